// @ts-check
// Retrospective undersampling of a scan: through a stored mask, or one that is designed for it.
import { api } from "../api.js";
import { designQueryThrough } from "../design/fields.js";
import { h, openDialog } from "../dom.js";
import { count, mm } from "../units.js";

const MAX_MASKS = 200;
const SAME_APERTURE = 1e-9; // m

/** Create the selection of the method. @param {string} id */
export function methodSelect(id) {
  return h("select", { id, "aria-label": "Method" }, h("option", { value: "" }, "direct"), h("option", { value: "iterative" }, "iterative: slower, masks differ least"));
}

/** Return the request of an undersampled reconstruction. @param {string} scanId @param {string} maskId @param {string} method */
export const throughBody = (scanId, maskId, method) => ({ scan_id: scanId, through: { mask_id: maskId }, ...(method ? { parameters: { method } } : {}) });

/**
 * Open the dialog that asks for the mask.
 * @param {any} scan @param {(request: any) => void} act receives the request
 */
export async function openUndersampling(scan, act) {
  const [own, { items }] = await Promise.all([api.get(`/masks/${scan.mask_id}`), api.get(`/masks?limit=${MAX_MASKS}`)]);
  const masks = items.filter((/** @type {any} */ one) => one.id !== own.id && Math.abs(one.aperture - own.aperture) < SAME_APERTURE);
  const select = h("select", { id: "other-mask" }, masks.map((/** @type {any} */ one) => h("option", { value: one.id }, maskTitle(one))));
  const method = methodSelect("other-method");
  const dialog = h("dialog", { "aria-labelledby": "undersampling-title" }, h("form", { method: "dialog", class: "stack" },
    h("h2", { id: "undersampling-title" }, "Retrospective undersampling"),
    h("p", null, "Reconstructs the scan as if only the points of another mask had been measured, and compares the image with that of all A-lines."),
    masks.length ? [h("label", { for: "other-mask" }, "Mask"), select, h("label", { for: "other-method" }, "Method"), method] : h("p", null, `No other mask of the aperture of this scan, ${mm(own.aperture)}, is stored.`),
    h("menu", null, h("a", { class: "button", href: `/design?${designQueryThrough(scan.id, own)}` }, "Design a mask …"), h("button", { value: "" }, "Cancel"), masks.length ? h("button", { class: "primary", value: "yes" }, "Reconstruct") : null)));
  dialog.addEventListener("close", () => dialog.returnValue === "yes" && act(throughBody(scan.id, select.value, method.value)));
  openDialog(dialog);
}

/** @param {any} mask */
function maskTitle({ id, arrangement, count: points, depth }) {
  return `${arrangement.arrangement ?? "mask"}, ${count(points)} points${depth === null ? "" : `, ${mm(depth, 1)} deep`} (${id.slice(0, 7)}…)`;
}
