// @ts-check
// Downloads of a volume: existing files with their size, other formats after an export job.
import { api, BASE, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showError, errorElements } from "../panel_states.js";
import { bytes, percent } from "../units.js";

const FORMATS = /** @type {[string, string, string, boolean][]} name, what it is for, suffix, compressed */ ([
  ["nifti", "NIfTI: 3D Slicer, ITK-SNAP, napari", ".nii.gz", true],
  ["tiff", "TIFF hyperstack: ImageJ, Fiji", ".tif", false],
  ["ome-zarr", "OME-Zarr: napari, web viewers", ".ome.zarr", true],
  ["vtkhdf", "VTKHDF: ParaView", ".vtkhdf", true],
  ["nrrd", "NRRD: 3D Slicer", ".nrrd", true],
  ["hdf5", "HDF5: MATLAB, Octave, h5py", ".h5", true],
  ["png", "PNG: projections", ".projections", true],
]);

const SERIES_FORMATS = ["nifti", "tiff", "ome-zarr", "hdf5"]; // that hold several volumes

export class Downloads {
  /** @param {any} reconstruction the reconstruction, of the API */
  constructor(reconstruction) {
    this.reconstruction = reconstruction;
    this.isSeries = Boolean(reconstruction.report?.frames?.length);
    this.element = h("div", { class: "stack" });
    /** @type {Map<string, any>} newest export of each format */
    this.jobs = new Map();
    /** @type {Set<string>} formats whose export is running */
    this.pendingFormats = new Set();
    live.on("job", (one) => this.jobs.size && [...this.jobs.values()].some((job) => job.id === one.id) && void this.load());
  }

  /** Size of the values in bytes. */
  get valueBytes() {
    return 4 * (this.reconstruction.report?.frames?.length || 1) * (this.reconstruction.report?.shape ?? []).reduce((/** @type {number} */ all, /** @type {number} */ one) => all * one, 1);
  }

  async load() {
    try {
      const { items } = await api.get("/jobs?kind=export&limit=200");
      this.jobs.clear();
      for (const job of items) {
        const { format, reconstruction_id: of, index } = job.asked;
        const usable = of === this.reconstruction.id && (index ?? null) === null && !["failed", "cancelled"].includes(job.state);
        if (usable && !this.jobs.has(format)) this.jobs.set(format, job);
      }
      this.show();
    } catch (error) {
      showError(this.element, error, () => void this.load());
    }
  }

  show() {
    const numpyRow = this.isSeries ? null : h("tr", null, h("td", null, "NumPy: values only"), h("td", { class: "number nowrap" }, bytes(this.valueBytes + 128)),
      h("td", null, h("a", { class: "button", href: `${BASE}/reconstructions/${this.reconstruction.id}/volume`, download: `${this.reconstruction.id}.npy` }, "Download")));
    replace(this.element,
      h("table", { class: "files" },
        h("thead", null, h("tr", null, h("th", null, "Format"), h("th", { class: "number" }, "Size"), h("th", null, h("span", { class: "visually-hidden" }, "Action")))),
        h("tbody", null, FORMATS.filter(([name]) => !this.isSeries || SERIES_FORMATS.includes(name)).map((format) => this.row(format)), numpyRow)),
      this.isSeries ? h("p", { class: "dim small" }, this.reconstruction.kind === "unmixing" ? "A file contains all maps, with their names." : "A file contains all volumes, with their wavelengths and times.") : null,
      h("p", { class: "dim small" }, "All formats except NumPy contain the voxel size. Creating a file takes a job of a few seconds."));
  }

  /** @param {[string, string, string, boolean]} format */
  row([name, description, , compressed]) {
    const job = this.jobs.get(name);
    const isDone = job?.state === "succeeded" && job.files.length;
    const size = isDone ? bytes(job.result?.bytes) : name === "png" ? "small" : `${compressed ? "≤" : "≈"} ${bytes(this.valueBytes)}`;
    const progressText = job && !isDone ? `creating … ${job.progress.total ? percent(job.progress.done / job.progress.total) : ""}` : null;
    const button = isDone
      ? h("a", { class: "button", href: `${BASE}/jobs/${job.id}/files/${encodeURIComponent(job.files[0])}`, download: job.files[0] }, "Download")
      : progressText ? h("span", { class: "dim", role: "status" }, progressText)
        : h("button", { type: "button", onclick: () => this.exportFormat(name) }, "Create");
    return h("tr", { dataset: { format: name } }, h("td", null, description), h("td", { class: "number nowrap" }, size), h("td", null, button));
  }

  /** @param {string} format */
  async exportFormat(format) {
    if (this.pendingFormats.has(format)) return; // double click
    this.pendingFormats.add(format);
    const body = { kind: "export", reconstruction_id: this.reconstruction.id, format };
    try {
      let job = await api.post("/jobs", body, { headers: idempotencyHeaders() });
      while (["queued", "running", "cancelling"].includes(job.state)) {
        this.jobs.set(format, job);
        this.show();
        job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
      }
      if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the export ${job.state}`);
      this.jobs.set(format, job);
      this.show();
    } catch (error) {
      this.jobs.delete(format);
      this.show();
      this.element.append(h("div", { role: "alert", class: "fault" }, ...errorElements(error)));
    } finally {
      this.pendingFormats.delete(format);
    }
  }
}
