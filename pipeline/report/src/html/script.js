"use strict";
// A click on a heading sorts its table; a second click turns the order round. Rows without a value stay last.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const value = (row) => {
      const cell = row.cells[column];
      const text = cell.dataset.v ?? cell.textContent.trim();
      return text === "-" ? null : text;
    };
    const order = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      const [m, n] = [Number(x), Number(y)];
      const by = Number.isNaN(m) || Number.isNaN(n) ? x.localeCompare(y, "en") : m - n;
      return up ? by : -by;
    };
    body.append(...[...body.rows].sort(order));
  }));
}
// Shows one of several lines at a time.
for (const panels of document.querySelectorAll(".panels")) {
  const tabs = [...panels.querySelectorAll(".tabs button")];
  const each = [...panels.querySelectorAll(".panel")];
  if (tabs.length !== each.length) continue;
  const show = (chosen) => each.forEach((panel, i) => {
    panel.hidden = i !== chosen;
    tabs[i].setAttribute("aria-pressed", String(i === chosen));
  });
  tabs.forEach((tab, i) => tab.addEventListener("click", () => show(i)));
  show(0);
}
