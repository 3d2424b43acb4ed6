// @ts-check
// Histogram of the visible values and the window of the colour scale, with a handle at either end.
import { decimalInput, decimalOf, showDecimal } from "../decimal_input.js";
import { oncePerFrame, h } from "../dom.js";
import { colour, onTheme } from "../theme.js";
import { PRESSURE, figure } from "../units.js";
import { paintRamp, colourTable } from "./colours.js";
import { mmText } from "./panes.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */

const BINS = 128;
const [WIDTH, HEIGHT] = [256, 84];
const STEP = 0.01; // of the range, per arrow key

export class Histogram {
  /** @param {VolumeState} stage @param {() => (ArrayLike<number> | null)[]} planes visible values */
  constructor(stage, planes) {
    this.stage = stage;
    this.planes = planes;
    this.canvas = h("canvas", { width: WIDTH, height: HEIGHT, role: "img", "aria-label": "Histogram of the visible values" });
    this.bar = h("canvas", { width: WIDTH, height: 1, class: "colour-bar", "aria-hidden": "true" });
    this.handles = [this.handle(0, "Lower end of the window"), this.handle(1, "Upper end of the window")];
    this.inputs = [this.input(0, "From"), this.input(1, "to")];
    this.ends = [h("span", { dataset: { end: "least" } }), h("span", { dataset: { end: "greatest" } })];
    this.depths = [h("span"), h("span")];
    this.depthScale = h("div", { class: "scale dim small" }, this.depths[0], h("span", null, "depth colour scale"), this.depths[1]);
    this.name = h("p", { class: "small", dataset: { volumeName: "" } });
    this.element = h("div", { class: "histogram" }, this.name,
      h("div", { class: "handles" }, this.canvas, ...this.handles),
      h("div", { class: "scale dim small" }, this.ends[0], h("span", null, stage.isMaps ? "value" : `initial pressure (${PRESSURE})`), this.ends[1]),
      this.bar, this.depthScale,
      h("div", { class: "row nowrap" }, ...this.inputs.map((input, n) => h("label", null, n ? "to" : "from", input)),
        h("button", { type: "button", title: "Window from 0 to the 99.9th percentile", onclick: () => stage.store.change({ window: null }) }, "auto")));
    this.draw = oncePerFrame(() => this.render());
    stage.store.on((_view, changed) => ["window", "map", "gamma", "log"].some((name) => changed.has(name)) && this.draw());
    onTheme(() => this.draw());
  }

  /** Range of values: that of the volume, extended to the window. @returns {[number, number]} */
  get range() {
    const { minValue, maxValue, window } = this.stage;
    return [Math.min(minValue, window[0]), Math.max(maxValue, window[1])];
  }

  /** @param {number} handleIndex @param {string} name */
  handle(handleIndex, name) {
    const handle = h("div", {
      class: "handle", role: "slider", tabindex: 0, "aria-label": name, dataset: { handle: handleIndex ? "high" : "low" },
    });
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      handle.focus();
      event.preventDefault();
    });
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const box = this.canvas.getBoundingClientRect();
      const [low, high] = this.range;
      this.setWindow(handleIndex, low + ((event.clientX - box.left) / box.width) * (high - low));
    });
    handle.addEventListener("keydown", (event) => {
      const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
      if (!direction) return;
      const [low, high] = this.range;
      this.setWindow(handleIndex, this.stage.window[handleIndex] + direction * STEP * (high - low));
      event.preventDefault();
    });
    return handle;
  }

  /** @param {number} handleIndex @param {string} name */
  input(handleIndex, name) {
    const input = decimalInput({ "aria-label": `Window ${name}`, class: "short" });
    input.addEventListener("change", () => Number.isFinite(decimalOf(input)) && this.setWindow(handleIndex, decimalOf(input)));
    return input;
  }

  /** @param {number} handleIndex @param {number} value */
  setWindow(handleIndex, value) {
    const window = /** @type {[number, number]} */ ([...this.stage.window]);
    const minWidth = (this.range[1] - this.range[0]) / 1000 || 1e-12;
    window[handleIndex] = handleIndex ? Math.max(value, window[0] + minWidth) : Math.min(value, window[1] - minWidth);
    this.stage.store.change({ window });
  }

  render() {
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const [low, high] = this.range;
    const counts = new Float64Array(BINS);
    for (const values of this.planes()) {
      if (!values) continue;
      for (let n = 0; n < values.length; n++) {
        const bin = Math.floor(((values[n] - low) / (high - low || 1)) * BINS);
        if (bin >= 0) counts[Math.min(bin, BINS - 1)] += 1; // excludes NaN and values below the range
      }
    }
    const maxCount = Math.log1p(Math.max(...counts)) || 1;
    context.clearRect(0, 0, WIDTH, HEIGHT);
    context.fillStyle = colour("--dim");
    counts.forEach((count, n) => {
      const height = (Math.log1p(count) / maxCount) * (HEIGHT - 4);
      context.fillRect((n * WIDTH) / BINS, HEIGHT - height, WIDTH / BINS, height);
    });
    this.stage.window.forEach((value, n) => {
      const share = Math.min(Math.max((value - low) / (high - low), 0), 1);
      this.handles[n].style.left = `${100 * share}%`;
      this.handles[n].setAttribute("aria-valuenow", String(Number(value.toPrecision(4))));
      this.handles[n].setAttribute("aria-valuemin", String(low));
      this.handles[n].setAttribute("aria-valuemax", String(high));
      this.handles[n].setAttribute("aria-valuetext", figure(value));
      showDecimal(this.inputs[n], value, 4);
    });
    this.name.textContent = this.stage.nameText;
    this.name.hidden = !this.name.textContent;
    [low, high].forEach((value, n) => (this.ends[n].textContent = figure(value)));
    this.drawBar();
  }

  /** Draw the colour bar: values below the histogram, or depths for the depth map. */
  drawBar() {
    const { isDepthMap: byDepth, colours, depths, window } = this.stage;
    const bar = /** @type {CanvasRenderingContext2D} */ (this.bar.getContext("2d"));
    const pixels = new ImageData(WIDTH, 1);
    const out = new Uint32Array(pixels.data.buffer);
    if (byDepth) paintRamp(colourTable("depth"), depths, depths, out);
    else paintRamp(colours, this.range, window, out);
    bar.putImageData(pixels, 0, 0);
    this.depthScale.hidden = !byDepth;
    depths.forEach((mm, n) => (this.depths[n].textContent = mmText(mm)));
  }
}
