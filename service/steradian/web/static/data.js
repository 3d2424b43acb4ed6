// @ts-check
// Data: a recording that is dropped here becomes a scan; what the file does not say is asked for.
import { api, onceOnly, Problem } from "./api.js";
import { byId, h, replace, settled } from "./dom.js";
import { words } from "./panel_states.js";
import { Understood } from "./recording_preview.js";
import { bytes, identifierOf } from "./units.js";
import { at } from "./urls.js";

const COMPANION = /\.(csv|npy|h5|hdf5)$/i;
const FIELDS = /** @type {[string, string, string, string][]} */ ([
  ["sampling_interval", "Sampling interval", "ns", "Time between samples"],
  ["time_zero", "Time zero", "ns", "From the laser pulse to the first sample"],
  ["time_zero_samples", "and", "samples", "Added to it; negative where the record begins before the pulse"],
  ["sound_speed", "Speed of sound", "m/s", "As far as it is known"],
  ["aperture", "Aperture", "mm", "Side of the square around the origin"],
  ["depth", "Depth of the point", "mm", "Distance of the point of interest"],
  ["interval", "Pitch of a grid", "mm", "Where the sensors are a grid, instead of positions"],
]);

const LENGTHS = ["aperture", "depth", "interval"];
/** @type {Record<string, number>} of a mm: units in which positions may come */
const UNITS = { mm: 1, m: 1e-3, um: 1e3 };

/** @type {Record<string, [number, string]>} SI units of what the service allows, in those of the fields */
const OF_FIELDS = { s: [1e9, "ns"], m: [1e3, "mm"] };

/** @type {Record<string, number>} what is tried where nobody knows */
const GUESSES = { sound_speed: 1500 };

const host = byId("data");
const files = h("input", { type: "file", multiple: true, id: "files", class: "visually-hidden", onchange: () => take(chosenFiles()) });
const drop = h("section", { class: "panel drop", "data-steradian": "data-drop" },
  h("strong", null, "Drop a recording here"),
  h("span", { class: "dim" }, "IPASC, k-Wave or MATLAB HDF5, .npy, .npz, .csv, .sgl, or a scan file; positions may come beside it as .csv or .npy"),
  h("label", { class: "button primary", for: "files" }, "Choose files …"), files);
const list = h("div", { class: "stack" });
const form = h("form", { class: "panel stack", hidden: true, "data-steradian": "data-form" });
const panel = h("section", { class: "panel stack", hidden: true, "data-steradian": "data-understood" });
const result = h("div", { class: "stack", role: "status" });
replace(host, h("div", { class: "stack" }, drop, list, form, result, panel));
const shown = new Understood(panel);

/** @type {{file: File, id: string}[]} the recording first, then what describes it */
let uploads = [];
let takes = 0;

for (const name of ["dragover", "dragenter"]) drop.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
for (const name of ["dragleave", "drop"]) drop.addEventListener(name, () => drop.classList.remove("over"));
drop.addEventListener("drop", (event) => {
  event.preventDefault();
  take([...(event.dataTransfer?.files ?? [])]);
});

/** What was chosen; the same may be chosen again. */
function chosenFiles() {
  const given = [...(files.files ?? [])];
  files.value = "";
  return given;
}

/** The largest file is the recording, a smaller one beside it its positions. @param {File[]} given */
async function take(given) {
  if (!given.length) return;
  const mine = (takes += 1);
  const ordered = [...given].sort((a, b) => b.size - a.size);
  const chosen = [ordered[0], ...ordered.slice(1).filter((one) => COMPANION.test(one.name)).slice(0, 1)];
  uploads = [];
  points = side = 0;
  replace(result);
  form.hidden = panel.hidden = true;
  for (const file of chosen) {
    const line = h("p", { class: "panel" }, h("strong", null, file.name), ` ${bytes(file.size)} is being sent …`);
    if (file === chosen[0]) replace(list, line);
    else list.append(line);
    try {
      const made = await api.post("/uploads", file, { headers: { "Content-Type": "application/octet-stream" } });
      if (mine !== takes) return; // others were given meanwhile
      uploads.push({ file, id: made.id });
      replace(line, h("strong", null, file.name), ` ${bytes(made.bytes)}, ${file === chosen[0] ? "the recording" : "its positions"}`);
    } catch (error) {
      replace(line, ...words(error));
      return;
    }
  }
  ask();
  await look();
}

