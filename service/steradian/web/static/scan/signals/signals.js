// @ts-check
// The inspection of a scan's signals: histogram, noise, maps, beams, frames and bad A-lines; read only while it is open.
import { api } from "../../api.js";
import { line } from "../../charts.js";
import { h, renew, replace } from "../../dom.js";
import { failed, loading, words } from "../../panel_states.js";
import { clock, count, figure } from "../../units.js";
import { showCounts } from "./code_histogram.js";
import { Field, markOf } from "./signal_map.js";
import { byKind, told, total } from "./labels.js";

/** @typedef {import("./labels.js").Signals} Told */

const EVERY = 10; // seconds between two looks while the scan runs
const MOST = 200; // A-lines of a kind that are listed

export class Signals {
  /** @param {HTMLElement} host @param {string} id of the scan @param {(aline: number) => void} chosen an A-line that is to be shown */
  constructor(host, id, chosen) {
    this.path = `/scans/${id}/signals`;
    this.chosen = chosen;
    this.aperture = 0.01;
    this.running = false;
    this.asking = false;
    this.isDue = false;
    this.isWhole = false;
    this.total = h("p", { role: "status", dataset: { total: "" } });
    this.when = h("p", { class: "dim small" });
    this.counts = h("div");
    this.noise = h("div", { class: "chart", role: "group" });
    this.map = h("div", { class: "stack field-map" });
    this.tables = h("div", { class: "stack" });
    this.list = h("div", { class: "stack" });
    this.field = new Field(this.map, chosen);
    this.body = h("div", { class: "stack" });
    this.view = [this.total, this.when, h("div", { class: "signals-grid" }, this.counts, h("div", null, h("h3", null, "Noise spectrum"), this.noise), this.map, h("div", { class: "stack" }, h("h3", null, "Bad A-lines"), this.list)), this.tables];
    this.details = h("details", { ontoggle: () => this.read() }, h("summary", null, h("strong", null, "Signals"), h("span", { class: "dim" }, " histogram, noise, maps, bad A-lines")), this.body);
    host.append(this.details);
    setInterval(() => this.running && this.read(), EVERY * 1000);
    document.addEventListener("visibilitychange", () => this.running && this.read());
  }

  /** What is known of the scan. @param {number} aperture in metres @param {boolean} running */
  of(aperture, running) {
    this.aperture = aperture;
    const ended = this.running && !running;
    this.running = running;
    this.isDue = ended; // also where a look is under way, which may have begun before the last A-line
    if (ended) void this.read();
  }

  /** Read and show it, where somebody sees it. */
  async read() {
    if (!this.details.open || document.hidden || this.asking || (this.isWhole && !this.running)) return;
    this.asking = true;
    this.isDue = false;
    if (!this.body.firstChild) loading(this.body, "looking at the signals …");
    try {
      const signals = /** @type {Told} */ (await api.get(this.path));
      if (!this.total.isConnected) replace(this.body, ...this.view);
      await this.show(signals);
      this.isWhole = signals.complete && !this.running;
    } catch (error) {
      if (this.running && this.total.isConnected) replace(this.when, "The last look did not work, what stands here is older: ", ...words(error));
      else failed(this.body, error, () => void this.read());
    }
    this.asking = false;
    if (this.isDue) await this.read();
  }

  /** @param {Told} signals */
  async show(signals) {
    const said = total(signals);
    if (this.total.textContent !== said) this.total.textContent = said;
    this.when.textContent = this.running ? `As of ${clock(new Date())}; looked at again every ${EVERY} s while the scan runs and this is open.` : "";
    showCounts(this.counts, signals.histogram);
    this.field.show(signals.maps, signals.bad, this.aperture, signals.histogram.kind === "codes");
    this.showBad(signals.bad);
    replace(this.tables, tableOf("Beams", "beam", signals.beams), tableOf("Frames", "frame", signals.frames));
    await this.showNoise(signals.spectrum);
  }

  /** @param {{frequencies: number[], mean: number[], median: number[]}} spectrum */
  async showNoise({ frequencies, mean, median }) {
    const x = frequencies.map((one) => one / 1e6);
    const strongest = mean.reduce((best, one, n) => (one > mean[best] ? n : best), 0);
    this.noise.setAttribute("aria-label", `Noise against frequency, mean and median of the A-lines, up to ${figure(x[x.length - 1])} MHz; the mean is greatest at ${figure(x[strongest])} MHz`);
    await line(this.noise, [{ name: "mean", x, y: mean }, { name: "median", x, y: median }], { x: "frequency (MHz)", y: "noise" });
  }

  /** @param {import("./labels.js").Bad[]} bad */
  showBad(bad) {
    const open = new Set([...this.list.querySelectorAll("details[open]")].map((one) => /** @type {HTMLElement} */ (one).dataset.kind));
    const one = (/** @type {import("./labels.js").Bad} */ each) => h("button", {
      type: "button", class: "quiet", title: told(each), "aria-label": told(each), dataset: { aline: each.aline }, onclick: () => this.chosen(each.aline),
      onfocus: () => this.field.light(each), onpointerenter: () => this.field.light(each), onblur: () => this.field.light(null), onpointerleave: () => this.field.light(null),
    }, String(each.aline));
    renew(this.list, bad.length ? byKind(bad).map(([kind, all]) => h("details", { open: open.has(kind), dataset: { kind } },
      h("summary", null, `${markOf(kind)} ${kind}: ${count(all.length)}`),
      h("div", { class: "row alines" }, all.slice(0, MOST).map(one), all.length > MOST ? h("span", { class: "dim" }, `and ${count(all.length - MOST)} more`) : null))) : h("p", { class: "dim" }, "none"));
  }
}

/** @param {string} title @param {string} name @param {any[]} rows */
function tableOf(title, name, rows) {
  if (!rows?.length) return null;
  const columns = Object.keys(rows[0]);
  const shown = (/** @type {any} */ value) => (typeof value !== "number" ? String(value ?? "–") : Number.isInteger(value) ? count(value) : figure(value));
  return h("div", { class: "scrolls" }, h("table", { dataset: { table: name } }, h("caption", null, title),
    h("thead", null, h("tr", null, columns.map((one) => h("th", { scope: "col", class: "number" }, one === "alines" ? "A-lines" : one.replaceAll("_", " "))))),
    h("tbody", null, rows.map((row) => h("tr", null, columns.map((one) => h("td", { class: "number" }, shown(row[one]))))))));
}
