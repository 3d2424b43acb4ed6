// @ts-check
// Data access to a volume: slices, slabs and a low-resolution block; lengths in mm.
import { request } from "../api.js";

/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {import("./measurements.js").Plane} Plane */
/** @typedef {{from: number, to: number}} Range voxels along an axis, `to` not among them */
/**
 * Geometry of a volume; an image of a line scan has one voxel along y.
 * @typedef {{id: string, index: number | null, volumes: number, shape: Triple, origin: Triple, spacing: Triple, near: number, flat: boolean, peak: number | null}} Source
 *   index: which volume of a series; null: a single volume; volumes: how many a series has, else 0; peak: upper end of the colour scale of the service's image
 */

export const AXES = /** @type {const} */ (["x", "y", "z"]);
/** Axes of the plane across each axis, horizontal and vertical. @type {Record<Axis, [Axis, Axis]>} */
export const PLANES = { x: ["y", "z"], y: ["x", "z"], z: ["x", "y"] };
const BINARY = "application/octet-stream";
const MAX_CACHED_BYTES = 256e6;
const MAX_PLANE_SIDE = 2048; // along an axis of a plane
const MAX_BLOCK_VOXELS = 2 ** 23; // of the 3-D view, one byte each

/** @param {Axis} axis */
export const axisIndex = (axis) => AXES.indexOf(axis);

/**
 * Return the source of a successful reconstruction; null if its report contains no voxel positions.
 * @param {any} view of the API
 * @param {number} [index] which volume of a series
 * @returns {Source | null}
 */
export function createSource(view, index = 0) {
  const report = view.report ?? {};
  const volumes = report.frames?.length ?? 0;
  const { shape, spacing_m: spacing, origin_m: origin } = report;
  if (!shape || !spacing || !origin) return null;
  const flat = shape.length === 2;
  /** @param {number[]} values @param {number} none @returns {Triple} */
  const toTriple = (values, none) => (flat ? [values[0], none, values[1]] : [values[0], values[1], values[2]]);
  const inMm = (/** @type {number[]} */ values) => values.map((/** @type {number} */ value) => value * 1e3);
  return {
    id: view.id, index: volumes ? Math.min(index, volumes - 1) : null, volumes, flat, shape: toTriple(shape, 1), spacing: toTriple(inMm(spacing), 1), origin: toTriple(inMm(origin), 0),
    near: (report.near_field_m ?? 0) * 1e3, peak: isLinear(view.parameters?.display) ? report.scale_ends?.[flat ? "y" : "z"] ?? null : null,
  };
}

/** Return whether images show the values on a linear scale. @param {any} display */
const isLinear = (display) => !display?.log_range_db && !display?.envelope && !display?.gain_db_per_mm;

/** Return the voxel whose centre is nearest to a position. @param {Source} source @param {Axis} axis @param {number} mm */
export function voxelIndex(source, axis, mm) {
  const n = axisIndex(axis);
  return Math.min(Math.max(Math.round((mm - source.origin[n]) / source.spacing[n]), 0), source.shape[n] - 1);
}

/** @param {Source} source @param {Axis} axis @param {number} index */
export function voxelPosition(source, axis, index) {
  const n = axisIndex(axis);
  return source.origin[n] + index * source.spacing[n];
}

/** Return the first voxel at or below a depth. @param {Pick<Source, "shape" | "origin" | "spacing">} source @param {number} cut */
export function firstVoxelBelow(source, cut) {
  const first = Math.ceil((cut - source.origin[2]) / source.spacing[2] - 1e-6);
  return Math.min(Math.max(first, 0), source.shape[2] - 1);
}

/**
 * Return the voxels of a slab around a position, without the near field.
 * @param {Source} source @param {Axis} axis @param {number} mm @param {number} thickness @param {number} cut
 * @returns {Range}
 */
export function slabRange(source, axis, mm, thickness, cut) {
  const n = axisIndex(axis);
  const minIndex = axis === "z" ? firstVoxelBelow(source, cut) : 0;
  if (thickness === Infinity) return { from: minIndex, to: source.shape[n] };
  const half = Math.max(0, (thickness / source.spacing[n] - 1) / 2);
  const middle = (mm - source.origin[n]) / source.spacing[n];
  const from = Math.min(Math.max(Math.round(middle - half), thickness === 0 ? 0 : minIndex), source.shape[n] - 1);
  return { from, to: Math.min(Math.max(Math.round(middle + half), from), source.shape[n] - 1) + 1 };
}

