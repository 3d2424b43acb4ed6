// @ts-check
// Iterative image of a scan beside its direct image, with the same parameters.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { urlOf } from "../urls.js";
import { frameFields, motionFields } from "./command.js";

const NEWEST = 50; // reconstructions of a scan among which a direct image is searched
const HINT = "The iterative image is nearer to the object where sensors are few or the view is limited, and takes about seven times as long";

/**
 * Create the button that reconstructs a scan iteratively and shows both images side by side.
 * @param {string} scanId @param {HTMLElement} messages host of errors
 * @param {{direct?: any, followed?: boolean}} [options] direct: reconstruction beside which it is shown, else the newest; followed: whether a live image counts, which is of one frame
 */
export function iterativeButton(scanId, messages, { direct = null, followed = true } = {}) {
  const button = h("button", { type: "button", title: HINT, onclick: async () => {
    button.disabled = true;
    try {
      const beside = direct ?? (await directImage(scanId, followed));
      const iterative = await post({ scan_id: scanId, parameters: { ...beside.parameters, method: "iterative" }, ...frameFields(beside), ...motionFields(beside) });
      location.assign(urlOf(`/reconstructions?side=${beside.id},${iterative.id}`));
    } catch (error) {
      replace(messages, ...errorElements(error));
      button.disabled = false;
    }
  } }, direct ? "Iterative image beside it" : "Direct and iterative");
  return button;
}

/** @param {any} request */
const post = (request) => api.post("/reconstructions", request, { headers: idempotencyHeaders() });

/** Return the newest direct image of a scan, else one that is on its way, or request one. @param {string} scanId @param {boolean} followed */
async function directImage(scanId, followed) {
  const { items } = await api.get(`/reconstructions?scan_id=${scanId}&state=succeeded&state=queued&state=running&limit=${NEWEST}`);
  return items.find(isDirect(followed)) ?? items.find(isExpected) ?? post({ scan_id: scanId });
}

/** Return whether a reconstruction is a direct image of all A-lines of the scan. @param {boolean} followed */
const isDirect = (followed) => (/** @type {any} */ { kind, parameters, report }) =>
  (kind === "reconstruction" || (kind === "live" && followed)) && parameters.method !== "iterative" && Boolean(report?.shape);

/** Return whether a reconstruction will become a direct image, such as one that an earlier attempt requested. @param {any} one */
const isExpected = ({ kind, state, parameters }) => kind === "reconstruction" && state !== "succeeded" && parameters.method !== "iterative";
