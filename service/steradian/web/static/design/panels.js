// @ts-check
// Panels of a design: point spread, visible orientations, solid angles and scan time.
import { oncePerFrame, h, replace, s } from "../dom.js";
import { showError, showLoading } from "../panel_states.js";
import { duration, length, mm, percent, signed } from "../units.js";
import { colourTable } from "../volume/colours.js";
import { timeText } from "./key_figures.js";
import { extent } from "./mask_map.js";

const READING = "Full widths at half maximum. A sphere that is blurred sideways reads less than its diameter in depth, down to 0.71 of it: its cross-section shrinks above and below its centre.";

/** Create the panel with the point spread: the x–z section through the image of a small sphere. @param {HTMLElement} host */
export function pointSpreadPanel(host) {
  const title = h("p", { class: "dim caption", title: READING });
  const body = h("div", { class: "picture" });
  replace(host, h("h2", null, "Image of a sphere"), body, title);
  showLoading(body, "simulating a sphere …");
  return {
    working: () => body.classList.add("stale"),
    /** @param {unknown} error @param {() => void} retryAction */
    failed(error, retryAction) {
      body.classList.remove("stale");
      showError(body, error, retryAction);
      title.textContent = "";
    },
    /** @param {any} preview @param {boolean} isStaged whether the place is known only after a survey */
    show(preview, isStaged) {
      body.classList.remove("stale");
      replace(body, paintSection(preview), axisLabels(preview));
      title.textContent = `${isStaged ? "With all points around this place: " : ""}${pointSpreadText(preview)}`;
    },
  };
}

/** @param {any} preview of a ball's image */
export function pointSpreadText(preview) {
  const width = preview.lateral === null ? "wider than shown" : `${length(preview.lateral)} wide`;
  const height = preview.axial === null ? "deeper than shown" : `${length(preview.axial)} deep`;
  return `Sphere of ${length(preview.true_width)} reads ${width}, ${height}; background ${percent(preview.background, 1)}`;
}

/** @param {any} preview @returns {HTMLCanvasElement} */
export function paintSection({ x, z, section }) {
  const canvas = h("canvas", { width: x.length, height: z.length, role: "img", "aria-label": "Image of a sphere, x to the right, z down" });
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const image = context.createImageData(x.length, z.length);
  const pixels = new Uint32Array(image.data.buffer);
  const colours = colourTable("inferno");
  for (let i = 0; i < x.length; i++) {
    for (let k = 0; k < z.length; k++) {
      pixels[k * x.length + i] = colours[Math.round(255 * Math.min(1, Math.max(0, section[i][k])))]; // the maximum is 1
    }
  }
  context.putImageData(image, 0, 0);
  const [width, depth] = [x[x.length - 1] - x[0], z[z.length - 1] - z[0]];
  canvas.style.aspectRatio = `${width} / ${depth}`;
  return canvas;
}

/** @param {number[]} places in metres */
const span = (places) => `${signed(1e3 * places[0], 1)} to ${mm(places[places.length - 1], 1)}`;

/** @param {any} preview */
function axisLabels({ x, z }) {
  return h("span", { class: "axes dim", title: "Colour scale: 0 to maximum" }, `x → ${span(x)}, z ↓ ${span(z)}`);
}

/** Create the polar plot of the visible edge normals at the point. @param {HTMLElement} host */
export function orientationPanel(host) {
  const title = h("p", { class: "dim caption" });
  const plot = s("svg", { viewBox: "-110 -110 220 220", role: "img", "aria-label": "Visible orientations of edges" });
  replace(host, h("h2", null, "Visible orientations"), plot, title);
  return {
    /** @param {any} preview @param {[number, number, number] | null} point */
    show(preview, point) {
      if (!point || preview.visible_share === null) {
        replace(plot);
        title.textContent = "This mask has no point of interest.";
        return;
      }
      const polar = (/** @type {number[]} */ [x, y = 0]) => {
        const tilt = Math.atan2(Math.hypot(x - point[0], y - point[1]), point[2]);
        const azimuth = Math.atan2(y - point[1], x - point[0]);
        const radius = (100 * tilt) / (Math.PI / 2);
        return `${(radius * Math.cos(azimuth)).toFixed(1)},${(-radius * Math.sin(azimuth)).toFixed(1)}`;
      };
      const edge = preview.outline && preview.outline[0].length === 2 ? densify(preview.outline).map(polar).join(" ") : "";
      const step = Math.max(1, Math.ceil(preview.positions.length / 800));
      const dots = preview.positions.filter((/** @type {any} */ _, /** @type {number} */ n) => n % step === 0).map((/** @type {number[]} */ one) => `M${polar(one)}h0`).join("");
      replace(plot,
        [30, 60, 90].map((angle) => s("circle", { r: (100 * angle) / 90, class: "ring" })),
        edge ? s("polygon", { points: edge, class: "seen" }) : null,
        s("path", { d: dots, class: "dots" }),
        [30, 60, 90].map((angle) => s("text", { x: 3, y: -(100 * angle) / 90 + 12, class: "tick over" }, `${angle}°`)));
      title.textContent = `${percent(preview.visible_share)} visible. Centre: edges parallel to the film; rim: perpendicular`;
    },
  };
}

