// @ts-check
"use strict";
// The explorer of each score table: controls, table, and the state in the hash of the address.

const VIEWS = { table: "Table", pivot: "Pivot", heat: "Heat map", curve: "Curve", parallel: "Parallel",
  scatter: "Scatter", lines: "Lines", compare: "Compare" };
/** Best point of each pipeline by the metric that ranks the points. @type {Map<string, SweepPoint>} */
const BEST_POINTS = new Map();
const ROW_PX = 30, MANY = 60, NARROW_TABLE_PX = 640, MOST_PRINTED = 2000;
/** Number of explorers on the page. */
let explorers = 0;

/** State of one table in the hash. @param {string} table @returns {ExplorerState} */
function stateOf(table) {
  /** @type {ExplorerState} */
  const state = {};
  for (const [key, value] of new URLSearchParams(location.hash.slice(1))) {
    if (key.startsWith(table + ":")) state[key.slice(table.length + 1)] = value;
  }
  return state;
}

/** @param {string} table @param {ExplorerState} state */
function keepState(table, state) {
  const all = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  for (const key of [...all.keys()]) if (key.startsWith(table + ":")) all.delete(key);
  for (const [key, value] of Object.entries(state)) all.set(`${table}:${key}`, value);
  history.replaceState(null, "", "#" + all);
}

class Explorer {
  /** @param {HTMLElement} home @param {ScoreBlock} block */
  constructor(home, block) {
    this.home = home;
    this.scores = new ScoreSet(block);
    /** Prefix of the keys of the state. */
    this.key = home.dataset.table ?? block.table;
    this.state = stateOf(this.key);
    this.panel = element("div", { class: "view", role: "tabpanel", id: `explorer-view-${explorers++}` });
    this.count = element("p", { class: "note", role: "status" });
    this.controls = element("div", { class: "controls" });
    this.tabs = element("div", { class: "tabs", role: "tablist", "aria-label": "View" });
    home.append(this.tabs, this.controls, this.count, this.panel);
    addEventListener("hashchange", () => { this.state = stateOf(this.key); this.fill(); });
    this.printed = false;
    document.addEventListener("magline:print", (event) => {
      this.printed = event instanceof CustomEvent && event.detail;
      this.draw();
    });
    let wide = 0;
    new ResizeObserver(() => {
      if (Math.abs(home.clientWidth - wide) > 2) { wide = home.clientWidth; this.draw(); }
    }).observe(home);
    this.fill();
    this.announce();
  }

  /** Takes newer scores. @param {ScoreBlock} block */
  update(block) {
    this.scores = new ScoreSet(block);
    this.fill();
    this.announce();
  }

  /** Axis values of a row. @param {number} row @returns {SweepPoint} */
  place(row) {
    const { axes } = this.scores.block;
    return Object.fromEntries(axes.map((axis, a) => [axis.name, this.scores.word(a, row)]));
  }

  /** Publishes the best point for the line view. */
  announce() {
    const { pipeline, headline, points } = this.scores.block;
    const row = this.scores.best(headline ?? 0, Array.from({ length: points }, (_, i) => i));
    if (row < 0 || BEST_POINTS.has(pipeline)) return;
    BEST_POINTS.set(pipeline, this.place(row));
    document.dispatchEvent(new CustomEvent("magline:best"));
  }

  /** Chooses a point, or the second point of a comparison. @param {number} row @param {boolean} [second] */
  choose(row, second = false) {
    const { state } = this, text = String(row), key = second && state.point !== undefined ? "other" : "point";
    const chosen = state[key] === text || (key === "other" && state.point === text) ? undefined : text;
    if (key === "point" && (chosen === undefined || chosen === state.other)) delete state.other;
    if (key === "other" && chosen !== undefined) state.view = "compare";
    this.set(key, chosen);
    this.show({});
  }

