// @ts-check
// Volume view: three linked slice views, the 3-D view and the tool panels.
import { api } from "../api.js";
import { byId, copyText, h, pathIdentifier, replace } from "../dom.js";
import { addShortcut } from "../shortcuts.js";
import { showEmpty, showError, showLoading } from "../panel_states.js";
import { methodText } from "../reconstructions/summary.js";
import { formatTime, identifierElement, pressure } from "../units.js";
import { AXES, findBrightest, createSource } from "./volume_data.js";
import { PRESSURE_MAPS } from "./colours.js";
import { Compare } from "./compare.js";
import { Downloads } from "./downloads.js";
import { Histogram } from "./histogram.js";
import { latestOnly } from "./latest_only.js";
import { provenance } from "./provenance.js";
import { mmText, slicePane, pane3d } from "./panes.js";
import { SliceView } from "./slice_view.js";
import { View3D } from "./view_3d.js";
import { soundSpeedPanel } from "./sound_speed.js";
import { VolumeState } from "./volume_state.js";
import { ViewStore } from "./view_store.js";
import { tabs } from "./tabs.js";
import { MeasureTools } from "./measure_tools.js";
import { TOOLS } from "./view_state.js";

/** @typedef {import("./view_state.js").Axis} Axis */

const COLOUR_MAP_NAMES = /** @type {Record<string, string>} */ ({ inferno: "Inferno", grey: "Grey", cividis: "Cividis", depth: "Depth as colour" });

