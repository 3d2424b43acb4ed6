// @ts-check
// Image of a scan: projection of the newest revision of its live reconstruction, else of its newest volume.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showEmpty, errorElements } from "../panel_states.js";
import { count, length, mm, percent } from "../units.js";
import { urlOf } from "../urls.js";
import { depthsText } from "../volume/scale.js";
import { createSource, firstVoxelBelow, projectedDepths } from "../volume/volume_data.js";
import { methodText } from "../reconstructions/summary.js";
import { depthAt } from "./depth_estimate.js";
import { PlaceMarkers } from "./place_markers.js";
import { Projection } from "./projection.js";

const MAX_PIXELS = 512;
const POLL_INTERVAL = 1000; // ms between two polls while the event stream is interrupted

/** @param {any} reconstruction */
const hasEnded = ({ state }) => ["failed", "cancelled"].includes(state);

export class LiveImage {
  /** @param {HTMLElement} host @param {HTMLElement} share shows of how many A-lines an image of a part is @param {string} scanId @param {() => Node[]} actions for a finished scan */
  constructor(host, share, scanId, actions) {
    this.host = host;
    this.share = share;
    this.scanId = scanId;
    this.actions = actions;
    this.markers = new PlaceMarkers();
    this.projection = new Projection(this.markers);
    this.canvas = this.projection.canvas;
    this.openLink = h("a", { class: "button", hidden: true }, "Open the volume");
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
    this.depths = ""; // of the projection, for its caption
  }

  /** Find the live reconstruction of the scan or its newest volume, or offer to start one. */
  async findReconstruction() {
    try {
      const item = (await api.get(`/reconstructions?kind=live&scan_id=${this.scanId}&limit=1`)).items[0];
      this.reconstruction = item ?? null;
      if (!item && !this.running && (await this.showNewestVolume())) return;
      if (!item) this.showOffer();
      else if (this.hasRevision()) await this.readRevisions().then(() => this.showOutcome());
      else if (this.running || !hasEnded(item) || !(await this.showNewestVolume())) this.showWaiting();
    } catch (error) {
      if (!this.canvas.isConnected) replace(this.host, h("div", { class: "state failed" }, ...errorElements(error)));
    }
  }

  /** Show the newest volume of a finished scan without a live image; return false if there is none. */
  async showNewestVolume() {
    const { items } = await api.get(`/reconstructions?scan_id=${this.scanId}&state=succeeded&kind=reconstruction&limit=1`);
    const source = items[0] ? createSource(items[0]) : null;
    if (!source) return false;
    const axis = source.flat ? "y" : "z";
    const first = source.flat ? 0 : firstVoxelBelow(source, source.near);
    const image = await this.fetchImage(source.id, axis, `${first ? `&slab=${first}:` : ""}${source.index === null ? "" : `&index=${source.index}`}`);
    const size = this.projection.show(axis, image.headers, new Uint8Array(await image.arrayBuffer()));
    if (!size) return false;
    this.final = true;
    this.caption.textContent = `Maximum along ${axis}${axis === "z" ? `, ${depthsText(projectedDepths(source))}` : ""}, ${mm(size[0], 1)} × ${mm(size[1], 1)}; newest volume: ${methodText(items[0])}`;
    this.insert(source.id, true);
    return true;
  }

  /** Show the image, if another state is shown. @param {string} id of the reconstruction @param {boolean} isFinal */
  insert(id, isFinal) {
    if (!this.canvas.isConnected) replace(this.host, this.projection.element, h("div", { class: "stack image-foot" }, this.caption, this.outcome, this.openLink));
    this.openLink.href = urlOf(`/volumes/${id}`);
    this.openLink.hidden = !isFinal;
  }

  /** @param {string} id @param {string} axis @param {string} query */
  fetchImage(id, axis, query) {
    return api.request("GET", `/reconstructions/${id}/mip?axis=${axis}&dtype=uint8&max_size=${MAX_PIXELS}${query}`, undefined, { accept: "application/octet-stream" });
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
        const source = revision.final && axis === "z" ? await this.finalSource() : null; // earlier revisions do not contain the near field
        if (source === undefined) return; // shown after the end of the job
        const first = source ? firstVoxelBelow(source, source.near) : 0;
        const image = await this.fetchImage(this.reconstruction.id, axis, first ? `&slab=${first}:` : "");
        this.depths = axis === "y" ? "" : source ? `, ${depthsText(projectedDepths(source))}` : " below the near field";
        this.show(revision, axis, image.headers, new Uint8Array(await image.arrayBuffer()));
        this.etag = answer.headers.get("ETag") ?? "";
      }
    } catch (error) {
      if (!this.etag) replace(this.host, h("div", { class: "state failed" }, ...errorElements(error)));
    }
  }

  /** Return the volume of the final image; undefined until the report is available, null if it has no positions. */
  async finalSource() {
    const view = await api.get(`/reconstructions/${this.reconstruction.id}`);
    return view.state === "succeeded" ? createSource(view) : undefined;
  }

  /** @param {any} revision @param {"z" | "y"} axis @param {Headers} headers @param {Uint8Array} values [x, y], or [x, z] of a line */
  show(revision, axis, headers, values) {
    const size = this.projection.show(axis, headers, values);
    if (!size) return;
    this.final = revision.final;
    const { area = null, largest_gap_m: gap = null } = revision.coverage ?? {};
    const [of, whole] = [`${count(revision.points)} of ${count(revision.planned)} A-lines`, revision.points === revision.planned];
    this.share.textContent = revision.final && !whole ? `from ${of}${area === null ? "" : `, ${percent(area)} of the area`}; amplitudes differ from those of a whole scan` : "";
    const description = !revision.final ? `revision ${revision.number}, from ${of}` : whole ? `the complete image from ${count(revision.points)} A-lines` : `the final image from ${of}`;
    this.caption.textContent = `Maximum along ${axis}${this.depths}, ${mm(size[0], 1)} × ${mm(size[1], 1)}; ${description}${area === null ? "" : `, ${percent(area)} of the area`}${gap === null ? "" : `, largest gap ${length(gap)}`}`;
    this.insert(this.reconstruction.id, revision.final);
    this.showOutcome();
  }

  /** Return the depth (m) of the maximum at a place of the shown image; null if it is not known. @param {[number, number]} place x and y in metres */
  async depthAt(place) {
    if (!this.etag || this.canvas.width < 2) return null;
    try {
      const [x, y, z] = await Promise.all(["x", "y", "z"].map((axis) => this.fetchProjection(axis)));
      return depthAt({ x, y, z }, place);
    } catch {
      return null; // the place keeps its depth, which the user can change
    }
  }

  /** @param {string} axis */
  async fetchProjection(axis) {
    const answer = await api.request("GET", `/reconstructions/${this.reconstruction.id}/mip?axis=${axis}&dtype=float32&max_size=${MAX_PIXELS}`, undefined, { accept: "application/octet-stream" });
    const [shape, origin, spacing] = ["X-Shape", "X-Origin", "X-Spacing"].map((name) => (answer.headers.get(name) ?? "").split(",").map(Number));
    return { values: new Float32Array(await answer.arrayBuffer()), shape, origin, spacing };
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
