// @ts-check
// Latest-only execution of asynchronous tasks.

const ABORT_DELAY = 300; // ms after which a newer request aborts a running one

/**
 * Return a function that runs one task at a time and skips all pending requests but the newest.
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
