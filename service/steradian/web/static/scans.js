// @ts-check
// Table of all scans, newest first, with thumbnails and live progress.
import { api } from "./api.js";
import { byId, oncePerFrame, h, replaceKeepingFocus, replace } from "./dom.js";
import { live } from "./event_stream.js";
import { isSurveyOnly, stateLabel } from "./scan/stages.js";
import { ScanFacts, UNKNOWN } from "./scan_facts.js";
import { ScanThumbnails } from "./scan_thumbnails.js";
import { showEmpty, showError, showLoading } from "./panel_states.js";
import { formatDate, count, identifierElement } from "./units.js";

const host = byId("scans");
const search = h("input", { type: "search", placeholder: "Search labels, states …", "aria-label": "Search", "data-search": true, oninput: () => draw() });
const body = h("div", { class: "scrolls" });
const facts = new ScanFacts(() => draw());
const thumbnails = new ScanThumbnails((id) => {
  const scan = scans.find((one) => one.id === id);
  if (scan) facts.request(scan); // it may have left the list
});
/** Explanations of columns. @type {Record<string, string>} */
const TITLES = { Depth: "Depth of the mask's point of interest", Wavelengths: "Excitation wavelengths of the plan", Date: "Start of the scan, or its import" };
const NUMBERS = new Set(["Points", "Depth", "A-lines"]);
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
  const hasWavelengths = matches.some((scan) => !["", UNKNOWN.wavelengths].includes(facts.of(scan).wavelengths));
  const columns = ["Scan", "State", "Points", "Depth", ...(hasWavelengths ? ["Wavelengths"] : []), "A-lines", "Labels", "Date"];
  replaceKeepingFocus(body, h("table", null,
    h("thead", null, h("tr", null, h("td"), columns.map((name) => h("th", { scope: "col", class: NUMBERS.has(name) ? "number" : "", title: TITLES[name] ?? null }, name)))),
    h("tbody", null, matches.map((scan) => row(scan, hasWavelengths)))),
    matches.length ? null : h("p", { class: "dim" }, "No scan matches the search."),
    nextPage ? h("p", { class: "dim" }, "Only the newest 100 scans are shown; use the API to list older scans.") : null);
});

/** @param {any} scan */
function textOf(scan) {
  return [scan.id, scan.state, stateLabel(scan), ...Object.entries(scan.labels).flat()].join(" ").toLowerCase();
}

/** @param {any} scan @param {boolean} hasWavelengths whether there is a column of them */
function row(scan, hasWavelengths) {
  const { done, total } = scan.progress;
  const isFault = scan.state === "failed" || scan.state === "interrupted";
  const stored = scan.summary ? scan.summary.stored : done;
  const planned = scan.summary?.points ?? total;
  const { points, depth, wavelengths } = facts.of(scan);
  return h("tr", null,
    h("td", null, h("a", { href: `/scans/${scan.id}`, tabindex: -1, "aria-hidden": "true" }, thumbnails.of(scan.id))),
    h("td", null, identifierElement(scan.id, `/scans/${scan.id}`)),
    h("td", { class: isFault ? "fault" : "" }, stateLabel(scan), scan.simulated ? h("span", { class: "dim" }, " (simulated)") : null),
    h("td", { class: "number" }, points), h("td", { class: "number nowrap" }, isSurveyOnly(scan) ? h("span", { class: "dim", title: "The scan ended before its focus" }, "none") : depth), hasWavelengths ? h("td", { class: "nowrap" }, wavelengths || h("span", { class: "dim" }, "not stated")) : null,
    h("td", { class: "number" }, stored === planned ? count(stored) : `${count(stored)} of ${count(planned)}`),
    h("td", null, Object.entries(scan.labels).map(([name, value]) => h("span", { class: "label" }, `${name}: ${value}`))),
    h("td", { class: "nowrap" }, formatDate(scan.started ?? scan.created)));
}

showLoading(body);
replace(host, h("div", { class: "row spread" }, search, h("a", { class: "button", href: "/design" }, "New design")), body);
live.on("scan", read);
live.on("again", read);
live.on("reconstruction", (one) => one.state === "succeeded" && thumbnails.refresh(one.scan_id));
live.on("revision", (one) => thumbnails.refresh(one.scan_id));
live.on("progress", (one) => {
  const scan = scans.find(({ id }) => id === one.id);
  if (!scan) return;
  scan.progress = { ...scan.progress, done: one.done, total: one.total };
  draw();
});
void read();
