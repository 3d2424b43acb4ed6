// @ts-check
// The HTTP API as the page's only back end: JSON in and out, problems as errors, a key where one is needed.
import { authorize, signIn, startSession } from "./session.js";
import { at } from "./urls.js";

export const BASE = at("/api/v1");
const AT_ONCE = 3; // of six connections that a browser opens: one is the event stream's, two are for looks, which give way to the stop
const HURRIED = { priority: /** @type {const} */ ("high") };

const PROXY_REFUSES = "A proxy in front of the service takes no body as large as this one, and the service never saw it. Its limit is client_max_body_size in nginx, request_body max_size in Caddy, LimitRequestBody in Apache.";

/** @typedef {{pointer: string, allowed: string, detail: string, place: string}} Finding */
/** @typedef {{signal?: AbortSignal, headers?: Record<string, string>, accept?: string, urgent?: boolean, asks?: boolean}} How  asks: false where nobody is asked to sign in */

/** What the service refused, in its words. */
export class Problem extends Error {
  /** @param {number} status @param {any} body @param {Response | null} [answer] */
  constructor(status, body, answer) {
    if (status === 413 && !body?.code) body = { title: "A proxy refused the size", detail: PROXY_REFUSES };
    super(body?.detail || body?.title || `the service answered ${status}`);
    this.name = "Problem";
    this.status = status;
    this.title = /** @type {string} */ (body?.title ?? "");
    this.detail = /** @type {string} */ (body?.detail ?? "");
    this.code = /** @type {string} */ (body?.code ?? "");
    this.type = /** @type {string} */ (body?.type ?? "");
    this.errors = /** @type {Finding[]} */ (body?.errors ?? []);
    this.retryAfter = Number(answer?.headers.get("Retry-After") ?? 0);
  }
}

let underWay = 0;
let hurried = 0; // requests that cannot wait; while there is one, no other begins
/** @type {Set<(none: null) => void>} */
const waiting = new Set();
/** @type {Set<AbortController>} those that only read: they are given up for one that cannot wait, and asked again */
const reading = new Set();

/** @param {AbortSignal} [signal] */
async function turn(signal) {
  while (!signal?.aborted && (underWay >= AT_ONCE || hurried)) {
    await new Promise((go) => {
      waiting.add(go);
      signal?.addEventListener("abort", () => waiting.delete(go) && go(null), { once: true });
    });
  }
  if (signal?.aborted) throw signal.reason;
  underWay += 1;
}

function leave() {
  underWay -= 1;
  const [next] = waiting;
  waiting.delete(next);
  next?.(null);
}

/** Leave connections and service to a request that cannot wait: downloads may hold what this page does not. */
function hurry() {
  hurried += 1;
  for (const one of reading) one.abort();
}

function settle() {
  hurried -= 1;
  for (const go of waiting) go(null); // each looks whether it has its turn
  waiting.clear();
}

/**
 * Ask for something and return the whole answer; raises {@link Problem} for what is refused.
 * @param {string} method
 * @param {string} path below /api/v1, or a link of a resource
 * @param {any} [body] sent as JSON; a Blob as it is
 * @param {How} [how]
 * @returns {Promise<Response>}
 */
export async function ask(method, path, body, how = {}) {
  const answer = await exchange(method, path, body, how);
  if (answer.ok || answer.status === 304) return answer;
  const problem = new Problem(answer.status, await answer.json().catch(() => null), answer);
  if (problem.code !== "cross-site") throw problem;
  await startSession(); // another page of this browser has signed in since
  const second = await exchange(method, path, body, how);
  if (second.ok) return second;
  throw new Problem(second.status, await second.json().catch(() => null), second);
}

/**
 * The same, whatever the answer; who must sign in is asked to.
 * @param {string} method @param {string} path @param {any} body @param {How} how
 * @returns {Promise<Response>}
 */
