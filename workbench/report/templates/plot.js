"use strict";
// How the plots of this project look, whatever page they are on.
const figures = (() => {
  // "--name" anywhere in a figure stands for a colour of the page's style.
  function resolve(value, style) {
    if (typeof value === "string") return value.startsWith("--") ? style.getPropertyValue(value).trim() : value;
    if (Array.isArray(value)) return value.map((item) => resolve(item, style));
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, resolve(item, style)]));
  }

  const axis = {
    automargin: true, gridcolor: "--grid", linecolor: "--line", zerolinecolor: "--line", zerolinewidth: 1,
    ticks: "outside", ticklen: 4, tickcolor: "--line", exponentformat: "power", minexponent: 5, title: { standoff: 10, font: { size: 13 } },
  };
  const template = {
    layout: {
      font: { family: "Inter, system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif", size: 12.5, color: "--text" },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      xaxis: axis, yaxis: axis, margin: { l: 64, r: 16, t: 34, b: 48 }, dragmode: "zoom", hoverdistance: 30,
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yanchor: "bottom", maxheight: 2000, bgcolor: "rgba(0,0,0,0)" },
      hoverlabel: { bgcolor: "--surface", bordercolor: "--line", font: { color: "--text" } },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "--muted", activecolor: "--text" },
    },
  };
  const config = {  // buttons by name, so that none that sends data elsewhere can slip in
    responsive: true, displaylogo: false, displayModeBar: true, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };

  // A legend of more than one row takes no height from its plot, which grows by it; drawn again in this height, it stays.
  const ROW = 24;  // [px]
  function grow(plot, height) {
    const legend = plot.querySelector(".legend .bg")?.getBBox().height ?? 0;
    const wanted = `${Math.round(height + Math.max(0, legend - ROW))}px`;
    if (plot.style.height === wanted) return;
    plot.style.height = wanted;
    Plotly.Plots.resize(plot);
  }

  const themed = ({ data, layout }) => resolve({ data, layout: { ...layout, template } }, getComputedStyle(document.documentElement));
  return { config, grow, themed };
})();
