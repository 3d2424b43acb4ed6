// @ts-check
// Request form of a reconstruction: of a scan with defaults, or a repetition with changed parameters.
import { api, idempotencyHeaders, Problem } from "../api.js";
import { h, replace } from "../dom.js";
import { showError, showLoading, errorElements } from "../panel_states.js";
import { formatDate, count } from "../units.js";
import { frameFields, motionFields } from "./command.js";
import { ParameterForm } from "./parameter_form.js";
import { parameterGroups } from "./schema.js";
import { urlOf } from "../urls.js";

const MOTION_LABELS = /** @type {Record<string, string>} */ ({ align: "Undo shifts between the volumes", motion: "Undo motion within each frame" });

/**
 * Show the form in a panel.
 * @param {HTMLElement} panel
 * @param {{again: string | null, scan: string | null, set: any}} query of the URL
 * @param {(reconstruction: any) => void} onCreated
 */
export async function showRequestForm(panel, query, onCreated) {
  panel.hidden = false;
  showLoading(panel, "loading the form …");
  try {
    const [groups, origin, scans] = await Promise.all([
      parameterGroups("ReconstructionParameters"),
      query.again ? api.get(`/reconstructions/${query.again}`) : null,
      api.get("/scans?limit=200"),
    ]);
    const initialScan = origin?.scan_id ?? query.scan;
    const isListed = !initialScan || scans.items.some((/** @type {any} */ one) => one.id === initialScan);
    const unlisted = isListed ? [] : [await api.get(`/scans/${initialScan}`)];
    fillForm(panel, groups, origin, [...scans.items, ...unlisted], query, onCreated);
  } catch (error) {
    showError(panel, error, () => void showRequestForm(panel, query, onCreated));
  }
}

/** @param {HTMLElement} panel @param {any} groups @param {any} origin @param {any[]} scans @param {any} query @param {(reconstruction: any) => void} onCreated */
function fillForm(panel, groups, origin, scans, query, onCreated) {
  const usable = scans.filter((one) => one.summary?.stored || (one.state === "running" && one.progress.done));
  const values = { ...(origin?.parameters ?? {}), ...(query.set ?? {}) };
  const form = new ParameterForm(groups, values, origin?.parameters ?? null);
  const scan = h("select", { id: "of-scan" }, usable.map((one) => h("option", { value: one.id }, scanTitle(one))));
  scan.value = origin?.scan_id ?? query.scan ?? usable[0]?.id ?? "";
  const priority = h("input", { type: "text", inputmode: "numeric", id: "of-priority", value: "100", class: "short-field" });
  const errorBox = h("div", { role: "alert" });
  const frame = new FrameChoice(origin?.scan_id, origin ? frameFields(origin) : {}, errorBox);
  const motion = Object.keys(origin ? motionFields(origin) : {}).map((name) => h("input", { type: "checkbox", id: `of-${name}`, name, checked: true }));
  const onScanChange = () => void frame.initialScan(usable.find((one) => one.id === scan.value));
  scan.addEventListener("change", onScanChange);
  onScanChange();
  const button = h("button", { class: "primary", disabled: !usable.length }, "Reconstruct");
  const close = h("button", { type: "button", onclick: () => { panel.hidden = true; history.replaceState(null, "", urlOf("/reconstructions")); } }, "Close");
  const whole = h("form", { novalidate: true, class: "stack" },
    h("h2", null, origin ? `Rerun: …${origin.id.slice(-5)}` : "Reconstruct a scan"),
    usable.length ? null : h("p", { class: "note" }, "There is no scan with A-lines yet: run a scan, or import your own data."),
    h("div", { class: "fields" },
      h("div", { class: "field whole" }, h("label", { for: "of-scan" }, "Scan"), scan),
      frame.element,
      ...motion.map((box) => h("div", { class: "field" }, h("label", { for: box.id }, MOTION_LABELS[box.name]), box)),
      h("div", { class: "field" }, h("label", { for: "of-priority" }, "Priority (lower runs first)"), priority)),
    form.element, errorBox, h("div", { class: "asking-foot" }, button, close, form.help));
  whole.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    replace(errorBox);
    const body = { scan_id: scan.value, parameters: form.values, priority: Number(priority.value), ...(origin?.mask_id ? { through: { mask_id: origin.mask_id } } : {}), ...frame.value, ...Object.fromEntries(motion.filter((box) => box.checked).map((box) => [box.name, true])) };
    try {
      onCreated(await api.post("/reconstructions", body, { headers: idempotencyHeaders() }));
      panel.hidden = true;
    } catch (error) {
      const others = error instanceof Problem ? form.showFieldErrors(error.errors) : [];
      if (!(error instanceof Problem) || others.length || !error.errors.length) replace(errorBox, ...errorElements(error));
    }
    button.disabled = false;
  });
  replace(panel, whole);
}

