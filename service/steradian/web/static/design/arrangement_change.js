// @ts-check
// Change of a design's arrangement: aperture, place and number of points are kept, as far as the new one has them.
import { furtherPoints } from "./fields.js";

/** @typedef {import("./fields.js").Design} Design */

const MICROMETRE = 1e-6; // step of a grid's interval

/** Change the arrangement of a design. @param {Design} design @param {string} arrangement of the API */
export function changeArrangement(design, arrangement) {
  const { mask } = design;
  const before = pointCount(design);
  design.arrangement = arrangement;
  if (arrangement === "grid") fitGrid(mask, before);
  else if (arrangement === "combined") sharePoints(design, before);
  else mask.count = before;
}

/** Return the requested number of points. @param {Design} design */
function pointCount(design) {
  const { arrangement, mask } = design;
  if (arrangement === "grid") return sideOf(mask.count) === mask.side ? mask.count : mask.side ** 2;
  return furtherPoints(design).reduce((sum, number) => sum + mask[`count${number}`], mask.count);
}

const sideOf = (/** @type {number} */ points) => Math.max(2, Math.round(Math.sqrt(points)));

/** Return the largest interval in whole micrometres with which a grid is within the aperture. @param {number} aperture @param {number} side points */
function largestInterval(aperture, side) {
  const widest = aperture / side;
  const whole = Math.floor(widest / MICROMETRE + 1e-6) * MICROMETRE;
  return Number((whole || widest).toPrecision(6));
}

/** Set a grid of about as many points; it fills the aperture, unless the grid before has that size and fits. @param {Record<string, number>} mask @param {number} points */
function fitGrid(mask, points) {
  const side = sideOf(points);
  if (mask.side === side && mask.interval <= mask.aperture / side) return;
  mask.side = side;
  mask.interval = largestInterval(mask.aperture, side);
}

/**
 * Change the aperture or the points per side of a grid; its interval follows if the grid filled the aperture, or no longer fits.
 * @param {Record<string, number>} mask @param {"aperture" | "side"} key @param {number} value
 */
export function resizeGrid(mask, key, value) {
  const hasFilled = mask.interval === largestInterval(mask.aperture, mask.side);
  mask[key] = value;
  if (mask.aperture > 0 && mask.side > 0 && (hasFilled || mask.side * mask.interval > mask.aperture)) mask.interval = largestInterval(mask.aperture, mask.side);
}

/** Share points evenly among the points of interest. @param {Design} design @param {number} points */
function sharePoints(design, points) {
  const { mask } = design;
  const further = furtherPoints(design);
  const share = Math.max(1, Math.floor(points / (further.length + 1)));
  for (const number of further) mask[`count${number}`] = share;
  mask.count = Math.max(1, points - share * further.length);
}
