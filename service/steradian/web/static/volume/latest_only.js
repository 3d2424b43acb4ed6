// @ts-check
// Of many requests for one panel only the last one counts.

const ABORT_DELAY = 300; // ms after which one under way is given up for a newer one

/**
 * Run work of which only the newest matters: one at a time, what was asked for meanwhile is left out, but the last.
 * @template T
 * @param {(input: T, signal: AbortSignal) => Promise<void>} task
 * @param {(error: unknown) => void} onError
 */
export function latestOnly(task, onError) {
  /** @type {{began: number, control: AbortController} | null} */
  let current = null;
  /** @type {{input: T} | null} */
  let next = null;

  async function run() {
    while (next) {
      const { input } = next;
      next = null;
      const control = new AbortController();
      current = { began: performance.now(), control };
      try {
        await task(input, control.signal);
      } catch (error) {
        if (!control.signal.aborted) onError(error);
      }
    }
    current = null;
  }

  return (/** @type {T} */ input) => {
    next = { input };
    if (!current) void run();
    else if (performance.now() - current.began > ABORT_DELAY) current.control.abort();
  };
}
