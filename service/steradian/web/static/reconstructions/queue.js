// @ts-check
// Queue as a table of waiting, running and finished jobs with their actions.
import { api } from "../api.js";
import { byId, h, replace, debounce } from "../dom.js";
import { addShortcut } from "../shortcuts.js";
import { live } from "../event_stream.js";
import { showEmpty, showError, showLoading, errorElements } from "../panel_states.js";
import { formatDate, formatTime, duration } from "../units.js";
import { showRequestForm } from "./request_form.js";
import { createDragHandle } from "./drag_handle.js";
import { byPriority, priorityChanges } from "./queue_order.js";
import { showSideBySide } from "./side_by_side.js";
import { requesterOf, methodText, scanNames, soundSpeedText, stateElement, runSeconds } from "./summary.js";
import { urlOf } from "../urls.js";

const MAX_SIDE_BY_SIDE = 4;
const MAX_POSITION_QUERIES = 12; // unfinished jobs whose queue position is queried
const RELOAD_DELAY = 250;

const selected = new Set(/** @type {string[]} */ ([]));
/** @type {any[]} */
let items = [];
/** @type {Map<string, string>} */
let names = new Map();
const panel = byId("reconstructions");
const formPanel = byId("asking");
const messages = h("div", { role: "alert" });
const positionStatus = h("p", { class: "visually-hidden", role: "status" });
let isDragging = false; // true while the user drags a row
let pendingChanges = 0; // running changes
let loadCount = 0;

/** @param {any} one */
const isOver = (one) => !["queued", "running", "cancelling"].includes(one.state);

async function load() {
  const ticket = (loadCount += 1);
  try {
    const [openJobs, newest, loadedNames] = await Promise.all([api.get("/reconstructions?state=queued&state=running&limit=200"), api.get("/reconstructions?limit=100"), scanNames()]);
    names = loadedNames;
    const all = [...new Map([...openJobs.items, ...newest.items].map((one) => [one.id, one])).values()].sort((one, other) => (one.created < other.created ? 1 : -1));
    const open = byExpectedStart(all.filter((one) => !isOver(one))).slice(0, MAX_POSITION_QUERIES);
    const jobDetails = await Promise.all(open.map((/** @type {any} */ one) => api.get(`/reconstructions/${one.id}`).catch(() => one)));
    if (ticket !== loadCount || pendingChanges || isDragging) return; // outdated, or not to be shown during a drag
    const by = new Map(jobDetails.map((one) => [one.id, one]));
    items = all.map((one) => by.get(one.id) ?? one);
    show();
  } catch (error) {
    showError(panel, error, load);
  }
}

function show() {
  if (!items.length) {
    showEmpty(panel, "No reconstructions yet", "Select a scan and parameters, or run a scan first.",
      h("button", { type: "button", class: "primary", onclick: () => openForm({ again: null, scan: null, set: null }) }, "Reconstruct a scan"));
    return;
  }
  const unordered = items.filter((one) => !isOver(one) && !isWaiting(one));
  const open = [...unordered.filter(({ state }) => state === "running"), ...byPriority(waiting()), ...unordered.filter(({ state }) => state !== "running")];
  const done = items.filter(isOver);
  const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset.key;
  replace(panel, messages, positionStatus, h("div", { class: "scrolls" }, h("table", { class: "queue" },
    h("thead", null, h("tr", null, [h("span", { class: "small" }, "compare"), "State", "Method", "Scan", "Submitted, by", "Priority", ""].map((name) => h("th", null, name)))),
    h("tbody", null, [...open, ...done].map(row)))));
  if (focused) /** @type {HTMLElement | null} */ (panel.querySelector(`[data-key="${CSS.escape(focused)}"]`))?.focus();
  showSelection();
}

