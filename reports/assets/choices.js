// Selects that choose what a figure shows.
import { make } from "./elements.js";

// A labelled select; `options`: [value, text] pairs. `changed` is called with the chosen value.
export function choice(name, options, chosen, changed) {
  const select = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  select.value = String(chosen);
  select.addEventListener("change", () => changed(select.value));
  return make("label", { class: "choice" }, make("span", {}, name), select);
}

// What is chosen, as a line of text.
export function choiceWords(listed, chosen) {
  const textOf = (key, options) => options.find(([value]) => String(value) === String(chosen[key]))?.[1];
  return listed.map(([key, name, options]) => `${name}: ${textOf(key, options)}`).join("; ");
}

// The choices of a figure in a row, with nothing to choose left out; drawn again after every change.
export function choiceBar(listed, chosen, redraw) {
  const bar = make("div", { class: "choices" });
  const fill = () => {
    const focused = [...bar.querySelectorAll("select")].findIndex((select) => select === document.activeElement);
    bar.replaceChildren();
    for (const [key, name, options] of listed(chosen)) {
      if (!options.some(([value]) => String(value) === String(chosen[key]))) chosen[key] = options[0][0];
      const picked = (value) => { chosen[key] = value; fill(); redraw(); };
      const one = choice(name, options, chosen[key], picked);
      one.hidden = options.length < 2;
      bar.append(one);
    }
    if (focused >= 0) bar.querySelectorAll("select")[focused]?.focus();
  };
  fill();
  return bar;
}
