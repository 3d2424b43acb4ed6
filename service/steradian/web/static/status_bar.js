// @ts-check
// The bar: how the scanners stand, with the age of it, the running scan, and the stop.
import { api } from "./api.js";
import { byId, h, put, renew, replace } from "./dom.js";
import { startFaults } from "./faults.js";
import { live } from "./event_stream.js";
import { seen, startLooking, watchAge } from "./scanner_status.js";
import { keepSession, signedOut, watchSession } from "./session.js";
import { doubtOfStop, laserOf, startStop, stopWords, watchStop, worksSince } from "./emergency_stop.js";
import { clock, count, duration } from "./units.js";
import { at } from "./urls.js";

export { watchScanner } from "./scanner_status.js";

const UNDER_WAY = ["arming", "running", "pausing", "paused", "stopping", "recovering", "completing", "aborting"].map((state) => `state=${state}`).join("&");

export function startBar() {
  live.on("scan", lookAtScan);
  live.on("again", lookAtScan);
  live.on("progress", (one) => one.kind === "scan" && one.id === scan?.id && showProgress(one));
  live.watch(showDoubt);
  watchStop(() => {
    showDoubt();
    showScanners();
  });
  watchSession(showDoubt);
  watchAge(showScanners);
  startFaults();
  startLooking();
  startStop();
  keepSession();
}

/** Whether what is shown is of now, and whether the stop can be relied on; "works" only where that has just been checked. */
function showDoubt() {
  const { is, since } = live.state;
  const [cut, out, doubt] = [is === "cut", signedOut(), doubtOfStop()];
  const works = (cut || out) && (!cut || worksSince(since)) && (!out || worksSince(out));
  const parts = [
    out ? "Signed out: what is shown here is not read any more." : cut ? `Not live since ${clock(since)}, trying again.` : "",
    doubt || (works ? "The emergency stop works." : ""),
  ];
  const line = byId("cut");
  const text = parts.filter(Boolean).join(" ");
  line.hidden = !text;
  if (line.textContent !== text) line.textContent = text;
}

const age = h("span", { class: "dim age", "aria-hidden": "true" }); // not told to screen readers each time

function showScanners() {
  const { scanners, asked, trouble } = seen();
  const pill = byId("scanner");
  const stopped = trouble && scanners.length === 1 && laserOf(scanners[0].id).laser === "off"; // a press has just been answered
  if (trouble) tell(h("span", { class: "fault" }, trouble), stopped ? h("span", { class: "dim" }, "laser off") : unknown());
  else if (!scanners.length) {
    if (asked.steady > 0) tell(h("span", { class: "dim" }, "the service knows no scanner"));
    return;
  } else if (scanners.length > 1) tell(...several(scanners));
  else tell(...one(scanners[0]));
  const seenAgo = trouble && !stopped ? null : oldest(scanners);
  const text = seenAgo === null ? "" : `seen ${Math.max(0, seenAgo).toFixed(1)} s ago`;
  if (age.textContent !== text) age.textContent = text;
  if (age.parentNode !== pill) pill.append(age);
}

/** Put it into the pill, if that says something else: a screen reader reads what is new. @param {...(Node | null)} children */
function tell(...children) {
  const pill = byId("scanner");
  const made = /** @type {HTMLElement} */ (pill.cloneNode(false));
  put(made, ...children);
  age.remove();
  if (!made.isEqualNode(pill)) pill.replaceChildren(...made.childNodes);
}

/** Seconds since the scanner was seen that was seen least recently; null where one of them is unknown. @param {any[]} scanners */
function oldest(scanners) {
  const ages = scanners.map((each) => laserOf(each.id).age);
  return ages.some((each) => each === null) ? null : Math.max(...ages.map(Number));
}

/** @param {string} [why] */
const unknown = (why) => h("span", { class: "fault" }, `laser: unknown${why ? ` (${why})` : ""}`);

