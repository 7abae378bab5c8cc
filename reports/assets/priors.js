// What trackers expect of a place before they see it, beside what the recording shows, on a logarithmic scale.
import { svgText } from "./axis.js";
import { draw } from "./elements.js";
import { startFigure } from "./figure.js";
import { inflatedBytes } from "./inflated.js";
import { pageData } from "./page_data.js";
import { isShown } from "./shown_trackers.js";

const PRIOR_LEVELS = 254, PRIOR_UNSEEN = 255, DECADES = 3; // as in priors.py
const MAP_HEAD = 24, MAP_GAP = 20, MAP_SIDE = 300;
const placeOf = ({ recording }) => pageData.priors.find((one) => one.recording === recording);
const panelsOf = (chosen) => {
  const place = placeOf(chosen);
  const recorded = { name: "recorded: share of frames", style: "", cells: place.recorded };
  return [recorded, ...place.rows.filter((row) => isShown(row.label))];
};
const probabilityOf = (level) => 10 ** (DECADES * (level / PRIOR_LEVELS - 1));

// A PNG of a plane, one pixel a cell, row 0 at the bottom.
function pictureOf(size, cells) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = size;
  const context = canvas.getContext("2d");
  const image = context.createImageData(size, size);
  const colours = pageData.level_colours, unseen = colours.length - 1;
  cells.forEach((level, cell) => {
    const colour = colours[level === PRIOR_UNSEEN ? unseen : Math.round((level / PRIOR_LEVELS) * (unseen - 1))];
    image.data.set([...colour, 255], 4 * ((size - 1 - Math.floor(cell / size)) * size + (cell % size)));
  });
  context.putImageData(image, 0, 0);
  return canvas.toDataURL("image/png");
}

function drawPriors(chosen, width) {
  const { size } = placeOf(chosen), panels = panelsOf(chosen);
  const side = Math.min(MAP_SIDE, width), across = Math.max(1, Math.floor((width + MAP_GAP) / (side + MAP_GAP)));
  const height = (MAP_HEAD + side + MAP_GAP) * Math.ceil(panels.length / across);
  const used = Math.min(across, panels.length) * (side + MAP_GAP) - MAP_GAP;
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${used} ${height}`, width: used, height, role: "img" });
  svg.setAttribute("aria-label", `Maps of ${panels.map((panel) => panel.name).join(", ")}`);
  panels.forEach((panel, i) => svg.append(draw("g", {
    class: `line ${panel.style}`, transform: `translate(${(i % across) * (side + MAP_GAP)} ${Math.floor(i / across) * (MAP_HEAD + side + MAP_GAP)})`,
  }, draw("title", {}, panel.name), svgText(0, 15, panel.name),
  draw("image", { class: "cells", y: MAP_HEAD, width: side, height: side, href: pictureOf(size, panel.cells) }))));
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
    line: () => "P(occupied) from no input, one step ahead: 0.001 is white, 1 black, never visible grey.",
  });
}
