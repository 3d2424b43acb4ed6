// @ts-check
// Outcome of a design: its figures and pictures, dimmed while newer ones are computed and hidden if the form is refused.
import { h, replace } from "../dom.js";

const DIM_DELAY = 150; // ms without an answer after which the figures of the design before are dimmed
const FIRST_RETRY = 2000; // ms
const MAX_RETRY = 16_000;

/** @typedef {"current" | "stale" | "refused"} State */

export class Outcome {
  /** @param {HTMLElement} host element with the figures and pictures @param {HTMLElement} noteHost shows why there are none */
  constructor(host, noteHost) {
    this.host = host;
    this.note = h("div", { class: "state refusal", hidden: true });
    noteHost.append(this.note);
    this.dimTimer = 0;
  }

  /** Dim the figures if no answer comes soon. */
  wait() {
    if (this.host.dataset.outcome === "refused") return; // stays hidden until the service accepts the form
    clearTimeout(this.dimTimer);
    this.dimTimer = setTimeout(() => this.set("stale"), DIM_DELAY);
  }

  /** @param {State} state @param {string} [reason] of a refusal */
  set(state, reason = "") {
    clearTimeout(this.dimTimer);
    this.host.dataset.outcome = state;
    this.note.hidden = state !== "refused";
    replace(this.note, reason ? [h("strong", null, "No figures for this form"), h("span", null, reason)] : null);
  }
}

/** Repeats a request that failed for a reason other than its content, until it is answered. */
export class Retry {
  /** @param {() => void} act */
  constructor(act) {
    this.act = act;
    this.timer = 0;
    this.delay = FIRST_RETRY;
  }

  /** Schedule the next request. */
  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(this.act, this.delay);
    this.delay = Math.min(2 * this.delay, MAX_RETRY);
  }

  /** Forget a scheduled request, because a newer one is sent or one was answered. */
  reset() {
    clearTimeout(this.timer);
    this.delay = FIRST_RETRY;
  }
}
