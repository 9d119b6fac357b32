// @ts-check
"use strict";
// Contour lines of a map: marching squares between the centres of its cells.

/** @typedef {[number, number][]} ContourLine Columns and rows of cell centres, from the north-west. */

const MOST_LEVELS = 40, LEAST_LEVELS = 3, HEAVY_CONTOUR = 5, LABEL_GAP = [0.13, 0.05], LABEL_LENGTH = 0.12;
/** @type {[number, number][]} */
const NO_CUTS = [];

/** Steps between contours: 1, 2 or 5 times a power of ten, with a readable number of levels.
 * @param {number} low @param {number} high */
function contourSteps(low, high) {
  /** @type {number[]} */
  const out = [];
  if (!(high > low)) return out;
  for (let k = Math.floor(Math.log10(high - low)) + 1; out.length < 4 && k > -12; k--) {
    for (const m of [5, 2, 1]) {
      const step = Number((m * 10 ** k).toPrecision(1)), levels = contourLevels(low, high, step).length;
      if (levels >= LEAST_LEVELS && levels <= MOST_LEVELS && out.length < 4) out.push(step);
    }
    if ((high - low) / 10 ** k > MOST_LEVELS) break;
  }
  return out;
}

/** Multiples of a step within a range. @param {number} low @param {number} high @param {number} step */
function contourLevels(low, high, step) {
  const [first, last] = [Math.ceil(low / step), Math.floor(high / step)];
  return Array.from({ length: Math.max(0, Math.min(1000, last - first + 1)) }, (_, i) =>
    Number(((first + i) * step).toPrecision(12)));
}

/** Pairs of edges of a cell that a contour joins. Edge 2k runs east from node k, edge 2k + 1 south.
 * @param {ArrayLike<number>} cells @param {number} width @param {number} node @param {number} level
 * @returns {[number, number][]} */
function contourCuts(cells, width, node, level) {
  const first = cells[node] >= level;
  if (first === (cells[node + 1] >= level) && first === (cells[node + width] >= level) &&
    first === (cells[node + width + 1] >= level)) return NO_CUTS;
  const corners = [node, node + 1, node + width + 1, node + width].map((k) => cells[k]);
  const above = corners.map((v) => v >= level);
  if (!corners.every(Number.isFinite)) return NO_CUTS;
  const edges = [2 * node, 2 * (node + 1) + 1, 2 * (node + width), 2 * node + 1];
  const crossed = edges.filter((_, k) => above[k] !== above[(k + 1) % 4]);
  if (crossed.length === 2) return [[crossed[0], crossed[1]]];
  // At a saddle, the mean decides.
  const middle = corners.reduce((a, b) => a + b) >= 4 * level, [north, east, south, west] = crossed;
  return above[0] === middle ? [[north, east], [south, west]] : [[north, west], [east, south]];
}

/** Contours of one level. @param {{cells: ArrayLike<number>, width: number, height: number}} map
 * @param {number} level @returns {ContourLine[]} */
function contourLines({ cells, width, height }, level) {
  /** @type {Map<number, number[]>} */
  const links = new Map();
  const link = (/** @type {number} */ a, /** @type {number} */ b) => {
    const known = links.get(a);
    if (known) known.push(b); else links.set(a, [b]);
  };
  for (let row = 0; row + 1 < height; row++) for (let column = 0; column + 1 < width; column++) {
    for (const [a, b] of contourCuts(cells, width, row * width + column, level)) { link(a, b); link(b, a); }
  }
  const crossing = (/** @type {number} */ edge) => {
    const node = edge >> 1, other = node + (edge & 1 ? width : 1);
    const part = (level - cells[node]) / (cells[other] - cells[node]);
    const [column, row] = [node % width, Math.floor(node / width)];
    return /** @type {[number, number]} */ (edge & 1 ? [column, row + part] : [column + part, row]);
  };
  // Open lines begin at an end, closed lines anywhere.
  const ends = [...links].filter(([, to]) => to.length === 1).map(([at]) => at);
  return [...ends, ...links.keys()].map((start) => contourWalk(links, start)).filter((line) => line.length > 1)
    .map((line) => line.map(crossing));
}

/** Edges from a start on, removed from the links. @param {Map<number, number[]>} links @param {number} start */
function contourWalk(links, start) {
  const line = [start];
  for (let at = start, next; (next = links.get(at)?.pop()) !== undefined; at = next) {
    const back = links.get(next) ?? [];
    back.splice(back.indexOf(at), 1);
    line.push(next);
  }
  return line;
}

/** Length of a line, as a part of the map's width and height. @param {ContourLine} line @param {MapImage} map */
function contourLength(line, { width, height }) {
  let sum = 0;
  for (let i = 1; i < line.length; i++) {
    sum += Math.hypot((line[i][0] - line[i - 1][0]) / width, (line[i][1] - line[i - 1][1]) / height);
  }
  return sum;
}

/** Path in a box of 1000 by 1000. @param {ContourLine[]} lines @param {MapImage} map */
function contourPath(lines, { width, height }) {
  return lines.map((line) => "M" + line.map(([x, y]) => `${(1000 * (x + 0.5) / width).toFixed(1)} ` +
    (1000 * (y + 0.5) / height).toFixed(1)).join("L")).join("");
}

/** Contours of a map as paths, and their labels. @param {MapImage} map @param {number} step */
function contourDrawing(map, step) {
  /** @type {SVGElement[]} */
  const paths = [];
  /** @type {HTMLElement[]} */
  const labels = [];
  /** @type {[number, number][]} */
  const taken = [];
  for (const level of contourLevels(map.least, map.most, step)) {
    const lines = contourLines(map, level), heavy = Math.round(level / step) % HEAVY_CONTOUR === 0;
    if (!lines.length) continue;
    paths.push(shape("path", { class: heavy ? "contour heavy" : "contour", "data-level": level,
      d: contourPath(lines, map) }));
    for (const line of lines.filter((one) => contourLength(one, map) > LABEL_LENGTH)) {
      const place = labelPlace(line, map, taken);
      if (!place) continue;
      taken.push(place);
      labels.push(element("span", { class: "contour-label", "aria-hidden": "true", style:
        `left:${(100 * place[0]).toFixed(2)}%;top:${(100 * place[1]).toFixed(2)}%` }, [String(level).replace("-",
        "\u2212")]));
    }
  }
  return { paths, labels };
}

/** A place on a line away from the edges and from other labels, from 0 to 1. @param {ContourLine} line
 * @param {MapImage} map @param {[number, number][]} taken @returns {[number, number] | null} */
function labelPlace(line, { width, height }, taken) {
  for (const part of [0.5, 0.25, 0.75]) {
    const [x, y] = line[Math.floor(part * (line.length - 1))], u = (x + 0.5) / width, v = (y + 0.5) / height;
    const inside = Math.min(u, 1 - u) > 0.05 && Math.min(v, 1 - v) > 0.03;
    const [wide, high] = LABEL_GAP;
    if (inside && taken.every(([a, b]) => Math.abs(a - u) > wide || Math.abs(b - v) > high)) return [u, v];
  }
  return null;
}
