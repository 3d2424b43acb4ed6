// @ts-check
// Choice of the points of interest of a stage: proposals to accept, or a place on the live image.
import { api } from "../api.js";
import { decimalInput, decimalOf, showDecimal } from "../decimal_input.js";
import { debounce, h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { figure, signed } from "../units.js";
import { readLease } from "./scanner_choice.js";
import { placeText, promiseName, promiseText } from "./stages.js";

/** @typedef {import("./stages.js").Place} Place */
/** @typedef {import("./stages.js").Proposal} Proposal */
/** @typedef {import("./stages.js").Stage} Stage */

const DEFAULT_DEPTH = 3e-3; // m, where neither a proposal nor the mask has one
const ESTIMATE_DELAY = 250;
const AXES = ["x", "y", "depth"];
const LASER = "(laser on)"; // what the action of a button does, at the end of its name

export class StageChoice {
  /** @param {import("./live_image.js").LiveImage} liveImage @param {() => void} chosen */
  constructor(liveImage, chosen) {
    this.liveImage = liveImage;
    this.chosen = chosen;
    /** @type {any} */
    this.scan = null;
    /** @type {Stage | null} */
    this.stage = null;
    /** @type {Place} */
    this.place = [0, 0, DEFAULT_DEPTH];
    this.shownKey = "";
    this.title = h("strong");
    this.explanation = h("span");
    this.proposals = h("div", { class: "scrolls" });
    this.inputs = AXES.map((axis, n) => decimalInput({ id: `place-${axis}`, "aria-describedby": "place-note", oninput: () => this.onTyped(n) }));
    this.note = h("p", { class: "dim small", id: "place-note" });
    this.messages = h("div", { class: "remarks", role: "alert" });
    this.consequence = h("strong", { id: "choice-consequence" });
    this.focusButton = h("button", { class: "primary", "aria-describedby": "choice-consequence" });
    this.form = h("form", { class: "row", onsubmit: (/** @type {Event} */ event) => this.submitPlace(event) },
      h("strong", null, "Place"),
      AXES.map((axis, n) => h("span", { class: "row tight-row" }, h("label", { for: `place-${axis}` }, axis), this.inputs[n], h("span", { class: "dim" }, "mm"))),
      this.focusButton);
    this.element = h("div", { class: "stage-choice", hidden: true, dataset: { steradian: "stage-choice" } }, h("p", { role: "status" }, this.title, " ", this.explanation, " ", this.consequence), this.proposals, this.form, this.note, this.messages);
    this.estimateDepthSoon = debounce(() => void this.estimateDepth(), ESTIMATE_DELAY);
    liveImage.markers.onPick = (picked) => this.onPicked(picked);
  }

  /** @param {any} scan @param {Stage} stage @param {{aperture: number, depth: number | null}} mask */
  show(scan, stage, mask) {
    this.scan = scan;
    this.stage = stage;
    const key = JSON.stringify([stage.number, stage.proposals, scan.state]);
    if (key === this.shownKey) return;
    this.shownKey = key;
    this.element.hidden = false;
    const isInterrupted = scan.state === "interrupted";
    this.title.textContent = isInterrupted ? "The scan is interrupted; its points of interest can be chosen." : "The laser is off: choose the point of interest.";
    const found = stage.proposals.length ? "Accept a proposal, or click another place on the image." : "Nothing in the image of the survey stands out of the noise; choose a place on the image or enter one.";
    this.explanation.textContent = found;
    this.consequence.textContent = isInterrupted ? "Then resume the scan." : "Accept and Focus here start the focus at once: the laser goes on.";
    this.focusButton.textContent = isInterrupted ? "Focus here" : `Focus here ${LASER}`;
    this.note.textContent = "On the image, a click or the arrow keys move the place.";
    replace(this.messages);
    replace(this.proposals, stage.proposals.length ? this.table(stage.proposals, isInterrupted ? "" : LASER) : null);
    const [first] = stage.proposals;
    this.liveImage.markers.aperture = mask.aperture;
    this.setPlace(first?.position ?? [0, 0, mask.depth ?? DEFAULT_DEPTH]);
  }

  hide() {
    this.shownKey = "";
    this.element.hidden = true;
    this.liveImage.markers.hideChoice();
  }

  /** @param {Proposal[]} proposals @param {string} ending of the buttons' names */
  table(proposals, ending) {
    const accept = (/** @type {number[]} */ numbers, /** @type {string} */ text, /** @type {string} */ name) => h("button", { type: "button", class: "nowrap", "aria-label": `${[text, ending].filter(Boolean).join(" ")}: ${name}`, "aria-describedby": "choice-consequence", onclick: () => void this.submit({ proposals: numbers }) }, [text, ending].filter(Boolean).join(" "));
    const all = proposals.map((_, n) => n + 1);
    return h("table", { dataset: { proposals: "" } },
      h("thead", null, h("tr", null, ["", "x (mm)", "y (mm)", "depth (mm)", "signal-to-noise"].map((name) => h("th", { scope: "col", class: "number" }, name || h("span", { class: "visually-hidden" }, "Proposal"))), h("th", { scope: "col", class: "number", title: "Full width at half maximum of the image of a small ball at this place, expected after the focus" }, promiseName(proposals)), h("th", { scope: "col" }, all.length > 1 ? accept(all, "Accept all", `${all.length} proposals`) : h("span", { class: "visually-hidden" }, "Accept")))),
      h("tbody", null, proposals.map((one, n) => h("tr", null,
        h("th", { scope: "row", class: "number" }, String(n + 1)), one.position.map((metres) => h("td", { class: "number" }, signed(metres * 1e3, 2))),
        h("td", { class: "number" }, figure(one.signal_to_noise, 2)), h("td", { class: "number" }, promiseText(one)),
        h("td", null, accept([n + 1], "Accept", `proposal ${n + 1}, ${placeText(one.position)}`))))));
  }

  /** @param {Place} place */
  setPlace(place) {
    this.place = place;
    this.inputs.forEach((input, n) => showDecimal(input, Number((place[n] * 1e3).toFixed(3))));
    this.liveImage.markers.showChoice(this.stage?.proposals.map(({ position }) => position) ?? [], place);
  }

  /** @param {number} n of the coordinate */
  onTyped(n) {
    const value = decimalOf(this.inputs[n]);
    if (!Number.isFinite(value)) return;
    const place = /** @type {Place} */ ([...this.place]);
    place[n] = Number((value * 1e-3).toPrecision(9));
    this.setPlace(place);
  }

  /** Move the place on the film; a proposal has its own depth. @param {[number, number] | Place} picked */
  onPicked([x, y, depth]) {
    this.setPlace([x, y, depth ?? this.place[2]]);
    if (depth === undefined) this.estimateDepthSoon();
    else this.note.textContent = "Place and depth of the proposal.";
  }

  /** Set the depth to that of the maximum at the place, if the live image shows it. */
  async estimateDepth() {
    const [x, y] = this.place;
    const depth = await this.liveImage.depthAt([x, y]);
    if (this.element.hidden || this.place[0] !== x || this.place[1] !== y) return;
    if (depth === null) this.note.textContent = "The depth there is not known; check the number.";
    else {
      this.setPlace([x, y, Number(depth.toFixed(6))]);
      this.note.textContent = "The depth is that of the maximum at this place, estimated from the projections along x and y.";
    }
  }

  /** @param {Event} event */
  submitPlace(event) {
    event.preventDefault();
    void this.submit({ points_of_interest: [this.place] });
  }

  /** @param {{proposals: number[]} | {points_of_interest: Place[]}} decision */
  async submit(decision) {
    const buttons = [...this.element.querySelectorAll("button")];
    buttons.forEach((button) => (button.disabled = true));
    replace(this.messages);
    try {
      const lease = await readLease(this.scan.scanner_id);
      const headers = lease ? { "Scanner-Lease": String(lease.fence) } : undefined;
      await api.put(`/scans/${this.scan.id}/stages/${this.stage?.number}`, decision, { headers });
      this.chosen();
    } catch (error) {
      replace(this.messages, ...errorElements(error));
    }
    buttons.forEach((button) => (button.disabled = false));
  }
}
