// @ts-check
// Labels of the signal inspection: kinds of bad A-lines, counts, and units of the maps.
import { count, figure, mm, shortTime } from "../../units.js";

/**
 * @typedef {{aline: number, x: number, y: number, kind: string, detail: string, mend: string}} Bad  x and y in metres
 * @typedef {{alines: number, looked_at: number, complete: boolean, histogram: any, spectrum: any, maps: any, beams: any[], frames: any[], bad: Bad[], bad_counts?: Record<string, number>, decidable?: boolean}} Signals
 */

/** Corrections by their name in the API. */
const MEND_LABELS = /** @type {Record<string, string>} */ ({ "leave-out": "can be excluded", sign: "can be corrected by inverting the sign", shift: "can be corrected by a shift" });

/** Maps by name in the response: title, unit, factor. */
export const MAPS = /** @type {[string, string, string, number][]} */ ([
  ["power", "Power", "counts²", 1], ["baseline_mean", "Baseline, mean", "counts", 1],
  ["baseline_variance", "Baseline, variance", "counts²", 1], ["arrival", "Arrival", "µs", 1e6],
]);

/** Group bad A-lines by kind, the most frequent first. @param {Bad[]} bad @returns {[string, Bad[]][]} */
export function groupByKind(bad) {
  /** @type {Map<string, Bad[]>} */
  const kinds = new Map();
  for (const one of bad) kinds.set(one.kind, [...(kinds.get(one.kind) ?? []), one]);
  return [...kinds].sort(([, a], [, b]) => b.length - a.length);
}

/** Return the number of bad A-lines by kind, including those not listed. @param {Signals} signals @returns {[string, number][]} */
function badCounts({ bad, bad_counts: counts }) {
  return counts ? Object.entries(counts).sort(([, a], [, b]) => b - a) : groupByKind(bad).map(([kind, all]) => [kind, all.length]);
}

/** @param {Signals} signals */
export function summaryOf(signals) {
  const { looked_at: inspected, alines, complete } = signals;
  const of = `${count(inspected)}${inspected < alines ? ` of ${count(alines)}` : ""} A-lines`;
  const soFar = complete ? "" : " so far";
  const limits = signals.decidable === false ? " Inverted and shifted A-lines cannot be detected, because neighbouring A-lines differ too much." : "";
  const numbers = badCounts(signals);
  const badNumber = numbers.reduce((sum, [, one]) => sum + one, 0);
  if (!badNumber) return `0 of ${of}${soFar} are bad.${limits}`;
  const kinds = numbers.map(([kind, one]) => `${count(one)} ${kind}`).join(", ");
  return `${count(badNumber)} of ${of}${soFar} ${badNumber === 1 ? "is" : "are"} bad: ${kinds}. No A-line is excluded or corrected unless the reconstruction requests it.${limits}`;
}

/** Describe one bad A-line. @param {Bad} bad */
export function alineText({ aline, x, y, kind, detail, mend }) {
  return `A-line ${count(aline)} at x ${mm(x)}, y ${mm(y)}: ${[kind, detail, MEND_LABELS[mend]].filter(Boolean).join("; ")}.`;
}

/** Return the unit of a map: counts, or as recorded. @param {string} name @param {boolean} isCounts */
export function mapUnit(name, isCounts) {
  const [, , unit] = MAPS.find(([one]) => one === name) ?? ["", "", "", 1];
  return isCounts || name === "arrival" ? unit : unit.endsWith("²") ? "(as recorded)²" : "as recorded";
}

/** Format a value of a map with its unit. @param {string} name @param {number | null} value @param {boolean} isCounts */
export function mapValue(name, value, isCounts) {
  if (value === null) return "unknown";
  return name === "arrival" ? shortTime(value) : `${figure(value)}\u00a0${mapUnit(name, isCounts)}`;
}
