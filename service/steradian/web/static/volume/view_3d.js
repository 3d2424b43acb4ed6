// @ts-check
// 3-D view: ray casting of a low-resolution copy, with clipping box, edges and scale bar.
import { oncePerFrame, h, debounce } from "../dom.js";
import { showError, showLoading } from "../panel_states.js";
import { AXES, fetchBlock, firstVoxelBelow } from "./volume_data.js";
import { colourTable, isDiverging } from "./colours.js";
import { drawDepthBar, drawScaleBar, drawLabel, strokeOutlined } from "./overlay.js";
import { Overlay3D } from "./overlay_3d.js";
import { clampZoom } from "./pointer.js";
import { boxEdges, createRaycaster, projection } from "./raycast.js";
import { colourEnd } from "./volume_state.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {[number, number, number, number, number, number]} Clip */

const WHOLE_BOX = /** @type {Clip} */ ([0, 1, 0, 1, 0, 1]);
const TURNING_RESOLUTION = 0.5; // resolution relative to CSS pixels during rotation
const REST_DELAY = 180; // ms after which the full resolution is drawn
const LABEL_EDGE = 9; // pixels, least distance of an axis name from the edge of the view
const DEGREES_PER_PIXEL = 0.4; // rotation per pixel
const REDRAW_KEYS = new Set(["window", "map", "camera", "clip", "cut", "depth", "large", "smooth", "gamma", "log"]);

export class View3D {
  /** @param {VolumeState} stage */
  constructor(stage) {
    this.stage = stage;
    this.image = h("canvas", { class: "image", dataset: { image: "3-D" } });
    this.overlay = h("canvas", {
      class: "overlay", tabindex: 0, role: "application", "aria-label": "3-D view, the arrow keys rotate it", dataset: { view: "3-D" },
    });
    this.message = h("div", { class: "message" });
    this.staleNote = h("p", { class: "stale-note small", hidden: true });
    this.added = new Overlay3D(stage, () => this.draw(), (block, end) => this.dimFactorOf(block, end));
    this.element = h("div", { class: "canvases" }, this.image, this.added.canvas, this.overlay, this.staleNote, this.message);
    this.loads = 0; // newest call of load
    /** @type {number | null} index of the volume in the block */
    this.shownIndex = null;
    this.isCoarse = this.wasTurned = false;
    /** @type {Awaited<ReturnType<typeof fetchBlock>> | null} */
    this.block = null;
    this.dimFactor = 1;
    this.raycaster = createRaycaster(this.image, { keep: true });
    this.draw = oncePerFrame(() => this.render());
    this.renderFineLater = debounce(() => {
      this.isCoarse = false;
      this.draw();
    }, REST_DELAY);
    new ResizeObserver(() => this.draw()).observe(this.element);
    this.drawOverlaySoon = oncePerFrame(() => this.block && this.drawOverlay(this.block));
    stage.store.on((_view, changed) => {
      for (const name of changed) if (REDRAW_KEYS.has(name)) this.draw();
      if (changed.has("at")) this.drawOverlaySoon(); // the crosshair alone needs no ray casting
      if (changed.has("index")) this.showStale();
    });
    this.image.addEventListener("restored", () => this.draw());
    this.addHandlers();
  }

  /** Whether the block is of another volume of the series than the slices. */
  get isStale() {
    return this.block !== null && this.shownIndex !== this.stage.source.index;
  }

  /** Dim a block of another volume, as during playback. */
  showStale() {
    this.element.classList.toggle("stale", this.isStale);
    this.staleNote.hidden = !this.isStale;
    this.staleNote.textContent = this.isStale ? `still volume ${(this.shownIndex ?? 0) + 1} of the series` : "";
  }

