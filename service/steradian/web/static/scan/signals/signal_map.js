// @ts-check
// A map of one figure of the A-lines over the film, with its colour bar, and the bad A-lines marked by kind.
import { h, replace } from "../../dom.js";
import { Plane } from "../../point_map.js";
import { shades } from "../../palette.js";
import { colour, onTheme } from "../../theme.js";
import { count, figure } from "../../units.js";
import { byKind, MAPS, told, unitOf, valueOf } from "./labels.js";

/** @typedef {import("./labels.js").Bad} Bad */

const STEPS = 16;
/** Marks by kind; kinds that are not among them share the last one. */
const MARKS = /** @type {Record<string, string>} */ ({ dead: "×", noisy: "○", inverted: "▽", saturated: "□", shifted: "◇" });
const OTHER = "△";

/** @param {string} kind */
export const markOf = (kind) => MARKS[kind] ?? MARKS[kind.replace("time-", "")] ?? OTHER;

export class Field {
  /** @param {HTMLElement} host @param {(aline: number) => void} chosen an A-line that is to be shown */
  constructor(host, chosen) {
    this.select = h("select", { "aria-label": "Map", onchange: () => this.draw() }, MAPS.map(([name, title]) => h("option", { value: name }, title)));
    this.ramp = h("i", { class: "ramp" });
    this.least = h("span");
    this.greatest = h("span");
    this.kinds = h("div", { class: "row small", role: "list", "aria-label": "Marks of bad A-lines" });
    const stage = h("div", { class: "stage" });
    this.said = h("output", { class: "small", "aria-live": "polite" }, "\u00a0");
    host.append(h("div", { class: "row spread" }, this.select, h("span", { class: "legend" }, this.least, this.ramp, this.greatest)), stage, this.said, this.kinds);
    this.plane = new Plane(stage, "Map");
    this.plane.over.push((context, to) => this.paint(context, to));
    /** @type {any} */
    this.maps = null;
    this.isCounts = true;
    /** @type {Bad[]} */
    this.bad = [];
    /** @type {Bad | null} */
    this.lit = null;
    this.listen(chosen);
    onTheme(() => this.draw());
  }

  /** @param {(aline: number) => void} chosen */
  listen(chosen) {
    const { canvas } = this.plane;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application"); // its arrow keys are its own
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: -1, ArrowRight: 1, Escape: 0 }[event.key];
      if (event.key === "Enter" && this.lit) return chosen(this.lit.aline);
      if (way === undefined) return;
      event.preventDefault();
      const { length } = this.bad;
      const now = this.lit ? this.bad.indexOf(this.lit) : way > 0 ? -1 : 0;
      this.light(way && length ? this.bad[(now + way + length) % length] : null);
    });
    canvas.addEventListener("pointermove", (event) => this.point(this.plane.nearest(event)));
    canvas.addEventListener("pointerleave", () => this.light(null));
    canvas.addEventListener("click", () => this.lit && chosen(this.lit.aline));
  }

  /** Tell what is under the pointer. @param {number} place */
  point(place) {
    const [x, y] = this.plane.places[place] ?? [NaN, NaN];
    const found = this.bad.find((one) => one.x === x && one.y === y) ?? null;
    if (found !== this.lit) this.light(found);
    if (!found && place >= 0) this.said.textContent = `${this.select.selectedOptions[0].text}: ${valueOf(this.select.value, this.maps[this.select.value][place], this.isCounts)}`;
  }

  /** Ring a bad A-line and say what is wrong with it. @param {Bad | null} bad */
  light(bad) {
    this.lit = bad;
    this.said.textContent = bad ? told(bad) : "\u00a0";
    this.plane.draw();
  }

  /** @param {any} maps @param {Bad[]} bad @param {number} aperture in metres @param {boolean} isCounts whether the samples are a digitiser's */
  show(maps, bad, aperture, isCounts) {
    this.maps = maps;
    this.bad = bad;
    this.isCounts = isCounts;
    this.lit = bad.find(({ aline }) => aline === this.lit?.aline) ?? null;
    this.plane.show(maps.x.map((/** @type {number} */ x, /** @type {number} */ n) => [x, maps.y[n]]), aperture);
    replace(this.kinds, byKind(bad).map(([kind, all]) => h("span", { role: "listitem", dataset: { mark: kind } }, `${markOf(kind)} ${kind} (${count(all.length)})`)));
    this.draw();
  }

  draw() {
    if (!this.maps) return;
    const [name, title, , factor] = MAPS.find(([one]) => one === this.select.value) ?? MAPS[0];
    const values = /** @type {(number | null)[]} */ (this.maps[name]);
    const known = values.filter((one) => one !== null).sort((a, b) => Number(a) - Number(b));
    const at = (/** @type {number} */ share) => Number(known[Math.round(share * (known.length - 1))] ?? NaN);
    const [least, greatest] = [at(0.01), at(0.99)]; // one dead or loud A-line does not take the colours of all others
    const step = (/** @type {number} */ one) => Math.min(STEPS - 1, Math.max(0, Math.floor((STEPS * (one - least)) / (greatest - least || 1))));
    this.plane.classes = Uint8Array.from(values, (one) => (one === null ? STEPS : step(one)));
    this.plane.palette = [...shades("cividis", STEPS), colour("--missing")];
    this.ramp.style.background = `linear-gradient(to right, ${this.plane.palette.slice(0, STEPS).join(", ")})`;
    [this.least.textContent, this.greatest.textContent] = [figure(least * factor), `${figure(greatest * factor)} ${unitOf(name, this.isCounts)}`];
    const about = `Map of the A-lines' ${title.toLowerCase()}, most between ${valueOf(name, least, this.isCounts)} and ${valueOf(name, greatest, this.isCounts)}, ${count(this.bad.length)} bad ones marked; left and right arrow go from one to the next, Enter shows its A-line, Escape ends it`;
    this.plane.canvas.setAttribute("aria-label", about);
    this.plane.draw();
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
    if (this.lit) {
      const [across, down] = to([this.lit.x, this.lit.y]);
      context.strokeStyle = colour("--text");
      context.lineWidth = 2;
      context.beginPath();
      context.arc(across, down, 11, 0, 2 * Math.PI);
      context.stroke();
    }
    context.restore();
  }
}
