// @ts-check
// Volume view: three linked slice views, the 3-D view and the tool panels.
import { api } from "../api.js";
import { designQueryAround } from "../design/fields.js";
import { byId, copyText, h, pathIdentifier, replace } from "../dom.js";
import { addShortcut } from "../shortcuts.js";
import { showEmpty, showError, showLoading } from "../panel_states.js";
import { methodText } from "../reconstructions/summary.js";
import { formatDate, identifierElement } from "../units.js";
import { urlOf } from "../urls.js";
import { AXES, findBrightest, createSource } from "./volume_data.js";
import { Compare } from "./compare.js";
import { depthControls, displayOptions } from "./display_options.js";
import { Downloads } from "./downloads.js";
import { figureForm } from "./figure_form.js";
import { Histogram } from "./histogram.js";
import { latestOnly } from "./latest_only.js";
import { addEnlarging, addLayout } from "./layout.js";
import { provenance } from "./provenance.js";
import { mmText, slicePane, pane3d } from "./panes.js";
import { createReadout } from "./readout.js";
import { SliceView } from "./slice_view.js";
import { View3D } from "./view_3d.js";
import { SeriesPlayer, wavelengthsOf } from "./series_player.js";
import { soundSpeedPanel } from "./sound_speed.js";
import { unmixingForm, unmixingResult } from "./unmixing.js";
import { VolumeState } from "./volume_state.js";
import { ViewStore } from "./view_store.js";
import { tabs } from "./tabs.js";
import { MeasureTools } from "./measure_tools.js";
import { MeasurementStore } from "./measurement_store.js";
import { measurementTable } from "./measurement_table.js";
import { loadOrigin } from "./scan_origin.js";
import { TOOLS, decode } from "./view_state.js";

/** @typedef {import("./view_state.js").Axis} Axis */

async function openVolume() {
  const panel = byId("volume");
  showLoading(panel, "loading the volume …");
  try {
    const reconstruction = await api.get(`/reconstructions/${pathIdentifier()}`);
    const source = reconstruction.state === "succeeded" ? createSource(reconstruction, decode(location.hash).index) : null;
    if (source) await show(panel, reconstruction, source);
    else showAbsent(panel, reconstruction);
  } catch (error) {
    showError(panel, error, openVolume);
  }
}

/** Show why there is no volume. @param {HTMLElement} panel @param {any} reconstruction */
function showAbsent(panel, reconstruction) {
  const reason = reconstruction.error ? reconstruction.error.detail : reconstruction.state === "succeeded" ? "The report does not contain the voxel positions." : `The reconstruction is ${reconstruction.state}.`;
  showEmpty(panel, "No volume", reason, h("a", { class: "button", href: `/reconstructions/${reconstruction.id}` }, "Show the reconstruction"));
}

