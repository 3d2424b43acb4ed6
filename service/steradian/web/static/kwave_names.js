// @ts-check
// Help for users of k-Wave: how to save a recording, and the names of the same things here.
import { h } from "./dom.js";

const SAVE = [
  ["MATLAB", "dt = kgrid.dt; dx = kgrid.dx; save('recording.mat', 'sensor_data', 'sensor', 'medium', 'dt', 'dx')"],
  ["k-wave-python", "np.savez('recording.npz', p=result['p'], mask=sensor.mask, dt=kgrid.dt, dx=kgrid.dx, c0=1500)"],
];
const NAMES = [
  ["sensor_data, p", "A-lines"],
  ["sensor.mask", "positions of the mask; a binary mask needs dx"],
  ["kgrid.dt, kgrid.t_array(1)", "sampling interval, time zero"],
  ["kgrid.dy · kgrid.Ny", "aperture"],
  ["medium.sound_speed", "speed of sound, one number"],
  ["p0, kspacePlaneRecon", "volume; its depth axis z is k-Wave's x"],
  ["kspacePlaneRecon, kspaceLineRecon", "method linear; nedner, the default, takes any positions"],
  ["time reversal, iterated", "method iterative"],
];

/** Create the folded help. */
export function kwaveHelp() {
  return h("details", { class: "panel", "data-steradian": "data-kwave" }, h("summary", null, h("strong", null, "Coming from k-Wave"), " ", h("span", { class: "dim" }, "recordings to save, and the names used here")),
    SAVE.map(([program, command]) => h("p", { class: "below" }, `From ${program}: `, h("code", null, command))),
    h("div", { class: "scrolls" }, h("table", { class: "below" },
      h("thead", null, h("tr", null, ["k-Wave", "Steradian"].map((name) => h("th", { scope: "col" }, name)))),
      h("tbody", null, NAMES.map(([theirs, ours]) => h("tr", null, h("td", null, h("code", null, theirs)), h("td", null, ours)))))));
}
