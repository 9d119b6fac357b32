// @ts-check
"use strict";
// Zoom of the line plots. Plots of one line with the same horizontal axis share their range.

/** @typedef {{name: string, x: number[], y: number[]}} PlotSeries */

class ZoomPlot {
  /** @param {SVGSVGElement} svg */
  constructor(svg) {
    this.svg = svg;
    this.inner = /** @type {SVGSVGElement} */ (svg.querySelector("svg"));
    this.ticks = /** @type {SVGGElement} */ (svg.querySelector("g.ticks"));
    const numbers = (/** @type {string | null} */ text) => (text ?? "").split(" ").map(Number);
    this.x = numbers(svg.dataset.x ?? "");
    this.y = numbers(svg.dataset.y ?? "");
    this.xName = svg.dataset.xName ?? "";
    this.yName = svg.dataset.yName ?? "";
    /** The plot in its own px: left, top, width, height. */
    this.box = numbers(this.inner.getAttribute("viewBox"));
    this.full = numbers(svg.getAttribute("viewBox"));
    /** The part in sight, from 0 to 1. */
    this.part = [0, 1];
    /** @type {ZoomPlot[]} */
    this.together = [this];
    this.marks = [...svg.querySelectorAll(".mark")];
    this.read = element("output", { class: "read" }, ["\u00a0"]);
    this.cursor = shape("line", { class: "cursor", x1: -9, x2: -9, y1: this.box[1], y2: this.box[1] + this.box[3] });
    this.selection = shape("rect", { class: "selection", y: this.box[1], height: this.box[3], width: 0 });
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("role", "application");
    svg.setAttribute("aria-roledescription", "zoomable plot");
    svg.append(this.selection, this.cursor);
    this.listen();
    this.tools();
  }

  /** The drawn lines, in the px of the plot. @returns {PlotSeries[]} */
  series() {
    if (!this.known) {
      this.known = [...this.inner.querySelectorAll("path.line")].map((path) => {
        /** @type {PlotSeries} */
        const one = { name: path.getAttribute("data-name") ?? "", x: [], y: [] };
        for (const [, x, y] of (path.getAttribute("d") ?? "").matchAll(/[ML](-?[\d.]+) (-?[\d.]+)/g)) {
          one.x.push(Number(x));
          one.y.push(Number(y));
        }
        return one;
      });
    }
    return this.known;
  }

  /** Value at a part of an axis. @param {number[]} axis @param {number} part */
  static value([low, high, log], part) { return log ? low * (high / low) ** part : low + part * (high - low); }

  /** Vertical part of the box with the lines in sight and a margin; the whole box at full range. */
  seen() {
    const [left, top, wide, high] = this.box, [from, to] = this.part;
    let [least, most] = [Infinity, -Infinity];
    for (const one of this.series()) one.x.forEach((x, i) => {
      if (x < left + from * wide || x > left + to * wide) return;
      least = Math.min(least, one.y[i]);
      most = Math.max(most, one.y[i]);
    });
    if (to - from >= 1 || !(most >= least)) return { top, high };
    const pad = Math.max(0.08 * (most - least), 0.005 * high);
    return { top: least - pad, high: most - least + 2 * pad };
  }

  /** Frame on the page: left, width. */
  frame() {
    const view = this.svg.viewBox.baseVal;
    return { left: this.box[0], width: view.width - this.box[0] - (this.full[2] - this.box[0] - this.box[2]) };
  }

