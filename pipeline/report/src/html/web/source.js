// @ts-check
"use strict";
// Sources of series: the server of `magline view`, or the blocks of a report.

/**
 * @typedef {Record<string, string>} SweepPoint
 * @typedef {{name: string, unit: string, role: string, description: string, series: boolean, length?: number,
 *   terms?: string[], term?: string}} ColumnInfo `terms` are the names of a list's elements, `term` is the name of one.
 * @typedef {{table: string, name: string, stage: string, kind: string, axes: string[], rows: number | null,
 *   inputs: string[], columns: ColumnInfo[]}} TableInfo
 * @typedef {{table: string, name: string, kind: string}} SourceInfo
 * @typedef {{name: string, axes: ScoreAxis[], tables: TableInfo[], sources: SourceInfo[]}} PipelineInfo
 * @typedef {{flight: string, line: string, rows: number, why?: string[]}} LineInfo
 * @typedef {{pipeline: string, point: SweepPoint, flight: string, line: string}} LinePlace
 * @typedef {{unit: string, role: string, description: string, low: Float64Array, high: Float64Array | null,
 *   first: Float64Array | null}} SeriesColumn
 * @typedef {{x: Float64Array, thinned: boolean, rows: number, first: number, last: number,
 *   columns: Map<string, SeriesColumn>}} SeriesAnswer
 * @typedef {{id: string, table: string, kind: string, stage: string, flight: string, line: string, point: SweepPoint,
 *   why: string[], rows: number, thinned: boolean, first: number, last: number, columns: (Omit<ColumnInfo, "series"> &
 *   {resolution: number})[]}} SeriesBlock
 * @typedef {{table: TableInfo, place: LinePlace, columns: string[], range: [number, number] | null, pixels: number,
 *   signal?: AbortSignal}} SeriesRequest
 * @typedef {{width: number, height: number, west: number, east: number, south: number, north: number, unit: string,
 *   least: number, most: number, of: [number, number], thinned: boolean, has_error?: boolean, cells: Float32Array}}
 *   MapImage
 */

/** An error with the answer's remedy. */
class SourceError extends Error {
  /** @param {string} message @param {number} status */
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/** Numbers of a column; a missing value is NaN. @param {ArrowColumn} column @param {number} offset */
function numbersOf(column, offset) {
  const values = column.toArray();
  if (offset === 0 && column.nullCount === 0 && values instanceof Float64Array) return values;
  const out = new Float64Array(values.length);
  for (let i = 0; i < out.length; i++) {
    const value = values[i];
    out[i] = value === null ? NaN : offset + Number(value);
  }
  return out;
}

/** Series from one Arrow IPC stream. @param {Uint8Array} bytes @returns {SeriesAnswer} */
function readSeries(bytes) {
  const table = fl.tableFromIPC(bytes), { fields, metadata } = table.schema;
  /** @type {Map<string, SeriesColumn>} */
  const columns = new Map();
  /** @type {Float64Array[]} */
  const times = [];
  fields.forEach((field, i) => {
    const of = (/** @type {string} */ key) => field.metadata?.get(key) ?? "";
    const part = of("part"), name = of("column"), values = () => numbersOf(table.getChildAt(i), Number(of("offset")));
    if (part === "time") times.push(values());
    if (!name || !["value", "min", "max", "first"].includes(part)) return;
    const own = columns.get(name) ?? { unit: of("unit"), role: of("role"), description: of("description"),
      low: new Float64Array(), high: null, first: null };
    if (part === "max") own.high = values(); else if (part === "first") own.first = values(); else own.low = values();
    columns.set(name, own);
  });
  const [from, to] = times, x = to ? from.map((t, i) => (t + to[i]) / 2) : from ?? new Float64Array();
  const number = (/** @type {string} */ key, /** @type {number} */ other) => {
    const text = metadata?.get(key);
    return text === undefined || text === "" ? other : Number(text);
  };
  return { x, columns, thinned: metadata?.get("thinned") === "true", rows: number("rows", x.length),
    first: number("first", x[0]), last: number("last", x[x.length - 1]) };
}

/** Bytes of base64 text. @param {string} text */
function bytesOf(text) {
  const raw = atob(text.trim()), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}

/** The axis values of a point that a table has. @param {TableInfo} table @param {SweepPoint} point */
function pointOf(table, point) {
  return Object.fromEntries(Object.entries(point).filter(([axis]) => table.axes.includes(axis)));
}

/** Equality of axis values: numbers by value, other texts by character. @param {string} a @param {string} b */
function sameValue(a, b) {
  return a === b || (a.trim() !== "" && b.trim() !== "" && Number(a) === Number(b));
}

/** The server. */
class ServerSource {
  /** @param {string} base */
  constructor(base) {
    this.base = base;
    this.live = true;
    /** @type {Map<string, Promise<any>>} */
    this.known = new Map();
  }

