//! The work itself: a task reads what its units need, runs the stage, and puts the answers into the store.

use std::{
    any::Any,
    collections::HashMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, OnceLock},
};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, RecordBatchOptions, new_null_array};
use arrow_schema::{DataType, Field, Schema};
use rayon::prelude::*;
use schemas::{Fault, InputKind, LineIn, Owner, Prepared, Shape, StageDyn};

use super::left_out;
use crate::{
    keys::Key,
    plan::{Graph, Instance, LineId, Ref, Unit},
    sources::map_batch,
    store::Store,
};

/// Units that are computed together.
pub struct Task {
    units: Vec<(Unit, Key)>,
}

/// What became of a unit.
pub struct Done {
    /// Which.
    pub unit: Unit,
    /// Why it could not be computed.
    pub fault: Option<Fault>,
    /// Of a survey stage: the lines it went on without, and why.
    pub left_out: Vec<Fault>,
}

impl Done {
    fn failed(unit: Unit, fault: Fault) -> Done {
        Done { unit, fault: Some(fault), left_out: vec![] }
    }
}

/// Points of a sweep that share the reading of one line.
const POINTS_A_TASK: usize = 12;

/// What a task may hold of columns it has read, in bytes, before it lets go of them.
const HELD_BYTES: usize = 256 << 20;

type Once = Arc<OnceLock<Result<Prepared, Fault>>>;

/// What a survey stage gives for a point: the lines that it left out, and its table.
type Gathered = (Vec<Fault>, Result<Vec<ArrayRef>, Fault>);

/// Computes units of one table.
pub struct Worker<'a> {
    graph: &'a Graph<'a>,
    store: &'a Store,
    table: usize,
    prepared: Mutex<HashMap<String, Once>>,
}

impl<'a> Worker<'a> {
    /// For the table `table`.
    pub fn new(graph: &'a Graph<'a>, store: &'a Store, table: usize) -> Worker<'a> {
        Worker { graph, store, table, prepared: Mutex::default() }
    }

    /// Tasks of a line stage: some points of one line.
    pub fn by_line(&self, pending: Vec<(Unit, Key)>) -> Vec<Task> {
        let mut lines: Vec<Vec<(Unit, Key)>> = vec![];
        let mut at: HashMap<Option<LineId>, usize> = HashMap::new();
        for (unit, key) in pending {
            let i = *at.entry(unit.line).or_insert_with(|| {
                lines.push(vec![]);
                lines.len() - 1
            });
            lines[i].push((unit, key));
        }
        let tasks =
            lines.into_iter().flat_map(|units| units.chunks(POINTS_A_TASK).map(<[_]>::to_vec).collect::<Vec<_>>());
        tasks.map(|units| Task { units }).collect()
    }

    /// Tasks of a survey stage: all points that see the same lines of the same tables.
    pub fn by_lines_seen(&self, pending: Vec<(Unit, Key)>) -> Vec<Task> {
        let mut groups: Vec<(String, Vec<(Unit, Key)>)> = vec![];
        for (unit, key) in pending {
            let it = self.instance(unit);
            let rows = it.predicate.as_ref().map(|p| p.canonical.clone());
            let seen = format!("{:?} {rows:?} {:?}", it.inputs(), self.graph.lines_of(unit.table, unit.instance));
            match groups.iter_mut().find(|(s, _)| *s == seen) {
                Some((_, units)) => units.push((unit, key)),
                None => groups.push((seen, vec![(unit, key)])),
            }
        }
        groups.into_iter().map(|(_, units)| Task { units }).collect()
    }

    fn instance(&self, unit: Unit) -> Instance<'a> {
        self.graph.plan.instance(unit.table, unit.instance)
    }

    /// Computes the units of `task`; each comes back with what went wrong, if anything did.
    pub fn run(&self, task: &Task, usable: &(dyn Fn(LineId, Unit) -> bool + Sync)) -> Vec<Done> {
        match task.units.first() {
            None => vec![],
            Some((first, _)) if first.line.is_none() => self.survey(task, usable),
            Some(_) => {
                let mut held = Held::new(self.graph, self.store);
                let one = |(unit, key): &(Unit, Key)| {
                    let fault = self.line(*unit, *key, &mut held).err();
                    Done { unit: *unit, fault, left_out: vec![] }
                };
                task.units.iter().map(one).collect()
            }
        }
    }

