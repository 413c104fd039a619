"use strict";
(() => {
  const root = document.documentElement;
  const plots = [...document.querySelectorAll(".plot")];
  const specs = new Map(plots.map((plot) => [plot, JSON.parse(plot.querySelector("script").textContent)]));
  const heights = new Map(plots.map((plot) => [plot, plot.offsetHeight]));
  const drawn = new Set();

  function draw(plot) {
    const { data, layout } = figures.themed(specs.get(plot));
    if (drawn.has(plot)) return Plotly.react(plot, data, layout, figures.config);
    drawn.add(plot);
    plot.replaceChildren();
    const done = Plotly.react(plot, data, layout, figures.config);
    plot.on("plotly_afterplot", () => figures.grow(plot, heights.get(plot)));
    return done.then(() => figures.grow(plot, heights.get(plot)));
  }

  async function unpack() {
    const packed = document.getElementById("plotly");
    const bytes = Uint8Array.from(atob(packed.textContent.trim()), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    packed.remove();
  }

  // A plot is drawn when it comes near the screen, and all of them before printing.
  function watch() {
    const observer = new IntersectionObserver((entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        observer.unobserve(target);
        draw(target);
      }
    }, { rootMargin: "800px" });
    plots.forEach((plot) => observer.observe(plot));

    let theme = null, folded = [];
    addEventListener("beforeprint", () => {
      theme = root.dataset.theme;
      root.dataset.theme = "light";
      folded = [...document.querySelectorAll("details:not([open])")];
      folded.forEach((details) => { details.open = true; });
      for (const plot of plots) {
        draw(plot);
        Plotly.relayout(plot, { width: plot.closest(".grid") ? 330 : 680, autosize: false });  // of A4 and Letter
      }
    });
    addEventListener("afterprint", () => {
      root.dataset.theme = theme;
      plots.forEach((plot) => { draw(plot); Plotly.relayout(plot, { width: null, autosize: true }); });
      folded.forEach((details) => { details.open = false; });
    });
  }

  unpack().then(watch, () => {
    plots.forEach((plot) => { plot.textContent = "This browser is too old to draw the plots; all numbers are in the text and tables."; });
  });
})();
