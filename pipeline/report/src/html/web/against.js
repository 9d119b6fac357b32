// @ts-check
"use strict";
// Comparison of two runs: the scores of shared points, points of one run only, and what changed between the runs.

/**
 * @typedef {{number: number, time: string, run: string, version: string, tables: number}} RunInfo
 * @typedef {{values: (number | null)[][], n: number[][], lines: number[][], in_sample: boolean[][],
 *   low: (number | null)[][], high: (number | null)[][], flagged: boolean[]}} RunSide
 * @typedef {{kind: string, table: string, what: string, before: string | null, after: string | null,
 *   points: number}} RunChange
 * @typedef {{pipeline: string, table: string, runs: [RunInfo, RunInfo], axes: ScoreAxis[], at: number[][],
 *   points: number, headline: number, metrics: ScoreMetric[], sides: [RunSide, RunSide], reasons: string[],
 *   rows: number[][], pairs: number[][][], omitted: string[], changes: RunChange[],
 *   only: [{count: number, points: string[]}, {count: number, points: string[]}]}} RunBlock
 */

const AGAINST_KEY = ".against", MOST_COMPARED = 300;
/** The server; a report without series does not contain the script that defines it. */
const RUN_SERVER = typeof SERVER === "undefined" ? null : SERVER;

/** Two runs of one table of scores. */
class RunPair {
  /** @param {RunBlock} block */
  constructor(block) {
    this.block = block;
    this.texts = block.axes.map(shownValues);
    /** Positions of the axes with several values. */
    this.varying = block.axes.map((_, a) => a).filter((a) => block.axes[a].values.length > 1);
  }

  /** @param {number} side @param {number} m @param {number} row */
  value(side, m, row) { return this.block.sides[side].values[m]?.[row] ?? null; }

  /** Difference of the second run and the first; `null` without both values. @param {number} m @param {number} row */
  difference(m, row) {
    const [a, b] = [this.value(0, m, row), this.value(1, m, row)];
    return a === null || b === null ? null : difference(a, b);
  }

  /** Difference over the same lines; `null` for unequal rows. @param {number} m @param {number} row */
  paired(m, row) { return this.reason(m, row) ? null : pairedDifference(this.block.pairs[m]?.[row] ?? []); }

  /** Reason why the values are not of equal rows; empty for equal rows. @param {number} m @param {number} row */
  reason(m, row) {
    const known = this.block.reasons[this.block.rows[m]?.[row] ?? 0] ?? "";
    const missing = this.block.runs.filter((_, side) => this.value(side, m, row) === null);
    return known || (missing.length === 1 ? `no value in run ${missing[0].number}` : "");
  }

  /** Marks of a value in words. @param {number} side @param {number} m @param {number} row */
  marks(side, m, row) {
    const own = this.block.sides[side];
    return [own.flagged[row] ? "flagged" : "", own.in_sample[m][row] ? "in sample" : ""].filter(Boolean).join(", ");
  }

  /** Position of the run with the better value, or -1: only on equal rows, held out and not flagged.
   * @param {number} m @param {number} row */
  better(m, row) {
    if (this.reason(m, row) || this.marks(0, m, row) || this.marks(1, m, row)) return -1;
    if (!this.difference(m, row)) return -1;
    const { better, target } = this.block.metrics[m];
    const cost = (/** @type {number} */ v) => better === "lower" ? v : better === "higher" ? -v
      : better === "near" ? Math.abs(Math.log(v / (target ?? 1))) : NaN;
    const [a, b] = [cost(this.value(0, m, row) ?? NaN), cost(this.value(1, m, row) ?? NaN)];
    return a < b ? 0 : b < a ? 1 : -1;
  }

  /** Axis values of a row in words. @param {number} row */
  point(row) {
    const { axes, at } = this.block;
    return this.varying.map((a) => `${axes[a].name} = ${this.texts[a][at[a][row]]}`).join(", ");
  }

  /** @param {number} m */
  label(m) {
    const { name, unit } = this.block.metrics[m];
    return unit === "1" ? name : `${name} [${unit}]`;
  }