    fn line(&self, unit: Unit, key: Key, held: &mut Held) -> Result<(), Fault> {
        let line = unit.line.ok_or_else(|| Fault::machine("a line stage without a line"))?;
        let input = self.line_in(unit, line, held)?;
        let it = self.instance(unit);
        let arrays = guarded(|| it.stage()?.run(&input)).map_err(|f| f.in_line(&input.flight, &input.line))?;
        self.store.put(key, &self.batch(&it, arrays)?)
    }

    /// What the stage sees of one line.
    fn line_in(&self, unit: Unit, line: LineId, held: &mut Held) -> Result<LineIn, Fault> {
        let it = self.instance(unit);
        let (flight, name) = self.graph.lines[line].clone();
        let kinds = it.kinds();
        let mut inputs = vec![];
        for (i, (r, kind)) in it.inputs().iter().zip(kinds).enumerate() {
            let columns = it.yields.reads.get(i).cloned().unwrap_or_default();
            inputs.push(match kind {
                InputKind::Map => empty(),
                _ if it.yields.lenient => filled(held.batch(*r, line, &columns)?, &columns, held.shape(*r))?,
                _ => held.batch(*r, line, &columns)?,
            });
        }
        let keep = match (&it.predicate, it.first_input()) {
            (Some(p), Some(r)) if !p.is_of_lines() => {
                let batch = held.batch(r, line, &p.columns)?;
                // SQL: what is asked of a column that is not there is unknown, so no row is selected.
                let whole = batch.num_columns() == p.columns.len();
                if whole { p.rows(&batch)? } else { Some(vec![false; inputs[0].num_rows()]) }
            }
            _ => None,
        };
        Ok(LineIn { flight, line: name, inputs, keep, prepared: self.prepare(unit)? })
    }

    /// What is built once for all lines, by whoever needs it first.
    fn prepare(&self, unit: Unit) -> Result<Prepared, Fault> {
        let it = self.instance(unit);
        let kinds = it.kinds();
        let whole = |k: &InputKind| matches!(k, InputKind::Map | InputKind::Model);
        let stage = it.stage()?;
        let mut name = stage.prepare_key();
        for (r, _) in it.inputs().iter().zip(&kinds).filter(|(_, k)| whole(k)) {
            name.push_str(&format!(" {}", self.graph.object(*r, usize::MAX)?));
        }
        let once = match self.prepared.lock() {
            Ok(mut all) => all.entry(name).or_default().clone(),
            Err(_) => return Err(Fault::machine("another thread failed while preparing the stage")),
        };
        once.get_or_init(|| {
            let mut inputs = vec![];
            for (r, kind) in it.inputs().iter().zip(&kinds) {
                inputs.push(match kind {
                    InputKind::Map => map_batch(self.store, self.graph.object(*r, usize::MAX)?)?,
                    InputKind::Model => self.model(*r)?,
                    _ => empty(),
                });
            }
            guarded(|| stage.prepare(&inputs))
        })
        .clone()
    }

    fn model(&self, r: Ref) -> Result<RecordBatch, Fault> {
        let Ref::Stage(t, i) = r else { return Ok(empty()) };
        let columns: Vec<&str> =
            self.graph.plan.instance(t, i).variant.yields.columns.iter().map(|c| c.name.as_str()).collect();
        self.store.get(self.graph.object(r, usize::MAX)?, &columns)
    }

