// @ts-check
// The queue as a table: what waits, runs and is done, to move, cancel, look at and make again.
import { api } from "../api.js";
import { byId, h, replace, settled } from "../dom.js";
import { addKey } from "../shortcuts.js";
import { live } from "../event_stream.js";
import { empty, failed, loading, words } from "../panel_states.js";
import { clock, duration } from "../units.js";
import { showForm } from "./request_form.js";
import { handle } from "./drag_handle.js";
import { inOrder, toPlace } from "./queue_order.js";
import { showSide } from "./side_by_side.js";
import { askedBy, methodOf, namesOfScans, speedOf, stateOf, tookOf } from "./summary.js";
import { at } from "../urls.js";

const MOST_SIDE = 4;
const LOOKED_UP = 12; // jobs not over whose place in the queue is asked for
const RELOAD = 250;

const chosen = new Set(/** @type {string[]} */ ([]));
/** @type {any[]} */
let items = [];
/** @type {Map<string, string>} */
let names = new Map();
const panel = byId("reconstructions");
const asking = byId("asking");
const told = h("div", { role: "alert" });
const placed = h("p", { class: "visually-hidden", role: "status" });
let isHeld = false; // a row is in somebody's hand
let moves = 0; // under way
let loads = 0;

/** @param {any} one */
const isOver = (one) => !["queued", "running", "cancelling"].includes(one.state);

async function load() {
  const mine = (loads += 1);
  try {
    const [under, newest, known] = await Promise.all([api.get("/reconstructions?state=queued&state=running&limit=200"), api.get("/reconstructions?limit=100"), namesOfScans()]);
    names = known;
    const all = [...new Map([...under.items, ...newest.items].map((one) => [one.id, one])).values()].sort((one, other) => (one.created < other.created ? 1 : -1));
    const open = soonest(all.filter((one) => !isOver(one))).slice(0, LOOKED_UP);
    const looked = await Promise.all(open.map((/** @type {any} */ one) => api.get(`/reconstructions/${one.id}`).catch(() => one)));
    if (mine !== loads || moves || isHeld) return; // older than what is shown, or not to be shown now
    const by = new Map(looked.map((one) => [one.id, one]));
    items = all.map((one) => by.get(one.id) ?? one);
    show();
  } catch (error) {
    failed(panel, error, load);
  }
}

function show() {
  if (!items.length) {
    empty(panel, "Nothing has been reconstructed yet", "Choose a scan and its parameters, or make a scan first.",
      h("button", { type: "button", class: "primary", onclick: () => ask({ again: null, scan: null, set: null }) }, "Reconstruct a scan"));
    return;
  }
  const rest = items.filter((one) => !isOver(one) && !isWaiting(one));
  const open = [...rest.filter(({ state }) => state === "running"), ...inOrder(waiting()), ...rest.filter(({ state }) => state !== "running")];
  const done = items.filter(isOver);
  const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset.key;
  replace(panel, told, placed, h("div", { class: "scrolls" }, h("table", { class: "queue" },
    h("thead", null, h("tr", null, [h("span", { class: "small" }, "compare"), "State", "Method", "Scan", "Asked for, by", "Priority", ""].map((name) => h("th", null, name)))),
    h("tbody", null, [...open, ...done].map(row)))));
  if (focused) /** @type {HTMLElement | null} */ (panel.querySelector(`[data-key="${CSS.escape(focused)}"]`))?.focus();
  showChosen();
}

/** What is not over, in the order in which it will be. @param {any[]} open newest first @returns {any[]} */
const soonest = (open) => [...open].reverse().sort((one, other) => Number(one.state === "queued") - Number(other.state === "queued") || one.priority - other.priority || one.turn - other.turn);

/** Whether a job has a place in the queue, and waits for no scan. @param {any} one */
const isWaiting = (one) => one.state === "queued" && one.queue?.position !== null;

/** What has a place in the queue, in its turns, equal ones by age: the service lists the newest first. */
const waiting = () => items.filter(isWaiting).reverse().sort((one, other) => one.turn - other.turn);

/** @param {any} one */
function row(one) {
  const box = h("input", { type: "checkbox", checked: chosen.has(one.id), disabled: one.state !== "succeeded", "aria-label": `Side by side: ${one.id}`, dataset: { key: `box ${one.id}` } });
  box.addEventListener("change", () => {
    if (box.checked) chosen.add(one.id);
    else chosen.delete(one.id);
    showChosen();
  });
  return h("tr", { dataset: { row: one.id, state: one.state, ...(isWaiting(one) ? { waits: "" } : {}) } },
    h("td", null, isWaiting(one) ? handle(one.id, waitingRows, (to) => put(one.id, to), hold) : box), h("td", { class: "state-cell" }, h("div", null, stateOf(one)), timeOf(one)),
    h("td", { class: "nowrap" }, methodOf(one), h("div", { class: "dim small" }, [speedOf(one), one.id.slice(-5)].filter(Boolean).join(", "))), h("td", { class: "named" }, h("a", { href: `/scans/${one.scan_id}`, title: `${names.get(one.scan_id) ?? ""} ${one.scan_id}` }, names.get(one.scan_id) || `…${one.scan_id.slice(-5)}`)),
    h("td", { class: "nowrap" }, clock(one.created), h("span", { class: "by dim small", title: askedBy(one) }, askedBy(one))), h("td", { class: "nowrap" }, priorityOf(one)), h("td", null, h("div", { class: "actions" }, ...actionsOf(one))));
}

