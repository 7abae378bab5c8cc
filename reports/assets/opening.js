// The moving picture of the first screen: one telling moment, horizon by horizon: the input, two forecasts, what came.
// Paths of robots stand through it.
import { openInAddress } from "./address.js";
import { inSeconds, make, meaning } from "./drawing.js";
import { busiestCell, cameColour, unpackedMoment } from "./moment_cells.js";
import { MomentCanvas, MomentDrawing, robotsLegend } from "./moment_drawing.js";
import { contactCell, IN_ADDRESS, robotCounts } from "./moments.js";
import { pageData } from "./page_data.js";
import { momentsOf } from "./players.js";

const FRAME_MS = 900;
const SHOWN_M = 8;

export async function startOpening() {
  const { opening } = pageData, section = document.getElementById("opening");
  if (!opening) return;
  section.hidden = false;
  const data = momentsOf(opening.recording), trackers = opening.trackers.map((label) => data.trackers.indexOf(label));
  const planes = await unpackedMoment(data, data.moments[opening.moment]);
  const span = Math.min(data.size, Math.max(20, Math.round(SHOWN_M / data.cell_m)));
  const [left, bottom] = (contactCell(data, opening.moment) ?? busiestCell(data, planes))
    .map((middle) => Math.round(Math.min(Math.max(middle - span / 2, 0), data.size - span)));
  const foreseenOf = (tracker) => {
    const counts = robotCounts(data, opening.moment, tracker);
    return counts && `${counts.foreseen} of ${counts.foreseen + counts.missed} contacts foreseen`;
  };
  // with paths of robots nothing is marked beside them, and the time ends with them
  const hasPaths = contactCell(data, opening.moment) !== null, last = hasPaths ? data.robots_at : data.horizons_s.length - 1;
  const state = {
    data, moment: opening.moment, h: data.robots_at ?? data.decisive, marks: !hasPaths, boxes: false, robots: true,
    pathsThroughout: true, split: 0, shown: trackers,
  };
  const drawn = [
    [new MomentCanvas("input"), (drawing) => drawing.input()],
    [new MomentCanvas("observed"), (drawing) => drawing.target(cameColour, "observed")],
    ...trackers.map((tracker) => [new MomentCanvas(""), (drawing) => drawing.forecast(tracker, foreseenOf(tracker))]),
  ];
  drawn.slice(2).forEach(([panel], at) => { panel.element.dataset.tracker = opening.trackers[at]; });
  const show = () => drawn.forEach(([panel, draw]) => {
    panel.prepare({ left, bottom, span });
    draw(new MomentDrawing(state, panel, planes));
  });
  const button = make("button", { type: "button" }, "play");
  const open = make("button", { type: "button" }, "open this moment");
  const words = make("output", {});
  const go = (h) => {
    state.h = h;
    show();
    words.textContent = `+${inSeconds(data.horizons_s[h])}`;
  };
  let timer = null;
  const play = (playing) => {
    clearInterval(timer);
    timer = playing ? setInterval(() => go((state.h + 1) % (last + 1)), FRAME_MS) : null;
    button.textContent = playing ? "pause" : "play";
  };
  button.addEventListener("click", () => play(!timer));
  open.addEventListener("click", () =>
    openInAddress(IN_ADDRESS, [data.recording, data.moments[state.moment].t, data.horizons_s[state.h], ...opening.trackers]));
  section.append(
    make("div", { class: "moment-panels" }, ...drawn.map(([panel]) => panel.element)),
    ...(hasPaths ? [robotsLegend()] : []),
    make("p", { class: "note" }, button, " ", open, " ", words, ` ${data.recording}. `, meaning("where-two-trackers-differ-most")));
  new ResizeObserver(show).observe(section);
  go(state.h);
  play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
}
