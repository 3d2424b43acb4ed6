// @ts-check
// Pointer and keyboard input of a slice view.
import { AXES, PLANES, axisIndex, voxelIndex, voxelPosition } from "./volume_data.js";
import { sample } from "./measurements.js";
import { MARKS, MAX_POINTS } from "./view_state.js";

/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./view_state.js").Triple} Triple */
/** @typedef {{x: number, y: number}} Point */

const MIN_MARK_PIXELS = 3; // minimum size of a mark in pixels
const GRAB_PIXELS = 12; // pixels within which a point of interest is grabbed
const ARROW_STEPS = /** @type {Record<string, [number, number]>} */ ({
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
});

/** @param {SliceView} view */
export function addPointerHandlers(view) {
  const target = view.overlay;
  /** @type {Map<number, Point>} */
  const pointers = new Map();
  /** @type {((to: Point) => void) | null} */
  let drag = null;
  let { points } = view.stage.view;
  let before = view.stage.view;

  target.addEventListener("pointerdown", (event) => {
    if (event.button === 2) return; // opens the browser's context menu
    target.focus({ preventScroll: true });
    target.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, pointOf(event));
    if (pointers.size === 1) {
      before = view.stage.view;
      ({ points } = before);
    }
    else view.stage.store.change({ points }); // undo the effect of the first finger of a pinch
    drag = pointers.size === 2 ? startPinch(view, [...pointers.values()]) : startDrag(view, event);
    drag?.(pointOf(event));
    event.preventDefault();
  });
  target.addEventListener("pointermove", (event) => {
    const at = pointOf(event);
    reportValue(view, at);
    if (!pointers.has(event.pointerId)) return;
    pointers.set(event.pointerId, at);
    if (pointers.size === 2) updatePinch(view, drag, [...pointers.values()]);
    else drag?.(at);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    target.addEventListener(kind, (event) => {
      pointers.delete(/** @type {PointerEvent} */ (event).pointerId);
      if (drag) reportMark(view, before);
      drag = null;
    });
  }
  target.addEventListener("pointerleave", () => view.onHover(null));
  target.addEventListener("wheel", (event) => onWheel(view, event), { passive: false });
  target.addEventListener("keydown", (event) => onKey(view, event));
}

/** @param {MouseEvent} event @returns {Point} */
const pointOf = (event) => ({ x: event.offsetX, y: event.offsetY });

/** Return the drag action for the pressed button and keys. @param {SliceView} view @param {PointerEvent} event */
function startDrag(view, event) {
  const from = pointOf(event);
  if (event.button === 1 || event.altKey) return dragPan(view, from);
  if (event.shiftKey) return dragWindow(view, from);
  const { tool } = view.stage.view;
  if (tool === "point") return dragPoint(view, from);
  return tool === "crosshair" ? dragCrosshair(view) : dragMark(view, from, /** @type {"line" | "region" | "background"} */ (tool));
}

/** @param {SliceView} view */
function dragCrosshair(view) {
  return (/** @type {Point} */ to) => view.stage.store.change({ at: positionAt(view, to, view.stage.position) });
}

/** Return the 3-D position at a point of a view; the coordinate along the view is unchanged. @param {SliceView} view @param {Point} to @param {Triple} from */
function positionAt(view, to, from) {
  const [a, b] = view.toPosition(to.x, to.y);
  const [across, up] = PLANES[view.axis];
  const place = /** @type {Triple} */ ([...from]);
  for (const [axis, mm] of /** @type {const} */ ([[across, a], [up, b]])) {
    const ends = view.stage.ends(axis);
    place[axisIndex(axis)] = Math.min(Math.max(mm, ends[0]), ends[1]);
  }
  return place;
}

