// @ts-check
// Slice view across an axis: slice or slab, crosshair, marks and scale bar.
import { oncePerFrame, h } from "../dom.js";
import { onTheme } from "../theme.js";
import { showError, showLoading } from "../panel_states.js";
import { PLANES, axisIndex, fetchDepths, firstVoxelBelow, voxelPosition, fetchPlane } from "./volume_data.js";
import { paint, paintDepths, colourTable } from "./colours.js";
import { transferFunction } from "./transfer.js";
import { latestOnly } from "./latest_only.js";
import { drawOverlay } from "./overlay.js";
import { addPointerHandlers } from "./pointer.js";

/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./measurements.js").Plane} Plane */
/** @typedef {import("./volume_state.js").VolumeState} VolumeState */

const REPAINT_KEYS = new Set(["window", "overlayWindow", "overlayMap", "map", "gamma", "log", "how", "cut", "difference"]);
const REDRAW_KEYS = new Set([...REPAINT_KEYS, "opacity", "smooth", "centre", "zoom", "at", "line", "region", "background", "points", "tool", "depth", "large"]);

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
    this.overlayBitmap = document.createElement("canvas");
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

  /** Whether the view shows the reference over the image. */
  get isOverlay() {
    return this.other !== null && this.stage.isOverlay;
  }

  get width() {
    return this.overlay.clientWidth;
  }

  get height() {
    return this.overlay.clientHeight;
  }

  /** @param {Set<string>} changed */
  onViewChange(changed) {
    if (["at", "slab", "cut", "map", "index"].some((name) => changed.has(name))) this.requestData(null);
    for (const name of changed) if (REPAINT_KEYS.has(name)) this.isStale = true;
    for (const name of changed) if (REDRAW_KEYS.has(name)) this.draw();
  }

  /** @param {AbortSignal} signal */
  async readData(signal) {
    const { source, reference, isDepthMap: byDepth } = this.stage;
    const range = this.stage.range(this.axis);
    const key = [source.index, reference?.id, reference?.index, range.from, range.to, byDepth].join();
    if (key === this.shownKey) return;
    const [plane, other, depth] = await Promise.all([
      fetchPlane(source, this.axis, range, signal),
      reference ? fetchPlane(reference, this.axis, this.stage.range(this.axis, reference), signal) : null,
      byDepth && this.axis === "z" && range.to - range.from > 1 ? fetchDepths(source, range, signal) : null,
    ]);
    this.shownKey = key;
    Object.assign(this, { plane, other, depth, range, isStale: true });
    if (other && this.stage.isComparable) this.stage.setDifference(this.axis, plane.values.map((value, n) => Math.abs(value - other.values[n])));
    this.message.hidden = true;
    for (const act of this.listeners) act();
    this.render();
  }

  /** Read the plane of another volume of the series, and of the reference that follows it. @param {number} index */
  async prefetch(index) {
    const { source, reference } = this.stage;
    await Promise.all([
      fetchPlane({ ...source, index }, this.axis, this.stage.range(this.axis)),
      this.stage.referenceIndex === null && reference?.index !== null && reference?.volumes === source.volumes ? fetchPlane({ ...reference, index }, this.axis, this.stage.range(this.axis, reference)) : null,
    ]);
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
    this.stage.sizes = [...this.stage.sizes.filter((one) => one.axis !== this.axis), ...(size.width && size.height ? [size] : [])]; // a hidden view has no size
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
      context.globalAlpha = this.isOverlay ? this.stage.view.opacity[0] : 1;
      this.drawImage(context, shownPlane, this.bitmap);
      if (this.other && this.isOverlay) this.drawOver(context, this.other);
      context.globalAlpha = 1;
    }
    drawOverlay(this);
  }

  /** Add the colours of the reference to those of the image; each lies where its voxels do. @param {CanvasRenderingContext2D} context @param {Plane} plane */
  drawOver(context, plane) {
    context.globalCompositeOperation = "lighter";
    context.globalAlpha = this.stage.view.opacity[1];
    this.drawImage(context, plane, this.overlayBitmap);
    context.globalCompositeOperation = "source-over";
  }

  /** @param {CanvasRenderingContext2D} context @param {Plane} plane @param {HTMLCanvasElement} bitmap */
  drawImage(context, { shape, origin, spacing }, bitmap) {
    const first = origin.map((one, n) => one - spacing[n] / 2);
    const last = first.map((one, n) => one + shape[n] * spacing[n]);
    const [x0, y0] = this.toPixels(first[0], first[1]);
    const [x1, y1] = this.toPixels(last[0], last[1]);
    context.imageSmoothingEnabled = this.stage.view.smooth === "linear" || Math.min(...spacing) * this.stage.scale < 1; // several voxels in a pixel are averaged
    context.save();
    if (!this.up) {
      const [from, to] = this.visibleDepths.map((mm) => this.toPixels(0, mm)[1]);
      context.beginPath();
      context.rect(0, from, this.width, to - from);
      context.clip();
    }
    context.drawImage(bitmap, x0, Math.min(y0, y1), x1 - x0, Math.abs(y1 - y0));
    context.restore();
  }

  /** Depths (mm) between which a view with a depth axis shows the volume: below the near field, within the crop. */
  get visibleDepths() {
    const { source, cut } = this.stage;
    const [from, to] = this.stage.shownEnds("z");
    return [Math.max(from, voxelPosition(source, "z", firstVoxelBelow(source, cut)) - source.spacing[2] / 2), to];
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
    } else if (byDepth) paintDepths(shownPlane, this.depthShare(shownPlane), window, { up: this.up, out, transfer: transferFunction(this.stage.view) });
    else paint(shownPlane, window, colours, { up: this.up, out });
    /** @type {CanvasRenderingContext2D} */ (this.bitmap.getContext("2d")).putImageData(pixels, 0, 0);
    if (other && this.isOverlay) this.paintOver(other);
    this.isStale = false;
  }

  /** Paint the reference in its own colours. @param {Plane} plane */
  paintOver(plane) {
    const [na, nb] = plane.shape;
    Object.assign(this.overlayBitmap, { width: na, height: nb });
    const pixels = new ImageData(na, nb);
    paint(plane, this.stage.overlayWindow, this.stage.overlayColours, { up: this.up, out: new Uint32Array(pixels.data.buffer) });
    /** @type {CanvasRenderingContext2D} */ (this.overlayBitmap.getContext("2d")).putImageData(pixels, 0, 0);
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
