// @ts-check
// Colour palettes for points in classes, with a contrast of at least 3:1 to the page; reversed in the light theme.
import { theme } from "./theme.js";
import { colourTable } from "./volume/colours.js";

/** @param {import("./volume/colours.js").MapName} name @param {number} count @returns {string[]} */
export function palette(name, count) {
  const colours = colourTable(name);
  const dark = theme() === "dark";
  return Array.from({ length: count }, (_, n) => {
    const share = n / Math.max(1, count - 1);
    const pixel = colours[Math.round(255 * (dark ? 0.4 + 0.6 * share : 0.6 * (1 - share)))];
    return `rgb(${pixel & 255} ${(pixel >> 8) & 255} ${(pixel >> 16) & 255})`;
  });
}