/** Drag a new or existing point of interest. @param {SliceView} view @param {Point} from */
function dragPoint(view, from) {
  const { stage } = view;
  const { points } = stage.view;
  const [across, up] = PLANES[view.axis];
  const grabbed = points.findIndex((one) => {
    const [x, y] = view.toPixels(one[axisIndex(across)], one[axisIndex(up)]);
    return Math.hypot(x - from.x, y - from.y) < GRAB_PIXELS;
  });
  if (grabbed < 0 && points.length === MAX_POINTS) return dragCrosshair(view);
  const n = grabbed >= 0 ? grabbed : stage.source.flat ? 0 : points.length;
  const start = points[grabbed] ?? stage.position;
  const [x, y] = grabbed < 0 ? [from.x, from.y] : view.toPixels(start[axisIndex(across)], start[axisIndex(up)]);
  return (/** @type {Point} */ to) => {
    const place = positionAt(view, { x: x + to.x - from.x, y: y + to.y - from.y }, start);
    stage.store.change({ points: [...points.slice(0, n), place, ...points.slice(n + 1)], at: place });
  };
}

/** @param {SliceView} view @param {Point} from @param {"line" | "region" | "background"} tool */
function dragMark(view, from, tool) {
  const start = view.toPosition(from.x, from.y);
  return (/** @type {Point} */ to) => {
    if (Math.hypot(to.x - from.x, to.y - from.y) < MIN_MARK_PIXELS) return;
    view.stage.store.change({ [tool]: { plane: view.axis, from: start, to: view.toPosition(to.x, to.y) } });
  };
}

/** Report the mark that a drag has changed. @param {SliceView} view @param {import("./view_state.js").View} before */
function reportMark({ stage }, before) {
  for (const tool of MARKS) if (stage.view[tool] && stage.view[tool] !== before[tool]) stage.onMark(tool);
}

/** Drag the window: to the right narrower, downwards lower. @param {SliceView} view @param {Point} from */
function dragWindow(view, from) {
  const [low, high] = view.stage.window;
  return (/** @type {Point} */ to) => {
    const width = (high - low) * 2 ** ((from.x - to.x) / 100);
    const middle = (low + high) / 2 + ((to.y - from.y) / 200) * (high - low);
    view.stage.store.change({ window: [middle - width / 2, middle + width / 2] });
  };
}

/** @param {SliceView} view @param {Point} from */
function dragPan(view, from) {
  const { centre, scale } = view.stage;
  return (/** @type {Point} */ to) => panBy(view, centre, (to.x - from.x) / scale, (to.y - from.y) / scale);
}

/** @param {SliceView} view @param {Triple} centre @param {number} right mm @param {number} down mm */
function panBy(view, centre, right, down) {
  const [across, up] = PLANES[view.axis];
  const moved = /** @type {Triple} */ ([...centre]);
  moved[axisIndex(across)] -= right;
  moved[axisIndex(up)] -= view.up ? -down : down;
  view.stage.store.change({ centre: moved });
}

/** @param {SliceView} view @param {Point[]} fingers */
function startPinch(view, [one, other]) {
  const { centre, scale, view: { zoom } } = view.stage;
  const startDistance = Math.hypot(other.x - one.x, other.y - one.y) || 1;
  const middle = { x: (one.x + other.x) / 2, y: (one.y + other.y) / 2 };
  return (/** @type {any} */ to) => {
    if (!to.apart) return;
    const wanted = clampZoom(zoom * (to.apart / startDistance));
    view.stage.store.change({ zoom: wanted });
    panBy(view, centreAfter(view.stage, centre, wanted / zoom), (to.x - middle.x) / scale, (to.y - middle.y) / scale);
  };
}

/** @param {SliceView} _view @param {((to: any) => void) | null} drag @param {Point[]} fingers */
function updatePinch(_view, drag, [one, other]) {
  drag?.({ x: (one.x + other.x) / 2, y: (one.y + other.y) / 2, apart: Math.hypot(other.x - one.x, other.y - one.y) });
}

/** @param {number} zoom */
export const clampZoom = (zoom) => Math.min(Math.max(zoom, 0.25), 64);

/** @param {SliceView} view @param {WheelEvent} event */
function onWheel(view, event) {
  event.preventDefault();
  if (event.ctrlKey || event.metaKey) zoomBy(view.stage, 2 ** (-event.deltaY / 300));
  else if (event.deltaY) stepSlice(view, Math.sign(event.deltaY));
}

/** Zoom all views around the crosshair, which keeps its place in each; at 1 and below everything is in the middle.
 *
 * @param {VolumeState} stage @param {number} factor
 */
export function zoomBy(stage, factor) {
  const zoom = clampZoom(stage.view.zoom * factor);
  stage.store.change({ zoom, centre: zoom > 1 ? centreAfter(stage, stage.centre, zoom / stage.view.zoom) : null });
}

