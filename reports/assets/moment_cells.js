// The packed cells of a moment (`moments.py`), and their colours.
import { inflatedBytes, pageData } from "./page_data.js";

const CALLED = 32;
const IN_MOTION = 8;
const LEVEL_MASK = 31;
const HIDDEN_FREE = 2;
const HIDDEN_OCCUPIED = 3;
const NOT_SCORED = 4;
// Colours that differ without red or green; misses are also hollow (`drawMisses`).
export const MARK_COLOURS = {
  hit: [0, 92, 175],
  "false alarm": [240, 155, 0],
  miss: [205, 20, 85],
  "hidden, found": [70, 190, 225],
  "hidden, missed": [125, 75, 160],
  "hidden, not scored": [120, 120, 210],
};
const OTHER = [120, 122, 126];

// Planes of one moment: `input`, and `target(h)`, `forecast(h, tracker)` as Uint8Array of size * size cells.
export async function unpackedMoment(player, moment) {
  const bytes = await inflatedBytes(moment.cells);
  const area = player.size * player.size;
  const horizons = player.horizons_s.length;
  const plane = (at) => bytes.subarray(at * area, (at + 1) * area);
  return {
    input: plane(0),
    target: (h) => plane(1 + h),
    forecast: (h, tracker) => plane(1 + horizons + tracker * horizons + h),
  };
}

function unseenColour() {
  return pageData.level_colours[LEVEL_MASK + 1];
}

function ofLevel(level) {
  return pageData.level_colours[level];
}

export function inputColour(code) {
  return code === 0 ? unseenColour() : ofLevel(code === 2 ? LEVEL_MASK : 0);
}

// The observed frame: hidden cells as not visible.
export function cameColour(code) {
  const state = code & 7;
  return state > 1 ? unseenColour() : ofLevel(state === 1 ? LEVEL_MASK : 0);
}

// The truth: hidden cells too; cells that no laser can observe are grey.
export function truthColour(code) {
  const state = code & 7;
  return state === NOT_SCORED ? unseenColour() : ofLevel(state & 1 ? LEVEL_MASK : 0);
}

export function forecastColour(code) {
  return ofLevel(code & LEVEL_MASK);
}

// The name of a hit or an error of a forecast in a cell, or "". `stratum`: whether cells in motion are known.
export function markOf(forecast, target, stratum) {
  const called = (forecast & CALLED) !== 0;
  const state = target & 7;
  if (state === HIDDEN_OCCUPIED) return called ? "hidden, found" : "hidden, missed";
  // the threshold of cells in motion does not suit unknown cells: a whole unobserved region may be just above it
  if (state === NOT_SCORED) return 2 * (forecast & LEVEL_MASK) > LEVEL_MASK ? "hidden, not scored" : "";
  if (state === HIDDEN_FREE || (stratum && !(target & IN_MOTION))) return "";
  if (state === 1) return called ? "hit" : "miss";
  return called ? "false alarm" : "";
}

export function markColour(forecast, target, stratum) {
  const mark = markOf(forecast, target, stratum);
  if (mark) return MARK_COLOURS[mark];
  const state = target & 7;
  if (state === 1) return OTHER;
  return state === 0 ? ofLevel(0) : unseenColour();
}

export function cssColour(colour) {
  return `rgb(${colour.join(" ")})`;
}

// The first centre of the view: the centre of the occupied cells in motion in the unpacked moments, else the window's.
export function busiestCell(player, planes) {
  let count = 0, x = 0, y = 0;
  for (let h = 0; h < player.horizons_s.length; h += 1) {
    planes.target(h).forEach((code, at) => {
      if (code === (IN_MOTION | 1)) {
        count += 1;
        x += at % player.size;
        y += Math.floor(at / player.size);
      }
    });
  }
  return count ? [x / count, y / count] : [player.size / 2, player.size / 2];
}
