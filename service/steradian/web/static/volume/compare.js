// @ts-check
// Comparison with a reference volume: difference, blinking and figures of merit.
import { api, idempotencyHeaders } from "../api.js";
import { debounce, oncePerFrame, h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { formatDate, figure } from "../units.js";
import { methodText, soundSpeedText } from "../reconstructions/summary.js";
import { frameText } from "../reconstructions/volume_names.js";
import { PLANES, createSource } from "./volume_data.js";
import { correlation } from "./measurements.js";
import { figureList } from "./measurement_details.js";
import { overlayOptions } from "./overlay_options.js";
import { COMPARE_MODES } from "./view_state.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./slice_view.js").SliceView} SliceView */

const BLINK_INTERVAL = 700; // ms for which each of the two images is shown
const MAX_LISTED = 60; // volumes of this series
const METRICS_DELAY = 300; // ms after the last change of the volume; longer than playback shows one
const BRIGHT_REGION = "over voxels with at least 4 % of the reference's maximum";
const SHARPNESS_NOTE = "normalised Tenenbaum function: larger is sharper";
/** Labels and descriptions of the service's figures of merit. */
const METRICS = /** @type {Record<string, [string, string]>} */ ({
  volume_correlation: ["Correlation", "Pearson correlation over all voxels"], volume_correlation_of_interest: ["Correlation of bright voxels", `Pearson correlation ${BRIGHT_REGION}`],
  ...Object.fromEntries(["x", "y", "z"].map((axis) => [`mip_${axis}_correlation`, [`Correlation along ${axis}`, `Pearson correlation of the maxima along ${axis}, ${BRIGHT_REGION}`]])),
  mip_z_sharpness: ["Sharpness along z", `Of the maximum along z of this image; ${SHARPNESS_NOTE}`], mip_z_reference_sharpness: ["– of the reference", `Of the maximum along z of the reference; ${SHARPNESS_NOTE}`],
  volume_sharpness: ["Sharpness", `Of this image; ${SHARPNESS_NOTE}`], volume_reference_sharpness: ["– of the reference", `Of the reference; ${SHARPNESS_NOTE}`],
  volume_amplitude: ["Amplitude", "Scale factor between reference and image; 1 means equal brightness"],
  volume_error: ["Relative error (l2)", "Norm of the difference relative to the norm of the reference, after optimum scaling"],
});

export class Compare {
  /** @param {VolumeState} stage @param {SliceView[]} views @param {any} reconstruction the reconstruction, of the API */
  constructor(stage, views, reconstruction) {
    this.stage = stage;
    this.views = views;
    this.reconstruction = reconstruction;
    this.choice = h("select", { "aria-label": "Reference" }, h("option", { value: "" }, "none"));
    this.choice.addEventListener("change", () => stage.store.change({ against: this.choice.value || null }));
    this.modeButtons = COMPARE_MODES.map((name) => h("button", { type: "button", dataset: { how: name }, onclick: () => this.selectMode(name) }, name[0].toUpperCase() + name.slice(1)));
    this.overlay = overlayOptions(stage);
    this.toggleButton = h("button", { type: "button", onclick: () => this.showReference(!this.isReferenceShown) }, "Show the reference");
    this.status = h("p", { class: "dim small", role: "status" });
    this.correlations = h("div", { class: "stack" });
    this.metrics = h("div", { class: "stack" });
    this.element = h("div", { class: "stack" },
      h("label", { class: "stack" }, "Reference", this.choice),
      h("div", { class: "row", role: "group", "aria-label": "Comparison mode" }, ...this.modeButtons, this.toggleButton),
      this.status, this.overlay.element, this.correlations, this.metrics);
    this.isReferenceShown = false;
    this.show = oncePerFrame(() => this.render());
    for (const view of views) view.listeners.add(this.show);
    const readMetricsSoon = debounce(() => void this.showMetrics(), METRICS_DELAY);
    stage.store.on((_view, changed) => {
      if (changed.has("against")) void this.loadReference();
      else if (changed.has("index") && stage.reference) {
        replace(this.metrics);
        readMetricsSoon();
      }
      if (changed.has("how")) this.updateBlinking();
      this.show();
    });
  }

  /** Select a way of comparing; two colours that add to white are the first of an overlay. @param {string} name */
  selectMode(name) {
    const { map } = this.stage.view;
    this.stage.store.change({ how: name, ...(name === "overlay" && map === "inferno" ? { map: "red" } : {}) });
  }

