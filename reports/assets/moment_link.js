// A link to a moment: #t=recording,seconds,horizon,tracker,... with each part escaped.
export function linkOf({ recording, seconds, horizon, trackers }) {
  return `#t=${[recording, seconds, horizon, ...trackers].map((part) => encodeURIComponent(part)).join(",")}`;
}

// The moment that a link names; null where it names none.
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
