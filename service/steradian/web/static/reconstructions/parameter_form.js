// @ts-check
// Parameter form of a reconstruction, generated from the API's schema.
import { h, replace } from "../dom.js";
import { layerTable } from "./layers.js";
import { displayUnit, formatValue, valueAt, withValue } from "./schema.js";

/** @typedef {import("./schema.js").Field} Field */
/** @typedef {import("./schema.js").Group} Group */
/** @typedef {{field: Field, row: HTMLElement, read: () => any, write: (value: any) => void, fault: HTMLElement, control: HTMLElement}} Entry */

/** Basic fields; all others are collapsed. */
const BASIC_FIELDS = { plain: new Set(["method", "modes", "sound_speed", "depth_range", "upsampling"]), rest: "Layers, transforms, weights, frequencies" };

const MAX_HINT = 12; // characters of a placeholder

export class ParameterForm {
  /**
   * @param {Group[]} groups @param {any} values shown first
   * @param {any} origin against which changes are marked; null: the defaults
   * @param {{plain: Set<string>, rest: string}} layout basic fields, and the description of the others
   */
  constructor(groups, values, origin, layout = BASIC_FIELDS) {
    this.origin = origin ?? {};
    this.hasOrigin = origin !== null;
    /** @type {Entry[]} */
    this.entries = [];
    const [topGroup, ...inner] = groups;
    const plain = topGroup.fields.filter((field) => layout.plain.has(field.path[0]));
    const rest = topGroup.fields.filter((field) => !layout.plain.has(field.path[0]));
    this.element = h("div", { class: "parameters" },
      plain.length ? h("div", { class: "fields" }, plain.map((field) => this.row(field, values))) : null,
      this.foldedGroup("More", layout.rest, rest, values),
      ...inner.map((group) => this.foldedGroup(group.title, group.description, group.fields, values)));
    /** Explains the focused field; placed next to the buttons, so that the fields do not move. */
    this.help = h("p", { class: "dim small help", "aria-hidden": "true" });
    this.element.addEventListener("focusin", (event) => {
      const row = /** @type {Element} */ (event.target).closest(".field");
      this.help.textContent = row?.querySelector(".explained")?.textContent ?? "";
    });
    this.element.addEventListener("input", () => this.markChanges());
    this.markChanges();
  }

  /** @param {string} title @param {string} description @param {Field[]} fields @param {any} values */
  foldedGroup(title, description, fields, values) {
    const known = fields.filter((field) => field.kind !== "other");
    const changed = known.some((field) => isDifferent(field, valueAt(values, field.path) ?? field.default, field.default));
    return h("details", { open: changed, dataset: { group: title } },
      h("summary", null, h("strong", null, title), " ", h("span", { class: "dim" }, description)),
      h("div", { class: "fields" }, known.map((field) => this.row(field, values))));
  }

  /** @param {Field} field @param {any} values */
  row(field, values) {
    const id = `field-${field.path.join("-")}`;
    const { control, read, write } = createControl(field, id);
    const [unit] = displayUnit(field.unit);
    const fault = h("p", { class: "fault small", id: `${id}-fault`, hidden: true });
    const changeMark = h("span", { class: "changed", hidden: true });
    const explanation = [`${field.description || field.name}.`, rangeText(field), `Default: ${formatValue(field, field.default)}.`].filter(Boolean).join(" ");
    const row = h("div", { class: field.kind === "layers" ? "field whole" : "field", dataset: { field: field.path.join(".") } },
      h("label", { for: id }, field.name, changeMark), h("span", { class: "entry" }, control, unit ? h("span", { class: "dim" }, unit) : null),
      h("p", { class: "explained", id: `${id}-about`, hidden: true }, `${field.name}: ${explanation}`), fault);
    control.setAttribute("aria-describedby", `${id}-about ${id}-fault`);
    write(valueAt(values, field.path) ?? field.default);
    this.entries.push({ field, row, read, write, fault, control });
    return row;
  }

  /** Mark values that differ from the origin, or from the defaults without an origin. */
  markChanges() {
    for (const { field, row, read } of this.entries) {
      const before = this.hasOrigin ? valueAt(this.origin, field.path) ?? field.default : field.default;
      const changed = isDifferent(field, read(), before);
      const changeMark = /** @type {HTMLElement} */ (row.querySelector(".changed"));
      row.classList.toggle("is-changed", changed);
      changeMark.hidden = !changed;
      changeMark.textContent = `${this.hasOrigin ? "was" : "default"} ${formatValue(field, before)}`;
    }
  }

  /** Parameters in the format of the API, without defaults. */
  get values() {
    return this.entries.reduce((values, { field, read }) => {
      const value = read();
      return isDifferent(field, value, field.default) ? withValue(values, field.path, value) : values;
    }, /** @type {any} */ ({}));
  }

