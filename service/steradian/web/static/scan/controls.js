// @ts-check
// State and actions of a scan: pause, resume, stop; reconstruction and download after its end.
import { api, idempotencyHeaders } from "../api.js";
import { h, openDialog, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { count, duration, figure, formatDate, identifierElement } from "../units.js";
import { iterativeButton } from "../reconstructions/iterative_beside.js";
import { startScan } from "./create.js";
import { readLease, ScannerChoice } from "./scanner_choice.js";
import { pointsToCome, stateLabel } from "./stages.js";
import { stopSummary, FINAL_STATES, TRANSITIONS } from "./states.js";
import { openUndersampling } from "./undersampling.js";
import { urlOf } from "../urls.js";

const ACTION_LABELS = /** @type {Record<string, string>} */ ({ paused: "Pause", running: "Resume", stopped: "Stop …" });
const RATE_WINDOW = 5000;

export class Controls {
  /** @param {HTMLElement} host @param {() => void} changed */
  constructor(host, changed) {
    this.changed = changed;
    this.state = h("div", { class: "row" });
    this.pace = h("span", { class: "dim", role: "status" });
    this.buttons = h("div", { class: "row", tabindex: -1, role: "group", "aria-label": "Actions" });
    this.advice = h("p", { class: "dim caption" });
    this.messages = h("div", { class: "remarks", role: "alert" });
    this.bar = h("progress", { max: 1, value: 0, "aria-label": "A-lines stored" });
    this.labels = h("span");
    this.below = h("div", { class: "row below" }, this.labels, this.advice);
    host.append(h("div", { class: "row spread" }, this.state, this.bar, this.pace, this.buttons), this.below, this.messages);
    /** @type {any} */
    this.scan = null;
    /** @type {any} */
    this.plan = null;
    this.renderedKey = "";
    this.stored = 0;
    this.total = 0;
    this.unusedShots = 0;
    this.toCome = 0;
    this.isSubmitting = false;
    this.isSeries = false; // several frames or wavelengths
    /** @type {[number, number][]} time and stored A-lines */
    this.history = [];
    /** @type {number | null} seconds, as last reported by the service */
    this.eta = null;
  }

  /** @param {any} scan @param {any} plan @param {any} coverage counts of the service, if available */
  show(scan, plan, coverage) {
    this.scan = scan;
    this.plan = plan;
    this.isSeries = plan.frames * Math.max(1, plan.excitation.length) > 1;
    if (coverage) {
      [this.total, this.stored] = [coverage.points, coverage.stored];
      const needed = (coverage.stored / Math.max(1, plan.beams.length)) * plan.averages;
      this.unusedShots = FINAL_STATES.has(scan.state) ? Math.max(0, coverage.fired - needed) : 0; // during the scan, some shots are still in transfer
    } else {
      this.total = scan.progress.total;
      this.stored = scan.summary?.stored ?? scan.progress.done;
    }
    this.toCome = pointsToCome(scan);
    if (scan.state !== "running") [this.history, this.eta] = [[], null];
    this.showCount();
    const key = [stateLabel(scan), scan.desired_state, scan.error?.detail, JSON.stringify(scan.labels), scan.summary?.stored].join();
    if (key !== this.renderedKey) {
      this.renderedKey = key;
      this.render();
    }
  }

  /** @param {{done: number, total: number, eta: number | null}} event */
  updateProgress({ done, total, eta }) {
    [this.stored, this.total] = [Math.max(this.stored, done), total];
    this.eta = eta ?? this.eta;
    this.showCount();
  }

  /** Show progress, rate and remaining time. */
  showCount() {
    const now = performance.now();
    this.history = [...this.history.filter(([at]) => now - at < RATE_WINDOW), /** @type {[number, number]} */ ([now, this.stored])];
    const [[firstTime, firstStored]] = this.history;
    const recent = now - firstTime > 400 ? ((this.stored - firstStored) * 1e3) / (now - firstTime) : 0;
    const left = this.eta ?? (recent > 0 ? (this.total - this.stored) / recent : null);
    const rate = left ? (this.total - this.stored) / left : recent; // what the time left is based on
    const isWhole = FINAL_STATES.has(this.scan?.state) && this.stored === this.total;
    const parts = [`${isWhole ? "" : `${count(this.stored)} of `}${count(this.total)} A-lines`, ...(this.toCome ? [`then up to ${count(this.toCome)} points of the focus`] : [])];
    if (this.unusedShots) parts.push(`${count(this.unusedShots)} shots without an A-line`);
    if (this.scan?.state === "running" && rate > 0) parts.push(`${figure(rate, 2)} per second`, ...(left ? [`${duration(left)} left`] : []));
    this.bar.max = this.total || 1;
    this.bar.value = this.stored;
    const over = FINAL_STATES.has(this.scan?.state);
    this.bar.hidden = over && isWhole;
    if (over && this.pace.parentElement !== this.below) this.below.prepend(this.pace); // beside the labels, where there are more actions
    if (over && this.scan.started) parts.push(`measured ${formatDate(this.scan.started)}${this.scan.ended ? ` in ${duration(secondsBetween(this.scan.started, this.scan.ended))}${isWhole ? this.plannedText() : ""}` : ""}`);
    this.pace.textContent = parts.join(", ");
    const advice = over || !TRANSITIONS[this.scan?.state] ? "" : stopSummary(this.stored, this.total, this.toCome);
    if (this.advice.textContent !== advice) this.advice.textContent = advice;
  }

  /** Return the planned duration of a scan of one stage. */
  plannedText() {
    const seconds = this.scan.stages ? null : this.plan?.preview?.total_seconds;
    return seconds ? ` (planned: ${duration(seconds)})` : "";
  }

  render() {
    const { scan } = this;
    const bad = ["failed", "interrupted"].includes(scan.state);
    const labels = Object.entries(scan.labels).map(([name, value]) => h("span", { class: "label" }, `${name}: ${value}`));
    replace(this.state, identifierElement(scan.id), h("strong", { class: bad ? "fault" : "" }, stateLabel(scan)), scan.simulated ? h("span", { class: "dim" }, "simulated") : null);
    const completes = scan.completes ? h("span", { class: "dim" }, "completes ", h("a", { href: `/scans/${encodeURIComponent(scan.completes)}` }, `${scan.completes.slice(0, 5)}…${scan.completes.slice(-5)}`)) : null;
    replace(this.labels, labels, completes);
    const transitions = (TRANSITIONS[scan.state] ?? []).filter((state) => state !== scan.desired_state || scan.state === "interrupted");
    const focused = this.buttons.contains(document.activeElement) ? document.activeElement : null;
    replace(this.buttons, transitions.map((state) => h("button", { type: "button", onclick: () => (state === "stopped" ? this.confirmStop() : void this.requestState(state)) }, ACTION_LABELS[state])),
      FINAL_STATES.has(scan.state) ? this.finishedActions() : null);
    const sameButton = [...this.buttons.querySelectorAll("button")].find((one) => one.textContent === focused?.textContent && focused !== this.buttons);
    if (focused) (sameButton ?? this.buttons).focus(); // focus the group, because a held key would otherwise press another button
    replace(this.messages, scan.error ? h("p", { class: "fault" }, scan.error.detail) : null, scan.reason && FINAL_STATES.has(scan.state) ? h("p", { class: "dim" }, scan.reason) : null);
  }

  /** Return the actions for a finished scan without an image. @returns {Node[]} */
  imageActions() {
    if (!this.scan?.summary?.stored) return [h("a", { class: "button", href: "/design" }, "New design")];
    return [h("button", { type: "button", class: "primary", onclick: () => void this.submit({ scan_id: this.scan.id }) }, "Reconstruct the image")];
  }

  /** Return the actions for a finished scan. @returns {Node[]} */
  finishedActions() {
    const { stored, points } = this.scan.summary ?? {};
    if (!stored) return [h("a", { class: "button", href: "/design" }, "New design")];
    return [
      h("button", { type: "button", class: "primary", onclick: () => void this.submit({ scan_id: this.scan.id }) }, "Reconstruct"),
      iterativeButton(this.scan.id, this.messages, { followed: !this.isSeries }),
      ...(stored < points ? [h("button", { type: "button", onclick: () => void this.confirmMissing() }, "Measure the missing points …")] : []),
      h("button", { type: "button", onclick: () => void this.chooseMask() }, "Undersample with another mask …"),
      h("a", { class: "button", href: `/api/v1/scans/${this.scan.id}/file`, download: `${this.scan.id}.h5` }, "Download HDF5"),
    ];
  }

  /** Submit a reconstruction and open its page. @param {any} request */
  async submit(request) {
    if (this.isSubmitting) return; // double click
    this.isSubmitting = true;
    try {
      const created = await api.post("/reconstructions", request, { headers: idempotencyHeaders() });
      location.assign(urlOf(`/reconstructions/${created.id}`));
    } catch (error) {
      replace(this.messages, ...errorElements(error));
      this.isSubmitting = false;
    }
  }

  async chooseMask() {
    try {
      await openUndersampling(this.scan, (request) => void this.submit(request));
    } catch (error) {
      replace(this.messages, ...errorElements(error));
    }
  }

  /** Ask for confirmation; use the scanner of this scan, or let the user select one if it no longer exists. */
  async confirmMissing() {
    const { stored, points } = this.scan.summary;
    const scannerChoice = new ScannerChoice();
    try {
      const { items } = await api.get("/scanners");
      const ownScanner = items.find((/** @type {any} */ one) => one.id === this.scan.scanner_id);
      scannerChoice.show(ownScanner ? [ownScanner] : items);
    } catch (error) {
      replace(this.messages, ...errorElements(error));
      return;
    }
    const text = `A new scan starts with these ${count(stored)} A-lines and measures the other ${count(points - stored)}, if the checks find film and scanner unchanged. This scan is not modified. The laser fires.`;
    openConfirmDialog("Measure the missing points", text, [scannerChoice.host], "Measure", () => void this.startCompletion(scannerChoice));
  }

  /** Create a scan that measures the missing points of this one. @param {ScannerChoice} scannerChoice */
  async startCompletion(scannerChoice) {
    try {
      const { id, plan_id, labels } = this.scan;
      const created = await startScan({ plan_id, labels, completes: id, ...scannerChoice.request });
      location.assign(urlOf(`/scans/${created.id}`));
    } catch (error) {
      replace(this.messages, ...errorElements(error));
    }
  }

  confirmStop() {
    openConfirmDialog("Stop the scan", stopSummary(this.stored, this.total, this.toCome), [], "Stop and keep the data", () => void this.requestState("stopped"));
  }

  /** @param {string} state */
  async requestState(state) {
    try {
      const lease = state === "running" ? await readLease(this.scan.scanner_id) : null;
      const headers = lease ? { "Scanner-Lease": String(lease.fence) } : undefined;
      await api.put(`/scans/${this.scan.id}/desired-state`, { state, reason: "requested on the web page" }, { headers });
      this.changed();
    } catch (error) {
      replace(this.messages, ...errorElements(error));
    }
  }
}

/** @param {string} from @param {string} to */
const secondsBetween = (from, to) => (new Date(to).getTime() - new Date(from).getTime()) / 1e3;

/** @param {string} title @param {string} text @param {Node[]} body @param {string} name label of the action; empty: no action @param {() => void} act */
function openConfirmDialog(title, text, body, name, act) {
  const dialog = h("dialog", { "aria-labelledby": "ask-title" }, h("form", { method: "dialog" },
    h("h2", { id: "ask-title" }, title), h("p", null, text), ...body,
    h("menu", null, h("button", { value: "" }, "Cancel"), name ? h("button", { class: "primary", value: "yes" }, name) : null)));
  dialog.addEventListener("close", () => dialog.returnValue === "yes" && act());
  openDialog(dialog);
}
