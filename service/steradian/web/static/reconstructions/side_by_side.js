// @ts-check
// Up to four results beside each other: the same place and slab in all of them, and what was done differently.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { failed, loading } from "../panel_states.js";
import { count, duration, figure, pressure } from "../units.js";
import { sourceOf } from "../volume/volume_data.js";
import { mmOf, pane } from "../volume/panes.js";
import { SliceView } from "../volume/slice_view.js";
import { Stage } from "../volume/shared_state.js";
import { Store } from "../volume/view_store.js";
import { differences, groupsOf, spokenPath, told, valueAt } from "./schema.js";
import { tookOf } from "./summary.js";

/** @typedef {import("../volume/view_state.js").Axis} Axis */

/** @param {HTMLElement} panel @param {string[]} identifiers */
export async function showSide(panel, identifiers) {
  panel.hidden = false;
  loading(panel, "loading …");
  try {
    const [groups, ...found] = await Promise.all([groupsOf("ReconstructionParameters"), ...identifiers.map((id) => api.get(`/reconstructions/${id}`))]);
    const usable = found.map((one) => ({ one, source: one.state === "succeeded" ? sourceOf(one) : null })).filter(({ source }) => source);
    const store = new Store();
    const stages = usable.map(({ source }) => new Stage(/** @type {any} */ (source), store));
    await Promise.all(stages.map((stage) => stage.survey()));
    const brightest = Math.max(...stages.map((stage) => stage.ownWindow[1]));
    for (const stage of stages) [stage.home, stage.ownWindow] = [stages[0].home, [0, brightest]]; // one scale, or the fainter would look as bright
    fill(panel, groups, usable.map(({ one }) => one), stages, store);
  } catch (error) {
    failed(panel, error, () => void showSide(panel, identifiers));
  }
}

/** @param {HTMLElement} panel @param {any} groups @param {any[]} found @param {Stage[]} stages @param {Store} store */
function fill(panel, groups, found, stages, store) {
  const cursor = h("output", { class: "cursor" });
  const tiles = h("div", { class: "tiles" });
  const choice = h("select", { "aria-label": "Plane" }, [["z", "x–y"], ["y", "x–z"], ["x", "y–z"]].map(([axis, name]) => h("option", { value: axis }, name)));
  const flat = stages.some((stage) => stage.source.flat);
  if (flat) choice.value = "y";
  choice.disabled = flat;
  const show = () => {
    const axis = /** @type {Axis} */ (choice.value);
    for (const stage of stages) stage.sizes = [];
    replace(tiles, stages.map((stage, n) => tile(stage, axis, found[n], cursor)));
  };
  choice.addEventListener("change", show);
  const close = h("a", { class: "button", href: "/reconstructions" }, "Close");
  replace(panel, h("header", null, h("h2", null, "Side by side"), choice, h("span", { class: "dim", dataset: { scale: "" } }, `colours of all: 0 to ${pressure(stages[0]?.ownWindow[1] ?? NaN)}`), cursor, close), tiles, table(groups, found));
  show();
}

/** @param {Stage} stage @param {Axis} axis @param {any} one @param {HTMLElement} cursor */
function tile(stage, axis, one, cursor) {
  const view = new SliceView(stage, axis, (seen) => {
    cursor.textContent = seen ? `${one.id.slice(-5)}: ${Object.entries(seen.place).filter(([, mm]) => mm !== null).map(([name, mm]) => `${name} ${mmOf(Number(mm))}`).join("  ")}  value ${pressure(seen.value, 4)}` : "";
  });
  view.read(null);
  const made = pane(view);
  const title = /** @type {HTMLElement} */ (made.querySelector("h2"));
  replace(title, h("a", { href: `/volumes/${one.id}` }, one.id.slice(-5)));
  return made;
}

/** What was changed, and what came of it. @param {any} groups @param {any[]} found */
function table(groups, found) {
  const changed = differences(groups, found.map((one) => one.parameters));
  const line = (/** @type {string} */ name, /** @type {(one: any) => string} */ of) => h("tr", null, h("th", { scope: "row" }, name), found.map((one) => h("td", null, of(one))));
  return h("div", { class: "scrolls" }, h("table", { dataset: { changes: "" } },
    h("thead", null, h("tr", null, h("th", null, ""), found.map((one) => h("th", { scope: "col" }, one.id.slice(-5))))),
    h("tbody", null,
      changed.map((field) => line(spokenPath(field.path), (one) => told(field, valueAt(one.parameters, field.path)))),
      new Set(found.map((one) => one.scan_id)).size > 1 ? line("Scan", (one) => one.scan_id.slice(-5)) : null,
      line("A-lines", (one) => count(one.report?.sensors)),
      line("Voxels", (one) => one.report?.shape?.join(" × ") ?? "–"),
      line("Misfit", (one) => (one.report?.fit?.misfit === null || one.report?.fit?.misfit === undefined ? "–" : figure(one.report.fit.misfit))),
      line("Took", (one) => duration(tookOf(one))))));
}
