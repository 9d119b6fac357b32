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
    canvas.style.aspectRatio = `${(map.east - map.west) * shrink} / ${map.north - map.south}`;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Map ${visible(table)}, from ${short(map.least)} to ${short(map.most)} ${unit}`);
    const read = element("output", { class: "read" }, ["\u00a0"]);
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect(), [u, v] = [(event.clientX - box.left) / box.width,
        (event.clientY - box.top) / box.height];
      const cell = map.cells[Math.min(map.height - 1, Math.floor(v * map.height)) * map.width +
        Math.min(map.width - 1, Math.floor(u * map.width))];
      const [lat, lon] = [map.north - v * (map.north - map.south), map.west + u * (map.east - map.west)];
      read.textContent = `${lat.toFixed(4)}\u00b0, ${lon.toFixed(4)}\u00b0: ` +
        (Number.isFinite(cell) ? `${short(cell)} ${unit}` : "unknown");
    });
    const bar = VIRIDIS.map((c, i) => `${c} ${(100 * i / 7).toFixed(0)}%`).join(", ");
    figure.append(canvas, element("div", { class: "map-scale" }, [element("span", {}, [`${short(low)} ${unit}`]),
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
