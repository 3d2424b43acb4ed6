// @ts-check
// Layers of the medium: form control, text and command-line options.
import { h, replace } from "../dom.js";

/** @typedef {{sound_speed?: number | null, thickness?: number | null, density?: number | null, attenuation?: {coefficient: number, power: number} | null}} Layer  in SI units */

/** Columns of the form: path within a layer, heading, unit and factor from SI to that unit. @type {[string, string, string, number][]} */
const COLUMNS = [
  ["sound_speed", "Speed", "m/s", 1], ["thickness", "Thickness", "mm", 1e3], ["density", "Density", "kg/m³", 1],
  ["coefficient", "Attenuation", "dB/(MHz^y cm)", 1], ["power", "Power y", "", 1],
];

/** Create a table of layers, from the film downwards, with a row each. @param {string} id */
export function layerTable(id) {
  const body = h("tbody");
  const add = h("button", { type: "button", class: "quiet", onclick: () => { body.append(layerRow({})); show(); changed(); /** @type {HTMLElement | null} */ (body.querySelector("tr:last-child input"))?.focus(); } }, "Add a layer");
  const heading = (/** @type {[string, string, string, number]} */ [, name, unit]) => h("th", null, unit ? `${name} (${unit})` : name);
  const table = h("table", { class: "layers" }, h("thead", null, h("tr", null, COLUMNS.map(heading), h("th"))), body);
  const control = h("span", { id, role: "group", tabindex: -1, class: "stack tight" }, table, add);
  const changed = () => control.dispatchEvent(new Event("input", { bubbles: true }));
  const show = () => { table.hidden = !body.children.length; };

  /** @param {Layer} layer */
  function layerRow(layer) {
    const remove = h("button", { type: "button", class: "quiet", "aria-label": "Remove this layer", onclick: () => { row.remove(); show(); changed(); } }, "×");
    const row = h("tr", null, COLUMNS.map(([name, title, unit, factor]) => {
      const value = name === "coefficient" || name === "power" ? layer.attenuation?.[name] : layer[/** @type {"thickness"} */ (name)];
      return h("td", null, h("input", { type: "text", inputmode: "decimal", class: "half-field", dataset: { part: name }, "aria-label": unit ? `${title}, ${unit}` : title, value: value === null || value === undefined ? "" : String(Number((value * factor).toPrecision(9))) }));
    }), h("td", null, remove));
    return row;
  }

  return {
    control,
    read: () => (body.children.length ? [...body.children].map(readRow) : null),
    write: (/** @type {Layer[] | null} */ value) => { replace(body, (value ?? []).map(layerRow)); show(); },
  };
}

/** Return the layer of a row; text that is not a number stays, for the API to refuse. @param {Element} row @returns {any} */
function readRow(row) {
  const [speed, thickness, density, coefficient, power] = COLUMNS.map(([name, , , factor]) => {
    const text = /** @type {HTMLInputElement} */ (row.querySelector(`[data-part=${name}]`)).value.trim();
    const value = Number(text.replace(",", "."));
    return text === "" ? null : Number.isFinite(value) ? Number((value / factor).toPrecision(12)) : text;
  });
  const attenuation = coefficient === null && power === null ? null : { ...(coefficient === null ? {} : { coefficient }), ...(power === null ? {} : { power }) };
  return { sound_speed: speed, thickness, density, attenuation };
}

/** Describe layers in one line. @param {Layer[]} layers */
export function layersText(layers) {
  return layers.map(({ sound_speed: speed, thickness, density, attenuation }) => [
    speed ? `${speed} m/s` : "the scan's speed", thickness ? `${Number((1e3 * thickness).toPrecision(6))} mm` : null, density ? `${density} kg/m³` : null,
    attenuation ? `${attenuation.coefficient} dB/(MHz^${attenuation.power} cm)` : null,
  ].filter(Boolean).join(", ")).join("; ");
}

/** Return the command-line options of layers; null: there are none, as a layer has the scan's speed. @param {Layer[]} layers @returns {string[] | null} */
export function layerOptions(layers) {
  const isStated = layers.every((layer) => layer.sound_speed);
  if (!isStated && layers.length > 1) return null;
  const each = layers.map(({ sound_speed: speed, thickness, density }) => [`${speed}m/s`, thickness ? `${thickness}m` : null, density ? `${density}kg/m3` : null].filter(Boolean).join(":"));
  const laws = layers.some((layer) => layer.attenuation) ? layers.map(({ attenuation }) => (attenuation ? `${attenuation.coefficient},${attenuation.power}` : "none")) : [];
  return [...(isStated ? each.flatMap((text) => ["--layer", text]) : []), ...laws.flatMap((text) => ["--attenuation", text])];
}
