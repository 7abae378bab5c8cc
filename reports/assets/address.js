// The view in the address of the page: #key=part,part&key=..., each part escaped. A reload or a copied link shows it again.
const followers = new Map(); // by key: they follow another address without a reload
let view = viewOf(location.hash);

function viewOf(hash) {
  const keys = new Map();
  for (const [key, equals, text] of hash.slice(1).split("&").map((one) => one.split(/(=)/))) {
    try {
      if (equals) keys.set(key, text ? text.split(",").map(decodeURIComponent) : []);
    } catch {
      continue; // no escaped text: not written by this page
    }
  }
  return keys;
}

// The parts of a key; null if the address lacks it.
export const inAddress = (key) => view.get(key) ?? null;

export function keepInAddress(key, parts) {
  view.set(key, parts.map(String));
  const texts = [...view].map(([name, values]) => `${name}=${values.map(encodeURIComponent).join(",")}`);
  history.replaceState(null, "", `#${texts.join("&")}`);
}

// Calls `follower` with the parts of the key, null if it lacks them, after the user went to another address. If that
// differs in another key, the page is loaded again.
export function whenAddressChanges(key, follower) {
  followers.set(key, follower);
}

// Keeps the parts of a key, and calls its follower.
export function openInAddress(key, parts) {
  keepInAddress(key, parts);
  followers.get(key)?.(inAddress(key));
}

window.addEventListener("hashchange", () => {
  const now = viewOf(location.hash), before = view;
  if (!now.size) return; // a place on the page
  view = now;
  const changed = [...new Set([...now.keys(), ...before.keys()])]
    .filter((key) => String(now.get(key)) !== String(before.get(key)));
  if (changed.some((key) => !followers.has(key))) location.reload();
  else for (const key of changed) followers.get(key)(inAddress(key));
});
