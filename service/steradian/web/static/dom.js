// @ts-check
// DOM helpers. Children are inserted as text, never as markup, because labels are arbitrary user input.
import { urlOf } from "./urls.js";

/** @typedef {Node | string | number | false | null | undefined} Child */
/** @typedef {Record<string, any>} Props */

/**
 * Create an HTML element.
 *
 * `on…` functions are event listeners, `dataset` and `style` are objects, `value`, `checked` and `disabled` are
 * properties; `class` and other names are attributes. Null, undefined and false are omitted. An `href` is a path of
 * this service, see {@link urlOf}.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Props | null} [props]
 * @param {...(Child | Child[])} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function h(tag, props, ...children) {
  return /** @type {HTMLElementTagNameMap[T]} */ (fill(document.createElement(tag), props, children));
}

/**
 * Create an SVG element.
 * @template {keyof SVGElementTagNameMap} T
 * @param {T} tag
 * @param {Props | null} [props]
 * @param {...(Child | Child[])} children
 * @returns {SVGElementTagNameMap[T]}
 */
export function s(tag, props, ...children) {
  const svgElement = document.createElementNS("http://www.w3.org/2000/svg", tag);
  return /** @type {SVGElementTagNameMap[T]} */ (fill(svgElement, props, children));
}

const PROPERTIES = new Set(["value", "checked", "disabled", "hidden", "open", "multiple", "selected"]);

/**
 * @param {HTMLElement | SVGElement} element
 * @param {Props | null | undefined} props
 * @param {(Child | Child[])[]} children
 */
function fill(element, props, children) {
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "dataset") Object.assign(element.dataset, value);
    else if (name === "style") for (const [key, one] of Object.entries(value)) element.style.setProperty(key, String(one));
    else if (PROPERTIES.has(name)) /** @type {any} */ (element)[name] = value;
    else element.setAttribute(name, value === true ? "" : name === "href" ? urlOf(String(value)) : String(value));
  }
  append(element, ...children);
  return element;
}

/**
 * Append children to an element; skip null and false.
 * @param {Element} element
 * @param {...(Child | Child[])} children
 */
export function append(element, ...children) {
  for (const child of children.flat()) {
    if (child === null || child === undefined || child === false) continue;
    element.append(child instanceof Node ? child : String(child));
  }
}

/**
 * Replace all children of an element.
 * @param {Element} element
 * @param {...(Child | Child[])} children
 */
export function replace(element, ...children) {
  element.replaceChildren();
  append(element, ...children);
}

/**
 * Replace all children of an element and restore the focus to the control of the same name.
 * @param {Element} element
 * @param {...(Child | Child[])} children
 * @returns {boolean} false where the focus is lost
 */
export function replaceKeepingFocus(element, ...children) {
  const focusedName = element.contains(document.activeElement) ? controlName(document.activeElement) : null;
  replace(element, ...children);
  if (focusedName === null) return true;
  const match = /** @type {HTMLElement[]} */ ([...element.querySelectorAll("button:enabled, a")]).find((one) => controlName(one) === focusedName);
  match?.focus({ preventScroll: true });
  return match !== undefined;
}

/** Return the name of a control. @param {Element | null} control */
const controlName = (control) => control?.getAttribute("aria-label") ?? control?.getAttribute("href") ?? control?.textContent ?? null;

/**
 * Return an element of the page shell; throw if it does not exist.
 * @param {string} id
 * @returns {HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/**
 * Return a function that calls `draw` once before the next frame, however often it is called.
 * @param {() => void} draw
 * @returns {() => void}
 */
export function oncePerFrame(draw) {
  let frameRequest = 0;
  return () => {
    if (frameRequest) return;
    frameRequest = requestAnimationFrame(() => {
      frameRequest = 0;
      draw();
    });
  };
}

/**
 * Return a function that calls `act` after `milliseconds` without a further call.
 * @param {() => void} act
 * @param {number} milliseconds
 * @returns {() => void}
 */
export function debounce(act, milliseconds) {
  let timer = 0;
  return () => {
    clearTimeout(timer);
    timer = setTimeout(act, milliseconds);
  };
}

/**
 * Copy a text to the clipboard and show the result on the button. Browsers do not allow this on pages loaded by plain
 * HTTP from another machine.
 * @param {HTMLElement} button @param {string} text @param {string} [done]
 */
export async function copyText(button, text, done = "copied") {
  const before = (button.dataset.before ??= button.textContent ?? "");
  const isCopied = navigator.clipboard ? await navigator.clipboard.writeText(text).then(() => true, () => false) : false;
  button.textContent = isCopied ? done : "copying not allowed";
  setTimeout(() => (button.textContent = before), 1500);
}

/** Return the last part of the page's path: the identifier of its resource. */
export function pathIdentifier() {
  return decodeURIComponent(location.pathname.split("/").pop() ?? "");
}

/**
 * Open a dialog that leaves the emergency stop usable: a modal dialog of the browser would block the stop for mouse
 * and touch.
 * @param {HTMLDialogElement} dialog gone when it is closed
 */
export function openDialog(dialog) {
  const before = document.activeElement;
  const background = /** @type {HTMLElement[]} */ ([...document.querySelectorAll("body > nav, body > main, body > .skip, dialog[open]")]);
  const shade = h("div", { class: "shade" });
  for (const one of background) one.inert = true;
  const escape = (/** @type {KeyboardEvent} */ event) => {
    if (event.key === "Escape") dialog.close();
  };
  dialog.addEventListener("close", () => {
    document.removeEventListener("keydown", escape);
    shade.remove();
    dialog.remove();
    for (const one of background) one.inert = false;
    if (before instanceof HTMLElement) before.focus();
  });
  document.addEventListener("keydown", escape);
  document.body.append(shade, dialog);
  dialog.setAttribute("aria-modal", "true");
  dialog.show();
  if (!dialog.contains(document.activeElement)) /** @type {HTMLElement | null} */ (dialog.querySelector("input, button"))?.focus();
}
