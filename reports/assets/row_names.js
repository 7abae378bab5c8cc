// The names of rows at the left of a drawing, whole: a long one takes several lines, and its row the room for them.
import { draw } from "./elements.js";

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

// The name in lines at most `room` pixels wide; a part that is wider ends anywhere.
export function nameLines(name, room) {
  const lines = [""];
  const add = (text) => {
    if (textWidth(lines.at(-1) + text) <= room) lines[lines.length - 1] += text;
    else lines.push(text);
  };
  for (const part of name.match(ENDS_LINE) ?? []) (textWidth(part) <= room ? [part] : [...part]).forEach(add);
  return lines.filter(Boolean);
}

// As much of the name as is at most `room` pixels wide, with an ellipsis where it is not the whole.
export function shortened(name, room) {
  const signs = [...name];
  let kept = signs.length, text = name;
  while (kept > 1 && textWidth(text) > room) text = `${signs.slice(0, kept -= 1).join("").trimEnd()}…`;
  return text;
}

// For each name its lines, and the middle `y` and `height` of its row, rows one below the other, pixels.
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

// The name of a row as `namedRows` placed it.
export function rowName({ lines, y }, attributes = {}) {
  const first = y + 4 - (LINE_OF_TEXT * (lines.length - 1)) / 2;
  return draw("text", attributes, ...lines.map((line, i) => draw("tspan", { x: 0, y: first + LINE_OF_TEXT * i }, line)));
}
