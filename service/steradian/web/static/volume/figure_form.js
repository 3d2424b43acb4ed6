// @ts-check
// Figure of the current view for a paper (PDF, SVG, PNG) or film of a series, made by a job of the service.
import { api, BASE, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { percent } from "../units.js";
import { AXES, PLANES, axisIndex, voxelPosition } from "./volume_data.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./view_state.js").Axis} Axis */

const FORMATS = [["pdf", "PDF"], ["svg", "SVG"], ["png", "PNG"]];
const MAX_PANELS = 36; // side by side
const MAPS = /** @type {Record<string, string>} */ ({ grey: "gray", "grey-reversed": "gray_r" }); // names of matplotlib that differ from the page's
const SIZES = /** @type {[string, string, number, number, number, string][]} */ ([ // name, label, default, least, most, unit
  ["width", "Width (mm)", 85, 35, 1000, "mm"], ["font", "Letters (pt)", 7, 4, 24, "pt"], ["dpi", "Resolution (dpi)", 300, 50, 2400, "dpi"],
]);

/** Create the form. @param {VolumeState} stage @param {any} reconstruction of the API */
export function figureForm(stage, reconstruction) {
  const frames = reconstruction.report.frames ?? [];
  const isMaps = reconstruction.kind === "unmixing";
  const format = h("select", { id: "figure-format" }, FORMATS.map(([value, text]) => h("option", { value }, text)));
  const film = h("option", { value: "gif" }, "GIF: film of the series");
  const showFilm = () => { // a film has no depths as colours
    if (!frames.length || isMaps) return;
    if (stage.isDepthMap) film.remove();
    else if (film.parentElement !== format) format.append(film);
  };
  stage.store.on(showFilm);
  showFilm();
  const sizes = SIZES.map(([name, , value]) => h("input", { type: "text", inputmode: "decimal", id: `figure-${name}`, value: String(value), class: "short-field", "aria-describedby": "figure-fault" }));
  const fault = h("p", { class: "fault small", id: "figure-fault", role: "alert", hidden: true });
  const all = h("option", { value: "all" }, `all ${frames.length}, side by side`);
  const which = h("select", { id: "figure-volumes", "aria-describedby": "figure-fault" }, h("option", { value: "one" }, "this volume"), isMaps || frames.length > MAX_PANELS ? null : all);
  const axis = h("select", { id: "figure-axis" }, stage.source.flat ? h("option", { value: "y" }, "the image")
    : [...(/** @type {Axis[]} */ (["z", "y", "x"])).map((name) => h("option", { value: name }, PLANES[name].join("–"))), h("option", { value: "zy" }, "x–y and x–z"), h("option", { value: "zyx" }, "x–y, x–z and y–z")]);
  const showLarge = () => {
    const { large } = stage;
    if (large && large !== "3d") axis.value = large;
    showPanels();
  };
  const axes = () => /** @type {Axis[]} */ ([...axis.value].slice(0, format.value === "gif" ? 1 : 3));
  const showPanels = () => (all.disabled = frames.length * axes().length > MAX_PANELS);
  axis.addEventListener("change", showPanels);
  stage.store.on((_view, changed) => changed.has("large") && showLarge());
  showLarge();
  const note = h("p", { class: "dim small" });
  const showNote = () => {
    const isFilm = format.value === "gif";
    const reference = !stage.reference ? "" : stage.isOverlay && !isFilm ? " With the overlay." : " Without the reference.";
    note.textContent = `Slices or maxima, part and depths as in the views, with their colours and scale${isFilm ? "; films show voxels without interpolation" : " and interpolation"}.${reference}`;
  };
  format.addEventListener("change", showNote);
  stage.store.on((_view, changed) => (["against", "how", "difference"].some((name) => changed.has(name))) && showNote());
  showNote();
  const status = h("div", { role: "status", class: "small", dataset: { figure: "" } });
  const button = h("button", null, "Create the figure");
  const form = h("form", { class: "stack", novalidate: true }, h("h3", null, "Figure for a paper"),
    field("figure-format", "Format", format), field("figure-axis", "Shows", axis), frames.length ? field("figure-volumes", "Volumes", which) : null, ...SIZES.map(([name, label], n) => field(`figure-${name}`, label, sizes[n])), fault,
    note, button, status);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const isTooMany = format.value !== "gif" && which.value === "all" && frames.length * axes().length > MAX_PANELS;
    which.setAttribute("aria-invalid", String(isTooMany));
    const isValid = SIZES.map(([, , , least, most], n) => Number(sizes[n].value) >= least && Number(sizes[n].value) <= most);
    const wrong = isValid.indexOf(false);
    sizes.forEach((input, n) => input.setAttribute("aria-invalid", String(!isValid[n])));
    fault.hidden = wrong < 0 && !isTooMany;
    if (wrong >= 0) {
      const [, label, , least, most, unit] = SIZES[wrong];
      fault.textContent = `${label}: a number from ${least} to ${most} ${unit}.`;
      return sizes[wrong].focus();
    }
    if (isTooMany) {
      fault.textContent = `Volumes: at most ${MAX_PANELS} panels side by side; ${frames.length} volumes with ${axes().length} planes each are ${frames.length * axes().length}. Select fewer planes or this volume.`;
      return which.focus();
    }
    const [width, font, dpi] = sizes.map((input) => Number(input.value));
    button.disabled = true;
    const [low, high] = stage.window;
    const { name } = frames[stage.source.index ?? 0] ?? {};
    const body = {
      kind: "figure", reconstruction_id: reconstruction.id, format: format.value, ...viewOf(stage, axes()),
      width: 1e-3 * width, font_size: font, dpi, limits: [low, high], near_field: 1e-3 * stage.cut,
      colour_map: stage.isDepthMap ? "inferno" : MAPS[stage.view.map] ?? stage.view.map, depth_coded: stage.isDepthMap,
      ...(stage.reference && stage.isOverlay && format.value !== "gif" ? { overlay: overlayOf(stage, stage.reference) } : {}), interpolation: stage.view.smooth, gamma: stage.view.gamma, ...(stage.view.log ? { log_range_db: stage.view.log } : {}),
      ...(name ? { label: name } : {}), ...(frames.length && format.value !== "gif" && which.value === "one" ? { indices: [stage.source.index] } : {}),
    };
    try {
      await create(body, status);
    } catch (error) {
      replace(status, ...errorElements(error));
    }
    button.disabled = false;
  });
  return form;
}

