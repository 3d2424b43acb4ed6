// @ts-check
// The 3-D view: a coarse copy of the volume, turned by dragging, cut by a box, with edges and a scale bar over it.
import { framed, h, settled } from "../dom.js";
import { failed, loading } from "../panel_states.js";
import { AXES, blockOf, firstBelow } from "./volume_data.js";
import { table } from "./colours.js";
import { drawDepths, drawScaleBar, label, outlined } from "./overlay.js";
import { limited } from "./pointer.js";
import { edges, make, projection } from "./raycast.js";
import { colourEnd } from "./shared_state.js";

/** @typedef {import("./shared_state.js").Stage} Stage */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {[number, number, number, number, number, number]} Clip */

const WHOLE = /** @type {Clip} */ ([0, 1, 0, 1, 0, 1]);
const WHILE_TURNING = 0.5; // pixels a CSS pixel has while it is turned
const REST = 180; // ms after which it is drawn finely again
const DEGREES = 0.4; // a pixel of dragging
const REDRAWN = new Set(["window", "map", "camera", "clip", "cut"]);

export class SolidView {
  /** @param {Stage} stage */
  constructor(stage) {
    this.stage = stage;
    this.image = h("canvas", { class: "image", dataset: { image: "3-D" } });
    this.overlay = h("canvas", {
      class: "overlay", tabindex: 0, role: "application", "aria-label": "3-D view, arrows turn it", dataset: { view: "3-D" },
    });
    this.message = h("div", { class: "message" });
    this.element = h("div", { class: "canvases" }, this.image, this.overlay, this.message);
    this.coarse = this.turned = false;
    /** @type {Awaited<ReturnType<typeof blockOf>> | null} */
    this.block = null;
    this.dimmer = 1;
    this.picture = make(this.image, { keep: true });
    this.draw = framed(() => this.drawNow());
    this.rest = settled(() => {
      this.coarse = false;
      this.draw();
    }, REST);
    new ResizeObserver(() => this.draw()).observe(this.element);
    this.place = framed(() => this.block && this.drawOverlay(this.block));
    stage.store.on((_view, changed) => {
      for (const name of changed) if (REDRAWN.has(name)) this.draw();
      if (changed.has("at")) this.place(); // no rays are cast for the crosshair alone
    });
    this.image.addEventListener("restored", () => this.draw());
    this.listen();
  }

  /** Read the coarse copy and show it. */
  async open() {
    if (!this.picture) {
      failed(this.message, new Error("this browser has no WebGL 2; the slices show the same numbers"));
      return;
    }
    loading(this.message, "loading a coarse copy …");
    try {
      this.block = await blockOf(this.stage.source, this.stage.greatest);
      this.picture.load(this.block);
      this.dimmer = this.dimming(this.block);
      this.message.hidden = true;
      this.draw();
    } catch (error) {
      failed(this.message, error, () => void this.open());
    }
  }

  /** How dim what is thin is beside the slices: coarse voxels are means. @param {NonNullable<typeof this.block>} block */
  dimming({ values, shape, origin, spacing, window: [least, greatest] }) {
    const [nx, ny, nz] = shape;
    const first = firstBelow({ shape, origin, spacing }, this.stage.cut);
    const projected = new Uint8Array(nx * ny);
    for (let n = 0; n < nx * ny; n++) {
      for (let k = n * nz + first; k < (n + 1) * nz; k++) if (values[k] > projected[n]) projected[n] = values[k];
    }
    const end = least + ((greatest - least) * colourEnd(projected.sort())) / 255;
    return Math.min(1, end / this.stage.ownWindow[1]) || 1;
  }

  /** The window of the slices in the block's bytes. @returns {[number, number]} */
  get window() {
    const [least, greatest] = this.block?.window ?? [0, 1];
    const inBytes = (/** @type {number} */ value) => (255 * (value * this.dimmer - least)) / (greatest - least);
    return [inBytes(this.stage.window[0]), inBytes(this.stage.window[1])];
  }

  /** Shares of the extent that are shown: the box, and what lies below the near field. @returns {Clip} */
  get clip() {
    const clip = /** @type {Clip} */ ([...(this.stage.view.clip ?? WHOLE)]);
    const [first, last] = this.stage.ends("z");
    clip[4] = Math.max(clip[4], Math.min((this.stage.cut - first) / (last - first), 1));
    return clip;
  }

