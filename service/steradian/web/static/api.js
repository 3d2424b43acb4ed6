// @ts-check
// Client of the HTTP API: JSON requests, RFC 9457 problems as errors, sign-in on demand.
import { authorize, signIn, readSession } from "./session.js";
import { urlOf } from "./urls.js";

export const BASE = urlOf("/api/v1");
const MAX_CONCURRENT = 3; // of a browser's six connections: one carries the event stream, two are left for status polls and the emergency stop
const HIGH_PRIORITY = { priority: /** @type {const} */ ("high") };

const PROXY_LIMIT_MESSAGE = "A proxy in front of the service does not accept request bodies of this size; the service did not receive the request. The limit is client_max_body_size in nginx, request_body max_size in Caddy, LimitRequestBody in Apache.";

/** @typedef {{pointer: string, allowed: string, detail: string, place: string}} FieldError */
/** @typedef {{signal?: AbortSignal, headers?: Record<string, string>, accept?: string, urgent?: boolean, promptSignIn?: boolean}} RequestOptions  promptSignIn: false suppresses the sign-in dialog */

/** Problem response (RFC 9457) of the service. */
export class Problem extends Error {
  /** @param {number} status @param {any} body @param {Response | null} [response] */
  constructor(status, body, response) {
    if (status === 413 && !body?.code) body = { title: "The proxy rejected the size of the request", detail: PROXY_LIMIT_MESSAGE };
    super(body?.detail || body?.title || `the service responded with status ${status}`);
    this.name = "Problem";
    this.status = status;
    this.title = /** @type {string} */ (body?.title ?? "");
    this.detail = /** @type {string} */ (body?.detail ?? "");
    this.code = /** @type {string} */ (body?.code ?? "");
    this.type = /** @type {string} */ (body?.type ?? "");
    this.errors = /** @type {FieldError[]} */ (body?.errors ?? []);
    this.retryAfter = Number(response?.headers.get("Retry-After") ?? 0);
  }
}

let activeRequests = 0;
let urgentRequests = 0; // running urgent requests; other requests wait until there are none
/** @type {Set<(none: null) => void>} */
const waitingRequests = new Set();
/** @type {Set<AbortController>} reads that an urgent request aborts; they are sent again afterwards */
const abortableReads = new Set();

/** @param {AbortSignal} [signal] */
async function acquireConnection(signal) {
  while (!signal?.aborted && (activeRequests >= MAX_CONCURRENT || urgentRequests)) {
    await new Promise((resolve) => {
      waitingRequests.add(resolve);
      signal?.addEventListener("abort", () => waitingRequests.delete(resolve) && resolve(null), { once: true });
    });
  }
  if (signal?.aborted) throw signal.reason;
  activeRequests += 1;
}

function releaseConnection() {
  activeRequests -= 1;
  const [next] = waitingRequests;
  waitingRequests.delete(next);
  next?.(null);
}

/** Free connections for an urgent request by aborting running reads. */
function beginUrgent() {
  urgentRequests += 1;
  for (const one of abortableReads) one.abort();
}

function endUrgent() {
  urgentRequests -= 1;
  for (const resolve of waitingRequests) resolve(null); // each checks again whether a connection is free
  waitingRequests.clear();
}

/**
 * Send a request and return the complete response; throw {@link Problem} on an error status.
 * @param {string} method
 * @param {string} path below /api/v1, or a link of a resource
 * @param {any} [body] sent as JSON; a Blob unchanged
 * @param {RequestOptions} [options]
 * @returns {Promise<Response>}
 */
export async function request(method, path, body, options = {}) {
  const response = await sendAuthorized(method, path, body, options);
  if (response.ok || response.status === 304) return response;
  const problem = new Problem(response.status, await response.json().catch(() => null), response);
  if (problem.code !== "cross-site") throw problem;
  await readSession(); // another page of this browser has started a new session
  const second = await sendAuthorized(method, path, body, options);
  if (second.ok) return second;
  throw new Problem(second.status, await second.json().catch(() => null), second);
}

/**
 * Send a request with the credentials of the session; open the sign-in dialog on status 401.
 * @param {string} method @param {string} path @param {any} body @param {RequestOptions} options
 * @returns {Promise<Response>}
 */
