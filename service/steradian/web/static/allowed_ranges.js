// @ts-check
// Allowed ranges of the service's errors, converted from SI units to the unit of a form field.

/** Numbers of a range; a number that counts something ("2 linewidths") is not a quantity. */
const NUMBER = /(?<![\w.])\d[\d.]*(?:e[-+]?\d+)?(?![\w.]| (?!to\b|on\b)[a-zπ])/g;

/** Limit of a number in the field's SI unit, which the constraints of the API's schema do not name. */
const BARE_LIMIT = /^(allowed: )?[<>]=? [\d.e-]+$/;

/**
 * Convert a range to other units: "at most 0.0002 (m)" becomes "at most 200 µm", and "> 0.0" of a length "> 0 mm".
 * @param {string} allowed range with its SI unit in parentheses
 * @param {Record<string, [number, string]>} units factor and name of the unit that replaces an SI unit
 */
export function convertRange(allowed, units) {
  const convert = (/** @type {string} */ range, /** @type {[number, string]} */ [factor, name]) => `${range.replace(NUMBER, (number) => String(Number((Number(number) * factor).toPrecision(6))))} ${name}`;
  const [only] = Object.values(units);
  if (only && BARE_LIMIT.test(allowed)) return convert(allowed, only);
  return allowed.replace(/^(.*?) ?\((m|s|Hz)\)/, (whole, range, unit) => (units[unit] ? convert(range, units[unit]) : whole));
}
