//! Measurement of a run: processor time, memory, rows and bytes of each table, kept in the store for the next estimate.

use plan::PlanGraph;
use schemas::keys::HashKey;
use store::Store;

use super::{
    fit::UnitPrices,
    machine,
    observed::{self, CostObservation, RUN, TableWork, WorkAmounts, usual_rows},
    work::{MissingWork, WorkEstimator},
};
use crate::OutcomeCounts;

/// Measures the tables of a run, which are computed one after another.
pub struct CostMeter<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    seen: Vec<CostObservation>,
    begun_s: f64,
    /// Processor time of the tables.
    spent_s: f64,
}

/// Work of a table, and start time of its computation.
pub struct TableStart {
    asked: MissingWork,
    begun_s: f64,
    sees_memory: bool,
}

impl<'a> CostMeter<'a> {
    /// Starts the measurement.
    pub fn new(graph: &'a PlanGraph<'a>, store: &'a Store) -> CostMeter<'a> {
        CostMeter { graph, store, seen: vec![], begun_s: machine::processor_s(), spent_s: 0.0 }
    }

    /// Starts the measurement of the table `t`; `None` if no unit of the table is to be computed.
    pub fn table(&self, t: usize) -> Option<TableStart> {
        let rows = UnitPrices::usual(usual_rows);
        let amounts = WorkEstimator::new(self.graph, self.store, &rows, rayon::current_num_threads());
        let asked = amounts.missing_work(t).ok().filter(|a| !a.missing.is_empty())?;
        let sees_memory = machine::forget_peak();
        Some(TableStart { asked, begun_s: machine::processor_s(), sees_memory })
    }

    /// Ends the measurement of a table, with its outcome and packs. A partly computed table is not measured.
    pub fn done(&mut self, before: Option<TableStart>, count: OutcomeCounts, packs: &[HashKey]) {
        let Some(TableStart { asked, begun_s, sees_memory }) = before else { return };
        let seconds = machine::processor_s() - begun_s;
        self.spent_s += seconds;
        if count.failed + count.skipped > 0 || count.computed != asked.missing.len() {
            return;
        }
        let catalogue = self.store.catalogue();
        let rows = |key: HashKey| catalogue.find(key).and_then(|place| place.rows).unwrap_or(0) as f64;
        let rows: f64 = asked.missing.iter().filter_map(|u| self.graph.key(*u).ok()).map(rows).sum();
        let all_new = asked.there == 0;
        let bytes = packs.iter().filter_map(|id| catalogue.by_id(*id)).map(|pack| pack.size as f64).sum();
        let memory = machine::peak_bytes().filter(|_| sees_memory).map(|bytes| bytes as f64);
        let bytes = Some(bytes).filter(|_| all_new);
        self.seen.push(CostObservation { work: asked.work, rows, bytes, seconds, memory });
    }

    /// Keeps the measurements. `whole` is true if the run has finished; its work outside the tables is then kept, too.
    pub fn keep(mut self, whole: bool) {
        if self.seen.is_empty() {
            return;
        }
        let used_s = machine::processor_s() - self.begun_s - self.spent_s;
        if whole {
            let work = of_run(self.graph, self.seen.iter().map(|o| o.rows * o.work.width).sum());
            let (seconds, rows) = (used_s.max(0.0), 0.0);
            self.seen.push(CostObservation { work, rows, bytes: None, seconds, memory: None });
        }
        let speed = machine::speed();
        self.seen.iter_mut().for_each(|o| o.seconds *= speed);
        observed::keep(self.store, &self.graph.plan.spec.name, self.seen);
    }
}

/// Work of a run outside its tables: keys, scores, warnings and publishing, for tables with `numbers` new numbers.
pub fn of_run(graph: &PlanGraph, numbers: f64) -> TableWork {
    let plan = graph.plan;
    let units: usize = (0..plan.tables.len()).map(|t| graph.unit_count(t)).sum();
    let part = WorkAmounts { units: plan.tables.len() as f64, samples: units as f64, values: numbers, squares: 0.0 };
    TableWork {
        stage: RUN.to_owned(),
        parts: [(RUN.to_owned(), part)].into(),
        units: units as f64,
        ..TableWork::default()
    }
}
