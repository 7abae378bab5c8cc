// The view in the address of the page: #key=part,part&key=..., each part escaped. A reload or a copied link shows it again.
const view = viewOf(location.hash);

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

// Calls `listener` after the user went to another address, with its parts of the key; null if it lacks the key.
export function whenAddressChanges(key, listener) {
  window.addEventListener("hashchange", () => listener(viewOf(location.hash).get(key) ?? null));
}
