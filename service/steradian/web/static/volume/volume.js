// @ts-check
// The page of a volume: three linked views and the 3-D one, and beside them what is asked about it.
import { api } from "../api.js";
import { byId, copy, h, identifier, replace } from "../dom.js";
import { addKey } from "../shortcuts.js";
import { empty, failed, loading } from "../panel_states.js";
import { methodOf } from "../reconstructions/summary.js";
import { clock, identifierOf, pressure } from "../units.js";
import { AXES, brightest, sourceOf } from "./volume_data.js";
import { PRESSURE_MAPS } from "./colours.js";
import { Compare } from "./compare.js";
import { Downloads } from "./downloads.js";
import { Histogram } from "./histogram.js";
import { latest } from "./latest_only.js";
import { made } from "./provenance.js";
import { mmOf, pane, solidPane } from "./panes.js";
import { SliceView } from "./slice_view.js";
import { SolidView } from "./view_3d.js";
import { soundSpeed } from "./sound_speed.js";
import { Stage } from "./shared_state.js";
import { Store } from "./view_store.js";
import { tabs } from "./tabs.js";
import { Tools } from "./measure_tools.js";
import { TOOLS } from "./view_state.js";

/** @typedef {import("./view_state.js").Axis} Axis */

const NAMES = /** @type {Record<string, string>} */ ({ inferno: "Inferno", grey: "Grey", cividis: "Cividis", depth: "Depth as colour" });

async function open() {
  const panel = byId("volume");
  loading(panel, "loading the volume …");
  try {
    const about = await api.get(`/reconstructions/${identifier()}`);
    const source = about.state === "succeeded" ? sourceOf(about) : null;
    if (source) await show(panel, about, source);
    else absent(panel, about);
  } catch (error) {
    failed(panel, error, open);
  }
}

/** Say why there is no volume. @param {HTMLElement} panel @param {any} about */
function absent(panel, about) {
  const why = about.error ? about.error.detail : about.state === "succeeded" ? "Its report does not tell where its voxels lie." : `The reconstruction is ${about.state}.`;
  empty(panel, "There is no volume here", why, h("a", { class: "button", href: `/reconstructions/${about.id}` }, "Its reconstruction"));
}

/** @param {HTMLElement} panel @param {any} about @param {import("./volume_data.js").Source} source */
async function show(panel, about, source) {
  const store = new Store();
  const stage = new Stage(source, store);
  const cursor = h("output", { class: "cursor", dataset: { cursor: "" }, "aria-live": "off" });
  const hover = (/** @type {any} */ seen) => (cursor.textContent = seen ? placeText(seen) : "");
  const axes = /** @type {Axis[]} */ (source.flat ? ["y"] : ["z", "y", "x"]);
  const views = axes.map((axis) => new SliceView(stage, axis, hover));
  const solid = source.flat ? null : new SolidView(stage);
  const histogram = new Histogram(stage, () => views.map((view) => view.plane?.values ?? null));
  const tools = new Tools(stage, views, about);
  const compare = new Compare(stage, views, about);
  const downloads = new Downloads(about);
  const how = made(about);
  const speed = soundSpeed(about);
  const side = tabs([
    ["View", h("div", { class: "stack" }, histogram.element, colourChoice(stage), nearField(stage), places(stage)), histogram.draw],
    ["Measure", tools.element, null],
    ["Compare", compare.element, null],
    ["Speed", speed.element, speed.open],
    ["Made", how.element, how.open],
    ["Files", downloads.element, () => void downloads.open()],
  ]);
  replace(panel,
    heading(about, cursor),
    h("div", { class: source.flat ? "volume flat" : "volume" },
      h("div", { class: "views" }, pane(views[0]), solid ? solidPane(solid) : null, ...views.slice(1).map(pane)),
      h("aside", { class: "panel side", dataset: { steradian: "volume-side" } }, side)),
    h("p", { class: "visually-hidden", id: "view-keys" }, "Arrows move the crosshair, Page up and down the slice, plus and minus zoom, 0 shows everything, m changes between slice and projection."));
  const surveyed = look(stage, views, histogram); // before the views ask: they wait for the same numbers
  for (const view of views) {
    view.ears.add(histogram.draw);
    view.read(null);
  }
  document.addEventListener("steradian:resized", () => views.forEach((view) => view.draw()));
  const again = latest(() => look(stage, views, histogram), () => null); // what failed the views tell themselves
  store.on((_view, changed) => (changed.has("cut") || changed.has("map")) && again(null));
  void surveyed.catch(() => null).then(() => solid?.open());
  keys(stage, side);
  void compare.open();
  document.dispatchEvent(new CustomEvent("steradian:volume", { detail: { about, stage, views, store } }));
}

/** Look where it is brightest and over which depths there is something. @param {Stage} stage @param {SliceView[]} views @param {Histogram} histogram */
async function look(stage, views, histogram) {
  await stage.survey();
  if (stage.byDepth) await stage.surveyDepths();
  stage.store.tell(["at", "window"]);
  for (const view of views) view.read(null);
  histogram.draw();
  byId("volume").dataset.surveyed = "";
}

