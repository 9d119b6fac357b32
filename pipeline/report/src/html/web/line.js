// @ts-check
"use strict";
// The series of one line: choices, columns, panels and track.

const LINE_KEY = ".line";
const MOST_COLUMNS = 24;
/** Number of values of an axis from which a field replaces the list. */
const MOST_CHOICES = 400;

class LineView {
  /** @param {HTMLElement} home @param {ServerSource | EmbeddedSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.state = stateOf(LINE_KEY);
    /** @type {PipelineInfo[]} */
    this.all = [];
    /** @type {LineInfo[]} */
    this.lines = [];
    /** @type {PanelData[] | undefined} Panels of the whole line. */
    this.base = undefined;
    /** @type {TimeRange | undefined} Interval of the series that the panels show. */
    this.loaded = undefined;
    this.status = element("p", { class: "note", role: "status" });
    this.controls = element("div", { class: "controls" });
    this.presets = element("div", { class: "tabs", role: "group", "aria-label": "Panels" });
    this.tools = element("div", { class: "downloads" });
    this.charts = element("div", { class: "line-charts" });
    this.spectra = element("div", { class: "line-spectra", hidden: true });
    this.track = element("div", { class: "track", hidden: true });
    this.columns = new ColumnList(() => this.pick(this.columns.chosen));
    this.side = element("div", { class: "line-side" }, [this.track, this.columns.home]);
    const help = element("p", { class: "note hint" }, ["Drag to zoom, Shift and drag to move, double-click for all. " +
      "Keys: " +
      "arrows read values, + and \u2212 zoom, Page Up and Page Down move, 0 shows all."]);
    home.append(this.controls, this.presets, this.status, element("div", { class: "line-grid" }, [
      element("div", { class: "line-main" }, [this.tools, this.charts, help, this.spectra]), this.side]));
    this.panels = new PanelSet(this.charts, { zoom: (range) => this.zoomed(range),
      hover: (t) => this.trackView.cursor(t) });
    this.trackView = new TrackView(this.track, (t) => this.panels.hover(t));
    this.tracks = new TrackLoader(source, this.trackView);
    this.spectrumView = new SpectrumView(this.spectra, source);
    this.fillTools();
    addEventListener("hashchange", () => { this.state = stateOf(LINE_KEY); this.refresh(); });
    document.addEventListener("magline:place", (event) => this.go(/** @type {CustomEvent} */ (event).detail));
    document.addEventListener("magline:best", () => this.refresh());
    document.addEventListener("magline:changed", () => {
      if (!(source instanceof ServerSource)) return;
      source.forget();
      this.reload();
    });
    this.reload();
  }

  async reload() {
    try {
      this.all = (await this.source.pipelines()).map((p) => ({ ...p,
        tables: p.tables.filter((t) => t.kind === "samples") })).filter((p) => p.tables.length);
      await this.refresh();
    } catch (error) { this.say(error); }
  }

  /** Jumps to a place that another part of the page has chosen. @param {{pipeline?: string, point?: SweepPoint,
   * flight?: string, line?: string, other?: SweepPoint | null, table?: string, focus?: boolean}} to */
  go({ pipeline, point, flight, line, other, table, focus }) {
    const { state } = this;
    if (pipeline && this.all.some((p) => p.name === pipeline)) state.pipeline = pipeline;
    const keep = (/** @type {string} */ mark, /** @type {SweepPoint} */ own) => {
      for (const key of Object.keys(state)) if (key.startsWith(mark)) delete state[key];
      for (const [axis, value] of Object.entries(own)) state[mark + axis] = value;
    };
    if (point) keep("p.", point);
    if (other !== undefined) keep("q.", other ?? {});
    if (flight !== undefined) state.flight = flight;
    if (line !== undefined) state.line = line;
    if (flight !== undefined || line !== undefined) {
      delete state.from;
      delete state.to;
    }
    if (point || flight !== undefined || line !== undefined || other !== undefined) this.base = undefined;
    if (table) this.columns.only(table);
    this.keep();
    this.refresh();
    if (focus) this.home.scrollIntoView({ block: "start" });
  }

  keep() { keepState(LINE_KEY, this.state); }

  /** @returns {PipelineInfo | undefined} */
  pipeline() { return this.all.find((p) => p.name === this.state.pipeline) ?? this.all[0]; }

  /** A point of the state; an axis without a choice takes its first value. @param {string} mark */
  point(mark) {
    const axes = this.pipeline()?.axes ?? [];
    const best = BEST_POINTS.get(this.pipeline()?.name ?? "") ?? {};
    return Object.fromEntries(axes.map(({ name, values }) => {
      const wanted = this.state[mark + name] ?? this.state["p." + name] ?? best[name];
      if (wanted === undefined || values.includes(wanted)) return [name, wanted ?? values[0]];
      return [name, values.find((v) => sameValue(v, wanted)) ?? values[0]];
    }));
  }

  /** The second point, if there is one. */
  second() { return Object.keys(this.state).some((key) => key.startsWith("q.")) ? this.point("q.") : null; }

  /** @param {ColumnChoice} choice */
  info({ table, column }) {
    const found = this.pipeline()?.tables.find((t) => t.name === table), base = column.replace(/\[\d+\]$/, "");
    return found?.columns.find((c) => c.name === column) ?? found?.columns.find((c) => c.name === base);
  }

  /** The chosen columns, or those of the first preset that applies. @returns {ColumnChoice[]} */
  chosen() {
    const tables = this.pipeline()?.tables ?? [], point = this.point("p.");
    if (this.state.cols !== undefined) return columnsFrom(this.state.cols).filter((c) => this.info(c));
    for (const preset of PRESETS) {
      const found = presetColumns(preset, tables, point);
      if (found.length) return found;
    }
    const [first] = tables;
    return (first?.columns.filter((c) => c.series && c.role !== "key").slice(0, 3) ?? [])
      .map((c) => ({ table: first.name, column: c.name }));
  }

  /** @param {ColumnChoice[]} columns */
  pick(columns) {
    this.state.cols = columnsText(columns.slice(0, MOST_COLUMNS));
    this.keep();
    this.refresh();
  }

  /** The table whose lines are listed: that of the first column. */
  table() {
    const tables = this.pipeline()?.tables ?? [], [first] = this.chosen();
    return tables.find((t) => t.name === first?.table) ?? tables[0];
  }

  /** Draws everything anew from the state. */
  async refresh() {
    const pipeline = this.pipeline(), table = this.table(), turn = this.turn = (this.turn ?? 0) + 1;
    if (!pipeline || !table) { this.status.textContent = "No table of this store has series."; return; }
    try {
      const lines = await this.source.lines(table, this.point("p."));
      if (turn !== this.turn) return;
      this.lines = lines;
    } catch (error) {
      this.lines = [];
      this.place = undefined;
      this.fillAll(pipeline);
      this.say(error);
      return;
    }
    const { flight, line } = this.state;
    this.place = this.lines.find((l) => l.line === line && (flight === undefined || l.flight === flight))
      ?? this.lines[0];
    this.fillAll(pipeline);
    await this.load();
  }

  /** @param {PipelineInfo} pipeline */
  fillAll(pipeline) {
    this.fillControls(pipeline);
    this.columns.fill(pipeline.tables, this.chosen());
    this.fillPresets(pipeline);
  }

  /** @param {string} label @param {string} key @param {[string, string][]} choices @param {string} value
   * @param {(value: string) => void} act */
  choice(label, key, choices, value, act) {
    const options = choices.map(([own, text]) => element("option", { value: own, selected: own === value }, [text]));
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      title: choices.find(([own]) => own === value)?.[1] ?? "", onchange: () => act(made.value) }, options));
    return element("label", {}, [element("bdi", {}, [label]), made]);
  }

  /** A field for a value of a long axis. @param {ScoreAxis} axis @param {string} mark @param {string} value
   * @param {(key: string) => (value: string) => void} set */
  typed({ name, values }, mark, value, set) {
    const made = /** @type {HTMLInputElement} */ (element("input", { type: "search", "data-key": mark + name, value,
      onchange: () => {
        const found = values.find((v) => sameValue(v, made.value.trim()));
        if (found !== undefined) set(mark + name)(found);
        else this.status.textContent = `The axis ${visible(name)} has no value ${visible(made.value)}.`;
      } }));
    return element("label", {}, [element("bdi", {}, [mark === "q." ? `${name}, B` : name]), made]);
  }

  /** @param {PipelineInfo} pipeline */
  fillControls(pipeline) {
    const focus = document.activeElement?.getAttribute("data-key"), point = this.point("p."), other = this.second();
    const set = (/** @type {string} */ key) => (/** @type {string} */ value) => {
      this.state[key] = value;
      this.base = undefined;
      this.keep();
      this.refresh();
    };
    const parts = [];
    if (this.all.length > 1) parts.push(this.choice("pipeline", "pipeline",
      this.all.map((p) => [p.name, visible(p.name)]), pipeline.name, (value) => {
        this.state = { pipeline: value };
        this.keep();
        this.refresh();
      }));
    const points = this.source instanceof EmbeddedSource ? this.source.points() : [];
    if (points.length > 1) parts.push(this.choice("point", "point", points.map(({ words }, i) => [String(i), words]),
      String(points.findIndex((p) => Object.entries(p.point).every(([axis, v]) => sameValue(v, point[axis])))),
      (value) => this.go({ point: points[Number(value)].point })));
    else for (const axis of pipeline.axes) {
      if (axis.values.length < 2) continue;
      if (axis.values.length > MOST_CHOICES) {
        parts.push(this.typed(axis, "p.", point[axis.name], set));
        if (other) parts.push(this.typed(axis, "q.", other[axis.name], set));
        continue;
      }
      const texts = shownValues(axis), values = axis.values.map((v, i) => /** @type {[string, string]} */ ([v,
        texts[i].slice(0, 80)]));
      parts.push(this.choice(axis.name, "p." + axis.name, values, point[axis.name], set("p." + axis.name)));
      if (other) parts.push(this.choice(`${axis.name}, B`, "q." + axis.name, values, other[axis.name],
        set("q." + axis.name)));
    }
    // "best point, median line, worst line" becomes "best point, median, worst line", which fits a phone.
    const reasons = (/** @type {string[]} */ why) => why.map((own, i) =>
      why[i + 1]?.endsWith(" line") ? own.replace(/ line$/, "") : own).map(visible).join(", ");
    const name = (/** @type {LineInfo} */ l) => `${visible(l.flight)} / ${visible(l.line)}` +
      (l.why?.length ? ` (${reasons(l.why)})` : "");
    const at = this.place ? this.lines.indexOf(this.place) : -1;
    const to = (/** @type {number} */ i) => {
      const next = this.lines[i];
      if (next) this.go({ flight: next.flight, line: next.line });
    };
    parts.push(this.choice("flight / line", "line", this.lines.map((l, i) => [String(i), name(l)]), String(at),
      (value) => to(Number(value))));
    const step = (/** @type {string} */ text, /** @type {string} */ label, /** @type {number} */ by) =>
      element("button", { type: "button", class: "plain", "aria-label": label, "data-key": "step" + by,
        disabled: !this.lines[at + by], onclick: () => to(at + by) }, [text]);
    parts.push(step("\u2190 line", "Previous line", -1), step("line \u2192", "Next line", 1));
    if (other) parts.push(element("button", { type: "button", class: "plain", onclick: () => this.go({ other: null }) },
      ["Remove B"]));
    this.controls.replaceChildren(...parts);
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
  }

  /** Buttons that add or remove the columns of a preset. @param {PipelineInfo} pipeline */
  fillPresets(pipeline) {
    const chosen = this.chosen(), same = (/** @type {ColumnChoice} */ a, /** @type {ColumnChoice} */ b) =>
      a.table === b.table && a.column === b.column;
    const focus = document.activeElement?.getAttribute("data-preset");
    this.presets.replaceChildren(...PRESETS.flatMap((preset) => {
      const own = presetColumns(preset, pipeline.tables, this.point("p."));
      if (!own.length) return [];
      const on = own.every((c) => chosen.some((k) => same(c, k)));
      return [element("button", { type: "button", "aria-pressed": String(on), "data-preset": preset.name,
        onclick: () => this.pick(on ? chosen.filter((c) => !own.some((k) => same(c, k)))
          : [...own, ...chosen.filter((c) => !own.some((k) => same(c, k)))]) }, [preset.title])];
    }), element("button", { type: "button", "aria-pressed": String(this.state.each === "1"), "data-preset": "each",
      onclick: () => {
        if (this.state.each === "1") delete this.state.each; else this.state.each = "1";
        this.keep();
        this.refresh();
      } }, ["One panel per column"]), element("button", { type: "button", "data-preset": "spectra",
      "aria-pressed": String(this.state.spectra === "1"), onclick: () => {
        if (this.state.spectra === "1") delete this.state.spectra; else this.state.spectra = "1";
        this.keep();
        this.fillPresets(pipeline);
        this.load();
      } }, ["Spectra"]));
    const again = focus && this.presets.querySelector(`[data-preset="${focus}"]`);
    if (again instanceof HTMLElement) again.focus();
  }

  fillTools() {
    const button = (/** @type {string} */ text, /** @type {string} */ label, /** @type {() => void} */ act) =>
      element("button", { type: "button", class: "plain", "aria-label": label, onclick: act }, [text]);
    const { panels } = this, name = () => `${this.place?.flight ?? ""}_${this.place?.line ?? "line"}`;
    const input = (/** @type {string} */ key) => element("input", { type: "number", step: "any", "data-key": key,
      "aria-label": `${key === "from" ? "First" : "Last"} time in sight, s`, onchange: () => {
        const [from, to] = ["from", "to"].map((k) => Number(/** @type {HTMLInputElement} */ (
          this.tools.querySelector(`[data-key="${k}"]`)).value));
        if (to > from) panels.zoom([from, to]);
      } });
    this.links = element("span", { class: "downloads" });
    this.tools.replaceChildren(button("+", "Zoom in", () => panels.scale(0.5)),
      button("\u2212", "Zoom out", () => panels.scale(2)), button("\u2190", "Earlier", () => panels.move(-0.5)),
      button("\u2192", "Later", () => panels.move(0.5)), button("All", "Show all", () => panels.zoom(panels.full)),
      element("label", { class: "inline" }, ["tt from ", input("from")]),
      element("label", { class: "inline" }, ["to ", input("to")]),
      button("CSV", "Download the panels as CSV", () => save(name() + ".csv",
        new Blob([panelsCsv(panels)], { type: "text/csv;charset=utf-8" }))),
      button("SVG", "Download the panels as SVG", () => save(name() + ".svg",
        new Blob([panelsSvg(panels, this.caption()).text], { type: "image/svg+xml" }))),
      button("PNG", "Download the panels as PNG", () => { saveAsPng(panelsSvg(panels, this.caption()), name()); }),
      this.links);
  }

  /** The place in words. */
  caption() {
    const point = (/** @type {SweepPoint} */ p) => Object.entries(p).map(([axis, v]) => `${axis} = ${v}`).join(", ");
    const other = this.second(), { place } = this;
    return [`${this.pipeline()?.name ?? ""}, flight ${place?.flight}, line ${place?.line}`,
      point(this.point("p.")), other ? `B: ${point(other)}` : ""].filter(Boolean).join("; ") + ". " +
      (this.thinned ? "Thinned: the band spans minimum and maximum of each interval; the line is their middle." : "");
  }

  /** @param {TimeRange | null} range */
  zoomed(range) {
    if (range) [this.state.from, this.state.to] = range.map((t) => t.toFixed(3));
    else { delete this.state.from; delete this.state.to; }
    this.trackView.range = range;
    this.trackView.later();
    this.showRange();
    // Until the answer arrives, the series of the whole line fill the parts outside the known interval.
    const [from, to] = this.loaded ?? [0, 0], own = range ?? this.panels.full;
    if (this.source.live && this.base && (own[0] < from || own[1] > to)) {
      this.loaded = this.panels.full;
      this.panels.show(this.base, this.panels.full, own);
    }
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => {
      this.keep();
      if (this.source.live) this.load(); else this.loadSpectra(range, new AbortController().signal);
    }, 150);
  }

  showRange() {
    for (const [k, key] of ["from", "to"].entries()) {
      const input = this.tools.querySelector(`[data-key="${key}"]`);
      if (input instanceof HTMLInputElement && input !== document.activeElement) {
        input.value = this.panels.range[k].toFixed(2);
      }
    }
  }

  /** Asks for the series of a point, one request for each table. @param {ColumnChoice[]} chosen
   * @param {SweepPoint} point @param {TimeRange | null} range @param {AbortSignal} signal */
  async ask(chosen, point, range, signal) {
    const pipeline = this.pipeline(), { place } = this;
    /** @type {Map<string, SeriesAnswer>} */
    const answers = new Map();
    if (!pipeline || !place) return answers;
    const pixels = Math.min(2000, Math.max(800, Math.round(this.charts.clientWidth * devicePixelRatio)));
    await Promise.all(pipeline.tables.map(async (table) => {
      const columns = [...new Set(chosen.filter((c) => c.table === table.name).map((c) => c.column))];
      if (columns.length) answers.set(table.name, await this.source.series({ table, columns, range, pixels, signal,
        place: { pipeline: pipeline.name, point, flight: place.flight, line: place.line } }));
    }));
    return answers;
  }

  /** Spectra of the chosen columns in a range. @param {TimeRange | null} range @param {AbortSignal} signal */
  async loadSpectra(range, signal) {
    const pipeline = this.pipeline(), { place } = this, other = this.second();
    this.spectra.hidden = this.state.spectra !== "1";
    if (!pipeline || !place || this.spectra.hidden) return;
    const points = [this.point("p."), ...(other ? [other] : [])];
    const places = points.map((point) => ({ pipeline: pipeline.name, point, flight: place.flight, line: place.line }));
    await this.spectrumView.load(pipeline, places, this.chosen(), (c) => this.info(c), range, signal);
  }

  async load() {
    if (!this.place) { this.status.textContent = "No line at this point."; return; }
    this.stop?.abort();
    const { signal } = this.stop = new AbortController();
    const range = this.state.from === undefined || this.state.to === undefined ? null
      : /** @type {TimeRange} */ ([Number(this.state.from), Number(this.state.to)]);
    const chosen = this.chosen(), other = this.second();
    try {
      const answers = await this.ask(chosen, this.point("p."), range, signal);
      const others = other ? await this.ask(chosen, other, range, signal) : null;
      if (signal.aborted) return;
      this.draw(chosen, answers, others, range);
      const pipeline = this.pipeline(), { flight, line } = this.place;
      if (!pipeline) return;
      this.loadSpectra(range, signal);
      const place = { pipeline: pipeline.name, point: this.point("p."), flight, line };
      await this.tracks.load(pipeline, place, signal).catch((error) => {
        if (!signal.aborted) this.status.append(` The track cannot be drawn: ${visible(String(error?.message))}`);
      });
    } catch (error) { if (!signal.aborted) this.say(error); }
  }

  /** @param {ColumnChoice[]} chosen @param {Map<string, SeriesAnswer>} answers
   * @param {Map<string, SeriesAnswer> | null} others @param {TimeRange | null} range */
  draw(chosen, answers, others, range) {
    const plans = panelPlans(chosen, (c) => this.info(c), this.state.each === "1");
    const panels = plans.map((plan) => {
      /** @type {PanelSeries[]} */
      const series = [];
      const used = new Set();
      const several = new Set(chosen.map((c) => c.column)).size < chosen.length;
      plan.items.forEach((choice, k) => {
        const info = this.info(choice);
        let { hue, dash } = columnStyle(info, k);
        for (let i = 0; used.has(hue) && i < 8; i++) hue = `--s${i}`;
        used.add(hue);
        const label = several ? `${choice.table}.${choice.column}` : choice.column;
        const [one, two] = [answers, others].map((all) => all?.get(choice.table)?.columns.get(choice.column)?.low);
        const apart = one && two && !sameNumbers(one, two);
        this.add(series, answers.get(choice.table), choice, { label: apart ? label + " (A)" : label, hue, dash }, plan);
        if (!others || !apart) return;
        const second = `--s${(Number(hue.slice(3)) + 2) % 8 || 2}`;
        this.add(series, others.get(choice.table), choice, { label: label + " (B)",
          hue: used.has(second) ? "--s3" : second, dash: [6, 4] }, plan);
      });
      for (const [sigma] of plan.bands) {
        const found = answers.get(sigma.table)?.columns.get(sigma.column), x = answers.get(sigma.table)?.x;
        if (!found || !x) continue;
        const high = (found.high ?? found.low).map((v) => 3 * v);
        series.push({ label: `\u00b13 ${sigma.column}`, hue: "--soft", dash: [], unit: plan.unit, x,
          low: high.map((v) => -v), high, band: true });
      }
      return { key: plan.key, title: plan.title, unit: plan.unit, series };
    }).filter((p) => p.series.length);
    const all = [...answers.values(), ...others?.values() ?? []].filter((a) => a.x.length);
    if (!panels.length || !all.length) {
      this.status.textContent = "Choose a column or a preset.";
      this.panels.show([], [0, 1], [0, 1]);
      return;
    }
    /** @type {TimeRange} */
    const full = [Math.min(...all.map((a) => a.first)), Math.max(...all.map((a) => a.last))];
    this.thinned = all.some((a) => a.thinned);
    this.loaded = range ?? full;
    if (!range) this.base = panels;
    else if (this.base?.map((p) => p.key).join() !== panels.map((p) => p.key).join()) this.base = undefined;
    this.trackView.range = range;
    this.panels.show(panels, full, range ?? full);
    this.showRange();
    this.describe(all, chosen);
  }

  /** @param {PanelSeries[]} series @param {SeriesAnswer | undefined} answer @param {ColumnChoice} choice
   * @param {{label: string, hue: string, dash: number[]}} style @param {PanelPlan} plan */
  add(series, answer, { column }, style, plan) {
    const found = answer?.columns.get(column);
    if (answer && found) series.push({ ...style, label: visible(style.label), unit: plan.unit, x: answer.x,
      low: found.low, high: found.high, band: false });
  }

  /** @param {SeriesAnswer[]} all @param {ColumnChoice[]} chosen */
  describe(all, chosen) {
    const rows = Math.max(...all.map((a) => a.rows)), { place, source } = this;
    const where = `Flight ${visible(place?.flight ?? "")}, line ${visible(place?.line ?? "")}: ${rows} samples. `;
    const how = !this.thinned ? "All samples in sight are drawn."
      : source.live ? "Thinned for the screen: the band spans the minimum and maximum of each interval. " +
        "A series without a band has the first sample of each interval. Zoom in for all samples."
        : "This page holds a thinned series: the band spans the minimum and maximum of each interval.";
    const more = source instanceof EmbeddedSource && source.omitted.length
      ? ` Omitted: ${source.omitted.map(visible).join("; ")}.` : "";
    this.status.textContent = where + how + more;
    if (source instanceof ServerSource && this.links) {
      const tables = [...new Set(chosen.map((c) => c.table))];
      this.links.replaceChildren(...tables.flatMap((name) => {
        const id = this.pipeline()?.tables.find((t) => t.name === name)?.table ?? name;
        return ["csv", "parquet"].map((format) => element("a", { href: source.download(id, format), download: true },
          [`${visible(name)}.${format}`]));
      }));
    }
  }

  /** @param {unknown} error */
  say(error) {
    this.status.textContent = error instanceof Error ? visible(error.message) : "The series cannot be read.";
  }
}

{
  const home = document.getElementById("series"), index = home?.querySelector("script.series-index")?.textContent;
  const name = document.body.dataset.pipeline ?? document.title;
  if (home && SERVER) new LineView(home, SERVER);
  else if (home && index) new LineView(home, new EmbeddedSource(JSON.parse(index), name));
}
