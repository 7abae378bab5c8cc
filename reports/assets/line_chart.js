// Lines over one axis, with bands, and the values at the pointer or at a place chosen by arrow keys.
import { axisName, axisRange, draw, inDigits, make, nearest, roundTicks, scaleOf, svgText, swatch } from "./drawing.js";

const HEIGHT = 408, LEFT = 44, RIGHT = 14, BOTTOM = 46, TOP = 24;
const EDGE = 5; // room for a dot on an axis
const READING_PLACES = 51;
const MOST_BANDS = 6;

// A chart: { lines, x, y }. A line: { name, style, xs, values, low, high, dotStyles }; `low` and `high` may be null, and
// `dotStyles` are the styles of dots at its places.
// `x`: { name, unit, range, ticks, words(x), written(x), unranked }; `y`: { name, fromZero, range, digits }. `ticks`: [place,
// text] pairs; `written`: the text of a place in the file of numbers, by default the place; `unranked`: places before the
// second do not count; `diagonal`: a line where x equals y.
export function lineChart({ lines, x: across, y: up, diagonal, width }) {
  const places = placesOf(lines);
  const [first, last] = across.range ?? [places[0] ?? 0, places.at(-1) ?? 1];
  const x = scaleOf(first, last, LEFT, width - RIGHT);
  const range = rangeOf(lines, across, up);
  const y = scaleOf(...range, HEIGHT - BOTTOM, TOP);
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, role: "img" });
  svg.setAttribute("aria-label", `${up.name}: ${lines.map((one) => `${one.name} ${inDigits(one.values.at(-1), up.digits)}`).join(", ")}`);
  for (const tick of roundTicks(...range, 6)) {
    svg.append(draw("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(tick), y2: y(tick) }),
      svgText(LEFT - 8, y(tick) + 4, String(tick), { class: "tick", "text-anchor": "end" }));
  }
  const ticks = across.ticks ?? roundTicks(first, last, width < 500 ? 4 : 8).map((tick) => [tick, `${tick}${across.unit ?? ""}`]);
  for (const [place, words] of ticks) {
    const anchor = x(place) > width - 3 * RIGHT ? "end" : "middle";
    svg.append(svgText(anchor === "end" ? width : x(place), HEIGHT - 24, words, { class: "tick", "text-anchor": anchor }));
  }
  svg.append(svgText(width, HEIGHT - 5, across.name, { class: "axis-name", "text-anchor": "end" }),
    svgText(0, 12, axisName(up.name, range), { class: "axis-name" }));
  if (across.unranked && places.length > 1) svg.append(draw("rect", { class: "unranked-step", x: LEFT, y: TOP, width: x(places[1]) - LEFT, height: HEIGHT - BOTTOM - TOP }));
  if (diagonal) svg.append(draw("line", { class: "axis", x1: x(0), y1: y(0), x2: x(1), y2: y(1) }));
  const drawn = lines.map((one) => drawnLine(one, x, y));
  svg.append(clipped(drawn, width));
  if (isCrowded(lines)) showBandOf(null, drawn);
  return withReading(svg, { lines, drawn, places: readingPlaces(places, [first, last]), words: wordsOf(across), digits: up.digits, x, y, width });
}

// The range of the axis up.
function rangeOf(lines, across, up) {
  const places = placesOf(lines), first = across.range?.[0] ?? places[0];
  return up.range ?? axisRange(scaledValues(lines, across.unranked ? places[1] : first), up.fromZero);
}

// The widest interval of a chart, { name, place, low, high }, if it is more than half as high as the axis; else null.
export function wideInterval({ lines, x: across, y: up }) {
  const [bottom, top] = rangeOf(lines, across, up), unranked = across.unranked ? placesOf(lines)[0] : null;
  const intervals = lines.flatMap(({ name, xs, low, high }) => (low && high ? xs : [])
    .map((place, i) => ({ name, place, low: low[i], high: high[i] })))
    .filter(({ place, low, high }) => low !== null && high !== null && place !== unranked);
  const widthOf = ({ low, high }) => high - low;
  const widest = intervals.sort((a, b) => widthOf(b) - widthOf(a))[0];
  return widest && widthOf(widest) > (top - bottom) / 2 ? widest : null;
}

// Too many bands to distinguish: only the band of the line next to the pointer is drawn.
export function isCrowded(lines) {
  return lines.filter((one) => one.low?.some((v) => v !== null)).length > MOST_BANDS;
}

function showBandOf(chosen, drawn) {
  for (const group of drawn) {
    for (const band of group.querySelectorAll(".band")) band.setAttribute("visibility", group === chosen ? "visible" : "hidden");
  }
}

// The values of the lines, and of their bands, from the place `first` on; all values if there are none.
function scaledValues(lines, first) {
  const valuesOf = (wanted) => lines.flatMap(({ xs, values, low, high }) =>
    [values, low ?? [], high ?? []].flatMap((curve) => curve.filter((value, i) => value !== null && wanted(xs[i]))));
  const later = valuesOf((place) => place >= first);
  return later.length ? later : valuesOf(() => true);
}

// The lines, cut at the axes: values that do not count for the scale may lie outside.
function clipped(drawn, width) {
  const box = { x: 0, y: TOP - EDGE, width, height: HEIGHT - BOTTOM - TOP + 2 * EDGE };
  return draw("svg", { ...box, viewBox: Object.values(box).join(" ") }, ...drawn);
}

