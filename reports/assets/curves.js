// Line figures of the scores: over the horizon, the scale, the hidden time of cells, conditions, and labelled scans.
import { inSeconds } from "./drawing.js";
import { pageData } from "./page_data.js";
import {
  aheadChoice, allSteps, anyHasScores, bandWords, isDefined, lineOf, lineThrough, outputNamed, pointOf, recordingNamed,
  rowsWith, scoresOf, scoreWords, startFigureOfRecording, stepAt, strataOf, stratumChoice,
} from "./scores.js";
import { isShown } from "./shown_trackers.js";

const axisOf = (key) => ({ name: outputNamed(key).heading, digits: outputNamed(key).decimals, fromZero: true });

// The best of the table is drawn last, on top.
function horizonChart({ recording, score, stratum }) {
  const rows = rowsWith(recordingNamed(recording), stratum, score).toReversed(), { horizons_s } = recordingNamed(recording);
  // a score of a few horizons has a line through them
  const steps = horizons_s.map((_, step) => step).filter((step) => rows.some((row) => pointOf(row, stratum, score, step).value !== null));
  const lines = rows.map((row) => lineThrough(row, steps.map((step) => horizons_s[step]), steps.map((step) => pointOf(row, stratum, score, step))));
  const words = (s) => `${inSeconds(s)} ahead${s ? "" : ": the input, not ranked"}`;
  return { lines, x: { name: "horizon, s", unit: " s", words, unranked: steps[0] === 0 }, y: axisOf(score) };
}

function startHorizon() {
  const { score, stratum } = pageData.headline;
  startFigureOfRecording({
    id: "curves",
    has: anyHasScores,
    chosen: () => ({ score, stratum }),
    choices: (now, recording) => [stratumChoice(recording, now.score), ["score", "Score", scoresOf(recording, now.stratum)]],
    chart: horizonChart,
    line: (now) => `${scoreWords(outputNamed(now.score))} over the horizon${bandWords(horizonChart(now))}.`,
  });
}

// Outputs with names such as `5_cells` are the values of their score at a scale, in cells.
const scaleOfOutput = ({ name }) => Number(/^(\d+)_cells$/.exec(name)?.[1] ?? 0);
const scaledScores = pageData.scores.filter((score) => score.outputs.filter(scaleOfOutput).length > 1);
const scalesOf = (name) => scaledScores.find((score) => score.name === name).outputs
  .filter(scaleOfOutput).sort((a, b) => scaleOfOutput(a) - scaleOfOutput(b));
const scaledOf = (recording, stratum) =>
  scaledScores.filter(({ name }) => recording.rows.some((row) => row.strata[stratum]?.[name]));

function scaleChart(chosen) {
  const { stratum, score } = chosen, step = stepAt(chosen), recording = recordingNamed(chosen.recording);
  const scales = scalesOf(score), xs = scales.map(scaleOfOutput);
  const at = (row, { name }) => {
    const { value, low, high } = row.strata[stratum][score][name] ?? {};
    return { value: value?.[step] ?? null, low: low?.[step] ?? null, high: high?.[step] ?? null };
  };
  const rows = recording.rows.filter((row) => isShown(row.label) && row.strata[stratum]?.[score]).toReversed();
  const text = (scale) => (recording.cell_m ? `${scale} (${Number((scale * recording.cell_m).toPrecision(2))} m)` : String(scale));
  return {
    lines: rows.map((row) => lineThrough(row, xs, scales.map((output) => at(row, output)))),
    x: { name: "side in cells", ticks: xs.map((scale) => [scale, text(scale)]), words: (scale) => `${text(scale)} cells` },
    y: { name: scaledScores.find(({ name }) => name === score).title, fromZero: true },
  };
}

function startScale() {
  const { stratum, ahead_s } = pageData.headline;
  const scaledStrata = (recording) => strataOf(recording, (name) => scaledOf(recording, name).length);
  startFigureOfRecording({
    id: "scale",
    title: "Scale",
    has: (recording) => scaledStrata(recording).length,
    chosen: () => ({ stratum, score: scaledScores[0].name, ahead_s }),
    choices: (now, recording) => [["stratum", "Cells", scaledStrata(recording)],
      ["score", "Score", scaledOf(recording, now.stratum).map(({ name, title }) => [name, title])], aheadChoice(now)],
    chart: scaleChart,
    line: (now) => `${scaleChart(now).y.name} over the side of a neighbourhood${bandWords(scaleChart(now))}.`,
  });
}

