// A score over the time of a tracker: each point is a row, beside one frame period.
import { axisName, axisRange, draw, heightOf, inDigits, namedRows, roundTicks, rowName, scaleOf, svgText } from "./drawing.js";
import { pageData } from "./page_data.js";
import { aheadChoice, outputNamed, pointsIn, recordingNamed, rowsWith, scoresOf, scoreWords, startFigureOfRecording, strataOf, stratumChoice } from "./scores.js";

const LEAST_HIGH = 360, LEFT_ROOM = 44, TOP_ROOM = 24, BOTTOM_ROOM = 46, LABEL_ROW = 18, LEAST_TIME_MS = 0.01;
const TIME = "99th percentile of update and forecast, ms";

// The recordings whose times count for one of the page: all of them for the pooled one, which has no times.
const timedOn = (recording) => (recording.pooled ? pageData.recordings.filter((one) => !one.pooled) : [recording]);
const periodOf = (recording) => Math.min(...timedOn(recording).map((one) => one.period_ms));

// The 99th percentiles of update and forecast together, on the slowest recording; null without a time.
function timeOf({ label }, recording) {
  const times = timedOn(recording).flatMap(({ rows }) => rows.filter((row) => row.label === label && row.latency))
    .map(({ latency }) => latency.update[2] + latency.predict[2]);
  return times.length ? Math.max(...times) : null;
}

const timedRows = (recording) => ({ rows: recording.rows.filter((row) => timeOf(row, recording) !== null) });

function timedPoints(chosen) {
  const at = pointsIn(chosen), recording = recordingNamed(chosen.recording);
  return rowsWith(timedRows(recording), chosen.stratum, chosen.score)
    .map((row) => ({ row, ms: timeOf(row, recording), point: at(row) })).filter(({ point }) => point.value !== null);
}

function drawScoreAndTime(chosen, width) {
  const timed = timedPoints(chosen), { heading, decimals } = outputNamed(chosen.score);
  const period = periodOf(recordingNamed(chosen.recording)), narrow = width < 560;
  const end = width - (narrow ? 124 : 210);
  const labels = namedRows(timed.map(({ row }) => row.name), width - end - 24, LABEL_ROW);
  const height = Math.max(LEAST_HIGH, heightOf(labels) + TOP_ROOM + BOTTOM_ROOM), bottom = height - BOTTOM_ROOM;
  const log = (ms) => Math.log10(Math.max(ms, LEAST_TIME_MS)), logs = [period, ...timed.map(({ ms }) => ms)].map(log);
  const [first, last] = [Math.floor(Math.min(...logs)), Math.ceil(Math.max(...logs) + 0.01)];
  const x = scaleOf(first, last, LEFT_ROOM, end), range = axisRange(timed.flatMap(({ point }) => Object.values(point)), false);
  const y = scaleOf(...range, bottom, TOP_ROOM);
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${width} ${height}`, width, height, role: "img" });
  svg.setAttribute("aria-label", timed.map(({ row, ms, point }) => `${row.name} ${inDigits(point.value, decimals)}, ${Number(ms.toPrecision(2))} ms`).join("; "));
  svg.append(draw("rect", { class: "unranked-step", x: x(log(period)), y: TOP_ROOM, width: end - x(log(period)), height: bottom - TOP_ROOM }));
  for (const tick of roundTicks(...range, 6)) {
    svg.append(draw("line", { class: "grid", x1: LEFT_ROOM, x2: end, y1: y(tick), y2: y(tick) }),
      svgText(LEFT_ROOM - 8, y(tick) + 4, String(tick), { class: "tick", "text-anchor": "end" }));
  }
  for (let decade = first; decade <= last; decade += 1) {
    svg.append(svgText(x(decade), bottom + 18, String(10 ** decade), { class: "tick", "text-anchor": "middle" }));
  }
  svg.append(draw("line", { class: "period", x1: x(log(period)), x2: x(log(period)), y1: TOP_ROOM, y2: bottom }),
    svgText(narrow ? width : end, height - 5, TIME, { class: "axis-name", "text-anchor": "end" }),
    svgText(0, 12, axisName(heading, range), { class: "axis-name" }));
  const spots = timed.map(({ row, ms, point }) => ({ row, point, x: x(log(ms)), y: y(point.value) }));
  const beside = spread(spots.map((spot) => spot.y), labels.map((label) => label.height), TOP_ROOM, bottom);
  spots.forEach((spot, i) => svg.append(drawnSpot(spot, { ...labels[i], y: beside[i] }, end, y)));
  return svg;
}

// A dot with its interval, and a line to its name beside the plot.
function drawnSpot({ row, point, x: across, y: at }, label, end, y) {
  const whisker = point.low === null || point.high === null ? []
    : [draw("line", { class: "whisker", x1: across, x2: across, y1: y(point.low), y2: y(point.high) })];
  const name = rowName(label, { transform: `translate(${end + 20} 0)` });
  const lead = draw("path", { class: "pairs", d: `M${across} ${at}L${end + 2} ${label.y}L${end + 16} ${label.y}` });
  return draw("g", { class: row.group === "unranked" ? `line ${row.style} partial` : `line ${row.style}` },
    draw("title", {}, row.name), lead, ...whisker, draw("circle", { class: "dot", cx: across, cy: at, r: 5 }), name);
}

// Middles of labels with these heights near the wanted ones, apart from each other, between `top` and `bottom`.
function spread(wanted, heights, top, bottom) {
  const order = wanted.map((_, i) => i).toSorted((a, b) => wanted[a] - wanted[b]), found = [...wanted];
  let limit = top;
  for (const i of order) {
    found[i] = Math.max(found[i], limit + heights[i] / 2);
    limit = found[i] + heights[i] / 2;
  }
  limit = bottom;
  for (const i of order.toReversed()) {
    found[i] = Math.min(found[i], limit - heights[i] / 2);
    limit = found[i] - heights[i] / 2;
  }
  return found;
}

function timedNumbers(chosen) {
  return [["tracker", "group", "p99, ms", chosen.score, "low", "high"],
    ...timedPoints(chosen).map(({ row, ms, point }) => [row.name, row.group, Number(ms.toPrecision(4)), point.value, point.low, point.high])];
}

// Fills the section of score and time.
export function startScoreAndTime() {
  startFigureOfRecording({
    id: "score-and-time",
    title: "Score and time",
    has: (recording) => strataOf(timedRows(recording)).length,
    chosen: () => pageData.headline,
    choices: (now, recording) => {
      const timed = timedRows(recording);
      return [stratumChoice(timed, now.score, (name) => scoresOf(timed, name).length),
        ["score", "Score", scoresOf(timed, now.stratum)], aheadChoice(now)];
    },
    drawing: drawScoreAndTime,
    numbers: timedNumbers,
    line: (now) => `${scoreWords(outputNamed(now.score))} over time; shaded: longer than a frame, ${Number(periodOf(recordingNamed(now.recording)).toPrecision(4))} ms.`,
  });
}
