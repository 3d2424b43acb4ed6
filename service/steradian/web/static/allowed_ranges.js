// @ts-check
// Allowed ranges of the service's errors, converted from SI units to the unit of a form field.

/** Numbers of a range; a number that counts something ("2 linewidths") is not a quantity. */
const NUMBER = /(?<![\w.])\d[\d.]*(?:e[-+]?\d+)?(?![\w.]| (?!to\b|on\b)[a-zπ])/g;

/**
 * Convert a range to other units: "at most 0.0002 (m)" becomes "at most 200 µm".
 * @param {string} allowed range with its SI unit in parentheses
 * @param {Record<string, [number, string]>} units factor and name of the unit that replaces an SI unit
 */
export function convertRange(allowed, units) {
  return allowed.replace(/^(.*?) ?\((m|s|Hz)\)/, (whole, range, unit) => {
    if (!units[unit]) return whole;
    const [factor, name] = units[unit];
    return `${range.replace(NUMBER, (/** @type {string} */ number) => String(Number((Number(number) * factor).toPrecision(6))))} ${name}`;
  });
}
