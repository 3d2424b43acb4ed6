// @ts-check
// Design view: form, preview by the service, and the button that stores mask, plan and scan.
import { api, idempotencyHeaders, Problem } from "../api.js";
import { onScanners } from "../status_bar.js";
import { byId, h, replace, debounce } from "../dom.js";
import { startScan } from "../scan/create.js";
import { ScannerChoice } from "../scan/scanner_choice.js";
import { errorElements } from "../panel_states.js";
import { arrangementOf, requestedCount, previewBody, formFieldOf, fromQuery, otherPoints, planBody, toQuery } from "./fields.js";
import { keyFigures, pointsText } from "./key_figures.js";
import { DesignForm } from "./form.js";
import { solidAnglePanel, orientationPanel, pointSpreadPanel, timePanel } from "./panels.js";
import { budgetPanel } from "./budget.js";
import { pinButton } from "./pinned_designs.js";
import { MaskMap } from "./mask_map.js";
import { Outcome, Retry } from "./outcome.js";
import { undersampleControls } from "./undersample.js";
import { isStaged } from "./stage_fields.js";
import { count } from "../units.js";
import { urlOf } from "../urls.js";

/** @typedef {import("./form.js").Remark} Remark */

const design = fromQuery(new URLSearchParams(location.search));
const host = byId("design");
const panel = (/** @type {string} */ name) => h("section", { class: `panel ${name}`, "data-steradian": `design-${name}` });
const [formPanel, planePanel, spread, orientation, angle, time] = ["form", "plane", "spread", "orientation", "angle", "time"].map(panel);
const figures = h("dl", { class: "figures across" });
const messages = h("div", { class: "remarks", role: "alert" });
const scanButton = h("button", { type: "button", class: "primary", id: "scan-this", disabled: true, onclick: () => void submitScan() }, "Scan this (laser on)");
const label = h("input", { type: "text", maxlength: 200, placeholder: "e.g. yarn phantom", "aria-label": "Name of the sample", class: "short", value: design.label, oninput: () => { design.label = label.value; writeQuery(); } });
const followCheckbox = h("input", { type: "checkbox", id: "watch", checked: true });
const scannerChoice = new ScannerChoice();
const undersampling = undersampleControls(design, messages);
const otherPlaceCheckbox = h("input", { type: "checkbox", id: "elsewhere", checked: design.look !== null, onchange: () => toggleOtherPlace() });

replace(host,
  formPanel,
  h("div", { class: "middle" }, planePanel, time),
  h("div", { class: "beside", tabindex: 0, role: "group", "aria-label": "Image quality at the point" }, spread, orientation, angle),
  h("footer", { class: "panel foot" }, figures, h("div", { class: "row" }, messages, ...(design.through ? undersampling.elements : [label, scannerChoice.host, h("label", { class: "row", for: "watch" }, followCheckbox, "Live image"), scanButton]))));

onScanners((first, all) => first && scannerChoice.show(all));
const form = new DesignForm(h("div", { class: "scrolled" }), design, onDesignChanged);
formPanel.append(form.host, form.help);
const maskMap = new MaskMap(planePanel, (place, over) => {
  if (design.look) design.look = [place[0], place[1], design.look[2]];
  else [design.mask.x, design.mask.y] = place;
  form.refresh();
  onDesignChanged();
  if (over) writeQuery();
});
maskMap.controls.append(
  h("label", { class: "row", for: "elsewhere", title: "Drag to evaluate a point other than the mask's point of interest" }, otherPlaceCheckbox, "Evaluate another point"),
  pinButton(/** @type {HTMLElement} */ (host.parentElement), design, writeQuery));
const budget = budgetPanel(/** @type {HTMLElement} */ (host.parentElement), design, () => {
  form.refresh();
  onDesignChanged();
});
maskMap.pointMap.aperture = design.mask.aperture;
const outcome = new Outcome(host, planePanel);
outcome.set("stale");
let version = 0; // of the design; an answer for an earlier version is shown as such
const panels = { spread: pointSpreadPanel(spread), orientation: orientationPanel(orientation), angle: solidAnglePanel(angle), time: timePanel(time) };

function toggleOtherPlace() {
  design.look = otherPlaceCheckbox.checked ? [design.mask.x, design.mask.y, design.mask.depth] : null;
  onDesignChanged();
}

function writeQuery() {
  history.replaceState(null, "", `?${toQuery(design)}`);
}

const writeQuerySoon = debounce(writeQuery, 300);

/** Return a function that runs one task at a time and repeats it for the newest design. */
function latestOnly(/** @type {() => Promise<void>} */ task) {
  let [isBusy, isDue] = [false, false];
  return async function run() {
    isDue = true;
    if (isBusy) return;
    isBusy = true;
    while (isDue) {
      isDue = false;
      await task();
    }
    isBusy = false;
  };
}

