// @ts-check
// Signal inspection of a scan: histogram, noise, maps, beams, frames and bad A-lines; read only while open.
import { api } from "../../api.js";
import { LineChart } from "../../charts.js";
import { h, replaceKeepingFocus, replace } from "../../dom.js";
import { showError, showLoading, errorElements } from "../../panel_states.js";
import { formatTime, count, figure } from "../../units.js";
import { showCodeHistogram } from "./code_histogram.js";
import { SignalMap, markOf } from "./signal_map.js";
import { groupByKind, alineText, summaryOf } from "./labels.js";

/** @typedef {import("./labels.js").Signals} SignalsReport */

const READ_INTERVAL = 10; // seconds between two reads while the scan runs
const MAX_LISTED = 200; // listed A-lines per kind

export class Signals {
  /** @param {HTMLElement} host @param {string} id of the scan @param {(aline: number) => void} onSelect an A-line that is to be shown */
  constructor(host, id, onSelect) {
    this.path = `/scans/${id}/signals`;
    this.onSelect = onSelect;
    this.aperture = 0.01;
    this.running = false;
    this.isReading = false;
    this.isDue = false;
    this.isComplete = false;
    this.summary = h("p", { role: "status", dataset: { total: "" } });
    this.statusLine = h("p", { class: "dim small" });
    this.counts = h("div");
    this.noise = h("div", { class: "chart", role: "group" });
    this.noiseChart = new LineChart(this.noise);
    this.mapHost = h("div", { class: "stack field-map" });
    this.tables = h("div", { class: "stack" });
    this.list = h("div", { class: "stack" });
    this.signalMap = new SignalMap(this.mapHost, onSelect);
    this.body = h("div", { class: "stack" });
    this.view = [this.summary, this.statusLine, h("div", { class: "signals-grid" }, this.counts, h("div", null, h("h3", null, "Noise spectrum"), this.noise), this.mapHost, h("div", { class: "stack" }, h("h3", null, "Bad A-lines"), this.list)), this.tables];
    this.details = h("details", { ontoggle: () => this.read() }, h("summary", null, h("strong", null, "Signals"), h("span", { class: "dim" }, " histogram, noise, maps, bad A-lines")), this.body);
    host.append(this.details);
    setInterval(() => this.running && this.read(), READ_INTERVAL * 1000);
    document.addEventListener("visibilitychange", () => this.running && this.read());
  }

  /** Set the properties of the scan. @param {number} aperture in metres @param {boolean} running */
  setScan(aperture, running) {
    this.aperture = aperture;
    const ended = this.running && !running;
    this.running = running;
    this.isDue = ended; // also if a read is running, which may have started before the last A-line
    if (ended) void this.read();
  }

  /** Read and show the inspection while the panel is open and visible. */
  async read() {
    if (!this.details.open || document.hidden || this.isReading || (this.isComplete && !this.running)) return;
    this.isReading = true;
    this.isDue = false;
    if (!this.body.firstChild) showLoading(this.body, "inspecting the signals …");
    try {
      const signals = /** @type {SignalsReport} */ (await api.get(this.path));
      if (!this.summary.isConnected) replace(this.body, ...this.view);
      this.show(signals);
      this.isComplete = signals.complete && !this.running;
    } catch (error) {
      if (this.running && this.summary.isConnected) replace(this.statusLine, "The update failed; these values are older: ", ...errorElements(error));
      else showError(this.body, error, () => void this.read());
    }
    this.isReading = false;
    if (this.isDue) await this.read();
  }

  /** @param {SignalsReport} signals */
  show(signals) {
    const summaryText = summaryOf(signals);
    if (this.summary.textContent !== summaryText) this.summary.textContent = summaryText;
    this.statusLine.textContent = this.running ? `As of ${formatTime(new Date())}; updated every ${READ_INTERVAL} s while the scan runs and this panel is open.` : "";
    showCodeHistogram(this.counts, signals.histogram);
    this.signalMap.show(signals.maps, signals.bad, this.aperture, signals.histogram.kind === "codes");
    this.showBad(signals.bad);
    replace(this.tables, createTable("Beams", "beam", signals.beams), createTable("Frames", "frame", signals.frames));
    this.showNoise(signals.spectrum);
  }

  /** @param {{frequencies: number[], mean: number[], median: number[]}} spectrum */
  showNoise({ frequencies, mean, median }) {
    const x = frequencies.map((one) => one / 1e6);
    const strongest = mean.reduce((best, one, n) => (one > mean[best] ? n : best), 0);
    this.noise.setAttribute("aria-label", `Noise against frequency, mean and median of the A-lines, up to ${figure(x[x.length - 1])} MHz; the mean is greatest at ${figure(x[strongest])} MHz`);
    this.noiseChart.show([{ name: "mean", x, y: mean }, { name: "median", x, y: median }], { x: "frequency (MHz)", y: "noise" });
  }

  /** @param {import("./labels.js").Bad[]} bad */
  showBad(bad) {
    const open = new Set([...this.list.querySelectorAll("details[open]")].map((one) => /** @type {HTMLElement} */ (one).dataset.kind));
    const one = (/** @type {import("./labels.js").Bad} */ each) => h("button", {
      type: "button", class: "quiet", title: alineText(each), "aria-label": alineText(each), dataset: { aline: each.aline }, onclick: () => this.onSelect(each.aline),
      onfocus: () => this.signalMap.highlight(each), onpointerenter: () => this.signalMap.highlight(each), onblur: () => this.signalMap.highlight(null), onpointerleave: () => this.signalMap.highlight(null),
    }, String(each.aline));
    replaceKeepingFocus(this.list, bad.length ? groupByKind(bad).map(([kind, all]) => h("details", { open: open.has(kind), dataset: { kind } },
      h("summary", null, `${markOf(kind)} ${kind}: ${count(all.length)}`),
      h("div", { class: "row alines" }, all.slice(0, MAX_LISTED).map(one), all.length > MAX_LISTED ? h("span", { class: "dim" }, `and ${count(all.length - MAX_LISTED)} more`) : null))) : h("p", { class: "dim" }, "none"));
  }
}

/** @param {string} title @param {string} name @param {any[]} rows */
function createTable(title, name, rows) {
  if (!rows?.length) return null;
  const columns = Object.keys(rows[0]);
  const cellText = (/** @type {any} */ value) => (typeof value !== "number" ? String(value ?? "–") : Number.isInteger(value) ? count(value) : figure(value));
  return h("div", { class: "scrolls" }, h("table", { dataset: { table: name } }, h("caption", null, title),
    h("thead", null, h("tr", null, columns.map((one) => h("th", { scope: "col", class: "number" }, one === "alines" ? "A-lines" : one.replaceAll("_", " "))))),
    h("tbody", null, rows.map((row) => h("tr", null, columns.map((one) => h("td", { class: "number" }, cellText(row[one]))))))));
}
