// @ts-check
"use strict";
// The page on paper: closed parts are opened, long tables are complete, and wide tables and plots fit the paper.

/** Width of a table on a portrait A4 or Letter page, px. */
const PAPER_PX = 640;
/** Smallest scale of a table or plot. */
const LEAST_ZOOM = 0.3;

class Paper {
  constructor() {
    /** @type {(() => void)[]} What `close` restores. */
    this.restore = [];
    this.open = false;
    // Tables may be drawn again for the width of the paper.
    this.changes = new MutationObserver(() => this.fitWide());
    addEventListener("beforeprint", () => this.prepare());
    addEventListener("afterprint", () => this.close());
    // A preview of the print style has no event of its own.
    const print = matchMedia("print");
    print.addEventListener("change", () => { if (print.matches) this.prepare(); else this.close(); });
  }

  /** Opens all parts of the page. */
  prepare() {
    if (this.open) return;
    this.open = true;
    for (const closed of document.querySelectorAll("details:not([open]):not(.columns)")) {
      closed.setAttribute("open", "");
      this.restore.push(() => closed.removeAttribute("open"));
    }
    for (const panel of document.querySelectorAll(".panels > .panel[hidden]")) {
      panel.removeAttribute("hidden");
      this.restore.push(() => panel.setAttribute("hidden", ""));
    }
    document.documentElement.classList.add("on-paper");
    this.notify(true);
    this.fitPlots();
    this.fitWide();
    this.changes.observe(document.body, { childList: true, subtree: true });
  }

  /** Restores the page. */
  close() {
    if (!this.open) return;
    this.open = false;
    this.changes.disconnect();
    document.documentElement.classList.remove("on-paper");
    for (const act of this.restore.splice(0)) act();
    this.notify(false);
    this.fitPlots();
  }

  /** Notifies the tables of the medium. @param {boolean} on Whether the page is on paper. */
  notify(on) { document.dispatchEvent(new CustomEvent("magline:print", { detail: on })); }

  /** Draws the plots of panels again, since a hidden panel has no width. */
  fitPlots() {
    for (const tabs of document.querySelectorAll(".panels > .tabs")) tabs.dispatchEvent(new Event("click"));
  }

  /** Scales tables and plots that are wider than the paper, also after wrapping. */
  fitWide() {
    for (const wide of document.querySelectorAll("table, .charts .chart")) {
      if (!(wide instanceof HTMLElement) || !wide.clientWidth || wide.style.getPropertyValue("--print-zoom")) continue;
      const { width } = wide.style;
      if (wide.tagName === "TABLE") wide.style.width = "min-content";
      const scale = PAPER_PX / wide.scrollWidth;
      wide.style.width = width;
      if (scale >= 1) continue;
      wide.style.setProperty("--print-zoom", Math.max(LEAST_ZOOM, scale).toFixed(3));
      this.restore.push(() => wide.style.removeProperty("--print-zoom"));
    }
  }
}

new Paper();
