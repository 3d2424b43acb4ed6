// @ts-check
// All scans, newest first; those that run move.
import { api } from "./api.js";
import { byId, framed, h, renew, replace } from "./dom.js";
import { live } from "./event_stream.js";
import { STATES } from "./scan/states.js";
import { empty, failed, loading } from "./panel_states.js";
import { clock, count, identifierOf } from "./units.js";

const host = byId("scans");
const search = h("input", { type: "search", placeholder: "Search labels, states …", "aria-label": "Search", "data-search": true, oninput: () => draw() });
const body = h("div", { class: "scrolls" });
/** @type {any[]} */
let scans = [];
let more = "";

async function read() {
  try {
    const answer = await api.ask("GET", "/scans?limit=100");
    more = answer.headers.get("Link") ?? "";
    scans = (await answer.json()).items;
    draw();
  } catch (error) {
    if (!scans.length) failed(body, error, read);
  }
}

const draw = framed(() => {
  if (!scans.length) {
    empty(body, "No scans yet", "A scan begins with a design: where to sense, and how fast.", h("a", { class: "button primary", href: "/design" }, "Design a scan"));
    return;
  }
  const wanted = search.value.trim().toLowerCase();
  const shown = scans.filter((scan) => !wanted || textOf(scan).includes(wanted));
  renew(body, h("table", null,
    h("thead", null, h("tr", null, ["Scan", "State", "A-lines", "Labels", "Began"].map((name) => h("th", { scope: "col", class: name === "A-lines" ? "number" : "" }, name)))),
    h("tbody", null, shown.map(row))),
    shown.length ? null : h("p", { class: "dim" }, "No scan has that."),
    more ? h("p", { class: "dim" }, "The newest 100 are shown; older ones by the API.") : null);
});

/** @param {any} scan */
function textOf(scan) {
  return [scan.id, scan.state, STATES[scan.state], ...Object.entries(scan.labels).flat()].join(" ").toLowerCase();
}

/** @param {any} scan */
function row(scan) {
  const { done, total } = scan.progress;
  const bad = scan.state === "failed" || scan.state === "interrupted";
  const stored = scan.summary ? scan.summary.stored : done;
  return h("tr", null,
    h("td", null, identifierOf(scan.id, `/scans/${scan.id}`)),
    h("td", { class: bad ? "fault" : "" }, STATES[scan.state] ?? scan.state, scan.simulated ? h("span", { class: "dim" }, " (simulated)") : null),
    h("td", { class: "number" }, `${count(stored)} of ${count(scan.summary?.points ?? total)}`),
    h("td", null, Object.entries(scan.labels).map(([name, value]) => h("span", { class: "label" }, `${name}: ${value}`))),
    h("td", { class: "nowrap" }, clock(scan.started ?? scan.created)));
}

loading(body);
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
