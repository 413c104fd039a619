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

  const root = document.documentElement;
  const drawn = new Map();  // spec and height of each plot that is drawn

  function draw(plot) {
    const isNew = !drawn.has(plot);
    if (isNew) {
      drawn.set(plot, { spec: JSON.parse(plot.querySelector("script").textContent), height: plot.offsetHeight });
      plot.replaceChildren();
    }
    const { spec: { data, layout }, height } = drawn.get(plot);
    Plotly.react(plot, resolve(data, getComputedStyle(root)), resolve({ ...layout, template }, getComputedStyle(root)), config);
    if (isNew) {
      plot.on("plotly_afterplot", () => grow(plot, height));
      connect(plot, layout);
    }
    grow(plot, height);
  }

  // Plots over time share range and cursor, and show the samples of a region: a sentence or a shaded stretch elsewhere.
  const WORST = 3;  // [s]
  const courses = () => [...drawn].filter(([, { spec }]) => spec.layout.meta?.axes);
  const follow = (plot, act) => courses().forEach(([other, { spec }]) => {
    if (other !== plot && String(spec.layout.meta.recording) === String(plot.layout.meta.recording)) act(other);
  });

  function show({ axis, low, high, joint, model }) {
    for (const plot of document.querySelectorAll(".plot.course")) if (!drawn.has(plot) && plot.checkVisibility()) draw(plot);
    const ones = courses().filter(([, { spec: { layout: { meta } } }]) => meta.joint === joint && meta.axes.time.length);
    for (const [plot, { spec: { layout: { meta } } }] of ones) {
      const { time } = meta.axes, values = meta.axes[axis], errors = meta.residuals[model];
      const step = Math.min(...time.slice(1, 9).map((end, k) => end - time[k])), runs = [];
      let first = 0, sum = 0, worst = -1, start = time[0];
      const inside = time.map((_, k) => !values || (values[k] >= low && values[k] <= high));
      time.forEach((now, k) => {
        if (!inside[k]) return;
        if (values && runs.length && now - runs.at(-1)[1] < 1.5 * step) runs.at(-1)[1] = now;
        else if (values) runs.push([now, now]);
        for (sum += errors[k] ** 2; time[first] < now - WORST; first++) if (inside[first]) sum -= errors[first] ** 2;
        if (sum > worst) [worst, start] = [sum, Math.max(time[0], (time[first] + now - WORST) / 2)];
      });
      if (worst < 0) continue;
      const fillcolor = getComputedStyle(root).getPropertyValue(model ? "--open" : "--region").trim();
      const shapes = runs.map(([x0, x1]) => ({
        type: "rect", layer: "below", yref: "paper", y0: 0, y1: 1, x0: x0 - step / 2, x1: x1 + step / 2, fillcolor, line: { width: 0 },
      }));
      Plotly.relayout(plot, { shapes, "xaxis.range": [start, start + WORST] });
    }
    ones[0]?.[0].scrollIntoView({ block: "nearest" });
  }

  addEventListener("click", ({ target }) => {
    const place = target.closest("[data-where]");
    if (place) show(JSON.parse(place.dataset.where));
  });

  // Below its plots over time, a pendulum for the measurement and for each model moves with the cursor, or in real time.
  // A goal is a mark at the end of its angle.
  const FAR = 0.1;  // [s] from the next sample: a model has no position there
  function replay(plot, turn) {
    const box = document.createElement("div"), all = drawn.get(plot).spec.data.filter(({ yaxis = "y" }) => yaxis === "y");
    const lines = all.filter(({ name }) => name !== "goal"), goals = all.filter(({ name }) => name === "goal");
    const pendulums = lines.map(({ name, line: { color } }) => `<figure><svg viewBox="-1.25 -1.25 2.5 2.5" role="img"
      aria-label="Position, ${name}" style="--color: var(${color})"><g class="rod"><path d="M0 0V1"/><circle cy="1" r="0.16"/></g>
      <g class="ghost"><path d="M0 0V1.2"/></g>${goals.map(() => '<g class="goal"><path d="M-0.1 1.22H0.1"/></g>')}<circle r="0.06"/></svg><figcaption>${name}</figcaption></figure>`);
    box.className = "replay";
    box.innerHTML = `<button type="button">▶ Play</button>${pendulums.join("")}<output></output>`;
    plot.after(box);
    const [button, output, pictures] = [box.querySelector("button"), box.querySelector("output"), box.querySelectorAll("svg")];
    const known = [...lines, ...goals].map(({ x, y }) => x.map((time, k) => [time, y[k]]).filter(([time, q]) => time !== null && q !== null));
    let now = known[0][0][0], last = null;

    const find = (samples, time) => {
      let [low, high] = [0, samples.length - 1];
      while (low < high) {
        const middle = (low + high) >> 1;
        if (samples[middle][0] < time) low = middle + 1; else high = middle;
      }
      return samples[low] && Math.abs(samples[low][0] - time) < FAR ? samples[low][1] : null;
    };
    const set = (time) => {
      now = time;
      output.textContent = `${time.toFixed(2)} s`;
      const angles = known.map((samples) => find(samples, time));
      pictures.forEach((picture, k) => {
        const [rod, ghost] = picture.querySelectorAll("g");
        rod.style.visibility = angles[k] === null ? "hidden" : "";
        rod.setAttribute("transform", `rotate(${-360 * angles[k] / turn})`);
        ghost.setAttribute("transform", `rotate(${-360 * angles[0] / turn})`);
        picture.querySelector(".goal")?.setAttribute("transform", `rotate(${-360 * angles.at(-1) / turn})`);
      });
    };
    const step = (stamp) => {
      if (last === null || !plot.isConnected) return;
      const [start, end] = plot.layout.xaxis.range;
      set(now + (stamp - last) / 1000 > end || now < start ? start : now + (stamp - last) / 1000);
      last = stamp;
      requestAnimationFrame(step);
    };
    button.addEventListener("click", () => {
      last = last === null ? performance.now() : null;
      button.textContent = last === null ? "▶ Play" : "❚❚ Stop";
      if (last !== null) requestAnimationFrame(step);
    });
    plot.on("plotly_hover", ({ xvals }) => { if (last === null) set(xvals[0]); });
    plot.on("plotly_relayout", ({ "xaxis.range": range }) => { if (range) set(range[0]); });
    set(now);
  }

  function connect(plot, { meta, shapes }) {
    if (meta?.turn) replay(plot, meta.turn);
    if (meta?.axes) {
      plot.on("plotly_relayout", (change) => {
        const range = change["xaxis.range"] ?? [change["xaxis.range[0]"], change["xaxis.range[1]"]];
        if (range[0] !== undefined) follow(plot, (other) => {
          if (String(other.layout.xaxis.range) !== String(range)) Plotly.relayout(other, { "xaxis.range": range });
        });
      });
      plot.on("plotly_hover", ({ xvals, event }) => { if (event) follow(plot, (other) => Plotly.Fx.hover(other, { xval: xvals[0] })); });
    } else if (shapes?.some(({ name }) => name)) {
      plot.on("plotly_click", ({ points: [{ x }] }) => {
        const stretch = shapes.find(({ x0, x1, name }) => name && x0 <= x && x <= x1);
        if (stretch) show(JSON.parse(stretch.name));
      });
    }
  }

  // A plot is drawn when it comes near the screen, one in each frame, and all of them before printing.
  const near = [];
  function drawNext() {
    const plot = near.shift();
    if (near.length) requestAnimationFrame(() => setTimeout(drawNext));
    if (plot?.checkVisibility()) { if (!drawn.has(plot)) draw(plot); }
    else if (plot?.isConnected) observer.observe(plot);  // hidden since: until it is seen again
  }
  const observer = new IntersectionObserver((entries) => {
    const isIdle = !near.length;
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      observer.unobserve(target);
      near.push(target);
    }
    if (isIdle) drawNext();
  }, { rootMargin: "800px" });

  function watch(place) {
    place.querySelectorAll(".plot").forEach((plot) => observer.observe(plot));
    for (const plot of drawn.keys()) if (!plot.isConnected) { drawn.delete(plot); Plotly.purge(plot); }
  }

  addEventListener("theme", () => [...drawn.keys()].forEach(draw));

  const LONG = 8;  // [lines] of a list that is not printed unless it is open
  let theme = null, folded = [];
  addEventListener("beforeprint", () => {
    theme = root.dataset.theme;
    root.dataset.theme = "light";
    folded = [...document.querySelectorAll("details:not([open], .evidence)")].filter((fold) => fold.querySelectorAll("li:not(.evidence li)").length < LONG);
    folded.forEach((details) => { details.open = true; });
    for (const plot of document.querySelectorAll(".plot")) {
      if (!plot.checkVisibility()) continue;
      draw(plot);
      const width = plot.closest(".strip") ? 220 : plot.closest(".grid") ? 330 : 680;  // of A4 and Letter
      const height = plot.matches(".course") ? 600 : plot.closest(":is(#why, #recordings, #failures) .grid") ? (width > 220 ? 240 : 180) : null;  // as in the style
      Plotly.relayout(plot, { width, height, autosize: false });
    }
  });
  addEventListener("afterprint", () => {
    root.dataset.theme = theme;
    for (const plot of drawn.keys()) { draw(plot); Plotly.relayout(plot, { width: null, height: null, autosize: true }); }
    folded.forEach((details) => { details.open = false; });
  });

  return { watch };
})();
