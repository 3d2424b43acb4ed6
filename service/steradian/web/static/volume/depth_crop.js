// @ts-check
// Crop in depth: the range in which a volume has signal, from its projection along y.
import { firstVoxelBelow, voxelPosition } from "./volume_data.js";

/** @typedef {import("./volume_data.js").Source} Source */
/** @typedef {import("./measurements.js").Plane} Plane */

const SIGNAL_SHARE = 0.1; // of the end of the colour scale, from which a depth has signal
const OVER_MEDIAN = 2.4; // times the median at a depth: maxima of noise alone are closer to it
const LAYER_SHARE = 0.3; // of the end of the colour scale, at which the median itself is signal
const MARGIN_SHARE = 0.12; // of the range, on either side
const MIN_SHARE = 0.25; // of the lateral extent: shortest range
const WHOLE_SHARE = 0.85; // of the volume's depth, from which all of it is shown

/** Return the depths (mm) between which a volume has signal, with a margin; null: nearly all, or none.
 *
 * @param {Source} source
 * @param {Plane} plane  maxima along y: x horizontally, depth vertically
 * @param {number} end  of the colour scale
 * @param {number} cut  depth (mm) above which nothing counts
 * @returns {[number, number] | null}
 */
export function signalDepths(source, { values, shape: [nx, nz] }, end, cut) {
  if (nz !== source.shape[2]) return null; // reduced in size
  let [first, last] = [nz, -1];
  for (let k = firstVoxelBelow(source, cut); k < nz; k++) {
    const row = Float32Array.from({ length: nx }, (_, i) => values[i * nz + k]).filter(Number.isFinite).sort(); // a map has voxels without a value
    const [median, greatest] = [row[row.length >> 1] ?? 0, row[row.length - 1] ?? 0];
    if (greatest < SIGNAL_SHARE * end || (greatest < OVER_MEDIAN * median && median < LAYER_SHARE * end)) continue;
    first = Math.min(first, k);
    last = k;
  }
  if (last < first) return null;
  const half = source.spacing[2] / 2;
  const ends = [voxelPosition(source, "z", firstVoxelBelow(source, cut)) - half, voxelPosition(source, "z", nz - 1) + half];
  let [from, to] = [voxelPosition(source, "z", first) - half, voxelPosition(source, "z", last) + half];
  const lateral = Math.max(source.shape[0] * source.spacing[0], source.flat ? 0 : source.shape[1] * source.spacing[1]);
  const margin = Math.max(MARGIN_SHARE * (to - from), (MIN_SHARE * lateral - (to - from)) / 2);
  [from, to] = [Math.max(from - margin, ends[0]), Math.min(to + margin, ends[1])];
  return to - from > WHOLE_SHARE * (ends[1] - ends[0]) ? null : [from, to];
}