  draw() {
    const [left, top, wide, high] = this.box, [from, to] = this.part;
    const narrow = this.svg.parentElement ? this.svg.parentElement.clientWidth - 28 : this.full[2];
    const total = narrow < this.full[2] ? Math.max(280, narrow) : this.full[2];
    this.svg.classList.toggle("fitted", total !== this.full[2]);
    this.svg.setAttribute("viewBox", `0 0 ${total} ${this.full[3]}`);
    const frame = this.frame();
    this.inner.setAttribute("width", String(frame.width));
    this.svg.querySelector("rect.frame")?.setAttribute("width", String(frame.width));
    const seen = this.seen();
    this.inner.setAttribute("viewBox", `${left + from * wide} ${seen.top} ${(to - from) * wide} ${seen.high}`);
    for (const mark of this.marks) {
      const name = mark.tagName === "circle" ? "cx" : "x";
      const own = mark.getAttribute("data-own") ?? mark.getAttribute(name);
      mark.setAttribute("data-own", own ?? "");
      const part = ((Number(own) - left) / wide - from) / (to - from);
      mark.setAttribute(name, String(left + part * frame.width));
      // The label of a mark stands 8 px above it.
      const lift = name === "cx" ? 0 : 8, down = name === "cx" ? "cy" : "y";
      const ownY = Number(mark.getAttribute("data-own-y") ?? mark.getAttribute(down));
      mark.setAttribute("data-own-y", String(ownY));
      const partY = (ownY + lift - seen.top) / seen.high;
      mark.setAttribute(down, String(top + partY * high - lift));
      mark.toggleAttribute("hidden", part < 0 || part > 1 || partY < 0 || partY > 1);
    }
    const x = [ZoomPlot.value(this.x, from), ZoomPlot.value(this.x, to)];
    const most = Math.max(3, Math.floor(frame.width / 95));
    const [low, high2, log] = this.x, at = (/** @type {number} */ v) => {
      const part = log ? Math.log(v / low) / Math.log(high2 / low) : (v - low) / (high2 - low);
      return left + (part - from) / (to - from) * frame.width;
    };
    const label = (/** @type {number} */ ax, /** @type {number} */ ay, /** @type {string} */ text, anchor = "middle") =>
      shape("text", { class: "tick", x: ax.toFixed(1), y: ay.toFixed(1), "text-anchor": anchor }, [text]);
    const bottom = top + high, parts = [];
    for (const tick of log && x[1] / x[0] > 3 ? logTicks(x[0], x[1]) : linearTicks(x[0], x[1], most)) {
      const px = at(tick.at).toFixed(1);
      parts.push(shape("line", { class: "grid", x1: px, x2: px, y1: top, y2: bottom }),
        label(Number(px), bottom + 16, tick.label));
    }
    const [, , yLog] = this.y;
    const yOf = (/** @type {number} */ px) => ZoomPlot.value(this.y, (bottom - px) / high);
    const [yLow, yHigh] = [yOf(seen.top + seen.high), yOf(seen.top)];
    for (const tick of yLog ? logTicks(yLow, yHigh) : linearTicks(yLow, yHigh, 6)) {
      const part = yLog ? Math.log(tick.at / yLow) / Math.log(yHigh / yLow) : (tick.at - yLow) / (yHigh - yLow);
      const py = bottom - part * high;
      const row = py.toFixed(1);
      parts.push(shape("line", { class: "grid", x1: left, x2: left + frame.width, y1: row, y2: row }),
        label(left - 7, py + 4, tick.label, "end"));
    }
    parts.push(shape("text", { class: "name", x: left + frame.width / 2, y: this.full[3] - 5,
      "text-anchor": "middle" }, [this.xName]), shape("text", { class: "name", "text-anchor": "middle",
      transform: `translate(13 ${top + high / 2}) rotate(-90)` }, [this.yName]));
    this.ticks.replaceChildren(...parts);
    this.svg.dataset.shown = x.map((v) => v.toPrecision(6)).join(" ");
  }

  /** Shows a part of the axis in all plots of the line. @param {number} from @param {number} to */
  zoom(from, to) {
    const width = Math.min(1, Math.max(1 / 200, to - from)), start = Math.min(1 - width, Math.max(0, from));
    for (const plot of this.together) {
      plot.part = [start, start + width];
      plot.draw();
    }
  }

  /** @param {number} factor @param {number} [around] Part of the frame that stays in place. */
  scale(factor, around = 0.5) {
    const [from, to] = this.part, at = from + around * (to - from);
    this.zoom(at - (at - from) * factor, at + (to - at) * factor);
  }

  /** @param {number} by Share of the part in sight. */
  move(by) {
    const [from, to] = this.part;
    this.zoom(from + by * (to - from), to + by * (to - from));
  }

  /** Part of the frame at the pointer. @param {MouseEvent} event */
  across(event) {
    const box = this.svg.getBoundingClientRect(), frame = this.frame();
    const x = (event.clientX - box.left) * this.svg.viewBox.baseVal.width / box.width;
    return Math.min(1, Math.max(0, (x - frame.left) / frame.width));
  }

  /** Values of all plots of the line at a part of the frame. @param {number} across */
  show(across) {
    for (const plot of this.together) {
      const [from, to] = plot.part, frame = plot.frame();
      const px = plot.box[0] + (from + across * (to - from)) * plot.box[2];
      const at = frame.left + across * frame.width;
      plot.cursor.setAttribute("x1", String(at));
      plot.cursor.setAttribute("x2", String(at));
      const values = plot.series().map((one) => {
        let [low, high] = [0, one.x.length - 1];
        while (high - low > 1) {
          const middle = (low + high) >> 1;
          if (one.x[middle] < px) low = middle; else high = middle;
        }
        const k = Math.abs((one.x[low] ?? Infinity) - px) < Math.abs((one.x[high] ?? Infinity) - px) ? low : high;
        const part = (plot.box[1] + plot.box[3] - one.y[k]) / plot.box[3];
        return `${one.name || plot.yName}: ${Number(ZoomPlot.value(plot.y, part).toPrecision(3))}`;
      });
      const unit = plot.yName.includes(", ") ? " " + plot.yName.split(", ").pop() : "";
      const x = ZoomPlot.value(plot.x, from + across * (to - from));
      const place = `${plot.xName}: ${Number(x.toPrecision(5))}`;
      plot.read.textContent = [place, ...values.map((v) => v + unit)].join(" · ");
    }
  }

