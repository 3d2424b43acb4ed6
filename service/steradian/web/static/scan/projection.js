// @ts-check
// Picture of a projection: image, markers, scale bar and colour bar.
import { h } from "../dom.js";
import { figure, PRESSURE } from "../units.js";
import { colourTable } from "../volume/colours.js";
import { drawProjection, numbersOf } from "../volume/projection_image.js";
import { lengthOf, roundDown } from "../volume/scale.js";

const RAMP_COLOURS = 32;
const BAR_SHARE = 0.3; // largest length of the scale bar, relative to the image's width

/** Return colours of the map from its lowest to its highest value. */
function rampColours() {
  const colours = colourTable("inferno");
  return Array.from({ length: RAMP_COLOURS }, (_, n) => colours[Math.round((255 * n) / (RAMP_COLOURS - 1))]).map((pixel) => `rgb(${pixel & 255} ${(pixel >> 8) & 255} ${(pixel >> 16) & 255})`);
}

export class Projection {
  /** @param {import("./place_markers.js").PlaceMarkers} markers */
  constructor(markers) {
    this.markers = markers;
    this.canvas = h("canvas", { role: "img", "aria-label": "Maximum-intensity projection along z" });
    this.scaleBar = h("span", { class: "scale-bar" });
    const ramp = h("span", { class: "ramp", style: { background: `linear-gradient(0deg, ${rampColours().join(", ")})` } });
    this.ends = [h("span"), h("span")];
    this.frame = h("div", { class: "live-frame" }, this.canvas, markers.svg, this.scaleBar);
    this.element = h("div", { class: "projection" }, this.frame, h("div", { class: "colour-bar dim small", role: "group", "aria-label": "Colour scale" }, this.ends[0], ramp, this.ends[1]));
  }

  /**
   * Draw a projection; return its size in metres, or null if the answer is incomplete.
   * @param {"z" | "y"} axis @param {Headers} headers of the answer @param {Uint8Array} values [x, y], or [x, z] of a line
   * @returns {[number, number] | null}
   */
  show(axis, headers, values) {
    const [[nx, ny], [dx, dy]] = [numbersOf(headers, "X-Shape", "1,1"), numbersOf(headers, "X-Spacing", "1,1")];
    const [[x, y], [low, high]] = [numbersOf(headers, "X-Origin", "0,0"), numbersOf(headers, "X-Window", "0,0")];
    if (values.length < nx * ny) return null;
    drawProjection(this.canvas, { values, shape: [nx, ny] }, axis);
    this.canvas.setAttribute("aria-label", `Maximum-intensity projection along ${axis}`);
    this.canvas.style.aspectRatio = `${nx * dx} / ${ny * dy}`;
    this.element.style.setProperty("--aspect", String((nx * dx) / (ny * dy)));
    this.markers.setExtent(x - dx / 2, y + (ny - 0.5) * dy, nx * dx, ny * dy);
    const bar = roundDown(BAR_SHARE * nx * dx * 1e3);
    this.scaleBar.textContent = lengthOf(bar);
    this.scaleBar.style.width = `${(100 * bar) / (nx * dx * 1e3)}%`;
    this.ends[0].textContent = `${figure(high)} ${PRESSURE}`;
    this.ends[1].textContent = figure(low);
    return [nx * dx, ny * dy];
  }
}
