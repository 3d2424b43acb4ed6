// @ts-check
// Slice view across an axis: slice or slab, crosshair, marks and scale bar.
import { oncePerFrame, h } from "../dom.js";
import { onTheme } from "../theme.js";
import { showError, showLoading } from "../panel_states.js";
import { PLANES, axisIndex, fetchDepths, firstVoxelBelow, voxelPosition, fetchPlane } from "./volume_data.js";
import { paint, paintDepths, colourTable } from "./colours.js";
import { latestOnly } from "./latest_only.js";
import { drawOverlay } from "./overlay.js";
import { addPointerHandlers } from "./pointer.js";

/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./measurements.js").Plane} Plane */
/** @typedef {import("./volume_state.js").VolumeState} VolumeState */

const CRISP_PIXELS = 4; // pixels per voxel above which voxel edges are drawn sharp
const REDRAW_KEYS = new Set(["difference", "window", "map", "how", "centre", "zoom", "at", "cut", "line", "region", "background", "points", "tool"]);

export class SliceView {
  /** @param {VolumeState} stage @param {Axis} axis @param {(hovered: any) => void} onHover receives position and value under the cursor */
  constructor(stage, axis, onHover) {
    this.stage = stage;
    this.axis = axis;
    this.onHover = onHover;
    const [across, up] = PLANES[axis];
    this.name = `${across}–${up}`;
    this.up = up === "y";
    /** @type {Plane | null} */
    this.plane = null;
    /** @type {Plane | null} of the reference */
    this.other = null;
    /** @type {Plane | null} depths of the maxima, for the depth map */
    this.depth = null;
    this.isReferenceShown = false;
    this.image = h("canvas", { class: "image", dataset: { image: this.name } });
    this.overlay = h("canvas", {
      class: "overlay", tabindex: 0, role: "application", "aria-label": `${this.name} view`,
      "aria-describedby": "view-keys", dataset: { view: this.name },
    });
    this.message = h("div", { class: "message" });
    showLoading(this.message);
    this.element = h("div", { class: "canvases" }, this.image, this.overlay, this.message);
    this.bitmap = document.createElement("canvas");
    /** @type {Set<() => void>} */
    this.listeners = new Set();
    this.isStale = true;
    this.shownKey = "";
    this.draw = oncePerFrame(() => this.render());
    this.requestData = latestOnly((_, signal) => this.readData(signal), (error) => this.showFailure(error));
    new ResizeObserver(() => this.resize()).observe(this.element);
    stage.store.on((_view, changed) => this.onViewChange(changed));
    onTheme(() => this.draw());
    addPointerHandlers(this);
  }

  /** Convert a position in the plane (mm) to CSS pixels. @param {number} a @param {number} b @returns {[number, number]} */
  toPixels(a, b) {
    const { scale, centre } = this.stage;
    const [across, up] = PLANES[this.axis];
    const y = (b - centre[axisIndex(up)]) * scale;
    return [this.width / 2 + (a - centre[axisIndex(across)]) * scale, this.height / 2 + (this.up ? -y : y)];
  }

  /** @param {number} x @param {number} y @returns {[number, number]} */
  toPosition(x, y) {
    const { scale, centre } = this.stage;
    const [across, up] = PLANES[this.axis];
    const away = (y - this.height / 2) / scale;
    return [centre[axisIndex(across)] + (x - this.width / 2) / scale, centre[axisIndex(up)] + (this.up ? -away : away)];
  }

  /** Whether the view shows the difference to the reference. */
  get isDifference() {
    return this.other !== null && this.stage.view.how === "difference" && this.stage.isComparable;
  }

  get width() {
    return this.overlay.clientWidth;
  }

  get height() {
    return this.overlay.clientHeight;
  }

  /** @param {Set<string>} changed */
  onViewChange(changed) {
    if (changed.has("at") || changed.has("slab") || changed.has("cut") || changed.has("map")) this.requestData(null);
    if (changed.has("window") || changed.has("map") || changed.has("how") || changed.has("cut") || changed.has("difference")) this.isStale = true;
    for (const name of changed) if (REDRAW_KEYS.has(name)) this.draw();
  }

