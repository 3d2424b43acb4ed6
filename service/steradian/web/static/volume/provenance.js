// @ts-check
// Provenance of a volume: sources, parameters, versions, and the commands that repeat the reconstruction.
import { api } from "../api.js";
import { LineChart } from "../charts.js";
import { copyText, h, replace } from "../dom.js";
import { showError } from "../panel_states.js";
import { formatDate, count, duration, identifierElement } from "../units.js";
import { isUnmixingCommandComplete, optionsOf, curlCommand, shellCommand } from "../reconstructions/command.js";
import { differences, parameterGroups, displayPath, formatValue, valueAt } from "../reconstructions/schema.js";
import { SERVICE_URL } from "../urls.js";

/** @param {any} reconstruction the reconstruction, of the API */
export function provenance(reconstruction) {
  const element = h("div", { class: "stack" });
  return { element, open: () => load(element, reconstruction).catch((error) => showError(element, error)) };
}

/** @param {HTMLElement} element @param {any} reconstruction */
async function load(element, reconstruction) {
  const [groups, scan] = await Promise.all([parameterGroups("ReconstructionParameters"), api.get(`/scans/${reconstruction.scan_id}`).catch(() => null)]);
  const { report } = reconstruction;
  const seconds = Object.values(report?.seconds ?? {}).reduce((all, one) => all + Number(one), 0);
  replace(element,
    h("dl", { class: "figures" },
      entry("Scan", h("span", null, identifierElement(reconstruction.scan_id, `/scans/${reconstruction.scan_id}`), reconstruction.simulated ? " simulated" : "")),
      entry("Plan", scan ? identifierElement(scan.plan_id) : null),
      entry("Mask", scan ? identifierElement(scan.mask_id) : null),
      entry("Undersampled with mask", reconstruction.mask_id ? identifierElement(reconstruction.mask_id) : null),
      entry("Labels", Object.entries(scan?.labels ?? {}).map(([name, text]) => `${name}: ${text}`).join(", ") || null),
      entry("A-lines", report?.sensors === null || report?.sensors === undefined ? null : `${count(report.sensors)} of ${count(report.planned)}`),
      entry("Voxels", report?.shape ? `${report.shape.join(" × ")}, ${report.spacing_m.map((/** @type {number} */ one) => Number((one * 1e6).toPrecision(4))).join(" × ")} µm` : null),
      entry("Centre in file coordinates", report?.centre_m?.length ? `${report.centre_m.map((/** @type {number} */ one) => Number((one * 1e3).toPrecision(6))).join(", ")} mm` : null),
      entry("Created", reconstruction.ended ? `${formatDate(reconstruction.ended)}${seconds ? `, computed in ${duration(seconds)}` : ""}` : null),
      entry("Method", reconstruction.parameters.method), entry("Speed of sound", report?.sound_speed_m_s ? `${report.sound_speed_m_s} m/s` : null)),
    ...(report?.notes ?? []).map((/** @type {string} */ note) => h("p", { class: "note" }, note)),
    ...noiseGain(report?.noise_gain ?? []),
    h("h3", null, "Parameters that differ from the defaults"), parameters(groups, reconstruction.parameters),
    h("div", { class: "row" },
      reconstruction.kind === "unmixing" ? null : h("a", { class: "button primary", href: `/reconstructions?again=${reconstruction.id}` }, "Rerun …"),
      h("a", { class: "button", href: `/reconstructions/${reconstruction.id}` }, "Log and attempts")),
    ...rerunCommands(groups, reconstruction));
}

/** Return a chart of the noise gain against depth. @param {number[][]} pairs depth in m, and gain */
function noiseGain(pairs) {
  if (!pairs.length) return [];
  const host = h("div", { class: "chart noise-gain" });
  const line = { name: "noise gain", x: pairs.map(([depth]) => 1e3 * depth), y: pairs.map(([, gain]) => gain) };
  new LineChart(host).show([line], { x: "depth (mm)", y: "noise gain" });
  return [h("h3", null, "Noise gain of the compensation of attenuation"), host];
}

/** @param {import("../reconstructions/schema.js").Group[]} groups @param {any} values */
function parameters(groups, values) {
  const fields = differences(groups, [values, {}]);
  if (!fields.length) return h("p", { class: "dim" }, "None.");
  return h("dl", { class: "figures" }, fields.flatMap((field) => entry(displayPath(field.path), formatValue(field, valueAt(values, field.path)))));
}

/** @param {import("../reconstructions/schema.js").Group[]} groups @param {any} reconstruction */
function rerunCommands(groups, reconstruction) {
  const { options, missing } = optionsOf(groups, reconstruction.parameters);
  const parts = [];
  const { unmixing } = reconstruction;
  if (!reconstruction.mask_id && (!unmixing || isUnmixingCommandComplete(unmixing))) {
    parts.push(h("h3", null, "Command line"), copyableText(shellCommand(SERVICE_URL, reconstruction, options), "shell"));
    if (missing.length && !unmixing) parts.push(h("p", { class: "dim small" }, `The command line has no option for ${missing.map((field) => field.path.join(".")).join(", ")}; the request below contains all parameters.`));
  }
  return [...parts, h("h3", null, "HTTP request"), copyableText(curlCommand(SERVICE_URL, reconstruction), "request")];
}

/** @param {string} text @param {string} name */
function copyableText(text, name) {
  const button = h("button", { type: "button", class: "quiet copy", onclick: () => copyText(button, text) }, "copy");
  return h("div", { class: "copyable" }, h("pre", { tabindex: 0, dataset: { command: name } }, text), button);
}

/** @param {string} name @param {import("../dom.js").Child} value */
function entry(name, value) {
  return value === null ? [] : [h("dt", null, name), h("dd", null, value)];
}