/** Sort unfinished jobs by expected start. @param {any[]} open newest first @returns {any[]} */
const byExpectedStart = (open) => [...open].reverse().sort((one, other) => Number(one.state === "queued") - Number(other.state === "queued") || one.priority - other.priority || one.turn - other.turn);

/** Return whether a job has a position in the queue. @param {any} one */
const isWaiting = (one) => one.state === "queued" && one.queue?.position !== null;

/** Return the queued jobs in order of their start tags, equal ones by age. */
const waiting = () => items.filter(isWaiting).reverse().sort((one, other) => one.turn - other.turn);

/** @param {any} one */
function row(one) {
  const box = h("input", { type: "checkbox", checked: selected.has(one.id), disabled: one.state !== "succeeded", "aria-label": `Side by side: ${one.id}`, dataset: { key: `box ${one.id}` } });
  box.addEventListener("change", () => {
    if (box.checked) selected.add(one.id);
    else selected.delete(one.id);
    showSelection();
  });
  return h("tr", { dataset: { row: one.id, state: one.state, ...(isWaiting(one) ? { waits: "" } : {}) } },
    h("td", null, isWaiting(one) ? createDragHandle(one.id, waitingRows, (to) => moveJob(one.id, to), setDragging) : box), h("td", { class: "state-cell" }, h("div", null, stateElement(one)), timeElement(one)),
    h("td", { class: "method" }, methodText(one), h("div", { class: "dim small" }, [soundSpeedText(one), one.id.slice(-5)].filter(Boolean).join(", "))), h("td", { class: "named" }, h("a", { href: `/scans/${one.scan_id}`, title: `${names.get(one.scan_id) ?? ""} ${one.scan_id}` }, names.get(one.scan_id) || `…${one.scan_id.slice(-5)}`)),
    h("td", { class: "nowrap" }, formatDate(one.created), h("span", { class: "by dim small", title: requesterOf(one) }, requesterOf(one))), h("td", { class: "nowrap" }, priorityElement(one)), h("td", null, h("div", { class: "actions" }, ...actionsOf(one))));
}

/** @param {any} one */
function timeElement(one) {
  const line = (/** @type {string} */ text) => h("div", { class: "dim small nowrap" }, text);
  if (!isOver(one)) return one.queue?.expected_end ? line(`expected end ${formatTime(one.queue.expected_end)}`) : null;
  const took = runSeconds(one);
  return took === null ? null : line(`duration ${duration(took)}`);
}

/** @param {any} one */
function priorityElement(one) {
  if (one.state !== "queued") return h("span", { class: "dim" }, String(one.priority));
  const move = (/** @type {number} */ by, /** @type {string} */ text, /** @type {string} */ label) => h("button", {
    type: "button", class: "quiet", "aria-label": `${label}: ${one.id}`, title: label, dataset: { key: `${label} ${one.id}` },
    onclick: () => runAction(() => api.patch(`/reconstructions/${one.id}`, { priority: Math.min(Math.max(one.priority + by, 0), 1000) })),
  }, text);
  return h("span", { class: "actions" }, move(-10, "↑", "Raise the priority"), String(one.priority), move(10, "↓", "Lower the priority"));
}

const waitingRows = () => /** @type {HTMLElement[]} */ ([...panel.querySelectorAll("[data-waits]")]);

/** @param {boolean} isActive whether the user drags a row; the queue reloads at the end of the drag */
function setDragging(isActive) {
  isDragging = isActive;
  if (!isActive) void load();
}

/** Move a job to a position in the queue; show the move at once and undo it if the service refuses. @param {string} id @param {number} to */
function moveJob(id, to) {
  const changes = priorityChanges(waiting(), id, to);
  if (!changes) return replace(messages, h("p", { class: "fault" }, "No free priority at this position; allowed: 0 to 1000."));
  const before = items;
  const by = new Map(changes.map((one) => [one.id, one.priority]));
  items = items.map((one) => (by.has(one.id) ? { ...one, priority: by.get(one.id) } : one));
  show();
  positionStatus.textContent = `Now at position ${to + 1} of ${waiting().length} in the queue.`;
  const submit = async () => {
    for (const one of changes) await api.patch(`/reconstructions/${one.id}`, { priority: one.priority });
  };
  void runAction(submit, () => {
    items = before;
    positionStatus.textContent = "";
    show();
  });
}

