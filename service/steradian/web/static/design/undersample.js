// @ts-check
// Undersampling of a finished scan through the designed mask: controls in place of those that start a scan.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { methodSelect, throughBody } from "../scan/undersampling.js";
import { urlOf } from "../urls.js";
import { arrangementOf } from "./fields.js";

/** @typedef {import("./fields.js").Design} Design */

/**
 * Create the controls; empty if the design is not for a finished scan.
 * @param {Design} design @param {HTMLElement} messages host of errors
 * @returns {{elements: HTMLElement[], enable: (isEnabled: boolean) => void}}
 */
export function undersampleControls(design, messages) {
  if (!design.through) return { elements: [], enable: () => {} };
  const method = methodSelect("through-method");
  const button = h("button", { type: "button", class: "primary", id: "undersample", disabled: true, title: "Reconstructs the scan as if only the points of this mask had been measured", onclick: () => void submit() }, `Undersample scan …${design.through.slice(-5)}`);

  let isSubmitting = false; // a preview that arrives meanwhile does not enable the button
  async function submit() {
    isSubmitting = button.disabled = true;
    try {
      const mask = await api.post("/masks", arrangementOf(design));
      const created = await api.post("/reconstructions", throughBody(design.through, mask.id, method.value), { headers: idempotencyHeaders() });
      location.assign(urlOf(`/reconstructions/${created.id}`));
    } catch (error) {
      replace(messages, ...errorElements(error));
      isSubmitting = button.disabled = false;
    }
  }

  return { elements: [method, button], enable: (isEnabled) => (button.disabled = isSubmitting || !isEnabled) };
}