/** @param {any} one */
function timeOf(one) {
  const say = (/** @type {string} */ text) => h("div", { class: "dim small nowrap" }, text);
  if (!isOver(one)) return one.queue?.expected_end ? say(`done at about ${clock(one.queue.expected_end)}`) : null;
  const took = tookOf(one);
  return took === null ? null : say(`took ${duration(took)}`);
}

/** @param {any} one */
function priorityOf(one) {
  if (one.state !== "queued") return h("span", { class: "dim" }, String(one.priority));
  const move = (/** @type {number} */ by, /** @type {string} */ text, /** @type {string} */ label) => h("button", {
    type: "button", class: "quiet", "aria-label": `${label}: ${one.id}`, title: label, dataset: { key: `${label} ${one.id}` },
    onclick: () => act(() => api.patch(`/reconstructions/${one.id}`, { priority: Math.min(Math.max(one.priority + by, 0), 1000) })),
  }, text);
  return h("span", { class: "actions" }, move(-10, "↑", "Sooner"), String(one.priority), move(10, "↓", "Later"));
}

const waitingRows = () => /** @type {HTMLElement[]} */ ([...panel.querySelectorAll("[data-waits]")]);

/** @param {boolean} is whether a row is in somebody's hand; what has come meanwhile is shown when it is let go */
function hold(is) {
  isHeld = is;
  if (!is) void load();
}

/** Have a job begin as the one at a place among those that wait; shown at once, and taken back where it is refused. @param {string} id @param {number} to */
function put(id, to) {
  const changes = toPlace(waiting(), id, to);
  if (!changes) return replace(told, h("p", { class: "fault" }, "No priority is left there: the smallest is 0, the largest 1000."));
  const before = items;
  const by = new Map(changes.map((one) => [one.id, one.priority]));
  items = items.map((one) => (by.has(one.id) ? { ...one, priority: by.get(one.id) } : one));
  show();
  placed.textContent = `Now number ${to + 1} of ${waiting().length} that wait.`;
  const ask = async () => {
    for (const one of changes) await api.patch(`/reconstructions/${one.id}`, { priority: one.priority });
  };
  void act(ask, () => {
    items = before;
    placed.textContent = "";
    show();
  });
}

/** @param {any} one */
function actionsOf(one) {
  const details = h("a", { class: "button", href: `/reconstructions/${one.id}` }, "Details");
  const again = h("a", { class: "button", href: `/reconstructions?again=${one.id}` }, "Again …");
  if (!isOver(one)) {
    const cancel = h("button", { type: "button", disabled: one.desired_state === "cancelled", dataset: { key: `cancel ${one.id}` },
      onclick: () => act(() => api.put(`/jobs/${one.id}/desired-state`, { state: "cancelled", reason: "cancelled on the page" })) }, "Cancel");
    return [details, cancel];
  }
  return one.state === "succeeded" ? [h("a", { class: "button", href: `/volumes/${one.id}` }, "Volume"), again, details] : [again, details];
}

/** Do something, then look; what is refused is said above the table. @param {() => Promise<any>} deed @param {() => void} [undo] what was shown before it was done */
async function act(deed, undo) {
  replace(told);
  moves += 1;
  try {
    await deed();
  } catch (error) {
    undo?.();
    replace(told, ...words(error));
  }
  moves -= 1;
  await load();
}

function showChosen() {
  const button = /** @type {HTMLAnchorElement} */ (byId("side-by-side"));
  const some = items.map((one) => one.id).filter((id) => chosen.has(id)).slice(0, MOST_SIDE);
  button.textContent = chosen.size > MOST_SIDE ? `Side by side: the first ${MOST_SIDE}` : `Side by side (${chosen.size})`;
  button.href = at(`/reconstructions?side=${some.join(",")}`);
  button.hidden = some.length < 2;
}

/** @param {{again: string | null, scan: string | null, set: any}} wanted */
function ask(wanted) {
  void showForm(asking, wanted, () => {
    history.replaceState(null, "", at("/reconstructions"));
    void load();
  });
}

/** @param {string | null} text */
function parsed(text) {
  try {
    const found = JSON.parse(text ?? "null");
    return found && typeof found === "object" ? found : null;
  } catch {
    return null;
  }
}

function start() {
  const query = new URLSearchParams(location.search);
  const side = (query.get("side") ?? "").split(",").filter((id) => /^[A-Za-z0-9]{1,64}$/.test(id)).slice(0, MOST_SIDE);
  if (side.length) void showSide(byId("side"), side);
  const again = query.get("again");
  if (again || query.has("scan")) ask({ again, scan: query.get("scan"), set: parsed(query.get("set")) });
  byId("new").addEventListener("click", () => ask({ again: null, scan: null, set: null }));
  addKey("n", "Reconstruct a scan", () => byId("new").click());
  loading(panel);
  const soon = settled(load, RELOAD);
  for (const kind of /** @type {const} */ (["reconstruction", "job", "again"])) live.on(kind, soon);
  live.on("progress", (seen) => {
    const one = items.find(({ id }) => id === seen.id);
    const cell = panel.querySelector(`[data-row="${CSS.escape(String(seen.id))}"] .state-cell > :first-child`);
    if (!one || !cell) return;
    one.progress = { stage: seen.stage, done: seen.done, total: seen.total };
    replace(cell, stateOf(one));
  });
  void load();
}

start();