  /** Shows the chosen points in the line view. @param {{flight?: string, line?: string, focus?: boolean}} more */
  show(more) {
    const { point, other } = this.state, { block } = this.scores;
    const row = point !== undefined && Number(point) < block.points ? Number(point)
      : this.scores.best(Math.max(0, this.scores.metric(this.full().metric)), this.scores.rows(this.full()));
    if (row < 0) return;
    document.dispatchEvent(new CustomEvent("magline:place", { detail: { ...more, pipeline: block.pipeline,
      point: this.place(row), other: other === undefined ? null : this.place(Number(other)) } }));
  }

  /** Adds the defaults of the keys that are not set. @returns {ExplorerState} */
  full() {
    const { metrics, headline, axes } = this.scores.block, { varying } = this.scores;
    const names = varying.map((a) => axes[a].name);
    const numeric = varying.find((a) => axes[a].numeric && axes[a].values.length > 2);
    const first = metrics[headline ?? 0]?.name ?? "";
    const x = numeric === undefined ? names[0] : axes[numeric].name;
    const other = metrics.find((m) => m.name !== first);
    return { view: varying.length ? "table" : "lines", metric: first, x: x ?? "",
      y: names.find((n) => n !== x) ?? "", against: other?.name ?? "", ...this.state };
  }

  /** @param {string} key @param {string | undefined} value */
  set(key, value) {
    if (value === undefined || value === "") delete this.state[key]; else this.state[key] = value;
    keepState(this.key, this.state);
    this.draw();
  }

