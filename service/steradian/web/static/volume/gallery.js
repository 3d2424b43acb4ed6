// @ts-check
// Gallery of volumes with thumbnails.
import { api, request } from "../api.js";
import { byId, h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showEmpty, showError, showLoading } from "../panel_states.js";
import { formatDate, pressure, signed } from "../units.js";
import { methodText, scanNames, soundSpeedText } from "../reconstructions/summary.js";
import { volumeName } from "../reconstructions/volume_names.js";
import { wavelengthsOf } from "./series_player.js";
import { depthsText } from "./scale.js";
import { createSource, firstVoxelBelow, projectedDepths, rangeEnds } from "./volume_data.js";
import { drawProjection, numbersOf, readProjection, showScaleBar, WHITE_LEVEL } from "./projection_image.js";

const THUMBNAIL_PIXELS = 256;
const MAX_LISTED = 200; // maximum page size of the service
const MAX_SHOWN = 3; // volumes of a series
const panel = byId("volumes");
const search = h("input", { type: "search", placeholder: "Search: labels, method, identifier", "aria-label": "Search", dataset: { search: "" } });
const oneScale = h("input", { type: "checkbox", id: "one-scale", onchange: () => paintAll() });
const scaleText = h("span", { dataset: { scale: "" } });
/** @type {any[]} */
let items = [];
let listedCount = 0; // number of listed reconstructions
/** @type {Map<string, string>} */
let scanLabels = new Map();

async function load() {
  try {
    const [response, labels] = await Promise.all([api.get(`/reconstructions?state=succeeded&limit=${MAX_LISTED}`), scanNames()]);
    scanLabels = labels;
    listedCount = response.items.length;
    items = response.items.filter((/** @type {any} */ one) => one.report?.shape);
    if (!items.length) {
      showEmpty(panel, "No volumes yet", "Reconstruct a scan to create a volume.", h("a", { class: "button primary", href: "/reconstructions?scan" }, "Reconstruct a scan"));
      return;
    }
    show();
  } catch (error) {
    showError(panel, error, load);
  }
}

function show() {
  const searchText = search.value.trim().toLowerCase();
  const matches = items.filter((one) => [one.id, one.scan_id, scanLabels.get(one.scan_id), methodText(one), ...(one.report.notes ?? [])].join(" ").toLowerCase().includes(searchText));
  const note = h("p", { class: "dim small" }, "Maximum-intensity projections along z (line scans: sections). ", scaleText, `${listedCount === MAX_LISTED ? ` The search covers the newest ${MAX_LISTED} volumes.` : ""}`);
  const grid = h("div", { class: "stack" }, matches.length ? [note, h("ul", { class: "gallery" }, matches.map(createCard))] : h("p", { class: "dim" }, "No volume matches the search."));
  if (panel.contains(search)) panel.lastElementChild?.replaceWith(grid);
  else replace(panel, h("header", { class: "row" }, search, h("label", { class: "row nowrap" }, oneScale, "One colour scale")), grid);
  paintAll();
}

/** @param {any} one */
function createCard(one) {
  const { shape, spacing_m: spacing } = one.report;
  const extents = shape.slice(0, -1).map((/** @type {number} */ count, /** @type {number} */ n) => signed(1e3 * count * spacing[n], 1)).join(" × ");
  const axis = shape.length === 3 ? "z" : "y";
  return h("li", null, h("a", { href: `/volumes/${one.id}` },
    h("span", { class: "thumbs" }, shownIndices(one).map((index) => thumbnail(one, axis, index))),
    h("strong", null, scanLabels.get(one.scan_id) || "no labels"), h("span", null, `created ${formatDate(one.ended ?? one.created)}`), h("span", null, [methodText(one), soundSpeedText(one)].filter(Boolean).join(", ")), one.report.frames?.length ? h("span", { dataset: { shown: "" } }, shownIndices(one).map((index) => volumeName(one, index)).join(" | ")) : null, h("span", { class: "dim" }, `${extents} mm${depthsOf(one)}`), h("span", { class: "dim" }, `${one.simulated ? "simulated, " : ""}scan ${one.scan_id.slice(-5)}, ${one.id.slice(-5)}`)));
}

/** Describe the depths of a volume, and those that its projection covers. @param {any} one */
function depthsOf(one) {
  const source = createSource(one);
  if (!source) return "";
  const whole = depthsText(rangeEnds(source, "z", { from: 0, to: source.shape[2] }));
  const shown = depthsText(projectedDepths(source));
  return `, ${(source.flat || shown === whole ? [`z ${whole}`] : [`z ${whole}`, `maximum of ${shown}`]).map((text) => text.replaceAll(" ", "\u00a0")).join("; ")}`;
}

/** Values of the loaded thumbnails in bytes, with the values of 0 and 255. @type {Map<HTMLCanvasElement, {values: Uint8Array, shape: [number, number], window: [number, number], isMap: boolean}>} */
const loaded = new Map();

