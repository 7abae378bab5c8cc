// One panel of the player: cells on a canvas, each a whole square, with sensors and objects over them.
import { make } from "./elements.js";
import { markOf, MARK_COLOURS, cssColour } from "./moment_cells.js";

const OBJECT_COLOUR = "#0a7a4f";
const cellBuffer = document.createElement("canvas");

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

  // What `paint` draws, in the columns [from, to) alone.
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

  // Misses are hollow: told from false alarms by form as well as by colour.
  misses(size, forecast, target, stratum) {
    this.context.fillStyle = "#fff";
    target.forEach((code, cell) => {
      if (!markOf(forecast[cell], code, stratum).includes("miss")) return;
      const [x, y] = this.at((cell % size) + 0.3, Math.floor(cell / size) + 0.7);
      this.context.fillRect(x, y, 0.4 * this.cell, 0.4 * this.cell);
    });
  }

  // A form without a direction: nobody knows where a sensor looks.
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

  // Each object, dashed where it is now and solid where it is in `seconds`; lengths in cells.
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
