// @ts-check
// Histogram of digitiser codes on a logarithmic scale, with clipped ends marked.
import { h, replace, s } from "../../dom.js";
import { count, figure } from "../../units.js";

const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP] = [420, 190, 52, 34, 8];

/** @param {HTMLElement} host @param {any} histogram of the answer */
export function showCodeHistogram(host, histogram) {
  const { edges, counts } = histogram;
  const name = histogram.kind === "codes" ? "digitiser codes" : "values";
  const maxCount = Math.max(10, ...counts);
  const decades = Math.ceil(Math.log10(maxCount));
  const span = edges[edges.length - 1] - edges[0] || 1;
  const x = (/** @type {number} */ value) => LEFT + ((WIDTH - LEFT - 8) * (value - edges[0])) / span;
  const y = (/** @type {number} */ number) => HEIGHT - BOTTOM - (number ? ((HEIGHT - BOTTOM - TOP) * (Math.log10(number) + 0.3)) / (decades + 0.3) : 0);
  const outline = counts.map((/** @type {number} */ one, /** @type {number} */ n) => `H${x(edges[n]).toFixed(1)}V${y(one).toFixed(1)}H${x(edges[n + 1]).toFixed(1)}`).join("");
  const facts = histogramFacts(histogram, name);
  const text = (/** @type {string} */ content, /** @type {any} */ props) => s("text", { class: "tick", ...props }, content);
  const levels = Array.from({ length: decades + 1 }, (_, n) => n).filter((n) => n % Math.ceil(decades / 5) === 0);
  const chart = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `Histogram of ${name}, logarithmic: ${facts.join("; ")}` },
    ...levels.flatMap((n) => [
      s("line", { class: "grid", x1: LEFT, x2: WIDTH - 8, y1: y(10 ** n), y2: y(10 ** n) }),
      text(n < 4 ? String(10 ** n) : figure(10 ** n, 1).replace("1 × ", ""), { class: "tick end", x: LEFT - 4, y: y(10 ** n) + 4 })]),
    s("path", { class: "seen", d: `M${LEFT},${HEIGHT - BOTTOM}${outline}V${HEIGHT - BOTTOM}Z` }),
    histogram.clipped_low ? s("rect", { class: "clipped", x: LEFT, y: TOP, width: 4, height: HEIGHT - BOTTOM - TOP }) : null,
    histogram.clipped_high ? s("rect", { class: "clipped", x: WIDTH - 12, y: TOP, width: 4, height: HEIGHT - BOTTOM - TOP }) : null,
    text(figure(edges[0]), { x: LEFT, y: HEIGHT - BOTTOM + 14 }),
    text(figure(edges[edges.length - 1]), { class: "tick end", x: WIDTH - 8, y: HEIGHT - BOTTOM + 14 }),
    text(`${histogram.kind === "codes" ? "code" : "value"} (samples per bin, logarithmic)`, { x: LEFT + 90, y: HEIGHT - 4 }));
  replace(host, h("h3", null, `Histogram of ${name}`), chart, h("p", { class: "dim small", dataset: { facts: "" } }, `${facts.join("; ")}.`));
}

/** @param {any} histogram @param {string} name */
function histogramFacts({ clipped_low: low, clipped_high: high, missing_codes: missing, mid_scale_offset: offset }, name) {
  const known = (/** @type {any} */ one) => one !== null && one !== undefined;
  return [
    `${count(low)} samples clipped at the low end`, `${count(high)} at the high end`,
    known(missing) ? `${count(missing)} ${name} missing between the ends` : "",
    known(offset) ? `mean ${figure(offset)} from mid-scale` : "",
  ].filter(Boolean);
}
