// @ts-check
// Plot of one A-line with the full scale of the digitiser, or of its spectrum.
import { oncePerFrame, h, replace } from "../dom.js";
import { coordinates, drawAxes, drawCurve, drawLevel, openSurface } from "../plot_axes.js";
import { colour, onTheme } from "../theme.js";
import { count, figure, frequency, percent } from "../units.js";
import { spectrum } from "./spectrum.js";

const MIN_LEVEL = -60; // dB

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
    const surface = openSurface(this.canvas);
    if (!surface) return;
    const { context, width, height } = surface;
    if (!this.line) {
      context.fillStyle = colour("--dim");
      context.textAlign = "center";
      context.fillText("No A-line yet", width / 2, height / 2);
      return;
    }
    const plot = this.isSpectrum ? this.spectrumPlot(this.line) : this.timePlot(this.line);
    const { values, from, to } = plot;
    const places = Float64Array.from(values, (_, n) => from + ((to - from) * n) / Math.max(1, values.length - 1));
    drawAxes(surface, plot);
    for (const value of plot.marks) drawLevel(surface, plot, value, colour("--fault"));
    drawCurve(surface, plot, places, values, colour("--accent"));
    if (plot.full !== null) drawSaturated(surface, plot, places, values, plot.full);
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

/**
 * Mark the samples at or above the full scale.
 * @param {import("../plot_axes.js").Surface} surface @param {import("../plot_axes.js").Range} range
 * @param {ArrayLike<number>} places @param {ArrayLike<number>} values @param {number} full
 */
function drawSaturated(surface, range, places, values, full) {
  const { x, y } = coordinates(surface, range);
  surface.context.fillStyle = colour("--fault");
  for (let n = 0; n < values.length; n++) if (Math.abs(values[n]) >= full) surface.context.fillRect(x(places[n]) - 1.5, y(values[n]) - 1.5, 3, 3);
}
