// @ts-check
// What every page has: theme, keys, bar with the stop, event stream; then others may add to it.
import { api } from "./api.js";
import { startBar } from "./status_bar.js";
import { startShortcuts } from "./shortcuts.js";
import { live } from "./event_stream.js";
import { startTheme } from "./theme.js";

startBar();
startTheme();
startShortcuts();
live.start();

document.addEventListener("DOMContentLoaded", () => {
  const panels = Object.fromEntries(
    [.../** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-steradian]"))].map((one) => [one.dataset.steradian, one]),
  );
  const detail = { page: document.body.dataset.page, api, live, panels };
  document.dispatchEvent(new CustomEvent("steradian:ready", { detail }));
});
