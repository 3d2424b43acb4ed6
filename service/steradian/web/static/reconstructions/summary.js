// @ts-check
// Summary of a reconstruction: method, requester, duration and state.
import { api } from "../api.js";
import { h } from "../dom.js";
import { percent, wavelengthText } from "../units.js";
import { singleText } from "./volume_names.js";

/** Return the labels of each scan by identifier. @returns {Promise<Map<string, string>>} */
export async function scanNames() {
  const { items } = await api.get("/scans?limit=200");
  return new Map(items.map((/** @type {any} */ one) => [one.id, Object.values(one.labels ?? {}).join(", ")]));
}

/** Return the principal that submitted a reconstruction: the name of a key, or local. @param {any} one */
export const requesterOf = (one) => one.history[0]?.who ?? "";

/** @param {any} one */
export function methodText(one) {
  const { method, modes } = one.parameters ?? {};
  const kind = { "what-if": "what-if, ", live: "live, ", unmixing: "unmixing, " }[/** @type {string} */ (one.kind)] ?? "";
  return [`${kind}${method ?? ""}`, modes ? `${modes} modes` : "", framesText(one)].filter(Boolean).join(", ");
}

/** Return which frames and wavelengths of a scan a reconstruction is made of; empty for a scan of one frame. @param {any} one */
function framesText(one) {
  const frames = one.report?.frames ?? [];
  if (one.kind === "unmixing") return "";
  if (frames.length) {
    const lights = [...new Set(frames.map((/** @type {any} */ frame) => frame.excitation_m).filter(Boolean).map(wavelengthText))];
    return [`series of ${frames.length} volumes`, ...(lights.length ? [`at ${lights.join(" and ")}`] : [])].join(" ");
  }
  return singleText(one);
}

/** Return the duration of the last attempt in seconds, once it has ended. @param {any} one */
export const runSeconds = (one) => (one.started && one.ended ? (new Date(one.ended).getTime() - new Date(one.started).getTime()) / 1e3 : null);

/** Return the speed of sound of a reconstruction. @param {any} one */
export const soundSpeedText = (one) => (one.parameters?.sound_speed ? `${one.parameters.sound_speed}\u00a0m/s` : "");

/** @param {any} one */
export function stateElement(one) {
  const { progress } = one;
  if (one.state === "running") {
    const bar = h("progress", { "aria-label": "Progress", ...(progress.total ? { value: progress.done, max: progress.total } : {}) });
    const [stage, ...more] = (progress.stage ?? "running").split(", "); // iterations, misfit 47.8 %
    const share = progress.total ? ` ${percent(progress.done / progress.total)}` : "";
    return h("span", { class: "stack tight live" }, h("span", null, one.desired_state === "cancelled" ? "cancelling" : [`${stage}${share}`, ...more].join(", ")), bar);
  }
  if (one.state === "queued") return h("span", { class: "live" }, one.queue?.position ? `queued, ${one.queue.position === 1 ? "next" : `position ${one.queue.position}`}` : "queued");
  if (one.state === "failed") return h("span", { class: "fault", title: one.error?.detail }, "failed");
  return h("span", { class: one.state === "succeeded" ? "good" : "dim" }, one.state);
}
