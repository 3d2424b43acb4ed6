// @ts-check
// What else a plan takes, as fields made from the API's own schema: folded, as most scans leave it as it is.
import { ParameterForm } from "../reconstructions/parameter_form.js";
import { parameterGroups } from "../reconstructions/schema.js";
import { PLAN_FIELDS } from "./fields.js";

/** @typedef {import("../reconstructions/schema.js").Field} Field */

/** What the design says elsewhere. */
const SHOWN_FIELDS = new Set(["arrangement", "point", ...PLAN_FIELDS.map(({ name }) => name)]);

/** Units in which a person thinks of these, where they are others than of lengths, times and frequencies elsewhere. */
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

/** The unit stands beside the field, and is no longer that of the description. @param {Field} field @returns {Field} */
function withUnit(field) {
  const unit = UNITS[field.path.join(".")] ?? field.unit;
  return unit ? { ...field, unit, description: field.description.replace(/,? (\((m|s|Hz|m\/s)\)|in m(?=;))/, "") } : field;
}
