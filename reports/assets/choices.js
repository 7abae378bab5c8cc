// Selects that choose what a figure shows.
import { make } from "./elements.js";

// A labelled select; `options`: [value, text] pairs. `changed` is called with the chosen value.
export function choice(name, options, chosen, changed) {
  const select = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  select.value = String(chosen);
  select.addEventListener("change", () => changed(options[select.selectedIndex][0]));
  return make("label", { class: "choice" }, make("span", {}, name), select);
}

// What is chosen, as a line of text, without what has no options.
export function choiceWords(listed, chosen) {
  const textOf = (options, taken) => options.find(([value]) => value === taken)?.[1];
  return listed.filter(([, , options]) => options.length)
    .map(([key, name, options, taken = chosen[key]]) => `${name}: ${textOf(options, taken)}`).join("; ");
}

// The choices of a figure in a row, with nothing to choose left out; drawn again after every change. A choice of
// `listed`: [key, name, options, taken]. Where what is chosen is no option, the first takes its place for good, or
// `taken` for as long as the options are these; where there is no option, it stays.
export function choiceBar(listed, chosen, redraw) {
  const bar = make("div", { class: "choices" });
  const fill = () => {
    const focused = [...bar.querySelectorAll("select")].findIndex((select) => select === document.activeElement);
    bar.replaceChildren();
    for (const at of listed(chosen).keys()) {
      const [key, name, options, taken] = listed(chosen)[at]; // anew: it depends on the choices before it
      const isOffered = options.some(([value]) => value === chosen[key]);
      if (taken === undefined && options.length && !isOffered) chosen[key] = options[0][0];
      const picked = (value) => { chosen[key] = value; fill(); redraw(); };
      const one = choice(name, options, taken ?? chosen[key], picked);
      one.hidden = options.length < 2 && (taken ?? chosen[key]) === chosen[key];
      bar.append(one);
    }
    if (focused >= 0) bar.querySelectorAll("select")[focused]?.focus();
  };
  fill();
  return bar;
}
