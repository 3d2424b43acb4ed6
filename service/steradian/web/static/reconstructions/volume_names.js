// @ts-check
// Names of volumes by wavelength, frame and time.
import { figure, wavelengthText } from "../units.js";

/** Return the name of a volume of a series. @param {any} frame of a report */
export function frameText({ name, numbers, excitation_m: light, time_s: time }) {
  if (name) return name;
  const parts = [light ? wavelengthText(light) : "", numbers?.length > 1 ? `mean of ${numbers.length} frames` : `frame ${numbers?.[0] ?? "?"}`];
  return [...parts, time === null || time === undefined ? "" : `${figure(time)} s`].filter(Boolean).join(", ");
}

/** Return the name of the volume of a reconstruction of one frame; empty for a scan of one frame. @param {any} one */
export const singleText = (one) =>
  [one.wavelength ? wavelengthText(one.wavelength) : "", one.frame === null || one.frame === undefined ? "" : `frame ${one.frame}`, one.average ? "mean of the frames" : ""].filter(Boolean).join(", ");

/** Return the name of a volume of a reconstruction, of a series the one of an index; its wavelength alone, if no other volume has it. @param {any} one @param {number | null} index */
export function volumeName(one, index) {
  const frames = one.report?.frames ?? [];
  const lights = new Set(frames.map((/** @type {any} */ frame) => frame.excitation_m && wavelengthText(frame.excitation_m)));
  if (frames.length > 1 && lights.size === frames.length && !lights.has(null)) return wavelengthText(frames[index ?? 0].excitation_m);
  return frames.length ? frameText(frames[index ?? 0]) : one.kind === "unmixing" ? "" : singleText(one);
}
