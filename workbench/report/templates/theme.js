"use strict";
// Before the first paint: the reader's last choice, or else what the system prefers.
(() => {
  let chosen = null;
  try { chosen = localStorage.getItem("pendulum-ident-theme"); } catch { /* storage may be barred for files */ }
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  document.documentElement.dataset.theme = chosen === "dark" || chosen === "light" ? chosen : system;
})();
