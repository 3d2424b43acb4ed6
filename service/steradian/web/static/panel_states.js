// @ts-check
// States of a panel: empty with the next step, loading, failed with the remedy.
import { Problem } from "./api.js";
import { h, replace } from "./dom.js";

/**
 * @param {Element} panel @param {string} title
 * @param {string} [text] next step
 * @param {...Node} actions
 */
export function showEmpty(panel, title, text, ...actions) {
  replace(panel, h("div", { class: "state" }, h("strong", null, title), text ? h("span", null, text) : null, ...actions));
}

/** @param {Element} panel @param {string} [text] */
export function showLoading(panel, text = "loading …") {
  replace(panel, h("div", { class: "state loading", role: "status" }, text));
}

/**
 * @param {Element} panel @param {unknown} error
 * @param {() => void} [retryAction] of the button
 */
export function showError(panel, error, retryAction) {
  const retry = retryAction ? h("button", { type: "button", onclick: retryAction }, "Try again") : null;
  replace(panel, h("div", { class: "state failed", role: "alert" }, ...errorElements(error), retry));
}

/** Create elements that describe an error and the errors of its fields. @param {unknown} error @returns {HTMLElement[]} */
export function errorElements(error) {
  if (error instanceof Problem) {
    const parts = [h("strong", null, error.title || "Refused"), h("span", null, error.detail || error.message)];
    for (const fieldError of error.errors) if (fieldError.detail !== error.detail) parts.push(h("span", null, fieldError.detail));
    return parts;
  }
  const text = error instanceof TypeError ? "the service does not answer" : String(error instanceof Error ? error.message : error);
  return [h("strong", null, "Operation failed"), h("span", null, text)];
}
