// @ts-check
// Scan of a volume: its aperture, plan and sample, which the design of another scan of the same object adopts.
import { api } from "../api.js";

/** @typedef {{aperture: number | null, plan: any, sample: string}} ScanOrigin plan: of the API; null: not known, or of an imported recording */

/** @type {Map<string, Promise<ScanOrigin>>} */
const origins = new Map();

/** Load what is known of a scan, once. @param {string} scanId @returns {Promise<ScanOrigin>} */
export function loadOrigin(scanId) {
  const known = origins.get(scanId) ?? readOrigin(scanId);
  origins.set(scanId, known);
  return known;
}

/** @param {string} scanId @returns {Promise<ScanOrigin>} */
async function readOrigin(scanId) {
  const scan = await api.get(`/scans/${scanId}`).catch(() => null);
  const read = (/** @type {string} */ path) => api.get(path).catch(() => null);
  const [mask, plan] = scan ? await Promise.all([read(`/masks/${scan.mask_id}`), scan.scanner_id ? read(`/plans/${scan.plan_id}`) : null]) : [null, null];
  return { aperture: mask?.aperture ?? null, plan, sample: scan?.labels?.sample ?? "" };
}
