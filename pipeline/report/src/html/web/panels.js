// @ts-check
"use strict";
// Panels of series with a common time axis: drawing, zoom, values under the cursor.

/**
 * @typedef {{label: string, hue: string, dash: number[], unit: string, x: Float64Array, low: Float64Array,
 *   high: Float64Array | null, band: boolean}} PanelSeries
 * @typedef {{key: string, title: string, unit: string, series: PanelSeries[]}} PanelData
 * @typedef {[number, number]} TimeRange
 */

/** Width of the labels of the vertical axis, px, equal in all panels so that their frames align. */
const AXIS_PX = 74, NARROW_AXIS_PX = 58, NARROW_PX = 480;
/** Largest height of a band in units of the largest value of the lines. */
const BAND_SHARE = 2;
/** Number of samples around the cursor among which a missing value is replaced by the nearest present one. */
const MOST_NEIGHBOURS = 100;
/** A step of more than this many usual steps is a gap. */
const GAP_STEPS = 3.5;
const PANEL_PX = 168, AXIS_FOOT_PX = 34;
/** Steps of time ticks, s. */
const TIME_STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900,
  1800, 3600, 7200, 10_800, 21_600, 43_200, 86_400];

/** A colour with transparency. @param {string} hex @param {number} alpha */
function faded(hex, alpha) {
  const full = hex.length === 4 ? "#" + [...hex.slice(1)].map((c) => c + c).join("") : hex;
  const part = (/** @type {number} */ i) => parseInt(full.slice(i, i + 2), 16);
  return `rgba(${part(1)}, ${part(3)}, ${part(5)}, ${alpha})`;
}

/** Hours, minutes and seconds of seconds past midnight. @param {number} t @param {number} digits */
function clock(t, digits = 0) {
  const unit = 10 ** digits, whole = Math.round(Math.abs(t) * unit), seconds = Math.floor(whole / unit);
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const part = digits ? "." + String(whole % unit).padStart(digits, "0") : "";
  const text = `${two(Math.floor(seconds / 3600))}:${two(Math.floor(seconds / 60) % 60)}:${two(seconds % 60)}${part}`;
  return t < 0 ? "\u2212" + text : text;
}

/** Position of the value nearest to `t`. @param {Float64Array} x @param {number} t */
function nearest(x, t) {
  let [low, high] = [0, x.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] < t) low = middle; else high = middle;
  }
  return Math.abs(x[low] - t) <= Math.abs(x[high] - t) ? low : high;
}

/** @type {WeakMap<Float64Array, number>} */
const KNOWN_STEPS = new WeakMap();

/** Least step of a time axis that is a gap: a multiple of the median step. @param {Float64Array} x */
function gapStep(x) {
  const known = KNOWN_STEPS.get(x);
  if (known !== undefined) return known;
  const some = [], every = Math.max(1, Math.floor(x.length / 2000));
  for (let i = 1; i < x.length; i += every) some.push(x[i] - x[i - 1]);
  some.sort((a, b) => a - b);
  const least = GAP_STEPS * (some[some.length >> 1] ?? Infinity);
  KNOWN_STEPS.set(x, least);
  return least;
}

/** Times inside the gaps of a time axis. @param {Float64Array} x */
function gapsOf(x) {
  const most = gapStep(x), out = [];
  for (let i = 1; i < x.length; i++) if (x[i] - x[i - 1] > most) out.push((x[i] + x[i - 1]) / 2);
  return out;
}

/** Whether two columns are equal. @param {Float64Array} a @param {Float64Array} b */
function sameNumbers(a, b) { return a === b || (a.length === b.length && a.every((t, i) => Object.is(t, b[i]))); }

/**
 * Columns on one time axis. A missing value and a gap are null, and a time of other series only is undefined.
 * @param {{x: Float64Array, y: Float64Array}[]} all @returns {PlotColumn[]}
 */
