// The ranking on a chosen score: a dot and its interval for each row, bars over rows that do not differ significantly, and
// the difference of each row from a chosen reference.
import { axisName, axisRange, draw, inDigits, rowName, svgText } from "./drawing.js";
import { pageData } from "./page_data.js";
import { rowPlot } from "./row_plot.js";
import {
  aheadChoice, anyHasScores, outputNamed, pointsIn, recordingNamed, rowsWith, scoresOf, scoreWords, startFigureOfRecording, stepAt,
  stratumChoice,
} from "./scores.js";

const LINE = 26, VALUE_ROOM = 72, TIER_ROOM = 12, LESS_ROOM = 64, BESIDE_ROOM = 72, NO_REFERENCE = "";
const MARKS = { better: "▲", worse: "▼", "no evidence of a difference": "" };

const ranks = ({ better }) => better !== "";

function rankedRows(chosen) {
  const { recording, score, stratum } = chosen;
  const { better } = outputNamed(score), at = pointsIn(chosen), value = (row) => at(row).value;
  const order = (row) => (row.group === "ceiling" ? 0 : row.group === "unranked" ? 2 : 1);
  return rowsWith(recordingNamed(recording), stratum, score)
    .filter((row) => value(row) !== null)
    .sort((a, b) => order(a) - order(b) || (better === "lower" ? value(a) - value(b) : value(b) - value(a)));
}

const testsOf = (chosen) =>
  recordingNamed(chosen.recording).groups[`${outputNamed(chosen.score).full}/${chosen.stratum}/${stepAt(chosen)}`] ?? null;

// A function of a row: its difference from the reference { less, verdict }; null without a reference, and of itself.
function differences(chosen) {
  const rows = rankedRows(chosen), at = pointsIn(chosen), tests = testsOf(chosen);
  const reference = rows.find(({ label }) => label === chosen.reference);
  const sign = outputNamed(chosen.score).better === "lower" ? -1 : 1;
  return (row) => {
    if (!reference || row === reference) return null;
    const less = at(row).value - at(reference).value;
    const differs = tests ? differInTest(tests, row.label, reference.label) : differByIntervals(at(row), at(reference));
    const verdict = differs ? (sign * less > 0 ? "better" : "worse") : "no evidence of a difference";
    return { less, verdict };
  };
}

// Rows of one run: two tested rows differ exactly if no group has both.
function differInTest({ tested, groups }, one, other) {
  return tested.includes(one) && tested.includes(other) && !groups.some((own) => own.includes(one) && own.includes(other));
}

// Rows of several runs are in no paired test: from the distances of their intervals (Zou and Donner, 2008), which is
// cautious for runs on the same frames.
function differByIntervals(one, other) {
  const [high, low] = one.value > other.value ? [one, other] : [other, one];
  if (high.low === null || low.high === null) return false;
  return high.value - low.value > Math.hypot(high.value - high.low, low.high - low.value);
}

// The output that stands beside the leading one of its score; null if the score has none, or another output is chosen.
function besideOf(chosen) {
  const { key, score } = outputNamed(chosen.score), found = key === score.name && score.outputs.find(({ beside }) => beside);
  return found ? outputNamed(`${score.name}.${found.name}`) : null;
}

// "Needless stops, 1/min" of the title "Needless stops, 80 % foreseen".
const shortHeading = ({ title, unit }) => [title.split(",")[0], unit].filter(Boolean).join(", ");

function drawRanking(chosen, width) {
  const rows = rankedRows(chosen), at = pointsIn(chosen), output = outputNamed(chosen.score), lessThan = differences(chosen);
  const groups = (testsOf(chosen)?.groups ?? [])
    .map((labels) => rows.flatMap((row, i) => (row.group !== "unranked" && labels.includes(row.label) ? [i] : [])))
    .filter((members) => members.length > 1);
  const range = axisRange(rows.flatMap((row) => Object.values(at(row))), false);
  const hasReference = rows.some((row) => lessThan(row)), scale = output.saying ? 100 : 1;
  const beside = besideOf(chosen), isBeside = beside && !hasReference; // the difference takes its place
  const numberBeside = (row) => (beside ? inDigits(at(row, beside.key).value, beside.decimals) : "");
  const wordsBeside = (row) => (beside ? `${beside.heading}: ${numberBeside(row)}` : "");
  const { svg, x, places, end } = rowPlot({
    names: rows.map((row) => row.name), least: LINE, range, width,
    axis: axisName(output.saying ? `${output.heading}, of 100` : output.heading, range.map((end) => scale * end)),
    tickText: (value) => String(Number((scale * value).toPrecision(6))),
    room: VALUE_ROOM + TIER_ROOM * groups.length + (hasReference ? LESS_ROOM : isBeside ? BESIDE_ROOM : 0),
    beside: hasReference ? "difference" : isBeside ? shortHeading(beside) : "",
    words: rows.map((row) => `${row.name} ${[inWords(at(row).value, output), differenceWords(lessThan(row), output), wordsBeside(row)].filter(Boolean).join(", ")}`).join(", "),
  });
  svg.classList.add("ranking");
  rows.forEach((row, i) => svg.append(drawRow(row, at(row), x, places[i], end, output, wordsBeside(row))));
  if (isBeside) rows.forEach((row, i) => svg.append(svgText(width, places[i].y + 4, numberBeside(row), { class: "beside", "text-anchor": "end" })));
  rows.forEach((row, i) => svg.append(...drawnDifference(lessThan(row), places[i], width, output)));
  groups.forEach((members, g) => {
    const bar = end + VALUE_ROOM + TIER_ROOM * g;
    const [first, last] = [places[members[0]], places[members.at(-1)]];
    svg.append(draw("line", { class: "tier", x1: bar, x2: bar, y1: first.y - 6, y2: last.y + 6 }),
      ...members.map((i) => draw("circle", { class: "tier", cx: bar, cy: places[i].y, r: 3 })));
  });
  return svg;
}

