// @ts-check
// Plot of one A-line with the full scale of the digitiser, or of its spectrum.
import { oncePerFrame, h, replace } from "../dom.js";
import { colour, onTheme } from "../theme.js";
import { count, figure, frequency, percent } from "../units.js";
import { ticks } from "../volume/scale.js";
import { spectrum } from "./spectrum.js";

const MARGIN = { left: 96, right: 16, top: 8, bottom: 38 };
const MIN_LEVEL = -60; // dB
const MAX_TICKS = 5;

/** @typedef {{samples: ArrayLike<number>, interval: number, zero: number, full: number | null, point: number, title: string}} Line samples in counts, seconds */

export class AlinePlot {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.title = h("span", { class: "dim" });
    this.timeButton = this.createButton("A-line", false);
    this.spectrumButton = this.createButton("Spectrum", true);
    this.followButton = h("button", { type: "button", hidden: true }, "Show the newest");
    this.canvas = h("canvas", { role: "img", "aria-label": "A-line", style: { width: "100%", height: "100%" } });
    const stage = h("div", { class: "strip" }, this.canvas);
    host.append(h("div", { class: "row spread" }, h("div", { class: "row" }, this.timeButton, this.spectrumButton, this.followButton), this.title), stage);
    this.isSpectrum = false;
    this.etag = ""; // of the newest A-line, while it is shown
    /** @type {Line | null} */
    this.line = null;
    this.draw = oncePerFrame(() => this._draw());
    new ResizeObserver(() => this.draw()).observe(stage);
    onTheme(this.draw);
  }

  /** @param {string} text @param {boolean} isSpectrum */
  createButton(text, isSpectrum) {
    const act = () => {
      this.isSpectrum = isSpectrum;
      this.timeButton.setAttribute("aria-pressed", String(!isSpectrum));
      this.spectrumButton.setAttribute("aria-pressed", String(isSpectrum));
      this.draw();
    };
    return h("button", { type: "button", "aria-pressed": String(!isSpectrum), onclick: act }, text);
  }

  /** @param {Line} line */
  show(line) {
    this.line = line;
    this.draw();
  }

  _draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.scale(ratio, ratio);
    context.font = "12px system-ui, sans-serif";
    if (!this.line) {
      context.fillStyle = colour("--dim");
      context.textAlign = "center";
      context.fillText("No A-line yet", width / 2, height / 2);
      return;
    }
    const plot = this.isSpectrum ? this.spectrumPlot(this.line) : this.timePlot(this.line);
    drawAxes(context, width, height, plot);
    drawCurve(context, width, height, plot);
  }

  /** @param {Line} line */
  timePlot({ samples, interval, zero, full, title }) {
    let peakValue = 0;
    let clipped = 0;
    for (let n = 0; n < samples.length; n++) {
      peakValue = Math.max(peakValue, Math.abs(samples[n]));
      if (full !== null && Math.abs(samples[n]) >= full) clipped += 1;
    }
    const limit = full === null ? peakValue || 1 : Math.max(1.1 * peakValue, 1);
    replace(this.title, `${title}: ${full === null ? `peak ${figure(peakValue)}` : `peak ${percent(peakValue / full)} of full scale`}`, clipped ? h("strong", { class: "fault" }, ` ${count(clipped)} samples saturated`) : null);
    const last = zero + (samples.length - 1) * interval;
    const [factor, unit] = last >= 1e-3 ? [1e3, "ms"] : [1e6, "µs"];
    return {
      values: samples, from: zero * factor, to: last * factor, low: -limit, high: limit,
      across: `time after the laser pulse (${unit})`, along: full === null ? "as recorded" : "counts",
      marks: full !== null && full <= limit ? [full, -full] : [], full,
    };
  }

  /** @param {Line} line */
  spectrumPlot({ samples, interval, title }) {
    const { levels, step, peak } = spectrum(samples, interval);
    replace(this.title, `${title}: maximum at ${frequency(peak)}`);
    return { values: levels, from: 0, to: (step * (levels.length - 1)) / 1e6, low: MIN_LEVEL, high: 0, across: "frequency (MHz)", along: "level (dB)", marks: [], full: null };
  }
}

/** @typedef {{values: ArrayLike<number>, from: number, to: number, low: number, high: number, across: string, along: string, marks: number[], full: number | null}} Plot */

/** @param {number} width @param {number} height @param {Plot} plot */
function coordinates(width, height, { values, low, high }) {
  const plotWidth = width - MARGIN.left - MARGIN.right;
  const plotHeight = height - MARGIN.top - MARGIN.bottom;
  return {
    x: (/** @type {number} */ n) => MARGIN.left + (plotWidth * n) / Math.max(1, values.length - 1),
    y: (/** @type {number} */ value) => MARGIN.top + (plotHeight * (high - Math.min(high, Math.max(low, value)))) / (high - low),
    wide: plotWidth,
  };
}

/** @param {CanvasRenderingContext2D} context @param {number} width @param {number} height @param {Plot} plot */
function drawAxes(context, width, height, plot) {
  const { y, wide: plotWidth } = coordinates(width, height, plot);
  context.strokeStyle = colour("--line");
  context.fillStyle = colour("--dim");
  context.lineWidth = 1;
  context.textAlign = "right";
  for (const value of ticks(plot.low, plot.high, MAX_TICKS)) {
    context.beginPath();
    context.moveTo(MARGIN.left, y(value));
    context.lineTo(width - MARGIN.right, y(value));
    context.stroke();
    context.fillText(figure(value, 2), MARGIN.left - 6, y(value) + 4);
  }
  context.strokeStyle = colour("--fault");
  for (const value of plot.marks) {
    context.beginPath();
    context.moveTo(MARGIN.left, y(value));
    context.lineTo(width - MARGIN.right, y(value));
    context.stroke();
  }
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((one) => ((plot.to - plot.from) / one) * 70 < plotWidth) ?? 1000;
  context.textAlign = "center";
  for (let at = Math.ceil(plot.from / step) * step; at <= plot.to; at += step) {
    const x = MARGIN.left + (plotWidth * (at - plot.from)) / (plot.to - plot.from);
    context.fillText(figure(Number(at.toPrecision(4))), x, height - MARGIN.bottom + 15);
  }
  context.fillText(plot.across, MARGIN.left + plotWidth / 2, height - 6);
  context.save();
  context.translate(14, (MARGIN.top + height - MARGIN.bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(plot.along, 0, 0);
  context.restore();
}

/** @param {CanvasRenderingContext2D} context @param {number} width @param {number} height @param {Plot} plot */
function drawCurve(context, width, height, plot) {
  const { x, y } = coordinates(width, height, plot);
  context.strokeStyle = colour("--accent");
  context.lineWidth = 1.2;
  context.beginPath();
  for (let n = 0; n < plot.values.length; n++) context.lineTo(x(n), y(plot.values[n]));
  context.stroke();
  const { full } = plot;
  if (full === null) return;
  context.fillStyle = colour("--fault");
  for (let n = 0; n < plot.values.length; n++) if (Math.abs(plot.values[n]) >= full) context.fillRect(x(n) - 1.5, y(plot.values[n]) - 1.5, 3, 3);
}
