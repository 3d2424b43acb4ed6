// @ts-check
// Data view: upload, preview and import of a recording.
import { convertRange } from "./allowed_ranges.js";
import { api, idempotencyHeaders, Problem } from "./api.js";
import { BASIC_FIELDS, descriptionOf, fieldOf, inputOf, labelOf, missingPitch, MORE_FIELDS } from "./data_fields.js";
import { byId, h, replace, debounce } from "./dom.js";
import { errorElements } from "./panel_states.js";
import { kwaveHelp } from "./kwave_names.js";
import { iterativeButton } from "./reconstructions/iterative_beside.js";
import { RecordingPreview } from "./recording_preview.js";
import { bytes, identifierElement } from "./units.js";
import { urlOf } from "./urls.js";

const COMPANION_PATTERN = /\.(csv|npy|h5|hdf5)$/i;
/** @type {Record<string, [number, string]>} factors and units of the fields by SI unit */
const FIELD_UNITS = { s: [1e9, "ns"], m: [1e3, "mm"] };

/** @type {Record<string, number>} initial values of required fields that the file does not contain */
const GUESSED_VALUES = { sound_speed: 1500 };

const host = byId("data");
const files = h("input", { type: "file", multiple: true, id: "files", class: "visually-hidden", onchange: () => uploadFiles(takeSelectedFiles()) });
const drop = h("section", { class: "panel drop", "data-steradian": "data-drop" },
  h("strong", null, "Drop a recording here"),
  h("span", { class: "dim" }, "IPASC, k-Wave, MATLAB or Octave (.mat from version 5 on), HDF5, .npy, .npz, .csv, .sgl, or a scan file; add the positions as .csv or .npy if the file does not contain them"),
  h("label", { class: "button primary", for: "files" }, "Choose files …"), files);
const list = h("div", { class: "stack" });
const form = h("form", { class: "panel stack", hidden: true, "data-steradian": "data-form" });
const panel = h("section", { class: "panel stack", hidden: true, "data-steradian": "data-understood" });
const result = h("div", { class: "stack", role: "status" });
replace(host, h("div", { class: "stack" }, drop, list, form, result, panel, kwaveHelp()));
const recordingPreview = new RecordingPreview(panel);

/** @type {{file: File, id: string}[]} the recording first, then its companion file */
let uploads = [];
let uploadCount = 0;

for (const name of ["dragover", "dragenter"]) drop.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
for (const name of ["dragleave", "drop"]) drop.addEventListener(name, () => drop.classList.remove("over"));
drop.addEventListener("drop", (event) => {
  event.preventDefault();
  uploadFiles([...(event.dataTransfer?.files ?? [])]);
});

/** Return the selected files and reset the input, so that the same file can be selected again. */
function takeSelectedFiles() {
  const selection = [...(files.files ?? [])];
  files.value = "";
  return selection;
}

/** Upload the largest file as the recording and one smaller file as its positions. @param {File[]} selection */
async function uploadFiles(selection) {
  if (!selection.length) return;
  const ticket = (uploadCount += 1);
  const ordered = [...selection].sort((a, b) => b.size - a.size);
  const chosenFiles = [ordered[0], ...ordered.slice(1).filter((one) => COMPANION_PATTERN.test(one.name)).slice(0, 1)];
  uploads = [];
  points = gridSide = 0;
  replace(result);
  form.hidden = panel.hidden = true;
  for (const file of chosenFiles) {
    const line = h("p", { class: "panel" }, h("strong", null, file.name), ` ${bytes(file.size)}, uploading …`);
    if (file === chosenFiles[0]) replace(list, line);
    else list.append(line);
    try {
      const created = await api.post("/uploads", file, { headers: { "Content-Type": "application/octet-stream" } });
      if (ticket !== uploadCount) return; // replaced by a later upload
      uploads.push({ file, id: created.id });
      replace(line, h("strong", null, file.name), ` ${bytes(created.bytes)}, ${file === chosenFiles[0] ? "recording" : "positions"}`);
    } catch (error) {
      replace(line, ...errorElements(error));
      return;
    }
  }
  showForm();
  await preview();
}

