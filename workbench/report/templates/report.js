"use strict";
(async () => {
  const packed = document.getElementById("plotly");
  const bytes = Uint8Array.from(atob(packed.textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.src = URL.createObjectURL(await new Response(stream).blob());  // compiled beside the page, unlike a text
  await new Promise((resolve, reject) => { Object.assign(script, { onload: resolve, onerror: reject }); document.head.append(script); });
  packed.remove();
})().then(() => figures.watch(document), () => {
  const text = "This browser is too old to draw the plots; all numbers are in the text and tables.";
  document.querySelectorAll(".plot").forEach((plot) => { plot.textContent = text; });
});
