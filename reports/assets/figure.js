// A figure of the page: choices, a drawing, one line on what it shows, and its downloads.
import { choiceBar, choiceWords } from "./choices.js";
import { downloadButtons } from "./downloads.js";
import { make, meaning, swatch } from "./elements.js";
import { numbersOfChart, lineChart } from "./line_chart.js";
import { whenShownChange } from "./shown_trackers.js";

const LEAST_WIDTH = 300;
const COLUMNS = { ahead_s: "horizon, s" };
let firstWidth = 0; // of the figure drawn first: all are as wide, and to measure each would lay the page out each time

// `figure`: { id, title, chosen, choices(chosen), line(chosen) } and either chart(chosen), what `lineChart` draws, or
// drawing(chosen, width), an element, and numbers(chosen), its table. Its title is a heading of docs/figures.md.
// `fixed(chosen)`: { name: value } for its file, beside what is chosen, such as a score that is always the same.
export function startFigure(figure) {
  const { id, title, chosen } = figure;
  const section = document.getElementById(id) ?? newSection(id, title);
  const heading = section.querySelector("h2").textContent.toLowerCase().replaceAll(" ", "-");
  const holder = make("div", { class: "drawn" });
  const note = make("p", { class: "note" });
  const printed = make("p", { class: "printed" });
  const drawing = figure.drawing ?? ((now, width) => lineChart({ ...figure.chart(now), width }));
  const table = figure.numbers ?? ((now) => numbersOfChart(figure.chart(now)));
  const numbers = (now) => toldOf(table(now), { ...choicesMade(figure.choices(now), now), ...figure.fixed?.(now) });
  const words = () => choiceWords(figure.choices(chosen), chosen);
  const legend = () => (figure.chart ? figure.chart(chosen).lines.toReversed() : []);
  let width = 0;
  const redraw = () => {
    holder.replaceChildren(drawing(chosen, Math.max(width, LEAST_WIDTH)));
    printed.replaceChildren(make("span", {}, words()), ...legend().map(({ name, style }) => make("span", {}, swatch(style), name)));
    note.replaceChildren(figure.line(chosen), " ", meaning(heading));
  };
  const controls = make("div", { class: "controls" }, choiceBar(figure.choices, chosen, redraw));
  section.append(controls, printed, holder, note);
  section.hidden = false;
  firstWidth ||= holder.clientWidth;
  width = firstWidth;
  redraw();
  const head = () => ({
    title: section.querySelector("h2").textContent,
    words: [words(), figure.line(chosen)],
    legend: legend(),
  });
  controls.append(downloadButtons(id, () => holder.querySelector("svg.figure-drawing"), head, () => numbers(chosen)));
  whenShownChange(redraw);
  new ResizeObserver(() => {
    if (holder.clientWidth === width) return;
    width = holder.clientWidth;
    redraw();
  }).observe(section);
}

// What is chosen, by the name of its column.
function choicesMade(listed, chosen) {
  return Object.fromEntries(listed.map(([key, , , taken = chosen[key]]) => [COLUMNS[key] ?? key, taken]));
}

// A table, headings first, with a column for each of `told`: a file says by itself what its numbers are of.
function toldOf([heading, ...rows], told) {
  return [[...heading, ...Object.keys(told)], ...rows.map((row) => [...row, ...Object.values(told)])];
}

function newSection(id, title) {
  const section = make("section", { id, class: "figure" }, make("h2", {}, title));
  document.getElementById("figures").append(section);
  return section;
}
