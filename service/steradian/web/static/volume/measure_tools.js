// @ts-check
// Measurement tools: profile and width of a line, statistics of a region, contrast to a background, points of interest.
import { api } from "../api.js";
import { designQueryAround } from "../design/fields.js";
import { oncePerFrame, h, replaceKeepingFocus, s } from "../dom.js";
import { PRESSURE, count, figure, pressure } from "../units.js";
import { PLANES } from "./volume_data.js";
import { contrastToNoise, fwhm, profile, statistics } from "./measurements.js";
import { formatMm, mmText } from "./panes.js";
import { lengthOf, lengthWithError, ticks } from "./scale.js";
import { MAX_POINTS } from "./view_state.js";
import { ObjectWidths } from "./object_width.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./view_state.js").Mark} Mark */
/** @typedef {import("./view_state.js").Triple} Triple */

const TOOL_TEXTS = {
  crosshair: ["Crosshair", "Click or drag in a view to move the crosshair in all views."],
  line: ["Line", "Drag a line across an object to measure its profile and full width at half maximum."],
  region: ["Region", "Drag a rectangle over an object to measure mean, standard deviation and extremes."],
  background: ["Background", "Drag a rectangle next to the object to measure the contrast-to-noise ratio."],
  point: ["Point", "Click a point that a mask should image well, drag its ring in another view to set the depth, then design the mask."],
};
const [WIDTH, HEIGHT, LEFT, TOP, BOTTOM] = [264, 154, 40, 22, 20];

export class MeasureTools {
  /** @param {VolumeState} stage @param {SliceView[]} views @param {any} reconstruction the reconstruction, of the API */
  constructor(stage, views, reconstruction) {
    this.stage = stage;
    this.views = views;
    this.reconstruction = reconstruction;
    /** @type {number | null | undefined} aperture (m) of the scan's mask; undefined: not requested, null: unknown */
    this.aperture = undefined;
    this.widths = new ObjectWidths(stage, reconstruction);
    this.buttons = Object.entries(TOOL_TEXTS).map(([name, [text]], n) =>
      h("button", { type: "button", dataset: { tool: name }, title: `Shortcut: ${n + 1}`, onclick: () => stage.store.change({ tool: name }) }, text));
    this.hint = h("p", { class: "dim small" });
    this.results = h("div", { class: "stack", "aria-live": "polite" });
    this.element = h("div", { class: "stack" }, h("div", { class: "row", role: "group", "aria-label": "Tool" }, ...this.buttons), this.hint, this.results);
    this.show = oncePerFrame(() => this.render());
    stage.store.on(this.show);
    for (const view of views) view.listeners.add(this.show);
    this.render();
  }

  /** Return the visible plane of a mark. @param {Mark} mark */
  shownPlane(mark) {
    return this.views.find((view) => view.axis === mark.plane)?.plane ?? null;
  }

