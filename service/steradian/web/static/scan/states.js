// @ts-check
// The states of a scan, in words.
import { count } from "../units.js";

/** States in words, and whether they are faults. */
export const STATE_LABELS = /** @type {Record<string, string>} */ ({
  queued: "waits", arming: "begins", running: "runs", pausing: "is being paused", paused: "paused", stopping: "is being stopped",
  recovering: "finds its scanner again", completing: "ends", aborting: "is being ended at once", interrupted: "interrupted",
  complete: "complete", partial: "stopped, part is kept", aborted: "ended at once", failed: "failed",
});

export const FINAL_STATES = new Set(["complete", "partial", "aborted", "failed"]);
/** What a person can have a scan do in a state. @type {Record<string, string[]>} */
export const TRANSITIONS = {
  queued: ["stopped"], arming: ["stopped"], running: ["paused", "stopped"], recovering: ["stopped"],
  paused: ["running", "stopped"], interrupted: ["running", "stopped"],
};

/** What stopping would keep. @param {number} stored @param {number} total */
export function stopSummary(stored, total) {
  if (!stored) return "Stop keeps nothing: no A-line is stored yet.";
  return `Stop keeps ${count(stored)} of ${count(total)} A-lines, which can be reconstructed; the others take a scan of their own. Pause can be resumed.`;
}
