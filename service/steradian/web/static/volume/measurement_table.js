// @ts-check
// Table of the named measurements under the views, with downloads.
import { api } from "../api.js";
import { h, replaceKeepingFocus } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { volumeName } from "../reconstructions/volume_names.js";
import { figure } from "../units.js";
import { lengthOf, lengthWithError } from "./scale.js";

/** @typedef {import("./measurement_store.js").MeasurementStore} MeasurementStore */
/** @typedef {import("./measurement_store.js").Measured} Measured */

/** @param {MeasurementStore} store */
export function measurementTable(store) {
  const element = h("section", { class: "panel measured", "aria-label": "Measurements", dataset: { steradian: "measurements" } });
  /** @type {unknown[]} items and error that are shown */
  let shown = [];
  const show = () => {
    const isSame = shown[0] === store.items && shown[1] === store.error;
    if (!isSame && !isEditing(element)) {
      shown = [store.items, store.error];
      build();
    }
    for (const one of element.querySelectorAll("tr[data-measurement]")) one.classList.toggle("selected", /** @type {HTMLElement} */ (one).dataset.measurement === store.selectedName);
  };
  const build = () => {
    element.hidden = !store.items.length && !store.error;
    const focused = element.contains(document.activeElement) ? /** @type {HTMLElement} */ (document.activeElement).dataset.field : null;
    replaceKeepingFocus(element,
      h("h2", { class: "visually-hidden" }, "Measurements"),
      store.error ? h("div", { role: "alert", class: "fault" }, ...errorElements(store.error)) : null,
      h("div", { class: "scrolled", tabindex: 0, role: "region", "aria-label": "Table of measurements" }, h("table", null,
        h("thead", null, h("tr", null, ...["Measurement", "Kind", "Value", "Width ± repeatability", "Corrected width"].map((name) => h("th", null, name)), h("th", null, h("span", { class: "row nowrap" }, downloadButton(store, "csv"), downloadButton(store, "json"))))),
        h("tbody", null, store.items.map((item, n) => row(store, item, n, show))))));
    if (focused) /** @type {HTMLElement | null} */ (element.querySelector(`[data-field="${focused}"]`))?.focus({ preventScroll: true });
  };
  store.listeners.add(show);
  build();
  return element;
}

/** Return whether a name is being typed, which must not be replaced. @param {HTMLElement} element */
function isEditing(element) {
  const active = document.activeElement;
  return active instanceof HTMLInputElement && element.contains(active) && active.value !== active.dataset.name;
}

/** @param {MeasurementStore} store @param {Measured} item @param {number} n @param {() => void} show */
function row(store, item, n, show) {
  const { name, kind, index } = item.measurement;
  const commit = () => {
    const wanted = rename.value.trim();
    if (!wanted || wanted === name) rename.value = name;
    else void store.rename(name, wanted);
    rename.dataset.name = rename.value;
  };
  const rename = h("input", {
    type: "text", value: name, maxlength: 100, required: true, "aria-label": `Name of measurement ${n + 1}`, dataset: { field: `name-${n}`, name },
    onfocus: () => store.select(name), onchange: commit, onblur: show,
  });
  const cell = (/** @type {string} */ key, /** @type {...any} */ ...children) => h("td", { dataset: { cell: key } }, ...children);
  return h("tr", { dataset: { measurement: name }, onclick: () => store.select(name) },
    h("td", null, rename), cell("kind", [kind, index === null ? "" : volumeName(store.reconstruction, index)].filter(Boolean).join(", ")), cell("value", valueText(store, item)), cell("width", widthText(item)), cell("corrected", correctedWidth(store, item)),
    h("td", null, h("button", { type: "button", class: "quiet", "aria-label": `Remove ${name}`, onclick: (/** @type {Event} */ event) => { event.stopPropagation(); void store.remove(name); } }, "remove")));
}

/** @param {MeasurementStore} store @param {Measured} item */
function valueText(store, { measurement, figures, reason }) {
  const { value } = figures;
  if (value === null) return measurement.kind === "contrast" ? reason : "–";
  return measurement.kind === "contrast" ? figure(value) : store.stage.valueText(value);
}

/** Return the width of the profile with its repeatability. @param {Measured} item */
export function widthText({ measurement, figures, reason }) {
  if (measurement.kind !== "profile") return "";
  if (figures.width === null) return reason;
  return lengthWithError(1e3 * figures.width, figures.repeatability === null ? null : 1e3 * figures.repeatability);
}

/** Return the corrected diameter as the service tells it. @param {any} correction */
export function correctedText(correction) {
  if (correction.at_most !== null) return `at most ${lengthOf(1e3 * correction.at_most)}`;
  return correction.corrected === null ? "none" : lengthOf(1e3 * correction.corrected);
}

/** @param {MeasurementStore} store @param {Measured} item */
function correctedWidth(store, item) {
  if (!store.isCorrectable(item)) return "";
  if (item.correction) return h("span", { title: item.correction.reason || item.correction.shape }, correctedText(item.correction));
  if (item.state === "queued" || item.state === "running") return h("span", { class: "dim", role: "status" }, item.state);
  return h("button", { type: "button", class: "quiet", "aria-label": `Correct the width of ${item.measurement.name}`, title: "Simulate the point spread at this place; takes as long as about ten images", onclick: () => void store.correct(item) }, item.state ? `${item.state}, again` : "compute");
}

/** @param {MeasurementStore} store @param {"csv" | "json"} format */
function downloadButton(store, format) {
  return h("button", { type: "button", class: "quiet", "aria-label": `Download the measurements as ${format.toUpperCase()}`, onclick: () => void store.handle(() => downloadTable(store, format)) }, `↓ ${format.toUpperCase()}`);
}

/** Download the table of this volume, and of others. @param {MeasurementStore} store @param {"csv" | "json"} format @param {string[]} others */
export async function downloadTable(store, format, others = []) {
  const query = new URLSearchParams(others.map((id) => ["also", id]));
  const response = await api.request("GET", `${store.path}?${query}`, undefined, { accept: format === "csv" ? "text/csv" : "application/json" });
  const address = URL.createObjectURL(await response.blob());
  const link = h("a", { download: `${store.reconstruction.id}-measurements.${format}` });
  link.href = address;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
