// The expectation of trackers for a place before their first frame, and the recorded occupancy, on a logarithmic scale.
import { draw, svgText } from "./drawing.js";
import { startFigure } from "./figure.js";
import { inflatedBytes, pageData } from "./page_data.js";
import { isShown } from "./shown_trackers.js";

const PRIOR_LEVELS = 254, PRIOR_UNSEEN = 255, DECADES = 3; // as in priors.py
const MAP_HEAD = 24, MAP_GAP = 20, MAP_SIDE = 300;
const BAR_LEFT = 18, BAR_LONG = 220, BAR_HIGH = 12, BAR_ROOM = 44, BAR_WHOLE = 370;
const placeOf = ({ recording }) => pageData.priors.find((one) => one.recording === recording);
const panelsOf = (chosen) => {
  const place = placeOf(chosen);
  const recorded = { name: "recorded: share of frames", style: "", cells: place.recorded };
  return [recorded, ...place.rows.filter((row) => isShown(row.label))];
};
const probabilityOf = (level) => 10 ** (DECADES * (level / PRIOR_LEVELS - 1));

// A PNG with one pixel per cell, from the colour of each cell, row 0 at the bottom.
function pictureOf(columns, rows, colourAt) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [columns, rows];
  const context = canvas.getContext("2d");
  const image = context.createImageData(columns, rows);
  for (let cell = 0; cell < columns * rows; cell += 1) {
    image.data.set([...colourAt(cell), 255], 4 * ((rows - 1 - Math.floor(cell / columns)) * columns + (cell % columns)));
  }
  context.putImageData(image, 0, 0);
  return canvas.toDataURL("image/png");
}

function priorColour(level) {
  const colours = pageData.level_colours, unseen = colours.length - 1;
  return colours[level === PRIOR_UNSEEN ? unseen : Math.round((level / PRIOR_LEVELS) * (unseen - 1))];
}

function mapOf({ name, style, cells }, size, side, x, y) {
  const href = pictureOf(size, size, (cell) => priorColour(cells[cell]));
  return draw("g", { class: `line ${style}`, transform: `translate(${x} ${y})` }, draw("title", {}, name), svgText(0, 15, name),
    draw("image", { class: "cells", y: MAP_HEAD, width: side, height: side, href }),
    draw("rect", { class: "map-edge", y: MAP_HEAD, width: side, height: side }));
}

// The logarithmic colours of the maps, and the colour of cells that were never visible.
function barOf(y) {
  const bar = pictureOf(PRIOR_LEVELS + 1, 1, priorColour), unseen = pictureOf(1, 1, () => priorColour(PRIOR_UNSEEN));
  const beside = BAR_LEFT + BAR_LONG + 18, below = y + BAR_HIGH + 15;
  const ticks = Array.from({ length: DECADES + 1 }, (_, i) => svgText(BAR_LEFT + (i / DECADES) * BAR_LONG, below,
    String(Number((10 ** (i - DECADES)).toPrecision(1))), { class: "tick", "text-anchor": "middle" }));
  const coloured = (x, width, href) => [
    draw("image", { x, y, width, height: BAR_HIGH, href, preserveAspectRatio: "none" }),
    draw("rect", { class: "map-edge", x, y, width, height: BAR_HIGH }),
  ];
  return draw("g", { class: "colour-bar" }, svgText(BAR_LEFT, y - 6, "P(occupied)"), ...coloured(BAR_LEFT, BAR_LONG, bar), ...ticks,
    ...coloured(beside, BAR_HIGH, unseen), svgText(beside + BAR_HIGH + 6, y + 10, "never visible", { class: "tick" }));
}

function drawPriors(chosen, width) {
  const { size } = placeOf(chosen), panels = panelsOf(chosen);
  const side = Math.min(MAP_SIDE, width), across = Math.max(1, Math.floor((width + MAP_GAP) / (side + MAP_GAP)));
  const bottom = (MAP_HEAD + side + MAP_GAP) * Math.ceil(panels.length / across), height = bottom + BAR_ROOM;
  const used = Math.min(width, Math.max(BAR_WHOLE, Math.min(across, panels.length) * (side + MAP_GAP) - MAP_GAP));
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${used} ${height}`, width: used, height, role: "img" });
  svg.setAttribute("aria-label", `Maps of ${panels.map((panel) => panel.name).join(", ")}`);
  panels.forEach((panel, i) => svg.append(mapOf(panel, size, side, (i % across) * (side + MAP_GAP),
    Math.floor(i / across) * (MAP_HEAD + side + MAP_GAP))));
  svg.append(barOf(bottom + 14));
  return svg;
}

function priorNumbers(chosen) {
  const { size } = placeOf(chosen), panels = panelsOf(chosen);
  const valueOf = (level) => (level === PRIOR_UNSEEN ? null : Number(probabilityOf(level).toPrecision(3)));
  return [["row", "column", ...panels.map((panel) => panel.name)],
    ...Array.from({ length: size * size }, (_, cell) => [Math.floor(cell / size), cell % size,
      ...panels.map((panel) => valueOf(panel.cells[cell]))])];
}

// Fills the section of the priors, once their cells are unpacked.
export async function startPriors() {
  if (!pageData.priors.length) return;
  for (const place of pageData.priors) {
    place.recorded = await inflatedBytes(place.recorded);
    for (const row of place.rows) row.cells = await inflatedBytes(row.cells);
  }
  startFigure({
    id: "priors",
    title: "Expected before anything is seen",
    chosen: { recording: pageData.priors[0].recording },
    choices: () => [["recording", "Recording", pageData.priors.map((one) => [one.recording, one.recording])]],
    drawing: drawPriors,
    numbers: priorNumbers,
    line: () => "P(occupied) from no input, one step ahead.",
  });
}
