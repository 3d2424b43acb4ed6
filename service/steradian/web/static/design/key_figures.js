// @ts-check
// Key figures of a design: points, metrics of the mask, time and data of the scan.
import { bytes, count, degrees, duration, length, percent, signed } from "../units.js";

/** Return the points of a scan; of one in stages the survey's, and the focus's at most. @param {any} preview of the API */
export function pointsText({ stages }) {
  return stages.map((/** @type {number} */ points, /** @type {number} */ n) => `${n ? "up to " : ""}${count(points)}`).join(" + ");
}

/** Return the time of a scan: a range where it may end early. @param {any} plan cost, of the API @param {number[]} stages points of each */
export function timeText({ least_seconds: least, total_seconds: total }, stages) {
  const most = duration(total);
  if (least !== null && least < 0.999 * total && duration(least) !== most) return `${duration(least)} to ${most}`;
  return stages.length > 1 ? `up to ${most}` : most;
}

/** @param {any} preview of the API @returns {[string, string][]} */
export function keyFigures({ mask, plan, stages, visible_share: visible }) {
  return [
    ["Points", pointsText({ stages })],
    ["Spacing", mask.coarsest - mask.finest > 1e-9 ? `${length(mask.finest)} to ${length(mask.coarsest)}` : length(mask.finest)],
    ["Weight ratio", signed(mask.weight_ratio, 2)],
    ["Opening angle", degrees(mask.opening_angle)],
    ["Visible edges", percent(visible)],
    ["Scan", timeText(plan, stages)],
    ["Data", bytes(plan.bytes)],
    ...saturationError(plan.oxygenation),
  ];
}

/** Return the expected error of oxygen saturation of a plan of several wavelengths. @param {any} found @returns {[string, string][]} */
function saturationError(found) {
  if (!found || found.saturation_error === null) return [];
  return [["Oxygen saturation", `± ${percent(found.saturation_error, 1)} of a voxel ${length(found.depth)} deep`]];
}
