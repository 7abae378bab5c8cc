// Every score of every tracker, for one recording, stratum and horizon.
import { inDigits, make, swatch } from "./drawing.js";
import { pageData } from "./page_data.js";
import { aheadChoice, allSteps, hasScores, outputNamed, pointsIn, recordingNamed, scoresOf, startFigureOfRecording, strataOf } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const rowsIn = ({ recording, stratum }) =>
  recordingNamed(recording).rows.filter((row) => isShown(row.label) && row.strata[stratum]);
const columnsOf = ({ recording, stratum }) => scoresOf(recordingNamed(recording), stratum);

function cell({ value, low, high }, decimals) {
  const number = (one) => inDigits(one, decimals);
  const interval = low === null || high === null ? [] : [make("small", {}, `[${number(low)}, ${number(high)}]`)];
  return make("td", {}, number(value), ...interval);
}

function drawTable(chosen) {
  const columns = columnsOf(chosen), at = pointsIn(chosen, allSteps(chosen));
  const heading = (words, name) => make("th", { scope: "col", class: name ? "name" : null }, words);
  const lines = rowsIn(chosen).map((row) => make("tr", {},
    make("th", { scope: "row", class: "name" }, swatch(row.style), make("span", { class: "label" }, row.remark ? `${row.name} (${row.remark})` : row.name)),
    ...columns.map(([key]) => cell(at(row, key), outputNamed(key).decimals))));
  return make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Every score" }, make("table", {},
    make("thead", {}, make("tr", {}, heading("tracker", true), ...columns.map(([, name]) => heading(name, false)))),
    make("tbody", {}, ...lines)));
}

function tableNumbers(chosen) {
  const columns = columnsOf(chosen), at = pointsIn(chosen, allSteps(chosen));
  const ends = ({ value, low, high }) => [value, low, high];
  return [["tracker", "outcome", ...columns.flatMap(([key]) => [key, `${key} low`, `${key} high`])],
    ...rowsIn(chosen).map((row) => [row.name, row.outcome, ...columns.flatMap(([key]) => ends(at(row, key)))])];
}

// Fills the section of every score.
export function startScoreTable() {
  const { stratum, ahead_s } = pageData.headline;
  startFigureOfRecording({
    id: "every-score",
    title: "Every score",
    has: hasScores,
    chosen: () => ({ stratum, ahead_s }),
    choices: (now, recording) => [["stratum", "Cells", strataOf(recording)], aheadChoice(now, allSteps(now))],
    drawing: drawTable,
    numbers: tableNumbers,
    line: () => "Brackets are 95 % intervals.",
  });
}
