// Moments: links to them, their scores, and the moments that stand out by these.
// A link to a moment: #t=recording,seconds,horizon,tracker,... with each part escaped.
export function linkOf({ recording, seconds, horizon, trackers }) {
  return `#t=${[recording, seconds, horizon, ...trackers].map((part) => encodeURIComponent(part)).join(",")}`;
}

// The moment that a link names; null if it names none.
export function momentOfLink(hash) {
  if (!hash.startsWith("#t=")) return null;
  try {
    const [recording, seconds, horizon, ...trackers] = hash.slice(3).split(",").map(decodeURIComponent);
    const found = { recording, seconds: Number(seconds), horizon: Number(horizon), trackers };
    return Number.isFinite(found.seconds) && Number.isFinite(found.horizon) ? found : null;
  } catch {
    return null;
  }
}

export function countsOf(player, moment, h, tracker) {
  return player.moments[moment].counts[h][tracker];
}

// F1 of one moment alone; null if there is no score, or nothing was occupied or called.
export function momentF1(player, moment, h, tracker) {
  const counts = countsOf(player, moment, h, tracker);
  if (!counts) return null;
  const [tp, fp, fn] = counts;
  return tp + fp + fn === 0 ? null : (2 * tp) / (2 * tp + fp + fn);
}

export function scoreText(player, moment, h, tracker) {
  const counts = countsOf(player, moment, h, tracker);
  if (!counts) return "not scored here";
  const f1 = momentF1(player, moment, h, tracker);
  const [tp, fp, fn] = counts;
  return `F1 ${f1 === null ? "–" : f1.toFixed(2)}: ${tp} hit, ${fp} false, ${fn} missed`;
}

// Kinds of moments that stand out by the first `trackers` on screen: the higher the `value`, the more, and where it is
// null, not at all. The worst has the lowest F1, where something was to be found; in the most different, F1 differs most.
// Both come last where few cells were to be found: F1 of one cell is 0 or 1 by chance.
const FEW_CELLS = 5;
const AFTER_ALL_OTHERS = 2;

export const WORST = {
  name: "worst",
  trackers: 1,
  value(player, moment, h, [tracker]) {
    const counts = countsOf(player, moment, h, tracker);
    return counts && counts[0] + counts[2] ? -momentF1(player, moment, h, tracker) : null;
  },
};
export const MOST_DIFFERENT = {
  name: "most different",
  trackers: 2,
  value(player, moment, h, trackers) {
    const [one, other] = trackers.map((tracker) => momentF1(player, moment, h, tracker));
    return one === null || other === null ? null : Math.abs(one - other) || null;
  },
};

// The first moment that stands out most, { moment, value }; null if none does.
export function outstandingMoment(player, kind, h, trackers) {
  let best = null;
  player.moments.forEach((_, moment) => {
    const standsOut = kind.value(player, moment, h, trackers);
    if (standsOut === null) return;
    const [found, , missed] = countsOf(player, moment, h, trackers[0]);
    const value = found + missed < FEW_CELLS ? standsOut - AFTER_ALL_OTHERS : standsOut;
    if (best === null || value > best.value) best = { moment, value };
  });
  return best;
}
