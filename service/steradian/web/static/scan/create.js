// @ts-check
// Begin a scan, once: where the answer is lost on its way, the same wish again is answered by the same scan.
import { api, onceOnly, Problem } from "../api.js";
import { leaseOf } from "./scanner_choice.js";

const MEANT_AGAIN = 300e3; // later, whoever asks for the same means another scan

/** @type {Map<string, {key: Record<string, string>, at: number}>} the keys of wishes that were not answered */
const unanswered = new Map();

/**
 * @param {{plan_id: string, labels: Record<string, string>, completes?: string, scanner_id?: string}} wish
 * @returns {Promise<any>} the scan
 */
export async function startScan(wish) {
  const lease = await leaseOf(wish.scanner_id);
  const name = JSON.stringify(wish);
  const before = unanswered.get(name);
  const key = before && performance.now() - before.at < MEANT_AGAIN ? before.key : onceOnly();
  unanswered.set(name, { key, at: performance.now() });
  try {
    const headers = { ...key, ...(lease ? { "Scanner-Lease": String(lease.fence) } : {}) };
    const made = await api.post("/scans", wish, { headers });
    unanswered.delete(name);
    return made;
  } catch (error) {
    if (error instanceof Problem && error.status < 500) unanswered.delete(name);
    throw error;
  }
}
