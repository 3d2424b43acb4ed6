// @ts-check
// The form at the left: a slider and a number for each field, and under it what the service finds wrong with it.
import { h, replace } from "../dom.js";
import { words } from "../panel_states.js";
import { addPoint, ARRANGEMENTS, fieldsOfPoint, furtherPoints, inSi, maskField, MOST_POINTS, PLAN, removePoint } from "./fields.js";
import { moreForm } from "./advanced_fields.js";
import { tuningField } from "./tuning_map.js";

/** @typedef {import("./fields.js").Design} Design */
/** @typedef {import("./fields.js").Field} Field */
/** @typedef {{name: string, text: string, severity: "error" | "warning"}} Remark */

const STEPS = 1000; // of a slider that goes by powers

export class Form {
  /**
   * @param {HTMLElement} host
   * @param {Design} design changed in place
   * @param {() => void} changed
   */
  constructor(host, design, changed) {
    this.host = host;
    this.design = design;
    this.changed = changed;
    /** @type {Map<string, HTMLElement>} by field of the API: where remarks go */
    this.places = new Map();
    /** @type {(() => void)[]} */
    this.refreshers = [];
    this.rest = h("div", { class: "remarks", role: "alert" });
    this.more = h("div", { class: "more" });
    /** Explains the field in there that has the focus. */
    this.help = h("p", { class: "help" });
    /** @type {Map<string, HTMLElement>} places of remarks in there */
    this.morePlaces = new Map();
    this.tuning = tuningField(design, changed);
    this.morePlaces.set("tuning_map", this.tuning.remarks);
    this.build();
    void this.open();
  }

  /** Add the fields that are made from what the API says of a plan. */
  async open() {
    try {
      const form = await moreForm(this.design.more);
      for (const { field, row, control } of form.entries) {
        const remarks = h("div", { class: "remarks", id: `remarks-${field.path.join("-")}` });
        control.setAttribute("aria-describedby", `${control.getAttribute("aria-describedby")} ${remarks.id}`);
        row.append(remarks);
        this.morePlaces.set(field.path.join("."), remarks);
      }
      form.element.addEventListener("input", () => {
        this.design.more = form.values;
        this.changed();
      });
      replace(this.more, form.element);
      this.help.replaceWith(form.help);
      this.register();
    } catch (error) {
      replace(this.more, ...words(error));
    }
  }

  register() {
    for (const [name, remarks] of this.morePlaces) this.places.set(name, remarks);
  }

  build() {
    this.places.clear();
    this.refreshers = [];
    const { design } = this;
    const kind = h("select", { id: "arrangement", onchange: () => this.choose(kind.value) },
      Object.entries(ARRANGEMENTS).map(([value, { label }]) => h("option", { value, selected: value === design.arrangement }, label)));
    const place = h("div", { class: "remarks" });
    this.places.set("arrangement", place);
    replace(this.host,
      h("fieldset", null, h("legend", null, "Mask"),
        h("div", { class: "field" }, h("label", { for: "arrangement" }, "Arrangement"), kind, place),
        ARRANGEMENTS[design.arrangement].fields.map((key) => this.row(maskField(key), design.mask, key)),
        furtherPoints(design).map((number) => this.point(number)),
        design.arrangement === "combined" ? h("button", { type: "button", id: "add-point", disabled: design.points >= MOST_POINTS, onclick: () => this.alter(() => addPoint(design)) }, "Add a point of interest") : null),
      h("fieldset", null, h("legend", null, "Plan"), PLAN.map((one) => this.row(one, design.plan, one.name)), this.tuning.element, this.more),
      this.rest);
    this.register();
  }

  /** A further point of interest. @param {number} number from 2 */
  point(number) {
    const remove = h("button", { type: "button", class: "quiet", disabled: this.design.points <= 2, "aria-label": `Remove point ${number}`, onclick: () => this.alter(() => removePoint(this.design, number)) }, "remove");
    return h("div", { class: "point", role: "group", "aria-label": `Point ${number}` },
      h("div", { class: "row spread" }, h("strong", null, `Point ${number}`), remove),
      fieldsOfPoint(number).map((key) => this.row(maskField(key), this.design.mask, key)));
  }

  /** @param {() => void} change of how many points there are */
  alter(change) {
    change();
    this.build();
    this.changed();
    this.host.querySelector("#add-point")?.scrollIntoView({ block: "nearest" });
    /** @type {HTMLElement | null} */ (this.host.querySelector("#add-point"))?.focus();
  }

