//! Amounts of work of a plan: the missing units of each table.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
};

use arrow_array::{cast::AsArray, types::Float64Type};
use arrow_schema::DataType;
use plan::{LineId, PlanGraph, PlanUnit, StageInstance, TableRef};
use schemas::{ColumnType, Fault, Grain, InputKind, PassThroughColumns, TableKind, keys::HashKey};
use store::{RowLocation, Store, row_bytes};

use super::{
    fit::UnitPrices,
    observed::{TableWork, WorkAmounts},
};
use crate::{cut::TableAssembler, layout::TableLayout};

/// Number of points of a line that are computed together.
const TOGETHER: usize = 8;
/// Maximum number of lines from which the sampling rate of a table of flights is determined.
const LOOKED_AT: usize = 16;

/// Missing units of a table, and the work that they require.
#[derive(Clone, Debug, Default)]
pub struct MissingWork {
    /// Units.
    pub units: usize,
    /// Units that are stored, have failed for good, or are duplicates.
    pub there: usize,
    /// Rows that are in the store already.
    pub rows_there: usize,
    /// The remaining work.
    pub work: TableWork,
    /// Number of rows to make.
    pub rows: f64,
    /// Number of tasks that can be computed concurrently.
    pub tasks: usize,
    /// The units to compute; of several units with the same key, only the first.
    pub missing: Vec<PlanUnit>,
}

/// Properties of a sweep point that determine the work at the point.
#[derive(Clone)]
struct PointEffort {
    kind: String,
    effort: f64,
    /// Numbers read per row.
    width: f64,
}

/// Column lists that the points of a table read; equal lists are stored once.
#[derive(Default)]
struct ColumnLists {
    /// The index of each column, by the table that made it and the name of the column in that table.
    numbers: HashMap<(TableRef, String), usize>,
    /// Width of each column: the count of numbers that it has per row.
    widths: Vec<f64>,
    /// The index of each list of columns.
    lists: HashMap<Vec<usize>, usize>,
    /// The columns of each list.
    by_list: Vec<Vec<usize>>,
}

impl ColumnLists {
    /// Index of a list of columns, which is added if it is new. A column is given by its source table, its name in that
    /// table, and its width.
    fn list(&mut self, columns: impl Iterator<Item = (TableRef, String, f64)>) -> usize {
        let mut list = vec![];
        for (made_by, name, width) in columns {
            let next = self.widths.len();
            let number = *self.numbers.entry((made_by, name)).or_insert(next);
            if number == next {
                self.widths.push(width);
            }
            list.push(number);
        }
        list.sort_unstable();
        let next = self.by_list.len();
        *self.lists.entry(list).or_insert_with_key(|list| {
            self.by_list.push(list.clone());
            next
        })
    }
}

/// Columns that points of one kind share on a line or a set of lines.
#[derive(Default)]
struct SharedColumns {
    rows: f64,
    lists: BTreeSet<usize>,
}

impl SharedColumns {
    /// Count of numbers read, each column counted once; and the sum over the lists of rows times the squared count of
    /// numbers per row.
    fn amounts(&self, read: &ColumnLists) -> (f64, f64) {
        let columns: BTreeSet<usize> = self.lists.iter().flat_map(|list| read.by_list[*list].iter().copied()).collect();
        let width = |columns: &mut dyn Iterator<Item = &usize>| columns.map(|c| read.widths[*c]).sum::<f64>();
        let squares = self.lists.iter().map(|list| width(&mut read.by_list[*list].iter()).powi(2));
        (self.rows * width(&mut columns.iter()), self.rows * squares.sum::<f64>())
    }
}

/// Estimator of the work of tables.
pub struct WorkEstimator<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    rows: &'a UnitPrices,
    threads: usize,
    /// Cached samples per second of each table of flights.
    rates: RefCell<HashMap<usize, Option<f64>>>,
}

