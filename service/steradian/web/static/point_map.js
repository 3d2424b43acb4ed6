// @ts-check
// Map of the film to scale: points in metres, coloured by class, with custom painters on top.
import { oncePerFrame, h } from "./dom.js";
import { colour, onTheme } from "./theme.js";
import { mm } from "./units.js";

/** @typedef {[number, number]} Place x and y in metres */
/** @typedef {(context: CanvasRenderingContext2D, to: (place: Place) => Place, plane: PointMap) => void} Painter */

const MARGIN = 26;

export class PointMap {
  /**
   * @param {HTMLElement} host filled by the canvas
   * @param {string} label accessible name
   */
  constructor(host, label) {
    this.canvas = h("canvas", { role: "img", "aria-label": label, style: { width: "100%", height: "100%" } });
    host.append(this.canvas);
    /** @type {Place[]} */
    this.places = [];
    this.aperture = 0.01;
    /** @type {ArrayLike<number>} class of each point: an index into the palette */
    this.classes = [];
    /** @type {string[]} */
    this.palette = [];
    /** @type {Painter[]} */
    this.painters = [];
    this.draw = oncePerFrame(() => this._draw());
    new ResizeObserver(() => this.draw()).observe(host);
    onTheme(this.draw);
  }

  /**
   * Show points.
   * @param {Place[]} places @param {number} aperture in metres
   */
  show(places, aperture) {
    this.places = places;
    this.aperture = aperture;
    this.draw();
  }

  /** Return the position on the film of a pointer event, in metres. @param {PointerEvent} event @returns {Place} */
  positionOf(event) {
    const { scale, x, y } = this._frame();
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left - x) / scale, (y - (event.clientY - box.top)) / scale];
  }

  /** Return the index of the point nearest to an event, or −1 if none is within reach. @param {PointerEvent} event */
  nearest(event) {
    const [x, y] = this.positionOf(event);
    let best = -1;
    let minDistance = (12 / this._frame().scale) ** 2;
    for (let n = 0; n < this.places.length; n++) {
      const away = (this.places[n][0] - x) ** 2 + (this.places[n][1] - y) ** 2;
      if (away < minDistance) [best, minDistance] = [n, away];
    }
    return best;
  }

  /** Radius of a point in pixels. */
  get radius() {
    const spacing = this.aperture / Math.sqrt(Math.max(1, this.places.length));
    return Math.min(6, Math.max(0.8, 0.27 * spacing * this._frame().scale));
  }

  _frame() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const scale = Math.max(1, Math.min(width, height) - 2 * MARGIN) / (this.aperture * 1.04);
    return { width, height, scale, x: width / 2, y: height / 2 };
  }

  _draw() {
    const { width, height, scale, x, y } = this._frame();
    if (!width || !height) return;
    const ratio = devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const to = (/** @type {Place} */ place) => /** @type {Place} */ ([x + place[0] * scale, y - place[1] * scale]);
    this._edge(context, to);
    this._points(context, to);
    for (const paint of this.painters) paint(context, to, this);
    this._ruler(context, width, height, scale);
  }

  /** @param {CanvasRenderingContext2D} context @param {(place: Place) => Place} to */
  _edge(context, to) {
    const half = this.aperture / 2;
    const [left, top] = to([-half, half]);
    const [right, bottom] = to([half, -half]);
    context.strokeStyle = colour("--edge");
    context.lineWidth = 1;
    context.strokeRect(left, top, right - left, bottom - top);
    context.fillStyle = colour("--dim");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(`${mm(this.aperture)} square, x →`, (left + right) / 2, bottom + 16);
    context.save();
    context.translate(left - 8, (top + bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText("y →", 0, 0);
    context.restore();
  }

  /** Draw the points in one pass per colour, because changing the colour is expensive. @param {CanvasRenderingContext2D} context @param {(place: Place) => Place} to */
  _points(context, to) {
    const radius = this.radius;
    const round = this.places.length <= 6000 && radius > 1;
    for (let one = 0; one < this.palette.length; one++) {
      context.fillStyle = this.palette[one];
      context.beginPath();
      for (let n = 0; n < this.places.length; n++) {
        if (this.classes[n] !== one) continue;
        const [px, py] = to(this.places[n]);
        if (round) {
          context.moveTo(px + radius, py);
          context.arc(px, py, radius, 0, 2 * Math.PI);
        } else context.rect(px - radius, py - radius, 2 * radius, 2 * radius);
      }
      context.fill();
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {number} width @param {number} height @param {number} scale */
  _ruler(context, width, height, scale) {
    const steps = [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1];
    const rulerLength = steps.filter((step) => step * scale < 0.25 * width).pop() ?? steps[0];
    context.strokeStyle = context.fillStyle = colour("--text");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(8, height - 6);
    context.lineTo(8 + rulerLength * scale, height - 6);
    context.stroke();
    context.textAlign = "left";
    context.fillText(rulerLength >= 1e-3 ? `${rulerLength * 1e3} mm` : `${Math.round(rulerLength * 1e6)} µm`, 8, height - 11);
  }
}
