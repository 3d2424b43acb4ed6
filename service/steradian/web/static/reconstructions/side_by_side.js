// @ts-check
// Comparison of up to four reconstructions, as soon as all have ended: same position and slab, and a table of differing parameters.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showError, showLoading } from "../panel_states.js";
import { count, duration, figure, pressure } from "../units.js";
import { PLANES, createSource } from "../volume/volume_data.js";
import { slicePane } from "../volume/panes.js";
import { createReadout } from "../volume/readout.js";
import { SliceView } from "../volume/slice_view.js";
import { VolumeState } from "../volume/volume_state.js";
import { ViewStore } from "../volume/view_store.js";
import { differences, parameterGroups, displayPath, formatValue, valueAt } from "./schema.js";
import { methodText, runSeconds, soundSpeedText, stateElement } from "./summary.js";

/** @typedef {import("../volume/view_state.js").Axis} Axis */

const MIN_IMAGE = 160; // pixels
const TILE_FRAME = { width: 22, height: 90 }; // pixels of a tile around its image, with the gap
const BELOW = 40; // pixels of the window that stay free, for the beginning of the table

/** Show reconstructions, at once or as soon as all have ended. @param {HTMLElement} panel @param {string[]} identifiers */
export async function showSideBySide(panel, identifiers) {
  panel.hidden = false;
  showLoading(panel, "loading …");
  let [isLoading, isDue, isShown] = [false, false, false];
  const read = async () => {
    isDue = true;
    if (isLoading || isShown) return;
    isLoading = true;
    while (isDue && !isShown) {
      isDue = false;
      isShown = await load(panel, identifiers);
    }
    isLoading = false;
  };
  await read();
  if (!isShown) onEnd(panel, identifiers, () => void read());
}

/** Load and show reconstructions; return false if one of them has not ended. @param {HTMLElement} panel @param {string[]} identifiers */
async function load(panel, identifiers) {
  try {
    const reconstructions = await Promise.all(identifiers.map((id) => api.get(`/reconstructions/${id}`)));
    if (reconstructions.some(isUnfinished)) {
      showProgress(panel, reconstructions);
      return false;
    }
    const groups = await parameterGroups("ReconstructionParameters");
    const usable = reconstructions.map((one) => ({ one, source: one.state === "succeeded" ? createSource(one) : null })).filter(({ source }) => source);
    const store = new ViewStore();
    const stages = usable.map(({ one, source }) => new VolumeState(/** @type {any} */ (source), store, null, one));
    await Promise.all(stages.map((stage) => stage.readOverview()));
    const brightest = Math.max(...stages.map((stage) => stage.defaultWindow[1]));
    const depths = commonDepths(stages);
    for (const stage of stages) stage.defaultDepths = depths;
    for (const stage of stages) [stage.defaultPosition, stage.defaultWindow] = [stages[0].defaultPosition, [0, brightest]]; // a common scale keeps brightness comparable
    fillPanel(panel, groups, usable.map(({ one }) => one), stages, store);
    const unusable = reconstructions.filter((one) => usable.every((other) => other.one !== one));
    if (unusable.length) panel.querySelector("header")?.after(unusableList(unusable));
  } catch (error) {
    showError(panel, error, () => void showSideBySide(panel, identifiers));
  }
  return true;
}

/** @param {any} one */
const isUnfinished = ({ state }) => ["queued", "running", "cancelling"].includes(state);

/** Show the progress of reconstructions that have not all ended. @param {HTMLElement} panel @param {any[]} reconstructions */
function showProgress(panel, reconstructions) {
  replace(panel, h("header", null, h("h2", null, "Side by side"), h("span", { class: "dim", role: "status" }, "The images appear when all are computed.")),
    h("ul", null, reconstructions.map((one) => h("li", { class: "row" }, h("a", { href: `/reconstructions/${one.id}` }, one.id.slice(-5)), methodText(one), h("span", { class: "state-cell", dataset: { of: one.id } }, stateElement(one))))));
}

/** List reconstructions without an image, with the reason. @param {any[]} reconstructions */
function unusableList(reconstructions) {
  return h("ul", { dataset: { unusable: "" } }, reconstructions.map((one) => h("li", { class: "row" },
    h("a", { href: `/reconstructions/${one.id}` }, one.id.slice(-5)), methodText(one), stateElement(one), h("span", null, one.error?.detail ?? "no image"))));
}

/** Call a function when one of the reconstructions may have ended. @param {HTMLElement} panel @param {string[]} identifiers @param {() => void} act */
function onEnd(panel, identifiers, act) {
  live.on("reconstruction", (event) => identifiers.includes(event.id) && act());
  live.on("again", act);
  live.on("progress", (event) => {
    const cell = panel.querySelector(`[data-of="${CSS.escape(String(event.id))}"]`);
    if (cell) replace(cell, stateElement({ state: "running", progress: event }));
  });
}

