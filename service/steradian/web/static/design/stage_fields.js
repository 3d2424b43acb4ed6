// @ts-check
// Fields of a scan in stages: survey, rule for the points of interest of the focus, and stopping rule.

/** @typedef {import("./fields.js").Field} Field */
/** @typedef {Record<string, number | string>} Stages values in SI units by the key of the field */

const NONE = { unit: "", scale: 1, from: 0, to: 0, step: 1, start: 0 };
const SHARE = { unit: "%", scale: 1e-2, from: 0.05, to: 10, step: 0.01, log: true };

/** @type {(Field & {key: string})[]} */
const STAGE_FIELDS = [
  { ...NONE, key: "survey", name: "survey", label: "Measure", help: "All points of the mask, or a survey of the aperture whose image shows where the other points are needed. A focus serves the direct method; the iterative one fits the whole field better with evenly spread points (correlation 0.993 against 0.982)",
    choices: [["none", "All points at once"], ["focus", "Survey, then focus"]] },
  { ...NONE, key: "survey_points", name: "survey.points", label: "Survey points", from: 16, to: 2000, start: 200, log: true, help: "Evenly spread points measured first; the focus has the rest of the mask's points" },
  { ...NONE, key: "choice", name: "survey.choice", label: "Focus on", help: "Points of interest, which are found in the image of the survey",
    choices: [["brightest", "The brightest place"], ["nearest", "The place nearest to the film"], ["several", "Several places, by brightness"]] },
  { ...NONE, key: "focus_places", name: "survey.count", label: "Places of focus", from: 2, to: 8, start: 2, help: "Points of interest, at most; the points of the focus are shared among them" },
  { ...NONE, key: "decision", name: "survey.decision", label: "Place chosen", help: "Automatically, or by a person: the scan then waits with the laser off",
    choices: [["auto", "Automatically"], ["ask", "Ask me, with the laser off"]] },
  { ...NONE, key: "stopping", name: "stopping", label: "End early", help: "Ends the scan before all points are measured, but not before half of them; needs the scan order coarse first, and one frame",
    choices: [["never", "Never: measure all points"], ["gain", "When the rest improves little"], ["change", "When the rest changes little"]] },
  { ...NONE, ...SHARE, key: "gain", name: "stopping.max_gain", label: "Gain less than", start: 0.4, help: "Expected rise of the correlation of the image with the object by the remaining points" },
  { ...NONE, ...SHARE, key: "change", name: "stopping.max_change", label: "Change less than", start: 0.5, help: "1 − correlation of the image with the one of all points, as expected from the images so far" },
];

/** Choices that show or hide other fields. */
export const STAGE_CHOICES = new Set(["survey", "choice", "stopping"]);

/** Names of the API whose errors are shown at another field. */
export const ERROR_FIELDS = /** @type {Record<string, string>} */ ({ survey: "survey.points", stages: "survey" });

/** @returns {Stages} */
export function defaultStages() {
  return Object.fromEntries(STAGE_FIELDS.map(({ key, choices, start, scale }) => [key, choices ? choices[0][0] : Number((start * scale).toPrecision(12))]));
}

/** Return whether a survey is measured first. @param {Stages} stages */
export const isStaged = (stages) => stages.survey === "focus";

/** Return whether the scan may end before all points are measured. @param {Stages} stages */
export const endsEarly = ({ stopping }) => stopping !== "never";

/** Return the fields that have an effect. @param {Stages} stages */
export function shownStageFields(stages) {
  const hidden = new Set([
    ...(isStaged(stages) ? [] : ["survey_points", "choice", "focus_places", "decision"]),
    ...(stages.choice === "several" ? [] : ["focus_places"]),
    ...["gain", "change"].filter((rule) => rule !== stages.stopping),
  ]);
  return STAGE_FIELDS.filter(({ key }) => !hidden.has(key));
}

/** Return survey and stopping rule in the format of the API. @param {Stages} stages @returns {Record<string, any>} */
export function stagesBody(stages) {
  const { survey_points: points, choice, focus_places: places, decision, stopping, gain, change } = stages;
  return {
    ...(isStaged(stages) ? { survey: { points, choice, decision, ...(choice === "several" ? { count: places } : {}) } } : {}),
    ...(endsEarly(stages) ? { stopping: stopping === "gain" ? { max_gain: gain } : { max_gain: null, max_change: change } } : {}),
  };
}

/** Write the values that differ from the defaults into a query. @param {Stages} stages @param {URLSearchParams} query */
export function writeStages(stages, query) {
  const first = defaultStages();
  for (const { key } of shownStageFields(stages)) if (stages[key] !== first[key]) query.set(key, String(stages[key]));
}

/** @param {URLSearchParams} query @returns {Stages} */
export function readStages(query) {
  const stages = defaultStages();
  for (const { key, choices } of STAGE_FIELDS) {
    const text = query.get(key);
    if (!text) continue;
    if (choices ? choices.some(([one]) => one === text) : Number.isFinite(Number(text))) stages[key] = choices ? text : Number(text);
  }
  return stages;
}
