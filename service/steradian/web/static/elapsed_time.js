// @ts-check
// How long ago something was, also across the sleep of a computer, during which one of the two clocks stands still.

/** @typedef {{steady: number, wall: number}} Timestamp */

/** The present moment. @returns {Timestamp} */
export const timestamp = () => ({ steady: performance.now(), wall: Date.now() });

/** A moment that is longer ago than anything. @type {Timestamp} */
export const NEVER = { steady: -Infinity, wall: -Infinity };

/** Milliseconds since a moment: the greater of what both clocks say, so that nothing seems newer than it is. @param {Timestamp} since */
export const elapsed = (since) => Math.max(performance.now() - since.steady, Date.now() - since.wall);
