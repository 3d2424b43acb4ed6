// @ts-check
// One reconstruction: how far it is, what was asked, what it wrote, how often it was begun.
import { api } from "../api.js";
import { byId, h, identifier, replace, settled } from "../dom.js";
import { live } from "../event_stream.js";
import { failed, loading, words } from "../panel_states.js";
import { clock, duration, identifierOf } from "../units.js";
import { askedBy, methodOf, stateOf } from "./summary.js";
import { differences, groupsOf, spokenPath, told, valueAt } from "./schema.js";

const panel = byId("reconstruction");
const said = h("div", { role: "alert" });
const LOG_EVERY = 2000;
/** @type {any} as it was read last */
let about = null;

async function load() {
  try {
    const id = identifier();
    const [one, groups, log, attempts] = await Promise.all([
      api.get(`/reconstructions/${id}`), groupsOf("ReconstructionParameters"),
      api.ask("GET", `/jobs/${id}/log`, undefined, { accept: "text/plain" }).then((answer) => answer.text()),
      api.get(`/jobs/${id}/attempts`),
    ]);
    about = one;
    show(one, groups, log, attempts.items);
  } catch (error) {
    failed(panel, error, load);
  }
}

/** @param {any} one @param {any} groups @param {string} log @param {any[]} attempts */
function show(one, groups, log, attempts) {
  const over = !["queued", "running"].includes(one.state);
  const changed = differences(groups, [one.parameters, {}]);
  replace(panel, said,
    h("div", { class: "row spread" }, h("div", { class: "row state-cell" }, stateOf(one), one.error ? h("span", { class: "fault" }, one.error.detail) : null, one.reason ? h("span", { class: "dim" }, one.reason) : null),
      h("div", { class: "row" },
        one.state === "succeeded" ? h("a", { class: "button primary", href: `/volumes/${one.id}` }, "Open the volume") : null,
        h("a", { class: "button", href: `/reconstructions?again=${one.id}` }, "Again …"),
        over ? null : h("button", { type: "button", disabled: one.desired_state === "cancelled", onclick: () => void cancel(one.id) }, "Cancel"))),
    h("div", { class: "halves" },
      h("section", { class: "panel" }, h("h2", null, "What was asked"),
        h("dl", { class: "figures" },
          pair("Identifier", identifierOf(one.id)), pair("Scan", identifierOf(one.scan_id, `/scans/${one.scan_id}`)), pair("Method", methodOf(one)),
          pair("Asked for", clock(one.created)), pair("By", askedBy(one)), pair("Began", clock(one.started)), pair("Ended", clock(one.ended)),
          pair("Priority", String(one.priority)),
          one.queue?.position ? pair("Place", String(one.queue.position)) : [], one.queue?.expected_end ? pair("Expected end", clock(one.queue.expected_end)) : [],
          one.queue?.awaited ? pair("Waits for", one.queue.awaited) : []),
        h("h3", null, "Parameters other than the defaults"),
        changed.length ? h("dl", { class: "figures" }, changed.flatMap((field) => pair(spokenPath(field.path), told(field, valueAt(one.parameters, field.path))))) : h("p", { class: "dim" }, "None.")),
      h("section", { class: "panel" }, h("h2", null, "Attempts"),
        attempts.length ? h("table", null, h("thead", null, h("tr", null, ["", "Worker", "Began", "Took", "Outcome"].map((name) => h("th", null, name)))),
          h("tbody", null, attempts.map((start) => h("tr", null, h("td", { class: "number" }, String(start.number)), h("td", null, start.worker ?? "–"), h("td", { class: "nowrap" }, clock(start.started)),
            h("td", { class: "nowrap" }, start.started && start.ended ? duration((new Date(start.ended).getTime() - new Date(start.started).getTime()) / 1e3) : "–"),
            h("td", null, start.outcome ?? "at work", start.detail ? h("span", { class: "dim" }, ` ${start.detail}`) : null))))) : h("p", { class: "dim" }, "It has not begun."))),
    h("section", { class: "panel" }, h("h2", null, "Log"), log ? h("pre", { class: "log", tabindex: 0 }, log) : h("p", { class: "dim" }, "Nothing was written.")));
}

/** @param {string} name @param {import("../dom.js").Child} value */
const pair = (name, value) => [h("dt", null, name), h("dd", null, value)];

/** @param {string} id */
async function cancel(id) {
  try {
    await api.put(`/jobs/${id}/desired-state`, { state: "cancelled", reason: "cancelled on the page" });
    replace(said);
  } catch (error) {
    replace(said, ...words(error));
  }
  await load();
}

loading(panel);
const soon = settled(load, 250);
for (const kind of /** @type {const} */ (["reconstruction", "job"])) live.on(kind, (seen) => seen.id === identifier() && soon());
live.on("again", soon);
let lastLog = 0;

/** Show what was logged meanwhile. */
async function readLog() {
  const log = panel.querySelector("pre.log");
  const now = performance.now();
  if (now - lastLog < LOG_EVERY) return;
  lastLog = now;
  if (!log) return void soon();
  const answer = await api.ask("GET", `/jobs/${identifier()}/log`, undefined, { accept: "text/plain" }).catch(() => null);
  if (answer) log.textContent = await answer.text();
}

live.on("progress", (seen) => {
  if (seen.id === identifier()) void readLog();
  const cell = panel.querySelector(".state-cell");
  if (seen.id === identifier() && cell) replace(cell, stateOf({ ...about, state: "running", progress: seen }));
});
void load();
