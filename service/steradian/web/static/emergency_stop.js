// @ts-check
// Controller of the emergency stop. The button is enabled only while the service has confirmed within the last two
// seconds that it accepts a stop of this page. A stop is repeated until the service answers.
import { api, poll, Problem } from "./api.js";
import { byId, h, replace } from "./dom.js";
import { openReleaseDialog } from "./stop_release.js";
import { MAX_STATUS_AGE, pollScanners, statusOf, lastStatus, UNKNOWN_STATUS, onTick, onScanners } from "./scanner_status.js";
import { askToSignIn, stopTicket, wasSignedIn, onSession } from "./session.js";
import { elapsed, timestamp, NEVER } from "./elapsed_time.js";
import { formatTime, duration, sentence } from "./units.js";

const STOP_PATH = "/emergency-stop"; // stops all scanners; the service lists them without its database
const ANSWER_TIMEOUT = 1500;
const REQUEST_TIMEOUT = 10_000; // ms after which an unanswered stop is sent again
const RETRY_INTERVAL = 500;
const CHECK_INTERVAL = 700; // ms between two readiness checks
const CHECK_TIMEOUT = 1000; // ms for the response to one check
const MAX_CHECK_AGE = 2000; // ms for which a positive check is valid
const USE_SWITCH = "use the hardware switch";
const NO_ANSWER = `The service does not answer: the emergency stop may not reach the laser, ${USE_SWITCH}.`;

/** @typedef {import("./elapsed_time.js").Timestamp} Timestamp */
/** @typedef {{sent: string, answers: Map<string, any> | null, at: Timestamp, silent: boolean, reason: string, refused: string}} StopRequest */

/** @type {StopRequest | null} last stop of this page, until it is released */
let stopRequest = null;
/** @type {string} */
let shownText = "";
/** @type {Timestamp} request time of the last positive check */
let checkedAt = NEVER;
let isAllowed = false; // whether the service has accepted a check and not refused one since
let refusal = ""; // reason of the last refusal
let isFailing = false; // whether the last check had no response
/** @type {Timestamp} time since which the page is visible */
let visibleSince = timestamp();
let isChecking = false;
/** @type {Set<() => void>} */
const listeners = new Set();

/** Subscribe to changes of {@link readiness} and of the stop. @param {() => void} act */
export function onStop(act) {
  listeners.add(act);
}

/** Return the readiness of the stop; "works" only if the service has just confirmed it. @returns {"works" | "silent" | "refused" | "starting" | "checking"} */
export function readiness() {
  if (refusal) return "refused";
  if (!isAllowed) return "starting";
  if (!isFailing && elapsed(checkedAt) < MAX_CHECK_AGE) return "works";
  return isFailing || elapsed(visibleSince) > MAX_CHECK_AGE ? "silent" : "checking";
}

/** Return whether the service has confirmed the stop since `date` and just now. @param {Date} date */
export const acceptedSince = (date) => readiness() === "works" && checkedAt.wall >= date.getTime();

/** Return the warning for a stop that may not reach the laser. */
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

/** Check whether the service would accept a stop of this page. */
async function check() {
  if (isChecking) return;
  isChecking = true;
  const startedAt = timestamp();
  try {
    await poll(STOP_PATH, CHECK_TIMEOUT, { headers: credentials() });
    accept(startedAt);
  } catch (error) {
    if (error instanceof Error && error.name === "AbortError") return; // aborted by a stop
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

/** @param {Timestamp} time it was requestedAt */
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

/** Stop every scanner; repeat the request until the service accepts or refuses it. */
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
      const { items } = await api.post(STOP_PATH, { reason: "triggered on the web page" }, { urgent: true, promptSignIn: false, headers: credentials(), signal: AbortSignal.timeout(REQUEST_TIMEOUT) });
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

/** Drop the answers of this page's stop once the service reports the same state, because other pages may release it. */
function clearConfirmedRequest() {
  const { scanners, requestedAt } = lastStatus();
  const answers = stopRequest?.answers;
  if (!stopRequest || !answers?.size || requestedAt.steady < stopRequest.at.steady) return; // polled before the stop
  const isKnown = (/** @type {[string, any]} */ [name, stop]) => {
    const one = scanners.find((each) => each.id === name);
    if (!one) return true; // decommissioned
    const now = one.emergency_stop;
    return now ? now.number !== stop.number || now.laser !== "unconfirmed" || stop.laser === "unconfirmed" : stop.recorded;
  };
  if ([...answers].every(isKnown)) stopRequest = null;
}

/** Remove the answer of a scanner whose stop was released. @param {string} name */
function removeAnswer(name) {
  stopRequest?.answers?.delete(name);
  if (!stopRequest?.answers?.size) stopRequest = null;
}

/** Return the scanners with active stops: from the answers of this page's stop, otherwise from the last poll. @returns {[string, any][]} */
function activeStops() {
  if (stopRequest) return stopRequest.answers ? [...stopRequest.answers] : [];
  return lastStatus().scanners.filter((one) => one.emergency_stop).map((one) => [one.id, one.emergency_stop]);
}

/** Return the status of a scanner; the answer to a stop is newer than an earlier poll. @param {string} name @returns {import("./scanner_status.js").ScannerStatus} */
export function laserStatus(name) {
  const { scanners, requestedAt } = lastStatus();
  const one = scanners.find((each) => each.id === name);
  const last = one ? statusOf(one) : { ...UNKNOWN_STATUS, age: null, reason: "not registered with the service" };
  const answer = stopRequest?.answers?.get(name);
  if (!answer || !stopRequest || requestedAt.steady >= stopRequest.at.steady || elapsed(stopRequest.at) >= MAX_STATUS_AGE) return last;
  if (answer.laser !== "off") return { ...last, ...UNKNOWN_STATUS, age: null, reason: "the stop is not confirmed" };
  return { ...last, laser: "off", shutter: "closed", age: elapsed(stopRequest.at) / 1e3, reason: "" };
}

/** Return the label of a scanner's stop for the status bar. @param {string} name of a scanner */
export function stopLabel(name) {
  const stop = activeStops().find(([other]) => other === name)?.[1];
  if (stop) return stop.laser === "unconfirmed" ? "stop not confirmed" : "stopped";
  return stopRequest && !stopRequest.answers && !stopRequest.refused ? "stop sent" : "";
}

/** Describe the outcome of a stop. @param {[string, any]} of scanner and stop */
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

/** Return the active stop with the worst outcome and its scanner. @returns {[string, any] | null} */
function worstStop() {
  const severity = (/** @type {[string, any]} */ [name, stop]) => (stop.laser === "unconfirmed" ? 3 : stop.laser === "idle" ? 0 : laserStatus(name).laser === "off" ? 1 : 2);
  return activeStops().toSorted((one, other) => severity(other) - severity(one))[0] ?? null;
}

/** Return the heading and the text of the panel. @returns {[string, string] | null} */
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

/** Show the button, or the reason why it is not available. */
function showButton() {
  const button = /** @type {HTMLButtonElement} */ (byId("stop"));
  const line = byId("no-stop");
  button.hidden = button.disabled = !isAllowed;
  line.hidden = isAllowed;
  if (refusal && line.textContent !== refusal) line.textContent = refusal;
}
