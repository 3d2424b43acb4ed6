// @ts-check
// Creation of a scan with an idempotency key, which a repeated request reuses if the first response was lost.
import { api, idempotencyHeaders, Problem } from "../api.js";
import { readLease } from "./scanner_choice.js";

const REUSE_TIMEOUT = 300e3; // ms after which an equal request creates another scan

/** @type {Map<string, {key: Record<string, string>, at: number}>} idempotency keys of unanswered requests */
const unansweredKeys = new Map();

/**
 * @param {{plan_id: string, labels: Record<string, string>, completes?: string, scanner_id?: string}} scanRequest
 * @returns {Promise<any>} the scan
 */
export async function startScan(scanRequest) {
  const lease = await readLease(scanRequest.scanner_id);
  const name = JSON.stringify(scanRequest);
  const previous = unansweredKeys.get(name);
  const key = previous && performance.now() - previous.at < REUSE_TIMEOUT ? previous.key : idempotencyHeaders();
  unansweredKeys.set(name, { key, at: performance.now() });
  try {
    const headers = { ...key, ...(lease ? { "Scanner-Lease": String(lease.fence) } : {}) };
    const created = await api.post("/scans", scanRequest, { headers });
    unansweredKeys.delete(name);
    return created;
  } catch (error) {
    if (error instanceof Problem && error.status < 500) unansweredKeys.delete(name);
    throw error;
  }
}
