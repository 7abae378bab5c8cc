// The content of a panel of the player: input, observed frame or forecasts of a moment; and the canvas of a panel.
import { draw, inSeconds, make } from "./drawing.js";
import { cssColour, forecastColour, inputColour, MARK_COLOURS, markColour, markOf } from "./moment_cells.js";
import { contactsOf, FORESEEN, MISSED, NEEDLESS, robotsOf, robotWords, scoreText, TOUCHED } from "./moments.js";

const OBJECT_COLOUR = "#0a7a4f";
// Kinds of paths differ in form as well as in colour: dashes, and a disc or a ring at the contact.
const ROBOT_STYLES = {
  [FORESEEN]: { colour: cssColour(MARK_COLOURS.hit), end: "disc", dash: [] },
  [MISSED]: { colour: cssColour(MARK_COLOURS.miss), end: "ring", dash: [] },
  [NEEDLESS]: { colour: cssColour(MARK_COLOURS["false alarm"]), end: "", dash: [2, 3] },
  [TOUCHED]: { colour: "#4a4d52", end: "disc", dash: [] },
};
const cellBuffer = document.createElement("canvas");

// The keys of the paths of robots.
export function robotsLegend() {
  return make("div", { class: "legend robots-legend" }, ...Object.entries(ROBOT_STYLES).map(([name, { colour, end, dash }]) => {
    const key = draw("svg", { class: "key", viewBox: "0 0 24 10", width: 24, height: 10, "aria-hidden": "true" },
      draw("line", { x1: 1, y1: 5, x2: 18, y2: 5, "stroke-dasharray": dash.join(" ") }));
    if (end) key.append(draw("circle", { class: end, cx: 18, cy: 5, r: 3 }));
    key.style.stroke = key.style.color = colour;
    return make("span", {}, key, name);
  }));
}

export class MomentDrawing {
  // The choices come from `player`, the content goes to `panel`, the cells come from the `planes` of the moment.
  constructor(player, panel, planes) {
    const { data, moment, h, marks, boxes, robots, split, shown, pathsThroughout: throughout = false } = player;
    Object.assign(this, { data, moment, h, marks, boxes, split, shown, panel, planes });
    this.hasRobots = robots && (throughout || h === data.robots_at);
    this.kept = data.moments[moment];
    this.ahead_s = data.horizons_s[h];
  }

  input() {
    this.panel.cells(this.data.size, (at) => inputColour(this.planes.input[at]));
    this.panel.sensors(this.kept.sensors.map((point) => this.inCells(point)));
    const tracking = this.boxes ? this.shown.find((tracker) => this.kept.objects[tracker].length) : undefined;
    if (tracking !== undefined) this.panel.objects(this.objectsOf(tracking), 0);
    const of = tracking === undefined ? "" : `, tracks of ${this.data.names[tracking]}`;
    this.panel.words(`input${of}`, `${this.kept.t.toFixed(1)} s`);
  }

  target(colour, title) {
    const target = this.planes.target(this.h);
    this.panel.cells(this.data.size, (at) => colour(target[at]));
    if (this.hasRobots) this.panel.robots(this.inWindow(contactsOf(this.data, this.moment)));
    this.panel.words(title, `${inSeconds(this.ahead_s)} later`);
  }

  // `words`: in place of the score.
  forecast(tracker, words = null) {
    this.columns(tracker, 0, this.data.size);
    this.panel.words(this.data.names[tracker], words ?? this.scoreOf(tracker));
  }

  // Two forecasts, each on its side of the split.
  wipe(left, right) {
    this.columns(left, 0, this.split);
    this.columns(right, this.split, this.data.size);
    this.panel.line(this.split);
    const both = (of) => [left, right].map(of).join(" | ");
    this.panel.words(both((tracker) => this.data.names[tracker]), both((tracker) => this.scoreOf(tracker)));
  }