  /** Load the low-resolution copy and show it. */
  async load() {
    if (!this.raycaster) {
      showError(this.message, new Error("this browser does not support WebGL 2; the slices show the same values"));
      return;
    }
    const load = ++this.loads;
    if (!this.block) showLoading(this.message, "loading a low-resolution copy …");
    try {
      const { source } = this.stage;
      const block = await fetchBlock(source, this.stage.maxValue);
      if (load !== this.loads) return; // another volume was selected meanwhile
      this.block = block;
      this.shownIndex = source.index;
      this.image.dataset.index = String(source.index ?? "");
      this.raycaster.upload(this.block);
      this.dimFactor = this.dimFactorOf(this.block);
      this.message.hidden = true;
      this.showStale();
      this.draw();
    } catch (error) {
      if (load !== this.loads) return;
      this.message.hidden = false;
      showError(this.message, error, () => void this.load());
    }
  }

  /** Return the factor by which averaging dims thin structures relative to the slices. @param {NonNullable<typeof this.block>} block @param {number} [fullEnd] end of the colour scale at full resolution */
  dimFactorOf({ values, shape, origin, spacing, window: [minValue, maxIntensity] }, fullEnd = this.stage.projectedEnd) {
    const [nx, ny, nz] = shape;
    const first = firstVoxelBelow({ shape, origin, spacing }, this.stage.cut);
    const projected = new Uint8Array(nx * ny);
    for (let n = 0; n < nx * ny; n++) {
      for (let k = n * nz + first; k < (n + 1) * nz; k++) if (values[k] > projected[n]) projected[n] = values[k];
    }
    const end = minValue + ((maxIntensity - minValue) * colourEnd(projected.sort())) / 255;
    return Math.min(1, end / fullEnd) || 1;
  }

  /** Window of the slices in units of the block. @returns {[number, number]} */
  get window() {
    const [minValue, maxIntensity] = this.block?.window ?? [0, 1];
    const inBytes = (/** @type {number} */ value) => (255 * (value * this.dimFactor - minValue)) / (maxIntensity - minValue);
    return [inBytes(this.stage.window[0]), inBytes(this.stage.window[1])];
  }

  /** Visible shares of the extent: the clipping box within the shown depths, below the near field. @returns {Clip} */
  get clip() {
    const clip = /** @type {Clip} */ ([...(this.stage.view.clip ?? WHOLE_BOX)]);
    const [first, last] = this.stage.ends("z");
    const [, , , , from, to] = this.fit;
    clip[4] = Math.max(clip[4], from, Math.min((this.stage.cut - first) / (last - first), 1));
    clip[5] = Math.max(Math.min(clip[5], to), clip[4]);
    return clip;
  }

  /** Shares of the extent that fill the view: the shown depths. @returns {Clip} */
  get fit() {
    const [first, last] = this.stage.ends("z");
    const [from, to] = this.stage.shownEnds("z").map((mm) => (mm - first) / (last - first));
    return [0, 1, 0, 1, from, to];
  }

  render() {
    if (!this.raycaster || !this.block) return;
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = devicePixelRatio || 1;
    const resolution = this.isCoarse ? TURNING_RESOLUTION : ratio;
    const { stage } = this;
    Object.assign(this.image, { width: Math.max(1, Math.round(width * resolution)), height: Math.max(1, Math.round(height * resolution)) });
    this.raycaster.draw({
      camera: stage.view.camera, clip: this.clip, window: this.window, depth: stage.isDepthMap,
      colours: colourTable(stage.mapName), depths: stage.depths, fit: this.fit,
      transfer: stage.view, twoSided: isDiverging(stage.mapName), smooth: stage.view.smooth === "linear",
    });
    this.image.style.opacity = stage.isOverlay ? String(stage.view.opacity[0]) : "";
    this.added.render({ width: this.image.width, height: this.image.height, clip: this.clip, fit: this.fit });
    this.drawOverlay(this.block);
  }

