// @ts-check
// Details of a named measurement: figures of the service, profile in the plane that was measured.
import { h, s } from "../dom.js";
import { PRESSURE, count, decimalText, figure } from "../units.js";
import { PLANES, axisIndex, voxelIndex } from "./volume_data.js";
import { profile } from "./measurements.js";
import { correctedText, widthText } from "./measurement_table.js";
import { formatMm, mmText } from "./panes.js";
import { lengthOf, ticks } from "./scale.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./measurement_store.js").Measured} Measured */
/** @typedef {[string, string, string?, number?, string?]} Row name, text, key and value for scripts, description */

const [WIDTH, HEIGHT, LEFT, TOP, BOTTOM] = [264, 154, 40, 22, 20];
const WIDTH_TEXT = "Full width at half maximum";
const inMm = (/** @type {[number, number]} */ place) => /** @type {[number, number]} */ (place.map((metres) => 1e3 * metres));

/** @param {VolumeState} stage @param {SliceView[]} views @param {Measured} item @param {...(Node | null)} more */
export function measurementDetails(stage, views, item, ...more) {
  const { kind, name, axis } = item.measurement;
  const view = views.find((one) => one.axis === axis);
  const isShown = view?.plane && isPlaneShown(stage, item);
  const isWide = kind === "profile" && item.figures.width !== null;
  return h("section", { dataset: { result: kind } }, h("h3", null, `${name}, ${PLANES[axis].join("–")}${slabText(item)}`),
    isShown && view.plane && kind === "profile" ? chart(stage, view.plane, item) : null,
    isShown ? null : h("button", { type: "button", class: "quiet", onclick: () => showPlane(stage, item) }, "Show the plane of this measurement"),
    figureList(rowsOf(stage, item)),
    isWide ? h("p", { class: "dim small" }, item.figures.repeatability === null ? "Draw a longer line to estimate the noise and the repeatability of the width."
      : "± is the repeatability under noise, not the accuracy: it does not contain the point spread of the mask, which widens the image.") : null,
    ...more);
}

/** @param {VolumeState} stage @param {Measured} item @returns {Row[]} */
function rowsOf(stage, item) {
  const { figures, measurement: { kind, axis, start, end } } = item;
  const text = (/** @type {string} */ key) => (figures[key] === null ? "–" : stage.valueText(/** @type {number} */ (figures[key])));
  const row = (/** @type {string} */ title, /** @type {string} */ key, shownKey = key) => /** @type {Row} */ ([title, text(key), shownKey, Number(figures[key])]);
  if (kind === "region") return [row("Mean", "value", "mean"), row("Standard deviation", "deviation"), ["Minimum, maximum", `${text("minimum")}, ${text("maximum")}`],
    ["Area", `${figure(1e6 * Number(figures.size))} mm², ${count(Number(figures.voxels))} voxels`]];
  if (kind === "contrast") return [["Contrast-to-noise", figures.value === null ? item.reason : figure(figures.value), "contrast", Number(figures.value)], row("Mean", "mean"),
    row("Mean of the background", "background_mean"), row("Deviation of the background", "background_deviation")];
  if (kind === "point") return [row("Value", "value"), ["Position", PLANES[axis].map((one, n) => `${one} ${mmText(1e3 * start[n])}`).join(", ")]];
  const length = end ? 1e3 * Math.hypot(end[0] - start[0], end[1] - start[1]) : 0;
  return [["Width", widthText(item), "fwhm", 1e3 * Number(figures.width), WIDTH_TEXT], ...(figures.width === null ? [] : [row("Peak above base", "value"), row("Base", "base")]),
    ["Length", lengthOf(length)], ...correctionRows(item)];
}

/** Return the point spread and the corrected diameter, in the slice through the peak. @param {Measured} item @returns {Row[]} */
function correctionRows({ measurement: { axis }, ends, correction }) {
  if (!correction) return [];
  const length = (/** @type {number | null} */ metres) => (metres === null ? "–" : lengthOf(1e3 * metres));
  const shape = correction.corrected === null ? "" : `, as a ${correction.shape}`;
  return [[`Width, slice at ${axis} ${mmText(1e3 * ends[0][axisIndex(axis)])}`, length(correction.fwhm)], ["Point spread", length(correction.point_spread)],
    ["Corrected width", `${correctedText(correction)}${shape}${correction.reason ? `: ${correction.reason}` : ""}`]];
}

