// @ts-check
// Labels and transitions of scan states.
import { count } from "../units.js";

/** Labels of the states. */
export const STATE_LABELS = /** @type {Record<string, string>} */ ({
  queued: "queued", arming: "arming", running: "running", pausing: "pausing", paused: "paused", stopping: "stopping",
  recovering: "reconnecting to the scanner", completing: "completing", aborting: "aborting", interrupted: "interrupted",
  complete: "complete", partial: "stopped, partial data", aborted: "aborted", failed: "failed",
});

export const FINAL_STATES = new Set(["complete", "partial", "aborted", "failed"]);
/** Desired states that a user can request in each state. @type {Record<string, string[]>} */
export const TRANSITIONS = {
  queued: ["stopped"], arming: ["stopped"], running: ["paused", "stopped"], recovering: ["stopped"],
  paused: ["running", "stopped"], interrupted: ["running", "stopped"],
};

/** Describe the data that a stop keeps. @param {number} stored @param {number} total @param {number} toCome points of further stages */
export function stopSummary(stored, total, toCome = 0) {
  if (!stored) return "Stop keeps no data: no A-line is stored yet.";
  if (toCome && stored === total) return `Stop keeps the ${count(stored)} A-lines for reconstruction, without the focus.`;
  return `Stop keeps ${count(stored)} of ${count(total)} A-lines for reconstruction; points not yet measured need another scan. A paused scan can be resumed.`;
}
