// @ts-check
"use strict";
// Models of a view: the losses of their training, and the importance of their inputs.

/**
 * @typedef {{training: [number, number][], validation: [number, number][]}} LossCurve Epoch and loss.
 * @typedef {{name: string, lines: [string, string, number][]}} ImportanceGroup
 * @typedef {{method: string, unit: string, groups: ImportanceGroup[]}} ImportanceAnswer
 */

const MODELS_KEY = ".models", MOST_GROUPS = 20;

/** Whether a table has the importance of inputs. @param {TableInfo} table */
function isImportance(table) {
  return ["group", "value", "method", "unit", "flight", "line"].every((name) =>
    table.columns.some((c) => c.name === name));
}

/** The losses by epoch. @param {LossCurve} curve @param {number} width @returns {PlotView | string} */
function lossView({ training, validation }, width) {
  if (training.length < 2) return "This model has no losses of epochs. It was fitted in one step.";
  const height = 280, kinds = /** @type {const} */ ([["training", training, "s0"], ["validation", validation, "s1"]]);
  const all = [...training, ...validation];
  const x = new PlotScale(all.map(([epoch]) => epoch), 64, width - 16);
  const y = new PlotScale(all.map(([, loss]) => loss), height - 46, 12);
  const least = validation.reduce((a, b) => b[1] < a[1] ? b : a, validation[0] ?? [NaN, NaN]);
  /** @type {PlotTarget[]} */
  const targets = kinds.flatMap(([name, points]) => points.map(([epoch, loss]) => ({ x: x.at(epoch), y: y.at(loss),
    row: -1, text: `epoch ${epoch}: ${name} loss ${short(loss)}` }))).sort((a, b) => a.x - b.x);
  const { svg, read } = livePlot({ label: "Loss by epoch", width, height, targets, choose: () => {} });
  svg.append(plotFrame(x, y, "epoch", "loss"));
  for (const [name, points, hue] of kinds) {
    const path = points.map(([epoch, loss], i) => `${i ? "L" : "M"}${x.at(epoch).toFixed(1)} ${y.at(loss).toFixed(1)}`);
    svg.append(shape("path", { class: "loss " + hue, "data-curve": name, d: path.join(""), fill: "none",
      style: `stroke:var(--${hue})`, "stroke-width": 2, "stroke-dasharray": name === "training" ? "none" : "6 4" }));
  }
  const csv = [csvRow(["epoch", "training", "validation"]), ...training.map(([epoch, loss]) => csvRow([epoch, loss,
    validation.find(([own]) => own === epoch)?.[1] ?? null]))].join("\n") + "\n";
  return { svg, read, csv, caption: "Loss of each epoch, divided by the square of the target's scale. Solid: " +
    "training; dashed: validation. " + (validation.length ? `The lowest validation loss is ${short(least[1])}, in ` +
      `epoch ${least[0]}. ` : "No lines were held out for validation. ") +
    "A validation loss that rises while the training loss falls indicates overfitting." };
}

/** Mean of absolute values. @param {ImportanceGroup} group */
function meanImportance({ lines }) {
  return lines.reduce((sum, [, , value]) => sum + value, 0) / Math.max(1, lines.length);
}

/** Bars of the means, and a dot for each line. @param {ImportanceAnswer} answer @param {number} width
 * @returns {PlotView | string} */
function importanceView({ method, unit, groups }, width) {
  const sorted = [...groups].sort((a, b) => meanImportance(b) - meanImportance(a) || (a.name < b.name ? -1 : 1));
  const shown = sorted.slice(0, MOST_GROUPS), row = 22, height = row * shown.length + 34;
  if (!shown.length) return "This table has no importance at this point.";
  const left = Math.min(210, width * 0.42), right = 74;
  const most = Math.max(...shown.flatMap((g) => g.lines.map(([, , value]) => value)), Number.MIN_VALUE);
  const x = (/** @type {number} */ v) => left + (width - left - right) * v / most;
  const words = unit === "1" || !unit ? "" : ` ${unit}`, drawn = shape("g");
  const targets = shown.flatMap((group, i) => {
    const y = row * (i + 0.5) + 4, mean = meanImportance(group), name = visible(group.name);
    drawn.append(shape("text", { class: "name", x: left - 8, y: y + 4, "text-anchor": "end" },
      [cut(name, Math.floor((left - 10) / 6.5))]), shape("rect", { class: "change", x: left, y: y - 7, height: 14,
      width: Math.max(1, x(mean) - left) }), ...group.lines.map(([, , value]) => shape("circle", { class: "point",
      cx: x(value), cy: y, r: 2.4 })), shape("text", { x: width - right + 8, y: y + 4 }, [short(mean)]));
    return [{ x: x(mean), y, row: -1, text: `${name}: mean ${short(mean)}${words}, ${group.lines.length} lines` },
      ...group.lines.map(([flight, line, value]) => ({ x: x(value), y, row: -1,
        text: `${name}: ${short(value)}${words}, flight ${visible(flight)}, line ${visible(line)}` }))];
  });
  const { svg, read } = livePlot({ label: "Importance of the inputs", width, height, targets, choose: () => {} });
  svg.append(drawn);
  const rest = groups.length - shown.length;
  const csv = [csvRow(["group", "flight", "line", "importance", "unit"]), ...sorted.flatMap((g) => g.lines.map(
    ([flight, line, value]) => csvRow([g.name, flight, line, value, unit])))].join("\n") + "\n";
  return { svg, read, csv, caption: `Importance of the inputs, ${visible(method.replaceAll("_", " "))}` +
    `${words && `,${words}`}. Each bar is the mean of the absolute values over the lines. Each dot is one line. ` +
    "Correlated inputs share or mask importance." + (rest > 0
      ? ` ${rest} less important groups are in the CSV file only.` : "") };
}

