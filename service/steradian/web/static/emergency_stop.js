// @ts-check
// The emergency stop: offered only while the service has said, less than two seconds ago, that it would take a press
// of this page; otherwise the page says why it cannot be relied on. A press is sent until there is an answer.
import { api, poll, Problem } from "./api.js";
import { byId, h, replace } from "./dom.js";
import { openReleaseDialog } from "./stop_release.js";
import { MAX_STATUS_AGE, pollScanners, statusOf, lastStatus, UNKNOWN_STATUS, onTick, onScanners } from "./scanner_status.js";
import { askToSignIn, stopTicket, wasSignedIn, onSession } from "./session.js";
import { elapsed, timestamp, NEVER } from "./elapsed_time.js";
import { formatTime, duration, sentence } from "./units.js";

const STOP_PATH = "/emergency-stop"; // who exists, the service knows, also without its database
const ANSWER_TIMEOUT = 1500;
const REQUEST_TIMEOUT = 10_000; // a press that has no answer by then is sent anew
const RETRY_INTERVAL = 500;
const CHECK_INTERVAL = 700; // ms between two questions whether a press would be taken
const CHECK_TIMEOUT = 1000; // ms for the answer to one
const MAX_CHECK_AGE = 2000; // ms for which an answer counts
const USE_SWITCH = "use the hardware switch";
const NO_ANSWER = `The service does not answer: the emergency stop may not reach the laser, ${USE_SWITCH}.`;

/** @typedef {import("./elapsed_time.js").Timestamp} Mark */
/** @typedef {{sent: string, answers: Map<string, any> | null, at: Mark, silent: boolean, reason: string, refused: string}} StopRequest */

/** @type {StopRequest | null} the last press of this page, until it is released */
let stopRequest = null;
/** @type {string} */
let shownText = "";
/** @type {Mark} when it was requestedAt what the service said yes to last */
let checkedAt = NEVER;
let isAllowed = false; // whether it has ever said yes to this page, and not no since
let refusal = ""; // reason it says no
let isFailing = false; // whether the last question had no answer
/** @type {Mark} when this page began to be looked at */
let visibleSince = timestamp();
let isChecking = false;
/** @type {Set<() => void>} */
const listeners = new Set();

/** Be told when {@link readiness} or what is known of a press may have changed. @param {() => void} act */
export function onStop(act) {
  listeners.add(act);
}

/** Whether a press would be taken: "works" only where the service has just said so. @returns {"works" | "silent" | "refused" | "starting" | "checking"} */
export function readiness() {
  if (refusal) return "refused";
  if (!isAllowed) return "starting";
  if (!isFailing && elapsed(checkedAt) < MAX_CHECK_AGE) return "works";
  return isFailing || elapsed(visibleSince) > MAX_CHECK_AGE ? "silent" : "checking";
}

/** Whether the service has said since then, and just now, that it would take a press. @param {Date} date */
export const acceptedSince = (date) => readiness() === "works" && checkedAt.wall >= date.getTime();

/** What is said of a stop that cannot be relied on. */
export const stopWarning = () => (readiness() === "silent" ? NO_ANSWER : "");

export function startStop() {
  byId("stop").addEventListener("click", () => void sendStop());
  document.addEventListener("keydown", (event) => {
    if (event.key === "." && event.ctrlKey) {
      event.preventDefault();
      if (!event.repeat) void sendStop();
    }
  }, { capture: true });
  document.addEventListener("visibilitychange", () => {
    visibleSince = timestamp();
    if (!document.hidden) void check();
  });
  setInterval(() => document.hidden || check(), CHECK_INTERVAL);
  onSession(() => void check());
  onScanners(() => clearConfirmedRequest());
  onTick(showPanel);
  void check();
}

/** Ask whether a press of this page would be taken, as it would be sent. */
async function check() {
  if (isChecking) return;
  isChecking = true;
  const startedAt = timestamp();
  try {
    await poll(STOP_PATH, CHECK_TIMEOUT, { headers: credentials() });
    accept(startedAt);
  } catch (error) {
    if (error instanceof Error && error.name === "AbortError") return; // it gave way to a press
    if (error instanceof Problem && isRefusal(error)) refuse(error);
    else isFailing = true;
  } finally {
    isChecking = false;
    showPanel();
  }
}

