// @ts-check
// Elapsed time that includes the sleep of the computer, during which one of the two clocks stops.

/** @typedef {{steady: number, wall: number}} Timestamp */

/** Return the present time. @returns {Timestamp} */
export const timestamp = () => ({ steady: performance.now(), wall: Date.now() });

/** Time before every other. @type {Timestamp} */
export const NEVER = { steady: -Infinity, wall: -Infinity };

/** Return the milliseconds since a timestamp: the larger value of both clocks, so that no status appears newer than it is. @param {Timestamp} since */
export const elapsed = (since) => Math.max(performance.now() - since.steady, Date.now() - since.wall);