const HIDDEN = /^occluded (?:to|over|[\d.]+-)/;
const agesOf = (recording) => strataOf(recording, (name) => HIDDEN.test(name)).map(([name]) => name);

function hiddenChart(chosen) {
  const { recording, score } = chosen, step = stepAt(chosen);
  const ages = agesOf(recordingNamed(recording)), xs = ages.map((_, i) => i);
  const lines = rowsWith(recordingNamed(recording), ages[0], score).toReversed()
    .map((row) => lineThrough(row, xs, ages.map((stratum) => pointOf(row, stratum, score, step))));
  const text = (i) => ages[i].replace("occluded ", "");
  return {
    lines,
    x: {
      name: "time since the cell was last seen", range: [0, Math.max(ages.length - 1, 1)],
      ticks: xs.map((i) => [i, text(i)]), words: (i) => `unseen for ${text(i)}`, written: text,
    },
    y: axisOf(score),
  };
}

function startHiddenTime() {
  const { score, ahead_s } = pageData.headline;
  startFigureOfRecording({
    id: "hidden-time",
    title: "Hidden cells",
    has: (recording) => agesOf(recording).length > 1,
    chosen: () => ({ score, ahead_s }),
    choices: (now, recording) => [["score", "Score", scoresOf(recording, agesOf(recording)[0])], aheadChoice(now)],
    chart: hiddenChart,
    line: (now) => `${scoreWords(outputNamed(now.score))} of cells that no beam reached, by the time since then${bandWords(hiddenChart(now))}.`,
  });
}

const kindsOf = (recording) => [...new Set(recording.rows.flatMap((row) => Object.keys(row.conditions)))];
const rowsUnder = ({ recording, kind }) =>
  recordingNamed(recording).rows.filter((row) => isShown(row.label) && row.conditions[kind]).toReversed();

function conditionChart(chosen) {
  const { kind, score, stratum } = chosen;
  const { name, unit } = pageData.conditions[kind];
  const axis = unit ? `${name},${unit}` : name;
  const lines = rowsUnder(chosen).map((row) => {
    const { values: xs, scores, notes } = row.conditions[kind];
    return lineOf(row, { xs, values: scores[score]?.[stratum] ?? xs.map(() => null), notes });
  });
  const places = [...new Set(lines.flatMap((one) => one.xs))].sort((a, b) => a - b);
  const isUntimed = (value) => kind === "rate" && value === 0;
  const number = (value) => (kind === "rate" ? `×${value}` : Number(value.toPrecision(3)));
  const text = (value) => (isUntimed(value) ? "untimed" : `${number(value)}${unit}`);
  return {
    lines,
    x: {
      name: axis, ticks: places.map((place) => [place, text(place)]), words: (place) => `${name} ${text(place)}`,
      written: (value) => (isUntimed(value) ? text(value) : value),
    },
    y: axisOf(score),
  };
}

const scoresUnder = (recording, kind) => [...new Set(recording.rows.flatMap((row) => Object.keys(row.conditions[kind]?.scores ?? {})))]
  .filter(outputNamed);
const strataUnder = (recording, kind, score) =>
  [...new Set(recording.rows.flatMap((row) => Object.keys(row.conditions[kind]?.scores[score] ?? {})))];

function startConditions() {
  startFigureOfRecording({
    id: "conditions",
    title: "Deadline and degraded input",
    has: (recording) => kindsOf(recording).length,
    chosen: (recording) => {
      const [kind] = kindsOf(recording), scores = scoresUnder(recording, kind), { score, stratum } = pageData.headline;
      return { kind, score: scores.includes(score) ? score : scores[0], stratum };
    },
    choices: (now, own) => [["kind", "Condition", kindsOf(own).map((one) => [one, pageData.conditions[one].name])],
      ["score", "Score", scoresUnder(own, now.kind).map((one) => [one, outputNamed(one).heading])],
      stratumChoice(own, now.score, (name) => strataUnder(own, now.kind, now.score).includes(name))],
    chart: conditionChart,
    fixed: (now) => ({ "horizon, s": recordingNamed(now.recording).conditions_ahead_s }),
    line: ({ recording: name, kind, score }) =>
      `${scoreWords(outputNamed(score))} ${inSeconds(recordingNamed(name).conditions_ahead_s)} ahead; ${pageData.conditions[kind].name}: ${pageData.conditions[kind].meaning}.`,
  });
}

