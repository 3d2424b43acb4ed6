// @ts-check
// Preview of a recording: format, dimensions, sensor positions and a few A-lines.
import { LineChart } from "./charts.js";
import { h, replace } from "./dom.js";
import { PointMap } from "./point_map.js";
import { errorElements } from "./panel_states.js";
import { colour } from "./theme.js";
import { count, frequency, mm, shortTime } from "./units.js";

const NOT_STATED = "not stated";

export class RecordingPreview {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.figures = h("dl", { class: "figures across" });
    this.errorBox = h("div", { class: "remarks", role: "alert" });
    this.notes = h("ul", { class: "dim", "data-steradian": "data-notes" });
    this.stage = h("div", { class: "stage" });
    const chart = h("div", { class: "chart" });
    this.chart = new LineChart(chart);
    this.noPositions = h("div", { class: "state" }, h("strong", null, "Sensor positions are not stated"), h("span", null, "Enter the grid pitch, or add a file with the positions."));
    this.pictures = h("div", { class: "two" }, this.stage, chart);
    replace(host, h("h2", null, "Preview"), this.errorBox, this.figures, this.notes, this.pictures);
    this.plane = new PointMap(this.stage, "Sensor positions");
    this.stage.append(this.noPositions);
  }

  /** @param {unknown} error */
  fail(error) {
    replace(this.errorBox, h("div", { class: "state failed" }, ...errorElements(error)));
    this.pictures.hidden = this.figures.hidden = true;
    replace(this.notes);
  }

  /** @param {any} preview of the API */
  show(preview) {
    replace(this.errorBox);
    this.pictures.hidden = this.figures.hidden = false;
    replace(this.figures, figuresOf(preview).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
    replace(this.notes, (preview.notes ?? []).map((/** @type {string} */ note) => h("li", null, note)));
    this.noPositions.hidden = preview.positions !== null;
    this.plane.canvas.hidden = preview.positions === null;
    this.plane.palette = [colour("--accent")];
    this.plane.classes = new Uint8Array(preview.positions?.length ?? 0);
    this.plane.show((preview.positions ?? []).map((/** @type {number[]} */ [x, y = 0]) => [x, y]), preview.aperture ?? 1);
    this.drawLines(preview);
  }

  /** @param {any} preview */
  drawLines({ rows, traces, sampling_interval: interval, time_zero: zero }) {
    const xValue = (/** @type {number} */ n) => (interval === null ? n : (zero + n * interval) * 1e6);
    const lines = traces.map((/** @type {number[]} */ y, /** @type {number} */ n) => ({ name: `A-line ${rows[n]}`, x: y.map((_, k) => xValue(k)), y }));
    this.chart.show(lines, { x: interval === null ? "sample" : "time (µs)", y: "amplitude (as in the file)" });
  }
}

/** @param {any} preview @returns {[string, string][]} */
function figuresOf({ format, points, frames, samples, dtype, sampling_interval: interval, time_zero: zero, sound_speed: speed, aperture, depth }) {
  const depthAt = (/** @type {number} */ time) => mm(Math.max(0, time) * speed, 1);
  const last = interval === null || speed === null ? null : depthAt(zero + (samples - 1) * interval);
  return [
    ["Format", format],
    ["A-lines", `${count(points)}${frames > 1 ? `, ${count(frames)} frames` : ""}`],
    ["Samples", `${count(samples)} (${dtype})`],
    ["Sampling interval", interval === null ? NOT_STATED : `${shortTime(interval)} (${frequency(1 / interval)})`],
    ["First sample", `${shortTime(zero)} after the pulse`],
    ["Speed of sound", speed === null ? NOT_STATED : `${speed} m/s`],
    ["Aperture", aperture === null ? NOT_STATED : mm(aperture)],
    ["Recorded depth", last === null ? "–" : zero > 0 ? `${depthAt(zero)} to ${last}` : last],
    ["Point of interest", depth === null ? "none" : `${mm(depth)} deep`],
  ];
}
