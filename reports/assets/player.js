// The player of one recording: kept forecasts over time and horizon, one to four trackers side by side.
import { make, meaning } from "./elements.js";
import { isShown } from "./shown_trackers.js";
import { button, check, markLegend, menu, slider } from "./player_controls.js";
import { MomentCanvas } from "./moment_canvas.js";
import {
  unpackedMoment, inputColour, cameColour, truthColour, forecastColour, markColour, busiestCell,
} from "./moment_cells.js";
import { scoreText, tellingMoment, worstMoment } from "./moment_scores.js";
import { linkOf } from "./moment_link.js";

const MOST_PANELS = 4;
const LEAST_CELL_PX = 4;
const PLAY_MS = 700;
const NONE = -1;
const inSeconds = (seconds) => `${Number(seconds.toPrecision(3))} s`;

export class Player {
  constructor(element, data) {
    Object.assign(this, { element, data, moment: 0, h: data.decisive, zoom: 1, centre: null, split: data.size / 2 });
    Object.assign(this, { marks: true, boxes: true, wipe: false, timer: null, told: "", unpacked: new Map() });
    this.chosen = Array.from({ length: MOST_PANELS }, (_, at) => (at < data.trackers.length ? at : NONE));
    this.build();
  }

  build() {
    const { moments, horizons_s: horizons } = this.data;
    this.time = slider("time", moments.length - 1, (at) => this.go({ moment: at }));
    this.horizon = slider("horizon", horizons.length - 1, (at) => this.go({ h: at }));
    this.playButton = button("play", () => this.play(!this.timer));
    this.menus = this.chosen.map((tracker, at) => this.trackerMenu(tracker, at));
    this.link = make("a", { href: "#" }, "link to this moment");
    this.wipeSlider = slider("wipe", this.data.size, (column) => this.go({ split: column }));
    this.why = make("output", { class: "why" });
    const zooms = [[1, "all that fits"], [2, "twice"], [4, "four times"]];
    this.zoomMenu = menu("zoom", zooms, 1, (zoom) => this.go({ zoom }));
    this.element.append(
      make("div", { class: "controls" }, this.playButton, this.time.element, this.horizon.element),
      make("div", { class: "controls" }, ...this.menus.map((one) => one.element)),
      make("div", { class: "controls" },
        button("worst of the first", () => this.jump("worst", worstMoment, 1)),
        button("most telling of the first two", () => this.jump("most telling", tellingMoment, 2)),
        this.zoomMenu.element,
        check("hits and errors", true, (marks) => this.go({ marks })),
        check("boxes", true, (boxes) => this.go({ boxes })),
        check("wipe between the first two", false, (wipe) => this.go({ wipe })),
        this.wipeSlider.element, this.link, this.why),
    );
    this.panels = make("div", { class: "moment-panels" });
    this.legend = markLegend(this.data.hidden_known);
    const left = this.data.kept - moments.length;
    const kept = left ? `${moments.length} of ${this.data.kept} kept moments fit on the page. ` : "";
    this.element.append(this.panels, this.legend, make("p", { class: "note" }, kept,
      `Hits and errors: ${this.data.stratum || "visible"} cells. Arrow keys: time, horizon; space: play; click: zoom; shift and arrows move it. `,
      meaning("moments")));
    this.element.tabIndex = 0;
    this.element.setAttribute("role", "group");
    this.element.setAttribute("aria-label", `Moments of ${this.data.recording}`);
    this.element.addEventListener("keydown", (event) => this.key(event));
  }

  // Another recording's player takes its place.
  leave() {
    this.play(false);
    this.element.hidden = true;
  }

  trackerMenu(tracker, at) {
    const options = [[NONE, "none"], ...this.data.trackers.map((label, index) => [index, label])];
    return menu(`tracker ${at + 1}`, at ? options : options.slice(1), tracker, (value) => {
      this.chosen[at] = value;
      this.arrange();
    });
  }

