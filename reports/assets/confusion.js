// Confusion matrices of the forecast classes, one for each tracker, and the recall of occupied cells by class.
import { scaleOf, svgText } from "./axis.js";
import { draw } from "./elements.js";
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { horizonOptions, recordingNamed, recordingOptions } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const CELL = 46, NAMES = 84, HEAD = 44, GAP = 28;
const rowsWithClasses = (recording) => recording.rows.filter((row) => row.classes);
const shownOf = ({ recording, visibility, step }) =>
  rowsWithClasses(recordingNamed(recording)).filter((row) => isShown(row.label) && row.classes.confusion[visibility]?.[step]);

function drawConfusion(chosen, width) {
  const rows = shownOf(chosen);
  const names = rows[0]?.classes.names ?? [], side = CELL * (names.length + 1) + NAMES;
  const across = Math.max(1, Math.floor((width + GAP) / (side + GAP)));
  const height = (HEAD + CELL * names.length + GAP) * Math.ceil(rows.length / across);
  const used = Math.max(side, Math.min(width, across * (side + GAP)));
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${used} ${height}`, width: used, height, role: "img" });
  svg.setAttribute("aria-label", rows.map((row) => `${row.name}: ${sharesOf(row, chosen).map((of, i) => `${names[i]} ${inPercent(of[i])} right`).join(", ")}`).join("; "));
  rows.forEach((row, i) => svg.append(draw("g", {
    class: `line ${row.style}`, transform: `translate(${(i % across) * (side + GAP)} ${Math.floor(i / across) * (HEAD + CELL * names.length + GAP)})`,
  }, ...matrix(row, names, sharesOf(row, chosen)))));
  return svg;
}

const classCounts = (row, { visibility, step }) => row.classes.confusion[visibility][step];
const sharesOf = (row, chosen) => classCounts(row, chosen).map((counts) => {
  const cells = counts.reduce((sum, one) => sum + one, 0);
  return counts.map((one) => (cells ? one / cells : 0));
});
const inPercent = (share) => `${Math.round(100 * share)} %`;
const short = (name) => (name.length > 11 ? `${name.slice(0, 10)}…` : name);

function matrix(row, names, shares) {
  const strength = scaleOf(0, 1, 0, 0.5);
  const parts = [svgText(0, 14, row.name)];
  names.forEach((name, i) => parts.push(svgText(NAMES - 6, HEAD + CELL * (i + 0.5) + 4, short(name), { class: "tick", "text-anchor": "end" })));
  [...names, "other"].forEach((name, j) => parts.push(svgText(NAMES + CELL * (j + 0.5), HEAD - 6, short(name).slice(0, 6), { class: "tick", "text-anchor": "middle" })));
  shares.forEach((of, i) => of.forEach((share, j) => {
    const [x, y] = [NAMES + CELL * j, HEAD + CELL * i];
    parts.push(draw("rect", { class: "share", x, y, width: CELL - 2, height: CELL - 2, "fill-opacity": strength(share) }),
      svgText(x + CELL / 2 - 1, y + CELL / 2 + 3, inPercent(share), { class: "on-share", "text-anchor": "middle" }));
  }));
  return parts;
}

function confusionNumbers(chosen) {
  const rows = shownOf(chosen), names = rows[0]?.classes.names ?? [];
  return [["tracker", "true class", ...names, "other"],
    ...rows.flatMap((row) => classCounts(row, chosen).map((counts, i) => [row.name, names[i], ...counts]))];
}

// Fills the section of the confusion matrices.
export function startConfusion() {
  const listed = recordingOptions((recording) => rowsWithClasses(recording).length);
  if (!listed.length) return;
  const of = (name) => rowsWithClasses(recordingNamed(name))[0].classes.confusion;
  const steps = (name, visibility) => Object.keys(of(name)[visibility] ?? {}).map(Number);
  const first = listed[0][0], visibility = Object.keys(of(first))[0];
  startFigure({
    id: "confusion",
    title: "Confusion of classes",
    chosen: { recording: first, visibility, step: pageData.headline.step },
    choices: (now) => [["recording", "Recording", listed],
      ["visibility", "Cells", Object.keys(of(now.recording)).map((name) => [name, `${name} cells`])],
      ["step", "Ahead", horizonOptions(recordingNamed(now.recording), steps(now.recording, now.visibility))]],
    drawing: drawConfusion,
    numbers: confusionNumbers,
    line: () => "Rows are true classes, columns the most probable ones.",
  });
}
