// @ts-check
"use strict";
// Coastlines under tracks and maps, from the server or from the block of a report.

const COAST_NOTE = "Coastline: Natural Earth, 1:50,000,000; it may differ from the true coast by kilometres.";
/** Least margin of a region, deg. */
const COAST_MARGIN = 0.2;

/** @typedef {{west: number, east: number, south: number, north: number}} Region */

/** Coastlines of a region, as longitude and latitude by turns. @param {ServerSource | EmbeddedSource} source
 * @param {Region} region @returns {Promise<number[][]>} */
async function coastOf(source, { west, east, south, north }) {
  if (![west, east, south, north].every(Number.isFinite)) return [];
  if (!(source instanceof ServerSource)) {
    return JSON.parse(document.querySelector("#series script.coast")?.textContent ?? "[]");
  }
  // A diverged estimate may be anywhere.
  const degrees = (/** @type {number} */ v, /** @type {number} */ most) =>
    Math.min(most, Math.max(-most, v)).toFixed(3);
  const query = { west: degrees(west, 360), east: degrees(east, 360), south: degrees(south, 90),
    north: degrees(north, 90) };
  if (!(Number(query.west) < Number(query.east) && Number(query.south) < Number(query.north))) return [];
  return (await source.json(source.address(source.base + "coast", query))).lines;
}

/** A region with a margin as large as the region. @param {Region} region @returns {Region} */
function widened({ west, east, south, north }) {
  const [wide, high] = [Math.max(COAST_MARGIN, east - west), Math.max(COAST_MARGIN, north - south)];
  return { west: west - wide, east: east + wide, south: south - high, north: north + high };
}

/** Draws coastlines. @param {CanvasRenderingContext2D} context @param {number[][]} lines
 * @param {(lon: number) => number} x @param {(lat: number) => number} y */
function drawCoast(context, lines, x, y) {
  for (const [hue, width] of /** @type {[string, number][]} */ ([["rgba(255,255,255,0.85)", 3], ["#3b2a1a", 1.2]])) {
    context.beginPath();
    context.strokeStyle = hue;
    context.lineWidth = width;
    context.lineJoin = "round";
    for (const line of lines) for (let i = 0; i + 1 < line.length; i += 2) {
      if (i === 0) context.moveTo(x(line[i]), y(line[i + 1])); else context.lineTo(x(line[i]), y(line[i + 1]));
    }
    context.stroke();
  }
}

/** Path through coastlines. @param {number[][]} lines @param {(lon: number) => number} x
 * @param {(lat: number) => number} y */
function coastPath(lines, x, y) {
  return lines.map((line) => {
    let path = "";
    for (let i = 0; i + 1 < line.length; i += 2) {
      path += `${i === 0 ? "M" : "L"}${x(line[i]).toFixed(2)} ${y(line[i + 1]).toFixed(2)}`;
    }
    return path;
  }).join("");
}