  /** Return the options of the volumes of this series; of a long one the first at each wavelength. */
  get seriesOptions() {
    const frames = this.reconstruction.report.frames ?? [];
    const seen = new Set();
    const chosen = frames.map((/** @type {any} */ frame, /** @type {number} */ n) => ({ frame, n })).filter((/** @type {any} */ { frame }) => frames.length <= MAX_LISTED || (!seen.has(frame.excitation_m) && seen.add(frame.excitation_m)));
    return chosen.map((/** @type {any} */ { frame, n }) => h("option", { value: `${this.reconstruction.id}:${n}` }, frameText(frame)));
  }

  /** List the candidates and load the reference of the URL. */
  async loadReferences() {
    try {
      const { items } = await api.get("/reconstructions?state=succeeded&limit=200");
      const candidates = items.filter((/** @type {any} */ one) => one.id !== this.reconstruction.id && one.report?.shape);
      const isSameScan = (/** @type {any} */ one) => one.scan_id === this.reconstruction.scan_id;
      const { seriesOptions } = this;
      replace(this.choice, h("option", { value: "" }, candidates.length || seriesOptions.length ? "none" : "no other reconstruction"),
        seriesOptions.length ? h("optgroup", { label: "This series" }, seriesOptions) : null, ...[["Of the same scan", candidates.filter(isSameScan)], ["Of other scans", candidates.filter((/** @type {any} */ one) => !isSameScan(one))]]
          .filter(([, group]) => group.length)
          .map(([label, group]) => h("optgroup", { label }, group.map((/** @type {any} */ one) => h("option", { value: one.id }, reconstructionTitle(one))))));
      await this.loadReference();
    } catch (error) {
      replace(this.correlations, ...errorElements(error));
    }
  }

  /** Load the reference of the view. */
  async loadReference() {
    const { against } = this.stage.view;
    const [referenceId, fixed] = against?.split(":") ?? [null];
    this.choice.value = against ?? "";
    this.stage.reference = null;
    replace(this.metrics);
    if (referenceId) {
      try {
        const view = await api.get(`/reconstructions/${referenceId}`);
        const reference = createSource(view);
        if (against !== this.stage.view.against) return; // another reference was selected meanwhile
        this.stage.setReference(reference, view, fixed === undefined ? null : Number(fixed));
        await this.showMetrics();
      } catch (error) {
        if (against !== this.stage.view.against) return;
        replace(this.metrics, ...errorElements(error));
      }
    }
    this.updateBlinking();
    for (const view of this.views) view.requestData(null);
    this.stage.store.notify(["difference"]); // captions, and the 3-D overlay
    this.show();
  }

  /** The two volumes that are compared; changes with reference and index. */
  get pair() {
    const { source, reference } = this.stage;
    return reference ? [reference.id, source.index, reference.index].join() : "";
  }

  /** Show the figures of merit or the error. */
  async showMetrics() {
    const { reference } = this.stage;
    const { pair } = this;
    if (!reference) return;
    try {
      await this.readMetrics(reference.id);
    } catch (error) {
      if (pair === this.pair) replace(this.metrics, ...errorElements(error));
    }
  }

  /** Start or stop blinking; do not blink if the user prefers reduced motion. */
  updateBlinking() {
    clearInterval(this.timer);
    const { reference, view } = this.stage;
    this.showReference(false);
    const prefersReducedMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (reference && view.how === "blink" && !prefersReducedMotion) this.timer = setInterval(() => this.showReference(!this.isReferenceShown), BLINK_INTERVAL);
  }

  /** @param {boolean} isReferenceShown */
  showReference(isReferenceShown) {
    this.isReferenceShown = isReferenceShown;
    for (const view of this.views) view.showReference(isReferenceShown);
    this.toggleButton.textContent = isReferenceShown ? "Show the image" : "Show the reference";
    this.updateStatus();
  }

  /** Say which volume of a reference that is a series is shown. */
  get volumeText() {
    const { reference, source } = this.stage;
    if (!reference || reference.index === null) return "";
    return ` The reference is volume ${reference.index + 1} of ${reference.volumes} of its series${reference.index === source.index && reference.volumes === source.volumes ? ", as here" : ""}: ${this.stage.referenceName}.`;
  }

