// @ts-check
// Design: a form, what the service says of it, and one button that stores anything.
import { api, onceOnly, Problem } from "../api.js";
import { watchScanner } from "../status_bar.js";
import { byId, h, replace, settled } from "../dom.js";
import { startScan } from "../scan/create.js";
import { WhichScanner } from "../scan/scanner_choice.js";
import { words } from "../panel_states.js";
import { arrangementOf, askedFor, bodyOf, fieldOf, fromQuery, othersOf, planOf, toQuery } from "./fields.js";
import { figuresOf } from "./key_figures.js";
import { Form } from "./form.js";
import { anglePanel, orientationPanel, spreadPanel, timePanel } from "./panels.js";
import { pinning } from "./pinned_designs.js";
import { DesignPlane } from "./mask_map.js";
import { at } from "../urls.js";

/** @typedef {import("./form.js").Remark} Remark */

const design = fromQuery(new URLSearchParams(location.search));
const host = byId("design");
const panel = (/** @type {string} */ name) => h("section", { class: `panel ${name}`, "data-steradian": `design-${name}` });
const [formPanel, planePanel, spread, orientation, angle, time] = ["form", "plane", "spread", "orientation", "angle", "time"].map(panel);
const figures = h("dl", { class: "figures across" });
const said = h("div", { class: "remarks", role: "alert" });
const scan = h("button", { type: "button", class: "primary", id: "scan-this", disabled: true, onclick: () => void scanThis() }, "Scan this");
const label = h("input", { type: "text", maxlength: 200, placeholder: "e.g. yarn phantom", "aria-label": "Name of the sample", class: "short", value: design.label, oninput: () => { design.label = label.value; note(); } });
const watch = h("input", { type: "checkbox", id: "watch", checked: true });
const which = new WhichScanner();
const elsewhere = h("input", { type: "checkbox", id: "elsewhere", checked: design.look !== null, onchange: () => look() });

replace(host,
  formPanel,
  h("div", { class: "middle" }, planePanel, time),
  h("div", { class: "beside", tabindex: 0, role: "group", "aria-label": "What the point sees" }, spread, orientation, angle),
  h("footer", { class: "panel foot" }, figures, h("div", { class: "row" }, said, label, which.host, h("label", { class: "row", for: "watch" }, watch, "Follow with an image"), scan)));

watchScanner((first, all) => first && which.show(all));
const form = new Form(h("div", { class: "scrolled" }), design, changed);
formPanel.append(form.host, form.help);
const plane = new DesignPlane(planePanel, (place, over) => {
  if (design.look) design.look = [place[0], place[1], design.look[2]];
  else [design.mask.x, design.mask.y] = place;
  form.refresh();
  changed();
  if (over) note();
});
plane.controls.append(
  h("label", { class: "row", for: "elsewhere", title: "Drag to see what another place than the mask's point of interest would" }, elsewhere, "Look from another place"),
  pinning(/** @type {HTMLElement} */ (host.parentElement), design, note));
plane.plane.aperture = design.mask.aperture;
const panels = { spread: spreadPanel(spread), orientation: orientationPanel(orientation), angle: anglePanel(angle), time: timePanel(time) };

function look() {
  design.look = elsewhere.checked ? [design.mask.x, design.mask.y, design.mask.depth] : null;
  changed();
}

function note() {
  history.replaceState(null, "", `?${toQuery(design)}`);
}

const noteSoon = settled(note, 300);

/** One question at a time, always about the newest design: a drag asks for more than can be answered. */
function latest(/** @type {(isOld: () => boolean) => Promise<void>} */ ask) {
  let [busy, due] = [false, false];
  return async function again() {
    due = true;
    if (busy) return;
    busy = true;
    while (due) {
      due = false;
      await ask(() => due);
    }
    busy = false;
  };
}

const askDesign = latest(async (isOld) => {
  const patience = setTimeout(() => replace(said, h("span", { class: "dim" }, "working it out …")), 400);
  try {
    const seen = await api.post("/designs/preview", bodyOf(design));
    clearTimeout(patience);
    show(seen);
    if (isOld()) scan.disabled = true; // what would be scanned is another design by now
    askSpreadSoon();
  } catch (error) {
    clearTimeout(patience);
    replace(said);
    refuse(error);
  }
});
const askSpread = latest(async () => {
  panels.spread.working();
  try {
    const { sound_speed } = design.plan;
    panels.spread.show(await api.post("/designs/point-spread", { arrangement: arrangementOf(design), point: design.look, sound_speed }));
  } catch (error) {
    panels.spread.failed(error);
  }
});
const askSpreadSoon = settled(() => void askSpread(), 350);

function changed() {
  scan.disabled = true;
  noteSoon();
  void askDesign();
}

/** @param {any} seen */
function show(seen) {
  const point = design.look ?? seen.mask.point_of_interest;
  plane.show(seen, point ? [point[0], point[1]] : [0, 0], othersOf(design), askedFor(design));
  panels.orientation.show(seen, point);
  panels.angle.show(seen, point);
  panels.time.show(seen.plan);
  const remarks = (seen.plan.findings ?? []).map((/** @type {any} */ one) => ({ name: one.field, severity: one.severity, text: `${one.message}; ${one.allowed}` }));
  const fault = form.remark(remarks);
  scan.disabled = fault !== null;
  hinder(fault);
  replace(figures, figuresOf(seen).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
}

/** @param {unknown} error */
function refuse(error) {
  if (!(error instanceof Problem) || !error.errors.length) {
    replace(said, ...words(error));
    return;
  }
  hinder(form.remark(error.errors.map(({ pointer, detail, allowed }) => ({ name: fieldOf(pointer), severity: "error", text: allowed ? `allowed: ${allowed}` : detail }))));
}

/** Say beside the button why it does nothing, and lead there. @param {ReturnType<Form["remark"]>} fault */
function hinder(fault) {
  replace(said, fault && h("button", { type: "button", class: "fault", title: fault.text, onclick: fault.show }, `${fault.label || "See"}: not allowed`));
}

/** Keep mask and plan, ask for the scan, and go where it can be seen. */
async function scanThis() {
  scan.disabled = true;
  replace(said, h("span", { class: "dim" }, "storing mask and plan …"));
  try {
    const on = which.wish;
    const mask = await api.post("/masks", arrangementOf(design));
    const plan = await api.post("/plans", { ...planOf(design), mask_id: mask.id });
    const made = await startScan({ plan_id: plan.id, ...on, labels: design.label.trim() ? { sample: design.label.trim() } : {} });
    const follow = { scan_id: made.id, follow: true, interval: 1 };
    if (watch.checked) await api.post("/reconstructions", follow, { headers: onceOnly() }).catch(() => null); // its page offers it again; here would be a second scan
    location.assign(at(`/scans/${made.id}`));
  } catch (error) {
    replace(said, ...words(error));
    scan.disabled = false;
  }
}

changed();
