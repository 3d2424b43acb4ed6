// @ts-check
// Panes of the four views with their controls for slice position and slab thickness.
import { h } from "../dom.js";
import { signed } from "../units.js";
import { AXES, PLANES, axisIndex, rangeEnds, voxelIndex, voxelPosition } from "./volume_data.js";
import { depthsText, lengthOf } from "./scale.js";

/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./view_state.js").Triple} Triple */

const SLAB_STEPS = 40; // of the slab slider, between a slice and the whole volume

/** Format a coordinate in mm without its unit. @param {number} mm */
export const formatMm = (mm) => signed(mm, 2);

/** @param {number} mm */
export const mmText = (mm) => `${formatMm(mm)} mm`;

/** Return the names of two volumes, with one unit if they are wavelengths. @param {string} one @param {string} other */
const pairText = (one, other) => `${/ nm$/.test(one) && /^[0-9]+ nm$/.test(other) ? one.replace(/ nm$/, "") : one} + ${other}`;

/** Create the pane of a slice view. @param {SliceView} view */
export function slicePane(view) {
  const { stage, axis } = view;
  const { source, store } = stage;
  const n = axisIndex(axis);
  const title = h("h2", null, view.name);
  const caption = h("span", { class: "dim nowrap", dataset: { where: view.name } });
  const slice = h("input", { type: "range", min: 0, max: source.shape[n] - 1, step: 1, "aria-label": `${axis} of the ${view.name} view` });
  const slab = h("input", { type: "range", min: 0, max: SLAB_STEPS, step: 1, "aria-label": `Thickness of the ${view.name} view's slab` });
  slice.addEventListener("input", () => {
    const place = /** @type {Triple} */ ([...stage.position]);
    place[n] = voxelPosition(source, axis, Number(slice.value));
    store.change({ at: place });
  });
  slab.addEventListener("input", () => {
    const all = /** @type {Triple} */ ([...stage.view.slab]);
    all[n] = thicknessAt(Number(slab.value), source.spacing[n], stage.extent(axis));
    store.change({ slab: all, at: stage.position });
  });
  const show = () => {
    const [place, slabThickness] = [stage.position[n], stage.view.slab[n]];
    slice.value = String(voxelIndex(source, axis, place));
    slice.setAttribute("aria-valuetext", `${axis} ${mmText(place)}`);
    slice.disabled = slabThickness === Infinity;
    slab.value = String(sliderPosition(slabThickness, source.spacing[n], stage.extent(axis)));
    const thicknessText = slabThickness === Infinity ? "all" : slabThickness === 0 ? "slice" : lengthOf(slabThickness);
    slab.setAttribute("aria-valuetext", thicknessText);
    caption.textContent = [view.isDifference ? "difference" : view.isOverlay ? `${pairText(stage.nameText || "image", stage.referenceName)}` : stage.nameText, source.flat ? "image" : slabThickness === Infinity ? axis === "z" ? `maximum of z ${depthsText(rangeEnds(source, axis, view.stage.range(axis)))}` : `maximum along ${axis}` : `${axis} ${mmText(place)}${slabThickness ? `, slab ${thicknessText}` : ", slice"}`].filter(Boolean).join(", ");
    caption.title = caption.textContent;
  };
  store.on(show);
  view.listeners.add(show);
  show();
  const controls = source.flat ? null : h("div", { class: "pane-controls" },
    h("label", null, axis, slice), h("label", null, "slab", slab));
  return h("section", { class: "pane panel", "aria-label": `${view.name} view`, dataset: { steradian: `view-${PLANES[axis].join("")}` } },
    h("header", null, title, caption), view.element, controls);
}

/** Return the slab thickness (mm) of a slider position.
 *
 * @param {number} position @param {number} spacing @param {number} extent
 */
export function thicknessAt(position, spacing, extent) {
  if (position <= 0) return 0;
  if (position >= SLAB_STEPS) return Infinity;
  const minThickness = 2 * spacing;
  return Number((minThickness * (extent / minThickness) ** ((position - 1) / (SLAB_STEPS - 1))).toPrecision(3));
}

/** Return the slider position of a slab thickness. @param {number} slabThickness @param {number} spacing @param {number} extent */
export function sliderPosition(slabThickness, spacing, extent) {
  if (slabThickness <= 0) return 0;
  if (slabThickness === Infinity) return SLAB_STEPS;
  const minThickness = 2 * spacing;
  const share = Math.log(Math.max(slabThickness, minThickness) / minThickness) / Math.log(extent / minThickness);
  return Math.min(Math.max(Math.round(1 + share * (SLAB_STEPS - 1)), 1), SLAB_STEPS - 1);
}

/** Create the pane of the 3-D view with its clipping box. @param {import("./view_3d.js").View3D} view3d */
export function pane3d(view3d) {
  const { stage } = view3d;
  const caption = h("span", { class: "dim nowrap", dataset: { where: "3-D" } });
  const place = (/** @type {"x" | "y" | "z"} */ axis, /** @type {number} */ share) => {
    const [first, last] = stage.ends(axis);
    return first + share * (last - first);
  };
  const updateCaption = () => {
    const clip = view3d.clip;
    const sides = AXES.map((axis, n) => [0, 1].map((side) => place(axis, clip[2 * n + side])));
    const whole = () => `${sides.slice(0, 2).map(([from, to]) => signed(to - from, 1)).join(" × ")} mm, z ${sides[2].map((one) => signed(one, 1)).join(" to ")}`;
    const cut = () => AXES.map((axis, n) => `${axis} ${sides[n].map((one) => signed(one, 1)).join(" to ")}`).join(", ");
    caption.textContent = [stage.nameText, `${stage.view.clip ? cut() : whole()} mm`].filter(Boolean).join(", ");
  };
  stage.store.on(updateCaption);
  updateCaption();
  const sliders = AXES.map((axis, n) => {
    const range = h("span", { class: "range" });
    range.append(...[0, 1].map((side) => {
      const slider = h("input", {
        type: "range", min: 0, max: 1, step: 0.01, "aria-label": `Box: ${axis} ${side ? "to" : "from"}`,
      });
      const show = () => {
        const share = (stage.view.clip ?? [0, 1, 0, 1, 0, 1])[2 * n + side];
        slider.value = String(share);
        slider.classList.toggle("above", !side && share > 0.5); // at the far end the other thumb cannot make room
        range.style.setProperty(side ? "--to" : "--from", String(share));
        slider.setAttribute("aria-valuetext", mmText(place(axis, Number(slider.value))));
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
    }));
    return h("span", { class: "clip" }, axis, range);
  });
  return h("section", { class: "pane panel", "aria-label": "3-D view", dataset: { steradian: "view-3d" } },
    h("header", null, h("h2", null, "3-D"), caption),
    view3d.element, h("div", { class: "pane-controls" }, h("span", { class: "dim" }, "box"), ...sliders));
}