const said = h("div", { class: "remarks", role: "alert" });
const bringIt = h("button", { class: "primary", disabled: true, "aria-describedby": "not-yet" }, "Import");
const notYet = h("span", { class: "dim small", id: "not-yet" });

/** The short form: all of it may stay empty where the file says it itself. */
function ask() {
  replace(said);
  replace(form,
    h("h2", null, "What the file does not say"),
    h("p", { class: "dim" }, "Leave empty what it says itself; what is needed is named. Below stands what was understood."),
    h("div", { class: "row top" }, FIELDS.map(([name, label, unit, help]) => h("label", { class: "stack asked", title: help }, label,
      h("span", { class: "with-unit" }, h("input", { type: "number", step: "any", name, "aria-label": label, oninput: lookSoon }), h("span", { class: "dim" }, unit)),
      h("span", { class: "fault small", dataset: { remark: name } }))),
      h("label", { class: "stack" }, "Axes of the array", h("select", { name: "axes", onchange: lookSoon }, [["", "as the file says"], ["point, time", "point, time"], ["time, point", "time, point"], ["x, y, time", "x, y, time"], ["time, x, y", "time, x, y"]].map(([value, text]) => h("option", { value }, text))))),
    uploads.length > 1 ? h("label", { class: "row" }, "Its positions are in", h("select", { name: "lengths", onchange: lookSoon }, [["mm", "mm (a guess)"], ["m", "m"], ["um", "µm"]].map(([value, text]) => h("option", { value }, text)))) : null,
    said, h("div", { class: "row" }, bringIt, notYet));
  form.onsubmit = (event) => {
    event.preventDefault();
    void bring();
  };
  form.hidden = false;
}

const lookSoon = settled(() => void look(), 400);
let looks = 0;
let points = 0;
let side = 0; // of a square grid, where the array does not say how its points lie

/** See what would be understood, and name what is missing. */
async function look() {
  const mine = (looks += 1);
  const [recording, companion] = uploads;
  bringIt.disabled = true;
  notYet.textContent = "";
  replace(said, h("p", { class: "dim" }, "looking into it …"));
  try {
    const seen = await api.post(`/uploads/${recording.id}/preview`, { description: description(), companion_id: companion?.id ?? null });
    if (mine !== looks) return;
    replace(said);
    panel.hidden = false;
    points = seen.points;
    name(seen.missing);
    bringIt.disabled = seen.missing.length > 0;
    notYet.textContent = seen.missing.length ? `Not yet; needed: ${needed(seen.missing)}.` : "";
    await shown.show(seen);
  } catch (error) {
    if (mine !== looks) return;
    replace(said);
    if (error instanceof Problem && !side && Number.isInteger(Math.sqrt(points)) && error.errors.some(({ pointer }) => /grid[./]count$/.test(pointer))) {
      side = Math.sqrt(points);
      return look();
    }
    panel.hidden = false;
    name(error instanceof Problem ? error.errors.map(({ pointer, allowed }) => ({ field: pointer.split("/").pop(), allowed })) : []);
    notYet.textContent = "Not yet; what is wrong stands below.";
    shown.fail(error);
  }
}

/** @param {{field: string}[]} missing @returns {string} */
function needed(missing) {
  const labels = missing.map(({ field }) => FIELDS.find(([name]) => name === field)?.[1] ?? field.replaceAll("_", " "));
  return labels.map((one) => one.toLowerCase()).join(", ");
}

/** @param {string} value */
const guessed = (value) => `${value} is a guess: change it if you know better.`;