/** @param {HTMLElement} panel @param {any} groups @param {any[]} reconstructions @param {VolumeState[]} stages @param {ViewStore} store */
function fillPanel(panel, groups, reconstructions, stages, store) {
  const tiles = h("div", { class: "tiles" });
  const choice = h("select", { "aria-label": "Plane" }, [["z", "x–y"], ["y", "x–z"], ["x", "y–z"]].map(([axis, name]) => h("option", { value: axis }, name)));
  const flat = stages.some((stage) => stage.source.flat);
  if (flat) choice.value = "y";
  choice.disabled = flat;
  const show = () => {
    const axis = /** @type {Axis} */ (choice.value);
    for (const stage of stages) stage.sizes = [];
    replace(tiles, stages.map((stage, n) => createTile(stage, axis, reconstructions[n])));
    arrange();
  };
  const arrange = () => {
    const [across, up] = PLANES[/** @type {Axis} */ (choice.value)];
    arrangeTiles(tiles, stages.length, Math.max(...stages.map((stage) => stage.extent(across) / stage.shownExtent(up))));
  };
  choice.addEventListener("change", show);
  const close = h("a", { class: "button close", href: "/reconstructions" }, "Close");
  if (!stages.length) return replace(panel, h("header", null, h("h2", null, "Side by side"), close));
  replace(panel, h("header", null, h("h2", null, "Side by side"), choice, h("span", { class: "dim", dataset: { scale: "" } }, `common colour scale: 0 to ${(reconstructions.every((one) => one.kind === "unmixing") ? figure : pressure)(stages[0]?.defaultWindow[1] ?? NaN)}`), close), tiles, comparisonTable(groups, reconstructions));
  show();
  new ResizeObserver(arrange).observe(panel);
  addEventListener("resize", arrange);
}

/** Lay out tiles so that their images are as large as the window allows: columns, and heights of the images. @param {HTMLElement} tiles @param {number} count @param {number} aspect width of an image over its height */
function arrangeTiles(tiles, count, aspect) {
  const { width } = tiles.getBoundingClientRect();
  const top = tiles.getBoundingClientRect().top + scrollY;
  let best = { columns: 1, size: 0, height: MIN_IMAGE };
  for (let columns = 1; columns <= count; columns++) {
    const tile = width / columns - TILE_FRAME.width;
    const room = (innerHeight - top - BELOW) / Math.ceil(count / columns) - TILE_FRAME.height;
    const height = Math.max(Math.min(tile / aspect, room), MIN_IMAGE);
    const size = Math.min(tile, height * aspect);
    if (size > best.size * 1.02) best = { columns, size, height };
  }
  tiles.style.setProperty("--columns", String(best.columns));
  tiles.style.setProperty("--image-height", `${Math.floor(best.height)}px`);
}

/** Return the depths (mm) in which any of the volumes has signal; null: all. @param {VolumeState[]} stages @returns {[number, number] | null} */
function commonDepths(stages) {
  const ranges = stages.map(({ defaultDepths }) => defaultDepths ?? [0, Infinity]);
  const [from, to] = [Math.min(...ranges.map(([one]) => one)), Math.max(...ranges.map(([, one]) => one))];
  return to === Infinity ? null : [from, to];
}

/** @param {VolumeState} stage @param {Axis} axis @param {any} one */
function createTile(stage, axis, one) {
  const view = new SliceView(stage, axis, createReadout(stage));
  view.requestData(null);
  const element = slicePane(view);
  element.setAttribute("aria-label", `${view.name} view of …${one.id.slice(-5)}`);
  const title = /** @type {HTMLElement} */ (element.querySelector("h2"));
  replace(title, h("a", { href: `/volumes/${one.id}` }, one.id.slice(-5)), ` ${[one.parameters?.method, soundSpeedText(one)].filter(Boolean).join(", ")}`);
  return element;
}

/** Create the table of differing parameters and results. @param {any} groups @param {any[]} reconstructions */
function comparisonTable(groups, reconstructions) {
  const changed = differences(groups, reconstructions.map((one) => one.parameters));
  const line = (/** @type {string} */ name, /** @type {(one: any) => string} */ of) => h("tr", null, h("th", { scope: "row" }, name), reconstructions.map((one) => h("td", null, of(one))));
  return h("div", { class: "scrolls" }, h("table", { dataset: { changes: "" } },
    h("thead", null, h("tr", null, h("th", null, h("span", { class: "visually-hidden" }, "Parameter")), reconstructions.map((one) => h("th", { scope: "col" }, one.id.slice(-5))))),
    h("tbody", null,
      changed.map((field) => line(displayPath(field.path), (one) => formatValue(field, valueAt(one.parameters, field.path)))),
      new Set(reconstructions.map((one) => one.scan_id)).size > 1 ? line("Scan", (one) => one.scan_id.slice(-5)) : null,
      line("A-lines", (one) => count(one.report?.sensors)),
      line("Voxels", (one) => one.report?.shape?.join(" × ") ?? "–"),
      line("Misfit", (one) => (one.report?.fit?.misfit === null || one.report?.fit?.misfit === undefined ? "–" : figure(one.report.fit.misfit))),
      line("Duration", (one) => duration(runSeconds(one))))));
}