/** Return the positions (mm) of the outer edges of a range of voxels. @param {Source} source @param {Axis} axis @param {Range} range @returns {[number, number]} */
export function rangeEnds(source, axis, { from, to }) {
  const half = source.spacing[axisIndex(axis)] / 2;
  return [voxelPosition(source, axis, from) - half, voxelPosition(source, axis, to - 1) + half];
}

/** Return the depths (mm) that a projection along z covers: those below the near field. @param {Source} source */
export const projectedDepths = (source) => rangeEnds(source, "z", slabRange(source, "z", 0, Infinity, source.near));

/** Return the query that selects a volume of a series. @param {Pick<Source, "index">} source */
const indexQuery = ({ index }) => (index === null ? {} : { index });

/**
 * Fetch an array with its axes.
 * @param {Source} source @param {"volume" | "mip"} part @param {Record<string, string | number>} query @param {AbortSignal} [signal]
 */
async function fetchArray(source, part, query, signal) {
  const searchParams = new URLSearchParams(Object.entries({ dtype: "float32", ...indexQuery(source), ...query }).map(([name, one]) => [name, String(one)]));
  const answer = await request("GET", `/reconstructions/${source.id}/${part}?${searchParams}`, undefined, { accept: BINARY, signal });
  const list = (/** @type {string} */ name) => (answer.headers.get(name) ?? "").split(",").map(Number);
  const body = await answer.arrayBuffer();
  return {
    values: query.dtype === "uint8" ? new Uint8Array(body) : new Float32Array(body),
    window: list("X-Window"),
    shape: list("X-Shape"),
    origin: list("X-Origin").map((metres) => metres * 1e3),
    spacing: list("X-Spacing").map((metres) => metres * 1e3),
  };
}

/** @param {{values: Float32Array | Uint8Array, shape: number[], origin: number[], spacing: number[]}} found @returns {Plane} */
function toPlane({ values, shape, origin, spacing }) {
  const two = (/** @type {number[]} */ line) => /** @type {[number, number]} */ ([line[0], line[1]]);
  return { values: /** @type {Float32Array} */ (values), shape: two(shape), origin: two(origin), spacing: two(spacing) };
}

/** @type {Map<string, Plane>} least recently used first */
const planeCache = new Map();
let cachedBytes = 0;

/** Planes that playback has read and must find again in its next round. @type {Set<string> | null} */
let playedPlanes = null;

/**
 * Keep the planes that are read from now on until playback stops: a loop longer than the cache finds its first part again,
 * where removal of the least recently used would leave nothing.
 * @param {boolean} isPlaying
 */
export function keepPlayedPlanes(isPlaying) {
  playedPlanes = isPlaying ? new Set() : null;
}

/** @param {string} name @param {Plane} plane */
function cache(name, plane) {
  if (planeCache.delete(name)) cachedBytes -= plane.values.byteLength;
  for (const [oldest, { values }] of planeCache) {
    if (cachedBytes + plane.values.byteLength <= MAX_CACHED_BYTES) break;
    if (playedPlanes?.has(oldest)) continue;
    planeCache.delete(oldest);
    cachedBytes -= values.byteLength;
  }
  if (cachedBytes + plane.values.byteLength > MAX_CACHED_BYTES) return;
  planeCache.set(name, plane);
  cachedBytes += plane.values.byteLength;
  playedPlanes?.add(name);
}

/** Running requests by name; further callers wait for the same request. @type {Map<string, Promise<Plane>>} */
const pendingPlanes = new Map();

/** @param {string} name @param {() => Promise<Plane>} read @param {AbortSignal} [signal] requests with a signal are not shared */
async function cachedPlane(name, read, signal) {
  const known = planeCache.get(name) ?? pendingPlanes.get(name);
  const promise = known ?? read();
  if (!signal && !known) pendingPlanes.set(name, /** @type {Promise<Plane>} */ (promise));
  try {
    const plane = await promise;
    cache(name, planeCache.get(name) ?? plane); // two requests may have read it
    return plane;
  } finally {
    if (!signal && !known) pendingPlanes.delete(name);
  }
}

