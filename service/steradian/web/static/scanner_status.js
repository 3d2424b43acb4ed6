// @ts-check
// Last known status of the scanners with its age. A status that is too old is unknown.
import { poll, Problem } from "./api.js";
import { live } from "./event_stream.js";
import { elapsed, timestamp, NEVER } from "./elapsed_time.js";

export const MAX_STATUS_AGE = 3000; // ms after which a status is unknown
const POLL_INTERVAL = 1000;
const POLL_TIMEOUT = 2500;
const TICK_INTERVAL = 250;
const RECONNECT_TIMEOUT = 8000; // ms without a response after which the event stream reconnects, too
export const UNKNOWN_STATUS = /** @type {const} */ ({ laser: "unknown", shutter: "unknown", interlock: "unknown", key: "unknown" });

/**
 * Status of a scanner. `reason` states why the laser is unknown, `age` the seconds since the device reported the rest.
 * @typedef {{laser: string, shutter: string, interlock: string, key: string, age: number | null, reason: string}} ScannerStatus
 */
/** @typedef {import("./elapsed_time.js").Timestamp} Timestamp */

/** @type {any[]} as of the last poll, sorted by identifier */
let scanners = [];
/** @type {Timestamp} time of the last successful request */
let requestedAt = NEVER;
/** @type {string | null} reason of the last failed poll */
let failure = null;
let isPolling = false;
let isDue = false;
/** @type {Set<(scanner: any, all: any[]) => void>} */
const listeners = new Set();
/** @type {Set<() => void>} */
const tickListeners = new Set();

/** Subscribe to polls: the listener receives the first scanner and all scanners, or null and none after a failure. @param {(scanner: any, all: any[]) => void} act */
export function onScanners(act) {
  listeners.add(act);
  if (scanners.length && !failure) act(scanners[0], scanners);
}

/** Subscribe to polls and to a periodic tick, because ages grow between polls. @param {() => void} act */
export function onTick(act) {
  tickListeners.add(act);
}

/** Return the result of the last poll, its time and the reason of a failure. */
export const lastStatus = () => ({ scanners, requestedAt, failure });

/** Return the present status of a scanner. @param {any} one @returns {ScannerStatus} */
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

/** Return the maximum age (ms) of a status; the service may poll a scanner less often than the page polls the service. @param {any} one */
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
    if (document.hidden) requestedAt = NEVER; // a page that becomes visible again shows no old status
    else void pollScanners();
    tick();
  });
}

/** Poll the scanners; one poll at a time. */
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
    if (!(error instanceof Error) || error.name !== "AbortError") showFailure(error); // otherwise aborted by a stop
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
