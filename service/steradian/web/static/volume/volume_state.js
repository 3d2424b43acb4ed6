// @ts-check
// State shared by all views of a volume: crosshair, scale, window and colours.
import { volumeName } from "../reconstructions/volume_names.js";
import { figure, pressure } from "../units.js";
import { AXES, PLANES, axisIndex, findBrightest, fetchDepths, firstVoxelBelow, fetchPlane, slabRange } from "./volume_data.js";
import { isDiverging } from "./colours.js";
import { signalDepths } from "./depth_crop.js";
import { transferTable } from "./transfer.js";

/** @typedef {import("./volume_data.js").Source} Source */
/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {import("./measurements.js").Plane} Plane */

const COLOUR_PERCENTILE = 0.999; // percentile of a projection at which the colour scale ends, as in the service's images
const MIN_END_SHARE = 0.5; // minimum end of the colour scale, relative to the maximum
const BRIGHT_SHARE = 0.5; // relative brightness above which depths determine the hue range
const [MARGIN, LARGE_MARGIN] = [0.94, 0.985]; // share of a view that its image fills

/** Return the automatic end of the colour scale. @param {ArrayLike<number>} sorted the values of a projection */
export function colourEnd(sorted) {
  const last = sorted.length - 1;
  return Math.max(sorted[Math.floor(COLOUR_PERCENTILE * last)], MIN_END_SHARE * sorted[last]);
}

export class VolumeState {
  /**
   * @param {Source} source @param {import("./view_store.js").ViewStore} store
   * @param {[number, number][] | null} windows colour scale of each volume of a series; null: found from the values
   * @param {any} reconstruction of the API; null: the volume has no name and is an image
   */
  constructor(source, store, windows = null, reconstruction = null) {
    this.source = source;
    this.store = store;
    this.windows = windows;
    this.reconstruction = reconstruction;
    if (source.index !== null) store.on((view, changed) => changed.has("index") && this.select(view.index)); // before the views read
    /** @type {Source | null} reference volume */
    this.reference = null;
    /** @type {any} reference of the API */
    this.referenceView = null;
    /** @type {number | null} index of the reference that does not follow this series */
    this.referenceIndex = null;
    /** @type {[number, number] | null} depths (mm) that are shown unless the view says so; null: all */
    this.defaultDepths = null;
    /** @type {Triple} initial crosshair */
    this.defaultPosition = /** @type {Triple} */ (AXES.map((axis) => (this.ends(axis)[0] + this.ends(axis)[1]) / 2));
    /** @type {[number, number]} */
    this.defaultWindow = this.fixedWindow ?? [0, source.peak || 1];
    /** @type {[number, number]} mm, at the ends of the hues */
    this.depths = [0, 1];
    this.projectedEnd = this.defaultWindow[1]; // end of the colour scale found from the values of this volume
    this.maxValue = source.peak || 1;
    this.minValue = 0;
    /** @type {{axis: Axis, width: number, height: number}[]} CSS pixels of each slice view */
    this.sizes = [];
    /** @type {Map<Axis, number>} end of the difference scale of each view */
    this.differenceEnds = new Map();
    /** @type {import("./measurement_store.js").MeasurementStore | null} measurements that the views show */
    this.measurements = null;
    /** @type {(tool: "line" | "region" | "background") => void} called when a mark has been drawn */
    this.onMark = () => undefined;
    /** @type {Plane | null} projection of everything below the near field along z (line scans: y) */
    this.whole = null;
  }

  get view() {
    return this.store.view;
  }

  /** Show another volume of a series. @param {number} index */
  select(index) {
    this.source = { ...this.source, index: this.windows ? Math.min(index, this.windows.length - 1) : index };
    this.defaultWindow = this.fixedWindow ?? this.defaultWindow;
    this.setReference(this.reference);
  }

  /**
   * Compare with a volume; of a series with the one of a fixed index, else, if it is as long as this one, that of the same index, else the first.
   * @param {Source | null} reference @param {any} [reconstruction] of the API @param {number | null} [fixed]
   */
  setReference(reference, reconstruction = this.referenceView, fixed = this.referenceIndex) {
    this.referenceView = reconstruction;
    this.referenceIndex = fixed;
    const same = reference && reference.index !== null && reference.volumes === this.source.volumes ? this.source.index : 0;
    const index = fixed === null ? same : Math.min(fixed, (reference?.volumes ?? 1) - 1);
    this.reference = reference && { ...reference, index: reference.index === null ? null : index };
  }

  /** Wavelength, frame and time of the reference, with its short identifier if it is of another reconstruction. */
  get referenceName() {
    const { reference } = this;
    const name = reference ? volumeName(this.referenceView, reference.index) : "";
    return !reference ? "" : reference.id === this.source.id ? name : [name, `…${reference.id.slice(-5)}`].filter(Boolean).join(", ");
  }

  /** Whether the reference is laid over the image. */
  get isOverlay() {
    return this.reference !== null && this.view.how === "overlay";
  }

  /** Values at the ends of the reference's colours where it is laid over the image. @returns {[number, number]} */
  get overlayWindow() {
    const { reference } = this;
    const name = this.referenceView?.report?.frames?.[reference?.index ?? 0]?.name;
    return this.view.overlayWindow ?? [0, name?.startsWith("saturation") ? 1 : reference?.peak || this.defaultWindow[1]];
  }

  /** Colours of the reference where it is laid over the image. */
  get overlayColours() {
    return transferTable(/** @type {import("./colours.js").MapName} */ (this.view.overlayMap), this.view);
  }

  /** Whether the values are those of an unmixing, without the unit of an image. */
  get isMaps() {
    return this.reconstruction?.kind === "unmixing";
  }

