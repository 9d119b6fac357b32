// @ts-check
"use strict";
// One map: the drawn layer, contours, values under the pointer, and a profile.

const PROFILE_HINT = "Click two points, or press Enter at two places, for a profile between them. Escape removes it.";
const MAP_HIGH_PX = 520;

class MapPicture {
  /** @param {HTMLElement} figure @param {ServerSource} source @param {string} table @param {ScoreAxis[]} axes */
  constructor(figure, source, table, axes) {
    this.figure = figure;
    this.source = source;
    this.table = table;
    this.axes = axes;
    this.state = stateOf(table);
    /** @type {Position[]} */
    this.ends = [];
    /** Place of the mark, from 0 to 1 to the east and to the south. */
    this.at = [0.5, 0.5];
    this.controls = element("div", { class: "controls" });
    this.canvas = element("canvas");
    this.way = shape("path", { class: "map-way", d: "" });
    this.along = shape("circle", { class: "map-along", r: 0 });
    this.lines = shape("g");
    this.over = shape("svg", { class: "map-over", viewBox: "0 0 1000 1000", preserveAspectRatio: "none",
      "aria-hidden": "true" }, [this.lines, this.way, this.along]);
    this.labels = element("div", { class: "contour-labels" });
    this.mark = element("span", { class: "map-mark" });
    this.frame = element("div", { class: "map-frame", tabindex: 0, role: "application",
      "aria-roledescription": "map" });
    this.scale = element("div", { class: "map-scale" });
    this.read = element("output", { class: "read" }, ["\u00a0"]);
    this.caption = element("figcaption");
    this.hint = element("p", { class: "note hint", role: "status" }, [PROFILE_HINT]);
    this.home = element("div", { class: "map-profile" });
    figure.append(this.controls, this.frame, this.scale, this.read, this.caption, this.hint, this.home);
    this.listen();
    addEventListener("hashchange", () => {
      const before = JSON.stringify(this.point);
      this.state = stateOf(table);
      if (JSON.stringify(this.point) !== before) this.clear();
      this.load();
    });
    this.load();
  }

  /** The point of a map of a stage. @returns {SweepPoint} */
  get point() {
    return Object.fromEntries(this.axes.map(({ name, values }) => {
      const wanted = this.state["axis." + name];
      return [name, values.includes(wanted) ? wanted : values[0]];
    }));
  }

  /** Reads the map, and draws it. */
  async load() {
    const asked = this.asked = {};
    try {
      const map = await this.source.map(this.table, this.point);
      const kind = /** @type {MapLayerKind} */ (this.state.layer in MAP_LAYERS ? this.state.layer : "map");
      const error = kind === "error" && map.has_error ? await this.source.map(this.table, this.point, "error") : null;
      if (asked !== this.asked) return;
      this.map = map;
      this.layer = mapLayer(map, kind, error);
      this.draw(map, this.layer);
    } catch (error) {
      if (asked !== this.asked) return;
      this.map = undefined;
      this.frame.replaceChildren();
      this.scale.replaceChildren();
      this.choices();
      this.caption.textContent = error instanceof Error ? visible(error.message) : "The map cannot be read.";
    }
  }

  /** @param {string} key @param {string} value @param {string} usual */
  set(key, value, usual) {
    // A profile is of one point of the sweep.
    if (key.startsWith("axis.")) this.clear();
    if (value === usual) delete this.state[key]; else this.state[key] = value;
    keepState(this.table, this.state);
    this.load();
  }

  /** @param {string} label @param {string} key @param {[string, string][]} options The first one is the default. */
  select(label, key, options) {
    const chosen = options.some(([value]) => value === this.state[key]) ? this.state[key] : options[0][0];
    const made = /** @type {HTMLSelectElement} */ (element("select", { "data-key": key,
      onchange: () => this.set(key, made.value, options[0][0]) }, options.map(([value, text]) =>
      element("option", { value, selected: value === chosen }, [text]))));
    return element("label", {}, [element("bdi", {}, [visible(label)]), made]);
  }