/** @returns {Record<string, string>} */
function credentials() {
  const ticket = stopTicket();
  return ticket ? { "X-Stop-Ticket": ticket } : {};
}

/** @param {Mark} time it was requestedAt */
function accept(time) {
  [checkedAt, isAllowed, refusal, isFailing] = [time, true, "", false];
  if (stopRequest?.refused) stopRequest = null;
}

/** @param {Problem} problem */
const isRefusal = ({ status }) => status === 401 || status === 403;

/** @param {Problem} problem */
function refuse(problem) {
  const statusText = problem.status === 403 ? `Refused (${problem.message})` : wasSignedIn() ? "Signed out" : "Not signed in";
  const remedy = problem.status === 403 ? `Use the hardware switch.` : `Sign in, or ${USE_SWITCH}.`;
  refusal = `${statusText}: this page cannot stop the laser. ${remedy}`;
  [isAllowed, isFailing] = [false, false];
}

/** Press the stop of every scanner; it is sent again until the service has taken or refused it. */
async function sendStop() {
  stopRequest = { sent: formatTime(new Date()), answers: null, at: NEVER, silent: false, reason: "", refused: "" };
  const current = stopRequest;
  showPanel();
  const timer = setTimeout(() => {
    current.silent = true;
    if (stopRequest === current) showPanel();
  }, ANSWER_TIMEOUT);
  await sendUntilAnswered(current);
  clearTimeout(timer);
  if (stopRequest === current) showPanel();
  void pollScanners();
}

/** @param {StopRequest} current */
async function sendUntilAnswered(current) {
  while (stopRequest === current && !current.answers) {
    const startedAt = timestamp();
    try {
      const { items } = await api.post(STOP_PATH, { reason: "pressed on the page" }, { urgent: true, promptSignIn: false, headers: credentials(), signal: AbortSignal.timeout(REQUEST_TIMEOUT) });
      current.answers = new Map(items.map((/** @type {any} */ one) => [one.id, one.emergency_stop]));
      current.at = timestamp();
      accept(startedAt);
    } catch (error) {
      if (error instanceof Problem && isRefusal(error)) {
        refuse(error);
        current.refused = refusal;
        return;
      }
      current.silent = isFailing = true;
      current.reason = error instanceof Problem ? error.message : "the service does not answer";
      if (stopRequest === current) showPanel();
      await new Promise((resolve) => setTimeout(resolve, RETRY_INTERVAL));
    }
  }
}

/** From when the service knows of each press what its answer said, what stands is what the service says: others release, too. */
function clearConfirmedRequest() {
  const { scanners, requestedAt } = lastStatus();
  const answers = stopRequest?.answers;
  if (!stopRequest || !answers?.size || requestedAt.steady < stopRequest.at.steady) return; // a look from before may know nothing of it
  const isKnown = (/** @type {[string, any]} */ [name, stop]) => {
    const one = scanners.find((each) => each.id === name);
    if (!one) return true; // it was retired
    const now = one.emergency_stop;
    return now ? now.number !== stop.number || now.laser !== "unconfirmed" || stop.laser === "unconfirmed" : stop.recorded;
  };
  if ([...answers].every(isKnown)) stopRequest = null;
}

/** Learn that somebody released the stop of a scanner here. @param {string} name */
function removeAnswer(name) {
  stopRequest?.answers?.delete(name);
  if (!stopRequest?.answers?.size) stopRequest = null;
}

/** The stops that stand and their scanners, as the press was answered or else as the service knows. @returns {[string, any][]} */
function activeStops() {
  if (stopRequest) return stopRequest.answers ? [...stopRequest.answers] : [];
  return lastStatus().scanners.filter((one) => one.emergency_stop).map((one) => [one.id, one.emergency_stop]);
}

/** How a scanner stands: what the device said to a press is newer than a look from before it. @param {string} name @returns {import("./scanner_status.js").ScannerStatus} */
export function laserStatus(name) {
  const { scanners, requestedAt } = lastStatus();
  const one = scanners.find((each) => each.id === name);
  const last = one ? statusOf(one) : { ...UNKNOWN_STATUS, age: null, reason: "not registered with the service" };
  const answer = stopRequest?.answers?.get(name);
  if (!answer || !stopRequest || requestedAt.steady >= stopRequest.at.steady || elapsed(stopRequest.at) >= MAX_STATUS_AGE) return last;
  if (answer.laser !== "off") return { ...last, ...UNKNOWN_STATUS, age: null, reason: "the stop is not confirmed" };
  return { ...last, laser: "off", shutter: "closed", age: elapsed(stopRequest.at) / 1e3, reason: "" };
}

