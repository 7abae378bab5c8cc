// New elements, without HTML: every text of a run is text and nothing else.
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

// The same of SVG.
export function draw(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

// A button that opens the section `name` of docs/figures.md, which is at the end of the page.
export function meaning(name) {
  return make("button", { type: "button", class: "meaning", popovertarget: `meaning-${name}` }, "What it means");
}

// The line in a tracker's colour that stands before its name.
export function swatch(style) {
  return draw("svg", { class: `swatch ${style}`, viewBox: "0 0 16 10", width: 16, height: 10, "aria-hidden": "true" },
    draw("line", { x1: 1, y1: 5, x2: 15, y2: 5 }));
}
