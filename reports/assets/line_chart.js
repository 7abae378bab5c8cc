// Lines over one axis, with bands, and the values at the pointer or, by arrow keys, at any place.
import { axisRange, inDigits, roundTicks, scaleOf, svgText } from "./axis.js";
import { draw, make } from "./elements.js";

const HEIGHT = 380, LEFT = 44, BOTTOM = 30, TOP = 10;

// `xs`: places; `lines`: [{name, style, values, low, high}]; `words(i)`: place i in words; `unranked`: places before the first that counts.
export function lineChart({ xs, lines, unit, words, unranked, fromZero, width }) {
  const x = scaleOf(xs[0], xs.at(-1), LEFT, width - 14);
  const range = axisRange(lines.flatMap((one) => [...one.values, ...(one.low ?? []), ...(one.high ?? [])]), fromZero);
  const y = scaleOf(...range, HEIGHT - BOTTOM, TOP);
  const svg = draw("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, role: "img" });
  svg.setAttribute("aria-label", lines.map((one) => `${one.name} ${inDigits(one.values.at(-1))}`).join(", "));
  for (const tick of roundTicks(...range, 6)) {
    svg.append(draw("line", { class: "grid", x1: LEFT, x2: width - 14, y1: y(tick), y2: y(tick) }),
      svgText(LEFT - 8, y(tick) + 4, String(tick), { class: "tick", "text-anchor": "end" }));
  }
  for (const tick of roundTicks(xs[0], xs.at(-1), width < 500 ? 4 : 8)) {
    svg.append(svgText(x(tick), HEIGHT - 8, `${tick}${unit}`, { class: "tick", "text-anchor": "middle" }));
  }
  if (unranked) svg.append(draw("rect", { class: "unranked-step", x: LEFT, y: TOP, width: x(xs[1]) - LEFT, height: HEIGHT - BOTTOM - TOP }));
  for (const one of lines) svg.append(drawnLine(one, xs, x, y));
  return withReading(svg, { xs, lines, words, x, y, width });
}

function drawnLine({ style, name, values, low, high }, xs, x, y) {
  const group = draw("g", { class: `line ${style}` }, draw("title", {}, name));
  for (const piece of piecesOf(values)) {
    const band = low && high ? piece.filter((i) => low[i] !== null && high[i] !== null) : [];
    if (band.length > 1) {
      const outline = [...band.map((i) => [i, high[i]]), ...band.reverse().map((i) => [i, low[i]])];
      group.append(draw("polygon", { class: "band", points: outline.map(([i, v]) => `${x(xs[i])},${y(v)}`).join(" ") }));
    }
    group.append(draw("polyline", { points: piece.map((i) => `${x(xs[i])},${y(values[i])}`).join(" ") }));
    if (piece.length === 1) group.append(draw("circle", { class: "dot", cx: x(xs[piece[0]]), cy: y(values[piece[0]]), r: 2.5 }));
  }
  return group;
}

// The indices of a curve between its undefined values.
function piecesOf(values) {
  const pieces = [[]];
  values.forEach((value, i) => (value === null ? pieces.push([]) : pieces.at(-1).push(i)));
  return pieces.filter((piece) => piece.length);
}

function withReading(svg, chart) {
  const marks = draw("g", { class: "reading" });
  svg.append(marks);
  const readout = make("output", { class: "readout" });
  const holder = make("div", { class: "chart", tabindex: 0, role: "group", "aria-label": "Values: arrow keys move" }, svg, readout);
  let at = null;
  const show = (i) => {
    at = i;
    marks.replaceChildren();
    readout.hidden = i === null;
    if (i !== null) fillReading(marks, readout, chart, i);
  };
  show(null);
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const place = ((event.clientX - box.left) / box.width) * chart.width;
    show(nearest(chart.xs.map(chart.x), place));
  });
  svg.addEventListener("pointerleave", () => show(null));
  holder.addEventListener("blur", () => show(null));
  holder.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(at === null ? (step > 0 ? 0 : chart.xs.length - 1) : Math.min(Math.max(at + step, 0), chart.xs.length - 1));
  });
  return holder;
}

function nearest(places, place) {
  return places.reduce((best, p, i) => (Math.abs(p - place) < Math.abs(places[best] - place) ? i : best), 0);
}

function fillReading(marks, readout, { xs, lines, words, x, y }, i) {
  const at = x(xs[i]);
  marks.append(draw("line", { x1: at, x2: at, y1: TOP, y2: HEIGHT - BOTTOM }));
  const read = lines.filter((one) => one.values[i] !== null).sort((a, b) => b.values[i] - a.values[i]);
  for (const one of read) marks.append(draw("g", { class: one.style }, draw("circle", { cx: at, cy: y(one.values[i]), r: 3.5 })));
  const rows = read.map((one) => make("span", { class: one.style }, make("i"), `${one.name} ${inDigits(one.values[i])}`
    + (one.low?.[i] != null && one.high?.[i] != null ? ` [${inDigits(one.low[i])}, ${inDigits(one.high[i])}]` : "")));
  readout.replaceChildren(make("b", {}, words(i)), ...rows);
}
