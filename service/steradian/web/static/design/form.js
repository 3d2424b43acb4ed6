// @ts-check
// Design form: a slider and a number for each field, with the service's errors below the field.
import { decimalInput, decimalOf, showDecimal } from "../decimal_input.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { convertRange } from "../allowed_ranges.js";
import { decimalText } from "../units.js";
import { displayUnit } from "../reconstructions/schema.js";
import { changeArrangement, resizeGrid } from "./arrangement_change.js";
import { addPoint, ARRANGEMENTS, fieldsOfPoint, furtherPoints, toSi, maskField, MAX_POINTS, PLAN_FIELDS, removePoint } from "./fields.js";
import { endsEarly, shownStageFields, STAGE_CHOICES } from "./stage_fields.js";
import { advancedForm } from "./advanced_fields.js";
import { tuningField } from "./tuning_map.js";

/** @typedef {import("./fields.js").Design} Design */
/** @typedef {import("./fields.js").Field} Field */
/** @typedef {{name: string, text: string, severity: "error" | "warning"}} Remark */

const SLIDER_STEPS = 1000; // steps of a logarithmic slider

export class DesignForm {
  /**
   * @param {HTMLElement} host
   * @param {Design} design changed in place
   * @param {() => void} changed
   */
  constructor(host, design, changed) {
    this.host = host;
    this.design = design;
    this.changed = changed;
    /** @type {Map<string, HTMLElement>} hosts of remarks by field of the API */
    this.remarkHosts = new Map();
    /** @type {Map<string, Record<string, [number, string]>>} units of fields by field of the API, as the factors and names of SI units */
    this.units = new Map();
    /** @type {(() => void)[]} */
    this.refreshers = [];
    this.otherRemarks = h("div", { class: "remarks", role: "alert" });
    this.advanced = h("div", { class: "more" });
    /** Explains the focused field. */
    this.help = h("p", { class: "help" });
    /** @type {Map<string, HTMLElement>} hosts of remarks in the advanced fields */
    this.advancedRemarkHosts = new Map();
    this.tuning = tuningField(design, changed);
    this.advancedRemarkHosts.set("tuning_map", this.tuning.remarks);
    this.build();
    void this.loadAdvanced();
  }

  /** Load the advanced fields from the API's schema. */
  async loadAdvanced() {
    try {
      const form = await advancedForm(this.design.more);
      for (const { field, row, control } of form.entries) {
        const remarks = h("div", { class: "remarks", id: `remarks-${field.path.join("-")}` });
        control.setAttribute("aria-describedby", `${control.getAttribute("aria-describedby")} ${remarks.id}`);
        row.append(remarks);
        this.advancedRemarkHosts.set(field.path.join("."), remarks);
        const [unit, factor] = displayUnit(field.unit);
        this.units.set(field.path.join("."), siUnits(unit, factor));
      }
      form.element.addEventListener("input", () => {
        this.design.more = form.values;
        this.changed();
      });
      replace(this.advanced, form.element);
      this.help.replaceWith(form.help);
      this.registerAdvanced();
    } catch (error) {
      replace(this.advanced, ...errorElements(error));
    }
  }

  registerAdvanced() {
    for (const [name, remarks] of this.advancedRemarkHosts) this.remarkHosts.set(name, remarks);
  }

  build() {
    this.remarkHosts.clear();
    this.refreshers = [];
    const { design } = this;
    const kind = h("select", { id: "arrangement", onchange: () => this.chooseArrangement(kind.value) },
      Object.entries(ARRANGEMENTS).map(([value, { label }]) => h("option", { value, selected: value === design.arrangement }, label)));
    const host = h("div", { class: "remarks" });
    this.remarkHosts.set("arrangement", host);
    replace(this.host,
      h("fieldset", null, h("legend", null, "Mask"),
        h("div", { class: "field" }, h("label", { for: "arrangement" }, "Arrangement"), kind, host),
        ARRANGEMENTS[design.arrangement].fields.map((key) => this.row(maskField(key), design.mask, key)),
        furtherPoints(design).map((number) => this.point(number)),
        design.arrangement === "combined" ? h("button", { type: "button", id: "add-point", disabled: design.points >= MAX_POINTS, onclick: () => this.changePoints(() => addPoint(design)) }, "Add a point of interest") : null),
      h("fieldset", null, h("legend", null, "Plan"), PLAN_FIELDS.map((one) => this.row(one, design.plan, one.name)),
        shownStageFields(design.stages).map((one) => this.row(one, design.stages, one.key)), this.tuning.element, this.advanced),
      this.otherRemarks);
    this.registerAdvanced();
  }

  /** Create the fields of a further point of interest. @param {number} number from 2 */
  point(number) {
    const remove = h("button", { type: "button", class: "quiet", disabled: this.design.points <= 2, "aria-label": `Remove point ${number}`, onclick: () => this.changePoints(() => removePoint(this.design, number)) }, "remove");
    return h("div", { class: "point", role: "group", "aria-label": `Point ${number}` },
      h("div", { class: "row spread" }, h("strong", null, `Point ${number}`), remove),
      fieldsOfPoint(number).map((key) => this.row(maskField(key), this.design.mask, key)));
  }

  /** @param {() => void} change of how many points there are */
  changePoints(change) {
    change();
    this.build();
    this.changed();
    this.host.querySelector("#add-point")?.scrollIntoView({ block: "nearest" });
    /** @type {HTMLElement | null} */ (this.host.querySelector("#add-point"))?.focus();
  }

