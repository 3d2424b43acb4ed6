// @ts-check
// Charts of several lines on common axes, on a canvas, with a button per line that shows or hides it.
import { h, oncePerFrame, replace, replaceKeepingFocus } from "./dom.js";
import { palette } from "./palette.js";
import { drawAxes, drawCurve, openSurface } from "./plot_axes.js";
import { onTheme } from "./theme.js";

/** @typedef {{name: string, x: number[], y: number[]}} Line */

const PADDING = 0.05; // of the range of the values, above and below

export class LineChart {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.canvas = h("canvas", { role: "img" });
    this.legend = h("div", { class: "legend", role: "group", "aria-label": "Lines" });
    const plot = h("div", { class: "plot" }, this.canvas);
    replace(host, plot, this.legend);
    /** @type {Line[]} */
    this.lines = [];
    /** @type {string[]} one a line */
    this.colours = [];
    this.labels = { x: "", y: "" };
    /** @type {Set<string>} */
    this.hidden = new Set();
    this.draw = oncePerFrame(() => this._draw());
    new ResizeObserver(() => this.draw()).observe(plot);
    onTheme(() => this.show(this.lines, this.labels));
  }

  /** @param {Line[]} lines @param {{x: string, y: string}} labels with units */
  show(lines, labels) {
    this.lines = lines;
    this.labels = labels;
    this.colours = palette("cividis", lines.length);
    this.canvas.setAttribute("aria-label", `${labels.y} against ${labels.x}: ${lines.map(({ name }) => name).join(", ")}`);
    replaceKeepingFocus(this.legend, lines.map(({ name }, n) => this.legendButton(name, this.colours[n])));
    this.draw();
  }

  /** Create the legend entry of a line: a button that shows or hides the line. @param {string} name @param {string} tint */
  legendButton(name, tint) {
    const button = h("button", { type: "button", class: "quiet", "aria-pressed": String(!this.hidden.has(name)) }, h("span", { class: "swatch", style: { background: tint } }), name);
    button.addEventListener("click", () => {
      if (!this.hidden.delete(name)) this.hidden.add(name);
      button.setAttribute("aria-pressed", String(!this.hidden.has(name)));
      this.draw();
    });
    return button;
  }

  _draw() {
    const surface = openSurface(this.canvas);
    if (!surface) return;
    const [from, to] = limits(this.lines.map(({ x }) => x));
    const [low, high] = limits(this.lines.map(({ y }) => y));
    const padding = PADDING * (high - low) || 1;
    const range = { from, to, low: low - padding, high: high + padding, across: this.labels.x, along: this.labels.y };
    drawAxes(surface, range);
    this.lines.forEach(({ name, x, y }, n) => this.hidden.has(name) || drawCurve(surface, range, x, y, this.colours[n]));
  }
}

/** Return the least and the greatest value. @param {number[][]} rows @returns {[number, number]} */
function limits(rows) {
  let [least, greatest] = [Infinity, -Infinity];
  for (const row of rows) {
    for (const value of row) {
      if (value < least) least = value;
      if (value > greatest) greatest = value;
    }
  }
  return least <= greatest ? [least, greatest] : [0, 1];
}
