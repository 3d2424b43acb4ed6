// @ts-check
// Who asks. On a service that only its own machine reaches nobody needs to say so; elsewhere a key is asked for once,
// and a cookie that no script can read takes its place.
import { h, openDialog } from "./dom.js";

const SESSION = "/api/v1/session";
/** @type {string | null} */
let token = null;
/** @type {Promise<boolean> | null} */
let asking = null;
let isDeclined = false; // nobody is asked again before a person does something

/** Learn what changes must bring; asked for when the page begins, so that the stop does not wait for it. */
export async function startSession() {
  try {
    const answer = await fetch(SESSION);
    if (answer.ok) learn(await answer.json());
  } catch {
    // the bar says that nobody answers
  }
}

/** @param {any} session */
function learn(session) {
  token = session.csrf_token;
  const out = document.getElementById("sign-out");
  if (!out) return;
  out.hidden = !token;
  out.textContent = "Sign out";
  out.title = `Sign out ${session.principal}`;
  out.onclick = () => void signOut();
}

/** End the session, here and in every page of this browser, and ask for a key again. */
async function signOut() {
  const headers = new Headers();
  await authorize("DELETE", headers);
  const answer = await fetch(SESSION, { method: "DELETE", headers }).catch(() => null);
  if (answer?.ok || answer?.status === 401) location.reload();
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
  Object.assign(way, { hidden: false, textContent: "Sign in", title: "", onclick: () => location.reload() });
}

/** Open a session, or say why there is none. @param {string} key @returns {Promise<string>} */
async function open(key) {
  try {
    const answer = await fetch(SESSION, { method: "POST", headers: { Authorization: `Bearer ${key}` } });
    const said = await answer.json();
    if (!answer.ok) return said.detail ?? `the service answered ${answer.status}`;
    learn(said);
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
