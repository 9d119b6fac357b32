// @ts-check
"use strict";
// Amplitude spectral densities of the chosen columns over the interval in sight.

/**
 * @typedef {{name: string, unit: string, density: number[], segments: number, left_out: number, why: string | null}}
 *   SpectrumColumn
 * @typedef {{rate_hz: number, segment: number, rows: number, frequency: number[], columns: SpectrumColumn[]}} Spectrum
 * @typedef {{label: string, hue: string, dash: number[], unit: string, frequency: number[], density: number[]}}
 *   SpectrumLine
 */

const SPECTRUM_PX = 330, LARGEST_SEGMENT = 12, STEP_SHARE = 0.01, GAP_SHARE = 1.5;

/** Transform of a sequence whose length is a power of two, in place.
 * @param {Float64Array} re @param {Float64Array} im */
function transform(re, im) {
  const n = re.length;
  for (let i = 1, k = 0; i < n; i++) {
    let bit = n >> 1;
    for (; k & bit; bit >>= 1) k ^= bit;
    k ^= bit;
    if (i < k) [re[i], re[k], im[i], im[k]] = [re[k], re[i], im[k], im[i]];
  }
  for (let size = 2; size <= n; size *= 2) {
    const half = size / 2;
    for (let k = 0; k < half; k++) {
      const [c, s] = [Math.cos(2 * Math.PI * k / size), -Math.sin(2 * Math.PI * k / size)];
      for (let at = k; at < n; at += size) {
        const to = at + half, [x, y] = [re[to] * c - im[to] * s, re[to] * s + im[to] * c];
        [re[to], im[to], re[at], im[at]] = [re[at] - x, im[at] - y, re[at] + x, im[at] + y];
      }
    }
  }
}

/**
 * One-sided power spectral density by Welch's method: periodic Hann taper, half overlap, the mean of each segment
 * subtracted. Segments with a missing sample are left out. The length of a segment is a power of two.
 * @param {ArrayLike<number>} values @param {number} rate Hz @param {number} segment
 */
function welchDensity(values, rate, segment) {
  const taper = Array.from({ length: segment }, (_, k) => 0.5 - 0.5 * Math.cos(2 * Math.PI * k / segment));
  const density = new Array(segment / 2 + 1).fill(0), power = taper.reduce((sum, w) => sum + w * w, 0);
  const [re, im] = [new Float64Array(segment), new Float64Array(segment)];
  let segments = 0, leftOut = 0;
  for (let start = 0; start + segment <= values.length; start += segment / 2) {
    let mean = 0;
    for (let k = 0; k < segment; k++) mean += values[start + k] / segment;
    if (!Number.isFinite(mean)) { leftOut++; continue; }
    for (let k = 0; k < segment; k++) { re[k] = (values[start + k] - mean) * taper[k]; im[k] = 0; }
    transform(re, im);
    for (let k = 0; k < density.length; k++) density[k] += re[k] * re[k] + im[k] * im[k];
    segments++;
  }
  const scale = (/** @type {number} */ k) => (k === 0 || 2 * k === segment ? 1 : 2) / (rate * power * segments);
  return { density: density.map((d, k) => d * scale(k)), segments, leftOut };
}

/** Sample rate of evenly spaced times, Hz, or a reason why there is none. @param {Float64Array} x */
function sampleRate(x) {
  const steps = Array.from({ length: Math.max(0, x.length - 1) }, (_, i) => x[i + 1] - x[i]);
  const step = [...steps].sort((a, b) => a - b)[(steps.length - 1) >> 1];
  if (!(step > 0) || steps.some((s) => !(s > 0))) return "the times do not increase";
  const odd = steps.some((s) => Math.abs(s - step) > STEP_SHARE * step + 1e-9 && s < GAP_SHARE * step);
  const rate = 1 / step, round = Math.round(rate * 1000) / 1000;
  return odd ? "the samples are not evenly spaced" : Math.abs(rate - round) <= 1e-6 * rate ? round : rate;
}

