// @ts-check
// Unmixing of a series: the request, and the oxygen saturation that was found.
import { api, BASE, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { nanometres, percent } from "../units.js";
import { wavelengthsOf } from "./series_player.js";

const BLOOD = ["oxyhaemoglobin", "deoxyhaemoglobin"];
const FURTHER = ["water", "lipid", "melanin", "ICG"];
const FLUENCE_MODELS = /** @type {[string, string][]} */ ([
  ["none", "none: the light is not corrected"], ["uniform", "uniform: the same at all depths"], ["tissue", "tissue, as stated below"],
  ["fit", "fit: tissue fitted to the series"], ["iterate", "iterate: tissue from the unmixing"],
]);
const FITTED_MODELS = ["fit", "iterate"];
const TISSUE = /** @type {[string, string, string][]} field, label, default */ ([["blood", "Blood (share of the volume)", "0.02"], ["saturation", "Its oxygen saturation", "0.7"]]);

/** Create the panel that requests an unmixing. @param {any} reconstruction the series, of the API */
export function unmixingForm(reconstruction) {
  const model = h("select", { id: "fluence" }, FLUENCE_MODELS.map(([name, text]) => h("option", { value: name }, text)));
  const boxes = FURTHER.map((name) => h("input", { type: "checkbox", value: name, id: `of-${name}`, onchange: () => showModels() }));
  const inputs = TISSUE.map(([name, , value]) => h("input", { type: "text", inputmode: "decimal", id: `tissue-${name}`, value, class: "short-field" }));
  const tissue = h("div", { class: "fields" }, TISSUE.map(([name, label], n) => h("div", { class: "field" }, h("label", { for: `tissue-${name}` }, label), inputs[n])));
  const status = h("div", { role: "status", class: "stack small", dataset: { unmixing: "" } });
  const button = h("button", { class: "primary" }, "Unmix");
  const lights = wavelengthsOf(reconstruction.report.frames).length;
  const showModels = () => {
    const isFittable = lights > BLOOD.length + boxes.filter((one) => one.checked).length;
    const reason = isFittable ? "" : "fit and iterate need more wavelengths than chromophores";
    for (const option of model.options) if (FITTED_MODELS.includes(option.value)) Object.assign(option, { disabled: !isFittable, title: reason });
    model.title = reason;
    if (!isFittable && FITTED_MODELS.includes(model.value)) model.value = "tissue";
  };
  model.value = "fit";
  showModels();
  const showTissue = () => (tissue.hidden = ["none", "uniform"].includes(model.value));
  model.addEventListener("change", showTissue);
  showTissue();
  const form = h("form", { class: "stack", novalidate: true },
    h("p", { class: "dim small" }, "Oxyhaemoglobin, deoxyhaemoglobin and oxygen saturation from the means at each wavelength."),
    h("div", { class: "field" }, h("label", { for: "fluence" }, "Light at a depth"), model), tissue,
    h("fieldset", null, h("legend", null, "Further chromophores"), FURTHER.map((name, n) => h("div", { class: "row" }, boxes[n], h("label", { for: `of-${name}` }, name)))),
    button, status);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    const fields = tissue.hidden ? {} : Object.fromEntries(TISSUE.map(([name], n) => [name, Number(inputs[n].value)]));
    const chromophores = [...BLOOD, ...boxes.filter((one) => one.checked).map((one) => one.value)];
    const unmixing = { chromophores, fluence: { model: model.value, ...fields } };
    try {
      await request(reconstruction, unmixing, status);
    } catch (error) {
      replace(status, ...errorElements(error));
    }
    button.disabled = false;
  });
  return form;
}

/** @param {any} reconstruction @param {any} unmixing @param {HTMLElement} status */
async function request(reconstruction, unmixing, status) {
  const body = { scan_id: reconstruction.scan_id, reconstruction_id: reconstruction.id, unmixing };
  let job = await api.post("/reconstructions", body, { headers: idempotencyHeaders() });
  while (["queued", "running", "cancelling"].includes(job.state)) {
    status.textContent = job.state === "queued" ? "queued …" : "unmixing …";
    job = await api.get(`/reconstructions/${job.id}`, { headers: { Prefer: "wait=5" } });
  }
  if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the unmixing ${job.state}`);
  replace(status, figures(job.report.unmixing), h("a", { class: "button primary", href: `/volumes/${job.id}` }, "Open the maps"));
}

/** Create the panel of an unmixing's result. @param {any} reconstruction the maps, of the API */
export function unmixingResult(reconstruction) {
  const picture = `${BASE}/reconstructions/${reconstruction.id}/mip`;
  const hasPicture = reconstruction.report.files?.includes("mip-z.png");
  return h("div", { class: "stack" }, figures(reconstruction.report.unmixing),
    hasPicture ? [h("a", { href: picture, download: `${reconstruction.id}.png` }, h("img", { src: picture, alt: "Oxygen saturation where haemoglobin is highest", class: "saturation" })),
      h("a", { class: "button", href: picture, download: `${reconstruction.id}.png` }, "Download the picture")] : null,
    (reconstruction.report.notes ?? []).map((/** @type {string} */ note) => h("p", { class: "note" }, note)),
    h("a", { class: "button", href: `/volumes/${reconstruction.reconstruction_id}` }, "Open the series"));
}

/** @param {any} found */
function figures(found) {
  const { saturation, fluence } = found;
  const share = (/** @type {number} */ value) => percent(value, 1);
  const rows = [["Chromophores", found.chromophores.join(", ")], ["Wavelengths", `${found.wavelengths_m.map(nanometres).join(", ")} nm`],
    ["Light", fluence.name], ["Voxels with signal", String(found.voxels)]];
  if (saturation?.mean !== undefined) {
    rows.push(["Oxygen saturation", share(saturation.mean)], ["5 to 95 % of voxels", `${share(saturation.percentile_5)} to ${share(saturation.percentile_95)}`],
      ["Error of a voxel", `± ${share(saturation.median_standard_error)}`]);
  }
  return h("dl", { class: "figures", dataset: { saturation: saturation?.mean === undefined ? "" : String(saturation.mean) } }, rows.flatMap(([name, value]) => [h("dt", null, name), h("dd", null, value)]));
}
