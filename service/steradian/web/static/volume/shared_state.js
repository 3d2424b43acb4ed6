// @ts-check
// What all views of a volume share: where one looks, how large a mm is, which values have which colour.
import { AXES, PLANES, axisIndex, findBrightest, fetchDepths, firstVoxelBelow, fetchPlane, slabRange } from "./volume_data.js";
import { colourTable } from "./colours.js";

/** @typedef {import("./volume_data.js").Source} Source */
/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {import("./measurements.js").Plane} Plane */

const COLOUR_PERCENTILE = 0.999; // of a projection's values, at which colours end; as in the service's own pictures
const MIN_END_SHARE = 0.5; // of the maximum, at least
const BRIGHT_SHARE = 0.5; // depths are coloured over those of columns at least so bright
const MARGIN = 0.94;

/** Where colours end by themselves. @param {ArrayLike<number>} sorted the values of a projection */
export function colourEnd(sorted) {
  const last = sorted.length - 1;
  return Math.max(sorted[Math.floor(COLOUR_PERCENTILE * last)], MIN_END_SHARE * sorted[last]);
}

export class Stage {
  /** @param {Source} source @param {import("./view_store.js").Store} store */
  constructor(source, store) {
    this.source = source;
    this.store = store;
    /** @type {Source | null} a second volume, beside which this one is looked at */
    this.reference = null;
    /** @type {Triple} where one looks before one has said so */
    this.defaultPosition = /** @type {Triple} */ (AXES.map((axis) => (this.ends(axis)[0] + this.ends(axis)[1]) / 2));
    /** @type {[number, number]} */
    this.defaultWindow = [0, source.peak || 1];
    /** @type {[number, number]} mm, at the ends of the hues */
    this.depths = [0, 1];
    this.maxValue = source.peak || 1;
    this.minValue = 0;
    /** @type {{axis: Axis, width: number, height: number}[]} CSS pixels of each slice view */
    this.sizes = [];
    /** @type {Map<Axis, number>} how far apart this volume and the reference are in each view */
    this.differenceEnds = new Map();
    /** @type {Plane | null} the projection along z (y of a line's image) of everything below the near field */
    this.whole = null;
  }

  get view() {
    return this.store.view;
  }

  /** Depth (mm) above which nothing is shown. */
  get cut() {
    return this.view.cut ?? this.source.near;
  }

  /** Where the crosshair is (mm). */
  get position() {
    return this.view.at ?? this.defaultPosition;
  }

  get window() {
    return this.view.window ?? this.defaultWindow;
  }

  /** Whether the reference has the same voxels, so that one can be subtracted from the other. */
  get isComparable() {
    const { source, reference } = this;
    const isClose = (/** @type {number} */ one, /** @type {number} */ other) => Math.abs(one - other) < 1e-6;
    return reference !== null && source.shape.every((count, n) => count === reference.shape[n] && isClose(source.spacing[n], reference.spacing[n]) && isClose(source.origin[n], reference.origin[n]));
  }

  /** @param {Axis} axis @param {Float32Array | Float64Array} differences of what a view shows, without their sign */
  setDifference(axis, differences) {
    this.differenceEnds.set(axis, colourEnd(differences.sort()));
    this.store.notify(["difference"]);
  }

  /** Where colours of differences end, to either side; the window makes it more or less. */
  get differenceEnd() {
    return Math.max(...this.differenceEnds.values(), 0) * (this.window[1] / this.defaultWindow[1]) || 1;
  }

  get isDepthMap() {
    return this.view.map === "depth" && !this.source.flat;
  }

  get colours() {
    const name = this.view.map === "depth" ? "grey" : this.view.map;
    return colourTable(/** @type {import("./colours.js").MapName} */ (name));
  }

  /** Extent (mm) along an axis, between outer edges. @param {Axis} axis */
  extent(axis) {
    return this.source.shape[axisIndex(axis)] * this.source.spacing[axisIndex(axis)];
  }

  /** Ends (mm) of the volume along an axis. @param {Axis} axis @returns {[number, number]} */
  ends(axis) {
    const n = axisIndex(axis);
    const first = this.source.origin[n] - this.source.spacing[n] / 2;
    return [first, first + this.extent(axis)];
  }

  /** The middle of every view (mm). @returns {Triple} */
  get centre() {
    if (this.view.centre) return this.view.centre;
    return /** @type {Triple} */ (AXES.map((axis) => (this.ends(axis)[0] + this.ends(axis)[1]) / 2));
  }

  /** Pixels a mm has in every slice view, so that what lies in one line lies in one line in all of them. */
  get scale() {
    const scales = this.sizes.map(({ axis, width, height }) => {
      const [across, up] = PLANES[axis];
      return Math.min(width / this.extent(across), height / this.extent(up));
    });
    return (scales.length ? Math.min(...scales) : 1) * MARGIN * this.view.zoom;
  }

  /** Voxels that a view across an axis shows, of this volume or of another at the same place. @param {Axis} axis */
  range(axis, source = this.source) {
    return slabRange(source, axis, this.position[axisIndex(axis)], this.view.slab[axisIndex(axis)], this.cut);
  }

  /** Look at the whole once: where it is brightest, where colours end, over which depths there is something. */
  async readOverview() {
    const { source, cut } = this;
    const along = source.flat ? "y" : "z";
    const [whole, brightest] = await Promise.all([
      fetchPlane(source, along, slabRange(source, along, 0, Infinity, cut)),
      findBrightest(source, cut),
    ]);
    const first = source.flat ? firstVoxelBelow(source, cut) : 0;
    const values = source.flat ? whole.values.filter((_, n) => n % whole.shape[1] >= first) : whole.values;
    const sorted = values.slice().sort();
    this.maxValue = sorted[sorted.length - 1];
    this.minValue = Math.min(0, sorted[0]);
    this.defaultWindow = [0, colourEnd(sorted) || 1];
    this.defaultPosition = brightest;
    this.whole = whole;
  }

  /** Find the depths over which there is something, for the hues. */
  async readDepths() {
    const { source, whole } = this;
    if (source.flat || !whole) return;
    const depths = await fetchDepths(source, slabRange(source, "z", 0, Infinity, this.cut));
    if (depths.values.length !== whole.values.length) return;
    const threshold = BRIGHT_SHARE * this.defaultWindow[1];
    const bright = depths.values.filter((_, n) => whole.values[n] >= threshold).sort();
    if (!bright.length) return;
    const [first, last] = [0.01, 0.99].map((share) => bright[Math.round(share * (bright.length - 1))]);
    this.depths = [first, Math.max(last, first + this.source.spacing[2])];
  }
}