/** Spectrum of a series that holds all samples. @param {SeriesAnswer} answer @param {string[]} names
 * @param {TimeRange | null} range @param {(name: string) => string} unit @returns {Spectrum} */
function spectrumOf({ x, columns }, names, range, unit) {
  const keep = Array.from(x, (_, i) => i).filter((i) => !range || (x[i] >= range[0] && x[i] <= range[1]));
  const times = Float64Array.from(keep, (i) => x[i]), rate = sampleRate(times);
  if (typeof rate === "string") throw new SourceError(`This part of the line has no spectrum: ${rate}.`, 400);
  const segment = 2 ** Math.min(LARGEST_SEGMENT, Math.floor(Math.log2(Math.max(2, Math.floor(times.length / 4)))));
  const frequency = Array.from({ length: segment / 2 }, (_, k) => (k + 1) * rate / segment);
  return { rate_hz: rate, segment, rows: times.length, frequency, columns: names.map((name) => {
    const all = columns.get(name)?.low ?? new Float64Array();
    /** @type {number[]} */
    const values = [];
    // A missing sample in each gap, so that no segment spans a gap.
    keep.forEach((i, k) => {
      if (k > 0 && (times[k] - times[k - 1]) * rate >= GAP_SHARE) values.push(NaN);
      values.push(all[i]);
    });
    const finite = values.filter(Number.isFinite), about = { name, unit: unit(name), left_out: 0, segments: 0 };
    if (finite.every((v) => v === finite[0])) return { ...about, density: [], why: "the column does not vary" };
    const { density, segments, leftOut } = welchDensity(values, rate, segment);
    const made = { ...about, segments, left_out: leftOut };
    return segments ? { ...made, density: density.slice(1).map(Math.sqrt), why: null }
      : { ...made, density: [], why: `no ${segment} consecutive samples are present` };
  }) };
}

/** Name of the unit of a density. @param {string} unit */
function densityUnit(unit) { return unit && unit !== "1" ? `${unit}/\u221aHz` : "1/\u221aHz"; }

class SpectrumView {
  /** @param {HTMLElement} home @param {ServerSource | EmbeddedSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.status = element("p", { class: "note spectra-note", "aria-live": "polite" });
    this.figures = element("div", { class: "spectra" });
    home.append(element("h3", {}, ["Spectra"]), this.status, this.figures);
  }

  /** @param {TableInfo} table @param {string[]} columns @param {LinePlace} place @param {TimeRange | null} range
   * @param {AbortSignal} signal @returns {Promise<Spectrum>} */
  async ask(table, columns, place, range, signal) {
    const { source } = this;
    if (source instanceof ServerSource) return source.spectrum({ table, columns, place, range, pixels: 1, signal });
    const answer = await source.series({ table, columns, place, range, pixels: 1 });
    if (answer.thinned) {
      throw new SourceError("This page holds a thinned series, which has no spectrum. `magline view` shows the " +
        "spectrum of all samples.", 400);
    }
    return spectrumOf(answer, columns, range,
      (name) => table.columns.find((c) => c.name === name)?.unit ?? "");
  }

