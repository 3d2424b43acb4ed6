// @ts-check
// Fields of an import: each value that a description can state, in the unit of its field.
import { h } from "./dom.js";

/**
 * @typedef {object} ImportField
 * @property {string} name of the description, or of a part of its grid
 * @property {string} label
 * @property {string} unit
 * @property {string} help
 * @property {"number" | "text"} [kind] default: number
 * @property {[string, string][]} [choices] values and their texts
 * @property {string[]} [suggestions] of a text
 */

/** @type {ImportField[]} */
export const BASIC_FIELDS = [
  field("sampling_interval", "Sampling interval", "ns", "Time between samples"),
  field("time_zero", "Time zero", "ns", "Time from the laser pulse to the first sample"),
  field("time_zero_samples", "Further delay", "samples", "Added to time zero; negative if the record starts before the laser pulse"),
  field("sound_speed", "Speed of sound", "m/s", "In the medium, if known"),
  field("aperture", "Aperture", "mm", "Side of the square detection area around the origin"),
  field("depth", "Depth of the point", "mm", "Distance of the point of interest from the film"),
  field("interval", "Grid pitch", "mm", "Replaces positions if the sensors form a grid"),
  {
    ...field("axes", "Axes of the array", "", "Names in the order in which the program that wrote the file shows them: time; point, or x and y; frame"), kind: "text",
    suggestions: ["point, time", "time, point", "x, y, time", "time, x, y", "frame, point, time", "point, time, frame", "frame, x, y, time"],
  },
  { ...field("array", "Array of the A-lines", "", "Its name, if the file contains several; a field of a structure by its path, scan.raw.data"), kind: "text", suggestions: [] },
];

/** @type {ImportField[]} */
export const MORE_FIELDS = [
  field("interval_y", "Pitch along y", "mm", "If it is not the pitch along x"),
  field("count_x", "Sensors along x", "", "Slower axis of the file; empty: as the array has, or a square"),
  field("count_y", "Sensors along y", "", "Faster axis of the file"),
  field("scale", "Scale", "per unit", "Pressure of one unit of the array"),
  { ...field("lengths", "Lengths in the file", "", "Unit of positions and pitches in the file, or of the file with the positions"), choices: [["", "m; of a second file mm"], ["m", "m"], ["mm", "mm"], ["um", "µm"]] },
  { ...field("times", "Times in the file", "", "Unit of times in the file; not used with a time above"), choices: [["", "s"], ["us", "µs"], ["ns", "ns"]] },
  { ...field("mask_order", "Rows of a binary mask", "", "Order in which the A-lines follow the mask's voxels"), choices: [["", "by the A-lines"], ["matlab", "first axis fastest (MATLAB)"], ["python", "last axis fastest (Python)"]] },
  field("wavelength", "Wavelength of IPASC", "index", "Only this one, from 0; empty: all"),
  field("frame", "Frame of IPASC", "index", "Only this one, from 0; empty: all"),
  { ...field("scanner", "Scanner", "", "Name of the instrument, for the report"), kind: "text" },
  { ...field("simulated", "Simulated", "", "Whether the recording is simulated"), choices: [["", "as the file states"], ["true", "yes"], ["false", "no"]] },
];

const ALL_FIELDS = [...BASIC_FIELDS, ...MORE_FIELDS];
const LENGTHS = ["aperture", "depth", "interval", "interval_y"];
const TIMES = ["sampling_interval", "time_zero"];
/** @type {Record<string, number>} length units relative to mm */
const LENGTH_UNITS = { mm: 1, m: 1e-3, um: 1e3 };
const GRID = ["interval", "interval_y", "count_x", "count_y"];

/** @param {string} name @param {string} label @param {string} unit @param {string} help @returns {ImportField} */
function field(name, label, unit, help) {
  return { name, label, unit, help };
}

/** Return the label of a field of the description. @param {string} name */
export const labelOf = (name) => ALL_FIELDS.find((one) => one.name === fieldOf(name))?.label ?? name.replaceAll("_", " ");

/** Return the field of the form in which a field of the description is stated. @param {string | undefined} name */
export const fieldOf = (name) => (name === "positions" || name === "grid" ? "interval" : name === "count" ? "count_x" : name);

/** Return the pitch as missing, if other fields of the grid are filled without it. @param {FormData} form */
export function missingPitch(form) {
  const isFilled = (/** @type {string} */ name) => String(form.get(name) ?? "").trim() !== "";
  return !isFilled("interval") && GRID.some(isFilled) ? [{ field: "interval", allowed: "with a pitch along y or a number of sensors" }] : [];
}

/** Create the input of a field, with its remark. @param {ImportField} field @param {() => void} changed */
export function inputOf({ name, label, unit, help, kind = "number", choices, suggestions }, changed) {
  const control = choices
    ? h("select", { name, "aria-label": label, onchange: changed }, choices.map(([value, text]) => h("option", { value }, text)))
    : h("input", { type: kind, step: "any", name, "aria-label": label, placeholder: suggestions?.[0] ?? null, oninput: changed, list: suggestions ? `suggested-${name}` : null });
  return h("label", { class: "stack asked", title: help }, label,
    unit ? h("span", { class: "with-unit" }, control, h("span", { class: "dim" }, unit)) : control,
    suggestions ? h("datalist", { id: `suggested-${name}` }, suggestions.map((value) => h("option", { value }))) : null,
    h("span", { class: "fault small", dataset: { remark: name } }));
}

/**
 * Return the description of a form; empty fields are left to the file.
 * @param {FormData} form @param {{fileName: string, hasPositions: boolean, side: number}} recording
 *   hasPositions: whether a file of positions is beside it; side: points of a square grid, if neither form nor array state them
 */
export function descriptionOf(form, { fileName, hasPositions, side }) {
  /** @type {Record<string, any>} */
  const description = {};
  for (const { name, kind, choices } of ALL_FIELDS) {
    const text = String(form.get(name) ?? "").trim();
    if (text !== "") description[name] = kind === "text" || choices ? text : Number(text);
  }
  if (description.simulated) description.simulated = description.simulated === "true";
  if (/\.sgl$/i.test(fileName)) description.file_name = fileName.slice(0, 300); // the file name contains metadata
  const hasLengths = LENGTHS.some((name) => description[name] !== undefined);
  const lengths = hasLengths || hasPositions ? (description.lengths ?? "mm") : description.lengths; // without a length of its own, the unit is that of the file
  for (const name of LENGTHS) if (description[name] !== undefined) description[name] = Number((description[name] * LENGTH_UNITS[lengths]).toPrecision(12));
  if (lengths) description.lengths = lengths;
  if (TIMES.some((name) => description[name] !== undefined)) description.times = "ns";
  const { interval, interval_y: across = interval, count_x: nx, count_y: ny } = description;
  for (const name of GRID) delete description[name];
  if (interval !== undefined) {
    const count = nx !== undefined || ny !== undefined ? [nx ?? ny, ny ?? nx] : side ? [side, side] : null;
    const isLine = count?.[1] === 1;
    description.grid = { interval: isLine ? [interval] : [interval, across], ...(count ? { count: isLine ? [count[0]] : count } : {}) };
  }
  return description;
}
