// @ts-check
"use strict";
// The maps of the store as pictures; values under the pointer.

const PROFILE_HINT = "Click two points, or press Enter at two places, for a profile between them. Escape removes it.";

class MapsView {
  /** @param {HTMLElement} home @param {ServerSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.fill();
  }

  async fill() {
    const all = await this.source.pipelines().catch(() => []);
    const maps = all.flatMap((p) => p.sources.filter((s) => s.kind === "map"));
    this.home.hidden = maps.length === 0;
    for (const { table } of maps) {
      const figure = element("figure", {}, [element("h3", {}, [visible(table)])]);
      this.home.append(figure);
      try { this.show(figure, await this.source.map(table), table); } catch (error) {
        figure.append(element("p", { class: "note" }, [error instanceof Error ? visible(error.message) : "No map."]));
      }
    }
  }

  /** Coastlines in the frame of a map. @param {SVGElement} over @param {MapImage} map @param {HTMLElement} figure */
  async coast(over, map, figure) {
    const lines = await coastOf(this.source, map).catch(() => []);
    if (!lines.length) return;
    const path = coastPath(lines, (lon) => 1000 * (lon - map.west) / (map.east - map.west),
      (lat) => 1000 * (map.north - lat) / (map.north - map.south));
    over.prepend(shape("path", { class: "coast halo", d: path }), shape("path", { class: "coast", d: path }));
    figure.append(element("p", { class: "note coast-note" }, [COAST_NOTE]));
  }

  /** Draws a profile between two points of a map. @param {HTMLElement} home @param {string} table
   * @param {[Position, Position]} ends @param {(at: Position | null) => void} hover */
  async profile(home, table, [from, to], hover) {
    try {
      const found = await this.source.profile(table, from, to);
      home.replaceChildren(found.known ? profileFigure(found, Math.max(300, home.clientWidth - 30), hover)
        : element("p", { class: "note" }, ["The map has no value along this line."]));
    } catch (error) {
      home.replaceChildren(element("p", { class: "note" }, [error instanceof Error ? visible(error.message)
        : "The profile cannot be computed."]));
    }
  }

  /** @param {HTMLElement} figure @param {MapImage} map @param {string} table */
  show(figure, map, table) {
    const { canvas, low, high } = mapCanvas(map), { unit } = map;
    const shrink = Math.cos((map.south + map.north) / 2 * Math.PI / 180);
    canvas.className = "map-canvas";
    const aspect = (map.east - map.west) * shrink / (map.north - map.south);
    canvas.style.aspectRatio = String(aspect);
    canvas.setAttribute("aria-hidden", "true");
    const read = element("output", { class: "read" }, ["\u00a0"]), mark = element("span", { class: "map-mark" });
    const way = shape("path", { class: "map-way", d: "" }), along = shape("circle", { class: "map-along", r: 0 });
    const over = shape("svg", { class: "map-over", viewBox: "0 0 1000 1000", preserveAspectRatio: "none",
      "aria-hidden": "true" }, [way, along]);
    const frame = element("div", { class: "map-frame", tabindex: 0, role: "application", "aria-roledescription": "map",
      "aria-label": `Map ${visible(table)}, from ${short(map.least)} to ${short(map.most)} ${unit}. Arrow keys read ` +
        "values. Enter at two places draws a profile." }, [canvas, over, mark]);
    this.coast(over, map, figure);
    const profile = element("div", { class: "map-profile" });
    /** @type {Position[]} */
    let ends = [];
    const draw = (/** @type {Position | null} */ last) => {
      const parts = (last ? [...ends, last] : ends).map(([lat, lon]) => `${(1000 * (lon - map.west) / (map.east -
        map.west)).toFixed(1)} ${(1000 * (map.north - lat) / (map.north - map.south)).toFixed(1)}`);
      way.setAttribute("d", parts.length ? `M${parts.join("L")}${parts.length === 1 ? "h0" : ""}` : "");
    };
    const hover = (/** @type {Position | null} */ place) => {
      along.setAttribute("r", place ? "8" : "0");
      if (!place) return;
      along.setAttribute("cx", String(1000 * (place[1] - map.west) / (map.east - map.west)));
      along.setAttribute("cy", String(1000 * (map.north - place[0]) / (map.north - map.south)));
    };
    const end = () => {
      const place = /** @type {Position} */ ([map.north - at[1] * (map.north - map.south),
        map.west + at[0] * (map.east - map.west)]);
      if (ends.length === 2) ends = [];
      if (ends.length && ends[0][0] === place[0] && ends[0][1] === place[1]) return;
      ends.push(place);
      draw(null);
      hint.textContent = ends.length === 1 ? `Profile from ${placeText(place)}: choose the second point.` : PROFILE_HINT;
      if (ends.length === 2) this.profile(profile, table, /** @type {[Position, Position]} */ (ends), hover);
      else profile.replaceChildren();
    };
    const hint = element("p", { class: "note", role: "status" }, [PROFILE_HINT]);
    // No taller than the window.
    frame.style.maxWidth = `${Math.round(520 * aspect)}px`;
    let at = [0.5, 0.5];
    const show = (/** @type {number} */ u, /** @type {number} */ v) => {
      at = [u, v].map((part) => Math.min(1, Math.max(0, part)));
      const [column, row] = [Math.min(map.width - 1, Math.floor(at[0] * map.width)),
        Math.min(map.height - 1, Math.floor(at[1] * map.height))];
      const cell = map.cells[row * map.width + column];
      const [lat, lon] = [map.north - at[1] * (map.north - map.south), map.west + at[0] * (map.east - map.west)];
      [mark.style.left, mark.style.top] = at.map((part) => `${100 * part}%`);
      read.textContent = `${lat.toFixed(4)}\u00b0, ${lon.toFixed(4)}\u00b0: ` +
        (Number.isFinite(cell) ? `${short(cell)} ${unit}` : "unknown");
    };
    frame.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      show((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
      if (ends.length === 1) draw([map.north - at[1] * (map.north - map.south), map.west + at[0] * (map.east -
        map.west)]);
    });
    frame.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect();
      show((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
      end();
    });
    frame.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.01, 0], ArrowRight: [0.01, 0], ArrowUp: [0, -0.01], ArrowDown: [0, 0.01] }[event.key];
      if (event.key === "Enter") { event.preventDefault(); end(); }
      if (event.key === "Escape") { ends = []; draw(null); hover(null); profile.replaceChildren(); }
      if (!by) return;
      event.preventDefault();
      show(at[0] + by[0], at[1] + by[1]);
    });
    const bar = VIRIDIS.map((c, i) => `${c} ${(100 * i / 7).toFixed(0)}%`).join(", ");
    figure.append(frame, element("div", { class: "map-scale" }, [element("span", {}, [`${short(low)} ${unit}`]),
      element("span", { class: "bar", style: `background:linear-gradient(to right, ${bar})` }),
      element("span", {}, [`${short(high)} ${unit}`])]), read, element("figcaption", {},
      [`${map.of[0]} \u00d7 ${map.of[1]} cells` +
        (map.thinned ? `, drawn as ${map.width} \u00d7 ${map.height} means` : "") +
        `, ${map.south.toFixed(3)}\u00b0 to ${map.north.toFixed(3)}\u00b0 north, ${map.west.toFixed(3)}\u00b0 to ` +
        `${map.east.toFixed(3)}\u00b0 east, ${short(map.least)} to ${short(map.most)} ${unit}. ` +
        "The colours span the 1st to the 99th percentile."]), hint, profile);
  }
}

{
  const home = document.getElementById("maps");
  if (home && SERVER) new MapsView(home, SERVER);
}
