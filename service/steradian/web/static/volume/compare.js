// @ts-check
// A second volume beside this one: what differs, by colour or by turns, and how much alike they are in figures.
import { api, onceOnly } from "../api.js";
import { framed, h, replace } from "../dom.js";
import { words } from "../panel_states.js";
import { clock, figure, pressure } from "../units.js";
import { PLANES, sourceOf } from "./volume_data.js";
import { correlation } from "./measurements.js";
import { figures } from "./measure_tools.js";

/** @typedef {import("./shared_state.js").Stage} Stage */
/** @typedef {import("./slice_view.js").SliceView} SliceView */

const TURN = 700; // ms for which each of the two is seen
const BRIGHT = "over what has at least 4 % of the reference's maximum";
const SHARP = "normalised Tenenbaum function: larger is sharper";
/** Figures of the service: name and what it is. */
const NAMES = /** @type {Record<string, [string, string]>} */ ({
  volume_correlation: ["Correlation", "Pearson's, over all voxels"], volume_correlation_of_interest: ["Correlation of the bright", `Pearson's, ${BRIGHT}`],
  ...Object.fromEntries(["x", "y", "z"].map((axis) => [`mip_${axis}_correlation`, [`Correlation along ${axis}`, `Pearson's, of the maxima along ${axis}, ${BRIGHT}`]])),
  mip_z_sharpness: ["Sharpness along z", `Of the maximum along z of this image; ${SHARP}`], mip_z_reference_sharpness: ["– of the reference", `Of the maximum along z of the reference; ${SHARP}`],
  volume_sharpness: ["Sharpness", `Of this image; ${SHARP}`], volume_reference_sharpness: ["– of the reference", `Of the reference; ${SHARP}`],
  volume_amplitude: ["Amplitude", "How many times the reference this image holds: 1 is as bright"],
  volume_error: ["Relative error (l2)", "Distance to the reference over its norm, after the best common factor"],
});

export class Compare {
  /** @param {Stage} stage @param {SliceView[]} views @param {any} about the reconstruction, of the API */
  constructor(stage, views, about) {
    this.stage = stage;
    this.views = views;
    this.about = about;
    this.choice = h("select", { "aria-label": "Reference" }, h("option", { value: "" }, "none"));
    this.choice.addEventListener("change", () => stage.store.change({ against: this.choice.value || null }));
    this.ways = ["difference", "blink"].map((name) =>
      h("button", { type: "button", dataset: { how: name }, onclick: () => stage.store.change({ how: name }) }, name === "blink" ? "Blink" : "Difference"));
    this.turnButton = h("button", { type: "button", onclick: () => this.turn(!this.turned) }, "Show the reference");
    this.told = h("p", { class: "dim small", role: "status" });
    this.numbers = h("div", { class: "stack" });
    this.quality = h("div", { class: "stack" });
    this.element = h("div", { class: "stack" },
      h("label", { class: "stack" }, "Reference", this.choice),
      h("div", { class: "row", role: "group", "aria-label": "How they are compared" }, ...this.ways, this.turnButton),
      this.told, this.numbers, this.quality);
    this.turned = false;
    this.show = framed(() => this.showNow());
    for (const view of views) view.ears.add(this.show);
    stage.store.on((_view, changed) => {
      if (changed.has("against")) void this.follow();
      if (changed.has("how")) this.pace();
      this.show();
    });
  }

  /** List what there is, and take the reference that the address names. */
  async open() {
    try {
      const { items } = await api.get("/reconstructions?state=succeeded&limit=200");
      const others = items.filter((/** @type {any} */ one) => one.id !== this.about.id && one.report?.shape);
      const same = (/** @type {any} */ one) => one.scan_id === this.about.scan_id;
      replace(this.choice, h("option", { value: "" }, others.length ? "none" : "there is no other reconstruction yet"),
        ...[["Of the same scan", others.filter(same)], ["Of other scans", others.filter((/** @type {any} */ one) => !same(one))]]
          .filter(([, some]) => some.length)
          .map(([label, some]) => h("optgroup", { label }, some.map((/** @type {any} */ one) => h("option", { value: one.id }, title(one))))));
      await this.follow();
    } catch (error) {
      replace(this.numbers, ...words(error));
    }
  }

