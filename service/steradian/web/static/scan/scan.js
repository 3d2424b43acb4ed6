// @ts-check
// Scan view: map, live image, A-line, signals and controls.
import { api } from "../api.js";
import { byId, h, pathIdentifier, replace } from "../dom.js";
import { live } from "../event_stream.js";
import { showError, showLoading } from "../panel_states.js";
import { Controls } from "./controls.js";
import { LiveImage } from "./live_image.js";
import { Interlocks } from "./interlocks.js";
import { ScanMap } from "./scan_map.js";
import { Shots } from "./shots.js";
import { Signals } from "./signals/signals.js";
import { StagePanel } from "./stage_panel.js";
import { AlinePlot } from "./aline_plot.js";
import { FINAL_STATES } from "./states.js";

const id = pathIdentifier();
const host = byId("scan");
const MANY_ALINES = 20_000; // number of A-lines above which polls are less frequent
const SHORT_INTERVAL = 200;
const LONG_INTERVAL = 1500;
const FULL_SCALE = 32_767; // 16-bit samples
const panel = (/** @type {string} */ name, live = true) => h("section", { class: `panel ${live ? "live" : ""} ${name}`, "data-steradian": `scan-${name}` });
const [head, stagesHost, mapPanel, imagePanel, tracePanel, signalsPanel] = [panel("head"), panel("stages"), panel("map"), panel("image"), panel("trace"), panel("signals", false)];

/** @type {any} */
let scan = null;
/** @type {any} */
let plan = null;
/** @type {any} */
let mask = null;
/** @type {Shots | null} */
let shots = null;
let hasShots = false; // whether shots have been read
let lastReadTime = 0;
/** @type {number | null} */
let selectedRow = null;

showLoading(host);
let isBuilt = false;
const controls = new Controls(head, () => void readScan());
const interlocks = new Interlocks();
head.append(interlocks.line);
const scanMap = new ScanMap(mapPanel, (row) => {
  selectedRow = row;
  showAline();
});
const alinePlot = new AlinePlot(tracePanel);
alinePlot.followButton.addEventListener("click", () => {
  selectedRow = scanMap.selectedRow = null;
  scanMap.pointMap.draw();
  showAline();
});
const signals = new Signals(signalsPanel, id, (row) => {
  selectedRow = scanMap.selectedRow = row;
  scanMap.pointMap.draw();
  showAline();
});
const imageBody = h("div", { class: "image-body" });
const imageShare = h("span", { class: "dim small" });
imagePanel.append(h("header", null, h("h2", null, "Image"), imageShare), imageBody);
const liveImage = new LiveImage(imageBody, imageShare, id, () => controls.imageActions());
const stagePanel = new StagePanel(stagesHost, liveImage, () => void readScan());

async function readScan() {
  try {
    scan = await api.get(`/scans/${id}`);
    interlocks.scannerId = scan.scanner_id;
    scanMap.isOver = FINAL_STATES.has(scan.state);
    interlocks.line.hidden = scanMap.isOver; // they would be those of now; the status bar has them
    host.classList.toggle("over", scanMap.isOver);
    const hasChanged = isBuilt && liveImage.running === FINAL_STATES.has(scan.state);
    liveImage.running = !FINAL_STATES.has(scan.state);
    if (!isBuilt) await buildPage();
    else if (scan.mask_id !== mask.id) await loadMask(); // with the points of a further stage
    controls.show(scan, plan, hasShots ? shots?.coverage : null);
    stagePanel.show(scan, shots, mask);
    signals.setScan(scanMap.pointMap.aperture, !FINAL_STATES.has(scan.state));
    if (hasChanged) void liveImage.findReconstruction(); // the actions depend on whether the scan is running
    await readShots();
  } catch (error) {
    if (!isBuilt) showError(host, error, readScan);
  }
}

async function buildPage() {
  plan = await api.get(`/plans/${scan.plan_id}`);
  scanMap.excitation = plan.excitation;
  await loadMask();
  replace(host, head, stagesHost, mapPanel, imagePanel, tracePanel, signalsPanel);
  isBuilt = true;
  void liveImage.findReconstruction();
}

