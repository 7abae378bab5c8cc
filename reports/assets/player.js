// The player of one recording: kept forecasts over time and horizon, one to four trackers side by side.
import { keepInAddress } from "./address.js";
import { inSeconds, make, meaning, nearest } from "./drawing.js";
import { busiestCell, cameColour, cssColour, MARK_COLOURS, truthColour, unpackedMoment } from "./moment_cells.js";
import { MomentCanvas, MomentDrawing, robotsLegend } from "./moment_drawing.js";
import { contactCell, IN_ADDRESS, MOST_DIFFERENT, outstandingMoment, WORST } from "./moments.js";
import { isShown } from "./shown_trackers.js";

const MOST_PANELS = 4;
const LEAST_CELL_PX = 4;
const PLAY_MS = 700;
const NONE = -1;
const CLOSE_M = 4; // the side of the view of a person and its surroundings

export class Player {
  // `onward(kind)` goes to a moment of this kind of another recording; null if there is no other.
  constructor(element, data, onward) {
    Object.assign(this, { element, data, onward, moment: 0, h: data.decisive, zoom: 1, centre: null });
    Object.assign(this, { marks: true, boxes: true, robots: true, wipe: false, split: data.size / 2 });
    Object.assign(this, { timer: null, remark: "", unpacked: new Map() });
    this.chosen = Array.from({ length: MOST_PANELS }, (_, at) => (at < data.trackers.length ? at : NONE));
    this.build();
  }

  build() {
    const { moments, horizons_s: horizons } = this.data;
    this.time = slider("time", moments.length - 1, (at) => this.go({ moment: at }));
    this.horizon = slider("horizon", horizons.length - 1, (at) => this.go({ h: at }));
    this.playButton = button("play", () => this.play(!this.timer));
    this.menus = this.chosen.map((_, at) => this.trackerMenu(at));
    this.jumps = new Map([[WORST, "worst of the first"], [MOST_DIFFERENT, "most different of the first two"]]
      .map(([kind, words]) => [kind, button(words, () => this.jump(kind))]));
    this.wipeSlider = slider("wipe", this.data.size, (column) => this.go({ split: column }));
    this.why = make("output", { class: "why" });
    const zooms = [[1, "all that fits"], [2, "twice"], [4, "four times"]];
    this.zoomMenu = menu("zoom", zooms, 1, (zoom) => this.go({ zoom }));
    this.element.append(
      make("div", { class: "controls" }, this.playButton, this.time.element, this.horizon.element),
      make("div", { class: "controls" }, ...this.menus.map((one) => one.element)),
      make("div", { class: "controls" },
        ...this.jumps.values(), this.zoomMenu.element,
        check("hits and errors", true, (marks) => this.go({ marks })),
        check("boxes", true, (boxes) => this.go({ boxes })),
        ...(this.data.robots_at === null ? [] : [check("virtual robots", true, (robots) => this.go({ robots }))]),
        check("wipe between the first two", false, (wipe) => this.go({ wipe })),
        this.wipeSlider.element, this.why),
    );
    this.panels = make("div", { class: "moment-panels" });
    this.legend = markLegend(this.data.hidden_known);
    this.robotLegend = robotsLegend();
    const left = this.data.kept - moments.length;
    const kept = left ? `${moments.length} of ${this.data.kept} kept moments fit on the page. ` : "";
    this.element.append(this.panels, this.legend, this.robotLegend, make("p", { class: "note" }, kept,
      `Hits and errors: ${this.data.stratum || "visible"} cells. Arrow keys: time, horizon; space: play; click: zoom; shift and arrows move it. `,
      meaning("moments")));
    this.element.tabIndex = 0;
    this.element.setAttribute("role", "group");
    this.element.setAttribute("aria-label", `Moments of ${this.data.recording}`);
    this.element.addEventListener("keydown", (event) => this.key(event));
  }

  // Another recording's player replaces this one.
  leave() {
    this.play(false);
    this.element.hidden = true;
  }

  trackerMenu(at) {
    const options = [[NONE, "none"], ...this.data.names.map((name, index) => [index, name])];
    return menu(`tracker ${at + 1}`, options, this.chosen[at], (value) => {
      this.chosen[at] = value;
      this.arrange();
      this.keep();
    });
  }

  isOnPage(tracker) {
    return tracker !== NONE && isShown(this.data.trackers[tracker]);
  }

  // The trackers on screen: chosen, and not hidden by the page.
  get shown() {
    return this.chosen.filter((tracker) => this.isOnPage(tracker));
  }

  // A chosen tracker that the page hides is "none" until the page shows it again.
  fillMenus() {
    this.menus.forEach(({ select }, at) => {
      [...select.options].slice(1).forEach((option, tracker) => { option.disabled = !this.isOnPage(tracker); });
      select.value = String(this.isOnPage(this.chosen[at]) ? this.chosen[at] : NONE);
    });
  }

