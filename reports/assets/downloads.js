// A figure as a file of its own, and its numbers as CSV.
import { make } from "./elements.js";

const DRAWN = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linejoin", "opacity",
  "font", "text-anchor", "filter", "image-rendering"];

function save(text, type, name) {
  const link = make("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// An SVG as text, with the styles that the page gives it, on the page's paper.
function standalone(svg) {
  const copy = svg.cloneNode(true);
  const originals = svg.querySelectorAll("*");
  copy.querySelectorAll("*").forEach((element, i) => {
    const style = getComputedStyle(originals[i]);
    for (const name of DRAWN) element.style.setProperty(name, style.getPropertyValue(name));
  });
  copy.querySelectorAll(".reading").forEach((reading) => reading.remove());
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.style.background = getComputedStyle(document.body).backgroundColor;
  return new XMLSerializer().serializeToString(copy);
}

// Texts are quoted, and one that a spreadsheet would take for a formula begins with an apostrophe.
function csvCell(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return String(value);
  return `"${value.replace(/^[=+\-@\t\r]/, "'$&").replaceAll('"', '""')}"`;
}

// Two buttons, for a table only the second; `svg()` is the figure, null for a table, and `rows()` its numbers, headings first, at the time of the click.
export function downloadButtons(name, svg, rows) {
  const file = (ending) => `${name}.${ending}`;
  const asSvg = make("button", { type: "button", "aria-label": `Download ${name} as SVG` }, "SVG");
  asSvg.addEventListener("click", () => save(standalone(svg()), "image/svg+xml", file("svg")));
  asSvg.hidden = !svg();
  const asCsv = make("button", { type: "button", "aria-label": `Download the numbers of ${name} as CSV` }, "CSV");
  asCsv.addEventListener("click", () => {
    save(rows().map((row) => row.map(csvCell).join(",")).join("\r\n") + "\r\n", "text/csv", file("csv"));
  });
  return make("span", { class: "downloads" }, asSvg, asCsv);
}
