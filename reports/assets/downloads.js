// A figure as a file of its own, and its numbers as CSV.
import { draw, make, nameLines, svgText, textWidth } from "./drawing.js";

// Without the shorthand "font": it is empty for styles that it cannot express, such as digits of equal width.
const DRAWN = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linejoin", "opacity",
  "font-family", "font-size", "font-style", "font-weight", "text-anchor", "filter", "image-rendering"];
const LINE_OF_HEAD = 18, SWATCH = 30;

function save(text, type, name) {
  const link = make("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// The drawing with its context for a file: { title, words, legend }. `legend`: { name, style } of each line.
function withHead(svg, { title, words, legend }) {
  const { width, height } = svg.viewBox.baseVal;
  const root = draw("svg", { class: "figure-drawing" }, svgText(0, 18, title, { class: "title-of-file" }));
  let y = 22;
  for (const line of words.flatMap((text) => nameLines(text, width))) root.append(svgText(0, y += LINE_OF_HEAD, line, { class: "tick" }));
  let x = width;
  for (const { name, style } of legend) {
    const wide = SWATCH + textWidth(name) + 16;
    if (x + wide > width) [x, y] = [0, y + LINE_OF_HEAD];
    root.append(draw("g", { class: `line ${style}` }, draw("polyline", { points: `${x},${y - 4} ${x + SWATCH - 6},${y - 4}` }),
      svgText(x + SWATCH, y, name)));
    x += wide;
  }
  const head = y + 14;
  root.append(draw("g", { transform: `translate(0 ${head})` }, ...svg.cloneNode(true).childNodes));
  for (const [name, value] of Object.entries({ viewBox: `0 0 ${width} ${head + height}`, width, height: head + height })) root.setAttribute(name, value);
  return root;
}

// An SVG as text, with its styles from the page, on the page's background.
function standalone(svg) {
  const copy = svg.cloneNode(true);
  const originals = svg.querySelectorAll("*");
  copy.querySelectorAll("*").forEach((element, i) => {
    const style = getComputedStyle(originals[i]);
    for (const name of DRAWN) element.style.setProperty(name, style.getPropertyValue(name));
  });
  copy.querySelectorAll(".reading").forEach((reading) => reading.remove());
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.style.removeProperty("position");
  copy.style.background = getComputedStyle(document.body).backgroundColor;
  return new XMLSerializer().serializeToString(copy);
}

// Texts are quoted; an apostrophe precedes texts that look like a formula to a spreadsheet.
function csvCell(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return String(value);
  return `"${value.replace(/^[=+\-@\t\r]/, "'$&").replaceAll('"', '""')}"`;
}

// A figure as the text of a file; it is on the page while its styles are read.
function fileOf(svg, head) {
  const whole = withHead(svg, head);
  whole.style.position = "absolute";
  svg.after(whole);
  const text = standalone(whole);
  whole.remove();
  return text;
}

// Two buttons, for a table only the second. At the click `svg()` gives the figure (null for a table), `head()` its
// heading in the file, and `rows()` its numbers, headings first.
export function downloadButtons(name, svg, head, rows) {
  const file = (ending) => `${name}.${ending}`;
  const asSvg = make("button", { type: "button", "aria-label": `Download ${name} as SVG` }, "SVG");
  asSvg.addEventListener("click", () => save(fileOf(svg(), head()), "image/svg+xml", file("svg")));
  asSvg.hidden = !svg();
  const asCsv = make("button", { type: "button", "aria-label": `Download the numbers of ${name} as CSV` }, "CSV");
  asCsv.addEventListener("click", () => {
    save(rows().map((row) => row.map(csvCell).join(",")).join("\r\n") + "\r\n", "text/csv", file("csv"));
  });
  return make("span", { class: "downloads" }, asSvg, asCsv);
}
