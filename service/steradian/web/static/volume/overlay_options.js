// @ts-check
// Options of an overlay: colours, opacity and scale of the image and of the reference laid over it, with their colour bars.
import { decimalInput, decimalOf, showDecimal } from "../decimal_input.js";
import { h } from "../dom.js";
import { MAP_LABELS, OVERLAY_MAPS, PRESSURE_MAPS, paintRamp } from "./colours.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */

const BAR_WIDTH = 256; // pixels

/** @param {VolumeState} stage */
export function overlayOptions(stage) {
  const layers = [layer(stage, 0), layer(stage, 1)];
  const element = h("div", { class: "stack", dataset: { overlay: "" } }, layers.map((one) => one.element));
  const show = () => {
    element.hidden = !stage.isOverlay;
    if (!element.hidden) for (const one of layers) one.show();
  };
  stage.store.on(show);
  return { element, show };
}

/** Create the options of a layer. @param {VolumeState} stage @param {0 | 1} n 0: the image, 1: the reference */
function layer(stage, n) {
  const which = n ? "Reference" : "Image";
  const title = h("h3");
  const maps = n ? OVERLAY_MAPS : PRESSURE_MAPS.filter((name) => name !== "depth");
  const map = h("select", { "aria-label": `${which}: colours`, onchange: () => stage.store.change(n ? { overlayMap: map.value } : { map: map.value }) }, maps.map((name) => h("option", { value: name }, MAP_LABELS[name])));
  const opacity = h("input", { type: "range", min: 0, max: 1, step: 0.05, "aria-label": `${which}: opacity` });
  opacity.addEventListener("input", () => {
    const all = /** @type {[number, number]} */ ([...stage.view.opacity]);
    all[n] = Number(opacity.value);
    stage.store.change({ opacity: all });
  });
  const canvas = h("canvas", { width: BAR_WIDTH, height: 1, class: "colour-bar", "aria-hidden": "true" });
  const inputs = ["from", "to"].map((name, side) => {
    const input = decimalInput({ class: "short", "aria-label": `${which}: ${name}` });
    input.addEventListener("change", () => {
      const window = /** @type {[number, number]} */ ([...(n ? stage.overlayWindow : stage.window)]);
      window[side] = decimalOf(input);
      if (window[0] < window[1]) stage.store.change(n ? { overlayWindow: window } : { window });
      else show();
    });
    return input;
  });
  const show = () => {
    title.textContent = n ? stage.referenceName : stage.nameText || "This image";
    map.value = n ? stage.view.overlayMap : stage.view.map;
    opacity.value = String(stage.view.opacity[n]);
    const window = n ? stage.overlayWindow : stage.window;
    window.forEach((value, side) => showDecimal(inputs[side], value, 4));
    const pixels = new ImageData(BAR_WIDTH, 1);
    paintRamp(n ? stage.overlayColours : stage.colours, window, window, new Uint32Array(pixels.data.buffer));
    canvas.getContext("2d")?.putImageData(pixels, 0, 0);
  };
  const element = h("div", { class: "stack histogram" }, title, h("div", { class: "choice" }, map, h("label", { class: "choice" }, "opacity", opacity)), canvas, h("div", { class: "row nowrap" }, inputs[0], "to", inputs[1]));
  return { element, show };
}
