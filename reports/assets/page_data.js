// The data of the page (`page_data.py` describes it), and the unpacking of deflated texts.
// A deflated text in base64, as a response: read it with `text` or `arrayBuffer`.
export function inflated(text) {
  const packed = atob(text), bytes = new Uint8Array(packed.length);
  for (let at = 0; at < packed.length; at += 1) bytes[at] = packed.charCodeAt(at);
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
}

export async function inflatedBytes(text) {
  return new Uint8Array(await inflated(text).arrayBuffer());
}

export const pageData = JSON.parse(await inflated(document.getElementById("page-data").textContent).text());
