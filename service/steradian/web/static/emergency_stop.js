// @ts-check
// The emergency stop: offered only while the service has said, less than two seconds ago, that it would take a press
// of this page; otherwise the page says why it cannot be relied on. A press is sent until there is an answer.
import { api, lookAt, Problem } from "./api.js";
import { byId, h, replace } from "./dom.js";
import { release } from "./stop_release.js";
import { FRESH, look, nowOf, seen, UNKNOWN, watchAge, watchScanner } from "./scanner_status.js";
import { askToSignIn, stopTicket, wasSignedIn, watchSession } from "./session.js";
import { elapsed, mark, NEVER } from "./elapsed_time.js";
import { clock, duration, sentence } from "./units.js";

const EVERY_STOP = "/emergency-stop"; // who exists, the service knows, also without its database
const PATIENCE = 1500;
const HANGS = 10_000; // a press that has no answer by then is sent anew
const TRY_AGAIN = 500;
const CHECK = 700; // ms between two questions whether a press would be taken
const CHECKED_IN = 1000; // ms for the answer to one
const COUNTS = 2000; // ms for which an answer counts
const SWITCH = "use the hardware switch";
const SILENT = `The service does not answer: the emergency stop may not reach the laser, ${SWITCH}.`;

/** @typedef {import("./elapsed_time.js").Mark} Mark */
/** @typedef {{sent: string, answers: Map<string, any> | null, at: Mark, silent: boolean, why: string, refused: string}} Press */

/** @type {Press | null} the last press of this page, until it is released */
let press = null;
/** @type {string} */
let shown = "";
/** @type {Mark} when it was asked what the service said yes to last */
let checked = NEVER;
let allowed = false; // whether it has ever said yes to this page, and not no since
let refusal = ""; // why it says no
let failing = false; // whether the last question had no answer
/** @type {Mark} when this page began to be looked at */
let visible = mark();
let checking = false;
/** @type {Set<() => void>} */
const watchers = new Set();

/** Be told when {@link readiness} or what is known of a press may have changed. @param {() => void} act */
export function watchStop(act) {
  watchers.add(act);
}

/** Whether a press would be taken: "works" only where the service has just said so. @returns {"works" | "silent" | "refused" | "starting" | "checking"} */
export function readiness() {
  if (refusal) return "refused";
  if (!allowed) return "starting";
  if (!failing && elapsed(checked) < COUNTS) return "works";
  return failing || elapsed(visible) > COUNTS ? "silent" : "checking";
}

/** Whether the service has said since then, and just now, that it would take a press. @param {Date} then */
export const worksSince = (then) => readiness() === "works" && checked.wall >= then.getTime();

/** What is said of a stop that cannot be relied on. */
export const doubtOfStop = () => (readiness() === "silent" ? SILENT : "");

export function startStop() {
  byId("stop").addEventListener("click", () => void stop());
  document.addEventListener("keydown", (event) => {
    if (event.key === "." && event.ctrlKey) {
      event.preventDefault();
      if (!event.repeat) void stop();
    }
  }, { capture: true });
  document.addEventListener("visibilitychange", () => {
    visible = mark();
    if (!document.hidden) void check();
  });
  setInterval(() => document.hidden || check(), CHECK);
  watchSession(() => void check());
  watchScanner(() => settle());
  watchAge(show);
  void check();
}

/** Ask whether a press of this page would be taken, as it would be sent. */
async function check() {
  if (checking) return;
  checking = true;
  const began = mark();
  try {
    await lookAt(EVERY_STOP, CHECKED_IN, { headers: credentials() });
    accept(began);
  } catch (error) {
    if (error instanceof Error && error.name === "AbortError") return; // it gave way to a press
    if (error instanceof Problem && isRefusal(error)) refuse(error);
    else failing = true;
  } finally {
    checking = false;
    show();
  }
}

/** @returns {Record<string, string>} */
function credentials() {
  const ticket = stopTicket();
  return ticket ? { "X-Stop-Ticket": ticket } : {};
}

/** @param {Mark} when it was asked */
function accept(when) {
  [checked, allowed, refusal, failing] = [when, true, "", false];
  if (press?.refused) press = null;
}

/** @param {Problem} problem */
const isRefusal = ({ status }) => status === 401 || status === 403;

/** @param {Problem} problem */
function refuse(problem) {
  const state = problem.status === 403 ? `Refused (${problem.message})` : wasSignedIn() ? "Signed out" : "Not signed in";
  const way = problem.status === 403 ? `Use the hardware switch.` : `Sign in, or ${SWITCH}.`;
  refusal = `${state}: this page cannot stop the laser. ${way}`;
  [allowed, failing] = [false, false];
}

/** Press the stop of every scanner; it is sent again until the service has taken or refused it. */
async function stop() {
  press = { sent: clock(new Date()), answers: null, at: NEVER, silent: false, why: "", refused: "" };
  const mine = press;
  show();
  const timer = setTimeout(() => {
    mine.silent = true;
    if (press === mine) show();
  }, PATIENCE);
  await send(mine);
  clearTimeout(timer);
  if (press === mine) show();
  void look();
}

/** @param {Press} mine */
async function send(mine) {
  while (press === mine && !mine.answers) {
    const began = mark();
    try {
      const { items } = await api.post(EVERY_STOP, { reason: "pressed on the page" }, { urgent: true, asks: false, headers: credentials(), signal: AbortSignal.timeout(HANGS) });
      mine.answers = new Map(items.map((/** @type {any} */ one) => [one.id, one.emergency_stop]));
      mine.at = mark();
      accept(began);
    } catch (error) {
      if (error instanceof Problem && isRefusal(error)) {
        refuse(error);
        mine.refused = refusal;
        return;
      }
      mine.silent = failing = true;
      mine.why = error instanceof Problem ? error.message : "the service does not answer";
      if (press === mine) show();
      await new Promise((go) => setTimeout(go, TRY_AGAIN));
    }
  }
}

