// @ts-check
"use strict";
// Panels as files: SVG and PNG with a caption, and CSV.

const FIGURE_PX = 920, FIGURE_PANEL_PX = 170, FIGURE_LEFT_PX = 84, FIGURE_RIGHT_PX = 16;

/** Lines of a text of at most `most` characters. @param {string} text @param {number} most */
function wrapped(text, most) {
  /** @type {string[]} */
  const lines = [];
  for (const word of visible(text).split(" ")) {
    const last = lines[lines.length - 1];
    if (last !== undefined && last.length + word.length < most) lines[lines.length - 1] = `${last} ${word}`;
    else lines.push(word);
  }
  return lines;
}

/** Path through the values in sight; a missing value or a gap breaks it. A value between missing values is a dot.
 * @param {ArrayLike<number>} x @param {ArrayLike<number>} y @param {(t: number) => number} px
 * @param {(v: number) => number} py @param {number} gap */
function pathOf(x, y, px, py, gap) {
  let line = "", dots = "", pen = false;
  for (let i = 0; i < x.length; i++) {
    if (!Number.isFinite(y[i])) { pen = false; continue; }
    const joined = pen && x[i] - x[i - 1] <= gap, place = px(x[i]).toFixed(1) + " " + py(y[i]).toFixed(1);
    line += (joined ? "L" : "M") + place;
    if (!joined && !Number.isFinite(y[i + 1])) dots += `M${place}h0`;
    pen = true;
  }
  return { line, dots };
}

/** The samples from the last one before a range to the first one after it. @param {PanelSeries} one
 * @param {TimeRange} range @returns {PanelSeries} */
function inSight(one, [from, to]) {
  const a = Math.max(0, nearest(one.x, from) - 1), b = Math.min(one.x.length - 1, nearest(one.x, to) + 1);
  return { ...one, x: one.x.slice(a, b + 1), low: one.low.slice(a, b + 1), high: one.high?.slice(a, b + 1) ?? null };
}

