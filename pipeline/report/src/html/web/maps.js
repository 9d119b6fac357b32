// @ts-check
"use strict";
// The maps of the store as pictures; values under the pointer.

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

  /** @param {HTMLElement} figure @param {MapImage} map @param {string} table */
  show(figure, map, table) {
    const { canvas, low, high } = mapCanvas(map), { unit } = map;
    const shrink = Math.cos((map.south + map.north) / 2 * Math.PI / 180);
    canvas.className = "map-canvas";
    const aspect = (map.east - map.west) * shrink / (map.north - map.south);
    canvas.style.aspectRatio = String(aspect);
    canvas.setAttribute("aria-hidden", "true");
    const read = element("output", { class: "read" }, ["\u00a0"]), mark = element("span", { class: "map-mark" });
    const frame = element("div", { class: "map-frame", tabindex: 0, role: "application", "aria-roledescription": "map",
      "aria-label": `Map ${visible(table)}, from ${short(map.least)} to ${short(map.most)} ${unit}. Arrow keys read ` +
        "values." }, [canvas, mark]);
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
    });
    frame.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.01, 0], ArrowRight: [0.01, 0], ArrowUp: [0, -0.01], ArrowDown: [0, 0.01] }[event.key];
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
        "The colours span the 1st to the 99th percentile."]));
  }
}

{
  const home = document.getElementById("maps");
  if (home && SERVER) new MapsView(home, SERVER);
}
