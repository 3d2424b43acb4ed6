// @ts-check
// The plane of a design: points by weight, the order of visit, and a point that is dragged.
import { h } from "../dom.js";
import { Plane } from "../point_map.js";
import { shades } from "../palette.js";
import { colour, onTheme } from "../theme.js";
import { area, count } from "../units.js";

/** @typedef {import("../point_map.js").Place} Place */

const CLASSES = 24;
const PLAY = 6000;
const REACH = 22;

export class DesignPlane {
  /**
   * @param {HTMLElement} host
   * @param {(place: Place, over: boolean) => void} dragged called with each place, and once more when it is over
   */
  constructor(host, dragged) {
    const stage = h("div", { class: "stage" });
    this.legend = h("div", { class: "legend" });
    this.asked = h("div", { class: "asked dim small" });
    this.order = h("input", { type: "range", min: 0, max: 1, step: 0.001, value: 1, "aria-label": "How much of the order of visit is shown", oninput: () => this.showOrder() });
    this.play = h("button", { type: "button", onclick: () => this.toggle() }, "Play order");
    stage.append(this.legend, this.asked);
    this.controls = h("div", { class: "row" }, this.play, h("span", { class: "grow" }, this.order));
    host.append(stage, this.controls);
    this.plane = new Plane(stage, "The points of the mask on the film; arrow keys move the point of interest");
    this.plane.over.push((context, to) => this.paint(context, to));
    /** @type {Place} */
    this.point = [0, 0];
    /** @type {Place[]} */
    this.others = [];
    /** @type {number[]} */
    this.visit = [];
    this.shown = 1;
    this.playing = 0;
    onTheme(() => this.tint());
    this.listen(dragged);
  }

  /** @param {any} seen of the API @param {Place} point @param {Place[]} others of interest @param {number | null} asked points */
  show(seen, point, others, asked) {
    this.others = others;
    this.asked.textContent = asked === null || asked === seen.mask.count ? "" : `${count(seen.mask.count)} points, nearest to ${count(asked)}`;
    this.weights = seen.weights;
    this.isLine = seen.outline?.[0]?.length === 1;
    this.visit = seen.visit;
    this.point = point;
    this.tint();
    this.plane.show(seen.positions, seen.mask.aperture);
  }

  /** Colours by weight, the same for all where the weights are. */
  tint() {
    if (!this.weights) return;
    const least = Math.min(...extent(this.weights));
    const most = Math.max(...extent(this.weights));
    const span = most - least > 1e-6 * most ? most - least : 0;
    this.plane.palette = shades("cividis", CLASSES);
    this.plane.classes = Uint8Array.from(this.weights, (/** @type {number} */ one) =>
      span ? Math.min(CLASSES - 1, Math.floor((CLASSES * (one - least)) / span)) : CLASSES >> 1);
    const unit = this.isLine ? (/** @type {number} */ one) => `${(one * 1e6).toPrecision(3)} µm` : area;
    const bar = h("span", { class: "ramp", style: { background: `linear-gradient(90deg, ${this.plane.palette.join(", ")})` } });
    this.legend.replaceChildren("weight ", span ? unit(least) : "", bar, span ? ` ${unit(most)}` : ` ${unit(most)} each`);
    this.plane.draw();
  }

  showOrder() {
    this.shown = Number(this.order.value);
    this.plane.draw();
  }

  toggle() {
    if (this.playing) return this.halt();
    const from = this.shown >= 1 ? 0 : this.shown;
    const begun = performance.now() - from * PLAY;
    this.play.textContent = "Pause";
    const step = () => {
      this.shown = Math.min(1, (performance.now() - begun) / PLAY);
      this.order.value = String(this.shown);
      this.plane.draw();
      this.playing = this.shown < 1 ? requestAnimationFrame(step) : 0;
      if (!this.playing) this.halt();
    };
    this.playing = requestAnimationFrame(step);
  }

  halt() {
    cancelAnimationFrame(this.playing);
    this.playing = 0;
    this.play.textContent = "Play order";
  }

  /** @param {CanvasRenderingContext2D} context @param {(place: Place) => Place} to */
  paint(context, to) {
    const { places } = this.plane;
    const upTo = Math.round(this.shown * this.visit.length);
    if (this.visit.length === places.length && upTo > 1) {
      context.strokeStyle = colour("--text");
      context.globalAlpha = 0.35;
      context.lineWidth = 0.8;
      context.beginPath();
      for (let n = 0; n < upTo; n++) context.lineTo(...to(places[this.visit[n]]));
      context.stroke();
      context.globalAlpha = 1;
      if (upTo < this.visit.length) {
        const [x, y] = to(places[this.visit[upTo - 1]]);
        ring(context, x, y, 6, colour("--text"), 2);
      }
    }
    for (const other of this.others) {
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
    const { canvas } = this.plane;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application"); // its arrow keys are its own
    canvas.style.touchAction = "none";
    let holds = false;
    const move = (/** @type {PointerEvent} */ event, /** @type {boolean} */ over) => {
      const half = this.plane.aperture / 2;
      const inside = this.plane.placeOf(event).map((one) => Math.round(Math.min(half, Math.max(-half, one)) * 1e5) / 1e5);
      this.point = /** @type {Place} */ (inside);
      this.plane.draw();
      dragged(this.point, over);
    };
    canvas.addEventListener("pointerdown", (event) => {
      const [x, y] = this.plane.placeOf(event);
      const per = this.plane.aperture / Math.min(canvas.clientWidth, canvas.clientHeight);
      if (Math.hypot(x - this.point[0], y - this.point[1]) > REACH * per) return;
      holds = true;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => holds && move(event, false));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      canvas.addEventListener(name, (event) => {
        if (holds) move(event, true);
        holds = false;
      });
    }
    canvas.addEventListener("keydown", (event) => {
      const step = this.plane.aperture * (event.shiftKey ? 0.05 : 0.01);
      const way = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
      if (!way) return;
      event.preventDefault();
      const half = this.plane.aperture / 2;
      this.point = /** @type {Place} */ (this.point.map((one, n) => Math.round(Math.min(half, Math.max(-half, one + way[n])) * 1e5) / 1e5));
      this.plane.draw();
      dragged(this.point, true);
    });
  }
}

/** Least and greatest, also of more numbers than a call takes. @param {number[]} values @returns {[number, number]} */
export function extent(values) {
  let [least, most] = [Infinity, -Infinity];
  for (const one of values) {
    if (one < least) least = one;
    if (one > most) most = one;
  }
  return [least, most];
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