  /** All shared points and metrics. */
  csv() {
    const { axes, at, metrics, runs, sides, points } = this.block;
    const of = (/** @type {string} */ what) => runs.map((r) => `${what} run ${r.number}`);
    const head = [...axes.map((a) => a.name), "metric", "unit", ...of("value"), "difference",
      "paired lines", "mean difference", "difference low", "difference high", ...of("low"), ...of("high"),
      ...of("n"), ...of("lines"), ...of("in_sample"), ...of("flagged"), "rows"];
    const body = [];
    for (let row = 0; row < points; row++) for (let m = 0; m < metrics.length; m++) {
      const both = (/** @type {(side: RunSide) => string | number | null} */ get) => sides.map(get);
      const paired = this.paired(m, row);
      body.push(csvRow([...axes.map((axis, a) => axis.values[at[a][row]]), metrics[m].name, metrics[m].unit,
        this.value(0, m, row), this.value(1, m, row), this.difference(m, row), paired?.lines ?? 0,
        paired?.mean ?? null, paired?.low ?? null, paired?.high ?? null, ...both((s) => s.low[m][row]),
        ...both((s) => s.high[m][row]), ...both((s) => s.n[m][row]), ...both((s) => s.lines[m][row]),
        ...both((s) => String(s.in_sample[m][row])), ...both((s) => String(s.flagged[row])),
        this.reason(m, row) || "equal"]));
    }
    return [csvRow(head), ...body].join("\n") + "\n";
  }
}

/** The last known state of the runs of the spec. @type {RunState | undefined} */
let lastRunState;
document.addEventListener("magline:run", (event) => {
  lastRunState = /** @type {CustomEvent} */ (event).detail;
});

class AgainstView {
  /** @param {HTMLElement} home @param {RunBlock[] | null} blocks Blocks of a report; `null` for a server. */
  constructor(home, blocks) {
    this.home = home;
    this.blocks = blocks;
    this.state = stateOf(AGAINST_KEY);
    /** Answers of the server by address, until tables are published. @type {Map<string, Promise<any>>} */
    this.known = new Map();
    this.polled = lastRunState;
    /** @type {RunPair | null} */
    this.pair = null;
    this.controls = element("div", { class: "controls" });
    this.status = element("p", { class: "note", role: "status" });
    this.panel = element("div");
    home.append(this.controls, this.status, this.panel);
    addEventListener("hashchange", () => { this.state = stateOf(AGAINST_KEY); this.refresh(); });
    if (!blocks) document.addEventListener("magline:changed", () => { this.known.clear(); this.refresh(); });
    document.addEventListener("magline:run", (event) => this.follow(/** @type {CustomEvent} */ (event).detail));
    this.refresh();
  }

  /** Tables of scores, as PIPELINE.TABLE. */
  tables() {
    if (this.blocks) return this.blocks.map((b) => `${b.pipeline}.${b.table}`);
    return [...document.querySelectorAll("section.explorer")].map((s) => s.getAttribute("data-table") ?? "");
  }

  /** JSON of an address. @param {string} path @param {Record<string, string>} query @returns {Promise<any>} */
  json(path, query) {
    if (!RUN_SERVER) return Promise.resolve(null);
    const address = RUN_SERVER.address(RUN_SERVER.base + path, query);
    const known = this.known.get(address) ?? RUN_SERVER.get(address).then((answer) => answer.json());
    this.known.set(address, known);
    known.catch(() => this.known.delete(address));
    return known;
  }

  /** Runs of the pipeline of a table, the newest first. @param {string} table @returns {Promise<RunInfo[]>} */
  async runsOf(table) {
    const pipeline = table.slice(0, table.indexOf("."));
    // The view of a spec polls the state of its runs.
    if (document.body.dataset.mode !== "store") return this.polled?.pipeline === pipeline ? this.polled.runs : [];
    const all = await this.json("run", {});
    return all?.pipelines.find((/** @type {any} */ p) => p.pipeline === pipeline)?.runs ?? [];
  }

  /** Takes the state of a run in progress. @param {RunState} state */
  follow(state) {
    const before = this.polled?.runs.length;
    this.polled = state;
    if (before !== state.runs.length) this.refresh();
  }

  /** @param {string} key @param {string} value */
  set(key, value) {
    if (value) this.state[key] = value; else delete this.state[key];
    keepState(AGAINST_KEY, this.state);
    this.refresh();
  }

  async refresh() {
    const turn = this.turn = (this.turn ?? 0) + 1, tables = this.tables();
    const table = tables.includes(this.state.table ?? "") ? this.state.table : tables[0];
    try {
      const runs = await this.runsOf(table);
      /** @type {RunBlock | null} */
      let block = this.blocks?.[tables.indexOf(table)] ?? null;
      if (!this.blocks && this.state.against && RUN_SERVER) {
        const query = { table, against: this.state.against, ...(this.state.run ? { run: this.state.run } : {}) };
        if (!this.pair) this.status.textContent = "The scores of both runs are read.";
        block = await this.json("against", query);
      }
      if (turn !== this.turn) return;
      this.pair = block ? new RunPair(block) : null;
      this.fill(tables, table, runs);
    } catch (error) {
      if (turn !== this.turn) return;
      this.pair = null;
      this.fill(tables, table, await this.runsOf(table).catch(() => []));
      this.status.textContent = error instanceof Error ? visible(error.message) : "The runs cannot be compared.";
    }
  }