    /// A line that cannot be used is left out and named; the others are gathered.
    fn survey(&self, task: &Task, usable: &(dyn Fn(LineId, Unit) -> bool + Sync)) -> Vec<Done> {
        let all = |fault: Fault| task.units.iter().map(|(u, _)| Done::failed(*u, fault.clone())).collect();
        let stages = task.units.iter().map(|(u, _)| self.instance(*u).stage()).collect::<Result<Vec<_>, Fault>>();
        let stages = match stages {
            Ok(stages) => stages,
            Err(fault) => return all(fault),
        };
        let stages: Vec<&dyn StageDyn> = stages.iter().map(AsRef::as_ref).collect();
        let Some(gather) = stages.first().and_then(|s| s.gather(&stages)) else {
            return all(Fault::machine("a survey stage that gathers nothing: an error in magline"));
        };
        let first = task.units[0].0;
        let lines: Vec<LineId> =
            self.graph.lines_of(first.table, first.instance).iter().copied().filter(|l| usable(*l, first)).collect();
        let mapped: Vec<Result<Box<dyn Any + Send>, Fault>> = lines
            .par_iter()
            .with_max_len(1)
            .map(|line| {
                let mut held = Held::new(self.graph, self.store);
                let input = self.gathered(task, *line, &mut held)?;
                guarded(|| gather.map(&input)).map_err(|f| f.in_line(&input.flight, &input.line))
            })
            .collect();
        if let Some(fault) = mapped.iter().filter_map(|m| m.as_ref().err()).find(|f| f.owner == Owner::Machine) {
            return all(fault.clone());
        }
        let mut left_out: Vec<Vec<Fault>> = task.units.iter().map(|_| vec![]).collect();
        let mut parts = vec![];
        for (line, part) in lines.iter().zip(mapped) {
            let (flight, name) = &self.graph.lines[*line];
            match part {
                Ok(part) => {
                    for (point, fault) in gather.refused(part.as_ref()) {
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
        let mut tables = match guarded(|| Ok(gather.finish(parts))) {
            Ok(tables) => tables,
            Err(fault) => return all(fault),
        };
        for (table, left_out) in tables.iter_mut().zip(&left_out).filter(|(_, l)| l.len() == lines.len()) {
            *table = Err(nothing_left(left_out));
        }
        let put = |((unit, key), (left_out, table)): (&(Unit, Key), Gathered)| {
            let done = table.and_then(|arrays| self.batch(&self.instance(*unit), arrays)).and_then(|batch| {
                left_out::keep(self.store, *key, &left_out)?;
                self.store.put(*key, &batch)
            });
            Done { unit: *unit, fault: done.err(), left_out }
        };
        task.units.par_iter().zip(left_out.into_par_iter().zip(tables)).map(put).collect()
    }

    /// One line as all points of a survey task see it: the columns of all of them.
    fn gathered(&self, task: &Task, line: LineId, held: &mut Held) -> Result<LineIn, Fault> {
        let first = task.units[0].0;
        let mut input = self.line_in(first, line, held)?;
        for (i, r) in self.instance(first).inputs().iter().enumerate() {
            let mut columns: Vec<String> = vec![];
            for (unit, _) in &task.units {
                for c in self.instance(*unit).variant.yields.reads.get(i).into_iter().flatten() {
                    if !columns.contains(c) {
                        columns.push(c.clone());
                    }
                }
            }
            input.inputs[i] = held.batch(*r, line, &columns)?;
        }
        Ok(input)
    }

    /// The stage's arrays as a batch, held against what it declared.
    fn batch(&self, it: &Instance, arrays: Vec<ArrayRef>) -> Result<RecordBatch, Fault> {
        let fields: Vec<Field> = it.yields.columns.iter().map(schemas::Column::field).collect();
        let fits =
            fields.len() == arrays.len() && fields.iter().zip(&arrays).all(|(f, a)| f.data_type() == a.data_type());
        if !fits {
            let name = self.graph.plan.tables[self.table].entry.name;
            return Err(Fault::machine(format!(
                "`{name}` yields other columns than it declares: an error in the stage"
            )));
        }
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
    }
}

/// The batch with NaN or null for each of `columns` that it lacks, in their order.
fn filled(batch: RecordBatch, columns: &[String], shape: Option<Shape>) -> Result<RecordBatch, Fault> {
    let rows = batch.num_rows();
    let (mut fields, mut arrays) = (vec![], vec![]);
    for name in columns {
        let there = batch.schema().field_with_name(name).ok().cloned().zip(batch.column_by_name(name).cloned());
        let described = || shape.as_ref().and_then(|s| s.get(name)).map(schemas::Column::field);
        let (field, array) = match (there, described()) {
            (Some(both), _) => both,
            (None, Some(field)) if field.data_type() == &DataType::Float64 => {
                (field, Arc::new(Float64Array::from(vec![f64::NAN; rows])) as ArrayRef)
            }
            (None, Some(field)) => {
                let nothing = new_null_array(field.data_type(), rows);
                (field, nothing)
            }
            (None, None) => continue,
        };
        fields.push(field);
        arrays.push(array);
    }
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
}

/// Why a survey stage has nothing to go on with.
fn nothing_left(faults: &[Fault]) -> Fault {
    let Some(first) = faults.first() else { return Fault::data("no selected line could be computed") };
    Fault::data(format!("none of the {} selected lines can be used; the first: {first}", faults.len()))
}

fn empty() -> RecordBatch {
    RecordBatch::new_empty(Arc::new(Schema::empty()))
}

/// Runs a stage; a panic in it is an error of that stage, not the end of the run.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<String>().map(String::as_str).or_else(|| cause.downcast_ref::<&str>().copied());
        Err(Fault::machine(format!("an error in the stage: {}", text.unwrap_or("no message"))).help("please report it"))
    })
}

/// Columns that a task has read, so that its points share them.
struct Held<'a> {
    graph: &'a Graph<'a>,
    store: &'a Store,
    columns: HashMap<(Key, String), ArrayRef>,
    bytes: usize,
}

