//! A run that is watched: the processor time, memory, rows and bytes of each table, kept in the store for the next estimate.

use super::{
    fit::Prices,
    machine,
    observed::{self, Observation, Part, RUN, Work, usual_rows},
    work::{Amounts, Asked},
};
use crate::{keys::Key, plan::Graph, run::Count, store::Store};

/// Measures the tables of a run, which are computed one after another.
pub struct Watch<'a> {
    graph: &'a Graph<'a>,
    store: &'a Store,
    seen: Vec<Observation>,
    begun_s: f64,
    /// Processor time of the tables.
    spent_s: f64,
}

/// A table that is about to be computed.
pub struct Before {
    asked: Asked,
    begun_s: f64,
    sees_memory: bool,
}

impl<'a> Watch<'a> {
    /// From now on.
    pub fn new(graph: &'a Graph<'a>, store: &'a Store) -> Watch<'a> {
        Watch { graph, store, seen: vec![], begun_s: machine::processor_s(), spent_s: 0.0 }
    }

    /// Before the table `t`; `None` where nothing of it is to be computed.
    pub fn table(&self, t: usize) -> Option<Before> {
        let rows = Prices::usual(usual_rows);
        let amounts = Amounts::new(self.graph, self.store, &rows, rayon::current_num_threads());
        let asked = amounts.of(t).ok().filter(|a| !a.missing.is_empty())?;
        let sees_memory = machine::forget_peak();
        Some(Before { asked, begun_s: machine::processor_s(), sees_memory })
    }

    /// After it: its outcome, and its packs. A table that was not computed as a whole says nothing.
    pub fn done(&mut self, before: Option<Before>, count: Count, packs: &[Key]) {
        let Some(Before { asked, begun_s, sees_memory }) = before else { return };
        let seconds = machine::processor_s() - begun_s;
        self.spent_s += seconds;
        if count.failed + count.skipped > 0 || count.computed != asked.missing.len() {
            return;
        }
        let catalogue = self.store.catalogue();
        let rows = |key: Key| catalogue.find(key).and_then(|place| place.rows).unwrap_or(0) as f64;
        let rows: f64 = asked.missing.iter().filter_map(|u| self.graph.key(*u).ok()).map(rows).sum();
        let all_new = asked.there == 0;
        let bytes = packs.iter().filter_map(|id| catalogue.by_id(*id)).map(|pack| pack.size as f64).sum();
        let memory = machine::peak_bytes().filter(|_| sees_memory).map(|bytes| bytes as f64);
        let bytes = Some(bytes).filter(|_| all_new);
        self.seen.push(Observation { work: asked.work, rows, bytes, seconds, memory });
    }

    /// Keeps the measurements. `whole` is whether the run has finished, so that its work outside the tables was
    /// measured too.
    pub fn keep(mut self, whole: bool) {
        if self.seen.is_empty() {
            return;
        }
        let beside = machine::processor_s() - self.begun_s - self.spent_s;
        if whole {
            let work = of_run(self.graph, self.seen.iter().map(|o| o.rows * o.work.width).sum());
            let (seconds, rows) = (beside.max(0.0), 0.0);
            self.seen.push(Observation { work, rows, bytes: None, seconds, memory: None });
        }
        let speed = machine::speed();
        self.seen.iter_mut().for_each(|o| o.seconds *= speed);
        observed::keep(self.store, &self.graph.plan.spec.name, self.seen);
    }
}

/// Work of a run outside its tables: keys, scores, warnings and publishing, for tables with `numbers` new numbers.
pub fn of_run(graph: &Graph, numbers: f64) -> Work {
    let plan = graph.plan;
    let units: usize = (0..plan.tables.len()).map(|t| graph.unit_count(t)).sum();
    let part = Part { units: plan.tables.len() as f64, samples: units as f64, values: numbers, squares: 0.0 };
    Work { stage: RUN.to_owned(), parts: [(RUN.to_owned(), part)].into(), units: units as f64, ..Work::default() }
}
