// @ts-check
// The scanners as the service told last, and how old that is. What is too old is unknown, whatever it was.
import { lookAt, Problem } from "./api.js";
import { live } from "./event_stream.js";
import { elapsed, mark, NEVER } from "./elapsed_time.js";

export const FRESH = 3000; // ms, after which what was told counts no more
const LOOK = 1000;
const PATIENCE = 2500;
const TICK = 250;
const DOUBT = 8000; // ms without an answer, after which the event stream is opened anew, too
export const UNKNOWN = /** @type {const} */ ({ laser: "unknown", shutter: "unknown", interlock: "unknown", key: "unknown" });

/**
 * How a scanner stands now. `why` says why the laser is unknown, `age` how many seconds ago the device told the rest.
 * @typedef {{laser: string, shutter: string, interlock: string, key: string, age: number | null, why: string}} Now
 */
/** @typedef {import("./elapsed_time.js").Mark} Mark */

/** @type {any[]} as they were told last, by name */
let scanners = [];
/** @type {Mark} when that was asked for: it is at least as new */
let asked = NEVER;
/** @type {string | null} why there is no answer at present */
let trouble = null;
let looking = false;
let due = false;
/** @type {Set<(scanner: any, all: any[]) => void>} */
const watchers = new Set();
/** @type {Set<() => void>} */
const tickers = new Set();

/** Be told, now and whenever it is looked at, of the first scanner, and of all; null while there is no answer. @param {(scanner: any, all: any[]) => void} act */
export function watchScanner(act) {
  watchers.add(act);
  if (scanners.length && !trouble) act(scanners[0], scanners);
}

/** Have something done at each look and several times a second: ages grow while there is no answer. @param {() => void} act */
export function watchAge(act) {
  tickers.add(act);
}

/** What was told last, when it was asked for, and why there is no answer at present. */
export const seen = () => ({ scanners, asked, trouble });

/** How a scanner stands, as far as that is known now. @param {any} one @returns {Now} */
export function nowOf(one) {
  const since = elapsed(asked);
  if (trouble) return { ...UNKNOWN, age: null, why: trouble };
  if (since > FRESH) return { ...UNKNOWN, age: null, why: asked === NEVER ? "not looked at yet" : "the service does not answer" };
  if (typeof one.age !== "number") return { ...UNKNOWN, age: null, why: whyUnknown(one) };
  const age = one.age + since / 1e3;
  if (age * 1e3 > limit(one)) return { ...UNKNOWN, age: null, why: "not seen any more" };
  const { laser = "unknown", shutter, interlock, key } = one;
  return { laser, shutter, interlock, key, age, why: laser === "unknown" ? whyUnknown(one) : "" };
}

/** Milliseconds for which what a device told counts: it may be asked less often than the page asks the service. @param {any} one */
const limit = (one) => Math.min(10_000, Math.max(FRESH, 2000 * (one.look_interval ?? 0)));

/** @param {any} one */
function whyUnknown({ connection, last_error: error }) {
  if (connection === "in-use") return "the program that uses it does not tell";
  if (connection === "disconnected") return error ?? "not connected";
  return connection === "connected" ? "the scanner does not tell" : (error ?? "the service has not looked at it");
}

export function startLooking() {
  live.on("scanner", look);
  live.on("again", look);
  setInterval(() => document.hidden || look(), LOOK);
  setInterval(tick, TICK);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) asked = NEVER; // whoever comes back sees nothing of before
    else void look();
    tick();
  });
}

/** Look at the scanners; one look at a time. */
export async function look() {
  due = looking;
  if (looking) return;
  looking = true;
  const began = mark();
  try {
    const told = (await lookAt("/scanners", PATIENCE, { asks: true })).items;
    scanners = told.toSorted((/** @type {any} */ a, /** @type {any} */ b) => (a.id < b.id ? -1 : 1));
    [asked, trouble] = [began, null];
    tell();
  } catch (error) {
    if (!(error instanceof Error) || error.name !== "AbortError") fail(error); // else it gave way to the stop
  } finally {
    looking = false;
    if (due) void look();
  }
}

/** @param {unknown} error */
function fail(error) {
  const refused = error instanceof Problem;
  trouble = refused ? error.message : "the service does not answer";
  tell();
  if (!refused && (error instanceof TypeError || elapsed(asked) > DOUBT)) live.doubt();
}

function tell() {
  for (const act of watchers) act(trouble ? null : (scanners[0] ?? null), trouble ? [] : scanners);
  tick();
}

function tick() {
  for (const act of tickers) act();
}
