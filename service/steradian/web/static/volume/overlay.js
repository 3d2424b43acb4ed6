// @ts-check
// Overlay of a slice: ticks in mm, crosshair, marks, scale bar.
import { decimalText, signed } from "../units.js";
import { PLANES, axisIndex } from "./volume_data.js";
import { MARKS } from "./view_state.js";
import { paintRamp, colourTable } from "./colours.js";
import { isPlaneShown } from "./measurement_details.js";
import { lengthOf, roundDown, ticks } from "./scale.js";

/** @typedef {import("./slice_view.js").SliceView} SliceView */
/** @typedef {[number, number]} Pair */

const LINE_COLOUR = "#ffffff";
const SHADOW = "rgb(0 0 0 / .75)";
const DEPTH_BAR_WIDTH = 110; // pixels of the depth colour bar
const CROSSHAIR_GAP = 7; // pixels around the crosshair that stay free
const MARK_COLOURS = { line: "#ffffff", region: "#7cc0ff", background: "#d0d6dd" };
const BAR_SHARES = { width: 0.25, height: 0.5 }; // of a view's width and of the height of its image, that the scale bar has at most
const LABEL_GAP = 8; // pixels between a measurement and its name, which the crosshair stays out of
const LEAST_TICKS = 3; // for which a vertical axis has room
const ELSEWHERE = 0.45; // opacity of measurements in other slices

/** @param {SliceView} view */
export function drawOverlay(view) {
  const ratio = devicePixelRatio || 1;
  const context = /** @type {CanvasRenderingContext2D} */ (view.overlay.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, view.width, view.height);
  context.font = "12px system-ui, sans-serif";
  drawTicks(context, view);
  drawCrosshair(context, view);
  drawMarks(context, view);
  const { stage } = view;
  drawScaleBar(context, stage.scale, view.width, view.height, stage.shownExtent(PLANES[view.axis][1]) * stage.scale);
}

/** Draw a path with a dark outline, so that it is visible on any colour.
 *
 * @param {CanvasRenderingContext2D} context @param {string} colour @param {number} width @param {() => void} path
 */
export function strokeOutlined(context, colour, width, path) {
  for (const [style, wide] of /** @type {[string, number][]} */ ([[SHADOW, width + 2], [colour, width]])) {
    context.beginPath();
    path();
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.stroke();
  }
}

/** @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y @param {string} [colour] */
export function drawLabel(context, text, x, y, colour = LINE_COLOUR) {
  context.strokeStyle = SHADOW;
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** @param {CanvasRenderingContext2D} context @param {SliceView} view */
function drawTicks(context, view) {
  const [across, up] = PLANES[view.axis];
  const [left, right] = [view.toPosition(0, 0)[0], view.toPosition(view.width, 0)[0]];
  const vertical = [view.toPosition(0, 0)[1], view.toPosition(0, view.height)[1]].sort((one, other) => one - other);
  const [x0, x1] = view.stage.shownEnds(across);
  const [y0, y1] = view.stage.shownEnds(up);
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const mm of ticks(Math.max(left, x0), Math.min(right, x1), view.width / 56)) {
    const [x] = view.toPixels(mm, 0);
    strokeOutlined(context, LINE_COLOUR, 1, () => { context.moveTo(x, 0); context.lineTo(x, 5); });
    if (x > 22 && x < view.width - 22) drawLabel(context, decimalText(mm), x, 7);
  }
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const mm of ticks(Math.max(vertical[0], y0), Math.min(vertical[1], y1), Math.max(view.height / 44, LEAST_TICKS))) {
    const [, y] = view.toPixels(0, mm);
    strokeOutlined(context, LINE_COLOUR, 1, () => { context.moveTo(0, y); context.lineTo(5, y); });
    if (y > 22 && y < view.height - 32) drawLabel(context, decimalText(mm), 11, y);
  }
  context.textBaseline = "bottom";
  drawLabel(context, `${across} → ${up} ${view.up ? "↑" : "↓"} mm`, 8, view.height - 9);
}

/** @param {CanvasRenderingContext2D} context @param {SliceView} view */
function drawCrosshair(context, view) {
  const [across, up] = PLANES[view.axis];
  const [x, y] = view.toPixels(view.stage.position[axisIndex(across)], view.stage.position[axisIndex(up)]);
  context.globalAlpha = 0.7;
  strokeOutlined(context, LINE_COLOUR, 1, () => {
    context.moveTo(0, y); context.lineTo(x - CROSSHAIR_GAP, y);
    context.moveTo(x + CROSSHAIR_GAP, y); context.lineTo(view.width, y);
    context.moveTo(x, 0); context.lineTo(x, y - CROSSHAIR_GAP);
    context.moveTo(x, y + CROSSHAIR_GAP); context.lineTo(x, view.height);
  });
  context.globalAlpha = 1;
}