  render() {
    const { view } = this.stage;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.tool === view.tool));
    this.hint.textContent = TOOL_TEXTS[/** @type {keyof typeof TOOL_TEXTS} */ (view.tool)][1];
    const parts = [view.line && this.line(view.line), view.region && this.region(view.region, "Region", "region")];
    parts.push(view.background && this.region(view.background, "Background", "background"));
    if (view.region && view.background) parts.push(this.contrast(view.region, view.background));
    if (view.points.length || view.tool === "point") parts.push(this.points(view.points));
    if (!replaceKeepingFocus(this.results, ...parts)) this.buttons.find((button) => button.dataset.tool === view.tool)?.focus();
  }

  /** @param {string} title @param {"line" | "region" | "background"} name @param {...(Node | null)} children */
  result(title, name, ...children) {
    const clear = h("button", {
      type: "button", class: "quiet", "aria-label": `Remove the ${name}`, onclick: () => this.stage.store.change({ [name]: null }),
    }, "remove");
    return h("section", { dataset: { result: name } }, h("div", { class: "row spread" }, h("h3", null, title), clear), ...children);
  }

  /** @param {Mark} mark */
  line(mark) {
    const plane = this.shownPlane(mark);
    if (!plane) return null;
    const measured = profile(plane, mark.from, mark.to);
    const width = fwhm(measured);
    const length = Math.hypot(mark.to[0] - mark.from[0], mark.to[1] - mark.from[1]);
    return this.result(`Line in ${PLANES[mark.plane].join("–")}`, "line", this.chart(measured, width),
      figureList([
        ["FWHM", width ? lengthWithError(width.width, width.error) : "no peak falls to half its height on both sides", "fwhm", width?.width],
        ["Peak above base", width ? `${figure(width.height)} above ${Math.abs(width.base) < 1e-3 * width.height ? `0 ${PRESSURE}` : pressure(width.base)}` : "–"],
        ["Length", lengthOf(length)],
      ]),
      width && width.error !== null ? h("p", { class: "dim small" }, "± is the repeatability under noise, not the accuracy: the width includes the point spread of the mask.") : null,
      width ? this.widths.resultFor(mark) : null,
      width && width.error === null ? h("p", { class: "dim small" }, "Draw a longer line to estimate the noise and the repeatability of the width.") : null);
  }

  /** @param {Mark} mark @param {string} title @param {"region" | "background"} name */
  region(mark, title, name) {
    const plane = this.shownPlane(mark);
    const measured = plane && statistics(plane, mark);
    if (!measured) return this.result(title, name, h("p", { class: "dim" }, "The rectangle does not contain a voxel centre."));
    return this.result(`${title} in ${PLANES[mark.plane].join("–")}`, name, figureList([
      ["Mean", pressure(measured.mean), "mean", measured.mean],
      ["Standard deviation", pressure(measured.deviation), "deviation", measured.deviation],
      ["Minimum, maximum", `${figure(measured.least)}, ${pressure(measured.greatest)}`],
      ["Area", `${figure(measured.area)} mm², ${count(measured.count)} voxels`],
    ]));
  }

  /** @param {Mark} region @param {Mark} background */
  contrast(region, background) {
    const [one, other] = [region, background].map((mark) => {
      const plane = this.shownPlane(mark);
      return plane && statistics(plane, mark);
    });
    if (!one || !other) return null;
    const ratio = contrastToNoise(one, other);
    return h("section", { dataset: { result: "contrast" } }, h("h3", null, "Contrast"),
      figureList([["Contrast-to-noise", Number.isFinite(ratio) ? figure(ratio) : "the background is constant", "contrast", ratio]]));
  }

  /** Show points of interest, with a link to the design of a mask around them. @param {Triple[]} points */
  points(points) {
    if (points.length && this.aperture === undefined) void this.loadAperture();
    const { flat } = this.stage.source;
    const setPoints = (/** @type {Triple[]} */ all) => this.stage.store.change({ points: all });
    const rows = points.map((place, n) => h("li", null, `x ${formatMm(place[0])}${flat ? "" : `, y ${formatMm(place[1])}`}, z ${mmText(place[2])} `,
      h("button", { type: "button", class: "quiet", "aria-label": `Remove point ${n + 1}`, onclick: () => setPoints(points.filter((_, m) => m !== n)) }, "remove")));
    const addButton = h("button", { type: "button", disabled: points.length >= (flat ? 1 : MAX_POINTS), onclick: () => setPoints([...points, this.stage.position]) }, "Add the crosshair");
    const designLink = h("a", { class: "button primary", href: `/design?${designQueryAround(points, flat, this.aperture ?? null)}` }, points.length > 1 ? `Mask around these ${points.length} points` : "Mask around this point");
    return h("section", { dataset: { result: "points" } }, h("h3", null, "Points of interest"), h("ol", { class: "points" }, rows), h("div", { class: "row" }, addButton, points.length ? designLink : null));
  }

  /** Load the aperture of the scan's mask, which the new mask adopts. */
  async loadAperture() {
    this.aperture = null;
    const scan = await api.get(`/scans/${this.reconstruction.scan_id}`).catch(() => null);
    const mask = scan && (await api.get(`/masks/${scan.mask_id}`).catch(() => null));
    this.aperture = mask?.aperture ?? null;
    this.show();
  }

  /** Draw a profile with its half-maximum level.
   *
   * @param {import("./measurements.js").Profile} found @param {import("./measurements.js").Width | null} width
   */
  chart({ distances, values }, width) {
    if (!values.length) return null;
    const [low, high] = [Math.min(...values, 0), Math.max(...values)];
    const last = distances[distances.length - 1] || 1;
    const x = (/** @type {number} */ mm) => LEFT + ((WIDTH - LEFT - 30) * mm) / last;
    const y = (/** @type {number} */ value) => HEIGHT - BOTTOM - ((HEIGHT - BOTTOM - TOP) * (value - low)) / (high - low || 1);
    const half = width && width.base + width.height / 2;
    return s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "profile", role: "img", "aria-label": "Profile along the line" },
      ticks(0, last, 5).map((mm) => s("text", { x: x(mm), y: HEIGHT - 5, "text-anchor": "middle" }, String(mm))),
      s("text", { x: WIDTH, y: HEIGHT - 5, "text-anchor": "end" }, "mm"), s("text", { x: 0, y: 10 }, PRESSURE),
      [low, high].map((value) => s("text", { x: LEFT - 4, y: y(value) + 4, "text-anchor": "end" }, Math.abs(value) < 5e-3 * (high - low) ? "0" : figure(value, 2))),
      s("path", { class: "axis", d: `M${LEFT} ${TOP - 4}V${HEIGHT - BOTTOM}H${WIDTH}` }),
      width && half !== null ? s("path", { class: "width", d: `M${x(width.left)} ${y(half)}H${x(width.right)}M${x(width.left)} ${y(half) - 5}v10M${x(width.right)} ${y(half) - 5}v10` }) : null,
      s("path", { class: "curve", d: [...values].map((value, n) => `${n ? "L" : "M"}${x(distances[n]).toFixed(1)} ${y(value).toFixed(1)}`).join("") }));
  }
}

/** @param {[string, string, string?, number?, string?][]} rows name, text, key and value for scripts, description */
export function figureList(rows) {
  return h("dl", { class: "figures" }, rows.flatMap(([name, text, key, value, description]) => [
    h("dt", { title: description || null }, name), h("dd", { dataset: key ? { figure: key, value: String(value) } : {} }, text)]));
}
