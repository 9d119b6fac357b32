// @ts-check
"use strict";
// The plots of the explorer. Each returns a picture, its readout, a caption, and its figures as CSV.

/**
 * @typedef {{svg: SVGSVGElement, read: HTMLElement, caption: string, csv: string, more?: HTMLElement}} PlotView
 * @typedef {{scores: ScoreSet, state: ExplorerState, rows: number[], metric: number, width: number,
 *   choose: (row: number, second: boolean) => void, openLine: (flight: string, line: string) => void}} ViewInput
 */

const HEIGHT = 380, LEFT = 76, RIGHT = 16, TOP = 12, BOTTOM = 44;

/**
 * Values of an axis among some rows, in display order.
 * @param {ScoreSet} scores @param {number} a @param {number[]} rows
 */
function valuesOf(scores, a, rows) {
  const there = new Set(rows.map((r) => scores.block.at[a][r]));
  return scores.order[a].filter((code) => there.has(code));
}

/** Best row for each combination of two axes. @param {ViewInput} input @param {number} a @param {number} b */
function pivot({ scores, rows, metric }, a, b) {
  /** @type {Map<string, number[]>} */
  const groups = new Map();
  for (const row of rows) {
    const key = scores.block.at[a][row] + " " + (b < 0 ? 0 : scores.block.at[b][row]);
    const known = groups.get(key);
    if (known) known.push(row); else groups.set(key, [row]);
  }
  /** @type {Map<string, number>} */
  const best = new Map();
  groups.forEach((own, key) => best.set(key, scores.best(metric, own)));
  return best;
}

/**
 * Part from 0 (worst) to 1 (best) of a value among eligible rows.
 * @param {ScoreSet} scores @param {number} metric @param {number[]} rows
 */
function goodness(scores, metric, rows) {
  const { better } = scores.block.metrics[metric];
  const costs = rows.filter((r) => r >= 0 && !scores.excluded(metric, r))
    .map((r) => scores.cost(metric, scores.value(metric, r))).filter(Number.isFinite);
  const [low] = reduced(costs, Math.min), [high] = reduced(costs, Math.max);
  const log = better === "lower" && low > 0 && high / low > 10;
  /** @param {number} row */
  return (row) => {
    const cost = scores.cost(metric, scores.value(metric, row));
    if (!(high > low)) return 1;
    return log ? 1 - Math.log(cost / low) / Math.log(high / low) : 1 - (cost - low) / (high - low);
  };
}