/** Return what views show, in m: axes, the slab along each, and the visible part. @param {VolumeState} stage @param {Axis[]} axes */
function viewOf(stage, axes) {
  const { source } = stage;
  const inMetres = (/** @type {number[]} */ values) => values.map((mm) => Number((1e-3 * mm).toPrecision(9)));
  const slab = Object.fromEntries(axes.filter((axis) => !source.flat && stage.view.slab[axisIndex(axis)] !== Infinity).map((axis) => {
    const { from, to } = stage.range(axis);
    return [axis, inMetres([from, to - 1].map((index) => voxelPosition(source, axis, index)))];
  }));
  const region = Object.fromEntries(AXES.filter((axis) => !source.flat || axis !== "y").map((axis) => [axis, inMetres(stage.visibleEnds(axis))]));
  return { axes, slab, region };
}

/** Return the overlay of the views. @param {VolumeState} stage @param {import("./volume_data.js").Source} reference */
function overlayOf(stage, reference) {
  const { overlayMap, opacity } = stage.view;
  return {
    reconstruction_id: reference.id, ...(reference.index === null ? {} : { index: reference.index }), colour_map: MAPS[overlayMap] ?? overlayMap,
    limits: [...stage.overlayWindow], opacity, label: `${stage.referenceName} (arb. u.)`,
  };
}

/** @param {string} id @param {string} text @param {HTMLElement} control */
const field = (id, text, control) => h("div", { class: "option" }, h("label", { for: id }, text), control);

/** @param {any} body @param {HTMLElement} status */
async function create(body, status) {
  let job = await api.post("/jobs", body, { headers: idempotencyHeaders() });
  while (["queued", "running", "cancelling"].includes(job.state)) {
    status.textContent = job.progress.total ? `drawing … ${percent(job.progress.done / job.progress.total)}` : "drawing …";
    job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
  }
  if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the figure ${job.state}`);
  const [file] = job.files;
  replace(status, h("a", { class: "button primary", href: `${BASE}/jobs/${job.id}/files/${encodeURIComponent(file)}`, download: file }, `Download ${file.slice(file.lastIndexOf(".") + 1).toUpperCase()}`));
}