/** Selection of the frame of a scan, or of the mean of the frames at one wavelength. */
class FrameChoice {
  /** @param {string | undefined} scan that of the origin @param {any} frames its fields of the request @param {HTMLElement} errorBox host of errors */
  constructor(scan, frames, errorBox) {
    this.origin = { scan, frames };
    this.errorBox = errorBox;
    this.body = "";
    this.select = h("select", { id: "of-frame" });
    this.element = h("div", { class: "field", hidden: true }, h("label", { for: "of-frame" }, "Frames"), this.select);
    this.unknown = frames; // selection of the origin, until the plan is loaded
  }

  /** @param {any} scan */
  async initialScan(scan) {
    this.element.hidden = true;
    this.body = scan?.id ?? "";
    this.unknown = this.body === this.origin.scan ? this.origin.frames : {};
    if (!scan) return;
    try {
      const { frames, excitation } = await api.get(`/plans/${scan.plan_id}`);
      if (this.body !== scan.id) return; // another scan was selected meanwhile
      /** @type {number[]} */
      const wavelengths = excitation.length ? excitation : [0];
      const each = wavelengths.flatMap((light) => Array(frames).fill(light));
      const meanOptions = frames > 1 ? wavelengths.map((light) => ({ ...(light ? { wavelength: light } : {}), average: true })) : [];
      const series = each.length > 1 ? [frameOption({}, `all ${each.length}, as a series`)] : [];
      if (meanOptions.length && wavelengths.length > 1) series.push(frameOption({ average: true }, "means at each wavelength, as a series"));
      replace(this.select, ...series,
        ...each.map((light, n) => frameOption({ frame: n }, `${n + 1} of ${each.length}${light ? `, ${count(light * 1e9)} nm` : ""}`)),
        ...meanOptions.map((meanOption, n) => frameOption(meanOption, `mean of ${frames}${wavelengths[n] ? ` at ${count(wavelengths[n] * 1e9)} nm` : ""}`)));
      const wanted = JSON.stringify(this.unknown);
      if (![...this.select.options].some((option) => option.value === wanted)) this.select.append(frameOption(this.unknown, "as before"));
      this.select.value = wanted;
      this.element.hidden = each.length < 2;
    } catch (error) {
      replace(this.errorBox, ...errorElements(error));
    }
  }

  get value() {
    return this.element.hidden ? this.unknown : JSON.parse(this.select.value);
  }
}

/** @param {any} fields of the request @param {string} text */
function frameOption(fields, text) {
  return h("option", { value: JSON.stringify(fields) }, text);
}

/** Describe a scan in one line. @param {any} one */
export function scanTitle(one) {
  const labels = Object.entries(one.labels ?? {}).map(([name, text]) => `${name}: ${text}`).join(", ");
  const stored = one.summary?.stored ?? one.progress.done;
  return `${labels || "no labels"}, …${one.id.slice(-5)}, ${formatDate(one.created)}, ${count(stored)} A-lines`;
}
