// One score of two rows on every stratum: such as cells in motion, standing, hidden, near and far.
import { axisName, axisRange, draw, inDigits, rowName, svgText } from "./drawing.js";
import { pageData } from "./page_data.js";
import { rowPlot } from "./row_plot.js";
import { aheadChoice, hasScores, isDefined, outputNamed, pointsIn, recordingNamed, scoresOf, scoreWords, startFigureOfRecording, strataOf } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const SLICE_ROW = 36, DIFFERENCE_ROOM = 72, BESIDE = 6;

const slicesOf = (recording, score) =>
  strataOf(recording, (name) => recording.rows.some((row) => isDefined(row, name, score))).map(([name]) => name);
const slicedScores = (recording) => strataOf(recording)
  .flatMap(([name]) => scoresOf(recording, name))
  .filter(([key], i, all) => all.findIndex(([other]) => other === key) === i && slicesOf(recording, key).length > 1);

// The two rows of a choice, without a hidden one.
const comparedRows = ({ recording, row, other }) => [row, other]
  .map((label) => recordingNamed(recording).rows.find((one) => one.label === label))
  .filter((one) => one && isShown(one.label));

// The strata in which a row has a value, and the points of the rows there.
function slicePoints(chosen) {
  const rows = comparedRows(chosen);
  const at = slicesOf(recordingNamed(chosen.recording), chosen.score).map((stratum) => {
    const points = pointsIn({ ...chosen, stratum });
    return { stratum, points: rows.map((row) => points(row)) };
  });
  return { rows, slices: at.filter(({ points }) => points.some(({ value }) => value !== null)) };
}

function drawSlices(chosen, width) {
  const { rows, slices } = slicePoints(chosen), { heading, decimals } = outputNamed(chosen.score);
  const range = axisRange(slices.flatMap(({ points }) => points.flatMap(Object.values)), false);
  const { svg, x, places, end } = rowPlot({
    names: slices.map(({ stratum }) => stratum), least: SLICE_ROW, range, axis: axisName(heading, range), room: DIFFERENCE_ROOM,
    beside: "difference", width,
    words: slices.map(({ stratum, points }) => `${stratum}: ${points.map(({ value }, i) => `${rows[i].name} ${inDigits(value, decimals)}`).join(", ")}`).join("; "),
  });
  slices.forEach(({ points }, i) => {
    const { y } = places[i];
    svg.append(rowName(places[i]), ...rows.map((row, k) => drawnPoint(row, points[k], x, y + (k ? BESIDE : -BESIDE))));
    const [first, second] = points.map(({ value }) => value);
    if (first === null || second === null || points.length < 2) return;
    const less = first - second;
    svg.append(svgText(end + DIFFERENCE_ROOM, y + 4, `${less < 0 ? "−" : "+"}${inDigits(Math.abs(less), decimals)}`, { "text-anchor": "end" }));
  });
  return svg;
}

function drawnPoint(row, { value, low, high }, x, y) {
  const group = draw("g", { class: `line ${row.style}` }, draw("title", {}, row.name));
  if (value === null) return group;
  if (low !== null && high !== null) group.append(draw("line", { class: "whisker", x1: x(low), x2: x(high), y1: y, y2: y }));
  group.append(draw("circle", { class: "dot", cx: x(value), cy: y, r: 4.5 }));
  return group;
}

function sliceNumbers(chosen) {
  const { rows, slices } = slicePoints(chosen);
  return [["cells", "tracker", chosen.score, "low", "high"],
    ...slices.flatMap(({ stratum, points }) => points.map(({ value, low, high }, i) => [stratum, rows[i].name, value, low, high]))];
}

// Fills the section of slices.
export function startSlices() {
  const { score, ahead_s } = pageData.headline;
  startFigureOfRecording({
    id: "slices",
    title: "Slices",
    has: (recording) => hasScores(recording) && recording.rows.length > 1 && slicedScores(recording).length,
    chosen: (recording) => {
      const inOrder = ["ranked", "floor", "unranked", "ceiling"].flatMap((group) => recording.rows.filter((row) => row.group === group));
      const floor = inOrder.find((row) => row.group === "floor" && row !== inOrder[0]) ?? inOrder[1];
      return { score, ahead_s, row: inOrder[0].label, other: floor.label };
    },
    choices: (now, recording) => {
      const rows = recording.rows.map(({ label, name }) => [label, name]);
      return [["score", "Score", slicedScores(recording)], ["row", "Tracker", rows],
        ["other", "Beside", rows.filter(([label]) => label !== now.row)], aheadChoice(now)];
    },
    drawing: drawSlices,
    numbers: sliceNumbers,
    line: (now) => `${scoreWords(outputNamed(now.score))} by cells; the difference is not tested.`,
    legend: (now) => comparedRows(now),
  });
}
