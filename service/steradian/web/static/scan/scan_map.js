// @ts-check
// Map of a scan: stored and flagged points, points to come or missing, and the beam position; counts serve as filters.
import { h, replace } from "../dom.js";
import { PointMap } from "../point_map.js";
import { colour, onTheme } from "../theme.js";
import { count, wavelengthText } from "../units.js";
import { FLAGS } from "./shots.js";

/** @typedef {import("../point_map.js").Place} Place */
/** @typedef {import("./shots.js").Shots} Shots */

const MISSING = 0;
const STORED = 1;
const FLAGGED = 2;
const FILTERED_OUT = 3;

export class ScanMap {
  /**
   * @param {HTMLElement} host
   * @param {(row: number | null) => void} selectedRow a point that is to be shown; null: the newest again
   */
  constructor(host, selectedRow) {
    this.filters = h("div", { class: "row filters", role: "group", "aria-label": "Show only" });
    this.frame = h("select", { "aria-label": "Frame", hidden: true, onchange: () => this.draw() });
    const stage = h("div", { class: "stage" });
    host.append(h("div", { class: "row spread" }, this.filters, this.frame), stage);
    this.pointMap = new PointMap(stage, "Points of the scan: stored, flagged, and to come or missing; the left and right arrow keys select an A-line, Escape selects the newest");
    this.pointMap.painters.push((context, to) => this.paint(context, to));
    this.filter = "";
    /** @type {Shots | null} */
    this.shots = null;
    /** @type {number | null} row that the user selected */
    this.selectedRow = null;
    this.isMoving = false;
    /** @type {number[]} wavelengths of the plan in metres; all frames at the first come first */
    this.excitation = [];
    this.isOver = false; // points that are not stored are missing then; before, they are to come
    onTheme(() => this.updateColours());
    this.updateColours();
    this.pointMap.canvas.addEventListener("click", (event) => {
      const point = this.pointMap.nearest(/** @type {PointerEvent} */ (event));
      const row = point < 0 ? -1 : this.offset + point;
      select(row >= 0 && row !== this.selectedRow && this.shots?.stored[row] ? row : null);
    });
    const select = (/** @type {number | null} */ row) => {
      this.selectedRow = row;
      this.pointMap.draw();
      selectedRow(row);
    };
    this.pointMap.canvas.tabIndex = 0;
    this.pointMap.canvas.setAttribute("role", "application"); // the arrow keys select A-lines
    this.pointMap.canvas.addEventListener("keydown", (event) => {
      const direction = { ArrowLeft: -1, ArrowRight: 1, Escape: 0 }[event.key];
      if (direction === undefined) return;
      event.preventDefault();
      select(direction ? this.neighbourOf(direction) : null);
    });
  }

  /** Return the row of the next stored A-line of the frame in a direction. @param {number} direction @returns {number | null} */
  neighbourOf(direction) {
    const { length } = this.pointMap.places;
    let point = (this.selectedRow ?? this.shots?.newest ?? 0) % (length || 1);
    for (let n = 0; n < length; n++) {
      point = (point + direction + length) % length;
      if (this.shots?.stored[this.offset + point]) return this.offset + point;
    }
    return null;
  }

  /** @param {Place[]} places @param {number} aperture */
  setPositions(places, aperture) {
    this.pointMap.show(places, aperture);
  }

  updateColours() {
    this.pointMap.palette = [colour("--missing"), colour("--accent"), colour("--fault"), colour("--line")];
    this.pointMap.draw();
  }

  /** First row of the visible frame. */
  get offset() {
    return Number(this.frame.value || 0) * this.pointMap.places.length;
  }

  /** @param {Shots} shots @param {boolean} isMoving whether the beam moves over the map now */
  update(shots, isMoving) {
    this.shots = shots;
    this.isMoving = isMoving;
    this.setFrameCount(shots.coverage.frames);
    this.draw();
  }

  /** @param {number} number */
  setFrameCount(number) {
    if (this.frame.options.length === number) return;
    replace(this.frame, Array.from({ length: number }, (_, n) => h("option", { value: n }, this.frameName(n, number))));
    this.frame.hidden = number < 2;
  }