  /** Draw edges, axis names, crosshair and scale bar. @param {import("./raycast.js").Block} block */
  drawOverlay(block) {
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = devicePixelRatio || 1;
    Object.assign(this.overlay, { width: Math.max(1, width * ratio), height: Math.max(1, height * ratio) });
    const context = /** @type {CanvasRenderingContext2D} */ (this.overlay.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = "12px system-ui, sans-serif";
    const { project, scale } = projection(block, this.stage.view.camera, { width, height }, this.fit);
    context.globalAlpha = 0.6;
    for (const { from, to } of boxEdges(block, this.clip)) {
      const [one, other] = [project(from), project(to)];
      strokeOutlined(context, "#ffffff", 1, () => { context.moveTo(one.x, one.y); context.lineTo(other.x, other.y); });
    }
    context.globalAlpha = 1;
    const [corner] = boxEdges(block, this.clip).map((edge) => edge.from);
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const { axis, from, to } of boxEdges(block, this.clip)) {
      if (from.some((value, n) => Math.abs(value - corner[n]) > 1e-9)) continue;
      const [one, other] = [project(from), project(to)];
      const length = Math.hypot(other.x - one.x, other.y - one.y);
      if (length < 24) continue; // the edge points at the viewer
      const beyond = 1 + 12 / length;
      const within = (/** @type {number} */ value, /** @type {number} */ size) => Math.min(Math.max(value, LABEL_EDGE), size - LABEL_EDGE);
      drawLabel(context, AXES[axis], within(one.x + (other.x - one.x) * beyond, width), within(one.y + (other.y - one.y) * beyond, height));
    }
    const { x, y } = project(this.stage.position);
    strokeOutlined(context, "#ffffff", 1, () => context.arc(x, y, 10, 0, 2 * Math.PI));
    drawScaleBar(context, scale, width, height);
    if (this.stage.isDepthMap) drawDepthBar(context, this.stage.depths, height);
    if (this.wasTurned) return;
    context.textAlign = "left";
    context.textBaseline = "top";
    drawLabel(context, "drag to rotate, scroll to zoom", 8, 7);
  }

  /** Rotate at reduced resolution until the input pauses. @param {Triple} camera */
  setCamera([azimuth, elevation, zoom]) {
    this.isCoarse = this.wasTurned = true;
    this.renderFineLater();
    const wrappedAzimuth = ((((azimuth + 180) % 360) + 360) % 360) - 180;
    this.stage.store.change({ camera: [wrappedAzimuth, Math.min(Math.max(elevation, -90), 90), clampZoom(zoom)] });
  }

  addHandlers() {
    const { overlay } = this;
    /** @type {{x: number, y: number, camera: Triple} | null} */
    let dragStart = null;
    overlay.addEventListener("pointerdown", (event) => {
      overlay.focus({ preventScroll: true });
      overlay.setPointerCapture(event.pointerId);
      dragStart = { x: event.clientX, y: event.clientY, camera: this.stage.view.camera };
      event.preventDefault();
    });
    overlay.addEventListener("pointermove", (event) => {
      if (!dragStart) return;
      const [azimuth, elevation, zoom] = dragStart.camera;
      this.setCamera([azimuth - (event.clientX - dragStart.x) * DEGREES_PER_PIXEL, elevation + (event.clientY - dragStart.y) * DEGREES_PER_PIXEL, zoom]);
    });
    for (const kind of ["pointerup", "pointercancel"]) overlay.addEventListener(kind, () => (dragStart = null));
    overlay.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [azimuth, elevation, zoom] = this.stage.view.camera;
      this.setCamera([azimuth, elevation, zoom * 2 ** (-event.deltaY / 500)]);
    }, { passive: false });
    overlay.addEventListener("keydown", (event) => {
      const [azimuth, elevation, zoom] = this.stage.view.camera;
      /** @type {Record<string, Triple>} */
      const cameraByKey = {
        ArrowLeft: [azimuth - 5, elevation, zoom], ArrowRight: [azimuth + 5, elevation, zoom],
        ArrowUp: [azimuth, elevation + 5, zoom], ArrowDown: [azimuth, elevation - 5, zoom],
        "+": [azimuth, elevation, zoom * 1.25], "-": [azimuth, elevation, zoom * 0.8], 0: [-35, 25, 1],
      };
      if (event.ctrlKey || event.altKey || event.metaKey || !cameraByKey[event.key]) return;
      this.setCamera(cameraByKey[event.key]);
      event.preventDefault();
      event.stopPropagation();
    });
  }
}