  // The forecast of a tracker and its objects, in the columns [from, to).
  columns(tracker, from, to) {
    this.panel.within(from, to, () => {
      if (this.isMissing(tracker)) return this.panel.clear();
      this.cells(tracker);
      if (this.boxes) this.panel.objects(this.objectsOf(tracker), this.ahead_s);
      if (this.hasRobots) this.panel.robots(this.inWindow(robotsOf(this.data, this.moment, tracker) ?? []));
    });
  }

  cells(tracker) {
    const { size, stratum } = this.data;
    const forecast = this.planes.forecast(this.h, tracker), target = this.planes.target(this.h);
    const marked = (at) => markColour(forecast[at], target[at], stratum);
    this.panel.cells(size, this.marks ? marked : (at) => forecastColour(forecast[at]));
    if (this.marks) this.panel.misses(size, forecast, target, stratum);
  }

  isMissing(tracker) {
    return this.kept.missing.includes(this.data.trackers[tracker]);
  }

  scoreOf(tracker) {
    if (this.isMissing(tracker)) return "no forecast here";
    const contacts = this.hasRobots ? robotWords(this.data, this.moment, tracker) : "";
    return `${scoreText(this.data, this.moment, this.h, tracker)}${contacts}`;
  }

  inCells([x, y]) {
    const { origin, cell_m: cell } = this.data;
    return [(x - origin[0]) / cell, (y - origin[1]) / cell];
  }

  // Paths of robots in cells, from their start to their end.
  inWindow(paths) {
    return paths.map(({ place: [x, y], velocity: [vx, vy], until_s, kind }) =>
      ({ kind, from: this.inCells([x, y]), to: this.inCells([x + until_s * vx, y + until_s * vy]) }));
  }

  objectsOf(tracker) {
    const { cell_m: cell } = this.data;
    return this.kept.objects[tracker].map(([track, px, py, heading, length, width, vx, vy]) => {
      const [x, y] = this.inCells([px, py]);
      return { track, x, y, heading, length: length / cell, width: width / cell, vx: vx / cell, vy: vy / cell };
    });
  }
}

// `view`: { left, bottom, span } in cells. Cell [row, column] is drawn with row 0 at the bottom.
function paintCells(size, colourAt) {
  cellBuffer.width = cellBuffer.height = size;
  const context = cellBuffer.getContext("2d");
  const image = context.createImageData(size, size);
  for (let row = 0; row < size; row += 1) {
    for (let column = 0; column < size; column += 1) {
      const [red, green, blue] = colourAt(row * size + column);
      image.data.set([red, green, blue, 255], 4 * ((size - 1 - row) * size + column));
    }
  }
  context.putImageData(image, 0, 0);
}

export class MomentCanvas {
  constructor(title) {
    this.canvas = make("canvas", { role: "img" });
    this.title = make("span", {});
    this.score = make("small", {});
    this.title.textContent = title;
    this.element = make("figure", { class: "moment-panel" }, make("figcaption", {}, this.title, this.score), this.canvas);
  }

  // The side of the panel in device pixels, and of a cell.
  prepare(view) {
    const side = Math.round(this.canvas.clientWidth * (window.devicePixelRatio || 1));
    if (side && this.canvas.width !== side) this.canvas.width = this.canvas.height = side;
    this.cell = this.canvas.width / view.span;
    this.view = view;
    this.context = this.canvas.getContext("2d");
    this.context.imageSmoothingEnabled = false;
  }

  // The drawing of `paint`, in the columns [from, to) alone.
  within(from, to, paint) {
    const { context } = this;
    const [left, right] = [from, to].map((column) => Math.round(this.at(column, 0)[0]));
    context.save();
    context.beginPath();
    context.rect(left, 0, right - left, this.canvas.height);
    context.clip();
    paint();
    context.restore();
  }