class ModelView {
  /** @param {HTMLElement} home @param {ServerSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.state = stateOf(MODELS_KEY);
    /** @type {PipelineInfo[]} */
    this.all = [];
    this.controls = element("div", { class: "controls" });
    this.status = element("p", { class: "note", role: "status" });
    this.panel = element("div");
    home.append(this.controls, this.status, this.panel);
    addEventListener("hashchange", () => { this.state = stateOf(MODELS_KEY); this.refresh(); });
    document.addEventListener("magline:changed", () => this.reload());
    this.reload();
  }

  async reload() {
    try {
      this.all = await this.source.pipelines();
      this.home.hidden = !this.tables().length;
      await this.refresh();
    } catch (error) { this.say(error); }
  }

  /** Models and tables of importance. */
  tables() { return this.all.flatMap((p) => p.tables).filter((t) => t.kind === "model" || isImportance(t)); }

  /** @param {string} key @param {string} value */
  set(key, value) {
    if (key === "table") this.state = {};
    if (value) this.state[key] = value; else delete this.state[key];
    keepState(MODELS_KEY, this.state);
    this.refresh();
  }

  /** @param {string} label @param {string} key @param {[string, string][]} choices @param {string} value */
  choice(label, key, choices, value) {
    const options = choices.map(([own, text]) => element("option", { value: own, selected: own === value }, [text]));
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      onchange: () => this.set(key, made.value) }, options));
    return element("label", {}, [element("bdi", {}, [label]), made]);
  }

  /** The point: the chosen value of each axis, else that of the best point, else the first. @param {TableInfo} table
   * @param {PipelineInfo} pipeline @returns {SweepPoint} */
  point(table, pipeline) {
    const best = BEST_POINTS.get(pipeline.name) ?? {};
    return Object.fromEntries(pipeline.axes.filter((axis) => table.axes.includes(axis.name)).map(({ name, values }) => {
      const wanted = this.state["p." + name] ?? best[name];
      return [name, values.find((v) => wanted !== undefined && sameValue(v, wanted)) ?? values[0]];
    }));
  }

  async refresh() {
    const turn = this.turn = (this.turn ?? 0) + 1, tables = this.tables();
    const table = tables.find((t) => t.table === this.state.table);
    const pipeline = this.all.find((p) => p.tables.some((t) => t === table));
    const focus = this.controls.contains(document.activeElement)
      ? document.activeElement?.getAttribute("data-key") : null;
    const parts = [this.choice("model or importance", "table", [["", "choose a table"], ...tables.map((t) =>
      /** @type {[string, string]} */ ([t.table, `${visible(t.table)} (${visible(t.stage)})`]))], table?.table ?? "")];
    const point = table && pipeline ? this.point(table, pipeline) : {};
    for (const { name, values } of pipeline?.axes.filter((axis) => axis.name in point) ?? []) {
      parts.push(this.choice(name, "p." + name, values.slice(0, MOST_CHOICES).map((value) =>
        [value, visible(value).slice(0, 80)]), point[name]));
    }
    this.controls.replaceChildren(...parts);
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
    if (!table) {
      this.panel.replaceChildren();
      this.status.textContent = "Choose a model for its training, or a table of importance.";
      return;
    }
    try {
      const what = table.kind === "model" ? "training" : "importance";
      const axes = Object.entries(point).map(([axis, value]) => ["axis." + axis, value]);
      const query = { table: table.table, ...Object.fromEntries(axes) };
      const found = await this.source.json(this.source.address(this.source.base + what, query));
      if (turn !== this.turn) return;
      const width = Math.max(300, Math.min(920, this.home.clientWidth - 30));
      const made = what === "training" ? lossView(found, width) : importanceView(found, width);
      this.status.textContent = [`Table ${visible(table.table)}`, ...Object.entries(point).map(([axis, value]) =>
        `${visible(axis)} = ${visible(value)}`)].join(", ") + ".";
      this.panel.replaceChildren(typeof made === "string" ? element("p", { class: "note" }, [made])
        : element("figure", { class: "live" }, [made.svg, made.read, element("figcaption", {}, [made.caption]),
          downloads(made.svg, `${table.table}_${what}`, () => made.csv)]));
    } catch (error) { if (turn === this.turn) this.say(error); }
  }

  /** @param {unknown} error */
  say(error) {
    this.panel.replaceChildren();
    this.status.textContent = error instanceof Error ? visible(error.message) : "The model cannot be read.";
  }
}

{
  const home = document.getElementById("models");
  if (home && SERVER) new ModelView(home, SERVER);
}
