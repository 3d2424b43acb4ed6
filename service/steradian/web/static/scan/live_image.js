// @ts-check
// The image of a scan that grows while it runs: the newest revision's projection, and how much it is made of.
import { api, onceOnly } from "../api.js";
import { h, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { empty, words } from "../panel_states.js";
import { count, length, mm, percent } from "../units.js";
import { firstBelow, sourceOf } from "../volume/volume_data.js";
import { table } from "../volume/colours.js";

const SIZE = 512;
const LOOK = 1000; // ms between two looks while the event stream is cut

export class Growing {
  /** @param {HTMLElement} host @param {string} scanId @param {() => Node[]} offers what can follow a scan that is over */
  constructor(host, scanId, offers) {
    this.host = host;
    this.scanId = scanId;
    this.offers = offers;
    this.canvas = h("canvas", { role: "img", "aria-label": "Maximum of the image along z" });
    this.caption = h("p", { class: "dim caption" });
    this.outcome = h("p", { class: "caption", role: "status", hidden: true });
    /** @type {any} the reconstruction */
    this.job = null;
    this.etag = "";
    this.running = false;
    this.busy = this.due = false;
    live.on("reconstruction", (event) => (event.id === this.job?.id || (!this.job && event.scan_id === scanId)) && this.find());
    live.on("revision", (event) => {
      if (event.scan_id !== scanId) return;
      if (event.id !== this.job?.id) return void this.find();
      this.any = true;
      void this.look();
    });
    live.on("progress", (event) => event.id === this.job?.id && (this.job.progress = event));
    live.on("again", () => void this.find());
    setInterval(() => live.state.is === "cut" && !document.hidden && this.job && !this.final && void this.find(), LOOK);
    this.final = false;
    this.any = false;
  }

  /** Find the reconstruction that follows this scan, or offer one. */
  async find() {
    try {
      const found = (await api.get(`/reconstructions?kind=live&scan_id=${this.scanId}&limit=1`)).items[0];
      this.job = found ?? null;
      if (!found) this.offer();
      else if (this.exists()) await this.look().then(() => this.tell());
      else this.wait();
    } catch (error) {
      if (!this.canvas.isConnected) replace(this.host, h("div", { class: "state failed" }, ...words(error)));
    }
  }

  offer() {
    if (!this.running) {
      empty(this.host, "No image was followed", "What is stored can be reconstructed now.", ...this.offers());
      return;
    }
    const start = h("button", { type: "button", class: "primary", onclick: () => { start.disabled = true; void this.follow(); } }, "Watch the image grow");
    empty(this.host, "No image yet", "A worker can reconstruct what is there every few seconds.", start);
  }

  async follow() {
    try {
      this.job = await api.post("/reconstructions", { scan_id: this.scanId, follow: true, interval: 1 }, { headers: onceOnly() });
      this.wait();
    } catch (error) {
      replace(this.host, h("div", { class: "state failed" }, ...words(error)));
    }
  }

  /** Whether there is a revision: its job says so. */
  exists() {
    const { state, progress } = this.job;
    this.any ||= state === "succeeded" || (progress.stage === "A-lines" && progress.done > 0);
    return this.any;
  }

  wait() {
    const { state, progress } = this.job;
    if (state === "queued") empty(this.host, "The image waits", "for a worker that is free.");
    else if (state === "running" && !this.running) empty(this.host, "The final image is being made", "It will be here.");
    else if (state === "running") empty(this.host, "The image begins", progress.stage && progress.stage !== "A-lines" ? `A worker is at it: ${progress.stage}.` : "as soon as enough A-lines are there.");
    else empty(this.host, "No image", `Its reconstruction ${state}.`, h("a", { class: "button", href: `/reconstructions/${this.job.id}` }, "Why"));
  }

  /** Ask for a revision newer than the one that is shown; once more, where another came meanwhile. */
  async look() {
    this.due = true;
    if (this.busy) return;
    this.busy = true;
    while (this.due) {
      this.due = false;
      if (this.job && this.exists()) await this.fetch();
    }
    this.busy = false;
  }

  async fetch() {
    try {
      const path = `/reconstructions/${this.job.id}/revision`;
      const answer = await api.ask("GET", path, undefined, { headers: this.etag ? { "If-None-Match": this.etag } : {} });
      if (answer.status === 200) {
        const revision = await answer.json();
        const axis = revision.image.shape.length === 3 ? "z" : "y"; // of a line there is one section;
        const part = revision.final && axis === "z" ? await this.part() : ""; // until then it is left out where it is made
        if (part === null) return; // when its job is over is told
        const image = await api.ask("GET", `/reconstructions/${this.job.id}/mip?axis=${axis}&dtype=uint8&max_size=${SIZE}${part}`, undefined, { accept: "application/octet-stream" });
        this.show(revision, axis, image.headers, new Uint8Array(await image.arrayBuffer()));
        this.etag = answer.headers.get("ETag") ?? "";
      }
    } catch (error) {
      if (!this.etag) replace(this.host, h("div", { class: "state failed" }, ...words(error)));
    }
  }

  /** What to ask for of the final image: that without the near field, as on its page; null while that is not known. */
  async part() {
    const view = await api.get(`/reconstructions/${this.job.id}`);
    if (view.state !== "succeeded") return null;
    const source = sourceOf(view);
    const first = source ? firstBelow(source, source.near) : 0;
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
    const colours = table("inferno");
    for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) pixels[(axis === "z" ? ny - 1 - j : j) * nx + i] = colours[values[i * ny + j]];
    context.putImageData(image, 0, 0);
    this.canvas.style.aspectRatio = `${nx * dx} / ${ny * dy}`;
    this.final = revision.final;
    const { area = null, largest_gap_m: gap = null } = revision.coverage ?? {};
    const [of, whole] = [`${count(revision.points)} of ${count(revision.planned)} A-lines`, revision.points === revision.planned];
    const made = !revision.final ? `revision ${revision.number}, of ${of}` : whole ? `the whole image of ${count(revision.points)} A-lines` : `the final image, of ${of}`;
    this.caption.textContent = `Maximum along ${axis}${axis === "z" ? " below the near field" : ""}, ${mm(nx * dx, 1)} × ${mm(ny * dy, 1)}; ${made}${area === null ? "" : `, ${percent(area)} of the area`}${gap === null ? "" : `, largest gap ${length(gap)}`}`;
    if (!this.canvas.isConnected) replace(this.host, this.canvas, this.caption, this.outcome, h("a", { class: "button", href: `/volumes/${this.job.id}` }, "Open the volume"));
    const open = /** @type {HTMLElement} */ (this.host.querySelector(":scope > a.button"));
    open.hidden = !revision.final;
    this.tell();
  }

  /** Say what becomes of the image of a scan that is over, as long as it is not the whole one. */
  tell() {
    this.outcome.hidden = this.final || this.running || !this.job;
    if (this.outcome.hidden) return;
    const { id, state } = this.job;
    const lost = ["failed", "cancelled"].includes(state);
    this.outcome.classList.toggle("fault", lost);
    if (lost) replace(this.outcome, `The final image was not made: its reconstruction ${state}. `, h("a", { href: `/reconstructions/${id}` }, "Why"));
    else replace(this.outcome, "The final image is being made …");
  }
}
