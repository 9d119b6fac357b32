//! The work itself: the inputs of some units are read, and their stage is run.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    ops::ControlFlow,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{Field, Schema};
use arrow_select::concat::concat_batches;
use rayon::prelude::*;
use schemas::{AnyLinePoint, AnyStage, AnySurveyPoint, Fault, Grain, InputKind, LineIn, Part, Prepared, Product, Work};

use super::{
    Event, Listener,
    cut::Cut,
    held::{Held, filled},
    interrupt::INTERRUPTED,
};
use crate::{
    keys::Key,
    plan::{Graph, Instance, LineId, Ref, Unit},
    store::{Remarks, Store},
};

/// The result of a computed unit.
#[derive(Clone)]
pub struct Made {
    /// The unit.
    pub unit: Unit,
    /// The columns that its stage made, or why it could not.
    pub rows: Result<RecordBatch, Fault>,
    /// Notes attached to the result: skipped lines and warnings.
    pub remarks: Remarks,
}

impl Made {
    fn failed(unit: Unit, fault: Fault) -> Made {
        Made { unit, rows: Err(fault), remarks: Remarks::default() }
    }
}

/// Points of a sweep that are computed together on one line, as wide as the widest vectors of numbers.
const POINTS_A_GROUP: usize = 8;

/// The least time between two reports of the progress of a unit.
const TOLD_EVERY: Duration = Duration::from_secs(1);

/// Dependencies of a stage's preparation: its table, and the parameters, models and maps that it uses.
type Basis = (usize, String);

/// A point on a line: its stage, the columns it reads, and what the stage prepared.
struct Input {
    stage: AnyStage,
    line: LineIn,
    prepared: Prepared,
}

impl Input {
    fn point(&self) -> Result<AnyLinePoint<'_>, Fault> {
        Ok(AnyLinePoint { stage: self.stage.of_lines()?, line: &self.line, prepared: &self.prepared })
    }
}

/// The result of a survey stage for a point: the lines that it left out, and its table.
type Gathered = (Vec<Fault>, Result<Product, Fault>);

/// Says whether a line can be used by a unit.
pub type Usable<'a> = dyn Fn(LineId, Unit) -> bool + Sync + 'a;

/// Inputs of a survey stage for its units, one per point.
struct Attended<'a> {
    worker: &'a Worker<'a>,
    units: &'a [Unit],
    /// When progress was told last.
    told: Mutex<Option<Instant>>,
}

impl Attended<'_> {
    /// Whether it is time to tell progress.
    fn is_due(&self) -> bool {
        let Ok(mut told) = self.told.lock() else { return false };
        let due = told.is_none_or(|last| last.elapsed() >= TOLD_EVERY);
        if due {
            *told = Some(Instant::now());
        }
        due
    }

    fn key(&self, point: usize) -> Option<Key> {
        self.units.get(point).and_then(|unit| self.worker.graph.key(*unit).ok())
    }
}

impl Work for Attended<'_> {
    fn kept(&self, point: usize) -> Option<Vec<u8>> {
        self.worker.store.checkpoint(self.key(point)?)
    }

    fn keep(&self, point: usize, state: &[u8]) {
        // A state that is not kept costs the time to compute it again, and the disk's fault shows when results are written.
        let _ = self.key(point).map(|key| self.worker.store.set_checkpoint(key, state));
    }

    fn goes_on(&self, point: usize, progress: &str) -> ControlFlow<()> {
        if let Some(unit) = self.units.get(point).filter(|_| self.is_due()) {
            let table = &self.worker.graph.plan.tables[unit.table].name;
            let point = &self.worker.instance(*unit).point();
            self.worker.listener.hear(&Event::Working { table, point, progress });
        }
        if INTERRUPTED.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// Computes units.
pub struct Worker<'a> {
    graph: &'a Graph<'a>,
    store: &'a Store,
    listener: &'a dyn Listener,
    prepared: Mutex<HashMap<Basis, Result<Prepared, Fault>>>,
    cuts: Vec<Result<Cut<'a>, Fault>>,
}