/** A scanner: connection, stop, laser, shutter, interlock, and who has it. @param {any} scanner @returns {(Node | null)[]} */
function one(scanner) {
  const pill = byId("scanner");
  const { connection, lease } = scanner;
  const { laser, why, shutter, interlock } = laserOf(scanner.id);
  const stop = stopWords(scanner.id);
  const every = scanner.look_interval ? `The service asks the scanner every ${duration(scanner.look_interval)}, this page asks the service every second.` : "";
  pill.title = [scanner.last_error, every].filter(Boolean).join(" ");
  return [
    h("span", { class: connection === "connected" ? "" : isUnstarted(scanner) ? "dim" : "fault" }, `${scanner.simulated ? "Simulated scanner" : "Scanner"}: ${linkOf(scanner)}`),
    stop ? h("span", { class: "fault" }, stop) : null,
    laser === "unknown" ? unknown(why) : laser !== "off" ? h("span", { class: "laser" }, `laser ${laser}`) : stop === "stop sent" ? null : h("span", { class: "dim" }, "laser off"),
    gate("shutter", shutter, laser === "on" ? "open" : "closed"), gate("interlock", interlock, "closed"),
    lease ? h("span", { class: "dim" }, `reserved by ${lease.holder} until ${clock(lease.ends)}`) : null];
}

/** Whether a scanner is the built-in simulator before its first scan. @param {any} scanner */
const isUnstarted = ({ simulated, connection }) => simulated && connection === "unknown";

/** How the service and a scanner are connected, in words. @param {any} scanner */
function linkOf(scanner) {
  const { connection, holder } = scanner;
  if (isUnstarted(scanner)) return "not started";
  if (connection === "in-use") return `in use by ${holder ?? "another program"}`;
  if (connection === "disconnected") return "not connected";
  return connection === "connected" ? "connected" : "connection unknown";
}

/** @param {string} name @param {string} is @param {string} usual */
function gate(name, is, usual) {
  if (!is || is === "unknown") return null; // the laser's word says why
  return h("span", { class: is === usual ? "dim" : "fault" }, `${name} ${is}`);
}

/** Several scanners in a line: how many, whose laser is on, which are stopped, and what is wrong with which. @param {any[]} scanners */
function several(scanners) {
  byId("scanner").removeAttribute("title");
  const named = (/** @type {(one: any) => boolean} */ which) => scanners.filter(which).map((each) => each.id).join(", ");
  const lasers = /** @type {Map<string, string>} */ (new Map(scanners.map((each) => [each.id, laserOf(each.id).laser])));
  const stops = ["stop sent", "stop not confirmed", "stopped"].map((how) => [how, named((each) => stopWords(each.id) === how)]);
  const list = (/** @type {string} */ what, /** @type {string} */ names, kind = "fault") => (names ? h("span", { class: kind }, `${what}: ${names}`) : null);
  const off = [...lasers.values()].every((laser) => laser === "off") && !stops[0][1];
  return [
    h("span", null, `${scanners.length} scanners`),
    list("laser on", named(({ id }) => lasers.get(id) === "on"), "laser"),
    list("laser armed", named(({ id }) => lasers.get(id) === "armed"), "laser"),
    list("laser unknown", named(({ id }) => lasers.get(id) === "unknown")),
    off ? h("span", { class: "dim" }, "laser off") : null,
    ...stops.map(([how, names]) => list(how, names)),
    list("not connected", named((each) => each.connection === "disconnected")),
    list("in use by another program", named((each) => each.connection === "in-use")),
    list("interlock open", named((each) => laserOf(each.id).interlock === "open"))];
}

/** @type {any} */
let scan = null;

async function lookAtScan() {
  try {
    const found = await api.get(`/scans?${UNDER_WAY}&limit=1`);
    scan = found.items[0] ?? null;
    const { done, total } = scan?.progress ?? {};
    if (scan) showProgress({ id: scan.id, done, total, eta: null });
    else replace(byId("running"));
  } catch {
    // the pill says that nobody answers
  }
}

/** @param {{id: string, done: number, total: number, eta: number | null}} about */
function showProgress({ id, done, total, eta }) {
  const left = eta === null ? "" : `${duration(eta)} left`;
  renew(byId("running"),
    h("a", { href: at(`/scans/${id}`) }, scan?.id === id && scan.state === "paused" ? "scan paused" : "scan"),
    h("progress", { max: total || 1, value: done, "aria-label": "Progress of the scan" }),
    h("span", null, `${count(done)} of ${count(total)}`), h("span", { class: "dim" }, left));
}
