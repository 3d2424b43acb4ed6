// @ts-check
// Stages of a running scan, and the choice of points of interest while the scan waits for it.
import { h, replace } from "../dom.js";
import { focusPlaces, isChoosable, nextStage, stageText } from "./stages.js";
import { StageChoice } from "./stage_choice.js";

/** @typedef {import("./stages.js").Stage} Stage */
/** @typedef {import("./shots.js").Shots} Shots */

export class StagePanel {
  /**
   * @param {HTMLElement} host @param {import("./live_image.js").LiveImage} liveImage
   * @param {() => void} changed called when points of interest are chosen
   */
  constructor(host, liveImage, changed) {
    this.host = host;
    this.liveImage = liveImage;
    this.list = h("ol", { class: "stage-list", tabindex: -1, "aria-label": "Stages" });
    this.choice = new StageChoice(liveImage, () => {
      this.list.focus(); // the controls disappear
      changed();
    });
    host.append(h("h2", null, "Stages"), this.list, this.choice.element);
    this.shownKey = "";
  }

  /** @param {any} scan @param {Shots | null} shots @param {{aperture: number, depth: number | null}} mask */
  show(scan, shots, mask) {
    this.host.hidden = !scan.stages;
    if (!scan.stages) return;
    let first = 0;
    const texts = scan.stages.map((/** @type {Stage} */ stage, /** @type {number} */ n) => {
      const points = n ? stage.points ?? 0 : (stage.points ?? shots?.points ?? 0);
      const measured = { points, stored: shots ? countStored(shots, first, points) : 0 };
      first += points;
      return [n ? "Focus" : "Survey", stageText(scan, stage, measured)];
    });
    const key = JSON.stringify(texts);
    if (key !== this.shownKey) {
      this.shownKey = key;
      replace(this.list, texts.map((/** @type {string[]} */ [name, text]) => h("li", null, h("strong", null, `${name}:`), ` ${text}`)));
    }
    const next = nextStage(scan);
    if (next && isChoosable(scan)) this.choice.show(scan, next, mask);
    else this.choice.hide();
    this.liveImage.markers.setFocus(focusPlaces(scan));
  }
}

/** Return the stored points of the first frame in a range of the mask. @param {Shots} shots @param {number} first @param {number} points */
function countStored(shots, first, points) {
  return shots.stored.subarray(first, Math.min(first + points, shots.points)).reduce((sum, one) => sum + one, 0);
}
