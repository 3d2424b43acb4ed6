// @ts-check
// Depth of the maximum at a place of an image of which only the projections along the axes are known.

/** @typedef {{values: ArrayLike<number>, shape: number[], origin: number[], spacing: number[]}} Projection lengths in metres */

const LEAST_SHARE = 0.95; // of the value along z that a voxel at its depth has in the other projections
const NEIGHBOURS = [-1, 0, 1];

/**
 * Return the depth of the maximum along z at a place; null if no depth fits.
 *
 * The maximum has its value in the projection along z, and at least this value in the projections along x and y. Of the
 * depths at which both have a local maximum, that with the value closest to it is returned.
 * @param {{x: Projection, y: Projection, z: Projection}} projections along each axis: [y, z], [x, z] and [x, y]
 * @param {[number, number]} place x and y in metres
 */
export function depthAt(projections, place) {
  const [x, y] = brightestNear(projections.z, place);
  const value = valueAt(projections.z, x, y);
  const [, depths] = projections.y.shape;
  const depthOf = (/** @type {number} */ k) => projections.y.origin[1] + k * projections.y.spacing[1];
  const both = Array.from({ length: depths }, (_, k) => Math.min(valueAt(projections.y, x, depthOf(k)), valueAt(projections.x, y, depthOf(k))));
  let best = -1;
  for (let k = 0; k < depths; k++) {
    const isMaximum = both[k] >= (both[k - 1] ?? -Infinity) && both[k] >= (both[k + 1] ?? -Infinity);
    if (!isMaximum || both[k] < LEAST_SHARE * value) continue;
    if (best < 0 || Math.abs(both[k] - value) < Math.abs(both[best] - value)) best = k;
  }
  return best < 0 || !(value > 0) ? null : depthOf(best);
}

/** Return the brightest of the voxels around a place. @param {Projection} image @param {[number, number]} place @returns {[number, number]} */
function brightestNear(image, [x, y]) {
  const around = NEIGHBOURS.flatMap((i) => NEIGHBOURS.map((j) => /** @type {[number, number]} */ ([x + i * image.spacing[0], y + j * image.spacing[1]])));
  return around.reduce((best, one) => (valueAt(image, ...one) > valueAt(image, ...best) ? one : best), around[4]);
}

/** Return the value of the voxel nearest to a place. @param {Projection} image @param {number} a @param {number} b */
function valueAt({ values, shape, origin, spacing }, a, b) {
  const [i, j] = [a, b].map((one, n) => Math.min(Math.max(Math.round((one - origin[n]) / spacing[n]), 0), shape[n] - 1));
  return values[i * shape[1] + j];
}
