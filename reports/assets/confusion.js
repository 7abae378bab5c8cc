// Confusion matrices of the forecast classes, one for each tracker, and the recall of occupied cells by class.
import { draw, scaleOf, shortened, svgText, textWidth } from "./drawing.js";
import { pageData } from "./page_data.js";
import { pointsOf, stepsWith, strataWith } from "./probabilities.js";
import { aheadChoice, recordingNamed, startFigureOfRecording } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const CELL = 46, NAMES = 84, TITLE = 20, GAP = 28;
const classCounts = (row, chosen) => pointsOf(row, "confusion", chosen)?.confusion ?? null;
const shownOf = (chosen) =>
  recordingNamed(chosen.recording).rows.filter((row) => isShown(row.label) && classCounts(row, chosen));

function drawConfusion(chosen, width) {
  const rows = shownOf(chosen);
  const names = recordingNamed(chosen.recording).classes, side = CELL * (names.length + 1) + NAMES;
  const across = Math.max(1, Math.floor((width + GAP) / (side + GAP)));
  const heads = headsOf(names), down = heads.height + CELL * names.length + GAP;
  const height = down * Math.ceil(rows.length / across);
  const used = Math.max(side, Math.min(width, across * (side + GAP)));
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${used} ${height}`, width: used, height, role: "img" });
  svg.setAttribute("aria-label", rows.map((row) => `${row.name}: ${sharesOf(row, chosen).map((of, i) => `${names[i]} ${inPercent(of[i])} right`).join(", ")}`).join("; "));
  rows.forEach((row, i) => svg.append(draw("g", {
    class: `line ${row.style}`, transform: `translate(${(i % across) * (side + GAP)} ${Math.floor(i / across) * down})`,
  }, ...matrix(row, names, sharesOf(row, chosen), heads))));
  return svg;
}

const sharesOf = (row, chosen) => classCounts(row, chosen).map((counts) => {
  const cells = counts.reduce((sum, one) => sum + one, 0);
  return counts.map((one) => (cells ? one / cells : 0));
});
const inPercent = (share) => `${Math.round(100 * share)} %`;

// The heads of the columns: their texts, whether they are upright because one is wider than its column, and the height
// of heads and title.
function headsOf(names) {
  const texts = [...names, "other"], widths = texts.map((name) => textWidth(shortened(name, NAMES - 6)));
  const upright = Math.max(...widths) > CELL - 4;
  return { texts, upright, height: TITLE + (upright ? Math.max(...widths) + 10 : 24) };
}

// The name of a class, in full in its title if there is no room for it.
function className(name, x, y, attributes) {
  const text = svgText(x, y, shortened(name, NAMES - 6), { class: "tick", ...attributes });
  if (text.textContent !== name) text.append(draw("title", {}, name));
  return text;
}

function matrix(row, names, shares, { texts, upright, height }) {
  const strength = scaleOf(0, 1, 0, 0.5);
  const turned = (x, y) => (upright ? { transform: `rotate(-90 ${x} ${y})` } : { "text-anchor": "middle" });
  const parts = [svgText(0, 14, row.name)];
  names.forEach((name, i) => {
    parts.push(className(name, NAMES - 6, height + CELL * (i + 0.5) + 4, { "text-anchor": "end" }));
  });
  texts.forEach((name, j) => {
    const [x, y] = [NAMES + CELL * (j + 0.5) + (upright ? 4 : 0), height - 6];
    parts.push(className(name, x, y, turned(x, y)));
  });
  shares.forEach((of, i) => of.forEach((share, j) => {
    const [x, y] = [NAMES + CELL * j, height + CELL * i];
    parts.push(draw("rect", { class: "share", x, y, width: CELL - 2, height: CELL - 2, "fill-opacity": strength(share) }),
      svgText(x + CELL / 2 - 1, y + CELL / 2 + 3, inPercent(share), { class: "on-share", "text-anchor": "middle" }));
  }));
  return parts;
}

function confusionNumbers(chosen) {
  const rows = shownOf(chosen), names = recordingNamed(chosen.recording).classes;
  return [["tracker", "true class", ...names, "other"],
    ...rows.flatMap((row) => classCounts(row, chosen).map((counts, i) => [row.name, names[i], ...counts]))];
}

// Fills the section of the confusion matrices.
export function startConfusion() {
  const strata = (recording) => strataWith(recording, "confusion");
  startFigureOfRecording({
    id: "confusion",
    title: "Confusion of classes",
    has: (recording) => strata(recording).length,
    chosen: (recording) => ({ stratum: strata(recording)[0][0], ahead_s: pageData.headline.ahead_s }),
    choices: (now, recording) => [["stratum", "Cells", strata(recording)], aheadChoice(now, stepsWith(now, "confusion"))],
    drawing: drawConfusion,
    numbers: confusionNumbers,
    line: () => "Rows are true classes, columns the most probable ones.",
  });
}
