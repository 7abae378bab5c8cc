// The ranking on a chosen score: a dot and its interval for each row, and bars over rows that do not differ significantly.
import { axisName, axisRange, draw, heightOf, inDigits, namedRows, roundTicks, rowName, scaleOf, svgText } from "./drawing.js";
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import {
  aheadChoice, hasScores, outputNamed, pointsIn, recordingNamed, recordingOptions, rowsWith, scoresOf, scoreWords, stepAt, strataOf,
} from "./scores.js";

const LINE = 26;

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

function drawRanking(chosen, width) {
  const rows = rankedRows(chosen);
  const groups = (testsOf(chosen)?.groups ?? [])
    .map((labels) => rows.flatMap((row, i) => (row.group !== "unranked" && labels.includes(row.label) ? [i] : [])))
    .filter((at) => at.length > 1);
  const narrow = width < 560;
  const left = narrow ? 124 : 210, right = 72 + 12 * groups.length;
  const at = pointsIn(chosen), output = outputNamed(chosen.score);
  const range = axisRange(rows.flatMap((row) => Object.values(at(row))), false);
  const x = scaleOf(...range, left, width - right);
  const places = namedRows(rows.map((row) => row.name), left - 12, LINE);
  const height = heightOf(places) + 46, bottom = height - 42;
  const svg = draw("svg", { class: "figure-drawing ranking", viewBox: `0 0 ${width} ${height}`, width, height, role: "img" });
  svg.setAttribute("aria-label", rows.map((row) => `${row.name} ${inWords(at(row).value, output)}`).join(", "));
  for (const tick of roundTicks(...range, narrow ? 3 : 6)) {
    svg.append(draw("line", { class: "grid", x1: x(tick), x2: x(tick), y1: 0, y2: bottom }),
      svgText(x(tick), bottom + 16, String(tick), { class: "tick", "text-anchor": "middle" }));
  }
  svg.append(svgText(width - right, height - 5, axisName(output.heading, range), { class: "axis-name", "text-anchor": "end" }));
  rows.forEach((row, i) => svg.append(drawRow(row, at(row), x, places[i], width - right, output)));
  groups.forEach((members, g) => {
    const bar = width - right + 72 + 12 * g;
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

function drawRow(row, { value, low, high }, x, place, end, output) {
  const { y } = place;
  const faint = row.group === "unranked" ? " partial" : "";
  const parts = [rowName(place, { class: row.group === "ranked" ? "" : "tick" }),
    draw("circle", { class: "dot", cx: x(value), cy: y, r: 4.5 }),
    svgText(end + 60, y + 4, inWords(value, output), { "text-anchor": "end" })];
  if (low !== null && high !== null) {
    parts.push(draw("line", { class: "whisker", x1: x(low), x2: x(high), y1: y, y2: y }));
  }
  const words = [row.name, row.remark, row.group === "unranked" ? "not ranked" : ""].filter(Boolean).join(", ");
  return draw("g", { class: `line ${row.style}${faint}` }, draw("title", {}, words), ...parts);
}

function caption(chosen) {
  const tests = testsOf(chosen);
  const lower = scoreWords(outputNamed(chosen.score));
  if (!tests) return `${lower}. Not tested: ${recordingNamed(chosen.recording).untested}.`;
  return `${lower}. A bar joins rows that do not differ significantly: ${tests.pairs} pairs, ${tests.units} units, Holm, p < 0.05. ${manyRankings(chosen)}`;
}

// A warning about comparing many rankings.
function manyRankings({ recording }) {
  const { groups, false_difference: rate } = recordingNamed(recording);
  const count = Object.keys(groups).length;
  return count > 1 && rate !== null ? `Of the ${count} rankings to choose from, at least one would separate equal trackers in ${Math.round(100 * rate)} % of runs.` : "";
}

function rankingNumbers(chosen) {
  const rows = rankedRows(chosen);
  const at = pointsIn(chosen);
  const groups = testsOf(chosen)?.groups ?? [];
  const letters = (row) => groups.map((labels, i) => (labels.includes(row.label) ? String(i + 1) : "")).filter(Boolean).join(" ");
  return [["tracker", "group", chosen.score, "low", "high", "no significant difference"],
    ...rows.map((row) => [row.name, row.group, at(row).value, at(row).low, at(row).high, letters(row)])];
}

// Fills the section of the ranking.
export function startRanking() {
  if (!pageData.recordings.some(hasScores)) return;
  startFigure({
    id: "ranking",
    aside: true,
    chosen: { recording: pageData.recordings[0].name, ...pageData.headline },
    choices: (now) => {
      const recording = recordingNamed(now.recording);
      const ranked = strataOf(recording, (name) => scoresOf(recording, name, ranks).length);
      return [["recording", "Recording", recordingOptions()], ["stratum", "Cells", ranked],
        ["score", "Score", scoresOf(recording, now.stratum, ranks)], aheadChoice(now)];
    },
    drawing: drawRanking,
    numbers: rankingNumbers,
    line: caption,
  });
}
