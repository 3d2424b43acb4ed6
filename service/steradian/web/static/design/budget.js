// @ts-check
// Pulse budget of a design: expected contrast of a vessel over points × averages, with a split that can be dragged.
import { api } from "../api.js";
import { h, replace, s } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { count, duration, length, percent, signed } from "../units.js";

/** @typedef {import("./fields.js").Design} Design */
/** @typedef {{points: number, averages: number, seconds: number, contrast_db: number, side_lobes_db: number | null, width: number | null, width_scatter: number | null, resolution: number | null, usable: boolean, proposed: boolean}} Split */

/** Arrangements that are split. */
const SPLIT_ARRANGEMENTS = new Set(["equi-steradian", "grid", "hexagonal", "poisson-disc", "random"]);
const PLOT = { width: 460, height: 190, left: 44, right: 12, top: 10, bottom: 34 };
const SEEDED = new Set(["poisson-disc", "random"]);
const SEED = 0; // of the predicted points
const MINUTE = 60;
const RECENT = 50; // scans offered for the noise

/**
 * Create the panel of the pulse budget.
 * @param {HTMLElement} host @param {Design} design changed in place @param {() => void} changed
 */
export function budgetPanel(host, design, changed) {
  const fields = { minutes: number("budget-minutes", 15, 0.01), vessel: number("budget-vessel", 150, 10), noise: number("budget-noise", 20, -60) };
  const source = h("select", { id: "budget-scan", onchange: () => showSource() }, h("option", { value: "" }, "typed in"));
  const propose = h("button", { type: "button", onclick: () => void request() }, "Propose");
  const result = h("div", { class: "budget-result" });
  const noiseField = labelled("Signal-to-noise of one pulse (dB)", fields.noise, "Peak of the strongest A-line over the noise's standard deviation, of one pulse");
  const panel = h("section", { class: "panel budget", "data-steradian": "design-budget", "aria-label": "Pulse budget" },
    h("h2", null, "Pulse budget"),
    h("div", { class: "row" },
      labelled("Time (min)", fields.minutes, "Duration of the scan; the pulse rate is that of the plan"),
      labelled("Vessel (µm)", fields.vessel, "Diameter of a vessel at the point of interest, parallel to the film"),
      labelled("Noise", source, "Typed in, or measured in an earlier scan of a similar object"), noiseField, propose),
    result);
  host.append(panel);
  void loadScans();
  let showUse = () => {}; // whether the design has the chosen split

  /** @type {AbortController | null} */
  let running = null;
  /** @type {AbortController | null} of the iterative image */
  let iterating = null;

  function showSource() {
    noiseField.hidden = source.value !== "";
  }

  async function loadScans() {
    const { items } = await api.get(`/scans?limit=${RECENT}`).catch(() => ({ items: [] }));
    const options = items.map((/** @type {any} */ scan) => h("option", { value: scan.id }, ["measured in", scan.labels?.sample, scan.id.slice(0, 8)].filter(Boolean).join(" ")));
    source.append(...options);
  }

  /** Return the request of the API. */
  function body() {
    const { mask, plan } = design;
    return {
      arrangement: design.arrangement, duration: Number(fields.minutes.value) * MINUTE, pulse_rate: plan.pulse_rate,
      aperture: mask.aperture, depth: mask.depth, offset: [mask.x, mask.y], vessel: Number((Number(fields.vessel.value) * 1e-6).toPrecision(12)),
      sampling_interval: plan.sampling_interval, sound_speed: plan.sound_speed,
      ...(source.value ? { scan_id: source.value } : { noise: Number(fields.noise.value) }),
    };
  }

  async function request() {
    if (running) {
      running.abort();
      return;
    }
    if (!SPLIT_ARRANGEMENTS.has(design.arrangement)) {
      replace(result, h("p", { class: "caption" }, "Choose another arrangement: equi-steradian, grid, hexagonal, Poisson disc or random."));
      return;
    }
    running = new AbortController();
    iterating?.abort();
    propose.textContent = "Stop";
    replace(result, h("p", { class: "caption dim", role: "status" }, "simulating a vessel …"));
    const asked = body();
    try {
      show(await api.post("/designs/budget", asked, { signal: running.signal }), asked);
    } catch (error) {
      replace(result, running.signal.aborted ? null : h("div", { class: "state failed", role: "alert" }, ...errorElements(error)));
    } finally {
      running = null;
      propose.textContent = "Propose";
    }
  }

  /** @param {any} budget @param {any} asked */
  function show(budget, asked) {
    const splits = /** @type {Split[]} */ (budget.splits);
    const text = h("p", { class: "caption", "aria-live": "polite" });
    const iterative = h("p", { class: "caption dim" });
    const choose = (/** @type {number} */ n) => {
      iterating?.abort();
      text.textContent = splitText(splits[n], budget);
      use.onclick = () => take(n);
      use.textContent = `Use ${productText(splits[n])}`;
      chosen = splits[n];
      showUse();
      replace(iterative, h("button", { type: "button", onclick: () => {
        iterating = new AbortController();
        void simulateIterative(iterative, asked, splits[n], iterating.signal);
      } }, "Simulate its iterative image"));
    };
    const take = (/** @type {number} */ n) => {
      if (JSON.stringify(body()) !== JSON.stringify(asked)) {
        iterating?.abort();
        replace(iterative, "The design has changed since: propose again.");
        return;
      }
      adopt(splits[n]);
      changed();
    };
    const use = h("button", { type: "button" });
    const state = h("strong", { role: "status" });
    let chosen = splits[0];
    showUse = () => (state.textContent = isAdopted(chosen) ? "The design has these points." : "Not in the design yet: figures above and Scan this are of the form.");
    const first = Math.max(0, splits.findIndex(({ proposed }) => proposed));
    const plot = splitPlot(splits, first, choose, take);
    replace(result, h("p", { class: "caption" }, `${count(budget.pulses)} pulses of ${signed(budget.noise_db, 1)} dB signal-to-noise each. All points × averages fit into them. Drag the point, use the arrow keys, or press Use … to set points and averages of the design.`), plot, h("p", { class: "caption dim" }, legendText(splits)), text, h("div", { class: "row below" }, use, state), iterative);
    choose(first);
  }

  /** Return whether the form has points and averages of a split. @param {Split} split */
  function isAdopted({ points, averages }) {
    const { mask, plan } = design;
    return plan.averages === averages && (design.arrangement === "grid" ? mask.side ** 2 === points : mask.count === points);
  }

  /** Set points and averages of the form, and the seed of the predicted points. @param {Split} split */
  function adopt({ points, averages }) {
    design.plan.averages = averages;
    if (design.arrangement === "grid") {
      design.mask.side = Math.round(Math.sqrt(points));
      design.mask.interval = Math.floor((1e9 * design.mask.aperture) / design.mask.side) / 1e9; // rounded up, the grid would not fit
    } else {
      design.mask.count = points;
      if (SEEDED.has(design.arrangement)) design.mask.seed = SEED;
    }
  }

  return { refresh: () => showUse() };
}