const messages = h("div", { class: "remarks", role: "alert" });
const importButton = h("button", { class: "primary", disabled: true, "aria-describedby": "not-yet" }, "Import");
const importHint = h("span", { class: "dim small", id: "not-yet" });

/** Show the form; fields stay empty if the file contains their values. */
function showForm() {
  replace(messages);
  replace(form,
    h("h2", null, "Description of the recording"),
    h("p", { class: "dim" }, "Leave a field empty if the file contains its value. Required fields are marked. The preview below shows how the file is interpreted."),
    h("div", { class: "row top" }, BASIC_FIELDS.map((one) => inputOf(one, previewSoon))),
    h("details", { class: "more-fields", open: uploads.length > 1 }, h("summary", null, h("strong", null, "More"), " ", h("span", { class: "dim" }, "units of the file, scale, grid, frames, provenance")),
      h("div", { class: "row top below" }, MORE_FIELDS.map((one) => inputOf(one, previewSoon)))),
    messages, h("div", { class: "row actions" }, importButton, importHint));
  form.onsubmit = (event) => {
    event.preventDefault();
    void importRecording();
  };
  form.hidden = false;
}

const previewSoon = debounce(() => void preview(), 400);
let previewCount = 0;
let points = 0;
let gridSide = 0; // points per side of a square grid, if the array does not state the arrangement

/** Request a preview of the recording and show the missing fields. */
async function preview() {
  const ticket = (previewCount += 1);
  const [recording, companion] = uploads;
  importButton.disabled = true;
  importHint.textContent = "";
  replace(messages, h("p", { class: "dim" }, "reading the file …"));
  try {
    const preview = await api.post(`/uploads/${recording.id}/preview`, { description: readDescription(), companion_id: companion?.id ?? null });
    if (ticket !== previewCount) return;
    replace(messages);
    panel.hidden = false;
    points = preview.points;
    const missing = withPitch(preview.missing);
    showMissing(missing);
    importButton.disabled = missing.length > 0;
    importHint.textContent = missing.length ? `Required for the import: ${missingLabels(missing)}.` : "";
    recordingPreview.show(preview);
  } catch (error) {
    if (ticket !== previewCount) return;
    replace(messages);
    if (error instanceof Problem && !gridSide && Number.isInteger(Math.sqrt(points)) && error.errors.some(({ pointer }) => /grid[./]count$/.test(pointer))) {
      gridSide = Math.sqrt(points);
      return preview();
    }
    panel.hidden = false;
    showMissing(error instanceof Problem ? [...error.errors.map(({ pointer, allowed }) => ({ field: pointer.split("/").pop(), allowed })), ...suggestArrays(error.detail)] : []);
    importHint.textContent = "Import not possible; the error is shown below.";
    recordingPreview.fail(error);
  }
}

/** Add the grid pitch to missing fields, if only other fields of the grid are filled. @param {{field: string, allowed: string}[]} missing */
const withPitch = (missing) => (missing.some(({ field }) => fieldOf(field) === "interval") ? missing : [...missing, ...missingPitch(new FormData(form))]);

/** @param {{field: string}[]} missing @returns {string} */
function missingLabels(missing) {
  return missing.map(({ field }) => labelOf(field).toLowerCase()).join(", ");
}

/** Offer the arrays of a file whose A-lines have another name. @param {string} detail of the refusal, which lists them */
function suggestArrays(detail) {
  const names = detail.match(/; it holds (.+)$/)?.[1].split(", ") ?? [];
  const list = form.querySelector("#suggested-array");
  if (list && names.length) replace(list, names.map((value) => h("option", { value })));
  return names.length ? [{ field: "array", allowed: `one of ${names.join(", ")}` }] : [];
}

