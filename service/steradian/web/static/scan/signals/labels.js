// @ts-check
// The inspection of a scan's signals in words: kinds of bad A-lines, their number, and what a value of a map means.
import { count, figure, mm, shortTime } from "../../units.js";

/**
 * @typedef {{aline: number, x: number, y: number, kind: string, detail: string, mend: string}} Bad  x and y in metres
 * @typedef {{alines: number, looked_at: number, complete: boolean, histogram: any, spectrum: any, maps: any, beams: any[], frames: any[], bad: Bad[], bad_counts?: Record<string, number>, decidable?: boolean}} Signals
 */

/** What a mend does, as the service names it. */
const MEND_LABELS = /** @type {Record<string, string>} */ ({ "leave-out": "can be excluded", sign: "can be corrected by inverting the sign", shift: "can be corrected by a shift" });

/** Maps by their name in the answer: name, unit, factor from the answer's unit. */
export const MAPS = /** @type {[string, string, string, number][]} */ ([
  ["power", "Power", "counts²", 1], ["baseline_mean", "Baseline, mean", "counts", 1],
  ["baseline_variance", "Baseline, variance", "counts²", 1], ["arrival", "Arrival", "µs", 1e6],
]);

/** Bad A-lines by kind, the most frequent first. @param {Bad[]} bad @returns {[string, Bad[]][]} */
export function groupByKind(bad) {
  /** @type {Map<string, Bad[]>} */
  const kinds = new Map();
  for (const one of bad) kinds.set(one.kind, [...(kinds.get(one.kind) ?? []), one]);
  return [...kinds].sort(([, a], [, b]) => b.length - a.length);
}

/** The number of bad A-lines by kind, also of those that are not listed. @param {Signals} signals @returns {[string, number][]} */
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

/** One A-line in a sentence. @param {Bad} bad */
export function alineText({ aline, x, y, kind, detail, mend }) {
  return `A-line ${count(aline)} at x ${mm(x)}, y ${mm(y)}: ${[kind, detail, MEND_LABELS[mend]].filter(Boolean).join("; ")}.`;
}

/** Unit of a map: the digitiser's counts, or those of a recording whose unit is not known. @param {string} name @param {boolean} isCounts */
export function mapUnit(name, isCounts) {
  const [, , unit] = MAPS.find(([one]) => one === name) ?? ["", "", "", 1];
  return isCounts || name === "arrival" ? unit : unit.endsWith("²") ? "(as recorded)²" : "as recorded";
}

/** A value of a map with its unit. @param {string} name @param {number | null} value @param {boolean} isCounts */
export function mapValue(name, value, isCounts) {
  if (value === null) return "unknown";
  return name === "arrival" ? shortTime(value) : `${figure(value)}\u00a0${mapUnit(name, isCounts)}`;
}