  /** @param {string} label @param {string} key @param {[string, string][]} choices @param {string} value */
  choice(label, key, choices, value) {
    const options = choices.map(([own, text]) => element("option", { value: own, selected: own === value }, [text]));
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      onchange: () => this.set(key, made.value) }, options));
    return element("label", {}, [label, made]);
  }

  /** @param {string[]} tables @param {string} table @param {RunInfo[]} runs */
  fill(tables, table, runs) {
    const focus = this.controls.contains(document.activeElement)
      ? document.activeElement?.getAttribute("data-key") : null;
    const parts = [];
    if (tables.length > 1) parts.push(this.choice("scores", "table", tables.map((t) => [t, visible(t)]), table));
    const words = (/** @type {RunInfo} */ r) => `${r.number}: ${r.time}, magline ${visible(r.version)}`;
    if (!this.blocks && runs.length > 1) {
      const listed = runs.map((r) => /** @type {[string, string]} */ ([String(r.number), words(r)]));
      parts.push(this.choice("run", "run", [["", "newest run"], ...listed], this.state.run ?? ""),
        this.choice("compare with", "against", [["", "choose a run"], ...listed], this.state.against ?? ""));
    }
    const { pair } = this;
    if (pair) {
      const metrics = pair.block.metrics.map((m, i) => /** @type {[string, string]} */ ([m.name, pair.label(i)]));
      parts.push(this.choice("metric", "metric", metrics, this.metricName(pair)), this.choice("order", "order",
        [["", "as in the sweep"], ["change", "largest change first"]], this.state.order ?? ""));
    }
    this.controls.replaceChildren(...parts);
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
    if (pair) this.draw(pair); else {
      this.panel.replaceChildren();
      this.status.textContent = runs.length > 1 ? "Choose a run to compare with."
        : runs.length === 1 ? "The store has one run of this pipeline. A comparison needs two." : "";
    }
  }

  /** @param {RunPair} pair */
  metricName({ block }) {
    const chosen = block.metrics.find((m) => m.name === this.state.metric);
    return (chosen ?? block.metrics[block.headline] ?? block.metrics[0])?.name ?? "";
  }

  /** @param {RunPair} pair */
  draw(pair) {
    const { block } = pair, m = block.metrics.findIndex((one) => one.name === this.metricName(pair));
    const [a, b] = block.runs, rows = Array.from({ length: block.points }, (_, i) => i);
    const run = (/** @type {RunInfo} */ r) => `run ${r.number} (${r.time}, magline ${visible(r.version)})`;
    const count = (/** @type {(row: number) => boolean} */ is) => rows.filter(is).length;
    const unequal = m < 0 ? 0 : count((row) => pair.reason(m, row) !== "");
    const parts = [`Scores of ${run(a)} and ${run(b)}: ${block.points} shared points.`];
    if (m >= 0 && block.points) {
      parts.push(`${pair.label(m)}: run ${b.number} is better at ${count((r) => pair.better(m, r) === 1)} and worse ` +
        `at ${count((r) => pair.better(m, r) === 0)} of them.`);
      if (unequal) parts.push(`${unequal} are not on equal rows and are never marked as better.`);
    }
    if (block.omitted.length) parts.push(`Shown are ${block.omitted.join("; ")}.`);
    this.status.textContent = parts.join(" ");
    const name = `${block.pipeline}_${block.table}_runs_${a.number}_${b.number}`;
    const only = block.only.map(({ count: n, points }, side) => n === 0 ? null : element("details", {}, [
      element("summary", {}, [`${n} ${n === 1 ? "point" : "points"} in run ${block.runs[side].number} only`]),
      element("ul", {}, points.map((p) => element("li", {}, [element("bdi", {}, [visible(p) || "the only point"])]))),
      ...(n > points.length ? [element("p", { class: "note" }, [`and ${n - points.length} more`])] : [])]));
    this.panel.replaceChildren(...(m >= 0 && block.points ? [this.table(pair, m, rows), downloads(null, name,
      () => pair.csv())] : []), ...only.filter((part) => part !== null), ...this.changes(pair));
  }

  /** @param {RunPair} pair @param {number} m @param {number[]} rows */
  table(pair, m, rows) {
    const { block } = pair, [a, b] = block.runs;
    const change = (/** @type {number} */ row) => percentChange(pair.value(0, m, row), pair.value(1, m, row));
    const order = this.state.order === "change"
      ? [...rows].sort((i, k) => Math.abs(change(k) ?? -1) - Math.abs(change(i) ?? -1) || i - k) : rows;
    const cell = (/** @type {number} */ side, /** @type {number} */ row, /** @type {boolean} */ best) => {
      const own = block.sides[side], [low, high] = [own.low[m][row], own.high[m][row]];
      const marks = pair.marks(side, m, row), interval = low === null || high === null ? ""
        : ` (${short(low)} to ${short(high)})`;
      return element("td", { class: best ? "n best" : "n", title: `${own.n[m][row]} rows, ${own.lines[m][row]} lines` },
        [(best ? "\u2605 " : "") + short(pair.value(side, m, row)) + interval + (marks ? ` [${marks}]` : "")]);
    };
    const body = order.slice(0, MOST_COMPARED).map((row) => {
      const better = pair.better(m, row), reason = pair.reason(m, row), by = pair.difference(m, row);
      const part = change(row);
      return element("tr", { class: reason ? "unequal" : null }, [
        ...pair.varying.map((x) => element("td", {}, [element("bdi", {}, [pair.texts[x][block.at[x][row]]])])),
        cell(0, row, better === 0), cell(1, row, better === 1),
        element("td", { class: "n" }, [(reason ? "\u2260 " : "") + (by === null ? "-" : short(by))]),
        element("td", { class: "n" }, [part === null ? "-" : `${short(part)} %`]),
        element("td", { class: "paired" }, [pairedWords(pair.paired(m, row))]),
        element("td", {}, [element("bdi", {}, [reason ? visible(reason) : "equal"])])]);
    });
    const head = (/** @type {string} */ text, n = true) =>
      element("th", { scope: "col", class: n ? "n" : null }, [text]);
    const heads = [...pair.varying.map((x) => head(block.axes[x].name, false)), head(`run ${a.number}`),
      head(`run ${b.number}`), head("difference"), head("change"), head("line by line", false),
      head("rows", false)];
    const has = block.sides.some((s) => s.low[m].some((v) => v !== null));
    return element("div", {}, [element("p", { class: "note against-title" },
      [`${pair.label(m)}: ${block.metrics[m].meaning}`]), element("div", { class: "scroll frame-scroll", tabindex: 0,
      role: "region", "aria-label": `Scores of both runs: ${pair.label(m)}` }, [element("table", { class: "against" }, [
      element("thead", {}, [element("tr", {}, heads)]), element("tbody", {}, body)])]),
    element("p", { class: "note" }, ["\u2605 marks the better run. Marked are only values of the same held-out lines " +
      "with the same data and numbers of samples, from the same stage of scores, without flagged lines. \u2260 marks " +
      `values of other rows, whose difference is no improvement or loss. ${PAIRED_NOTE}` +
      (has ? " In parentheses: confidence interval of the stage summary." : "") +
      (order.length > MOST_COMPARED ? ` The first ${MOST_COMPARED} of ${order.length} points are ` +
      "listed; the CSV file has all." : "")])]);
  }

  /** What changed between the runs. @param {RunPair} pair */
  changes({ block }) {
    const [a, b] = block.runs, all = [...block.changes];
    if (a.version !== b.version) {
      all.unshift({ kind: "version", table: "", what: "magline", before: a.version, after: b.version, points: 0 });
    }
    const title = element("h3", {}, ["What changed"]);
    if (!all.length) {
      return [title, element("p", { class: "note" }, ["Program, inputs and parameters of both runs are the same."])];
    }
    const words = { version: "version", input: "input", table: "table", parameter: "parameter" };
    const rows = all.map((c) => element("tr", {}, [
      element("td", {}, [words[/** @type {keyof typeof words} */ (c.kind)] ?? c.kind]),
      ...[c.table, c.what].map((text) => element("td", {}, [element("bdi", {}, [visible(text)])])),
      ...[c.before, c.after].map((text) => element("td", {}, [element("bdi", {}, [text === null ? "absent"
        : visible(text)])])),
      element("td", { class: "n" }, [c.points ? String(c.points) : ""])]));
    const heads = ["kind", "table", "part", `run ${a.number}`, `run ${b.number}`];
    return [title, element("div", { class: "scroll frame-scroll", tabindex: 0, role: "region",
      "aria-label": "What changed" }, [element("table", { class: "changes" }, [element("thead", {}, [
      element("tr", {}, [...heads.map((text) => element("th", { scope: "col" }, [text])),
        element("th", { scope: "col", class: "n" }, ["points"])])]), element("tbody", {}, rows)])])];
  }
}

{
  const home = document.getElementById("against"), text = home?.querySelector("script")?.textContent;
  if (home && text) new AgainstView(home, JSON.parse(text));
}
