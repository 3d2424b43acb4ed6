// @ts-check
// Keyboard shortcuts: g and a letter opens a view, / focuses the search, ? lists all shortcuts of the page.
import { byId, h, openDialog } from "./dom.js";

/** @type {{keys: string, description: string, action: (() => void) | null}[]} */
const shortcuts = [];
const SEQUENCE_TIMEOUT = 1200;
let lastKey = { key: "", at: 0 };

/**
 * Add a shortcut of one key, or of two keys in sequence as in "g d".
 * @param {string} keys @param {string} description @param {(() => void) | null} action null: handled elsewhere, listed only
 */
export function addShortcut(keys, description, action) {
  shortcuts.push({ keys, description, action });
}

/** Return whether an element accepts text input. @param {EventTarget | null} target */
function isTextInput(target) {
  return target instanceof HTMLElement && (target.isContentEditable || /^(input|textarea|select)$/i.test(target.tagName));
}

/** @param {KeyboardEvent} event */
function handleKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || isTextInput(event.target) || document.querySelector("dialog[open]")) return;
  const now = event.timeStamp;
  const pair = `${lastKey.key} ${event.key}`;
  const shortcut = (now - lastKey.at < SEQUENCE_TIMEOUT && shortcuts.find((one) => one.keys === pair)) || shortcuts.find((one) => one.keys === event.key);
  lastKey = { key: event.key, at: now };
  if (!shortcut || !shortcut.action) return;
  event.preventDefault();
  shortcut.action();
}

export function showShortcuts() {
  const dialog = h("dialog", { "aria-labelledby": "keys-title" },
    h("form", { method: "dialog" },
      h("h2", { id: "keys-title" }, "Keyboard shortcuts"),
      h("table", null, h("tbody", null,
        shortcuts.map((one) => h("tr", null,
          h("td", { class: "nowrap" }, one.keys.split(" ").flatMap((key) => [h("kbd", null, key), " "])),
          h("td", null, one.description))))),
      h("menu", null, h("button", null, "Close"))));
  openDialog(dialog);
}

export function startShortcuts() {
  addShortcut("Ctrl+.", "Emergency stop", null);
  for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll(".rail a[data-key]"))) {
    addShortcut(`g ${link.dataset.key}`, link.textContent ?? "", () => link.click());
  }
  addShortcut("/", "Search", () => /** @type {HTMLElement | null} */ (document.querySelector("[data-search]"))?.focus());
  addShortcut("?", "Keyboard shortcuts", showShortcuts);
  byId("keys").addEventListener("click", showShortcuts);
  document.addEventListener("keydown", handleKey);
}
