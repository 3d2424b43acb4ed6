// @ts-check
// Who asks. On a service that only its own machine reaches nobody needs to say so; elsewhere a key is asked for once,
// and a cookie that no script can read takes its place.
import { h, openDialog } from "./dom.js";
import { clock } from "./units.js";
import { at } from "./urls.js";

const SESSION = at("/api/v1/session");
/** @type {string | null} */
let token = null;
/** @type {Promise<boolean> | null} */
let asking = null;
let isDeclined = false; // nobody is asked again before a person does something
/** @type {string | null} presses the stop after the session has ended; only this page has it, until somebody signs out */
let ticket = null;
/** @type {Date | null} since when the service refuses this page */
let out = null;
/** @type {number | null} when the session ends, by this computer's clock */
let ends = null;
let isLearned = false; // whether the last question who asks was answered
/** @type {Set<() => void>} */
const watchers = new Set();
const others = new BroadcastChannel("steradian.session"); // tells the other pages of this browser who signs in or out
const WARN = 15 * 60e3; // ms before its end, from when on the page says so
const RENEW = 10 * 60e3; // ms between two stop tickets
const RETRY = 5e3;

/** What to press the stop with, if this page has been signed in. */
export const stopTicket = () => ticket;

/** Whether this page was signed in once. */
export const wasSignedIn = () => ticket !== null || ends !== null;

/** Since when the service no longer knows this page, or null. */
export const signedOut = () => out;

/** Be told when somebody has signed in or out. @param {() => void} act */
export function watchSession(act) {
  watchers.add(act);
}

/** Learn what changes must bring; asked for when the page begins, so that the stop does not wait for it. */
export async function startSession() {
  try {
    const answer = await fetch(SESSION);
    isLearned = answer.ok || answer.status === 401;
    if (answer.ok) learn(await answer.json(), answer);
    else if (answer.status === 401) leave();
  } catch {
    isLearned = false; // the bar says that nobody answers
  }
}

/** @param {any} session @param {Response} answer which said it, with the service's time */
function learn(session, answer) {
  token = session.csrf_token;
  ticket = session.stop_ticket;
  const ahead = Date.now() - (Date.parse(answer.headers.get("Date") ?? "") || Date.now());
  ends = session.expires && Date.parse(session.expires) + ahead;
  out = null;
  isDeclined = false;
  warn();
  tell();
  const way = document.getElementById("sign-out");
  if (!way) return;
  way.hidden = !token;
  way.textContent = "Sign out";
  way.title = `Sign out ${session.principal}`;
  way.onclick = () => void signOut();
}

/** End the session, here and in every page of this browser, and ask for a key again. */
async function signOut() {
  const headers = new Headers();
  await authorize("DELETE", headers);
  const answer = await fetch(SESSION, { method: "DELETE", headers }).catch(() => null);
  if (!answer?.ok && answer?.status !== 401) return;
  others.postMessage("out");
  location.reload();
}

/** The service knows this page no more; the stop ticket stays. */
function leave() {
  if (out) return;
  out = new Date();
  warn();
  tell();
}

function tell() {
  for (const act of watchers) act();
}

others.onmessage = (/** @type {MessageEvent} */ { data }) => {
  if (data === "in") return void startSession();
  token = ticket = null; // whoever signs out wants nothing of it left
  leave();
};

/** Say that the session ends soon, and let somebody stay. */
function warn() {
  const line = document.getElementById("session");
  if (!line) return;
  const left = ends === null ? Infinity : ends - Date.now();
  line.hidden = out !== null || left > WARN;
  if (line.hidden || ends === null) return;
  const text = left > 0 ? `Your session ends at ${clock(new Date(ends))}.` : "Your session has ended.";
  if (line.firstChild?.textContent === text) return;
  line.replaceChildren(h("span", null, text), " ", h("button", { type: "button", onclick: () => void askToSignIn() }, "Stay signed in …"));
}

/** Ask for a key. @returns {Promise<boolean>} whether it was given */
export function askToSignIn() {
  const way = document.getElementById("sign-out");
  if (way && out) way.hidden = true; // the dialog has a button of that name
  asking ??= show("Your key opens a new session.").finally(() => (asking = null));
  return asking.then((isIn) => {
    if (!isIn && out) offer();
    return isIn;
  });
}

/** Have a new stop ticket now and then, and whatever could not be learned. */
export function keepSession() {
  setInterval(warn, RETRY);
  setInterval(() => document.hidden || isLearned || startSession(), RETRY);
  setInterval(() => document.hidden || out || startSession(), RENEW);
  document.addEventListener("visibilitychange", () => document.hidden || out || startSession());
}

const PATIENCE = 300;
const ready = startSession();

/** Add what shows that a page of this service asks. @param {string} method @param {Headers} headers */
export async function authorize(method, headers) {
  if (method === "GET") return;
  await Promise.race([ready, new Promise((go) => setTimeout(go, PATIENCE))]);
  if (token) headers.set("X-CSRF-Token", token);
}

/** Ask for a key, once for all who were refused; false when it was not given. @param {Response} refused @param {boolean} isWish something that a person does, no look */
export async function signIn(refused, isWish) {
  leave();
  if (isDeclined && !isWish) return false;
  const why = (await refused.clone().json().catch(() => null))?.detail ?? "a key is needed";
  asking ??= show(why).then((isIn) => {
    isDeclined = !isIn;
    if (isDeclined) offer();
    return isIn;
  }).finally(() => (asking = null));
  return asking;
}

/** Leave a way in to who did not want to. */
function offer() {
  const way = document.getElementById("sign-out");
  if (!way) return;
  Object.assign(way, { hidden: false, textContent: "Sign in", title: "", onclick: async () => (await askToSignIn()) && location.reload() });
}

/** Open a session, or say why there is none. @param {string} key @returns {Promise<string>} */
async function open(key) {
  try {
    const answer = await fetch(SESSION, { method: "POST", headers: { Authorization: `Bearer ${key}` } });
    const said = await answer.json();
    if (!answer.ok) return said.detail ?? `the service answered ${answer.status}`;
    learn(said, answer);
    others.postMessage("in");
    return "";
  } catch {
    return "the service does not answer";
  }
}

/** @param {string} why @returns {Promise<boolean>} */
function show(why) {
  const input = h("input", { type: "password", autocomplete: "off", id: "sign-in-key", required: true, style: { width: "100%" } });
  const said = h("p", { class: "fault", role: "alert" });
  const cancel = h("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
  const form = h("form", null,
    h("h2", { id: "sign-in-title" }, "Sign in"), h("p", { class: "dim" }, why),
    h("label", { for: "sign-in-key" }, "API key"), input, said,
    h("menu", null, cancel, h("button", { class: "primary" }, "Sign in")));
  const dialog = h("dialog", { "aria-labelledby": "sign-in-title" }, form);
  let isIn = false;
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    said.textContent = await open(input.value.trim());
    isIn = said.textContent === "";
    if (isIn) dialog.close();
  });
  openDialog(dialog);
  return new Promise((settle) => {
    dialog.addEventListener("close", () => settle(isIn));
  });
}