// Scores of classes over the number of labelled scans in the training of a row's weights.
const ofClasses = ({ score, better }) => score.compared_with === "classes" && better !== "";
const budgetsOf = (rows) => [...new Set(rows.map((row) => row.label_budget.scans))].sort((a, b) => a - b);
const labelledRows = (recording, stratum, score) =>
  recording.rows.filter((row) => row.label_budget && isDefined(row, stratum, score));
const labelScores = (recording, stratum) =>
  scoresOf(recording, stratum, (output) => ofClasses(output) && budgetsOf(labelledRows(recording, stratum, output.key)).length > 1);
const labelStrata = (recording) => strataOf(recording, (name) => labelScores(recording, name).length);

function shownLabelled(chosen) {
  const { stratum, score } = chosen, step = stepAt(chosen, allSteps(chosen));
  return labelledRows(recordingNamed(chosen.recording), stratum, score)
    .map((row) => ({ row, point: pointOf(row, stratum, score, step) }))
    .filter(({ row, point }) => isShown(row.label) && point.value !== null);
}

// A line for each method: the mean of the rows with an equal number of scans, and the interval of a single row.
function budgetLine(method, shown) {
  const budgets = budgetsOf(shown.map(({ row }) => row));
  const at = budgets.map((scans) => shown.filter(({ row }) => row.label_budget.scans === scans));
  const end = (name) => at.map((own) => (own.length === 1 ? own[0].point[name] : null));
  return {
    name: method,
    style: shown[0].row.style,
    xs: budgets.map(Math.log2),
    values: at.map((own) => own.reduce((sum, { point }) => sum + point.value, 0) / own.length),
    low: end("low"),
    high: end("high"),
    dotStyles: at.map((own) => own[0].row.style),
    notes: at.map((own) => (own.length === 1 ? own[0].row.name : `mean of ${own.length} rows`)),
  };
}

function budgetChart(chosen) {
  const shown = shownLabelled(chosen), methods = [...new Set(shown.map(({ row }) => row.label_budget.method))];
  const words = (place) => `${Math.round(2 ** place)} labelled scans`;
  const budgets = budgetsOf(shown.map(({ row }) => row));
  return {
    lines: methods.map((method) => budgetLine(method, shown.filter(({ row }) => row.label_budget.method === method))).toReversed(),
    x: { name: "labelled scans", ticks: budgets.map((scans) => [Math.log2(scans), String(scans)]), words },
    y: axisOf(chosen.score),
  };
}

function budgetNumbers(chosen) {
  return [["tracker", "method", "labelled scans", chosen.score, "low", "high"], ...shownLabelled(chosen)
    .map(({ row, point }) => [row.name, row.label_budget.method, row.label_budget.scans, point.value, point.low, point.high])];
}

function startLabelBudget() {
  startFigureOfRecording({
    id: "label-budget",
    title: "Label budget",
    has: (recording) => labelStrata(recording).length,
    chosen: (recording) => {
      const [[stratum]] = labelStrata(recording);
      return { stratum, score: labelScores(recording, stratum)[0][0], ahead_s: pageData.headline.ahead_s };
    },
    choices: (now, recording) => [["stratum", "Cells", labelStrata(recording)],
      ["score", "Score", labelScores(recording, now.stratum)], aheadChoice(now, allSteps(now))],
    chart: budgetChart,
    numbers: budgetNumbers,
    line: (now) => `${scoreWords(outputNamed(now.score))} over labelled scans${bandWords(budgetChart(now))}.`,
  });
}

export const lineFigures = { startHorizon, startScale, startHiddenTime, startConditions, startLabelBudget };
