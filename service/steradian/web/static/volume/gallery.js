// @ts-check
// Volumes: what has been reconstructed, as pictures to choose from.
import { api, ask } from "../api.js";
import { byId, h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { empty, failed, loading } from "../panel_states.js";
import { clock, length } from "../units.js";
import { methodOf, namesOfScans, speedOf } from "../reconstructions/summary.js";
import { firstBelow, sourceOf } from "./volume_data.js";
import { paint, table } from "./colours.js";

const PIXELS = 256;
const MOST = 200; // that the service lists at once
const BRIGHTEST = 190; // of 255: what is brighter is shown as bright as that
const panel = byId("volumes");
const search = h("input", { type: "search", placeholder: "Search: labels, method, identifier", "aria-label": "Search", dataset: { search: "" } });
/** @type {any[]} */
let items = [];
let page = 0; // how many the service listed
/** @type {Map<string, string>} */
let names = new Map();

async function load() {
  try {
    const [found, known] = await Promise.all([api.get(`/reconstructions?state=succeeded&limit=${MOST}`), namesOfScans()]);
    names = known;
    page = found.items.length;
    items = found.items.filter((/** @type {any} */ one) => one.report?.shape);
    if (!items.length) {
      empty(panel, "There is no volume yet", "Reconstruct a scan, and it will be here.", h("a", { class: "button primary", href: "/reconstructions?scan" }, "Reconstruct a scan"));
      return;
    }
    show();
  } catch (error) {
    failed(panel, error, load);
  }
}

function show() {
  const wanted = search.value.trim().toLowerCase();
  const some = items.filter((one) => [one.id, one.scan_id, names.get(one.scan_id), methodOf(one), ...(one.report.notes ?? [])].join(" ").toLowerCase().includes(wanted));
  const told = h("p", { class: "dim small" }, `Maxima along z (sections of lines), each with its own scale.${page === MOST ? ` The newest ${MOST} are searched.` : ""}`);
  const grid = h("div", { class: "stack" }, some.length ? [told, h("ul", { class: "gallery" }, some.map(card))] : h("p", { class: "dim" }, "Nothing has all of this."));
  if (panel.contains(search)) panel.lastElementChild?.replaceWith(grid);
  else replace(panel, h("header", null, search), grid);
}

/** @param {any} one */
function card(one) {
  const { shape, spacing_m: spacing } = one.report;
  const extent = shape.map((/** @type {number} */ count, /** @type {number} */ n) => length(count * spacing[n])).join(" × ");
  const axis = shape.length === 3 ? "z" : "y";
  return h("li", null, h("a", { href: `/volumes/${one.id}` },
    picture(one, axis),
    h("strong", null, names.get(one.scan_id) || "without labels"), h("span", null, `made ${clock(one.ended ?? one.created)}`), h("span", null, [methodOf(one), speedOf(one)].filter(Boolean).join(", ")), h("span", { class: "dim" }, extent), h("span", { class: "dim" }, `${one.simulated ? "simulated, " : ""}scan ${one.scan_id.slice(-5)}, ${one.id.slice(-5)}`)));
}

/** Pictures are read when they come into sight. */
const watcher = new IntersectionObserver((seen) => {
  for (const { target, isIntersecting } of seen) {
    if (!isIntersecting) continue;
    watcher.unobserve(target);
    void fill(/** @type {HTMLCanvasElement} */ (target));
  }
}, { rootMargin: "200px" });

/** First voxel along z below the near field. @param {any} one */
function firstShown(one) {
  const source = sourceOf(one);
  return source && !source.flat ? firstBelow(source, source.near) : 0;
}

/** Those that were made: a search reads none of them again. @type {Map<string, HTMLElement>} */
const pictures = new Map();

/** @param {any} one @param {string} axis */
function picture(one, axis) {
  const before = pictures.get(one.id);
  if (before) return before;
  const canvas = h("canvas", { width: 1, height: 1, role: "img", "aria-label": `Maximum along ${axis}`, dataset: { of: one.id, axis, first: String(firstShown(one)) } });
  const made = h("span", { class: "thumb" }, canvas, h("span", null, "loading …"));
  pictures.set(one.id, made);
  watcher.observe(canvas);
  return made;
}

/** Say on a picture's place why nothing is seen there; no text: it is seen. @param {HTMLCanvasElement} canvas @param {string} text */
function say(canvas, text) {
  if (canvas.nextElementSibling) canvas.nextElementSibling.textContent = text;
}

/** Draw a small projection, black where there is nothing. @param {HTMLCanvasElement} canvas */
async function fill(canvas) {
  const { of, axis } = canvas.dataset;
  const slab = axis === "z" ? `&slab=${canvas.dataset.first}:` : ""; // without the near field, as on its page
  const query = `axis=${axis}&max_size=${PIXELS}&dtype=uint8${slab}`;
  try {
    const answer = await ask("GET", `/reconstructions/${of}/mip?${query}`, undefined, { accept: "application/octet-stream" });
    const shape = /** @type {[number, number]} */ ((answer.headers.get("X-Shape") ?? "").split(",").map(Number));
    const pixels = new ImageData(shape[0], shape[1]);
    const how = { up: axis === "z", out: new Uint32Array(pixels.data.buffer) };
    const values = new Uint8Array(await answer.arrayBuffer());
    paint({ values, shape }, [0, BRIGHTEST], table("inferno"), how);
    Object.assign(canvas, { width: shape[0], height: shape[1] });
    canvas.getContext("2d")?.putImageData(pixels, 0, 0);
    say(canvas, values.some((value) => value > 0) ? "" : "empty: no value above 0");
  } catch {
    say(canvas, "no picture");
    canvas.setAttribute("aria-label", "There is no picture of it");
  }
}

search.addEventListener("input", show);
loading(panel);
live.on("reconstruction", (seen) => seen.state === "succeeded" && void load());
live.on("again", () => void load());
void load();
