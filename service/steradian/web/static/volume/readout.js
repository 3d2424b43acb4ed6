// @ts-check
// Readout of position and value under the cursor, beside it in the view; breaks into lines where there is little room.
import { h } from "../dom.js";
import { AXES } from "./volume_data.js";
import { formatMm } from "./panes.js";

/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {{value: number, second: number | null, place: Partial<Record<Axis, number | null>>, whose: string, view: HTMLElement, low: boolean}} Hovered
 *   second: value of the reference that is laid over the image; whose: volume of the value, where two are shown; low: whether the cursor is in the lower half of the view */

/** Create the readout; the returned function shows it, or hides it if null.
 *
 * @param {import("./volume_state.js").VolumeState} stage
 * @returns {(hovered: Hovered | null) => void}
 */
export function createReadout(stage) {
  const element = h("output", { class: "cursor", dataset: { cursor: "" }, "aria-live": "off" });
  return (hovered) => {
    element.hidden = !hovered;
    if (!hovered) return;
    if (element.parentElement !== hovered.view) hovered.view.append(element);
    element.classList.toggle("above", hovered.low);
    element.textContent = positionText(hovered, stage);
  };
}

/** @param {Hovered} hovered @param {import("./volume_state.js").VolumeState} stage */
function positionText({ value, second, place, whose }, stage) {
  const coordinates = AXES.flatMap((axis) => {
    const mm = place[axis]; // none along a maximum
    return mm === null || mm === undefined || (stage.source.flat && axis === "y") ? [] : `${axis} ${formatMm(mm)}`;
  });
  return `${coordinates.join(", ")} mm: ${stage.valueText(value, 4)}${whose ? ` in ${whose}` : ""}${second === null ? "" : `; ${stage.valueText(second, 4)} in ${stage.referenceName}`}`;
}