  // The trackers on screen: those chosen that the page shows.
  get shown() {
    return this.chosen.filter((tracker) => tracker !== NONE && isShown(this.data.trackers[tracker]));
  }

  arrange() {
    this.told = "";
    const shown = this.shown;
    const wiped = this.wipe && shown.length > 1;
    this.drawn = [
      { panel: new MomentCanvas("input"), draw: (one, planes) => this.drawInput(one, planes) },
      { panel: new MomentCanvas("what came"), draw: (one, planes) => this.drawTarget(one, planes, cameColour, "what came") },
    ];
    if (this.data.hidden_known) {
      this.drawn.push({ panel: new MomentCanvas("truth"), draw: (one, planes) => this.drawTarget(one, planes, truthColour, "truth") });
    }
    if (wiped) {
      this.drawn.push({ panel: new MomentCanvas(""), draw: (one, planes) => this.drawWipe(one, planes, shown[0], shown[1]), wipes: true });
    }
    for (const tracker of wiped ? shown.slice(2) : shown) {
      this.drawn.push({ panel: new MomentCanvas(""), draw: (one, planes) => this.drawForecast(one, planes, tracker) });
    }
    this.panels.replaceChildren(...this.drawn.map(({ panel }) => panel.element));
    for (const { panel, wipes } of this.drawn) (wipes ? this.dragWipe(panel) : this.clickCentres(panel));
    this.wipeSlider.element.hidden = !wiped;
    this.show();
  }

  go(change) {
    const wiped = this.wipe;
    if ("moment" in change || "h" in change) this.told = "";
    Object.assign(this, change);
    if (wiped !== this.wipe) this.arrange();
    else this.show();
  }