  /** Wavelength, frame and time of the volume; empty if there is only one. */
  get nameText() {
    return this.reconstruction ? volumeName(this.reconstruction, this.source.index) : "";
  }

  /** Format a value with its unit. @param {number} value @param {number} [digits] */
  valueText(value, digits = 3) {
    return this.isMaps ? figure(value, digits) : pressure(value, digits);
  }

  /** Colour scale that is set for the volume; null: it is found from the values. */
  get fixedWindow() {
    return this.windows?.[this.source.index ?? 0] ?? null;
  }

  /** Name of the enlarged view; null: all are shown. */
  get large() {
    const { large } = this.view;
    return this.source.flat && large !== "y" ? null : large; // an image of a line has one view
  }

  /** Depth (mm) above which the near field is hidden. */
  get cut() {
    return this.view.cut ?? this.source.near;
  }

  /** Position of the crosshair (mm). */
  get position() {
    return this.view.at ?? this.defaultPosition;
  }

  /** Values at the ends of the colour scale; of a map with a zero in its middle, symmetrical unless the view says so. @returns {[number, number]} */
  get window() {
    const [low, high] = this.defaultWindow;
    return this.view.window ?? (isDiverging(this.view.map) ? [-high, high] : [low, high]);
  }

  /** Whether the voxel grids of image and reference are equal. */
  get isComparable() {
    const { source, reference } = this;
    const isClose = (/** @type {number} */ one, /** @type {number} */ other) => Math.abs(one - other) < 1e-6;
    return reference !== null && source.shape.every((count, n) => count === reference.shape[n] && isClose(source.spacing[n], reference.spacing[n]) && isClose(source.origin[n], reference.origin[n]));
  }

  /** @param {Axis} axis @param {Float32Array | Float64Array} differences absolute values in a view */
  setDifference(axis, differences) {
    const finite = differences.filter(Number.isFinite).sort();
    this.differenceEnds.set(axis, finite.length ? colourEnd(finite) : 0);
    this.store.notify(["difference"]);
  }

  /** End of the difference scale, adjusted by the window. */
  get differenceEnd() {
    return Math.max(...this.differenceEnds.values(), 0) * (this.window[1] / this.defaultWindow[1]) || 1;
  }

  get isDepthMap() {
    return this.view.map === "depth" && !this.source.flat;
  }

  /** Colour map: an image of a line has no depth map. @returns {import("./colours.js").MapName} */
  get mapName() {
    return /** @type {import("./colours.js").MapName} */ (this.view.map === "depth" && !this.isDepthMap ? "grey" : this.view.map);
  }

  /** Colours over the window. */
  get colours() {
    return transferTable(this.isDepthMap ? "grey" : this.mapName, this.view);
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

  /** Return the ends (mm) of what is shown along an axis: the volume, cropped in depth. @param {Axis} axis @returns {[number, number]} */
  shownEnds(axis) {
    const [first, last] = this.ends(axis);
    const [from, to] = (axis === "z" && (this.view.depth ?? this.defaultDepths)) || [first, last];
    return from < last && to > first ? [Math.max(from, first), Math.min(to, last)] : [first, last];
  }

  /** @param {Axis} axis */
  shownExtent(axis) {
    const [first, last] = this.shownEnds(axis);
    return last - first;
  }

  /** Centre of every view (mm). @returns {Triple} */
  get centre() {
    return this.view.centre ?? /** @type {Triple} */ (AXES.map((axis) => (this.shownEnds(axis)[0] + this.shownEnds(axis)[1]) / 2));
  }

  /** Return the ends (mm) along an axis of the part that all views across which it runs show. @param {Axis} axis @returns {[number, number]} */
  visibleEnds(axis) {
    const [first, last] = this.shownEnds(axis);
    const middle = this.centre[axisIndex(axis)];
    const halves = this.sizes.flatMap(({ axis: across, width, height }) => {
      const n = PLANES[across].indexOf(axis);
      return n < 0 ? [] : [(n ? height : width) / 2 / this.scale];
    });
    const half = Math.min(...halves, Infinity);
    const [from, to] = [Math.max(first, middle - half), Math.min(last, middle + half)];
    return from < to ? [from, to] : [first, last];
  }

  /** Pixels per mm, equal in all visible slice views, so that their axes are aligned. */
  get scale() {
    const scales = this.sizes.map(({ axis, width, height }) => {
      const [across, up] = PLANES[axis];
      return Math.min(width / this.shownExtent(across), height / this.shownExtent(up));
    });
    return (scales.length ? Math.min(...scales) : 1) * (this.large ? LARGE_MARGIN : MARGIN) * this.view.zoom;
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
    const finite = values.filter(Number.isFinite); // maps of an unmixing have voxels without a value
    const sorted = (finite.length ? finite : new Float32Array(1)).sort();
    this.maxValue = sorted[sorted.length - 1];
    this.minValue = Math.min(0, sorted[0]);
    this.projectedEnd = colourEnd(sorted) || 1;
    this.defaultWindow = this.fixedWindow ?? [0, this.projectedEnd];
    this.defaultPosition = brightest;
    this.whole = whole;
    if (source.index === null || !this.defaultDepths) await this.cropDepths(); // the volumes of a series keep the first one's
  }

  /** Determine the depths that are shown by default. */
  async cropDepths() {
    const { source, cut } = this;
    const plane = await fetchPlane(source, "y", slabRange(source, "y", 0, Infinity, cut));
    this.defaultDepths = signalDepths(source, plane, this.defaultWindow[1], cut);
    this.store.notify(["depth"]);
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
