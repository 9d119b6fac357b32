//! Computation of units: reads the inputs of some units, and runs their stage.

use std::{
    collections::HashMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, atomic::Ordering},
};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{Field, Schema};
use plan::{LineId, PlanGraph, PlanUnit, StageInstance};
use rayon::prelude::*;
use schemas::{AnyLinePoint, AnySharedData, AnyStage, Fault, Grain, LineInput, StageOutput};
use store::{Remarks, Store};

#[cfg(feature = "cluster")]
use super::Event;
use super::{Listener, cut::TableAssembler, held::LineColumnCache, interrupt::INTERRUPTED};

mod inputs;
mod survey;

/// Result of a computed unit.
#[derive(Clone)]
pub struct UnitResult {
    /// Unit of the plan.
    pub unit: PlanUnit,
    /// Columns that the stage made, or the fault of the stage.
    pub rows: Result<RecordBatch, Fault>,
    /// Notes attached to the result: skipped lines and warnings.
    pub remarks: Remarks,
}

impl UnitResult {
    fn failed(unit: PlanUnit, fault: Fault) -> UnitResult {
        UnitResult { unit, rows: Err(fault), remarks: Remarks::default() }
    }
}

/// Number of points of a sweep that are computed together on one line; equal to the number of values in the widest SIMD
/// vectors.
const POINTS_A_GROUP: usize = 8;

/// Key of a stage's preparation: the position of its table, and a text that names the parameters, models and maps that
/// the preparation uses.
type PreparationKey = (usize, String);

/// A stage with its inputs for one point on one line: its columns and its preparation.
struct LineUnitInput {
    stage: AnyStage,
    line: LineInput,
    prepared: AnySharedData,
}

impl LineUnitInput {
    fn point(&self) -> Result<AnyLinePoint<'_>, Fault> {
        Ok(AnyLinePoint { stage: self.stage.of_lines()?, line: &self.line, prepared: &self.prepared })
    }
}

/// Function that decides whether a line is usable for a unit.
pub type LineUsability<'a> = dyn Fn(LineId, PlanUnit) -> bool + Sync + 'a;

/// Component that computes units, with a cache of prepared stages.
pub struct UnitWorker<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    listener: &'a dyn Listener,
    prepared: Mutex<HashMap<PreparationKey, Result<AnySharedData, Fault>>>,
    cuts: Vec<Result<TableAssembler<'a>, Fault>>,
}

