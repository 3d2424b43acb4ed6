// @ts-check
// Map of a signal property over the film, with colour bar and marks of bad A-lines.
import { h, replace } from "../../dom.js";
import { PointMap } from "../../point_map.js";
import { palette } from "../../palette.js";
import { colour, onTheme } from "../../theme.js";
import { count, figure } from "../../units.js";
import { groupByKind, MAPS, alineText, mapUnit, mapValue } from "./labels.js";

/** @typedef {import("./labels.js").Bad} Bad */

const COLOUR_STEPS = 16;
/** Marks by kind; other kinds share one mark. */
const KIND_MARKS = /** @type {Record<string, string>} */ ({ dead: "×", noisy: "○", inverted: "▽", saturated: "□", shifted: "◇" });
const OTHER_MARK = "△";

/** @param {string} kind */
export const markOf = (kind) => KIND_MARKS[kind] ?? KIND_MARKS[kind.replace("time-", "")] ?? OTHER_MARK;

export class SignalMap {
  /** @param {HTMLElement} host @param {(aline: number) => void} onSelect an A-line that is to be shown */
  constructor(host, onSelect) {
    this.select = h("select", { "aria-label": "Map", onchange: () => this.draw() }, MAPS.map(([name, title]) => h("option", { value: name }, title)));
    this.colourBar = h("i", { class: "ramp" });
    this.minLabel = h("span");
    this.maxLabel = h("span");
    this.kinds = h("div", { class: "row small", role: "list", "aria-label": "Marks of bad A-lines" });
    const stage = h("div", { class: "stage" });
    this.status = h("output", { class: "small", "aria-live": "polite" }, "\u00a0");
    host.append(h("div", { class: "row spread" }, this.select, h("span", { class: "legend" }, this.minLabel, this.colourBar, this.maxLabel)), stage, this.status, this.kinds);
    this.pointMap = new PointMap(stage, "Map");
    this.pointMap.painters.push((context, to) => this.paint(context, to));
    /** @type {any} */
    this.maps = null;
    this.isCounts = true;
    /** @type {Bad[]} */
    this.bad = [];
    /** @type {Bad | null} */
    this.highlighted = null;
    this.listen(onSelect);
    onTheme(() => this.draw());
  }

  /** @param {(aline: number) => void} onSelect */
  listen(onSelect) {
    const { canvas } = this.pointMap;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application"); // the arrow keys select bad A-lines
    canvas.addEventListener("keydown", (event) => {
      const direction = { ArrowLeft: -1, ArrowRight: 1, Escape: 0 }[event.key];
      if (event.key === "Enter" && this.highlighted) return onSelect(this.highlighted.aline);
      if (direction === undefined) return;
      event.preventDefault();
      const { length } = this.bad;
      const now = this.highlighted ? this.bad.indexOf(this.highlighted) : direction > 0 ? -1 : 0;
      this.highlight(direction && length ? this.bad[(now + direction + length) % length] : null);
    });
    canvas.addEventListener("pointermove", (event) => this.showValue(this.pointMap.nearest(event)));
    canvas.addEventListener("pointerleave", () => this.highlight(null));
    canvas.addEventListener("click", () => this.highlighted && onSelect(this.highlighted.aline));
  }

  /** Show the value at the pointer. @param {number} place */
  showValue(place) {
    const [x, y] = this.pointMap.places[place] ?? [NaN, NaN];
    const match = this.bad.find((one) => one.x === x && one.y === y) ?? null;
    if (match !== this.highlighted) this.highlight(match);
    if (!match && place >= 0) this.status.textContent = `${this.select.selectedOptions[0].text}: ${mapValue(this.select.value, this.maps[this.select.value][place], this.isCounts)}`;
  }

  /** Highlight a bad A-line and describe it. @param {Bad | null} bad */
  highlight(bad) {
    this.highlighted = bad;
    this.status.textContent = bad ? alineText(bad) : "\u00a0";
    this.pointMap.draw();
  }

  /** @param {any} maps @param {Bad[]} bad @param {number} aperture in metres @param {boolean} isCounts whether the samples are a digitiser's */
  show(maps, bad, aperture, isCounts) {
    this.maps = maps;
    this.bad = bad;
    this.isCounts = isCounts;
    this.highlighted = bad.find(({ aline }) => aline === this.highlighted?.aline) ?? null;
    this.pointMap.show(maps.x.map((/** @type {number} */ x, /** @type {number} */ n) => [x, maps.y[n]]), aperture);
    replace(this.kinds, groupByKind(bad).map(([kind, all]) => h("span", { role: "listitem", dataset: { mark: kind } }, `${markOf(kind)} ${kind} (${count(all.length)})`)));
    this.draw();
  }

  draw() {
    if (!this.maps) return;
    const [name, title, , factor] = MAPS.find(([one]) => one === this.select.value) ?? MAPS[0];
    const values = /** @type {(number | null)[]} */ (this.maps[name]);
    const known = values.filter((one) => one !== null).sort((a, b) => Number(a) - Number(b));
    const at = (/** @type {number} */ share) => Number(known[Math.round(share * (known.length - 1))] ?? NaN);
    const [minValue, maxValue] = [at(0.01), at(0.99)]; // percentiles, so that one outlier does not determine the colour scale
    const step = (/** @type {number} */ one) => Math.min(COLOUR_STEPS - 1, Math.max(0, Math.floor((COLOUR_STEPS * (one - minValue)) / (maxValue - minValue || 1))));
    this.pointMap.classes = Uint8Array.from(values, (one) => (one === null ? COLOUR_STEPS : step(one)));
    this.pointMap.palette = [...palette("cividis", COLOUR_STEPS), colour("--missing")];
    this.colourBar.style.background = `linear-gradient(to right, ${this.pointMap.palette.slice(0, COLOUR_STEPS).join(", ")})`;
    [this.minLabel.textContent, this.maxLabel.textContent] = [figure(minValue * factor), `${figure(maxValue * factor)} ${mapUnit(name, this.isCounts)}`];
    const description = `Map of the A-lines' ${title.toLowerCase()}, most between ${mapValue(name, minValue, this.isCounts)} and ${mapValue(name, maxValue, this.isCounts)}, ${count(this.bad.length)} bad A-lines marked; the left and right arrow keys select the next one, Enter shows it, Escape clears the selection`;
    this.pointMap.canvas.setAttribute("aria-label", description);
    this.pointMap.draw();
  }

  /** @param {CanvasRenderingContext2D} context @param {(place: [number, number]) => [number, number]} to */
  paint(context, to) {
    context.save();
    context.font = "bold 15px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = colour("--fault");
    context.strokeStyle = colour("--panel");
    context.lineWidth = 3;
    for (const { x, y, kind } of this.bad) {
      const [across, down] = to([x, y]);
      context.strokeText(markOf(kind), across, down);
      context.fillText(markOf(kind), across, down);
    }
    if (this.highlighted) {
      const [across, down] = to([this.highlighted.x, this.highlighted.y]);
      context.strokeStyle = colour("--text");
      context.lineWidth = 2;
      context.beginPath();
      context.arc(across, down, 11, 0, 2 * Math.PI);
      context.stroke();
    }
    context.restore();
  }
}
