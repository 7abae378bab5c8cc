// What the histograms of probability say: precision against recall, F1 over the threshold, and calibration.
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { aheadChoice, bandWords, lineOf, recordingNamed, recordingOptions, stepAt } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const binsOf = (row, chosen) => row.bins?.[chosen.stratum]?.[stepAt(chosen, stepsWithBins(chosen))] ?? null;
const hasBins = (recording) => recording.rows.some((row) => row.bins);
const firstBins = ({ recording }) => recordingNamed(recording).rows.find((row) => row.bins).bins;
// Of all strata: one of which no cell was occupied has no steps.
const stepsWithBins = (chosen) =>
  [...new Set(Object.values(firstBins(chosen)).flatMap(Object.keys))].map(Number).sort((a, b) => a - b);
const probabilityWords = (p) => `p ≥ ${Number(p.toPrecision(2))}`;

function linesOf(chosen, fields) {
  return recordingNamed(chosen.recording).rows.toReversed()
    .filter((row) => isShown(row.label) && binsOf(row, chosen))
    .map((row) => lineOf(row, fields(binsOf(row, chosen))));
}

// Precision over recall from recall 0 on, where it is that of the highest threshold; thresholds at which the same cells
// are called occupied are one point.
function curveFromZero({ p, recall, precision, precision_low: low, precision_high: high }) {
  const repeats = (i) => recall[i] === recall[i - 1] && precision[i] === precision[i - 1];
  const points = [...p.keys()].filter((i) => !repeats(i));
  const drawn = recall[0] > 0 ? [0, ...points] : points;
  const fromZero = (values) => values && drawn.map((i) => values[i]);
  return {
    xs: drawn.map((i, at) => (at ? recall[i] : 0)), values: fromZero(precision), low: fromZero(low), high: fromZero(high),
    notes: fromZero(p).map(probabilityWords),
  };
}

function precisionRecall(chosen) {
  const lines = linesOf(chosen, curveFromZero);
  return { lines, x: { name: "recall", range: [0, 1] }, y: { name: "precision", range: [0, 1.02] } };
}

function f1OverThreshold(chosen) {
  const f1 = (precision, recall) => (precision + recall ? (2 * precision * recall) / (precision + recall) : 0);
  const lines = linesOf(chosen, ({ p, recall, precision }) => ({ xs: p, values: p.map((_, i) => f1(precision[i], recall[i])) }));
  return { lines, x: { name: "threshold", range: [0, 1] }, y: { name: "F1", fromZero: true } };
}

function calibration(chosen) {
  const lines = linesOf(chosen, ({ mean_p: xs, share: values }) => ({ xs, values }));
  return { lines, x: { name: "forecast probability", range: [0, 1] }, y: { name: "share occupied", range: [0, 1.02] }, diagonal: true };
}

const FIGURES = [
  { id: "precision-recall", title: "Precision and recall", chart: precisionRecall, fixed: () => ({ score: "precision" }), line: (now) => `Each point is a threshold; PR-AUC is the mean precision over recall, in steps${bandWords(precisionRecall(now))}.` },
  { id: "threshold", title: "Threshold", chart: f1OverThreshold, fixed: () => ({ score: "f1" }), line: () => "F1 at every threshold." },
  { id: "calibration", title: "Calibration", chart: calibration, fixed: () => ({ score: "share occupied" }), line: () => "On the diagonal, p is the share of cells that were occupied." },
];

// Fills a section for each of FIGURES.
export function startProbabilities() {
  const listed = recordingOptions(hasBins);
  if (!listed.length) return;
  const { stratum, ahead_s } = pageData.headline;
  for (const figure of FIGURES) {
    startFigure({
      ...figure,
      chosen: { recording: listed[0][0], stratum, ahead_s },
      choices: (now) => [["recording", "Recording", listed],
        ["stratum", "Cells", Object.keys(firstBins(now)).map((name) => [name, `${name} cells`])],
        aheadChoice(now, stepsWithBins(now))],
    });
  }
}
