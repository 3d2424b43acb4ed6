// @ts-check
// Designs that are kept in sight beside the one that is worked on: the same pictures and figures of each.
import { api } from "../api.js";
import { h, replace } from "../dom.js";
import { Plane } from "../point_map.js";
import { loading, words } from "../panel_states.js";
import { colour } from "../theme.js";
import { ARRANGEMENTS, arrangementOf, bodyOf, fromQuery, MOST_PINS, toQuery } from "./fields.js";
import { figuresOf } from "./key_figures.js";
import { paint, sizeOf } from "./panels.js";

/** @typedef {import("./fields.js").Design} Design */

/**
 * Show the pinned designs of a design, and pin it itself.
 * @param {HTMLElement} host @param {Design} design @param {() => void} changed
 */
export function pinning(host, design, changed) {
  const button = h("button", { type: "button", title: "Keep this design in sight, to compare the next one with it", "aria-label": "Pin this design", onclick: () => pin() }, "Pin");
  const cards = h("div", { class: "pins" });
  const panel = h("section", { class: "panel", "data-steradian": "design-pins", "aria-label": "Pinned designs" }, h("h2", null, "Pinned"), cards);
  host.append(panel);

  function pin() {
    const text = toQuery({ ...design, pins: [] }).toString();
    design.pins = [...design.pins.filter((one) => one !== text), text].slice(-MOST_PINS);
    made.delete(text); // the same words may be of another tuning map by now
    show();
    changed();
    panel.scrollIntoView({ block: "nearest" });
  }

  /** @type {Map<string, HTMLElement>} */
  const made = new Map();
  function show() {
    for (const text of design.pins) if (!made.has(text)) made.set(text, card(text, unpin, design.map));
    replace(cards, design.pins.map((text) => made.get(text)));
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
function card(text, unpin, map) {
  const design = { ...fromQuery(new URLSearchParams(text)), map };
  const name = [ARRANGEMENTS[design.arrangement].label, design.label].filter(Boolean).join(", ");
  const body = h("div", { class: "pin-body" });
  const made = h("article", { class: "pin", dataset: { pin: text } },
    h("div", { class: "row spread" }, h("h3", null, name), h("span", { class: "row" },
      h("a", { class: "button", href: `/design?${text}` }, "Work on it"),
      h("button", { type: "button", "aria-label": `Unpin ${name}`, onclick: () => unpin(text) }, "Unpin"))),
    body);
  loading(body, "working it out …");
  void fill(body, design);
  return made;
}

/** @param {HTMLElement} body @param {Design} design */
async function fill(body, design) {
  try {
    const asked = { arrangement: arrangementOf(design), point: design.look, sound_speed: design.plan.sound_speed };
    const [seen, spread] = await Promise.all([api.post("/designs/preview", bodyOf(design)), api.post("/designs/point-spread", asked).catch(() => null)]);
    const stage = h("div", { class: "stage" });
    const ball = spread ? [["Point spread", sizeOf(spread)]] : [];
    replace(body, stage, spread ? h("div", { class: "picture" }, paint(spread)) : null,
      h("dl", { class: "figures" }, [...figuresOf(seen), ...ball].map(([title, value]) => [h("dt", null, title), h("dd", null, value)]).flat()));
    const plane = new Plane(stage, "The points of the mask on the film");
    plane.palette = [colour("--accent")];
    plane.classes = new Uint8Array(seen.positions.length);
    plane.show(seen.positions.map((/** @type {number[]} */ [x, y = 0]) => [x, y]), seen.mask.aperture);
  } catch (error) {
    replace(body, h("div", { class: "state failed" }, ...words(error)));
  }
}
