// @ts-check
// Measurement tools: marks that become named measurements, details of the selected one, points of interest.
import { designQueryAround } from "../design/fields.js";
import { oncePerFrame, h, replaceKeepingFocus } from "../dom.js";
import { measurementDetails } from "./measurement_details.js";
import { measurementVolumes } from "./measurement_volumes.js";
import { formatMm, mmText } from "./panes.js";
import { MARKS, MAX_POINTS } from "./view_state.js";
import { loadOrigin } from "./scan_origin.js";
import { RegionCourses } from "./region_course.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./view_state.js").Triple} Triple */

const TOOL_TEXTS = {
  crosshair: ["Crosshair", "Click or drag in a view to move the crosshair in all views; its value can be kept."],
  line: ["Line", "Drag a line across an object to measure its profile and width (full width at half maximum); each line is kept with a name."],
  region: ["Region", "Drag a rectangle over an object to measure mean, standard deviation and extremes."],
  background: ["Background", "Drag a rectangle next to a region, in the same view, to measure the contrast-to-noise ratio of the region."],
  point: ["Point", "Click a point that a mask should image well, drag its ring in another view to set the depth, then design the mask."],
};

export class MeasureTools {
  /** @param {VolumeState} stage @param {SliceView[]} views @param {import("./measurement_store.js").MeasurementStore} store */
  constructor(stage, views, store) {
    this.stage = stage;
    this.views = views;
    this.store = store;
    /** @type {import("./scan_origin.js").ScanOrigin | null} */
    this.origin = null;
    this.courses = new RegionCourses(stage, store.reconstruction);
    this.buttons = Object.entries(TOOL_TEXTS).map(([name, [text]], n) =>
      h("button", { type: "button", dataset: { tool: name }, title: `Shortcut: ${n + 1}`, onclick: () => stage.store.change({ tool: name }) }, text));
    this.hint = h("p", { class: "dim small" });
    this.message = h("p", { class: "small", role: "status" });
    this.results = h("div", { class: "stack", "aria-live": "polite" });
    this.element = h("div", { class: "stack" }, h("div", { class: "row", role: "group", "aria-label": "Tool" }, ...this.buttons), this.hint, this.message, this.results, measurementVolumes(store));
    this.show = oncePerFrame(() => this.render());
    stage.store.on(this.show);
    stage.onMark = (tool) => void this.measure(tool);
    store.listeners.add(this.show);
    store.listeners.add(() => views.forEach((view) => view.draw()));
    for (const view of views) view.listeners.add(this.show);
    this.render();
  }

  /** Measure a mark by the service; it stays as a draft where that fails. @param {"line" | "region" | "background"} tool */
  async measure(tool) {
    const mark = this.stage.view[tool];
    if (!mark) return;
    const definition = this.definitionOf(tool);
    this.message.textContent = definition ? "" : "Draw a region in the same view first.";
    if (!definition || this.store.keptAs(definition) || !(await this.store.add(definition))) return;
    if (this.stage.view[tool] === mark) this.stage.store.change({ [tool]: null });
  }

  /** Return the definition, without a name, of a mark. @param {"line" | "region" | "background"} tool */
  definitionOf(tool) {
    const mark = this.stage.view[tool];
    if (!mark) return null;
    return tool === "background" ? this.store.contrastOf(mark) : this.store.definitionOf(tool === "line" ? "profile" : "region", mark);
  }

  /** Return what can be done with a mark; one that is kept as a measurement already, as after a reload, is only named. @param {"line" | "region" | "background"} tool */
  draftElement(tool) {
    const definition = this.definitionOf(tool);
    const kept = definition && this.store.keptAs(definition);
    if (kept) return h("p", { class: "small", dataset: { kept: tool } }, `This ${tool} is kept as ${kept.measurement.name}.`);
    return h("div", { class: "row" },
      h("button", { type: "button", class: "primary", onclick: () => void this.measure(tool) }, `Measure the ${tool}`),
      h("button", { type: "button", class: "quiet", "aria-label": `Remove the ${tool}`, onclick: () => this.stage.store.change({ [tool]: null }) }, "remove"));
  }

  render() {
    const { view } = this.stage;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.tool === view.tool));
    this.hint.textContent = TOOL_TEXTS[/** @type {keyof typeof TOOL_TEXTS} */ (view.tool)][1];
    const drafts = MARKS.filter((tool) => view[tool]).map((tool) => this.draftElement(tool));
    const { selected } = this.store;
    const parts = [view.tool === "crosshair" && h("button", { type: "button", onclick: () => void this.store.add(this.store.definitionOfCrosshair()) }, "Keep the value at the crosshair"),
      ...drafts, selected && measurementDetails(this.stage, this.views, selected, ["region", "contrast"].includes(selected.measurement.kind) ? this.courses.resultFor(selected.measurement) : null),
      (view.points.length || view.tool === "point") && this.points(view.points)];
    if (!replaceKeepingFocus(this.results, ...parts)) this.buttons.find((button) => button.dataset.tool === view.tool)?.focus();
  }

  /** Show points of interest, with a link to the design of a mask around them. @param {Triple[]} points */
  points(points) {
    if (points.length && !this.origin) void this.loadOrigin();
    const { flat } = this.stage.source;
    const setPoints = (/** @type {Triple[]} */ all) => this.stage.store.change({ points: all });
    const rows = points.map((place, n) => h("li", null, `x ${formatMm(place[0])}${flat ? "" : `, y ${formatMm(place[1])}`}, z ${mmText(place[2])} `,
      h("button", { type: "button", class: "quiet", "aria-label": `Remove point ${n + 1}`, onclick: () => setPoints(points.filter((_, m) => m !== n)) }, "remove")));
    const addButton = h("button", { type: "button", disabled: points.length >= (flat ? 1 : MAX_POINTS), onclick: () => setPoints([...points, this.stage.position]) }, "Add the crosshair");
    const designLink = h("a", { class: "button primary", href: `/design?${designQueryAround(points, flat, this.origin)}` }, points.length > 1 ? `Mask around these ${points.length} points` : "Mask around this point");
    return h("section", { dataset: { result: "points" } }, h("h3", null, "Points of interest"), h("ol", { class: "points" }, rows), h("div", { class: "row" }, addButton, points.length ? designLink : null));
  }

  /** Load the properties of the scan that the new design adopts. */
  async loadOrigin() {
    this.origin = { aperture: null, plan: null, sample: "" };
    this.origin = await loadOrigin(this.store.reconstruction.scan_id);
    this.show();
  }
}
