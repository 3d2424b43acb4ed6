// @ts-check
// Pinned designs, shown next to the current one with the same figures.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { PointMap } from "../point_map.js";
import { showLoading, errorElements } from "../panel_states.js";
import { colour } from "../theme.js";
import { ARRANGEMENTS, arrangementOf, previewBody, fromQuery, MAX_PINS, toQuery } from "./fields.js";
import { keyFigures } from "./key_figures.js";
import { paintSection, pointSpreadText } from "./panels.js";

/** @typedef {import("./fields.js").Design} Design */

/**
 * Create the pin button and the panel of pinned designs.
 * @param {HTMLElement} host @param {Design} design @param {() => void} changed
 */
export function pinButton(host, design, changed) {
  const button = h("button", { type: "button", title: "Keep this design visible for comparison with the next", "aria-label": "Pin this design", onclick: () => pin() }, "Pin");
  const cards = h("div", { class: "pins" });
  const panel = h("section", { class: "panel", "data-steradian": "design-pins", "aria-label": "Pinned designs" }, h("h2", null, "Pinned"), cards);
  host.append(panel);

  function pin() {
    const text = toQuery({ ...design, pins: [] }).toString();
    design.pins = [...design.pins.filter((one) => one !== text), text].slice(-MAX_PINS);
    cardsByQuery.delete(text); // an equal query may belong to another tuning map
    show();
    changed();
    panel.scrollIntoView({ block: "nearest" });
  }

  /** @type {Map<string, HTMLElement>} */
  const cardsByQuery = new Map();
  function show() {
    for (const text of design.pins) if (!cardsByQuery.has(text)) cardsByQuery.set(text, createCard(text, unpin, design.map));
    replace(cards, design.pins.map((text) => cardsByQuery.get(text)));
    panel.hidden = !design.pins.length;
  }

  /** @param {string} text */
  function unpin(text) {
    design.pins = design.pins.filter((one) => one !== text);
    show();
    changed();
    button.focus();
  }

  show();
  return button;
}

/** @param {string} text the query of a design @param {(text: string) => void} unpin @param {Design["map"]} map */
function createCard(text, unpin, map) {
  const design = { ...fromQuery(new URLSearchParams(text)), map };
  const name = [ARRANGEMENTS[design.arrangement].label, design.label].filter(Boolean).join(", ");
  const body = h("div", { class: "pin-body" });
  const element = h("article", { class: "pin", dataset: { pin: text } },
    h("div", { class: "row spread" }, h("h3", null, name), h("span", { class: "row" },
      h("a", { class: "button", href: `/design?${text}` }, "Edit this design"),
      h("button", { type: "button", "aria-label": `Unpin ${name}`, onclick: () => unpin(text) }, "Unpin"))),
    body);
  showLoading(body, "computing …");
  void fillCard(body, design);
  return element;
}

/** @param {HTMLElement} body @param {Design} design */
async function fillCard(body, design) {
  try {
    const spreadRequest = { arrangement: arrangementOf(design), point: design.look, sound_speed: design.plan.sound_speed };
    const [preview, spread] = await Promise.all([api.post("/designs/preview", previewBody(design)), api.post("/designs/point-spread", spreadRequest).catch(() => null)]);
    const stage = h("div", { class: "stage" });
    const ball = spread ? [["Point spread", pointSpreadText(spread)]] : [];
    replace(body, stage, spread ? h("div", { class: "picture" }, paintSection(spread)) : null,
      h("dl", { class: "figures" }, [...keyFigures(preview), ...ball].map(([title, value]) => [h("dt", null, title), h("dd", null, value)]).flat()));
    const plane = new PointMap(stage, "Points of the mask on the film");
    plane.palette = [colour("--accent")];
    plane.classes = new Uint8Array(preview.positions.length);
    plane.show(preview.positions.map((/** @type {number[]} */ [x, y = 0]) => [x, y]), preview.mask.aperture);
  } catch (error) {
    replace(body, h("div", { class: "state failed" }, ...errorElements(error)));
  }
}
