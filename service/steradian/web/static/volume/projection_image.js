// @ts-check
// Drawing of projections on a canvas, from values of 0 to 255 as the service sends them.
import { colourTable, paint } from "./colours.js";
import { lengthOf, roundDown } from "./scale.js";

const BAR_SHARE = 0.4; // largest length of the scale bar, relative to the thumbnail

/** Value of full brightness in a thumbnail, of 255. */
export const WHITE_LEVEL = 190;

/** @typedef {{values: Uint8Array, shape: [number, number]}} Plane values [x, y], or [x, z] along y; see {@link paint} */

/** Return the numbers of a header of an answer. @param {Headers} headers @param {string} name @param {string} none text if it is missing @returns {number[]} */
export const numbersOf = (headers, name, none = "") => (headers.get(name) ?? none).split(",").map(Number);

/** Set the scale bar of a square thumbnail, into which its image fits. @param {HTMLElement | null} bar @param {Headers} headers of the answer */
export function showScaleBar(bar, headers) {
  const [[nx, ny], [dx, dy]] = [numbersOf(headers, "X-Shape"), numbersOf(headers, "X-Spacing")];
  const side = 1e3 * Math.max(nx * dx, ny * dy);
  if (!bar || !(side > 0)) return;
  const length = roundDown(BAR_SHARE * side);
  bar.textContent = lengthOf(length);
  bar.style.width = `${(100 * length) / side}%`;
}

/** Return the projection in an answer. @param {Response} answer @returns {Promise<Plane>} */
export async function readProjection(answer) {
  const values = new Uint8Array(await answer.arrayBuffer());
  return { values, shape: /** @type {[number, number]} */ (numbersOf(answer.headers, "X-Shape")) };
}

/**
 * Draw a projection with one pixel a value; along z, y points up, else z down.
 * @param {HTMLCanvasElement} canvas @param {Plane} plane @param {string | undefined} axis x, y or z
 * @param {[number, number]} [window] values of the darkest and the brightest colour
 */
export function drawProjection(canvas, plane, axis, window = [0, 255]) {
  const [width, height] = plane.shape;
  const pixels = new ImageData(width, height);
  paint(plane, window, colourTable("inferno"), { up: axis === "z", out: new Uint32Array(pixels.data.buffer) });
  Object.assign(canvas, { width, height });
  canvas.getContext("2d")?.putImageData(pixels, 0, 0);
}
