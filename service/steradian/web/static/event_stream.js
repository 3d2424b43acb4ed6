// @ts-check
// Event stream shared by all pages of a browser, because a browser opens only six connections to a service and the
// emergency stop needs one. The page that holds a lock receives events and broadcasts them to the others. While the
// stream is interrupted, pages poll instead.
import { BASE } from "./api.js";

/** @typedef {"scan" | "reconstruction" | "revision" | "job" | "batch" | "scanner" | "progress" | "again"} Kind */
/** @typedef {{is: "opening" | "live" | "cut" | "resting", since: Date}} State */
/** @typedef {{asks?: boolean, is?: "live" | "cut", again?: boolean, kind?: Kind, data?: any, last?: string}} ChannelMessage  between pages */

const KINDS = /** @type {Kind[]} */ (["scan", "reconstruction", "revision", "job", "batch", "scanner", "progress"]);
const RETRY_INTERVAL = 2000;
const CHANNEL_NAME = "steradian.events"; // name of the lock and of the broadcast channel

class EventStream {
  constructor() {
    /** @type {State} */
    this.state = { is: "opening", since: new Date() };
    /** @type {EventSource | null} */
    this._source = null;
    this._last = "";
    /** @type {Map<string, Set<(data: any) => void>>} */
    this._listeners = new Map();
    /** @type {Set<(state: State) => void>} */
    this._watchers = new Set();
    this._channel = new BroadcastChannel(CHANNEL_NAME);
    this._channel.onmessage = ({ data }) => this._receive(data);
    /** @type {(() => void) | null} releases the lock for another page */
    this._releaseLock = null;
    /** @type {AbortController | null} aborts waiting for the lock */
    this._lockRequest = null;
  }

  /**
   * Subscribe to a kind of event. "again" means that everything may have changed, so that listeners read again; a late
   * listener receives it at once.
   * @param {Kind} kind @param {(data: any) => void} act
   * @returns {() => void} ends it
   */
  on(kind, act) {
    const listeners = this._listeners.get(kind) ?? new Set();
    this._listeners.set(kind, listeners.add(act));
    // the stream may have opened before this listener was added
    if (kind === "again" && this.state.is !== "opening") queueMicrotask(() => act(null));
    return () => listeners.delete(act);
  }

  /** Subscribe to the state of the stream; call the listener at once. @param {(state: State) => void} act */
  watch(act) {
    this._watchers.add(act);
    act(this.state);
  }

  /** Start; only visible pages take part. */
  start() {
    const update = () => (document.hidden ? this._suspend() : this._acquireLock());
    document.addEventListener("visibilitychange", update);
    update();
  }

  /** Connect once this page holds the lock; until then, receive broadcasts of the page that holds it. */
  _acquireLock() {
    if (this._releaseLock || !navigator.locks) return this._connect(); // no locks on pages loaded by plain HTTP from another machine
    if (this._lockRequest) return;
    this._lockRequest = new AbortController();
    const listen = () => new Promise((release) => {
      if (document.hidden) return release(null); // hidden before the lock was acquired
      this._lockRequest = null;
      this._releaseLock = () => release(null);
      this._connect();
    });
    navigator.locks.request(CHANNEL_NAME, { signal: this._lockRequest.signal }, listen).catch(() => null);
    this._channel.postMessage({ asks: true });
  }

  _suspend() {
    clearTimeout(this._timer);
    this._lockRequest?.abort();
    this._source?.close();
    this._releaseLock?.();
    this._source = this._lockRequest = this._releaseLock = null;
    this._setState("resting");
  }

  /** @param {ChannelMessage} message from the page that holds the lock, or a query of a new page */
  _receive(message) {
    if (this._releaseLock && message.asks && (this.state.is === "live" || this.state.is === "cut")) this._channel.postMessage({ is: this.state.is, last: this._last });
    if (!this._lockRequest || message.asks) return;
    this._last = message.last || this._last;
    if (message.kind) return this._dispatch(message.kind, message.data);
    const before = this.state.is;
    this._setState(message.is ?? before);
    if (message.again || before !== this.state.is) this._dispatch("again", null);
  }

  /** @param {ChannelMessage} message */
  _broadcast(message) {
    if (this._releaseLock) this._channel.postMessage({ ...message, last: this._last });
  }

  _connect() {
    clearTimeout(this._timer);
    this._source?.close();
    const query = new URLSearchParams();
    if (this._last) query.set("last_event_id", this._last);
    const source = (this._source = new EventSource(`${BASE}/events?${query}`));
    source.addEventListener("ready", (event) => this._handleReady(/** @type {MessageEvent} */ (event)));
    source.addEventListener("reset", (event) => this._handleReady(/** @type {MessageEvent} */ (event)));
    for (const kind of KINDS) source.addEventListener(kind, (event) => this._handleEvent(kind, /** @type {MessageEvent} */ (event)));
    source.onmessage = (event) => (this._last = event.lastEventId || this._last);
    source.onerror = () => this._handleError();
  }

  /** @param {MessageEvent} event */
  _handleReady(event) {
    this._last = event.lastEventId || this._last;
    this._setState("live");
    this._dispatch("again", null);
    this._broadcast({ is: "live", again: true });
  }

  /** @param {Kind} kind @param {MessageEvent} event */
  _handleEvent(kind, event) {
    this._last = event.lastEventId || this._last;
    const data = JSON.parse(event.data);
    this._dispatch(kind, data);
    this._broadcast({ kind, data });
  }

  /** Reconnect after an interval; subscribers poll meanwhile. */
  _handleError() {
    this._source?.close();
    this._source = null;
    if (document.hidden) return;
    this._setState("cut");
    this._dispatch("again", null);
    this._broadcast({ is: "cut", again: true });
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this._connect(), RETRY_INTERVAL);
  }

  /** Reconnect after a request without response, because the stream may be dead, too. */
  reconnect() {
    if (this._source && this.state.is === "live") this._handleError();
  }

  /** @param {State["is"]} value */
  _setState(value) {
    if (this.state.is === value) return;
    this.state = { is: value, since: new Date() };
    document.body.dataset.live = value;
    for (const watcher of this._watchers) watcher(this.state);
  }

  /** @param {Kind} kind @param {any} data */
  _dispatch(kind, data) {
    for (const act of this._listeners.get(kind) ?? []) act(data);
  }

  /** @type {ReturnType<typeof setTimeout> | undefined} */
  _timer;
}

export const live = new EventStream();
