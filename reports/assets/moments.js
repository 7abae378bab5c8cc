// Moments: their place in the address, their scores, and the outstanding moments by score.
export const IN_ADDRESS = "t";
const ONE_PERSON_M = 1; // contacts nearer to each other are with one person

// The moment of the parts [recording, seconds, horizon, tracker, ...] of an address; null if they are none.
export function momentOfParts(parts) {
  const [recording, seconds, horizon, ...trackers] = parts ?? [];
  const found = { recording, seconds: Number(seconds), horizon: Number(horizon), trackers };
  return Number.isFinite(found.seconds) && Number.isFinite(found.horizon) ? found : null;
}

export function countsOf(player, moment, h, tracker) {
  return player.moments[moment].counts[h][tracker];
}

// The occupied cells in motion, which are the same for every tracker; 0 without a score.
export function occupiedCells(player, moment, h) {
  const [found, , missed] = player.moments[moment].counts[h].find((counts) => counts) ?? [0, 0, 0];
  return found + missed;
}

// F1 of one moment; null without a score, or if no cell was occupied or called occupied.
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

// The paths of virtual robots of a moment by the alarms of a tracker, { place, velocity, until_s, kind }; null without
// alarms. Kinds: FORESEEN and MISSED contacts, and NEEDLESS alarms on clear paths.
export const FORESEEN = "contact foreseen", MISSED = "contact missed", NEEDLESS = "needless alarm", TOUCHED = "contact";

export function robotsOf(player, moment, tracker) {
  const { paths, alarms } = player.moments[moment].robots ?? { alarms: [] };
  if (!alarms[tracker]) return null;
  const kindOf = (contact, alarm) => (contact ? (alarm ? FORESEEN : MISSED) : alarm ? NEEDLESS : null);
  return paths.map(([x, y, vx, vy, until_s, contact], i) =>
    ({ place: [x, y], velocity: [vx, vy], until_s, kind: kindOf(contact, alarms[tracker][i] === "1") }))
    .filter(({ kind }) => kind);
}

// The paths of a moment that end in a contact.
export function contactsOf(player, moment) {
  return (player.moments[moment].robots?.paths ?? []).filter((path) => path[5])
    .map(([x, y, vx, vy, until_s]) => ({ place: [x, y], velocity: [vx, vy], until_s, kind: TOUCHED }));
}

// The contact with the most others near it, [x, y] in cells; null without one.
export function contactCell(player, moment) {
  const ends = contactsOf(player, moment).map(({ place: [x, y], velocity: [vx, vy], until_s }) => [x + until_s * vx, y + until_s * vy]);
  const near = ends.map(([x, y]) => ends.filter(([u, v]) => Math.hypot(u - x, v - y) < ONE_PERSON_M).length);
  const end = ends[near.indexOf(Math.max(...near))];
  return end ? end.map((at, axis) => (at - player.origin[axis]) / player.cell_m) : null;
}

// Numbers of paths by kind for a tracker; null without alarms.
export function robotCounts(player, moment, tracker) {
  const robots = robotsOf(player, moment, tracker);
  const number = (kind) => robots.filter((one) => one.kind === kind).length;
  return robots && { foreseen: number(FORESEEN), missed: number(MISSED), needless: number(NEEDLESS) };
}

export function robotWords(player, moment, tracker) {
  const counts = robotCounts(player, moment, tracker);
  if (!counts) return "";
  const { foreseen, missed, needless } = counts;
  return `; ${foreseen} of ${foreseen + missed} contacts foreseen, ${needless} needless`;
}

// Kinds of outstanding moments for the first `trackers` on screen, with a high `value`; null if a moment is of another
// kind. Worst: the lowest F1 of moments with occupied cells. Different: the largest range of F1. Moments with few
// occupied cells come last: F1 of one cell is 0 or 1 by chance.
export const FEW_CELLS = 5;
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

// The first moment with the highest value, { moment, value }; null if there is none.
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
