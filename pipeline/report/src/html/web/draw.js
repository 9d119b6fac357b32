// @ts-check
"use strict";
// Drawing of plots as SVG, and downloads.

/** @typedef {{x: number, y: number, text: string, row: number}} PlotTarget */

/** @param {string} tag @param {Record<string, any>} [more] @param {(Node | string)[]} [inner] */
function element(tag, more = {}, inner = []) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(more)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) made.setAttribute(name, value === true ? "" : String(value));
  }
  made.append(...inner);
  return made;
}

const SVG_SPACE = (() => {
  const holder = document.createElement("div");
  holder.innerHTML = "<svg>";
  return holder.firstElementChild?.namespaceURI ?? null;
})();

/** @param {string} tag @param {Record<string, any>} [more] @param {(Node | string)[]} [inner] @returns {SVGElement} */
function shape(tag, more = {}, inner = []) {
  const made = /** @type {SVGElement} */ (document.createElementNS(SVG_SPACE, tag));
  for (const [name, value] of Object.entries(more)) made.setAttribute(name, String(value));
  made.append(...inner);
  return made;
}

/** Ticks in steps of 1, 2 or 5 times a power of ten. @param {number} low @param {number} high @param {number} most */
function linearTicks(low, high, most) {
  if (!(high > low)) return [];
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough * (1 - 1e-9)) ?? 10 * power;
  const digits = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k <= Math.floor(high / step + 1e-9); k++) {
    const text = (k * step).toFixed(digits);
    out.push({ at: k * step, label: /^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "\u2212") });
  }
  return out;
}

/** Decades, with 2 and 5 if there are few. @param {number} low @param {number} high */
function logTicks(low, high) {
  const out = [], wide = Math.log10(high / low) >= 3;
  const every = Math.max(1, Math.ceil(Math.log10(high / low) / 7));
  for (let k = Math.floor(Math.log10(low)); k <= Math.ceil(Math.log10(high)); k++) {
    if (k % every !== 0) continue;
    for (const m of wide ? [1] : [1, 2, 5]) {
      const at = m * 10 ** k;
      if (at < low * (1 - 1e-9) || at > high * (1 + 1e-9)) continue;
      out.push({ at, label: k < -4 || k > 5 ? `${m}e${k}` : String(Number(at.toPrecision(3))) });
    }
  }
  return out;
}

/** Position of values on an axis. */
class PlotScale {
  /** @param {number[]} values @param {number} from @param {number} to */
  constructor(values, from, to) {
    const finite = values.filter(Number.isFinite), above = finite.filter((v) => v > 0);
    let low = Math.min(...reduced(finite, Math.min)), high = Math.max(...reduced(finite, Math.max));
    const least = Math.min(...reduced(above, Math.min));
    /** Logarithmic where the values span decades. Zero is one decade below the least value. */
    this.log = above.length > 1 && low >= 0 && high / least >= 30;
    this.zero = this.log && low === 0 ? least / 10 : 0;
    if (this.log) low = this.zero || low;
    if (!(high > low)) [low, high] = [low - (Math.abs(low) || 1) * 0.1, high + (Math.abs(high) || 1) * 0.1];
    const pad = this.log ? (high / low) ** 0.04 : 0.04 * (high - low);
    this.low = this.log ? low / pad : low - pad;
    this.high = this.log ? high * pad : high + pad;
    this.from = from;
    this.to = to;
  }

  /** @param {number} v */
  at(v) {
    const value = this.log ? Math.max(v, this.zero || v) : v;
    const part = this.log ? Math.log(value / this.low) / Math.log(this.high / this.low)
      : (value - this.low) / (this.high - this.low);
    return this.from + part * (this.to - this.from);
  }

  ticks(most = 6) {
    if (!this.log) return linearTicks(this.low, this.high, most);
    const own = logTicks(this.zero ? this.zero * 5 : this.low, this.high);
    return this.zero ? [{ at: this.zero, label: "0" }, ...own] : own;
  }
}

/**
 * One value, so that spreading never exceeds the stack.
 * @param {number[]} v @param {(a: number, b: number) => number} f
 */
function reduced(v, f) { return v.length ? [v.reduce((a, b) => f(a, b))] : []; }

/** Frame, grid and labels. @param {PlotScale} x @param {PlotScale} y @param {string} xName @param {string} yName */
function plotFrame(x, y, xName, yName) {
  const group = shape("g"), [left, right, top, bottom] = [x.from, x.to, y.to, y.from];
  for (const tick of x.ticks(Math.max(3, Math.floor((right - left) / 80)))) {
    const at = x.at(tick.at);
    group.append(shape("line", { class: "grid", x1: at, x2: at, y1: top, y2: bottom }),
      shape("text", { x: at, y: bottom + 16, "text-anchor": "middle" }, [tick.label]));
  }
  for (const tick of y.ticks()) {
    const at = y.at(tick.at);
    group.append(shape("line", { class: "grid", x1: left, x2: right, y1: at, y2: at }),
      shape("text", { x: left - 7, y: at + 4, "text-anchor": "end" }, [tick.label]));
  }
  group.append(shape("rect", { class: "frame", x: left, y: top, width: right - left, height: bottom - top }),
    shape("text", { class: "name", x: (left + right) / 2, y: bottom + 34, "text-anchor": "middle" }, [xName]),
    shape("text", { class: "name", "text-anchor": "middle",
      transform: `translate(13 ${(top + bottom) / 2}) rotate(-90)` }, [yName]));
  return group;
}

