// @ts-check
"use strict";
// Scores of two tables, such as those of two pipelines: the points, metrics and lines that both have.

/** @typedef {{a: number, b: number}} SharedPoint Positions of a point in both tables. */

/** Axis value in one spelling for equal numbers. @param {string} text */
function axisKey(text) {
  return text.trim() !== "" && Number.isFinite(Number(text)) ? String(Number(text)) : text;
}

class PipelinePair {
  /** @param {[ScoreBlock, ScoreBlock]} blocks
   * @param {[SweepPoint, SweepPoint]} fixed Wanted values of the axes that only one table has. */
  constructor(blocks, fixed) {
    this.sets = /** @type {[ScoreSet, ScoreSet]} */ (blocks.map((block) => new ScoreSet(block)));
    const [, b] = this.sets, [one, two] = blocks;
    /** Axes of both tables, as positions in each. */
    this.axes = one.axes.map((axis, i) => [i, b.axis(axis.name)]).filter(([, k]) => k >= 0);
    /** Metrics of both tables with the same unit, as positions in each. */
    this.metrics = one.metrics.map((m, i) => [i, b.metric(m.name)])
      .filter(([i, k]) => k >= 0 && one.metrics[i].unit === two.metrics[k].unit);
    /** Axes that only one of the tables has, as positions in it. */
    this.own = [0, 1].map((side) => blocks[side].axes.map((_, i) => i)
      .filter((i) => !this.axes.some((pair) => pair[side] === i)));
    this.fixed = [0, 1].map((side) => this.fixedValues(side, fixed[side]));
    /** @type {SharedPoint[]} */
    this.points = this.shared();
    /** Axes whose values differ among the shared points. */
    this.varying = this.axes.filter(([i]) => new Set(this.points.map(({ a: row }) => one.at[i][row])).size > 1);
    this.entries = this.sets.map(({ block }) => {
      /** @type {Map<number, number[]>} */
      const found = new Map();
      block.lines?.points.forEach((point, entry) => {
        const known = found.get(point);
        if (known) known.push(entry); else found.set(point, [entry]);
      });
      return found;
    });
    this.seen = this.sets.map(({ block }) => new Set(block.lines?.in_sample ?? []));
  }

  /** Values of the axes that only one table has: the wanted ones, else those of its best point.
   * @param {number} side @param {SweepPoint} wanted @returns {Map<number, number>} */
  fixedValues(side, wanted) {
    const { sets, own } = this, { block } = sets[side];
    const best = sets[side].best(Math.max(0, block.headline ?? 0), Array.from({ length: block.points }, (_, i) => i));
    return new Map(own[side].map((i) => {
      const { name, values } = block.axes[i], given = wanted[name];
      const at = given === undefined ? -1 : values.findIndex((value) => sameValue(value, given));
      return [i, at >= 0 ? at : best < 0 ? 0 : block.at[i][best]];
    }));
  }

  /** Rows of a table at its fixed values, by the values of the shared axes. @param {number} side */
  rowsOf(side) {
    const { block } = this.sets[side], keys = block.axes.map((axis) => axis.values.map(axisKey));
    /** @type {Map<string, number>} */
    const found = new Map();
    for (let row = 0; row < block.points; row++) {
      if ([...this.fixed[side]].some(([i, at]) => block.at[i][row] !== at)) continue;
      found.set(JSON.stringify(this.axes.map((pair) => keys[pair[side]][block.at[pair[side]][row]])), row);
    }
    return found;
  }

  /** @returns {SharedPoint[]} */
  shared() {
    const other = this.rowsOf(1);
    return [...this.rowsOf(0)].flatMap(([key, row]) => {
      const b = other.get(key);
      return b === undefined ? [] : [{ a: row, b }];
    });
  }

  /** @param {number} m @param {SharedPoint} point @returns {[number | null, number | null]} */
  values(m, { a, b }) {
    const [i, k] = this.metrics[m];
    return [this.sets[0].value(i, a), this.sets[1].value(k, b)];
  }

  /** Difference of B and A; `null` without both values. @param {number} m @param {SharedPoint} point */
  difference(m, point) {
    const [a, b] = this.values(m, point);
    return a === null || b === null ? null : difference(a, b);
  }

  /** Values of a metric on the lines of a point, by flight and line. @param {number} side @param {number} m
   * @param {number} row @returns {Map<string, {value: number, seen: boolean}>} */
  lines(side, m, row) {
    const own = this.sets[side].block.lines, column = own?.metrics.indexOf(this.metrics[m][side]) ?? -1;
    if (!own || column < 0) return new Map();
    return new Map((this.entries[side].get(row) ?? []).flatMap((entry) => {
      const value = own.values[column][entry];
      return value === null ? [] : [[JSON.stringify(own.names[own.lines[entry]]),
        { value, seen: this.seen[side].has(entry) }]];
    }));
  }

  /** Differences on the lines that both have. Lines that are in sample on one side only are omitted.
   * @param {number} m @param {SharedPoint} point */
  paired(m, { a, b }) {
    const [one, two] = [this.lines(0, m, a), this.lines(1, m, b)];
    return pairedDifference([...one].flatMap(([name, { value, seen }]) => {
      const other = two.get(name);
      return other === undefined || other.seen !== seen ? [] : [other.value - value];
    }));
  }

