// @ts-check
// Transfer function of the colour scale: linear, power (gamma) or logarithm.
import { colourTable, isDiverging } from "./colours.js";

/** @typedef {{gamma: number, log: number}} Transfer  exponent; range of a logarithmic scale in dB, 0: none */

const LEVELS = 4096; // of a table that is not linear: its dark end rises steeply

/** Return the function from share of the window to share of the colours, both 0 to 1. @param {Transfer} transfer */
export function transferFunction({ gamma, log }) {
  if (log) return (/** @type {number} */ share) => Math.max(0, 1 + (20 / log) * Math.log10(Math.max(share, 1e-9)));
  return (/** @type {number} */ share) => share ** gamma;
}

/** @type {Map<string, Uint32Array>} */
const tables = new Map();

/** Return the colours over the window (cached); of a map with a zero in its middle, to either side of it.
 *
 * @param {import("./colours.js").MapName} name @param {Transfer} transfer
 */
export function transferTable(name, transfer) {
  const base = colourTable(name);
  if (transfer.gamma === 1 && !transfer.log) return base;
  const key = [name, transfer.gamma, transfer.log].join();
  const cached = tables.get(key);
  if (cached) return cached;
  const apply = transferFunction(transfer);
  const twoSided = isDiverging(name);
  const table = Uint32Array.from({ length: LEVELS }, (_, n) => {
    const share = n / (LEVELS - 1);
    const signed = 2 * share - 1;
    return base[Math.round(255 * (twoSided ? 0.5 + 0.5 * Math.sign(signed) * apply(Math.abs(signed)) : apply(share)))];
  });
  if (tables.size > 32) tables.clear(); // a slider has many values
  tables.set(key, table);
  return table;
}
