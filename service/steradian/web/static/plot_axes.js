// @ts-check
// Axes of line plots on a canvas: grid lines, tick labels and axis titles in the colours of the page.
import { colour } from "./theme.js";
import { figure } from "./units.js";
import { ticks } from "./volume/scale.js";

const MARGIN = { left: 96, right: 16, top: 8, bottom: 38 };
const MAX_TICKS = 5;
const TICK_WIDTH = 70; // px per tick label of the horizontal axis

/** @typedef {{from: number, to: number, low: number, high: number, across: string, along: string}} Range limits and titles of the two axes */
/** @typedef {{context: CanvasRenderingContext2D, width: number, height: number}} Surface */

/** Clear a canvas and fit its pixels to its size on the screen; null while it is hidden. @param {HTMLCanvasElement} canvas @returns {Surface | null} */
export function openSurface(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !height) return null;
  const ratio = devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(ratio, ratio);
  context.font = "12px system-ui, sans-serif";
  return { context, width, height };
}

/** Return the functions from values to pixels; values above and below the range are drawn at its limits. @param {Surface} surface @param {Range} range */
export function coordinates({ width, height }, { from, to, low, high }) {
  const plotWidth = width - MARGIN.left - MARGIN.right;
  const plotHeight = height - MARGIN.top - MARGIN.bottom;
  return {
    x: (/** @type {number} */ value) => MARGIN.left + (plotWidth * (value - from)) / (to - from || 1),
    y: (/** @type {number} */ value) => MARGIN.top + (plotHeight * (high - Math.min(high, Math.max(low, value)))) / (high - low || 1),
  };
}

/** Draw grid lines, tick labels and axis titles. @param {Surface} surface @param {Range} range */
export function drawAxes(surface, range) {
  const { context, width, height } = surface;
  const { x, y } = coordinates(surface, range);
  context.fillStyle = colour("--dim");
  context.textAlign = "right";
  for (const value of ticks(range.low, range.high, MAX_TICKS)) {
    drawLevel(surface, range, value, colour("--line"));
    context.fillText(figure(value, 2), MARGIN.left - 6, y(value) + 4);
  }
  context.textAlign = "center";
  const middle = (x(range.from) + x(range.to)) / 2;
  for (const value of ticks(range.from, range.to, Math.floor((width - MARGIN.left - MARGIN.right) / TICK_WIDTH))) {
    context.fillText(figure(Number(value.toPrecision(4))), x(value), height - MARGIN.bottom + 15);
  }
  context.fillText(range.across, middle, height - 6);
  context.save();
  context.translate(14, (MARGIN.top + height - MARGIN.bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(range.along, 0, 0);
  context.restore();
}

/** Draw a horizontal line at a value. @param {Surface} surface @param {Range} range @param {number} value @param {string} tint */
export function drawLevel(surface, range, value, tint) {
  const { context, width } = surface;
  const { y } = coordinates(surface, range);
  context.strokeStyle = tint;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(MARGIN.left, y(value));
  context.lineTo(width - MARGIN.right, y(value));
  context.stroke();
}

/** Draw a curve. @param {Surface} surface @param {Range} range @param {ArrayLike<number>} xs @param {ArrayLike<number>} ys @param {string} tint */
export function drawCurve({ context, ...size }, range, xs, ys, tint) {
  const { x, y } = coordinates({ context, ...size }, range);
  context.strokeStyle = tint;
  context.lineWidth = 1.2;
  context.beginPath();
  for (let n = 0; n < ys.length; n++) context.lineTo(x(xs[n]), y(ys[n]));
  context.stroke();
}
