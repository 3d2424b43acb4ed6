// @ts-check
// Tab panels.
import { h } from "../dom.js";

/**
 * @param {[string, HTMLElement, (() => unknown) | null, string?][]} panels name, content, action when first opened, label if not the name
 * @returns {HTMLElement}
 */
export function tabs(panels) {
  const opened = new Set();
  const bodies = panels.map(([name, element]) => h("div", { role: "tabpanel", id: `panel-${name}`, "aria-labelledby": `tab-${name}`, tabindex: 0 }, element));
  const buttons = panels.map(([name, , , label], n) => h("button", {
    type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}`, dataset: { tab: name }, onclick: () => selectTab(n),
  }, label ?? name));
  /** @param {number} selectedIndex */
  function selectTab(selectedIndex) {
    bodies.forEach((body, n) => (body.hidden = n !== selectedIndex));
    buttons.forEach((button, n) => {
      button.setAttribute("aria-selected", String(n === selectedIndex));
      button.tabIndex = n === selectedIndex ? 0 : -1;
    });
    const [name, , act] = panels[selectedIndex];
    if (!opened.has(name)) act?.();
    opened.add(name);
  }
  const list = h("div", { role: "tablist", class: "tabs", "aria-label": "Volume panels" }, ...buttons);
  list.addEventListener("keydown", (event) => {
    const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!direction) return;
    const selected = buttons.findIndex((button) => button.tabIndex === 0);
    const nextIndex = (selected + direction + buttons.length) % buttons.length;
    selectTab(nextIndex);
    buttons[nextIndex].focus();
    event.preventDefault();
  });
  selectTab(0);
  return h("div", { class: "tabbed" }, list, ...bodies);
}
