// @ts-check
// Event stream: one event stream for all pages of the browser, for it opens six connections to a service
// and the emergency stop needs one. One page listens and tells the others. When the stream is cut, everybody is told,
// and asks instead.
import { BASE } from "./api.js";

/** @typedef {"scan" | "reconstruction" | "revision" | "job" | "batch" | "scanner" | "progress" | "again"} Kind */
/** @typedef {{is: "opening" | "live" | "cut" | "resting", since: Date}} State */
/** @typedef {{asks?: boolean, is?: "live" | "cut", again?: boolean, kind?: Kind, data?: any, last?: string}} Word  between pages */

const KINDS = /** @type {Kind[]} */ (["scan", "reconstruction", "revision", "job", "batch", "scanner", "progress"]);
const RETRY = 2000;
const NAME = "steradian.events"; // of the turn to listen, and of what the pages tell each other

class Live {
  constructor() {
    /** @type {State} */
    this.state = { is: "opening", since: new Date() };
    /** @type {EventSource | null} */
    this._source = null;
    this._last = "";
    /** @type {Map<string, Set<(data: any) => void>>} */
    this._ears = new Map();
    /** @type {Set<(state: State) => void>} */
    this._watchers = new Set();
    this._others = new BroadcastChannel(NAME);
    this._others.onmessage = ({ data }) => this._learn(data);
    /** @type {(() => void) | null} lets another page listen */
    this._yield = null;
    /** @type {AbortController | null} ends the wait for the turn */
    this._waits = null;
  }

  /**
   * Listen to a kind of event; "again" comes when all may have changed, and at once to who comes late: read what is
   * shown anew.
   * @param {Kind} kind @param {(data: any) => void} act
   * @returns {() => void} ends it
   */
  on(kind, act) {
    const ears = this._ears.get(kind) ?? new Set();
    this._ears.set(kind, ears.add(act));
    // the stream may have opened before the script of this view was there, which then waits for nothing
    if (kind === "again" && this.state.is !== "opening") queueMicrotask(() => act(null));
    return () => ears.delete(act);
  }

  /** Be told, now and later, whether the stream is up. @param {(state: State) => void} act */
  watch(act) {
    this._watchers.add(act);
    act(this.state);
  }

  /** Begin; a page that nobody sees leaves it to others to listen. */
  start() {
    const turn = () => (document.hidden ? this._rest() : this._join());
    document.addEventListener("visibilitychange", turn);
    turn();
  }

  /** Listen when it is this page's turn; hear from the one whose turn it is meanwhile. */
  _join() {
    if (this._yield || !navigator.locks) return this._open(); // no locks where the page came by plain HTTP from elsewhere
    if (this._waits) return;
    this._waits = new AbortController();
    const listen = () => new Promise((over) => {
      if (document.hidden) return over(null); // its turn came as it was left
      this._waits = null;
      this._yield = () => over(null);
      this._open();
    });
    navigator.locks.request(NAME, { signal: this._waits.signal }, listen).catch(() => null);
    this._others.postMessage({ asks: true });
  }

  _rest() {
    clearTimeout(this._timer);
    this._waits?.abort();
    this._source?.close();
    this._yield?.();
    this._source = this._waits = this._yield = null;
    this._become("resting");
  }

  /** @param {Word} word of the page that listens, or of one that has come and asks how it stands */
  _learn(word) {
    if (this._yield && word.asks && (this.state.is === "live" || this.state.is === "cut")) this._others.postMessage({ is: this.state.is, last: this._last });
    if (!this._waits || word.asks) return;
    this._last = word.last || this._last;
    if (word.kind) return this._tell(word.kind, word.data);
    const before = this.state.is;
    this._become(word.is ?? before);
    if (word.again || before !== this.state.is) this._tell("again", null);
  }

  /** @param {Word} word */
  _share(word) {
    if (this._yield) this._others.postMessage({ ...word, last: this._last });
  }

  _open() {
    clearTimeout(this._timer);
    this._source?.close();
    const query = new URLSearchParams();
    if (this._last) query.set("last_event_id", this._last);
    const source = (this._source = new EventSource(`${BASE}/events?${query}`));
    source.addEventListener("ready", (event) => this._begin(/** @type {MessageEvent} */ (event)));
    source.addEventListener("reset", (event) => this._begin(/** @type {MessageEvent} */ (event)));
    for (const kind of KINDS) source.addEventListener(kind, (event) => this._hear(kind, /** @type {MessageEvent} */ (event)));
    source.onmessage = (event) => (this._last = event.lastEventId || this._last);
    source.onerror = () => this._fail();
  }

  /** @param {MessageEvent} event */
  _begin(event) {
    this._last = event.lastEventId || this._last;
    this._become("live");
    this._tell("again", null);
    this._share({ is: "live", again: true });
  }

  /** @param {Kind} kind @param {MessageEvent} event */
  _hear(kind, event) {
    this._last = event.lastEventId || this._last;
    const data = JSON.parse(event.data);
    this._tell(kind, data);
    this._share({ kind, data });
  }

  /** Try again in a while, and have those who listen look for themselves meanwhile. */
  _fail() {
    this._source?.close();
    this._source = null;
    if (document.hidden) return;
    this._become("cut");
    this._tell("again", null);
    this._share({ is: "cut", again: true });
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this._open(), RETRY);
  }

  /** Somebody had no answer: a stream that has gone quiet may be gone, too, and is opened anew. */
  doubt() {
    if (this._source && this.state.is === "live") this._fail();
  }

  /** @param {State["is"]} is */
  _become(is) {
    if (this.state.is === is) return;
    this.state = { is, since: new Date() };
    document.body.dataset.live = is;
    for (const watcher of this._watchers) watcher(this.state);
  }

  /** @param {Kind} kind @param {any} data */
  _tell(kind, data) {
    for (const act of this._ears.get(kind) ?? []) act(data);
  }

  /** @type {ReturnType<typeof setTimeout> | undefined} */
  _timer;
}

export const live = new Live();
