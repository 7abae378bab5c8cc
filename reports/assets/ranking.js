// The ranking on a chosen score: a dot and its interval for each row, and bars that join rows that are not told apart.
import { axisRange, inDigits, roundTicks, scaleOf, svgText } from "./axis.js";
import { choiceBar } from "./choices.js";
import { downloadButtons } from "./downloads.js";
import { draw, make } from "./elements.js";
import { pageData } from "./page_data.js";
import { recordingNamed, recordingOptions, rowsWith, scoreNamed, scoresOf, scoreWords, strataOf, valueAt } from "./scores.js";
import { whenShownChange } from "./shown_trackers.js";

const LINE = 26;
const GROUPS = ["ceiling", "ranked", "floor", "unranked"];

function rankedRows({ recording, score, stratum, step }) {
  const { better } = scoreNamed(score);
  const value = (row) => valueAt(row, stratum, score, step);
  const order = (row) => (row.group === "ceiling" ? 0 : row.group === "unranked" ? 2 : 1);
  return rowsWith(recordingNamed(recording), stratum, score)
    .filter((row) => value(row) !== null)
    .sort((a, b) => order(a) - order(b) || (better < 0 ? value(a) - value(b) : value(b) - value(a)));
}

function horizonOptions(recording) {
  return recording.horizons_s.map((s, step) => [step, `${Number(s.toPrecision(3))} s`]).slice(1);
}

const tiersOf = ({ recording, score, stratum, step }) =>
  recordingNamed(recording).tiers[`${score}/${stratum}/${step}`] ?? null;

function drawRanking(chosen, width) {
  const rows = rankedRows(chosen);
  const groups = (tiersOf(chosen)?.groups ?? [])
    .map((labels) => rows.flatMap((row, i) => (row.group !== "unranked" && labels.includes(row.label) ? [i] : [])))
    .filter((at) => at.length > 1);
  const narrow = width < 560;
  const left = narrow ? 112 : 210, right = 64 + 12 * groups.length;
  const at = (row, end = "") => valueAt(row, chosen.stratum, chosen.score, chosen.step, end);
  const range = axisRange(rows.flatMap((row) => [at(row), at(row, "_low"), at(row, "_high")]), false);
  const x = scaleOf(...range, left, width - right);
  const height = LINE * rows.length + 28;
  const svg = draw("svg", { class: "ranking", viewBox: `0 0 ${width} ${height}`, width, height, role: "img" });
  svg.setAttribute("aria-label", rows.map((row) => `${row.name} ${inDigits(at(row))}`).join(", "));
  for (const tick of roundTicks(...range, narrow ? 3 : 6)) {
    svg.append(draw("line", { class: "grid", x1: x(tick), x2: x(tick), y1: 0, y2: height - 24 }),
      svgText(x(tick), height - 8, String(tick), { class: "tick", "text-anchor": "middle" }));
  }
  rows.forEach((row, i) => svg.append(drawRow(row, at, x, LINE * (i + 0.5), width - right, narrow ? 14 : 28)));
  groups.forEach((members, g) => {
    const bar = width - right + 64 + 12 * g;
    svg.append(draw("line", { class: "tier", x1: bar, x2: bar, y1: LINE * members[0] + 7, y2: LINE * (members.at(-1) + 1) - 7 }),
      ...members.map((i) => draw("circle", { class: "tier", cx: bar, cy: LINE * (i + 0.5), r: 3 })));
  });
  return svg;
}

function drawRow(row, at, x, y, end, letters) {
  const name = row.name.length > letters ? `${row.name.slice(0, letters - 1)}…` : row.name;
  const faint = row.group === "unranked" ? " partial" : "";
  const parts = [svgText(0, y + 4, name, { class: row.group === "ranked" ? "" : "tick" }),
    draw("circle", { class: "dot", cx: x(at(row)), cy: y, r: 4.5 }),
    svgText(end + 52, y + 4, inDigits(at(row)), { "text-anchor": "end" })];
  if (at(row, "_low") !== null && at(row, "_high") !== null) {
    parts.push(draw("line", { class: "whisker", x1: x(at(row, "_low")), x2: x(at(row, "_high")), y1: y, y2: y }));
  }
  const words = row.group === "unranked" ? `${row.name}: ${row.outcome}, not ranked` : row.name;
  return draw("g", { class: `line ${row.style}${faint}` }, draw("title", {}, words), ...parts);
}

function caption(chosen) {
  const tiers = tiersOf(chosen);
  const lower = scoreWords(scoreNamed(chosen.score));
  if (!tiers) return `${lower}. Not tested, so the order may be chance: ${recordingNamed(chosen.recording).untested}.`;
  return `${lower}, with 95 % intervals. A bar joins rows that are not told apart: all ${tiers.pairs} pairs tested on`
    + ` ${tiers.units} units, Holm over all of them, p < 0.05.`;
}

function numbers(chosen) {
  const rows = rankedRows(chosen);
  const at = (row, end) => valueAt(row, chosen.stratum, chosen.score, chosen.step, end);
  const groups = tiersOf(chosen)?.groups ?? [];
  const letters = (row) => groups.map((labels, i) => (labels.includes(row.label) ? String(i + 1) : "")).filter(Boolean).join(" ");
  return [["tracker", "group", chosen.score, "low", "high", "not told apart"],
    ...rows.map((row) => [row.name, row.group, at(row, ""), at(row, "_low"), at(row, "_high"), letters(row)])];
}

// Fills the section of the ranking.
export function startRanking() {
  const section = document.getElementById("ranking");
  const chosen = { recording: pageData.recordings[0].name, ...pageData.headline };
  const holder = make("div", { class: "drawn" });
  const note = make("p", { class: "note" });
  const redraw = () => {
    holder.replaceChildren(drawRanking(chosen, Math.max(holder.clientWidth, 300)));
    note.textContent = caption(chosen);
  };
  const listed = (now) => {
    const recording = recordingNamed(now.recording);
    return [["recording", "Recording", recordingOptions()], ["stratum", "Cells", strataOf(recording)],
      ["score", "Score", scoresOf(recording, now.stratum)], ["step", "Ahead", horizonOptions(recording)]];
  };
  const downloads = downloadButtons("ranking", () => holder.firstChild, () => numbers(chosen));
  const bar = choiceBar(listed, chosen, redraw);
  section.append(make("div", { class: "controls" }, bar, downloads), holder, note);
  section.hidden = !pageData.recordings.some((one) => GROUPS.some((group) => one.rows.some((row) => row.group === group && Object.keys(row.strata).length)));
  redraw();
  whenShownChange(redraw);
  new ResizeObserver(redraw).observe(section);
}
