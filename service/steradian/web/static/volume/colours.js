// @ts-check
/** Colour maps: tables of 256 colours, and images painted with them.
 *
 * A table is a Uint32Array of pixels, 256 or more,
 * in the format of canvases and textures: red in the lowest byte, opaque.
 *
 * @typedef {"inferno" | "grey" | "grey-reversed" | "cividis" | "coolwarm" | "difference" | "depth" | Hue} MapName
 * @typedef {"red" | "green" | "blue" | "cyan" | "magenta" | "yellow"} Hue
 * @typedef {[number, number, number]} Colour  red, green, blue, 0 to 255
 */

/** Equidistant colours with linear interpolation, within 4/255 of the service's colour maps. */
const KNOTS = {
  inferno:
    "0000030303120a0724150b37210c4a2e0a5b3c09654a0b6b57106e63146f70196e7d1e6d89226a962766a32b62af315cbb3755" +
    "c63d4dd14545db4f3ce45932eb6528f1711ef67f14f98d09fb9c05fcab0ffbba1ff9ca32f5d949f2e865f2f586fcffa5",
  cividis:
    "00234e00285b002e6b0433721c386f273e6e32436d3b496c434e6c4b546c52596d5a5f6e61646f686a716f70737576767c7b78" +
    "8481798b8778938d789b9376a39a75aba072b3a670bbad6dc3b469ccba64d4c15fddc958e6d051efd748f9df3bffe734",
  coolwarm:
    "3b4cc0445acc4e68d85875e16282ea6c8ff1779af782a6fb8db0fe98b9ffa3c2feaec9fcb9d0f9c3d5f4ccd9edd5dbe5" +
    "dddcdce5d8d1ecd3c5f1ccb8f5c4acf7ba9ff7b093f6a586f4987af08b6eeb7d62e46e56dd5f4bd44e41ca3b37be242eb40426",
};

/** Maps from black to one colour, whose sum shows two volumes at once. @type {Record<Hue, Colour>} */
const HUES = { red: [255, 0, 0], green: [0, 255, 0], blue: [0, 0, 255], cyan: [0, 255, 255], magenta: [255, 0, 255], yellow: [255, 255, 0] };

/** Names of the selectable colour maps; depth has a special meaning. */
export const MAP_LABELS = /** @type {Record<string, string>} */ ({
  inferno: "Inferno", grey: "Grey", "grey-reversed": "Grey, reversed", cividis: "Cividis", coolwarm: "Blue–white–red (signed)",
  red: "Red", green: "Green", blue: "Blue", cyan: "Cyan", magenta: "Magenta", yellow: "Yellow", depth: "Depth as colour",
});

/** Selectable colour maps. */
export const PRESSURE_MAPS = Object.keys(MAP_LABELS);

/** Colour maps of a volume laid over another: black at zero, which adds nothing. */
export const OVERLAY_MAPS = ["cyan", "magenta", "yellow", "red", "green", "blue", "grey", "inferno"];

/** Whether the middle of a colour map is zero. @param {string} name */
export const isDiverging = (name) => name === "coolwarm" || name === "difference";

/** @type {Map<MapName, Uint32Array>} */
const tables = new Map();

/** Return the table of a colour map; computed once.
 *
 * @param {MapName} name
 */
export function colourTable(name) {
  const cached = tables.get(name);
  if (cached) return cached;
  const colours = Array.from({ length: 256 }, (_, n) => colourOf(name, n / 255));
  const pixels = Uint32Array.from(colours, toPixel);
  tables.set(name, pixels);
  return pixels;
}

/** @param {MapName} name  @param {number} share  @returns {Colour} */
function colourOf(name, share) {
  if (name === "grey") return [255 * share, 255 * share, 255 * share];
  if (name === "grey-reversed") return [255 * (1 - share), 255 * (1 - share), 255 * (1 - share)];
  if (name in HUES) return /** @type {Colour} */ (HUES[/** @type {Hue} */ (name)].map((one) => one * share));
  if (name === "depth") return oklab(0.78, 0.15, 45 + 205 * share);
  if (name === "difference") return differenceColour(2 * share - 1);
  const knots = KNOTS[/** @type {keyof typeof KNOTS} */ (name)];
  const place = share * (knots.length / 6 - 1);
  const first = Math.min(Math.floor(place), knots.length / 6 - 2);
  const at = (/** @type {number} */ knot, /** @type {number} */ channel) =>
    parseInt(knots.slice(6 * knot + 2 * channel, 6 * knot + 2 * channel + 2), 16);
  const mixed = [0, 1, 2].map((c) => at(first, c) + (place - first) * (at(first + 1, c) - at(first, c)));
  return /** @type {Colour} */ (mixed);
}

