// @ts-check
// A few panels of which one is seen; arrows go from one to the next.
import { h } from "../dom.js";

/**
 * @param {[string, HTMLElement, (() => unknown) | null][]} panels name, what it holds, what to do when it is first seen
 * @returns {HTMLElement}
 */
export function tabs(panels) {
  const seen = new Set();
  const bodies = panels.map(([name, element]) => h("div", { role: "tabpanel", id: `panel-${name}`, "aria-labelledby": `tab-${name}`, tabindex: 0 }, element));
  const buttons = panels.map(([name], n) => h("button", {
    type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}`, dataset: { tab: name }, onclick: () => choose(n),
  }, name));
  /** @param {number} chosen */
  function choose(chosen) {
    bodies.forEach((body, n) => (body.hidden = n !== chosen));
    buttons.forEach((button, n) => {
      button.setAttribute("aria-selected", String(n === chosen));
      button.tabIndex = n === chosen ? 0 : -1;
    });
    const [name, , act] = panels[chosen];
    if (!seen.has(name)) act?.();
    seen.add(name);
  }
  const list = h("div", { role: "tablist", class: "tabs", "aria-label": "About the volume" }, ...buttons);
  list.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!way) return;
    const now = buttons.findIndex((button) => button.tabIndex === 0);
    const next = (now + way + buttons.length) % buttons.length;
    choose(next);
    buttons[next].focus();
    event.preventDefault();
  });
  choose(0);
  return h("div", { class: "tabbed" }, list, ...bodies);
}