async function exchange(method, path, body, how) {
  const isWhole = path.startsWith("/api/") || path.startsWith("/openapi") || path.startsWith(`${BASE}/`);
  const address = isWhole ? at(path) : BASE + path;
  const way = method === "GET" && !how.urgent ? new AbortController() : null;
  if (how.urgent) hurry();
  else await turn(how.signal);
  if (way) reading.add(way);
  let answer = null;
  try {
    answer = await send(method, address, body, how, way);
  } catch (error) {
    if (!way?.signal.aborted || how.signal?.aborted) throw error;
  } finally {
    if (way) reading.delete(way);
    if (how.urgent) settle();
    else leave();
  }
  if (!answer) return exchange(method, path, body, how); // it gave way
  return answer.status === 401 && how.asks !== false && (await signIn(answer, method !== "GET")) ? exchange(method, path, body, how) : answer;
}

/**
 * Send it and wait for the whole body, as the connection is busy for so long.
 * @param {string} method @param {string} address @param {any} body @param {How} how
 * @param {AbortController | null} way aborted when it is to give way
 */
async function send(method, address, body, how, way) {
  const headers = new Headers({ Accept: how.accept ?? "application/json", ...how.headers });
  await authorize(method, headers);
  if (body !== undefined && !(body instanceof Blob)) headers.set("Content-Type", "application/json");
  const sent = body === undefined || body instanceof Blob ? body : JSON.stringify(body);
  const signal = AbortSignal.any([how.signal, way?.signal].filter((one) => one !== undefined));
  const answer = await fetch(address, { method, headers, body: sent, signal, ...(how.urgent ? HURRIED : {}) });
  const whole = [204, 304].includes(answer.status) ? null : await answer.arrayBuffer();
  return new Response(whole, answer);
}

/**
 * Look at something small that must not wait for what else is under way; a press of the stop aborts it (AbortError).
 * Raises {@link Problem} for what is refused, at once: who must sign in is asked to meanwhile, where that is wanted.
 * @param {string} path below /api/v1
 * @param {number} patience milliseconds for the whole answer
 * @param {{headers?: Record<string, string>, asks?: boolean}} [how]
 * @returns {Promise<any>}
 */
export async function lookAt(path, patience, { headers = {}, asks = false } = {}) {
  const way = new AbortController();
  reading.add(way);
  try {
    const signal = AbortSignal.any([way.signal, AbortSignal.timeout(patience)]);
    const answer = await fetch(BASE + path, { headers: { Accept: "application/json", ...headers }, signal, cache: "no-store", ...HURRIED });
    if (answer.ok) return await answer.json();
    if (answer.status === 401 && asks) void signIn(answer.clone(), false);
    throw new Problem(answer.status, await answer.json().catch(() => null), answer);
  } finally {
    reading.delete(way);
  }
}

/** @param {Response} answer */
async function read(answer) {
  return answer.status === 204 ? null : answer.json();
}

export const api = {
  /** @param {string} path @param {How} [how] @returns {Promise<any>} */
  get: async (path, how) => read(await ask("GET", path, undefined, how)),
  /** @param {string} path @param {any} [body] @param {How} [how] @returns {Promise<any>} */
  post: async (path, body, how) => read(await ask("POST", path, body, how)),
  /** @param {string} path @param {any} [body] @param {How} [how] @returns {Promise<any>} */
  put: async (path, body, how) => read(await ask("PUT", path, body, how)),
  /** @param {string} path @param {any} [body] @param {How} [how] @returns {Promise<any>} */
  patch: async (path, body, how) => read(await ask("PATCH", path, body, how)),
  /** @param {string} path @param {How} [how] @returns {Promise<any>} */
  remove: async (path, how) => read(await ask("DELETE", path, undefined, how)),
  ask,
};

/** A key under which a request that is sent twice makes one thing. */
export function onceOnly() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return { "Idempotency-Key": [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("") };
}