  /** Draws the spectra of columns at one or two points. @param {PipelineInfo} pipeline @param {LinePlace[]} places
   * @param {ColumnChoice[]} chosen @param {(c: ColumnChoice) => ColumnInfo | undefined} info
   * @param {TimeRange | null} range @param {AbortSignal} signal */
  async load(pipeline, places, chosen, info, range, signal) {
    /** @type {SpectrumLine[]} */
    const lines = [];
    /** @type {Set<string>} */
    const notes = new Set();
    let hue = 0;
    for (const table of pipeline.tables) {
      const columns = [...new Set(chosen.filter((c) => c.table === table.name).map((c) => c.column))];
      if (!columns.length) continue;
      const first = hue;
      for (const [k, place] of places.entries()) {
        /** @type {Spectrum} */
        let found;
        try { found = await this.ask(table, columns, place, range, signal); } catch (error) {
          if (signal.aborted) return;
          notes.add(error instanceof Error ? error.message : "The spectra cannot be computed.");
          continue;
        }
        if (signal.aborted) return;
        hue = first;
        for (const { name, unit, density, why, left_out: out, segments } of found.columns) {
          const style = columnStyle(info({ table: table.name, column: name }), hue++);
          const label = name + (places.length > 1 ? [" (A)", " (B)"][k] : "");
          if (why) { notes.add(`${label}: ${why}.`); continue; }
          if (out) notes.add(`${label}: ${out} of ${out + segments} segments contain a gap and are left out.`);
          lines.push({ label: visible(label), hue: style.hue, dash: k ? [6, 4] : style.dash, unit,
            frequency: found.frequency, density });
        }
        notes.add(`Welch's method on ${found.rows} samples at ${short(found.rate_hz)} Hz: Hann window, segments of ` +
          `${found.segment} samples (${short(found.segment / found.rate_hz)} s), half overlap.`);
      }
    }
    this.status.textContent = [...notes].map(visible).join(" ") || "Choose a column.";
    const units = [...new Set(lines.map((l) => l.unit))];
    this.figures.replaceChildren(...units.map((unit) => this.figure(lines.filter((l) => l.unit === unit), unit,
      `${pipeline.name}, flight ${places[0].flight}, line ${places[0].line}` + (range ? `, tt from ` +
      `${range[0].toFixed(2)} to ${range[1].toFixed(2)} s` : ""))));
  }

  /** @param {SpectrumLine[]} lines @param {string} unit @param {string} place */
  figure(lines, unit, place) {
    const width = Math.max(300, this.home.clientWidth - 30), left = 74, right = 14, high = SPECTRUM_PX;
    const positive = lines.flatMap((l) => l.density.filter((d) => d > 0));
    const x = new PlotScale(lines.flatMap((l) => [l.frequency[0], l.frequency[l.frequency.length - 1]]), left,
      width - right);
    const y = new PlotScale(positive, high - 44, 12), drawn = shape("g");
    /** @type {PlotTarget[]} */
    const targets = [];
    for (const { label, hue, dash, frequency, density } of lines) {
      let path = "", pen = false;
      density.forEach((d, k) => {
        if (!(d > 0)) { pen = false; return; }
        const [px, py] = [x.at(frequency[k]), y.at(d)];
        path += `${pen ? "L" : "M"}${px.toFixed(1)} ${py.toFixed(1)}`;
        pen = true;
        targets.push({ x: px, y: py, row: -1, text: `${label}: ${short(d)} ${densityUnit(unit)} at ` +
          `${short(frequency[k])} Hz (period ${short(1 / frequency[k])} s)` });
      });
      drawn.append(shape("path", { class: "spectrum", d: path, style: `stroke:var(${hue})`,
        ...(dash.length ? { "stroke-dasharray": dash.join(" ") } : {}) }));
    }
    const { svg, read } = livePlot({ label: `Amplitude spectral density in ${densityUnit(unit)}`, width, height: high,
      targets, choose: () => {} });
    svg.append(plotFrame(x, y, "frequency, Hz", `density, ${densityUnit(unit)}`), drawn);
    const legend = element("div", { class: "legend" }, lines.map(({ label, hue, dash }) => element("span", {}, [
      element("span", { class: "key", style: `border-color:var(${hue})` + (dash.length ? ";border-top-style:dashed"
        : "") }), element("bdi", {}, [label])])));
    const csv = () => [csvRow(["series", "frequency [Hz]", `density [${densityUnit(unit)}]`]),
      ...lines.flatMap((l) => l.density.map((d, k) => csvRow([l.label, l.frequency[k], d])))].join("\n") + "\n";
    return element("figure", { class: "live" }, [legend, svg, read, element("figcaption", {},
      [`Amplitude spectral density: root of the one-sided power spectral density in ` +
        `${unit && unit !== "1" ? unit : "1"}\u00b2/Hz. ${visible(place)}.`]), downloads(svg, "spectra", csv)]);
  }
}
