// Scores of the page's data: by recording, row, stratum, score and step.
import { pageData } from "./page_data.js";
import { isShown } from "./shown_trackers.js";

export const recordingNamed = (name) => pageData.recordings.find((one) => one.name === name);
export const scoreNamed = (key) => pageData.scores.find((one) => one.key === key);

// A curve of a row; null where the row has none. `end`: "", "_low" or "_high".
export function curveOf(row, stratum, score, end = "") {
  return row.strata[stratum]?.[score + end] ?? null;
}

export function valueAt(row, stratum, score, step, end = "") {
  return curveOf(row, stratum, score, end)?.[step] ?? null;
}

// The rows of a recording that are shown and have the score anywhere.
export function rowsWith(recording, stratum, score) {
  return recording.rows.filter((row) => isShown(row.label) && curveOf(row, stratum, score)?.some((v) => v !== null));
}

// Options of selects: what the recording has.
export function recordingOptions() {
  return pageData.recordings.map((one) => [one.name, one.name]);
}

export function strataOf(recording) {
  return [...new Set(recording.rows.flatMap((row) => Object.keys(row.strata)))].map((name) => [name, `${name} cells`]);
}

export function scoresOf(recording, stratum) {
  return pageData.scores
    .filter(({ key }) => recording.rows.some((row) => curveOf(row, stratum, key)?.some((v) => v !== null)))
    .map(({ key, name }) => [key, name]);
}

// What a score's name leaves open: its unit, and that lower is better.
export function scoreWords({ name, better }) {
  return better < 0 ? `${name} (lower is better)` : name;
}
