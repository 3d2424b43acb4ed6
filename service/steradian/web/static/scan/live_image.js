// @ts-check
// Live image of a running scan: projection of the newest revision, with its coverage.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showEmpty, errorElements } from "../panel_states.js";
import { count, length, mm, percent } from "../units.js";
import { firstVoxelBelow, createSource } from "../volume/volume_data.js";
import { colourTable } from "../volume/colours.js";

const MAX_PIXELS = 512;
const POLL_INTERVAL = 1000; // ms between two polls while the event stream is interrupted

export class LiveImage {
  /** @param {HTMLElement} host @param {string} scanId @param {() => Node[]} actions for a finished scan */
  constructor(host, scanId, actions) {
    this.host = host;
    this.scanId = scanId;
    this.actions = actions;
    this.canvas = h("canvas", { role: "img", "aria-label": "Maximum-intensity projection along z" });
    this.caption = h("p", { class: "dim caption" });
    this.outcome = h("p", { class: "caption", role: "status", hidden: true });
    /** @type {any} live reconstruction */
    this.reconstruction = null;
    this.etag = "";
    this.running = false;
    this.isBusy = this.isDue = false;
    live.on("reconstruction", (event) => (event.id === this.reconstruction?.id || (!this.reconstruction && event.scan_id === scanId)) && this.findReconstruction());
    live.on("revision", (event) => {
      if (event.scan_id !== scanId) return;
      if (event.id !== this.reconstruction?.id) return void this.findReconstruction();
      this.hasAny = true;
      void this.readRevisions();
    });
    live.on("progress", (event) => event.id === this.reconstruction?.id && (this.reconstruction.progress = event));
    live.on("again", () => void this.findReconstruction());
    setInterval(() => live.state.is === "cut" && !document.hidden && this.reconstruction && !this.final && void this.findReconstruction(), POLL_INTERVAL);
    this.final = false;
    this.hasAny = false;
  }

  /** Find the live reconstruction of the scan, or offer to start one. */
  async findReconstruction() {
    try {
      const item = (await api.get(`/reconstructions?kind=live&scan_id=${this.scanId}&limit=1`)).items[0];
      this.reconstruction = item ?? null;
      if (!item) this.showOffer();
      else if (this.hasRevision()) await this.readRevisions().then(() => this.showOutcome());
      else this.showWaiting();
    } catch (error) {
      if (!this.canvas.isConnected) replace(this.host, h("div", { class: "state failed" }, ...errorElements(error)));
    }
  }

  showOffer() {
    if (!this.running) {
      showEmpty(this.host, "No live image", "The stored A-lines can be reconstructed now.", ...this.actions());
      return;
    }
    const start = h("button", { type: "button", class: "primary", onclick: () => { start.disabled = true; void this.startFollowing(); } }, "Start a live image");
    showEmpty(this.host, "No image yet", "A worker can reconstruct the stored A-lines every few seconds.", start);
  }

  async startFollowing() {
    try {
      this.reconstruction = await api.post("/reconstructions", { scan_id: this.scanId, follow: true, interval: 1 }, { headers: idempotencyHeaders() });
      this.showWaiting();
    } catch (error) {
      replace(this.host, h("div", { class: "state failed" }, ...errorElements(error)));
    }
  }

  /** Return whether the reconstruction has a revision. */
  hasRevision() {
    const { state, progress } = this.reconstruction;
    this.hasAny ||= state === "succeeded" || (progress.stage === "A-lines" && progress.done > 0);
    return this.hasAny;
  }

  showWaiting() {
    const { state, progress } = this.reconstruction;
    if (state === "queued") showEmpty(this.host, "Image queued", "Waiting for a free worker.");
    else if (state === "running" && !this.running) showEmpty(this.host, "The final image is being computed", "The image appears here when complete.");
    else if (state === "running") showEmpty(this.host, "Image started", progress.stage && progress.stage !== "A-lines" ? `Current step: ${progress.stage}.` : "Waiting for a sufficient number of A-lines.");
    else showEmpty(this.host, "No image", `The reconstruction ${state}.`, h("a", { class: "button", href: `/reconstructions/${this.reconstruction.id}` }, "Details"));
  }

