// @ts-check
"use strict";
// Position errors of an estimate against the truth of another table, where the server lists none.

/** WGS-84: semi-major axis, m, and squared eccentricity. */
const EARTH_A_M = 6_378_137, EARTH_E2 = 0.00669437999014;
/** Largest difference of times that belong together, s. */
const SAME_TIME_S = 1e-6;
const NOTE = "; in a thinned series that of the first sample of each interval";
const POSITION_COLUMNS = [
  { name: "truth_lat", unit: "deg", description: "true latitude" },
  { name: "truth_lon", unit: "deg", description: "true longitude" },
  { name: "north_error", unit: "m", description: "truth minus estimate, north" + NOTE },
  { name: "east_error", unit: "m", description: "truth minus estimate, east" + NOTE },
];

/** @param {TableInfo} table @param {string} name @param {boolean} truth */
function hasPosition(table, name, truth) {
  return table.columns.some((c) => c.name === name && c.series && (c.role === "truth") === truth);
}

/** The table with the true position of an estimate: an input, or another table. @param {TableInfo} table
 * @param {TableInfo[]} tables */
function truthOf(table, tables) {
  const all = tables.filter((t) => t.kind === "samples" && hasPosition(t, "lat", true) && hasPosition(t, "lon", true));
  return all.find((t) => table.inputs.includes(t.name)) ?? all[all.length - 1];
}

/** Adds the columns of position errors to the tables that estimate a position. @param {PipelineInfo} pipeline */
function withPositionErrors(pipeline) {
  const tables = pipeline.tables.map((table) => {
    const estimates = table.kind === "samples" && hasPosition(table, "lat", false) && hasPosition(table, "sd_n", false);
    const truth = estimates && !table.columns.some((c) => c.name === "north_error") && truthOf(table, pipeline.tables);
    if (!truth) return table;
    const more = POSITION_COLUMNS.map((c) => ({ ...c, role: "derived", series: true }));
    return { ...table, truth, columns: [...table.columns, ...more] };
  });
  return { ...pipeline, tables };
}

/** North and east differences of two positions, m, on the ellipsoid. @param {number} lat @param {number} lon
 * @param {number} lat2 @param {number} lon2 @returns {[number, number]} */
function metresBetween(lat, lon, lat2, lon2) {
  const rad = Math.PI / 180, middle = (lat + lat2) / 2 * rad, w = Math.sqrt(1 - EARTH_E2 * Math.sin(middle) ** 2);
  const turn = ((lon2 - lon + 540) % 360) - 180;
  return [(lat2 - lat) * rad * EARTH_A_M * (1 - EARTH_E2) / w ** 3, turn * rad * EARTH_A_M / w * Math.cos(middle)];
}

/** Positions of an answer, one for each row: those of the first sample of an interval.
 * @param {SeriesAnswer} answer @param {string} name */
function positions(answer, name) {
  const found = answer.columns.get(name);
  return found?.first ?? found?.low ?? new Float64Array(answer.x.length).fill(NaN);
}

/** Adds the position errors to an answer. @param {SeriesAnswer} answer @param {SeriesAnswer} truth
 * @param {string[]} wanted @returns {SeriesAnswer} */
function addPositionErrors(answer, truth, wanted) {
  const count = answer.x.length, made = POSITION_COLUMNS.map(() => new Float64Array(count).fill(NaN));
  const [lat, lon] = [positions(answer, "lat"), positions(answer, "lon")];
  const [lat2, lon2] = [positions(truth, "lat"), positions(truth, "lon")];
  for (let i = 0, k = 0; i < count; i++) {
    while (k < truth.x.length - 1 && truth.x[k] < answer.x[i] - SAME_TIME_S) k++;
    if (!(Math.abs(truth.x[k] - answer.x[i]) <= SAME_TIME_S)) continue;
    const values = [lat2[k], lon2[k], ...metresBetween(lat[i], lon[i], lat2[k], lon2[k])];
    values.forEach((value, c) => { made[c][i] = value; });
  }
  const columns = new Map(answer.columns);
  POSITION_COLUMNS.forEach(({ name, unit, description }, c) => {
    if (wanted.includes(name)) columns.set(name, { unit, description, role: "derived", low: made[c], high: null,
      first: null });
  });
  return { ...answer, columns };
}
