// @ts-check
// Map of a mask: points coloured by weight, scan order, and a draggable point of interest.
import { h } from "../dom.js";
import { PointMap } from "../point_map.js";
import { palette } from "../palette.js";
import { colour, onTheme } from "../theme.js";
import { area } from "../units.js";

/** @typedef {import("../point_map.js").Place} Place */

const CLASSES = 24;
const PLAY_MS = 6000;
const GRAB_PIXELS = 22;

export class MaskMap {
  /**
   * @param {HTMLElement} host
   * @param {(place: Place, over: boolean) => void} dragged called with each place, and once more when it is over
   */
  constructor(host, dragged) {
    const stage = h("div", { class: "stage" });
    this.legend = h("div", { class: "legend" });
    this.countNote = h("div", { class: "asked dim small" });
    this.order = h("input", { type: "range", min: 0, max: 1, step: 0.001, value: 1, "aria-label": "Shown part of the scan order", oninput: () => this.showOrder() });
    this.play = h("button", { type: "button", onclick: () => this.toggle() }, "Play order");
    stage.append(this.legend, this.countNote);
    this.controls = h("div", { class: "row" }, this.play, h("span", { class: "grow" }, this.order));
    host.append(stage, this.controls);
    this.pointMap = new PointMap(stage, "Points of the mask on the film; arrow keys move the point of interest");
    this.pointMap.painters.push((context, to) => this.paint(context, to));
    /** @type {Place} */
    this.point = [0, 0];
    /** @type {Place[]} */
    this.otherPoints = [];
    /** @type {number[]} */
    this.visitOrder = [];
    this.shownShare = 1;
    this.animationFrame = 0;
    onTheme(() => this.updateColours());
    this.listen(dragged);
  }

  /** @param {any} preview of the API @param {Place} point @param {Place[]} otherPoints of interest @param {string} note on the number of points */
  show(preview, point, otherPoints, note) {
    this.otherPoints = otherPoints;
    this.countNote.textContent = note;
    this.weights = preview.weights;
    this.isLine = preview.outline?.[0]?.length === 1;
    this.visitOrder = preview.visit;
    this.point = point;
    this.updateColours();
    this.pointMap.show(preview.positions, preview.mask.aperture);
  }

  /** Colour the points by weight; equal weights have one colour. */
  updateColours() {
    if (!this.weights) return;
    const minValue = Math.min(...extent(this.weights));
    const maxValue = Math.max(...extent(this.weights));
    const span = maxValue - minValue > 1e-6 * maxValue ? maxValue - minValue : 0;
    this.pointMap.palette = palette("cividis", CLASSES);
    this.pointMap.classes = Uint8Array.from(this.weights, (/** @type {number} */ one) =>
      span ? Math.min(CLASSES - 1, Math.floor((CLASSES * (one - minValue)) / span)) : CLASSES >> 1);
    const unit = this.isLine ? (/** @type {number} */ one) => `${(one * 1e6).toPrecision(3)} µm` : area;
    const bar = h("span", { class: "ramp", style: { background: `linear-gradient(90deg, ${this.pointMap.palette.join(", ")})` } });
    this.legend.replaceChildren("weight ", span ? unit(minValue) : "", bar, span ? ` ${unit(maxValue)}` : ` ${unit(maxValue)} each`);
    this.pointMap.draw();
  }

  showOrder() {
    this.shownShare = Number(this.order.value);
    this.pointMap.draw();
  }

  toggle() {
    if (this.animationFrame) return this.stopPlaying();
    const from = this.shownShare >= 1 ? 0 : this.shownShare;
    const startedAt = performance.now() - from * PLAY_MS;
    this.play.textContent = "Pause";
    const step = () => {
      this.shownShare = Math.min(1, (performance.now() - startedAt) / PLAY_MS);
      this.order.value = String(this.shownShare);
      this.pointMap.draw();
      this.animationFrame = this.shownShare < 1 ? requestAnimationFrame(step) : 0;
      if (!this.animationFrame) this.stopPlaying();
    };
    this.animationFrame = requestAnimationFrame(step);
  }