/** Subdivide the edges of a polygon, so that they appear curved in the polar plot. @param {number[][]} corners */
function densify(corners) {
  return corners.flatMap((from, n) => {
    const next = corners[(n + 1) % corners.length];
    return Array.from({ length: 12 }, (_, k) => from.map((one, axis) => one + ((next[axis] - one) * k) / 12));
  });
}

/** Create the plot of solid angle against distance: constant for an even mask. @param {HTMLElement} host */
export function solidAnglePanel(host) {
  const title = h("p", { class: "dim caption" });
  const plot = s("svg", { viewBox: "0 0 240 120", role: "img", "aria-label": "Solid angle of each point against its distance" });
  replace(host, h("h2", null, "Solid angle per point"), plot, title);
  return {
    /** @param {any} preview @param {[number, number, number] | null} point */
    show(preview, point) {
      if (!point || !preview.solid_angles) {
        replace(plot);
        title.textContent = "This mask has no point of interest.";
        return;
      }
      const angles = /** @type {number[]} */ (preview.solid_angles);
      const mean = angles.reduce((sum, one) => sum + one, 0) / angles.length;
      const distances = preview.positions.map((/** @type {number[]} */ [x, y = 0]) => Math.hypot(x - point[0], y - point[1]));
      const [, maxDistance] = extent(distances);
      const top = Math.max(2, Math.min(4, extent(angles)[1] / mean));
      const step = Math.max(1, Math.ceil(distances.length / 1500));
      const up = (/** @type {number} */ value) => 98 - (92 * Math.min(top, value)) / top;
      let dots = "";
      for (let n = 0; n < distances.length; n += step) dots += `M${(34 + (200 * distances[n]) / maxDistance).toFixed(1)},${up(angles[n] / mean).toFixed(1)}h0`;
      replace(plot,
        s("path", { d: `M34,${up(1)}H236`, class: "ring" }), s("path", { d: "M34,4V98H236", class: "axis" }),
        s("text", { x: 30, y: up(1) + 4, class: "tick end" }, "mean"), s("text", { x: 30, y: 102, class: "tick end" }, "0"),
        s("text", { x: 236, y: 114, class: "tick end" }, `${mm(maxDistance, 1)} from the point`),
        s("path", { d: dots, class: "dots" }));
      const even = preview.mask.evenness;
      title.textContent = even === null ? "" : `standard deviation ${percent(even, 1)} of the mean, without the rim`;
    },
  };
}

/** Create the bar chart of the scan time; the parts overlap, so each has its own bar. @param {HTMLElement} host */
export function timePanel(host) {
  const draw = (/** @type {any} */ { plan, stages }) => {
    const parts = Object.entries(plan.seconds ?? {}).filter(([, seconds]) => Number(seconds) > 0);
    const total = plan.total_seconds ?? 0;
    replace(host, ...bars(parts, total, timeText(plan, stages), plan.limiting, plan.averages ?? 1));
  };
  let preview = /** @type {any} */ (null);
  const redraw = oncePerFrame(() => preview && draw(preview));
  return { show: (/** @type {any} */ one) => ((preview = one), redraw()) };
}

const TIME_PARTS = /** @type {Record<string, [string, string]>} */ ({
  laser: ["laser", "increase the pulse rate or reduce the averages"],
  mover: ["motion and settling", "change the scan order or use a faster scanner"],
  tuning: ["retuning", "scan in bands of bias wavelength"],
  gate: ["waiting for the gate", "measure more points per gate"],
  link: ["data link", "reduce the samples or use a faster link"],
  disk: ["disk", "reduce the samples"],
});

/** @param {[string, any][]} parts @param {number} total @param {string} text @param {string | null} limiting @param {number} averages */
function* bars(parts, total, text, limiting, averages) {
  const [limitingLabel, advice] = limiting ? TIME_PARTS[limiting] ?? [limiting, ""] : [];
  const help = limiting === "laser" && averages <= 1 ? "increase the pulse rate" : advice;
  yield h("p", { class: "caption" }, h("strong", null, `Scan time ${text}`), limitingLabel ? `, limited by: ${limitingLabel}; ${help}.` : "");
  const scaleSeconds = Math.max(total, ...parts.map(([, seconds]) => Number(seconds)));
  for (const [name, seconds] of parts) {
    const [label] = TIME_PARTS[name] ?? [name];
    yield h("div", { class: `part ${name === limiting ? "limiting" : ""}` },
      h("span", null, label),
      h("span", { class: "track" }, h("span", { class: "fill", style: { width: `${Math.max(0.3, (100 * Number(seconds)) / scaleSeconds)}%` } })),
      h("span", { class: "number" }, duration(Number(seconds))));
  }
}
