// @ts-check
// Display options of the View tab: colour map, transfer function, interpolation, and depths that are shown.
import { h } from "../dom.js";
import { signed } from "../units.js";
import { MAP_LABELS, PRESSURE_MAPS } from "./colours.js";
import { mmText } from "./panes.js";
import { firstVoxelBelow, rangeEnds } from "./volume_data.js";
import { DECIBELS, GAMMAS } from "./view_state.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */

const CURVES = { linear: "Linear", gamma: "Gamma", log: "Logarithm (dB)" };
const [FIRST_GAMMA, FIRST_DECIBELS] = [0.5, 40];

/** @param {VolumeState} stage */
export function displayOptions(stage) {
  const legend = h("p", { class: "dim small" });
  const map = h("select", { id: "map", onchange: () => stage.store.change({ map: map.value }) },
    PRESSURE_MAPS.filter((name) => name !== "depth" || !stage.source.flat).map((name) => h("option", { value: name }, MAP_LABELS[name])));
  const smooth = h("select", { id: "smooth", onchange: () => stage.store.change({ smooth: smooth.value }) },
    h("option", { value: "linear" }, "Linear"), h("option", { value: "nearest" }, "Nearest voxel"));
  const curve = h("select", { id: "curve", onchange: () => stage.store.change({ gamma: curve.value === "gamma" ? FIRST_GAMMA : 1, log: curve.value === "log" ? FIRST_DECIBELS : 0 }) },
    Object.entries(CURVES).map(([value, text]) => h("option", { value }, text)));
  const amount = h("input", { type: "number", class: "short" });
  amount.addEventListener("change", () => {
    const value = amount.valueAsNumber;
    const [least, most] = stage.view.log ? DECIBELS : GAMMAS;
    if (value >= least && value <= most) stage.store.change(stage.view.log ? { log: value } : { gamma: value });
    else show();
  });
  const show = () => {
    const { view } = stage;
    map.value = view.map;
    smooth.value = view.smooth;
    if (curve.value !== "gamma" || view.log) curve.value = view.log ? "log" : view.gamma === 1 ? "linear" : "gamma";
    amount.hidden = curve.value === "linear";
    const [least, most] = view.log ? DECIBELS : GAMMAS;
    Object.assign(amount, { min: String(least), max: String(most), step: view.log ? "5" : "0.1", value: String(view.log || view.gamma) });
    amount.setAttribute("aria-label", view.log ? "Range of the logarithm (dB)" : "Gamma: below 1 brightens");
    legend.textContent = stage.isDepthMap ? "Hue shows depth, brightness shows the value." : "";
    legend.hidden = !legend.textContent;
  };
  stage.store.on(show);
  show();
  return h("div", { class: "stack options" }, field("map", "Colours", map), legend, field("curve", "Scale", h("span", { class: "choice" }, curve, amount)), field("smooth", "Interpolation", smooth));
}

/** @param {string} id @param {string} text @param {HTMLElement} control */
const field = (id, text, control) => h("div", { class: "option" }, h("label", { for: id }, text), control);

/** Controls of the hidden near field and of the depths that are shown. @param {VolumeState} stage */
export function depthControls(stage) {
  const [first, last] = stage.ends("z");
  const slider = h("input", { type: "range", min: 0, max: Math.max(last, first), step: stage.source.spacing[2], "aria-label": "Hidden near field, up to (mm)" });
  const status = h("output", null);
  slider.addEventListener("input", () => stage.store.change({ cut: Number(slider.value) }));
  const inputs = ["from", "to"].map((name, n) => {
    const input = h("input", { type: "number", step: "any", min: 0, class: "short", "aria-label": `Shown depth, ${name} (mm)` });
    input.addEventListener("change", () => {
      const depth = /** @type {[number, number]} */ ([...stage.shownEnds("z")]);
      depth[n] = input.valueAsNumber;
      if (depth[0] >= 0 && depth[1] > depth[0]) stage.store.change({ depth, centre: null });
      else show();
    });
    return input;
  });
  const show = () => {
    slider.value = String(stage.cut);
    const top = firstVoxelBelow(stage.source, stage.cut);
    status.textContent = top ? `to ${mmText(rangeEnds(stage.source, "z", { from: 0, to: top })[1])}` : "none";
    stage.shownEnds("z").forEach((mm, n) => inputs[n] !== document.activeElement && (inputs[n].value = String(Math.max(0, Number(mm.toFixed(2))))));
  };
  stage.store.on(show);
  show();
  const [least, most] = [Math.max(0, first), last].map((mm) => signed(mm, 1));
  return h("div", { class: "stack options", dataset: { depths: "" } },
    h("div", { class: "option" }, h("span", { title: "Depths of x–z, y–z and 3-D; the maximum in x–y covers all below the near field" }, "x–z, y–z, 3-D"), h("span", { class: "choice" }, inputs[0], "to", inputs[1], "mm")),
    h("div", { class: "option" }, h("span"), h("span", { class: "choice" },
      h("button", { type: "button", title: "Depths in which the volume has signal, with a margin", onclick: () => stage.store.change({ depth: null, centre: null }) }, "Object"),
      h("button", { type: "button", title: "All depths of the volume", "aria-label": `All depths, ${least} to ${most} mm`, onclick: () => stage.store.change({ depth: [0, Infinity], centre: null }) }, `All, ${least} to ${most} mm`))),
    h("div", { class: "option", title: "Above this depth, the views and projections leave the volume out" }, h("span", null, "Near field off"), h("span", { class: "choice" }, slider, status,
      h("button", { type: "button", title: "End of the near field as determined by the reconstruction", onclick: () => stage.store.change({ cut: null }) }, "auto"))));
}
