// A drawing with a named row for each tracker or stratum, over one axis, and a number beside each row.
import { draw, heightOf, namedRows, roundTicks, scaleOf, svgText } from "./drawing.js";

const FOOT = 46;

// The drawing and its places: { svg, x, places, end }. `names` of the rows, at least `least` pixels high each; `range` and
// name `axis` of the axis, which ends `room` pixels before the right edge, at `end`; `beside`: the heading of the numbers
// there, if they have one; `words` describe the drawing. `ticks(x)`: [place, text] pairs, by default round
// values with `tickText`.
export function rowPlot({ names, least, range, axis, room, beside, words, width, ticks, tickText = String }) {
  const narrow = width < 560, left = narrow ? 124 : 210, end = width - room;
  const x = scaleOf(...range, left, end), places = namedRows(names, left - 12, least);
  const height = heightOf(places) + FOOT, bottom = height - FOOT + 4;
  const svg = draw("svg", { class: "figure-drawing", viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": words });
  for (const [place, text] of ticks?.(x) ?? roundTicks(...range, narrow ? 3 : 6).map((tick) => [tick, tickText(tick)])) {
    svg.append(draw("line", { class: "grid", x1: x(place), x2: x(place), y1: 0, y2: bottom }),
      svgText(x(place), bottom + 16, text, { class: "tick", "text-anchor": "middle" }));
  }
  svg.append(svgText(end, height - 5, axis, { class: "axis-name", "text-anchor": "end" }));
  if (beside) svg.append(svgText(width, bottom + 16, beside, { class: "tick", "text-anchor": "end" }));
  return { svg, x, places, end };
}