  /** @param {string} arrangement */
  chooseArrangement(arrangement) {
    changeArrangement(this.design, arrangement);
    this.build();
    this.changed();
    this.host.querySelector("select")?.focus();
  }

  /** Show values that changed outside the form. */
  refresh() {
    for (const refresh of this.refreshers) refresh();
  }

  /**
   * @param {Field} field @param {Record<string, number | string>} values @param {string} key
   * @returns {HTMLElement}
   */
  row(field, values, key) {
    const remarks = h("div", { class: "remarks", id: `remarks-${key}` });
    const name = /^[xy]/.test(key) ? key.replace("x", "offset") : field.name;
    this.remarkHosts.set(name, remarks);
    this.units.set(name, siUnits(field.unit, 1 / field.scale));
    const label = h("label", { for: `field-${key}`, title: field.help }, field.label);
    if (field.choices) {
      const select = h("select", { id: `field-${key}`, title: field.help, onchange: () => this.set(values, key, select.value) },
        field.choices.map(([value, text]) => h("option", { value, selected: value === values[key] }, text)));
      return h("div", { class: "field" }, label, select, remarks);
    }
    const number = decimalInput({ id: `field-${key}`, title: field.help, "aria-describedby": remarks.id });
    const slider = h("input", { type: "range", "aria-label": field.label, ...rangeOf(field) });
    const show = () => {
      const value = Number(values[key]) / field.scale;
      showDecimal(number, value);
      slider.value = String(toSlider(field, value));
      slider.setAttribute("aria-valuetext", `${decimalText(value, 4)} ${field.unit}`);
    };
    number.addEventListener("input", () => {
      if (Number.isFinite(decimalOf(number))) this.set(values, key, toSi(field, decimalOf(number)));
      show();
    });
    number.addEventListener("blur", show);
    slider.addEventListener("input", () => {
      this.set(values, key, toSi(field, fromSlider(field, Number(slider.value))));
      show();
    });
    this.refreshers.push(show);
    show();
    return h("div", { class: "field" }, label, h("span", { class: "with-unit" }, number, h("span", { class: "dim" }, field.unit)), slider, remarks);
  }

  /** @param {Record<string, number | string>} values @param {string} key @param {number | string} value */
  set(values, key, value) {
    if (this.design.arrangement === "grid" && values === this.design.mask && (key === "aperture" || key === "side")) {
      resizeGrid(this.design.mask, key, Number(value));
      this.refresh();
    } else values[key] = value;
    if (STAGE_CHOICES.has(key)) {
      if (key === "stopping" && endsEarly(this.design.stages)) this.design.plan.order = "progressive"; // the only order in which each part is an even mask
      this.build();
      /** @type {HTMLElement | null} */ (this.host.querySelector(`#field-${key}`))?.focus();
    }
    this.changed();
  }

  /**
   * Show remarks below their fields, and unassigned remarks at the end.
   * @param {Remark[]} remarks
   * @returns {{label: string, text: string, show: () => void} | null} the first fault, which may be out of sight
   */
  remark(remarks) {
    remarks = remarks.map((one) => ({ ...one, text: convertRange(one.text, this.units.get(one.name) ?? {}) }));
    for (const [name, host] of this.remarkHosts) {
      const fieldRemarks = remarks.filter((one) => one.name === name);
      replace(host, fieldRemarks.map((one) => h("p", { class: one.severity === "error" ? "fault" : "warning" }, one.text)));
      const input = host.parentElement?.querySelector("input:not([type=range]), select");
      input?.toggleAttribute("data-remarked", fieldRemarks.length > 0);
      if (fieldRemarks.some((one) => one.severity === "error")) input?.setAttribute("aria-invalid", "true");
      else input?.removeAttribute("aria-invalid");
    }
    const unassigned = remarks.filter((one) => !this.remarkHosts.has(one.name));
    replace(this.otherRemarks, unassigned.map((one) => h("p", { class: one.severity === "error" ? "fault" : "warning" }, one.text)));
    const fault = remarks.find((one) => one.severity === "error");
    if (!fault) return null;
    const field = this.remarkHosts.get(fault.name)?.parentElement;
    const show = () => {
      field?.closest("details")?.setAttribute("open", "");
      (field ?? this.otherRemarks).scrollIntoView({ block: "center" });
      /** @type {HTMLElement | null | undefined} */ (field?.querySelector("input, select"))?.focus();
    };
    return { label: field?.querySelector("label")?.firstChild?.textContent ?? "", text: fault.text, show };
  }
}

/** Return the factor and the name of a field's unit by the SI unit that it replaces. @param {string} unit @param {number} factor @returns {Record<string, [number, string]>} */
function siUnits(unit, factor) {
  const si = unit.endsWith("Hz") ? "Hz" : unit.endsWith("m") ? "m" : unit.endsWith("s") ? "s" : "";
  return si && !unit.includes("/") ? { [si]: [factor, unit] } : {};
}

/** @param {Field} field */
function rangeOf(field) {
  return field.log ? { min: 0, max: SLIDER_STEPS, step: 1 } : { min: field.from, max: field.to, step: field.step };
}

/** @param {Field} field @param {number} value */
function toSlider(field, value) {
  return field.log ? (SLIDER_STEPS * Math.log(value / field.from)) / Math.log(field.to / field.from) : value;
}

/** @param {Field} field @param {number} position */
function fromSlider(field, position) {
  if (!field.log) return position;
  const value = field.from * (field.to / field.from) ** (position / SLIDER_STEPS);
  const digits = Number(value.toPrecision(2));
  return Math.max(field.from, Math.round(digits / field.step) * field.step);
}
