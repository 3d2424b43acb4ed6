// @ts-check
// Commands that repeat a reconstruction: command line and HTTP request.
import { layerOptions } from "./layers.js";
import { differences } from "./schema.js";

/** Options of `steradian reconstruct` by parameter; two options are the ends of a range. */
const OPTIONS = /** @type {Record<string, string | string[]>} */ ({
  method: "--method", modes: "--modes", upsampling: "--upsampling", sound_speed: "--sound-speed",
  depth_range: ["--first-depth", "--last-depth"], weights: "--weights", tolerance: "--tolerance", window: "--window",
  time_padding: "--time-padding", lateral_padding: "--lateral-padding", highest_frequency: "--highest-frequency",
  depth_step: "--depth-step", device: "--device", "shots.time_zero": "--time-zero", "shots.normalise_energy": "--energy", "shots.correct_sensitivity": "--sensitivity",
  "shots.leave_out": "--leave-out", "shots.bad_lines": "--bad-lines", "conditioning.zero_first": "--zero-first",
  "conditioning.remove_offset": "--remove-offset", "conditioning.remove_common": "--remove-common",
  "conditioning.band": ["--low-cut", "--high-cut"], "conditioning.rim": "--rim", "conditioning.delay": "--delay",
  "display.gain_db_per_mm": "--gain", "display.envelope": "--envelope", "display.log_range_db": "--log-range",
  "display.non_negative": "--non-negative", "display.near_field": "--near-field", "display.percentile": "--percentile",
  "display.colour_map": "--colour-map", "display.scale_bar": "--scale-bar", "display.size": "--size",
  "iterative.regularisation": "--regularisation", "iterative.strength": "--strength",
  "iterative.iterations": "--iterations", "iterative.non_negative": "--signed", "film.kind": "--film",
  "film.max_gain": "--max-gain", "film.thickness": "--thickness",
  "film.spot.diameter": "--spot", "film.spot.profile": "--spot-profile",
});
const BLOOD = ["oxyhaemoglobin", "deoxyhaemoglobin"];
const SCATTERING_POWER = 1.3; // of the command line
const SWITCH_OPTIONS = new Set(["shots.normalise_energy", "shots.correct_sensitivity", "conditioning.remove_offset", "display.envelope", "display.non_negative"]);

/**
 * @param {import("./schema.js").Group[]} groups of ReconstructionParameters
 * @param {any} parameters as they took effect
 * @returns {{options: string[], missing: import("./schema.js").Field[]}} missing: fields without a command-line option
 */
export function optionsOf(groups, parameters) {
  const cliOptions = [];
  const missing = [];
  for (const field of differences(groups, [parameters, {}])) {
    const name = field.path.join(".");
    const option = OPTIONS[name];
    const value = field.path.reduce((inner, part) => inner?.[part], parameters);
    if (value === null || value === undefined) continue;
    const ofLayers = field.kind === "layers" ? layerOptions(value) : null;
    if (ofLayers) cliOptions.push(...ofLayers);
    else if (!option) missing.push(field);
    else if (Array.isArray(option)) option.forEach((one, n) => value[n] !== null && cliOptions.push(one, String(value[n])));
    else if (name === "iterative.non_negative") cliOptions.push(value ? "--no-signed" : "--signed");
    else if (SWITCH_OPTIONS.has(name)) cliOptions.push(value ? option : option.replace("--", "--no-"));
    else if (Array.isArray(value)) cliOptions.push(option, value.join(",") || "none");
    else cliOptions.push(option, String(value));
  }
  return { options: cliOptions, missing };
}

/** Return the fields of a request that select frames. @param {any} reconstruction the reconstruction */
export function frameFields(reconstruction) {
  return { ...(reconstruction.frame === null ? {} : { frame: reconstruction.frame }), ...(reconstruction.wavelength ? { wavelength: reconstruction.wavelength } : {}), ...(reconstruction.average ? { average: true } : {}) };
}

/** Return the fields of a request that undo motion. @param {any} reconstruction the reconstruction */
export function motionFields(reconstruction) {
  return { ...(reconstruction.align ? { align: true } : {}), ...(reconstruction.motion ? { motion: true } : {}) };
}

/** Return the shell commands that repeat a reconstruction. @param {string} origin of this service @param {any} reconstruction the reconstruction @param {string[]} cliOptions */
export function shellCommand(origin, reconstruction, cliOptions) {
  if (reconstruction.unmixing) return unmixingCommand(origin, reconstruction);
  const file = `${reconstruction.scan_id}.h5`;
  const { frame, wavelength, average } = frameFields(reconstruction);
  const frames = [...(frame === undefined ? [] : ["--frame", String(frame)]), ...(wavelength ? ["--wavelength", String(wavelength)] : []), ...(average ? ["--average"] : []), ...Object.keys(motionFields(reconstruction)).map((name) => `--${name}`)];
  const words = [...frames, ...cliOptions].reduce((lines, one) => (one.startsWith("--") ? [...lines, one] : [...lines.slice(0, -1), `${lines.at(-1)} ${shellQuoted(one)}`]), /** @type {string[]} */ ([]));
  return [`curl -o ${file} ${origin}/api/v1/scans/${reconstruction.scan_id}/file`, [`steradian reconstruct ${file} -o ${reconstruction.id}`, ...words].join(" \\\n  ")].join("\n");
}

/** Return whether `steradian unmix` has options for all that an unmixing was asked for. @param {any} unmixing */
export function isUnmixingCommandComplete({ chromophores, spectra, wavelengths, non_negative, fluence }) {
  return BLOOD.every((name) => chromophores.includes(name)) && !spectra?.length && !wavelengths?.length && non_negative !== false && (fluence.scattering_power ?? SCATTERING_POWER) === SCATTERING_POWER;
}

/** Return the shell commands that repeat an unmixing. @param {string} origin @param {any} reconstruction */
function unmixingCommand(origin, { id, reconstruction_id: series, unmixing }) {
  const { chromophores, fluence, significance } = unmixing;
  const further = chromophores.filter((/** @type {string} */ name) => !BLOOD.includes(name)).map((/** @type {string} */ name) => ["--chromophore", name]);
  const tissue = ["blood", "saturation", "water", "lipid", "scattering"].map((name) => [`--${name}`, fluence[name]]);
  const options = [...further, ["--fluence", fluence.model], ...(["none", "uniform"].includes(fluence.model) ? [] : tissue), ["--significance", significance]];
  const line = (/** @type {any[]} */ words) => words.map((word) => shellQuoted(String(word))).join(" ");
  return [line(["curl", "-o", `${series}.h5`, `${origin}/api/v1/jobs/${series}/files/series.h5`]), [["steradian", "unmix", `${series}.h5`, "-o", id], ...options].map(line).join(" \\\n  ")].join("\n");
}

/** Return the curl command that repeats a reconstruction. @param {string} origin @param {any} reconstruction */
export function curlCommand(origin, reconstruction) {
  const { scan_id, reconstruction_id, unmixing } = reconstruction;
  const body = unmixing ? { scan_id, reconstruction_id, unmixing } : { scan_id, parameters: reconstruction.parameters, ...(reconstruction.mask_id ? { through: { mask_id: reconstruction.mask_id } } : {}), ...frameFields(reconstruction), ...motionFields(reconstruction) };
  return `curl ${origin}/api/v1/reconstructions \\\n  -H 'Content-Type: application/json' -H "Idempotency-Key: $(uuidgen)" \\\n  -d ${shellQuoted(JSON.stringify(body))}`;
}

/** @param {string} text as one word of a shell */
function shellQuoted(text) {
  return /^[A-Za-z0-9_.,:+/-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}