async function openVolume() {
  const panel = byId("volume");
  showLoading(panel, "loading the volume …");
  try {
    const reconstruction = await api.get(`/reconstructions/${pathIdentifier()}`);
    const source = reconstruction.state === "succeeded" ? createSource(reconstruction) : null;
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
  const stage = new VolumeState(source, store);
  const cursor = h("output", { class: "cursor", dataset: { cursor: "" }, "aria-live": "off" });
  const showPosition = (/** @type {any} */ hovered) => (cursor.textContent = hovered ? positionText(hovered) : "");
  const axes = /** @type {Axis[]} */ (source.flat ? ["y"] : ["z", "y", "x"]);
  const views = axes.map((axis) => new SliceView(stage, axis, showPosition));
  const view3d = source.flat ? null : new View3D(stage);
  const histogram = new Histogram(stage, () => views.map((view) => view.plane?.values ?? null));
  const tools = new MeasureTools(stage, views, reconstruction);
  const compare = new Compare(stage, views, reconstruction);
  const downloads = new Downloads(reconstruction);
  const provenancePanel = provenance(reconstruction);
  const speed = soundSpeedPanel(reconstruction);
  const side = tabs([
    ["View", h("div", { class: "stack" }, histogram.element, colourChoice(stage), nearFieldControl(stage), positionControls(stage)), histogram.draw],
    ["Measure", tools.element, null],
    ["Compare", compare.element, null],
    ["Speed", speed.element, speed.open],
    ["Made", provenancePanel.element, provenancePanel.open, "Origin"],
    ["Files", downloads.element, () => void downloads.load()],
  ]);
  replace(panel,
    createHeading(reconstruction, cursor),
    h("div", { class: source.flat ? "volume flat" : "volume" },
      h("div", { class: "views" }, slicePane(views[0]), view3d ? pane3d(view3d) : null, ...views.slice(1).map(slicePane)),
      h("aside", { class: "panel side", dataset: { steradian: "volume-side" } }, side)),
    h("p", { class: "visually-hidden", id: "view-keys" }, "The arrow keys move the crosshair, Page Up and Page Down change the slice, plus and minus zoom, 0 resets the view, m switches between slice and projection."));
  const overview = loadOverview(stage, views, histogram); // before the views request the same data
  for (const view of views) {
    view.listeners.add(histogram.draw);
    view.requestData(null);
  }
  document.addEventListener("steradian:resized", () => views.forEach((view) => view.draw()));
  const reloadOverview = latestOnly(() => loadOverview(stage, views, histogram), () => null); // the views show their own errors
  store.on((_view, changed) => (changed.has("cut") || changed.has("map")) && reloadOverview(null));
  void overview.catch(() => null).then(() => view3d?.load());
  addShortcuts(stage, side);
  void compare.loadReferences();
  document.dispatchEvent(new CustomEvent("steradian:volume", { detail: { about: reconstruction, stage, views, store } }));
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

/** @param {any} reconstruction @param {HTMLElement} cursor */
function createHeading(reconstruction, cursor) {
  const link = h("button", { type: "button", title: "The URL contains the complete view", onclick: () => copyText(link, location.href, "Link copied") }, "Copy link");
  const sample = h("strong", { dataset: { sample: "" } });
  void api.get(`/scans/${reconstruction.scan_id}`).then(({ labels }) => (sample.textContent = sample.title = Object.values(labels).join(", ")), () => null);
  return h("header", { class: "volume-head" }, sample, h("span", null, methodText(reconstruction)),
    h("span", null, reconstruction.simulated ? "simulated, " : "", `created ${formatTime(reconstruction.ended ?? reconstruction.created)}`), identifierElement(reconstruction.id, `/reconstructions/${reconstruction.id}`),
    h("span", null, "from ", h("a", { href: `/scans/${reconstruction.scan_id}`, title: reconstruction.scan_id }, `scan …${reconstruction.scan_id.slice(-5)}`)), cursor, link);
}

/** @param {{value: number, place: Partial<Record<Axis, number | null>>, of: string, whose: string}} hovered */
function positionText({ value, place, whose: volumeName }) {
  const coordinates = AXES.map((axis) => {
    const mm = place[axis];
    return mm === null || mm === undefined ? `${axis} (maximum)` : `${axis} ${mmText(mm)}`;
  });
  return `${coordinates.join("  ")}  value ${pressure(value, 4)}${volumeName ? ` in ${volumeName}` : ""}`;
}

/** @param {VolumeState} stage */
function colourChoice(stage) {
  const legend = h("p", { class: "dim small" });
  const choice = h("select", { id: "map", onchange: () => stage.store.change({ map: choice.value }) },
    PRESSURE_MAPS.filter((name) => name !== "depth" || !stage.source.flat).map((name) => h("option", { value: name }, COLOUR_MAP_NAMES[name])));
  const show = () => {
    choice.value = stage.view.map;
    legend.textContent = stage.isDepthMap ? "Hue shows depth, brightness shows the value." : "";
  };
  stage.store.on(show);
  show();
  return h("div", { class: "stack" }, h("label", { for: "map" }, "Colours"), choice, legend);
}

/** @param {VolumeState} stage */
function nearFieldControl(stage) {
  const [first, last] = stage.ends("z");
  const slider = h("input", { type: "range", min: 0, max: Math.max(last, first), step: stage.source.spacing[2], "aria-label": "Hidden near field, up to (mm)" });
  const status = h("output", null);
  slider.addEventListener("input", () => stage.store.change({ cut: Number(slider.value) }));
  const show = () => {
    slider.value = String(stage.cut);
    status.textContent = stage.cut ? `up to ${mmText(stage.cut)}` : "none";
  };
  stage.store.on(show);
  show();
  const autoButton = h("button", { type: "button", title: "End of the near field as determined by the reconstruction", onclick: () => stage.store.change({ cut: null }) }, "auto");
  return h("div", { class: "stack" }, h("div", { class: "row spread" }, h("span", null, "Hidden near field: ", status), autoButton), slider);
}

/** Create the crosshair controls. @param {VolumeState} stage */
function positionControls(stage) {
  const show = h("dl", { class: "figures", dataset: { place: "" } });
  const update = () => replace(show, AXES.flatMap((axis, n) => (stage.source.flat && axis === "y" ? [] : [h("dt", null, axis), h("dd", { dataset: { axis, value: String(stage.position[n]) } }, mmText(stage.position[n]))])));
  stage.store.on(update);
  update();
  return h("div", { class: "stack" }, h("h3", null, "Crosshair"), show, h("div", { class: "row" },
    h("button", { type: "button", title: "Shortcut: b", onclick: () => void moveToBrightest(stage) }, "Brightest"),
    h("button", { type: "button", title: "Shortcut: 0", onclick: () => stage.store.change({ zoom: 1, centre: null }) }, "Fit"),
    h("button", { type: "button", onclick: () => stage.store.change({ slab: [0, 0, 0], at: stage.position }) }, "Slices"),
    h("button", { type: "button", onclick: () => stage.store.change({ slab: [Infinity, Infinity, Infinity] }) }, "Projections")));
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
    ["+", "Zoom"], ["Shift drag", "Set the window: width horizontally, level vertically"], ["Alt drag", "Pan the image"],
  ])) addShortcut(key, description, null);
}

void openVolume();