  /** @param {string} arrangement */
  choose(arrangement) {
    this.design.arrangement = arrangement;
    this.build();
    this.changed();
    this.host.querySelector("select")?.focus();
  }

  /** Show values that were changed elsewhere. */
  refresh() {
    for (const refresh of this.refreshers) refresh();
  }

  /**
   * @param {Field} field @param {Record<string, number | string>} values @param {string} key
   * @returns {HTMLElement}
   */
  row(field, values, key) {
    const remarks = h("div", { class: "remarks", id: `remarks-${key}` });
    this.places.set(/^[xy]/.test(key) ? key.replace("x", "offset") : field.name, remarks);
    const label = h("label", { for: `field-${key}`, title: field.help }, field.label);
    if (field.choices) {
      const select = h("select", { id: `field-${key}`, title: field.help, onchange: () => this.set(values, key, select.value) },
        field.choices.map(([value, text]) => h("option", { value, selected: value === values[key] }, text)));
      return h("div", { class: "field" }, label, select, remarks);
    }
    const number = h("input", { type: "number", id: `field-${key}`, step: "any", title: field.help, "aria-describedby": remarks.id });
    const slider = h("input", { type: "range", "aria-label": field.label, ...rangeOf(field) });
    const show = () => {
      const value = Number(values[key]) / field.scale;
      if (document.activeElement !== number) number.value = String(Number(value.toPrecision(7)));
      slider.value = String(toSlider(field, value));
      slider.setAttribute("aria-valuetext", `${Number(value.toPrecision(4))} ${field.unit}`);
    };
    number.addEventListener("input", () => {
      if (number.value !== "") this.set(values, key, inSi(field, Number(number.value)));
      show();
    });
    number.addEventListener("blur", show);
    slider.addEventListener("input", () => {
      this.set(values, key, inSi(field, fromSlider(field, Number(slider.value))));
      show();
    });
    this.refreshers.push(show);
    show();
    return h("div", { class: "field" }, label, h("span", { class: "with-unit" }, number, h("span", { class: "dim" }, field.unit)), slider, remarks);
  }

  /** @param {Record<string, number | string>} values @param {string} key @param {number | string} value */
  set(values, key, value) {
    values[key] = value;
    this.changed();
  }

  /**
   * Put remarks beside the fields they concern, those of none at the end.
   * @param {Remark[]} remarks
   * @returns {{label: string, text: string, show: () => void} | null} the first fault, which may be out of sight
   */
  remark(remarks) {
    for (const [name, place] of this.places) {
      const own = remarks.filter((one) => one.name === name);
      replace(place, own.map((one) => h("p", { class: one.severity === "error" ? "fault" : "warning" }, one.text)));
      const input = place.parentElement?.querySelector("input:not([type=range]), select");
      input?.toggleAttribute("data-remarked", own.length > 0);
      if (own.some((one) => one.severity === "error")) input?.setAttribute("aria-invalid", "true");
      else input?.removeAttribute("aria-invalid");
    }
    const others = remarks.filter((one) => !this.places.has(one.name));
    replace(this.rest, others.map((one) => h("p", { class: one.severity === "error" ? "fault" : "warning" }, one.text)));
    const fault = remarks.find((one) => one.severity === "error");
    if (!fault) return null;
    const field = this.places.get(fault.name)?.parentElement;
    const show = () => {
      field?.closest("details")?.setAttribute("open", "");
      (field ?? this.rest).scrollIntoView({ block: "center" });
      /** @type {HTMLElement | null | undefined} */ (field?.querySelector("input, select"))?.focus();
    };
    return { label: field?.querySelector("label")?.firstChild?.textContent ?? "", text: fault.text, show };
  }
}

/** @param {Field} field */
function rangeOf(field) {
  return field.log ? { min: 0, max: STEPS, step: 1 } : { min: field.from, max: field.to, step: field.step };
}

/** @param {Field} field @param {number} value */
function toSlider(field, value) {
  return field.log ? (STEPS * Math.log(value / field.from)) / Math.log(field.to / field.from) : value;
}

/** @param {Field} field @param {number} place */
function fromSlider(field, place) {
  if (!field.log) return place;
  const value = field.from * (field.to / field.from) ** (place / STEPS);
  const digits = Number(value.toPrecision(2));
  return Math.max(field.from, Math.round(digits / field.step) * field.step);
}
