//! Published tables: plain Parquet data sets of one run, with the axes as ordinary columns. These data sets replace the
//! previous data sets in one step.

use std::{collections::BTreeSet, sync::Arc};

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, new_null_array};
use arrow_schema::{DataType, Field, Schema};
use plan::{
    Plan, PlanGraph, PlanUnit, SweepPoint,
    spec::{SearchTrialScore, TRIAL},
};
use results::{
    pooled::{self, PooledMetric},
    warnings::Warning,
};
use schemas::{Fault, Literal, Role, field, keys::HashKey};
use store::{ExtraTable, PipelineLock, Store, TableFiles};

use super::{
    cut::{TableAssembler, axis_type, axis_values},
    failure::Failure,
    logical, quality,
};

/// Inputs of publishing.
pub struct Publication<'a> {
    /// Plan with its data.
    pub graph: &'a PlanGraph<'a>,
    /// The store.
    pub store: &'a Store,
    /// Identifier of the run.
    pub run: &'a str,
    /// Packs of each table.
    pub packs: &'a [Vec<HashKey>],
    /// Tables that stay unchanged from the previous version.
    pub left: &'a [usize],
    /// Whether a unit is available.
    pub there: &'a (dyn Fn(PlanUnit) -> bool + Sync),
}

impl Publication<'_> {
    /// Publishes all tables of the pipeline together.
    ///
    /// # Errors
    /// Fails if the store cannot be read or written; the previous tables then stay.
    pub fn publish(
        &self,
        publisher: &PipelineLock,
        failures: &[Failure],
        warnings: &[Warning],
        pooled: &[PooledMetric],
        trials: &[SearchTrialScore],
    ) -> Result<(), Fault> {
        let (graph, store) = (self.graph, self.store);
        let plan = graph.plan;
        let mut reserved_tables = vec![
            self::failures(plan, store, failures)?,
            self::warnings(plan, store, warnings)?,
            quality::table(graph, store)?,
        ];
        reserved_tables.extend(self::pooled(plan, store, pooled)?);
        reserved_tables.extend(self::trials(plan, store, trials)?);
        let (mut tables, mut kept) = (vec![], vec![]);
        for (t, (node, packs)) in plan.tables.iter().zip(self.packs).enumerate() {
            if self.left.contains(&t) {
                kept.push(node.name.clone());
                continue;
            }
            if plan.spec.stages.iter().any(|s| s.name == node.name && !s.publish) {
                continue;
            }
            let packs: Vec<HashKey> = packs.iter().copied().filter(|id| has_rows(store, *id)).collect();
            let cut = TableAssembler::new(graph, t)?;
            let units = logical::write(graph, store, &cut, t, self.there)?;
            if packs.is_empty() {
                let file = store.temporary();
                store.write_table(&file, &RecordBatch::new_empty(cut.schema.clone()), &[])?;
                reserved_tables.push(ExtraTable { name: node.name.clone(), file });
            } else {
                tables.push(TableFiles { name: node.name.clone(), packs, units });
            }
        }
        store.publish(publisher, self.run, &tables, &reserved_tables, &self.rests_on(), &kept).map(|_| ())
    }

    /// All packs that the tables reference, including the packs of the sources.
    fn rests_on(&self) -> Vec<HashKey> {
        let graph = self.graph;
        let catalogue = self.store.catalogue();
        let lines = graph.records.iter().flat_map(|r| r.values()).map(|l| l.object);
        let sources =
            lines.chain(graph.maps.iter().copied()).filter_map(|k| Some(catalogue.pack(catalogue.find(k)?.pack)?.id));
        let all: BTreeSet<HashKey> = self.packs.iter().flatten().copied().chain(sources).collect();
        all.into_iter().collect()
    }
}

fn has_rows(store: &Store, id: HashKey) -> bool {
    store.catalogue().by_id(id).is_some_and(|p| p.units.iter().any(|u| u.count().is_some_and(|n| n > 0)))
}

/// Writes the failures, even if the table is empty.
fn failures(plan: &Plan, store: &Store, failures: &[Failure]) -> Result<ExtraTable, Fault> {
    let text = |f: &dyn Fn(&Failure) -> Option<String>| -> ArrayRef {
        Arc::new(failures.iter().map(f).collect::<StringArray>())
    };
    let points: Vec<&SweepPoint> = failures.iter().map(|f| &f.point).collect();
    let columns = vec![
        ("flight", text(&|f| f.line.as_ref().map(|l| l.0.clone())), "flight identifier"),
        ("line", text(&|f| f.line.as_ref().map(|l| l.1.clone())), "line identifier"),
        ("stage", text(&|f| Some(f.table.clone())), "the table that failed"),
        ("error", text(&|f| Some(f.fault.to_string())), "the error"),
    ];
    write_reserved_table(plan, store, "failures", &points, columns)
}

