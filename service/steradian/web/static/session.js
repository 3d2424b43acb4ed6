// @ts-check
// Session of the page. A service that only its own machine can reach needs no key; others ask once for a key and then
// use a cookie that scripts cannot read.
import { h, openDialog } from "./dom.js";
import { formatTime } from "./units.js";
import { urlOf } from "./urls.js";

const SESSION = urlOf("/api/v1/session");
/** @type {string | null} */
let token = null;
/** @type {Promise<boolean> | null} */
let dialogResult = null;
let isDeclined = false; // the user closed the dialog; ask again only after a user action
/** @type {string | null} authorises a stop after the session has ended; kept in memory until sign-out */
let ticket = null;
/** @type {Date | null} time since which the service rejects the session */
let signedOutAt = null;
/** @type {number | null} end of the session by the clock of this computer */
let expiresAt = null;
let isKnown = false; // whether the last request for the session was answered
/** @type {Set<() => void>} */
const listeners = new Set();
const channel = new BroadcastChannel("steradian.session"); // announces sign-in and sign-out to the other pages of this browser
const WARNING_PERIOD = 15 * 60e3; // ms before the end of the session at which the warning appears
const RENEWAL_INTERVAL = 10 * 60e3; // ms between two stop tickets
const RETRY_INTERVAL = 5e3;

/** Return the ticket that authorises a stop, if this page was signed in. */
export const stopTicket = () => ticket;

/** Return whether this page was signed in before. */
export const wasSignedIn = () => ticket !== null || expiresAt !== null;

/** Return the time since which the session is rejected, or null. */
export const signedOut = () => signedOutAt;

/** Subscribe to sign-in and sign-out. @param {() => void} act */
export function onSession(act) {
  listeners.add(act);
}

/** Read the session and its CSRF token; requested at start, so that a stop does not wait for them. */
export async function readSession() {
  try {
    const answer = await fetch(SESSION);
    isKnown = answer.ok || answer.status === 401;
    if (answer.ok) storeSession(await answer.json(), answer);
    else if (answer.status === 401) markSignedOut();
  } catch {
    isKnown = false; // the status bar shows that the service does not answer
  }
}

/** @param {any} session @param {Response} answer response with the service's time */
function storeSession(session, answer) {
  token = session.csrf_token;
  ticket = session.stop_ticket;
  const clockOffset = Date.now() - (Date.parse(answer.headers.get("Date") ?? "") || Date.now());
  expiresAt = session.expires && Date.parse(session.expires) + clockOffset;
  signedOutAt = null;
  isDeclined = false;
  showExpiry();
  notify();
  const button = document.getElementById("sign-out");
  if (!button) return;
  button.hidden = !token;
  button.textContent = "Sign out";
  button.title = `Sign out ${session.principal}`;
  button.onclick = () => void signOut();
}

/** End the session in all pages of this browser. */
async function signOut() {
  const headers = new Headers();
  await authorize("DELETE", headers);
  const answer = await fetch(SESSION, { method: "DELETE", headers }).catch(() => null);
  if (!answer?.ok && answer?.status !== 401) return;
  channel.postMessage("out");
  location.reload();
}

/** Mark the session as rejected; the stop ticket remains. */
function markSignedOut() {
  if (signedOutAt) return;
  signedOutAt = new Date();
  showExpiry();
  notify();
}

function notify() {
  for (const act of listeners) act();
}

channel.onmessage = (/** @type {MessageEvent} */ { data }) => {
  if (data === "in") return void readSession();
  token = ticket = null; // sign-out also ends the right to stop
  markSignedOut();
};