function aligned(all) {
  const axes = all.reduce((/** @type {Float64Array[]} */ known, { x }) =>
    known.some((k) => sameNumbers(k, x)) ? known : [...known, x], []);
  const gaps = axes.map(gapsOf);
  if (axes.length === 1 && !gaps[0].length) {
    return [axes[0], ...all.map(({ y }) => y.some((v) => Number.isNaN(v))
      ? Array.from(y, (v) => Number.isNaN(v) ? null : v) : y)];
  }
  const times = new Float64Array(axes.reduce((n, x, i) => n + x.length + gaps[i].length, 0));
  let at = 0;
  axes.forEach((x, i) => { times.set(x, at); times.set(gaps[i], at + x.length); at += x.length + gaps[i].length; });
  times.sort();
  const x = times.filter((t, i) => i === 0 || t !== times[i - 1]);
  return [x, ...all.map((one) => {
    const own = gaps[axes.findIndex((k) => sameNumbers(k, one.x))];
    let [i, g] = [0, 0];
    return Array.from(x, (t) => {
      if (one.x[i] === t) { const v = one.y[i++]; return Number.isNaN(v) ? null : v; }
      if (own[g] === t) { g++; return null; }
      return /** @type {any} */ (undefined);
    });
  })];
}

/** Middle of minimum and maximum. @param {PanelSeries} one */
function middles({ low, high }) { return high ? low.map((v, i) => (v + high[i]) / 2) : low; }

class PanelSet {
  /** @param {HTMLElement} home
   * @param {{zoom: (range: TimeRange | null) => void, hover: (t: number | null) => void}} on */
  constructor(home, on) {
    this.home = home;
    this.on = on;
    /** @type {{data: PanelData, plot: PlotInstance, values: HTMLElement[], hidden: Set<number>}[]} */
    this.panels = [];
    /** @type {TimeRange} */
    this.full = [0, 1];
    /** @type {TimeRange} */
    this.range = [0, 1];
    /** @type {number | null} */
    this.at = null;
    this.busy = false;
    /** @type {Map<string, string>} */
    this.colours = new Map();
    this.read = element("p", { class: "read" }, ["\u00a0"]);
    /** Values at the cursor for screen readers. */
    this.spoken = element("output", { class: "unseen" });
    this.list = element("div", { class: "charts" });
    home.append(this.read, this.spoken, this.list);
    new ResizeObserver(() => this.fit()).observe(this.list);
    for (const query of ["(prefers-color-scheme: dark)", "print"]) {
      matchMedia(query).addEventListener("change", () => {
        this.colours.clear();
        this.panels.forEach((p) => p.plot.redraw(false, true));
      });
    }
  }

  /** @param {string} name */
  colour(name) {
    const known = this.colours.get(name) ?? (getComputedStyle(this.home).getPropertyValue(name).trim() || "#777777");
    this.colours.set(name, known);
    return known;
  }

  /** Draws panels. Panels with the same series as before take the new data. @param {PanelData[]} panels
   * @param {TimeRange} full @param {TimeRange} range */
  show(panels, full, range) {
    this.full = full;
    this.range = range;
    const shape = (/** @type {PanelData[]} */ all) => JSON.stringify(all.map((p) => [p.key, p.series.map((s) =>
      [s.label, s.hue, s.band])]));
    if (this.panels.length && shape(panels) === shape(this.panels.map((p) => p.data))) {
      this.panels.forEach((own, i) => {
        own.data = panels[i];
        own.plot.batch(() => {
          own.plot.setData(this.columns(panels[i]), false);
          own.plot.setScale("x", { min: range[0], max: range[1] });
        });
      });
    } else {
      for (const own of this.panels) own.plot.destroy();
      this.list.replaceChildren();
      this.panels = panels.map((data, i) => this.make(data, i === panels.length - 1));
    }
    this.list.dataset.shown = range.map((t) => t.toFixed(3)).join(" ");
    this.hover(this.at);
  }

