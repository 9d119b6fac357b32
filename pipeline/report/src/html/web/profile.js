// @ts-check
"use strict";
// Profile of a map along a line between two points.

/**
 * @typedef {{table: string, unit: string, distance_m: number[], lat: number[], lon: number[],
 *   value: (number | null)[], known: number}} MapProfile
 * @typedef {[number, number]} Position Latitude and longitude, deg.
 */

const PROFILE_PX = 260, FAR_M = 5000;

/** A position in words. @param {Position} at */
function placeText([lat, lon]) { return `${lat.toFixed(5)}\u00b0, ${lon.toFixed(5)}\u00b0`; }

/** Figure of a profile.
 * @param {MapProfile} profile @param {number} width @param {(at: Position | null) => void} hover */
function profileFigure(profile, width, hover) {
  const { distance_m: along, value, lat, lon, unit, table } = profile, last = along.length - 1;
  const far = along[last] > FAR_M, scale = far ? 1000 : 1, long = far ? "km" : "m";
  const left = 74, right = 14;
  const x = new PlotScale([0, along[last] / scale], left, width - right);
  // Distances are never on a logarithmic axis.
  [x.log, x.zero, x.low, x.high] = [false, 0, 0, along[last] / scale];
  const finite = /** @type {number[]} */ (value.filter((v) => v !== null));
  const y = new PlotScale(finite, PROFILE_PX - 44, 12);
  if (y.log) {
    const [low, high] = [Math.min(...reduced(finite, Math.min)), Math.max(...reduced(finite, Math.max))];
    const pad = 0.04 * (high - low);
    [y.log, y.zero, y.low, y.high] = [false, 0, low - pad, high + pad];
  }
  let path = "", pen = false;
  /** @type {PlotTarget[]} */
  const targets = [];
  value.forEach((v, i) => {
    if (v === null) { pen = false; return; }
    const [px, py] = [x.at(along[i] / scale), y.at(v)];
    path += `${pen ? "L" : "M"}${px.toFixed(1)} ${py.toFixed(1)}`;
    pen = true;
    targets.push({ x: px, y: py, row: -1, text: `${along[i].toFixed(0)} m: ${short(v)} ${unit} at ` +
      placeText([lat[i], lon[i]]) });
  });
  const { svg, read } = livePlot({ label: `Profile of the map ${visible(table)}`, width, height: PROFILE_PX, targets,
    choose: () => {} });
  svg.append(plotFrame(x, y, `distance, ${long}`, unit), shape("path", { class: "spectrum", d: path,
    style: "stroke:var(--after)" }));
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect(), px = (event.clientX - box.left) * width / box.width;
    const part = (px - left) / (width - left - right), i = Math.round(part * last);
    hover(part >= 0 && part <= 1 ? [lat[i], lon[i]] : null);
  });
  svg.addEventListener("pointerleave", () => hover(null));
  const csv = () => [csvRow(["distance [m]", "lat [deg]", "lon [deg]", `value [${unit}]`]),
    ...along.map((d, i) => csvRow([d, lat[i], lon[i], value[i]]))].join("\n") + "\n";
  const missing = along.length - profile.known;
  return element("figure", { class: "live profile" }, [svg, read, element("figcaption", {}, [`From ` +
    `${placeText([lat[0], lon[0]])} to ${placeText([lat[last], lon[last]])}: ${short(along[last] / scale)} ${long} ` +
    `on the ellipsoid. Bilinear between the nodes of the map.` + (missing ? ` ${missing} of ${along.length} samples ` +
    "are off the map or at unknown nodes." : "")]), downloads(svg, `${table}_profile`, csv)]);
}