  arrange() {
    this.remark = "";
    this.fillMenus();
    const shown = this.shown;
    const wiped = this.wipe && shown.length > 1;
    this.drawn = [
      { panel: new MomentCanvas("input"), draw: (drawing) => drawing.input() },
      { panel: new MomentCanvas("observed"), draw: (drawing) => drawing.target(cameColour, "observed") },
    ];
    if (this.data.hidden_known) {
      this.drawn.push({ panel: new MomentCanvas("truth"), draw: (drawing) => drawing.target(truthColour, "truth") });
    }
    if (wiped) {
      this.drawn.push({ panel: new MomentCanvas(""), draw: (drawing) => drawing.wipe(shown[0], shown[1]), wipes: true });
    }
    for (const tracker of wiped ? shown.slice(2) : shown) {
      this.drawn.push({ panel: new MomentCanvas(""), draw: (drawing) => drawing.forecast(tracker) });
    }
    this.panels.replaceChildren(...this.drawn.map(({ panel }) => panel.element));
    for (const { panel, wipes } of this.drawn) (wipes ? this.dragWipe(panel) : this.clickCentres(panel));
    this.wipeSlider.element.hidden = !wiped;
    this.show();
  }

  // A change by the user.
  go(change) {
    this.change(change);
    this.keep();
  }

  change(change) {
    const wiped = this.wipe;
    if ("moment" in change || "h" in change) this.remark = "";
    Object.assign(this, change);
    if (wiped !== this.wipe) this.arrange();
    else this.show();
  }

  // The moment of this kind for the first trackers on screen; its line has their names.
  outstanding(kind) {
    const trackers = this.shown.slice(0, kind.trackers);
    if (trackers.length < kind.trackers) return { remark: ": too few trackers are shown" };
    const found = outstandingMoment(this.data, kind, this.h, trackers);
    const of = trackers.map((tracker) => this.data.names[tracker]).join(" and ");
    if (!found) return { remark: `: no ${kind.name} moment of ${of}` };
    const again = this.onward ? "; again: of the next recording" : "";
    return { moment: found.moment, remark: `, the ${kind.name} of ${of} ${this.ahead}${again}` };
  }

  // To the moment of this kind, or to another recording's if it is already on screen.
  jump(kind) {
    const found = this.outstanding(kind);
    if (this.onward && found.remark === this.remark) this.onward(kind);
    else this.go(found);
  }

  // `jump` from the player of another recording, where this button had the focus.
  arrive(kind) {
    this.go(this.outstanding(kind));
    this.jumps.get(kind).focus();
  }

  // To the most interesting moment.
  begin() {
    const found = [MOST_DIFFERENT, WORST].map((kind) => this.outstanding(kind)).find(({ moment }) => moment !== undefined);
    if (!found) return;
    this.moment = found.moment;
    this.approach();
    this.change(found);
  }

  get ahead() {
    return `+${inSeconds(this.data.horizons_s[this.h])}`;
  }

  play(playing) {
    clearInterval(this.timer);
    this.timer = playing ? setInterval(() => this.go({ moment: (this.moment + 1) % this.data.moments.length }), PLAY_MS) : null;
    this.playButton.textContent = playing ? "pause" : "play";
  }

