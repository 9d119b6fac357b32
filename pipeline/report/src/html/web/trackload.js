// @ts-check
"use strict";
// Reads the tracks of a line and the map below them.

class TrackLoader {
  /** @param {ServerSource | EmbeddedSource} source @param {TrackView} view */
  constructor(source, view) {
    this.source = source;
    this.view = view;
    /** @type {string | undefined} The table of the map under the track. */
    this.mapName = undefined;
    /** @type {SeriesAnswer | undefined} The track of the whole line. */
    this.whole = undefined;
    /** @type {string | undefined} */
    this.wholeKey = undefined;
  }

  /** Tracks of the whole line, and a finer track of the interval in sight.
   * @param {PipelineInfo} pipeline @param {LinePlace} place @param {AbortSignal} signal */
  async load(pipeline, place, signal) {
    const { source, view } = this, { range } = view;
    const has = (/** @type {TableInfo} */ t, /** @type {string} */ name) =>
      t.columns.some((c) => c.name === name && c.series);
    const tables = pipeline.tables.filter((t) => has(t, "lat") && has(t, "lon"));
    const table = tables.find((t) => has(t, "truth_lat")) ?? tables.find((t) => has(t, "sd_n")) ?? tables[0];
    if (!table) { view.show([], null, []); return; }
    const layers = TRACK_LAYERS.filter((l) => has(table, l.lat) && has(table, l.lon));
    const columns = [...layers.flatMap((l) => [l.lat, l.lon]), ...["sd_n", "sd_e"].filter((n) => has(table, n)),
      ...modeColumns(table).flat()];
    const ask = (/** @type {TimeRange | null} */ own) => source.series({ table, columns, range: own, pixels: 1000,
      signal, place });
    const key = JSON.stringify([table.table, place]);
    if (this.wholeKey !== key) [this.whole, this.wholeKey] = [await ask(null), key];
    const whole = /** @type {SeriesAnswer} */ (this.whole), answer = range && source.live ? await ask(range) : whole;
    if (signal.aborted) return;
    const of = (/** @type {SeriesAnswer} */ from, /** @type {string} */ name) => {
      const found = from.columns.get(name);
      return found?.first ?? (found?.high ? found.low.map((v, i) => (v + (found.high?.[i] ?? v)) / 2) : found?.low);
    };
    const tracks = (/** @type {SeriesAnswer} */ from) => layers.flatMap((layer) => {
      const [lat, lon] = [of(from, layer.lat), of(from, layer.lon)];
      const named = layer.lat === "lat" && has(table, "sd_n") ? { ...layer, name: "estimate" } : layer;
      return lat && lon ? [{ layer: named, x: from.x, lat, lon }] : [];
    });
    const [north, east] = [of(answer, "sd_n"), of(answer, "sd_e")];
    view.show(tracks(answer), north && east ? { x: answer.x, north, east } : null, tracks(whole),
      modesOf(modeColumns(table), answer));
    await this.loadMap(pipeline, table);
    const lines = await coastOf(source, widened(view.bounds(false)));
    if (!signal.aborted) view.showCoast(lines);
  }

  /** @param {PipelineInfo} pipeline @param {TableInfo} table */
  async loadMap(pipeline, table) {
    const { source, view } = this;
    if (!(source instanceof ServerSource)) return;
    const maps = pipeline.sources.filter((s) => s.kind === "map");
    const map = maps.find((s) => table.inputs.includes(s.name)) ?? maps[0];
    if (!map || this.mapName === map.table) return;
    this.mapName = map.table;
    const image = await source.map(map.table);
    view.map = { map: image, canvas: mapCanvas(image).canvas };
    view.draw();
  }
}
