// @ts-check
// Order of queued jobs, and the priorities that move a job to a position.

/** @typedef {{id: string, priority: number}} Waiting */

const MAX_PRIORITY = 1000;

/** Sort jobs by priority, equal ones by start tag. @template {Waiting} T @param {T[]} waitingJobs in their turns @returns {T[]} */
export function byPriority(waitingJobs) {
  return [...waitingJobs].sort((one, other) => one.priority - other.priority);
}

/**
 * Return the priorities that move a job to a position; other jobs change only if no number is free between them.
 * @param {Waiting[]} waitingJobs all that wait, in their turns
 * @param {string} id @param {number} place among them
 * @returns {Waiting[] | null} those that change, in their new order; null: all numbers are taken
 */
export function priorityChanges(waitingJobs, id, place) {
  const turnOf = new Map(waitingJobs.map((one, n) => [one.id, n]));
  const row = byPriority(waitingJobs).map((one) => ({ id: one.id, priority: one.priority }));
  const [moved] = row.splice(row.findIndex((one) => one.id === id), 1);
  row.splice(place, 0, moved);
  /** Return the minimum difference of priority between two consecutive jobs. @param {Waiting} one @param {Waiting} later */
  const step = (one, later) => (Number(turnOf.get(one.id)) < Number(turnOf.get(later.id)) ? 0 : 1);
  const low = place > 0 ? row[place - 1].priority + step(row[place - 1], moved) : 0;
  const high = place < row.length - 1 ? row[place + 1].priority - step(moved, row[place + 1]) : MAX_PRIORITY;
  moved.priority = Math.min(Math.max(moved.priority, low), high);
  for (let n = place; n > 0; n--) row[n - 1].priority = Math.min(row[n - 1].priority, row[n].priority - step(row[n - 1], row[n]));
  row[0].priority = Math.max(row[0].priority, 0);
  for (let n = 1; n < row.length; n++) row[n].priority = Math.max(row[n].priority, row[n - 1].priority + step(row[n - 1], row[n]));
  if (row[row.length - 1].priority > MAX_PRIORITY) return null;
  const before = new Map(waitingJobs.map((one) => [one.id, one.priority]));
  return row.filter((one) => one.priority !== before.get(one.id));
}
