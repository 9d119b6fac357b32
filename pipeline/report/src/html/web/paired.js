// @ts-check
"use strict";
// Mean difference of a score over the same lines, with a bootstrap interval.

/** Number of resamples, and the share of them in the interval. */
const PAIRED_DRAWS = 2000, PAIRED_LEVEL = 0.95;
/** Least number of lines of an interval. The bootstrap interval of fewer lines is too narrow. */
const PAIRED_LEAST = 5;

/** Numbers from 0 to 1 of a fixed seed (Mulberry32). */
function paired32() {
  let state = 1;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** Percentile of sorted numbers, linear between them. @param {Float64Array} sorted @param {number} share */
function percentile(sorted, share) {
  const at = share * (sorted.length - 1), low = Math.floor(at), high = Math.ceil(at);
  return sorted[low] + (at - low) * (sorted[high] - sorted[low]);
}

/**
 * @typedef {{lines: number, mean: number, low: number | null, high: number | null, lower: number, higher: number}}
 *   PairedDifference
 */

/** Mean of the differences on single lines, each with the same weight, and percentiles of the means of resamples of the
 * lines [Efron & Tibshirani 1993, chapter 13]. `null` without a line. @param {number[]} differences
 * @returns {PairedDifference | null} */
function pairedDifference(differences) {
  const lines = differences.length;
  if (!lines) return null;
  const mean = differences.reduce((sum, d) => sum + d, 0) / lines;
  const found = { lines, mean, low: /** @type {number | null} */ (null), high: /** @type {number | null} */ (null),
    lower: differences.filter((d) => d < 0).length, higher: differences.filter((d) => d > 0).length };
  if (lines < PAIRED_LEAST) return found;
  const next = paired32(), means = new Float64Array(PAIRED_DRAWS);
  for (let k = 0; k < PAIRED_DRAWS; k++) {
    let sum = 0;
    for (let i = 0; i < lines; i++) sum += differences[Math.floor(next() * lines)];
    means[k] = sum / lines;
  }
  means.sort();
  found.low = percentile(means, (1 - PAIRED_LEVEL) / 2);
  found.high = percentile(means, (1 + PAIRED_LEVEL) / 2);
  return found;
}

/** In words: mean, interval, and on how many lines the difference is negative. @param {PairedDifference | null} d */
function pairedWords(d) {
  if (!d) return "-";
  const interval = d.low === null || d.high === null ? "" : ` (${short(d.low)} to ${short(d.high)})`;
  return `${short(d.mean)}${interval}; lower on ${d.lower} of ${d.lines} ${d.lines === 1 ? "line" : "lines"}`;
}

/** Differences of two points on the lines that both have. Lines that are in sample at only one of the two points are
 * omitted.
 * @param {ScoreBlock} block @param {number} m @param {number} a @param {number} b @returns {number[]} */
function pairedLines({ lines: own }, m, a, b) {
  const column = own?.metrics.indexOf(m) ?? -1;
  if (!own || column < 0) return [];
  const seen = new Set(own.in_sample);
  /** @type {Map<number, number>} */
  const first = new Map();
  own.points.forEach((point, entry) => { if (point === a) first.set(own.lines[entry], entry); });
  return own.points.flatMap((point, entry) => {
    const other = point === b ? first.get(own.lines[entry]) : undefined;
    if (other === undefined || seen.has(other) !== seen.has(entry)) return [];
    const [one, two] = [own.values[column][other], own.values[column][entry]];
    return one === null || two === null ? [] : [two - one];
  });
}

/** The meaning of the interval, for captions. */
const PAIRED_NOTE = "Line by line: mean difference over the lines that both have, each with the same weight, with " +
  `the ${100 * PAIRED_LEVEL} % percentile interval of ${PAIRED_DRAWS} resamples of the lines. Fewer than ` +
  `${PAIRED_LEAST} lines have no interval.`;