const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"];

/** Colour of a part from 0 (bad) to 1 (good), and of text on it. @param {number} part */
function viridis(part) {
  const k = Math.min(7, Math.max(0, Math.floor(part * 8)));
  return { fill: VIRIDIS[k], ink: k < 4 ? "#fff" : "#000", bin: k };
}

/** Starts a download. @param {string} name @param {Blob} blob */
function save(name, blob) {
  const address = URL.createObjectURL(blob);
  const link = element("a", { href: address, download: name.replace(/[^\w.-]+/g, "_") });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/** A picture as a separate file, with the colours of the page. @param {SVGSVGElement} svg */
function standalone(svg) {
  const copy = /** @type {SVGSVGElement} */ (svg.cloneNode(true));
  const box = svg.getBoundingClientRect();
  copy.setAttribute("width", String(Math.round(box.width)));
  copy.setAttribute("height", String(Math.round(box.height)));
  const inside = [...svg.querySelectorAll("*")], copies = [...copy.querySelectorAll("*")];
  const kept = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-opacity", "opacity",
    "font-family", "font-size", "font-weight", "vector-effect"];
  inside.forEach((from, i) => {
    const look = getComputedStyle(from), to = /** @type {SVGElement} */ (copies[i]);
    for (const name of kept) to.style.setProperty(name, look.getPropertyValue(name));
  });
  const paper = getComputedStyle(document.body).backgroundColor;
  const view = (copy.getAttribute("viewBox") ?? "0 0 1 1").split(" ");
  copy.prepend(shape("rect", { x: view[0], y: view[1], width: view[2], height: view[3], fill: paper }));
  return new XMLSerializer().serializeToString(copy);
}

/** @param {SVGSVGElement} svg @param {string} name */
function saveSvg(svg, name) { save(name + ".svg", new Blob([standalone(svg)], { type: "image/svg+xml" })); }

/** Saves a picture at twice its size on the page. @param {SVGSVGElement} svg @param {string} name */
async function savePng(svg, name) {
  const { width, height } = svg.getBoundingClientRect();
  await saveAsPng({ text: standalone(svg), width, height }, name);
}

/** Saves a picture at twice its size.
 * @param {{text: string, width: number, height: number}} svg @param {string} name */
async function saveAsPng({ text, width, height }, name) {
  const image = new Image();
  image.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(text);
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [Math.round(2 * width), Math.round(2 * height)];
  canvas.getContext("2d")?.drawImage(image, 0, 0, canvas.width, canvas.height);
  canvas.toBlob((blob) => { if (blob) save(name + ".png", blob); });
}

/**
 * A plot whose targets are read by pointer and arrow keys; Enter or a click chooses one.
 * @param {{label: string, width: number, height: number, targets: PlotTarget[],
 *   choose: (row: number, second: boolean) => void}} of
 */
function livePlot({ label, width, height, targets, choose }) {
  const svg = /** @type {SVGSVGElement} */ (shape("svg", { viewBox: `0 0 ${width} ${height}`, tabindex: 0,
    role: "application", "aria-roledescription": "plot", "aria-label": label + ". Arrow keys read values." }));
  const read = element("output", { class: "read" }, ["\u00a0"]);
  const ring = shape("circle", { class: "ring", r: 6, cx: -20, cy: -20 });
  let at = -1;
  /** @param {number} k */
  const show = (k) => {
    const target = targets[k];
    if (!target) return;
    at = k;
    ring.setAttribute("cx", String(target.x));
    ring.setAttribute("cy", String(target.y));
    svg.append(ring);
    read.textContent = target.text;
  };
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) * width / box.width, (event.clientY - box.top) * height / box.height];
    let found = -1, least = 900;
    for (let k = 0; k < targets.length; k++) {
      const far = (targets[k].x - x) ** 2 + (targets[k].y - y) ** 2;
      if (far < least) [found, least] = [k, far];
    }
    if (found >= 0 && found !== at) show(found);
  });
  svg.addEventListener("click", (event) => {
    if (at >= 0 && targets[at].row >= 0) choose(targets[at].row, event.shiftKey);
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (event.key === "Enter" && at >= 0 && targets[at].row >= 0) choose(targets[at].row, event.shiftKey);
    if (step === undefined) return;
    event.preventDefault();
    show((at + step + targets.length) % targets.length);
  });
  return { svg, read };
}
