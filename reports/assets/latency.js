// The times of updates and forecasts: distribution, median, 95th and 99th percentile, on a logarithmic axis with the
// period.
import { draw, heightOf, rowName, svgText } from "./drawing.js";
import { rowPlot } from "./row_plot.js";
import { recordingNamed, startFigureOfRecording } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const ROW = 30, TICK_ROOM = 44, LEAST_MS = 0.01, SLICE_AREA = 48, MOST_SPREAD = 22;
const CALLS = [["update", "update"], ["predict", "forecast of all steps"]];
const rowsTimed = (recording) => recording.rows.filter((row) => row.latency);
const timed = ({ recording }) => rowsTimed(recordingNamed(recording)).filter((row) => isShown(row.label));
const timedName = ({ name, latency }) => (latency.device ? `${name} · ${latency.device}` : name);
const inMs = (ms) => `${ms < LEAST_MS ? `<${LEAST_MS}` : Number(ms.toPrecision(2))}`;

function drawLatency({ recording, call }, width) {
  const rows = timed({ recording }), period = recordingNamed(recording).period_ms;
  const log = (ms) => Math.log10(Math.max(ms, LEAST_MS));
  const times = [period, ...rows.flatMap((row) => [...row.latency[call], ...row.latency.twentieths[call]])].map(log);
  const [low, high] = [Math.floor(Math.min(...times)), Math.ceil(Math.max(...times) + 0.01)];
  const { svg, x, places } = rowPlot({
    names: rows.map(timedName), least: ROW, range: [low, high], axis: `${CALLS.find(([name]) => name === call)[1]}, ms`, room: 110, width,
    words: rows.map((row) => `${timedName(row)} ${inMs(row.latency[call][0])} ms`).join(", "), ticks: (at) => decadeTicks(at, low, high),
  });
  svg.append(draw("line", { class: "period", x1: x(log(period)), x2: x(log(period)), y1: 0, y2: heightOf(places) + 4 }));
  rows.forEach((row, i) => svg.append(drawnRow(row, row.latency[call].map(log).map(x), places[i], width, row.latency[call],
    row.latency.twentieths[call].map(log).map(x))));
  return svg;
}

// Powers of ten from the highest down, as many as have room.
function decadeTicks(x, low, high) {
  const apart = Math.ceil(TICK_ROOM / (x(low + 1) - x(low))), ticks = [];
  for (let decade = high; decade >= low; decade -= apart) ticks.push([decade, `${10 ** decade}${decade === high ? " ms" : ""}`]);
  return ticks;
}

function drawnRow(row, [p50, p95, p99], place, width, [median, , most], ends) {
  const { y } = place;
  return draw("g", { class: `line ${row.style}` }, draw("title", {}, timedName(row)), rowName(place), ...slices(ends, y),
    draw("line", { class: "whisker", x1: p50, x2: p99, y1: y, y2: y }),
    draw("line", { class: "whisker", x1: p95, x2: p95, y1: y - 4, y2: y + 4 }),
    draw("line", { class: "whisker", x1: p99, x2: p99, y1: y - 7, y2: y + 7 }),
    draw("circle", { class: "dot", cx: p50, cy: y, r: 4.5 }),
    svgText(width, y + 4, `${inMs(median)} to ${inMs(most)}`, { "text-anchor": "end" }));
}

// Bars of equal area for a twentieth of the calls each: tall where calls take nearly the same time.
function slices(ends, y) {
  return ends.slice(1).map((end, i) => {
    const wide = Math.max(end - ends[i], 1), height = Math.min(MOST_SPREAD, SLICE_AREA / wide);
    return draw("rect", { class: "spread", x: ends[i], y: y - height / 2, width: wide, height });
  });
}

function latencyNumbers({ recording, call }) {
  const others = Array.from({ length: 21 }, (_, i) => i).filter((i) => ![50, 95].includes(5 * i));
  return [["tracker", "p50, ms", "p95, ms", "p99, ms", "device", "peak memory, MiB", "keeps up", ...others.map((i) => `p${5 * i}, ms`)],
    ...timed({ recording }).map(({ name, latency }) => [name, ...latency[call], latency.device || "processor", latency.peak_mib, latency.keeps_up,
      ...others.map((i) => latency.twentieths[call][i])])];
}

// Fills the section of times.
export function startLatency() {
  startFigureOfRecording({
    id: "latency",
    title: "Time",
    has: (recording) => rowsTimed(recording).length,
    chosen: () => ({ call: "update" }),
    choices: () => [["call", "Call", CALLS]],
    drawing: drawLatency,
    numbers: latencyNumbers,
    line: ({ recording }) => `Median (dot), 95th and 99th percentile, spread; the line is one frame period, ${Number(recordingNamed(recording).period_ms.toPrecision(4))} ms.`,
  });
}