/// Writes the warnings, even if the table is empty.
fn warnings(plan: &Plan, store: &Store, warnings: &[Warning]) -> Result<ExtraTable, Fault> {
    let text = |f: &dyn Fn(&Warning) -> Option<String>| -> ArrayRef {
        Arc::new(warnings.iter().map(f).collect::<StringArray>())
    };
    let number =
        |f: fn(&Warning) -> Option<f64>| -> ArrayRef { Arc::new(warnings.iter().map(f).collect::<Float64Array>()) };
    let points: Vec<&SweepPoint> = warnings.iter().map(|w| &w.point).collect();
    let columns = vec![
        ("flight", text(&|w| w.line.as_ref().map(|l| l.0.clone())), "flight identifier; null for a fit"),
        ("line", text(&|w| w.line.as_ref().map(|l| l.1.clone())), "line identifier; null for a fit"),
        ("stage", text(&|w| Some(w.stage.clone())), "the table of scores or models"),
        ("kind", text(&|w| Some(w.kind.as_str().to_owned())), "the kind of warning"),
        ("value", number(|w| w.value), "the value that caused the warning; null for a fit"),
        ("limit", number(|w| w.limit), "the limit that the value violates"),
        ("unit", text(&|w| Some(w.unit.to_owned())), "the unit of `value` and `limit`"),
        ("text", text(&|w| Some(w.text.clone())), "the message"),
        ("cause", text(&|w| w.cause.clone()), "the likely cause; null if unknown"),
    ];
    write_reserved_table(plan, store, "warnings", &points, columns)
}

/// Writes the pooled scores, even if the table is empty. Writes nothing for a plan without a table of scores.
fn pooled(plan: &Plan, store: &Store, pooled: &[PooledMetric]) -> Result<Option<ExtraTable>, Fault> {
    if pooled::tables(plan).next().is_none() {
        return Ok(None);
    }
    let text = |f: &dyn Fn(&PooledMetric) -> String| -> ArrayRef {
        Arc::new(pooled.iter().map(|p| Some(f(p))).collect::<StringArray>())
    };
    let number =
        |f: fn(&PooledMetric) -> Option<f64>| -> ArrayRef { Arc::new(pooled.iter().map(f).collect::<Float64Array>()) };
    let count = |f: fn(&PooledMetric) -> i64| -> ArrayRef {
        Arc::new(pooled.iter().map(|p| Some(f(p))).collect::<Int64Array>())
    };
    let lines = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
    let many = |f: &dyn Fn(&PooledMetric) -> usize| -> ArrayRef {
        Arc::new(pooled.iter().map(|p| Some(lines(f(p)))).collect::<Int64Array>())
    };
    let in_sample: ArrayRef = Arc::new(pooled.iter().map(|p| Some(p.is_in_sample())).collect::<BooleanArray>());
    let columns = vec![
        text(&|p| plan.table_name(p.table).to_owned()),
        text(&|p| p.metric.name.to_owned()),
        number(|p| p.shown().value),
        text(&|p| p.metric.unit.to_owned()),
        count(|p| p.shown().n),
        many(&|p| p.shown().lines),
        in_sample,
        number(|p| p.in_sample.value),
        count(|p| p.in_sample.n),
        many(&|p| p.in_sample.lines),
        text(&|p| p.metric.pool.words()),
    ];
    let columns = pooled::COLUMNS.iter().zip(columns).map(|((name, about), array)| (*name, array, *about)).collect();
    let points: Vec<SweepPoint> = pooled.iter().map(|p| plan.instance(p.table, p.instance).point()).collect();
    write_reserved_table(plan, store, pooled::TABLE, &points.iter().collect::<Vec<_>>(), columns).map(Some)
}

