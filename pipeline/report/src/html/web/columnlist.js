// @ts-check
"use strict";
// The list of the columns of a line: search, table, units, roles.

const LISTED_COLUMNS = 400;

class ColumnList {
  /** @param {() => void} change */
  constructor(change) {
    this.change = change;
    /** @type {ColumnChoice[]} */
    this.chosen = [];
    /** @type {TableInfo[]} */
    this.tables = [];
    this.search = /** @type {HTMLInputElement} */ (element("input", { type: "search", "data-key": "column-search",
      placeholder: "name, unit, role or meaning", oninput: () => this.draw() }));
    this.table = /** @type {HTMLSelectElement} */ (element("select", { "data-key": "column-table",
      onchange: () => this.draw() }));
    this.list = element("div", { class: "column-list", role: "group", "aria-label": "Columns", tabindex: 0 });
    this.count = element("p", { class: "note" });
    this.home = element("details", { class: "columns", open: innerWidth >= 1100 }, [element("summary", {}, ["Columns"]),
      element("div", { class: "controls" }, [element("label", {}, ["search", this.search]),
        element("label", {}, ["table", this.table])]), this.count, this.list]);
  }

  /** Lists one table. @param {string} name */
  only(name) {
    this.wanted = name;
    /** @type {HTMLDetailsElement} */ (this.home).open = true;
  }

  /** @param {TableInfo[]} tables @param {ColumnChoice[]} chosen */
  fill(tables, chosen) {
    const before = this.wanted ?? this.table.value;
    this.wanted = undefined;
    this.tables = tables;
    this.chosen = chosen;
    this.table.replaceChildren(element("option", { value: "" }, ["all"]), ...tables.map((t) => element("option",
      { value: t.name, selected: t.name === before }, [`${visible(t.name)} (${visible(t.stage)})`])));
    this.draw();
  }

  /** Columns that the search keeps. */
  found() {
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.tables.filter((t) => !this.table.value || t.name === this.table.value).flatMap((table) =>
      table.columns.filter((c) => c.series).filter((c) => {
        const text = `${c.name} ${c.unit} ${c.role} ${c.description}`.toLowerCase();
        return words.every((word) => text.includes(word));
      }).flatMap((info) => info.length
        ? Array.from({ length: Math.min(info.length, 64) }, (_, i) => ({ table, info, column: `${info.name}[${i}]`,
          term: info.terms?.[i] }))
        : [{ table, info, column: info.name, term: info.term }]));
  }

  draw() {
    const found = this.found(), focus = document.activeElement?.getAttribute("data-column");
    const top = this.list.scrollTop;
    this.count.textContent = `${found.length} columns` + (found.length > LISTED_COLUMNS
      ? `; the first ${LISTED_COLUMNS} are listed` : "");
    this.list.replaceChildren(...found.slice(0, LISTED_COLUMNS).map(({ table, info, column, term }) => {
      const choice = { table: table.name, column };
      const is = (/** @type {ColumnChoice} */ c) => c.table === choice.table && c.column === choice.column;
      const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", checked: this.chosen.some(is),
        "data-column": `${table.name}/${column}`, onchange: () => {
          this.chosen = box.checked ? [...this.chosen, choice] : this.chosen.filter((c) => !is(c));
          this.change();
        } }));
      const unit = info.unit === "1" || !info.unit ? "" : ` [${visible(info.unit)}]`;
      return element("label", { class: "column" }, [box, element("span", {}, [
        element("bdi", { class: "column-name" }, [visible(column) + unit]),
        element("bdi", { class: "note" }, [[table.name, term ?? "", info.role, info.description].filter(Boolean)
          .map(visible).join(" \u00b7 ")])])]);
    }));
    this.list.scrollTop = top;
    const again = focus && this.list.querySelector(`[data-column="${CSS.escape(focus)}"]`);
    if (again instanceof HTMLElement) again.focus({ preventScroll: true });
  }
}
