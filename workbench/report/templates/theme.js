"use strict";
// From before the first paint: the colours that the switch chose, else those that the system prefers.
{
  const key = "pendulum-ident-theme", dark = matchMedia("(prefers-color-scheme: dark)"), { dataset } = document.documentElement;
  const show = (theme) => { dataset.theme = theme; dispatchEvent(new Event("theme")); };
  const store = (theme) => { try { localStorage.setItem(key, theme); } catch { /* storage may be barred */ } };
  const load = () => { try { return localStorage.getItem(key); } catch { return null; } };
  const follow = () => show(load() ?? (dark.matches ? "dark" : "light"));
  follow();
  dark.addEventListener("change", follow);
  addEventListener("click", ({ target }) => {
    if (!target.closest(".theme")) return;
    show(dataset.theme === "dark" ? "light" : "dark");
    store(dataset.theme);
  });
}
