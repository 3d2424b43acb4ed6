// @ts-check
// Player of a series: selection of a volume by wavelength, number or name of a map, and playback.
import { h, replace } from "../dom.js";
import { frameText } from "../reconstructions/volume_names.js";
import { wavelengthText } from "../units.js";
import { keepPlayedPlanes } from "./volume_data.js";

/** @typedef {import("./volume_state.js").VolumeState} VolumeState */
/** @typedef {import("./slice_view.js").SliceView} SliceView */

const INTERVAL = 40; // ms that a volume is shown at least
const SAME_LIGHT = 0.5e-9; // m

/** Return the distinct wavelengths of frames in m. @param {any[]} frames */
export function wavelengthsOf(frames) {
  /** @type {number[]} */
  const found = [];
  for (const { excitation_m: light } of frames) if (light && !found.some((one) => Math.abs(one - light) < SAME_LIGHT)) found.push(light);
  return found;
}

export class SeriesPlayer {
  /** @param {VolumeState} stage @param {SliceView[]} views @param {any[]} frames of the report */
  constructor(stage, views, frames) {
    this.stage = stage;
    this.views = views;
    this.frames = frames;
    this.isPlaying = false;
    this.runs = 0; // starts and ends of playback
    const lights = wavelengthsOf(frames);
    this.light = h("select", { "aria-label": "Wavelength", hidden: lights.length < 2, onchange: () => this.selectNearest() },
      h("option", { value: "" }, "all wavelengths"), lights.map((light) => h("option", { value: String(light) }, wavelengthText(light))));
    this.choice = h("select", { "aria-label": "Volume of the series", onchange: () => this.select(Number(this.choice.value)) });
    this.slider = h("input", { type: "range", min: 0, step: 1, "aria-label": "Position in the series" });
    this.slider.addEventListener("input", () => this.select(this.chosen[Number(this.slider.value)]));
    this.button = h("button", { type: "button", dataset: { play: "" }, onclick: () => (this.isPlaying ? this.pause() : void this.play()) }, "Play");
    this.status = h("output", { class: "dim", dataset: { series: "" } });
    const isMaps = frames.some(({ name }) => name);
    this.element = h("div", { class: "row series", role: "group", "aria-label": "Series" }, this.light, this.choice, isMaps ? null : [this.slider, this.button], h("span", { class: "dim nowrap" }, "volume ", this.status));
    stage.store.on((_view, changed) => {
      if (changed.has("index")) this.show();
      if (this.isPlaying && ["at", "slab", "cut", "map", "against"].some((name) => changed.has(name))) keepPlayedPlanes(true); // other planes from now on
    });
    this.show();
  }

  /** Indices of the volumes at the chosen wavelength. */
  get chosen() {
    const light = Number(this.light.value);
    return this.frames.map((_, n) => n).filter((n) => !light || Math.abs(this.frames[n].excitation_m - light) < SAME_LIGHT);
  }

  /** @param {number} index */
  select(index) {
    this.pause();
    this.stage.store.change({ index });
  }

  selectNearest() {
    const { index } = this.stage.view;
    const { chosen } = this;
    this.stage.store.change({ index: chosen.find((n) => n >= index) ?? chosen[chosen.length - 1] });
    this.show();
  }

  show() {
    const { chosen } = this;
    const index = this.stage.source.index ?? 0;
    replace(this.choice, chosen.map((n) => h("option", { value: String(n) }, frameText(this.frames[n]))));
    this.choice.value = String(index);
    this.slider.max = String(chosen.length - 1);
    this.slider.value = String(Math.max(0, chosen.indexOf(index)));
    this.status.textContent = `${chosen.indexOf(index) + 1} of ${chosen.length}`;
  }

  stop() {
    this.isPlaying = false;
    this.runs += 1;
    this.button.textContent = "Play";
    keepPlayedPlanes(false);
  }

  pause() {
    if (!this.isPlaying) return;
    this.stop();
    this.stage.store.notify(["index"]); // overview and histogram of the volume that stays
  }

  /** Show the volumes at the chosen wavelength one after another, again and again. */
  async play() {
    const run = ++this.runs;
    this.isPlaying = true;
    this.button.textContent = "Pause";
    keepPlayedPlanes(true);
    while (run === this.runs) {
      const began = performance.now();
      const { chosen } = this;
      const next = chosen[(chosen.indexOf(this.stage.source.index ?? 0) + 1) % chosen.length];
      try {
        await Promise.all(this.views.map((view) => view.prefetch(next)));
      } catch {
        if (run !== this.runs) return;
        this.stop();
        this.stage.store.change({ index: next });
        return this.stage.store.notify(["index"]); // the views read the volume and show the error
      }
      if (run !== this.runs) return;
      this.stage.store.change({ index: next });
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, INTERVAL - (performance.now() - began))));
    }
  }
}