  updateStatus() {
    const { reference, view } = this.stage;
    const blink = view.how === "blink";
    this.status.textContent = !reference ? "Select a reference reconstruction."
      : view.how === "overlay" ? "The colours of both are added."
        : blink ? `Shown now: ${this.isReferenceShown ? "the reference" : "this image"}.`
        : this.stage.isComparable ? `Blue: below the reference; orange: above; dark: equal. Colour range ±${this.stage.valueText(this.stage.differenceEnd)}; projections show the difference of the two maxima, 3-D shows this image only.`
          : "The voxel grids differ, so the images cannot be subtracted: use Blink, or reconstruct with the same modes and depth range.";
    this.status.append(this.volumeText);
  }

  render() {
    const { reference, view } = this.stage;
    for (const button of this.modeButtons) {
      button.setAttribute("aria-pressed", String(button.dataset.how === view.how));
      button.disabled = !reference;
    }
    this.overlay.show();
    this.toggleButton.hidden = !reference || view.how !== "blink";
    this.updateStatus();
    const rows = /** @type {[string, string, string, number][]} */ ([]);
    for (const one of this.views) {
      if (!this.stage.isComparable || !one.plane || !one.other || one.plane.values.length !== one.other.values.length) continue;
      const value = correlation(one.plane.values, one.other.values);
      rows.push([PLANES[one.axis].join("–"), figure(value), `correlation-${one.axis}`, value]);
    }
    replace(this.correlations, ...(rows.length ? [h("h3", null, "Correlation of the images"), h("p", { class: "dim small" }, "Pearson correlation of each view's slice or projection over all of its depths, also those not shown; 1: equal but for a factor and an offset.")] : []), rows.length ? figureList(rows) : null);
  }

  /** Show the figures of merit, or a button that computes them. @param {string} reference */
  async readMetrics(reference) {
    const { pair } = this;
    const { items } = await api.get(`/reconstructions/${this.reconstruction.id}/quality`);
    if (pair !== this.pair) return; // another volume was selected meanwhile
    const [index, referenceIndex] = [this.stage.source.index ?? 0, this.stage.reference?.index ?? 0];
    const isPair = (/** @type {any} */ one) => one.reference_id === reference && (one.index ?? 0) === index && (one.reference_index ?? 0) === referenceIndex;
    const metricsEntry = items.find((/** @type {any} */ one) => isPair(one) && one.figures);
    if (metricsEntry) {
      const rows = Object.entries(metricsEntry.figures).map(([name, value]) => {
        const [label, description] = METRICS[name.replace(/^image_/, "volume_")] ?? [name.replaceAll("_", " "), ""];
        return [label, value === null ? "–" : figure(Number(value)), name, Number(value), description];
      });
      replace(this.metrics, h("h3", null, "Whole volumes"), h("p", { class: "dim small" }, `Computed by the service. Bright voxels: ${BRIGHT_REGION}.`), figureList(/** @type {any} */ (rows)));
    } else if (this.stage.isComparable) {
      replace(this.metrics, h("button", { type: "button", onclick: () => this.computeMetrics(reference) }, "Compare the whole volumes"));
    }
  }

  /** Compute the figures of merit with the service. @param {string} reference */
  async computeMetrics(reference) {
    replace(this.metrics, h("p", { class: "dim", role: "status" }, "comparing …"));
    const { pair } = this;
    const [index, referenceIndex] = [this.stage.source.index, this.stage.reference?.index ?? null];
    const body = { reference_id: reference, ...(index === null ? {} : { index }), ...(referenceIndex === null ? {} : { reference_index: referenceIndex }) };
    try {
      let job = await api.post(`/reconstructions/${this.reconstruction.id}/quality`, body, { headers: { ...idempotencyHeaders(), Prefer: "wait=20" } });
      while (["queued", "running", "cancelling"].includes(job.state)) job = await api.get(job.links.self, { headers: { Prefer: "wait=20" } });
      if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the comparison ${job.state}`);
      if (pair === this.pair) await this.readMetrics(reference);
    } catch (error) {
      if (pair === this.pair) replace(this.metrics, ...errorElements(error));
    }
  }

  /** @type {ReturnType<typeof setInterval> | undefined} */
  timer;
}

/** Describe a reconstruction in one line. @param {any} one */
export function reconstructionTitle(one) {
  return [one.id.slice(-5), methodText(one), soundSpeedText(one), formatDate(one.ended ?? one.created)].filter(Boolean).join(", "); // a short field cuts the end
}
