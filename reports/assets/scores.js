// Scores of the page's data: by recording, row, stratum, score and step.
import { inSeconds } from "./axis.js";
import { isCrowded } from "./line_chart.js";
import { pageData } from "./page_data.js";
import { isShown } from "./shown_trackers.js";

export const recordingNamed = (name) => pageData.recordings.find((one) => one.name === name);
export const scoreNamed = (key) => pageData.scores.find((one) => one.key === key);

// What is behind the name of a score: nothing for its value, then the ends of its interval.
export const ENDS = ["", "_low", "_high"];

// A curve of a row; null where the row has none. `end`: one of ENDS.
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

// A line of a chart in the colour of its row; of one that is not ranked it says so.
export function lineOf(row, values) {
  const unranked = row.group === "unranked";
  return { name: unranked ? `${row.name} (not ranked)` : row.name, style: unranked ? `${row.style} partial` : row.style, ...values };
}

// Options of selects: what the recording has. `has(recording)`: which recordings are listed.
export function recordingOptions(has = () => true) {
  return pageData.recordings.filter(has).map((one) => [one.name, one.name]);
}

export function strataOf(recording, has = () => true) {
  return [...new Set(recording.rows.flatMap((row) => Object.keys(row.strata)))].filter(has).map((name) => [name, `${name} cells`]);
}

export function scoresOf(recording, stratum, has = () => true) {
  return pageData.scores.filter(has)
    .filter(({ key }) => recording.rows.some((row) => curveOf(row, stratum, key)?.some((v) => v !== null)))
    .map(({ key, name }) => [key, name]);
}

export const allSteps = ({ recording }) => recordingNamed(recording).horizons_s.map((_, step) => step);
const laterSteps = (chosen) => allSteps(chosen).slice(1);

// The choice of the time ahead, in seconds: recordings of other rates have other steps. `steps`: only these.
export function aheadChoice(chosen, steps = laterSteps(chosen)) {
  const { horizons_s: seconds } = recordingNamed(chosen.recording);
  const options = steps.map((step) => [seconds[step], inSeconds(seconds[step])]);
  return ["ahead_s", "Ahead", options, seconds[stepAt(chosen, steps)]];
}

// The step of the chosen recording that is nearest to the chosen time ahead, of two equally near ones the even; to a
// thousandth of a step, as in common/horizons.py.
export function stepAt(chosen, steps = laterSteps(chosen)) {
  const { horizons_s: seconds } = recordingNamed(chosen.recording);
  const away = (step) => Math.round((1000 * Math.abs(seconds[step] - chosen.ahead_s)) / seconds[1]);
  return steps.toSorted((a, b) => away(a) - away(b) || (a % 2) - (b % 2))[0];
}

// What a score's name leaves open: that lower is better.
export function scoreWords({ name, better }) {
  return better < 0 ? `${name} (lower is better)` : name;
}

export function bandWords({ lines }) {
  if (!lines.some((one) => one.low?.some((v) => v !== null))) return "; without intervals";
  return isCrowded(lines) ? "; a band, of the line next to the pointer, is a 95 % interval" : "; a band is a 95 % interval";
}