  // To the moment that `find` has of the first `count` trackers on screen, whose names the line of the moment then has.
  jump(kind, find, count) {
    const trackers = this.shown.slice(0, count);
    const moment = trackers.length === count ? find(this.data, this.h, ...trackers) : null;
    const of = trackers.map((tracker) => this.data.trackers[tracker]).join(" and ");
    if (moment !== null) this.go({ moment, told: `, the ${kind} of ${of} ${this.ahead}` });
    else this.go({ told: trackers.length < count ? ": too few trackers are shown" : `: no ${kind} moment of ${of}` });
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

  // The place of the pointer on a panel, in cells from the lower left corner of the window.
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

  // The part of the window on screen, whole cells: as much as fits with cells of LEAST_CELL_PX, divided by the zoom.
  view() {
    const { size } = this.data;
    const fits = Math.min(size, Math.floor(this.drawn[0].panel.canvas.clientWidth / LEAST_CELL_PX) || size);
    const span = Math.max(4, Math.floor(fits / this.zoom));
    const [x, y] = this.centre ?? [size / 2, size / 2];
    const low = (middle) => Math.round(Math.min(Math.max(middle - span / 2, 0), size - span));
    return { left: low(x), bottom: low(y), span };
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
    this.centre ??= busiestCell(data, planes);
    const view = this.view();
    for (const { panel, draw } of this.drawn) {
      panel.prepare(view);
      draw(panel, planes);
    }
    const { t } = data.moments[moment];
    this.time.input.value = moment;
    this.time.output.textContent = `${t.toFixed(1)} s`;
    this.horizon.input.value = h;
    this.horizon.output.textContent = this.ahead;
    this.wipeSlider.input.value = this.split;
    this.legend.hidden = !this.marks;
    this.why.textContent = `moment ${moment + 1} of ${data.moments.length}${this.told}`;
    const trackers = this.shown.map((tracker) => data.trackers[tracker]);
    this.link.href = linkOf({ recording: data.recording, seconds: t, horizon: data.horizons_s[h], trackers });
    this.element.dataset.ready = `${moment} ${h}`;
  }

  inCells([x, y]) {
    return [(x - this.data.origin[0]) / this.data.cell_m, (y - this.data.origin[1]) / this.data.cell_m];
  }

  drawInput(panel, planes) {
    const { trackers, moments } = this.data;
    panel.cells(this.data.size, (at) => inputColour(planes.input[at]));
    panel.sensors(moments[this.moment].sensors.map((point) => this.inCells(point)));
    const tracking = this.boxes ? this.shown.find((tracker) => moments[this.moment].objects[tracker].length) : undefined;
    if (tracking !== undefined) panel.objects(this.objectsOf(tracking), 0);
    panel.words(tracking === undefined ? "input" : `input, tracks of ${trackers[tracking]}`, `${moments[this.moment].t.toFixed(1)} s`);
  }

  drawTarget(panel, planes, colour, title) {
    const target = planes.target(this.h);
    panel.cells(this.data.size, (at) => colour(target[at]));
    panel.words(title, `${inSeconds(this.data.horizons_s[this.h])} later`);
  }

  paint(panel, planes, tracker, from, to) {
    const { size, stratum } = this.data;
    const forecast = planes.forecast(this.h, tracker), target = planes.target(this.h);
    const colour = this.marks ? (at) => markColour(forecast[at], target[at], stratum) : (at) => forecastColour(forecast[at]);
    panel.cells(size, colour, from, to);
    if (this.marks) panel.misses(size, forecast, target, stratum, from, to);
  }

  isMissing(tracker) {
    return this.data.moments[this.moment].missing.includes(this.data.trackers[tracker]);
  }

  drawForecast(panel, planes, tracker) {
    const label = this.data.trackers[tracker];
    if (this.isMissing(tracker)) {
      panel.context.clearRect(0, 0, panel.canvas.width, panel.canvas.height);
      return panel.words(label, "no forecast here");
    }
    this.paint(panel, planes, tracker, 0, this.data.size);
    if (this.boxes) panel.objects(this.objectsOf(tracker), this.data.horizons_s[this.h]);
    panel.words(label, scoreText(this.data, this.moment, this.h, tracker));
  }

  drawWipe(panel, planes, left, right) {
    this.paint(panel, planes, left, 0, this.split);
    this.paint(panel, planes, right, this.split, this.data.size);
    panel.line(this.split);
    const [one, other] = [left, right].map((tracker) => this.data.trackers[tracker]);
    panel.words(`${one} | ${other}`, [left, right].map((t) => scoreText(this.data, this.moment, this.h, t)).join(" | "));
  }

  objectsOf(tracker) {
    const { cell_m: cell } = this.data;
    return this.data.moments[this.moment].objects[tracker].map(([track, px, py, heading, length, width, vx, vy]) => {
      const [x, y] = this.inCells([px, py]);
      return { track, x, y, heading, length: length / cell, width: width / cell, vx: vx / cell, vy: vy / cell };
    });
  }

  // Of the trackers that are chosen.
  get labels() {
    return this.chosen.filter((tracker) => tracker !== NONE).map((tracker) => this.data.trackers[tracker]);
  }

  // Chooses the trackers with these labels that this recording has; where it has none of them, the choice stays.
  choose(labels) {
    const known = labels.map((label) => this.data.trackers.indexOf(label)).filter((at) => at >= 0).slice(0, MOST_PANELS);
    if (known.length) this.chosen = this.chosen.map((_, at) => known[at] ?? NONE);
    this.menus.forEach(({ select }, at) => { select.value = String(this.chosen[at]); });
  }

  // Opens the moment of a link: the kept one nearest to its time, and the trackers that this recording has.
  open({ seconds, horizon, trackers }) {
    const nearest = (values, wanted) =>
      values.reduce((best, value, at) => (Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? at : best), 0);
    this.choose(trackers);
    this.moment = nearest(this.data.moments.map(({ t }) => t), seconds);
    this.h = nearest(this.data.horizons_s, horizon);
    this.arrange();
    this.element.scrollIntoView();
  }
}