/** What a stop that stands or is on its way has in the pill. @param {string} name of a scanner */
export function stopLabel(name) {
  const stop = activeStops().find(([other]) => other === name)?.[1];
  if (stop) return stop.laser === "unconfirmed" ? "stop not confirmed" : "stopped";
  return stopRequest && !stopRequest.answers && !stopRequest.refused ? "stop sent" : "";
}

/** What is known of a stop, in words. @param {[string, any]} of scanner and stop */
function outcomeOf([name, stop]) {
  const { laser, reason } = laserStatus(name);
  if (stop.laser === "off") {
    const durationText = stop.seconds === null ? "" : `, ${duration(stop.seconds)}`;
    if (laser === "off") return `laser off (confirmed by the device${durationText})`;
    if (laser === "unknown") return `confirmed by the device${durationText}; the laser state is now unknown (${reason})`;
    return `confirmed by the device${durationText}, but the laser is ${laser} again: ${USE_SWITCH}`;
  }
  if (stop.laser === "idle") return "no scanner is connected to this service (the built-in simulator was never started)";
  return `no answer from ${lastStatus().scanners.length > 1 ? name : "the scanner"}: ${USE_SWITCH}`;
}

/** The stop that stands of which least good is known, and its scanner, or null. @returns {[string, any] | null} */
function worstStop() {
  const severity = (/** @type {[string, any]} */ [name, stop]) => (stop.laser === "unconfirmed" ? 3 : stop.laser === "idle" ? 0 : laserStatus(name).laser === "off" ? 1 : 2);
  return activeStops().toSorted((one, other) => severity(other) - severity(one))[0] ?? null;
}

/** What the panel says: its head, and the rest. @returns {[string, string] | null} */
function panelText() {
  const worst = worstStop();
  if (worst) {
    const [name, stop] = worst;
    const detailText = stop.detail && (stop.laser === "unconfirmed" || laserStatus(name).laser === "off") ? `${sentence(stop.detail)} ` : "";
    return [outcomeOf(worst), `${detailText}Triggered ${formatTime(stop.at)} by ${stop.by}${stop.reason ? `: ${stop.reason}` : ""}. No scan starts until the stop is released.`];
  }
  if (!stopRequest) return null;
  if (stopRequest.answers) return [`no scanner is registered: ${USE_SWITCH}`, `Sent ${stopRequest.sent}.`];
  if (stopRequest.refused) return [`not accepted: ${USE_SWITCH}`, `Sent ${stopRequest.sent}. ${stopRequest.refused} The page does not repeat the stop.`];
  if (stopRequest.silent) return [`no answer: ${USE_SWITCH}`, `Sent ${stopRequest.sent}${stopRequest.reason ? `; ${stopRequest.reason}` : ""}; the page repeats the stop.`];
  return ["stop sent …", `Sent ${stopRequest.sent}.`];
}

function showPanel() {
  showButton();
  const panel = byId("stopped");
  const panelContent = panelText();
  const text = panelContent ? panelContent.join("|") : "";
  if (text !== shownText) {
    shownText = text;
    panel.hidden = !panelContent;
    const button = activeStops().length ? h("button", { type: "button", onclick: () => openReleaseDialog(activeStops(), removeAnswer) }, "Release …")
      : stopRequest?.refused ? h("button", { type: "button", onclick: () => void askToSignIn() }, "Sign in …") : null;
    if (panelContent) replace(panel, h("strong", null, `Emergency stop: ${panelContent[0]}`), h("span", null, panelContent[1]), button);
  }
  for (const act of listeners) act();
}

/** The button, or why there is none. */
function showButton() {
  const button = /** @type {HTMLButtonElement} */ (byId("stop"));
  const line = byId("no-stop");
  button.hidden = button.disabled = !isAllowed;
  line.hidden = isAllowed;
  if (refusal && line.textContent !== refusal) line.textContent = refusal;
}
