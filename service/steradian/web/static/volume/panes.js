// @ts-check
// The four views with what stands under each: where its slice is and how thick its slab.
import { h } from "../dom.js";
import { AXES, PLANES, at, indexOf, placeOf } from "./volume_data.js";
import { lengthOf } from "./scale.js";

/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./view_state.js").Triple} Triple */

const STEPS = 40; // of the slab's slider, between a slice and everything

/** @param {number} mm @param {number} [decimals] */
const signed = (mm, decimals = 1) => mm.toFixed(decimals).replace("-", "−");

/** As all places are told, without the unit. @param {number} mm */
export const inMm = (mm) => signed(mm, 2);

/** @param {number} mm */
export const mmOf = (mm) => `${inMm(mm)} mm`;

/** A view with its controls. @param {SliceView} view */
export function pane(view) {
  const { stage, axis } = view;
  const { source, store } = stage;
  const n = at(axis);
  const title = h("h2", null, view.name);
  const where = h("span", { class: "dim nowrap", dataset: { where: view.name } });
  const slice = h("input", { type: "range", min: 0, max: source.shape[n] - 1, step: 1, "aria-label": `${axis} of the ${view.name} view` });
  const slab = h("input", { type: "range", min: 0, max: STEPS, step: 1, "aria-label": `Thickness of the ${view.name} view's slab` });
  slice.addEventListener("input", () => {
    const place = /** @type {Triple} */ ([...stage.place]);
    place[n] = placeOf(source, axis, Number(slice.value));
    store.change({ at: place });
  });
  slab.addEventListener("input", () => {
    const all = /** @type {Triple} */ ([...stage.view.slab]);
    all[n] = thickness(Number(slab.value), source.spacing[n], stage.extent(axis));
    store.change({ slab: all, at: stage.place });
  });
  const show = () => {
    const [place, thick] = [stage.place[n], stage.view.slab[n]];
    slice.value = String(indexOf(source, axis, place));
    slice.setAttribute("aria-valuetext", `${axis} ${mmOf(place)}`);
    slice.disabled = thick === Infinity;
    slab.value = String(position(thick, source.spacing[n], stage.extent(axis)));
    const words = thick === Infinity ? "all" : thick === 0 ? "slice" : lengthOf(thick);
    slab.setAttribute("aria-valuetext", words);
    where.textContent = view.differs ? "difference, " : "";
    where.textContent += thick === Infinity ? `maximum along ${axis}` : `${axis} ${mmOf(place)}${thick ? `, slab ${words}` : ", slice"}`;
  };
  store.on(show);
  view.ears.add(show);
  show();
  const controls = source.flat ? null : h("div", { class: "pane-controls" },
    h("label", null, axis, slice), h("label", null, "slab", slab));
  return h("section", { class: "pane panel", "aria-label": `${view.name} view`, dataset: { steradian: `view-${PLANES[axis].join("")}` } },
    h("header", null, title, where), view.element, controls);
}

/** Thickness (mm) of a slider's position: a slice, then more and more, then everything.
 *
 * @param {number} position @param {number} spacing @param {number} extent
 */
export function thickness(position, spacing, extent) {
  if (position <= 0) return 0;
  if (position >= STEPS) return Infinity;
  const least = 2 * spacing;
  return Number((least * (extent / least) ** ((position - 1) / (STEPS - 1))).toPrecision(3));
}

/** The slider's position for a thickness. @param {number} thick @param {number} spacing @param {number} extent */
export function position(thick, spacing, extent) {
  if (thick <= 0) return 0;
  if (thick === Infinity) return STEPS;
  const least = 2 * spacing;
  const share = Math.log(Math.max(thick, least) / least) / Math.log(extent / least);
  return Math.min(Math.max(Math.round(1 + share * (STEPS - 1)), 1), STEPS - 1);
}

/** The 3-D view with its box. @param {import("./view_3d.js").SolidView} solid */
export function solidPane(solid) {
  const { stage } = solid;
  const where = h("span", { class: "dim nowrap", dataset: { where: "3-D" } });
  const place = (/** @type {"x" | "y" | "z"} */ axis, /** @type {number} */ share) => {
    const [first, last] = stage.ends(axis);
    return first + share * (last - first);
  };
  const tell = () => {
    const clip = solid.clip;
    const sides = AXES.map((axis, n) => [0, 1].map((side) => place(axis, clip[2 * n + side])));
    const whole = () => sides.map(([from, to]) => (to - from).toFixed(1)).join(" × ");
    const cut = () => AXES.map((axis, n) => `${axis} ${sides[n].map((one) => signed(one)).join("…")}`).join(", ");
    where.textContent = `${stage.view.clip ? cut() : whole()} mm`;
  };
  stage.store.on(tell);
  tell();
  const sliders = AXES.map((axis, n) => h("span", { class: "clip" }, axis,
    ...[0, 1].map((side) => {
      const slider = h("input", {
        type: "range", min: 0, max: 1, step: 0.01, "aria-label": `Box: ${axis} ${side ? "to" : "from"}`,
      });
      const show = () => {
        slider.value = String((stage.view.clip ?? [0, 1, 0, 1, 0, 1])[2 * n + side]);
        slider.setAttribute("aria-valuetext", mmOf(place(axis, Number(slider.value))));
      };
      slider.addEventListener("input", () => {
        const clip = /** @type {any} */ ([...(stage.view.clip ?? [0, 1, 0, 1, 0, 1])]);
        clip[2 * n + side] = side ? Math.max(Number(slider.value), clip[2 * n] + 0.01) : Math.min(Number(slider.value), clip[2 * n + 1] - 0.01);
        stage.store.change({ clip: clip.every((/** @type {number} */ one, /** @type {number} */ m) => one === m % 2) ? null : clip });
        show();
      });
      stage.store.on(show);
      show();
      return slider;
    })));
  return h("section", { class: "pane panel", "aria-label": "3-D view", dataset: { steradian: "view-3d" } },
    h("header", null, h("h2", null, "3-D"), where),
    solid.element, h("div", { class: "pane-controls" }, h("span", { class: "dim" }, "box"), ...sliders));
}
