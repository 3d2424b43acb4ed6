// @ts-check
// Fields of a design: arrangement and plan, in the units of the form.
import { defaultStages, ERROR_FIELDS, readStages, stagesBody, writeStages } from "./stage_fields.js";

/**
 * @typedef {object} Field
 * @property {string} name of the API
 * @property {string} label
 * @property {string} unit
 * @property {number} scale SI units in one of these
 * @property {number} from of the slider
 * @property {number} to of the slider; the number input accepts values beyond it, and the service checks them
 * @property {number} step
 * @property {number} start
 * @property {boolean} [log]
 * @property {[string, string][]} [choices]
 * @property {string} help
 */

/** @type {Record<string, Field>} */
const MASK_FIELDS = {
  aperture: field("aperture", "Aperture", "mm", 1e-3, 1, 30, 0.01, 13.56, "Side of the square detection area"),
  depth: field("depth", "Depth of point", "mm", 1e-3, 0.2, 15, 0.01, 3.6, "Distance of the point of interest from the film"),
  x: field("x", "x of the point", "mm", 1e-3, -10, 10, 0.01, 0, "x coordinate of the point of interest over the aperture; or drag the cross"),
  y: field("y", "y of the point", "mm", 1e-3, -10, 10, 0.01, 0, "y coordinate of the point of interest over the aperture; or drag the cross"),
  count: { ...field("count", "Points", "", 1, 20, 20_000, 1, 1600, "Requested number of points; the mask has the nearest possible number"), log: true },
  side: { ...field("count", "Points per side", "", 1, 2, 200, 1, 41, "Points on each axis of the grid") },
  interval: field("interval", "Interval", "µm", 1e-6, 20, 2000, 1, 300, "Distance between neighbouring points"),
  seed: field("seed", "Seed", "", 1, 0, 100, 1, 0, "The same seed gives the same points"),
};

/** @param {string} name @param {string} label @param {string} unit @param {number} scale @param {number} from @param {number} to @param {number} step @param {number} start @param {string} help @returns {Field} */
function field(name, label, unit, scale, from, to, step, start, help) {
  return { name, label, unit, scale, from, to, step, start, help };
}

/** Labels of the fields of each further point of interest. */
const POINT_LABELS = /** @type {Record<string, string>} */ ({ count: "Points for", depth: "Depth of", x: "x of", y: "y of" });
const POINT_KEYS = Object.keys(POINT_LABELS);
export const MAX_POINTS = 64;
const POINT_COUNT = 800; // of a further point
const POINT_OFFSET = 3e-3; // m from the centre: initial offset of a further point

export const MAX_PINS = 2;
const ADOPTED_FIELDS = ["pulse_rate", "averages", "samples", "sampling_interval", "sound_speed"]; // of the plan of an earlier scan

/** Arrangements that the form supports, with their fields; others consist of given positions. */
export const ARRANGEMENTS = /** @type {Record<string, {label: string, fields: string[]}>} */ ({
  "equi-steradian": { label: "Equi-steradian", fields: ["aperture", "count", "depth", "x", "y"] },
  combined: { label: "Equi-steradian, several points", fields: ["aperture", "count", "depth", "x", "y"] },
  grid: { label: "Grid", fields: ["aperture", "side", "interval", "depth", "x", "y"] },
  hexagonal: { label: "Hexagonal", fields: ["aperture", "count", "depth", "x", "y"] },
  "poisson-disc": { label: "Poisson disc", fields: ["aperture", "count", "seed", "depth", "x", "y"] },
  random: { label: "Random", fields: ["aperture", "count", "seed", "depth", "x", "y"] },
  equiangular: { label: "Equiangular line", fields: ["aperture", "count", "depth", "x"] },
});

/** @param {string} key of the mask's values: a further point's have its number, from 2 @returns {Field} */
export function maskField(key) {
  const [, name, number] = /** @type {RegExpMatchArray} */ (key.match(/^([a-z]+)([0-9]*)$/));
  return number ? { ...MASK_FIELDS[name], name: key, label: `${POINT_LABELS[name]} point ${number}` } : MASK_FIELDS[name];
}

/** Return the keys of the fields of a further point of interest. @param {number} number from 2 */
export const fieldsOfPoint = (number) => POINT_KEYS.map((name) => name + number);

/** Return the numbers of the points of interest after the first. @param {Design} design @returns {number[]} */
export function furtherPoints({ arrangement, points }) {
  return arrangement === "combined" ? Array.from({ length: points - 1 }, (_, n) => n + 2) : [];
}

/** Add a point of interest. @param {Design} design */
export function addPoint(design) {
  design.points = Math.min(design.points + 1, MAX_POINTS);
  fillPoint(design.mask, design.points);
}

/** Remove a point of interest; later ones move up. @param {Design} design @param {number} number from 2 */
export function removePoint(design, number) {
  for (let n = number; n < design.points; n++) for (const name of POINT_KEYS) design.mask[name + n] = design.mask[name + (n + 1)];
  for (const key of fieldsOfPoint(design.points)) delete design.mask[key];
  design.points -= 1;
}

