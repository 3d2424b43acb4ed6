// @ts-check
// Text fields of numbers: shown with a typographic minus, which browsers' number fields do not accept.
import { h } from "./dom.js";
import { decimalText } from "./units.js";

/** Create a field of a number; what is no number is invalid. @param {import("./dom.js").Props} props */
export function decimalInput(props) {
  const input = h("input", { type: "text", inputmode: "decimal", autocomplete: "off", ...props });
  input.addEventListener("input", () => check(input));
  return input;
}

/** Return the number in a field; NaN if there is none. @param {HTMLInputElement} input */
export function decimalOf(input) {
  const text = input.value.trim().replace("−", "-").replace(",", ".");
  return text === "" ? NaN : Number(text);
}

/** Show a number, unless the user is typing one. @param {HTMLInputElement} input @param {number} value @param {number} [digits] significant ones */
export function showDecimal(input, value, digits = 7) {
  if (input === document.activeElement) return;
  input.value = decimalText(value, digits);
  check(input);
}

/** @param {HTMLInputElement} input */
const check = (input) => input.setCustomValidity(Number.isFinite(decimalOf(input)) ? "" : "Enter a number.");
