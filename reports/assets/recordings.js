// One score on every recording: its distribution, in which each dot is a recording, and a table of recordings and trackers.
import { axisName, axisRange, draw, inDigits, make, rowName, svgText, swatch } from "./drawing.js";
import { chooseRecording, startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { rowPlot } from "./row_plot.js";
import { aheadChoice, hasScores, outputNamed, pointsIn, rowsWith, scoresOf, scoreWords, stratumChoice } from "./scores.js";

const DOT_ROW = 34, MEDIAN_ROOM = 64, MANY_DOTS = 100, NEAR_DOT = 16;
const single = pageData.recordings.filter((one) => !one.pooled && hasScores(one));
const pooledOnes = pageData.recordings.filter((one) => one.pooled);
const allRows = { rows: single.flatMap((recording) => recording.rows) };

// For each recording its name, and by tracker the row with its point.
function pointsOn(recordings, chosen) {
  return recordings.map((recording) => {
    const at = pointsIn({ ...chosen, recording: recording.name });
    const scored = rowsWith(recording, chosen.stratum, chosen.score);
    return { name: recording.name, points: new Map(scored.map((row) => [row.label, { row, ...at(row) }])) };
  });
}

const valueIn = ({ points }, label) => points.get(label)?.value ?? null;
const isLower = (chosen) => outputNamed(chosen.score).better === "lower";

function medianOf(values) {
  const sorted = values.toSorted((a, b) => a - b), half = sorted.length / 2;
  return Number.isInteger(half) ? (sorted[half - 1] + sorted[half]) / 2 : sorted[Math.floor(half)];
}

// The trackers with a value on any recording, and their median over recordings, the best one first.
function trackersOn(scored, chosen) {
  const sign = isLower(chosen) ? 1 : -1;
  return pageData.trackers.flatMap((tracker) => {
    const values = scored.map((one) => valueIn(one, tracker.label)).filter((value) => value !== null);
    return values.length ? [{ ...tracker, median: medianOf(values) }] : [];
  }).sort((a, b) => sign * (a.median - b.median));
}

function drawRecordings(chosen, width) {
  const scored = pointsOn(single, chosen), trackers = trackersOn(scored, chosen);
  return make("div", {}, distribution(scored, trackers, chosen, width), scoreMatrix(scored, trackers, chosen));
}

function distribution(scored, trackers, { score }, width) {
  const { heading, decimals } = outputNamed(score);
  const values = scored.flatMap((one) => trackers.map(({ label }) => valueIn(one, label)));
  const range = axisRange(values, false);
  const { svg, x, places, end } = rowPlot({
    names: trackers.map(({ name }) => name), least: DOT_ROW, range, axis: axisName(heading, range), room: MEDIAN_ROOM, beside: "median", width,
    words: trackers.map(({ name, median }) => `${name}: median ${inDigits(median, decimals)}`).join(", "),
  });
  const joined = scored.map((one) => draw("path", { class: "pairs", d: pathOver(trackers, places, one, x) }));
  const radius = scored.length > MANY_DOTS ? 2 : 4;
  const rows = trackers.map((tracker, i) => drawnTracker(tracker, scored, { x, place: places[i], end, decimals, radius }));
  svg.append(...joined, ...rows);
  const dots = scored.flatMap((one, recording) => trackers.flatMap(({ label }, i) => {
    const value = valueIn(one, label);
    return value === null ? [] : [{ recording, x: x(value), y: places[i].y }];
  }));
  return withRecordingReading(svg, { scored, trackers, joined, dots, decimals, width });
}

// From tracker to tracker through the values on one recording, with gaps where it has none.
function pathOver(trackers, places, one, x) {
  const values = trackers.map(({ label }) => valueIn(one, label));
  return values.map((value, i) => (value === null ? "" : `${i && values[i - 1] !== null ? "L" : "M"}${x(value)} ${places[i].y}`)).join("");
}

function drawnTracker({ label, name, style, median }, scored, { x, place, end, decimals, radius }) {
  const dots = scored.filter((one) => valueIn(one, label) !== null).map((one) => {
    const faint = one.points.get(label).row.group === "unranked";
    return draw("circle", { class: faint ? "dot partial" : "dot", cx: x(valueIn(one, label)), cy: place.y, r: radius });
  });
  return draw("g", { class: `line ${style}` }, draw("title", {}, name), rowName(place), ...dots,
    draw("line", { class: "whisker", x1: x(median), x2: x(median), y1: place.y - 11, y2: place.y + 11 }),
    svgText(end + MEDIAN_ROOM, place.y + 4, inDigits(median, decimals), { "text-anchor": "end" }));
}

// Pointer and arrow keys read the values on one recording, which stay; a click on a dot or the Enter key chooses it.
function withRecordingReading(svg, { scored, trackers, joined, dots, decimals, width }) {
  const readout = make("output", { class: "readout" });
  let at = null;
  const show = (recording) => {
    if (at !== null) joined[at].classList.remove("read");
    at = recording;
    joined[at].classList.add("read");
    const values = trackers.filter(({ label }) => valueIn(scored[at], label) !== null)
      .map(({ label, name, style }) => make("span", {}, swatch(style), `${name} ${inDigits(valueIn(scored[at], label), decimals)}`));
    readout.replaceChildren(make("b", {}, scored[at].name), ...values);
  };
  const choose = () => at !== null && chooseRecording(scored[at].name);
  const readAt = (event) => {
    const box = svg.getBoundingClientRect(), scale = width / box.width;
    const away = dots.map((dot) => Math.hypot(dot.x - scale * (event.clientX - box.left), dot.y - scale * (event.clientY - box.top)));
    const nearestDot = away.reduce((best, one, i) => (one < away[best] ? i : best), 0);
    show(dots[nearestDot].recording);
    return away[nearestDot];
  };
  svg.addEventListener("pointermove", readAt);
  svg.addEventListener("click", (event) => readAt(event) < NEAR_DOT && choose());
  const holder = make("div", { class: "spread-of-recordings", tabindex: 0, role: "group", "aria-label": "Recordings: arrow keys move, Enter chooses" }, svg, readout);
  holder.addEventListener("keydown", (event) => {
    if (event.key === "Enter") return choose();
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(at === null ? (step > 0 ? 0 : scored.length - 1) : Math.min(Math.max(at + step, 0), scored.length - 1));
  });
  return holder;
}

// The table: a row for each recording, below the pooled scores, and a column for each tracker; sorted as chosen.
function scoreMatrix(scored, trackers, chosen) {
  const lineOfRecording = matrixLine(scored, trackers, chosen);
  const lines = new Map(scored.map((one) => [one, lineOfRecording(one)]));
  const together = pointsOn(pooledOnes, chosen).filter(({ points }) => points.size).map(lineOfRecording), body = make("tbody");
  const heads = [null, ...trackers].map((tracker) => make("th", { scope: "col", class: tracker ? null : "name" },
    make("button", { type: "button" }, ...(tracker ? [swatch(tracker.style), make("span", { class: "label" }, tracker.name)] : ["recording"]))));
  const sort = () => {
    const { by, descending } = chosen.sorted;
    const worst = descending ? -Infinity : Infinity, value = (one) => valueIn(one, by) ?? worst;
    const order = by === null ? scored : scored.toSorted((a, b) => (descending ? value(b) - value(a) : value(a) - value(b)));
    body.append(...order.map((one) => lines.get(one)));
    trackers.forEach(({ label }, i) => heads[i + 1].setAttribute("aria-sort", label !== by ? "none" : descending ? "descending" : "ascending"));
  };
  heads.forEach((head, i) => head.querySelector("button").addEventListener("click", () => {
    const by = trackers[i - 1]?.label ?? null, again = by !== null && by === chosen.sorted.by;
    chosen.sorted = { by, descending: by !== null && !(again && chosen.sorted.descending) };
    sort();
  }));
  sort();
  return make("div", { class: "scroll matrix", tabindex: 0, role: "region", "aria-label": "Recordings and trackers" },
    make("table", {}, make("thead", {}, make("tr", {}, ...heads)), make("tbody", { class: "together" }, ...together), body));
}

function recordingButton(name) {
  const button = make("button", { type: "button", class: "recording" }, make("span", { class: "label" }, name));
  button.addEventListener("click", () => chooseRecording(name));
  return button;
}

// A function that makes the line of a recording. The stronger its shade, the better a value; the best of a line is bold.
function matrixLine(scored, trackers, chosen) {
  const { decimals } = outputNamed(chosen.score), sign = isLower(chosen) ? -1 : 1;
  const isShaded = ({ row, value }) => value !== null && row.group !== "ceiling" && row.group !== "unranked";
  const known = scored.flatMap(({ points }) => [...points.values()].filter(isShaded).map(({ value }) => value));
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const share = (value) => Math.min(Math.max((sign > 0 ? value - low : high - value) / (high - low || 1), 0), 1);
  return (one) => {
    const ranked = [...one.points.values()].filter(isShaded);
    const best = inDigits(sign * Math.max(...ranked.map(({ value }) => sign * value)), decimals);
    return make("tr", {}, make("th", { scope: "row", class: "name" }, recordingButton(one.name)), ...trackers.map(({ label }) => {
      const point = one.points.get(label) ?? { row: {}, value: null }, text = inDigits(point.value, decimals);
      if (!isShaded(point)) return make("td", {}, point.row.group === "unranked" ? `(${text})` : text);
      const cell = make("td", {}, text === best ? make("b", {}, text) : text);
      cell.style.setProperty("--share", share(point.value).toFixed(3));
      return cell;
    }));
  };
}

function recordingNumbers(chosen) {
  const lines = pointsOn(single, chosen).flatMap(({ name, points }) => [...points.values()]
    .map(({ row, value, low, high }) => [name, row.name, row.group, value, low, high]));
  return [["recording", "tracker", "group", chosen.score, "low", "high"], ...lines];
}

// The number of recordings, and of all if some do not fit on the page.
function countWords() {
  const { left_out: others } = pageData;
  return others ? `${single.length} of ${single.length + others} recordings, those that differ most` : `${single.length} recordings`;
}

// Fills the section of recordings.
export function startRecordings() {
  if (single.length < 2) return;
  const recording = pageData.recordings[0].name;
  startFigure({
    id: "recordings",
    title: "Recordings",
    chosen: { recording, ...pageData.headline, sorted: { by: null, descending: false } },
    choices: (now) => [stratumChoice(allRows, now.score, (name) => scoresOf(allRows, name).length),
      ["score", "Score", scoresOf(allRows, now.stratum)], aheadChoice(now)],
    drawing: drawRecordings,
    numbers: recordingNumbers,
    line: (now) => `${scoreWords(outputNamed(now.score))} on ${countWords()}.`,
  });
}
