// @ts-check
// The keyboard: g and a letter leads to a view, / to the search, ? shows what there is; pages add their own.
import { byId, h, openDialog } from "./dom.js";

/** @type {{keys: string, what: string, act: (() => void) | null}[]} */
const known = [];
const WITHIN = 1200;
let before = { key: "", at: 0 };

/**
 * Add a key, or two after each other as in "g d".
 * @param {string} keys @param {string} what @param {(() => void) | null} act null: somebody else listens
 */
export function addKey(keys, what, act) {
  known.push({ keys, what, act });
}

/** Whether somebody writes just now. @param {EventTarget | null} target */
function writes(target) {
  return target instanceof HTMLElement && (target.isContentEditable || /^(input|textarea|select)$/i.test(target.tagName));
}

/** @param {KeyboardEvent} event */
function press(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || writes(event.target) || document.querySelector("dialog[open]")) return;
  const now = event.timeStamp;
  const pair = `${before.key} ${event.key}`;
  const found = (now - before.at < WITHIN && known.find((one) => one.keys === pair)) || known.find((one) => one.keys === event.key);
  before = { key: event.key, at: now };
  if (!found || !found.act) return;
  event.preventDefault();
  found.act();
}

export function showKeys() {
  const dialog = h("dialog", { "aria-labelledby": "keys-title" },
    h("form", { method: "dialog" },
      h("h2", { id: "keys-title" }, "Keys"),
      h("table", null, h("tbody", null,
        known.map((one) => h("tr", null,
          h("td", { class: "nowrap" }, one.keys.split(" ").flatMap((key) => [h("kbd", null, key), " "])),
          h("td", null, one.what))))),
      h("menu", null, h("button", null, "Close"))));
  openDialog(dialog);
}

export function startKeys() {
  addKey("Ctrl+.", "Emergency stop", null);
  for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll(".rail a[data-key]"))) {
    addKey(`g ${link.dataset.key}`, link.textContent ?? "", () => link.click());
  }
  addKey("/", "Search", () => /** @type {HTMLElement | null} */ (document.querySelector("[data-search]"))?.focus());
  addKey("?", "This map of keys", showKeys);
  byId("keys").addEventListener("click", showKeys);
  document.addEventListener("keydown", press);
}
