// @ts-check
// Detail view of one reconstruction: state, request, attempts and log.
import { api } from "../api.js";
import { byId, h, pathIdentifier, replace, debounce } from "../dom.js";
import { live } from "../event_stream.js";
import { showError, showLoading, errorElements } from "../panel_states.js";
import { formatDate, formatTime, duration, identifierElement } from "../units.js";
import { iterativeButton } from "./iterative_beside.js";
import { requesterOf, methodText, stateElement } from "./summary.js";
import { differences, parameterGroups, displayPath, formatValue, valueAt } from "./schema.js";

const panel = byId("reconstruction");
const messages = h("div", { role: "alert" });
const LOG_INTERVAL = 2000;
/** @type {any} as of the last read */
let reconstruction = null;

async function load() {
  try {
    const id = pathIdentifier();
    const [one, groups, log, attempts] = await Promise.all([
      api.get(`/reconstructions/${id}`), parameterGroups("ReconstructionParameters"),
      api.request("GET", `/jobs/${id}/log`, undefined, { accept: "text/plain" }).then((answer) => answer.text()),
      api.get(`/jobs/${id}/attempts`),
    ]);
    reconstruction = one;
    show(one, groups, log, attempts.items);
  } catch (error) {
    showError(panel, error, load);
  }
}

/** @param {any} one @param {any} groups @param {string} log @param {any[]} attempts */
function show(one, groups, log, attempts) {
  const isOver = !["queued", "running"].includes(one.state);
  const changed = differences(groups, [one.parameters, {}]);
  replace(panel, messages,
    h("div", { class: "row spread" }, h("div", { class: "row state-cell" }, stateElement(one), one.error ? h("span", { class: "fault" }, one.error.detail) : null, one.reason ? h("span", { class: "dim" }, one.reason) : null),
      h("div", { class: "row" },
        one.state === "succeeded" ? h("a", { class: "button primary", href: `/volumes/${one.id}` }, "Open the volume") : null,
        one.state === "succeeded" && one.kind === "reconstruction" && one.parameters.method !== "iterative" ? iterativeButton(one.scan_id, messages, { direct: one }) : null,
        one.kind === "unmixing" ? null : h("a", { class: "button", href: `/reconstructions?again=${one.id}` }, "Rerun …"),
        isOver ? null : h("button", { type: "button", disabled: one.desired_state === "cancelled", onclick: () => void cancel(one.id) }, "Cancel"))),
    h("div", { class: "halves" },
      h("section", { class: "panel" }, h("h2", null, "Request"),
        h("dl", { class: "figures" },
          pair("Identifier", identifierElement(one.id)), pair("Scan", identifierElement(one.scan_id, `/scans/${one.scan_id}`)), pair("Method", methodText(one)),
          pair("Submitted", formatDate(one.created, true)), pair("Submitted by", requesterOf(one)), pair("Started", formatDate(one.started, true)), pair("Ended", formatDate(one.ended, true)),
          pair("Priority", String(one.priority)),
          one.queue?.position ? pair("Queue position", String(one.queue.position)) : [], one.queue?.expected_end ? pair("Expected end", formatTime(one.queue.expected_end)) : [],
          one.queue?.awaited ? pair("Waiting for", one.queue.awaited) : []),
        h("h3", null, "Parameters that differ from the defaults"),
        changed.length ? h("dl", { class: "figures" }, changed.flatMap((field) => pair(displayPath(field.path), formatValue(field, valueAt(one.parameters, field.path))))) : h("p", { class: "dim" }, "None.")),
      h("section", { class: "panel" }, h("h2", null, "Attempts"),
        attempts.length ? h("table", null, h("thead", null, h("tr", null, ["", "Worker", "Started", "Duration", "Outcome"].map((name) => h("th", null, name)))),
          h("tbody", null, attempts.map((start) => h("tr", null, h("td", { class: "number" }, String(start.number)), h("td", null, start.worker ?? "–"), h("td", { class: "nowrap" }, formatDate(start.started, true)),
            h("td", { class: "nowrap" }, start.started && start.ended ? duration((new Date(start.ended).getTime() - new Date(start.started).getTime()) / 1e3) : "–"),
            h("td", null, start.outcome ?? "running", start.detail ? h("span", { class: "dim" }, ` ${start.detail}`) : null))))) : h("p", { class: "dim" }, "Not started yet."))),
    h("section", { class: "panel" }, h("h2", null, "Log"), log ? h("pre", { class: "log", tabindex: 0 }, log) : h("p", { class: "dim" }, "The log is empty.")));
}

/** @param {string} name @param {import("../dom.js").Child} value */
const pair = (name, value) => [h("dt", null, name), h("dd", null, value)];

/** @param {string} id */
async function cancel(id) {
  try {
    await api.put(`/jobs/${id}/desired-state`, { state: "cancelled", reason: "cancelled on the web page" });
    replace(messages);
  } catch (error) {
    replace(messages, ...errorElements(error));
  }
  await load();
}

showLoading(panel);
const loadSoon = debounce(load, 250);
for (const kind of /** @type {const} */ (["reconstruction", "job"])) live.on(kind, (event) => event.id === pathIdentifier() && loadSoon());
live.on("again", loadSoon);
let lastLogTime = 0;

/** Update the log. */
async function readLog() {
  const log = panel.querySelector("pre.log");
  const now = performance.now();
  if (now - lastLogTime < LOG_INTERVAL) return;
  lastLogTime = now;
  if (!log) return void loadSoon();
  const answer = await api.request("GET", `/jobs/${pathIdentifier()}/log`, undefined, { accept: "text/plain" }).catch(() => null);
  if (answer) log.textContent = await answer.text();
}

live.on("progress", (event) => {
  if (event.id === pathIdentifier()) void readLog();
  const cell = panel.querySelector(".state-cell");
  if (event.id === pathIdentifier() && cell) replace(cell, stateElement({ ...reconstruction, state: "running", progress: event }));
});
void load();