/** From when the service knows of each press what its answer said, what stands is what the service says: others release, too. */
function settle() {
  const { scanners, asked } = seen();
  const answers = press?.answers;
  if (!press || !answers?.size || asked.steady < press.at.steady) return; // a look from before may know nothing of it
  const isKnown = (/** @type {[string, any]} */ [name, stop]) => {
    const one = scanners.find((each) => each.id === name);
    if (!one) return true; // it was retired
    const now = one.emergency_stop;
    return now ? now.number !== stop.number || now.laser !== "unconfirmed" || stop.laser === "unconfirmed" : stop.recorded;
  };
  if ([...answers].every(isKnown)) press = null;
}

/** Learn that somebody released the stop of a scanner here. @param {string} name */
function forget(name) {
  press?.answers?.delete(name);
  if (!press?.answers?.size) press = null;
}

/** The stops that stand and their scanners, as the press was answered or else as the service knows. @returns {[string, any][]} */
function standing() {
  if (press) return press.answers ? [...press.answers] : [];
  return seen().scanners.filter((one) => one.emergency_stop).map((one) => [one.id, one.emergency_stop]);
}

/** How a scanner stands: what the device said to a press is newer than a look from before it. @param {string} name @returns {import("./scanner_status.js").Now} */
export function laserOf(name) {
  const { scanners, asked } = seen();
  const one = scanners.find((each) => each.id === name);
  const last = one ? nowOf(one) : { ...UNKNOWN, age: null, why: "the service does not know it" };
  const answer = press?.answers?.get(name);
  if (!answer || !press || asked.steady >= press.at.steady || elapsed(press.at) >= FRESH) return last;
  if (answer.laser !== "off") return { ...last, ...UNKNOWN, age: null, why: "the stop is not confirmed" };
  return { ...last, laser: "off", shutter: "closed", age: elapsed(press.at) / 1e3, why: "" };
}

/** What a stop that stands or is on its way has in the pill. @param {string} name of a scanner */
export function stopWords(name) {
  const stop = standing().find(([other]) => other === name)?.[1];
  if (stop) return stop.laser === "unconfirmed" ? "stop not confirmed" : "stopped";
  return press && !press.answers && !press.refused ? "stop sent" : "";
}

/** What is known of a stop, in words. @param {[string, any]} of scanner and stop */
function verdict([name, stop]) {
  const { laser, why } = laserOf(name);
  if (stop.laser === "off") {
    const took = stop.seconds === null ? "" : `, ${duration(stop.seconds)}`;
    if (laser === "off") return `laser off (confirmed by the device${took})`;
    if (laser === "unknown") return `confirmed by the device${took}; the laser now: unknown (${why})`;
    return `confirmed by the device${took}, but the laser is ${laser} again: ${SWITCH}`;
  }
  if (stop.laser === "idle") return "no scanner is connected to this service (the built-in simulator was never started)";
  return `no answer from ${seen().scanners.length > 1 ? name : "the scanner"}: ${SWITCH}`;
}

/** The stop that stands of which least good is known, and its scanner, or null. @returns {[string, any] | null} */
function worst() {
  const bad = (/** @type {[string, any]} */ [name, stop]) => (stop.laser === "unconfirmed" ? 3 : stop.laser === "idle" ? 0 : laserOf(name).laser === "off" ? 1 : 2);
  return standing().toSorted((one, other) => bad(other) - bad(one))[0] ?? null;
}

/** What the panel says: its head, and the rest. @returns {[string, string] | null} */
function words() {
  const least = worst();
  if (least) {
    const [name, stop] = least;
    const told = stop.detail && (stop.laser === "unconfirmed" || laserOf(name).laser === "off") ? `${sentence(stop.detail)} ` : "";
    return [verdict(least), `${told}Pressed ${clock(stop.at)} by ${stop.by}${stop.reason ? `: ${stop.reason}` : ""}. No scan begins until it is released.`];
  }
  if (!press) return null;
  if (press.answers) return [`the service knows no scanner: ${SWITCH}`, `Sent ${press.sent}.`];
  if (press.refused) return [`not taken: ${SWITCH}`, `Sent ${press.sent}. ${press.refused} It is not sent again.`];
  if (press.silent) return [`no answer: ${SWITCH}`, `Sent ${press.sent}${press.why ? `; ${press.why}` : ""}; it is sent again and again.`];
  return ["stop sent …", `Sent ${press.sent}.`];
}

function show() {
  showButton();
  const panel = byId("stopped");
  const said = words();
  const text = said ? said.join("|") : "";
  if (text !== shown) {
    shown = text;
    panel.hidden = !said;
    const button = standing().length ? h("button", { type: "button", onclick: () => release(standing(), forget) }, "Release …")
      : press?.refused ? h("button", { type: "button", onclick: () => void askToSignIn() }, "Sign in …") : null;
    if (said) replace(panel, h("strong", null, `Emergency stop: ${said[0]}`), h("span", null, said[1]), button);
  }
  for (const act of watchers) act();
}

/** The button, or why there is none. */
function showButton() {
  const button = /** @type {HTMLButtonElement} */ (byId("stop"));
  const line = byId("no-stop");
  button.hidden = button.disabled = !allowed;
  line.hidden = allowed;
  if (refusal && line.textContent !== refusal) line.textContent = refusal;
}
