// @ts-check
// Dark and light theme: that of the system until the user selects one.
import { byId } from "./dom.js";

const root = document.documentElement;
const system = matchMedia("(prefers-color-scheme: light)");

/** @returns {"dark" | "light"} */
export function theme() {
  const stored = root.dataset.theme;
  return stored === "dark" || stored === "light" ? stored : system.matches ? "light" : "dark";
}

/** Return the value of a CSS custom property in the current theme, for canvases and charts. @param {string} name */
export function colour(name) {
  const probe = document.createElement("i");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const value = getComputedStyle(probe).color;
  probe.remove();
  return value;
}

/** Subscribe to changes of the theme. @param {() => void} act */
export function onTheme(act) {
  document.addEventListener("steradian:theme", act);
}

export function startTheme() {
  const button = byId("theme");
  const show = () => {
    button.textContent = theme() === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", `Change to the ${theme() === "dark" ? "light" : "dark"} theme`);
    document.dispatchEvent(new CustomEvent("steradian:theme"));
  };
  button.addEventListener("click", () => {
    root.dataset.theme = theme() === "dark" ? "light" : "dark";
    try {
      localStorage.setItem("steradian.theme", root.dataset.theme);
    } catch {
      // storage is not available: the selection lasts for this page
    }
    show();
  });
  system.addEventListener("change", show);
  show();
}
