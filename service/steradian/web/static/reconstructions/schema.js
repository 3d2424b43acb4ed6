// @ts-check
// Form fields derived from the OpenAPI document: kind, unit, limits, default and description.
import { api } from "../api.js";
import { layersText } from "./layers.js";

/**
 * @typedef {{
 *   path: string[], name: string, description: string, unit: string, kind: "number" | "integer" | "boolean" | "choice"
 *   | "choices" | "range" | "numbers" | "pairs" | "layers" | "text" | "other", nullable: boolean, default: any, minimum: number | null,
 *   maximum: number | null, choices: string[], words: string[],
 * }} Field  words: keywords that may replace a number
 * @typedef {{path: string[], title: string, description: string, fields: Field[]}} Group
 */

/** @type {Promise<any> | null} */
let documentPromise = null;

/** Load the OpenAPI document once. */
export function apiDocument() {
  documentPromise ??= api.get("/openapi.json").catch((error) => {
    documentPromise = null;
    throw error;
  });
  return documentPromise;
}

/** Return the groups of fields of a schema: its own fields first, then one group for each object. @param {string} name @returns {Promise<Group[]>} */
export async function parameterGroups(name) {
  const { components: { schemas } } = await apiDocument();
  return groupsOfSchema(schemas, schemas[name], [], displayName(name), "");
}

/** @param {any} schemas @param {any} schema @param {string[]} path @param {string} title @param {string} description @returns {Group[]} */
export function groupsOfSchema(schemas, schema, path, title, description) {
  const ownGroup = /** @type {Group} */ ({ path, title, description, fields: [] });
  const inner = [];
  for (const [name, one] of Object.entries(schema.properties ?? {})) {
    const target = resolveReference(schemas, one);
    if (target.properties) inner.push(...groupsOfSchema(schemas, target, [...path, name], displayName(name), (one.description ?? target.description ?? "").split("\n")[0]));
    else ownGroup.fields.push(createField([...path, name], one, target));
  }
  return [ownGroup, ...inner];
}

/** @param {any} schemas @param {any} schema */
function resolveReference(schemas, schema) {
  const name = schema.$ref?.split("/").pop();
  return name ? schemas[name] : schema;
}

/** @param {string[]} path @param {any} property @param {any} schema @returns {Field} */
function createField(path, property, schema) {
  const options = schema.anyOf ?? [schema];
  const alternatives = options.filter((/** @type {any} */ one) => one.type !== "null");
  const main = alternatives.find((/** @type {any} */ one) => ["number", "integer", "array", "boolean"].includes(one.type)) ?? alternatives[0] ?? {};
  const words = alternatives.flatMap((/** @type {any} */ one) => (one === main ? [] : one.const ? [one.const] : one.enum ?? []));
  return {
    path, name: displayName(path[path.length - 1]), description: property.description ?? "", unit: property["x-unit"] ?? "",
    kind: fieldKind(main), nullable: options.length > alternatives.length, default: property.default ?? null,
    minimum: main.minimum ?? main.exclusiveMinimum ?? null, maximum: main.maximum ?? main.exclusiveMaximum ?? null,
    choices: main.enum ?? main.items?.enum ?? [], words,
  };
}

/** @param {any} schema @returns {Field["kind"]} */
function fieldKind(schema) {
  if (schema.enum) return "choice";
  if (schema.type === "array") {
    if (schema.items?.enum) return "choices";
    if (schema.items?.$ref?.endsWith("/LayerParameters")) return "layers";
    const kinds = (schema.items?.anyOf ?? [schema.items ?? {}]).map((/** @type {any} */ one) => one.type);
    const consistsOf = (/** @type {string[]} */ ...kindsAllowed) => kinds.every((/** @type {string} */ kind) => kindsAllowed.includes(kind));
    if (schema.maxItems === 2 && consistsOf("number", "integer", "null")) return "range";
    if (consistsOf("number", "integer")) return "numbers";
    return consistsOf("array") && schema.items.maxItems === 2 && fieldKind(schema.items) === "range" ? "pairs" : "other";
  }
  if (schema.type === "number" || schema.type === "integer" || schema.type === "boolean") return schema.type;
  return schema.type === "string" ? "text" : "other";
}

/** Convert an API name to words. @param {string} name */
const displayWords = (name) => name.replaceAll("_", " ").replace(/\bsound speed\b/, "speed of sound").replace(/ db per mm$/, " (dB/mm)").replace(/ db$/, " (dB)");

/** Return the display name of a path. @param {string[]} path */
export const displayPath = (path) => path.map(displayWords).join(", ");

/** Return the display name of a field: sound_speed becomes Speed of sound. @param {string} name */
export function displayName(name) {
  const text = displayWords(name);
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Return the display unit of an SI unit and the conversion factor. @param {string} unit @returns {[string, number]} */
export function displayUnit(unit) {
  return /** @type {Record<string, [string, number]>} */ ({ m: ["mm", 1e3], nm: ["nm", 1e9], "nm/s": ["nm/s", 1e9], ns: ["ns", 1e9], ms: ["ms", 1e3], "pulses/s": ["Hz", 1], "edges/s": ["Hz", 1], s: ["µs", 1e6], Hz: ["MHz", 1e-6], relative: ["", 1], modes: ["", 1], times: ["×", 1] })[unit] ?? [unit, 1];
}

/** @param {any} values @param {string[]} path */
export function valueAt(values, path) {
  return path.reduce((inner, name) => inner?.[name], values) ?? null;
}

/** Return a copy of the values with one value replaced. @param {any} values @param {string[]} path @param {any} value @returns {any} */
export function withValue(values, [first, ...alternatives], value) {
  const inner = alternatives.length ? withValue(values?.[first] ?? {}, alternatives, value) : value;
  return { ...values, [first]: inner };
}

/** Format a value with its unit. @param {Field} field @param {any} value */
export function formatValue(field, value) {
  if (field.kind === "layers") return value ? layersText(value) : "none";
  const [unit, factor] = displayUnit(field.unit);
  const one = (/** @type {any} */ item) => item === null || item === undefined ? "none" : field.kind === "pairs" ? `(${item.map((/** @type {number} */ number) => Number((number * factor).toPrecision(9))).join(", ")})` : typeof item === "number" ? String(Number((item * factor).toPrecision(9))).replace("-", "−") : typeof item === "object" ? JSON.stringify(item) : String(item);
  const text = Array.isArray(value) ? (value.length ? value.map(one).join(field.kind === "range" ? " to " : ", ") : "none") : one(value);
  return unit && text !== "none" && /[0-9]/.test(text) ? `${text} ${unit}` : text;
}

/** Return the fields whose values differ between sets of parameters. @param {Group[]} groups @param {any[]} sets */
export function differences(groups, sets) {
  return groups.flatMap((group) => group.fields).filter((field) => {
    const serialized = sets.map((values) => JSON.stringify(valueAt(values, field.path) ?? field.default));
    return serialized.some((one) => one !== serialized[0]);
  });
}
