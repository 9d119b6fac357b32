// @ts-check
"use strict";
// Two points side by side: what differs in the axes, and every metric.

/** Relative difference below which two scores differ by rounding only. */
const ROUNDING = 1e-12;

/** Difference of two scores; zero where they differ by rounding only. @param {number} a @param {number} b */
function difference(a, b) { return Math.abs(b - a) <= ROUNDING * Math.max(Math.abs(a), Math.abs(b)) ? 0 : b - a; }

/** Change from A to B in percent; `null` where A is zero or a value is missing. @param {number | null} a
 * @param {number | null} b */
function percentChange(a, b) {
  return a === null || b === null || a === 0 ? null : 100 * difference(a, b) / Math.abs(a);
}

/** The better of two points. @param {ScoreSet} scores @param {number} m @param {number} a @param {number} b */
function betterOf(scores, m, a, b) {
  const [one, two] = [scores.cost(m, scores.value(m, a)), scores.cost(m, scores.value(m, b))];
  if (!Number.isFinite(one) || !Number.isFinite(two) || difference(one, two) === 0) return "";
  return one < two ? "A" : "B";
}

/** @param {ViewInput} input @returns {PlotView | string} */
function compareView({ scores, state, width }) {
  const { block } = scores, [a, b] = [Number(state.point ?? -1), Number(state.other ?? -1)];
  const there = (/** @type {number} */ row) => row >= 0 && row < block.points;
  if (!there(a) || !there(b)) {
    return "Choose a point in the table. Then choose the second point: button B of its row, or a click with Shift.";
  }
  const rows = block.metrics.map((_, m) => m).filter((m) => scores.value(m, a) !== null || scores.value(m, b) !== null);
  const changes = rows.map((m) => percentChange(scores.value(m, a), scores.value(m, b)));
  const left = Math.min(200, width * 0.42), right = 74, high = 24, height = rows.length * high + 40;
  const most = Math.min(300, Math.max(5, ...changes.map((c) => Math.abs(c ?? 0)))) * 1.05;
  const x = (/** @type {number} */ v) => left + (Math.min(most, Math.max(-most, v)) + most) / (2 * most)
    * (width - left - right);
  const drawn = shape("g");
  const targets = rows.map((m, i) => {
    const y = high * (i + 0.5) + 6, change = changes[i], better = betterOf(scores, m, a, b);
    const words = change === null ? "-" : change === 0 ? "0 %"
      : `${change < 0 ? "\u2212" : "+"}${Math.abs(change).toPrecision(3)} %`;
    drawn.append(shape("text", { class: "name", x: left - 8, y: y + 4, "text-anchor": "end" },
      [cut(block.metrics[m].name, Math.floor((left - 10) / 6.5))]));
    if (change !== null) drawn.append(shape("rect", { class: "change" + (better ? ` to-${better.toLowerCase()}` : ""),
      x: Math.min(x(0), x(change)), y: y - 7, width: Math.max(1, Math.abs(x(change) - x(0))), height: 14 }));
    drawn.append(shape("text", { x: width - right + 6, y: y + 4 }, [words]));
    return { x: x(change ?? 0), y, row: -1, text: `${scores.words(m, scores.value(m, a))} at A, ` +
      `${short(scores.value(m, b))} at B, ${words}${better ? `: ${better} is better` : ""}` };
  });
  const { svg, read } = livePlot({ label: "Change of each metric from A to B", width, height, targets,
    choose: () => {} });
  svg.append(shape("line", { class: "zero", x1: x(0), x2: x(0), y1: 0, y2: height - 30 }));
  for (const tick of linearTicks(-most, most, Math.max(2, Math.floor((width - left - right) / 90)))) {
    svg.append(shape("line", { class: "grid", x1: x(tick.at), x2: x(tick.at), y1: 0, y2: height - 32 }),
      shape("text", { x: x(tick.at), y: height - 16, "text-anchor": "middle" }, [tick.label + " %"]));
  }
  svg.append(drawn);
  const differs = scores.varying.filter((i) => block.at[i][a] !== block.at[i][b]);
  const axes = differs.map((i) => `${block.axes[i].name}: ${scores.text(i, a)} at A, ${scores.text(i, b)} at B`)
    .join("; ");
  return { svg, read, more: compareTable(scores, rows, a, b),
    caption: `A is ${scores.point(a) || "the only point"}. B is ${scores.point(b) || "the only point"}. ` +
      `The axes differ in ${axes || "nothing"}. Bars show the change from A to B: blue where A is better, orange ` +
      "where B is better, grey where the metric has no direction." + (block.lines ? " " + PAIRED_NOTE : ""),
    csv: [csvRow(["metric", "unit", "A", "B", "change [%]", "better", "paired lines", "mean difference", "low",
      "high"]), ...rows.map((m, i) => {
      const paired = pairedDifference(pairedLines(block, m, a, b));
      return csvRow([block.metrics[m].name, block.metrics[m].unit, scores.value(m, a), scores.value(m, b), changes[i],
        betterOf(scores, m, a, b), paired?.lines ?? 0, paired?.mean ?? null, paired?.low ?? null,
        paired?.high ?? null]);
    })].join("\n") + "\n" };
}

/** @param {ScoreSet} scores @param {number[]} rows @param {number} a @param {number} b */
function compareTable(scores, rows, a, b) {
  const { block } = scores, cell = (/** @type {string} */ text, on = false) => element("td",
    { class: on ? "n best" : "n" }, [text]);
  const axes = scores.varying.map((i) => element("tr", {}, [element("th", { scope: "row" },
    [element("bdi", {}, [block.axes[i].name])]), ...[a, b].map((row) => element("td", { class: "n" },
    [element("bdi", {}, [scores.text(i, row)])])), element("td", { class: "n" },
    [block.at[i][a] === block.at[i][b] ? "same" : "differs"]), ...(block.lines ? [element("td")] : [])]));
  const metrics = rows.map((m) => {
    const [one, two] = [scores.value(m, a), scores.value(m, b)], better = betterOf(scores, m, a, b);
    const marks = (/** @type {number} */ row) => scores.marks(m, row) ? ` (${scores.marks(m, row)})` : "";
    return element("tr", {}, [element("th", { scope: "row" }, [scores.label(m)]),
      cell(short(one) + marks(a), better === "A"), cell(short(two) + marks(b), better === "B"),
      cell(one === null || two === null ? "-" : short(difference(one, two))), ...(block.lines ? [element("td", {
        class: "paired" }, [pairedWords(pairedDifference(pairedLines(block, m, a, b)))])] : [])]);
  });
  const frame = { class: "scroll", tabindex: "0", role: "region", "aria-label": "Differences" };
  return element("div", frame, [element("table", { class: "compare" }, [element("thead", {}, [
    element("tr", {}, [...["", "A", "B", "B \u2212 A"].map((text) => text
      ? element("th", { scope: "col", class: "n" }, [text]) : element("td")), ...(block.lines ? [element("th",
      { scope: "col", class: "paired" }, ["B \u2212 A, line by line"])] : [])])]),
  element("tbody", {}, [...axes, ...metrics])])]);
}