/** @param {Measured} item */
function slabText({ measurement: { axis, slab } }) {
  if (!slab) return "";
  const [first, last] = inMm(slab);
  return first === last ? `, ${axis} ${mmText(first)}` : `, maximum of ${axis} ${formatMm(first)} to ${mmText(last)}`;
}

/** Return the voxels across the plane that were measured. @param {VolumeState} stage @param {Measured} item */
function rangeOf({ source }, { measurement: { axis, slab } }) {
  const [from, last] = slab ? inMm(slab).map((mm) => voxelIndex(source, axis, mm)) : [0, 0];
  return { from, to: last + 1 };
}

/** Return whether the views show the plane that was measured. @param {VolumeState} stage @param {Measured} item */
export function isPlaneShown(stage, item) {
  const { axis, index } = item.measurement;
  const [range, shown] = [rangeOf(stage, item), stage.range(axis)];
  return index === stage.source.index && (stage.source.flat || (range.from === shown.from && range.to === shown.to));
}

/** @param {VolumeState} stage @param {Measured} item */
function showPlane(stage, item) {
  const { axis, slab: measured, index } = item.measurement;
  const n = axisIndex(axis);
  const { from, to } = rangeOf(stage, item);
  const at = /** @type {import("./view_state.js").Triple} */ ([...stage.position]);
  const slab = /** @type {import("./view_state.js").Triple} */ ([...stage.view.slab]);
  if (measured) at[n] = (inMm(measured)[0] + inMm(measured)[1]) / 2;
  slab[n] = to - from === 1 ? 0 : to - from >= stage.source.shape[n] - 1 || to === stage.source.shape[n] ? Infinity : (to - from) * stage.source.spacing[n];
  stage.store.change({ at, slab, ...(index === null ? {} : { index }) });
}

/** Draw the profile with its half-maximum level. @param {VolumeState} stage @param {import("./measurements.js").Plane} plane @param {Measured} item */
function chart(stage, plane, { measurement: { start, end }, figures }) {
  const { distances, values } = profile(plane, inMm(start), inMm(end ?? start));
  if (!values.length) return null;
  const [low, high] = [Math.min(...values, 0), Math.max(...values)];
  const last = distances[distances.length - 1] || 1;
  const x = (/** @type {number} */ mm) => LEFT + ((WIDTH - LEFT - 30) * mm) / last;
  const y = (/** @type {number} */ value) => HEIGHT - BOTTOM - ((HEIGHT - BOTTOM - TOP) * (value - low)) / (high - low || 1);
  const [left, right] = [1e3 * Number(figures.left), 1e3 * Number(figures.right)];
  const half = y(Number(figures.base) + Number(figures.value) / 2);
  return s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "profile", role: "img", "aria-label": "Profile along the line" },
    ticks(0, last, 5).map((mm) => s("text", { x: x(mm), y: HEIGHT - 5, "text-anchor": "middle" }, decimalText(mm))),
    s("text", { x: WIDTH, y: HEIGHT - 5, "text-anchor": "end" }, "mm"), s("text", { x: 0, y: 10 }, stage.isMaps ? "" : PRESSURE),
    [low, high].map((value) => s("text", { x: LEFT - 4, y: y(value) + 4, "text-anchor": "end" }, Math.abs(value) < 5e-3 * (high - low) ? "0" : figure(value, 2))),
    s("path", { class: "axis", d: `M${LEFT} ${TOP - 4}V${HEIGHT - BOTTOM}H${WIDTH}` }),
    figures.width === null ? null : s("path", { class: "width", d: `M${x(left)} ${half}H${x(right)}M${x(left)} ${half - 5}v10M${x(right)} ${half - 5}v10` }),
    s("path", { class: "curve", d: [...values].map((value, n) => `${n ? "L" : "M"}${x(distances[n]).toFixed(1)} ${y(value).toFixed(1)}`).join("") }));
}

/** @param {Row[]} rows */
export function figureList(rows) {
  return h("dl", { class: "figures" }, rows.flatMap(([name, text, key, value, description]) => [
    h("dt", { title: description || null }, name), h("dd", { dataset: key ? { figure: key, value: String(value) } : {} }, text)]));
}