  stopPlaying() {
    cancelAnimationFrame(this.animationFrame);
    this.animationFrame = 0;
    this.play.textContent = "Play order";
  }

  /** @param {CanvasRenderingContext2D} context @param {(place: Place) => Place} to */
  paint(context, to) {
    const { places } = this.pointMap;
    const lastShown = Math.round(this.shownShare * this.visitOrder.length);
    if (this.visitOrder.length === places.length && lastShown > 1) {
      context.strokeStyle = colour("--text");
      context.globalAlpha = 0.35;
      context.lineWidth = 0.8;
      context.beginPath();
      for (let n = 0; n < lastShown; n++) context.lineTo(...to(places[this.visitOrder[n]]));
      context.stroke();
      context.globalAlpha = 1;
      if (lastShown < this.visitOrder.length) {
        const [x, y] = to(places[this.visitOrder[lastShown - 1]]);
        ring(context, x, y, 6, colour("--text"), 2);
      }
    }
    for (const other of this.otherPoints) {
      ring(context, ...to(other), 9, colour("--bg"), 5);
      ring(context, ...to(other), 9, colour("--text"), 2.5);
    }
    const [x, y] = to(this.point);
    ring(context, x, y, 9, colour("--bg"), 5);
    ring(context, x, y, 9, colour("--accent"), 2.5);
    cross(context, x, y, 14, colour("--accent"));
  }

  /** @param {(place: Place, over: boolean) => void} dragged */
  listen(dragged) {
    const { canvas } = this.pointMap;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application"); // the arrow keys move the point
    canvas.style.touchAction = "none";
    let isDragging = false;
    const move = (/** @type {PointerEvent} */ event, /** @type {boolean} */ over) => {
      const half = this.pointMap.aperture / 2;
      const inside = this.pointMap.positionOf(event).map((one) => Math.round(Math.min(half, Math.max(-half, one)) * 1e5) / 1e5);
      this.point = /** @type {Place} */ (inside);
      this.pointMap.draw();
      dragged(this.point, over);
    };
    canvas.addEventListener("pointerdown", (event) => {
      const [x, y] = this.pointMap.positionOf(event);
      const metresPerPixel = this.pointMap.aperture / Math.min(canvas.clientWidth, canvas.clientHeight);
      if (Math.hypot(x - this.point[0], y - this.point[1]) > GRAB_PIXELS * metresPerPixel) return;
      isDragging = true;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => isDragging && move(event, false));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      canvas.addEventListener(name, (event) => {
        if (isDragging) move(event, true);
        isDragging = false;
      });
    }
    canvas.addEventListener("keydown", (event) => {
      const step = this.pointMap.aperture * (event.shiftKey ? 0.05 : 0.01);
      const direction = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
      if (!direction) return;
      event.preventDefault();
      const half = this.pointMap.aperture / 2;
      this.point = /** @type {Place} */ (this.point.map((one, n) => Math.round(Math.min(half, Math.max(-half, one + direction[n])) * 1e5) / 1e5));
      this.pointMap.draw();
      dragged(this.point, true);
    });
  }
}

/** Return minimum and maximum of an array of any length. @param {number[]} values @returns {[number, number]} */
export function extent(values) {
  let [minValue, maxValue] = [Infinity, -Infinity];
  for (const one of values) {
    if (one < minValue) minValue = one;
    if (one > maxValue) maxValue = one;
  }
  return [minValue, maxValue];
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} radius @param {string} stroke @param {number} width */
export function ring(context, x, y, radius, stroke, width) {
  context.strokeStyle = stroke;
  context.lineWidth = width;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} arm @param {string} stroke */
function cross(context, x, y, arm, stroke) {
  context.strokeStyle = stroke;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(x - arm, y);
  context.lineTo(x + arm, y);
  context.moveTo(x, y - arm);
  context.lineTo(x, y + arm);
  context.stroke();
}