impl<'a> Held<'a> {
    fn new(graph: &'a Graph<'a>, store: &'a Store) -> Held<'a> {
        Held { graph, store, columns: HashMap::new(), bytes: 0 }
    }

    /// The columns `names` of one line of `r`, each from the object that holds it. A column that the line lacks is
    /// left out.
    fn batch(&mut self, r: Ref, line: LineId, names: &[String]) -> Result<RecordBatch, Fault> {
        let mut wanted: Vec<(String, Key, String)> = vec![];
        for name in names {
            let origin = self.graph.origin(r, name);
            if let Ref::Flights(i) = origin.made_by
                && self.graph.records[i].get(&line).is_some_and(|l| !l.columns.contains_key(&origin.column))
            {
                continue;
            }
            wanted.push((name.clone(), self.graph.object(origin.made_by, line)?, origin.column));
        }
        self.fetch(&wanted)?;
        let (mut fields, mut arrays) = (vec![], vec![]);
        let shape = self.shape(r);
        for (name, object, column) in wanted {
            let Some(array) = self.columns.get(&(object, column)) else { continue };
            let described = shape.as_ref().and_then(|s| s.get(&name)).map(schemas::Column::field);
            fields.push(described.unwrap_or_else(|| Field::new(&name, array.data_type().clone(), true)));
            arrays.push(array.clone());
        }
        let rows = arrays.first().map_or(0, |a| a.len());
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), arrays, &options)
            .map_err(|e| Fault::machine(e.to_string()))
    }

    fn shape(&self, r: Ref) -> Option<Shape> {
        match r {
            Ref::Flights(i) => Some(self.graph.plan.flights[i].shape.clone()),
            Ref::Stage(t, i) => Some(self.graph.plan.instance(t, i).table.shape().clone()),
            Ref::Map(_) => None,
        }
    }

    /// Reads what is not held yet, each object once.
    fn fetch(&mut self, wanted: &[(String, Key, String)]) -> Result<(), Fault> {
        if self.bytes > HELD_BYTES {
            self.columns.clear();
            self.bytes = 0;
        }
        let mut objects: Vec<(Key, Vec<String>)> = vec![];
        for (_, object, column) in wanted.iter().filter(|(_, o, c)| !self.columns.contains_key(&(*o, c.clone()))) {
            match objects.iter_mut().find(|(o, _)| o == object) {
                Some((_, columns)) if columns.contains(column) => {}
                Some((_, columns)) => columns.push(column.clone()),
                None => objects.push((*object, vec![column.clone()])),
            }
        }
        for (object, columns) in objects {
            let batch = self.store.get(object, &columns)?;
            for (name, array) in columns.into_iter().zip(batch.columns()) {
                self.bytes += array.get_array_memory_size();
                self.columns.insert((object, name), array.clone());
            }
        }
        Ok(())
    }
}
