// @ts-check
// Advanced fields of a plan, generated from the API's schema and collapsed by default.
import { ParameterForm } from "../reconstructions/parameter_form.js";
import { parameterGroups } from "../reconstructions/schema.js";
import { PLAN_FIELDS } from "./fields.js";

/** @typedef {import("../reconstructions/schema.js").Field} Field */

/** Fields that the main form already contains. */
const SHOWN_FIELDS = new Set(["arrangement", "point", "survey", "stopping", ...PLAN_FIELDS.map(({ name }) => name)]);

/** Units of fields that differ from the default units of lengths, times and frequencies. */
const UNITS = /** @type {Record<string, string>} */ ({
  beams: "m", excitation: "nm", wavelength_uncertainty: "nm", gate_rate: "edges/s", "scanner.wavelength": "nm", "scanner.x": "m", "scanner.y": "m",
  "scanner.pulse_rate": "pulses/s", "scanner.sampling_interval": "ns", "fringe.linewidth": "nm", "fringe.free_spectral_range": "nm",
  "tuning.speed": "nm/s", "tuning.settling": "ms", "tuning.tolerance": "nm",
});

/** @param {any} values as the API takes them */
export async function advancedForm(values) {
  const [topGroup, ...inner] = await parameterGroups("DesignRequest");
  const fields = topGroup.fields.filter(({ path }) => !SHOWN_FIELDS.has(path[0]));
  const groups = [{ ...topGroup, fields }, ...inner].map((group) => ({ ...group, fields: group.fields.map(withUnit) }));
  return new ParameterForm(groups, values, null, { plain: new Set(), rest: "Excitation, beams, gate" });
}

/** Set the unit of a field and remove the unit from its description. @param {Field} field @returns {Field} */
function withUnit(field) {
  const unit = UNITS[field.path.join(".")] ?? field.unit;
  return unit ? { ...field, unit, description: field.description.replace(/,? (\((m|s|Hz|m\/s)\)|in m(?=;))/, "") } : field;
}