/** Return a colour of the difference map: blue below, orange above, dark at zero; safe for colour-blind readers.
 *
 * @param {number} signed  −1 to 1
 */
function differenceColour(signed) {
  const size = Math.abs(signed);
  return oklab(0.82 * size, 0.14 * Math.min(1, 1.2 * size), signed < 0 ? 250 : 60);
}

/** Convert Oklab (B. Ottosson, 2020) to sRGB.
 *
 * @param {number} lightness  0 to 1
 * @param {number} chroma
 * @param {number} hue  degrees
 * @returns {Colour}
 */
function oklab(lightness, chroma, hue) {
  const a = chroma * Math.cos((hue * Math.PI) / 180);
  const b = chroma * Math.sin((hue * Math.PI) / 180);
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return /** @type {Colour} */ (linear.map((light) => {
    const shown = Math.min(Math.max(light, 0), 1);
    return 255 * (shown <= 0.0031308 ? 12.92 * shown : 1.055 * shown ** (1 / 2.4) - 0.055);
  }));
}

/** @param {Colour} colour */
function toPixel([red, green, blue]) {
  return ((255 << 24) | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;
}

/** Paint a colour bar over a range of values; values outside the window have the end colours.
 *
 * @param {Uint32Array} colours
 * @param {[number, number]} range  values at the outer edges of the first and the last pixel
 * @param {[number, number]} window  values at the table's ends
 * @param {Uint32Array} out  pixels
 */
export function paintRamp(colours, [from, to], window, out) {
  const values = Float64Array.from(out, (_, n) => from + ((n + 0.5) / out.length) * (to - from));
  paint({ values, shape: [out.length, 1] }, window, colours, { out });
}

/** Paint an image (na × nb) into pixels nb rows high and na wide: the first axis is horizontal, the second vertical.
 *
 * @param {{values: ArrayLike<number>, shape: [number, number]}} plane
 * @param {[number, number]} window  values at the table's ends
 * @param {Uint32Array} colours
 * @param {{up?: boolean, out: Uint32Array}} how  up: the second axis points up
 */
export function paint({ values, shape: [na, nb] }, [low, high], colours, { up = false, out }) {
  const last = colours.length - 1;
  const scale = high > low ? last / (high - low) : 0;
  for (let i = 0; i < na; i++) {
    for (let j = 0; j < nb; j++) {
      const share = Math.min(Math.max((values[i * nb + j] - low) * scale, 0), last);
      out[(up ? nb - 1 - j : j) * na + i] = colours[share | 0];
    }
  }
}

/** Paint depths as hues and values as brightness; see {@link paint}.
 *
 * @param {{values: ArrayLike<number>, shape: [number, number]}} plane
 * @param {(i: number, j: number) => number} depth  0 to 1, of a voxel of the plane
 * @param {[number, number]} window
 * @param {{up?: boolean, out: Uint32Array, transfer?: (share: number) => number}} how  transfer: from share of the window to brightness
 */
export function paintDepths({ values, shape: [na, nb] }, depth, [low, high], { up = false, out, transfer = (share) => share }) {
  const hues = colourTable("depth");
  const scale = high > low ? 1 / (high - low) : 0;
  for (let i = 0; i < na; i++) {
    for (let j = 0; j < nb; j++) {
      const share = transfer(Math.min(Math.max((values[i * nb + j] - low) * scale, 0), 1));
      const hue = hues[Math.min(Math.max(Math.round(255 * depth(i, j)), 0), 255)];
      const dimmed = [hue & 255, (hue >> 8) & 255, (hue >> 16) & 255].map((channel) => channel * share);
      out[(up ? nb - 1 - j : j) * na + i] = toPixel(/** @type {Colour} */ (dimmed));
    }
  }
}
