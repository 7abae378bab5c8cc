// Maps from values to positions, and the round numbers beside them.
import { draw } from "./elements.js";

// A linear map of [low, high] to [start, end].
export function scaleOf(low, high, start, end) {
  const span = high - low || 1;
  return (value) => start + ((value - low) / span) * (end - start);
}

// Round values within [low, high], about `wanted` of them.
export function roundTicks(low, high, wanted) {
  const rough = (high - low) / wanted || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((value) => value >= rough);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i += 1) ticks.push(Number((i * step).toPrecision(6)));
  return ticks;
}

// The index of the value that is nearest to `wanted`, of equally near ones the first.
export function nearest(values, wanted) {
  return values.reduce((best, value, i) => (Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? i : best), 0);
}

// The range of an axis over `values`: whole steps; scores between 0 and 1 start at 0.
export function axisRange(values, fromZero) {
  const known = values.filter((value) => value !== null);
  if (!known.length) return [0, 1];
  let [low, high] = [Math.min(...known), Math.max(...known)];
  if (fromZero) low = Math.min(low, 0);
  const room = (high - low) * 0.05 || 0.05;
  return [fromZero && low === 0 ? 0 : low - room, high + room];
}

export function svgText(x, y, text, attributes = {}) {
  return draw("text", { x, y, ...attributes }, text);
}

export const inSeconds = (seconds) => `${Number(seconds.toPrecision(3))} s`;

// A score in words, with a dash where it is undefined.
export function inDigits(value, digits = 3) {
  return value === null || value === undefined ? "–" : value.toFixed(digits);
}
