// @ts-check
"use strict";
// The sections of a view that depend on the store: an explorer for each table of scores, the comparison of runs, and
// the last runs in the foot. They are read after the page is shown.

/** @typedef {{scores: string[], runs: {pipeline: string, run: string}[]}} PageSections */

class SectionList {
  /** @param {HTMLElement} note Paragraph before which the sections are inserted. @param {string} address */
  constructor(note, address) {
    this.note = note;
    this.address = address;
    document.addEventListener("magline:changed", () => this.read());
    this.read();
  }

  async read() {
    try {
      const answer = await fetch(this.address), found = await answer.json();
      if (!answer.ok) throw new Error(found.error);
      this.fill(found);
      this.note.hidden = true;
    } catch (error) {
      this.note.hidden = false;
      this.note.textContent = error instanceof Error ? visible(error.message) : "The list of tables cannot be read.";
    }
  }

  /** Adds the sections that the page does not have yet. @param {PageSections} found */
  fill({ scores, runs }) {
    const known = new Set([...document.querySelectorAll("section.explorer")].map((s) => s.getAttribute("data-table")));
    for (const table of scores.filter((name) => !known.has(name))) {
      const address = "api/scores?" + new URLSearchParams({ table });
      const home = element("section", { class: "explorer", id: "explore-" + table, "data-table": table,
        "data-src": address }, [element("h2", {}, ["Explore: ", element("bdi", {}, [visible(table)])])]);
      this.note.before(home);
      fetchedExplorer(home, address);
    }
    if (scores.length && !document.getElementById("against")) {
      const home = element("section", { class: "against", id: "against" }, [element("h2", {}, ["Compare runs"])]);
      this.note.before(home);
      new AgainstView(home, null);
    }
    if (scores.length > 1 && !document.getElementById("pipelines")) {
      const home = element("section", { class: "against", id: "pipelines" },
        [element("h2", {}, ["Compare pipelines"])]);
      this.note.before(home);
      new PipelinesView(home, scores);
    }
    const foot = document.querySelector("footer");
    for (const { pipeline, run } of runs) {
      const own = foot?.querySelector(`[data-run="${CSS.escape(pipeline)}"]`);
      if (own) own.textContent = run;
      else foot?.prepend(element("p", { class: "note" }, ["Run ", element("code", { "data-run": pipeline }, [run]),
        " of ", element("bdi", {}, [visible(pipeline)]), "."]));
    }
  }
}

{
  const note = document.getElementById("sections");
  if (note?.dataset.src) new SectionList(note, note.dataset.src);
}
