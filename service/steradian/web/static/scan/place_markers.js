// @ts-check
// Markers over the live image: proposals, the chosen place, which a click or the arrow keys move, and focused places.
import { s } from "../dom.js";

/** @typedef {import("./stages.js").Place} Place */

const RING = 0.035; // radius of a ring, relative to the image's width
const STEP = 0.01; // of an arrow key, relative to the aperture
const LARGE_STEP = 0.05;
const ARROWS = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] });

export class PlaceMarkers {
  constructor() {
    this.svg = s("svg", { class: "markers" });
    this.aperture = Infinity;
    this.width = 1; // mm
    /** @type {Place[]} */
    this.proposals = [];
    /** @type {Place | null} null: nothing is to be chosen */
    this.place = null;
    /** @type {Place[]} */
    this.focus = [];
    /** Receives a place on the film, or a proposal with its depth. @type {(picked: [number, number] | Place) => void} */
    this.onPick = () => {};
    this.svg.addEventListener("click", (event) => this.place && this.onPick(this.placeOf(event)));
    this.svg.addEventListener("keydown", (event) => this.onKey(event));
  }

  /** Set the extent of the image in metres. @param {number} left @param {number} top @param {number} width @param {number} height */
  setExtent(left, top, width, height) {
    this.width = width * 1e3;
    this.svg.setAttribute("viewBox", [left, -top, width, height].map((one) => one * 1e3).join(" "));
    this.draw();
  }

  /** @param {Place[]} proposals @param {Place} place chosen for now */
  showChoice(proposals, place) {
    this.proposals = proposals;
    this.place = place;
    this.svg.setAttribute("tabindex", "0");
    this.svg.setAttribute("role", "application"); // the arrow keys move the place
    this.svg.setAttribute("aria-label", "Point of interest on the live image; the arrow keys move it, with Shift in larger steps");
    this.draw();
  }

  hideChoice() {
    if (!this.place) return;
    this.place = null;
    this.proposals = [];
    for (const name of ["tabindex", "role", "aria-label"]) this.svg.removeAttribute(name);
    this.draw();
  }

  /** Mark the places that the scan is focused on. @param {Place[]} places */
  setFocus(places) {
    this.focus = places;
    this.draw();
  }

  draw() {
    this.svg.classList.toggle("choosing", this.place !== null);
    this.svg.setAttribute("aria-hidden", String(this.place === null));
    this.svg.replaceChildren(
      ...(this.place ? [] : this.focus).flatMap((place) => this.ring(place, "focused")),
      ...this.proposals.flatMap((place, n) => [...this.ring(place, "proposal"), this.number(place, n + 1)]),
      ...(this.place ? [...this.ring(this.place, "chosen"), ...this.cross(this.place)] : []));
  }

  /** Draw a ring with a dark edge, which is visible on any colour. @param {Place} place @param {string} name */
  ring([x, y], name) {
    return ["halo", name].map((one) => s("circle", { cx: x * 1e3, cy: -y * 1e3, r: RING * this.width, class: one, "data-marker": one === "halo" ? null : name }));
  }

  /** @param {Place} place */
  cross([x, y]) {
    const [cx, cy, arm] = [x * 1e3, -y * 1e3, 1.6 * RING * this.width];
    const d = `M${cx - arm} ${cy}H${cx + arm}M${cx} ${cy - arm}V${cy + arm}`;
    return ["halo", "chosen"].map((name) => s("path", { d, class: name }));
  }

  /** @param {Place} place @param {number} number */
  number([x, y], number) {
    return s("text", { x: x * 1e3 + 1.3 * RING * this.width, y: -y * 1e3 - 0.6 * RING * this.width, "font-size": 0.06 * this.width }, String(number));
  }

  /** Return the place of a click: the proposal there, or a place over the aperture. @param {MouseEvent} event @returns {[number, number] | Place} */
  placeOf(event) {
    const matrix = this.svg.getScreenCTM();
    if (!matrix) return [0, 0];
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
    const proposal = this.proposals.find(([x, y]) => Math.hypot(point.x - x * 1e3, point.y + y * 1e3) < RING * this.width);
    return proposal ?? this.inside([point.x * 1e-3, -point.y * 1e-3]);
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    const direction = ARROWS[event.key];
    if (!this.place || !direction) return;
    event.preventDefault();
    const step = (event.shiftKey ? LARGE_STEP : STEP) * Math.min(this.aperture, this.width * 1e-3);
    this.onPick(this.inside([this.place[0] + direction[0] * step, this.place[1] + direction[1] * step]));
  }

  /** Return the nearest place over the aperture, rounded to 10 µm. @param {[number, number]} place @returns {[number, number]} */
  inside(place) {
    const half = this.aperture / 2;
    const [x, y] = place.map((one) => Math.round(Math.min(half, Math.max(-half, one)) * 1e5) / 1e5);
    return [x, y];
  }
}