/** Load the points of the scan's stages so far; a selected A-line stays selected, because earlier points keep their numbers. */
async function loadMask() {
  const [points, loadedMask] = await Promise.all([api.get(`/masks/${scan.mask_id}/points`), api.get(`/masks/${scan.mask_id}`)]);
  const before = shots;
  mask = loadedMask;
  shots = new Shots(points.count, plan.frames * Math.max(1, plan.excitation.length));
  if (before && selectedRow !== null) {
    selectedRow = Math.floor(selectedRow / before.points) * shots.points + (selectedRow % before.points);
    scanMap.selectedRow = selectedRow;
  }
  if (before) shots.keep(before);
  scanMap.setPositions(points.positions.map((/** @type {number[]} */ [x, y = 0]) => [x, y]), mask.aperture);
  scanMap.update(shots, before !== null);
}

/** Return whether the scan file contains A-lines. */
function hasFile() {
  return hasShots || scan.progress.done > 0 || (scan.summary?.stored ?? 0) > 0;
}

let isReading = false;
let isDue = false;

/** Read new shots; one request at a time, at a limited rate. */
async function readShots() {
  isDue = true;
  if (isReading) return;
  isReading = true;
  while (isDue) {
    const wait = lastReadTime + ((shots?.stored.length ?? 0) > MANY_ALINES ? LONG_INTERVAL : SHORT_INTERVAL) - performance.now();
    if (wait > 0) await new Promise((go) => setTimeout(go, wait));
    isDue = false;
    lastReadTime = performance.now();
    if (!shots || !hasFile()) continue;
    try {
      const reading = shots;
      if (!shots.apply(await api.get(shots.path(id))) || reading !== shots) continue; // the mask of a further stage is not loaded yet
      hasShots = true;
      scanMap.update(shots, !FINAL_STATES.has(scan.state));
      controls.show(scan, plan, hasShots ? shots?.coverage : null);
      stagePanel.show(scan, shots, mask);
      await readAline();
    } catch {
      // no file yet, or the status bar shows that the service does not answer
    }
  }
  isReading = false;
}

/** Read and show the selected or newest A-line, unless it is already shown. */
async function readAline() {
  const row = selectedRow;
  alinePlot.followButton.hidden = row === null;
  if (!shots || (row === null && shots.newest < 0)) return;
  const path = `/scans/${id}/alines${row === null ? "/latest" : `?slice=${row}`}`;
  const headers = alinePlot.etag && row === null ? { "If-None-Match": alinePlot.etag } : undefined;
  const answer = await api.request("GET", path, undefined, { accept: "application/octet-stream", headers });
  if (answer.status === 304 || row !== selectedRow) return;
  const isWhole = (answer.headers.get("X-Dtype") ?? "").endsWith("i2");
  const body = await answer.arrayBuffer();
  const point = (row ?? Number(answer.headers.get("X-Row"))) % shots.points;
  alinePlot.etag = row === null ? (answer.headers.get("ETag") ?? "") : "";
  alinePlot.show({
    samples: isWhole ? new Int16Array(body) : new Float32Array(body),
    interval: plan.sampling_interval,
    zero: row === null ? Number(answer.headers.get("X-Origin")) || 0 : shots.timeZero[row],
    full: isWhole ? FULL_SCALE : null,
    point,
    title: `${row === null ? "Newest" : "Selected"}, point ${point}`,
  });
}

function showAline() {
  readAline().catch(() => null); // the status bar shows that the service does not answer
}

live.on("scan", (event) => event.id === id && readScan());
live.on("again", readScan);
live.on("progress", (event) => {
  if (event.id !== id || !isBuilt) return;
  scan.progress = event;
  controls.updateProgress(event);
  void readShots();
});
setInterval(() => live.state.is === "cut" && !document.hidden && readScan(), LONG_INTERVAL);
