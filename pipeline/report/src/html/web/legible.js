// @ts-check
"use strict";
// Labels of static pictures on a narrow screen: the picture of the answer is fitted; others keep their size and scroll.

const NARROW_SCREEN_PX = 760, LETTER_PX = 7.2, TICK_GAP_PX = 44;

/** Original value of an attribute. @param {Element} node @param {string} name */
function original(node, name) {
  const kept = node.getAttribute("data-own-" + name) ?? node.getAttribute(name) ?? "0";
  node.setAttribute("data-own-" + name, kept);
  return Number(kept);
}

/** Fits the dots of the answer to the width of the page, with labels of full size. @param {SVGSVGElement} svg */
function fitDots(svg) {
  const names = [...svg.querySelectorAll("text.name")], values = [...svg.querySelectorAll("text.value")];
  if (!names.length || !values.length || !svg.parentElement) return;
  const [, , width, height] = (svg.dataset.whole ??= svg.getAttribute("viewBox") ?? "").split(" ").map(Number);
  const room = svg.parentElement.clientWidth - 28, narrow = innerWidth < NARROW_SCREEN_PX && room < width;
  const longest = (/** @type {Element[]} */ all) => LETTER_PX * Math.max(...all.map((t) => t.textContent?.length ?? 0));
  // The rows end 12 px before the frame, and the values begin 14 px after it.
  const own = [original(names[0], "x") + 12, original(values[0], "x") - 14];
  const frame = narrow ? [Math.min(own[0], longest(names) + 12), room - longest(values) - 14] : own;
  const place = (/** @type {number} */ x) => x <= own[0] - 12 ? frame[0] - 12 : x >= own[1] + 14 ? frame[1] + 14
    : frame[0] + (x - own[0]) * (frame[1] - frame[0]) / (own[1] - own[0]);
  for (const node of svg.querySelectorAll("text, circle, line")) {
    for (const name of ["x", "cx", "x1", "x2"]) {
      if (node.hasAttribute(name)) node.setAttribute(name, place(original(node, name)).toFixed(1));
    }
  }
  let last = -Infinity;
  for (const tick of svg.querySelectorAll("text.tick")) {
    const x = Number(tick.getAttribute("x"));
    tick.toggleAttribute("hidden", x - last < TICK_GAP_PX);
    if (x - last >= TICK_GAP_PX) last = x;
  }
  svg.setAttribute("viewBox", `0 0 ${narrow ? room : width} ${height}`);
}

/** Makes the labels of all static pictures readable. */
function fitPictures() {
  for (const svg of document.querySelectorAll("figure > svg:not(.plot), .flow")) {
    if (!(svg instanceof SVGSVGElement) || svg.closest(".live, .lineage")) continue;
    if (svg.matches(".dots")) {
      fitDots(svg);
      continue;
    }
    svg.dataset.least ??= svg.style.minWidth;
    svg.style.minWidth = innerWidth < NARROW_SCREEN_PX ? `${Math.ceil(svg.viewBox.baseVal.width)}px`
      : svg.dataset.least;
  }
}

addEventListener("resize", fitPictures);
fitPictures();
