// @ts-check
// Gallery of volumes with thumbnails.
import { api, request } from "../api.js";
import { byId, h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showEmpty, showError, showLoading } from "../panel_states.js";
import { formatTime, length } from "../units.js";
import { methodText, scanNames, soundSpeedText } from "../reconstructions/summary.js";
import { firstVoxelBelow, createSource } from "./volume_data.js";
import { paint, colourTable } from "./colours.js";

const THUMBNAIL_PIXELS = 256;
const MAX_LISTED = 200; // maximum page size of the service
const WHITE_LEVEL = 190; // of 255: value of full brightness
const panel = byId("volumes");
const search = h("input", { type: "search", placeholder: "Search: labels, method, identifier", "aria-label": "Search", dataset: { search: "" } });
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
  const note = h("p", { class: "dim small" }, `Maximum-intensity projections along z (line scans: sections), each with its own colour scale.${listedCount === MAX_LISTED ? ` The search covers the newest ${MAX_LISTED} volumes.` : ""}`);
  const grid = h("div", { class: "stack" }, matches.length ? [note, h("ul", { class: "gallery" }, matches.map(createCard))] : h("p", { class: "dim" }, "No volume matches the search."));
  if (panel.contains(search)) panel.lastElementChild?.replaceWith(grid);
  else replace(panel, h("header", null, search), grid);
}

/** @param {any} one */
function createCard(one) {
  const { shape, spacing_m: spacing } = one.report;
  const extent = shape.map((/** @type {number} */ count, /** @type {number} */ n) => length(count * spacing[n])).join(" × ");
  const axis = shape.length === 3 ? "z" : "y";
  return h("li", null, h("a", { href: `/volumes/${one.id}` },
    thumbnail(one, axis),
    h("strong", null, scanLabels.get(one.scan_id) || "no labels"), h("span", null, `created ${formatTime(one.ended ?? one.created)}`), h("span", null, [methodText(one), soundSpeedText(one)].filter(Boolean).join(", ")), h("span", { class: "dim" }, extent), h("span", { class: "dim" }, `${one.simulated ? "simulated, " : ""}scan ${one.scan_id.slice(-5)}, ${one.id.slice(-5)}`)));
}

/** Loads thumbnails when they become visible. */
const observer = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    observer.unobserve(target);
    void drawThumbnail(/** @type {HTMLCanvasElement} */ (target));
  }
}, { rootMargin: "200px" });

/** Return the first voxel along z below the near field. @param {any} one */
function firstVoxel(one) {
  const source = createSource(one);
  return source && !source.flat ? firstVoxelBelow(source, source.near) : 0;
}

/** Created thumbnails, reused by the search. @type {Map<string, HTMLElement>} */
const thumbnails = new Map();

/** @param {any} one @param {string} axis */
function thumbnail(one, axis) {
  const cached = thumbnails.get(one.id);
  if (cached) return cached;
  const canvas = h("canvas", { width: 1, height: 1, role: "img", "aria-label": `Maximum along ${axis}`, dataset: { of: one.id, axis, first: String(firstVoxel(one)) } });
  const element = h("span", { class: "thumb" }, canvas, h("span", null, "loading …"));
  thumbnails.set(one.id, element);
  observer.observe(canvas);
  return element;
}

/** Set the caption of a thumbnail; an empty text shows the image only. @param {HTMLCanvasElement} canvas @param {string} text */
function setCaption(canvas, text) {
  if (canvas.nextElementSibling) canvas.nextElementSibling.textContent = text;
}

/** Draw the projection of a volume. @param {HTMLCanvasElement} canvas */
async function drawThumbnail(canvas) {
  const { of, axis } = canvas.dataset;
  const slab = axis === "z" ? `&slab=${canvas.dataset.first}:` : ""; // without the near field, as in the volume view
  const query = `axis=${axis}&max_size=${THUMBNAIL_PIXELS}&dtype=uint8${slab}`;
  try {
    const answer = await request("GET", `/reconstructions/${of}/mip?${query}`, undefined, { accept: "application/octet-stream" });
    const shape = /** @type {[number, number]} */ ((answer.headers.get("X-Shape") ?? "").split(",").map(Number));
    const pixels = new ImageData(shape[0], shape[1]);
    const options = { up: axis === "z", out: new Uint32Array(pixels.data.buffer) };
    const values = new Uint8Array(await answer.arrayBuffer());
    paint({ values, shape }, [0, WHITE_LEVEL], colourTable("inferno"), options);
    Object.assign(canvas, { width: shape[0], height: shape[1] });
    canvas.getContext("2d")?.putImageData(pixels, 0, 0);
    setCaption(canvas, values.some((value) => value > 0) ? "" : "empty: no value above 0");
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