impl<'a> WorkEstimator<'a> {
    /// Creates an estimator for the tables of `graph` on `threads` threads. `rows` holds the prices that predict row
    /// counts where the plan does not determine them.
    pub fn new(graph: &'a PlanGraph<'a>, store: &'a Store, rows: &'a UnitPrices, threads: usize) -> WorkEstimator<'a> {
        WorkEstimator { graph, store, rows, threads, rates: RefCell::default() }
    }

    /// Missing units of the table `t`.
    ///
    /// # Errors
    /// Fails for a table whose columns have types that no file can hold.
    pub fn missing_work(&self, t: usize) -> Result<MissingWork, Fault> {
        let node = &self.graph.plan.tables[t];
        let mut asked = MissingWork::default();
        if !node.keep {
            return Ok(asked);
        }
        let mut first: HashSet<HashKey> = HashSet::new();
        for unit in self.graph.units(t) {
            asked.units += 1;
            // A unit that cannot be computed has no key.
            let Ok(key) = self.graph.key(unit) else { continue };
            match self.store.find(key) {
                Some(RowLocation { rows, .. }) => {
                    asked.there += 1;
                    asked.rows_there += rows.unwrap_or(0);
                }
                None if first.insert(key) => asked.missing.push(unit),
                None => asked.there += 1,
            }
        }
        if !asked.missing.is_empty() {
            self.measure(t, &mut asked)?;
        }
        Ok(asked)
    }

    fn measure(&self, t: usize, asked: &mut MissingWork) -> Result<(), Fault> {
        let node = &self.graph.plan.tables[t];
        let cut = TableAssembler::new(self.graph, t)?;
        let layout = TableLayout::new(self.graph, t, &cut);
        let wanted: HashSet<PlanUnit> = asked.missing.iter().copied().collect();
        let written =
            |range: &&std::ops::Range<usize>| layout.units[(*range).clone()].iter().any(|u| wanted.contains(u));
        let chunks: Vec<f64> = layout
            .chunks
            .iter()
            .filter(written)
            .map(|range| {
                let units = layout.units[range.clone()].iter().filter(|u| wanted.contains(u));
                units.map(|u| self.bytes(*u, row_bytes(&cut.schema))).sum()
            })
            .collect();
        let mut largest = chunks.clone();
        largest.sort_by(|a, b| b.total_cmp(a));
        let mut work = TableWork {
            stage: node.entry.name.to_owned(),
            packs: chunks.len() as f64,
            held: largest.iter().take(self.threads).sum(),
            ..TableWork::default()
        };
        let mut points: HashMap<(HashKey, usize), PointEffort> = HashMap::new();
        // Columns read per line or set of lines, by kind: each column once for all points.
        let mut shared: HashMap<(String, Option<LineId>, u32), SharedColumns> = HashMap::new();
        let (mut read, mut lists) = (ColumnLists::default(), HashMap::new());
        let mut unkept: HashSet<PlanUnit> = HashSet::new();
        let mut numbers = 0.0;
        for unit in &asked.missing {
            let it = self.graph.plan.instance(unit.table, unit.instance);
            let point = points.entry((it.question(), node.variant(unit.instance))).or_insert_with(|| self.point(&it));
            let rows = self.rows_of_inputs(*unit, &it);
            let part = work.parts.entry(point.kind.clone()).or_default();
            part.units += 1.0;
            part.samples += rows * point.effort;
            let set = if node.entry.grain == Grain::Survey { self.graph.line_set(t, unit.instance) } else { 0 };
            let list = *lists.entry(unit.instance).or_insert_with(|| read.list(self.columns(&it)));
            let known = shared.entry((point.kind.clone(), unit.line, set)).or_default();
            known.rows = rows;
            known.lists.insert(list);
            work.units += 1.0;
            work.rows_in += rows;
            work.reads += point.width;
            let made = self.rows_of(*unit, &it, rows, point.width);
            asked.rows += made;
            numbers += made * width(&it, node.axes.len(), &cut);
            self.unkept(*unit, &it, &mut unkept);
        }
        work.width = if asked.rows > 0.0 { numbers / asked.rows } else { 0.0 };
        // Sorted, because sums depend on the order.
        for ((kind, ..), of_line) in shared.iter().collect::<BTreeMap<_, _>>() {
            let part = work.parts.entry(kind.clone()).or_default();
            let (values, squares) = of_line.amounts(&read);
            part.values += values;
            part.squares += if node.entry.grain == Grain::Survey { squares } else { 0.0 };
        }
        self.made_again(&unkept, &mut work.parts);
        asked.tasks = match node.entry.grain {
            Grain::Line => {
                let mut of_line: HashMap<Option<LineId>, usize> = HashMap::new();
                asked.missing.iter().for_each(|u| *of_line.entry(u.line).or_default() += 1);
                of_line.values().map(|points| points.div_ceil(TOGETHER)).sum()
            }
            Grain::Survey => {
                let lines: HashSet<LineId> =
                    asked.missing.iter().flat_map(|u| self.graph.lines_of(t, u.instance).iter().copied()).collect();
                lines.len()
            }
            Grain::Map => asked.missing.len(),
        };
        asked.work = work;
        Ok(())
    }

    /// Work per row of a point of a table.
    fn point(&self, it: &StageInstance) -> PointEffort {
        let entry = &it.node.entry;
        let (mut kind, mut effort) = (entry.name.to_owned(), 1.0);
        if let Ok(stage) = it.stage() {
            effort = stage.effort();
            if let Some(key) = entry.kinds.first().map(|k| k.key)
                && let Some((_, chosen)) = stage.canonical().into_iter().find(|(name, _)| *name == key)
            {
                // The canonical value is the name in quotes, followed by the version.
                kind = format!("{kind} {}", chosen.split('"').nth(1).unwrap_or(&chosen));
            }
            let manner = stage.manner();
            if !manner.is_empty() {
                kind = format!("{kind} {manner}");
            }
        }
        let inputs = it.inputs();
        let of = |(r, reads): (&TableRef, &Vec<String>)| reads.iter().map(|c| self.numbers(*r, c)).sum::<f64>();
        let width = inputs.iter().zip(&it.yields.reads).map(of);
        PointEffort { kind, effort: if effort.is_finite() { effort.max(0.0) } else { 1.0 }, width: width.sum() }
    }

    /// The columns that a point reads.
    fn columns<'b>(&'b self, it: &'b StageInstance) -> impl Iterator<Item = (TableRef, String, f64)> + 'b {
        let of = move |(r, reads): (TableRef, &'b Vec<String>)| {
            reads.iter().map(move |name| {
                let origin = self.graph.origin(r, name);
                (origin.made_by, origin.column, self.numbers(r, name))
            })
        };
        it.inputs().into_iter().zip(&it.yields.reads).flat_map(of)
    }

    /// Count of numbers per row in the column `name` of `r`.
    fn numbers(&self, r: TableRef, name: &str) -> f64 {
        let plan = self.graph.plan;
        let found = match r {
            TableRef::Flights(i) => plan.flights[i].shape.get(name),
            TableRef::Stage(t, i) => plan.instance(t, i).variant.table.shape().get(name),
            TableRef::Map(_) => None,
        };
        found.map_or(1.0, |c| numbers(&c.column_type))
    }

    /// Bytes of a unit in memory.
    fn bytes(&self, unit: PlanUnit, of_row: usize) -> f64 {
        let it = self.graph.plan.instance(unit.table, unit.instance);
        self.rows_of(unit, &it, self.rows_of_inputs(unit, &it), 1.0) * of_row as f64
    }

    /// Input rows of a unit: the rows of its line, of all its lines, or of its maps.
    fn rows_of_inputs(&self, unit: PlanUnit, it: &StageInstance) -> f64 {
        match (it.node.entry.grain, unit.line) {
            (Grain::Map, _) => it.inputs().iter().map(|r| self.rows_of_map(*r)).sum(),
            (_, Some(line)) => self.rows_of_line(it, line),
            (_, None) => {
                let lines = self.graph.lines_of(unit.table, unit.instance);
                lines.iter().map(|line| self.rows_of_line(it, *line)).sum()
            }
        }
    }

    /// Number of rows of a line in the first line input, to which the other line inputs are aligned.
    fn rows_of_line(&self, it: &StageInstance, line: LineId) -> f64 {
        let first = it.node.inputs(it.index).find(|(kind, _)| kind.is_by_line());
        first.map_or(0.0, |(_, r)| self.rows_in(r, line))
    }

    fn rows_in(&self, r: TableRef, line: LineId) -> f64 {
        let TableRef::Stage(table, instance) = r else {
            let TableRef::Flights(i) = r else { return 0.0 };
            return self.graph.records[i].get(&line).map_or(0.0, |l| l.rows as f64);
        };
        let it = self.graph.plan.instance(table, instance);
        let unit = PlanUnit { table, instance, line: Some(line) };
        self.rows_of(unit, &it, self.rows_of_line(&it, line), 0.0)
    }

    /// Number of rows that a unit makes from `rows` input rows of `reads` numbers each.
    fn rows_of(&self, unit: PlanUnit, it: &StageInstance, rows: f64, reads: f64) -> f64 {
        if it.node.entry.grain == Grain::Line && it.yields.passes != PassThroughColumns::None {
            return rows;
        }
        if let Some(RowLocation { rows: Some(rows), .. }) =
            self.graph.key(unit).ok().and_then(|key| self.store.find(key))
        {
            return rows as f64;
        }
        let by_rate = || {
            let rate_hz = it.yields.rate_hz.filter(|_| it.node.entry.yields == TableKind::Lines)?;
            let (_, first) = it.node.inputs(it.index).find(|(kind, _)| kind.is_by_line())?;
            Some(rows * rate_hz / self.rate(first)?)
        };
        by_rate().unwrap_or_else(|| {
            let work = TableWork {
                stage: it.node.entry.name.to_owned(),
                units: 1.0,
                rows_in: rows,
                reads,
                ..TableWork::default()
            };
            self.rows.total(&work.rows())
        })
    }

    fn rows_of_map(&self, r: TableRef) -> f64 {
        let there = self.graph.whole(r).ok().and_then(|key| self.store.find(key)).and_then(|place| place.rows);
        match (there, r) {
            (Some(rows), _) => rows as f64,
            (None, TableRef::Stage(table, instance)) => {
                let it = self.graph.plan.instance(table, instance);
                let unit = PlanUnit { table, instance, line: None };
                self.rows_of(unit, &it, self.rows_of_inputs(unit, &it), 0.0)
            }
            (None, TableRef::Map(_) | TableRef::Flights(_)) => 0.0,
        }
    }

    /// Samples per second of a table of lines, determined by a stage or by the flights upstream.
    fn rate(&self, r: TableRef) -> Option<f64> {
        match r {
            TableRef::Map(_) => None,
            TableRef::Flights(i) => {
                if let Some(known) = self.rates.borrow().get(&i) {
                    return *known;
                }
                let found = self.rate_of_flights(i);
                self.rates.borrow_mut().insert(i, found);
                found
            }
            TableRef::Stage(t, i) => {
                let it = self.graph.plan.instance(t, i);
                let below = || self.rate(it.node.inputs(i).find(|(kind, _)| kind.is_by_line())?.1);
                it.yields.rate_hz.or_else(below)
            }
        }
    }

    /// Median rate over some lines.
    fn rate_of_flights(&self, i: usize) -> Option<f64> {
        let records = self.graph.records.get(i)?;
        let step = (records.len() / LOOKED_AT).max(1);
        let usable = records.values().filter(|l| l.rows > 1 && l.fault.is_none()).step_by(step).take(LOOKED_AT);
        let mut rates: Vec<f64> = usable
            .filter_map(|line| {
                let batch = self.store.get(line.object, &["tt"]).ok()?;
                let tt = batch.column_by_name("tt")?.as_primitive_opt::<Float64Type>()?.clone();
                let span_s = tt.value(tt.len().checked_sub(1)?) - tt.value(0);
                Some((tt.len() - 1) as f64 / span_s).filter(|rate| rate.is_finite() && *rate > 0.0)
            })
            .collect();
        rates.sort_by(f64::total_cmp);
        rates.get(rates.len() / 2).copied()
    }

    /// Finds the units that must be recomputed for `unit`, because the results of their tables are not kept.
    fn unkept(&self, unit: PlanUnit, it: &StageInstance, found: &mut HashSet<PlanUnit>) {
        if self.graph.plan.tables.iter().all(|node| node.keep) {
            return;
        }
        let lines: Vec<LineId> = match unit.line {
            Some(line) => vec![line],
            None => self.graph.lines_of(unit.table, unit.instance).to_vec(),
        };
        for ((kind, r), reads) in it.node.inputs(it.index).zip(&it.variant.yields.reads) {
            if !matches!(kind, InputKind::Lines | InputKind::ManyLines) {
                continue;
            }
            for made_by in reads.iter().map(|name| self.graph.origin(r, name).made_by) {
                let TableRef::Stage(table, instance) = made_by else { continue };
                if self.graph.plan.tables[table].keep {
                    continue;
                }
                for line in &lines {
                    let above = PlanUnit { table, instance, line: Some(*line) };
                    if found.insert(above) {
                        self.unkept(above, &self.graph.plan.instance(table, instance), found);
                    }
                }
            }
        }
    }

    fn made_again(&self, units: &HashSet<PlanUnit>, parts: &mut BTreeMap<String, WorkAmounts>) {
        let mut points: HashMap<(usize, usize), PointEffort> = HashMap::new();
        for unit in units {
            let it = self.graph.plan.instance(unit.table, unit.instance);
            let point = points.entry((unit.table, unit.instance)).or_insert_with(|| self.point(&it));
            let rows = self.rows_of_inputs(*unit, &it);
            let part = parts.entry(point.kind.clone()).or_default();
            part.units += 1.0;
            part.samples += rows * point.effort;
            part.values += rows * point.width;
        }
    }
}

