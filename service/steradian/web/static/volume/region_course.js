// @ts-check
// Course of a region over the volumes of a series, computed by a job of the service.
import { api, BASE, idempotencyHeaders } from "../api.js";
import { LineChart } from "../charts.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { wavelengthText } from "../units.js";
import { mmText } from "./panes.js";
import { PLANES, axisIndex } from "./volume_data.js";

/** @typedef {import("./measurement_store.js").Definition} Definition */
/** @typedef {[number, number]} Pair */
/** @typedef {import("./view_state.js").Axis} Axis */

export class RegionCourses {
  /** @param {import("./volume_state.js").VolumeState} stage @param {any} reconstruction the series, of the API */
  constructor(stage, reconstruction) {
    this.stage = stage;
    this.reconstruction = reconstruction;
    /** @type {Map<string, HTMLElement>} by the box */
    this.results = new Map();
  }

  /** Return a rectangle in a slab as a region of the service. @param {Definition} definition @param {Pair} start @param {Pair} end @param {string} name */
  boxOf({ axis, slab }, start, end, name) {
    const { flat, spacing } = this.stage.source;
    const half = 0.5e-3 * spacing[axisIndex(axis)];
    /** @type {Pair[]} */
    const ranges = [[0, 0], [0, 0], [0, 0]];
    if (slab) ranges[axisIndex(axis)] = [slab[0] - half, slab[1] + half];
    PLANES[axis].forEach((one, part) => {
      ranges[axisIndex(one)] = [Math.min(start[part], end[part]), Math.max(start[part], end[part])];
    });
    return { kind: "box", name, ranges: ranges.filter((_, n) => !flat || n !== 1) };
  }

  /** Create the course of a region, and of its contrast to a background. @param {Definition} definition */
  resultFor(definition) {
    if (this.stage.source.index === null || this.reconstruction.kind === "unmixing") return null;
    const { start: corner, end, background_start: from, background_end: to } = definition;
    const body = { regions: [this.boxOf(definition, corner, end ?? corner, "region")], ...(from && to ? { background: this.boxOf(definition, from, to, "background") } : {}) };
    const key = JSON.stringify(body);
    const cached = this.results.get(key);
    if (cached) return cached;
    const status = h("div", { class: "stack small", role: "status", dataset: { course: "" } });
    const button = h("button", { type: "button", onclick: () => void start() }, "Course over the series");
    const start = async () => {
      button.disabled = true;
      try {
        await this.measure(body, definition.axis, status);
        button.remove();
      } catch (error) {
        replace(status, ...errorElements(error));
        button.disabled = false;
      }
    };
    const element = h("div", { class: "stack" }, button, status);
    this.results.set(key, element);
    return element;
  }

  /** @param {any} body @param {Axis} plane of the region @param {HTMLElement} status */
  async measure(body, plane, status) {
    let job = await api.post("/jobs", { kind: "regions", reconstruction_id: this.reconstruction.id, ...body }, { headers: idempotencyHeaders() });
    while (["queued", "running", "cancelling"].includes(job.state)) {
      status.textContent = job.progress.total ? `volume ${job.progress.done + 1} of ${job.progress.total} …` : "queued …";
      job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
    }
    if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the measurement ${job.state}`);
    const host = h("div", { class: "chart course" });
    const table = `${BASE}/jobs/${job.id}/files/regions.csv`;
    const [first, last] = this.depthOf(body.regions[0], plane);
    replace(status, host, h("p", { class: "dim" }, `Mean of all voxels of the box, ${plane} ${mmText(1e3 * first)} to ${mmText(1e3 * last)}.`), h("a", { class: "button", href: table, download: "regions.csv" }, "Table (CSV)"));
    this.draw(host, job.result.rows);
  }

  /** Return the ends of a box across the plane of its rectangle. @param {any} box @param {Axis} plane @returns {[number, number]} */
  depthOf({ ranges }, plane) {
    return ranges[this.stage.source.flat ? (plane === "z" ? 1 : 0) : axisIndex(plane)];
  }

  /** Draw the means of each wavelength. @param {HTMLElement} host @param {any[]} rows */
  draw(host, rows) {
    const hasTimes = rows.every((row) => row.time !== null) && rows.some((row) => row.time > 0);
    /** @type {Map<number, {name: string, x: number[], y: number[]}>} */
    const lines = new Map();
    rows.forEach((row, n) => {
      const name = row.excitation ? wavelengthText(row.excitation) : "mean";
      const line = lines.get(row.excitation) ?? { name, x: [], y: [] };
      line.x.push(hasTimes ? row.time : n + 1);
      line.y.push(row.mean);
      lines.set(row.excitation, line);
    });
    new LineChart(host).show([...lines.values()], { x: hasTimes ? "time (s)" : "volume of the series", y: "mean (arb. u.)" });
    host.dataset.means = JSON.stringify(rows.map((row) => row.mean));
  }
}
