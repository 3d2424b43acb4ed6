// @ts-check
// Shell of every page: theme, shortcuts, status bar with emergency stop, event stream, and the hook for custom scripts.
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
