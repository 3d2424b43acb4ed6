// @ts-check
// Search for the speed of sound: curve of sharpness, with links to reconstructions at each speed.
import { api, idempotencyHeaders } from "../api.js";
import { h, replace, s } from "../dom.js";
import { errorElements } from "../panel_states.js";
import { formatDate, signed } from "../units.js";
import { ticks } from "./scale.js";

const [WIDTH, HEIGHT, LEFT, TOP, BOTTOM] = [264, 172, 34, 22, 36];
const RANGE_SHARE = 0.04; // half width of the initial range, relative to the speed

/** @param {any} reconstruction the reconstruction, of the API */
export function soundSpeedPanel(reconstruction) {
  /** @type {number | undefined} */
  const reportedSpeed = reconstruction.report?.sound_speed_m_s;
  const startSpeed = reportedSpeed ?? 1500;
  const number = (/** @type {number} */ value, /** @type {string} */ label) => h("input", { type: "number", class: "short", min: 300, max: 6000, step: 1, value: String(Math.round(value)), "aria-label": label });
  const first = number(startSpeed * (1 - RANGE_SHARE), "Lowest speed (m/s)");
  const last = number(startSpeed * (1 + RANGE_SHARE), "Highest speed (m/s)");
  const curve = h("div", { class: "stack" });
  const status = h("p", { class: "dim small", role: "status" });
  const button = h("button", { type: "button", onclick: () => void startSearch() }, "Try 21 speeds");
  const element = h("div", { class: "stack" },
    h("p", { class: "dim small" }, "Finds the speed of sound whose image fits the A-lines best; ± is its standard error. For comparison, the curve shows the image's sharpness at each speed."),
    h("div", { class: "row" }, h("label", null, "from ", first), h("label", null, "to ", last, " m/s"), button), status, curve);

  async function load() {
    try {
      const { items } = await api.get(`/jobs?kind=sound-speed&scan_id=${reconstruction.scan_id}&limit=20`);
      const finished = items.find((/** @type {any} */ job) => job.state === "succeeded" && (job.result?.sharpness || job.result?.parameters));
      const running = items.find((/** @type {any} */ job) => ["queued", "running"].includes(job.state));
      if (finished) show(finished);
      if (running) await waitForJob(running);
    } catch (error) {
      replace(status, ...errorElements(error));
    }
  }

  async function startSearch() {
    button.disabled = true;
    const { sound_speed: _speed, ...parameters } = reconstruction.parameters;
    const range = parameters.medium ? {} : { first: first.valueAsNumber, last: last.valueAsNumber, steps: 21 };
    const body = { kind: "sound-speed", scan_id: reconstruction.scan_id, ...range, parameters };
    try {
      await waitForJob(await api.post("/jobs", body, { headers: idempotencyHeaders() }));
    } catch (error) {
      replace(status, ...errorElements(error));
    }
    button.disabled = false;
  }

  /** @param {any} job */
  async function waitForJob(job) {
    while (["queued", "running", "cancelling"].includes(job.state)) {
      status.textContent = job.progress.total ? `${job.progress.done} of ${job.progress.total}` : "queued …";
      job = await api.get(job.links.self, { headers: { Prefer: "wait=5" } });
    }
    if (job.state !== "succeeded") throw new Error(job.error?.detail ?? `the search ${job.state}`);
    show(job);
  }

  /** @param {any} job */
  function show(job) {
    if (job.result.parameters) {
      status.textContent = `Layers, computed ${formatDate(job.ended)}.`;
      replace(curve, ...job.result.parameters.map(parameterText), ...noteElements(job));
      return;
    }
    const { sound_speeds: speeds, sharpness, best, standard_error: error, at_edge: edge } = job.result;
    status.textContent = `Best fit at ${signed(best, 1)}${error ? ` ± ${signed(error, 1)}` : ""} m/s, computed ${formatDate(job.ended)}${edge ? ". The optimum is at the edge: shift the range" : ""}.`;
    const rerunUrl = (/** @type {number} */ speed) => `/reconstructions?again=${reconstruction.id}&set=${encodeURIComponent(JSON.stringify({ sound_speed: Number(speed.toFixed(1)) }))}`;
    replace(curve, chart(speeds, sharpness, reportedSpeed, rerunUrl),
      h("a", { class: "button", href: rerunUrl(best) }, `Rerun at ${signed(best, 1)} m/s`),
      ...noteElements(job),
      h("p", { class: "dim small" }, `${reportedSpeed && reportedSpeed >= speeds[0] && reportedSpeed <= speeds[speeds.length - 1] ? `Dashed line: this volume, ${signed(reportedSpeed, 1)} m/s. ` : ""}Or select a point of the curve.`));
  }

  return { element, open: load };
}

/** @param {any} job */
const noteElements = (job) => (job.result.notes ?? []).map((/** @type {string} */ note) => h("p", { class: "dim small" }, `Note: ${note}.`));

/** @param {any} found one parameter of the medium, of the API */
function parameterText({ name, value, standard_error: error, unit, at_edge: edge }) {
  return h("p", null, `${name}: ${value.toPrecision(5)}${error ? ` ± ${error.toPrecision(2)}` : ""} ${unit}${edge ? ", at the end of the range" : ""}`);
}

/** @param {number[]} speeds @param {number[]} sharpness @param {number | undefined} startSpeed @param {(speed: number) => string} rerunUrl */
function chart(speeds, sharpness, startSpeed, rerunUrl) {
  const [low, high] = [speeds[0], speeds[speeds.length - 1]];
  const x = (/** @type {number} */ speed) => LEFT + ((WIDTH - LEFT - 8) * (speed - low)) / (high - low);
  const top = Math.max(...sharpness);
  const bottom = Math.min(...sharpness);
  const y = (/** @type {number} */ value) => HEIGHT - BOTTOM - ((HEIGHT - BOTTOM - TOP) * (value - bottom)) / (top - bottom || 1);
  return s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "profile", role: "group", "aria-label": "Sharpness against the speed of sound" },
    ticks(low, high, 4).map((speed) => s("text", { x: x(speed), y: HEIGHT - 22, "text-anchor": "middle" }, String(speed))),
    s("text", { x: 2, y: 11 }, "sharpness (% of maximum)"),
    [top, bottom].map((value) => s("text", { x: LEFT - 4, y: y(value) + 4, "text-anchor": "end" }, String(Math.round((100 * value) / top)))), s("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 5, "text-anchor": "middle" }, "speed of sound (m/s)"),
    s("path", { class: "axis", d: `M${LEFT} ${TOP - 6}V${HEIGHT - BOTTOM}H${WIDTH}` }),
    startSpeed && startSpeed >= low && startSpeed <= high ? s("path", { class: "width", d: `M${x(startSpeed)} ${TOP - 6}V${HEIGHT - BOTTOM}` }) : null,
    s("path", { class: "curve", d: speeds.map((speed, n) => `${n ? "L" : "M"}${x(speed).toFixed(1)} ${y(sharpness[n]).toFixed(1)}`).join("") }),
    speeds.map((speed, n) => s("a", { href: rerunUrl(speed), "aria-label": `Rerun at ${signed(speed, 1)} m/s`, dataset: { speed: String(speed) } },
      s("circle", { cx: x(speed), cy: y(sharpness[n]), r: 4 }), s("title", null, `${signed(speed, 1)} m/s: ${sharpness[n].toPrecision(4)}`))));
}