// A value; of 100, if the score has a saying.
function inWords(value, { saying, decimals }) {
  return saying ? `${Math.round(100 * value)} of 100` : inDigits(value, decimals);
}

function signed(less, { saying, decimals }) {
  return `${less < 0 ? "−" : "+"}${saying ? Math.round(100 * Math.abs(less)) : inDigits(Math.abs(less), decimals)}`;
}

const differenceWords = (found, output) => (found ? `${signed(found.less, output)} ${found.verdict}` : "");

function drawnDifference(found, { y }, width, output) {
  if (!found) return [];
  const text = svgText(width, y + 4, `${signed(found.less, output)} ${MARKS[found.verdict] || "\u2007"}`, { class: `difference ${found.verdict}`, "text-anchor": "end" });
  text.append(draw("title", {}, found.verdict));
  return [text];
}

function drawRow(row, { value, low, high }, x, place, end, output, alsoSaid) {
  const { y } = place;
  const faint = row.group === "unranked" ? " partial" : "";
  const parts = [rowName(place, { class: row.group === "ranked" ? "" : "tick" }),
    draw("circle", { class: "dot", cx: x(value), cy: y, r: 4.5 }),
    svgText(end + 60, y + 4, inWords(value, output), { "text-anchor": "end" })];
  if (low !== null && high !== null) {
    parts.push(draw("line", { class: "whisker", x1: x(low), x2: x(high), y1: y, y2: y }));
  }
  const words = [row.name, row.remark, row.group === "unranked" ? "not ranked" : "", alsoSaid].filter(Boolean).join(", ");
  return draw("g", { class: `line ${row.style}${faint}` }, draw("title", {}, words), ...parts);
}

function caption(chosen) {
  const tests = testsOf(chosen), at = pointsIn(chosen), hasIntervals = rankedRows(chosen).some((row) => at(row).low !== null);
  const beside = besideOf(chosen), right = beside && chosen.reference === NO_REFERENCE ? `. On the right: ${scoreWords(beside)}` : "";
  const own = `${scoreWords(outputNamed(chosen.score))}${hasIntervals ? ", with 95 % intervals" : ""}${right}`;
  const marks = chosen.reference === NO_REFERENCE ? "" : ` ▲ better, ▼ worse${tests ? "" : " by intervals"}.`;
  if (!tests) return `${own}. Not tested: ${recordingNamed(chosen.recording).untested}.${marks}`;
  return `${own}. A bar joins rows that do not differ significantly: p < 0.05 over ${tests.units} units, corrected for ${tests.pairs} pairs.${marks} ${manyRankings(chosen)}`;
}

// A warning about comparing many rankings.
function manyRankings({ recording }) {
  const { groups, false_difference: rate } = recordingNamed(recording);
  const count = Object.keys(groups).length;
  return count > 1 && rate !== null ? `Of the ${count} rankings to choose from, at least one would separate equal trackers in ${Math.round(100 * rate)} % of runs.` : "";
}

function rankingNumbers(chosen) {
  const rows = rankedRows(chosen), at = pointsIn(chosen), lessThan = differences(chosen);
  const groups = testsOf(chosen)?.groups ?? [];
  const beside = besideOf(chosen), also = (row) => (beside ? [at(row, beside.key).value] : []);
  const letters = (row) => groups.map((labels, i) => (labels.includes(row.label) ? String(i + 1) : "")).filter(Boolean).join(" ");
  return [["tracker", "group", chosen.score, "low", "high", "no significant difference", "difference", "verdict", ...(beside ? [beside.key] : [])],
    ...rows.map((row) => [row.name, row.group, at(row).value, at(row).low, at(row).high, letters(row), lessThan(row)?.less ?? null,
      lessThan(row)?.verdict ?? "", ...also(row)])];
}

// Fills the section of the ranking.
export function startRanking() {
  startFigureOfRecording({
    id: "ranking",
    aside: true,
    has: anyHasScores,
    chosen: () => pageData.headline,
    choices: (now, recording) => [stratumChoice(recording, now.score, (name) => scoresOf(recording, name, ranks).length),
      ["score", "Score", scoresOf(recording, now.stratum, ranks)], aheadChoice(now),
      ["reference", "Reference", [[NO_REFERENCE, "none"], ...rankedRows(now).map(({ label, name }) => [label, name])]]],
    drawing: drawRanking,
    numbers: rankingNumbers,
    line: caption,
  });
}
