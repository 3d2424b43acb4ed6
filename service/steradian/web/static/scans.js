// @ts-check
// Table of all scans, newest first, with live progress.
import { api } from "./api.js";
import { byId, oncePerFrame, h, replaceKeepingFocus, replace } from "./dom.js";
import { live } from "./event_stream.js";
import { STATE_LABELS } from "./scan/states.js";
import { showEmpty, showError, showLoading } from "./panel_states.js";
import { formatTime, count, identifierElement } from "./units.js";

const host = byId("scans");
const search = h("input", { type: "search", placeholder: "Search labels, states …", "aria-label": "Search", "data-search": true, oninput: () => draw() });
const body = h("div", { class: "scrolls" });
/** @type {any[]} */
let scans = [];
let nextPage = "";

async function read() {
  try {
    const response = await api.request("GET", "/scans?limit=100");
    nextPage = response.headers.get("Link") ?? "";
    scans = (await response.json()).items;
    draw();
  } catch (error) {
    if (!scans.length) showError(body, error, read);
  }
}

const draw = oncePerFrame(() => {
  if (!scans.length) {
    showEmpty(body, "No scans yet", "Design a mask and a scan plan first.", h("a", { class: "button primary", href: "/design" }, "Design a scan"));
    return;
  }
  const searchText = search.value.trim().toLowerCase();
  const matches = scans.filter((scan) => !searchText || textOf(scan).includes(searchText));
  replaceKeepingFocus(body, h("table", null,
    h("thead", null, h("tr", null, ["Scan", "State", "A-lines", "Labels", "Started"].map((name) => h("th", { scope: "col", class: name === "A-lines" ? "number" : "" }, name)))),
    h("tbody", null, matches.map(row))),
    matches.length ? null : h("p", { class: "dim" }, "No scan matches the search."),
    nextPage ? h("p", { class: "dim" }, "Only the newest 100 scans are shown; use the API to list older scans.") : null);
});

/** @param {any} scan */
function textOf(scan) {
  return [scan.id, scan.state, STATE_LABELS[scan.state], ...Object.entries(scan.labels).flat()].join(" ").toLowerCase();
}

/** @param {any} scan */
function row(scan) {
  const { done, total } = scan.progress;
  const isFault = scan.state === "failed" || scan.state === "interrupted";
  const stored = scan.summary ? scan.summary.stored : done;
  return h("tr", null,
    h("td", null, identifierElement(scan.id, `/scans/${scan.id}`)),
    h("td", { class: isFault ? "fault" : "" }, STATE_LABELS[scan.state] ?? scan.state, scan.simulated ? h("span", { class: "dim" }, " (simulated)") : null),
    h("td", { class: "number" }, `${count(stored)} of ${count(scan.summary?.points ?? total)}`),
    h("td", null, Object.entries(scan.labels).map(([name, value]) => h("span", { class: "label" }, `${name}: ${value}`))),
    h("td", { class: "nowrap" }, formatTime(scan.started ?? scan.created)));
}

showLoading(body);
replace(host, h("div", { class: "row spread" }, search, h("a", { class: "button", href: "/design" }, "New design")), body);
live.on("scan", read);
live.on("again", read);
live.on("progress", (one) => {
  const scan = scans.find(({ id }) => id === one.id);
  if (!scan) return;
  scan.progress = { ...scan.progress, done: one.done, total: one.total };
  draw();
});
void read();
