// @ts-check
/** View state and its encoding in the URL fragment; defaults are omitted.
 *
 * Lengths are in mm. `slab` is the thickness of the maximum: 0 is a slice, Infinity the whole volume. `large` is the
 * enlarged view, `depth` the range of depths that is shown; null: where the volume has signal. `smooth`
 * is the interpolation, `log` the range of a logarithmic colour scale in dB; 0: none. `against` is the
 * reference, of a series with a volume that is fixed: identifier:index; `opacity` is that of the image and of the overlay.
 *
 * @typedef {"x" | "y" | "z"} Axis
 * @typedef {[number, number, number]} Triple
 * @typedef {{plane: Axis, from: [number, number], to: [number, number]}} Mark  in the plane across an axis
 * @typedef {{
 *   at: Triple | null, slab: Triple, window: [number, number] | null, map: string, cut: number | null,
 *   centre: Triple | null, zoom: number, camera: Triple,
 *   clip: [number, number, number, number, number, number] | null,
 *   line: Mark | null, region: Mark | null, background: Mark | null, points: Triple[],
 *   against: string | null, how: string, tool: string, index: number, large: "x" | "y" | "z" | "3d" | null, depth: [number, number] | null,
 *   smooth: string, gamma: number, log: number, overlayMap: string, overlayWindow: [number, number] | null, opacity: [number, number],
 * }} View
 */

import { OVERLAY_MAPS, PRESSURE_MAPS } from "./colours.js";

export const TOOLS = ["crosshair", "line", "region", "background", "point"];
export const MARKS = /** @type {const} */ (["line", "region", "background"]);
export const MAX_POINTS = 8;
export const COMPARE_MODES = ["difference", "blink", "overlay"];
export const INTERPOLATIONS = ["linear", "nearest"];
export const GAMMAS = [0.1, 5];
export const DECIBELS = [10, 80];
const MAX_ZOOM = 64;

/** @returns {View} */
export function defaultView() {
  return {
    at: null, slab: [Infinity, Infinity, Infinity], window: null, map: "inferno", cut: null,
    centre: null, zoom: 1, camera: [-35, 25, 1], clip: null, line: null, region: null, background: null,
    points: [], against: null, how: "difference", tool: "crosshair", index: 0,
    large: null, depth: null, smooth: "linear", gamma: 1, log: 0,
    overlayMap: "cyan", overlayWindow: null, opacity: [1, 1],
  };
}

/** @param {number} value */
function formatNumber(value) {
  return value === Infinity ? "all" : String(Number(value.toPrecision(6)));
}

/** @param {string} text */
function parseNumber(text) {
  return text === "all" ? Infinity : /^-?[0-9]+(\.[0-9]*)?(e[-+]?[0-9]{1,2})?$/i.test(text) ? Number(text) : NaN;
}

/** @param {readonly number[]} values */
const formatList = (values) => values.map(formatNumber).join(",");

/** Parse comma-separated numbers; null unless `count` numbers are valid.
 *
 * @param {string} text
 * @param {number} count
 * @param {(value: number) => boolean} isValid
 * @returns {any}
 */
function parseNumbers(text, count, isValid = Number.isFinite) {
  const values = text.split(",").map(parseNumber);
  return values.length === count && values.every(isValid) ? values : null;
}

/** @param {Mark} mark */
const formatMark = ({ plane, from, to }) => `${plane},${formatList([...from, ...to])}`;

/** @param {string} text  @returns {Mark | null} */
function parseMark(text) {
  const [plane, ...remainder] = text.split(",");
  const ends = parseNumbers(remainder.join(","), 4);
  if (!ends || !["x", "y", "z"].includes(plane)) return null;
  return { plane: /** @type {Axis} */ (plane), from: [ends[0], ends[1]], to: [ends[2], ends[3]] };
}

/** @param {readonly string[]} known */
const choiceOf = (known) => (/** @type {string} */ text) => (known.includes(text) ? text : null);

/** @param {string} text  @returns {Triple[] | null} */
function parsePoints(text) {
  const parsed = text.split(";").map((one) => parseNumbers(one, 3));
  return parsed.length <= MAX_POINTS && parsed.every((one) => one !== null) ? parsed : null;
}