impl<'a> UnitWorker<'a> {
    /// Worker for all tables of a run.
    pub fn new(graph: &'a PlanGraph<'a>, store: &'a Store, listener: &'a dyn Listener) -> UnitWorker<'a> {
        let cuts = (0..graph.plan.tables.len()).map(|t| TableAssembler::new(graph, t)).collect();
        UnitWorker { graph, store, listener, prepared: Mutex::default(), cuts }
    }

    /// Plan with its data.
    pub fn graph(&self) -> &'a PlanGraph<'a> {
        self.graph
    }

    /// The store.
    pub fn store(&self) -> &'a Store {
        self.store
    }

    /// Reports that the run waits for `what`; `None` reports that it resumes.
    #[cfg(feature = "cluster")]
    pub fn waits(&self, what: Option<&str>) {
        self.listener.on_event(&Event::Waiting { what });
    }

    /// Granularity of the stage of a table.
    pub fn grain(&self, table: usize) -> Grain {
        self.graph.plan.tables[table].entry.grain
    }

    /// Contents of the files of a table.
    ///
    /// # Errors
    /// Returns the errors of [`TableAssembler::new`].
    pub fn cut(&self, table: usize) -> Result<&TableAssembler<'a>, Fault> {
        match self.cuts.get(table) {
            Some(cut) => cut.as_ref().map_err(Clone::clone),
            None => Err(Fault::bug("a table is not in the plan")),
        }
    }

    /// Drops the preparations of the stage of a table.
    pub fn forget(&self, table: usize) {
        if let Ok(mut prepared) = self.prepared.lock() {
            prepared.retain(|(t, _), _| *t != table);
        }
    }

    /// Computes the units `units` of one table in parallel; the results are in the order of the units. Calls `done`
    /// with each finished group. The results lack units that an interrupt skips.
    pub fn compute(
        &self,
        units: &[PlanUnit],
        usable: &LineUsability,
        done: &(dyn Fn(&[UnitResult]) + Sync),
    ) -> Vec<UnitResult> {
        let Some(first) = units.first() else { return vec![] };
        let grain = self.graph.plan.tables[first.table].entry.grain;
        let groups = match grain {
            Grain::Line => by_line(units),
            Grain::Survey => self.by_lines_seen(units),
            Grain::Map => units.iter().map(|unit| vec![*unit]).collect(),
        };
        let one = |group: &Vec<PlanUnit>| {
            if INTERRUPTED.load(Ordering::Relaxed) {
                return vec![];
            }
            let made = match grain {
                Grain::Line => self.lines(group),
                Grain::Survey => self.survey(group, usable),
                Grain::Map => group.iter().map(|unit| self.map(*unit)).collect(),
            };
            done(&made);
            made
        };
        let made: Vec<Vec<UnitResult>> = groups.par_iter().with_max_len(1).map(one).collect();
        let mut of: HashMap<PlanUnit, UnitResult> = made.into_iter().flatten().map(|m| (m.unit, m)).collect();
        units.iter().filter_map(|u| of.remove(u)).collect()
    }

    /// Stage of a unit at its point.
    pub fn instance(&self, unit: PlanUnit) -> StageInstance<'a> {
        self.graph.plan.instance(unit.table, unit.instance)
    }

    /// Computes some points of one line together.
    fn lines(&self, units: &[PlanUnit]) -> Vec<UnitResult> {
        let mut held = LineColumnCache::new(self);
        let mut input = |unit: &PlanUnit| -> Result<LineUnitInput, Fault> {
            let line = unit.line.ok_or_else(|| Fault::bug("a stage that works on one line has no line"))?;
            self.input(*unit, line, &mut held)
        };
        let inputs: Vec<Result<LineUnitInput, Fault>> = units.iter().map(&mut input).collect();
        let points: Vec<Result<AnyLinePoint, Fault>> =
            inputs.iter().map(|input| input.as_ref().map_err(Clone::clone)?.point()).collect();
        let able: Vec<AnyLinePoint> = points.iter().flatten().copied().collect();
        let together = match able.first() {
            Some(first) => guarded(|| Ok(first.stage.run_points(&able))),
            None => Ok(vec![]),
        };
        // A panic of one point discards the results of the whole group; each point is then computed separately.
        let alone = |point: &AnyLinePoint| guarded(|| point.stage.run(point.line, point.prepared));
        let answers = together.unwrap_or_else(|_| able.iter().map(alone).collect());
        let mut answers = answers.into_iter();
        let one = |(unit, point): (&PlanUnit, &Result<AnyLinePoint, Fault>)| {
            let rows = match point {
                Ok(AnyLinePoint { line, .. }) => {
                    let answer = answers.next().unwrap_or_else(|| Err(Fault::bug("a point has no result")));
                    let answer = answer.and_then(|arrays| self.batch(&self.instance(*unit), arrays));
                    answer.map_err(|f| f.in_line(&line.flight, &line.line))
                }
                Err(fault) => Err(fault.clone()),
            };
            UnitResult { unit: *unit, rows, remarks: Remarks::default() }
        };
        units.iter().zip(&points).map(one).collect()
    }

    /// Columns that one unit of a line stage makes.
    ///
    /// # Errors
    /// Fails if its inputs cannot be read, or its stage fails.
    pub fn alone(&self, unit: PlanUnit, line: LineId, held: &mut LineColumnCache) -> Result<RecordBatch, Fault> {
        let input = self.input(unit, line, held)?;
        let arrays = guarded(|| input.stage.of_lines()?.run(&input.line, &input.prepared));
        let arrays = arrays.map_err(|f| f.in_line(&input.line.flight, &input.line.line))?;
        self.batch(&self.instance(unit), arrays)
    }

    /// Unit of a line stage with its inputs.
    fn input(&self, unit: PlanUnit, line: LineId, held: &mut LineColumnCache) -> Result<LineUnitInput, Fault> {
        let stage = self.instance(unit).stage()?;
        let prepared = self.prepare(unit, &stage)?;
        Ok(LineUnitInput { line: self.line_in(unit, line, held)?, stage, prepared })
    }

    /// Computes one point of a map stage.
    fn map(&self, unit: PlanUnit) -> UnitResult {
        let made = || {
            let it = self.instance(unit);
            let maps: Vec<RecordBatch> =
                it.inputs().iter().map(|r| self.graph.map(self.store, *r)).collect::<Result<_, Fault>>()?;
            let stage = it.stage()?;
            let StageOutput { columns, warnings } = guarded(|| stage.of_maps()?.run(&maps))?;
            Ok((self.batch(&it, columns)?, warnings))
        };
        match made() {
            Ok((rows, warnings)) => {
                UnitResult { unit, rows: Ok(rows), remarks: Remarks { warnings, left_out: vec![] } }
            }
            Err(fault) => UnitResult::failed(unit, fault),
        }
    }

    /// Batch of the arrays that a stage made, checked against the stage's declaration.
    fn batch(&self, it: &StageInstance, arrays: Vec<ArrayRef>) -> Result<RecordBatch, Fault> {
        let fields: Vec<Field> = it.yields.columns.iter().map(schemas::Column::field).collect();
        let fits =
            fields.len() == arrays.len() && fields.iter().zip(&arrays).all(|(f, a)| f.data_type() == a.data_type());
        if !fits {
            let name = it.node.entry.name;
            return Err(Fault::bug(format!("the columns of `{name}` differ from its declaration")));
        }
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
    }
}

fn empty() -> RecordBatch {
    RecordBatch::new_empty(Arc::new(Schema::empty()))
}

/// Runs a stage. A panic is an error of that stage and does not end the run.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<String>().map(String::as_str).or_else(|| cause.downcast_ref::<&str>().copied());
        Err(Fault::bug(format!("the stage panicked ({})", text.unwrap_or("no message"))))
    })
}

/// Groups of units by line, in the order of the units.
fn by_line(units: &[PlanUnit]) -> Vec<Vec<PlanUnit>> {
    let mut lines: Vec<Vec<PlanUnit>> = vec![];
    let mut at: HashMap<Option<LineId>, usize> = HashMap::new();
    for unit in units {
        let i = *at.entry(unit.line).or_insert_with(|| {
            lines.push(vec![]);
            lines.len() - 1
        });
        lines[i].push(*unit);
    }
    lines.iter().flat_map(|line| line.chunks(POINTS_A_GROUP).map(<[_]>::to_vec)).collect()
}
