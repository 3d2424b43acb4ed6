// @ts-check
// Named measurements of a volume: the service computes and keeps them.
import { api, idempotencyHeaders } from "../api.js";
import { voxelIndex, voxelPosition } from "./volume_data.js";

/** @typedef {import("./view_state.js").Mark} Mark */
/** @typedef {import("./view_state.js").Axis} Axis */
/** @typedef {[number, number]} Pair */
/** @typedef {"profile" | "region" | "contrast" | "point"} Kind */
/**
 * Definition of a measurement; lengths in m, positions along the axes of the plane across `axis`.
 * @typedef {{kind: Kind, name: string, index: number | null, axis: Axis, slab: Pair | null, start: Pair, end?: Pair, background_start?: Pair, background_end?: Pair}} Definition
 * @typedef {{measurement: Definition, figures: Record<string, number | null>, ends: number[][], reason: string, state: string | null, correction: any, links: {job?: string}}} Measured
 */

const TOLERANCE = 1e-9; // m, within which positions are equal
const UNFINISHED = ["queued", "running", "cancelling"];
const metres = (/** @type {Pair} */ place) => /** @type {Pair} */ (place.map((mm) => 1e-3 * mm));

/** Return whether two definitions measure the same. @param {Omit<Definition, "name">} one @param {Omit<Definition, "name">} other */
function isSame(one, other) {
  const numbers = (/** @type {Omit<Definition, "name">} */ { slab, start, end, background_start: from, background_end: to }) => [slab, start, end, from, to].flatMap((pair) => pair ?? [NaN, NaN]);
  const others = numbers(other);
  return one.kind === other.kind && one.index === other.index && one.axis === other.axis
    && numbers(one).every((value, n) => Object.is(value, others[n]) || Math.abs(value - others[n]) < TOLERANCE);
}

export class MeasurementStore {
  /** @param {import("./volume_state.js").VolumeState} stage @param {any} reconstruction the reconstruction, of the API */
  constructor(stage, reconstruction) {
    this.stage = stage;
    this.reconstruction = reconstruction;
    this.path = `/reconstructions/${reconstruction.id}/measurements`;
    /** @type {Measured[]} */
    this.items = [];
    /** @type {string | null} name of the measurement whose details are shown */
    this.selectedName = null;
    /** @type {unknown} error of the last request */
    this.error = null;
    this.etag = "";
    /** @type {Set<() => void>} */
    this.listeners = new Set();
  }

  /** @type {Measured | null} */
  get selected() {
    return this.items.find((item) => item.measurement.name === this.selectedName) ?? null;
  }

  notify() {
    for (const act of this.listeners) act();
  }

  /** @param {string | null} name */
  select(name) {
    if (name === this.selectedName) return;
    this.selectedName = name;
    this.notify();
  }

  async load() {
    await this.handle(async () => this.adopt(await api.request("GET", this.path)));
  }

  /** Change the definitions; repeat the change where another browser was first. @param {(all: Definition[]) => Definition[]} act */
  async change(act) {
    const send = async () => this.adopt(await api.request("PUT", this.path, { items: act(this.items.map((item) => item.measurement)) }, { headers: { "If-Match": this.etag } }));
    return this.handle(async () => {
      try {
        await send();
      } catch (error) {
        if (/** @type {any} */ (error).status !== 412) throw error;
        await this.adopt(await api.request("GET", this.path));
        await send();
      }
    });
  }

  /** Add a measurement with the first free name and select it. @param {Omit<Definition, "name">} definition @returns {Promise<boolean>} whether it was measured */
  async add(definition) {
    let name = "";
    return this.change((all) => {
      const names = new Set(all.map((one) => one.name));
      let number = 1;
      while (names.has(`${definition.kind} ${number}`)) number += 1;
      name = `${definition.kind} ${number}`;
      return [...all, { ...definition, name }];
    }).then((isMeasured) => {
      if (isMeasured) this.select(name);
      return isMeasured;
    });
  }