/** @param {CanvasRenderingContext2D} context @param {SliceView} view */
function drawMarks(context, view) {
  for (const name of MARKS) {
    const mark = view.stage.view[name];
    if (mark?.plane === view.axis) drawMark(context, view, name, mark.from, mark.to);
  }
  drawMeasurements(context, view);
  drawPoints(context, view);
}

/** @param {CanvasRenderingContext2D} context @param {SliceView} view @param {"line" | "region" | "background"} kind @param {Pair} from @param {Pair} to mm @param {number} [width] */
function drawMark(context, view, kind, from, to, width = 2) {
  const [x0, y0] = view.toPixels(...from);
  const [x1, y1] = view.toPixels(...to);
  context.setLineDash(kind === "background" ? [5, 4] : []);
  strokeOutlined(context, MARK_COLOURS[kind], width, () => {
    if (kind === "line") { context.moveTo(x0, y0); context.lineTo(x1, y1); }
    else context.rect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
  });
  context.setLineDash([]);
}

/** Draw the measurements of the plane with their names. @param {CanvasRenderingContext2D} context @param {SliceView} view */
function drawMeasurements(context, view) {
  const { stage } = view;
  const inMm = (/** @type {Pair} */ place) => /** @type {Pair} */ (place.map((metres) => 1e3 * metres));
  for (const item of stage.measurements?.items ?? []) {
    const { kind, name, axis, start, end = start, background_start: from, background_end: to } = item.measurement;
    if (axis !== view.axis) continue;
    context.globalAlpha = isPlaneShown(stage, item) ? 1 : ELSEWHERE;
    const width = stage.measurements?.selectedName === name ? 3 : 1.5;
    const [x, y] = view.toPixels(...inMm(end));
    if (kind === "point") strokeOutlined(context, LINE_COLOUR, width, () => { context.moveTo(x - 5, y); context.lineTo(x + 5, y); context.moveTo(x, y - 5); context.lineTo(x, y + 5); });
    else drawMark(context, view, kind === "profile" ? "line" : "region", inMm(start), inMm(end), width);
    if (from && to) drawMark(context, view, "background", inMm(from), inMm(to), width);
    context.globalAlpha = 1;
    if (!isPlaneShown(stage, item) && stage.measurements?.selectedName !== name) continue; // its line is elsewhere
    const isRight = x > view.width / 2;
    context.textAlign = isRight ? "right" : "left";
    context.textBaseline = "bottom";
    drawLabel(context, name, x + (isRight ? -6 : 6), Math.max(y - LABEL_GAP, 14));
  }
}

/** Draw the numbered points of interest. @param {CanvasRenderingContext2D} context @param {SliceView} view */
function drawPoints(context, view) {
  const [across, up] = PLANES[view.axis];
  context.textAlign = "left";
  context.textBaseline = "middle";
  view.stage.view.points.forEach((place, n) => {
    const [x, y] = view.toPixels(place[axisIndex(across)], place[axisIndex(up)]);
    strokeOutlined(context, LINE_COLOUR, 2, () => context.arc(x, y, 8, 0, 2 * Math.PI));
    drawLabel(context, String(n + 1), x + 12, y);
  });
}

/** Draw the scale bar, which fits into the shorter side of the image.
 *
 * @param {CanvasRenderingContext2D} context @param {number} scale pixels a mm @param {number} width @param {number} height @param {number} [imageHeight] pixels
 */
export function drawScaleBar(context, scale, width, height, imageHeight = height) {
  const mm = roundDown(Math.min(BAR_SHARES.width * width, BAR_SHARES.height * Math.min(height, imageHeight)) / scale);
  const [right, y] = [width - 12, height - 12];
  strokeOutlined(context, LINE_COLOUR, 3, () => { context.moveTo(right - mm * scale, y); context.lineTo(right, y); });
  context.textAlign = "right";
  context.textBaseline = "bottom";
  drawLabel(context, lengthOf(mm), right, y - 5);
}

/** Draw the colour bar of depths. @param {CanvasRenderingContext2D} context @param {Pair} depths in mm @param {number} height */
export function drawDepthBar(context, depths, height) {
  const pixels = new ImageData(DEPTH_BAR_WIDTH, 1);
  paintRamp(colourTable("depth"), depths, depths, new Uint32Array(pixels.data.buffer));
  const ramp = new OffscreenCanvas(DEPTH_BAR_WIDTH, 1);
  /** @type {OffscreenCanvasRenderingContext2D} */ (ramp.getContext("2d")).putImageData(pixels, 0, 0);
  const [left, y] = [12, height - 16];
  strokeOutlined(context, LINE_COLOUR, 1, () => context.rect(left, y, DEPTH_BAR_WIDTH, 6));
  context.drawImage(ramp, left, y, DEPTH_BAR_WIDTH, 6);
  context.textAlign = "left";
  context.textBaseline = "bottom";
  drawLabel(context, `depth ${depths.map((mm) => signed(mm, 1)).join(" to ")} mm`, left, y - 4);
}