  /** Fetch revisions until the newest one is shown. */
  async readRevisions() {
    this.isDue = true;
    if (this.isBusy) return;
    this.isBusy = true;
    while (this.isDue) {
      this.isDue = false;
      if (this.reconstruction && this.hasRevision()) await this.fetchRevision();
    }
    this.isBusy = false;
  }

  async fetchRevision() {
    try {
      const path = `/reconstructions/${this.reconstruction.id}/revision`;
      const answer = await api.request("GET", path, undefined, { headers: this.etag ? { "If-None-Match": this.etag } : {} });
      if (answer.status === 200) {
        const revision = await answer.json();
        const axis = revision.image.shape.length === 3 ? "z" : "y"; // a line scan has one section
        const slabQuery = revision.final && axis === "z" ? await this.nearFieldQuery() : ""; // earlier revisions do not contain the near field
        if (slabQuery === null) return; // shown after the end of the job
        const image = await api.request("GET", `/reconstructions/${this.reconstruction.id}/mip?axis=${axis}&dtype=uint8&max_size=${MAX_PIXELS}${slabQuery}`, undefined, { accept: "application/octet-stream" });
        this.show(revision, axis, image.headers, new Uint8Array(await image.arrayBuffer()));
        this.etag = answer.headers.get("ETag") ?? "";
      }
    } catch (error) {
      if (!this.etag) replace(this.host, h("div", { class: "state failed" }, ...errorElements(error)));
    }
  }

  /** Return the query that excludes the near field from the final image; null until the report is available. */
  async nearFieldQuery() {
    const view = await api.get(`/reconstructions/${this.reconstruction.id}`);
    if (view.state !== "succeeded") return null;
    const source = createSource(view);
    const first = source ? firstVoxelBelow(source, source.near) : 0;
    return first ? `&slab=${first}:` : "";
  }

  /** @param {any} revision @param {"z" | "y"} axis @param {Headers} headers @param {Uint8Array} values [x, y], or [x, z] of a line */
  show(revision, axis, headers, values) {
    const [nx, ny] = (headers.get("X-Shape") ?? "1,1").split(",").map(Number);
    const [dx, dy] = (headers.get("X-Spacing") ?? "1,1").split(",").map(Number);
    if (values.length < nx * ny) return;
    this.canvas.width = nx;
    this.canvas.height = ny;
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const image = context.createImageData(nx, ny);
    const pixels = new Uint32Array(image.data.buffer);
    const colours = colourTable("inferno");
    for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) pixels[(axis === "z" ? ny - 1 - j : j) * nx + i] = colours[values[i * ny + j]];
    context.putImageData(image, 0, 0);
    this.canvas.style.aspectRatio = `${nx * dx} / ${ny * dy}`;
    this.final = revision.final;
    const { area = null, largest_gap_m: gap = null } = revision.coverage ?? {};
    const [of, whole] = [`${count(revision.points)} of ${count(revision.planned)} A-lines`, revision.points === revision.planned];
    const description = !revision.final ? `revision ${revision.number}, from ${of}` : whole ? `the complete image from ${count(revision.points)} A-lines` : `the final image from ${of}`;
    this.caption.textContent = `Maximum along ${axis}${axis === "z" ? " below the near field" : ""}, ${mm(nx * dx, 1)} × ${mm(ny * dy, 1)}; ${description}${area === null ? "" : `, ${percent(area)} of the area`}${gap === null ? "" : `, largest gap ${length(gap)}`}`;
    if (!this.canvas.isConnected) replace(this.host, this.canvas, this.caption, this.outcome, h("a", { class: "button", href: `/volumes/${this.reconstruction.id}` }, "Open the volume"));
    const open = /** @type {HTMLElement} */ (this.host.querySelector(":scope > a.button"));
    open.hidden = !revision.final;
    this.showOutcome();
  }

  /** Show the state of the final image after the end of the scan. */
  showOutcome() {
    this.outcome.hidden = this.final || this.running || !this.reconstruction;
    if (this.outcome.hidden) {
      replace(this.outcome);
      return;
    }
    const { id, state } = this.reconstruction;
    const isFailed = ["failed", "cancelled"].includes(state);
    this.outcome.classList.toggle("fault", isFailed);
    if (isFailed) replace(this.outcome, `The final image was not created: the reconstruction ${state}. `, h("a", { href: `/reconstructions/${id}` }, "Details"));
    else replace(this.outcome, "The final image is being computed …");
  }
}