/**
 * Fetch the plane across an axis: a slice, or the maximum of a slab.
 * @param {Source} source @param {Axis} axis @param {Range} range @param {AbortSignal} [signal]
 * @returns {Promise<Plane>}
 */
export function fetchPlane(source, axis, { from, to }, signal) {
  return cachedPlane(`${source.id} ${source.index} ${axis} ${from}:${to}`, async () => {
    if (source.flat) return toPlane(await fetchArray(source, "volume", {}, signal));
    if (to - from > 1) {
      const slab = to - from < source.shape[axisIndex(axis)] ? { slab: `${from}:${to}` } : null; // the file contains the full projection
      return toPlane(await fetchArray(source, "mip", { axis, ...slab, max_size: MAX_PLANE_SIDE }, signal));
    }
    const parts = AXES.map((one) => (one === axis ? String(from) : ":"));
    return toPlane(await fetchArray(source, "volume", { slice: parts.join(",") }, signal));
  }, signal);
}

/** Fetch the depths (mm) of the maxima along z. @param {Source} source @param {Range} range @param {AbortSignal} [signal] */
export function fetchDepths(source, { from, to }, signal) {
  return cachedPlane(`${source.id} ${source.index} depth ${from}:${to}`, async () => {
    const plane = toPlane(await fetchArray(source, "mip", { axis: "depth", slab: `${from}:${to}`, max_size: MAX_PLANE_SIDE }, signal));
    return { ...plane, values: plane.values.map((metres) => metres * 1e3) };
  }, signal);
}

/**
 * Fetch a low-resolution copy for the 3-D view in bytes; `window` contains the values of 0 and 255.
 * @param {Source} source @param {number} peak the value of 255
 */
export async function fetchBlock(source, peak) {
  let blockShape = source.shape;
  while (blockShape[0] * blockShape[1] * blockShape[2] > MAX_BLOCK_VOXELS) blockShape = /** @type {Triple} */ (blockShape.map((side) => Math.ceil(side / 2)));
  const response = await fetchArray(source, "volume", { dtype: "uint8", window: `0,${peak > 0 ? peak : 1}`, max_size: Math.max(...blockShape) });
  return /** @type {import("./raycast.js").Block & {window: [number, number], values: Uint8Array}} */ (/** @type {unknown} */ (response));
}

/**
 * Find the brightest voxel below a depth from the projections at full resolution.
 * @param {Source} source @param {number} cut @param {AbortSignal} [signal]
 * @returns {Promise<Triple>} mm
 */
export async function findBrightest(source, cut, signal) {
  const along = source.flat ? "y" : "z";
  const plane = await fetchPlane(source, along, slabRange(source, along, 0, Infinity, cut), signal);
  if (source.flat) {
    const peak = maxOfPlane(plane, firstVoxelBelow(source, cut));
    return [voxelPosition(source, "x", peak.i), 0, voxelPosition(source, "z", peak.j)];
  }
  const { i, j } = maxOfPlane(plane, 0);
  const [x, y] = [plane.origin[0] + i * plane.spacing[0], plane.origin[1] + j * plane.spacing[1]];
  const slice = `${voxelIndex(source, "x", x)},${voxelIndex(source, "y", y)},:`;
  const { values } = await fetchArray(source, "volume", { slice }, signal);
  let peak = firstVoxelBelow(source, cut);
  let greatest = -Infinity;
  for (let n = peak; n < values.length; n++) {
    if (!Number.isFinite(values[n]) || values[n] <= greatest) continue; // maps have voxels without a value
    greatest = values[n];
    peak = n;
  }
  return [x, y, voxelPosition(source, "z", peak)];
}

/** @param {Plane} plane @param {number} first along its second axis */
function maxOfPlane({ values, shape: [na, nb] }, first) {
  const peak = { i: 0, j: first, value: -Infinity };
  for (let i = 0; i < na; i++) {
    for (let j = first; j < nb; j++) {
      if (Number.isFinite(values[i * nb + j]) && values[i * nb + j] > peak.value) Object.assign(peak, { i, j, value: values[i * nb + j] });
    }
  }
  return peak;
}
