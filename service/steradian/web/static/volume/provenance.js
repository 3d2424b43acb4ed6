// @ts-check
// How a volume was made: from what, with which parameters, by which version, and how it is made again.
import { api } from "../api.js";
import { copy, h, replace } from "../dom.js";
import { failed } from "../panel_states.js";
import { clock, count, duration, identifierOf } from "../units.js";
import { optionsOf, requestOf, shellOf } from "../reconstructions/command.js";
import { differences, groupsOf, spokenPath, told, valueAt } from "../reconstructions/schema.js";
import { SERVICE } from "../urls.js";

/** @param {any} about the reconstruction, of the API */
export function made(about) {
  const element = h("div", { class: "stack" });
  return { element, open: () => open(element, about).catch((error) => failed(element, error)) };
}

/** @param {HTMLElement} element @param {any} about */
async function open(element, about) {
  const [groups, scan] = await Promise.all([groupsOf("ReconstructionParameters"), api.get(`/scans/${about.scan_id}`).catch(() => null)]);
  const { report } = about;
  const seconds = Object.values(report?.seconds ?? {}).reduce((all, one) => all + Number(one), 0);
  replace(element,
    h("dl", { class: "figures" },
      row("Scan", h("span", null, identifierOf(about.scan_id, `/scans/${about.scan_id}`), about.simulated ? " simulated" : "")),
      row("Plan", scan ? identifierOf(scan.plan_id) : null),
      row("Mask", scan ? identifierOf(scan.mask_id) : null),
      row("Through", about.mask_id ? identifierOf(about.mask_id) : null),
      row("Labels", Object.entries(scan?.labels ?? {}).map(([name, text]) => `${name}: ${text}`).join(", ") || null),
      row("A-lines", report?.sensors === null || report?.sensors === undefined ? null : `${count(report.sensors)} of ${count(report.planned)}`),
      row("Voxels", report?.shape ? `${report.shape.join(" × ")}, ${report.spacing_m.map((/** @type {number} */ one) => Number((one * 1e6).toPrecision(4))).join(" × ")} µm` : null),
      row("Centre in the file's coordinates", report?.centre_m?.length ? `${report.centre_m.map((/** @type {number} */ one) => Number((one * 1e3).toPrecision(6))).join(", ")} mm` : null),
      row("Made", about.ended ? `${clock(about.ended)}${seconds ? `, in ${duration(seconds)}` : ""}` : null),
      row("Method", about.parameters.method), row("Speed of sound", report?.sound_speed_m_s ? `${report.sound_speed_m_s} m/s` : null)),
    ...(report?.notes ?? []).map((/** @type {string} */ note) => h("p", { class: "note" }, note)),
    h("h3", null, "Parameters other than the defaults"), parameters(groups, about.parameters),
    h("div", { class: "row" },
      h("a", { class: "button primary", href: `/reconstructions?again=${about.id}` }, "Again …"),
      h("a", { class: "button", href: `/reconstructions/${about.id}` }, "Log and attempts")),
    ...again(groups, about));
}

/** @param {import("../reconstructions/schema.js").Group[]} groups @param {any} values */
function parameters(groups, values) {
  const fields = differences(groups, [values, {}]);
  if (!fields.length) return h("p", { class: "dim" }, "None.");
  return h("dl", { class: "figures" }, fields.flatMap((field) => row(spokenPath(field.path), told(field, valueAt(values, field.path)))));
}

/** @param {import("../reconstructions/schema.js").Group[]} groups @param {any} about */
function again(groups, about) {
  const { options, missing } = optionsOf(groups, about.parameters);
  const parts = [];
  if (!about.mask_id) {
    parts.push(h("h3", null, "On the command line"), copyable(shellOf(SERVICE, about, options), "shell"));
    if (missing.length) parts.push(h("p", { class: "dim small" }, `It has no option for ${missing.map((field) => field.path.join(".")).join(", ")}; the request below says all.`));
  }
  return [...parts, h("h3", null, "By one request"), copyable(requestOf(SERVICE, about), "request")];
}

/** @param {string} text @param {string} name */
function copyable(text, name) {
  const button = h("button", { type: "button", class: "quiet copy", onclick: () => copy(button, text) }, "copy");
  return h("div", { class: "copyable" }, h("pre", { tabindex: 0, dataset: { command: name } }, text), button);
}

/** @param {string} name @param {import("../dom.js").Child} value */
function row(name, value) {
  return value === null ? [] : [h("dt", null, name), h("dd", null, value)];
}
