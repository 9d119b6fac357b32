//! Computation of a task, common to all engines: computes the units, writes their results into one pack, and returns
//! the outcome of each unit. Points of a sweep with the same computation and data are computed once.

use std::collections::{HashMap, HashSet};

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use plan::{LineId, PlanUnit};
use schemas::{Fault, keys::HashKey};
use store::{NewUnit, PackedUnit, Remarks};

use super::{
    cut::TableAssembler,
    engine::OutcomeCallback,
    events::UnitOutcome,
    held::LineColumnCache,
    task::{Receipt, Task, TaskUnit, UnitAnswer},
    work::{UnitResult, UnitWorker},
};

/// Units to compute. Points of a sweep that are equal in all inputs of their stage have one key. The first of these
/// points is computed, and the other points share its result.
struct PendingUnits {
    units: Vec<(PlanUnit, HashKey)>,
    /// First unit of each key, in order.
    first: Vec<PlanUnit>,
    of_key: HashMap<HashKey, PlanUnit>,
}

impl PendingUnits {
    fn new(units: Vec<(PlanUnit, HashKey)>) -> PendingUnits {
        let mut of_key = HashMap::new();
        let is_first = |(unit, key): &(PlanUnit, HashKey)| *of_key.entry(*key).or_insert(*unit) == *unit;
        let first = units.iter().copied().filter(is_first).map(|(unit, _)| unit).collect();
        PendingUnits { units, first, of_key }
    }

    /// Units that share the result of another unit.
    fn repeats(&self) -> HashSet<PlanUnit> {
        self.units.iter().filter(|(unit, key)| self.of_key.get(key) != Some(unit)).map(|(unit, _)| *unit).collect()
    }

    /// Results of the first units, copied to all units.
    fn spread(&self, made: Vec<UnitResult>) -> Vec<UnitResult> {
        if self.first.len() == self.units.len() {
            return made;
        }
        let of: HashMap<PlanUnit, UnitResult> = made.into_iter().map(|m| (m.unit, m)).collect();
        let one = |(unit, key): &(PlanUnit, HashKey)| {
            Some(UnitResult { unit: *unit, ..of.get(self.of_key.get(key)?)?.clone() })
        };
        self.units.iter().filter_map(one).collect()
    }
}

/// Computes a task of the table `table`, and writes its pack. Units that an interrupt skips have no answer.
pub fn compute(worker: &UnitWorker, table: usize, task: &Task, on_outcome: &OutcomeCallback) -> Receipt {
    let pending: Vec<&TaskUnit> = task.wanted().collect();
    let cut = match worker.cut(table) {
        Ok(cut) => cut,
        Err(fault) => {
            let failed = |u: &&TaskUnit| UnitAnswer::new(u, UnitOutcome::Failed, Some(fault.clone()));
            return task.receipt(pending.iter().map(failed).collect());
        }
    };
    let without: HashMap<PlanUnit, &[LineId]> =
        pending.iter().filter(|u| !u.without.is_empty()).map(|u| (u.unit(table), u.without.as_slice())).collect();
    let usable = |line: LineId, unit: PlanUnit| !without.get(&unit).is_some_and(|lines| lines.contains(&line));
    let say = |unit: PlanUnit, made: &UnitResult, computed: UnitOutcome| {
        let outcome = if made.rows.is_ok() { computed } else { UnitOutcome::Failed };
        on_outcome(unit, outcome, made.rows.as_ref().err());
    };
    let done = |made: &[UnitResult]| made.iter().for_each(|m| say(m.unit, m, UnitOutcome::Computed));
    let all = PendingUnits::new(pending.iter().map(|u| (u.unit(table), u.key)).collect());
    let mut made = all.spread(worker.compute(&all.first, &usable, &done));
    let repeats = all.repeats();
    made.iter().filter(|m| repeats.contains(&m.unit)).for_each(|m| say(m.unit, m, UnitOutcome::Reused));
    // A later run computes the units that an interrupt skips, and then writes the whole pack.
    let part = task.part || made.len() < pending.len();
    let lost = write(worker, cut, table, task, part, &mut made).err();
    let mut made = made.into_iter().peekable();
    let answer = |u: &&TaskUnit| {
        let unit = u.unit(table);
        let UnitResult { rows, .. } = made.next_if(|m| m.unit == unit)?;
        let computed = if repeats.contains(&unit) { UnitOutcome::Reused } else { UnitOutcome::Computed };
        Some(match rows.err().or_else(|| lost.clone()) {
            None => UnitAnswer::new(u, computed, None),
            Some(fault) => UnitAnswer::new(u, UnitOutcome::Failed, Some(fault)),
        })
    };
    task.receipt(pending.iter().filter_map(answer).collect())
}