impl<'a> Worker<'a> {
    /// For all tables of a run.
    pub fn new(graph: &'a Graph<'a>, store: &'a Store, listener: &'a dyn Listener) -> Worker<'a> {
        let cuts = (0..graph.plan.tables.len()).map(|t| Cut::new(graph, t)).collect();
        Worker { graph, store, listener, prepared: Mutex::default(), cuts }
    }

    /// The plan with its data.
    pub fn graph(&self) -> &'a Graph<'a> {
        self.graph
    }

    /// The store.
    pub fn store(&self) -> &'a Store {
        self.store
    }

    /// Reports that the run waits for `what`, or that it resumes.
    #[cfg(feature = "cluster")]
    pub fn waits(&self, what: Option<&str>) {
        self.listener.hear(&Event::Waiting { what });
    }

    /// Granularity of the stage of a table.
    pub fn grain(&self, table: usize) -> Grain {
        self.graph.plan.tables[table].entry.grain
    }

    /// The contents of the files of a table.
    ///
    /// # Errors
    /// The same as [`Cut::new`].
    pub fn cut(&self, table: usize) -> Result<&Cut<'a>, Fault> {
        match self.cuts.get(table) {
            Some(cut) => cut.as_ref().map_err(Clone::clone),
            None => Err(Fault::bug("a table that the plan does not have")),
        }
    }

    /// Drops the preparations for the lines of a table.
    pub fn forget(&self, table: usize) {
        if let Ok(mut prepared) = self.prepared.lock() {
            prepared.retain(|(t, _), _| *t != table);
        }
    }

    /// Computes `units` of one table, in their order, in parallel; `done` is called with each finished group. Units
    /// that an interrupt leaves out are not among the results.
    pub fn compute(&self, units: &[Unit], usable: &Usable, done: &(dyn Fn(&[Made]) + Sync)) -> Vec<Made> {
        let Some(first) = units.first() else { return vec![] };
        let grain = self.graph.plan.tables[first.table].entry.grain;
        let groups = match grain {
            Grain::Line => by_line(units),
            Grain::Survey => self.by_lines_seen(units),
            Grain::Map => units.iter().map(|unit| vec![*unit]).collect(),
        };
        let one = |group: &Vec<Unit>| {
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
        let made: Vec<Vec<Made>> = groups.par_iter().with_max_len(1).map(one).collect();
        let mut of: HashMap<Unit, Made> = made.into_iter().flatten().map(|m| (m.unit, m)).collect();
        units.iter().filter_map(|u| of.remove(u)).collect()
    }

    /// All points that see the same lines of the same tables.
    fn by_lines_seen(&self, units: &[Unit]) -> Vec<Vec<Unit>> {
        let mut groups: Vec<Vec<Unit>> = vec![];
        let mut at: HashMap<String, usize> = HashMap::new();
        for unit in units {
            let group = *at.entry(self.seen(*unit)).or_insert_with(|| {
                groups.push(vec![]);
                groups.len() - 1
            });
            groups[group].push(*unit);
        }
        groups
    }

    /// The lines, tables and rows that a survey stage sees.
    pub fn seen(&self, unit: Unit) -> String {
        let it = self.instance(unit);
        let rows = it.predicate.as_ref().map(|p| p.canonical.clone());
        format!("{:?} {rows:?} {:?}", self.graph.line_inputs(&it), self.graph.line_set(unit.table, unit.instance))
    }

    /// The stage of a unit at its point.
    pub fn instance(&self, unit: Unit) -> Instance<'a> {
        self.graph.plan.instance(unit.table, unit.instance)
    }

    /// Some points of one line, run together.
    fn lines(&self, units: &[Unit]) -> Vec<Made> {
        let mut held = Held::new(self);
        let mut input = |unit: &Unit| -> Result<Input, Fault> {
            let line = unit.line.ok_or_else(|| Fault::bug("a line stage without a line"))?;
            self.input(*unit, line, &mut held)
        };
        let inputs: Vec<Result<Input, Fault>> = units.iter().map(&mut input).collect();
        let points: Vec<Result<AnyLinePoint, Fault>> =
            inputs.iter().map(|input| input.as_ref().map_err(Clone::clone)?.point()).collect();
        let able: Vec<AnyLinePoint> = points.iter().flatten().copied().collect();
        let together = match able.first() {
            Some(first) => guarded(|| Ok(first.stage.run_points(&able))),
            None => Ok(vec![]),
        };
        // A panic of one point discards the others of the group: each is then computed separately.
        let alone = |point: &AnyLinePoint| guarded(|| point.stage.run(point.line, point.prepared));
        let answers = together.unwrap_or_else(|_| able.iter().map(alone).collect());
        let mut answers = answers.into_iter();
        let one = |(unit, point): (&Unit, &Result<AnyLinePoint, Fault>)| {
            let rows = match point {
                Ok(AnyLinePoint { line, .. }) => {
                    let answer = answers.next().unwrap_or_else(|| Err(Fault::bug("a point without an answer")));
                    let answer = answer.and_then(|arrays| self.batch(&self.instance(*unit), arrays));
                    answer.map_err(|f| f.in_line(&line.flight, &line.line))
                }
                Err(fault) => Err(fault.clone()),
            };
            Made { unit: *unit, rows, remarks: Remarks::default() }
        };
        units.iter().zip(&points).map(one).collect()
    }

    /// The columns that one unit of a line stage makes.
    ///
    /// # Errors
    /// Fails when its inputs cannot be read, and where its stage does.
    pub fn alone(&self, unit: Unit, line: LineId, held: &mut Held) -> Result<RecordBatch, Fault> {
        let input = self.input(unit, line, held)?;
        let arrays = guarded(|| input.stage.of_lines()?.run(&input.line, &input.prepared));
        let arrays = arrays.map_err(|f| f.in_line(&input.line.flight, &input.line.line))?;
        self.batch(&self.instance(unit), arrays)
    }

    /// A unit of a line stage, ready to run.
    fn input(&self, unit: Unit, line: LineId, held: &mut Held) -> Result<Input, Fault> {
        let stage = self.instance(unit).stage()?;
        let prepared = self.prepare(unit, &stage)?;
        Ok(Input { line: self.line_in(unit, line, held)?, stage, prepared })
    }

    /// The inputs of the stage on one line.
    fn line_in(&self, unit: Unit, line: LineId, held: &mut Held) -> Result<LineIn, Fault> {
        let it = self.instance(unit);
        let (flight, name) = self.graph.lines[line].clone();
        let kinds = it.kinds();
        let mut inputs = vec![];
        for (i, (r, kind)) in it.inputs().iter().zip(kinds).enumerate() {
            let columns = it.yields.reads.get(i).cloned().unwrap_or_default();
            inputs.push(match kind {
                kind if !kind.is_by_line() => empty(),
                _ if it.yields.lenient => filled(held.batch(*r, line, &columns)?, &columns, held.shape(*r))?,
                _ => held.batch(*r, line, &columns)?,
            });
        }
        let keep = match (&it.predicate, it.first_input()) {
            (Some(p), Some(r)) if !p.is_of_lines() => {
                let batch = held.batch(r, line, &p.columns)?;
                // SQL: a condition on a missing column is unknown, so no row is selected.
                let whole = batch.num_columns() == p.columns.len();
                if whole { p.rows(&batch)? } else { Some(vec![false; inputs[0].num_rows()]) }
            }
            _ => None,
        };
        Ok(LineIn { flight, line: name, inputs, keep })
    }

    /// Builds what the stages of `units`, all of one table, need from their models and maps, each once. It is then
    /// shared by every line.
    pub fn prepare_all(&self, units: impl Iterator<Item = Unit>) {
        let mut seen = HashSet::new();
        let mut bases: BTreeMap<Basis, (Unit, AnyStage)> = BTreeMap::new();
        let mut waiting: Vec<Unit> = units.collect();
        while let Some(unit) = waiting.pop() {
            if !seen.insert((unit.table, unit.instance)) {
                continue;
            }
            let stage = self.instance(unit).stage();
            if let Ok(stage @ AnyStage::Line(_)) = stage
                && let Ok(basis) = self.basis(unit, &stage)
            {
                bases.entry(basis).or_insert((unit, stage));
            }
            // Results that are not kept are recomputed on demand.
            let made_again = self.instance(unit).inputs().into_iter().filter_map(|r| match r {
                Ref::Stage(table, instance) if !self.graph.plan.tables[table].keep => {
                    Some(Unit { table, instance, line: None })
                }
                Ref::Stage(..) | Ref::Flights(_) | Ref::Map(_) => None,
            });
            waiting.extend(made_again);
        }
        bases.into_values().collect::<Vec<_>>().par_iter().with_max_len(1).for_each(|(unit, stage)| {
            // Its faults are reported by each unit that needs it.
            let _ = self.prepare(*unit, stage);
        });
    }

    fn basis(&self, unit: Unit, stage: &AnyStage) -> Result<Basis, Fault> {
        let it = self.instance(unit);
        let mut name = stage.of_lines()?.prepare_key();
        for (i, (r, kind)) in it.inputs().iter().zip(it.kinds()).enumerate() {
            match kind {
                InputKind::Map | InputKind::ManyMaps | InputKind::Model | InputKind::ManyModels => {
                    name.push_str(&format!(" {}", self.graph.whole(*r)?));
                }
                InputKind::Record | InputKind::ManyRecords => {
                    name.push_str(&format!(" {}", self.graph.record(*r, &self.graph.read(&it, i))?));
                }
                InputKind::Lines | InputKind::ManyLines | InputKind::Scores => {}
            }
        }
        Ok((unit.table, name))
    }

    /// The preparations for all lines of a table. It is built without a lock: a thread that waits for its own parallel
    /// work takes up other lines meanwhile, which may come to the same place.
    fn prepare(&self, unit: Unit, stage: &AnyStage) -> Result<Prepared, Fault> {
        let basis = self.basis(unit, stage)?;
        let failed = || Fault::bug("another thread failed while preparing the stage");
        if let Some(known) = self.prepared.lock().map_err(|_| failed())?.get(&basis) {
            return known.clone();
        }
        let build = || {
            let inputs = self.whole_inputs(&self.instance(unit))?;
            guarded(|| stage.of_lines()?.prepare(&inputs))
        };
        let built = build();
        self.prepared.lock().map_err(|_| failed())?.entry(basis).or_insert(built).clone()
    }

    /// The inputs that are the same for all lines; those by line are empty.
    fn whole_inputs(&self, it: &Instance) -> Result<Vec<RecordBatch>, Fault> {
        let one = |(i, (kind, r)): (usize, (InputKind, Ref))| match kind {
            InputKind::Record | InputKind::ManyRecords => self.record(r, &self.graph.read(it, i)),
            InputKind::Map | InputKind::ManyMaps => self.graph.map(self.store, r),
            InputKind::Model | InputKind::ManyModels => self.model(r),
            InputKind::Lines | InputKind::ManyLines | InputKind::Scores => Ok(empty()),
        };
        it.kinds().into_iter().zip(it.inputs()).enumerate().map(one).collect()
    }

    /// The columns `columns` of all lines of a record, one line after another.
    fn record(&self, r: Ref, columns: &[String]) -> Result<RecordBatch, Fault> {
        let mut held = Held::new(self);
        let shape = held.shape(r);
        let mut lines = vec![];
        for line in self.graph.lines_in(r) {
            lines.push(filled(held.batch(r, line, columns)?, columns, shape.clone())?);
        }
        let Some(schema) = lines.first().map(RecordBatch::schema) else { return Ok(empty()) };
        concat_batches(&schema, &lines).map_err(|e| Fault::machine(e.to_string()))
    }

    fn model(&self, r: Ref) -> Result<RecordBatch, Fault> {
        let (t, i) = match r {
            Ref::Stage(t, i) => (t, i),
            Ref::Map(_) => return self.store.whole(self.graph.whole(r)?),
            Ref::Flights(_) => return Ok(empty()),
        };
        let columns: Vec<&str> =
            self.graph.plan.instance(t, i).variant.yields.columns.iter().map(|c| c.name.as_str()).collect();
        self.store.get(self.graph.whole(r)?, &columns)
    }

    /// One point of a stage that works on maps.
    fn map(&self, unit: Unit) -> Made {
        let made = || {
            let it = self.instance(unit);
            let maps: Vec<RecordBatch> =
                it.inputs().iter().map(|r| self.graph.map(self.store, *r)).collect::<Result<_, Fault>>()?;
            let stage = it.stage()?;
            let Product { columns, warnings } = guarded(|| stage.of_maps()?.run(&maps))?;
            Ok((self.batch(&it, columns)?, warnings))
        };
        match made() {
            Ok((rows, warnings)) => Made { unit, rows: Ok(rows), remarks: Remarks { warnings, left_out: vec![] } },
            Err(fault) => Made::failed(unit, fault),
        }
    }

    /// A line that cannot be used is left out and named; the others are gathered.
    fn survey(&self, units: &[Unit], usable: &Usable) -> Vec<Made> {
        let all = |fault: Fault| units.iter().map(|u| Made::failed(*u, fault.clone())).collect();
        let stages = match units.iter().map(|u| self.instance(*u).stage()).collect::<Result<Vec<_>, Fault>>() {
            Ok(stages) => stages,
            Err(fault) => return all(fault),
        };
        let whole = match units.iter().map(|u| self.whole_inputs(&self.instance(*u))).collect::<Result<Vec<_>, Fault>>()
        {
            Ok(whole) => whole,
            Err(fault) => return all(fault),
        };
        let points = stages.iter().zip(&whole);
        let points: Result<Vec<AnySurveyPoint>, Fault> =
            points.map(|(stage, inputs)| Ok(AnySurveyPoint { stage: stage.of_surveys()?, inputs })).collect();
        let gather = points.and_then(|points| match points.first() {
            Some(first) => first.stage.gather(&points),
            None => Err(Fault::bug("a survey without points")),
        });
        let gather = match gather {
            Ok(gather) => gather,
            Err(fault) => return all(fault),
        };
        let first = units[0];
        let lines: Vec<LineId> =
            self.graph.lines_of(first.table, first.instance).iter().copied().filter(|l| usable(*l, first)).collect();
        let mapped: Vec<Result<Part, Fault>> = lines
            .par_iter()
            .with_max_len(1)
            .map(|line| {
                let mut held = Held::new(self);
                let input = self.gathered(units, *line, &mut held)?;
                guarded(|| gather.map(&input)).map_err(|f| f.in_line(&input.flight, &input.line))
            })
            .collect();
        if let Some(fault) = mapped.iter().filter_map(|m| m.as_ref().err()).find(|f| !f.owner.is_lasting()) {
            return all(fault.clone());
        }
        let mut left_out: Vec<Vec<Fault>> = units.iter().map(|_| vec![]).collect();
        let mut parts = vec![];
        for (line, part) in lines.iter().zip(mapped) {
            let (flight, name) = &self.graph.lines[*line];
            match part {
                Ok(part) => {
                    for (point, fault) in gather.refused(&part) {
                        left_out[point].push(fault.in_line(flight, name));
                    }
                    parts.push(part);
                }
                Err(fault) => {
                    let fault = fault.in_line(flight, name);
                    left_out.iter_mut().for_each(|faults| faults.push(fault.clone()));
                }
            }
        }
        let mut tables =
            match guarded(|| gather.finish(parts, &Attended { worker: self, units, told: Mutex::default() })) {
                Ok(tables) => tables,
                Err(fault) => return all(fault),
            };
        for (table, left_out) in tables.iter_mut().zip(&left_out).filter(|(_, l)| l.len() == lines.len()) {
            *table = Err(nothing_left(left_out));
        }
        let made = |(unit, (left_out, table)): (&Unit, Gathered)| {
            let (rows, warnings) = match table {
                Ok(Product { columns, warnings }) => (self.batch(&self.instance(*unit), columns), warnings),
                Err(fault) => (Err(fault), vec![]),
            };
            Made { unit: *unit, rows, remarks: Remarks { left_out, warnings } }
        };
        let made = units.iter().zip(left_out.into_iter().zip(tables)).map(made);
        // An interrupted unit has no final outcome.
        let stopped =
            |m: &Made| INTERRUPTED.load(Ordering::Relaxed) && m.rows.as_ref().is_err_and(|f| !f.owner.is_lasting());
        made.filter(|m| !stopped(m)).collect()
    }

    /// One line as all points of a survey task see it: the columns of all of them.
    fn gathered(&self, units: &[Unit], line: LineId, held: &mut Held) -> Result<LineIn, Fault> {
        let first = units[0];
        let mut input = self.line_in(first, line, held)?;
        for (i, r) in self.graph.line_inputs(&self.instance(first)) {
            let mut columns: Vec<String> = vec![];
            for unit in units {
                for c in self.instance(*unit).variant.yields.reads.get(i).into_iter().flatten() {
                    if !columns.contains(c) {
                        columns.push(c.clone());
                    }
                }
            }
            input.inputs[i] = held.batch(r, line, &columns)?;
        }
        Ok(input)
    }

    /// The stage's arrays as a batch, checked against its declaration.
    fn batch(&self, it: &Instance, arrays: Vec<ArrayRef>) -> Result<RecordBatch, Fault> {
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

/// The fault of a survey stage without usable lines.
fn nothing_left(faults: &[Fault]) -> Fault {
    let Some(first) = faults.first() else { return Fault::data("none of the selected lines could be computed") };
    Fault::data(format!("none of the {} selected lines can be used; the first: {first}", faults.len()))
}

fn empty() -> RecordBatch {
    RecordBatch::new_empty(Arc::new(Schema::empty()))
}

/// Runs a stage; a panic in it is an error of that stage, not the end of the run.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<String>().map(String::as_str).or_else(|| cause.downcast_ref::<&str>().copied());
        Err(Fault::bug(format!("the stage panicked ({})", text.unwrap_or("no message"))))
    })
}

/// Some points of one line each, in the order of the units.
fn by_line(units: &[Unit]) -> Vec<Vec<Unit>> {
    let mut lines: Vec<Vec<Unit>> = vec![];
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
