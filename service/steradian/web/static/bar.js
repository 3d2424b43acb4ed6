// @ts-check
// The bar: how the scanner stands, the running scan, and the stop, which needs neither the event stream nor a look.
import { api, Problem } from "./api.js";
import { byId, h, openDialog, put, renew, replace } from "./dom.js";
import { live } from "./live.js";
import { count, clock, duration } from "./units.js";

/** @param {string} name */
const stopOf = (name) => `/scanners/${name}/emergency-stop`;
const EVERY_STOP = "/emergency-stop"; // who exists, the service knows, also without its database
const PATIENCE = 1500;
const LOOK = 3000;
const HANGS = 10_000; // a press that has no answer by then is sent anew
const TRY_AGAIN = 500;
const UNDER_WAY = ["arming", "running", "pausing", "paused", "stopping", "recovering", "completing", "aborting"].map((state) => `state=${state}`).join("&");
const SWITCH = "use the hardware switch";

/** @type {any[]} how they stand, as far as that is known */
let scanners = [];
/** @type {any} the first of them */
let scanner = null;
/** @type {Set<(scanner: any, all: any[]) => void>} */
const watchers = new Set();
/** @type {any} the last press of this page, until it is released */
let press = null;
/** @type {string} */
let shown = "";
let looks = 0; // under way

/** Be told, now and whenever it is looked at, how the first scanner stands, and all; null while nobody answers. @param {(scanner: any, all: any[]) => void} act */
export function watchScanner(act) {
  watchers.add(act);
  if (scanner) act(scanner, scanners);
}

export function startBar() {
  byId("stop").addEventListener("click", () => void stop());
  document.addEventListener("keydown", (event) => {
    if (event.key === "." && event.ctrlKey) {
      event.preventDefault();
      if (!event.repeat) void stop();
    }
  }, { capture: true });
  live.on("scanner", look);
  live.on("again", look);
  live.on("scan", lookAtScan);
  live.on("again", lookAtScan);
  live.on("progress", (one) => one.kind === "scan" && one.id === scan?.id && showProgress(one));
  live.watch(({ is, since }) => {
    const line = byId("cut");
    line.hidden = is !== "cut";
    line.textContent = is === "cut" ? `Not live since ${clock(since)}, trying again. The emergency stop works.` : "";
  });
  setInterval(() => document.hidden || looks || look(), LOOK);
}

/** Press the stop of every scanner; it is sent again until the service has taken it. */
async function stop() {
  press = { sent: clock(new Date()), answers: null, silent: false };
  const mine = press;
  showStop();
  const timer = setTimeout(() => {
    mine.silent = true;
    if (press === mine) showStop();
  }, PATIENCE);
  await send(mine);
  clearTimeout(timer);
  if (press === mine) showStop();
  look();
}

/** @param {any} mine the press */
async function send(mine) {
  while (press === mine && !mine.answers) {
    try {
      const { items } = await api.post(EVERY_STOP, { reason: "pressed on the page" }, { urgent: true, signal: AbortSignal.timeout(HANGS) });
      mine.answers = new Map(items.map((/** @type {any} */ one) => [one.id, one.emergency_stop]));
    } catch (error) {
      mine.silent = true;
      mine.why = error instanceof Problem ? error.message : "the service does not answer";
      if (press === mine) showStop();
      await new Promise((go) => setTimeout(go, TRY_AGAIN));
    }
  }
}

/** The stops that stand and their scanners, as the press was answered or else as the service knows. @returns {[string, any][]} */
function standing() {
  if (press) return press.answers ? [...press.answers] : [];
  return scanners.filter((one) => one.emergency_stop).map((one) => [one.id, one.emergency_stop]);
}

/** The one of them of which least good is known, and its scanner, or null. @returns {[string, any] | null} */
function worst() {
  const all = standing();
  return ["unconfirmed", "off", "idle"].map((laser) => all.find(([, stop]) => stop.laser === laser)).find(Boolean) ?? null;
}

