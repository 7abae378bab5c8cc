// What the page knows of its runs: `page_data.py` describes it.
async function inflated(text) {
  const packed = atob(text), bytes = new Uint8Array(packed.length);
  for (let at = 0; at < packed.length; at += 1) bytes[at] = packed.charCodeAt(at);
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
}

export const pageData = JSON.parse(await inflated(document.getElementById("page-data").textContent));
