// @ts-check
"use strict";
// Lineage of the tables: a drawing of the whole pipeline, and the origin of one table.

/**
 * @typedef {{name: string, stage: string, version: number, axes: string[], predicate: string | null, inputs: string[],
 *   columns: {name: string, from: [string, string][]}[]}} LineageTable
 * @typedef {{pipeline: string, spec: string, seed: number, table: string, tables: LineageTable[],
 *   sources: {name: string, kind: string, files: [string, string][], lines: number}[]}} Lineage
 */

/** A count with its noun. @param {number} n @param {string} noun */
function counted(n, noun) { return `${n} ${noun}${n === 1 ? "" : "s"}`; }

class LineageView {
  /** @param {HTMLElement} home @param {ServerSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.controls = element("div", { class: "controls" });
    this.drawing = element("div", { class: "scroll" });
    this.origin = element("div", { class: "origin" });
    home.append(this.controls, this.drawing, this.origin);
    this.fill();
    document.addEventListener("magline:changed", () => this.fill());
  }

  async fill() {
    try {
      const all = await this.source.pipelines();
      // Tables of failures and warnings have no lineage.
      const choices = all.flatMap((p) => p.tables.filter((t) => t.inputs.length)
        .map((t) => ({ pipeline: p, table: t })));
      const select = /** @type {HTMLSelectElement} */ (element("select", { "data-key": "lineage", onchange: () => {
        const { pipeline, table } = choices[Number(select.value)];
        this.show(pipeline, table);
      } }, choices.map(({ table }, i) => element("option", { value: i }, [visible(table.table)]))));
      this.controls.replaceChildren(element("label", {}, ["table", select]));
      const first = Math.max(0, choices.findIndex(({ table }) => table.kind === "scores"));
      if (!choices.length) { this.origin.textContent = "The store has no tables."; return; }
      select.value = String(first);
      await this.show(choices[first].pipeline, choices[first].table);
    } catch (error) { this.origin.textContent = error instanceof Error ? visible(error.message) : "No lineage."; }
  }

  /** @param {PipelineInfo} pipeline @param {TableInfo} table */
  async show(pipeline, table) {
    this.draw(pipeline, table);
    /** @type {Lineage} */
    const found = await this.source.json(this.source.address(this.source.base + "lineage", { table: table.table }));
    this.origin.replaceChildren(element("h3", {}, [`Origin of ${visible(table.table)}`]),
      element("p", { class: "note" }, [`${visible(found.spec)}, seed ${found.seed}.`]),
      element("ul", { class: "tree" }, [this.branch(found, pipeline, found.table, new Set())]));
  }

  /** A table with its inputs. A table that is listed above appears only by name. @param {Lineage} all
   * @param {PipelineInfo} pipeline @param {string} name @param {Set<string>} seen @returns {HTMLElement} */
  branch(all, pipeline, name, seen) {
    const source = all.sources.find((s) => s.name === name), table = all.tables.find((t) => t.name === name);
    if (source) {
      return element("li", {}, [element("code", {}, [visible(name)]),
        ` ${source.kind}, ${counted(source.lines, "line")}`,
        element("details", {}, [element("summary", {}, [counted(source.files.length, "file")]), element("ul", {},
          source.files.slice(0, 200).map(([path, hash]) => element("li", {}, [element("bdi", {}, [visible(path)]), " ",
            element("code", { class: "note" }, [`blake3 ${hash.slice(0, 16)}`])])))])]);
    }
    if (!table) return element("li", {}, [element("code", {}, [visible(name)])]);
    if (seen.has(name)) return element("li", {}, [element("code", {}, [visible(name)]), " (see above)"]);
    seen.add(name);
    const made = table.columns.filter((c) => c.from.length > 1 || c.from.some(([, from]) => from !== c.name));
    const words = ` ${table.stage}, version ${table.version}` +
      (table.axes.length ? `, over ${table.axes.join(", ")}` : "");
    return element("li", {}, [this.open(pipeline, name), visible(words), ...(table.predicate ? [" where ",
      element("code", {}, [visible(table.predicate)])] : []), ...(made.length ? [element("details", {}, [
      element("summary", {}, [counted(made.length, "column")]), element("ul", {}, made.map((c) => element("li", {}, [
      element("code", {},
      [visible(c.name)]), " from " + visible(c.from.map(([t, f]) => `${t}.${f}`).join(", "))])))])] : []),
      element("ul", {}, table.inputs.map((input) => this.branch(all, pipeline, input, seen)))]);
  }

  /** A button that shows the table in the line view, or its name.
   * @param {PipelineInfo} pipeline @param {string} name */
  open(pipeline, name) {
    const table = pipeline.tables.find((t) => t.name === name);
    if (table?.kind !== "samples") return element("code", {}, [visible(name)]);
    return element("button", { type: "button", class: "plain", title: "Show its columns in the line view",
      onclick: () => this.go(pipeline, name) }, [visible(name)]);
  }

  /** @param {PipelineInfo} pipeline @param {string} table */
  go(pipeline, table) {
    document.dispatchEvent(new CustomEvent("magline:place",
      { detail: { pipeline: pipeline.name, table, focus: true } }));
  }

  /** The tables in columns by their distance from the sources. @param {PipelineInfo} pipeline
   * @param {TableInfo} chosen */
  draw(pipeline, chosen) {
    /** @type {Map<string, number>} */
    const depth = new Map(pipeline.sources.map((s) => [s.name, 0]));
    const tables = pipeline.tables.filter((t) => t.inputs.length);
    for (const { name, inputs } of tables) {
      depth.set(name, 1 + Math.max(0, ...inputs.map((input) => depth.get(input) ?? 0)));
    }
    const levels = Array.from({ length: 1 + Math.max(0, ...depth.values()) }, (_, d) =>
      [...depth].filter(([, own]) => own === d).map(([name]) => name));
    // An edge that passes a level takes its own place there, so that it crosses no box.
    const via = (/** @type {string} */ from, /** @type {string} */ to, /** @type {number} */ d) =>
      `${from}\n${to}\n${d}`;
    for (const { name, inputs } of tables) for (const input of inputs) {
      for (let d = (depth.get(input) ?? 0) + 1; d < (depth.get(name) ?? 0); d++) levels[d].push(via(input, name, d));
    }
    const wide = 150, high = 44, gap = 46;
    const width = levels.length * (wide + gap) - gap + 4, tall = Math.max(...levels.map((l) => l.length));
    const height = tall * (high + 14) - 10;
    /** @type {Map<string, [number, number]>} */
    const at = new Map();
    levels.forEach((names, d) => names.forEach((name, i) => at.set(name, [2 + d * (wide + gap),
      2 + (i + (tall - names.length) / 2) * (high + 14)])));
    const upstream = new Set([chosen.name]);
    for (const { name, inputs } of [...tables].reverse()) {
      if (upstream.has(name)) for (const input of inputs) upstream.add(input);
    }
    const svg = shape("svg", { class: "flow", viewBox: `0 0 ${width} ${height}`,
      style: `width:${width}px;max-width:none`, role: "group", "aria-label": "Tables and their inputs" });
    for (const { name, inputs } of tables) for (const input of inputs) {
      const [start, end] = [at.get(input), at.get(name)];
      if (!start || !end) continue;
      let [x, y] = [start[0] + wide, start[1] + high / 2], d = `M${x} ${y}`;
      const bend = (/** @type {number} */ to, /** @type {number} */ down) => {
        d += `C${x + gap / 2} ${y} ${to - gap / 2} ${down} ${to} ${down}`;
        [x, y] = [to, down];
      };
      for (let k = (depth.get(input) ?? 0) + 1; k < (depth.get(name) ?? 0); k++) {
        const [px, py] = at.get(via(input, name, k)) ?? [0, 0];
        bend(px, py + high / 2);
        x += wide;
        d += `H${x}`;
      }
      bend(end[0], end[1] + high / 2);
      svg.append(shape("path", { class: upstream.has(name) ? "arrow on" : "arrow", d }));
    }
    for (const [name, [x, y]] of at) {
      if (!depth.has(name)) continue;
      const table = pipeline.tables.find((t) => t.name === name), samples = table?.kind === "samples";
      const source = pipeline.sources.find((s) => s.name === name);
      const group = shape("g", { class: `box${source ? " source" : ""}${name === chosen.name ? " chosen" : ""}` +
        (upstream.has(name) ? "" : " aside"), ...(samples ? { tabindex: 0, role: "button",
        "aria-label": `${visible(name)}, ${table?.stage}: show its columns` } : {}) }, [
        shape("rect", { x, y, width: wide, height: high, rx: 6 }),
        shape("text", { class: "title", x: x + 9, y: y + 18 }, [cut(name, 19)]),
        shape("text", { x: x + 9, y: y + 35 }, [cut(table ? table.stage : source?.kind ?? "", 21)])]);
      if (samples) {
        group.addEventListener("click", () => this.go(pipeline, name));
        group.addEventListener("keydown", (event) => {
          if (event.key === "Enter" || event.key === " ") { event.preventDefault(); this.go(pipeline, name); }
        });
      }
      svg.append(group);
    }
    this.drawing.replaceChildren(svg);
  }
}

{
  const home = document.getElementById("lineage");
  if (home && SERVER) new LineageView(home, SERVER);
}