/** @param {ViewInput} input @returns {PlotView | string} */
function heatView(input) {
  const { scores, state, rows, metric, width, choose } = input;
  const [a, b] = [scores.axis(state.y), scores.axis(state.x)];
  if (a < 0 || b < 0 || a === b) return "A heat map needs two axes with several values.";
  const down = valuesOf(scores, a, rows), across = valuesOf(scores, b, rows);
  if (down.length * across.length > 40_000) return "Too many cells: filter one of the axes first.";
  const best = pivot(input, a, b), part = goodness(scores, metric, [...best.values()]);
  const longest = Math.max(0, ...down.map((c) => scores.texts[a][c].length));
  const left = Math.min(width * 0.35, 30 + 6.8 * longest);
  const wide = (width - left - RIGHT) / Math.max(1, across.length);
  const high = Math.max(12, Math.min(34, 700 / Math.max(1, down.length)));
  const height = 44 + high * down.length + 10;
  /** @type {PlotTarget[]} */
  const targets = [];
  // Borders would dull the colours of narrow cells.
  const fine = wide < 12 || high < 12 ? " fine" : "";
  const cells = shape("g"), lines = [csvRow([scores.block.axes[a].name, scores.block.axes[b].name,
    scores.label(metric), "marks"])];
  down.forEach((i, row) => across.forEach((k, column) => {
    const found = best.get(i + " " + k);
    if (found === undefined || found < 0) return;
    const [x, y] = [left + wide * column, 44 + high * row];
    const marks = scores.marks(metric, found), colour = viridis(part(found));
    cells.append(shape("rect", { class: (marks ? "cell out" : "cell") + fine, x, y, width: wide, height: high,
      ...(marks ? {} : { fill: colour.fill }) }));
    const value = scores.value(metric, found);
    if (wide > 44 && high > 15) {
      cells.append(shape("text", { class: "in", x: x + wide / 2, y: y + high / 2 + 4, "text-anchor": "middle",
        style: marks ? "" : `fill:${colour.ink}` }, [short(value) + (marks ? " !" : "")]));
    }
    targets.push({ x: x + wide / 2, y: y + high / 2, row: found,
      text: `${scores.words(metric, value)} at ${scores.point(found)}${marks ? " (" + marks + ")" : ""}` });
    lines.push(csvRow([scores.word(a, found), scores.word(b, found), value, marks]));
  }));
  const { svg, read } = livePlot({ label: `${scores.label(metric)} over ${state.y} and ${state.x}`, width, height,
    targets, choose });
  const every = Math.max(1, Math.ceil(64 / wide)), each = Math.max(1, Math.ceil(12 / high));
  svg.append(cells, shape("text", { class: "name", x: left + (width - left) / 2, y: 14, "text-anchor": "middle" },
    [state.x]), shape("text", { class: "name", x: 4, y: 34 }, [state.y]));
  across.forEach((k, i) => { if (i % every === 0) {
    svg.append(shape("text", { x: left + wide * (i + 0.5), y: 36, "text-anchor": "middle" },
      [cut(scores.texts[b][k], Math.floor(wide * every / 6.5))]));
  } });
  down.forEach((k, i) => { if (i % each === 0) {
    svg.append(shape("text", { x: left - 7, y: 48 + high * (i + 0.5), "text-anchor": "end" },
      [cut(scores.texts[a][k], Math.floor((left - 10) / 6.5))]));
  } });
  return { svg, read, csv: lines.join("\n") + "\n", caption: "Each cell is the best point over the other axes that " +
    "the filters keep. Yellow is good, purple is bad. Cells without a colour are flagged or in sample." };
}

/** @param {string} text @param {number} most */
function cut(text, most) {
  const shown = visible(text);
  return shown.length > most ? shown.slice(0, Math.max(1, most - 1)) + "\u2026" : shown;
}