  /** @param {string} path @param {Record<string, string>} [query] */
  address(path, query = {}) {
    const text = new URLSearchParams(query).toString();
    return path + (text ? "?" + text : "");
  }

  /** @param {string} address @param {AbortSignal} [signal] @returns {Promise<Response>} */
  async get(address, signal) {
    for (let attempt = 0; ; attempt++) {
      const answer = await fetch(address, { signal });
      if (answer.ok) return answer;
      if (answer.status === 503 && attempt < 3) {
        await new Promise((done) => setTimeout(done, 1000));
        continue;
      }
      const said = await answer.json().catch(() => ({}));
      throw new SourceError([said.error ?? `status ${answer.status}`, said.help].filter(Boolean).join("; "),
        answer.status);
    }
  }

  /** JSON of an address, kept until `forget`. @param {string} address @returns {Promise<any>} */
  json(address) {
    const known = this.known.get(address) ?? this.get(address).then((answer) => answer.json());
    this.known.set(address, known);
    known.catch(() => this.known.delete(address));
    return known;
  }

  forget() { this.known.clear(); }

  /** @returns {Promise<PipelineInfo[]>} */
  async pipelines() {
    const all = await this.json(this.base + "catalogue");
    const own = (/** @type {PipelineInfo} */ p) => Number(p.name !== all.pipeline);
    return all.pipelines.sort((/** @type {PipelineInfo} */ a, /** @type {PipelineInfo} */ b) => own(a) - own(b));
  }

  /** @param {TableInfo} table @param {SweepPoint} point @returns {Promise<LineInfo[]>} */
  async lines(table, point) {
    const axes = Object.entries(pointOf(table, point)).map(([axis, value]) => ["axis." + axis, value]);
    const address = this.address(this.base + "lines", { table: table.table, ...Object.fromEntries(axes) });
    return (await this.json(address)).lines;
  }

  /** @param {SeriesRequest} request @returns {Promise<SeriesAnswer>} */
  async series({ table, place, columns, range, pixels, signal }) {
    const query = new URLSearchParams({ table: table.table, flight: place.flight, line: place.line });
    for (const name of columns) query.append("column", name);
    for (const [axis, value] of Object.entries(pointOf(table, place.point))) query.set("axis." + axis, value);
    if (range) {
      query.set("from", String(range[0]));
      query.set("to", String(range[1]));
    }
    query.set("pixels", String(Math.round(pixels)));
    const answer = await this.get(this.base + "series?" + query, signal);
    return readSeries(new Uint8Array(await answer.arrayBuffer()));
  }

  /** Spectra of all samples in a range. @param {SeriesRequest} request @returns {Promise<Spectrum>} */
  async spectrum({ table, place, columns, range, signal }) {
    const query = new URLSearchParams({ table: table.table, flight: place.flight, line: place.line });
    for (const name of columns) query.append("column", name);
    for (const [axis, value] of Object.entries(pointOf(table, place.point))) query.set("axis." + axis, value);
    if (range) {
      query.set("from", String(range[0]));
      query.set("to", String(range[1]));
    }
    return (await this.get(this.base + "spectrum?" + query, signal)).json();
  }

  /** A map along a line. @param {string} table @param {Position} from @param {Position} to @param {SweepPoint} [point]
   * @returns {Promise<MapProfile>} */
  async profile(table, from, to, point = {}) {
    const axes = Object.entries(point).map(([axis, value]) => ["axis." + axis, value]);
    const query = { table, from: from.join(","), to: to.join(","), ...Object.fromEntries(axes) };
    return (await this.get(this.address(this.base + "profile", query))).json();
  }