  /** Columns of a plot: two edges and a line for each series; the edges of a series with all samples are empty, and
   * bands have no line. @param {PanelData} data */
  columns(data) {
    const parts = data.series.flatMap((one) => {
      const { x, low, high } = one, none = high ? null : new Float64Array(x.length).fill(NaN);
      const edges = [{ x, y: none ?? low }, { x, y: none ?? high ?? low }];
      return one.band ? edges : [...edges, { x, y: middles(one) }];
    });
    return aligned(parts);
  }

  /** @param {PanelData} data @param {boolean} last */
  make(data, last) {
    const values = data.series.map(() => element("span", { class: "value" }));
    /** @type {Set<number>} */
    const hidden = new Set();
    const keys = data.series.map((one, k) => element("button", { type: "button", class: "series-key",
      "aria-pressed": "true", title: "Show or hide", onclick: (/** @type {Event} */ event) => {
        if (hidden.has(k)) hidden.delete(k); else hidden.add(k);
        const button = /** @type {HTMLElement} */ (event.currentTarget);
        button.setAttribute("aria-pressed", String(!hidden.has(k)));
        own.plot.batch(() => this.places(data, k).forEach((s) => own.plot.setSeries(s, { show: !hidden.has(k) })));
      } }, [element("span", { class: one.band ? "key area" : "key", "aria-hidden": "true",
      style: one.band ? `background:var(${one.hue})` : `border-color:var(${one.hue})` +
        (one.dash.length ? ";border-top-style:dashed" : "") }), element("bdi", {}, [one.label]), values[k]]));
    const unit = data.unit === "1" ? "" : ` [${data.unit}]`, title = visible(data.title + unit);
    const home = element("div", { class: "chart", tabindex: 0, role: "application", "aria-roledescription": "plot",
      "aria-label": `${title}. Arrow keys read values; plus and minus zoom; Page Up and Page Down move; 0 shows all.`,
      onkeydown: (/** @type {KeyboardEvent} */ event) => this.key(event) });
    const peak = element("button", { type: "button", class: "plain", title: "Go to the largest absolute value in sight",
      "aria-label": `Largest value of ${title}`, onclick: () => this.peak(data) }, ["max |y|"]);
    const figure = element("figure", { class: "panel-figure" }, [element("div", { class: "chart-head" },
      [element("h3", {}, [title]), element("div", { class: "series-keys" }, keys), peak]), home]);
    this.list.append(figure);
    const own = { data, values, hidden, plot: new uPlot(this.options(data, last), this.columns(data), home) };
    home.querySelector("canvas")?.setAttribute("aria-hidden", "true");
    this.listen(home, own.plot);
    return own;
  }

  /** Whether a panel shows thinned series. @param {string} key */
  thinned(key) {
    return this.panels.some(({ data }) => data.key === key && data.series.some((s) => s.high && !s.band));
  }

  /** Positions of the uPlot series of a series. @param {PanelData} data @param {number} k */
  places(data, k) {
    const count = (/** @type {PanelSeries} */ s) => s.band ? 2 : 3;
    const start = 1 + data.series.slice(0, k).reduce((n, s) => n + count(s), 0);
    return Array.from({ length: count(data.series[k]) }, (_, i) => start + i);
  }

