// @ts-check
// Store of the view state: notifies the panels and writes the URL.
import { debounce } from "../dom.js";
import { decode, encode } from "./view_state.js";

/** @typedef {import("./view_state.js").View} View */

const WRITE_DELAY = 200; // ms after the last change; browsers limit the rate of URL changes

export class ViewStore {
  constructor() {
    /** @type {View} */
    this.view = decode(location.hash);
    /** @type {Set<(view: View, changed: Set<string>) => void>} */
    this._listeners = new Set();
    this._writeSoon = debounce(() => this.write(), WRITE_DELAY);
    addEventListener("hashchange", () => this._load(decode(location.hash)));
  }

  /** Subscribe to changes. @param {(view: View, changed: Set<string>) => void} act */
  on(act) {
    this._listeners.add(act);
    return () => this._listeners.delete(act);
  }

  /** @param {Partial<View>} parts */
  change(parts) {
    const view = /** @type {any} */ (this.view);
    const changed = Object.entries(parts).filter(([name, value]) => JSON.stringify(view[name]) !== JSON.stringify(value));
    if (!changed.length) return;
    this._set({ ...this.view, ...parts }, new Set(changed.map(([name]) => name)));
    this._writeSoon();
  }

  /** Notify listeners as if these parts had changed. @param {string[]} names */
  notify(names) {
    this._set(this.view, new Set(names));
  }

  /** Write the view to the URL now. */
  write() {
    const fragment = encode(this.view);
    if (`#${fragment}` !== (location.hash || "#")) {
      history.replaceState(history.state, "", location.pathname + location.search + (fragment ? `#${fragment}` : ""));
    }
  }

  /** @param {View} view */
  _load(view) {
    this._set(view, new Set(Object.keys(view)));
  }

  /** @param {View} view @param {Set<string>} changed */
  _set(view, changed) {
    this.view = view;
    for (const act of this._listeners) act(view, changed);
  }
}