  /** @param {string} label @param {string} key @param {[string, string][]} choices */
  select(label, key, choices) {
    const chosen = this.full()[key] ?? "";
    const options = choices.map(([value, text]) => element("option", { value, selected: value === chosen }, [text]));
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      onchange: () => this.set(key, made.value) }, options));
    return element("label", {}, [element("bdi", {}, [label]), made]);
  }

  /** Tabs and controls. */
  fill() {
    const { scores } = this, { metrics, axes } = scores.block;
    const focus = document.activeElement?.getAttribute("data-key");
    this.tabs.replaceChildren(...Object.entries(VIEWS).map(([key, text]) => element("button", { type: "button",
      role: "tab", "data-view": key, "aria-controls": this.panel.id, onclick: () => this.set("view", key),
      onkeydown: (/** @type {KeyboardEvent} */ event) => this.step(event, key) }, [text])));
    const named = metrics.map((m, i) => /** @type {[string, string]} */ ([m.name, scores.label(i)]));
    const places = scores.varying.map((a) => /** @type {[string, string]} */ ([axes[a].name, axes[a].name]));
    const only = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", "data-key": "sound",
      checked: Boolean(this.state.sound), onchange: () => this.set("sound", only.checked ? "1" : undefined) }));
    const parts = [this.select("metric", "metric", named)];
    const more = [this.select("across", "x", places), this.select("down or lines", "y", places),
      this.select("against", "against", named)];
    const shown = [["pivot", "heat", "curve"], ["pivot", "heat", "curve"], ["scatter"]];
    more.forEach((part, i) => { part.dataset.views = shown[i].join(" "); });
    for (const a of scores.varying) parts.push(this.filter(a));
    this.controls.replaceChildren(...parts, ...more, element("label", { class: "check" },
      [only, "only held out and not flagged"]), element("button", { type: "button", class: "plain",
      onclick: () => { this.state = {}; keepState(this.key, {}); this.fill(); } }, ["Reset"]),
      ...(document.getElementById("series") ? [element("button", { type: "button", class: "plain", "data-key": "series",
        onclick: () => this.show({ focus: true }) }, ["Show series"])] : []));
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
    this.draw();
  }

  /** Choice of one value; of a long axis, a text or a range. @param {number} a */
  filter(a) {
    const axis = this.scores.block.axes[a];
    if (axis.values.length <= MANY) {
      const values = this.scores.order[a].map((i) => /** @type {[string, string]} */ ([axis.values[i],
        this.scores.texts[a][i].slice(0, 80)]));
      return this.select(axis.name, "is." + axis.name, [["", "all"], ...values]);
    }
    const input = /** @type {HTMLInputElement} */ (element("input", { type: "search", "data-key": "has." + axis.name,
      value: this.state["has." + axis.name] ?? "", placeholder: axis.numeric ? "0.1..2" : "contains",
      oninput: () => this.set("has." + axis.name, input.value) }));
    return element("label", {}, [element("bdi", {}, [axis.name]), input]);
  }

  /** @param {KeyboardEvent} event @param {string} key */
  step(event, key) {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key], keys = Object.keys(VIEWS);
    if (by === undefined) return;
    const next = keys[(keys.indexOf(key) + by + keys.length) % keys.length];
    this.set("view", next);
    const tab = this.tabs.querySelector(`[data-view="${next}"]`);
    if (tab instanceof HTMLElement) tab.focus();
  }

  draw() {
    const state = this.full(), { scores } = this, { block } = scores;
    const rows = scores.rows(state), metric = Math.max(0, scores.metric(state.metric));
    for (const tab of this.tabs.children) {
      const on = tab.getAttribute("data-view") === state.view;
      tab.setAttribute("aria-selected", String(on));
      tab.setAttribute("tabindex", on ? "0" : "-1");
    }
    for (const part of this.controls.children) {
      if (part instanceof HTMLElement && part.dataset.views) {
        part.hidden = !part.dataset.views.split(" ").includes(state.view);
      }
    }
    const same = block.axes.filter((axis) => axis.values.length === 1)
      .map((axis) => `${axis.name} = ${visible(axis.values[0])}`);
    const point = Number(state.point);
    const second = state.other === undefined ? "" : ` B: ${scores.point(Number(state.other))}. `;
    const chosen = state.point !== undefined && point < block.points ? `Chosen: ${scores.point(point)}. ${second}` : "";
    this.count.textContent = `${rows.length} of ${block.points} points, ${block.over}. ${chosen}` +
      (same.length ? `Everywhere: ${same.join(", ")}. ` : "") +
      (block.omitted.length ? `Omitted to limit the page's size; this page has ${block.omitted.join("; ")}.` : "");
    const name = `${block.pipeline}_${block.table}_${state.view}`;
    if (state.view === "table") { this.table(rows, metric, name); return; }
    const views = { heat: heatView, curve: curveView, parallel: parallelView, scatter: scatterView, lines: linesView,
      compare: compareView };
    const make = views[/** @type {keyof typeof views} */ (state.view)] ?? linesView;
    const width = Math.max(300, this.home.clientWidth - 30);
    /** @type {ViewInput} */
    const input = { scores, state, rows, metric, width, choose: (row, two) => this.choose(row, two),
      openLine: (flight, line) => this.show({ flight, line, focus: true }) };
    if (state.view === "pivot") { this.panel.replaceChildren(...pivotView(input, name)); return; }
    const made = make(input);
    if (typeof made === "string") { this.panel.replaceChildren(element("p", { class: "note" }, [made])); return; }
    this.panel.replaceChildren(element("figure", { class: "live" }, [made.svg, made.read,
      element("figcaption", {}, [made.caption]), ...(made.more ? [made.more] : []),
      downloads(made.svg, name, () => made.csv)]));
  }

  /**
   * The table; only the rows in sight are in the page.
   * @param {number[]} rows @param {number} metric @param {string} name
   */
  table(rows, metric, name) {
    const { scores, state } = this, { block } = scores;
    const sort = state.sort ?? block.metrics[metric].name, down = state.down === "1";
    const m = scores.metric(sort), a = scores.axis(sort);
    const rank = new Map((scores.order[a] ?? []).map((code, i) => [code, i]));
    const key = a >= 0 ? rows.map((r) => rank.get(block.at[a][r]) ?? 0)
      : rows.map((r) => state.sort === undefined ? scores.cost(m, scores.value(m, r)) : scores.value(m, r) ?? Infinity);
    const place = rows.map((_, i) => i).sort((i, k) => {
      if (!Number.isFinite(key[i]) || !Number.isFinite(key[k])) {
        return Number(!Number.isFinite(key[i])) - Number(!Number.isFinite(key[k])) || i - k;
      }
      return (down ? key[k] - key[i] : key[i] - key[k]) || i - k;
    });
    const sorted = place.map((i) => rows[i]);
    const best = block.metrics.map((_, i) => {
      const row = scores.best(i, rows);
      return row >= 0 && rows.length > 1 && !scores.excluded(i, row) ? row : -1;
    });
    /** @param {string} text @param {string} by @param {string} [title] */
    const head = (text, by, title) => element("th", { scope: "col",
      "aria-sort": by === sort ? (down ? "descending" : "ascending") : null }, [element("button", { type: "button",
      title: title ?? null, "data-sort": by, onclick: () => {
        this.state.down = by === sort && !down ? "1" : "0";
        this.set("sort", by);
        const again = this.panel.querySelector(`[data-sort="${CSS.escape(by)}"]`);
        if (again instanceof HTMLElement) again.focus();
      } }, [text])]);
    const order = this.columns(metric);
    const heads = [element("th", { scope: "col" }, ["point"]), ...order.map(([kind, i]) => kind === "axis"
      ? head(block.axes[i].name, block.axes[i].name) : head(scores.label(i), block.metrics[i].name,
        block.metrics[i].meaning))];
    const body = element("tbody");
    const table = element("table", { class: "virtual", "aria-rowcount": rows.length + 1,
      "aria-label": `Scores: ${block.table}` }, [element("thead", {}, [element("tr", {}, heads)]), body]);
    const frame = element("div", { class: "frame-scroll", tabindex: 0, role: "region",
      "aria-label": `Table of scores: ${block.table}` }, [table]);
    let first = -1;
    const show = () => {
      const from = this.printed ? 0 : Math.max(0, Math.floor(frame.scrollTop / ROW_PX) - 10);
      if (from === first) return;
      first = from;
      const count = this.printed ? MOST_PRINTED : 40 + Math.ceil(frame.clientHeight / ROW_PX);
      const some = sorted.slice(from, from + count);
      const gap = (/** @type {number} */ n) => n <= 0 ? [] : [element("tr", { "aria-hidden": "true", class: "gap" },
        [element("td", { colspan: heads.length, style: `height:${n * ROW_PX}px` })])];
      body.replaceChildren(...gap(from), ...some.map((row, i) => this.row(row, from + i, best, order)),
        ...gap(this.printed ? 0 : sorted.length - from - some.length));
    };
    let asked = false;
    frame.addEventListener("scroll", () => {
      if (!asked) requestAnimationFrame(() => { asked = false; show(); });
      asked = true;
    });
    frame.style.maxHeight = "460px";
    const bar = downloads(null, name, () => scores.csv(sorted));
    if (this.home.dataset.src) bar.append(...["csv", "parquet"].map((format) => element("a", { download: true,
      href: "download?" + new URLSearchParams({ table: this.key, format }) }, [`${visible(block.table)}.${format}`])));
    const rest = this.printed && sorted.length > MOST_PRINTED ? [element("p", { class: "note" },
      [`The first ${MOST_PRINTED} of ${sorted.length} points in this order. The CSV file has all.`])] : [];
    this.panel.replaceChildren(frame, ...rest, bar);
    show();
  }

  /** Columns of the table: axes and metrics; on a narrow page, first the chosen metric. @param {number} metric
   * @returns {["axis" | "metric", number][]} */
  columns(metric) {
    const { scores, home } = this, narrow = home.clientWidth > 0 && home.clientWidth < NARROW_TABLE_PX;
    const axes = scores.varying.map((a) => /** @type {["axis", number]} */ (["axis", a]));
    const metrics = scores.block.metrics.map((_, m) => /** @type {["metric", number]} */ (["metric", m]));
    return narrow ? [metrics[metric], ...axes, ...metrics.filter(([, m]) => m !== metric)] : [...axes, ...metrics];
  }

  /** @param {number} row @param {number} at @param {number[]} best @param {["axis" | "metric", number][]} order */
  row(row, at, best, order) {
    const { scores } = this, { block } = scores;
    const marked = block.flagged[row] > 0, chosen = this.state.point === String(row);
    const choose = element("button", { type: "button", "aria-pressed": String(chosen),
      title: "Choose this point; with Shift, the second point of a comparison",
      onclick: (/** @type {MouseEvent} */ event) => this.choose(row, event.shiftKey) },
    [`${marked ? "! " : ""}${row + 1}`]);
    const second = this.state.point !== undefined && !chosen ? [element("button", { type: "button", class: "second",
      "aria-pressed": String(this.state.other === String(row)), "aria-label": `Compare with point ${row + 1}`,
      title: "Compare the chosen point with this point", onclick: () => this.choose(row, true) }, ["B"])] : [];
    return element("tr", { "aria-rowindex": at + 2, class: marked ? "bad" : null }, [
      element("td", {}, [choose, ...second]), ...order.map(([kind, i]) => kind === "axis"
        ? element("td", { title: visible(scores.word(i, row)) }, [element("bdi", {}, [scores.text(i, row)])])
        : this.cell(i, row, best[i] === row))]);
  }

  /** A score in the table. @param {number} m @param {number} row @param {boolean} best */
  cell(m, row, best) {
    const { scores } = this, value = scores.value(m, row), marks = scores.marks(m, row);
    const text = short(value) + (scores.inSample[m].has(row) ? " ~" : "");
    return element("td", { class: best ? "n best" : "n", title: marks || null, "data-v": value }, [text]);
  }
}

