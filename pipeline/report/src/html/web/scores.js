// @ts-check
"use strict";
// Scores of one table, read from the JSON block of its section: selection, ranking, text.

/**
 * @typedef {{name: string, numeric: boolean, values: string[]}} ScoreAxis
 * @typedef {{name: string, unit: string, better: string, target: number | null, meaning: string, pool: string,
 *   baseline: string | null}} ScoreMetric
 * @typedef {{names: [string, string][], metrics: number[], points: number[], lines: number[], in_sample: number[],
 *   flagged: number[], values: (number | null)[][]}} LineBlock
 * @typedef {{pipeline: string, table: string, points: number, headline: number | null, over: string,
 *   axes: ScoreAxis[], metrics: ScoreMetric[], at: number[][], values: (number | null)[][], in_sample: number[][],
 *   flagged: number[], cautious: number[], bounds: number[], held_out: number[], seen: number[],
 *   omitted: string[], lines: LineBlock | null}} ScoreBlock
 * @typedef {Record<string, string>} ExplorerState
 */

/** A number with four significant digits. @param {number | null | undefined} x */
function short(x) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "-";
  if (x === 0) return "0";
  const size = Math.abs(x);
  return size < 1e-4 || size >= 1e6 ? x.toExponential(3) : x.toPrecision(4).replace(/e\+?(\d+)$/, "e$1");
}