/** Formatter and parser of each part; invalid parts have their default.
 *
 * @type {{[name in keyof View]: {write: (value: any) => string, read: (text: string) => any}}}
 */
const PARTS = {
  at: { write: formatList, read: (text) => parseNumbers(text, 3) },
  slab: { write: formatList, read: (text) => parseNumbers(text, 3, (value) => value >= 0) },
  window: { write: formatList, read: (text) => validWindow(parseNumbers(text, 2)) },
  map: { write: String, read: choiceOf(PRESSURE_MAPS) },
  cut: { write: formatNumber, read: (text) => parseNumbers(text, 1, (value) => value >= 0 && value < 1e6)?.[0] ?? null },
  centre: { write: formatList, read: (text) => parseNumbers(text, 3) },
  zoom: { write: formatNumber, read: (text) => parseNumbers(text, 1, (value) => value >= 0.25 && value <= MAX_ZOOM)?.[0] ?? null },
  camera: { write: formatList, read: (text) => validCamera(parseNumbers(text, 3)) },
  clip: { write: formatList, read: (text) => parseNumbers(text, 6, (value) => value >= 0 && value <= 1) },
  line: { write: formatMark, read: parseMark },
  region: { write: formatMark, read: parseMark },
  background: { write: formatMark, read: parseMark },
  points: { write: (/** @type {Triple[]} */ all) => all.map(formatList).join(";"), read: parsePoints },
  against: { write: String, read: (text) => (/^[A-Za-z0-9]{1,64}(:[0-9]{1,6})?$/.test(text) ? text : null) },
  how: { write: String, read: choiceOf(COMPARE_MODES) },
  tool: { write: String, read: choiceOf(TOOLS) },
  large: { write: String, read: choiceOf(["x", "y", "z", "3d"]) },
  depth: { write: formatList, read: (text) => validWindow(parseNumbers(text, 2, (value) => value >= 0)) },
  smooth: { write: String, read: choiceOf(INTERPOLATIONS) },
  gamma: { write: formatNumber, read: (text) => parseNumbers(text, 1, (value) => value >= GAMMAS[0] && value <= GAMMAS[1])?.[0] ?? null },
  log: { write: formatNumber, read: (text) => parseNumbers(text, 1, (value) => value >= DECIBELS[0] && value <= DECIBELS[1])?.[0] ?? null },
  overlayMap: { write: String, read: choiceOf(OVERLAY_MAPS) },
  overlayWindow: { write: formatList, read: (text) => validWindow(parseNumbers(text, 2)) },
  opacity: { write: formatList, read: (text) => parseNumbers(text, 2, (value) => value >= 0 && value <= 1) },
  index: { write: String, read: (text) => (/^[0-9]{1,6}$/.test(text) ? Number(text) : null) },
};

/** @param {[number, number] | null} window */
const validWindow = (window) => (window && window[0] < window[1] ? window : null);

/** @param {Triple | null} values */
const validCamera = (values) => (values && Math.abs(values[1]) <= 90 && values[2] >= 0.25 && values[2] <= MAX_ZOOM ? values : null);

/** Encode a view as a URL fragment without #.
 *
 * @param {View} view
 */
export function encode(view) {
  const defaults = defaultView();
  return /** @type {(keyof View)[]} */ (Object.keys(PARTS))
    .filter((name) => view[name] !== null && JSON.stringify(formatPart(name, view)) !== JSON.stringify(formatPart(name, defaults)))
    .map((name) => `${name}=${formatPart(name, view)}`)
    .join("&");
}

/** @param {keyof View} name  @param {View} view */
const formatPart = (name, view) => (view[name] === null ? "" : PARTS[name].write(view[name]));

/** Decode a URL fragment, with or without #; invalid parts have their default.
 *
 * @param {string} fragment
 * @returns {View}
 */
export function decode(fragment) {
  /** @type {any} */
  const view = defaultView();
  for (const part of fragment.replace(/^#/, "").split("&")) {
    const [name, ...remainder] = part.split("=");
    if (!Object.hasOwn(PARTS, name)) continue;
    const value = PARTS[/** @type {keyof View} */ (name)].read(decoded(remainder.join("=")));
    if (value !== null) view[name] = value;
  }
  return view;
}

/** @param {string} text */
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return "";
  }
}
