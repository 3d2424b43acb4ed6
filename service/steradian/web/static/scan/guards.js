// @ts-check
// What keeps the laser from harm, as the scanner reads it, and who holds the scanner.
import { watchScanner } from "../bar.js";
import { h, replace } from "../dom.js";
import { clock } from "../units.js";

/** What each of them is called when the laser may fire; anything else but that and "unknown" is a fault while it scans. */
const SAFE = { interlock: "closed", key: "on" };

export class Guards {
  constructor() {
    this.line = h("div", { class: "row caption", role: "group", "aria-label": "Interlock, key, shutter and lease" });
    /** @type {string | null} whose they are; null: of the only one */
    this.of = null;
    watchScanner((first, all) => this.show(first, all));
  }

  /** @param {any} first null: the service does not answer @param {any[]} all */
  show(first, all) {
    const scanner = all.find(({ id }) => id === this.of) ?? (this.of === null && all.length === 1 ? first : null);
    if (!scanner) {
      const why = first ? `${this.of ?? "its scanner"} is not there` : "the service does not answer";
      replace(this.line, h("span", { class: "dim" }, `Interlock, key and shutter: unknown, ${why}`));
      return;
    }
    const { interlock, key, shutter, lease } = scanner;
    const said = [["Interlock", interlock], ["key", key], ["shutter", shutter]].flatMap(([name, value], n) => {
      const wrong = value !== "unknown" && name.toLowerCase() in SAFE && value !== SAFE[/** @type {"key"} */ (name.toLowerCase())];
      const read = h("span", { class: wrong ? "fault" : value === "unknown" ? "dim" : "" }, `${name} ${value}`);
      return n ? [h("span", { class: "dim", "aria-hidden": "true" }, "·"), read] : [read];
    });
    const silent = [interlock, key, shutter].every((value) => value === "unknown") ? h("span", { class: "dim" }, "(not read since: look at the scanner; it tells them while a scan runs)") : null;
    const held = lease ? `reserved by ${lease.holder} until ${clock(lease.ends)}${lease.note ? `: ${lease.note}` : ""}` : "not reserved by anybody";
    replace(this.line, said, silent, h("span", { class: "dim" }, held));
  }
}