/** Control characters and characters that change the direction of text, as escapes. @param {string} text */
function visible(text) {
  return text.replace(/[\u0000-\u001f\u007f-\u009f]/g, (c) => "\\x" + c.charCodeAt(0).toString(16).padStart(2, "0"))
    .replace(/[\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/g,
      (c) => "\\u" + c.charCodeAt(0).toString(16).padStart(4, "0"));
}

/** Values of an axis as shown: long numbers with the fewest digits that keep them apart. @param {ScoreAxis} axis */
function shownValues({ numeric, values }) {
  if (numeric && values.some((v) => v.length > 8)) {
    for (const digits of [4, 6, 9]) {
      const texts = values.map((v) => {
        const x = Number(Number(v).toPrecision(digits));
        return x !== 0 && Math.abs(x) < 1e-3 ? x.toExponential() : String(x);
      });
      if (new Set(texts).size === values.length) return texts;
    }
  }
  return values.map(visible);
}

/** Quoted cells of one row. @param {(string | number | null | boolean)[]} cells */
function csvRow(cells) {
  return cells.map((cell) => {
    const text = cell === null ? "" : String(cell);
    return /[",\r\n]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
  }).join(",");
}

/** Scores with their exclusions. */
class ScoreSet {
  /** @param {ScoreBlock} block */
  constructor(block) {
    this.block = block;
    this.inSample = block.in_sample.map((rows) => new Set(rows));
    this.cautious = new Set(block.cautious);
    this.bounds = new Set(block.bounds);
    this.texts = block.axes.map(shownValues);
    /** Positions of the axes with several values. */
    this.varying = block.axes.map((_, a) => a).filter((a) => block.axes[a].values.length > 1);
    /** Positions of the values of each axis, in display order. */
    this.order = block.axes.map((axis) => {
      const at = axis.values.map((_, i) => i);
      if (axis.numeric) at.sort((i, k) => Number(axis.values[i]) - Number(axis.values[k]));
      return at;
    });
  }

  /** @param {string} name */
  metric(name) { return this.block.metrics.findIndex((m) => m.name === name); }

  /** @param {string} name */
  axis(name) { return this.block.axes.findIndex((a) => a.name === name); }

  /** @param {number} m @param {number} row @returns {number | null} */
  value(m, row) { return this.block.values[m]?.[row] ?? null; }

  /** Axis value of a row as text. @param {number} a @param {number} row */
  word(a, row) { return this.block.axes[a].values[this.block.at[a][row]]; }

  /** Axis value of a row as shown. @param {number} a @param {number} row */
  text(a, row) { return this.texts[a][this.block.at[a][row]]; }

  /** Whether a row is never the best. @param {number} m @param {number} row */
  excluded(m, row) {
    return this.block.flagged[row] > 0 || this.bounds.has(row) || this.inSample[m].has(row);
  }

  /** Cost of a value; the better of two values has the smaller cost. @param {number} m @param {number | null} v */
  cost(m, v) {
    const { better, target } = this.block.metrics[m];
    if (v === null) return Infinity;
    if (better === "lower") return v;
    if (better === "higher") return -v;
    return better === "near" ? Math.abs(Math.log(v / (target ?? 1))) : Infinity;
  }

  /** The best of some rows; excluded rows only if there is no other. @param {number} m @param {number[]} rows */
  best(m, rows) {
    let found = -1, cost = Infinity, out = true;
    for (const row of rows) {
      const own = this.cost(m, this.value(m, row)), excluded = this.excluded(m, row);
      if (!Number.isFinite(own)) continue;
      if (found < 0 || (out && !excluded) || (out === excluded && own < cost)) {
        [found, cost, out] = [row, own, excluded];
      }
    }
    return found;
  }

  /** Sweep point of a row in words: the axes that differ. @param {number} row */
  point(row) {
    return this.varying.map((a) => `${this.block.axes[a].name} = ${this.text(a, row)}`).join(", ");
  }

  /** A value with its metric and unit. @param {number} m @param {number | null} v */
  words(m, v) {
    const { name, unit } = this.block.metrics[m];
    return `${name} ${short(v)}${unit === "1" ? "" : " " + unit}`;
  }

  /** Metric and unit. @param {number} m */
  label(m) {
    const { name, unit } = this.block.metrics[m];
    return unit === "1" ? name : `${name} [${unit}]`;
  }

  /** Marks of a value in words. @param {number} m @param {number} row */
  marks(m, row) {
    const out = [];
    if (this.block.flagged[row] > 0) out.push(this.cautious.has(row) ? "cautious" : "flagged");
    if (this.inSample[m].has(row)) out.push("in sample");
    if (this.bounds.has(row)) out.push("bound");
    return out.join(", ");
  }

  /** Rows that the filters of the state keep. @param {ExplorerState} state */
  rows(state) {
    const { axes, at, points } = this.block;
    /** @type {((row: number) => boolean)[]} */
    const tests = [];
    const m = Math.max(0, this.metric(state.metric));
    axes.forEach((axis, a) => {
      const wanted = state["is." + axis.name];
      if (wanted !== undefined) {
        const code = axis.values.indexOf(wanted);
        tests.push((row) => at[a][row] === code);
      }
      const text = state["has." + axis.name];
      if (text) {
        const range = /^\s*(\S*?)\s*\.\.\s*(\S*)\s*$/.exec(text);
        const [low, high] = range ? [Number(range[1] || -Infinity), Number(range[2] || Infinity)] : [NaN, NaN];
        const keep = axis.values.map((v) => axis.numeric && range ? Number(v) >= low && Number(v) <= high
          : v.includes(text));
        tests.push((row) => keep[at[a][row]]);
      }
    });
    if (state.sound) tests.push((row) => !this.excluded(m, row));
    const rows = [];
    for (let row = 0; row < points; row++) if (tests.every((test) => test(row))) rows.push(row);
    return rows;
  }

  /** Scores of the lines of a point, worst first. @param {number} m @param {number} point */
  linesOf(m, point) {
    const lines = this.block.lines;
    if (!lines || point < 0) return [];
    const column = lines.metrics.indexOf(m);
    const base = lines.metrics.indexOf(this.metric(this.block.metrics[m].baseline ?? ""));
    const seen = new Set(lines.in_sample), flagged = new Set(lines.flagged);
    const found = [];
    for (let i = 0; i < lines.points.length; i++) {
      const value = column < 0 ? null : lines.values[column][i];
      if (lines.points[i] !== point || value === null) continue;
      const [flight, line] = lines.names[lines.lines[i]];
      const marks = [flagged.has(i) ? "flagged" : "", seen.has(i) ? "in sample" : ""].filter(Boolean).join(", ");
      found.push({ flight, line, value, base: base < 0 ? null : lines.values[base][i], marks });
    }
    return found.sort((a, b) => this.cost(m, b.value) - this.cost(m, a.value));
  }

  /** All scores of some rows as CSV. @param {number[]} rows */
  csv(rows) {
    const { axes, metrics, flagged, held_out, seen } = this.block;
    const named = metrics.map((_, m) => this.label(m));
    const head = [...axes.map((a) => a.name), "flagged_lines", "lines_held_out", "lines_in_sample", ...named];
    const body = rows.map((r) => csvRow([...axes.map((_, a) => this.word(a, r)), flagged[r], held_out[r], seen[r],
      ...metrics.map((_, m) => this.value(m, r))]));
    return [csvRow(head), ...body].join("\n") + "\n";
  }
}
