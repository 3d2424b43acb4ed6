// @ts-check
// The scanners as the service told last, and how old that is. What is too old is unknown, whatever it was.
import { poll, Problem } from "./api.js";
import { live } from "./event_stream.js";
import { elapsed, timestamp, NEVER } from "./elapsed_time.js";

export const MAX_STATUS_AGE = 3000; // ms, after which what was told counts no more
const POLL_INTERVAL = 1000;
const POLL_TIMEOUT = 2500;
const TICK_INTERVAL = 250;
const RECONNECT_TIMEOUT = 8000; // ms without an answer, after which the event stream is opened anew, too
export const UNKNOWN_STATUS = /** @type {const} */ ({ laser: "unknown", shutter: "unknown", interlock: "unknown", key: "unknown" });

/**
 * How a scanner stands now. `why` says why the laser is unknown, `age` how many seconds ago the device told the rest.
 * @typedef {{laser: string, shutter: string, interlock: string, key: string, age: number | null, reason: string}} ScannerStatus
 */
/** @typedef {import("./elapsed_time.js").Timestamp} Mark */

/** @type {any[]} as they were told last, by name */
let scanners = [];
/** @type {Mark} when that was requestedAt for: it is at least as new */
let requestedAt = NEVER;
/** @type {string | null} reason there is no answer at present */
let failure = null;
let isPolling = false;
let isDue = false;
/** @type {Set<(scanner: any, all: any[]) => void>} */
const listeners = new Set();
/** @type {Set<() => void>} */
const tickListeners = new Set();

/** Be told, now and whenever it is looked at, of the first scanner, and of all; null while there is no answer. @param {(scanner: any, all: any[]) => void} act */
export function onScanners(act) {
  listeners.add(act);
  if (scanners.length && !failure) act(scanners[0], scanners);
}

/** Have something done at each look and several times a second: ages grow while there is no answer. @param {() => void} act */
export function onTick(act) {
  tickListeners.add(act);
}

/** What was told last, when it was requestedAt for, and why there is no answer at present. */
export const lastStatus = () => ({ scanners, requestedAt, failure });

/** How a scanner stands, as far as that is known now. @param {any} one @returns {ScannerStatus} */
export function statusOf(one) {
  const since = elapsed(requestedAt);
  if (failure) return { ...UNKNOWN_STATUS, age: null, reason: failure };
  if (since > MAX_STATUS_AGE) return { ...UNKNOWN_STATUS, age: null, reason: requestedAt === NEVER ? "not polled yet" : "the service does not answer" };
  if (typeof one.age !== "number") return { ...UNKNOWN_STATUS, age: null, reason: unknownReason(one) };
  const age = one.age + since / 1e3;
  if (age * 1e3 > maxAge(one)) return { ...UNKNOWN_STATUS, age: null, reason: "the status is out of date" };
  const { laser = "unknown", shutter, interlock, key } = one;
  return { laser, shutter, interlock, key, age, reason: laser === "unknown" ? unknownReason(one) : "" };
}

/** Milliseconds for which what a device told counts: it may be requestedAt less often than the page promptSignIn the service. @param {any} one */
const maxAge = (one) => Math.min(10_000, Math.max(MAX_STATUS_AGE, 2000 * (one.look_interval ?? 0)));

/** @param {any} one */
function unknownReason({ connection, last_error: error }) {
  if (connection === "in-use") return "not reported by the program that uses the scanner";
  if (connection === "disconnected") return error ?? "not connected";
  return connection === "connected" ? "not reported by the scanner" : (error ?? "the service has not polled the scanner yet");
}

export function startPolling() {
  live.on("scanner", pollScanners);
  live.on("again", pollScanners);
  setInterval(() => document.hidden || pollScanners(), POLL_INTERVAL);
  setInterval(tick, TICK_INTERVAL);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) requestedAt = NEVER; // whoever comes back sees nothing of before
    else void pollScanners();
    tick();
  });
}

/** Look at the scanners; one look at a time. */
export async function pollScanners() {
  isDue = isPolling;
  if (isPolling) return;
  isPolling = true;
  const startedAt = timestamp();
  try {
    const items = (await poll("/scanners", POLL_TIMEOUT, { promptSignIn: true })).items;
    scanners = items.toSorted((/** @type {any} */ a, /** @type {any} */ b) => (a.id < b.id ? -1 : 1));
    [requestedAt, failure] = [startedAt, null];
    notify();
  } catch (error) {
    if (!(error instanceof Error) || error.name !== "AbortError") showFailure(error); // else it gave way to the stop
  } finally {
    isPolling = false;
    if (isDue) void pollScanners();
  }
}

/** @param {unknown} error */
function showFailure(error) {
  const isProblem = error instanceof Problem;
  failure = isProblem ? error.message : "the service does not answer";
  notify();
  if (!isProblem && (error instanceof TypeError || elapsed(requestedAt) > RECONNECT_TIMEOUT)) live.reconnect();
}

function notify() {
  for (const act of listeners) act(failure ? null : (scanners[0] ?? null), failure ? [] : scanners);
  tick();
}

function tick() {
  for (const act of tickListeners) act();
}