/** Show when the session ends, with a button to renew it. */
function showExpiry() {
  const line = document.getElementById("session");
  if (!line) return;
  const left = expiresAt === null ? Infinity : expiresAt - Date.now();
  line.hidden = signedOutAt !== null || left > WARNING_PERIOD;
  if (line.hidden || expiresAt === null) return;
  const text = left > 0 ? `Your session ends at ${formatTime(new Date(expiresAt))}.` : "Your session has ended.";
  if (line.firstChild?.textContent === text) return;
  line.replaceChildren(h("span", null, text), " ", h("button", { type: "button", onclick: () => void askToSignIn() }, "Stay signed in …"));
}

/** Open the sign-in dialog. @returns {Promise<boolean>} whether it was given */
export function askToSignIn() {
  const button = document.getElementById("sign-out");
  if (button && signedOutAt) button.hidden = true; // the dialog has a button of the same name
  dialogResult ??= openSignInDialog("Enter your key to open a new session.").finally(() => (dialogResult = null));
  return dialogResult.then((isIn) => {
    if (!isIn && signedOutAt) offerSignIn();
    return isIn;
  });
}

/** Renew the stop ticket periodically and retry failed requests for the session. */
export function startRenewal() {
  setInterval(showExpiry, RETRY_INTERVAL);
  setInterval(() => document.hidden || isKnown || readSession(), RETRY_INTERVAL);
  setInterval(() => document.hidden || signedOutAt || readSession(), RENEWAL_INTERVAL);
  document.addEventListener("visibilitychange", () => document.hidden || signedOutAt || readSession());
}

const READY_TIMEOUT = 300;
const ready = readSession();

/** Add the CSRF token to the headers of a request. @param {string} method @param {Headers} headers */
export async function authorize(method, headers) {
  if (method === "GET") return;
  await Promise.race([ready, new Promise((resolve) => setTimeout(resolve, READY_TIMEOUT))]);
  if (token) headers.set("X-CSRF-Token", token);
}

/** Open the sign-in dialog once for all rejected requests; return false if the user cancels it. @param {Response} response @param {boolean} isUserAction false for polls */
export async function signIn(response, isUserAction) {
  markSignedOut();
  if (isDeclined && !isUserAction) return false;
  const reason = (await response.clone().json().catch(() => null))?.detail ?? "an API key is required";
  dialogResult ??= openSignInDialog(reason).then((isIn) => {
    isDeclined = !isIn;
    if (isDeclined) offerSignIn();
    return isIn;
  }).finally(() => (dialogResult = null));
  return dialogResult;
}

/** Show the sign-in button. */
function offerSignIn() {
  const button = document.getElementById("sign-out");
  if (!button) return;
  Object.assign(button, { hidden: false, textContent: "Sign in", title: "", onclick: async () => (await askToSignIn()) && location.reload() });
}

/** Create a session; return the reason of a refusal. @param {string} key @returns {Promise<string>} */
async function createSession(key) {
  try {
    const answer = await fetch(SESSION, { method: "POST", headers: { Authorization: `Bearer ${key}` } });
    const result = await answer.json();
    if (!answer.ok) return result.detail ?? `the service responded with status ${answer.status}`;
    storeSession(result, answer);
    channel.postMessage("in");
    return "";
  } catch {
    return "the service does not answer";
  }
}

/** @param {string} reason @returns {Promise<boolean>} */
function openSignInDialog(reason) {
  const input = h("input", { type: "password", autocomplete: "off", id: "sign-in-key", required: true, style: { width: "100%" } });
  const errorText = h("p", { class: "fault", role: "alert" });
  const cancel = h("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
  const form = h("form", null,
    h("h2", { id: "sign-in-title" }, "Sign in"), h("p", { class: "dim" }, reason),
    h("label", { for: "sign-in-key" }, "API key"), input, errorText,
    h("menu", null, cancel, h("button", { class: "primary" }, "Sign in")));
  const dialog = h("dialog", { "aria-labelledby": "sign-in-title" }, form);
  let isIn = false;
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    errorText.textContent = await createSession(input.value.trim());
    isIn = errorText.textContent === "";
    if (isIn) dialog.close();
  });
  openDialog(dialog);
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(isIn));
  });
}