const requestPreview = latestOnly(async () => {
  const requested = version;
  const busyTimer = setTimeout(() => replace(messages, h("span", { class: "dim" }, "computing …")), 400);
  try {
    const preview = await api.post("/designs/preview", previewBody(design));
    clearTimeout(busyTimer);
    retry.reset();
    show(preview);
    if (requested !== version) {
      scanButton.disabled = true;
      undersampling.enable(false);
      outcome.wait();
    }
    requestPointSpreadSoon();
  } catch (error) {
    clearTimeout(busyTimer);
    replace(messages);
    if (requested === version) showProblem(error);
  }
});
const requestPointSpread = latestOnly(async () => {
  const requested = version;
  panels.spread.working();
  try {
    const { sound_speed } = design.plan;
    const preview = await api.post("/designs/point-spread", { arrangement: arrangementOf(design), point: design.look, sound_speed });
    panels.spread.show(preview, isStaged(design.stages));
    if (requested !== version) panels.spread.working();
  } catch (error) {
    if (requested === version) panels.spread.failed(error, () => void requestPointSpread());
  }
});
const requestPointSpreadSoon = debounce(() => void requestPointSpread(), 350);
const retry = new Retry(() => void requestPreview());

function onDesignChanged() {
  version += 1;
  budget.refresh();
  scanButton.disabled = true;
  undersampling.enable(false);
  outcome.wait();
  panels.spread.working();
  retry.reset();
  writeQuerySoon();
  void requestPreview();
}

/** @param {any} preview */
function show(preview) {
  outcome.set("current");
  const point = design.look ?? preview.mask.point_of_interest;
  maskMap.show(preview, point ? [point[0], point[1]] : [0, 0], otherPoints(design), countNote(preview));
  panels.orientation.show(preview, point);
  panels.angle.show(preview, point);
  panels.time.show(preview);
  const remarks = (preview.plan.findings ?? []).map((/** @type {any} */ one) => ({ name: one.field, severity: one.severity, text: `${one.message}; ${one.allowed}` }));
  const fault = form.remark(remarks);
  scanButton.disabled = fault !== null;
  showBlockingError(fault);
  replace(figures, keyFigures(preview).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
}

/** Return the note on the number of points, if it is not the requested one. @param {any} preview */
function countNote(preview) {
  const requested = requestedCount(design);
  if (preview.stages.length > 1) return `survey, then focus: ${pointsText(preview)} points`;
  return requested === null || requested === preview.mask.count ? "" : `${count(preview.mask.count)} points; requested: ${count(requested)}`;
}

/** Show the refused fields, or an error that is not one of the form; the request is then repeated. @param {unknown} error */
function showProblem(error) {
  if (error instanceof Problem && error.errors.length) {
    const fault = form.remark(error.errors.map(({ pointer, detail, allowed }) => ({ name: formFieldOf(pointer), severity: "error", text: allowed ? `allowed: ${allowed}` : detail })));
    outcome.set("refused", fault?.label ? `${fault.label}: ${fault.text.replace(/^allowed: /, "allowed ")}` : (fault?.text ?? error.detail));
    showBlockingError(fault);
    return;
  }
  outcome.set("stale");
  replace(messages, ...errorElements(error), h("button", { type: "button", onclick: () => void requestPreview() }, "Try again"));
  retry.later();
}

/** Show the blocking error next to the button, with a link to its field. @param {ReturnType<DesignForm["remark"]>} fault */
function showBlockingError(fault) {
  undersampling.enable(host.dataset.outcome === "current"); // a plan that the scanner cannot run does not concern it
  replace(messages, fault && h("button", { type: "button", class: "fault", title: fault.text, onclick: fault.show }, `${fault.label || "Field"}: not allowed`));
}

/** Store mask and plan, create the scan and open its page. */
async function submitScan() {
  scanButton.disabled = true;
  replace(messages, h("span", { class: "dim" }, "storing mask and plan …"));
  try {
    const on = scannerChoice.request;
    const mask = await api.post("/masks", arrangementOf(design));
    const plan = await api.post("/plans", { ...planBody(design), mask_id: mask.id });
    const createdScan = await startScan({ plan_id: plan.id, ...on, labels: design.label.trim() ? { sample: design.label.trim() } : {} });
    const follow = { scan_id: createdScan.id, follow: true, interval: 1 };
    if (followCheckbox.checked) await api.post("/reconstructions", follow, { headers: idempotencyHeaders() }).catch(() => null); // the scan page offers it again; an error here would lead to a second scan
    location.assign(urlOf(`/scans/${createdScan.id}`));
  } catch (error) {
    replace(messages, ...errorElements(error));
    scanButton.disabled = false;
  }
}

onDesignChanged();