  /** Take the reference that the view names. */
  async follow() {
    const { against } = this.stage.view;
    this.choice.value = against ?? "";
    this.stage.reference = null;
    replace(this.quality);
    if (against) {
      try {
        const reference = sourceOf(await api.get(`/reconstructions/${against}`));
        if (against !== this.stage.view.against) return; // another was chosen meanwhile
        this.stage.reference = reference;
        await this.readQuality(against);
      } catch (error) {
        if (against !== this.stage.view.against) return;
        replace(this.quality, ...words(error));
      }
    }
    this.pace();
    for (const view of this.views) view.read(null);
    this.show();
  }

  /** Blink by itself, but not for who asked for less motion. */
  pace() {
    clearInterval(this.timer);
    const { reference, view } = this.stage;
    this.turn(false);
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (reference && view.how === "blink" && !still) this.timer = setInterval(() => this.turn(!this.turned), TURN);
  }

  /** @param {boolean} turned */
  turn(turned) {
    this.turned = turned;
    for (const view of this.views) view.blink(turned);
    this.turnButton.textContent = turned ? "Show the image" : "Show the reference";
    this.tell();
  }

  tell() {
    const { reference, view } = this.stage;
    const blink = view.how === "blink";
    this.told.textContent = !reference ? "Choose a reconstruction to compare this one with."
      : blink ? `Seen now: ${this.turned ? "the reference" : "this image"}.`
        : this.stage.fits ? `Blue: less than the reference; orange: more; dark: alike. Colours end at ±${pressure(this.stage.differenceEnd)}; projections: the difference of the two maxima; 3-D: this image alone`
          : "They are of different voxels and cannot be subtracted: blink between them, or reconstruct with the same modes and depths.";
  }

  showNow() {
    const { reference, view } = this.stage;
    for (const button of this.ways) {
      button.setAttribute("aria-pressed", String(button.dataset.how === view.how));
      button.disabled = !reference;
    }
    this.turnButton.hidden = !reference || view.how !== "blink";
    this.tell();
    const rows = /** @type {[string, string, string, number][]} */ ([]);
    for (const one of this.views) {
      if (!this.stage.fits || !one.plane || !one.other || one.plane.values.length !== one.other.values.length) continue;
      const value = correlation(one.plane.values, one.other.values);
      rows.push([PLANES[one.axis].join("–"), figure(value), `correlation-${one.axis}`, value]);
    }
    replace(this.numbers, ...(rows.length ? [h("h3", null, "Correlation of what is seen"), h("p", { class: "dim small" }, "Pearson's, of the pixels that each view shows now: 1 where they are alike.")] : []), rows.length ? figures(rows) : null);
  }

  /** What the service found when it compared the volumes, or a button that has it done. @param {string} reference */
  async readQuality(reference) {
    const { items } = await api.get(`/reconstructions/${this.about.id}/quality`);
    if (reference !== this.stage.view.against) return;
    const found = items.find((/** @type {any} */ one) => one.reference_id === reference && one.figures);
    if (found) {
      const rows = Object.entries(found.figures).map(([name, value]) => {
        const [told, what] = NAMES[name.replace(/^image_/, "volume_")] ?? [name.replaceAll("_", " "), ""];
        return [told, value === null ? "–" : figure(Number(value)), name, Number(value), what];
      });
      replace(this.quality, h("h3", null, "Whole volumes"), h("p", { class: "dim small" }, `As the service compares them. Of the bright: ${BRIGHT}.`), figures(/** @type {any} */ (rows)));
    } else if (this.stage.fits) {
      replace(this.quality, h("button", { type: "button", onclick: () => this.measure(reference) }, "Compare the whole volumes"));
    }
  }

  /** Have the service compare the volumes. @param {string} reference */
  async measure(reference) {
    replace(this.quality, h("p", { class: "dim", role: "status" }, "comparing …"));
    try {
      let job = await api.post(`/reconstructions/${this.about.id}/quality`, { reference_id: reference }, { headers: { ...onceOnly(), Prefer: "wait=20" } });
      while (["queued", "running", "cancelling"].includes(job.state)) job = await api.get(job.links.self, { headers: { Prefer: "wait=20" } });
      if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the comparison ${job.state}`);
      await this.readQuality(reference);
    } catch (error) {
      replace(this.quality, ...words(error));
    }
  }

  /** @type {ReturnType<typeof setInterval> | undefined} */
  timer;
}

/** A reconstruction in a line. @param {any} one */
export function title(one) {
  const { method, modes } = one.parameters ?? {};
  const kind = one.kind === "reconstruction" ? "" : `${one.kind}, `;
  return `${clock(one.ended ?? one.created)}, ${kind}${method ?? ""}${modes ? ` ${modes} modes` : ""}, ${one.id.slice(-5)}`;
}
