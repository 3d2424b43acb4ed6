// @ts-check
// Stages of a scan: which comes next, whether it waits for a choice, and their descriptions.
import { count, length, mm } from "../units.js";
import { FINAL_STATES, STATE_LABELS } from "./states.js";

/** @typedef {[number, number, number]} Place x, y and depth in metres */
/** @typedef {{position: Place, signal_to_noise: number, promise: Record<string, number>}} Proposal of the API */
/** @typedef {{number: number, state: string, points: number | null, decision: string | null, points_of_interest: Place[], proposals: Proposal[], decided_by: string}} Stage of the API */

const DECIDED_BY = /** @type {Record<string, string>} */ ({ auto: "chosen automatically", plan: "given by the plan" });

/** Return the stage whose points are not in the file yet; null if there is none. @param {any} scan @returns {Stage | null} */
export const nextStage = (scan) => scan.stages?.find((/** @type {Stage} */ { state }) => state !== "made") ?? null;

/** Return whether the laser is off until a person chooses a point of interest. @param {any} scan */
export function isWaiting(scan) {
  const stage = nextStage(scan);
  return scan.state === "paused" && stage?.state === "proposed" && (stage.decision === "ask" || !stage.proposals.length);
}

/** Return whether the points of interest of the next stage can be chosen now. @param {any} scan */
export function isChoosable(scan) {
  return isWaiting(scan) || (scan.state === "interrupted" && ["proposed", "decided"].includes(nextStage(scan)?.state ?? ""));
}

/** Return whether a scan is over without its focus. @param {any} scan */
export const isSurveyOnly = (scan) => FINAL_STATES.has(scan.state) && (scan.summary?.stored ?? 0) > 0 && nextStage(scan) !== null;

/** Return the label of a scan's state. @param {any} scan */
export function stateLabel(scan) {
  if (isWaiting(scan)) return "waiting for a point of interest";
  if (scan.state === "paused" && scan.desired_state === "running" && nextStage(scan)) return "planning the next stage";
  const label = STATE_LABELS[scan.state] ?? scan.state;
  if (isSurveyOnly(scan)) return `${scan.state === "partial" ? "stopped" : label}, survey only`;
  return label;
}

/** Return the points that the further stages add at most. @param {any} scan */
export function pointsToCome(scan) {
  const further = FINAL_STATES.has(scan.state) ? [] : (scan.stages ?? []).filter((/** @type {Stage} */ { state }) => state !== "made");
  return further.reduce((/** @type {number} */ sum, /** @type {Stage} */ { points }) => sum + (points ?? 0), 0);
}

/** Return the points of interest of the stages that are made or decided. @param {any} scan @returns {Place[]} */
export const focusPlaces = (scan) => (scan.stages ?? []).flatMap((/** @type {Stage} */ stage) => stage.points_of_interest);

/** @param {Place} place */
export const placeText = ([x, y, depth]) => `x ${mm(x)}, y ${mm(y)}, depth ${mm(depth)}`;

/** Describe the figure that proposals promise: the width of a small ball's image after the focus. @param {Proposal[]} proposals */
export function promiseName([{ promise }]) {
  return promise.true_m ? `width of a ball of ${length(promise.true_m)}` : "expected width";
}

/** @param {Proposal} proposal */
export const promiseText = ({ promise }) => length(promise.lateral_m, 2);

/** Describe a stage. @param {any} scan @param {Stage} stage @param {{points: number, stored: number}} measured points of the stage in the file, and those stored */
export function stageText(scan, stage, { points, stored }) {
  const most = `up to ${count(stage.points)} points`;
  if (stage.state === "made") return [stored < points ? `${count(stored)} of ${count(points)} points measured` : `${count(points)} points measured`, choiceText(stage)].filter(Boolean).join("; ");
  if (FINAL_STATES.has(scan.state)) return "not measured";
  if (stage.state === "decided") return [choiceText(stage), most].join("; ");
  if (stage !== nextStage(scan) || scan.state !== "paused") return stage.decision === "ask" ? `${most}; the scan waits for your choice of the place` : most;
  if (isWaiting(scan)) return `${most}; waiting for a point of interest`;
  return `${most}; searching the image for points of interest`;
}

/** @param {Stage} stage */
function choiceText({ points_of_interest: places, decided_by: who }) {
  if (!places.length) return "";
  return `around ${places.map(placeText).join(" and ")}, ${DECIDED_BY[who] ?? `chosen by ${who}`}`;
}
