// Elements, axes and names of rows: the parts of every figure. Every text of a run is text and never HTML.
const SVG = "http://www.w3.org/2000/svg";

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// An HTML element with attributes (null: left out) and children, elements or texts.
export function make(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

// An SVG element with attributes and children.
export function draw(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

// A button that opens the section `name` of docs/figures.md at the end of the page.
export function meaning(name) {
  return make("button", { type: "button", class: "meaning", popovertarget: `meaning-${name}` }, "Explanation");
}

// The line in a tracker's colour before its name.
export function swatch(style) {
  return draw("svg", { class: `swatch ${style}`, viewBox: "0 0 16 10", width: 16, height: 10, "aria-hidden": "true" },
    draw("line", { x1: 1, y1: 5, x2: 15, y2: 5 }));
}

// A linear map of [low, high] to [start, end].
export function scaleOf(low, high, start, end) {
  const span = high - low || 1;
  return (value) => start + ((value - low) / span) * (end - start);
}

// Round values within [low, high], about `wanted` of them.
export function roundTicks(low, high, wanted) {
  const rough = (high - low) / wanted || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((value) => value >= rough);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i += 1) ticks.push(Number((i * step).toPrecision(6)));
  return ticks;
}

// The index of the first value nearest to `wanted`.
export function nearest(values, wanted) {
  return values.reduce((best, value, i) => (Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? i : best), 0);
}

// The range of an axis over `values`. It begins at 0 if `fromZero`, or if the values then fill half of it.
export function axisRange(values, fromZero) {
  const known = values.filter((value) => value !== null);
  if (!known.length) return [0, 1];
  let [low, high] = [Math.min(...known), Math.max(...known)];
  if (fromZero || low <= high / 2) low = Math.min(low, 0);
  const room = (high - low) * 0.05 || 0.05;
  return [low === 0 ? 0 : low - room, high + room];
}

// The name of an axis; an axis without 0 names its first value.
export function axisName(name, [low, high]) {
  return low <= 0 && high >= 0 ? name : `${name}; the axis begins at ${Number(low.toPrecision(2))}`;
}

export function svgText(x, y, text, attributes = {}) {
  return draw("text", { x, y, ...attributes }, text);
}

export const inSeconds = (seconds) => `${Number(seconds.toPrecision(3))} s`;

// A score in words, with a dash if it is undefined.
export function inDigits(value, digits = 3) {
  return value === null || value === undefined ? "–" : value.toFixed(digits);
}

const LINE_OF_TEXT = 14;
const ENDS_LINE = /[^\s\-_.,:/]*[\s\-_.,:/]|[^\s\-_.,:/]+$/g; // a part of a name, with the sign after which a line may end
let pen = null;

// The width of a text in the font of drawings, pixels.
export function textWidth(text) {
  if (!pen) {
    pen = document.createElement("canvas").getContext("2d");
    pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  }
  return pen.measureText(text.trimEnd()).width;
}

// The name in lines at most `room` pixels wide; wider parts break anywhere.
export function nameLines(name, room) {
  const lines = [""];
  const add = (text) => {
    if (textWidth(lines.at(-1) + text) <= room) lines[lines.length - 1] += text;
    else lines.push(text);
  };
  for (const part of name.match(ENDS_LINE) ?? []) (textWidth(part) <= room ? [part] : [...part]).forEach(add);
  return lines.filter(Boolean);
}

// The name, shortened with an ellipsis to at most `room` pixels.
export function shortened(name, room) {
  const signs = [...name];
  let kept = signs.length, text = name;
  while (kept > 1 && textWidth(text) > room) text = `${signs.slice(0, kept -= 1).join("").trimEnd()}…`;
  return text;
}

// For each name its lines, and the middle `y` and `height` of its row, pixels.
export function namedRows(names, room, leastHeight) {
  let bottom = 0;
  return names.map((name) => {
    const lines = nameLines(name, room), height = Math.max(leastHeight, LINE_OF_TEXT * lines.length + 12);
    bottom += height;
    return { lines, y: bottom - height / 2, height };
  });
}

// The height of the rows that `namedRows` placed.
export const heightOf = (places) => places.reduce((sum, { height }) => sum + height, 0);

// The name of a row at its place from `namedRows`.
export function rowName({ lines, y }, attributes = {}) {
  const first = y + 4 - (LINE_OF_TEXT * (lines.length - 1)) / 2;
  return draw("text", attributes, ...lines.map((line, i) => draw("tspan", { x: 0, y: first + LINE_OF_TEXT * i }, line)));
}
