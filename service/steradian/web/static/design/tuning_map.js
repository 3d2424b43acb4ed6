// @ts-check
// Tuning map read from a file; too large for the URL, so it stays in the page.
import { h, replace } from "../dom.js";

/** @typedef {import("./fields.js").Design} Design */

const COLUMNS = ["x_mm", "y_mm", "wavelength_nm"];

/** Create the field of the tuning map and the host of its remarks. @param {Design} design @param {() => void} changed */
export function tuningField(design, changed) {
  const remarks = h("div", { class: "remarks", id: "remarks-tuning_map" });
  const file = h("input", { type: "file", accept: ".csv,.json", id: "field-tuning_map", "aria-describedby": `told-tuning_map ${remarks.id}`, onchange: () => void readFile() });
  /** Errors of the file are separate from the remarks, because each response of the service replaces those. */
  const status = h("p", { id: "told-tuning_map", role: "status" });
  const remove = h("button", { type: "button", class: "quiet", onclick: () => setMap(null) }, "remove");

  async function readFile() {
    const selectedFile = file.files?.[0];
    if (!selectedFile) return;
    file.value = ""; // allows selecting the same file again
    try {
      setMap(parseMap(selectedFile.name, await selectedFile.text()));
    } catch (error) {
      setMap(null, `${selectedFile.name}: ${error instanceof Error ? error.message : error}`);
    }
  }

  /** @param {Design["map"]} map @param {string} [fault] */
  function setMap(map, fault) {
    design.map = map;
    replace(remarks);
    show(fault);
    changed();
  }

  /** @param {string} [fault] */
  function show(fault) {
    remove.hidden = !design.map;
    status.className = fault ? "fault small" : "dim small";
    status.textContent = fault ?? (design.map ? `${design.map.wavelengths.length} positions; not stored in the URL` : "CSV with x_mm, y_mm, wavelength_nm, or JSON in the format of the API");
  }

  show();
  const element = h("div", { class: "field tuning" }, h("label", { for: file.id, title: "Optimum bias wavelength at positions on the film; interpolated between them" }, "Tuning map"), remove, file, status, remarks);
  return { element, remarks };
}

/** Check a map in the format of the API. @param {any} map @returns {Design["map"]} */
function checkedMap(map) {
  if (!Array.isArray(map?.positions) || !Array.isArray(map.wavelengths)) throw new Error("positions and wavelengths are missing");
  return map;
}

/** @param {string} name @param {string} text @returns {Design["map"]} */
function parseMap(name, text) {
  if (/\.json$/i.test(name)) return checkedMap(JSON.parse(text));
  const [head, ...rows] = text.replace("\ufeff", "").trim().split(/\r?\n/).map((line) => line.split(",").map((cell) => cell.trim()));
  const columns = COLUMNS.map((column) => head.indexOf(column));
  if (columns.includes(-1)) throw new Error(`the header does not contain ${COLUMNS.join(", ")}`);
  const values = rows.map((row) => columns.map((column) => Number(row[column] || NaN)));
  const invalidRow = values.findIndex((row) => !row.every(Number.isFinite));
  if (invalidRow >= 0 || !values.length) throw new Error(`line ${invalidRow + 2} does not contain three numbers`);
  const si = (/** @type {number} */ value, /** @type {number} */ factor) => Number((value * factor).toPrecision(12));
  return { positions: values.map(([x, y]) => [si(x, 1e-3), si(y, 1e-3)]), wavelengths: values.map((row) => si(row[2], 1e-9)) };
}
