// Which trackers the page shows: a button for each; one that is off is gone from every table and figure.
import { make, swatch } from "./drawing.js";
import { pageData } from "./page_data.js";

const hiddenLabels = new Set();
const listeners = [];

export function isShown(label) {
  return !hiddenLabels.has(label);
}

// Calls `listener` after every change; what is marked with `data-tracker` in the page needs none, nor what is of several
// and marked with `data-trackers`, JSON, which is gone when all of them are.
export function whenShownChange(listener) {
  listeners.push(listener);
}

function toggle(label, button) {
  if (!hiddenLabels.delete(label)) hiddenLabels.add(label);
  button.setAttribute("aria-pressed", String(isShown(label)));
  for (const marked of document.querySelectorAll("[data-tracker]")) {
    marked.toggleAttribute("hidden", !isShown(marked.dataset.tracker));
  }
  for (const marked of document.querySelectorAll("[data-trackers]")) {
    marked.toggleAttribute("hidden", !JSON.parse(marked.dataset.trackers).some(isShown));
  }
  for (const listener of listeners) listener();
}

// Fills the bar of buttons.
export function startShownTrackers() {
  const bar = document.getElementById("trackers");
  for (const { label, name, style } of pageData.trackers) {
    const button = make("button", { type: "button", class: "tracker", "aria-pressed": "true" }, swatch(style), name);
    button.addEventListener("click", () => toggle(label, button));
    bar.append(button);
  }
  bar.hidden = pageData.trackers.length < 2;
}
