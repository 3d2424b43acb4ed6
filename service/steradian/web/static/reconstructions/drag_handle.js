// @ts-check
// Drag handle of a table row, for pointer and arrow keys.
import { h } from "../dom.js";

const MARK_CLASSES = ["is-moving", "drop-above", "drop-below"];

/**
 * @param {string} id of the row, as in its data-row
 * @param {() => HTMLElement[]} rows those among which it may be put, in their order
 * @param {(place: number) => void} moveTo called with its new place
 * @param {(isConfirmed: boolean) => void} setHeld called when it is taken and when it is let go: no row may change meanwhile
 */
export function createDragHandle(id, rows, moveTo, setHeld) {
  const button = h("button", {
    type: "button", class: "quiet grip", "aria-label": `Move: ${id}`, "aria-keyshortcuts": "ArrowUp ArrowDown",
    title: "Drag to change the position in the queue, or use the arrow keys", dataset: { key: `move ${id}` },
  }, "\u2807");
  const rowIndex = () => rows().findIndex((row) => row.dataset.row === id);
  let place = -1; // target index during a drag, otherwise −1

  /** @param {number} height of the pointer in the window */
  function updateTarget(height) {
    const otherRows = rows().filter((row) => row.dataset.row !== id);
    place = otherRows.filter((row) => middle(row) < height).length;
    clear();
    rows()[rowIndex()]?.classList.add("is-moving");
    if (place < otherRows.length) otherRows[place].classList.add("drop-above");
    else otherRows[place - 1]?.classList.add("drop-below");
  }

  function clear() {
    for (const row of rows()) row.classList.remove(...MARK_CLASSES);
  }

  /** @param {boolean} isConfirmed whether it stays where it is now */
  function endDrag(isConfirmed) {
    if (place < 0) return;
    const [target, before] = [place, rowIndex()];
    place = -1;
    clear();
    setHeld(false);
    if (isConfirmed && target !== before && before >= 0) moveTo(target);
  }

  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    setHeld(true);
    updateTarget(event.clientY);
  });
  button.addEventListener("pointermove", (event) => place >= 0 && updateTarget(event.clientY));
  button.addEventListener("pointerup", () => endDrag(true));
  for (const name of ["pointercancel", "lostpointercapture", "blur"]) button.addEventListener(name, () => endDrag(false));
  button.addEventListener("keydown", (event) => {
    if (event.key === "Escape") endDrag(false);
    const direction = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!direction) return;
    event.preventDefault();
    const next = rowIndex() + direction;
    if (place < 0 && next >= 0 && next < rows().length) moveTo(next);
  });
  return button;
}

/** @param {HTMLElement} row */
function middle(row) {
  const { top, height } = row.getBoundingClientRect();
  return top + height / 2;
}
