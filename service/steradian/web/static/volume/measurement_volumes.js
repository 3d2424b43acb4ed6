// @ts-check
// The same named measurements in several volumes, and the table of all.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { methodText, scanNames } from "../reconstructions/summary.js";
import { formatDate } from "../units.js";
import { downloadTable } from "./measurement_table.js";

/** @typedef {import("./measurement_store.js").MeasurementStore} MeasurementStore */
/** @typedef {import("./measurement_store.js").Definition} Definition */

const MAX_VOLUMES = 100; // of a table of the service
const pathOf = (/** @type {string} */ id) => `/reconstructions/${id}/measurements`;

/** @param {MeasurementStore} store */
export function measurementVolumes(store) {
  const choice = h("fieldset", { class: "volumes" }, h("legend", null, "Other volumes"));
  const message = h("p", { class: "small", role: "status" });
  const chosen = () => /** @type {HTMLInputElement[]} */ ([...choice.querySelectorAll("input:checked")]).map((one) => one.value);
  const applyButton = h("button", { type: "button", onclick: () => void measureAll() }, "Measure in these volumes");
  const tableButton = h("button", { type: "button", onclick: () => void store.handle(() => downloadTable(store, "csv", chosen())) }, "Table of all volumes (CSV)");
  const update = () => {
    const count = chosen().length;
    applyButton.disabled = !count || count > MAX_VOLUMES || !store.items.length;
    tableButton.disabled = !count || count > MAX_VOLUMES;
  };
  const load = async () => {
    try {
      const [{ items }, labels] = await Promise.all([api.get("/reconstructions?state=succeeded&limit=200"), scanNames()]);
      const others = items.filter((/** @type {any} */ one) => one.id !== store.reconstruction.id && one.report?.shape?.length === store.reconstruction.report.shape.length);
      replace(choice, h("legend", null, "Other volumes"), others.length ? others.map((/** @type {any} */ one) => h("label", { class: "row nowrap" },
        h("input", { type: "checkbox", value: one.id, onchange: update }), h("span", null, [labels.get(one.scan_id), methodText(one), formatDate(one.ended ?? one.created), one.id.slice(-5)].filter(Boolean).join(", ")))) : h("p", { class: "dim" }, "There is no other volume."));
    } catch (error) {
      replace(message, ...errorElements(error));
    }
    update();
  };
  const measureAll = async () => {
    applyButton.disabled = true;
    const definitions = store.items.map((item) => item.measurement);
    /** @type {string[]} */
    const failures = [];
    for (const id of chosen()) {
      message.textContent = `measuring in ${id} …`;
      await measureIn(id, definitions).catch((error) => failures.push(`${id.slice(-5)}: ${error.message}`));
    }
    message.textContent = failures.length ? `Not measured in ${failures.join("; ")}` : "Measured in all of them, and kept with each.";
    update();
  };
  store.listeners.add(update);
  update();
  return h("details", { dataset: { volumes: "" }, ontoggle: (/** @type {Event} */ event) => /** @type {HTMLDetailsElement} */ (event.target).open && void load() },
    h("summary", null, "Several volumes"), h("div", { class: "stack" }, choice, h("div", { class: "row" }, applyButton, tableButton), message));
}

/** Keep measurements with another volume; those of the same names are replaced. @param {string} id @param {Definition[]} definitions */
async function measureIn(id, definitions) {
  const response = await api.request("GET", pathOf(id));
  const names = new Set(definitions.map((one) => one.name));
  const own = (await response.json()).items.map((/** @type {any} */ item) => item.measurement).filter((/** @type {Definition} */ one) => !names.has(one.name));
  await api.put(pathOf(id), { items: [...own, ...definitions] }, { headers: { "If-Match": response.headers.get("ETag") ?? "*" } });
}
