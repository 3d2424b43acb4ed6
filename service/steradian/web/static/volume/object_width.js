// @ts-check
// Point spread at a line and corrected object width, computed by a job of the service.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { PLANES, axisIndex } from "./volume_data.js";
import { mmText } from "./panes.js";
import { lengthOf, lengthWithError } from "./scale.js";

/** @typedef {import("./view_state.js").Mark} Mark */

export class ObjectWidths {
  /** @param {import("./volume_state.js").VolumeState} stage @param {any} reconstruction the reconstruction, of the API */
  constructor(stage, reconstruction) {
    this.stage = stage;
    this.reconstruction = reconstruction;
    /** @type {Map<string, HTMLElement>} by the ends of the line */
    this.results = new Map();
  }

  /** Return the ends of a line in metres; its plane is that of the crosshair. @param {Mark} mark */
  endsOf(mark) {
    return [mark.from, mark.to].map((end) => {
      const place = [...this.stage.position];
      PLANES[mark.plane].forEach((axis, n) => {
        place[axisIndex(axis)] = end[n];
      });
      return place.map((mm) => 1e-3 * mm);
    });
  }

  /** Create the result of a line. @param {Mark} mark */
  resultFor(mark) {
    if (this.stage.source.flat || this.reconstruction.kind === "what-if") return null;
    const [start, end] = this.endsOf(mark);
    const key = JSON.stringify([start, end]);
    const cached = this.results.get(key);
    if (cached) return cached;
    const [place, axis] = [this.stage.position[axisIndex(mark.plane)], mark.plane];
    const status = h("div", { class: "stack small", role: "status", dataset: { width: "" } });
    const button = h("button", { type: "button", onclick: () => void startMeasurement() }, "Point spread and corrected diameter");
    const startMeasurement = async () => {
      button.disabled = true;
      try {
        await this.measure(start, end, status, `slice at ${axis} ${mmText(place)}`);
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

  /** @param {number[]} start @param {number[]} end @param {HTMLElement} status @param {string} sliceText */
  async measure(start, end, status, sliceText) {
    const { scan_id, frame, wavelength, average } = this.reconstruction;
    const body = { kind: "width", scan_id, reconstruction_id: this.reconstruction.id, start, end, frame, wavelength, average };
    let job = await api.post("/jobs", body, { headers: idempotencyHeaders() });
    while (["queued", "running", "cancelling"].includes(job.state)) {
      status.textContent = job.progress.total ? `image ${job.progress.done} of about ${job.progress.total} …` : "queued …";
      job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
    }
    if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the measurement ${job.state}`);
    const measured = job.result.width;
    const length = (/** @type {number | null} */ metres) => (metres === null ? "–" : lengthOf(1e3 * metres));
    const error = measured.repeatability === null ? null : 1e3 * measured.repeatability;
    const corrected = measured.at_most === null ? length(measured.corrected) : `at most ${length(measured.at_most)}`;
    const rows = [[`FWHM, ${sliceText}`, lengthWithError(1e3 * measured.fwhm, error)], ["Point spread", length(measured.point_spread)], ["Corrected", `${corrected}${measured.corrected ? `, as a ${measured.shape}` : ""}`]];
    replace(status, h("dl", { class: "figures" }, rows.flatMap(([name, value]) => [h("dt", null, name), h("dd", null, value)])),
      measured.reason ? h("p", { class: "dim" }, `${measured.reason}.`) : null);
  }
}