/** What is known of a press, in words. @param {[string, any]} of scanner and stop */
function verdict([name, stop]) {
  if (stop.laser === "off") return `laser off (confirmed by the device${stop.seconds === null ? "" : `, ${duration(stop.seconds)}`})`;
  if (stop.laser === "idle") return "no scan ran; the laser was not armed";
  return `no answer from ${scanners.length > 1 ? name : "the scanner"}: ${SWITCH}`;
}

function showStop() {
  if (scanner) showScanner();
  const panel = byId("stopped");
  const least = worst();
  const stop = least?.[1];
  if (!press && !stop) {
    panel.hidden = true;
    shown = "";
    return;
  }
  const none = press?.answers && !stop; // it was taken, and there was nobody to press it for
  const head = least ? verdict(least) : none ? `the service knows no scanner: ${SWITCH}` : press.silent ? `no answer: ${SWITCH}` : "stop sent …";
  const rest = stop
    ? `Pressed ${clock(stop.at)} by ${stop.by}${stop.reason ? `: ${stop.reason}` : ""}. No scan begins until it is released.`
    : press.silent && !none
      ? `Sent ${press.sent}${press.why ? `; ${press.why}` : ""}; it is sent again and again.`
      : `Sent ${press.sent}.`;
  if (shown === head + rest) return;
  shown = head + rest;
  panel.hidden = false;
  const button = stop ? h("button", { type: "button", onclick: release }, "Release …") : null;
  replace(panel, h("strong", null, `Emergency stop: ${head}`), h("span", null, rest), button);
}

/** Ask why, then release what stands on each scanner and no later press. */
function release() {
  const pressed = standing();
  const reason = h("input", { type: "text", id: "release-reason", required: true, maxlength: 500, style: { width: "100%" } });
  const said = h("p", { class: "fault", role: "alert" });
  const form = h("form", null,
    h("h2", { id: "release-title" }, "Release the emergency stop"),
    h("p", null, "Look at the scanner first: is it safe that a laser fires? No scan begins by itself."),
    h("label", { for: "release-reason" }, "Why it may be released"), reason, said,
    h("menu", null,
      h("button", { type: "button", onclick: () => dialog.close() }, "Cancel"),
      h("button", { class: "primary" }, "Release")));
  const dialog = h("dialog", { "aria-labelledby": "release-title" }, form);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const left = (await Promise.all(pressed.map((one) => releaseOne(one, reason.value.trim())))).filter(Boolean);
    said.textContent = left.join("; ");
    if (!left.length) {
      press = null;
      dialog.close();
    }
    await look(); // some may have been released
  });
  openDialog(dialog);
}

/** Release a scanner's stop; returns why it stands yet, or nothing. @param {[string, any]} of scanner and stop @param {string} reason */
async function releaseOne([name, { number }], reason) {
  try {
    await api.remove(`${stopOf(name)}?${new URLSearchParams({ number, reason })}`, { urgent: true });
    press?.answers?.delete(name);
    return "";
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return ""; // it was retired meanwhile
    const why = error instanceof Error ? error.message : String(error);
    return scanners.length > 1 ? `${name}: ${why}` : why;
  }
}

async function look() {
  const answered = press?.answers ? press : null; // a look from before it may know nothing of it
  looks += 1;
  try {
    scanners = (await api.get("/scanners", { signal: AbortSignal.timeout(5 * LOOK) })).items.toSorted((/** @type {any} */ a, /** @type {any} */ b) => (a.id < b.id ? -1 : 1));
    scanner = scanners[0] ?? null;
    // From when the service knows of each press what the answer said, what stands is what it says: others release, too.
    const isKnown = (/** @type {[string, any]} */ [name, stop]) => {
      const one = scanners.find((each) => each.id === name);
      if (!one) return true; // it was retired
      const seen = one.emergency_stop;
      return seen ? seen.number !== stop.number || seen.laser !== "unconfirmed" || stop.laser === "unconfirmed" : stop.recorded;
    };
    if (answered?.answers.size && press === answered && [...answered.answers].every(isKnown)) press = null;
    if (scanner) for (const watcher of watchers) watcher(scanner, scanners);
    showStop();
  } catch (error) {
    scanner = null;
    for (const watcher of watchers) watcher(null, []);
    tell(h("span", { class: "fault" }, error instanceof Problem ? error.message : "the service does not answer"));
    if (!(error instanceof Problem)) live.doubt();
  } finally {
    looks -= 1;
  }
}