  /** A map of files, or of a stage at a point. @param {string} table @param {SweepPoint} [point]
   * @param {"anomaly" | "error"} [band] @returns {Promise<MapImage>} */
  async map(table, point = {}, band = "anomaly") {
    const axes = Object.entries(point).map(([axis, value]) => ["axis." + axis, value]);
    const query = { table, ...(band === "error" ? { band } : {}), ...Object.fromEntries(axes) };
    const found = await this.json(this.address(this.base + "map", query));
    return { ...found, cells: new Float32Array(bytesOf(found.values).buffer) };
  }

  /** Address of a table as a file. @param {string} table @param {string} format */
  download(table, format) { return this.address("download", { table, format }); }
}

/** The blocks of a report. */
class EmbeddedSource {
  /** @param {{blocks: SeriesBlock[], omitted: string[]}} index @param {string} pipeline */
  constructor({ blocks, omitted }, pipeline) {
    this.blocks = blocks;
    this.omitted = omitted;
    this.pipeline = pipeline;
    this.live = false;
    /** @type {Map<string, Promise<SeriesAnswer>>} */
    this.read = new Map();
  }

  /** @returns {Promise<PipelineInfo[]>} */
  async pipelines() {
    /** @type {Map<string, TableInfo>} */
    const tables = new Map();
    /** @type {Map<string, Set<string>>} */
    const axes = new Map();
    for (const { table, stage, kind, point, columns, rows } of this.blocks) {
      const own = tables.get(table) ?? { table, name: table, stage, kind, axes: Object.keys(point), rows, inputs: [],
        columns: [] };
      for (const column of columns) {
        if (!own.columns.some((c) => c.name === column.name)) own.columns.push({ ...column, series: true });
      }
      tables.set(table, own);
      for (const [axis, value] of Object.entries(point)) {
        axes.set(axis, (axes.get(axis) ?? new Set()).add(value));
      }
    }
    const listed = [...axes].map(([name, values]) => ({ name, values: [...values],
      numeric: [...values].every((v) => v.trim() !== "" && Number.isFinite(Number(v))) }));
    return [{ name: this.pipeline, axes: listed, tables: [...tables.values()], sources: [] }];
  }

  /** The points of the blocks, each in the words of the axes that differ. */
  points() {
    /** @type {Map<string, SweepPoint>} */
    const known = new Map();
    for (const { point } of this.blocks) known.set(JSON.stringify(Object.entries(point).sort()), point);
    const all = [...known.values()], names = [...new Set(all.flatMap((p) => Object.keys(p)))]
      .filter((name) => new Set(all.map((p) => p[name])).size > 1);
    return all.map((point) => ({ point, words: names.map((name) => `${name} = ${visible(point[name] ?? "-")}`)
      .join(", ").slice(0, 120) }));
  }

  /** The blocks at a point. @param {SweepPoint} point */
  at(point) {
    return this.blocks.filter((b) => Object.entries(b.point).every(([axis, value]) =>
      point[axis] === undefined || sameValue(point[axis], value)));
  }

  /** @param {TableInfo} table @param {SweepPoint} point @returns {Promise<LineInfo[]>} */
  async lines(table, point) {
    return this.at(point).filter((b) => b.table === table.name)
      .map(({ flight, line, rows, why }) => ({ flight, line, rows, why }));
  }

  /** @param {SeriesRequest} request @returns {Promise<SeriesAnswer>} */
  async series({ table, place, columns }) {
    const { flight, line } = place;
    const block = this.at(place.point).find((b) => b.table === table.name && b.flight === flight && b.line === line);
    if (!block) throw new SourceError("The page has no series of this line at this point.", 404);
    const known = this.read.get(block.id) ?? this.decode(block.id);
    this.read.set(block.id, known);
    const all = await known;
    return { ...all, columns: new Map([...all.columns].filter(([name]) => columns.includes(name))) };
  }

  /** @param {string} id */
  async decode(id) {
    const packed = bytesOf(document.getElementById(id)?.textContent ?? "");
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return readSeries(new Uint8Array(await new Response(stream).arrayBuffer()));
  }
}

/** The server of the page; a report has none. */
const SERVER = document.body.dataset.api ? new ServerSource(document.body.dataset.api) : null;