  /** @param {AbortSignal} signal */
  async readData(signal) {
    const { source, reference, isDepthMap: byDepth } = this.stage;
    const range = this.stage.range(this.axis);
    const key = [reference?.id, range.from, range.to, byDepth].join();
    if (key === this.shownKey) return;
    const [plane, other, depth] = await Promise.all([
      fetchPlane(source, this.axis, range, signal),
      reference ? fetchPlane(reference, this.axis, this.stage.range(this.axis, reference), signal) : null,
      byDepth && this.axis === "z" && range.to - range.from > 1 ? fetchDepths(source, range, signal) : null,
    ]);
    this.shownKey = key;
    Object.assign(this, { plane, other, depth, range, stale: true });
    if (other && this.stage.isComparable) this.stage.setDifference(this.axis, plane.values.map((value, n) => Math.abs(value - other.values[n])));
    this.message.hidden = true;
    for (const act of this.listeners) act();
    this.render();
  }

  /** Keep the last image and show the error. @param {unknown} error */
  showFailure(error) {
    this.message.hidden = false;
    this.shownKey = "";
    showError(this.message, error, () => this.requestData(null));
  }

  resize() {
    if (!this.element.isConnected) return; // the pane is being replaced
    const ratio = devicePixelRatio || 1;
    for (const canvas of [this.image, this.overlay]) {
      canvas.width = Math.max(1, Math.round(this.element.clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(this.element.clientHeight * ratio));
    }
    const size = { axis: this.axis, width: this.width, height: this.height };
    this.stage.sizes = [...this.stage.sizes.filter((one) => one.axis !== this.axis), size];
    for (const act of this.listeners) act();
    document.dispatchEvent(new Event("steradian:resized"));
    this.draw();
  }

  render() {
    const ratio = devicePixelRatio || 1;
    const context = /** @type {CanvasRenderingContext2D} */ (this.image.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = "#000";
    context.fillRect(0, 0, this.width, this.height);
    if (this.plane) {
      const shownPlane = this.other && this.isReferenceShown ? this.other : this.plane;
      if (this.isStale) this.paint(shownPlane, this.plane);
      this.drawImage(context, shownPlane);
    }
    drawOverlay(this);
  }

  /** @param {CanvasRenderingContext2D} context @param {Plane} plane */
  drawImage(context, { shape, origin, spacing }) {
    const first = origin.map((one, n) => one - spacing[n] / 2);
    const last = first.map((one, n) => one + shape[n] * spacing[n]);
    const [x0, y0] = this.toPixels(first[0], first[1]);
    const [x1, y1] = this.toPixels(last[0], last[1]);
    context.imageSmoothingEnabled = Math.min(...spacing) * this.stage.scale < CRISP_PIXELS;
    context.drawImage(this.bitmap, x0, Math.min(y0, y1), x1 - x0, Math.abs(y1 - y0));
    const { source, cut } = this.stage;
    if (this.up || !firstVoxelBelow(source, cut)) return;
    const edge = voxelPosition(source, "z", firstVoxelBelow(source, cut)) - source.spacing[2] / 2;
    context.clearRect(x0, y0, x1 - x0, this.toPixels(0, edge)[1] - y0); // hidden near field
  }

  /** @param {Plane} shownPlane @param {Plane} plane */
  paint(shownPlane, plane) {
    const [na, nb] = shownPlane.shape;
    Object.assign(this.bitmap, { width: na, height: nb });
    const pixels = new ImageData(na, nb);
    const out = new Uint32Array(pixels.data.buffer);
    const { window, isDepthMap: byDepth, colours, differenceEnd } = this.stage;
    const other = this.other;
    if (other && this.isDifference) {
      const values = plane.values.map((value, n) => value - other.values[n]);
      paint({ values, shape: plane.shape }, [-differenceEnd, differenceEnd], colourTable("difference"), { up: this.up, out });
    } else if (byDepth) paintDepths(shownPlane, this.depthShare(shownPlane), window, { up: this.up, out });
    else paint(shownPlane, window, colours, { up: this.up, out });
    /** @type {CanvasRenderingContext2D} */ (this.bitmap.getContext("2d")).putImageData(pixels, 0, 0);
    this.isStale = false;
  }

  /** Return a function from voxel to relative depth. @param {Plane} plane @returns {(i: number, j: number) => number} */
  depthShare(plane) {
    const [first, last] = this.stage.depths;
    const { depth } = this;
    const nb = plane.shape[1];
    /** @param {number} mm */
    const share = (mm) => (mm - first) / (last - first);
    if (!this.up) return (_, j) => share(plane.origin[1] + j * plane.spacing[1]);
    if (depth && depth.values.length === plane.values.length) return (i, j) => share(depth.values[i * nb + j]);
    return () => share(this.stage.position[2]);
  }

  /** Show the reference or the image. @param {boolean} isReferenceShown */
  showReference(isReferenceShown) {
    this.isReferenceShown = isReferenceShown;
    this.isStale = true;
    this.draw();
  }
}
