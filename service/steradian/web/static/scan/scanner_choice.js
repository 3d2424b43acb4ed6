// @ts-check
// Selection of the scanner for a scan, shown if the service has several scanners.
import { api } from "../api.js";
import { h, replace } from "../dom.js";

const SELECT_ID = "which-scanner";

export class ScannerChoice {
  constructor() {
    this.select = h("select", { id: SELECT_ID, "aria-label": "Scanner for this scan", onchange: () => { this.selected = this.select.value; } });
    this.host = h("label", { class: "row", for: SELECT_ID, hidden: true }, "Scanner for this scan", this.select);
    this.selected = "";
    this.names = "";
  }

  /** @param {any[]} all scanners of the service */
  show(all) {
    const names = all.map(({ id }) => id);
    if (names.join() === this.names) return;
    this.names = names.join();
    this.host.hidden = names.length < 2;
    if (!names.includes(this.selected)) this.selected = "";
    replace(this.select, [h("option", { value: "" }, "select …"), ...names.map((name) => h("option", { value: name }, name))]);
    this.select.value = this.selected;
  }

  /** Request fields of the selected scanner; throws if none is selected. @returns {{scanner_id?: string}} */
  get request() {
    if (this.host.hidden) return {};
    if (this.selected) return { scanner_id: this.selected };
    this.select.focus();
    throw new Error("Several scanners are available; select the scanner for this scan.");
  }
}

/** Return the lease of a scanner, or of the only scanner; null if there is none. @param {string | null} [name] */
export async function readLease(name) {
  const { items } = await api.get("/scanners");
  const one = items.find((/** @type {any} */ each) => each.id === name) ?? (items.length === 1 ? items[0] : null);
  return one?.lease ?? null;
}
