// @ts-check
// How a scan stands, and what can be done: pause, resume, stop; and what a finished one offers.
import { api, onceOnly } from "../api.js";
import { h, openDialog, replace } from "../dom.js";
import { words } from "../panel_states.js";
import { count, duration, figure, identifierOf } from "../units.js";
import { startScan } from "./create.js";
import { leaseOf, WhichScanner } from "./scanner_choice.js";
import { keeps, OVER, STATES, WISHES } from "./states.js";
import { at } from "../urls.js";

const NAMES = /** @type {Record<string, string>} */ ({ paused: "Pause", running: "Resume", stopped: "Stop …" });
const WINDOW = 5000;

export class Controls {
  /** @param {HTMLElement} host @param {() => void} changed */
  constructor(host, changed) {
    this.changed = changed;
    this.state = h("div", { class: "row" });
    this.pace = h("span", { class: "dim", role: "status" });
    this.buttons = h("div", { class: "row", tabindex: -1, role: "group", "aria-label": "What can be done" });
    this.advice = h("p", { class: "dim caption" });
    this.said = h("div", { class: "remarks", role: "alert" });
    this.bar = h("progress", { max: 1, value: 0, "aria-label": "A-lines stored" });
    this.labels = h("span");
    host.append(h("div", { class: "row spread" }, this.state, this.bar, this.pace, this.buttons), h("div", { class: "row below" }, this.labels, this.advice), this.said);
    /** @type {any} */
    this.scan = null;
    this.drawn = "";
    this.stored = 0;
    this.total = 0;
    this.spare = 0;
    this.isAsking = false;
    /** @type {[number, number][]} when, how many */
    this.steps = [];
    /** @type {number | null} seconds, as the service told last */
    this.eta = null;
  }

  /** @param {any} scan @param {any} plan @param {any} coverage what the service counts, if there is anything to count */
  show(scan, plan, coverage) {
    this.scan = scan;
    if (coverage) {
      [this.total, this.stored] = [coverage.points, coverage.stored];
      const needed = (coverage.stored / Math.max(1, plan.beams.length)) * plan.averages;
      this.spare = OVER.has(scan.state) ? Math.max(0, coverage.fired - needed) : 0; // before, some are under way
    } else {
      this.total = scan.progress.total;
      this.stored = scan.summary?.stored ?? scan.progress.done;
    }
    if (scan.state !== "running") [this.steps, this.eta] = [[], null];
    this.count();
    const drawn = [scan.state, scan.desired_state, scan.error?.detail, JSON.stringify(scan.labels), scan.summary?.stored].join();
    if (drawn !== this.drawn) {
      this.drawn = drawn;
      this.build();
    }
  }

  /** @param {{done: number, total: number, eta: number | null}} event */
  advance({ done, total, eta }) {
    [this.stored, this.total] = [Math.max(this.stored, done), total];
    this.eta = eta ?? this.eta;
    this.count();
  }

  /** Say how many, how fast and how long. */
  count() {
    const now = performance.now();
    this.steps = [...this.steps.filter(([at]) => now - at < WINDOW), /** @type {[number, number]} */ ([now, this.stored])];
    const [[since, before]] = this.steps;
    const rate = now - since > 400 ? ((this.stored - before) * 1e3) / (now - since) : 0;
    const left = this.eta ?? (rate > 0 ? (this.total - this.stored) / rate : null);
    const parts = [`${count(this.stored)} of ${count(this.total)} A-lines`];
    if (this.spare) parts.push(`${count(this.spare)} shots without an A-line`);
    if (this.scan?.state === "running" && rate > 0) parts.push(`${figure(rate, 2)} a second`, ...(left ? [`${duration(left)} left`] : []));
    this.pace.textContent = parts.join(", ");
    this.bar.max = this.total || 1;
    this.bar.value = this.stored;
    const over = OVER.has(this.scan?.state);
    const advice = over || !WISHES[this.scan?.state] ? "" : keeps(this.stored, this.total);
    if (this.advice.textContent !== advice) this.advice.textContent = advice;
  }

  build() {
    const { scan } = this;
    const bad = ["failed", "interrupted"].includes(scan.state);
    const labels = Object.entries(scan.labels).map(([name, value]) => h("span", { class: "label" }, `${name}: ${value}`));
    replace(this.state, identifierOf(scan.id), h("strong", { class: bad ? "fault" : "" }, STATES[scan.state] ?? scan.state), scan.simulated ? h("span", { class: "dim" }, "simulated") : null);
    const completes = scan.completes ? h("span", { class: "dim" }, "completes ", h("a", { href: `/scans/${encodeURIComponent(scan.completes)}` }, `${scan.completes.slice(0, 5)}…${scan.completes.slice(-5)}`)) : null;
    replace(this.labels, labels, completes);
    const wishes = (WISHES[scan.state] ?? []).filter((wish) => wish !== scan.desired_state || scan.state === "interrupted");
    const held = this.buttons.contains(document.activeElement) ? document.activeElement : null;
    replace(this.buttons, wishes.map((wish) => h("button", { type: "button", onclick: () => (wish === "stopped" ? this.confirm() : void this.wish(wish)) }, scan.state === "interrupted" && wish === "running" ? "Go on" : NAMES[wish])),
      OVER.has(scan.state) ? this.offers() : null);
    const same = [...this.buttons.querySelectorAll("button")].find((one) => one.textContent === held?.textContent && held !== this.buttons);
    if (held) (same ?? this.buttons).focus(); // else the place: another button would be pressed by a key that is held down
    replace(this.said, scan.error ? h("p", { class: "fault" }, scan.error.detail) : null, scan.reason && OVER.has(scan.state) ? h("p", { class: "dim" }, scan.reason) : null);
  }

