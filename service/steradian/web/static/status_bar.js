// @ts-check
// Status bar: scanners with the age of their status, running scan, emergency stop.
import { api } from "./api.js";
import { byId, h, append, replaceKeepingFocus, replace } from "./dom.js";
import { startFaults } from "./faults.js";
import { live } from "./event_stream.js";
import { lastStatus, startPolling, onTick } from "./scanner_status.js";
import { startRenewal, signedOut, onSession } from "./session.js";
import { stopWarning, laserStatus, startStop, stopLabel, onStop, acceptedSince } from "./emergency_stop.js";
import { formatTime, count, duration, signed } from "./units.js";
import { urlOf } from "./urls.js";

export { onScanners } from "./scanner_status.js";

const ACTIVE_STATES = ["arming", "running", "pausing", "paused", "stopping", "recovering", "completing", "aborting"].map((state) => `state=${state}`).join("&");

export function startBar() {
  live.on("scan", readActiveScan);
  live.on("again", readActiveScan);
  live.on("progress", (one) => one.kind === "scan" && one.id === scan?.id && showProgress(one));
  live.watch(showWarnings);
  onStop(() => {
    showWarnings();
    showScanners();
  });
  onSession(showWarnings);
  onTick(showScanners);
  startFaults();
  startPolling();
  startStop();
  startRenewal();
}

/** Show whether the values are live and whether the stop works. */
function showWarnings() {
  const { is, since } = live.state;
  const [isCut, signedOutSince, warning] = [is === "cut", signedOut(), stopWarning()];
  const isConfirmed = (isCut || signedOutSince) && (!isCut || acceptedSince(since)) && (!signedOutSince || acceptedSince(signedOutSince));
  const parts = [
    signedOutSince ? "Signed out: the values on this page are no longer updated." : isCut ? `Not live since ${formatTime(since)}, reconnecting.` : "",
    warning || (isConfirmed ? "The emergency stop works." : ""),
  ];
  const line = byId("cut");
  const text = parts.filter(Boolean).join(" ");
  line.hidden = !text;
  if (line.textContent !== text) line.textContent = text;
}

const age = h("span", { class: "dim age", "aria-hidden": "true" }); // hidden from screen readers, because it changes several times a second

function showScanners() {
  const { scanners, requestedAt, failure } = lastStatus();
  const pill = byId("scanner");
  const stopped = failure && scanners.length === 1 && laserStatus(scanners[0].id).laser === "off"; // the answer to a stop is newer than the poll
  if (failure) updatePill(h("span", { class: "fault" }, failure), stopped ? h("span", { class: "dim" }, "laser off") : unknownLaser());
  else if (!scanners.length) {
    if (requestedAt.steady > 0) updatePill(h("span", { class: "dim" }, "no scanner is registered"));
    return;
  } else if (scanners.length > 1) updatePill(...describeScanners(scanners));
  else updatePill(...describeScanner(scanners[0]));
  const statusAge = failure && !stopped ? null : maxAge(scanners);
  const text = statusAge === null ? "" : `updated ${signed(Math.max(0, statusAge), 1)} s ago`;
  if (age.textContent !== text) age.textContent = text;
  if (age.parentNode !== pill) pill.append(age);
}

/** Update the status pill only on a change, because screen readers announce changes. @param {...(Node | null)} children */
function updatePill(...children) {
  const pill = byId("scanner");
  const candidate = /** @type {HTMLElement} */ (pill.cloneNode(false));
  append(candidate, ...children);
  age.remove();
  if (!candidate.isEqualNode(pill)) pill.replaceChildren(...candidate.childNodes);
}

/** Return the largest status age of all scanners in seconds; null if one is unknown. @param {any[]} scanners */
function maxAge(scanners) {
  const ages = scanners.map((each) => laserStatus(each.id).age);
  return ages.some((each) => each === null) ? null : Math.max(...ages.map(Number));
}

/** @param {string} [reason] */
const unknownLaser = (reason) => h("span", { class: "fault" }, `laser: unknown${reason ? ` (${reason})` : ""}`);

