// Scores of single moments, and the moments that they lead to.
export function countsOf(player, moment, h, tracker) {
  return player.moments[moment].counts[h][tracker];
}

// F1 of one moment alone; null where there is no score, or nothing was occupied or called.
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

function bestMoment(player, valueOf) {
  let best = null, most = -Infinity;
  player.moments.forEach((_, moment) => {
    const value = valueOf(moment);
    if (value !== null && value > most) [best, most] = [moment, value];
  });
  return best;
}

// The moment with the lowest F1 of a tracker, among those in which something was to be found; null where none was.
export function worstMoment(player, h, tracker) {
  return bestMoment(player, (moment) => {
    const counts = countsOf(player, moment, h, tracker);
    if (!counts || counts[0] + counts[2] === 0) return null;
    return -momentF1(player, moment, h, tracker);
  });
}

// The moment in which the F1 of two trackers differ most; null where none has both.
export function tellingMoment(player, h, one, other) {
  return bestMoment(player, (moment) => {
    const values = [one, other].map((tracker) => momentF1(player, moment, h, tracker));
    return values.includes(null) ? null : Math.abs(values[0] - values[1]);
  });
}