/** @param {any} one */
function actionsOf(one) {
  const details = h("a", { class: "button", href: `/reconstructions/${one.id}` }, "Details");
  const rerun = one.kind === "unmixing" ? [] : [h("a", { class: "button", href: `/reconstructions?again=${one.id}` }, "Rerun …")];
  if (!isOver(one)) {
    const cancel = h("button", { type: "button", disabled: one.desired_state === "cancelled", dataset: { key: `cancel ${one.id}` },
      onclick: () => runAction(() => api.put(`/jobs/${one.id}/desired-state`, { state: "cancelled", reason: "cancelled on the web page" })) }, "Cancel");
    return [details, cancel];
  }
  return one.state === "succeeded" ? [h("a", { class: "button", href: `/volumes/${one.id}` }, "Volume"), ...rerun, details] : [...rerun, details];
}

/** Run an action and reload; show an error above the table. @param {() => Promise<any>} action @param {() => void} [undo] restores the view after an error */
async function runAction(action, undo) {
  replace(messages);
  pendingChanges += 1;
  try {
    await action();
  } catch (error) {
    undo?.();
    replace(messages, ...errorElements(error));
  }
  pendingChanges -= 1;
  await load();
}

function showSelection() {
  const button = /** @type {HTMLAnchorElement} */ (byId("side-by-side"));
  const firstSelected = items.map((one) => one.id).filter((id) => selected.has(id)).slice(0, MAX_SIDE_BY_SIDE);
  button.textContent = selected.size > MAX_SIDE_BY_SIDE ? `Side by side: the first ${MAX_SIDE_BY_SIDE}` : `Side by side (${selected.size})`;
  button.href = urlOf(`/reconstructions?side=${firstSelected.join(",")}`);
  button.hidden = firstSelected.length < 2;
}

/** @param {{again: string | null, scan: string | null, set: any}} formQuery */
function openForm(formQuery) {
  void showRequestForm(formPanel, formQuery, () => {
    history.replaceState(null, "", urlOf("/reconstructions"));
    void load();
  });
}

/** @param {string | null} text */
function parseObject(text) {
  try {
    const parsed = JSON.parse(text ?? "null");
    return parsed && typeof parsed === "object" ? parsed : null;
  } catch {
    return null;
  }
}

function startPage() {
  const query = new URLSearchParams(location.search);
  const side = (query.get("side") ?? "").split(",").filter((id) => /^[A-Za-z0-9]{1,64}$/.test(id)).slice(0, MAX_SIDE_BY_SIDE);
  if (side.length) void showSideBySide(byId("side"), side);
  const rerunOf = query.get("again");
  if (rerunOf || query.has("scan")) openForm({ again: rerunOf, scan: query.get("scan"), set: parseObject(query.get("set")) });
  byId("new").addEventListener("click", () => openForm({ again: null, scan: null, set: null }));
  addShortcut("n", "Reconstruct a scan", () => byId("new").click());
  showLoading(panel);
  const loadSoon = debounce(load, RELOAD_DELAY);
  for (const kind of /** @type {const} */ (["reconstruction", "job", "again"])) live.on(kind, loadSoon);
  live.on("progress", (progress) => {
    const one = items.find(({ id }) => id === progress.id);
    const cell = panel.querySelector(`[data-row="${CSS.escape(String(progress.id))}"] .state-cell > :first-child`);
    if (!one || !cell) return;
    one.progress = { stage: progress.stage, done: progress.done, total: progress.total };
    replace(cell, stateElement(one));
  });
  void load();
}

startPage();