/** @param {ViewInput} input @returns {PlotView | string} */
function curveView(input) {
  const { scores, state, rows, metric, width, choose } = input;
  const a = scores.axis(state.x);
  let b = scores.axis(state.y);
  if (a < 0) return "A curve needs an axis with several values.";
  if (b === a) b = -1;
  const codes = valuesOf(scores, a, rows), axis = scores.block.axes[a];
  const place = (/** @type {number} */ code) => axis.numeric ? Number(axis.values[code]) : codes.indexOf(code);
  const best = pivot(input, a, b), series = b < 0 ? [0] : valuesOf(scores, b, rows).slice(0, 8);
  const values = [...best.values()].filter((r) => r >= 0).map((r) => scores.value(metric, r) ?? NaN);
  // The legend stands above the frame.
  const names = b < 0 ? [] : series.map((s) => cut(scores.texts[b][s], 24));
  const step = 44 + 7 * Math.max(0, ...names.map((name) => name.length));
  const columns = Math.max(1, Math.floor((width - LEFT - RIGHT) / step));
  const foot = HEIGHT - BOTTOM, top = TOP + 17 * Math.ceil(names.length / columns);
  const x = new PlotScale(codes.map(place), LEFT, width - RIGHT), y = new PlotScale(values, foot, top);
  /** @type {PlotTarget[]} */
  const targets = [];
  const drawn = shape("g"), lines = [csvRow([axis.name, ...(b < 0 ? [] : [state.y]), scores.label(metric), "marks"])];
  const legend = shape("g");
  series.forEach((s, k) => {
    let d = "";
    for (const code of codes) {
      const row = best.get(code + " " + s);
      const value = row === undefined || row < 0 ? null : scores.value(metric, row);
      if (row === undefined || value === null) continue;
      const [px, py] = [x.at(place(code)), y.at(value)], marks = scores.marks(metric, row);
      d += (d ? "L" : "M") + px.toFixed(1) + " " + py.toFixed(1);
      drawn.append(shape("circle", { class: marks ? "point out" : `point s${k}`, cx: px, cy: py, r: 3.5 }));
      targets.push({ x: px, y: py, row,
        text: `${scores.words(metric, value)} at ${scores.point(row)}${marks ? " (" + marks + ")" : ""}` });
      lines.push(csvRow([axis.values[code], ...(b < 0 ? [] : [scores.block.axes[b].values[s]]), value, marks]));
    }
    drawn.prepend(shape("path", { class: `line s${k}`, d }));
    if (b >= 0) {
      const [lx, ly] = [LEFT + step * (k % columns), TOP + 17 * Math.floor(k / columns)];
      legend.append(shape("path", { class: `line s${k}`, d: `M${lx} ${ly}h20` }),
        shape("text", { x: lx + 26, y: ly + 4 }, [names[k]]));
    }
  });
  const { svg, read } = livePlot({ label: `${scores.label(metric)} over ${axis.name}`, width, height: HEIGHT, targets,
    choose });
  svg.append(plotFrame(x, y, axis.name, scores.label(metric)), drawn, legend);
  if (!axis.numeric) codes.forEach((code, i) => svg.append(shape("text", { class: "name", x: x.at(i), y: foot - 6,
    "text-anchor": "middle" }, [cut(axis.values[code], Math.floor((width - LEFT) / codes.length / 6.5))])));
  const ideal = scores.best(metric, rows);
  let edge = "";
  if (ideal >= 0 && !scores.excluded(metric, ideal)) {
    const code = scores.block.at[a][ideal], value = scores.value(metric, ideal) ?? NaN;
    svg.append(shape("circle", { class: "best", cx: x.at(place(code)), cy: y.at(value), r: 8 }));
    if (axis.numeric && codes.length > 1 && (code === codes[0] || code === codes[codes.length - 1])) {
      edge = ` The best value is at an end of ${axis.name}, so a value outside the range may be better.`;
    }
  }
  const many = b >= 0 && valuesOf(scores, b, rows).length > 8 ? ` The first 8 values of ${state.y} are drawn.` : "";
  return { svg, read, csv: lines.join("\n") + "\n", caption: "Each dot is the best point over the other axes that " +
    "the filters keep. " + (ideal < 0 ? "" : `The ring is the best point: ${scores.words(metric,
      scores.value(metric, ideal))} at ${scores.point(ideal)}.`) + edge + many };
}

