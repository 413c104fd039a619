"use strict";
// Before the first paint: the colours that the system prefers.
document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