/** Return the centre of the views after a zoom around the crosshair, within what is shown. @param {VolumeState} stage @param {Triple} centre @param {number} factor */
function centreAfter(stage, centre, factor) {
  return /** @type {Triple} */ (AXES.map((axis, n) => {
    const [first, last] = stage.shownEnds(axis);
    const place = stage.position[n];
    return Math.min(Math.max(place + (centre[n] - place) / factor, first), last);
  }));
}

/** Step to another slice; from the full projection, switch to the slice at the crosshair.
 *
 * @param {SliceView} view @param {number} by voxels
 */
export function stepSlice(view, by) {
  const { stage, axis } = view;
  const { source } = stage;
  if (source.flat) return;
  if (stage.view.slab[axisIndex(axis)] === Infinity) return toggleSlab(view);
  const place = /** @type {Triple} */ ([...stage.position]);
  const index = voxelIndex(source, axis, place[axisIndex(axis)]) + by;
  place[axisIndex(axis)] = voxelPosition(source, axis, Math.min(Math.max(index, 0), source.shape[axisIndex(axis)] - 1));
  stage.store.change({ at: place });
}

/** Toggle between the full projection and the slice at the crosshair. @param {SliceView} view */
export function toggleSlab(view) {
  const { stage, axis } = view;
  if (stage.source.flat) return;
  const slab = /** @type {Triple} */ ([...stage.view.slab]);
  slab[axisIndex(axis)] = slab[axisIndex(axis)] === Infinity ? 0 : Infinity;
  stage.store.change({ slab, at: stage.position });
}

/** @param {SliceView} view @param {KeyboardEvent} event */
function onKey(view, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const { stage } = view;
  const arrow = ARROW_STEPS[event.key];
  if (arrow) moveCrosshair(view, arrow, event.shiftKey ? 10 : 1);
  else if (event.key === "PageUp" || event.key === "PageDown") stepSlice(view, event.key === "PageUp" ? -1 : 1);
  else if (event.key === "+" || event.key === "=") zoomBy(stage, 1.25);
  else if (event.key === "-") zoomBy(stage, 0.8);
  else if (event.key === "0") stage.store.change({ zoom: 1, centre: null });
  else if (event.key === "m") toggleSlab(view);
  else return;
  event.preventDefault();
  event.stopPropagation();
}

/** Move the crosshair by voxels. @param {SliceView} view @param {[number, number]} way @param {number} by */
function moveCrosshair(view, [right, down], by) {
  const { stage } = view;
  const { source } = stage;
  const place = /** @type {Triple} */ ([...stage.position]);
  const [across, up] = PLANES[view.axis];
  for (const [axis, steps] of /** @type {const} */ ([[across, right * by], [up, (view.up ? -down : down) * by]])) {
    if (!steps) continue;
    const index = voxelIndex(source, axis, place[axisIndex(axis)]) + steps;
    place[axisIndex(axis)] = voxelPosition(source, axis, Math.min(Math.max(index, 0), source.shape[axisIndex(axis)] - 1));
  }
  stage.store.change({ at: place });
}

/** Report value and position at the cursor. @param {SliceView} view @param {Point} point */
function reportValue(view, point) {
  const [a, b] = view.toPosition(point.x, point.y);
  const plane = view.isReferenceShown && view.other ? view.other : view.plane;
  const value = plane ? sample(plane, a, b) : NaN;
  if (Number.isNaN(value)) return view.onHover(null);
  const [across, up] = PLANES[view.axis];
  const range = view.stage.range(view.axis);
  const slice = range.to - range.from === 1;
  /** @type {Partial<Record<import("./view_state.js").Axis, number | null>>} */
  const place = { [across]: a, [up]: b };
  place[view.axis] = slice ? voxelPosition(view.stage.source, view.axis, range.from) : null;
  const second = plane === view.plane && view.other && view.isOverlay ? sample(view.other, a, b) : null;
  const volumeName = !view.other || view.isOverlay ? "" : plane === view.other ? "the reference" : "this image";
  view.onHover({ value, second, place, whose: volumeName, view: view.element, low: point.y > view.height / 2 });
}