  listen() {
    const { svg } = this;
    /** @type {number | null} */
    let start = null;
    svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "mouse" || event.button !== 0) return;
      start = this.across(event);
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      const at = this.across(event), frame = this.frame();
      if (start !== null) {
        this.selection.setAttribute("x", String(frame.left + Math.min(start, at) * frame.width));
        this.selection.setAttribute("width", String(Math.abs(at - start) * frame.width));
      }
      this.show(at);
    });
    svg.addEventListener("pointerup", (event) => {
      const at = this.across(event), [from, to] = this.part;
      this.selection.setAttribute("width", "0");
      if (start !== null && Math.abs(at - start) > 0.01) {
        this.zoom(from + Math.min(start, at) * (to - from), from + Math.max(start, at) * (to - from));
      }
      start = null;
    });
    svg.addEventListener("dblclick", () => this.zoom(0, 1));
    // Without focus or Ctrl the wheel scrolls the page.
    svg.addEventListener("wheel", (event) => {
      if (document.activeElement !== svg && !event.ctrlKey) return;
      event.preventDefault();
      this.scale(event.deltaY < 0 ? 0.8 : 1.25, this.across(event));
    }, { passive: false });
    let key = 0.5;
    svg.addEventListener("keydown", (event) => {
      const acts = { "+": () => this.scale(0.7), "=": () => this.scale(0.7), "-": () => this.scale(1 / 0.7),
        "0": () => this.zoom(0, 1), Escape: () => this.zoom(0, 1),
        PageUp: () => this.move(-0.5), PageDown: () => this.move(0.5),
        ArrowLeft: () => this.show(key = Math.max(0, key - 0.01)),
        ArrowRight: () => this.show(key = Math.min(1, key + 0.01)) };
      const act = acts[/** @type {keyof typeof acts} */ (event.key)];
      if (!act || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      act();
    });
  }

  /** Buttons under the plot. */
  tools() {
    const button = (/** @type {string} */ text, /** @type {string} */ label, /** @type {() => void} */ act) =>
      element("button", { type: "button", class: "plain", "aria-label": label, onclick: act }, [text]);
    const name = (this.svg.getAttribute("aria-label") ?? "plot").slice(0, 60);
    const bar = downloads(this.svg, name, () => this.csv());
    bar.prepend(button("+", "Zoom in", () => this.scale(0.5)), button("\u2212", "Zoom out", () => this.scale(2)),
      button("\u2190", "Earlier", () => this.move(-0.5)), button("\u2192", "Later", () => this.move(0.5)),
      button("All", "Show all", () => this.zoom(0, 1)));
    this.svg.after(this.read, bar);
  }

  /** The drawn points in sight: the smallest and the largest value of each interval of a long line. */
  csv() {
    const rows = [csvRow(["series", this.xName, this.yName])], [left, top, wide, high] = this.box;
    for (const one of this.series()) one.x.forEach((px, i) => {
      const part = (px - left) / wide;
      if (part < this.part[0] || part > this.part[1]) return;
      rows.push(csvRow([one.name, Number(ZoomPlot.value(this.x, part).toPrecision(6)),
        Number(ZoomPlot.value(this.y, (top + high - one.y[i]) / high).toPrecision(4))]));
    });
    return rows.join("\n") + "\n";
  }
}

{
  /** @type {Map<string, ZoomPlot[]>} */
  const groups = new Map();
  const homes = [...document.querySelectorAll(".panel, section")];
  const plots = [...document.querySelectorAll("svg.plot")]
    .map((svg) => new ZoomPlot(/** @type {SVGSVGElement} */ (svg)));
  for (const plot of plots) {
    const panel = plot.svg.closest(".panel");
    const key = homes.indexOf(panel ?? plot.svg) + plot.xName + plot.x.map((v) => v.toPrecision(4)).join();
    if (panel && !plot.x[2]) groups.set(key, [...groups.get(key) ?? [], plot]);
  }
  groups.forEach((own) => own.forEach((plot) => { plot.together = own; }));
  const fit = () => plots.forEach((plot) => plot.draw());
  let wide = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === wide) return;
    wide = innerWidth;
    fit();
  });
  for (const tabs of document.querySelectorAll(".panels .tabs")) tabs.addEventListener("click", fit);
  fit();
  // Areas that scroll are reached by keyboard.
  for (const area of document.querySelectorAll(".scroll, figure, pre")) {
    if (area.scrollWidth > area.clientWidth + 1) {
      area.setAttribute("tabindex", "0");
      area.classList.add("scrolls");
    }
  }
}
