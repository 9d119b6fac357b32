// @ts-check
"use strict";
// Comparison of two pipelines: differences of the metrics that both have, and what differs in their parameters.

const PIPELINES_KEY = ".pipelines";
/** Scores of each table of the page, as PIPELINE.TABLE. @type {Map<string, ScoreBlock>} */
const SCORE_BLOCKS = new Map();

class PipelinesView {
  /** @param {HTMLElement} home @param {string[]} tables Tables of scores, as PIPELINE.TABLE. */
  constructor(home, tables) {
    this.home = home;
    this.tables = tables;
    this.state = stateOf(PIPELINES_KEY);
    this.controls = element("div", { class: "controls" });
    this.status = element("p", { class: "note", role: "status" });
    this.panel = element("div");
    this.changes = element("div");
    home.append(this.controls, this.status, this.panel);
    addEventListener("hashchange", () => { this.state = stateOf(PIPELINES_KEY); this.refresh(); });
    for (const event of ["magline:scores", "magline:changed"]) document.addEventListener(event, () => this.refresh());
    this.refresh();
  }

  /** @param {string} key @param {string} value */
  set(key, value) {
    if (value) this.state[key] = value; else delete this.state[key];
    keepState(PIPELINES_KEY, this.state);
    this.refresh();
  }

  /** Both tables: the chosen ones, else the first table and the first table of another pipeline. */
  chosen() {
    const { state, tables } = this, of = (/** @type {string} */ name) => name.slice(0, name.indexOf("."));
    const a = tables.includes(state.a ?? "") ? state.a : tables[0];
    const others = tables.filter((t) => t !== a), b = others.includes(state.b ?? "") ? state.b
      : others.find((t) => of(t) !== of(a)) ?? others[0];
    return [a, b];
  }

  /** Wanted values of the axes that only one table has. @param {string} side @returns {SweepPoint} */
  fixed(side) {
    const start = side + ".";
    return Object.fromEntries(Object.entries(this.state).filter(([key]) => key.startsWith(start))
      .map(([key, value]) => [key.slice(start.length), value]));
  }

  async refresh() {
    const turn = this.turn = (this.turn ?? 0) + 1, [a, b] = this.chosen();
    const [one, two] = [SCORE_BLOCKS.get(a), SCORE_BLOCKS.get(b)];
    if (!one || !two) { this.status.textContent = "The scores of both pipelines are loading."; return; }
    const pair = new PipelinePair([one, two], [this.fixed("a"), this.fixed("b")]);
    this.fill([a, b], pair);
    try {
      const ask = (/** @type {string} */ pipeline) =>
        SERVER?.json(SERVER.address(SERVER.base + "parameters", { pipeline }));
      const [own, other] = await Promise.all([one, two].map((block) => ask(block.pipeline)));
      if (turn === this.turn) this.changes.replaceChildren(...changeTable(pipelineChanges(own, other)));
    } catch (error) {
      if (turn === this.turn) this.status.textContent = error instanceof Error ? visible(error.message)
        : "The parameters cannot be read.";
    }
  }