  /** Show each error at its field; return the errors without a field. @param {import("../api.js").FieldError[]} findings */
  showFieldErrors(findings) {
    for (const { fault, control } of this.entries) {
      fault.hidden = true;
      control.removeAttribute("aria-invalid");
    }
    /** @type {HTMLElement | null} */
    let first = null;
    const unassigned = findings.filter((finding) => {
      const parts = finding.pointer.replace(/^#?\//, "").split("/").filter((part) => part !== "parameters" && !/^[0-9]+$/.test(part));
      const entry = this.entries.find(({ field }) => field.path.join("/") === parts.slice(0, field.kind === "layers" ? field.path.length : undefined).join("/"));
      if (!entry) return true;
      entry.fault.hidden = false;
      replace(entry.fault, finding.detail || `allowed: ${finding.allowed}`);
      entry.control.setAttribute("aria-invalid", "true");
      /** @type {HTMLDetailsElement | null} */ (entry.row.closest("details"))?.setAttribute("open", "");
      first ??= entry.control;
      return false;
    });
    /** @type {HTMLElement | null} */ (first)?.focus();
    return unassigned;
  }
}

/** @param {Field} field @param {any} one @param {any} other */
function isDifferent(field, one, other) {
  if (typeof one === "number" && typeof other === "number") return Math.abs(one - other) > 1e-9 * Math.max(Math.abs(one), Math.abs(other));
  return JSON.stringify(one ?? null) !== JSON.stringify(other ?? null);
}

/** @param {Field} field */
function rangeText(field) {
  const [unit, factor] = displayUnit(field.unit);
  if (field.minimum === null && field.maximum === null) return "";
  const one = (/** @type {number | null} */ value) => (value === null ? "…" : Number((value * factor).toPrecision(6)));
  return `From ${one(field.minimum)} to ${one(field.maximum)}${unit ? ` ${unit}` : ""}.`;
}

/** @param {Field} field @param {string} id @returns {{control: HTMLElement, read: () => any, write: (value: any) => void}} */
function createControl(field, id) {
  if (field.kind === "boolean") {
    const input = h("input", { type: "checkbox", id });
    return { control: input, read: () => input.checked, write: (value) => (input.checked = Boolean(value)) };
  }
  if (field.kind === "choice") {
    const none = field.nullable ? [h("option", { value: "" }, "none")] : [];
    const select = h("select", { id }, ...none, field.choices.map((one) => h("option", { value: one }, one)));
    return { control: select, read: () => select.value || null, write: (value) => (select.value = value ?? "") };
  }
  if (field.kind === "choices") return checkboxGroup(field, id);
  if (field.kind === "layers") return layerTable(id);
  if (field.kind === "range") return rangeInput(field, id);
  if (field.kind === "numbers" || field.kind === "pairs") return listInput(field, id);
  if (field.kind === "text") {
    const input = h("input", { type: "text", id });
    return { control: input, read: () => input.value || null, write: (value) => (input.value = value ?? "") };
  }
  return numberInput(field, id);
}

/** @param {Field} field @param {string} id */
function checkboxGroup(field, id) {
  const boxes = field.choices.map((one) => h("input", { type: "checkbox", value: one }));
  const control = h("span", { id, role: "group", tabindex: -1, class: "row" }, boxes.map((box) => h("label", { class: "row" }, box, box.value)));
  return {
    control,
    read: () => boxes.filter((box) => box.checked).map((box) => box.value),
    write: (/** @type {string[]} */ value) => boxes.forEach((box) => (box.checked = (value ?? []).includes(box.value))),
  };
}

/** Return parser and formatter of numbers in display units; a keyword may replace a number. @param {Field} field */
function numberFormat(field) {
  const factor = displayUnit(field.unit)[1];
  return {
    read: (/** @type {string} */ text) => {
      const plain = text.trim();
      if (!plain || plain === "none") return null;
      if (field.words.includes(plain)) return plain;
      const value = Number(plain.replace(",", "."));
      return Number.isFinite(value) ? Number((value / factor).toPrecision(12)) : plain; // the API rejects text that is not a number
    },
    write: (/** @type {any} */ value) => (value === null || value === undefined ? "" : typeof value === "number" ? String(Number((value * factor).toPrecision(9))) : String(value)),
  };
}

/** Return what an empty field means, from the field's description: "none: the scan's, …". @param {Field} field */
function emptyMeaning({ description }) {
  const meaning = description.match(/\bnone: ([^,;(]+)/)?.[1].trim() ?? "none";
  return meaning.length > MAX_HINT ? "automatic" : meaning;
}

/** @param {Field} field @param {string} id */
function numberInput(field, id) {
  const { read, write } = numberFormat(field);
  const hint = field.nullable ? [emptyMeaning(field), ...field.words].join(", or ") : "";
  const input = h("input", { type: "text", inputmode: "decimal", id, placeholder: hint, class: "short-field" });
  return {
    control: input,
    read: () => read(input.value) ?? (field.nullable ? null : field.default),
    write: (/** @type {any} */ value) => (input.value = write(value)),
  };
}

/** Create an input of comma-separated numbers, or of pairs separated by semicolons. @param {Field} field @param {string} id */
function listInput(field, id) {
  const { read, write } = numberFormat(field);
  const ofPairs = field.kind === "pairs";
  const input = h("input", { type: "text", id, placeholder: ofPairs ? "x, y; x, y" : "none" });
  const numbers = (/** @type {string} */ text) => text.split(/[,\s]+/).filter(Boolean).map(read);
  const written = (/** @type {any} */ one) => (Array.isArray(one) ? one.map(write).join(", ") : write(one));
  return {
    control: input,
    read: () => (ofPairs ? input.value.split(";").map(numbers).filter((one) => one.length) : numbers(input.value)),
    write: (/** @type {any} */ value) => (input.value = (Array.isArray(value) ? value : []).map(written).join(ofPairs ? "; " : ", ")),
  };
}

/** @param {Field} field @param {string} id */
function rangeInput(field, id) {
  const { read, write } = numberFormat(field);
  const inputs = ["from", "to"].map((name, n) => h("input", { type: "text", inputmode: "decimal", "aria-label": `${field.name} ${name}`, placeholder: name, class: "half-field", id: n ? null : id }));
  const control = h("span", { class: "row nowrap" }, ...inputs);
  return {
    control,
    read: () => {
      const ends = inputs.map((input) => read(input.value));
      return field.nullable && ends.every((one) => one === null) ? null : ends;
    },
    write: (/** @type {any[] | null} */ value) => inputs.forEach((input, n) => (input.value = write(value?.[n] ?? null))),
  };
}