/** The panels as one picture. @param {PanelSet} set @param {string} caption */
function panelsSvg(set, caption) {
  const note = wrapped(caption, 130), high = set.panels.length * FIGURE_PANEL_PX + 44;
  const height = high + 18 * note.length + 8, [from, to] = set.range;
  const svg = shape("svg", { viewBox: `0 0 ${FIGURE_PX} ${height}`, width: FIGURE_PX, height,
    "font-family": "Helvetica, Arial, sans-serif", "font-size": 12 });
  const soft = set.colour("--soft"), ink = set.colour("--ink"), grid = set.colour("--grid");
  svg.append(shape("rect", { width: FIGURE_PX, height, fill: set.colour("--paper") }));
  const right = FIGURE_PX - FIGURE_RIGHT_PX;
  const px = (/** @type {number} */ t) => FIGURE_LEFT_PX + (t - from) / (to - from) * (right - FIGURE_LEFT_PX);
  const step = TIME_STEPS.find((s) => (to - from) / s <= 9) ?? 86_400;
  /** @type {number[]} */
  const times = [];
  for (let t = Math.ceil(from / step) * step; t <= to; t += step) times.push(t);
  set.panels.forEach(({ data, hidden }, at) => {
    const top = at * FIGURE_PANEL_PX + 26, foot = (at + 1) * FIGURE_PANEL_PX - 6;
    const series = data.series.filter((_, k) => !hidden.has(k)).map((s) => inSight(s, set.range));
    const values = series.filter((s) => !s.band).flatMap((s) => [...s.low, ...s.high ?? []]).filter(Number.isFinite);
    const [least, largest] = [reduced(values, Math.min)[0] ?? null, reduced(values, Math.max)[0] ?? null];
    const [low, most] = PanelSet.rangeY(...set.withBands(data.key, least, largest));
    const py = (/** @type {number} */ v) => foot - (v - low) / (most - low) * (foot - top);
    for (const t of times) svg.append(shape("path", { d: `M${px(t).toFixed(1)} ${top}V${foot}`, stroke: grid }));
    for (const tick of linearTicks(low, most, 5)) {
      svg.append(shape("path", { d: `M${FIGURE_LEFT_PX} ${py(tick.at).toFixed(1)}H${right}`, stroke: grid }),
        shape("text", { x: FIGURE_LEFT_PX - 6, y: py(tick.at) + 4, "text-anchor": "end", fill: soft }, [tick.label]));
    }
    const id = `clip-${at}`;
    svg.append(shape("clipPath", { id }, [shape("rect", { x: FIGURE_LEFT_PX, y: top, width: right - FIGURE_LEFT_PX,
      height: foot - top })]));
    const drawn = shape("g", { "clip-path": `url(#${id})` });
    for (const one of series) {
      const hue = set.colour(one.hue), gap = gapStep(one.x);
      if (one.high) {
        const [x, edge] = [Array.from(one.x), Array.from(one.high)];
        const keep = x.map((_, i) => i).filter((i) => Number.isFinite(edge[i]) && Number.isFinite(one.low[i]));
        const way = [...keep.map((i) => [x[i], edge[i]]), ...keep.reverse().map((i) => [x[i], one.low[i]])];
        const corners = way.map(([t, v]) => `${px(t).toFixed(1)} ${py(v).toFixed(1)}`);
        if (corners.length) drawn.append(shape("path", { d: `M${corners.join("L")}Z`, fill: hue,
          "fill-opacity": one.band ? 0.18 : 0.4 }));
      }
      if (one.band) continue;
      const { line, dots } = pathOf(one.x, middles(one), px, py, gap);
      drawn.append(shape("path", { d: line, fill: "none", stroke: hue, "stroke-width": 1.3, "stroke-linejoin": "round",
        ...(one.dash.length ? { "stroke-dasharray": "5 4" } : {}) }),
      shape("path", { d: dots, fill: "none", stroke: hue, "stroke-width": 3.5, "stroke-linecap": "round" }));
    }
    svg.append(drawn, shape("rect", { x: FIGURE_LEFT_PX, y: top, width: right - FIGURE_LEFT_PX, height: foot - top,
      fill: "none", stroke: soft }), shape("text", { x: FIGURE_LEFT_PX, y: top - 8, fill: ink, "font-weight": 600 },
      [cut(data.title + (data.unit === "1" ? "" : ` [${data.unit}]`), 48)]));
    let x = right;
    for (const one of [...series].reverse()) {
      const text = cut(one.label, 40);
      x -= 7 * text.length + 34;
      svg.append(shape("path", { d: `M${x} ${top - 12}h20`, stroke: set.colour(one.hue),
        "stroke-width": one.band ? 9 : 2.5, "stroke-opacity": one.band ? 0.3 : 1,
        ...(one.dash.length ? { "stroke-dasharray": "5 4" } : {}) }),
        shape("text", { x: x + 25, y: top - 8, fill: soft }, [text]));
    }
  });
  const foot = high - 44;
  for (const t of times) svg.append(shape("text", { x: px(t), y: foot + 12, "text-anchor": "middle", fill: soft },
    [clock(t, step >= 1 ? 0 : step >= 0.1 ? 1 : 3)]));
  svg.append(shape("text", { x: (FIGURE_LEFT_PX + right) / 2, y: foot + 30, "text-anchor": "middle", fill: ink },
    ["time, UTC"]));
  note.forEach((line, i) => svg.append(shape("text", { x: 12, y: high + 12 + 18 * i, fill: soft }, [line])));
  return { text: new XMLSerializer().serializeToString(svg), width: FIGURE_PX, height };
}

/** The values in sight, one row for each time. @param {PanelSet} set */
function panelsCsv(set) {
  /** @type {string[]} */
  const names = [];
  /** @type {{x: Float64Array, y: Float64Array}[]} */
  const columns = [];
  for (const { data, hidden } of set.panels) data.series.forEach((one, k) => {
    if (hidden.has(k)) return;
    const unit = one.unit === "1" ? "" : ` [${one.unit}]`;
    const parts = one.high ? [[" min", one.low], [" max", one.high]] : [["", one.low]];
    for (const [part, y] of /** @type {[string, Float64Array][]} */ (parts)) {
      names.push(one.label + part + unit);
      columns.push({ x: one.x, y });
    }
  });
  if (!columns.length) return "";
  const [x, ...values] = aligned(columns), rows = [csvRow(["tt [s]", ...names])];
  for (let i = 0; i < x.length; i++) {
    const t = x[i];
    if (t === null || t < set.range[0] || t > set.range[1]) continue;
    const cells = values.map((v) => v[i] ?? null);
    if (cells.some((v) => v !== null)) rows.push(csvRow([t, ...cells]));
  }
  return rows.join("\n") + "\n";
}