  clear() {
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  cells(size, colourAt) {
    paintCells(size, colourAt);
    const { left, bottom, span } = this.view, { width, height } = this.canvas;
    this.context.drawImage(cellBuffer, left, size - bottom - span, span, span, 0, 0, width, height);
  }

  // The position of a point, in cells from the lower left corner of the window, on the canvas.
  at(x, y) {
    return [(x - this.view.left) * this.cell, this.canvas.height - (y - this.view.bottom) * this.cell];
  }

  // Misses are hollow: they differ from false alarms by form as well as by colour.
  misses(size, forecast, target, stratum) {
    this.context.fillStyle = "#fff";
    target.forEach((code, cell) => {
      if (!markOf(forecast[cell], code, stratum).includes("miss")) return;
      const [x, y] = this.at((cell % size) + 0.3, Math.floor(cell / size) + 0.7);
      this.context.fillRect(x, y, 0.4 * this.cell, 0.4 * this.cell);
    });
  }

  // A form without a direction: the direction of a sensor is unknown.
  sensors(points) {
    const side = 1.6 * Math.max(this.cell, 4);
    for (const point of points) {
      const [x, y] = this.at(...point);
      this.context.beginPath();
      this.context.moveTo(x, y - side);
      this.context.lineTo(x + side, y);
      this.context.lineTo(x, y + side);
      this.context.lineTo(x - side, y);
      this.context.closePath();
      this.context.fillStyle = cssColour(MARK_COLOURS.hit);
      this.context.fill();
    }
  }

  // Each object, dashed at its present place and solid at its place in `seconds`; lengths in cells.
  objects(objects, seconds) {
    const context = this.context, scale = window.devicePixelRatio || 1;
    context.lineWidth = 1.5 * scale;
    context.font = `${Math.round(12 * scale)}px sans-serif`;
    for (const one of objects) {
      const then = { ...one, x: one.x + one.vx * seconds, y: one.y + one.vy * seconds };
      context.strokeStyle = OBJECT_COLOUR;
      if (seconds) {
        context.setLineDash([3 * scale, 3 * scale]);
        this.box(one);
        context.setLineDash([]);
        context.beginPath();
        context.moveTo(...this.at(one.x, one.y));
        context.lineTo(...this.at(then.x, then.y));
        context.stroke();
      }
      this.box(then);
      this.label(then);
    }
  }

  // Paths from `from` to `to`, in cells.
  robots(paths) {
    const context = this.context, scale = window.devicePixelRatio || 1;
    for (const { from, to, kind } of paths) {
      const { colour, end, dash } = ROBOT_STYLES[kind];
      context.strokeStyle = context.fillStyle = colour;
      context.lineWidth = 1.25 * scale;
      context.setLineDash(dash.map((length) => length * scale));
      context.beginPath();
      context.moveTo(...this.at(...from));
      context.lineTo(...this.at(...to));
      context.stroke();
      context.setLineDash([]);
      if (!end) continue;
      context.beginPath();
      context.arc(...this.at(...to), 2 * scale, 0, 2 * Math.PI);
      if (end === "ring") context.stroke();
      else context.fill();
    }
  }

  box({ x, y, heading, length, width }) {
    const { context, cell } = this;
    context.save();
    context.translate(...this.at(x, y));
    context.rotate(-heading); // y is up in the world and down on a canvas
    context.strokeRect((-length * cell) / 2, (-width * cell) / 2, length * cell, width * cell);
    context.restore();
  }

  label({ track, x, y, heading, length, width }) {
    const { context } = this;
    const [half, side] = [length / 2, width / 2];
    const right = Math.abs(half * Math.cos(heading)) + Math.abs(side * Math.sin(heading));
    const up = Math.abs(half * Math.sin(heading)) + Math.abs(side * Math.cos(heading));
    const place = this.at(x + right + 0.5, y + up);
    context.strokeStyle = "#fff"; // a halo: readable on every colour of a cell
    context.lineWidth *= 2;
    context.strokeText(String(track), ...place);
    context.lineWidth /= 2;
    context.fillStyle = OBJECT_COLOUR;
    context.fillText(String(track), ...place);
  }

  line(column) {
    const [x] = this.at(column, 0);
    this.context.fillStyle = "#000";
    this.context.fillRect(x - 1, 0, 2, this.canvas.height);
  }

  words(title, score) {
    this.title.textContent = title;
    this.score.textContent = score;
    this.canvas.setAttribute("aria-label", score ? `${title}: ${score}` : title);
  }
}
