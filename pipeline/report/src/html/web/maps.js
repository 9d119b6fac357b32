// @ts-check
"use strict";
// The maps of the store: those of files, and those of stages at a point.

class MapsView {
  /** @param {HTMLElement} home @param {ServerSource} source */
  constructor(home, source) {
    this.home = home;
    this.source = source;
    this.fill();
  }

  async fill() {
    const all = await this.source.pipelines().catch(() => []);
    for (const pipeline of all) {
      const made = pipeline.tables.filter((t) => t.kind === "map");
      for (const { table, axes } of [...pipeline.sources.filter((s) => s.kind === "map"), ...made]
        .map((t) => ({ axes: /** @type {string[]} */ ([]), ...t }))) {
        const figure = element("figure", {}, [element("h3", {}, [visible(table)])]);
        this.home.append(figure);
        new MapPicture(figure, this.source, table, pipeline.axes.filter((a) => axes.includes(a.name)));
      }
    }
    this.home.hidden = !this.home.querySelector("figure");
  }
}

{
  const home = document.getElementById("maps");
  if (home && SERVER) new MapsView(home, SERVER);
}
