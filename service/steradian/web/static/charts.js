// @ts-check
// Charts with axes that one can move about in, by BokehJS, which is loaded when the first one is drawn.
import { h, replace } from "./dom.js";
import { colour, onTheme } from "./theme.js";
import { shades } from "./palette.js";
import { at } from "./urls.js";

/** @type {Promise<any> | null} */
let loaded = null;

/** BokehJS, from the service's own wheel. @returns {Promise<any>} */
export function bokeh() {
  loaded ??= load("bokeh.min.js").then(() => load("bokeh-api.min.js")).then(() => /** @type {any} */ (window).Bokeh).catch((error) => {
    loaded = null; // to be tried again
    throw error;
  });
  return loaded;
}

/** @param {string} name @returns {Promise<void>} */
function load(name) {
  return new Promise((done, fail) => {
    const script = document.createElement("script");
    script.src = at(`/static/bokeh/${name}`);
    script.onload = () => done();
    script.onerror = () => fail(new Error(`${name} could not be loaded`));
    document.head.append(script);
  });
}

/**
 * A figure in the page's colours.
 * @param {any} Bokeh @param {{x: string, y: string}} labels with units
 */
export function figure(Bokeh, labels) {
  const made = Bokeh.Plotting.figure({
    sizing_mode: "stretch_both", tools: "pan,wheel_zoom,box_zoom,reset,hover", toolbar_location: "above",
    x_axis_label: labels.x, y_axis_label: labels.y, background_fill_color: colour("--panel"), border_fill_color: colour("--panel"), outline_line_color: colour("--line"),
  });
  made.toolbar.logo = null;
  for (const axis of [...made.xaxis, ...made.yaxis]) {
    for (const part of ["axis_label_text_color", "major_label_text_color"]) axis[part] = colour("--dim");
    for (const part of ["axis_line_color", "major_tick_line_color", "minor_tick_line_color"]) axis[part] = colour("--edge");
    axis.axis_label_text_font_style = "normal";
  }
  for (const grid of [...made.xgrid, ...made.ygrid]) grid.grid_line_color = colour("--line");
  return made;
}

/** A line's name and colour, beneath the chart so that it covers none; it shows the line or not. @param {string} name @param {string} tint @param {any} drawn */
function legendOf(name, tint, drawn) {
  const button = h("button", { type: "button", class: "quiet", "aria-pressed": "true" }, h("span", { class: "swatch", style: { background: tint } }), name);
  button.addEventListener("click", () => {
    drawn.visible = !drawn.visible;
    button.setAttribute("aria-pressed", String(drawn.visible));
  });
  return button;
}

/** What each place shows now. @type {WeakMap<HTMLElement, () => Promise<void>>} */
const shown = new WeakMap();

/**
 * Draw lines, again whenever the theme changes; in place of those that were there.
 * @param {HTMLElement} host
 * @param {{name: string, x: number[], y: number[]}[]} lines
 * @param {{x: string, y: string}} labels
 */
export async function line(host, lines, labels) {
  const Bokeh = await bokeh();
  const draw = async () => {
    const made = figure(Bokeh, labels);
    const colours = shades("cividis", lines.length);
    const drawn = lines.map(({ x, y }, n) => made.line(x, y, { color: colours[n], line_width: 1.3 }));
    const plot = h("div", { class: "plot" });
    replace(host, plot, h("div", { class: "legend", role: "group", "aria-label": "Lines" }, lines.map(({ name }, n) => legendOf(name, colours[n], drawn[n]))));
    await Bokeh.Plotting.show(made, plot);
  };
  if (!shown.has(host)) onTheme(() => void shown.get(host)?.());
  shown.set(host, draw);
  await draw();
}
