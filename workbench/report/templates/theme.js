"use strict";
// From before the first paint: the colours that the system prefers, until the switch is pressed.
{
  const dark = matchMedia("(prefers-color-scheme: dark)"), { dataset } = document.documentElement;
  const show = (theme) => { dataset.theme = theme; dispatchEvent(new Event("theme")); };
  const follow = () => show(dark.matches ? "dark" : "light");
  follow();
  dark.addEventListener("change", follow);
  addEventListener("click", ({ target }) => { if (target.closest(".theme")) show(dataset.theme === "dark" ? "light" : "dark"); });
}
