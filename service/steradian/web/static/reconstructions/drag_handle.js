// @ts-check
// A row's handle: mouse, pen or finger put the row elsewhere in its table, and so do the arrow keys.
import { h } from "../dom.js";

const MARKS = ["is-moving", "drop-above", "drop-below"];

/**
 * @param {string} id of the row, as in its data-row
 * @param {() => HTMLElement[]} rows those among which it may be put, in their order
 * @param {(place: number) => void} put called with its new place
 * @param {(is: boolean) => void} hold called when it is taken and when it is let go: no row may change meanwhile
 */
export function handle(id, rows, put, hold) {
  const button = h("button", {
    type: "button", class: "quiet grip", "aria-label": `Move: ${id}`, "aria-keyshortcuts": "ArrowUp ArrowDown",
    title: "Drag to its place in the queue, or move it with the arrow keys", dataset: { key: `move ${id}` },
  }, "\u2807");
  const own = () => rows().findIndex((row) => row.dataset.row === id);
  let place = -1; // while it is held

  /** @param {number} height of the pointer in the window */
  function over(height) {
    const others = rows().filter((row) => row.dataset.row !== id);
    place = others.filter((row) => middle(row) < height).length;
    clear();
    rows()[own()]?.classList.add("is-moving");
    if (place < others.length) others[place].classList.add("drop-above");
    else others[place - 1]?.classList.add("drop-below");
  }

  function clear() {
    for (const row of rows()) row.classList.remove(...MARKS);
  }

  /** @param {boolean} is whether it stays where it is now */
  function drop(is) {
    if (place < 0) return;
    const [wanted, before] = [place, own()];
    place = -1;
    clear();
    hold(false);
    if (is && wanted !== before && before >= 0) put(wanted);
  }

  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    hold(true);
    over(event.clientY);
  });
  button.addEventListener("pointermove", (event) => place >= 0 && over(event.clientY));
  button.addEventListener("pointerup", () => drop(true));
  for (const name of ["pointercancel", "lostpointercapture", "blur"]) button.addEventListener(name, () => drop(false));
  button.addEventListener("keydown", (event) => {
    if (event.key === "Escape") drop(false);
    const way = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!way) return;
    event.preventDefault();
    const next = own() + way;
    if (place < 0 && next >= 0 && next < rows().length) put(next);
  });
  return button;
}

/** @param {HTMLElement} row */
function middle(row) {
  const { top, height } = row.getBoundingClientRect();
  return top + height / 2;
}