  /** The controls. */
  choices() {
    const focus = this.controls.contains(document.activeElement) && document.activeElement?.getAttribute("data-key");
    const { map } = this, parts = this.axes.filter((a) => a.values.length > 1).map((axis) => {
      const texts = shownValues(axis);
      return this.select(axis.name, "axis." + axis.name, axis.values.map((v, i) => [v, texts[i].slice(0, 80)]));
    });
    if (map) {
      const kinds = /** @type {[string, string][]} */ (Object.entries(MAP_LAYERS)
        .filter(([kind]) => kind !== "error" || map.has_error));
      const steps = this.steps(map).map((step) => /** @type {[string, string]} */ ([String(step),
        `every ${step} ${visible(map.unit)}`]));
      parts.unshift(this.select("drawn", "layer", kinds), this.select("contours", "step", [["", "none"], ...steps]));
    }
    this.controls.replaceChildren(...parts);
    const again = focus && this.controls.querySelector(`[data-key="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus();
  }

  /** @param {MapImage} map @param {MapLayer} layer */
  draw(map, layer) {
    this.choices();
    const { canvas, low, high } = mapCanvas(map, layer.cells, layer.light), unit = visible(layer.unit);
    const shrink = Math.cos((map.south + map.north) / 2 * Math.PI / 180);
    const aspect = (map.east - map.west) * shrink / (map.north - map.south);
    canvas.className = "map-canvas";
    canvas.style.aspectRatio = String(aspect);
    canvas.setAttribute("aria-hidden", "true");
    this.canvas = canvas;
    // No taller than the window.
    this.frame.style.maxWidth = `${Math.round(MAP_HIGH_PX * aspect)}px`;
    this.frame.setAttribute("aria-label", `Map ${visible(this.table)}, ${MAP_LAYERS[layer.kind]} from ${short(low)} ` +
      `to ${short(high)} ${unit}. Arrow keys read values. Enter at two places draws a profile.`);
    this.frame.replaceChildren(canvas, this.over, this.labels, this.mark);
    this.frame.dataset.layer = layer.kind;
    this.contours(map);
    const bar = VIRIDIS.map((c, i) => `${c} ${(100 * i / 7).toFixed(0)}%`).join(", ");
    this.scale.replaceChildren(element("span", {}, [`${short(low)} ${unit}`]),
      element("span", { class: "bar", style: `background:linear-gradient(to right, ${bar})` }),
      element("span", {}, [`${short(high)} ${unit}`]));
    this.caption.textContent = this.words(map, layer);
    this.coast(map);
  }

  /** Steps of contours, for the span of the colours. @param {MapImage} map */
  steps(map) {
    const { low, high } = mapSpan(map.cells);
    return contourSteps(low, high);
  }

  /** Draws the contours. @param {MapImage} map */
  contours(map) {
    const step = Number(this.state.step);
    const { paths, labels } = this.steps(map).includes(step) ? contourDrawing(map, step) : { paths: [], labels: [] };
    this.lines.replaceChildren(...paths);
    this.labels.replaceChildren(...labels);
    this.step = paths.length ? step : null;
  }

  /** @param {MapImage} map @param {MapLayer} layer */
  words(map, layer) {
    const point = Object.entries(this.point).map(([axis, value]) => `${axis} = ${value}`).join(", ");
    return `${MAP_LAYERS[layer.kind][0].toUpperCase()}${MAP_LAYERS[layer.kind].slice(1)}${point ? " at " +
      visible(point) : ""}: ${map.of[0]} \u00d7 ${map.of[1]} cells` +
      (map.thinned ? `, drawn as ${map.width} \u00d7 ${map.height} means` : "") +
      `, ${map.south.toFixed(3)}\u00b0 to ${map.north.toFixed(3)}\u00b0 north, ${map.west.toFixed(3)}\u00b0 to ` +
      `${map.east.toFixed(3)}\u00b0 east; the map has ${short(map.least)} to ${short(map.most)} ` +
      `${visible(map.unit)}. ` + layer.words + "The colours span the 1st to the 99th percentile." +
      (this.step ? ` Contours of the map every ${this.step} ${visible(map.unit)}, thicker every ` +
        `${HEAVY_CONTOUR * this.step} ${visible(map.unit)}.` : "");
  }

  /** Coastlines in the frame. @param {MapImage} map */
  async coast(map) {
    const lines = await coastOf(this.source, map).catch(() => []);
    if (map !== this.map) return;
    for (const old of this.figure.querySelectorAll(".coast, .coast-note")) old.remove();
    if (!lines.length) return;
    const path = coastPath(lines, (lon) => 1000 * (lon - map.west) / (map.east - map.west),
      (lat) => 1000 * (map.north - lat) / (map.north - map.south));
    this.over.prepend(shape("path", { class: "coast halo", d: path }), shape("path", { class: "coast", d: path }));
    this.figure.append(element("p", { class: "note coast-note" }, [COAST_NOTE]));
  }

  /** Position of a place from 0 to 1. @param {number[]} at @returns {Position} */
  position([u, v]) {
    const { north, south, west, east } = /** @type {MapImage} */ (this.map);
    return [north - v * (north - south), west + u * (east - west)];
  }

  /** A position in the box of 1000 by 1000. @param {Position} at */
  inBox([lat, lon]) {
    const { north, south, west, east } = /** @type {MapImage} */ (this.map);
    return [1000 * (lon - west) / (east - west), 1000 * (north - lat) / (north - south)];
  }

  /** Draws the line of the profile. @param {Position | null} last */
  drawWay(last) {
    const parts = (last ? [...this.ends, last] : this.ends).map((end) => this.inBox(end).map((v) => v.toFixed(1))
      .join(" "));
    this.way.setAttribute("d", parts.length ? `M${parts.join("L")}${parts.length === 1 ? "h0" : ""}` : "");
  }

  /** Marks a place of the profile. @param {Position | null} place */
  hover(place) {
    this.along.setAttribute("r", place ? "8" : "0");
    if (!place || !this.map) return;
    const [x, y] = this.inBox(place);
    this.along.setAttribute("cx", String(x));
    this.along.setAttribute("cy", String(y));
  }

  /** Takes an end of the profile. */
  end() {
    const { ends } = this, place = this.position(this.at);
    if (ends.length === 2) ends.length = 0;
    if (ends.length && ends[0][0] === place[0] && ends[0][1] === place[1]) return;
    ends.push(place);
    this.drawWay(null);
    this.hint.textContent = ends.length === 1 ? `Profile from ${placeText(place)}: choose the second point.`
      : PROFILE_HINT;
    if (ends.length === 2) this.profile(ends[0], ends[1]); else this.home.replaceChildren();
  }

  /** Removes the profile. */
  clear() {
    this.ends = [];
    this.way.setAttribute("d", "");
    this.hover(null);
    this.hint.textContent = PROFILE_HINT;
    this.home.replaceChildren();
  }

  /** Draws a profile of the map between two positions. @param {Position} from @param {Position} to */
  async profile(from, to) {
    const { home } = this, removed = () => this.ends[0] !== from || this.ends[1] !== to;
    try {
      const found = await this.source.profile(this.table, from, to, this.point);
      if (removed()) return;
      home.replaceChildren(found.known ? profileFigure(found, Math.max(300, home.clientWidth - 30),
        (place) => this.hover(place)) : element("p", { class: "note" }, ["The map has no value along this line."]));
    } catch (error) {
      if (removed()) return;
      home.replaceChildren(element("p", { class: "note" }, [error instanceof Error ? visible(error.message)
        : "The profile cannot be computed."]));
    }
  }

  /** Reads the value at a place from 0 to 1. @param {number[]} place */
  show(place) {
    const { map, layer } = this;
    if (!map || !layer) return;
    this.at = place.map((part) => Math.min(1, Math.max(0, part)));
    const [column, row] = [Math.min(map.width - 1, Math.floor(this.at[0] * map.width)),
      Math.min(map.height - 1, Math.floor(this.at[1] * map.height))];
    const text = (/** @type {number} */ v, /** @type {string} */ unit) => Number.isFinite(v) ?
      `${short(v)} ${visible(unit)}` : "unknown";
    const own = layer.cells[row * map.width + column], value = map.cells[row * map.width + column];
    const [lat, lon] = this.position(this.at);
    [this.mark.style.left, this.mark.style.top] = this.at.map((part) => `${100 * part}%`);
    this.read.textContent = `${lat.toFixed(4)}\u00b0, ${lon.toFixed(4)}\u00b0: ` +
      (layer.cells === map.cells ? text(value, map.unit)
        : `${MAP_LAYERS[layer.kind]} ${text(own, layer.unit)}, map ${text(value, map.unit)}`);
  }

  /** Place of the pointer, from 0 to 1. @param {MouseEvent} event */
  pointed(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  /** Pointer and keys. */
  listen() {
    const { frame } = this;
    frame.addEventListener("pointermove", (event) => {
      if (!this.map) return;
      this.show(this.pointed(event));
      if (this.ends.length === 1) this.drawWay(this.position(this.at));
    });
    frame.addEventListener("click", (event) => {
      if (!this.map) return;
      this.show(this.pointed(event));
      this.end();
    });
    frame.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.01, 0], ArrowRight: [0.01, 0], ArrowUp: [0, -0.01], ArrowDown: [0, 0.01] }[event.key];
      if (!this.map) return;
      if (event.key === "Enter") { event.preventDefault(); this.end(); }
      if (event.key === "Escape") this.clear();
      if (!by) return;
      event.preventDefault();
      this.show([this.at[0] + by[0], this.at[1] + by[1]]);
    });
  }
}