/** Set missing values of a further point. @param {Record<string, number>} mask @param {number} number */
function fillPoint(mask, number) {
  const [x, y] = [[POINT_OFFSET, 0], [-POINT_OFFSET, 0], [0, POINT_OFFSET], [0, -POINT_OFFSET]][(number - 2) % 4];
  const first = /** @type {Record<string, number>} */ ({ count: POINT_COUNT, depth: mask.depth, x, y });
  for (const name of POINT_KEYS) mask[name + number] ??= first[name];
}

/** @type {Field[]} */
export const PLAN_FIELDS = [
  { ...field("pulse_rate", "Pulse rate", "Hz", 1, 1, 2000, 1, 50, "Laser pulses per second"), log: true },
  { ...field("averages", "Averages", "", 1, 1, 100, 1, 1, "Pulses averaged into one A-line"), log: true },
  { ...field("samples", "Samples", "", 1, 64, 8192, 16, 1024, "Samples of an A-line"), log: true },
  field("sampling_interval", "Sampling interval", "ns", 1e-9, 1, 100, 1, 8, "Time between samples"),
  field("sound_speed", "Speed of sound", "m/s", 1, 1400, 1650, 1, 1500, "Determines the recorded depth"),
  { ...field("frames", "Frames", "", 1, 1, 100, 1, 1, "Number of measurements of the whole mask"), log: true },
  {
    ...field("order", "Scan order", "", 1, 0, 0, 1, 0, "Order in which the beam visits the points"),
    choices: [["snake", "Snake, row by row"], ["hilbert", "Hilbert curve"], ["shortest", "Shortest path"],
      ["progressive", "Coarse first, then finer"], ["wavelength", "By bias wavelength"],
      ["bands", "In bands of bias wavelength"], ["given", "Order of the arrangement"]],
  },
];

/**
 * @typedef {object} Design values in SI units
 * @property {string} arrangement
 * @property {number} points of interest, where there are several
 * @property {Record<string, number>} mask
 * @property {Record<string, number | string>} plan
 * @property {import("./stage_fields.js").Stages} stages
 * @property {Record<string, any>} more of the plan, as the API takes it
 * @property {{positions: number[][], wavelengths: number[]} | null} map of bias wavelengths; not in a query
 * @property {[number, number, number] | null} look
 * @property {string} label
 * @property {string[]} pins queries of others
 * @property {string} through scan that is to be undersampled with the mask; empty: none
 */

/** Convert a value to SI units, rounded to 12 digits. @param {Field} field @param {number} value */
export function toSi(field, value) {
  return Number((value * field.scale).toPrecision(12));
}

/** @returns {Design} */
export function defaultDesign() {
  const mask = Object.fromEntries(Object.entries(MASK_FIELDS).map(([key, one]) => [key, toSi(one, one.start)]));
  const plan = Object.fromEntries(PLAN_FIELDS.map((one) => [one.name, one.choices ? one.choices[0][0] : toSi(one, one.start)]));
  fillPoint(mask, 2);
  return { arrangement: "equi-steradian", points: 2, mask, plan, stages: defaultStages(), more: {}, map: null, look: null, label: "", pins: [], through: "" };
}

/** Return the arrangement in the format of the API. @param {Design} design */
export function arrangementOf(design) {
  const { arrangement, mask } = design;
  if (arrangement === "combined") {
    const points_of_interest = ["", ...furtherPoints(design)].map((one) => ({ depth: mask[`depth${one}`], count: mask[`count${one}`], offset: [mask[`x${one}`], mask[`y${one}`]] }));
    return { arrangement, aperture: mask.aperture, points_of_interest };
  }
  /** @type {Record<string, any>} */
  const body = { arrangement };
  for (const key of ARRANGEMENTS[arrangement].fields) if (key !== "x" && key !== "y") body[maskField(key).name] = mask[key];
  body.offset = arrangement === "equiangular" ? mask.x : [mask.x, mask.y];
  return body;
}

/** Return the requested number of points, if the arrangement uses the nearest possible number. @param {Design} design @returns {number | null} */
export function requestedCount({ arrangement, mask }) {
  return arrangement === "equi-steradian" || arrangement === "hexagonal" ? mask.count : null;
}

/** Return the positions of the further points of interest. @param {Design} design @returns {[number, number][]} */
export function otherPoints(design) {
  return furtherPoints(design).map((number) => [design.mask[`x${number}`], design.mask[`y${number}`]]);
}

