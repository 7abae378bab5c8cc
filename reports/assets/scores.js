// The scores of the page's data: estimates by recording, row, stratum, score, output and step.
import { inDigits, inSeconds } from "./drawing.js";
import { startFigure } from "./figure.js";
import { isCrowded, wideInterval } from "./line_chart.js";
import { pageData } from "./page_data.js";
import { isShown } from "./shown_trackers.js";

// Every output of every score; `key`: its name in options, `f1` or `f1.recall`.
const outputs = pageData.scores.flatMap((score) => score.outputs.map((output, i) => ({
  ...output,
  key: i ? `${score.name}.${output.name}` : score.name,
  full: `${score.name}.${output.name}`,
  heading: output.unit ? `${output.title}, ${output.unit}` : output.title,
  score,
})));
const outputByKey = new Map(outputs.map((one) => [one.key, one]));

export const recordingNamed = (name) => pageData.recordings.find((one) => one.name === name);
export const outputNamed = (key) => outputByKey.get(key);
export const hasScores = (recording) => recording.rows.some((row) => Object.keys(row.strata).length);
export const anyHasScores = () => pageData.recordings.some(hasScores);

// The curves { value, low, high } of a row; null if it has none. `low` and `high` may be missing.
export function estimateOf(row, stratum, key) {
  const output = outputNamed(key);
  return row.strata[stratum]?.[output?.score.name]?.[output.name] ?? null;
}

// The numbers { value, low, high } at one step; null if they are undefined.
export function pointOf(row, stratum, key, step) {
  const { value, low, high } = estimateOf(row, stratum, key) ?? {};
  return { value: value?.[step] ?? null, low: low?.[step] ?? null, high: high?.[step] ?? null };
}

// A function of a row and a score: its point at the chosen cells and time. `steps`: the steps to choose from.
export function pointsIn(chosen, steps = laterSteps(chosen)) {
  const step = stepAt(chosen, steps);
  return (row, key = chosen.score) => pointOf(row, chosen.stratum, key, step);
}

export const isDefined = (row, stratum, key) => estimateOf(row, stratum, key) !== null;

// The shown rows of a recording that have the score anywhere.
export function rowsWith(recording, stratum, key) {
  return recording.rows.filter((row) => isShown(row.label) && isDefined(row, stratum, key));
}

// A line of a chart in the colour of its row; the name says if the row is not ranked.
export function lineOf(row, values) {
  const unranked = row.group === "unranked";
  return { name: unranked ? `${row.name} (not ranked)` : row.name, style: unranked ? `${row.style} partial` : row.style, ...values };
}

// A line through points { value, low, high } at `xs`.
export function lineThrough(row, xs, points) {
  const [values, low, high] = ["value", "low", "high"].map((name) => points.map((point) => point[name]));
  return lineOf(row, { xs, values, low, high });
}

// A figure of one of the recordings that it `has`; none without any. `chosen(recording)`: its other choices at the start,
// on the first one; `choices(chosen, recording)`: those after the choice of the recording.
export function startFigureOfRecording({ has, chosen, choices, ...figure }) {
  const listed = pageData.recordings.filter(has);
  if (!listed.length) return;
  const options = listed.map(({ name }) => [name, name]);
  startFigure({
    ...figure,
    chosen: { recording: listed[0].name, ...chosen(listed[0]) },
    choices: (now) => [["recording", "Recording", options], ...choices(now, recordingNamed(now.recording))],
  });
}

// Options of selects, from the recording. `has`: whether an option is listed.
export function strataOf(recording, has = () => true, noun = "cells") {
  return [...new Set(recording.rows.flatMap((row) => Object.keys(row.strata)))].filter(has).map((name) => [name, stratumWords(name, noun)]);
}

// The choice of the stratum of a chosen score, in the noun of what the score counts. `has`: whether a stratum is listed.
export function stratumChoice(recording, score, has) {
  const noun = outputNamed(score)?.score.counted ?? "cells";
  return ["stratum", noun[0].toUpperCase() + noun.slice(1), strataOf(recording, has, noun)];
}

// Strata of contacts and of people alone have a name of their own.
export const stratumWords = (name, noun = "cells") => (/^(contacts|people)\b/.test(name) ? name : `${name} ${noun}`);

export function scoresOf(recording, stratum, has = () => true) {
  return outputs.filter(has).filter(({ key }) => recording.rows.some((row) => isDefined(row, stratum, key)))
    .map(({ key, heading }) => [key, heading]);
}

export const allSteps = ({ recording }) => recordingNamed(recording).horizons_s.map((_, step) => step);

// The steps ahead at which any row has the chosen score, if there are some: a score may have only a few horizons.
function laterSteps(chosen) {
  const { rows } = recordingNamed(chosen.recording), steps = allSteps(chosen).slice(1);
  const hasValue = (step) => rows.some((row) => pointOf(row, chosen.stratum, chosen.score, step).value !== null);
  const scored = chosen.score ? steps.filter(hasValue) : [];
  return scored.length ? scored : steps;
}

// The choice of the time ahead, in seconds: recordings of other rates have other steps. `steps`: only these.
export function aheadChoice(chosen, steps = laterSteps(chosen)) {
  const { horizons_s: seconds } = recordingNamed(chosen.recording);
  const options = steps.map((step) => [seconds[step], inSeconds(seconds[step])]);
  return ["ahead_s", "Ahead", options, seconds[stepAt(chosen, steps)]];
}

// The step of the chosen recording nearest to the chosen time ahead, to a thousandth of a step; the even one of two
// equally near steps, as in common/horizons.py.
export function stepAt(chosen, steps = laterSteps(chosen)) {
  const { horizons_s: seconds } = recordingNamed(chosen.recording);
  const away = (step) => Math.round((1000 * Math.abs(seconds[step] - chosen.ahead_s)) / seconds[1]);
  return steps.toSorted((a, b) => away(a) - away(b) || (a % 2) - (b % 2))[0];
}

// The heading of a score, with a remark if lower is better.
export function scoreWords({ heading, better }) {
  return better === "lower" ? `${heading} (lower is better)` : heading;
}

export function bandWords(chart) {
  const { lines, x, y } = chart;
  if (!lines.some((one) => one.low?.some((v) => v !== null))) return "; without intervals";
  const band = isCrowded(lines) ? "; a band, of the line next to the pointer, is a 95 % interval" : "; a band is a 95 % interval";
  const wide = wideInterval(chart);
  if (!wide) return band;
  const [low, high] = [wide.low, wide.high].map((value) => inDigits(value, Math.min(y.digits ?? 2, 2)));
  return `${band}; it is wide, of ${wide.name} ${low} to ${high} at ${x.words?.(wide.place) ?? wide.place}: too few data to order such lines`;
}