async function sendAuthorized(method, path, body, options) {
  const isAbsolute = path.startsWith("/api/") || path.startsWith("/openapi") || path.startsWith(`${BASE}/`);
  const address = isAbsolute ? urlOf(path) : BASE + path;
  const controller = method === "GET" && !options.urgent ? new AbortController() : null;
  if (options.urgent) beginUrgent();
  else await acquireConnection(options.signal);
  if (controller) abortableReads.add(controller);
  let response = null;
  try {
    response = await send(method, address, body, options, controller);
  } catch (error) {
    if (!controller?.signal.aborted || options.signal?.aborted) throw error;
  } finally {
    if (controller) abortableReads.delete(controller);
    if (options.urgent) endUrgent();
    else releaseConnection();
  }
  if (!response) return sendAuthorized(method, path, body, options); // aborted by an urgent request
  return response.status === 401 && options.promptSignIn !== false && (await signIn(response, method !== "GET")) ? sendAuthorized(method, path, body, options) : response;
}

/**
 * Send a request and read the whole body, because the connection stays busy until then.
 * @param {string} method @param {string} address @param {any} body @param {RequestOptions} options
 * @param {AbortController | null} controller aborted when it is to give way
 */
async function send(method, address, body, options, controller) {
  const headers = new Headers({ Accept: options.accept ?? "application/json", ...options.headers });
  await authorize(method, headers);
  if (body !== undefined && !(body instanceof Blob)) headers.set("Content-Type", "application/json");
  const payload = body === undefined || body instanceof Blob ? body : JSON.stringify(body);
  const signal = AbortSignal.any([options.signal, controller?.signal].filter((one) => one !== undefined));
  const response = await fetch(address, { method, headers, body: payload, signal, ...(options.urgent ? HIGH_PRIORITY : {}) });
  const whole = [204, 304].includes(response.status) ? null : await response.arrayBuffer();
  return new Response(whole, response);
}

/**
 * Poll a small resource with high priority; an emergency stop aborts the poll (AbortError).
 * Throw {@link Problem} on an error status; on status 401, open the sign-in dialog if `promptSignIn` is set.
 * @param {string} path below /api/v1
 * @param {number} timeout milliseconds for the whole answer
 * @param {{headers?: Record<string, string>, promptSignIn?: boolean}} [how]
 * @returns {Promise<any>}
 */
export async function poll(path, timeout, { headers = {}, promptSignIn = false } = {}) {
  const controller = new AbortController();
  abortableReads.add(controller);
  try {
    const signal = AbortSignal.any([controller.signal, AbortSignal.timeout(timeout)]);
    const response = await fetch(BASE + path, { headers: { Accept: "application/json", ...headers }, signal, cache: "no-store", ...HIGH_PRIORITY });
    if (response.ok) return await response.json();
    if (response.status === 401 && promptSignIn) void signIn(response.clone(), false);
    throw new Problem(response.status, await response.json().catch(() => null), response);
  } finally {
    abortableReads.delete(controller);
  }
}

/** @param {Response} response */
async function parseBody(response) {
  return response.status === 204 ? null : response.json();
}

export const api = {
  /** @param {string} path @param {RequestOptions} [options] @returns {Promise<any>} */
  get: async (path, options) => parseBody(await request("GET", path, undefined, options)),
  /** @param {string} path @param {any} [body] @param {RequestOptions} [options] @returns {Promise<any>} */
  post: async (path, body, options) => parseBody(await request("POST", path, body, options)),
  /** @param {string} path @param {any} [body] @param {RequestOptions} [options] @returns {Promise<any>} */
  put: async (path, body, options) => parseBody(await request("PUT", path, body, options)),
  /** @param {string} path @param {any} [body] @param {RequestOptions} [options] @returns {Promise<any>} */
  patch: async (path, body, options) => parseBody(await request("PATCH", path, body, options)),
  /** @param {string} path @param {RequestOptions} [options] @returns {Promise<any>} */
  remove: async (path, options) => parseBody(await request("DELETE", path, undefined, options)),
  request,
};

/** Return headers with a new idempotency key. */
export function idempotencyHeaders() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return { "Idempotency-Key": [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("") };
}
