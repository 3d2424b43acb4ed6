// @ts-check
/** Measurements in a plane: profile and width of a line, statistics of a region, contrast, correlation.
 *
 * A plane contains `values` (na × nb, the second axis runs fastest), `origin` (centre of the first voxel) and
 * `spacing` (mm) along its axes a and b.
 *
 * @typedef {[number, number]} Pair
 * @typedef {{values: Float32Array | Float64Array, shape: Pair, origin: Pair, spacing: Pair}} Plane
 * @typedef {{distances: Float64Array, values: Float64Array}} Profile
 * @typedef {{width: number, error: number | null, centre: number, height: number, base: number,
 *            left: number, right: number}} Width
 * @typedef {{from: Pair, to: Pair}} Rectangle
 * @typedef {{count: number, mean: number, deviation: number, least: number, greatest: number, area: number}} Statistics
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

/** @param {ArrayLike<number>} values */
export function median(values) {
  const sorted = Float64Array.from(values).sort();
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

/** Compute the full width at half maximum of the highest peak above the base.
 *
 * The base is the median of the samples further than one width from the peak, or 0 without such samples. Their scatter
 * (1.48 times the median deviation) is the noise. The error propagates the noise over the slopes of the profile: of each
 * crossing independently, and of the peak's height for both.
 *
 * @param {Profile} profile
 * @returns {Width | null}  null if the profile does not fall to half on both sides; error null if there are too few
 *                          samples next to the peak to estimate the noise
 */
export function fwhm({ distances, values }) {
  if (values.length < 3) return null;
  let top = 0;
  for (let n = 1; n < values.length; n++) if (values[n] > values[top]) top = n;
  let baseline = /** @type {number[]} */ ([]);
  let base = 0;
  let halfWidth = crossings(distances, values, top, base);
  for (let iteration = 0; iteration < 3 && halfWidth; iteration++) {
    const { left, right } = halfWidth;
    const span = right - left;
    baseline = [...values].filter((_, n) => distances[n] < left - span || distances[n] > right + span);
    if (baseline.length < 8) break;
    base = median(baseline);
    halfWidth = crossings(distances, values, top, base);
  }
  if (!halfWidth) return null;
  const { left, right, rise, fall } = halfWidth;
  const height = values[top] - base;
  let error = null;
  if (baseline.length >= 8) {
    const noise = 1.4826 * median(baseline.map((value) => Math.abs(value - base)));
    error = noise * Math.hypot(1 / rise, 1 / fall, 0.5 * (1 / rise + 1 / fall));
  }
  return { width: right - left, error, centre: (left + right) / 2, height, base, left, right };
}

/** Find the half-maximum crossings of a peak and their slopes.
 *
 * @param {Float64Array} distances
 * @param {Float64Array} values
 * @param {number} top
 * @param {number} base
 */
function crossings(distances, values, top, base) {
  const half = (values[top] + base) / 2;
  if (!(values[top] > base)) return null;
  const places = [-1, 1].map((direction) => {
    for (let n = top; n + direction >= 0 && n + direction < values.length; n += direction) {
      if (values[n + direction] > half) continue;
      const share = (values[n] - half) / (values[n] - values[n + direction]);
      const slope = Math.abs((values[n + direction] - values[n]) / (distances[n + direction] - distances[n]));
      return { at: distances[n] + share * (distances[n + direction] - distances[n]), slope };
    }
    return null;
  });
  const [one, other] = places;
  return one && other ? { left: one.at, right: other.at, rise: one.slope, fall: other.slope } : null;
}

/** Compute statistics of the voxels whose centres lie in a rectangle.
 *
 * @param {Plane} plane
 * @param {Rectangle} rectangle  two opposite corners in mm
 * @returns {Statistics | null}  deviation of the population, area in mm²; null where no voxel lies in it
 */
export function statistics(plane, { from, to }) {
  const ranges = [0, 1].map((axis) => {
    const low = (Math.min(from[axis], to[axis]) - plane.origin[axis]) / plane.spacing[axis];
    const high = (Math.max(from[axis], to[axis]) - plane.origin[axis]) / plane.spacing[axis];
    return [Math.max(0, Math.ceil(low - 1e-9)), Math.min(plane.shape[axis] - 1, Math.floor(high + 1e-9))];
  });
  let [count, sum, least, greatest] = [0, 0, Infinity, -Infinity];
  /** @param {(value: number) => void} visit */
  const each = (visit) => {
    for (let i = ranges[0][0]; i <= ranges[0][1]; i++) {
      for (let j = ranges[1][0]; j <= ranges[1][1]; j++) visit(plane.values[i * plane.shape[1] + j]);
    }
  };
  each((value) => {
    count += 1;
    sum += value;
    least = Math.min(least, value);
    greatest = Math.max(greatest, value);
  });
  if (!count) return null;
  const mean = sum / count;
  let squares = 0; // a second pass keeps the precision of small deviations
  each((value) => { squares += (value - mean) ** 2; });
  const area = count * plane.spacing[0] * plane.spacing[1];
  return { count, mean, deviation: Math.sqrt(squares / count), least, greatest, area };
}

/** Compute (mean inside − mean outside) / background deviation, as the service does.
 *
 * @param {Statistics} inside
 * @param {Statistics} outside
 */
export function contrastToNoise(inside, outside) {
  const difference = inside.mean - outside.mean;
  if (outside.deviation) return difference / outside.deviation;
  return difference ? Math.sign(difference) * Infinity : 0;
}

/** Compute the Pearson correlation of two planes of equal shape; NaN if one of them is constant.
 *
 * @param {ArrayLike<number>} one
 * @param {ArrayLike<number>} other
 */
export function correlation(one, other) {
  let [a, b] = [0, 0];
  for (let n = 0; n < one.length; n++) {
    a += one[n] / one.length;
    b += other[n] / one.length;
  }
  let [ab, aa, bb] = [0, 0, 0];
  for (let n = 0; n < one.length; n++) {
    ab += (one[n] - a) * (other[n] - b);
    aa += (one[n] - a) ** 2;
    bb += (other[n] - b) ** 2;
  }
  return ab / Math.sqrt(aa * bb);
}
