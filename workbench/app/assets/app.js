"use strict";
// What the page does by itself: its colours, its plots and its brushing; everything else is the server's.
(() => {
  const root = document.documentElement;
  const keep = (key, value) => { try { sessionStorage.setItem(key, value); } catch { /* storage may be barred */ } };
  const kept = (key) => { try { return sessionStorage.getItem(key); } catch { return null; } };

  // A tab keeps its session over a reload; another tab has another.
  function session() {
    let id = kept("pendulum-ident-session");
    if (!id) {
      id = [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
      keep("pendulum-ident-session", id);
    }
    return id;
  }

  function theme(clicks) {
    if (clicks) {
      root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
      try { localStorage.setItem("pendulum-ident-theme", root.dataset.theme); } catch { /* as above */ }
    }
    return root.dataset.theme;
  }

  const same = () => window.dash_clientside.no_update;
  const draw = (spec) => (spec ? figures.themed(spec) : same());

  // The selection's traces on top; a box stays only in the view it was drawn in.
  function brush(spec, _theme, lit, id) {
    if (!spec) return same();
    const data = lit ? [...spec.data, ...lit.traces[id.of]] : spec.data;
    const layout = { ...spec.layout, uirevision: "same" };
    if (!lit || lit.source !== id.of) layout.selections = [];
    return figures.themed({ data, layout });
  }

  // An empty plot, once the first stage is there, so that plotly.js comes while the user reads.
  let warmed = false;
  function warm(stage) {
    if (!stage || warmed) return same();
    warmed = true;
    const plot = { namespace: "dash_core_components", type: "Graph", props: { figure: { data: [], layout: {} } } };
    return new Promise((resolve) => setTimeout(() => resolve(plot), 200));
  }

  // Sections of the report come as the report has them.
  function fragment(markup, id) {
    const name = JSON.stringify(id, Object.keys(id).sort());
    const place = document.getElementById(name);
    if (place && markup) place.innerHTML = markup;
    return same();
  }

  // A stage that is drawn anew gives the focus back to where it was, or takes it, so that a keyboard keeps its place.
  let focused = null, lent = false;
  addEventListener("pointerdown", () => { focused = null; });
  addEventListener("focusin", ({ target }) => {
    lent = false;
    focused = target.closest("#stage, #job") ? target.id : null;
  });
  new MutationObserver(() => {
    const stage = document.getElementById("stage"), here = document.activeElement;
    if (!focused || !stage || (here !== document.body && !(here === stage && lent))) return;
    const before = document.getElementById(focused), kept = focused;
    (before && !before.disabled ? before : stage).focus({ preventScroll: true });
    if (document.activeElement === stage) [focused, lent] = [kept, true];
  }).observe(root, { childList: true, subtree: true });

  // Files are chosen in a field of the document's own, or dropped, and read in the order in which they were chosen:
  // what is drawn anew meanwhile would lose them.
  const chooser = Object.assign(document.createElement("input"), { type: "file", hidden: true, id: "chooser" });
  let asking = null;
  addEventListener("DOMContentLoaded", () => document.body.append(chooser));
  addEventListener("click", ({ target }) => {
    const place = target.closest?.("[data-files]");
    if (!place) return;
    asking = place.id;
    Object.assign(chooser, { value: "", multiple: place.dataset.files === "several" });
    chooser.click();
  });
  chooser.addEventListener("change", () => coming(asking, chooser.files));
  for (const kind of ["dragover", "dragleave", "drop"]) addEventListener(kind, (event) => {
    const place = event.target.closest?.("[data-files]");
    if (!place) return;
    event.preventDefault();
    place.classList.toggle("over", kind === "dragover");
    if (kind === "drop") coming(place.id, event.dataTransfer.files);
  });
  function coming(place, chosen) {
    const all = [...chosen];
    if (!all.length) return;
    const tell = (text) => window.dash_clientside.set_props("notice", { children: text });
    const most = Number(document.querySelector("[data-most]").dataset.most);
    if (all.reduce((sum, file) => sum + file.size, 0) > most) {
      const what = all.length === 1 ? `${all[0].name}: is` : "these files: are together";
      return tell(`${what} larger than ${Math.round(most / 1e6)} MB: shorten or load one at a time, or use the command line`);
    }
    const unwrap = Boolean(document.querySelector(`[id='{"field":"unwrap"}'] input:checked`));
    const whole = (file) => new Promise((resolve, reject) => {
      const reader = new FileReader();
      reader.onload = () => resolve([file.name, reader.result]);
      reader.onerror = () => reject(`${file.name}: the browser cannot read it: choose it again`);
      reader.readAsDataURL(file);
    });
    const came = (files) => window.dash_clientside.set_props("came", { data: { place, files, unwrap } });
    Promise.all(all.map(whole)).then(came, tell);
  }

  // What somebody did is seen to be worked on until its answer comes; what the page asks by itself, it asks unseen.
  const ask = window.fetch;
  let waiting = 0;
  const wait = (more) => root.classList.toggle("waiting", (waiting += more) > 0);
  window.fetch = (address, options) => {
    const gone = "the workbench does not answer any more: start it again in the terminal, then load this page again";
    const told = (error) => { window.dash_clientside.set_props("notice", { children: gone }); throw error; };
    const body = typeof options?.body === "string" ? options.body : "";
    const changed = body.match(/"changedPropIds":\[([^\]]*)\]/)?.[1];
    if (!changed || /^"[\w-]+\.n_intervals"$/.test(changed)) return ask(address, options).catch(told);
    wait(1);
    return ask(address, options).catch(told).finally(() => wait(-1));
  };

  // Where the stages do not fit in, the one that is shown is in sight.
  function reveal() {
    document.querySelector("nav [aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
    return same();
  }

  // Another stage is another page, which begins at its top.
  addEventListener("hashchange", () => scrollTo({ top: 0, behavior: "instant" }));

  // The address tells the stage, so that this link must not change it.
  addEventListener("click", (event) => {
    if (event.target.id !== "skip") return;
    event.preventDefault();
    document.getElementById("stage").focus();
  }, true);

  window.dash_clientside = { ...window.dash_clientside, app: { session, theme, draw, brush, reveal, warm, fragment } };
})();
