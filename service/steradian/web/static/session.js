// @ts-check
// Who asks. On a service that only its own machine reaches nobody needs to say so; elsewhere a key is asked for once,
// and a cookie that no script can read takes its place.
import { h, openDialog } from "./dom.js";
import { formatTime } from "./units.js";
import { urlOf } from "./urls.js";

const SESSION = urlOf("/api/v1/session");
/** @type {string | null} */
let token = null;
/** @type {Promise<boolean> | null} */
let dialogResult = null;
let isDeclined = false; // nobody is asked again before a person does something
/** @type {string | null} presses the stop after the session has ended; only this page has it, until somebody signs out */
let ticket = null;
/** @type {Date | null} since when the service refuses this page */
let signedOutAt = null;
/** @type {number | null} when the session ends, by this computer's clock */
let expiresAt = null;
let isKnown = false; // whether the last question who asks was answered
/** @type {Set<() => void>} */
const listeners = new Set();
const channel = new BroadcastChannel("steradian.session"); // tells the other pages of this browser who signs in or out
const WARNING_PERIOD = 15 * 60e3; // ms before its end, from when on the page says so
const RENEWAL_INTERVAL = 10 * 60e3; // ms between two stop tickets
const RETRY_INTERVAL = 5e3;

/** What to press the stop with, if this page has been signed in. */
export const stopTicket = () => ticket;

/** Whether this page was signed in once. */
export const wasSignedIn = () => ticket !== null || expiresAt !== null;

/** Since when the service no longer knows this page, or null. */
export const signedOut = () => signedOutAt;

/** Be told when somebody has signed in or out. @param {() => void} act */
export function onSession(act) {
  listeners.add(act);
}

/** Learn what changes must bring; asked for when the page begins, so that the stop does not wait for it. */
export async function readSession() {
  try {
    const answer = await fetch(SESSION);
    isKnown = answer.ok || answer.status === 401;
    if (answer.ok) storeSession(await answer.json(), answer);
    else if (answer.status === 401) markSignedOut();
  } catch {
    isKnown = false; // the bar says that nobody answers
  }
}

/** @param {any} session @param {Response} answer which said it, with the service's time */
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

/** End the session, here and in every page of this browser, and ask for a key again. */
async function signOut() {
  const headers = new Headers();
  await authorize("DELETE", headers);
  const answer = await fetch(SESSION, { method: "DELETE", headers }).catch(() => null);
  if (!answer?.ok && answer?.status !== 401) return;
  channel.postMessage("out");
  location.reload();
}

/** The service knows this page no more; the stop ticket stays. */
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
  token = ticket = null; // whoever signs out wants nothing of it left
  markSignedOut();
};

/** Say that the session ends soon, and let somebody stay. */
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

/** Ask for a key. @returns {Promise<boolean>} whether it was given */
export function askToSignIn() {
  const button = document.getElementById("sign-out");
  if (button && signedOutAt) button.hidden = true; // the dialog has a button of that name
  dialogResult ??= openSignInDialog("Enter your key to open a new session.").finally(() => (dialogResult = null));
  return dialogResult.then((isIn) => {
    if (!isIn && signedOutAt) offerSignIn();
    return isIn;
  });
}

/** Have a new stop ticket now and then, and whatever could not be learned. */
export function startRenewal() {
  setInterval(showExpiry, RETRY_INTERVAL);
  setInterval(() => document.hidden || isKnown || readSession(), RETRY_INTERVAL);
  setInterval(() => document.hidden || signedOutAt || readSession(), RENEWAL_INTERVAL);
  document.addEventListener("visibilitychange", () => document.hidden || signedOutAt || readSession());
}

const READY_TIMEOUT = 300;
const ready = readSession();

/** Add what shows that a page of this service asks. @param {string} method @param {Headers} headers */
export async function authorize(method, headers) {
  if (method === "GET") return;
  await Promise.race([ready, new Promise((resolve) => setTimeout(resolve, READY_TIMEOUT))]);
  if (token) headers.set("X-CSRF-Token", token);
}

/** Ask for a key, once for all who were refused; false when it was not given. @param {Response} response @param {boolean} isUserAction something that a person does, no look */
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

/** Leave a way in to who did not want to. */
function offerSignIn() {
  const button = document.getElementById("sign-out");
  if (!button) return;
  Object.assign(button, { hidden: false, textContent: "Sign in", title: "", onclick: async () => (await askToSignIn()) && location.reload() });
}

/** Open a session, or say why there is none. @param {string} key @returns {Promise<string>} */
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
