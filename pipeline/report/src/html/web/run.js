// @ts-check
"use strict";
// The run in progress: units, failures by kind, best results.

/**
 * @typedef {{pipeline: string, state: string, units: {done: number, failed: number, total: number},
 *   tables: {table: string, stage: string, done: number, failed: number, total: number}[],
 *   failures: {stage: string, error: string, times: number, example: string}[],
 *   best: {table: string, metric: string, unit: string, value: number, point: SweepPoint, points: number,
 *     in_sample: boolean, baseline: {metric: string, value: number} | null}[],
 *   runs: (RunInfo & {seconds: number, computed: number, reused: number, failed: number})[],
 *   changed: string}} RunState
 */

const PLAN_POLL_MS = 250, RUN_POLL_MS = 2000, IDLE_POLL_MS = 10_000;

class RunView {
  /** @param {HTMLElement} home @param {string} address */
  constructor(home, address) {
    this.home = home;
    this.address = address;
    /** @type {string | undefined} */
    this.changed = undefined;
    this.summary = element("p", { class: "lead", role: "status" });
    this.best = element("div", { class: "figures" });
    this.bars = element("div", { class: "bars" });
    this.failures = element("div");
    home.append(this.summary, this.best, this.bars, this.failures);
    this.poll();
  }

  async poll() {
    let wait = IDLE_POLL_MS;
    try {
      const answer = await fetch(this.address);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      /** @type {RunState} */
      const state = await answer.json();
      this.show(state);
      document.dispatchEvent(new CustomEvent("magline:run", { detail: state }));
      if (this.changed !== undefined && this.changed !== state.changed) {
        document.dispatchEvent(new CustomEvent("magline:changed"));
      }
      this.changed = state.changed;
      if (state.state === "planning") wait = PLAN_POLL_MS;
      else if (state.state === "running" || state.state === "incomplete") wait = RUN_POLL_MS;
    } catch { this.summary.textContent = "The server does not answer. The page tries again."; }
    setTimeout(() => { if (document.hidden) addEventListener("visibilitychange", () => this.poll(), { once: true });
      else this.poll(); }, wait);
  }

  /** @param {RunState} state */
  show({ pipeline, state, units, tables, failures, best, runs }) {
    const words = { running: "A run is in progress", none: "No run yet",
      done: units.failed ? "The run is finished" : "All results are in the store",
      incomplete: "Results are missing, and no run is in progress" };
    const last = runs.reduce((a, b) => b.number > a.number ? b : a, runs[0]);
    const times = failures.reduce((n, f) => n + f.times, 0);
    const word = words[/** @type {keyof typeof words} */ (state)] ?? state;
    const text = (state === "planning" ? "The plan of the spec is being made." :
      `${word}: ${units.done} of ${units.total} units` + (units.failed ? `, ${units.failed} failed` : "") + ".") +
      (last ? ` Run ${last.number}: ${last.computed} computed, ${last.reused} reused, ${short(last.seconds)} s.` : "");
    if (this.summary.textContent !== text) this.summary.textContent = text;
    const foot = document.querySelector(`footer [data-run="${CSS.escape(pipeline)}"]`);
    if (foot && last) foot.textContent = last.run;
    this.best.replaceChildren(...best.map((b) => {
      const unit = b.unit === "1" ? "" : " " + b.unit, base = b.baseline;
      const point = Object.entries(b.point).map(([axis, value]) => `${axis} = ${value}`).join(", ");
      return element("div", {}, [element("strong", {}, [short(b.value) + unit]),
        `best ${b.metric} of ${b.points} points` + (base ? `; ${base.metric} ${short(base.value)}${unit}` : "") +
        (b.in_sample ? " (in sample)" : ""),
        element("br"), element("bdi", {}, [visible(point)])]);
    }));
    this.bars.replaceChildren(...(state === "done" ? [] : tables).map((t) => {
      const name = visible(t.table.slice(t.table.indexOf(".") + 1)), part = (/** @type {number} */ n) =>
        `width:${t.total ? 100 * n / t.total : 0}%`;
      return element("div", { class: "bar-row" }, [element("bdi", {}, [name]), element("div", { class: "progress",
        role: "progressbar", "aria-label": `Units of ${name}`, "aria-valuemin": 0, "aria-valuemax": t.total,
        "aria-valuenow": t.done + t.failed }, [element("span", { class: "done", style: part(t.done) }),
        element("span", { class: "failed", style: part(t.failed) })]), element("span", { class: "note" },
        [`${t.done} of ${t.total}` + (t.failed ? `, ${t.failed} failed` : "")])]);
    }));
    const open = new Set([...this.failures.querySelectorAll("details[open]")].map((d) => d.getAttribute("data-kind")));
    this.failures.replaceChildren(...(failures.length ? [element("div", { class: "warning" }, [element("strong", {},
      [`${times} failed, ${failures.length} ${failures.length === 1 ? "kind" : "kinds"}`]), ...failures.map((f) =>
      element("details", { "data-kind": f.stage + f.error, open: open.has(f.stage + f.error) }, [element("summary", {},
        [`${f.times} \u00d7 ${visible(f.stage)}: ${visible(f.error)}`]), element("p", { class: "note" },
        [`First at ${visible(f.example)}.`])]))])] : []));
  }
}

{
  const home = document.getElementById("live");
  if (home?.dataset.src && document.body.dataset.mode === "spec") new RunView(home, home.dataset.src);
}
