//! Inputs of a stage: its columns on a line, and the models, maps and records that all lines share.

use std::{
    collections::{BTreeMap, HashSet},
    sync::Arc,
};

use arrow_array::{BooleanArray, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use arrow_select::concat::concat_batches;
use plan::{IN_SAMPLE, LineId, PlanUnit, StageInstance, TableRef};
use rayon::prelude::*;
use schemas::{AnySharedData, AnyStage, Fault, InputKind, LineInput};

use super::{
    super::held::{LineColumnCache, filled},
    PreparationKey, UnitWorker, empty, guarded,
};

impl UnitWorker<'_> {
    /// Inputs of the stage on one line.
    pub(super) fn line_in(&self, unit: PlanUnit, line: LineId, held: &mut LineColumnCache) -> Result<LineInput, Fault> {
        let it = self.instance(unit);
        let (flight, name) = self.graph.lines[line].clone();
        let kinds = it.kinds();
        let mut inputs = vec![];
        for (i, (r, kind)) in it.inputs().iter().zip(kinds).enumerate() {
            let columns = it.yields.reads.get(i).cloned().unwrap_or_default();
            inputs.push(match kind {
                kind if !kind.is_by_line() => empty(),
                InputKind::Scores => self.scores(*r, line, &columns, held)?,
                _ if it.yields.lenient => filled(held.batch(*r, line, &columns)?, &columns, held.shape(*r))?,
                _ => held.batch(*r, line, &columns)?,
            });
        }
        let keep = match (&it.predicate, it.first_input()) {
            (Some(p), Some(r)) if !p.is_of_lines() => {
                let batch = held.batch(r, line, &p.columns)?;
                // As in SQL, a condition on a missing column is neither true nor false, so it selects no row.
                let whole = batch.num_columns() == p.columns.len();
                if whole { p.rows(&batch)? } else { Some(vec![false; inputs[0].num_rows()]) }
            }
            _ => None,
        };
        Ok(LineInput { flight, line: name, inputs, keep })
    }

    /// Columns of the scores of a line, including [`IN_SAMPLE`] if requested.
    pub(super) fn scores(
        &self,
        r: TableRef,
        line: LineId,
        columns: &[String],
        held: &mut LineColumnCache,
    ) -> Result<RecordBatch, Fault> {
        let asked = columns.iter().any(|c| c == IN_SAMPLE);
        let Some(seen) = (if asked { self.graph.in_sample(r, line)? } else { None }) else {
            return held.batch(r, line, columns);
        };
        let made: Vec<String> = columns.iter().filter(|c| *c != IN_SAMPLE).cloned().collect();
        let batch = held.batch(r, line, &made)?;
        let mut fields = batch.schema().fields().to_vec();
        fields.push(Arc::new(Field::new(IN_SAMPLE, DataType::Boolean, true)));
        let mut arrays = batch.columns().to_vec();
        arrays.push(Arc::new(BooleanArray::from(vec![seen; batch.num_rows()])));
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
    }

    /// Prepares the stages of `units`, all of one table, from their models and maps, each stage once. Every line shares
    /// the result.
    pub fn prepare_all(&self, units: impl Iterator<Item = PlanUnit>) {
        let mut seen = HashSet::new();
        let mut bases: BTreeMap<PreparationKey, (PlanUnit, AnyStage)> = BTreeMap::new();
        let mut waiting: Vec<PlanUnit> = units.collect();
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
                TableRef::Stage(table, instance) if !self.graph.plan.tables[table].keep => {
                    Some(PlanUnit { table, instance, line: None })
                }
                TableRef::Stage(..) | TableRef::Flights(_) | TableRef::Map(_) => None,
            });
            waiting.extend(made_again);
        }
        bases.into_values().collect::<Vec<_>>().par_iter().with_max_len(1).for_each(|(unit, stage)| {
            // Faults are ignored here: each unit that needs the preparation reports them.
            let _ = self.prepare(*unit, stage);
        });
    }

    fn basis(&self, unit: PlanUnit, stage: &AnyStage) -> Result<PreparationKey, Fault> {
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

    /// Preparation for all lines of a table. No lock is held while the preparation is built: a thread that waits for
    /// its own parallel work processes other lines in the meantime, and these lines may need the same preparation.
    pub(super) fn prepare(&self, unit: PlanUnit, stage: &AnyStage) -> Result<AnySharedData, Fault> {
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

    /// Inputs that are the same for all lines; inputs by line are empty.
    pub(super) fn whole_inputs(&self, it: &StageInstance) -> Result<Vec<RecordBatch>, Fault> {
        let one = |(i, (kind, r)): (usize, (InputKind, TableRef))| match kind {
            InputKind::Record | InputKind::ManyRecords => self.record(r, &self.graph.read(it, i)),
            InputKind::Map | InputKind::ManyMaps => self.graph.map(self.store, r),
            InputKind::Model | InputKind::ManyModels => self.model(r),
            InputKind::Lines | InputKind::ManyLines | InputKind::Scores => Ok(empty()),
        };
        it.kinds().into_iter().zip(it.inputs()).enumerate().map(one).collect()
    }

    /// Columns `columns` of all lines of a record, line after line.
    fn record(&self, r: TableRef, columns: &[String]) -> Result<RecordBatch, Fault> {
        let mut held = LineColumnCache::new(self);
        let shape = held.shape(r);
        let mut lines = vec![];
        for line in self.graph.lines_in(r) {
            lines.push(filled(held.batch(r, line, columns)?, columns, shape.clone())?);
        }
        let Some(schema) = lines.first().map(RecordBatch::schema) else { return Ok(empty()) };
        concat_batches(&schema, &lines).map_err(|e| Fault::machine(e.to_string()))
    }

    fn model(&self, r: TableRef) -> Result<RecordBatch, Fault> {
        let (t, i) = match r {
            TableRef::Stage(t, i) => (t, i),
            TableRef::Map(_) => return self.store.whole(self.graph.whole(r)?),
            TableRef::Flights(_) => return Ok(empty()),
        };
        let columns: Vec<&str> =
            self.graph.plan.instance(t, i).variant.yields.columns.iter().map(|c| c.name.as_str()).collect();
        self.store.get(self.graph.whole(r)?, &columns)
    }
}
