// What a panel of the player shows of a moment: its input, what came, forecasts.
import { inSeconds } from "./axis.js";
import { forecastColour, inputColour, markColour } from "./moment_cells.js";
import { scoreText } from "./moment_scores.js";

export class MomentDrawing {
  // Of what is chosen in `player`, on a `panel`, from the `planes` of the moment.
  constructor(player, panel, planes) {
    const { data, moment, h, marks, boxes, split, shown } = player;
    Object.assign(this, { data, moment, h, marks, boxes, split, shown, panel, planes });
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
    this.panel.words(title, `${inSeconds(this.ahead_s)} later`);
  }

  forecast(tracker) {
    this.columns(tracker, 0, this.data.size);
    this.panel.words(this.data.names[tracker], this.scoreOf(tracker));
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
    return this.isMissing(tracker) ? "no forecast here" : scoreText(this.data, this.moment, this.h, tracker);
  }

  inCells([x, y]) {
    const { origin, cell_m: cell } = this.data;
    return [(x - origin[0]) / cell, (y - origin[1]) / cell];
  }

  objectsOf(tracker) {
    const { cell_m: cell } = this.data;
    return this.kept.objects[tracker].map(([track, px, py, heading, length, width, vx, vy]) => {
      const [x, y] = this.inCells([px, py]);
      return { track, x, y, heading, length: length / cell, width: width / cell, vx: vx / cell, vy: vy / cell };
    });
  }
}