/// Writes the trials of a search, one row per trial and rung. Writes nothing for a spec without a search.
fn trials(plan: &Plan, store: &Store, trials: &[SearchTrialScore]) -> Result<Option<ExtraTable>, Fault> {
    let (Some(search), Some(goal)) = (&plan.spec.search, plan.goal()?) else { return Ok(None) };
    let whole = |f: &dyn Fn(&SearchTrialScore) -> usize| -> ArrayRef {
        Arc::new(trials.iter().map(|t| i64::try_from(f(t)).ok()).collect::<Int64Array>())
    };
    let text = |f: &dyn Fn(&SearchTrialScore) -> Option<String>| -> ArrayRef {
        Arc::new(trials.iter().map(f).collect::<StringArray>())
    };
    let literals: Vec<Vec<Literal>> = trials.iter().map(|t| t.row.literals(search)).collect();
    let key = |name: &str, about: &str| field(name, DataType::Int64, "", Role::Key, about);
    let mut fields = vec![
        key(TRIAL, "number of the trial"),
        key("generation", "generation of the trial; all trials of a generation were proposed together"),
        key("rung", "rung of successive halving; 1 without halving"),
    ];
    let mut arrays = vec![whole(&|t| t.row.trial), whole(&|t| t.row.generation), whole(&|t| t.row.rung)];
    for (k, (name, _)) in search.columns().into_iter().enumerate().skip(1) {
        let kind = literals.first().and_then(|row| row.get(k)).map_or(DataType::Utf8, axis_type);
        let cells: Vec<ArrayRef> = literals
            .iter()
            .map(|row| row.get(k).map_or_else(|| new_null_array(&kind, 1), |v| axis_values(v, 1)))
            .collect();
        fields.push(field(name, kind.clone(), "", Role::Key, "axis of the sweep"));
        arrays.push(one_array(&cells, &kind)?);
    }
    let about = format!(
        "`{}` of the table `{}`, pooled over the lines; null if there is no value",
        goal.metric.name, search.table
    );
    fields.push(field("goal", DataType::Float64, goal.metric.unit, Role::Derived, &about));
    arrays.push(Arc::new(trials.iter().map(|t| t.goal).collect::<Float64Array>()));
    fields.push(field("lines", DataType::Int64, "", Role::Derived, "number of line scores pooled in `goal`"));
    arrays.push(whole(&|t| t.lines));
    let word = |name: &str, about: &str| field(name, DataType::Utf8, "", Role::Key, about);
    fields.push(word("state", "state of the trial: done, promoted (to the next rung), pruned or failed"));
    arrays.push(text(&|t| Some(t.rung_outcome(search).as_str().to_owned())));
    fields.push(word("error", "the reason for a missing goal"));
    arrays.push(text(&|t| t.error.clone()));
    let batch =
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))?;
    let file = store.temporary();
    store.write_table(&file, &batch, &[])?;
    Ok(Some(ExtraTable { name: "trials".to_owned(), file }))
}

/// Concatenates cells into one array of the type `kind`.
fn one_array(cells: &[ArrayRef], kind: &DataType) -> Result<ArrayRef, Fault> {
    if cells.is_empty() {
        return Ok(new_null_array(kind, 0));
    }
    let cells: Vec<&dyn arrow_array::Array> = cells.iter().map(AsRef::as_ref).collect();
    arrow_select::concat::concat(&cells).map_err(|e| Fault::machine(e.to_string()))
}

/// Writes a reserved table. Its columns are the axes of the whole sweep (null where a row has no value), followed by
/// `columns`, each given by name, values and meaning. An axis takes precedence over a column of the same name.
fn write_reserved_table(
    plan: &Plan,
    store: &Store,
    name: &str,
    points: &[&SweepPoint],
    columns: Vec<(&str, ArrayRef, &str)>,
) -> Result<ExtraTable, Fault> {
    let mut fields = vec![];
    let mut arrays: Vec<ArrayRef> = vec![];
    for axis in &plan.spec.axes {
        let kind = axis_type(&axis.values[0]);
        let cells: Vec<ArrayRef> = points
            .iter()
            .map(|p| p.get(&axis.name).map_or_else(|| new_null_array(&kind, 1), |v| axis_values(v, 1)))
            .collect();
        arrays.push(one_array(&cells, &kind)?);
        fields.push(field(&axis.name, kind, "", Role::Key, "axis of the sweep"));
    }
    for (name, array, about) in columns {
        if fields.iter().any(|f: &Field| f.name() == name) {
            continue;
        }
        let role = if array.data_type() == &DataType::Float64 { Role::Derived } else { Role::Key };
        fields.push(field(name, array.data_type().clone(), "", role, about));
        arrays.push(array);
    }
    let batch =
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))?;
    let file = store.temporary();
    store.write_table(&file, &batch, &[])?;
    Ok(ExtraTable { name: name.to_owned(), file })
}
