// @ts-check
// Design view: form, preview by the service, and the button that stores mask, plan and scan.
import { api, idempotencyHeaders, Problem } from "../api.js";
import { onScanners } from "../status_bar.js";
import { byId, h, replace, debounce } from "../dom.js";
import { startScan } from "../scan/create.js";
import { ScannerChoice } from "../scan/scanner_choice.js";
import { errorElements } from "../panel_states.js";
import { arrangementOf, requestedCount, previewBody, formFieldOf, fromQuery, otherPoints, planBody, toQuery } from "./fields.js";
import { keyFigures } from "./key_figures.js";
import { DesignForm } from "./form.js";
import { solidAnglePanel, orientationPanel, pointSpreadPanel, timePanel } from "./panels.js";
import { pinButton } from "./pinned_designs.js";
import { MaskMap } from "./mask_map.js";
import { urlOf } from "../urls.js";

/** @typedef {import("./form.js").Remark} Remark */

const design = fromQuery(new URLSearchParams(location.search));
const host = byId("design");
const panel = (/** @type {string} */ name) => h("section", { class: `panel ${name}`, "data-steradian": `design-${name}` });
const [formPanel, planePanel, spread, orientation, angle, time] = ["form", "plane", "spread", "orientation", "angle", "time"].map(panel);
const figures = h("dl", { class: "figures across" });
const messages = h("div", { class: "remarks", role: "alert" });
const scanButton = h("button", { type: "button", class: "primary", id: "scan-this", disabled: true, onclick: () => void submitScan() }, "Scan this");
const label = h("input", { type: "text", maxlength: 200, placeholder: "e.g. yarn phantom", "aria-label": "Name of the sample", class: "short", value: design.label, oninput: () => { design.label = label.value; writeQuery(); } });
const followCheckbox = h("input", { type: "checkbox", id: "watch", checked: true });
const scannerChoice = new ScannerChoice();
const otherPlaceCheckbox = h("input", { type: "checkbox", id: "elsewhere", checked: design.look !== null, onchange: () => toggleOtherPlace() });

replace(host,
  formPanel,
  h("div", { class: "middle" }, planePanel, time),
  h("div", { class: "beside", tabindex: 0, role: "group", "aria-label": "Image quality at the point" }, spread, orientation, angle),
  h("footer", { class: "panel foot" }, figures, h("div", { class: "row" }, messages, label, scannerChoice.host, h("label", { class: "row", for: "watch" }, followCheckbox, "Show a live image"), scanButton)));

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
maskMap.pointMap.aperture = design.mask.aperture;
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
function latestOnly(/** @type {(isOld: () => boolean) => Promise<void>} */ task) {
  let [isBusy, isDue] = [false, false];
  return async function run() {
    isDue = true;
    if (isBusy) return;
    isBusy = true;
    while (isDue) {
      isDue = false;
      await task(() => isDue);
    }
    isBusy = false;
  };
}

const requestPreview = latestOnly(async (isOld) => {
  const busyTimer = setTimeout(() => replace(messages, h("span", { class: "dim" }, "computing …")), 400);
  try {
    const preview = await api.post("/designs/preview", previewBody(design));
    clearTimeout(busyTimer);
    show(preview);
    if (isOld()) scanButton.disabled = true; // the design has changed meanwhile
    requestPointSpreadSoon();
  } catch (error) {
    clearTimeout(busyTimer);
    replace(messages);
    showProblem(error);
  }
});
const requestPointSpread = latestOnly(async () => {
  panels.spread.working();
  try {
    const { sound_speed } = design.plan;
    panels.spread.show(await api.post("/designs/point-spread", { arrangement: arrangementOf(design), point: design.look, sound_speed }));
  } catch (error) {
    panels.spread.failed(error);
  }
});
const requestPointSpreadSoon = debounce(() => void requestPointSpread(), 350);

function onDesignChanged() {
  scanButton.disabled = true;
  writeQuerySoon();
  void requestPreview();
}

/** @param {any} preview */
function show(preview) {
  const point = design.look ?? preview.mask.point_of_interest;
  maskMap.show(preview, point ? [point[0], point[1]] : [0, 0], otherPoints(design), requestedCount(design));
  panels.orientation.show(preview, point);
  panels.angle.show(preview, point);
  panels.time.show(preview.plan);
  const remarks = (preview.plan.findings ?? []).map((/** @type {any} */ one) => ({ name: one.field, severity: one.severity, text: `${one.message}; ${one.allowed}` }));
  const fault = form.remark(remarks);
  scanButton.disabled = fault !== null;
  showBlockingError(fault);
  replace(figures, keyFigures(preview).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
}

/** @param {unknown} error */
function showProblem(error) {
  if (!(error instanceof Problem) || !error.errors.length) {
    replace(messages, ...errorElements(error));
    return;
  }
  showBlockingError(form.remark(error.errors.map(({ pointer, detail, allowed }) => ({ name: formFieldOf(pointer), severity: "error", text: allowed ? `allowed: ${allowed}` : detail }))));
}

/** Show the blocking error next to the button, with a link to its field. @param {ReturnType<DesignForm["remark"]>} fault */
function showBlockingError(fault) {
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