/** @param {{points: number, averages: number}} split */
const productText = ({ points, averages }) => `${count(points)} points × ${count(averages)} ${averages === 1 ? "average" : "averages"}`;

/** Return the legend of the plot. @param {Split[]} splits */
function legendText(splits) {
  const dotted = splits.some(({ side_lobes_db: one }) => one !== null) ? "; dotted: without noise" : "";
  const open = splits.some(({ usable }) => !usable) ? "; open points: uncertain width" : "";
  return `Contrast of the vessel over the number of points; ring: proposed${dotted}${open}.`;
}

/** Return the figures of a split as text. @param {Split} split @param {any} budget */
function splitText(split, { max_contrast_db: most }) {
  const side = split.side_lobes_db === null ? "" : ` (${signed(split.side_lobes_db, 1)} dB without noise)`;
  const contrast = split.side_lobes_db === null && split.contrast_db >= most ? `above ${most} dB` : `${signed(split.contrast_db, 1)} dB${side}`;
  const width = split.width === null ? "no width" : `width ${length(split.width)}${split.width_scatter === null ? ", often none" : ` ± ${percent(split.width_scatter, 1)}`}`;
  const resolution = split.resolution === null ? "" : `, resolution ${length(split.resolution)}`;
  return `${productText(split)}, ${duration(split.seconds)}: contrast ${contrast}, ${width}${resolution}${split.proposed ? "; proposed" : ""}`;
}

/** Simulate the iterative image of a split, which takes a minute. @param {HTMLElement} host @param {any} asked @param {Split} split @param {AbortSignal} signal of another choice */
async function simulateIterative(host, asked, split, signal) {
  replace(host, h("span", { role: "status" }, "reconstructing iteratively …"));
  try {
    const found = await api.post("/designs/budget", { ...asked, method: "iterative", averages: [split.averages] }, { signal });
    if (!signal.aborted) replace(host, `Iterative: ${splitText({ ...found.splits[0], proposed: false }, found)}`);
  } catch (error) {
    if (!signal.aborted) replace(host, ...errorElements(error));
  }
}

