"use strict";
// What the page does by itself: its plots; everything else is the server's.
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

  const same = () => window.dash_clientside.no_update;

  // Sections of the report come as the report has them; one that is the same stays as it is, zoomed or unfolded.
  const shown = new WeakMap();
  const links = {  // in the place of commands
    "Run diagnose": '<a href="#diagnose">Run the diagnosis</a>',
    "record --excitation suggested plays it": '<a href="#export">Export</a> saves it',
  };
  function fragment(markup, id) {
    const place = document.getElementById(JSON.stringify(id, Object.keys(id).sort()));
    if (!place || !markup || shown.get(place) === markup) return same();
    shown.set(place, markup);
    place.innerHTML = Object.entries(links).reduce((text, [words, link]) => text.replaceAll(words, link), markup);
    figures.watch(place);
    return same();
  }

  // A stage that is drawn anew gives the focus back to where it was, or takes it, so that a keyboard keeps its place.
  let focused = null, lent = false;
  addEventListener("pointerdown", () => { focused = null; });
  addEventListener("focusin", ({ target }) => {
    lent = false;
    focused = target.closest("#stage, .running") ? target.id : null;
  });
  new MutationObserver(() => {
    const stage = document.getElementById("stage"), here = document.activeElement;
    if (!focused || !stage || (here !== document.body && !(here === stage && lent))) return;
    const before = document.getElementById(focused), kept = focused;
    (before && !before.disabled ? before : stage).focus({ preventScroll: true });
    if (document.activeElement === stage) [focused, lent] = [kept, true];
  }).observe(root, { childList: true, subtree: true });

  // What somebody did is seen to be worked on until its answer comes; what the page asks by itself, it asks unseen.
  const ask = window.fetch;
  let waiting = 0;
  const wait = (more) => root.classList.toggle("waiting", (waiting += more) > 0);
  window.fetch = (address, options) => {
    const gone = "the workbench does not answer any more: start it again in the terminal, then load this page again";
    const large = "these files are too large: shorten them or load one at a time, or use the command line";
    const tell = (text) => window.dash_clientside.set_props("notice", { children: text });
    const told = (error) => { tell(gone); throw error; };
    const check = (answer) => { if (answer.status === 413) tell(large); return answer; };
    const body = typeof options?.body === "string" ? options.body : "";
    const changed = body.match(/"changedPropIds":\[([^\]]*)\]/)?.[1];
    if (!changed || /^"[\w-]+\.n_intervals"$/.test(changed)) return ask(address, options).catch(told);
    wait(1);
    return ask(address, options).then(check, told).finally(() => wait(-1));
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

  window.dash_clientside = { ...window.dash_clientside, app: { session, reveal, fragment } };
})();
