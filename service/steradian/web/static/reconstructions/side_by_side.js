// @ts-check
// Comparison of up to four reconstructions: same position and slab, and a table of differing parameters.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { showError, showLoading } from "../panel_states.js";
import { count, duration, figure, pressure } from "../units.js";
import { createSource } from "../volume/volume_data.js";
import { mmText, slicePane } from "../volume/panes.js";
import { SliceView } from "../volume/slice_view.js";
import { VolumeState } from "../volume/volume_state.js";
import { ViewStore } from "../volume/view_store.js";
import { differences, parameterGroups, displayPath, formatValue, valueAt } from "./schema.js";
import { runSeconds } from "./summary.js";

/** @typedef {import("../volume/view_state.js").Axis} Axis */

/** @param {HTMLElement} panel @param {string[]} identifiers */
export async function showSideBySide(panel, identifiers) {
  panel.hidden = false;
  showLoading(panel, "loading …");
  try {
    const [groups, ...reconstructions] = await Promise.all([parameterGroups("ReconstructionParameters"), ...identifiers.map((id) => api.get(`/reconstructions/${id}`))]);
    const usable = reconstructions.map((one) => ({ one, source: one.state === "succeeded" ? createSource(one) : null })).filter(({ source }) => source);
    const store = new ViewStore();
    const stages = usable.map(({ source }) => new VolumeState(/** @type {any} */ (source), store));
    await Promise.all(stages.map((stage) => stage.readOverview()));
    const brightest = Math.max(...stages.map((stage) => stage.defaultWindow[1]));
    for (const stage of stages) [stage.defaultPosition, stage.defaultWindow] = [stages[0].defaultPosition, [0, brightest]]; // a common scale keeps brightness comparable
    fillPanel(panel, groups, usable.map(({ one }) => one), stages, store);
  } catch (error) {
    showError(panel, error, () => void showSideBySide(panel, identifiers));
  }
}

/** @param {HTMLElement} panel @param {any} groups @param {any[]} reconstructions @param {VolumeState[]} stages @param {ViewStore} store */
function fillPanel(panel, groups, reconstructions, stages, store) {
  const cursor = h("output", { class: "cursor" });
  const tiles = h("div", { class: "tiles" });
  const choice = h("select", { "aria-label": "Plane" }, [["z", "x–y"], ["y", "x–z"], ["x", "y–z"]].map(([axis, name]) => h("option", { value: axis }, name)));
  const flat = stages.some((stage) => stage.source.flat);
  if (flat) choice.value = "y";
  choice.disabled = flat;
  const show = () => {
    const axis = /** @type {Axis} */ (choice.value);
    for (const stage of stages) stage.sizes = [];
    replace(tiles, stages.map((stage, n) => createTile(stage, axis, reconstructions[n], cursor)));
  };
  choice.addEventListener("change", show);
  const close = h("a", { class: "button", href: "/reconstructions" }, "Close");
  replace(panel, h("header", null, h("h2", null, "Side by side"), choice, h("span", { class: "dim", dataset: { scale: "" } }, `common colour scale: 0 to ${pressure(stages[0]?.defaultWindow[1] ?? NaN)}`), cursor, close), tiles, comparisonTable(groups, reconstructions));
  show();
}

/** @param {VolumeState} stage @param {Axis} axis @param {any} one @param {HTMLElement} cursor */
function createTile(stage, axis, one, cursor) {
  const view = new SliceView(stage, axis, (hovered) => {
    cursor.textContent = hovered ? `${one.id.slice(-5)}: ${Object.entries(hovered.place).filter(([, mm]) => mm !== null).map(([name, mm]) => `${name} ${mmText(Number(mm))}`).join("  ")}  value ${pressure(hovered.value, 4)}` : "";
  });
  view.requestData(null);
  const element = slicePane(view);
  const title = /** @type {HTMLElement} */ (element.querySelector("h2"));
  replace(title, h("a", { href: `/volumes/${one.id}` }, one.id.slice(-5)));
  return element;
}

/** Create the table of differing parameters and results. @param {any} groups @param {any[]} reconstructions */
function comparisonTable(groups, reconstructions) {
  const changed = differences(groups, reconstructions.map((one) => one.parameters));
  const line = (/** @type {string} */ name, /** @type {(one: any) => string} */ of) => h("tr", null, h("th", { scope: "row" }, name), reconstructions.map((one) => h("td", null, of(one))));
  return h("div", { class: "scrolls" }, h("table", { dataset: { changes: "" } },
    h("thead", null, h("tr", null, h("th", null, ""), reconstructions.map((one) => h("th", { scope: "col" }, one.id.slice(-5))))),
    h("tbody", null,
      changed.map((field) => line(displayPath(field.path), (one) => formatValue(field, valueAt(one.parameters, field.path)))),
      new Set(reconstructions.map((one) => one.scan_id)).size > 1 ? line("Scan", (one) => one.scan_id.slice(-5)) : null,
      line("A-lines", (one) => count(one.report?.sensors)),
      line("Voxels", (one) => one.report?.shape?.join(" × ") ?? "–"),
      line("Misfit", (one) => (one.report?.fit?.misfit === null || one.report?.fit?.misfit === undefined ? "–" : figure(one.report.fit.misfit))),
      line("Duration", (one) => duration(runSeconds(one))))));
}
