// Every score of every tracker, for one recording, stratum and horizon.
import { inDigits } from "./axis.js";
import { make, swatch } from "./elements.js";
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { aheadChoice, ENDS, recordingNamed, recordingOptions, scoresOf, stepAt, strataOf, valueAt } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const rowsIn = ({ recording, stratum }) =>
  recordingNamed(recording).rows.filter((row) => isShown(row.label) && row.strata[stratum]);
const columnsOf = ({ recording, stratum }) => scoresOf(recordingNamed(recording), stratum);

// A function of a row and a score: its value and the ends of its interval.
function endsIn(chosen) {
  const step = stepAt(chosen);
  return (row, key) => ENDS.map((end) => valueAt(row, chosen.stratum, key, step, end));
}

function cell([value, low, high]) {
  const interval = low === null || high === null ? [] : [make("small", {}, `[${inDigits(low)}, ${inDigits(high)}]`)];
  return make("td", {}, inDigits(value), ...interval);
}

function drawTable(chosen) {
  const columns = columnsOf(chosen), ends = endsIn(chosen);
  const heading = (words, name) => make("th", { scope: "col", class: name ? "name" : null }, words);
  const lines = rowsIn(chosen).map((row) => make("tr", {},
    make("th", { scope: "row", class: "name" }, swatch(row.style), make("span", { class: "label" }, row.group === "unranked" ? `${row.name} (${row.outcome})` : row.name)),
    ...columns.map(([key]) => cell(ends(row, key)))));
  return make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Every score" }, make("table", {},
    make("thead", {}, make("tr", {}, heading("tracker", true), ...columns.map(([, name]) => heading(name, false)))),
    make("tbody", {}, ...lines)));
}

function tableNumbers(chosen) {
  const columns = columnsOf(chosen), ends = endsIn(chosen);
  return [["tracker", "outcome", ...columns.flatMap(([key]) => ENDS.map((end) => key + end))],
    ...rowsIn(chosen).map((row) => [row.name, row.outcome, ...columns.flatMap(([key]) => ends(row, key))])];
}

// Fills the section of every score.
export function startScoreTable() {
  const listed = recordingOptions((recording) => recording.rows.some((row) => Object.keys(row.strata).length));
  if (!listed.length) return;
  const { stratum, ahead_s } = pageData.headline;
  startFigure({
    id: "every-score",
    title: "Every score",
    chosen: { recording: listed[0][0], stratum, ahead_s },
    choices: (now) => {
      const recording = recordingNamed(now.recording);
      return [["recording", "Recording", listed], ["stratum", "Cells", strataOf(recording)], aheadChoice(now)];
    },
    drawing: drawTable,
    numbers: tableNumbers,
    line: () => "Pooled over the scored frames; brackets are 95 % intervals.",
  });
}