// The places of all lines, in order.
function placesOf(lines) {
  return [...new Set(lines.flatMap((one) => one.xs))].sort((a, b) => a - b);
}

// The positions for reading values: the places, or evenly spaced positions if there are too many.
function readingPlaces(places, [first, last]) {
  if (places.length <= READING_PLACES) return places;
  return Array.from({ length: READING_PLACES }, (_, i) => first + (i * (last - first)) / (READING_PLACES - 1));
}

const wordsOf = (across) => across.words ?? ((place) => `${across.name} ${Number(place.toPrecision(3))}${across.unit ?? ""}`);

function drawnLine({ style, name, xs, values, low, high, dotStyles }, x, y) {
  const group = draw("g", { class: `line ${style}` }, draw("title", {}, name));
  const dot = (i) => draw("circle", { class: "dot", cx: x(xs[i]), cy: y(values[i]), r: dotStyles ? 4.5 : 2.5 });
  for (const piece of piecesOf(values)) {
    const band = low && high ? piece.filter((i) => low[i] !== null && high[i] !== null) : [];
    if (band.length > 1) {
      const outline = [...band.map((i) => [i, high[i]]), ...band.reverse().map((i) => [i, low[i]])];
      group.append(draw("polygon", { class: "band", points: outline.map(([i, v]) => `${x(xs[i])},${y(v)}`).join(" ") }));
    }
    group.append(draw("polyline", { points: piece.map((i) => `${x(xs[i])},${y(values[i])}`).join(" ") }));
    if (dotStyles) for (const i of piece) group.append(draw("g", { class: `line ${dotStyles[i]}` }, dot(i)));
    else if (piece.length === 1) group.append(dot(piece[0]));
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
  const { places } = chart;
  const crowded = isCrowded(chart.lines);
  let at = null;
  const show = (i) => {
    at = i;
    marks.replaceChildren();
    readout.hidden = i === null;
    if (i !== null) fillReading(marks, readout, chart, places[i]);
  };
  show(null);
  if (!places.length) return holder;
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    show(nearest(places.map(chart.x), ((event.clientX - box.left) / box.width) * chart.width));
    if (crowded) showBandOf(lineAt(chart, places[at], ((event.clientY - box.top) / box.height) * HEIGHT), chart.drawn);
  });
  svg.addEventListener("pointerleave", () => {
    show(null);
    if (crowded) showBandOf(null, chart.drawn);
  });
  holder.addEventListener("blur", () => show(null));
  holder.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(at === null ? (step > 0 ? 0 : places.length - 1) : Math.min(Math.max(at + step, 0), places.length - 1));
  });
  return holder;
}

// The drawn line nearest to a height of the drawing at a place.
function lineAt({ lines, drawn, y }, place, height) {
  const away = lines.map((one) => Math.abs(y(one.values[nearest(one.xs, place)] ?? Infinity) - height));
  return drawn[away.indexOf(Math.min(...away))];
}

// Each line at its own nearest place.
function fillReading(marks, readout, { lines, words, digits, x, y }, place) {
  const number = (value) => inDigits(value, digits);
  marks.append(draw("line", { x1: x(place), x2: x(place), y1: TOP, y2: HEIGHT - BOTTOM }));
  const read = lines.map((one) => ({ one, i: nearest(one.xs, place) }))
    .filter(({ one, i }) => one.values[i] !== null && one.values[i] !== undefined)
    .sort((a, b) => b.one.values[b.i] - a.one.values[a.i]);
  const isInside = (height) => height >= TOP - EDGE && height <= HEIGHT - BOTTOM + EDGE;
  for (const { one, i } of read.filter((at) => isInside(y(at.one.values[at.i])))) marks.append(draw("g", { class: one.style }, draw("circle", { cx: x(one.xs[i]), cy: y(one.values[i]), r: 3.5 })));
  const rows = read.map(({ one, i }) => make("span", {}, swatch(one.style), `${one.name} ${number(one.values[i])}`
    + (one.low?.[i] != null && one.high?.[i] != null ? ` [${number(one.low[i])}, ${number(one.high[i])}]` : "")
    + (one.notes ? ` (${one.notes[i]})` : "")));
  readout.replaceChildren(make("b", {}, words(place)), ...rows);
}

// The numbers of a chart, headings first: a column for each line if all have the same places, else a row for each point.
export function numbersOfChart({ lines, x, y }) {
  const shown = lines.toReversed();
  const places = placesOf(lines), written = x.written ?? ((place) => place);
  const hasAll = ({ xs }) => xs.length === places.length && places.every((place) => xs.includes(place));
  if (!shown.every(hasAll)) {
    const banded = shown.some((one) => one.low && one.high);
    return [["tracker", x.name, y.name, ...(banded ? [`${y.name} low`, `${y.name} high`] : [])],
      ...shown.flatMap((one) => one.xs.map((place, i) =>
        [one.name, written(place), one.values[i], ...(banded ? [one.low?.[i], one.high?.[i]] : [])]))];
  }
  const ends = (one) => (one.low && one.high ? [`${one.name} low`, `${one.name} high`] : []);
  const values = (one, place) => {
    const i = one.xs.indexOf(place);
    return [one.values[i], ...(one.low && one.high ? [one.low[i], one.high[i]] : [])];
  };
  return [[x.name, ...shown.flatMap((one) => [one.name, ...ends(one)])],
    ...places.map((place) => [written(place), ...shown.flatMap((one) => values(one, place))])];
}
