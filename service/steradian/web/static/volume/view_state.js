// @ts-check
/** A view as a whole, and the fragment of an address that says it: what is not said is as it is by itself.
 *
 * Lengths are in mm. `slab` is the thickness over which a view shows its maximum: 0 a slice, Infinity everything.
 *
 * @typedef {"x" | "y" | "z"} Axis
 * @typedef {[number, number, number]} Triple
 * @typedef {{plane: Axis, from: [number, number], to: [number, number]}} Mark  in the plane across an axis
 * @typedef {{
 *   at: Triple | null, slab: Triple, window: [number, number] | null, map: string, cut: number | null,
 *   centre: Triple | null, zoom: number, camera: Triple,
 *   clip: [number, number, number, number, number, number] | null,
 *   line: Mark | null, region: Mark | null, background: Mark | null, points: Triple[],
 *   against: string | null, how: string, tool: string,
 * }} View
 */

import { PRESSURE_MAPS } from "./colours.js";

const MAPS = /** @type {readonly string[]} */ (PRESSURE_MAPS);
export const TOOLS = ["crosshair", "line", "region", "background", "point"];
export const MOST_POINTS = 8;
export const WAYS = ["difference", "blink"];
const MOST_ZOOM = 64;

/** @returns {View} */
export function fresh() {
  return {
    at: null, slab: [Infinity, Infinity, Infinity], window: null, map: "inferno", cut: null,
    centre: null, zoom: 1, camera: [-35, 25, 1], clip: null, line: null, region: null, background: null,
    points: [], against: null, how: "difference", tool: "crosshair",
  };
}

/** @param {number} value */
function written(value) {
  return value === Infinity ? "all" : String(Number(value.toPrecision(6)));
}

/** @param {string} text */
function read(text) {
  return text === "all" ? Infinity : /^-?[0-9]+(\.[0-9]*)?(e[-+]?[0-9]{1,2})?$/i.test(text) ? Number(text) : NaN;
}

/** @param {readonly number[]} values */
const list = (values) => values.map(written).join(",");

/** Numbers of a text; null unless there are so many that all pass.
 *
 * @param {string} text
 * @param {number} count
 * @param {(value: number) => boolean} fits
 * @returns {any}
 */
function numbers(text, count, fits = Number.isFinite) {
  const values = text.split(",").map(read);
  return values.length === count && values.every(fits) ? values : null;
}

/** @param {Mark} mark */
const mark = ({ plane, from, to }) => `${plane},${list([...from, ...to])}`;

/** @param {string} text  @returns {Mark | null} */
function markOf(text) {
  const [plane, ...rest] = text.split(",");
  const ends = numbers(rest.join(","), 4);
  if (!ends || !["x", "y", "z"].includes(plane)) return null;
  return { plane: /** @type {Axis} */ (plane), from: [ends[0], ends[1]], to: [ends[2], ends[3]] };
}

/** @param {readonly string[]} known */
const oneOf = (known) => (/** @type {string} */ text) => (known.includes(text) ? text : null);

/** @param {string} text  @returns {Triple[] | null} */
function pointsOf(text) {
  const found = text.split(";").map((one) => numbers(one, 3));
  return found.length <= MOST_POINTS && found.every((one) => one !== null) ? found : null;
}

/** How each part is written, and read; a part that cannot be read is as it is by itself.
 *
 * @type {{[name in keyof View]: {write: (value: any) => string, read: (text: string) => any}}}
 */
const PARTS = {
  at: { write: list, read: (text) => numbers(text, 3) },
  slab: { write: list, read: (text) => numbers(text, 3, (value) => value >= 0) },
  window: { write: list, read: (text) => pair(numbers(text, 2)) },
  map: { write: String, read: oneOf(MAPS) },
  cut: { write: written, read: (text) => numbers(text, 1, (value) => value >= 0 && value < 1e6)?.[0] ?? null },
  centre: { write: list, read: (text) => numbers(text, 3) },
  zoom: { write: written, read: (text) => numbers(text, 1, (value) => value >= 0.25 && value <= MOST_ZOOM)?.[0] ?? null },
  camera: { write: list, read: (text) => camera(numbers(text, 3)) },
  clip: { write: list, read: (text) => numbers(text, 6, (value) => value >= 0 && value <= 1) },
  line: { write: mark, read: markOf },
  region: { write: mark, read: markOf },
  background: { write: mark, read: markOf },
  points: { write: (/** @type {Triple[]} */ all) => all.map(list).join(";"), read: pointsOf },
  against: { write: String, read: (text) => (/^[A-Za-z0-9]{1,64}$/.test(text) ? text : null) },
  how: { write: String, read: oneOf(WAYS) },
  tool: { write: String, read: oneOf(TOOLS) },
};

/** @param {[number, number] | null} window */
const pair = (window) => (window && window[0] < window[1] ? window : null);

/** @param {Triple | null} values */
const camera = (values) => (values && Math.abs(values[1]) <= 90 && values[2] >= 0.25 && values[2] <= MOST_ZOOM ? values : null);

/** Write a view as the fragment of an address, without its #.
 *
 * @param {View} view
 */
export function encode(view) {
  const plain = fresh();
  return /** @type {(keyof View)[]} */ (Object.keys(PARTS))
    .filter((name) => view[name] !== null && JSON.stringify(said(name, view)) !== JSON.stringify(said(name, plain)))
    .map((name) => `${name}=${said(name, view)}`)
    .join("&");
}

/** @param {keyof View} name  @param {View} view */
const said = (name, view) => (view[name] === null ? "" : PARTS[name].write(view[name]));

/** Read a fragment, with or without its #; whatever it is, a view comes out.
 *
 * @param {string} fragment
 * @returns {View}
 */
export function decode(fragment) {
  /** @type {any} */
  const view = fresh();
  for (const part of fragment.replace(/^#/, "").split("&")) {
    const [name, ...rest] = part.split("=");
    if (!Object.hasOwn(PARTS, name)) continue;
    const value = PARTS[/** @type {keyof View} */ (name)].read(unescaped(rest.join("=")));
    if (value !== null) view[name] = value;
  }
  return view;
}

/** @param {string} text */
function unescaped(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return "";
  }
}