/** @param {ViewInput} input @returns {PlotView | string} */
function parallelView({ scores, state, rows, metric, width, choose }) {
  const axes = scores.varying, drawn = shape("g");
  if (axes.length === 0) return "Parallel coordinates need an axis with several values.";
  const codes = axes.map((a) => valuesOf(scores, a, rows));
  const span = (width - 60 - 80) / axes.length, foot = HEIGHT - 20;
  const scales = axes.map((a, i) => {
    const axis = scores.block.axes[a];
    const place = new Map(codes[i].map((code, k) => [code, axis.numeric ? Number(axis.values[code]) : k]));
    const scale = new PlotScale([...place.values()], foot, 30);
    return { x: 60 + span * i, at: (/** @type {number} */ row) => scale.at(place.get(scores.block.at[a][row]) ?? NaN) };
  });
  const usable = rows.filter((r) => scores.value(metric, r) !== null);
  const end = new PlotScale(usable.map((r) => scores.value(metric, r) ?? NaN), foot, 30);
  const right = 60 + span * axes.length, part = goodness(scores, metric, usable);
  // Points share segments; a shared segment is drawn once per colour.
  const paths = Array.from({ length: 9 }, () => /** @type {Set<string>} */ (new Set()));
  /** @type {PlotTarget[]} */
  const targets = [];
  for (const row of usable) {
    const y = end.at(scores.value(metric, row) ?? NaN), marks = scores.marks(metric, row);
    const corners = [...scales.map((s) => `${s.x.toFixed(0)} ${s.at(row).toFixed(1)}`), `${right} ${y.toFixed(1)}`];
    const segments = paths[marks ? 0 : 1 + viridis(part(row)).bin];
    for (let i = 1; i < corners.length; i++) segments.add(`M${corners[i - 1]}L${corners[i]}`);
    const words = scores.words(metric, scores.value(metric, row));
    targets.push({ x: right, y, row, text: `${words} at ${scores.point(row)}${marks ? ` (${marks})` : ""}` });
  }
  paths.forEach((segments, k) => { if (segments.size) {
    drawn.append(shape("path", { class: k ? `way b${k - 1}` : "way out", d: [...segments].join("") }));

  } });
  targets.sort((p, q) => p.y - q.y);
  const { svg, read } = livePlot({ label: `Parallel coordinates with ${scores.label(metric)}`, width, height: HEIGHT,
    targets, choose });
  const top = Number(state.point ?? scores.best(metric, rows));
  svg.append(drawn);
  if (usable.includes(top)) {
    svg.append(shape("path", { class: "chosen", d: "M" + scales.map((s) => `${s.x} ${s.at(top)}`).join("L") +
      `L${right} ${end.at(scores.value(metric, top) ?? NaN)}` }));
  }
  axes.forEach((a, i) => {
    const { x } = scales[i];
    let last = Infinity;
    const axis = scores.block.axes[a];
    const place = new PlotScale(codes[i].map((c, k) => axis.numeric ? Number(axis.values[c]) : k), foot, 30);
    svg.append(shape("line", { class: "stroke", x1: x, x2: x, y1: 30, y2: foot }),
      shape("text", { class: "name", x, y: 18, "text-anchor": "middle" }, [cut(axis.name, Math.floor(span / 7))]));
    codes[i].forEach((c, k) => {
      const y = place.at(axis.numeric ? Number(axis.values[c]) : k);
      if (Math.abs(y - last) < 15) return;
      last = y;
      svg.append(shape("text", { class: "halo-text", x: x + 6, y: y + 4 },
        [cut(scores.texts[a][c], Math.floor(span / 8))]));
    });
  });
  svg.append(shape("line", { class: "stroke", x1: right, x2: right, y1: 30, y2: foot }),
    shape("text", { class: "name", x: right, y: 18, "text-anchor": "middle" }, [scores.label(metric)]));
  for (const tick of end.ticks(8)) svg.append(shape("text", { x: right + 7, y: end.at(tick.at) + 4 }, [tick.label]));
  return { svg, read, csv: scores.csv(usable), caption: "One line is one point. Yellow is good, purple is bad, grey " +
    "is flagged or in sample. The thick line is the chosen point, or the best. Values are read at the right axis." };
}

/** @param {ViewInput} input @returns {PlotView | string} */
function scatterView({ scores, state, rows, metric, width, choose }) {
  const other = scores.metric(state.against);
  if (other < 0) return "A scatter plot needs a second metric.";
  const usable = rows.filter((r) => scores.value(metric, r) !== null && scores.value(other, r) !== null);
  const x = new PlotScale(usable.map((r) => scores.value(other, r) ?? NaN), LEFT, width - RIGHT);
  const y = new PlotScale(usable.map((r) => scores.value(metric, r) ?? NaN), HEIGHT - BOTTOM, TOP);
  /** @type {PlotTarget[]} */
  const targets = [];
  let [good, out] = ["", ""];
  for (const row of usable) {
    const [px, py] = [x.at(scores.value(other, row) ?? NaN), y.at(scores.value(metric, row) ?? NaN)];
    const d = `M${px.toFixed(1)} ${py.toFixed(1)}h0`, marks = scores.marks(metric, row) || scores.marks(other, row);
    if (marks) out += d; else good += d;
    targets.push({ x: px, y: py, row, text: `${scores.words(metric, scores.value(metric, row))}, ` +
      `${scores.words(other, scores.value(other, row))} at ${scores.point(row)}${marks ? " (" + marks + ")" : ""}` });
  }
  targets.sort((p, q) => p.x - q.x);
  const label = `${scores.label(metric)} against ${scores.label(other)}`;
  const { svg, read } = livePlot({ label, width, height: HEIGHT, targets, choose });
  svg.append(plotFrame(x, y, scores.label(other), scores.label(metric)), shape("path", { class: "dots out", d: out }),
    shape("path", { class: "dots", d: good }));
  const top = Number(state.point ?? scores.best(metric, usable));
  if (usable.includes(top)) svg.append(shape("circle", { class: "best", r: 8,
    cx: x.at(scores.value(other, top) ?? NaN), cy: y.at(scores.value(metric, top) ?? NaN) }));
  return { svg, read, csv: scores.csv(usable),
    caption: "One dot is one point; grey dots are flagged or in sample. The " +
    `ring is the chosen point, or the best by ${scores.block.metrics[metric].name}.` };
}

