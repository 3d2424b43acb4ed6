// @ts-check
// Release the emergency stop: a person says why, and only what stood when it was asked is released.
import { api, Problem } from "./api.js";
import { openReasonDialog } from "./reason_dialog.js";
import { pollScanners, lastStatus } from "./scanner_status.js";

/** @param {string} name */
const stopPath = (name) => `/scanners/${encodeURIComponent(name)}/emergency-stop`;

/**
 * Ask why, then release what stands on each scanner and no later press.
 * @param {[string, any][]} activeStops scanners and their stops
 * @param {(name: string) => void} released told of each scanner whose stop is released
 */
export function openReleaseDialog(activeStops, released) {
  openReasonDialog({
    title: "Release the emergency stop",
    text: "Check the scanner first: is it safe to fire the laser? No scan starts automatically.",
    label: "Reason for the release",
    name: "Release",
    act: async (reason) => {
      const errors = await Promise.all(activeStops.map((one) => releaseStop(one, reason, released)));
      void pollScanners(); // some may have been released
      return errors.filter(Boolean).join("; ");
    },
  });
}

/** Release a scanner's stop; returns why it stands yet, or nothing. @param {[string, any]} of scanner and stop @param {string} reason @param {(name: string) => void} released */
async function releaseStop([name, { number }], reason, released) {
  try {
    await api.remove(`${stopPath(name)}?${new URLSearchParams({ number, reason })}`, { urgent: true });
    released(name);
    return "";
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return ""; // it was retired meanwhile
    const message = error instanceof Error ? error.message : String(error);
    return lastStatus().scanners.length > 1 ? `${name}: ${message}` : message;
  }
}