  /** @param {string} label @param {string} key @param {[string, string][]} choices @param {string} value */
  choice(label, key, choices, value) {
    const options = choices.map(([own, text]) => element("option", { value: own, selected: own === value }, [text]));
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      onchange: () => this.set(key, made.value) }, options));
    return element("label", {}, [element("bdi", {}, [label]), made]);
  }

  /** @param {string[]} chosen @param {PipelinePair} pair */
  fill([a, b], pair) {
    const focus = this.controls.contains(document.activeElement)
      ? document.activeElement?.getAttribute("data-key") : null;
    const named = (/** @type {string[]} */ list) => list.map((t) => /** @type {[string, string]} */ ([t, visible(t)]));
    const metrics = pair.metrics.map(([i], m) => /** @type {[string, string]} */ (
      [pair.sets[0].block.metrics[i].name, pair.label(m)]));
    const parts = [this.choice("A", "a", named(this.tables), a),
      this.choice("B", "b", named(this.tables.filter((t) => t !== a)), b)];
    const m = this.metric(pair);
    if (metrics.length) parts.push(this.choice("metric", "metric", metrics, metrics[m]?.[0] ?? ""), this.choice("order",
      "order", [["", "as in the sweep"], ["change", "largest change first"]], this.state.order ?? ""));
    for (const side of [0, 1]) for (const [i, at] of pair.fixed[side]) {
      const { block, texts } = pair.sets[side], { name, values } = block.axes[i], mark = "ab"[side];
      if (values.length < 2) continue;
      parts.push(this.choice(`${name}, only ${mark.toUpperCase()}`, `${mark}.${name}`,
        values.slice(0, MOST_CHOICES).map((value, k) => [value, texts[i][k].slice(0, 80)]), values[at]));
    }
    this.controls.replaceChildren(...parts);
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
    this.changes = element("div");
    this.status.textContent = this.words(pair, m);
    const [one, two] = pair.sets.map(({ block }) => block);
    const name = `${one.pipeline}_${one.table}_${two.pipeline}_${two.table}`;
    const shown = m >= 0 && pair.points.length ? [this.table(pair, m), downloads(null, name, () => pair.csv())] : [];
    this.panel.replaceChildren(...shown, this.changes);
  }

  /** Position of the chosen metric among those that both have. @param {PipelinePair} pair */
  metric(pair) {
    const { metrics, headline } = pair.sets[0].block;
    const at = pair.metrics.findIndex(([i]) => metrics[i].name === this.state.metric);
    return at >= 0 || !pair.metrics.length ? at : Math.max(0, pair.metrics.findIndex(([i]) => i === headline));
  }

  /** @param {PipelinePair} pair @param {number} m */
  words(pair, m) {
    const { points, axes, metrics, sets } = pair, names = axes.map(([i]) => visible(sets[0].block.axes[i].name));
    const many = (/** @type {number} */ n, /** @type {string} */ what) => `${n} shared ${what}${n === 1 ? "" : "s"}`;
    const parts = [`${many(points.length, "point")} and ${many(metrics.length, "metric")}. ` +
      (names.length ? `Shared axes: ${names.join(", ")}.` : "No axis is shared.")];
    for (const side of [0, 1]) {
      const fixed = pair.fixedWords(side);
      if (fixed) parts.push(`Only ${"AB"[side]} has ${visible(fixed)}.`);
    }
    if (m >= 0 && points.length) {
      const better = points.map((point) => pair.better(m, point)), unequal = points.filter((p) => pair.reason(m, p));
      parts.push(`${pair.label(m)}: B is better at ${better.filter((side) => side === 1).length} and worse at ` +
        `${better.filter((side) => side === 0).length} of them.`);
      if (unequal.length) parts.push(`${unequal.length} are not on the same lines and are never marked as better.`);
    }
    return parts.join(" ");
  }

  /** @param {PipelinePair} pair @param {number} m */
  table(pair, m) {
    const { sets, varying } = pair;
    const change = (/** @type {SharedPoint} */ point) => percentChange(...pair.values(m, point));
    const order = this.state.order === "change" ? [...pair.points]
      .sort((one, two) => Math.abs(change(two) ?? -1) - Math.abs(change(one) ?? -1)) : pair.points;
    const body = order.slice(0, MOST_COMPARED).map((point) => {
      const better = pair.better(m, point), reason = pair.reason(m, point), by = pair.difference(m, point);
      const part = change(point), cells = pair.values(m, point).map((value, side) => {
        const marks = pair.marks(side, m, point);
        return element("td", { class: better === side ? "n best" : "n" },
          [(better === side ? "\u2605 " : "") + short(value) + (marks ? ` [${marks}]` : "")]);
      });
      return element("tr", { class: reason ? "unequal" : null }, [
        ...varying.map((axis) => element("td", {}, [element("bdi", {}, [pair.text(axis, point)])])), ...cells,
        element("td", { class: "n" }, [(reason ? "\u2260 " : "") + (by === null ? "-" : short(by))]),
        element("td", { class: "n" }, [part === null ? "-" : `${short(part)} %`]),
        element("td", { class: "paired" }, [pairedWords(pair.paired(m, point))]),
        element("td", {}, [reason || "equal"])]);
    });
    const head = (/** @type {string} */ text, n = true) => element("th", { scope: "col", class: n ? "n" : null },
      [element("bdi", {}, [text])]);
    const heads = [...varying.map(([i]) => head(visible(sets[0].block.axes[i].name), false)),
      ...sets.map(({ block }, side) => head(`${"AB"[side]}: ${visible(block.pipeline)}`)), head("B \u2212 A"),
      head("change"), head("line by line", false), head("lines", false)];
    const rest = order.length > MOST_COMPARED
      ? ` The first ${MOST_COMPARED} of ${order.length} points are listed; the CSV file has all.` : "";
    const label = pair.label(m), { meaning } = sets[0].block.metrics[pair.metrics[m][0]];
    return element("div", {}, [element("p", { class: "note" }, [`${label}: ${meaning}`]), element("div",
      { class: "scroll frame-scroll", tabindex: 0, role: "region", "aria-label": `Scores of both pipelines: ${label}` },
      [element("table", { class: "against" }, [element("thead", {}, [element("tr", {}, heads)]),
        element("tbody", {}, body)])]), element("p", { class: "note" }, ["\u2605 marks the better pipeline. Only " +
      "values of the same held-out lines without flagged lines are marked. Lines are matched by the names of flight " +
      `and line. ${PAIRED_NOTE}${rest}`])]);
  }
}

/** Table of the differences of two pipelines. @param {PipelineChange[]} all */
function changeTable(all) {
  const title = element("h3", {}, ["What differs"]);
  if (!all.length) {
    return [title, element("p", { class: "note" }, ["Sources, stages and parameters of both pipelines are the same."])];
  }
  const text = (/** @type {string | null} */ value) => element("td", {}, [element("bdi", {}, [value === null ? "absent"
    : visible(value)])]);
  const rows = all.map((c) => element("tr", {}, [element("td", {}, [c.kind]), text(c.table), text(c.what), text(c.a),
    text(c.b)]));
  const heads = ["kind", "table", "part", "A", "B"].map((name) => element("th", { scope: "col" }, [name]));
  return [title, element("div", { class: "scroll frame-scroll", tabindex: 0, role: "region",
    "aria-label": "What differs" }, [element("table", { class: "changes" }, [element("thead", {}, [element("tr", {},
    heads)]), element("tbody", {}, rows)])])];
}
