// @ts-check
// Thumbnails of scans: projection of the newest volume or of the newest revision of the live image, loaded when in sight.
import { api } from "./api.js";
import { h } from "./dom.js";
import { drawProjection, readProjection, showScaleBar, WHITE_LEVEL } from "./volume/projection_image.js";
import { createSource, firstVoxelBelow } from "./volume/volume_data.js";

const PIXELS = 96;
const REFRESH_INTERVAL = 3000; // ms, least time between two images of a scan
const IMAGE_KINDS = new Set(["reconstruction", "live"]); // of the scan's own A-lines

export class ScanThumbnails {
  /** @param {(scanId: string) => void} onVisible called when the row of a scan comes into sight */
  constructor(onVisible) {
    /** @type {Map<string, HTMLCanvasElement>} by identifier of the scan; reused when the table is drawn again */
    this.canvases = new Map();
    /** @type {WeakMap<HTMLCanvasElement, number>} number of the newest request of each canvas; answers to earlier ones are not drawn */
    this.requests = new WeakMap();
    /** @type {WeakMap<HTMLCanvasElement, number>} time of the newest request of each canvas */
    this.times = new WeakMap();
    /** @type {WeakSet<HTMLCanvasElement>} canvases with a planned refresh */
    this.planned = new WeakSet();
    this.observer = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        if (!isIntersecting) continue;
        const canvas = /** @type {HTMLCanvasElement} */ (target);
        this.observer.unobserve(canvas);
        onVisible(canvas.dataset.of ?? "");
        void this.load(canvas);
      }
    }, { rootMargin: "200px" });
  }

  /** Return the thumbnail of a scan, with its scale bar. @param {string} scanId */
  of(scanId) {
    const known = this.canvases.get(scanId);
    if (known) return known.parentElement;
    const canvas = h("canvas", { width: 1, height: 1, "aria-hidden": "true", dataset: { of: scanId } });
    this.canvases.set(scanId, canvas);
    this.observer.observe(canvas);
    return h("span", { class: "scan-thumb", "aria-hidden": "true" }, canvas, h("i", { class: "scale-bar" }));
  }

  /** Load a scan's thumbnail again, because it has a newer image; at most once in an interval. @param {string} scanId */
  refresh(scanId) {
    const canvas = this.canvases.get(scanId);
    if (!canvas || this.planned.has(canvas)) return;
    this.planned.add(canvas);
    const wait = (this.times.get(canvas) ?? -Infinity) + REFRESH_INTERVAL - performance.now();
    setTimeout(() => {
      this.planned.delete(canvas);
      this.observer.observe(canvas);
    }, Math.max(0, wait));
  }

  /** @param {HTMLCanvasElement} canvas */
  async load(canvas) {
    const number = (this.requests.get(canvas) ?? 0) + 1;
    this.requests.set(canvas, number);
    this.times.set(canvas, performance.now());
    try {
      const { items } = await api.get(`/reconstructions?scan_id=${canvas.dataset.of}&state=succeeded&state=running&limit=10`);
      for (const one of items.filter((/** @type {any} */ { kind }) => IMAGE_KINDS.has(kind))) if (await this.draw(canvas, one, number)) return;
    } catch {
      // stays empty; the status bar shows that the service does not answer
    }
  }

  /** Draw the projection of a reconstruction; return false if it has no image yet. @param {HTMLCanvasElement} canvas @param {any} one @param {number} number of the request */
  async draw(canvas, one, number) {
    const source = createSource(one);
    if (!source && (one.kind !== "live" || one.progress.stage !== "A-lines" || !one.progress.done)) return false;
    const axis = source?.flat ? "y" : "z";
    const first = source && !source.flat ? firstVoxelBelow(source, source.near) : 0;
    const query = `axis=${axis}&dtype=uint8&max_size=${PIXELS}${first ? `&slab=${first}:` : ""}${source && source.index !== null ? `&index=${source.index}` : ""}`;
    const answer = await api.request("GET", `/reconstructions/${one.id}/mip?${query}`, undefined, { accept: "application/octet-stream" });
    const plane = await readProjection(answer);
    if (this.requests.get(canvas) !== number) return true; // a later request draws
    drawProjection(canvas, plane, axis, [0, WHITE_LEVEL]);
    showScaleBar(/** @type {HTMLElement | null} */ (canvas.nextElementSibling), answer.headers);
    return true;
  }
}