/** Paint a thumbnail: with its own colours, or over a range of values that is common to all of pressure. @param {HTMLCanvasElement} canvas @param {number | null} end */
function paintThumbnail(canvas, end) {
  const thumb = loaded.get(canvas);
  if (!thumb) return;
  const { values, shape, window: [low, high], isMap } = thumb;
  const inBytes = (/** @type {number} */ value) => (255 * (value - low)) / (high - low || 1);
  drawProjection(canvas, { values, shape }, canvas.dataset.axis, end === null || isMap ? [0, WHITE_LEVEL] : [inBytes(0), inBytes(end)]);
}

/** Value at the bright end of a thumbnail that has its own colours. @param {{window: [number, number]}} thumb */
const ownEnd = ({ window: [low, high] }) => low + (WHITE_LEVEL / 255) * (high - low);

/** Paint all loaded thumbnails; on request with one scale, whose end is that of the brightest. */
function paintAll() {
  const shown = [...loaded].filter(([canvas, { isMap }]) => panel.contains(canvas) && !isMap);
  const end = oneScale.checked && shown.length ? Math.max(...shown.map(([, thumb]) => ownEnd(thumb))) : null;
  scaleText.textContent = end === null ? "Each has its own colour scale." : `Colours from 0 to ${pressure(end)}, the brightest of those loaded.`;
  for (const canvas of loaded.keys()) paintThumbnail(canvas, end);
}

/** Loads thumbnails when they become visible. */
const observer = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    observer.unobserve(target);
    void drawThumbnail(/** @type {HTMLCanvasElement} */ (target));
  }
}, { rootMargin: "200px" });

/** Return the volumes of a series that the gallery shows: the first at each wavelength, at most three. @param {any} one @returns {number[]} */
function shownIndices(one) {
  const frames = one.report.frames ?? [];
  const lights = wavelengthsOf(frames).slice(0, MAX_SHOWN);
  return lights.length ? lights.map((light) => frames.findIndex((/** @type {any} */ frame) => frame.excitation_m === light)) : [0];
}

/** Return the first voxel along z below the near field. @param {any} one */
function firstVoxel(one) {
  const source = createSource(one);
  return source && !source.flat ? firstVoxelBelow(source, source.near) : 0;
}

/** Created thumbnails, reused by the search. @type {Map<string, HTMLElement>} */
const thumbnails = new Map();

/** @param {any} one @param {string} axis @param {number} index */
function thumbnail(one, axis, index) {
  const cached = thumbnails.get(`${one.id} ${index}`);
  if (cached) return cached;
  const canvas = h("canvas", { width: 1, height: 1, role: "img", "aria-label": [`Maximum along ${axis}`, volumeName(one, index)].filter(Boolean).join(", "), dataset: { of: one.id, axis, first: String(firstVoxel(one)), index: one.report.frames?.length ? String(index) : "", kind: one.kind } });
  const element = h("span", { class: "thumb" }, canvas, h("span", null, "loading …"), h("i", { class: "scale-bar", "aria-hidden": "true" }));
  thumbnails.set(`${one.id} ${index}`, element);
  observer.observe(canvas);
  return element;
}

/** Set the caption of a thumbnail; an empty text shows the image only. @param {HTMLCanvasElement} canvas @param {string} text */
function setCaption(canvas, text) {
  if (canvas.nextElementSibling) canvas.nextElementSibling.textContent = text;
}

/** Draw the projection of a volume. @param {HTMLCanvasElement} canvas */
async function drawThumbnail(canvas) {
  const { of, axis, index } = canvas.dataset;
  const slab = axis === "z" ? `&slab=${canvas.dataset.first}:` : ""; // without the near field, as in the volume view
  const query = `axis=${axis}&max_size=${THUMBNAIL_PIXELS}&dtype=uint8${slab}${index ? `&index=${index}` : ""}`;
  try {
    const answer = await request("GET", `/reconstructions/${of}/mip?${query}`, undefined, { accept: "application/octet-stream" });
    const window = /** @type {[number, number]} */ (numbersOf(answer.headers, "X-Window", "0,1"));
    const plane = await readProjection(answer);
    showScaleBar(/** @type {HTMLElement | null} */ (canvas.parentElement?.querySelector(".scale-bar")), answer.headers);
    loaded.set(canvas, { ...plane, window, isMap: canvas.dataset.kind === "unmixing" });
    if (oneScale.checked) paintAll(); // it may be the brightest
    else paintThumbnail(canvas, null);
    setCaption(canvas, plane.values.some((value) => value > 0) ? "" : "empty: no value above 0");
  } catch {
    setCaption(canvas, "image unavailable");
    canvas.setAttribute("aria-label", "Image unavailable");
  }
}

search.addEventListener("input", show);
showLoading(panel);
live.on("reconstruction", (entries) => entries.state === "succeeded" && void load());
live.on("again", () => void load());
void load();
