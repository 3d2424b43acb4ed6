// @ts-check
// Formatting of quantities with unit and significant digits.
import { copyText, h } from "./dom.js";

const NONE = "–";
const NBSP = "\u00a0"; // keeps the unit on the line of its value

/** Replace the minus of a number's text by the typographic one, which zero does not have. @param {string} text */
const withMinus = (text) => text.replace(/^-(?=[0.]*$)/, "").replace("-", "−");

/** Format a number with fixed decimals. @param {number} value @param {number} decimals */
export const signed = (value, decimals) => withMinus(value.toFixed(decimals));

/** Format a number with as many decimals as it has, at most some significant digits. @param {number} value @param {number} [digits] */
export const decimalText = (value, digits = 7) => (Number.isFinite(value) ? withMinus(String(Number(value.toPrecision(digits)))) : "");

/** Unit of the values of an image. */
export const PRESSURE = `arb.${NBSP}u.`;

/** @param {number} value @param {number} digits significant ones */
export function figure(value, digits = 3) {
  if (!Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    return `${withMinus(mantissa)} × 10${superscript(Number(exponent))}`;
  }
  const decimals = size === 0 ? 0 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return withMinus(Number(value.toFixed(Math.min(decimals, 12))).toLocaleString("en", { maximumFractionDigits: 12 }));
}

/** @param {number} exponent */
function superscript(exponent) {
  return [...String(exponent)].map((character) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(character)] ?? "⁻").join("");
}

/** @param {[number, string][]} steps descending @returns {(value: number | null | undefined, digits?: number) => string} */
function unitFormatter(steps) {
  return (value, digits = 3) => {
    if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
    const size = Math.abs(value) * (1 + 1e-9);
    const [factor, unit] = steps.find(([one]) => size >= one) ?? (value === 0 ? steps[0] : steps[steps.length - 1]);
    return `${figure(value / factor, digits)}${NBSP}${unit}`;
  };
}

export const length = unitFormatter([[1, "m"], [1e-3, "mm"], [1e-6, "µm"], [1e-9, "nm"]]);
export const frequency = unitFormatter([[1e9, "GHz"], [1e6, "MHz"], [1e3, "kHz"], [1, "Hz"]]);
export const bytes = unitFormatter([[1e12, "TB"], [1e9, "GB"], [1e6, "MB"], [1e3, "kB"], [1, "B"]]);
export const shortTime = unitFormatter([[1, "s"], [1e-3, "ms"], [1e-6, "µs"], [1e-9, "ns"]]);

export const area = unitFormatter([[1e-6, "mm²"]]);

/** Format a value of an image: initial pressure in arbitrary units. @param {number} value @param {number} [digits] */
export function pressure(value, digits = 3) {
  return Number.isFinite(value) ? `${figure(value, digits)}${NBSP}${PRESSURE}` : NONE;
}

/** Format a length in millimetres, for coordinates. @param {number} metres @param {number} [decimals] */
export function mm(metres, decimals = 2) {
  return Number.isFinite(metres) ? `${signed(metres * 1e3, decimals)}${NBSP}mm` : NONE;
}

/** Return a wavelength in nanometres, to four digits. @param {number} metres */
export const nanometres = (metres) => Number((1e9 * metres).toPrecision(4));

/** Format a wavelength. @param {number} metres */
export const wavelengthText = (metres) => `${nanometres(metres)} nm`;

/** @param {number | null | undefined} value */
export function count(value) {
  return value === null || value === undefined ? NONE : withMinus(value.toLocaleString("en"));
}

/** @param {number | null | undefined} share @param {number} [decimals] */
export function percent(share, decimals = 0) {
  return share === null || share === undefined || !Number.isFinite(share) ? NONE : `${signed(100 * share, decimals)}${NBSP}%`;
}

/** @param {number | null | undefined} radians */
export function degrees(radians) {
  return radians === null || radians === undefined ? NONE : `${signed((radians * 180) / Math.PI, 0)}°`;
}

/** Format a duration: 0.42 s, 38 s, 4 min 05 s, 2 h 10 min. @param {number | null | undefined} seconds */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return NONE;
  if (seconds < 10) return shortTime(seconds, 2);
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole}${NBSP}s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
  const minutes = Math.round(whole / 60);
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** Format the local date and time of a record: 2026-11-29 12:05, of steps that follow each other with seconds. @param {string | Date | null | undefined} when @param {boolean} [withSeconds] */
export function formatDate(when, withSeconds = false) {
  if (!when) return NONE;
  const then = new Date(when);
  const [month, day] = [then.getMonth() + 1, then.getDate()].map((part) => String(part).padStart(2, "0"));
  return `${then.getFullYear()}-${month}-${day} ${then.toTimeString().slice(0, withSeconds ? 8 : 5)}`;
}

/** Format the local time of what happens now: 12:05:30; with the date if it is not today. @param {string | Date | null | undefined} when */
export function formatTime(when) {
  if (!when) return NONE;
  const then = new Date(when);
  return then.toDateString() === new Date().toDateString() ? then.toTimeString().slice(0, 8) : formatDate(when);
}

/** Create an element with a shortened identifier and a copy button. @param {string} id @param {string} [href] */
export function identifierElement(id, href) {
  const short = id.length > 12 ? `${id.slice(0, 5)}…${id.slice(-5)}` : id;
  const button = h("button", { type: "button", class: "quiet copy", title: `Copy ${id}`, "aria-label": `Copy ${id}`, onclick: () => copyText(button, id) }, "copy");
  return h("span", { class: "id", title: id }, href ? h("a", { href }, short) : short, button);
}

/** Return a text as a sentence. @param {string} text */
export const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
