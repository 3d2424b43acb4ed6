// @ts-check
// Interactive charts with axes, drawn by BokehJS, which is loaded with the first chart.
import { h, replace } from "./dom.js";
import { colour, onTheme } from "./theme.js";
import { palette } from "./palette.js";
import { urlOf } from "./urls.js";

/** @type {Promise<any> | null} */
let loaded = null;

/** Load BokehJS from the service. @returns {Promise<any>} */
export function loadBokeh() {
  loaded ??= load("bokeh.min.js").then(() => load("bokeh-api.min.js")).then(() => /** @type {any} */ (window).Bokeh).catch((error) => {
    loaded = null; // allow another attempt
    throw error;
  });
  return loaded;
}

/** @param {string} name @returns {Promise<void>} */
function load(name) {
  return new Promise((done, fail) => {
    const script = document.createElement("script");
    script.src = urlOf(`/static/bokeh/${name}`);
    script.onload = () => done();
    script.onerror = () => fail(new Error(`${name} could not be loaded`));
    document.head.append(script);
  });
}

/**
 * Create a figure in the colours of the page.
 * @param {any} Bokeh @param {{x: string, y: string}} labels with units
 */
export function figure(Bokeh, labels) {
  const bokehFigure = Bokeh.Plotting.figure({
    sizing_mode: "stretch_both", tools: "pan,wheel_zoom,box_zoom,reset,hover", toolbar_location: "above",
    x_axis_label: labels.x, y_axis_label: labels.y, background_fill_color: colour("--panel"), border_fill_color: colour("--panel"), outline_line_color: colour("--line"),
  });
  bokehFigure.toolbar.logo = null;
  for (const axis of [...bokehFigure.xaxis, ...bokehFigure.yaxis]) {
    for (const part of ["axis_label_text_color", "major_label_text_color"]) axis[part] = colour("--dim");
    for (const part of ["axis_line_color", "major_tick_line_color", "minor_tick_line_color"]) axis[part] = colour("--edge");
    axis.axis_label_text_font_style = "normal";
  }
  for (const grid of [...bokehFigure.xgrid, ...bokehFigure.ygrid]) grid.grid_line_color = colour("--line");
  return bokehFigure;
}

/** Create the legend entry of a line: a button that shows or hides the line. @param {string} name @param {string} tint @param {any} glyph */
function legendOf(name, tint, glyph) {
  const button = h("button", { type: "button", class: "quiet", "aria-pressed": "true" }, h("span", { class: "swatch", style: { background: tint } }), name);
  button.addEventListener("click", () => {
    glyph.visible = !glyph.visible;
    button.setAttribute("aria-pressed", String(glyph.visible));
  });
  return button;
}

/** Current draw function of each host element. @type {WeakMap<HTMLElement, () => Promise<void>>} */
const redraws = new WeakMap();

/**
 * Draw lines in place of earlier ones; redraw when the theme changes.
 * @param {HTMLElement} host
 * @param {{name: string, x: number[], y: number[]}[]} lines
 * @param {{x: string, y: string}} labels
 */
export async function line(host, lines, labels) {
  const Bokeh = await loadBokeh();
  const draw = async () => {
    const bokehFigure = figure(Bokeh, labels);
    const colours = palette("cividis", lines.length);
    const glyph = lines.map(({ x, y }, n) => bokehFigure.line(x, y, { color: colours[n], line_width: 1.3 }));
    const plot = h("div", { class: "plot" });
    replace(host, plot, h("div", { class: "legend", role: "group", "aria-label": "Lines" }, lines.map(({ name }, n) => legendOf(name, colours[n], glyph[n]))));
    await Bokeh.Plotting.show(bokehFigure, plot);
  };
  if (!redraws.has(host)) onTheme(() => void redraws.get(host)?.());
  redraws.set(host, draw);
  await draw();
}