/// Name of the pack of a task whose units all have results or lasting failures.
pub fn pack_of(cut: &TableAssembler, table: usize, part: bool, units: &[&TaskUnit]) -> HashKey {
    let packed =
        |u: &&TaskUnit| PackedUnit { key: u.key, passthrough_hash: cut.passthrough_hash(u.unit(table)), rows: 0 };
    name_of(cut, part, &units.iter().map(packed).collect::<Vec<_>>())
}

fn name_of(cut: &TableAssembler, part: bool, units: &[PackedUnit]) -> HashKey {
    let id = cut.id(units);
    if part { HashKey::from_parts([b"part", id.as_ref()]) } else { id }
}

/// Writes the pack of a task with the new and the stored results. The rows in `made` are moved into the pack.
fn write(
    worker: &UnitWorker,
    cut: &TableAssembler,
    table: usize,
    task: &Task,
    part: bool,
    made: &mut [UnitResult],
) -> Result<(), Fault> {
    let store = worker.store();
    let mut held = LineColumnCache::new(worker);
    let mut next = made.iter_mut().peekable();
    let nothing = RecordBatch::new_empty(Schema::empty().into());
    let (mut units, mut packed, mut written) = (vec![], vec![], vec![]);
    for of_task in &task.units {
        let (unit, key) = (of_task.unit(table), of_task.key);
        let passthrough_hash = cut.passthrough_hash(unit);
        let new = if of_task.have {
            let remarks = if unit.line.is_none() { store.remarks(key)? } else { Remarks::default() };
            match store.find(key).map(|place| place.rows) {
                Some(None) => {
                    let Some(fault) = store.failed(key)? else { continue };
                    NewUnit { key, passthrough_hash, rows: Err(fault), remarks }
                }
                Some(Some(_)) | None => {
                    let it = worker.instance(unit);
                    let names: Vec<&str> = it.yields.columns.iter().map(|c| c.name.as_str()).collect();
                    let rows = cut.rows(unit, &store.get(key, &names)?, &mut held)?;
                    NewUnit { key, passthrough_hash, rows: Ok(rows), remarks }
                }
            }
        } else {
            let Some(own) = next.next_if(|m| m.unit == unit) else { continue };
            let remarks = own.remarks.clone();
            match &mut own.rows {
                Ok(rows) => {
                    let whole = cut.rows(unit, rows, &mut held)?;
                    // From here on, `whole` holds the rows. The schemas of the units are dropped, because they would
                    // use much memory in a large sweep.
                    *rows = nothing.clone();
                    NewUnit { key, passthrough_hash, rows: Ok(whole), remarks }
                }
                Err(fault) if !fault.owner.is_lasting() => continue,
                Err(fault) => NewUnit { key, passthrough_hash, rows: Err(fault.clone()), remarks },
            }
        };
        written.push(unit);
        packed.push(PackedUnit { key, passthrough_hash, rows: 0 });
        units.push(new);
    }
    if units.is_empty() {
        return Ok(());
    }
    let id = name_of(cut, part, &packed);
    let kind = if part { HashKey::from_parts([b"part", cut.kind.as_ref()]) } else { cut.kind };
    store.pack(id, kind, &cut.schema, &cut.about(id, &written), units)
}