/** @param {HTMLElement} panel @param {any} reconstruction @param {import("./volume_data.js").Source} source */
async function show(panel, reconstruction, source) {
  const store = new ViewStore();
  const stage = new VolumeState(source, store, windowsOf(reconstruction, source), reconstruction);
  const showPosition = createReadout(stage);
  const axes = /** @type {Axis[]} */ (source.flat ? ["y"] : ["z", "y", "x"]);
  const views = axes.map((axis) => new SliceView(stage, axis, showPosition));
  const view3d = source.flat ? null : new View3D(stage);
  const frames = reconstruction.report.frames ?? [];
  const player = frames.length ? new SeriesPlayer(stage, views, frames) : null;
  const histogram = new Histogram(stage, () => views.map((view) => view.plane?.values ?? null));
  const measurements = (stage.measurements = new MeasurementStore(stage, reconstruction));
  const tools = new MeasureTools(stage, views, measurements);
  const compare = new Compare(stage, views, reconstruction);
  const downloads = new Downloads(reconstruction);
  const provenancePanel = provenance(reconstruction);
  const speed = soundSpeedPanel(reconstruction);
  const side = tabs([
    ["View", h("div", { class: "stack view-tab" }, histogram.element, displayOptions(stage), depthControls(stage), positionControls(stage, reconstruction.scan_id)), histogram.draw],
    ["Measure", tools.element, null],
    ["Compare", compare.element, null],
    ...unmixingTab(reconstruction),
    ...(reconstruction.kind === "unmixing" ? [] : [tab("Speed", speed.element, speed.open)]),
    ["Made", provenancePanel.element, provenancePanel.open, "Origin"],
    ["Files", h("div", { class: "stack" }, downloads.element, figureForm(stage, reconstruction)), () => void downloads.load()],
  ]);
  const [firstPane, ...panes] = views.map((view) => addEnlarging(stage, view.axis, view.name, slicePane(view)));
  const grid = h("div", { class: "views" }, firstPane, view3d ? addEnlarging(stage, "3d", "3-D", pane3d(view3d)) : null, ...panes);
  addLayout(stage, panel, grid);
  const largeName = h("p", { class: "large-name" }); // while one view fills the window, without the heading
  replace(panel,
    createHeading(reconstruction, stage, largeName), player?.element,
    h("div", { class: source.flat ? "volume flat" : "volume" }, h("div", { class: "column" }, grid, measurementTable(measurements)), h("aside", { class: "panel side", dataset: { steradian: "volume-side" } }, largeName, side)),
    h("p", { class: "visually-hidden", id: "view-keys" }, "The arrow keys move the crosshair, Page Up and Page Down change the slice, plus and minus zoom, 0 resets the view, m switches between slice and projection, f enlarges the view, Escape shows all views."));
  const overview = loadOverview(stage, views, histogram); // before the views request the same data
  for (const view of views) {
    view.listeners.add(histogram.draw);
    view.requestData(null);
  }
  document.addEventListener("steradian:resized", () => views.forEach((view) => view.draw()));
  const reload = async () => {
    await loadOverview(stage, views, histogram);
    if (view3d?.isStale && !player?.isPlaying) await view3d.load();
  };
  const reloadOverview = latestOnly(reload, () => null); // the views show their own errors
  store.on((_view, changed) => (changed.has("cut") || changed.has("map") || (changed.has("index") && !player?.isPlaying)) && reloadOverview(null));
  void overview.catch(() => null).then(() => view3d?.load());
  addShortcuts(stage, side);
  void compare.loadReferences();
  void measurements.load();
  document.dispatchEvent(new CustomEvent("steradian:volume", { detail: { about: reconstruction, stage, views, store } }));
}

/** Return the colour scale of each volume of a series: one for all images, 0 to 1 for saturation. @param {any} reconstruction @param {import("./volume_data.js").Source} source */
function windowsOf(reconstruction, source) {
  const { frames } = reconstruction.report;
  if (!frames?.length) return null;
  return frames.map((/** @type {any} */ { name }) => (name?.startsWith("saturation") ? [0, 1] : !name && source.peak ? [0, source.peak] : null));
}

/** @param {string} name @param {HTMLElement} element @param {(() => unknown) | null} act @returns {[string, HTMLElement, (() => unknown) | null]} */
const tab = (name, element, act = null) => [name, element, act];

/** Return the tab that unmixes a series of several wavelengths, or shows an unmixing. @param {any} reconstruction */
function unmixingTab(reconstruction) {
  if (reconstruction.kind === "unmixing") return [tab("Oxygen", unmixingResult(reconstruction))];
  return wavelengthsOf(reconstruction.report.frames ?? []).length > 1 ? [tab("Unmix", unmixingForm(reconstruction))] : [];
}

/** Read the overview of the volume and update all views. @param {VolumeState} stage @param {SliceView[]} views @param {Histogram} histogram */
async function loadOverview(stage, views, histogram) {
  await stage.readOverview();
  if (stage.isDepthMap) await stage.readDepths();
  stage.store.notify(["at", "window"]);
  for (const view of views) view.requestData(null);
  histogram.draw();
  byId("volume").dataset.surveyed = "";
}