/// Count of numbers per row that a unit writes; constant columns take no space.
fn width(it: &StageInstance, axes: usize, cut: &TableAssembler) -> f64 {
    let made: f64 = it.yields.columns.iter().map(|c| numbers(&c.column_type)).sum();
    let passed = cut.schema.fields().iter().skip(axes).filter(|f| it.makes(f.name()).is_none());
    let passed = passed.map(|f| match f.data_type() {
        DataType::FixedSizeList(_, n) => f64::from(*n),
        DataType::Utf8 | DataType::Boolean => 0.0,
        _ => 1.0,
    });
    made + passed.sum::<f64>()
}

fn numbers(kind: &ColumnType) -> f64 {
    match kind {
        ColumnType::Float => 1.0,
        ColumnType::List(names) => names.len() as f64,
        ColumnType::Text => 0.5,
        ColumnType::Other(_) => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_shared_columns_and_products_are_counted_once() {
        let mut read = ColumnLists::default();
        let column = |table: usize, name: &str, width: f64| (TableRef::Stage(table, 0), name.to_owned(), width);
        // The first three points read eighteen terms with one of two magnetometers, two of them with the same one. The
        // last point reads the terms of another vector magnetometer.
        let lists: Vec<usize> = [(0, "mag_4"), (0, "mag_5"), (0, "mag_4"), (1, "mag_4")]
            .into_iter()
            .map(|(terms, mag)| read.list([column(2, mag, 1.0), column(terms, "tl", 18.0)].into_iter()))
            .collect();
        assert_eq!(lists, [0, 1, 0, 2]);
        let of = |lists: &[usize]| SharedColumns { rows: 100.0, lists: lists.iter().copied().collect() }.amounts(&read);
        let product = 100.0 * 19.0 * 19.0;
        assert_eq!(of(&[0]), (1900.0, product));
        assert_eq!(of(&[0, 1, 0]), (2000.0, 2.0 * product));
        assert_eq!(of(&lists), (3800.0, 3.0 * product));
        // Lists that differ only in the order of their columns are equal.
        assert_eq!(read.list([column(0, "tl", 18.0), column(2, "mag_4", 1.0)].into_iter()), 0);
    }
}
