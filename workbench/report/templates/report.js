"use strict";
(async () => {
  const packed = document.getElementById("plotly");
  const bytes = Uint8Array.from(atob(packed.textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const blob = await new Response(stream).blob(), source = URL.createObjectURL(blob);
  const run = (content) => new Promise((onload, onerror) => { document.head.append(Object.assign(document.createElement("script"), { onload, onerror }, content)); });
  await run({ src: source }).catch(async () => { run({ textContent: await blob.text() }); });  // a text, compiled more slowly, if a host bars blobs
  URL.revokeObjectURL(source);
  packed.remove();
})().then(() => figures.watch(document), () => {
  const text = "This browser is too old to draw the plots; all numbers are in the text and tables.";
  document.querySelectorAll(".plot").forEach((plot) => { plot.textContent = text; });
});