/** @param {any} reconstruction @param {VolumeState} stage @param {HTMLElement} largeName shows the same name beside an enlarged view */
function createHeading(reconstruction, stage, largeName) {
  const toFigure = h("button", { type: "button", dataset: { toFigure: "" }, title: "Figure of the views for a paper: PDF, SVG, PNG", onclick: () => {
    /** @type {HTMLElement | null} */ (document.querySelector('[role="tab"][data-tab="Files"]'))?.click();
    document.getElementById("figure-format")?.focus();
  } }, "Figure …");
  const link = h("button", { type: "button", title: "The URL contains the complete view", onclick: () => copyText(link, location.href, "Link copied") }, "Copy link");
  const sample = h("strong", { dataset: { sample: "" } });
  const showTitle = () => (document.title = [stage.nameText, "Volume · Steradian"].filter(Boolean).join(" · "));
  showTitle();
  stage.store.on((_view, changed) => changed.has("index") && showTitle());
  const largeSample = h("strong");
  replace(largeName, largeSample, " ", h("span", { class: "dim" }, methodText(reconstruction)));
  void api.get(`/scans/${reconstruction.scan_id}`).then(({ labels }) => (sample.textContent = sample.title = largeSample.textContent = Object.values(labels).join(", ")), () => null);
  return h("header", { class: "volume-head" }, sample, h("span", { class: "method", title: methodText(reconstruction) }, methodText(reconstruction)),
    h("span", { title: "Created" }, reconstruction.simulated ? "simulated, " : "", formatDate(reconstruction.ended ?? reconstruction.created)), identifierElement(reconstruction.id, `/reconstructions/${reconstruction.id}`),
    h("span", null, h("a", { href: `/scans/${reconstruction.scan_id}`, title: reconstruction.scan_id }, `scan …${reconstruction.scan_id.slice(-5)}`)), h("span", { class: "row nowrap" }, toFigure, link));
}

/** Create the crosshair controls. @param {VolumeState} stage @param {string} scanId */
function positionControls(stage, scanId) {
  const show = h("dl", { class: "place", dataset: { place: "" } });
  const update = () => replace(show, AXES.flatMap((axis, n) => (stage.source.flat && axis === "y" ? [] : [h("div", null, h("dt", null, axis), h("dd", { dataset: { axis, value: String(stage.position[n]) } }, mmText(stage.position[n])))])));
  stage.store.on(update);
  update();
  return h("div", { class: "stack crosshair" },
    h("div", { class: "row spread nowrap" }, h("h3", null, "Crosshair"), h("button", { type: "button", class: "primary", title: "Design a scan with a mask around the crosshair", onclick: () => void scanHere(stage, scanId) }, "Scan here …")), show,
    h("div", { class: "row nowrap" },
      h("button", { type: "button", title: "Shortcut: b", onclick: () => void moveToBrightest(stage) }, "Brightest"),
      h("button", { type: "button", title: "Shortcut: 0", onclick: () => stage.store.change({ zoom: 1, centre: null }) }, "Fit"),
      h("button", { type: "button", onclick: () => stage.store.change({ slab: [0, 0, 0], at: stage.position }) }, "Slices"),
      h("button", { type: "button", onclick: () => stage.store.change({ slab: [Infinity, Infinity, Infinity] }) }, "Projections")));
}

/** Open the design of a scan around the crosshair. @param {VolumeState} stage @param {string} scanId */
async function scanHere(stage, scanId) {
  const query = designQueryAround([stage.position], stage.source.flat, await loadOrigin(scanId));
  location.assign(urlOf(`/design?${query}`));
}

/** @param {VolumeState} stage */
async function moveToBrightest(stage) {
  stage.store.change({ at: await findBrightest(stage.source, stage.cut) });
}

/** @param {VolumeState} stage @param {HTMLElement} side */
function addShortcuts(stage, side) {
  TOOLS.forEach((tool, n) => addShortcut(String(n + 1), `Tool: ${tool}`, () => {
    stage.store.change({ tool });
    /** @type {HTMLElement | null} */ (side.querySelector('[role="tab"][data-tab="Measure"]'))?.click();
  }));
  addShortcut("b", "Move the crosshair to the brightest voxel", () => void moveToBrightest(stage));
  addShortcut("0", "Reset the view", () => stage.store.change({ zoom: 1, centre: null }));
  for (const [key, description] of /** @type {[string, string][]} */ ([
    ["←", "Move the crosshair (in a view; with Shift by ten voxels)"], ["PageDown", "Next slice"], ["m", "Slice or projection"],
    ["+", "Zoom around the crosshair"], ["Shift drag", "Set the window: width horizontally, level vertically"], ["Alt drag", "Pan the image"],
  ])) addShortcut(key, description, null);
}

void openVolume();