/**
 * Draw contrast over the number of points, logarithmic, with a slider on the chosen split.
 * @param {Split[]} splits @param {number} first @param {(n: number) => void} choose @param {(n: number) => void} adopt
 */
function splitPlot(splits, first, choose, adopt) {
  const { width, height, left, right, top, bottom } = PLOT;
  const levels = splits.flatMap(({ contrast_db: one, side_lobes_db: other }) => (other === null ? [one] : [one, other]));
  const [low, high] = [Math.min(...levels) - 2, Math.max(...levels) + 2];
  const logs = splits.map(({ points }) => Math.log(points));
  const span = logs[logs.length - 1] - logs[0] || 1;
  const x = (/** @type {number} */ n) => left + 10 + ((width - left - right - 20) * (logs[n] - logs[0])) / span;
  const y = (/** @type {number} */ level) => top + ((height - top - bottom) * (high - level)) / (high - low);
  const path = (/** @type {(split: Split) => number | null} */ value) => splits.map((split, n) => `${n ? "L" : "M"}${x(n).toFixed(1)},${y(value(split) ?? low).toFixed(1)}`).join("");
  const handle = s("g", { class: "handle", tabindex: 0, role: "slider", "aria-label": "Points of the scan", "aria-valuemin": 0, "aria-valuemax": splits.length - 1 },
    s("circle", { r: 14, class: "grip" }), s("circle", { r: 6 }));
  const plot = s("svg", { viewBox: `0 0 ${width} ${height}`, class: "trade", role: "group", "aria-label": "Contrast over the number of points" },
    s("path", { d: `M${left},${top}V${height - bottom}H${width - right}`, class: "axis" }),
    [low + 2, high - 2].map((level) => s("text", { x: left - 6, y: y(level) + 4, class: "tick end" }, `${signed(level, 0)} dB`)),
    splits.map(({ points }, n) => s("text", { x: x(n), y: height - bottom + 16, class: "tick middle" }, count(points))),
    s("text", { x: (left + width - right) / 2, y: height - 3, class: "tick middle" }, "points, logarithmic"),
    s("text", { x: left + 6, y: top + 8, class: "tick" }, "contrast"),
    splits.some(({ side_lobes_db: one }) => one !== null) ? s("path", { d: path((split) => split.side_lobes_db), class: "limit" }, s("title", null, "without noise")) : null,
    s("path", { d: path((split) => split.contrast_db), class: "contrast" }),
    splits.map((split, n) => s("circle", { cx: x(n), cy: y(split.contrast_db), r: split.proposed ? 9 : 3, class: split.proposed ? "proposed" : split.usable ? "split" : "split unsure" })),
    handle);

  let chosen = -1;
  const set = (/** @type {number} */ n) => {
    const next = Math.min(splits.length - 1, Math.max(0, n));
    if (next === chosen) return;
    chosen = next;
    const { points, averages, contrast_db: contrast } = splits[next];
    handle.setAttribute("transform", `translate(${x(next)} ${y(contrast)})`);
    handle.setAttribute("aria-valuenow", String(next));
    handle.setAttribute("aria-valuetext", `${productText({ points, averages })}, ${signed(contrast, 1)} dB`);
    choose(next);
  };
  const nearest = (/** @type {PointerEvent} */ event) => {
    const box = plot.getBoundingClientRect();
    const place = ((event.clientX - box.left) * width) / box.width;
    return splits.reduce((best, _, n) => (Math.abs(x(n) - place) < Math.abs(x(best) - place) ? n : best), 0);
  };
  plot.addEventListener("pointerdown", (event) => {
    plot.setPointerCapture(event.pointerId);
    set(nearest(event));
    handle.focus({ preventScroll: true });
    event.preventDefault();
  });
  plot.addEventListener("pointermove", (event) => plot.hasPointerCapture(event.pointerId) && set(nearest(event)));
  plot.addEventListener("pointerup", () => adopt(chosen));
  const steps = /** @type {Record<string, number>} */ ({ ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, Home: -splits.length, End: splits.length });
  handle.addEventListener("keydown", (event) => {
    const step = steps[/** @type {KeyboardEvent} */ (event).key];
    if (step === undefined) return;
    event.preventDefault();
    set(chosen + step);
    adopt(chosen);
  });
  set(first);
  return plot;
}

/** @param {string} id @param {number} value @param {number} least */
function number(id, value, least) {
  return h("input", { type: "number", id, value, min: least, step: "any", class: "short" });
}

/** @param {string} text @param {HTMLElement} control @param {string} help */
function labelled(text, control, help) {
  return h("label", { class: "row", for: control.id, title: help }, text, control);
}