  /** What can follow a scan that is over and of which no image was made. @returns {Node[]} */
  nextSteps() {
    if (!this.scan?.summary?.stored) return [h("a", { class: "button", href: "/design" }, "New design")];
    return [h("button", { type: "button", class: "primary", onclick: () => void this.reconstruct() }, "Reconstruct the image")];
  }

  /** What can follow a scan that is over. @returns {Node[]} */
  offers() {
    const { stored, points } = this.scan.summary ?? {};
    if (!stored) return [h("a", { class: "button", href: "/design" }, "New design")];
    return [
      h("button", { type: "button", class: "primary", onclick: () => void this.reconstruct() }, "Reconstruct"),
      ...(stored < points ? [h("button", { type: "button", onclick: () => void this.confirmMissing() }, "Measure the missing points …")] : []),
      h("button", { type: "button", onclick: () => void this.chooseMask() }, "Through another mask …"),
      h("a", { class: "button", href: `/api/v1/scans/${this.scan.id}/file`, download: `${this.scan.id}.h5` }, "Download HDF5"),
    ];
  }

  /** @param {any} [more] */
  async reconstruct(more = {}) {
    if (this.isAsking) return; // it was pressed twice
    this.isAsking = true;
    try {
      const made = await api.post("/reconstructions", { scan_id: this.scan.id, ...more }, { headers: onceOnly() });
      location.assign(at(`/reconstructions/${made.id}`));
    } catch (error) {
      replace(this.said, ...words(error));
      this.isAsking = false;
    }
  }

  async chooseMask() {
    try {
      const masks = (await api.get("/masks?limit=50")).items.filter((/** @type {any} */ one) => one.id !== this.scan.mask_id);
      const select = h("select", { id: "other-mask" }, masks.map((/** @type {any} */ one) => h("option", { value: one.id }, `${one.arrangement.arrangement ?? "mask"}, ${count(one.count)} points (${one.id.slice(0, 7)}…)`)));
      const body = masks.length ? [h("label", { for: "other-mask" }, "Mask"), select] : [h("p", null, "There is no other mask yet: design one, or make it by the API.")];
      ask("Look through another mask", "The scan as if only that mask's points had been measured.", body, masks.length ? "Reconstruct" : "", () => void this.reconstruct({ through: { mask_id: select.value } }));
    } catch (error) {
      replace(this.said, ...words(error));
    }
  }

  /** Its scanner goes on with it; where that one is no more, a person says which. */
  async confirmMissing() {
    const { stored, points } = this.scan.summary;
    const which = new WhichScanner();
    try {
      const { items } = await api.get("/scanners");
      const own = items.find((/** @type {any} */ one) => one.id === this.scan.scanner_id);
      which.show(own ? [own] : items);
    } catch (error) {
      replace(this.said, ...words(error));
      return;
    }
    const text = `A new scan begins with these ${count(stored)} A-lines and measures the other ${count(points - stored)}, if film and scanner prove to be as they were. This one stays as it is. The laser fires.`;
    ask("Measure the missing points", text, [which.host], "Measure", () => void this.complete(which));
  }

  /** Have a new scan measure what this one misses. @param {WhichScanner} which */
  async complete(which) {
    try {
      const { id, plan_id, labels } = this.scan;
      const made = await startScan({ plan_id, labels, completes: id, ...which.wish });
      location.assign(at(`/scans/${made.id}`));
    } catch (error) {
      replace(this.said, ...words(error));
    }
  }

  confirm() {
    ask("Stop the scan", keeps(this.stored, this.total), [], "Stop and keep", () => void this.wish("stopped"));
  }

  /** @param {string} state */
  async wish(state) {
    try {
      const lease = state === "running" ? await leaseOf(this.scan.scanner_id) : null;
      const headers = lease ? { "Scanner-Lease": String(lease.fence) } : undefined;
      await api.put(`/scans/${this.scan.id}/desired-state`, { state, reason: "asked for on the page" }, { headers });
      this.changed();
    } catch (error) {
      replace(this.said, ...words(error));
    }
  }
}

/** @param {string} title @param {string} text @param {Node[]} body @param {string} name of what is done, none: nothing @param {() => void} act */
function ask(title, text, body, name, act) {
  const dialog = h("dialog", { "aria-labelledby": "ask-title" }, h("form", { method: "dialog" },
    h("h2", { id: "ask-title" }, title), h("p", null, text), ...body,
    h("menu", null, h("button", { value: "" }, "Cancel"), name ? h("button", { class: "primary", value: "yes" }, name) : null)));
  dialog.addEventListener("close", () => dialog.returnValue === "yes" && act());
  openDialog(dialog);
}
