// Figures of probabilities: precision against recall, F1 over the threshold, and calibration.
import { pageData } from "./page_data.js";
import { aheadChoice, bandWords, lineOf, recordingNamed, startFigureOfRecording, stepAt, stratumWords } from "./scores.js";
import { isShown } from "./shown_trackers.js";

// The figures of a row by stratum and step, from the score with the points `field`; empty without such a score.
export function figureWith(row, field) {
  const hasField = (strata) => Object.values(strata).some((steps) => Object.values(steps).some((points) => field in points));
  return Object.values(row.figures).find(hasField) ?? {};
}

export function strataWith(recording, field) {
  const names = recording.rows.flatMap((row) => Object.keys(figureWith(row, field)));
  return [...new Set(names)].map((name) => [name, stratumWords(name)]);
}

// The steps of all strata: a stratum without an occupied cell has none.
export function stepsWith({ recording }, field) {
  const figures = recordingNamed(recording).rows.map((row) => figureWith(row, field));
  return [...new Set(figures.flatMap((strata) => Object.values(strata).flatMap(Object.keys)))].map(Number).sort((a, b) => a - b);
}

export function pointsOf(row, field, chosen) {
  return figureWith(row, field)[chosen.stratum]?.[stepAt(chosen, stepsWith(chosen, field))] ?? null;
}

const probabilityWords = (p) => `p ≥ ${Number(p.toPrecision(2))}`;

function linesOf(chosen, field, fields) {
  return recordingNamed(chosen.recording).rows.toReversed()
    .map((row) => ({ row, points: pointsOf(row, field, chosen) }))
    .filter(({ row, points }) => isShown(row.label) && points)
    .map(({ row, points }) => lineOf(row, fields(points)));
}

// Precision over recall; at recall 0 with the precision of the highest threshold. Thresholds with the same occupied cells
// are one point.
function curveFromZero({ p, recall, precision: { value: precision, low, high } }) {
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
  const lines = linesOf(chosen, "precision", curveFromZero);
  return { lines, x: { name: "recall", range: [0, 1] }, y: { name: "precision", range: [0, 1.02] } };
}

function f1OverThreshold(chosen) {
  const f1 = (precision, recall) => (precision + recall ? (2 * precision * recall) / (precision + recall) : 0);
  const lines = linesOf(chosen, "precision", ({ p, recall, precision: { value: precision } }) => ({ xs: p, values: p.map((_, i) => f1(precision[i], recall[i])) }));
  return { lines, x: { name: "threshold", range: [0, 1] }, y: { name: "F1", fromZero: true } };
}

function calibration(chosen) {
  const lines = linesOf(chosen, "mean_p", ({ mean_p: xs, share: values }) => ({ xs, values }));
  return { lines, x: { name: "forecast probability", range: [0, 1] }, y: { name: "share occupied", range: [0, 1.02] }, diagonal: true };
}

const FIGURES = [
  { field: "precision", id: "precision-recall", title: "Precision and recall", chart: precisionRecall, fixed: () => ({ score: "precision" }), line: (now) => `Each point is a threshold${bandWords(precisionRecall(now))}.` },
  { field: "precision", id: "threshold", title: "Threshold", chart: f1OverThreshold, fixed: () => ({ score: "f1" }), line: () => "F1 at every threshold." },
  { field: "mean_p", id: "calibration", title: "Calibration", chart: calibration, fixed: () => ({ score: "share occupied" }), line: () => "On the diagonal, p is the share of cells that were occupied." },
];

// Fills a section for each of FIGURES.
export function startProbabilities() {
  const { stratum, ahead_s } = pageData.headline;
  for (const { field, ...figure } of FIGURES) {
    startFigureOfRecording({
      ...figure,
      has: (recording) => strataWith(recording, field).length,
      chosen: () => ({ stratum, ahead_s }),
      choices: (now, recording) => [["stratum", "Cells", strataWith(recording, field)], aheadChoice(now, stepsWith(now, field))],
    });
  }
}
