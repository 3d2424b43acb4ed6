// @ts-check
// Laser, interlock, key, shutter and lease of a scanner, with the age of these values.
import { h, replace } from "../dom.js";
import { statusOf, lastStatus, onTick } from "../scanner_status.js";
import { formatTime, signed } from "../units.js";

/** Values at which the laser may fire; other known values are shown as faults. */
const SAFE_VALUES = /** @type {Record<string, string>} */ ({ interlock: "closed", key: "on" });
const NAMES = { laser: "Laser", interlock: "interlock", key: "key", shutter: "shutter" };

export class Interlocks {
  constructor() {
    this.values = h("span", { class: "row" });
    this.age = h("span", { class: "dim" });
    this.leaseText = h("span", { class: "dim" });
    this.line = h("div", { class: "row caption", role: "group", "aria-label": "Laser, interlock, key, shutter and lease" }, this.values, this.age, this.leaseText);
    /** @type {string | null} identifier of the scanner; null: the only scanner */
    this.scannerId = null;
    this.shownKey = "";
    onTick(() => this.show());
    this.show();
  }

  show() {
    const { scanners, failure } = lastStatus();
    const one = scanners.find(({ id }) => id === this.scannerId) ?? (this.scannerId === null && scanners.length === 1 ? scanners[0] : null);
    const now = one && statusOf(one);
    this.age.textContent = now && now.age !== null ? `updated ${signed(Math.max(0, now.age), 1)} s ago` : "";
    const lease = failure ? null : one?.lease;
    const heldText = lease ? `reserved by ${lease.holder} until ${formatTime(lease.ends)}${lease.note ? `: ${lease.note}` : ""}` : "not reserved";
    this.leaseText.textContent = one && !failure ? heldText : "";
    const reason = one ? (now?.reason ?? "") : (failure ?? (scanners.length ? `${this.scannerId ?? "the scanner"} is not registered` : "not polled yet"));
    const text = JSON.stringify([reason, now?.laser, now?.interlock, now?.key, now?.shutter]);
    if (text === this.shownKey) return;
    this.shownKey = text;
    if (!now || now.age === null) replace(this.values, h("span", { class: "dim" }, `Laser, interlock, key and shutter: unknown, ${reason}`));
    else replace(this.values, Object.entries(NAMES).flatMap(([signal, name], n) => this.valueElements(name, signal, now[/** @type {"key"} */ (signal)], n > 0)));
  }

  /** @param {string} name @param {string} signal @param {string} value @param {boolean} follows */
  valueElements(name, signal, value, follows) {
    const isUnsafe = signal in SAFE_VALUES && value !== "unknown" && value !== SAFE_VALUES[signal];
    const element = h("span", { class: isUnsafe ? "fault" : value === "unknown" ? "dim" : "" }, `${name} ${value}`);
    return follows ? [h("span", { class: "dim", "aria-hidden": "true" }, "·"), element] : [element];
  }
}