/** @param {ViewInput} input @returns {PlotView | string} */
function linesView({ scores, state, rows, metric, width, openLine }) {
  const point = Number(state.point ?? scores.best(metric, rows));
  const lines = scores.linesOf(metric, point);
  if (!lines.length) return "No scores of single lines for this metric. `magline sql` shows the table of scores.";
  const left = Math.min(190, width * 0.4), row = 20, height = row * lines.length + BOTTOM;
  const x = new PlotScale(lines.flatMap((l) => l.base === null ? [l.value] : [l.value, l.base]), left, width - RIGHT);
  const drawn = shape("g"), most = Math.floor((left - 10) / 6.5);
  const targets = lines.map((l, i) => {
    const y = row * (i + 0.5) + 4, at = x.at(l.value);
    drawn.append(shape("text", { class: "name", x: left - 8, y: y + 4, "text-anchor": "end" },
      [cut(`${l.flight} / ${l.line}`, most)]));
    if (l.base !== null) drawn.append(shape("line", { class: "arm", x1: at, x2: x.at(l.base), y1: y, y2: y }),
      shape("circle", { class: "base", cx: x.at(l.base), cy: y, r: 4 }));
    drawn.append(shape("circle", { class: l.marks ? "point out" : "dot", cx: at, cy: y, r: 5 }));
    const base = scores.block.metrics[metric].baseline;
    return { x: at, y, row: i, text: `flight ${visible(l.flight)}, line ${visible(l.line)}: ` +
      scores.words(metric, l.value) + (l.base === null ? "" : `, ${base} ${short(l.base)}`) +
      (l.marks ? ` (${l.marks})` : "") };
  });
  const { svg, read } = livePlot({ label: `${scores.label(metric)} of each line`, width, height, targets,
    choose: (i) => openLine(lines[i].flight, lines[i].line) });
  for (const tick of x.ticks(Math.max(3, Math.floor((width - left) / 80)))) {
    const at = x.at(tick.at);
    svg.append(shape("line", { class: "grid", x1: at, x2: at, y1: 0, y2: height - BOTTOM + 4 }),
      shape("text", { x: at, y: height - BOTTOM + 20, "text-anchor": "middle" }, [tick.label]));
  }
  svg.append(drawn, shape("text", { class: "name", x: (left + width) / 2, y: height - 4, "text-anchor": "middle" },
    [scores.label(metric)]));
  const base = scores.block.metrics[metric].baseline;
  const csv = [csvRow(["flight", "line", scores.label(metric), base ?? "baseline", "marks"]),
    ...lines.map((l) => csvRow([l.flight, l.line, l.value, l.base, l.marks]))].join("\n") + "\n";
  const words = state.point === undefined ? "the best point that the filters keep" : "the chosen point";
  return { svg, read, csv, caption: `The lines of ${words}, worst first: ${scores.point(point) || "one point"}. ` +
    `Worst: flight ${visible(lines[0].flight)}, line ${visible(lines[0].line)}, ` +
    `${scores.words(metric, lines[0].value)}. A click or Enter opens the series of a line.` };
}
