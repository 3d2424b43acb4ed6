// @ts-check
// A scan as it runs: map, image, A-line, and what a person can have it do.
import { api } from "../api.js";
import { byId, h, identifier, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { failed, loading } from "../panel_states.js";
import { Controls } from "./controls.js";
import { Growing } from "./live_image.js";
import { Guards } from "./interlocks.js";
import { ScanMap } from "./scan_map.js";
import { Shots } from "./shots.js";
import { Signals } from "./signals/signals.js";
import { Trace } from "./aline_plot.js";
import { OVER } from "./states.js";

const id = identifier();
const host = byId("scan");
const MANY = 20_000; // A-lines, from which on they are looked at less often
const QUICK = 200;
const SLOW = 1500;
const FULL_SCALE = 32_767; // of 16 bits
const panel = (/** @type {string} */ name, live = true) => h("section", { class: `panel ${live ? "live" : ""} ${name}`, "data-steradian": `scan-${name}` });
const [head, mapPanel, imagePanel, tracePanel, signalsPanel] = [panel("head"), panel("map"), panel("image"), panel("trace"), panel("signals", false)];

/** @type {any} */
let scan = null;
/** @type {any} */
let plan = null;
/** @type {Shots | null} */
let shots = null;
let isRead = false; // whether any of them was told
let lastLook = 0;
/** @type {number | null} */
let chosen = null;

loading(host);
let built = false;
const controls = new Controls(head, () => void read());
const guards = new Guards();
head.append(guards.line);
const map = new ScanMap(mapPanel, (row) => {
  chosen = row;
  showTrace();
});
const line = new Trace(tracePanel);
line.follow.addEventListener("click", () => {
  chosen = map.chosen = null;
  map.plane.draw();
  showTrace();
});
const signals = new Signals(signalsPanel, id, (row) => {
  chosen = map.chosen = row;
  map.plane.draw();
  showTrace();
});
const imageBody = h("div", { class: "image-body" });
imagePanel.append(h("h2", null, "Image"), imageBody);
const growing = new Growing(imageBody, id, () => controls.nextSteps());

async function read() {
  try {
    scan = await api.get(`/scans/${id}`);
    guards.of = scan.scanner_id;
    const turned = built && growing.running === OVER.has(scan.state);
    growing.running = !OVER.has(scan.state);
    if (!built) await build();
    controls.show(scan, plan, isRead ? shots?.coverage : null);
    signals.of(map.plane.aperture, !OVER.has(scan.state));
    if (turned) void growing.find(); // what is offered or said of the image is another thing now
    await look();
  } catch (error) {
    if (!built) failed(host, error, read);
  }
}

async function build() {
  const [points, found] = await Promise.all([api.get(`/masks/${scan.mask_id}/points`), api.get(`/plans/${scan.plan_id}`)]);
  const mask = await api.get(`/masks/${scan.mask_id}`);
  plan = found;
  map.place(points.positions.map((/** @type {number[]} */ [x, y = 0]) => [x, y]), mask.aperture);
  replace(host, head, mapPanel, imagePanel, tracePanel, signalsPanel);
  shots = new Shots(points.count, plan.frames * Math.max(1, plan.excitation.length));
  map.update(shots, false);
  built = true;
  void growing.find();
}

/** Whether there is a file to look into. */
function hasBegun() {
  return isRead || scan.progress.done > 0 || (scan.summary?.stored ?? 0) > 0;
}

let asking = false;
let due = false;

/** Look at what is new, one look at a time, not more often than it can be shown. */
async function look() {
  due = true;
  if (asking) return;
  asking = true;
  while (due) {
    const wait = lastLook + ((shots?.stored.length ?? 0) > MANY ? SLOW : QUICK) - performance.now();
    if (wait > 0) await new Promise((go) => setTimeout(go, wait));
    due = false;
    lastLook = performance.now();
    if (!shots || !hasBegun()) continue;
    try {
      shots.take(await api.get(shots.path(id)));
      isRead = true;
      map.update(shots, !OVER.has(scan.state));
      controls.show(scan, plan, isRead ? shots?.coverage : null);
      await trace();
    } catch {
      // no file yet, or the bar says that nobody answers
    }
  }
  asking = false;
}

/** Show the chosen A-line, or else the newest, unless it is shown already. */
async function trace() {
  const row = chosen;
  line.follow.hidden = row === null;
  if (!shots || (row === null && shots.newest < 0)) return;
  const path = `/scans/${id}/alines${row === null ? "/latest" : `?slice=${row}`}`;
  const headers = line.tag && row === null ? { "If-None-Match": line.tag } : undefined;
  const answer = await api.ask("GET", path, undefined, { accept: "application/octet-stream", headers });
  if (answer.status === 304 || row !== chosen) return;
  const isWhole = (answer.headers.get("X-Dtype") ?? "").endsWith("i2");
  const body = await answer.arrayBuffer();
  const point = (row ?? Number(answer.headers.get("X-Row"))) % shots.points;
  line.tag = row === null ? (answer.headers.get("ETag") ?? "") : "";
  line.show({
    samples: isWhole ? new Int16Array(body) : new Float32Array(body),
    interval: plan.sampling_interval,
    zero: row === null ? Number(answer.headers.get("X-Origin")) || 0 : shots.zero[row],
    full: isWhole ? FULL_SCALE : null,
    point,
    title: `${row === null ? "Newest" : "Chosen"}, point ${point}`,
  });
}

function showTrace() {
  trace().catch(() => null); // the bar says that nobody answers
}

live.on("scan", (event) => event.id === id && read());
live.on("again", read);
live.on("progress", (event) => {
  if (event.id !== id || !built) return;
  scan.progress = event;
  controls.advance(event);
  void look();
});
setInterval(() => live.state.is === "cut" && !document.hidden && read(), SLOW);