  key(event) {
    const own = event.target === this.element;
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (!own || !(event.key === " " || event.key in steps) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    if (event.key === " ") return this.play(!this.timer);
    const [x, y] = steps[event.key];
    if (event.shiftKey) return this.pan(x, y);
    const within = (value, last) => Math.min(Math.max(value, 0), last);
    this.go({
      moment: within(this.moment + x, this.data.moments.length - 1), h: within(this.h + y, this.data.horizons_s.length - 1),
    });
  }

  pan(x, y) {
    const { left, bottom, span } = this.view();
    this.go({ centre: [left + span / 2 + (x * span) / 8, bottom + span / 2 + (y * span) / 8] });
  }

  // The position of the pointer on a panel, in cells from the lower left corner of the window.
  placeOn(panel, event) {
    const { left, bottom, span } = this.view();
    const box = panel.canvas.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width, y = 1 - (event.clientY - box.top) / box.height;
    return [left + x * span, bottom + y * span];
  }

  clickCentres(panel) {
    panel.canvas.addEventListener("click", (event) => this.go({ centre: this.placeOn(panel, event) }));
  }

  dragWipe(panel) {
    panel.canvas.classList.add("wipes");
    const drag = (event) => {
      if (!(event.buttons & 1)) return;
      if (event.type === "pointerdown") panel.canvas.setPointerCapture(event.pointerId);
      const [column] = this.placeOn(panel, event);
      this.go({ split: Math.round(Math.min(Math.max(column, 0), this.data.size)) });
    };
    for (const kind of ["pointerdown", "pointermove"]) panel.canvas.addEventListener(kind, drag);
  }

  // The visible part of the window, in whole cells: as many as fit with cells of LEAST_CELL_PX, divided by the zoom.
  view() {
    const { size } = this.data;
    const fits = Math.min(size, Math.floor(this.drawn[0].panel.canvas.clientWidth / LEAST_CELL_PX) || size);
    const span = Math.max(4, Math.floor(fits / this.zoom));
    const [x, y] = this.centre ?? [size / 2, size / 2];
    const low = (middle) => Math.round(Math.min(Math.max(middle - span / 2, 0), size - span));
    return { left: low(x), bottom: low(y), span };
  }

  // Near enough to the contacts of the moment to see a person; without contacts as before.
  approach() {
    const { size, cell_m: cell } = this.data;
    if (!contactCell(this.data, this.moment)) return;
    this.centre = null;
    this.zoom = [4, 2].find((zoom) => (size * cell) / zoom >= CLOSE_M) ?? 1;
    this.zoomMenu.select.value = String(this.zoom);
  }

  async planes(moment) {
    if (!this.unpacked.has(moment)) this.unpacked.set(moment, unpackedMoment(this.data, this.data.moments[moment]));
    return this.unpacked.get(moment);
  }

  async show() {
    const { moment, h, data } = this;
    if (!this.element.clientWidth) return;
    const planes = await this.planes(moment);
    if (moment !== this.moment || h !== this.h) return;
    this.centre ??= contactCell(data, moment) ?? busiestCell(data, planes);
    const view = this.view();
    for (const { panel, draw } of this.drawn) {
      panel.prepare(view);
      draw(new MomentDrawing(this, panel, planes));
    }
    const { t } = data.moments[moment];
    this.time.input.value = moment;
    this.time.output.textContent = `${t.toFixed(1)} s`;
    this.horizon.input.value = h;
    this.horizon.output.textContent = this.ahead;
    this.wipeSlider.input.value = this.split;
    this.legend.hidden = !this.marks;
    this.robotLegend.hidden = !(this.robots && h === data.robots_at);
    this.why.textContent = `moment ${moment + 1} of ${data.moments.length}${this.remark}`;
    this.element.dataset.ready = `${moment} ${h}`;
  }

  // The moment on screen goes into the address.
  keep() {
    const { recording, trackers, horizons_s: horizons, moments } = this.data;
    const labels = this.shown.map((tracker) => trackers[tracker]);
    keepInAddress(IN_ADDRESS, [recording, moments[this.moment].t, horizons[this.h], ...labels]);
  }

  // The choices that carry over to another recording: the labels of trackers, and the horizon in seconds.
  get choice() {
    const trackers = this.chosen.filter((tracker) => tracker !== NONE).map((tracker) => this.data.trackers[tracker]);
    return { trackers, horizon: this.data.horizons_s[this.h] };
  }

  // Chooses the nearest horizon and the trackers of this recording; without any of them, keeps its own.
  choose({ trackers, horizon }) {
    const known = trackers.map((label) => this.data.trackers.indexOf(label)).filter((at) => at >= 0);
    if (known.length) this.chosen = this.chosen.map((_, at) => known[at] ?? NONE);
    this.h = nearest(this.data.horizons_s, horizon);
  }

  // Opens the kept moment nearest to the time of a link.
  open(link) {
    this.choose(link);
    this.moment = nearest(this.data.moments.map(({ t }) => t), link.seconds);
    this.approach();
    this.arrange();
    this.element.scrollIntoView();
    return this;
  }
}

// Controls: real buttons, sliders and labels.
function button(words, onClick) {
  const element = make("button", { type: "button" }, words);
  element.addEventListener("click", onClick);
  return element;
}

function slider(words, last, onInput) {
  const input = make("input", { type: "range", min: 0, max: last, step: 1, "aria-label": words });
  const output = make("output", {});
  input.addEventListener("input", () => onInput(Number(input.value)));
  return { input, output, element: make("label", { class: "slider" }, words, input, output) };
}

function check(words, checked, onChange) {
  const input = make("input", { type: "checkbox" });
  input.checked = checked;
  input.addEventListener("change", () => onChange(input.checked));
  return make("label", {}, input, words);
}

// A menu of `options`, [value, text] each.
function menu(words, options, chosen, onChange) {
  const select = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  select.value = String(chosen);
  select.addEventListener("change", () => onChange(Number(select.value)));
  return { select, element: make("label", { class: "menu" }, words, select) };
}

function markLegend(hidden) {
  const names = Object.keys(MARK_COLOURS).filter((name) =>
    !name.startsWith("hidden") || hidden || name === "hidden, not scored");
  return make("div", { class: "legend marks-legend" }, ...names.map((name) => {
    const key = make("i", { class: name.includes("miss") ? "key hollow" : "key" });
    key.style.backgroundColor = key.style.borderColor = cssColour(MARK_COLOURS[name]);
    return make("span", {}, key, name);
  }));
}
