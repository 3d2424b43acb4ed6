// @ts-check
// Release of the emergency stop with a reason; releases only the stops that were active when the dialog opened.
import { api, Problem } from "./api.js";
import { openReasonDialog } from "./reason_dialog.js";
import { pollScanners, lastStatus } from "./scanner_status.js";

/** @param {string} name */
const stopPath = (name) => `/scanners/${encodeURIComponent(name)}/emergency-stop`;

/**
 * Ask for a reason, then release the given stops and no later ones.
 * @param {[string, any][]} activeStops scanners and their stops
 * @param {(name: string) => void} released called with each scanner whose stop was released
 */
export function openReleaseDialog(activeStops, released) {
  openReasonDialog({
    title: "Release the emergency stop",
    text: "Check the scanner first: is it safe to fire the laser? No scan starts automatically.",
    label: "Reason for the release",
    name: "Release",
    act: async (reason) => {
      const errors = await Promise.all(activeStops.map((one) => releaseStop(one, reason, released)));
      void pollScanners(); // update also after a partial failure
      return errors.filter(Boolean).join("; ");
    },
  });
}

/** Release the stop of one scanner; return the reason of a failure, or an empty string. @param {[string, any]} of scanner and stop @param {string} reason @param {(name: string) => void} released */
async function releaseStop([name, { number }], reason, released) {
  try {
    await api.remove(`${stopPath(name)}?${new URLSearchParams({ number, reason })}`, { urgent: true });
    released(name);
    return "";
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return ""; // decommissioned meanwhile
    const message = error instanceof Error ? error.message : String(error);
    return lastStatus().scanners.length > 1 ? `${name}: ${message}` : message;
  }
}
