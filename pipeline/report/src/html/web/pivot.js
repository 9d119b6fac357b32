// @ts-check
"use strict";
// The pivot of the scores: one axis down, one across, and a metric in the cells.

const MOST_PIVOT_CELLS = 10_000, PIVOT_LETTERS = 28;

/** Axis down and axis across of a pivot; -1 for no axis. @param {ScoreSet} scores @param {ExplorerState} state */
function pivotAxes(scores, state) {
  const [down, across] = [scores.axis(state.y), scores.axis(state.x)];
  return down < 0 || down === across ? [across, -1] : [down, across];
}

/** A heading of a pivot. @param {ScoreSet} scores @param {number} a @param {number} code @param {string} scope */
function pivotHead(scores, a, code, scope) {
  if (a < 0) return element("th", { scope }, ["value"]);
  return element("th", { scope, title: visible(scores.block.axes[a].values[code]) }, [element("bdi", {},
    [cut(scores.texts[a][code], PIVOT_LETTERS)])]);
}

/** A cell of a pivot. @param {ViewInput} input @param {number | undefined} row @param {number} best */
function pivotCell({ scores, state, metric, choose }, row, best) {
  if (row === undefined || row < 0) return element("td", { class: "n" }, ["-"]);
  const marks = scores.marks(metric, row), value = scores.value(metric, row);
  const text = short(value) + (scores.inSample[metric].has(row) ? " ~" : "") + (scores.block.flagged[row] ? " !" : "");
  const words = `${scores.words(metric, value)} at ${scores.point(row)}${marks ? ` (${marks})` : ""}` +
    (row === best ? ", the best value" : "");
  return element("td", { class: row === best ? "n best" : "n", "data-v": value }, [element("button", { type: "button",
    "aria-pressed": String(state.point === String(row)), title: words, "aria-label": words,
    onclick: (/** @type {MouseEvent} */ event) => choose(row, event.shiftKey) }, [text])]);
}

/** The pivot as CSV. A column of marks follows each column that has marks.
 * @param {ScoreSet} scores @param {number} metric @param {{axes: number[], down: number[], across: number[],
 *   at: (i: number, k: number) => number | undefined}} table */
function pivotCsv(scores, metric, { axes: [a, b], down, across, at }) {
  const { axes } = scores.block, label = scores.label(metric);
  const name = (/** @type {number} */ k) => b < 0 ? label : `${label} at ${axes[b].name} = ${axes[b].values[k]}`;
  const marks = (/** @type {number} */ i, /** @type {number} */ k) => {
    const row = at(i, k);
    return row === undefined || row < 0 ? "" : scores.marks(metric, row);
  };
  const marked = across.map((k) => down.some((i) => marks(i, k) !== ""));
  const head = across.flatMap((k, c) => marked[c] ? [name(k), `marks of ${name(k)}`] : [name(k)]);
  return [csvRow([axes[a].name, ...head]), ...down.map((i) => csvRow([axes[a].values[i], ...across.flatMap((k, c) => {
    const row = at(i, k), value = row === undefined || row < 0 ? null : scores.value(metric, row);
    return marked[c] ? [value, marks(i, k)] : [value];
  })]))].join("\n") + "\n";
}

/** The pivot as a table with its caption and download. @param {ViewInput} input @param {string} name
 * @returns {HTMLElement[]} */
function pivotView(input, name) {
  const { scores, state, rows, metric } = input, [a, b] = pivotAxes(scores, state), { axes } = scores.block;
  const note = (/** @type {string} */ text) => [element("p", { class: "note" }, [text])];
  if (a < 0) return note("A pivot needs an axis with several values.");
  const down = valuesOf(scores, a, rows), across = b < 0 ? [0] : valuesOf(scores, b, rows);
  if (down.length * across.length > MOST_PIVOT_CELLS) return note("Too many cells: filter one of the axes first.");
  const cells = pivot(input, a, b), at = (/** @type {number} */ i, /** @type {number} */ k) => cells.get(i + " " + k);
  const ideal = scores.best(metric, rows);
  const best = ideal >= 0 && rows.length > 1 && !scores.excluded(metric, ideal) ? ideal : -1;
  const corner = element("th", { scope: "col" }, [element("bdi", {}, [visible(axes[a].name)])]);
  const over = b < 0 ? [] : [element("tr", {}, [element("td"), element("th", { scope: "colgroup",
    colspan: across.length, class: "over" }, [element("bdi", {}, [visible(axes[b].name)])])])];
  const table = element("table", { class: "pivot", "aria-label": `Pivot of ${scores.label(metric)}` }, [
    element("thead", {}, [...over, element("tr", {}, [corner, ...across.map((k) => pivotHead(scores, b, k, "col"))])]),
    element("tbody", {}, down.map((i) => element("tr", {}, [pivotHead(scores, a, i, "row"),
      ...across.map((k) => pivotCell(input, at(i, k), best))])))]);
  const csv = () => pivotCsv(scores, metric, { axes: [a, b], down, across, at });
  return [element("div", { class: "frame-scroll", tabindex: 0, role: "region",
    "aria-label": `Pivot: ${visible(scores.block.table)}`, style: "max-height:460px" }, [table]),
  element("p", { class: "note" }, [`${scores.label(metric)} of the best point over the other axes that the filters ` +
    "keep. The best value is marked; a value in sample (~) or flagged (!) is never the best."]),
  downloads(null, name, csv)];
}
