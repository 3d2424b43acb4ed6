// @ts-check
// Layout of the views: heights by the shown extents, and one view enlarged to the whole.
import { h, replace, s } from "../dom.js";
import { addShortcut } from "../shortcuts.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {"x" | "y" | "z" | "3d"} ViewName */

const MIN_ROW_SHARE = 0.27; // of the height of the images, that either row of views has at least

/** Enlarge a view, or show all again. @param {VolumeState} stage @param {ViewName} name */
function toggleLarge(stage, name) {
  stage.store.change({ large: stage.large === name ? null : name });
}

/** Let a double click, a button and keys enlarge a view. @param {VolumeState} stage @param {ViewName} name @param {string} title @param {HTMLElement} pane */
export function addEnlarging(stage, name, title, pane) {
  const button = h("button", { type: "button", class: "quiet enlarge", dataset: { enlarge: name }, onclick: () => toggleLarge(stage, name) });
  pane.querySelector("header")?.append(button);
  pane.querySelector(".overlay")?.addEventListener("dblclick", () => toggleLarge(stage, name));
  pane.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(input|select|textarea)$/i.test(/** @type {HTMLElement} */ (event.target).tagName)) return;
    if (event.key === "f") toggleLarge(stage, name);
    else if (event.key === "Escape" && stage.large) stage.store.change({ large: null });
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
  const show = () => {
    const isLarge = stage.large === name;
    pane.hidden = stage.large !== null && !isLarge;
    replace(button, isLarge ? "All views" : s("svg", { viewBox: "0 0 16 16", width: 14, height: 14, "aria-hidden": "true" }, s("path", { d: "M9 2h5v5M14 2 9 7M7 14H2V9M2 14l5-5", fill: "none", stroke: "currentColor", "stroke-width": 1.6 })));
    button.classList.toggle("quiet", !isLarge);
    button.title = isLarge ? "Shortcut: f or Escape" : "Shortcut: f, or a double click on the image";
    button.setAttribute("aria-label", isLarge ? "Show all views" : `Enlarge the ${title} view`);
  };
  stage.store.on((_view, changed) => changed.has("large") && show());
  show();
  return pane;
}

/** Set the heights of the views and mark the root while a view is enlarged. @param {VolumeState} stage @param {HTMLElement} root @param {HTMLElement} views */
export function addLayout(stage, root, views) {
  const show = () => {
    root.classList.toggle("large", stage.large !== null);
    const [y, z] = [stage.extent("y"), stage.shownExtent("z")];
    const share = Math.min(Math.max(y / (y + z), MIN_ROW_SHARE), 1 - MIN_ROW_SHARE);
    views.style.setProperty("--first-share", share.toFixed(3));
    root.dataset.depths = stage.shownEnds("z").map((mm) => mm.toFixed(4)).join();
    views.style.setProperty("--second-share", (1 - share).toFixed(3));
  };
  stage.store.on((_view, changed) => (changed.has("large") || changed.has("depth")) && show());
  show();
  let last = /** @type {ViewName} */ (stage.source.flat ? "y" : "z");
  views.addEventListener("focusin", (event) => {
    const name = /** @type {HTMLElement} */ (event.target).closest(".pane")?.querySelector("[data-enlarge]")?.getAttribute("data-enlarge");
    if (name) last = /** @type {ViewName} */ (name);
  });
  addShortcut("f", "Enlarge the view, or show all views", () => toggleLarge(stage, stage.large ?? last));
  addShortcut("Escape", "Show all views", () => stage.store.change({ large: null }));
}
