// @ts-check
// The volume in every format: those that lie there with their size, the others made by a job first.
import { api, BASE, onceOnly } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { failed, words } from "../panel_states.js";
import { bytes, percent } from "../units.js";

const FORMATS = /** @type {[string, string, string, boolean][]} name, what it is for, suffix, compressed */ ([
  ["nifti", "NIfTI: 3D Slicer, ITK-SNAP, napari", ".nii.gz", true],
  ["tiff", "TIFF hyperstack: ImageJ, Fiji", ".tif", false],
  ["ome-zarr", "OME-Zarr: napari, web viewers", ".ome.zarr", true],
  ["vtkhdf", "VTKHDF: ParaView", ".vtkhdf", true],
  ["nrrd", "NRRD: 3D Slicer", ".nrrd", true],
  ["hdf5", "HDF5: MATLAB, Octave, h5py", ".h5", true],
  ["png", "PNG: the projections as pictures", ".projections", true],
]);

export class Downloads {
  /** @param {any} about the reconstruction, of the API */
  constructor(about) {
    this.about = about;
    this.element = h("div", { class: "stack" });
    /** @type {Map<string, any>} the newest export of each format */
    this.jobs = new Map();
    /** @type {Set<string>} formats that are being made for this page */
    this.asked = new Set();
    live.on("job", (one) => this.jobs.size && [...this.jobs.values()].some((job) => job.id === one.id) && void this.open());
  }

  /** Bytes of the values as they lie there. */
  get size() {
    return 4 * (this.about.report?.shape ?? []).reduce((/** @type {number} */ all, /** @type {number} */ one) => all * one, 1);
  }

  async open() {
    try {
      const { items } = await api.get("/jobs?kind=export&limit=200");
      this.jobs.clear();
      for (const job of items) {
        const { format, reconstruction_id: of } = job.asked;
        const usable = of === this.about.id && !["failed", "cancelled"].includes(job.state);
        if (usable && !this.jobs.has(format)) this.jobs.set(format, job);
      }
      this.show();
    } catch (error) {
      failed(this.element, error, () => void this.open());
    }
  }

  show() {
    const whole = h("tr", null, h("td", null, "NumPy: the values alone"), h("td", { class: "number nowrap" }, bytes(this.size + 128)),
      h("td", null, h("a", { class: "button", href: `${BASE}/reconstructions/${this.about.id}/volume`, download: `${this.about.id}.npy` }, "Download")));
    replace(this.element,
      h("table", null,
        h("thead", null, h("tr", null, h("th", null, "Format"), h("th", { class: "number" }, "Size"), h("th", null, ""))),
        h("tbody", null, FORMATS.map((format) => this.row(format)), whole)),
      h("p", { class: "dim small" }, "Voxel sizes travel along in all but NumPy. What is not made yet takes a job of a few seconds."));
  }

  /** @param {[string, string, string, boolean]} format */
  row([name, what, , compressed]) {
    const job = this.jobs.get(name);
    const done = job?.state === "succeeded" && job.files.length;
    const size = done ? bytes(job.result?.bytes) : name === "png" ? "small" : `${compressed ? "≤" : "≈"} ${bytes(this.size)}`;
    const about = job && !done ? `making … ${job.progress.total ? percent(job.progress.done / job.progress.total) : ""}` : null;
    const button = done
      ? h("a", { class: "button", href: `${BASE}/jobs/${job.id}/files/${encodeURIComponent(job.files[0])}`, download: job.files[0] }, "Download")
      : about ? h("span", { class: "dim", role: "status" }, about)
        : h("button", { type: "button", onclick: () => this.make(name) }, "Make");
    return h("tr", { dataset: { format: name } }, h("td", null, what), h("td", { class: "number nowrap" }, size), h("td", null, button));
  }

  /** @param {string} format */
  async make(format) {
    if (this.asked.has(format)) return; // it was pressed twice
    this.asked.add(format);
    const asked = { kind: "export", reconstruction_id: this.about.id, format };
    try {
      let job = await api.post("/jobs", asked, { headers: onceOnly() });
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
      this.element.append(h("div", { role: "alert", class: "fault" }, ...words(error)));
    } finally {
      this.asked.delete(format);
    }
  }
}