/** @param {any} about @param {HTMLElement} cursor */
function heading(about, cursor) {
  const link = h("button", { type: "button", title: "The address holds the whole view", onclick: () => copy(link, location.href, "Link copied") }, "Copy link");
  const sample = h("strong", { dataset: { sample: "" } });
  void api.get(`/scans/${about.scan_id}`).then(({ labels }) => (sample.textContent = sample.title = Object.values(labels).join(", ")), () => null);
  return h("header", { class: "volume-head" }, sample, h("span", null, methodOf(about)),
    h("span", null, about.simulated ? "simulated, " : "", `made ${clock(about.ended ?? about.created)}`), identifierOf(about.id, `/reconstructions/${about.id}`),
    h("span", null, "of ", h("a", { href: `/scans/${about.scan_id}`, title: about.scan_id }, `scan …${about.scan_id.slice(-5)}`)), cursor, link);
}

/** @param {{value: number, place: Partial<Record<Axis, number | null>>, of: string, whose: string}} seen */
function placeText({ value, place, whose }) {
  const where = AXES.map((axis) => {
    const mm = place[axis];
    return mm === null || mm === undefined ? `${axis} (maximum)` : `${axis} ${mmOf(mm)}`;
  });
  return `${where.join("  ")}  value ${pressure(value, 4)}${whose ? ` in ${whose}` : ""}`;
}

/** @param {Stage} stage */
function colourChoice(stage) {
  const legend = h("p", { class: "dim small" });
  const choice = h("select", { id: "map", onchange: () => stage.store.change({ map: choice.value }) },
    PRESSURE_MAPS.filter((name) => name !== "depth" || !stage.source.flat).map((name) => h("option", { value: name }, NAMES[name])));
  const show = () => {
    choice.value = stage.view.map;
    legend.textContent = stage.byDepth ? "The hue is the depth, the brightness the value." : "";
  };
  stage.store.on(show);
  show();
  return h("div", { class: "stack" }, h("label", { for: "map" }, "Colours"), choice, legend);
}

/** @param {Stage} stage */
function nearField(stage) {
  const [first, last] = stage.ends("z");
  const slider = h("input", { type: "range", min: 0, max: Math.max(last, first), step: stage.source.spacing[2], "aria-label": "Near field left out up to (mm)" });
  const told = h("output", null);
  slider.addEventListener("input", () => stage.store.change({ cut: Number(slider.value) }));
  const show = () => {
    slider.value = String(stage.cut);
    told.textContent = stage.cut ? `up to ${mmOf(stage.cut)}` : "nothing";
  };
  stage.store.on(show);
  show();
  const own = h("button", { type: "button", title: "Where the sensors' own noise ends, as the reconstruction found", onclick: () => stage.store.change({ cut: null }) }, "auto");
  return h("div", { class: "stack" }, h("div", { class: "row spread" }, h("span", null, "Near field left out: ", told), own), slider);
}

/** Where one may go at once. @param {Stage} stage */
function places(stage) {
  const show = h("dl", { class: "figures", dataset: { place: "" } });
  const tell = () => replace(show, AXES.flatMap((axis, n) => (stage.source.flat && axis === "y" ? [] : [h("dt", null, axis), h("dd", { dataset: { axis, value: String(stage.place[n]) } }, mmOf(stage.place[n]))])));
  stage.store.on(tell);
  tell();
  return h("div", { class: "stack" }, h("h3", null, "Crosshair"), show, h("div", { class: "row" },
    h("button", { type: "button", title: "Key b", onclick: () => void toBrightest(stage) }, "Brightest"),
    h("button", { type: "button", title: "Key 0", onclick: () => stage.store.change({ zoom: 1, centre: null }) }, "Fit"),
    h("button", { type: "button", onclick: () => stage.store.change({ slab: [0, 0, 0], at: stage.place }) }, "Slices"),
    h("button", { type: "button", onclick: () => stage.store.change({ slab: [Infinity, Infinity, Infinity] }) }, "Projections")));
}

/** @param {Stage} stage */
async function toBrightest(stage) {
  stage.store.change({ at: await brightest(stage.source, stage.cut) });
}

/** @param {Stage} stage @param {HTMLElement} side */
function keys(stage, side) {
  TOOLS.forEach((tool, n) => addKey(String(n + 1), `Tool: ${tool}`, () => {
    stage.store.change({ tool });
    /** @type {HTMLElement | null} */ (side.querySelector('[role="tab"][data-tab="Measure"]'))?.click();
  }));
  addKey("b", "Crosshair to the brightest voxel", () => void toBrightest(stage));
  addKey("0", "Show everything", () => stage.store.change({ zoom: 1, centre: null }));
  for (const [key, what] of /** @type {[string, string][]} */ ([
    ["←", "Move the crosshair (in a view; with Shift by ten)"], ["PageDown", "Next slice"], ["m", "Slice or projection"],
    ["+", "Zoom"], ["Shift drag", "Window: across its width, up and down its level"], ["Alt drag", "Move the picture"],
  ])) addKey(key, what, null);
}

void open();
