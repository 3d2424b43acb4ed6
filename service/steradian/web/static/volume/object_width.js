// @ts-check
// Point spread at a line, and the diameter corrected for it: a job of the service, asked for by a button.
import { api, onceOnly } from "../api.js";
import { h, replace } from "../dom.js";
import { words } from "../panel_states.js";
import { PLANES, at } from "./volume_data.js";
import { mmOf } from "./panes.js";
import { lengthOf, lengthWithError } from "./scale.js";

/** @typedef {import("./view_state.js").Mark} Mark */

export class ObjectWidths {
  /** @param {import("./shared_state.js").Stage} stage @param {any} about the reconstruction, of the API */
  constructor(stage, about) {
    this.stage = stage;
    this.about = about;
    /** @type {Map<string, HTMLElement>} by the ends of the line */
    this.shown = new Map();
  }

  /** Ends of a line in metres; across the plane it lies at the crosshair. @param {Mark} mark */
  ends(mark) {
    return [mark.from, mark.to].map((end) => {
      const place = [...this.stage.place];
      PLANES[mark.plane].forEach((axis, n) => {
        place[at(axis)] = end[n];
      });
      return place.map((mm) => 1e-3 * mm);
    });
  }

  /** Part of a line's result. @param {Mark} mark */
  of(mark) {
    if (this.stage.source.flat || this.about.kind === "what-if") return null;
    const [start, end] = this.ends(mark);
    const key = JSON.stringify([start, end]);
    const known = this.shown.get(key);
    if (known) return known;
    const [place, axis] = [this.stage.place[at(mark.plane)], mark.plane];
    const told = h("div", { class: "stack small", role: "status", dataset: { width: "" } });
    const button = h("button", { type: "button", onclick: () => void ask() }, "Point spread and corrected diameter");
    const ask = async () => {
      button.disabled = true;
      try {
        await this.measure(start, end, told, `slice at ${axis} ${mmOf(place)}`);
        button.remove();
      } catch (error) {
        replace(told, ...words(error));
        button.disabled = false;
      }
    };
    const element = h("div", { class: "stack" }, button, told);
    this.shown.set(key, element);
    return element;
  }

  /** @param {number[]} start @param {number[]} end @param {HTMLElement} told @param {string} where */
  async measure(start, end, told, where) {
    const { scan_id, frame, wavelength, average } = this.about;
    const asked = { kind: "width", scan_id, reconstruction_id: this.about.id, start, end, frame, wavelength, average };
    let job = await api.post("/jobs", asked, { headers: onceOnly() });
    while (["queued", "running", "cancelling"].includes(job.state)) {
      told.textContent = job.progress.total ? `image ${job.progress.done} of about ${job.progress.total} …` : "waiting for its turn …";
      job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
    }
    if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the measurement ${job.state}`);
    const found = job.result.width;
    const length = (/** @type {number | null} */ metres) => (metres === null ? "–" : lengthOf(1e3 * metres));
    const error = found.repeatability === null ? null : 1e3 * found.repeatability;
    const corrected = found.at_most === null ? length(found.corrected) : `at most ${length(found.at_most)}`;
    const rows = [[`FWHM, ${where}`, lengthWithError(1e3 * found.fwhm, error)], ["Point spread", length(found.point_spread)], ["Corrected", `${corrected}${found.corrected ? `, as a ${found.shape}` : ""}`]];
    replace(told, h("dl", { class: "figures" }, rows.flatMap(([name, value]) => [h("dt", null, name), h("dd", null, value)])),
      found.reason ? h("p", { class: "dim" }, `${found.reason}.`) : null);
  }
}
