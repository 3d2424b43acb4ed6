// @ts-check
// The states of a panel besides full: empty with the next step, loading at its final size, failed with what to do.
import { Problem } from "./api.js";
import { h, replace } from "./dom.js";

/**
 * @param {Element} panel @param {string} title
 * @param {string} [text] what to do next
 * @param {...Node} actions
 */
export function empty(panel, title, text, ...actions) {
  replace(panel, h("div", { class: "state" }, h("strong", null, title), text ? h("span", null, text) : null, ...actions));
}

/** @param {Element} panel @param {string} [text] */
export function loading(panel, text = "loading …") {
  replace(panel, h("div", { class: "state loading", role: "status" }, text));
}

/**
 * @param {Element} panel @param {unknown} error
 * @param {() => void} [again] what the button tries
 */
export function failed(panel, error, again) {
  const retry = again ? h("button", { type: "button", onclick: again }, "Try again") : null;
  replace(panel, h("div", { class: "state failed", role: "alert" }, ...words(error), retry));
}

/** What went wrong, and what is wrong with each field. @param {unknown} error @returns {HTMLElement[]} */
export function words(error) {
  if (error instanceof Problem) {
    const parts = [h("strong", null, error.title || "Refused"), h("span", null, error.detail || error.message)];
    for (const finding of error.errors) if (finding.detail !== error.detail) parts.push(h("span", null, finding.detail));
    return parts;
  }
  const text = error instanceof TypeError ? "the service does not answer" : String(error instanceof Error ? error.message : error);
  return [h("strong", null, "This did not work"), h("span", null, text)];
}
