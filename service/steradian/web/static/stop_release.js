// @ts-check
// Release the emergency stop: a person says why, and only what stood when it was asked is released.
import { api, Problem } from "./api.js";
import { askWhy } from "./reason_dialog.js";
import { look, seen } from "./scanner_status.js";

/** @param {string} name */
const stopOf = (name) => `/scanners/${encodeURIComponent(name)}/emergency-stop`;

/**
 * Ask why, then release what stands on each scanner and no later press.
 * @param {[string, any][]} pressed scanners and their stops
 * @param {(name: string) => void} released told of each scanner whose stop is released
 */
export function release(pressed, released) {
  askWhy({
    title: "Release the emergency stop",
    text: "Look at the scanner first: is it safe that a laser fires? No scan begins by itself.",
    label: "Why it may be released",
    name: "Release",
    act: async (reason) => {
      const left = await Promise.all(pressed.map((one) => releaseOne(one, reason, released)));
      void look(); // some may have been released
      return left.filter(Boolean).join("; ");
    },
  });
}

/** Release a scanner's stop; returns why it stands yet, or nothing. @param {[string, any]} of scanner and stop @param {string} reason @param {(name: string) => void} released */
async function releaseOne([name, { number }], reason, released) {
  try {
    await api.remove(`${stopOf(name)}?${new URLSearchParams({ number, reason })}`, { urgent: true });
    released(name);
    return "";
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return ""; // it was retired meanwhile
    const why = error instanceof Error ? error.message : String(error);
    return seen().scanners.length > 1 ? `${name}: ${why}` : why;
  }
}