  /** @param {string} name */
  remove(name) {
    return this.change((all) => all.filter((one) => one.name !== name));
  }

  /** @param {string} name @param {string} wanted */
  async rename(name, wanted) {
    const isRenamed = await this.change((all) => all.map((one) => (one.name === name ? { ...one, name: wanted } : one)));
    if (isRenamed) this.select(wanted);
  }

  /** Whether the service corrects the width of a profile for the point spread. @param {Measured} item */
  isCorrectable(item) {
    return item.ends.length === 2 && !["what-if", "unmixing"].includes(this.reconstruction.kind);
  }

  /** Queue a job that corrects the width of a profile. @param {Measured} item */
  async correct(item) {
    const { scan_id, id, frame, wavelength, average } = this.reconstruction;
    const { index } = item.measurement;
    const [start, end] = item.ends;
    const body = { kind: "width", scan_id, reconstruction_id: id, start, end, ...(index === null ? { frame, wavelength, average } : { index }) };
    await this.handle(async () => {
      let job = await api.post("/jobs", body, { headers: idempotencyHeaders() });
      await this.adopt(await api.request("GET", this.path));
      while (UNFINISHED.includes(job.state)) job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
      if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the measurement ${job.state}`);
      await this.adopt(await api.request("GET", this.path));
    });
  }

  /** @param {Response} response */
  async adopt(response) {
    this.etag = response.headers.get("ETag") ?? "*";
    this.items = (await response.json()).items;
    this.notify();
  }

  /** @param {() => Promise<unknown>} act */
  async handle(act) {
    this.error = null;
    try {
      await act();
    } catch (error) {
      this.error = error;
    }
    this.notify();
    return this.error === null;
  }

  /** Return the measurement that has a definition; null if none has. @param {Omit<Definition, "name">} definition */
  keptAs(definition) {
    return this.items.find(({ measurement }) => isSame(measurement, definition)) ?? null;
  }

  /** Return the definition, without a name, of a mark in the slice or slab that its view shows. @param {Kind} kind @param {Mark} mark @returns {Omit<Definition, "name">} */
  definitionOf(kind, mark) {
    const { source } = this.stage;
    const { from, to } = this.stage.range(mark.plane);
    const slab = source.flat ? null : metres([voxelPosition(source, mark.plane, from), voxelPosition(source, mark.plane, to - 1)]);
    return { kind, index: source.index, axis: mark.plane, slab, start: metres(mark.from), ...(kind === "point" ? {} : { end: metres(mark.to) }) };
  }

  /** Return the definition of the value at the crosshair. @returns {Omit<Definition, "name">} */
  definitionOfCrosshair() {
    const { source, position: [x, y, z] } = this.stage;
    if (source.flat) return { kind: "point", index: source.index, axis: "y", slab: null, start: metres([x, z]) };
    const depth = 1e-3 * voxelPosition(source, "z", voxelIndex(source, "z", z));
    return { kind: "point", index: source.index, axis: "z", slab: [depth, depth], start: metres([x, y]) };
  }

  /** Return the contrast of a region to a background; null without a region in the plane of the background. @param {Mark} background */
  contrastOf(background) {
    const draft = this.stage.view.region;
    const hasRegion = (/** @type {Measured | null | undefined} */ item) => item?.measurement.end && item.measurement.kind !== "profile" && item.measurement.axis === background.plane && item.measurement.index === this.stage.source.index;
    const item = [this.selected, ...[...this.items].reverse()].find(hasRegion);
    const region = draft?.plane === background.plane ? this.definitionOf("contrast", draft) : item?.measurement;
    if (!region) return null;
    const { index, axis, slab, start, end } = region;
    return { kind: /** @type {const} */ ("contrast"), index, axis, slab, start, end, background_start: metres(background.from), background_end: metres(background.to) };
  }
}
