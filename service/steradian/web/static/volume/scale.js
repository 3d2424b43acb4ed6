// @ts-check
/** Round lengths for scale bars and axis ticks, and their texts. */
import { signed } from "../units.js";

/** Return the largest 1, 2 or 5 times a power of ten that does not exceed a length.
 *
 * @param {number} length  above 0
 */
export function roundDown(length) {
  const power = 10 ** Math.floor(Math.log10(length) + 1e-9);
  const share = length / power + 1e-9;
  return power * (share >= 5 ? 5 : share >= 2 ? 2 : 1);
}

/** Format a length in mm.
 *
 * @param {number} mm
 */
export function lengthOf(mm) {
  return mm < 0.999 ? `${Number((mm * 1e3).toPrecision(3))} µm` : `${Number(mm.toPrecision(3))} mm`;
}

/** Format a range of depths, from the film downwards. @param {readonly number[]} ends  mm */
export const depthsText = (ends) => `${ends.map((mm) => signed(Math.max(0, mm), 2)).join(" to ")}\u00a0mm`;

/** Format a length with its error: one digit of the error, or two if it starts with 1.
 *
 * @param {number} mm
 * @param {number | null} error  mm; null: not known
 */
export function lengthWithError(mm, error) {
  const [factor, unit] = mm < 0.999 ? [1e3, "µm"] : [1, "mm"];
  if (error === null) return `${lengthOf(mm)} ± ?`;
  const minError = mm < 0.999 ? 0.1 : 0.0001; // smallest error shown, in the unit
  const shownError = Math.max(error * factor, minError);
  const power = Math.floor(Math.log10(shownError) + 1e-9);
  const digits = Math.max(0, -power + (shownError / 10 ** power < 1.95 && shownError > minError ? 1 : 0));
  return `${signed(mm * factor, digits)} ± ${signed(shownError, digits)} ${unit}`;
}

/** Return tick positions within a range, at most `maxTicks`.
 *
 * @param {number} from
 * @param {number} to
 * @param {number} maxTicks
 */
export function ticks(from, to, maxTicks) {
  if (!(to > from) || maxTicks < 1) return [];
  let step = roundDown((to - from) / maxTicks);
  while ((to - from) / step > maxTicks) step = roundDown(step * 2.5);
  const positions = [];
  for (let n = Math.ceil(from / step - 1e-9); n * step <= to + 1e-9 * step; n++) positions.push(Number((n * step).toPrecision(12)));
  return positions;
}
