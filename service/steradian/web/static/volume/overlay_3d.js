// @ts-check
// Second volume of the 3-D view, laid over the first: a canvas of its own whose light is added.
import { h } from "../dom.js";
import { colourTable } from "./colours.js";
import { createRaycaster } from "./raycast.js";
import { AXES, fetchBlock, fetchPlane, slabRange } from "./volume_data.js";
import { colourEnd } from "./volume_state.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {Awaited<ReturnType<typeof fetchBlock>>} Block */

export class Overlay3D {
  /** @param {VolumeState} stage @param {() => void} draw draws the 3-D view @param {(block: Block, fullEnd: number) => number} dimFactorOf factor by which averaging dims thin structures */
  constructor(stage, draw, dimFactorOf) {
    this.stage = stage;
    this.draw = draw;
    this.dimFactorOf = dimFactorOf;
    this.canvas = h("canvas", { class: "image added", hidden: true, dataset: { image: "3-D overlay" } });
    /** @type {ReturnType<typeof createRaycaster>} */
    this.raycaster = null;
    /** @type {Block | null} */
    this.block = null;
    this.dimFactor = 1;
    this.key = ""; // volume in the block, or on its way
    this.canvas.addEventListener("restored", draw);
    stage.store.on((_view, changed) => ["against", "how", "index", "difference", "overlayWindow", "overlayMap", "opacity"].some((name) => changed.has(name)) && this.update());
  }

  /** Load the reference if it is shown and another one, and draw. */
  update() {
    const { stage } = this;
    const { reference } = stage;
    const key = reference && stage.isOverlay ? `${reference.id} ${reference.index}` : "";
    if (key !== this.key) {
      this.key = key;
      this.block = null;
      if (reference && key) void this.load(reference, key);
    }
    this.draw();
  }

  /** @param {import("./volume_data.js").Source} reference @param {string} key */
  async load(reference, key) {
    try {
      const [block, { values }] = await Promise.all([
        fetchBlock(reference, reference.peak || this.stage.overlayWindow[1]),
        fetchPlane(reference, "z", slabRange(reference, "z", 0, Infinity, this.stage.cut)),
      ]);
      if (key !== this.key) return; // another reference was selected meanwhile
      this.raycaster ??= createRaycaster(this.canvas, { keep: true });
      this.raycaster?.upload(block);
      this.block = block;
      this.dimFactor = this.dimFactorOf(block, colourEnd(values.filter(Number.isFinite).sort()) || 1);
      this.draw();
    } catch {
      // the slices show the error; the key stays, so that it is loaded again only after another selection
    }
  }

  /** Draw the reference in the box of the image.
   *
   * @param {{width: number, height: number, clip: readonly number[], fit: readonly number[]}} shown  size in pixels; shares of the image's extent
   */
  render({ width, height, clip, fit }) {
    const { stage, block } = this;
    const isShown = block !== null && this.raycaster !== null && stage.isOverlay;
    this.canvas.hidden = !isShown;
    if (!isShown) return;
    const [low, high] = block.window;
    Object.assign(this.canvas, { width, height });
    this.canvas.style.opacity = String(stage.view.opacity[1]);
    this.raycaster?.draw({
      camera: stage.view.camera, clip: this.sharesOf(clip, block).map((share) => Math.min(Math.max(share, 0), 1)), fit: this.sharesOf(fit, block),
      window: /** @type {[number, number]} */ (stage.overlayWindow.map((value) => (255 * (value * this.dimFactor - low)) / (high - low))),
      colours: colourTable(/** @type {import("./colours.js").MapName} */ (stage.view.overlayMap)), depth: false, depths: stage.depths,
      transfer: stage.view, smooth: stage.view.smooth === "linear",
    });
  }

  /** Convert shares of the image's extent to those of the reference. @param {readonly number[]} shares @param {Block} block */
  sharesOf(shares, { shape, origin, spacing }) {
    return shares.map((share, m) => {
      const n = m >> 1;
      const [first, last] = this.stage.ends(AXES[n]);
      return (first + share * (last - first) - (origin[n] - spacing[n] / 2)) / (shape[n] * spacing[n]);
    });
  }
}
