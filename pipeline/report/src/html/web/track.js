// @ts-check
"use strict";
// The track of a line over a map: truth, INS, estimate, and the region of three standard deviations.

/**
 * @typedef {{name: string, lat: string, lon: string, hue: string, width: number, dash: number[]}} TrackLayer
 * @typedef {{layer: TrackLayer, x: Float64Array, lat: Float64Array, lon: Float64Array}} TrackData
 */

/** @type {TrackLayer[]} */
const TRACK_LAYERS = [
  { name: "truth", lat: "truth_lat", lon: "truth_lon", hue: "#000000", width: 3.6, dash: [] },
  { name: "INS", lat: "ins_lat", lon: "ins_lon", hue: "#ff7a1a", width: 2.2, dash: [7, 4] },
  { name: "position", lat: "lat", lon: "lon", hue: "#ff4fd0", width: 2, dash: [] },
];
/** Metres of one degree of latitude. */
const DEGREE_M = 111_320;

class TrackView {
  /** @param {HTMLElement} home @param {(t: number | null) => void} hover */
  constructor(home, hover) {
    this.home = home;
    this.hover = hover;
    /** @type {TrackData[]} Tracks of the interval in sight. */
    this.tracks = [];
    /** @type {TrackData[]} Tracks of the whole line. */
    this.whole = [];
    /** @type {{x: Float64Array, north: Float64Array, east: Float64Array} | null} */
    this.sigma = null;
    /** @type {ModeTrack | null} Modes of the position in the interval in sight. */
    this.modes = null;
    this.hasModes = true;
    /** @type {{map: MapImage, canvas: HTMLCanvasElement} | null} */
    this.map = null;
    /** @type {number[][]} Coastlines, as longitude and latitude by turns. */
    this.coast = [];
    /** @type {TimeRange | null} */
    this.range = null;
    /** @type {number | null} */
    this.at = null;
    this.fit = true;
    this.canvas = /** @type {HTMLCanvasElement} */ (element("canvas", { class: "track-canvas", role: "img" }));
    this.legend = element("div", { class: "legend" });
    this.read = element("p", { class: "note" }, ["\u00a0"]);
    this.source = element("p", { class: "note coast-note", hidden: true }, [COAST_NOTE]);
    const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", checked: true, onchange: () => {
      this.fit = box.checked;
      this.draw();
    } }));
    const shown = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", checked: true,
      "data-key": "modes", onchange: () => {
        this.hasModes = shown.checked;
        this.draw();
      } }));
    this.choice = element("label", { class: "note check", hidden: true },
      [shown, " modes of the particle filter"]);
    home.append(this.canvas, this.legend, element("label", { class: "note check" },
      [box, " fit to the interval in sight"]), this.choice, this.source, this.read);
    new ResizeObserver(() => this.draw()).observe(home);
    for (const query of ["(prefers-color-scheme: dark)", "print"]) {
      matchMedia(query).addEventListener("change", () => this.draw());
    }
    this.canvas.addEventListener("pointermove", (event) => this.find(event));
    this.canvas.addEventListener("pointerleave", () => this.hover(null));
  }

  /** @param {TrackData[]} tracks @param {{x: Float64Array, north: Float64Array, east: Float64Array} | null} sigma
   * @param {TrackData[]} whole @param {ModeTrack | null} [modes] */
  show(tracks, sigma, whole, modes = null) {
    this.tracks = tracks.filter((t) => t.x.length);
    this.whole = whole;
    this.sigma = sigma;
    this.modes = modes;
    this.choice.hidden = modes === null;
    const names = [...this.tracks.map((t) => t.layer.name), ...(modes ? ["modes of the particle filter"] : [])];
    this.canvas.setAttribute("aria-label", `Track over the map: ${names.join(", ")}`);
    this.legend.replaceChildren(...this.tracks.map(({ layer }) => element("span", {}, [element("span", { class: "key",
      style: `border-color:${layer.hue === "#000000" ? "var(--ink)" : layer.hue}` +
        (layer.dash.length ? ";border-top-style:dashed" : "") }), layer.name])),
      ...(sigma ? [element("span", {}, [element("span", { class: "key area",
        style: "background:#ff4fd0;opacity:0.4" }), "three standard deviations"])] : []),
      ...(modes ? [element("span", {}, [element("span", { class: "key mode" }),
        "mode; size and opacity increase with its weight"])] : []));
    this.draw();
  }

  /** Takes the coastlines around the tracks. @param {number[][]} lines */
  showCoast(lines) {
    this.coast = lines;
    this.source.hidden = lines.length === 0;
    this.draw();
  }

  /** Whether a time is in sight. @param {number} t */
  inSight(t) { return this.range === null || (t >= this.range[0] && t <= this.range[1]); }

  /** Bounds in degrees of the whole tracks, or of the part in sight. */
  bounds(fit = this.fit) {
    let [west, east, south, north] = [Infinity, -Infinity, Infinity, -Infinity];
    const modes = fit && this.hasModes ? this.modes : null;
    const tracks = [...(fit ? this.tracks : this.whole),
      ...(modes?.modes.map(({ lat, lon }) => ({ x: modes.x, lat, lon })) ?? [])];
    for (const { x, lat, lon } of tracks) for (let i = 0; i < x.length; i++) {
      if (fit && !this.inSight(x[i])) continue;
      if (!Number.isFinite(lat[i]) || !Number.isFinite(lon[i])) continue;
      west = Math.min(west, lon[i]); east = Math.max(east, lon[i]);
      south = Math.min(south, lat[i]); north = Math.max(north, lat[i]);
    }
    return { west, east, south, north };
  }

  /** Places degrees on the canvas with equal scales north and east. @param {number} width @param {number} height */
  projection(width, height) {
    const { west, east, south, north } = this.bounds(), middle = (south + north) / 2;
    const shrink = Math.max(0.01, Math.cos(middle * Math.PI / 180));
    const least = 200 / DEGREE_M;
    const wide = Math.max(east - west, least / shrink) * shrink, high = Math.max(north - south, least);
    const scale = Math.min((width - 40) / wide, (height - 40) / high);
    return { scale, shrink, x: (/** @type {number} */ lon) => width / 2 + (lon - (west + east) / 2) * shrink * scale,
      y: (/** @type {number} */ lat) => height / 2 - (lat - middle) * scale };
  }

  draw() {
    const width = this.home.clientWidth, height = Math.round(Math.min(width * 0.85, 420));
    const ratio = devicePixelRatio || 1;
    this.home.hidden = this.tracks.length === 0;
    if (!width || !this.tracks.length) return;
    [this.canvas.width, this.canvas.height] = [width * ratio, height * ratio];
    this.canvas.style.height = `${height}px`;
    const context = this.canvas.getContext("2d");
    if (!context) return;
    context.scale(ratio, ratio);
    const place = this.place = this.projection(width, height);
    const colour = (/** @type {string} */ name) => getComputedStyle(this.home).getPropertyValue(name).trim();
    context.fillStyle = colour("--grid");
    context.fillRect(0, 0, width, height);
    if (this.map) {
      const { map, canvas } = this.map, [left, top] = [place.x(map.west), place.y(map.north)];
      context.drawImage(canvas, left, top, place.x(map.east) - left, place.y(map.south) - top);
    }
    drawCoast(context, this.coast, place.x, place.y);
    if (this.range) for (const track of this.whole) {
      this.stroke(context, track, place, "rgba(255,255,255,0.55)", 2.2, [], false);
      this.stroke(context, track, place, track.layer.hue, 0.7, [], false);
    }
    if (this.modes && this.hasModes) drawModes(context, this.modes, place, (t) => this.inSight(t));
    for (const track of this.tracks) {
      const { hue, width: own, dash } = track.layer;
      if (dash.length === 0) this.stroke(context, track, place, "rgba(255,255,255,0.8)", own + 2, [], true);
      this.stroke(context, track, place, hue, own, dash, true);
    }
    this.scaleBar(context, place.scale, width, height);
    if (this.at !== null) this.mark(context, place, this.at);
  }

  /** @param {CanvasRenderingContext2D} context @param {TrackData} track @param {{x: (v: number) => number,
   * y: (v: number) => number}} place @param {string} hue @param {number} width @param {number[]} dash
   * @param {boolean} part Whether only the part in sight is drawn. */
  stroke(context, { x, lat, lon }, place, hue, width, dash, part) {
    context.beginPath();
    context.strokeStyle = hue;
    context.lineWidth = width;
    context.lineJoin = context.lineCap = "round";
    context.setLineDash(dash);
    const gap = gapStep(x);
    let pen = false;
    for (let i = 0; i < x.length; i++) {
      if (!Number.isFinite(lat[i]) || (part && !this.inSight(x[i]))) { pen = false; continue; }
      if (pen && x[i] - x[i - 1] <= gap) context.lineTo(place.x(lon[i]), place.y(lat[i]));
      else context.moveTo(place.x(lon[i]), place.y(lat[i]));
      pen = true;
    }
    context.stroke();
    context.setLineDash([]);
  }

  /** @param {CanvasRenderingContext2D} context @param {number} scale px per degree @param {number} width
   * @param {number} height */
  scaleBar(context, scale, width, height) {
    const metres = (width / 4) / scale * DEGREE_M, power = 10 ** Math.floor(Math.log10(metres));
    const long = [5, 2, 1].map((m) => m * power).find((m) => m <= metres) ?? power, px = long / DEGREE_M * scale;
    const text = long >= 1000 ? `${long / 1000} km` : `${long} m`, left = 12, foot = height - 12;
    context.font = `12px ${getComputedStyle(this.home).fontFamily}`;
    context.fillStyle = "rgba(255,255,255,0.85)";
    context.fillRect(left - 6, foot - 22, Math.max(px, context.measureText(text).width) + 12, 28);
    context.strokeStyle = context.fillStyle = "#000";
    context.lineWidth = 1.6;
    context.beginPath();
    context.moveTo(left, foot - 5); context.lineTo(left, foot); context.lineTo(left + px, foot);
    context.lineTo(left + px, foot - 5);
    context.stroke();
    context.fillText(text, left, foot - 8);
  }

  /** Marks at a time, with the region.
   * @param {CanvasRenderingContext2D} context @param {any} place @param {number} t */
  mark(context, place, t) {
    const words = [];
    for (const { layer, x, lat, lon } of this.tracks) {
      const i = nearest(x, t);
      if (!Number.isFinite(lat[i])) continue;
      const [px, py] = [place.x(lon[i]), place.y(lat[i])];
      if (this.sigma && layer.lat === "lat") {
        const k = nearest(this.sigma.x, t), metre = place.scale / DEGREE_M;
        context.beginPath();
        context.ellipse(px, py, 3 * this.sigma.east[k] * metre || 0, 3 * this.sigma.north[k] * metre || 0, 0, 0, 7);
        context.fillStyle = "rgba(255,79,208,0.3)";
        context.strokeStyle = "#ff4fd0";
        context.lineWidth = 1.4;
        context.fill();
        context.stroke();
      }
      context.beginPath();
      context.arc(px, py, 5, 0, 7);
      context.fillStyle = layer.hue;
      context.strokeStyle = "#fff";
      context.lineWidth = 2;
      context.fill();
      context.stroke();
      words.push(`${layer.name} ${lat[i].toFixed(5)}\u00b0, ${lon[i].toFixed(5)}\u00b0`);
    }
    if (this.modes && this.hasModes) words.push(...markModes(context, this.modes, place, t));
    this.read.textContent = words.join("; ");
  }

  /** @param {number | null} t */
  cursor(t) {
    if (t === this.at) return;
    this.at = t;
    this.later();
  }

  /** Draws before the next frame. */
  later() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.draw(); });
  }

  /** The time of the sample nearest to the pointer. @param {PointerEvent} event */
  find(event) {
    const track = this.tracks[this.tracks.length - 1], place = this.place;
    if (!track || !place) return;
    const box = this.canvas.getBoundingClientRect(), [px, py] = [event.clientX - box.left, event.clientY - box.top];
    let [found, least] = [-1, 900];
    for (let i = 0; i < track.x.length; i++) {
      const far = (place.x(track.lon[i]) - px) ** 2 + (place.y(track.lat[i]) - py) ** 2;
      if (far < least) [found, least] = [i, far];
    }
    if (found >= 0) this.hover(track.x[found]);
  }
}
