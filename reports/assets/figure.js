// A figure of the page: choices, a drawing, one line of description, and its downloads.
import { inAddress, keepInAddress } from "./address.js";
import { downloadButtons } from "./downloads.js";
import { draw, make, meaning, svgText, swatch } from "./drawing.js";
import { lineChart, numbersOfChart } from "./line_chart.js";
import { pageData } from "./page_data.js";
import { whenShownChange } from "./shown_trackers.js";

const LEAST_WIDTH = 300, EMPTY_HEIGHT = 120;
const NO_VALUE = "No shown tracker has a value here";
const COLUMNS = { ahead_s: "horizon, s" };
let firstWidth = 0; // of the first full figure: all are as wide, and to measure each would lay the page out each time

// `figure`: { id, title, chosen, choices(chosen), line(chosen) } and either chart(chosen), the data for `lineChart`, or
// drawing(chosen, width), an element, and numbers(chosen), its table. Its title is a heading of docs/figures.md.
// `fixed(chosen)`: { name: value } for its file, besides the choices, such as a constant score. `legend(chosen)`: the rows
// { name, style } of a drawing above it; for a chart these are its lines, only on paper and in its file. `aside`: it has
// a part of the page's width.
export function startFigure(figure) {
  const { id, title, chosen } = figure;
  const section = document.getElementById(id) ?? newSection(id, title);
  takeFromAddress(figure);
  const heading = section.querySelector("h2").textContent.toLowerCase().replaceAll(" ", "-");
  const holder = make("div", { class: "drawn" });
  const note = make("p", { class: "note" });
  const printed = make("p", { class: "printed" });
  const keys = make("p", { class: "legend" });
  const drawing = figure.drawing ?? ((now, width) => lineChart({ ...figure.chart(now), width }));
  const table = figure.numbers ?? ((now) => numbersOfChart(figure.chart(now)));
  const numbers = (now) => labelled(table(now), { ...choicesMade(figure.choices(now), now), ...figure.fixed?.(now) });
  const words = () => choiceWords(figure.choices(chosen), chosen);
  const legend = () => figure.legend?.(chosen) ?? (figure.chart ? figure.chart(chosen).lines.toReversed() : []);
  const legendKeys = () => legend().map(({ name, style }) => make("span", {}, swatch(style), name));
  let width = 0;
  const redraw = () => {
    const draws = isEmpty(table(chosen)) ? (_, wide) => emptyDrawing(wide) : drawing;
    holder.replaceChildren(draws(chosen, Math.max(width, LEAST_WIDTH)));
    printed.replaceChildren(make("span", {}, words()), ...(figure.legend ? [] : legendKeys()));
    if (figure.legend) keys.replaceChildren(...legendKeys());
    note.replaceChildren(figure.line(chosen), " ", meaning(heading));
  };
  const controls = make("div", { class: "controls" }, choiceBar(figure.choices, chosen, () => {
    redraw();
    keepInAddress(id, figure.choices(chosen).map(([key, , , taken = chosen[key]]) => taken));
  }));
  section.append(controls, printed, ...(figure.legend ? [keys] : []), holder, note);
  section.hidden = false;
  if (!figure.aside) firstWidth ||= holder.clientWidth;
  width = figure.aside ? holder.clientWidth : firstWidth;
  redraw();
  const head = () => ({
    title: section.querySelector("h2").textContent,
    words: [words(), figure.line(chosen)],
    legend: legend(),
  });
  controls.append(downloadButtons(id, () => holder.querySelector("svg.figure-drawing"), head, () => numbers(chosen)));
  whenShownChange(redraw);
  new ResizeObserver(() => {
    if (!holder.clientWidth || holder.clientWidth === width) return; // 0: in a part that is closed
    width = holder.clientWidth;
    redraw();
  }).observe(section);
}

// The choices of a figure in the address, as far as they are options.
function takeFromAddress({ id, choices, chosen }) {
  (inAddress(id) ?? []).forEach((text, at) => {
    const [key, , options] = choices(chosen)[at] ?? [];
    const found = options?.find(([value]) => String(value) === text);
    if (found) [chosen[key]] = found;
  });
}

// Whether the table of a figure, headings first, has no value after its first column of names or places.
function isEmpty([, ...rows]) {
  return !rows.some((row) => row.some((cell, column) => column > 0 && typeof cell === "number"));
}

function emptyDrawing(width) {
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${width} ${EMPTY_HEIGHT}`, width, height: EMPTY_HEIGHT, role: "img", "aria-label": NO_VALUE });
  svg.append(svgText(width / 2, EMPTY_HEIGHT / 2, NO_VALUE, { class: "tick", "text-anchor": "middle" }));
  return svg;
}

// The choice, by the name of its column.
function choicesMade(listed, chosen) {
  return Object.fromEntries(listed.map(([key, , , taken = chosen[key]]) => [COLUMNS[key] ?? key, taken]));
}

// A table, headings first, with a column for each choice, for a file that explains itself.
function labelled([heading, ...rows], choices) {
  return [[...heading, ...Object.keys(choices)], ...rows.map((row) => [...row, ...Object.values(choices)])];
}

// The part of the page for figures that are not in its HTML, and the names of those that open on demand.
let partOfPage = document.getElementById("figures");
const namesOfDetails = make("span");

function newSection(id, title) {
  const section = make("section", { id, class: "figure" }, make("h2", {}, title));
  partOfPage.append(section);
  if (partOfPage.contains(namesOfDetails)) namesOfDetails.append(`${namesOfDetails.hasChildNodes() ? ", " : ""}${title.toLowerCase()}`);
  partOfPage.hidden = false;
  return section;
}

// Figures that start after this are in a part that opens on demand, and on paper.
export function startDetails() {
  const details = make("details", { id: "details", hidden: "" }, make("summary", {}, make("b", {}, "Details: "), namesOfDetails));
  partOfPage.append(details);
  partOfPage = details;
  window.addEventListener("beforeprint", () => { details.open = true; });
}

// A labelled select; `options`: [value, text] pairs. `changed` is called with the chosen value.
export function choice(name, options, chosen, changed) {
  const select = make("select", { "data-choice": name }, ...options.map(([value, text]) => make("option", { value }, text)));
  select.value = String(chosen);
  select.addEventListener("change", () => changed(options[select.selectedIndex][0]));
  return make("label", { class: "choice" }, make("span", {}, name), select);
}

// Chooses a recording in every figure that offers it, and leads to its moments, or to the ranking if it has none.
export function chooseRecording(recording) {
  const offers = (select) => [...select.options].some(({ value }) => value === recording);
  const choices = () => [...document.querySelectorAll("select[data-choice=Recording]")];
  for (const select of choices().filter(offers)) {
    select.value = recording;
    select.dispatchEvent(new Event("change"));
  }
  const goal = document.getElementById(pageData.players.includes(recording) ? "moments" : "ranking");
  goal.scrollIntoView();
  choices().find((select) => goal.contains(select)).focus({ preventScroll: true });
}

// The choice, as a line of text, without choices that have no options.
export function choiceWords(listed, chosen) {
  const textOf = (options, taken) => options.find(([value]) => value === taken)?.[1];
  return listed.filter(([, , options]) => options.length)
    .map(([key, name, options, taken = chosen[key]]) => `${name}: ${textOf(options, taken)}`).join("; ");
}

// The choices of a figure in a row, without single options; drawn again after every change. A choice of `listed`:
// [key, name, options, taken]. If the chosen value is no option, the first option replaces it, or `taken` while the
// options are these; without options it stays.
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
