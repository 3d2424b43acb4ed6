// @ts-check
// Facts of scans that are in their masks and plans: number of points, depth of the point of interest, wavelengths.
import { api } from "./api.js";
import { count, mm, nanometres } from "./units.js";

/** @typedef {{points: string, depth: string, wavelengths: string}} Facts */

/** Facts that are not loaded yet. */
export const UNKNOWN = { points: "…", depth: "…", wavelengths: "…" };

/** Facts of a scan; wavelengths are empty if its plan has none. */
export class ScanFacts {
  /** @param {() => void} changed called when facts are loaded */
  constructor(changed) {
    this.changed = changed;
    /** @type {Map<string, any>} masks and plans by path; null: requested */
    this.resources = new Map();
  }

  /** Return the facts of a scan, as far as they are loaded. @param {any} scan @returns {Facts} */
  of(scan) {
    const [mask, plan] = pathsOf(scan).map((path) => this.resources.get(path));
    if (!mask || !plan) return UNKNOWN;
    const lights = plan.excitation.map(nanometres);
    return { points: count(mask.count), depth: mm(mask.depth ?? NaN, 1), wavelengths: wavelengthsText(lights) };
  }

  /** Request the facts of a scan, once. @param {any} scan */
  request(scan) {
    for (const path of pathsOf(scan)) {
      if (this.resources.has(path)) continue;
      this.resources.set(path, null);
      void this.load(path);
    }
  }

  /** @param {string} path */
  async load(path) {
    try {
      this.resources.set(path, await api.get(path));
      this.changed();
    } catch {
      this.resources.delete(path); // requested again when the row comes into sight again
    }
  }
}

/** @param {any} scan */
const pathsOf = (scan) => [`/masks/${scan.mask_id}`, `/plans/${scan.plan_id}`];

/** @param {number[]} lights in nm */
function wavelengthsText(lights) {
  if (!lights.length) return "";
  return `${lights.length > 3 ? `${lights.length}, ${Math.min(...lights)} to ${Math.max(...lights)}` : lights.join(", ")}\u00a0nm`;
}
