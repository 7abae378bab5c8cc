// All kept moments as a list, to sort and to filter; a click opens one in the player.
import { downloadButtons } from "./downloads.js";
import { inDigits, inSeconds, make, nearest } from "./drawing.js";
import { choiceBar } from "./figure.js";
import { FEW_CELLS, momentF1, occupiedCells, robotCounts } from "./moments.js";
import { pageData } from "./page_data.js";
import { isShown, whenShownChange } from "./shown_trackers.js";

const EVERY_RECORDING = "", WITH_MOTION = "motion", EVERY_MOMENT = "every";

// The columns of the list; those with `digits` are numbers and sort downwards first.
const momentColumns = (players, { one, other }) => [
  { key: "recording", name: "recording" },
  { key: "seconds", name: "time, s", digits: 1 },
  { key: "one", name: `F1 of ${nameOf(one)}`, digits: 2 },
  { key: "other", name: `F1 of ${nameOf(other)}`, digits: 2 },
  { key: "difference", name: "difference", digits: 2 },
  ...(players.some(({ moments }) => moments.some(({ robots }) => robots)) ? contactColumns(nameOf(one)) : []),
];
const contactColumns = (name) => [
  { key: "contacts", name: "contacts", digits: 0 },
  { key: "missed", name: `missed by ${name}`, digits: 0 },
  { key: "needless", name: `needless of ${name}`, digits: 0 },
];

// Fills a section below the players. `momentsOf(recording)`: its data; `open(link)`: shows a moment in the player.
export function startMomentList(section, momentsOf, open) {
  const holder = make("div", {});
  const list = make("details", { class: "all-moments" }, make("summary", {}, "All kept moments as a list"), holder);
  section.append(list);
  let isFilled = false;
  list.addEventListener("toggle", () => {
    if (list.open && !isFilled) fill(holder, pageData.players.map(momentsOf), open);
    isFilled ||= list.open;
  });
}

function fill(holder, players, open) {
  const labels = pageData.trackers.map(({ label }) => label).filter((label) => players.some((one) => one.trackers.includes(label)));
  const chosen = { recording: EVERY_RECORDING, one: labels[0], other: labels[1] ?? labels[0], ahead_s: 1, moments: EVERY_MOMENT };
  const order = { key: "difference", down: true };
  const drawn = make("div", {});
  const redraw = () => drawn.replaceChildren(drawList(players, chosen, order, open, redraw));
  holder.append(
    make("div", { class: "controls" }, choiceBar((now) => choicesOf(players, labels, now), chosen, redraw),
      downloadButtons("moments", () => null, null, () => numbersOf(players, chosen, order))), drawn);
  whenShownChange(redraw);
  redraw();
}

function choicesOf(players, labels, chosen) {
  const named = labels.map((label) => [label, nameOf(label)]);
  const horizons = [...new Set(players.flatMap((one) => one.horizons_s))].sort((a, b) => a - b);
  const ahead_s = horizons[nearest(horizons, chosen.ahead_s)];
  return [["recording", "Recording", [[EVERY_RECORDING, "all"], ...players.map(({ recording }) => [recording, recording])]],
    ["one", "Row", named], ["other", "Less", named], ["ahead_s", "Ahead", horizons.map((s) => [s, inSeconds(s)]), ahead_s],
    ["moments", "Moments", [[EVERY_MOMENT, "all"], [WITH_MOTION, `with ${FEW_CELLS} cells in motion or more`]]]];
}

const isNumber = ({ digits }) => digits !== undefined;
const nameOf = (label) => pageData.trackers.find((one) => one.label === label).name;

// The lines that the choices leave, in their order; undefined values come last.
function momentLines(players, chosen, { key, down }) {
  const lines = players.filter(({ recording }) => [EVERY_RECORDING, recording].includes(chosen.recording))
    .flatMap((player) => player.moments.map((_, moment) => lineOfMoment(player, moment, chosen)))
    .filter(({ cells }) => chosen.moments === EVERY_MOMENT || cells >= FEW_CELLS);
  const before = (a, b) => (typeof a === "string" ? a.localeCompare(b) : a - b);
  const undefinedLast = (a, b) => (a === null) - (b === null);
  return lines.sort((a, b) => undefinedLast(a[key], b[key]) || (a[key] === null ? 0 : before(a[key], b[key]) * (down ? -1 : 1)));
}

function lineOfMoment(player, moment, { one, other, ahead_s }) {
  const h = nearest(player.horizons_s, ahead_s);
  const of = (label) => {
    const tracker = isShown(label) ? player.trackers.indexOf(label) : -1;
    return tracker < 0 ? null : momentF1(player, moment, h, tracker);
  };
  const scores = [of(one), of(other)];
  const difference = scores.includes(null) ? null : scores[0] - scores[1];
  const { recording } = player, seconds = player.moments[moment].t;
  const tracker = player.trackers.indexOf(one), robots = isShown(one) ? robotCounts(player, moment, tracker) : null;
  return {
    recording, seconds, one: scores[0], other: scores[1], difference, cells: occupiedCells(player, moment, h),
    contacts: robots && robots.foreseen + robots.missed, missed: robots?.missed ?? null, needless: robots?.needless ?? null,
  };
}

function drawList(players, chosen, order, open, redraw) {
  const columns = momentColumns(players, chosen);
  const sorted = ({ key }) => (key === order.key ? (order.down ? "descending" : "ascending") : null);
  const heading = (column) => {
    const button = make("button", { type: "button", class: "sorts" }, column.name);
    button.addEventListener("click", () => {
      Object.assign(order, { key: column.key, down: column.key === order.key ? !order.down : isNumber(column) });
      redraw();
      document.querySelector(`.sorts[data-key="${column.key}"]`).focus();
    });
    button.dataset.key = column.key;
    return make("th", { scope: "col", "aria-sort": sorted(column), class: isNumber(column) ? null : "name" }, button);
  };
  const lines = momentLines(players, chosen, order);
  const rows = lines.map((line) => make("tr", {}, ...columns.map((column) => cellOf(line, column, chosen, open))));
  return make("div", {},
    make("p", { class: "note" }, `${lines.length} moments; a click on one opens it in the player above.`),
    make("div", { class: "scroll moment-list", tabindex: 0, role: "region", "aria-label": "All kept moments" },
      make("table", {}, make("thead", {}, make("tr", {}, ...columns.map(heading))), make("tbody", {}, ...rows))));
}

function cellOf(line, column, { one, other, ahead_s }, open) {
  if (isNumber(column)) return make("td", {}, inDigits(line[column.key], column.digits));
  const button = make("button", { type: "button", class: "opens-moment" }, line.recording);
  const { recording, seconds } = line;
  button.addEventListener("click", () => open({ recording, seconds, horizon: ahead_s, trackers: [...new Set([one, other])] }));
  return make("th", { scope: "row", class: "name" }, button);
}

function numbersOf(players, chosen, order) {
  const columns = momentColumns(players, chosen);
  return [columns.map(({ name }) => name), ...momentLines(players, chosen, order).map((line) => columns.map(({ key }) => line[key]))];
}
