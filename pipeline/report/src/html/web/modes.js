// @ts-check
"use strict";
// Modes of the position from a particle filter: their columns, and their marks on the track.

/**
 * @typedef {{weight: Float64Array, lat: Float64Array, lon: Float64Array, sd_n: Float64Array, sd_e: Float64Array,
 *   cov_ne: Float64Array}} PositionMode Weight 0 to 1, position in deg, standard deviations in m, covariance in m2.
 * @typedef {{x: Float64Array, modes: PositionMode[]}} ModeTrack The most probable mode first.
 * @typedef {{scale: number, x: (lon: number) => number, y: (lat: number) => number}} TrackPlace
 */

const MODE_TERMS = /** @type {const} */ (["weight", "lat", "lon", "sd_n", "sd_e", "cov_ne"]);
const MODE_HUE = "#fff", MODE_EDGE = "#1b1b1b";

/** Columns of the modes of a table, in the order of `MODE_TERMS` for each mode; empty without modes.
 * @param {TableInfo} table @returns {string[][]} */
function modeColumns(table) {
  /** @type {Map<string, string>} */
  const named = new Map();
  for (const { name, series, term, terms } of table.columns) {
    if (series && term) named.set(term, name);
    if (series && !term) terms?.forEach((own, i) => named.set(own, `${name}[${i}]`));
  }
  const found = [];
  for (let k = 1; ; k++) {
    const own = MODE_TERMS.flatMap((term) => named.get(`${term}_${k}`) ?? []);
    if (own.length < MODE_TERMS.length) return found;
    found.push(own);
  }
}

/** Modes of the samples of an answer; `null` if there are none.
 * @param {string[][]} columns @param {SeriesAnswer} answer @returns {ModeTrack | null} */
function modesOf(columns, { x, columns: known }) {
  const modes = columns.flatMap((names) => {
    // Values of one sample, also where the series is thinned.
    const values = names.flatMap((name) => known.get(name)?.first ?? known.get(name)?.low ?? []);
    if (values.length < MODE_TERMS.length || !values[0].some((weight) => weight > 0)) return [];
    return [/** @type {PositionMode} */ (Object.fromEntries(MODE_TERMS.map((term, i) => [term, values[i]])))];
  });
  return modes.length ? { x, modes } : null;
}

/** Whether a mode is present at a sample. @param {PositionMode} mode @param {number} i */
function hasMode(mode, i) { return mode.weight[i] > 0 && Number.isFinite(mode.lat[i]) && Number.isFinite(mode.lon[i]); }

/** Marks the position of each mode: opacity and area increase with the weight.
 * @param {CanvasRenderingContext2D} context @param {ModeTrack} track @param {TrackPlace} place
 * @param {(t: number) => boolean} inSight */
function drawModes(context, { x, modes }, place, inSight) {
  context.save();
  context.fillStyle = MODE_HUE;
  context.strokeStyle = MODE_EDGE;
  context.lineWidth = 0.8;
  // The most probable mode is drawn last.
  for (const mode of [...modes].reverse()) for (let i = 0; i < x.length; i++) {
    if (!inSight(x[i]) || !hasMode(mode, i)) continue;
    context.globalAlpha = 0.3 + 0.7 * mode.weight[i];
    context.beginPath();
    context.arc(place.x(mode.lon[i]), place.y(mode.lat[i]), 1.5 + 3 * Math.sqrt(mode.weight[i]), 0, 7);
    context.fill();
    context.stroke();
  }
  context.restore();
}

/** Axes of the region of three standard deviations, in m, and the angle of the long axis from east to north, in rad.
 * @param {number} sdN @param {number} sdE @param {number} cov */
function modeRegion(sdN, sdE, cov) {
  const [e, n] = [sdE * sdE, sdN * sdN], middle = (e + n) / 2, half = Math.hypot((e - n) / 2, cov);
  return { long: 3 * Math.sqrt(middle + half), short: 3 * Math.sqrt(Math.max(0, middle - half)),
    angle: 0.5 * Math.atan2(2 * cov, e - n) };
}

/** Marks the regions of the modes at a time. Returns their words.
 * @param {CanvasRenderingContext2D} context @param {ModeTrack} track @param {TrackPlace} place @param {number} t */
function markModes(context, { x, modes }, place, t) {
  const i = nearest(x, t), metre = place.scale / DEGREE_M;
  return modes.flatMap((mode, k) => {
    if (!hasMode(mode, i)) return [];
    const { long, short: across, angle } = modeRegion(mode.sd_n[i], mode.sd_e[i], mode.cov_ne[i] || 0);
    const [px, py] = [place.x(mode.lon[i]), place.y(mode.lat[i])];
    context.save();
    context.beginPath();
    context.ellipse(px, py, long * metre || 0, across * metre || 0, -angle, 0, 7);
    context.strokeStyle = MODE_EDGE;
    context.lineWidth = 3;
    context.stroke();
    context.strokeStyle = MODE_HUE;
    context.lineWidth = 1.4;
    context.setLineDash([4, 3]);
    context.stroke();
    context.restore();
    return [`mode ${k + 1}: ${(100 * mode.weight[i]).toFixed(1)} %, ${mode.lat[i].toFixed(5)}\u00b0, ` +
      `${mode.lon[i].toFixed(5)}\u00b0`];
  });
}
