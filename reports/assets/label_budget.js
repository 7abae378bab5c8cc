// Log loss of the classes over the number of labelled scans that the weights of a row learned them from.
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { aheadChoice, allSteps, bandWords, recordingNamed, recordingOptions, stepAt } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const labelledRows = (recording, visibility) => recording.rows.filter((row) => row.label_budget?.losses[visibility]);
const budgetsOf = (rows) => [...new Set(rows.map((row) => row.label_budget.scans))].sort((a, b) => a - b);
const visibilitiesOf = (recording) => [...new Set(recording.rows.flatMap((row) => Object.keys(row.label_budget?.losses ?? {})))]
  .filter((visibility) => budgetsOf(labelledRows(recording, visibility)).length > 1);
const lossOf = (row, chosen, end = "") =>
  row.label_budget.losses[chosen.visibility][`nll${end}`]?.[stepAt(chosen, allSteps(chosen))] ?? null;
const shownRows = (chosen) => labelledRows(recordingNamed(chosen.recording), chosen.visibility)
  .filter((row) => isShown(row.label) && lossOf(row, chosen) !== null);

// A line for each method: the mean of the rows that learned from equally many scans, an interval where it is one row.
function budgetLine(method, rows, chosen) {
  const budgets = budgetsOf(rows);
  const rowsAt = budgets.map((scans) => rows.filter((row) => row.label_budget.scans === scans));
  const end = (which) => rowsAt.map((own) => (own.length === 1 ? lossOf(own[0], chosen, which) : null));
  return {
    name: method,
    style: rows[0].style,
    xs: budgets.map(Math.log2),
    values: rowsAt.map((own) => own.reduce((sum, row) => sum + lossOf(row, chosen), 0) / own.length),
    low: end("_low"),
    high: end("_high"),
    dotStyles: rowsAt.map((own) => own[0].style),
    notes: rowsAt.map((own) => (own.length === 1 ? own[0].name : `mean of ${own.length} rows`)),
  };
}

function budgetChart(chosen) {
  const rows = shownRows(chosen), methods = [...new Set(rows.map((row) => row.label_budget.method))];
  const words = (place) => `${Math.round(2 ** place)} labelled scans`;
  return {
    lines: methods.map((method) => budgetLine(method, rows.filter((row) => row.label_budget.method === method), chosen)).toReversed(),
    x: { name: "labelled scans", ticks: budgetsOf(rows).map((scans) => [Math.log2(scans), String(scans)]), words },
    y: { name: "Log loss of a scan, nats", fromZero: true },
  };
}

function budgetNumbers(chosen) {
  return [["tracker", "method", "labelled scans", "log loss", "low", "high"], ...shownRows(chosen)
    .map((row) => [row.name, row.label_budget.method, row.label_budget.scans, ...["", "_low", "_high"].map((end) => lossOf(row, chosen, end))])];
}

// Fills the section of the label budget, where rows differ in the number of labelled scans.
export function startLabelBudget() {
  const listed = recordingOptions((recording) => visibilitiesOf(recording).length);
  if (!listed.length) return;
  startFigure({
    id: "label-budget",
    title: "Label budget",
    chosen: {
      recording: listed[0][0], visibility: visibilitiesOf(recordingNamed(listed[0][0]))[0],
      ahead_s: pageData.headline.ahead_s,
    },
    choices: (now) => [["recording", "Recording", listed],
      ["visibility", "Cells", visibilitiesOf(recordingNamed(now.recording)).map((name) => [name, `${name} cells`])],
      aheadChoice(now, allSteps(now))],
    chart: budgetChart,
    numbers: budgetNumbers,
    line: (now) => `Log loss of classes (lower is better) over labelled scans${bandWords(budgetChart(now))}.`,
  });
}