/** What is allowed, in the unit that stands beside the field. @param {string} allowed */
function inFieldsUnit(allowed) {
  const told = allowed.replace(/^([^;(]*)\(([sm])\)/, (_, range, unit) => {
    const [factor, name] = OF_FIELDS[unit];
    return `${range.replace(/-?\d[\d.]*(e[-+]?\d+)?/g, (/** @type {string} */ number) => String(Number((Number(number) * factor).toPrecision(6))))}${name}`;
  });
  return told.replace(/^> /, "more than ").replace(", which the file does not state", "; the file does not say it");
}

/** Say beside each field what it must be; where nobody knows, a guess is put in. @param {{field: string | undefined, allowed: string}[]} missing */
function name(missing) {
  for (const remark of /** @type {NodeListOf<HTMLElement>} */ (form.querySelectorAll("[data-remark]"))) {
    const field = remark.dataset.remark ?? "";
    const input = /** @type {HTMLInputElement} */ (form.querySelector(`input[name="${field}"]`));
    const found = missing.find((one) => (one.field === "positions" ? "interval" : one.field) === field);
    remark.textContent = found ? `Needed: ${inFieldsUnit(found.allowed)}` : input.dataset.guess === input.value ? guessed(input.value) : "";
    remark.className = found ? "fault small" : "dim small"; // a guess is no fault
    if (found) input.setAttribute("aria-invalid", "true");
    else input.removeAttribute("aria-invalid");
    if (!found || !(field in GUESSES) || input.value !== "") continue;
    input.value = input.dataset.guess = String(GUESSES[field]);
    remark.textContent = guessed(input.value);
    remark.className = "dim small";
    input.removeAttribute("aria-invalid");
    lookSoon();
  }
}

function description() {
  const given = new FormData(form);
  /** @type {Record<string, any>} */
  const found = {};
  for (const [name] of FIELDS) {
    const text = String(given.get(name) ?? "");
    if (text !== "") found[name] = Number(text);
  }
  const called = uploads[0]?.file.name ?? "";
  if (/\.sgl$/i.test(called)) found.file_name = called.slice(0, 300); // its name says more than the file
  if (given.get("axes")) found.axes = given.get("axes");
  const lengths = String(given.get("lengths") ?? "mm");
  for (const name of LENGTHS) if (found[name] !== undefined) found[name] = Number((found[name] * UNITS[lengths]).toPrecision(12));
  if (found.interval !== undefined) {
    found.grid = { interval: [found.interval, found.interval], ...(side ? { count: [side, side] } : {}) };
    delete found.interval;
  }
  if (uploads.length > 1 || found.grid || LENGTHS.some((name) => found[name] !== undefined)) found.lengths = lengths; // of these alone
  if (found.sampling_interval !== undefined || found.time_zero !== undefined) found.times = "ns";
  return found;
}

/** Import, and wait for what comes of it. */
async function bring() {
  bringIt.disabled = true;
  replace(said, h("p", { class: "dim" }, "importing …"));
  try {
    const [recording, companion] = uploads;
    const body = { kind: "import", upload_id: recording.id, companion_id: companion?.id ?? null, description: description(), labels: { file: recording.file.name.slice(0, 200) } };
    let job = await api.post("/jobs", body, { headers: onceOnly() });
    while (["queued", "running", "cancelling"].includes(job.state)) {
      job = await api.get(`/jobs/${job.id}`, { headers: { Prefer: "wait=5" } });
      replace(said, h("p", { class: "dim" }, `importing: ${job.progress.stage ?? "waits for a worker"} …`));
    }
    if (job.state !== "succeeded") {
      replace(said, h("p", { class: "fault" }, job.error?.detail ?? `The import ${job.state}.`));
      bringIt.disabled = false;
      return;
    }
    form.hidden = true;
    done(job.result.scan_id);
  } catch (error) {
    replace(said, ...words(error));
    bringIt.disabled = false;
  }
}

/** Say what it has become, and what comes next. @param {string} id of the scan */
function done(id) {
  const wrong = h("div", { class: "remarks", role: "alert" });
  const start = h("button", { type: "button", class: "primary", onclick: async () => {
    start.disabled = true;
    try {
      const made = await api.post("/reconstructions", { scan_id: id }, { headers: onceOnly() });
      location.assign(at(`/reconstructions/${made.id}`));
    } catch (error) {
      replace(wrong, ...words(error));
      start.disabled = false;
    }
  } }, "Reconstruct");
  replace(result, h("section", { class: "panel row spread" }, h("span", null, h("strong", null, "Imported"), " as the scan ", identifierOf(id, `/scans/${id}`)), wrong, start));
}