/**
 * Buttons that save a figure.
 * @param {SVGSVGElement | null} svg @param {string} name @param {(() => string) | null} csv
 */
function downloads(svg, name, csv) {
  const button = (/** @type {string} */ text, /** @type {() => void} */ act) => element("button", { type: "button",
    class: "plain", onclick: act, "aria-label": `Download as ${text}` }, [text]);
  const out = [];
  if (csv) out.push(button("CSV", () => save(name + ".csv", new Blob([csv()], { type: "text/csv;charset=utf-8" }))));
  if (svg) out.push(button("SVG", () => saveSvg(svg, name)), button("PNG", () => { savePng(svg, name); }));
  return element("p", { class: "downloads" }, out);
}

/** Reads the scores of a section from the server. @param {HTMLElement} home @param {string} address */
async function fetchedExplorer(home, address) {
  const note = element("p", { class: "note", role: "status" }, ["Scores are read."]);
  home.append(note);
  /** @type {Explorer | undefined} */
  let made;
  const read = async () => {
    try {
      const answer = await fetch(address), found = await answer.json();
      if (!answer.ok) throw new Error(found.error);
      note.remove();
      if (made) made.update(found); else made = new Explorer(home, found);
      SCORE_BLOCKS.set(home.dataset.table ?? "", found);
      document.dispatchEvent(new CustomEvent("magline:scores"));
    } catch (error) {
      home.append(note);
      note.textContent = error instanceof Error ? visible(error.message) : "The scores cannot be read.";
    }
  };
  document.addEventListener("magline:changed", read);
  await read();
}

for (const home of document.querySelectorAll("section.explorer")) {
  const text = home.querySelector("script")?.textContent;
  if (!(home instanceof HTMLElement)) continue;
  if (text) new Explorer(home, JSON.parse(text)); else if (home.dataset.src) fetchedExplorer(home, home.dataset.src);
}
