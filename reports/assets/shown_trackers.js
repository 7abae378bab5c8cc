// A button for each tracker, which hides it in every table and figure.
import { inAddress, keepInAddress } from "./address.js";
import { make, swatch } from "./drawing.js";
import { pageData } from "./page_data.js";

const HIDDEN_KEY = "hidden", COPIED_MS = 2000;
const hiddenLabels = new Set();
const listeners = [];

export function isShown(label) {
  return !hiddenLabels.has(label);
}

// Calls `listener` after every change. Elements with `data-tracker` are hidden without a listener, and elements with
// `data-trackers`, a JSON list, when all of these trackers are hidden.
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

// A button that copies the address of the page, which has the choices made.
function copyButton() {
  const button = make("button", { type: "button", class: "copies" }, "copy link");
  const say = (words) => {
    button.textContent = words;
    setTimeout(() => { button.textContent = "copy link"; }, COPIED_MS);
  };
  const copy = async () => navigator.clipboard.writeText(location.href);
  button.addEventListener("click", () => copy().then(() => say("copied"), () => say("copy it from the address bar")));
  return button;
}

// Fills the bar of buttons.
export function startShownTrackers() {
  const bar = document.getElementById("trackers");
  for (const { label, name, style } of pageData.trackers) {
    const button = make("button", { type: "button", class: "tracker", "aria-pressed": "true" }, swatch(style), name);
    button.addEventListener("click", () => {
      toggle(label, button);
      keepInAddress(HIDDEN_KEY, [...hiddenLabels]);
    });
    button.hidden = pageData.trackers.length < 2;
    bar.append(button);
    if (inAddress(HIDDEN_KEY)?.includes(label)) toggle(label, button);
  }
  bar.append(copyButton());
  bar.hidden = false;
}
