// @ts-check
// Asking for a reconstruction: of a scan with the defaults, or again with what is changed.
import { api, onceOnly, Problem } from "../api.js";
import { h, replace } from "../dom.js";
import { failed, loading, words } from "../panel_states.js";
import { clock, count } from "../units.js";
import { framesOf } from "./command.js";
import { ParameterForm } from "./parameter_form.js";
import { groupsOf } from "./schema.js";
import { at } from "../urls.js";

/**
 * Show the form in a panel.
 * @param {HTMLElement} panel
 * @param {{again: string | null, scan: string | null, set: any}} wanted what the address says
 * @param {(made: any) => void} done
 */
export async function showForm(panel, wanted, done) {
  panel.hidden = false;
  loading(panel, "reading what can be chosen …");
  try {
    const [groups, origin, scans] = await Promise.all([
      groupsOf("ReconstructionParameters"),
      wanted.again ? api.get(`/reconstructions/${wanted.again}`) : null,
      api.get("/scans?limit=200"),
    ]);
    const of = origin?.scan_id ?? wanted.scan;
    const isListed = !of || scans.items.some((/** @type {any} */ one) => one.id === of);
    const older = isListed ? [] : [await api.get(`/scans/${of}`)];
    fill(panel, groups, origin, [...scans.items, ...older], wanted, done);
  } catch (error) {
    failed(panel, error, () => void showForm(panel, wanted, done));
  }
}

/** @param {HTMLElement} panel @param {any} groups @param {any} origin @param {any[]} scans @param {any} wanted @param {(made: any) => void} done */
function fill(panel, groups, origin, scans, wanted, done) {
  const usable = scans.filter((one) => one.summary?.stored || (one.state === "running" && one.progress.done));
  const values = { ...(origin?.parameters ?? {}), ...(wanted.set ?? {}) };
  const form = new ParameterForm(groups, values, origin?.parameters ?? null);
  const scan = h("select", { id: "of-scan" }, usable.map((one) => h("option", { value: one.id }, scanTitle(one))));
  scan.value = origin?.scan_id ?? wanted.scan ?? usable[0]?.id ?? "";
  const priority = h("input", { type: "text", inputmode: "numeric", id: "of-priority", value: "100", class: "short-field" });
  const told = h("div", { role: "alert" });
  const frame = new FrameChoice(origin?.scan_id, origin ? framesOf(origin) : {}, told);
  const chosen = () => void frame.of(usable.find((one) => one.id === scan.value));
  scan.addEventListener("change", chosen);
  chosen();
  const button = h("button", { class: "primary", disabled: !usable.length }, "Reconstruct");
  const close = h("button", { type: "button", onclick: () => { panel.hidden = true; history.replaceState(null, "", at("/reconstructions")); } }, "Close");
  const whole = h("form", { novalidate: true, class: "stack" },
    h("h2", null, origin ? `Again: …${origin.id.slice(-5)}` : "Reconstruct a scan"),
    usable.length ? null : h("p", { class: "note" }, "There is no scan with A-lines yet: make one, or import your own data."),
    h("div", { class: "fields" },
      h("div", { class: "field whole" }, h("label", { for: "of-scan" }, "Scan"), scan),
      frame.element,
      h("div", { class: "field" }, h("label", { for: "of-priority" }, "Priority (smaller first)"), priority)),
    form.element, told, h("div", { class: "asking-foot" }, button, close, form.help));
  whole.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    replace(told);
    const asked = { scan_id: scan.value, parameters: form.values, priority: Number(priority.value), ...(origin?.mask_id ? { through: { mask_id: origin.mask_id } } : {}), ...frame.value };
    try {
      done(await api.post("/reconstructions", asked, { headers: onceOnly() }));
      panel.hidden = true;
    } catch (error) {
      const others = error instanceof Problem ? form.blame(error.errors) : [];
      if (!(error instanceof Problem) || others.length || !error.errors.length) replace(told, ...words(error));
    }
    button.disabled = false;
  });
  replace(panel, whole);
}

/** The field with the frames of a scan that has several, and the means of those at one wavelength. */
class FrameChoice {
  /** @param {string | undefined} scan that of the origin @param {any} frames its fields of the request @param {HTMLElement} told for what goes wrong */
  constructor(scan, frames, told) {
    this.origin = { scan, frames };
    this.told = told;
    this.asked = "";
    this.select = h("select", { id: "of-frame" });
    this.element = h("div", { class: "field", hidden: true }, h("label", { for: "of-frame" }, "Frame"), this.select);
    this.unknown = frames; // until it is known how many there are, that of the origin
  }

  /** @param {any} scan */
  async of(scan) {
    this.element.hidden = true;
    this.asked = scan?.id ?? "";
    this.unknown = this.asked === this.origin.scan ? this.origin.frames : {};
    if (!scan) return;
    try {
      const { frames, excitation } = await api.get(`/plans/${scan.plan_id}`);
      if (this.asked !== scan.id) return; // another was chosen meanwhile
      /** @type {number[]} */
      const lights = excitation.length ? excitation : [0];
      const each = lights.flatMap((light) => Array(frames).fill(light));
      const means = frames > 1 ? lights.map((light) => ({ ...(light ? { wavelength: light } : {}), average: true })) : [];
      replace(this.select,
        ...each.map((light, n) => option({ frame: n }, `${n + 1} of ${each.length}${light ? `, ${count(light * 1e9)} nm` : ""}`)),
        ...means.map((mean, n) => option(mean, `mean of ${frames}${lights[n] ? ` at ${count(lights[n] * 1e9)} nm` : ""}`)));
      const { wavelength, average, frame } = this.unknown;
      const first = frame ?? (wavelength ? each.findIndex((light) => Math.abs(light - wavelength) < 0.5e-9) : 0);
      this.select.value = JSON.stringify(average ? this.unknown : { frame: first });
      this.element.hidden = each.length < 2;
    } catch (error) {
      replace(this.told, ...words(error));
    }
  }

  get value() {
    return this.element.hidden ? this.unknown : JSON.parse(this.select.value);
  }
}

/** @param {any} fields of the request @param {string} text */
function option(fields, text) {
  return h("option", { value: JSON.stringify(fields) }, text);
}

/** A scan in a line. @param {any} one */
export function scanTitle(one) {
  const labels = Object.entries(one.labels ?? {}).map(([name, text]) => `${name}: ${text}`).join(", ");
  const stored = one.summary?.stored ?? one.progress.done;
  return `${labels || "without labels"}, …${one.id.slice(-5)}, ${clock(one.created)}, ${count(stored)} A-lines`;
}
