// @ts-check
// Status of each A-line of a scan, updated incrementally.

/** Quality flags: bit, name on the page, name in the API. */
export const FLAGS = /** @type {[number, string, string][]} */ ([
  [1, "saturated", "saturated"], [2, "mistuned", "mistuned"], [4, "misfired", "misfired"], [8, "partially averaged", "partial"],
]);

export class Shots {
  /** @param {number} points of the mask @param {number} frames */
  constructor(points, frames) {
    this.points = points;
    this.stored = new Uint8Array(points * frames);
    this.quality = new Uint32Array(points * frames);
    this.timeZero = new Float64Array(points * frames); // s from the laser pulse to the first sample
    /** @type {any} counts of the service */
    this.coverage = { points: points * frames, frames, stored: 0, missing: points * frames, fired: 0, flags: {} };
    this.newest = -1;
    this.cursor = "";
  }

  /** Return the path of the shots after the last update. @param {string} id of the scan */
  path(id) {
    return `/scans/${id}/shots${this.cursor ? `?since=${encodeURIComponent(this.cursor)}` : ""}`;
  }

  /** Keep the status of the points of earlier stages until the next update. @param {Shots} before */
  keep(before) {
    for (let row = 0; row < before.stored.length; row++) {
      const now = Math.floor(row / before.points) * this.points + (row % before.points);
      this.stored[now] = before.stored[row];
      this.quality[now] = before.quality[row];
      this.timeZero[now] = before.timeZero[row];
    }
    const { stored, fired, flags } = before.coverage;
    this.coverage = { ...this.coverage, stored, fired, flags, missing: this.coverage.points - stored };
  }

  /**
   * Apply an update; return false if the file has the points of another mask.
   * @param {any} response an answer of that address
   */
  apply(response) {
    if (response.coverage.points !== this.stored.length) return false;
    for (let n = 0; n < response.points.length; n++) {
      const row = response.frames[n] * this.points + response.points[n];
      this.stored[row] = Number(response.stored[n]);
      this.quality[row] = response.quality[n];
      this.timeZero[row] = response.time_zero[n] ?? 0;
    }
    this.coverage = response.coverage;
    this.newest = response.newest ?? -1;
    this.cursor = response.next;
    return true;
  }
}