/** @param {string} value */
const guessText = (value) => `${value} is an assumption: change it if you know the value.`;

/** Convert an allowed range to the unit of the field. @param {string} allowed */
function toFieldUnit(allowed) {
  return convertRange(allowed, FIELD_UNITS).replace(/^> /, "more than ").replace(", which the file does not state", "; not stated in the file").replace(/a description with no (time|length) of its own, \{.*?\}, says their unit/, (_, kind) => `${kind === "time" ? "Times" : "Lengths"} in the file, under More, is their unit`);
}

/** Show the requirement of each missing field; fill in an assumed value if there is one. @param {{field: string | undefined, allowed: string}[]} missing */
function showMissing(missing) {
  for (const remark of /** @type {NodeListOf<HTMLElement>} */ (form.querySelectorAll("[data-remark]"))) {
    const field = remark.dataset.remark ?? "";
    const input = /** @type {HTMLInputElement} */ (form.querySelector(`[name="${field}"]`));
    const missingField = missing.find((one) => fieldOf(one.field) === field);
    remark.textContent = missingField ? `Required: ${toFieldUnit(missingField.allowed)}` : input.dataset.guess === input.value ? guessText(input.value) : "";
    remark.className = missingField ? "fault small" : "dim small"; // an assumed value is not an error
    if (missingField) {
      input.setAttribute("aria-invalid", "true");
      input.closest("details")?.setAttribute("open", "");
    } else input.removeAttribute("aria-invalid");
    if (!missingField || !(field in GUESSED_VALUES) || input.value !== "") continue;
    input.value = input.dataset.guess = String(GUESSED_VALUES[field]);
    remark.textContent = guessText(input.value);
    remark.className = "dim small";
    input.removeAttribute("aria-invalid");
    previewSoon();
  }
}

function readDescription() {
  return descriptionOf(new FormData(form), { fileName: uploads[0]?.file.name ?? "", hasPositions: uploads.length > 1, side: gridSide });
}

/** Import the recording and wait for the job. */
async function importRecording() {
  importButton.disabled = true;
  replace(messages, h("p", { class: "dim" }, "importing …"));
  try {
    const [recording, companion] = uploads;
    const body = { kind: "import", upload_id: recording.id, companion_id: companion?.id ?? null, description: readDescription(), labels: { file: recording.file.name.slice(0, 200) } };
    let job = await api.post("/jobs", body, { headers: idempotencyHeaders() });
    while (["queued", "running", "cancelling"].includes(job.state)) {
      job = await api.get(`/jobs/${job.id}`, { headers: { Prefer: "wait=5" } });
      replace(messages, h("p", { class: "dim" }, `importing: ${job.progress.stage ?? "waiting for a worker"} …`));
    }
    if (job.state !== "succeeded") {
      replace(messages, h("p", { class: "fault" }, job.error?.detail ?? `The import ${job.state}.`));
      importButton.disabled = false;
      return;
    }
    form.hidden = true;
    showImported(job.result.scan_id);
  } catch (error) {
    replace(messages, ...errorElements(error));
    importButton.disabled = false;
  }
}

/** Show the created scan and the next step. @param {string} id of the scan */
function showImported(id) {
  const errorBox = h("div", { class: "remarks", role: "alert" });
  const start = h("button", { type: "button", class: "primary", onclick: async () => {
    start.disabled = true;
    try {
      const created = await api.post("/reconstructions", { scan_id: id }, { headers: idempotencyHeaders() });
      location.assign(urlOf(`/reconstructions/${created.id}`));
    } catch (error) {
      replace(errorBox, ...errorElements(error));
      start.disabled = false;
    }
  } }, "Reconstruct");
  replace(result, h("section", { class: "panel row spread" }, h("span", null, h("strong", null, "Imported"), " as scan ", identifierElement(id, `/scans/${id}`)), errorBox, h("span", { class: "row" }, iterativeButton(id, errorBox), start)));
}
