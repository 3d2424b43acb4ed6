// @ts-check
// A map of the film's best bias wavelengths, from a file: too long for an address, it stays with the page.
import { h, replace } from "../dom.js";

/** @typedef {import("./fields.js").Design} Design */

const COLUMNS = ["x_mm", "y_mm", "wavelength_nm"];

/** A field for it, in the place of remarks too. @param {Design} design @param {() => void} changed */
export function tuningField(design, changed) {
  const remarks = h("div", { class: "remarks", id: "remarks-tuning_map" });
  const file = h("input", { type: "file", accept: ".csv,.json", id: "field-tuning_map", "aria-describedby": `told-tuning_map ${remarks.id}`, onchange: () => void take() });
  /** What is wrong with a file stands here, not among the remarks: those are the service's, and go with its next answer. */
  const told = h("p", { id: "told-tuning_map", role: "status" });
  const remove = h("button", { type: "button", class: "quiet", onclick: () => give(null) }, "remove");

  async function take() {
    const chosen = file.files?.[0];
    if (!chosen) return;
    file.value = ""; // the same may be chosen again, changed
    try {
      give(mapOf(chosen.name, await chosen.text()));
    } catch (error) {
      give(null, `${chosen.name}: ${error instanceof Error ? error.message : error}`);
    }
  }

  /** @param {Design["map"]} map @param {string} [fault] */
  function give(map, fault) {
    design.map = map;
    replace(remarks);
    show(fault);
    changed();
  }

  /** @param {string} [fault] */
  function show(fault) {
    remove.hidden = !design.map;
    told.className = fault ? "fault small" : "dim small";
    told.textContent = fault ?? (design.map ? `${design.map.wavelengths.length} places; not in the address` : "CSV with x_mm, y_mm, wavelength_nm, or JSON as the API takes it");
  }

  show();
  const element = h("div", { class: "field tuning" }, h("label", { for: file.id, title: "Where on the film which wavelength reads it best; between the places it is interpolated" }, "Tuning map"), remove, file, told, remarks);
  return { element, remarks };
}

/** What the API takes, or something else. @param {any} map @returns {Design["map"]} */
function given(map) {
  if (!Array.isArray(map?.positions) || !Array.isArray(map.wavelengths)) throw new Error("it has no positions and wavelengths");
  return map;
}

/** @param {string} name @param {string} text @returns {Design["map"]} */
function mapOf(name, text) {
  if (/\.json$/i.test(name)) return given(JSON.parse(text));
  const [head, ...rows] = text.replace("\ufeff", "").trim().split(/\r?\n/).map((line) => line.split(",").map((cell) => cell.trim()));
  const places = COLUMNS.map((column) => head.indexOf(column));
  if (places.includes(-1)) throw new Error(`its first line does not name ${COLUMNS.join(", ")}`);
  const values = rows.map((row) => places.map((column) => Number(row[column] || NaN)));
  const wrong = values.findIndex((row) => !row.every(Number.isFinite));
  if (wrong >= 0 || !values.length) throw new Error(`line ${wrong + 2} is no three numbers`);
  const si = (/** @type {number} */ value, /** @type {number} */ factor) => Number((value * factor).toPrecision(12));
  return { positions: values.map(([x, y]) => [si(x, 1e-3), si(y, 1e-3)]), wavelengths: values.map((row) => si(row[2], 1e-9)) };
}
