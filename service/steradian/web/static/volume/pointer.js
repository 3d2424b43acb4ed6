// @ts-check
// Mouse, touch and keys on a slice view.
import { PLANES, at, indexOf, placeOf } from "./volume_data.js";
import { sample } from "./measurements.js";
import { MOST_POINTS } from "./view_state.js";

/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {{x: number, y: number}} Point */

const CLOSEST = 3; // pixels that a mark has at least
const REACH = 12; // pixels within which a point of interest is taken
const ARROWS = /** @type {Record<string, [number, number]>} */ ({
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
});

/** @param {SliceView} view */
export function listen(view) {
  const target = view.overlay;
  /** @type {Map<number, Point>} */
  const down = new Map();
  /** @type {((to: Point) => void) | null} */
  let drag = null;
  let { points } = view.stage.view;

  target.addEventListener("pointerdown", (event) => {
    if (event.button === 2) return; // the browser's menu
    target.focus({ preventScroll: true });
    target.setPointerCapture(event.pointerId);
    down.set(event.pointerId, pointOf(event));
    if (down.size === 1) ({ points } = view.stage.view);
    else view.stage.store.change({ points }); // the first of two fingers meant none
    drag = down.size === 2 ? pinch(view, [...down.values()]) : begin(view, event);
    drag?.(pointOf(event));
    event.preventDefault();
  });
  target.addEventListener("pointermove", (event) => {
    const at = pointOf(event);
    tell(view, at);
    if (!down.has(event.pointerId)) return;
    down.set(event.pointerId, at);
    if (down.size === 2) pinched(view, drag, [...down.values()]);
    else drag?.(at);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    target.addEventListener(kind, (event) => {
      down.delete(/** @type {PointerEvent} */ (event).pointerId);
      drag = null;
    });
  }
  target.addEventListener("pointerleave", () => view.hover(null));
  target.addEventListener("wheel", (event) => wheel(view, event), { passive: false });
  target.addEventListener("dblclick", () => toggleSlab(view));
  target.addEventListener("keydown", (event) => key(view, event));
}

/** @param {MouseEvent} event @returns {Point} */
const pointOf = (event) => ({ x: event.offsetX, y: event.offsetY });

/** What a drag does, by button and keys held. @param {SliceView} view @param {PointerEvent} event */
function begin(view, event) {
  const from = pointOf(event);
  if (event.button === 1 || event.altKey) return panned(view, from);
  if (event.shiftKey) return windowed(view, from);
  const { tool } = view.stage.view;
  if (tool === "point") return pointed(view, from);
  return tool === "crosshair" ? placed(view) : marked(view, from, /** @type {"line" | "region" | "background"} */ (tool));
}

/** @param {SliceView} view */
function placed(view) {
  return (/** @type {Point} */ to) => view.stage.store.change({ at: placeAt(view, to, view.stage.place) });
}

/** Where something goes that is put at a point of a view; along the view it stays. @param {SliceView} view @param {Point} to @param {Triple} from */
function placeAt(view, to, from) {
  const [a, b] = view.toPlace(to.x, to.y);
  const [across, up] = PLANES[view.axis];
  const place = /** @type {Triple} */ ([...from]);
  for (const [axis, mm] of /** @type {const} */ ([[across, a], [up, b]])) {
    const ends = view.stage.ends(axis);
    place[at(axis)] = Math.min(Math.max(mm, ends[0]), ends[1]);
  }
  return place;
}

/** Another point of interest, or one that is there put elsewhere. @param {SliceView} view @param {Point} from */
function pointed(view, from) {
  const { stage } = view;
  const { points } = stage.view;
  const [across, up] = PLANES[view.axis];
  const taken = points.findIndex((one) => {
    const [x, y] = view.toPixels(one[at(across)], one[at(up)]);
    return Math.hypot(x - from.x, y - from.y) < REACH;
  });
  if (taken < 0 && points.length === MOST_POINTS) return placed(view);
  const n = taken >= 0 ? taken : stage.source.flat ? 0 : points.length;
  const start = points[taken] ?? stage.place;
  const [x, y] = taken < 0 ? [from.x, from.y] : view.toPixels(start[at(across)], start[at(up)]);
  return (/** @type {Point} */ to) => {
    const place = placeAt(view, { x: x + to.x - from.x, y: y + to.y - from.y }, start);
    stage.store.change({ points: [...points.slice(0, n), place, ...points.slice(n + 1)], at: place });
  };
}

/** @param {SliceView} view @param {Point} from @param {"line" | "region" | "background"} tool */
function marked(view, from, tool) {
  const start = view.toPlace(from.x, from.y);
  return (/** @type {Point} */ to) => {
    if (Math.hypot(to.x - from.x, to.y - from.y) < CLOSEST) return;
    view.stage.store.change({ [tool]: { plane: view.axis, from: start, to: view.toPlace(to.x, to.y) } });
  };
}

/** To the right: brighter (a narrower window); down: lower. @param {SliceView} view @param {Point} from */
function windowed(view, from) {
  const [low, high] = view.stage.window;
  return (/** @type {Point} */ to) => {
    const width = (high - low) * 2 ** ((from.x - to.x) / 100);
    const middle = (low + high) / 2 + ((to.y - from.y) / 200) * (high - low);
    view.stage.store.change({ window: [middle - width / 2, middle + width / 2] });
  };
}

/** @param {SliceView} view @param {Point} from */
function panned(view, from) {
  const { centre, scale } = view.stage;
  return (/** @type {Point} */ to) => move(view, centre, (to.x - from.x) / scale, (to.y - from.y) / scale);
}

/** @param {SliceView} view @param {Triple} centre @param {number} right mm @param {number} down mm */
function move(view, centre, right, down) {
  const [across, up] = PLANES[view.axis];
  const moved = /** @type {Triple} */ ([...centre]);
  moved[at(across)] -= right;
  moved[at(up)] -= view.up ? -down : down;
  view.stage.store.change({ centre: moved });
}

/** @param {SliceView} view @param {Point[]} fingers */
function pinch(view, [one, other]) {
  const { centre, scale, view: { zoom } } = view.stage;
  const apart = Math.hypot(other.x - one.x, other.y - one.y) || 1;
  const middle = { x: (one.x + other.x) / 2, y: (one.y + other.y) / 2 };
  return (/** @type {any} */ to) => {
    if (!to.apart) return;
    view.stage.store.change({ zoom: limited(zoom * (to.apart / apart)) });
    move(view, centre, (to.x - middle.x) / scale, (to.y - middle.y) / scale);
  };
}

/** @param {SliceView} _view @param {((to: any) => void) | null} drag @param {Point[]} fingers */
function pinched(_view, drag, [one, other]) {
  drag?.({ x: (one.x + other.x) / 2, y: (one.y + other.y) / 2, apart: Math.hypot(other.x - one.x, other.y - one.y) });
}

/** @param {number} zoom */
export const limited = (zoom) => Math.min(Math.max(zoom, 0.25), 64);

/** @param {SliceView} view @param {WheelEvent} event */
function wheel(view, event) {
  event.preventDefault();
  if (event.ctrlKey || event.metaKey) zoomAt(view, 2 ** (-event.deltaY / 300), pointOf(event));
  else if (event.deltaY) step(view, Math.sign(event.deltaY));
}

/** Zoom so that what is under a point stays there. @param {SliceView} view @param {number} factor @param {Point} point */
function zoomAt(view, factor, point) {
  const { stage } = view;
  const zoom = limited(stage.view.zoom * factor);
  const ratio = 1 - stage.view.zoom / zoom;
  const [a, b] = view.toPlace(point.x, point.y);
  const [across, up] = PLANES[view.axis];
  const centre = /** @type {Triple} */ ([...stage.centre]);
  centre[at(across)] += (a - centre[at(across)]) * ratio;
  centre[at(up)] += (b - centre[at(up)]) * ratio;
  stage.store.change({ zoom, centre });
}

/** Go to another slice; from the projection of everything to the slice at the crosshair.
 *
 * @param {SliceView} view @param {number} by voxels
 */
export function step(view, by) {
  const { stage, axis } = view;
  const { source } = stage;
  if (source.flat) return;
  if (stage.view.slab[at(axis)] === Infinity) return toggleSlab(view);
  const place = /** @type {Triple} */ ([...stage.place]);
  const index = indexOf(source, axis, place[at(axis)]) + by;
  place[at(axis)] = placeOf(source, axis, Math.min(Math.max(index, 0), source.shape[at(axis)] - 1));
  stage.store.change({ at: place });
}

/** From the projection to the slice at the crosshair and back. @param {SliceView} view */
export function toggleSlab(view) {
  const { stage, axis } = view;
  if (stage.source.flat) return;
  const slab = /** @type {Triple} */ ([...stage.view.slab]);
  slab[at(axis)] = slab[at(axis)] === Infinity ? 0 : Infinity;
  stage.store.change({ slab, at: stage.place });
}

/** @param {SliceView} view @param {KeyboardEvent} event */
function key(view, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const { stage } = view;
  const arrow = ARROWS[event.key];
  const middle = { x: view.width / 2, y: view.height / 2 };
  if (arrow) nudge(view, arrow, event.shiftKey ? 10 : 1);
  else if (event.key === "PageUp" || event.key === "PageDown") step(view, event.key === "PageUp" ? -1 : 1);
  else if (event.key === "+" || event.key === "=") zoomAt(view, 1.25, middle);
  else if (event.key === "-") zoomAt(view, 0.8, middle);
  else if (event.key === "0") stage.store.change({ zoom: 1, centre: null });
  else if (event.key === "m") toggleSlab(view);
  else return;
  event.preventDefault();
  event.stopPropagation();
}

/** Move the crosshair by voxels. @param {SliceView} view @param {[number, number]} way @param {number} by */
function nudge(view, [right, down], by) {
  const { stage } = view;
  const { source } = stage;
  const place = /** @type {Triple} */ ([...stage.place]);
  const [across, up] = PLANES[view.axis];
  for (const [axis, steps] of /** @type {const} */ ([[across, right * by], [up, (view.up ? -down : down) * by]])) {
    if (!steps) continue;
    const index = indexOf(source, axis, place[at(axis)]) + steps;
    place[at(axis)] = placeOf(source, axis, Math.min(Math.max(index, 0), source.shape[at(axis)] - 1));
  }
  stage.store.change({ at: place });
}

/** Tell the value and the place under the cursor. @param {SliceView} view @param {Point} point */
function tell(view, point) {
  const [a, b] = view.toPlace(point.x, point.y);
  const plane = view.blinked && view.other ? view.other : view.plane;
  const value = plane ? sample(plane, a, b) : NaN;
  if (Number.isNaN(value)) return view.hover(null);
  const [across, up] = PLANES[view.axis];
  const range = view.stage.range(view.axis);
  const slice = range.to - range.from === 1;
  /** @type {Partial<Record<import("./view_state.js").Axis, number | null>>} */
  const place = { [across]: a, [up]: b };
  place[view.axis] = slice ? placeOf(view.stage.source, view.axis, range.from) : null;
  const whose = !view.other ? "" : plane === view.other ? "the reference" : "this image";
  view.hover({ value, place, of: view.name, whose });
}
