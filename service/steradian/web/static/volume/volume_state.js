// @ts-check
// State shared by all views of a volume: crosshair, scale, window and colours.
import { AXES, PLANES, axisIndex, findBrightest, fetchDepths, firstVoxelBelow, fetchPlane, slabRange } from "./volume_data.js";
import { colourTable } from "./colours.js";

/** @typedef {import("./volume_data.js").Source} Source */
/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {import("./measurements.js").Plane} Plane */

const COLOUR_PERCENTILE = 0.999; // percentile of a projection at which the colour scale ends, as in the service's images
const MIN_END_SHARE = 0.5; // minimum end of the colour scale, relative to the maximum
const BRIGHT_SHARE = 0.5; // relative brightness above which depths determine the hue range
const MARGIN = 0.94;

/** Return the automatic end of the colour scale. @param {ArrayLike<number>} sorted the values of a projection */
export function colourEnd(sorted) {
  const last = sorted.length - 1;
  return Math.max(sorted[Math.floor(COLOUR_PERCENTILE * last)], MIN_END_SHARE * sorted[last]);
}

export class VolumeState {
  /** @param {Source} source @param {import("./view_store.js").ViewStore} store */
  constructor(source, store) {
    this.source = source;
    this.store = store;
    /** @type {Source | null} reference volume */
    this.reference = null;
    /** @type {Triple} initial crosshair */
    this.defaultPosition = /** @type {Triple} */ (AXES.map((axis) => (this.ends(axis)[0] + this.ends(axis)[1]) / 2));
    /** @type {[number, number]} */
    this.defaultWindow = [0, source.peak || 1];
    /** @type {[number, number]} mm, at the ends of the hues */
    this.depths = [0, 1];
    this.maxValue = source.peak || 1;
    this.minValue = 0;
    /** @type {{axis: Axis, width: number, height: number}[]} CSS pixels of each slice view */
    this.sizes = [];
    /** @type {Map<Axis, number>} end of the difference scale of each view */
    this.differenceEnds = new Map();
    /** @type {Plane | null} projection of everything below the near field along z (line scans: y) */
    this.whole = null;
  }

  get view() {
    return this.store.view;
  }

  /** Depth (mm) above which the near field is hidden. */
  get cut() {
    return this.view.cut ?? this.source.near;
  }

  /** Position of the crosshair (mm). */
  get position() {
    return this.view.at ?? this.defaultPosition;
  }

  get window() {
    return this.view.window ?? this.defaultWindow;
  }

  /** Whether the voxel grids of image and reference are equal. */
  get isComparable() {
    const { source, reference } = this;
    const isClose = (/** @type {number} */ one, /** @type {number} */ other) => Math.abs(one - other) < 1e-6;
    return reference !== null && source.shape.every((count, n) => count === reference.shape[n] && isClose(source.spacing[n], reference.spacing[n]) && isClose(source.origin[n], reference.origin[n]));
  }

  /** @param {Axis} axis @param {Float32Array | Float64Array} differences absolute values in a view */
  setDifference(axis, differences) {
    this.differenceEnds.set(axis, colourEnd(differences.sort()));
    this.store.notify(["difference"]);
  }

  /** End of the difference scale, adjusted by the window. */
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

  /** Return the extent (mm) along an axis, between outer edges. @param {Axis} axis */
  extent(axis) {
    return this.source.shape[axisIndex(axis)] * this.source.spacing[axisIndex(axis)];
  }

  /** Return the ends (mm) of the volume along an axis. @param {Axis} axis @returns {[number, number]} */
  ends(axis) {
    const n = axisIndex(axis);
    const first = this.source.origin[n] - this.source.spacing[n] / 2;
    return [first, first + this.extent(axis)];
  }

  /** Centre of every view (mm). @returns {Triple} */
  get centre() {
    if (this.view.centre) return this.view.centre;
    return /** @type {Triple} */ (AXES.map((axis) => (this.ends(axis)[0] + this.ends(axis)[1]) / 2));
  }

  /** Pixels per mm, equal in all slice views, so that their axes are aligned. */
  get scale() {
    const scales = this.sizes.map(({ axis, width, height }) => {
      const [across, up] = PLANES[axis];
      return Math.min(width / this.extent(across), height / this.extent(up));
    });
    return (scales.length ? Math.min(...scales) : 1) * MARGIN * this.view.zoom;
  }

  /** Return the voxels that a view across an axis shows. @param {Axis} axis */
  range(axis, source = this.source) {
    return slabRange(source, axis, this.position[axisIndex(axis)], this.view.slab[axisIndex(axis)], this.cut);
  }

  /** Read the projection of the volume; determine the brightest voxel and the automatic window. */
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

  /** Determine the depth range of the hues. */
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
