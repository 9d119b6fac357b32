// @ts-check
"use strict";
// Layers of a map as pictures: its values, shaded relief, horizontal gradient, and errors.

/**
 * @typedef {"map" | "relief" | "gradient" | "error"} MapLayerKind
 * @typedef {{kind: MapLayerKind, unit: string, cells: ArrayLike<number>, light: Float64Array | null, words: string}}
 *   MapLayer
 * @typedef {{east: Float64Array, north: Float64Array}} MapSlopes Rise to the east and to the north, per metre.
 */

/** @type {Record<MapLayerKind, string>} */
const MAP_LAYERS = { map: "map", relief: "shaded relief", gradient: "horizontal gradient", error: "error" };
/** Semi-major axis, m, and squared eccentricity of WGS-84. */
const WGS84_A_M = 6_378_137, WGS84_E2 = 0.006_694_379_990_141_3;
/** Light from the north-west at 45 degrees, as in `magline map plot`. The steepest tenth is drawn at 45 degrees. */
const LIGHT = { azimuth: 315, elevation: 45, strength: 0.5, gentle: 0.9 };
const MAP_HUES = VIRIDIS.map((hue) => [1, 3, 5].map((c) => parseInt(hue.slice(c, c + 2), 16)));

/** Colour of a part from 0 to 1 of a map. @param {number} part @returns {[number, number, number]} */
function mapColour(part) {
  const at = Math.min(0.9999, Math.max(0, part)) * (MAP_HUES.length - 1), k = Math.floor(at);
  return /** @type {[number, number, number]} */ (MAP_HUES[k].map((v, i) =>
    Math.round(v + (MAP_HUES[k + 1][i] - v) * (at - k))));
}

/** A colour in light and shade; light 1 keeps it. @param {[number, number, number]} colour @param {number} light */
function litColour(colour, light) {
  const glare = Math.min(0.6, Math.max(0, 0.5 * (light - 1)));
  return colour.map((v) => Math.round(light < 1 ? v * light : v + glare * (255 - v)));
}

/** The 1st and the 99th percentile of the known cells. @param {ArrayLike<number>} cells */
function mapSpan(cells) {
  const known = Float64Array.from(cells).filter(Number.isFinite).sort();
  return { low: known[Math.floor(known.length * 0.01)] ?? 0, high: known[Math.floor(known.length * 0.99)] ?? 1 };
}

/** A map as a picture; unknown cells are transparent. Colours span the 1st to the 99th percentile.
 * @param {MapImage} map @param {ArrayLike<number>} cells @param {Float64Array | null} light */
function mapCanvas(map, cells = map.cells, light = null) {
  const canvas = /** @type {HTMLCanvasElement} */ (element("canvas", { width: map.width, height: map.height }));
  const pixels = new ImageData(map.width, map.height), { low, high } = mapSpan(cells);
  for (let i = 0; i < cells.length; i++) {
    if (!Number.isFinite(cells[i])) continue;
    const colour = mapColour(high > low ? (cells[i] - low) / (high - low) : 0.5);
    pixels.data.set([...(light ? litColour(colour, light[i]) : colour), 255], 4 * i);
  }
  canvas.getContext("2d")?.putImageData(pixels, 0, 0);
  return { canvas, low, high };
}

/** Size of the cells of a row on the ellipsoid, m. @param {MapImage} map @param {number} row */
function cellMetres(map, row) {
  const high = (map.north - map.south) / map.height, lat = (map.north - (row + 0.5) * high) * Math.PI / 180;
  const wide = (map.east - map.west) / map.width, flat = 1 - WGS84_E2 * Math.sin(lat) ** 2;
  return { east: wide * Math.PI / 180 * WGS84_A_M / Math.sqrt(flat) * Math.cos(lat),
    north: high * Math.PI / 180 * WGS84_A_M * (1 - WGS84_E2) / flat ** 1.5 };
}

/** Rise per cell, by central differences, or from the only known neighbour. @param {number} before @param {number} here
 * @param {number} after */
function riseOf(before, here, after) {
  if (Number.isFinite(before)) return Number.isFinite(after) ? (after - before) / 2 : here - before;
  return after - here;
}

/** Slopes of a map; NaN at unknown cells and without a known neighbour. @param {MapImage} map @returns {MapSlopes} */
function mapSlopes({ cells, width, height, ...map }) {
  const [east, north] = [new Float64Array(cells.length).fill(NaN), new Float64Array(cells.length).fill(NaN)];
  for (let row = 0; row < height; row++) {
    const metres = cellMetres({ cells, width, height, ...map }, row);
    for (let column = 0; column < width; column++) {
      const i = row * width + column, here = cells[i];
      const west = column > 0 ? cells[i - 1] : NaN, other = column + 1 < width ? cells[i + 1] : NaN;
      east[i] = riseOf(west, here, other) / metres.east;
      // The rows begin in the north.
      north[i] = riseOf(cells[i + width] ?? NaN, here, cells[i - width] ?? NaN) / metres.north;
    }
  }
  for (let i = 0; i < cells.length; i++) if (!Number.isFinite(cells[i])) east[i] = north[i] = NaN;
  return { east, north };
}

/** Magnitude of the horizontal gradient, per kilometre. @param {MapSlopes} slopes */
function gradientCells({ east, north }) { return east.map((e, i) => 1000 * Math.hypot(e, north[i])); }

/** Light on each cell relative to level ground [Horn, Proc. IEEE 69, 1981]. @param {MapSlopes} slopes */
function mapLight({ east, north }) {
  const steep = east.map((e, i) => Math.hypot(e, north[i])).filter((s) => s > 0).sort();
  const scale = steep[Math.min(steep.length - 1, Math.floor(LIGHT.gentle * steep.length))];
  const [azimuth, elevation] = [LIGHT.azimuth, LIGHT.elevation].map((v) => v * Math.PI / 180);
  const toEast = Math.sin(azimuth) / Math.tan(elevation), toNorth = Math.cos(azimuth) / Math.tan(elevation);
  return east.map((e, i) => {
    const slope = Math.hypot(e, north[i]);
    if (!Number.isFinite(slope) || scale === undefined) return 1;
    const flatter = 1 / Math.hypot(scale, slope), [a, b] = [e * flatter, north[i] * flatter];
    const facing = Math.max(0, (1 - a * toEast - b * toNorth) / Math.sqrt(1 + a * a + b * b));
    return 1 + LIGHT.strength * (facing - 1);
  });
}

/** A layer of a map. @param {MapImage} map @param {MapLayerKind} kind @param {MapImage | null} error
 * @returns {MapLayer} */
function mapLayer(map, kind, error) {
  if (kind === "error" && error) {
    return { kind, unit: error.unit, cells: error.cells, light: null,
      words: "Standard deviation of the error of the map. " };
  }
  if (kind === "relief") {
    return { kind, unit: map.unit, cells: map.cells, light: mapLight(mapSlopes(map)), words: "Relief: light from the " +
      "north-west; heights are scaled so that the steepest tenth of the map begins at 45\u00b0. " };
  }
  if (kind === "gradient") {
    const { east, north } = cellMetres(map, Math.floor(map.height / 2));
    return { kind, unit: `${map.unit}/km`, cells: gradientCells(mapSlopes(map)), light: null, words: "Magnitude of " +
      `the horizontal gradient, by central differences between drawn cells of ${short(east)} m east by ` +
      `${short(north)} m north. ` };
  }
  return { kind: "map", unit: map.unit, cells: map.cells, light: null, words: "" };
}
