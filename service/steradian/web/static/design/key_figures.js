// @ts-check
// Key figures of a design.
import { bytes, count, degrees, duration, length, percent } from "../units.js";

/** @param {any} preview of the API @returns {[string, string][]} */
export function keyFigures({ mask, plan, visible_share: visible }) {
  return [
    ["Points", count(mask.count)],
    ["Spacing", mask.coarsest - mask.finest > 1e-9 ? `${length(mask.finest)} to ${length(mask.coarsest)}` : length(mask.finest)],
    ["Weight ratio", mask.weight_ratio.toFixed(2)],
    ["Opening angle", degrees(mask.opening_angle)],
    ["Visible edges", percent(visible)],
    ["Scan", duration(plan.total_seconds)],
    ["Data", bytes(plan.bytes)],
  ];
}
