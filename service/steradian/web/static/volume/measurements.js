// @ts-check
/** Values of a plane for display: interpolation, profile of a line, correlation; the service measures.
 *
 * A plane contains `values` (na × nb, the second axis runs fastest), `origin` (centre of the first voxel) and
 * `spacing` (mm) along its axes a and b.
 *
 * @typedef {[number, number]} Pair
 * @typedef {{values: Float32Array | Float64Array, shape: Pair, origin: Pair, spacing: Pair}} Plane
 * @typedef {{distances: Float64Array, values: Float64Array}} Profile
 */

const MAX_SAMPLES = 4096;

/** Return the weights of cubic convolution (R. Keys, 1981), which preserves height and width of narrow peaks and is
 * exact for parabolas.
 *
 * @param {number} t  place between the second and the third, 0 to 1
 * @returns {[number, number, number, number]}
 */
function cubicWeights(t) {
  return [
    t * (-0.5 + t * (1 - 0.5 * t)),
    1 + t * t * (1.5 * t - 2.5),
    t * (0.5 + t * (2 - 1.5 * t)),
    t * t * (0.5 * t - 0.5),
  ];
}

/** Interpolate the value at a position in mm; NaN outside the outermost voxel centres.
 *
 * @param {Plane} plane
 * @param {number} a
 * @param {number} b
 */
export function sample(plane, a, b) {
  const [na, nb] = plane.shape;
  const i = (a - plane.origin[0]) / plane.spacing[0];
  const j = (b - plane.origin[1]) / plane.spacing[1];
  const tolerance = 1e-6; // rounding error of a position on the outermost centre
  if (!(i >= -tolerance && j >= -tolerance && i <= na - 1 + tolerance && j <= nb - 1 + tolerance)) return NaN;
  const i0 = Math.min(Math.max(Math.floor(i), 0), Math.max(na - 2, 0));
  const j0 = Math.min(Math.max(Math.floor(j), 0), Math.max(nb - 2, 0));
  const u = cubicWeights(i - i0);
  const v = cubicWeights(j - j0);
  let sum = 0;
  for (let di = 0; di < 4; di++) {
    const row = Math.min(Math.max(i0 + di - 1, 0), na - 1) * nb;
    let along = 0;
    for (let dj = 0; dj < 4; dj++) along += v[dj] * plane.values[row + Math.min(Math.max(j0 + dj - 1, 0), nb - 1)];
    sum += u[di] * along;
  }
  return sum;
}

/** Sample values along a line, at most half the finer voxel apart; positions outside the plane are omitted.
 *
 * @param {Plane} plane
 * @param {Pair} from  mm
 * @param {Pair} to    mm
 * @returns {Profile}  distances in mm from `from`
 */
export function profile(plane, from, to) {
  const [da, db] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(da, db);
  const step = Math.min(plane.spacing[0], plane.spacing[1]) / 2;
  const count = Math.min(MAX_SAMPLES, Math.max(2, Math.ceil(length / step) + 1));
  const distances = [];
  const values = [];
  for (let n = 0; n < count; n++) {
    const share = n / (count - 1);
    const value = sample(plane, from[0] + share * da, from[1] + share * db);
    if (Number.isNaN(value)) continue;
    distances.push(share * length);
    values.push(value);
  }
  return { distances: Float64Array.from(distances), values: Float64Array.from(values) };
}

/** Compute the Pearson correlation of two planes of equal shape where both have values; NaN if one of them is constant.
 *
 * @param {ArrayLike<number>} one
 * @param {ArrayLike<number>} other
 */
export function correlation(one, other) {
  const hasValues = (/** @type {number} */ n) => Number.isFinite(one[n]) && Number.isFinite(other[n]);
  let [a, b, count] = [0, 0, 0];
  for (let n = 0; n < one.length; n++) {
    if (!hasValues(n)) continue;
    a += one[n];
    b += other[n];
    count += 1;
  }
  a /= count;
  b /= count;
  let [ab, aa, bb] = [0, 0, 0];
  for (let n = 0; n < one.length; n++) {
    if (!hasValues(n)) continue;
    ab += (one[n] - a) * (other[n] - b);
    aa += (one[n] - a) ** 2;
    bb += (other[n] - b) ** 2;
  }
  return ab / Math.sqrt(aa * bb);
}