  /** Reason why the values are not of the same lines; empty for the same lines. @param {number} m
   * @param {SharedPoint} point */
  reason(m, point) {
    const [a, b] = this.values(m, point);
    if (a === null && b === null) return "no values";
    if (a === null || b === null) return `no value in ${a === null ? "A" : "B"}`;
    const [one, two] = [this.lines(0, m, point.a), this.lines(1, m, point.b)];
    if (!one.size || !two.size) return "scores of single lines are missing";
    const shared = [...one].filter(([name, { seen }]) => two.get(name)?.seen === seen).length;
    return shared === one.size && shared === two.size ? ""
      : `lines differ: ${one.size} in A, ${two.size} in B, ${shared} in both`;
  }

  /** Marks of a value in words. @param {number} side @param {number} m @param {SharedPoint} point */
  marks(side, m, { a, b }) { return this.sets[side].marks(this.metrics[m][side], side ? b : a); }

  /** Side of the better value, or -1: only on the same lines, held out and not flagged.
   * @param {number} m @param {SharedPoint} point */
  better(m, point) {
    const [i] = this.metrics[m], [a, b] = this.values(m, point);
    if (this.reason(m, point) || this.marks(0, m, point) || this.marks(1, m, point)) return -1;
    if (!this.difference(m, point)) return -1;
    const [one, two] = [this.sets[0].cost(i, a), this.sets[0].cost(i, b)];
    return one < two ? 0 : two < one ? 1 : -1;
  }

  /** Value of a shared axis as shown. @param {number[]} axis @param {SharedPoint} point */
  text([i], { a }) { return this.sets[0].text(i, a); }

  /** @param {number} m */
  label(m) { return this.sets[0].label(this.metrics[m][0]); }

  /** Values of the axes that only one table has, in words. @param {number} side */
  fixedWords(side) {
    const { block, texts } = this.sets[side];
    return [...this.fixed[side]].map(([i, at]) => `${block.axes[i].name} = ${texts[i][at]}`).join(", ");
  }

  /** All shared points and metrics. */
  csv() {
    const { block } = this.sets[0];
    const head = [...this.axes.map(([i]) => block.axes[i].name), "metric", "unit", "A", "B", "difference",
      "paired lines", "mean difference", "difference low", "difference high", "marks A", "marks B", "lines"];
    const body = this.points.flatMap((point) => this.metrics.map(([i], m) => {
      const [a, b] = this.values(m, point), paired = this.paired(m, point);
      return csvRow([...this.axes.map(([k]) => this.sets[0].word(k, point.a)), block.metrics[i].name,
        block.metrics[i].unit, a, b, this.difference(m, point), paired?.lines ?? 0, paired?.mean ?? null,
        paired?.low ?? null, paired?.high ?? null, this.marks(0, m, point), this.marks(1, m, point),
        this.reason(m, point) || "equal"]);
    }));
    return [csvRow(head), ...body].join("\n") + "\n";
  }
}

/**
 * @typedef {{name: string, stage: string, version: number, axes: string[], inputs: string[], predicate: string | null,
 *   parameters: Record<string, {count: number, values: string[]}>}} NotedTable
 * @typedef {{pipeline: string, seed: number, tables: NotedTable[], sources: {name: string, kind: string,
 *   files: [string, string][]}[]}} NotedPipeline
 * @typedef {{kind: string, table: string, what: string, a: string | null, b: string | null}} PipelineChange
 */

/** Differences of two pipelines in their sources, tables and parameters.
 * @param {NotedPipeline} one @param {NotedPipeline} two @returns {PipelineChange[]} */
function pipelineChanges(one, two) {
  /** @type {PipelineChange[]} */
  const found = [];
  const add = (/** @type {string} */ kind, /** @type {string} */ table, /** @type {string} */ what,
    /** @type {string | null | undefined} */ a, /** @type {string | null | undefined} */ b) => {
    if ((a ?? null) !== (b ?? null)) found.push({ kind, table, what, a: a ?? null, b: b ?? null });
  };
  const names = (/** @type {{name: string}[][]} */ lists) => [...new Set(lists.flat().map((x) => x.name))];
  add("seed", "", "seed", String(one.seed), String(two.seed));
  const files = (/** @type {NotedPipeline} */ p, /** @type {string} */ name) => {
    const own = p.sources.find((s) => s.name === name);
    return own?.files.map(([path, hash]) => `${path.split("/").pop()} (${hash.slice(0, 8)})`).join(", ");
  };
  for (const name of names([one.sources, two.sources])) {
    add("source", name, "files", files(one, name), files(two, name));
  }
  const values = (/** @type {{count: number, values: string[]} | undefined} */ p) => p && p.values.join(", ") +
    (p.count > p.values.length ? `, \u2026 (${p.count} values)` : "");
  for (const name of names([one.tables, two.tables])) {
    const [a, b] = [one, two].map((p) => p.tables.find((t) => t.name === name));
    const stage = (/** @type {NotedTable | undefined} */ t) => t && `${t.stage}, version ${t.version}`;
    add("table", name, "stage", stage(a), stage(b));
    if (!a || !b) continue;
    add("table", name, "inputs", a.inputs.join(", "), b.inputs.join(", "));
    add("table", name, "axes", a.axes.join(", "), b.axes.join(", "));
    add("table", name, "where", a.predicate, b.predicate);
    for (const key of new Set([...Object.keys(a.parameters), ...Object.keys(b.parameters)])) {
      add("parameter", name, key, values(a.parameters[key]), values(b.parameters[key]));
    }
  }
  return found;
}