  /** Return the name of a frame: its wavelength, if the plan has any, and its number. @param {number} n @param {number} number */
  frameName(n, number) {
    const lights = this.excitation.length;
    const each = lights ? number / lights : number;
    const name = `frame ${(n % each) + 1} of ${each}`;
    const light = lights ? wavelengthText(this.excitation[Math.floor(n / each)]) : "";
    return light ? (each > 1 ? `${light}, ${name}` : light) : `F${name.slice(1)}`;
  }

  draw() {
    const { shots } = this;
    if (!shots) return;
    const { offset } = this;
    const activeFilter = this.filter;
    const bit = FLAGS.find(([, name]) => name === activeFilter)?.[0] ?? 0;
    this.pointMap.classes = Uint8Array.from(this.pointMap.places, (_, point) => {
      const row = offset + point;
      const status = !shots.stored[row] ? MISSING : shots.quality[row] ? FLAGGED : STORED;
      if (!activeFilter) return status;
      const passes = bit ? status !== MISSING && (shots.quality[row] & bit) !== 0 : activeFilter === "stored" ? status !== MISSING : status === MISSING;
      return passes ? status : FILTERED_OUT;
    });
    this.pointMap.draw();
    this.showCounts(shots);
  }

  /** @param {Shots} shots */
  showCounts(shots) {
    const { stored, missing, flags } = shots.coverage;
    const flagged = FLAGS.map(([, name, apiName]) => /** @type {[string, number]} */ ([name, flags[apiName] ?? 0]));
    const counts = new Map([["stored", stored], ["missing", missing], ...flagged]);
    const buttons = /** @type {HTMLButtonElement[]} */ ([...this.filters.children]);
    if (!buttons.length) {
      for (const name of counts.keys()) {
        const act = () => {
          this.filter = this.filter === name ? "" : name;
          this.draw();
        };
        buttons.push(h("button", { type: "button", class: "chip", onclick: act, dataset: { filter: name } }, h("i", { class: `swatch ${name}` }), h("span")));
      }
      this.filters.append(...buttons);
    }
    for (const button of buttons) {
      const name = button.dataset.filter ?? "";
      const text = `${name === "missing" && !this.isOver ? "to come" : name} ${count(counts.get(name))}`;
      const label = /** @type {HTMLElement} */ (button.lastElementChild);
      if (label.textContent !== text) label.textContent = text;
      button.setAttribute("aria-pressed", String(this.filter === name));
      button.hidden = !counts.get(name) && name !== "stored" && this.filter !== name;
    }
  }

  /** Mark flagged points by shape as well as colour, and the newest and selected points by rings. @param {CanvasRenderingContext2D} context @param {(setPositions: Place) => Place} to */
  paint(context, to) {
    const { classes, places, radius } = this.pointMap;
    const arm = radius + 2;
    context.strokeStyle = colour("--fault");
    context.lineWidth = 1.2;
    context.beginPath();
    for (let n = 0; n < places.length; n++) {
      if (classes[n] !== FLAGGED) continue;
      const [x, y] = to(places[n]);
      context.moveTo(x - arm, y - arm);
      context.lineTo(x + arm, y + arm);
      context.moveTo(x - arm, y + arm);
      context.lineTo(x + arm, y - arm);
    }
    context.stroke();
    if (this.isMoving && this.shots) this.mark(context, to, this.shots.newest, colour("--text"));
    if (this.selectedRow !== null) this.mark(context, to, this.selectedRow, colour("--accent"));
  }

  /** @param {CanvasRenderingContext2D} context @param {(setPositions: Place) => Place} to @param {number} row @param {string} stroke */
  mark(context, to, row, stroke) {
    const position = this.pointMap.places[row - this.offset];
    if (!position) return;
    const [x, y] = to(position);
    context.strokeStyle = stroke;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x, y, this.pointMap.radius + 5, 0, 2 * Math.PI);
    context.stroke();
  }
}
