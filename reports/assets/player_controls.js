// The controls of a player: real buttons, sliders and labels.
import { make } from "./elements.js";
import { MARK_COLOURS, cssColour } from "./moment_cells.js";

export function button(words, onClick) {
  const element = make("button", { type: "button" }, words);
  element.addEventListener("click", onClick);
  return element;
}

export function slider(words, last, onInput) {
  const input = make("input", { type: "range", min: 0, max: last, step: 1, "aria-label": words });
  const output = make("output", {});
  input.addEventListener("input", () => onInput(Number(input.value)));
  return { input, output, element: make("label", { class: "slider" }, words, input, output) };
}

export function check(words, checked, onChange) {
  const input = make("input", { type: "checkbox" });
  input.checked = checked;
  input.addEventListener("change", () => onChange(input.checked));
  return make("label", {}, input, words);
}

// A menu of `options`, [value, text] each.
export function menu(words, options, chosen, onChange) {
  const select = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  select.value = String(chosen);
  select.addEventListener("change", () => onChange(Number(select.value)));
  return { select, element: make("label", { class: "menu" }, words, select) };
}

export function markLegend(hidden) {
  const names = Object.keys(MARK_COLOURS).filter((name) =>
    !name.startsWith("hidden") || hidden || name === "hidden, not scored");
  return make("div", { class: "legend marks-legend" }, ...names.map((name) => {
    const key = make("i", { class: name.includes("miss") ? "key hollow" : "key" });
    key.style.backgroundColor = key.style.borderColor = cssColour(MARK_COLOURS[name]);
    return make("span", {}, key, name);
  }));
}