/** Return the key of the form field for a JSON pointer of the API. @param {string} pointer of the API */
export function formFieldOf(pointer) {
  const parts = pointer.replace(/^#\//, "").split("/");
  if (parts[0] === "tuning_map") return parts[0];
  if (parts[0] !== "arrangement") {
    const name = parts.filter((part) => !/^[0-9]+$/.test(part)).join(".");
    return ERROR_FIELDS[name] ?? name;
  }
  if (parts[1] !== "points_of_interest") return parts[1] ?? "arrangement";
  return (parts[3] ?? "depth") + (Number(parts[2]) > 0 ? Number(parts[2]) + 1 : "");
}

/** Return the scan plan in the format of the API. @param {Design} design @returns {Record<string, any>} */
export function planBody({ plan, stages, more, map }) {
  return { ...more, ...plan, ...stagesBody(stages), ...(map ? { tuning_map: map } : {}) };
}

/** @param {Design} design */
export function previewBody(design) {
  return { ...planBody(design), arrangement: arrangementOf(design), point: design.look };
}

/**
 * Return the query of a design with a mask around points of a volume.
 * @param {[number, number, number][]} places x, y and depth in mm @param {boolean} flat whether they are of a line's image
 * @param {import("../volume/scan_origin.js").ScanOrigin | null} origin scan that showed them: its aperture, laser and records are adopted
 */
export function designQueryAround(places, flat, origin) {
  const design = defaultDesign();
  design.arrangement = flat ? "equiangular" : places.length > 1 ? "combined" : "equi-steradian";
  if (origin?.aperture) design.mask.aperture = origin.aperture;
  for (const name of ADOPTED_FIELDS) design.plan[name] = origin?.plan?.[name] ?? design.plan[name];
  design.label = origin?.sample ?? "";
  while (design.points < places.length) addPoint(design);
  places.forEach((place, n) => ["x", "y", "depth"].forEach((name, axis) => (design.mask[name + (n ? n + 1 : "")] = Number((place[axis] * 1e-3).toPrecision(5)))));
  return toQuery(design);
}

/** Return the query of a design with a mask for the undersampling of a scan: of its aperture, with half of its points. @param {string} scanId @param {any} mask of the scan */
export function designQueryThrough(scanId, { aperture, depth, count, arrangement }) {
  const design = defaultDesign();
  const [x = 0, y = 0] = Array.isArray(arrangement.offset) ? arrangement.offset : [arrangement.offset ?? 0];
  Object.assign(design.mask, { aperture, x, y, count: Math.max(20, Math.round(count / 2)), depth: depth ?? Math.min(design.mask.depth, aperture / 2) });
  if (arrangement.arrangement === "equiangular") design.arrangement = "equiangular";
  design.through = scanId;
  return toQuery(design);
}

/** Encode a design as a query, so that a link restores it. @param {Design} design */
export function toQuery(design) {
  const first = defaultDesign();
  const query = new URLSearchParams({ mask: design.arrangement });
  for (const key of [...ARRANGEMENTS[design.arrangement].fields, ...furtherPoints(design).flatMap(fieldsOfPoint)]) query.set(key, String(design.mask[key]));
  for (const { name } of PLAN_FIELDS) if (design.plan[name] !== first.plan[name]) query.set(name, String(design.plan[name]));
  writeStages(design.stages, query);
  if (Object.keys(design.more).length) query.set("more", JSON.stringify(design.more));
  if (design.look) query.set("look", design.look.join(" "));
  if (design.label) query.set("label", design.label);
  if (design.through) query.set("through", design.through);
  for (const one of design.pins) query.append("pin", one);
  return query;
}

/** @param {URLSearchParams} query @returns {Design} */
export function fromQuery(query) {
  const design = defaultDesign();
  const arrangementName = query.get("mask");
  if (arrangementName && arrangementName in ARRANGEMENTS) design.arrangement = arrangementName;
  for (const [key, text] of query) {
    const number = Number(key.match(/^(?:count|depth|x|y)([0-9]{1,2})$/)?.[1] ?? 0);
    if ((!Object.hasOwn(MASK_FIELDS, key) && number < 2) || number > MAX_POINTS) continue;
    if (text !== "" && Number.isFinite(Number(text))) design.mask[key] = Number(text);
    design.points = Math.max(design.points, number);
  }
  for (let number = 2; number <= design.points; number++) fillPoint(design.mask, number);
  for (const { name, choices } of PLAN_FIELDS) {
    const queryValue = query.get(name);
    if (queryValue !== null && (choices ? choices.some(([one]) => one === queryValue) : Number.isFinite(Number(queryValue)))) {
      design.plan[name] = choices ? queryValue : Number(queryValue);
    }
  }
  const look = (query.get("look") ?? "").split(" ").map(Number);
  if (look.length === 3 && look.every(Number.isFinite)) design.look = /** @type {[number, number, number]} */ (look);
  design.stages = readStages(query);
  design.more = parseObject(query.get("more"));
  design.label = query.get("label") ?? "";
  design.through = query.get("through") ?? "";
  design.pins = query.getAll("pin").slice(0, MAX_PINS);
  return design;
}

/** @param {string | null} text @returns {Record<string, any>} */
function parseObject(text) {
  try {
    const parsed = JSON.parse(text ?? "{}");
    return parsed && typeof parsed === "object" && !Array.isArray(parsed) ? parsed : {};
  } catch {
    return {};
  }
}