/** Describe one scanner: connection, stop, laser, shutter, interlock and lease. @param {any} scanner @returns {(Node | null)[]} */
function describeScanner(scanner) {
  const pill = byId("scanner");
  const { connection, lease } = scanner;
  const { laser, reason, shutter, interlock } = laserStatus(scanner.id);
  const stop = stopLabel(scanner.id);
  const intervalText = scanner.look_interval ? `The service polls the scanner every ${duration(scanner.look_interval)}. This page polls the service every second.` : "";
  pill.title = [scanner.last_error, intervalText].filter(Boolean).join(" ");
  return [
    h("span", { class: connection === "connected" ? "" : isNotStarted(scanner) ? "dim" : "fault" }, `${scanner.simulated ? "Simulated scanner" : "Scanner"}: ${connectionText(scanner)}`),
    stop ? h("span", { class: "fault" }, stop) : null,
    laser === "unknown" ? unknownLaser(reason) : laser !== "off" ? h("span", { class: "laser" }, `laser ${laser}`) : stop === "stop sent" ? null : h("span", { class: "dim" }, "laser off"),
    interlockText("shutter", shutter, laser === "on" ? "open" : "closed"), interlockText("interlock", interlock, "closed"),
    lease ? h("span", { class: "dim" }, `reserved by ${lease.holder} until ${formatTime(lease.ends)}`) : null];
}

/** Return whether the scanner is the built-in simulator before its first scan. @param {any} scanner */
const isNotStarted = ({ simulated, connection }) => simulated && connection === "unknown";

/** Describe the connection between the service and a scanner. @param {any} scanner */
function connectionText(scanner) {
  const { connection, holder } = scanner;
  if (isNotStarted(scanner)) return "not started";
  if (connection === "in-use") return `in use by ${holder ?? "another program"}`;
  if (connection === "disconnected") return "not connected";
  return connection === "connected" ? "connected" : "connection unknown";
}

/** @param {string} name @param {string} is @param {string} safeValue */
function interlockText(name, is, safeValue) {
  if (!is || is === "unknown") return null; // the laser status shows the reason
  return h("span", { class: is === safeValue ? "dim" : "fault" }, `${name} ${is}`);
}

/** Summarise several scanners: number, lasers, stops and faults by scanner. @param {any[]} scanners */
function describeScanners(scanners) {
  byId("scanner").removeAttribute("title");
  const idsOf = (/** @type {(one: any) => boolean} */ predicate) => scanners.filter(predicate).map((each) => each.id).join(", ");
  const lasers = /** @type {Map<string, string>} */ (new Map(scanners.map((each) => [each.id, laserStatus(each.id).laser])));
  const stops = ["stop sent", "stop not confirmed", "stopped"].map((stopText) => [stopText, idsOf((each) => stopLabel(each.id) === stopText)]);
  const list = (/** @type {string} */ label, /** @type {string} */ names, kind = "fault") => (names ? h("span", { class: kind }, `${label}: ${names}`) : null);
  const allOff = [...lasers.values()].every((laser) => laser === "off") && !stops[0][1];
  return [
    h("span", null, `${scanners.length} scanners`),
    list("laser on", idsOf(({ id }) => lasers.get(id) === "on"), "laser"),
    list("laser armed", idsOf(({ id }) => lasers.get(id) === "armed"), "laser"),
    list("laser unknown", idsOf(({ id }) => lasers.get(id) === "unknown")),
    allOff ? h("span", { class: "dim" }, "laser off") : null,
    ...stops.map(([stopText, names]) => list(stopText, names)),
    list("not connected", idsOf((each) => each.connection === "disconnected")),
    list("in use by another program", idsOf((each) => each.connection === "in-use")),
    list("interlock open", idsOf((each) => laserStatus(each.id).interlock === "open"))];
}

/** @type {any} */
let scan = null;

async function readActiveScan() {
  try {
    const response = await api.get(`/scans?${ACTIVE_STATES}&limit=1`);
    scan = response.items[0] ?? null;
    const { done, total } = scan?.progress ?? {};
    if (scan) showProgress({ id: scan.id, done, total, eta: null });
    else replace(byId("running"));
  } catch {
    // the status pill shows that the service does not answer
  }
}

/** @param {{id: string, done: number, total: number, eta: number | null}} about */
function showProgress({ id, done, total, eta }) {
  const left = eta === null ? "" : `${duration(eta)} left`;
  replaceKeepingFocus(byId("running"),
    h("a", { href: urlOf(`/scans/${id}`) }, scan?.id === id && scan.state === "paused" ? "scan paused" : "scan"),
    h("progress", { max: total || 1, value: done, "aria-label": "Progress of the scan" }),
    h("span", null, `${count(done)} of ${count(total)}`), h("span", { class: "dim" }, left));
}
