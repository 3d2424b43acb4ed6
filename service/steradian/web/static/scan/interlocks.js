// @ts-check
// What keeps the laser from harm, as the scanner reads it, how old that is, and who holds the scanner.
import { h, replace } from "../dom.js";
import { nowOf, seen, watchAge } from "../scanner_status.js";
import { clock } from "../units.js";

/** What each of them is called when the laser may fire; anything else but that and "unknown" is a fault while it scans. */
const SAFE = /** @type {Record<string, string>} */ ({ interlock: "closed", key: "on" });
const NAMES = { laser: "Laser", interlock: "interlock", key: "key", shutter: "shutter" };

export class Guards {
  constructor() {
    this.read = h("span", { class: "row" });
    this.age = h("span", { class: "dim" });
    this.held = h("span", { class: "dim" });
    this.line = h("div", { class: "row caption", role: "group", "aria-label": "Laser, interlock, key, shutter and lease" }, this.read, this.age, this.held);
    /** @type {string | null} whose they are; null: of the only one */
    this.of = null;
    this.shown = "";
    watchAge(() => this.show());
    this.show();
  }

  show() {
    const { scanners, trouble } = seen();
    const one = scanners.find(({ id }) => id === this.of) ?? (this.of === null && scanners.length === 1 ? scanners[0] : null);
    const now = one && nowOf(one);
    this.age.textContent = now && now.age !== null ? `seen ${Math.max(0, now.age).toFixed(1)} s ago` : "";
    const lease = trouble ? null : one?.lease;
    const held = lease ? `reserved by ${lease.holder} until ${clock(lease.ends)}${lease.note ? `: ${lease.note}` : ""}` : "not reserved by anybody";
    this.held.textContent = one && !trouble ? held : "";
    const why = one ? (now?.why ?? "") : (trouble ?? (scanners.length ? `${this.of ?? "its scanner"} is not there` : "not looked at yet"));
    const text = JSON.stringify([why, now?.laser, now?.interlock, now?.key, now?.shutter]);
    if (text === this.shown) return;
    this.shown = text;
    if (!now || now.age === null) replace(this.read, h("span", { class: "dim" }, `Laser, interlock, key and shutter: unknown, ${why}`));
    else replace(this.read, Object.entries(NAMES).flatMap(([of, name], n) => this.word(name, of, now[/** @type {"key"} */ (of)], n > 0)));
  }

  /** @param {string} name @param {string} of @param {string} value @param {boolean} follows */
  word(name, of, value, follows) {
    const wrong = of in SAFE && value !== "unknown" && value !== SAFE[of];
    const read = h("span", { class: wrong ? "fault" : value === "unknown" ? "dim" : "" }, `${name} ${value}`);
    return follows ? [h("span", { class: "dim", "aria-hidden": "true" }, "·"), read] : [read];
  }
}