/** Put it into the pill, if that says something else: a screen reader reads what is new. @param {...(Node | null)} children */
function tell(...children) {
  const pill = byId("scanner");
  const made = /** @type {HTMLElement} */ (pill.cloneNode(false));
  put(made, ...children);
  if (!made.isEqualNode(pill)) pill.replaceChildren(...made.childNodes);
}

/** How a scanner's laser stands: a stop that nobody confirmed leaves it open. @param {any} one @returns {"on" | "stopped, laser off" | "stopped" | "stop not confirmed" | "stop sent" | ""} */
function laserOf(one) {
  const stop = standing().find(([name]) => name === one.id)?.[1];
  if (stop?.laser === "off") return "stopped, laser off";
  if (one.state === "scanning") return "on";
  if (stop) return stop.laser === "idle" ? "stopped" : "stop not confirmed";
  return press && !press.answers ? "stop sent" : "";
}

function showScanner() {
  const pill = byId("scanner");
  if (scanners.length > 1) {
    pill.removeAttribute("title");
    tell(...showScanners());
    return;
  }
  const connected = scanner.connection === "connected";
  const link = connected ? "connected" : scanner.connection === "unknown" ? "not used yet" : "not connected";
  const name = scanner.simulated ? "Simulated scanner" : "Scanner";
  const { interlock, lease } = scanner;
  const laser = laserOf(scanner);
  tell(
    h("span", { class: scanner.connection === "disconnected" ? "fault" : "" }, `${name}: ${link}`),
    laser === "on" ? h("span", { class: "laser" }, "laser on") : h("span", { class: laser ? "fault" : "dim" }, laser || (connected ? "idle, laser off" : "idle")),
    interlock === "open" ? h("span", { class: "fault" }, "interlock open") : null,
    lease ? h("span", { class: "dim" }, `reserved by ${lease.holder} until ${clock(lease.ends)}`) : null);
  if (scanner.last_error && !connected) pill.title = scanner.last_error;
  else pill.removeAttribute("title");
}

/** Several scanners in a line: how many, whose laser is on, which are stopped, and what is wrong with which. */
function showScanners() {
  const named = (/** @type {(one: any) => boolean} */ which) => scanners.filter(which).map((one) => one.id).join(", ");
  const stops = /** @type {const} */ (["stop sent", "stop not confirmed", "stopped", "stopped, laser off"]).map((how) => [how, named((one) => laserOf(one) === how)]).filter(([, some]) => some);
  const [firing, lost, open] = [named((one) => laserOf(one) === "on"), named((one) => one.connection === "disconnected"), named((one) => one.interlock === "open")];
  return [
    h("span", null, `${scanners.length} scanners`),
    firing ? h("span", { class: "laser" }, `laser on: ${firing}`) : stops.length ? null : h("span", { class: "dim" }, "idle"),
    ...stops.map(([how, some]) => h("span", { class: "fault" }, `${how}: ${some}`)),
    lost ? h("span", { class: "fault" }, `not connected: ${lost}`) : null,
    open ? h("span", { class: "fault" }, `interlock open: ${open}`) : null];
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

/** @param {{id: string, done: number, total: number, eta: number | null}} seen */
function showProgress({ id, done, total, eta }) {
  const left = eta === null ? "" : `${duration(eta)} left`;
  renew(byId("running"),
    h("a", { href: `/scans/${id}` }, scan?.id === id && scan.state === "paused" ? "scan paused" : "scan"),
    h("progress", { max: total || 1, value: done, "aria-label": "Progress of the scan" }),
    h("span", null, `${count(done)} of ${count(total)}`), h("span", { class: "dim" }, left));
}