  /** @param {PanelData} data @param {boolean} last */
  options(data, last) {
    const ink = (/** @type {string} */ name) => () => this.colour(name);
    /** @type {object[]} */
    const series = [{}], bands = [];
    // Samples are dots where there is room for them.
    const dots = (/** @type {any} */ u) => !this.thinned(data.key) && u.series[0].idxs[1] - u.series[0].idxs[0] <
      u.over.clientWidth / 8;
    // A value between missing values has no line, so that it is always a dot.
    const alone = (/** @type {PlotInstance} */ u, /** @type {number} */ k, /** @type {boolean} */ all) => {
      if (all) return null;
      const y = u.data[k], out = [];
      for (let i = 0; i < y.length; i++) {
        if ((y[i] ?? null) !== null && (y[i - 1] ?? null) === null && (y[i + 1] ?? null) === null) out.push(i);
      }
      return out;
    };
    for (const one of data.series) {
      const fill = () => faded(this.colour(one.hue), one.band ? 0.18 : 0.4);
      bands.push({ series: [series.length + 1, series.length], fill });
      const points = { show: dots, size: 4, filter: alone, stroke: ink(one.hue), fill: ink(one.hue) };
      const edge = { stroke: "transparent", width: 0, pxAlign: 0, auto: !one.band };
      series.push(...[0, 1].map(() => ({ ...edge, points: one.band ? { show: false } : { ...points, show: false } })));
      if (!one.band) series.push({ stroke: ink(one.hue), width: 1.4, dash: one.dash.length ? one.dash : undefined,
        points, pxAlign: 0 });
    }
    const grid = { stroke: ink("--grid"), width: 1 }, ticks = { show: false };
    const font = `12px ${getComputedStyle(this.home).fontFamily}`;
    return {
      width: Math.max(280, this.list.clientWidth - 2), height: PANEL_PX + (last ? AXIS_FOOT_PX : 0),
      legend: { show: false }, series, bands, padding: [8, 30, last ? 0 : 6, 0],
      scales: { x: { time: false, range: () => this.range },
        y: { range: (/** @type {any} */ _, /** @type {number | null} */ low, /** @type {number | null} */ high) =>
          PanelSet.rangeY(...this.withBands(data.key, low, high)) } },
      axes: [
        { grid, ticks, font, stroke: ink("--soft"), size: last ? AXIS_FOOT_PX : 4, incrs: TIME_STEPS, space: 76,
          values: (/** @type {any} */ _, /** @type {number[]} */ at, /** @type {any} */ __, /** @type {any} */ ___,
            /** @type {number} */ step) => last ? at.map((t) => clock(t, step >= 1 ? 0 : step >= 0.1 ? 1 : 3)) : [] },
        { grid, ticks, font, stroke: ink("--soft"), space: 30,
          size: () => this.list.clientWidth < NARROW_PX ? NARROW_AXIS_PX : AXIS_PX,
          values: (/** @type {any} */ _, /** @type {number[]} */ at, /** @type {any} */ __, /** @type {any} */ ___,
            /** @type {number} */ step) => at.map((v) => tickText(v, step)) },
      ],
      cursor: { y: false, drag: { x: true, y: false, setScale: false, dist: 4 }, points: { size: 7, width: 1.5 },
        bind: { dblclick: () => () => { this.zoom(this.full); return null; },
          mousedown: (/** @type {any} */ _, /** @type {any} */ __, /** @type {(e: MouseEvent) => void} */ next) =>
            (/** @type {MouseEvent} */ event) => { if (!event.shiftKey) next(event); return null; } } },
      hooks: {
        draw: [(/** @type {PlotInstance} */ u) => {
          const { min, max } = u.scales.y;
          u.root.parentElement?.setAttribute("data-y", `${min} ${max}`);
        }],
        setSelect: [(/** @type {PlotInstance} */ u) => {
          if (u.select.width < 4) return;
          const [from, to] = [u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")];
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          this.zoom([from, to]);
        }],
        setCursor: [(/** @type {PlotInstance} */ u) => {
          if (this.busy) return;
          const { left } = u.cursor;
          this.hover(left === undefined || left < 0 ? null : u.posToVal(left, "x"), u);
        }],
      },
    };
  }

  /** Extent of the lines in sight, widened by the bands up to a multiple of it, so that a wide band never hides a line.
   * @param {string} key @param {number | null} low @param {number | null} high
   * @returns {[number | null, number | null]} */
  withBands(key, low, high) {
    const bands = this.panels.find((p) => p.data.key === key)?.data.series.filter((s) => s.band) ?? [];
    let most = 0;
    for (const one of bands) {
      const seen = inSight(one, this.range);
      most = (seen.high ?? seen.low).reduce((m, v) => Number.isFinite(v) ? Math.max(m, Math.abs(v)) : m, most);
    }
    if (low === null || high === null) return bands.length ? [-most, most] : [low, high];
    const limit = Math.min(most, BAND_SHARE * Math.max(Math.abs(low), Math.abs(high)));
    return bands.length ? [Math.min(low, -limit), Math.max(high, limit)] : [low, high];
  }

  /** Range of the vertical axis: the values in sight with a margin.
   * @param {number | null} low @param {number | null} high @returns {[number, number]} */
  static rangeY(low, high) {
    if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
    const pad = high > low ? 0.06 * (high - low) : Math.max(1e-9, 1e-4 * Math.abs(high));
    return [low - pad, high + pad];
  }

  /** Shows a part of the time axis in all panels. @param {TimeRange} range */
  zoom([from, to]) {
    const [first, last] = this.full, all = last - first || 1;
    const width = Math.min(all, Math.max(Math.min(all, 0.05), to - from));
    const start = Math.min(last - width, Math.max(first, from));
    this.range = [start, start + width];
    for (const { plot } of this.panels) plot.setScale("x", { min: start, max: start + width });
    this.list.dataset.shown = this.range.map((t) => t.toFixed(3)).join(" ");
    this.on.zoom(width >= all * 0.999 ? null : this.range);
  }

  /** @param {number} factor @param {number} [around] */
  scale(factor, around = this.at ?? (this.range[0] + this.range[1]) / 2) {
    this.zoom([around - (around - this.range[0]) * factor, around + (this.range[1] - around) * factor]);
  }

  /** @param {number} by Share of the part in sight. */
  move(by) {
    const wide = this.range[1] - this.range[0];
    this.zoom([this.range[0] + by * wide, this.range[1] + by * wide]);
  }

  /** Values at a time in all panels. @param {number | null} t @param {PlotInstance} [source] */
  hover(t, source) {
    this.at = t;
    this.busy = true;
    for (const { data, plot, values } of this.panels) {
      const left = t === null ? -10 : plot.valToPos(t, "x");
      if (plot !== source) plot.setCursor({ left, top: t === null ? -10 : 1 });
      data.series.forEach((one, k) => { values[k].textContent = t === null ? "" : valueText(one, t); });
    }
    this.busy = false;
    this.read.textContent = t === null ? "\u00a0" : `${clock(t, 2)} UTC, tt = ${t.toFixed(2)} s`;
    this.on.hover(t);
  }

  /** The cursor at the largest absolute value in sight of the first shown series. @param {PanelData} data */
  peak(data) {
    const one = data.series.find((s) => !s.band);
    if (!one) return;
    let [found, most] = [-1, -Infinity];
    one.x.forEach((t, i) => {
      const size = Math.max(Math.abs(one.low[i]), Math.abs(one.high?.[i] ?? one.low[i]));
      if (t >= this.range[0] && t <= this.range[1] && size > most) [found, most] = [i, size];
    });
    if (found >= 0) this.hover(one.x[found]);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const wide = this.range[1] - this.range[0], at = this.at ?? (this.range[0] + this.range[1]) / 2;
    const step = (/** @type {number} */ by) => {
      const t = Math.min(this.range[1], Math.max(this.range[0], at + by * wide));
      this.hover(t);
      const words = this.panels.map(({ data }) => `${data.title}: ` + data.series.map((s) =>
        `${s.label} ${valueText(s, t)}`).join(", "));
      this.spoken.textContent = [`${clock(t, 2)} UTC, tt = ${t.toFixed(2)} s`, ...words].join("; ");
    };
    const fine = event.shiftKey ? 0.1 : 0.01;
    const acts = { "+": () => this.scale(0.6), "=": () => this.scale(0.6), "-": () => this.scale(1 / 0.6),
      "0": () => this.zoom(this.full), Escape: () => this.zoom(this.full), PageUp: () => this.move(-0.5),
      PageDown: () => this.move(0.5), ArrowLeft: () => step(-fine), ArrowRight: () => step(fine),
      Home: () => step(-1), End: () => step(1) };
    const act = acts[/** @type {keyof typeof acts} */ (event.key)];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  }

  /** Wheel zoom and drag with Shift. @param {HTMLElement} home @param {PlotInstance} plot */
  listen(home, plot) {
    home.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !home.contains(document.activeElement)) return;
      event.preventDefault();
      const box = plot.over.getBoundingClientRect();
      this.scale(event.deltaY < 0 ? 0.8 : 1.25, plot.posToVal(event.clientX - box.left, "x"));
    }, { passive: false });
    /** @type {{x: number, range: TimeRange} | null} */
    let start = null;
    plot.over.addEventListener("pointerdown", (event) => {
      home.focus({ preventScroll: true });
      if (!event.shiftKey) return;
      start = { x: event.clientX, range: this.range };
      plot.over.setPointerCapture(event.pointerId);
    });
    plot.over.addEventListener("pointermove", (event) => {
      if (!start) return;
      const by = (start.x - event.clientX) / plot.over.clientWidth * (start.range[1] - start.range[0]);
      this.zoom([start.range[0] + by, start.range[1] + by]);
    });
    plot.over.addEventListener("pointerup", () => { start = null; });
  }

  fit() {
    const width = Math.max(280, this.list.clientWidth - 2);
    this.panels.forEach(({ plot }) => { if (plot.width !== width) plot.setSize({ width, height: plot.height }); });
  }
}

