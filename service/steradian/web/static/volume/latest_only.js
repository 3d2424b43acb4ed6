// @ts-check
// Of many requests for one panel only the last one counts.

const PATIENCE = 300; // ms after which one under way is given up for a newer one

/**
 * Run work of which only the newest matters: one at a time, what was asked for meanwhile is left out, but the last.
 * @template T
 * @param {(wanted: T, signal: AbortSignal) => Promise<void>} work
 * @param {(error: unknown) => void} fail
 */
export function latest(work, fail) {
  /** @type {{began: number, control: AbortController} | null} */
  let busy = null;
  /** @type {{wanted: T} | null} */
  let next = null;

  async function run() {
    while (next) {
      const { wanted } = next;
      next = null;
      const control = new AbortController();
      busy = { began: performance.now(), control };
      try {
        await work(wanted, control.signal);
      } catch (error) {
        if (!control.signal.aborted) fail(error);
      }
    }
    busy = null;
  }

  return (/** @type {T} */ wanted) => {
    next = { wanted };
    if (!busy) void run();
    else if (performance.now() - busy.began > PATIENCE) busy.control.abort();
  };
}