  drawNow() {
    if (!this.picture || !this.block) return;
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = devicePixelRatio || 1;
    const fine = this.coarse ? WHILE_TURNING : ratio;
    const { stage } = this;
    Object.assign(this.image, { width: Math.max(1, Math.round(width * fine)), height: Math.max(1, Math.round(height * fine)) });
    this.picture.draw({
      camera: stage.view.camera, clip: this.clip, window: this.window, depth: stage.byDepth,
      colours: stage.byDepth ? table("depth") : stage.colours, depths: stage.depths,
    });
    this.drawOverlay(this.block);
  }

  /** Edges, names of axes, crosshair and scale bar. @param {import("./raycast.js").Block} block */
  drawOverlay(block) {
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = devicePixelRatio || 1;
    Object.assign(this.overlay, { width: Math.max(1, width * ratio), height: Math.max(1, height * ratio) });
    const context = /** @type {CanvasRenderingContext2D} */ (this.overlay.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = "12px system-ui, sans-serif";
    const { project, scale } = projection(block, this.stage.view.camera, { width, height });
    context.globalAlpha = 0.6;
    for (const { from, to } of edges(block, this.clip)) {
      const [one, other] = [project(from), project(to)];
      outlined(context, "#ffffff", 1, () => { context.moveTo(one.x, one.y); context.lineTo(other.x, other.y); });
    }
    context.globalAlpha = 1;
    const [corner] = edges(block, this.clip).map((edge) => edge.from);
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const { axis, from, to } of edges(block, this.clip)) {
      if (from.some((value, n) => Math.abs(value - corner[n]) > 1e-9)) continue;
      const [one, other] = [project(from), project(to)];
      const length = Math.hypot(other.x - one.x, other.y - one.y);
      if (length < 24) continue; // it points at the viewer
      const beyond = 1 + 12 / length;
      label(context, AXES[axis], one.x + (other.x - one.x) * beyond, one.y + (other.y - one.y) * beyond);
    }
    const { x, y } = project(this.stage.place);
    outlined(context, "#ffffff", 1, () => context.arc(x, y, 10, 0, 2 * Math.PI));
    drawScaleBar(context, scale, width, height);
    if (this.stage.byDepth) drawDepths(context, this.stage.depths, height);
    if (this.turned) return;
    context.textAlign = "left";
    context.textBaseline = "top";
    label(context, "drag to turn, scroll to zoom", 8, 7);
  }

  /** Turn, and draw less finely until it rests. @param {Triple} camera */
  turn([azimuth, elevation, zoom]) {
    this.coarse = this.turned = true;
    this.rest();
    const turned = ((((azimuth + 180) % 360) + 360) % 360) - 180;
    this.stage.store.change({ camera: [turned, Math.min(Math.max(elevation, -90), 90), limited(zoom)] });
  }

  listen() {
    const { overlay } = this;
    /** @type {{x: number, y: number, camera: Triple} | null} */
    let from = null;
    overlay.addEventListener("pointerdown", (event) => {
      overlay.focus({ preventScroll: true });
      overlay.setPointerCapture(event.pointerId);
      from = { x: event.clientX, y: event.clientY, camera: this.stage.view.camera };
      event.preventDefault();
    });
    overlay.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [azimuth, elevation, zoom] = from.camera;
      this.turn([azimuth - (event.clientX - from.x) * DEGREES, elevation + (event.clientY - from.y) * DEGREES, zoom]);
    });
    for (const kind of ["pointerup", "pointercancel"]) overlay.addEventListener(kind, () => (from = null));
    overlay.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [azimuth, elevation, zoom] = this.stage.view.camera;
      this.turn([azimuth, elevation, zoom * 2 ** (-event.deltaY / 500)]);
    }, { passive: false });
    overlay.addEventListener("keydown", (event) => {
      const [azimuth, elevation, zoom] = this.stage.view.camera;
      /** @type {Record<string, Triple>} */
      const turns = {
        ArrowLeft: [azimuth - 5, elevation, zoom], ArrowRight: [azimuth + 5, elevation, zoom],
        ArrowUp: [azimuth, elevation + 5, zoom], ArrowDown: [azimuth, elevation - 5, zoom],
        "+": [azimuth, elevation, zoom * 1.25], "-": [azimuth, elevation, zoom * 0.8], 0: [-35, 25, 1],
      };
      if (event.ctrlKey || event.altKey || event.metaKey || !turns[event.key]) return;
      this.turn(turns[event.key]);
      event.preventDefault();
      event.stopPropagation();
    });
  }
}