/** Text of a tick. @param {number} v @param {number} step */
function tickText(v, step) {
  if (v !== 0 && (Math.abs(v) >= 1e7 || step < 1e-7)) return v.toExponential(2).replace("-", "\u2212");
  const digits = Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const text = v.toFixed(digits);
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "\u2212");
}

/** A value with thousandths; a position in degrees with digits to 0.1 m.
 * @param {number} v @param {boolean} place */
function digitsOf(v, place) {
  if (!Number.isFinite(v)) return "missing";
  if (place) return v.toFixed(6).replace("-", "\u2212");
  const size = Math.abs(v);
  return (size >= 1e6 || (size > 0 && size < 1e-3) ? v.toExponential(3) : v.toFixed(size >= 1000 ? 2 : 3))
    .replace("-", "\u2212");
}

/** Position of the present value nearest to a position, among a few neighbours. @param {Float64Array} values
 * @param {number} i */
function presentNear(values, i) {
  for (let k = 0; k <= MOST_NEIGHBOURS; k++) {
    if (Number.isFinite(values[i - k])) return i - k;
    if (Number.isFinite(values[i + k])) return i + k;
  }
  return i;
}

/** Value of a series at a time, with its unit; of a sparse series, the nearest value and its distance.
 * @param {PanelSeries} one @param {number} t */
function valueText({ x, low, high, unit, band, label }, t) {
  if (!x.length) return "no data";
  const at = nearest(x, t);
  if (Math.abs(x[at] - t) > gapStep(x)) return "no data";
  const i = presentNear(low, at), sign = x[i] < x[at] ? "\u2212" : "+";
  const far = i === at ? "" : ` (${sign}${short(Math.abs(x[i] - t))} s)`;
  const words = (unit === "1" ? "" : " " + unit) + far;
  if (band) return `\u00b1${digitsOf(Math.abs((high ?? low)[i]), false)}${words}`;
  const degrees = unit === "deg" && /lat|lon/.test(label);
  const [a, b] = [digitsOf(low[i], degrees), digitsOf((high ?? low)[i], degrees)];
  return (a === b ? a : `${a} to ${b}`) + words;
}
