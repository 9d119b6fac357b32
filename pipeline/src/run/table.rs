//! One table of a run: existing results are found, missing ones are computed, and both are written into packs.

use std::collections::{HashMap, HashSet};

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use rayon::prelude::*;
use schemas::{Fault, Grain};

use super::{
    Looked, Outcome, Runner, State,
    cut::Cut,
    layout::{Cover, Layout, cover, scattered},
    tell,
    work::{Held, Made, Worker},
};
use crate::{
    keys::Key,
    plan::{LineId, Unit},
    run::{Count, Event},
    store::{FAILED, NewUnit, Packed, Remarks},
};

/// A unit of a chunk and its state before the chunk is computed.
#[derive(Clone, Copy)]
enum Known {
    /// No rows: one of its inputs is missing, or it cannot be computed.
    Nothing,
    /// It is in the store.
    There(Packed),
    /// It is to be computed.
    Pending(Key),
}

/// The result of a chunk.
#[derive(Default)]
struct Answer {
    made: Vec<Made>,
    /// The error of writing its pack.
    lost: Option<Fault>,
}

/// The units of a chunk that are to be computed. Points of a sweep that are equal in all inputs of their stage have
/// one key: the first of them is computed, and its result is shared by the others.
struct Pending {
    units: Vec<(Unit, Key)>,
    /// The first unit of each key, in their order.
    first: Vec<Unit>,
    of_key: HashMap<Key, Unit>,
}

impl Pending {
    fn new(units: Vec<(Unit, Key)>) -> Pending {
        let mut of_key = HashMap::new();
        let is_first = |(unit, key): &(Unit, Key)| *of_key.entry(*key).or_insert(*unit) == *unit;
        let first = units.iter().copied().filter(is_first).map(|(unit, _)| unit).collect();
        Pending { units, first, of_key }
    }

    /// The units whose result is shared.
    fn repeats(&self) -> HashSet<Unit> {
        self.units.iter().filter(|(unit, key)| self.of_key.get(key) != Some(unit)).map(|(unit, _)| *unit).collect()
    }

    /// The results of the first units, for all units.
    fn spread(&self, made: Vec<Made>) -> Vec<Made> {
        if self.first.len() == self.units.len() {
            return made;
        }
        let of: HashMap<Unit, Made> = made.into_iter().map(|m| (m.unit, m)).collect();
        let one = |(unit, key): &(Unit, Key)| Some(Made { unit: *unit, ..of.get(self.of_key.get(key)?)?.clone() });
        self.units.iter().filter_map(one).collect()
    }
}

impl Runner<'_> {
    /// Computes what is missing of the table `t`, and returns the packs that contain it.
    pub(super) fn table(&mut self, t: usize) -> (Count, Vec<Key>) {
        let mut count = Count::default();
        if !self.graph.plan.tables[t].keep {
            self.passed_over(t);
            return (count, vec![]);
        }
        let cut = match Cut::new(self.graph, t) {
            Ok(cut) => cut,
            Err(fault) => {
                let units: Vec<Unit> = self.graph.units(t).collect();
                count.failed = units.len();
                units.into_iter().for_each(|unit| self.fail(unit, fault.clone()));
                return (count, vec![]);
            }
        };
        let layout = Layout::new(self.graph, t, &cut);
        let known: Vec<Known> = layout.units.iter().map(|u| self.known(*u, &cut, &mut count)).collect();
        let wanted = |known: &[Known]| -> Vec<Option<Packed>> {
            let packed = |k: &Known| match k {
                Known::There(packed) => Some(*packed),
                Known::Nothing | Known::Pending(_) => None,
            };
            known.iter().map(packed).collect()
        };
        let find = |known: &[Known], strict| cover(&self.store.catalogue(), cut.kind, &layout, &wanted(known), strict);
        let mut before = find(&known, self.compact);
        if scattered(before.packs.len(), layout.chunks.len()) {
            before = find(&known, true);
        }
        let pending = known.iter().filter(|k| matches!(k, Known::Pending(_))).count();
        let table = &self.graph.plan.tables[t].name;
        self.listener.hear(&Event::Computing { table, units: pending });
        let lacking =
            |c: &Cover, known: &[Known]| c.covered.iter().zip(known).any(|(c, k)| !c && matches!(k, Known::There(_)));
        if pending == 0 && !lacking(&before, &known) {
            return (count, before.packs);
        }
        let worker = self.worker;
        let to_do = layout.units.iter().zip(&known).filter(|(_, k)| matches!(k, Known::Pending(_))).map(|(u, _)| *u);
        if self.graph.plan.tables[t].entry.grain != Grain::Map {
            worker.prepare_all(to_do);
        }
        // A table of one chunk is always one pack.
        let whole = layout.chunks.len() <= 1 || self.compact;
        let this = &*self;
        let chunk = |range: &std::ops::Range<usize>| this.chunk(&cut, &layout, range, &known, &before, whole, worker);
        let answers: Vec<Answer> = layout.chunks.par_iter().with_max_len(1).map(chunk).collect();
        let mut known = known;
        for (range, answer) in layout.chunks.iter().zip(answers) {
            let mut made = answer.made.into_iter().peekable();
            let mut computed = HashSet::new();
            for i in range.clone() {
                let Known::Pending(key) = known[i] else { continue };
                let Some(Made { unit, rows, remarks }) = made.next_if(|m| m.unit == layout.units[i]) else { continue };
                self.left_out(unit, remarks.left_out);
                match rows.map(|_| ()).and(answer.lost.clone().map_or(Ok(()), Err)) {
                    Ok(()) => {
                        let first = computed.insert(key);
                        *(if first { &mut count.computed } else { &mut count.reused }) += 1;
                        self.states.set(unit, State::Done);
                        known[i] = Known::There(Packed { key, dress: cut.dress(unit), rows: 0 });
                    }
                    Err(fault) => {
                        count.failed += 1;
                        if fault.owner.is_lasting() {
                            known[i] = Known::There(Packed { key, dress: cut.dress(unit), rows: FAILED });
                        }
                        self.record(unit, fault);
                    }
                }
            }
        }
        let find = |known: &[Known], strict| cover(&self.store.catalogue(), cut.kind, &layout, &wanted(known), strict);
        let strict = find(&known, true);
        let after = if lacking(&strict, &known) { find(&known, false) } else { strict };
        worker.forget(t);
        (count, after.packs)
    }

    /// A table whose results are not kept: each unit is made where it is needed, if its inputs are available.
    fn passed_over(&mut self, t: usize) {
        let units: Vec<Unit> = self.graph.units(t).collect();
        for unit in units {
            let state = if self.missing_input(unit).is_none() { State::Done } else { State::Missing };
            self.states.set(unit, state);
        }
    }

    /// Records the state of a unit and reports it as an event.
    fn known(&mut self, unit: Unit, cut: &Cut, count: &mut Count) -> Known {
        match self.look(unit) {
            Looked::Skip(r) => {
                count.skipped += 1;
                let name = self.graph.plan.name_of(r);
                let why = Fault::data(format!("it is made from `{name}`, which could not be computed"));
                self.note(unit, State::Missing, Outcome::Skipped, Some(&why));
                Known::Nothing
            }
            Looked::Have(key) => {
                count.reused += 1;
                self.note(unit, State::Done, Outcome::Reused, None);
                self.went_on_without(unit, key);
                Known::There(Packed { key, dress: cut.dress(unit), rows: 0 })
            }
            Looked::Failed(key, fault) => {
                count.failed += 1;
                self.fail(unit, fault);
                Known::There(Packed { key, dress: cut.dress(unit), rows: FAILED })
            }
            Looked::Fault(fault) => {
                count.failed += 1;
                self.fail(unit, fault);
                Known::Nothing
            }
            Looked::Need(key) => Known::Pending(key),
        }
    }

    /// Computes what is pending of a chunk and writes its pack; points with the same computation and data are computed
    /// once. Where `whole`, the pack contains all of the chunk; otherwise what
    /// is new, and what no pack contains in the needed form.
    #[allow(clippy::too_many_arguments)]
    fn chunk(
        &self,
        cut: &Cut,
        layout: &Layout,
        range: &std::ops::Range<usize>,
        known: &[Known],
        cover: &Cover,
        whole: bool,
        worker: &Worker,
    ) -> Answer {
        let key = |i: usize| match known[i] {
            Known::Pending(key) => Some((layout.units[i], key)),
            Known::Nothing | Known::There(_) => None,
        };
        let pending = Pending::new(range.clone().filter_map(key).collect());
        let stale = |i: &usize| matches!(known[*i], Known::There(_)) && !cover.covered[*i];
        if pending.units.is_empty() && !range.clone().any(|i| stale(&i)) {
            return Answer::default();
        }
        let usable = |line: LineId, unit: Unit| self.line_is_there(line, unit) != State::Failed;
        let done = |made: &[Made]| {
            for Made { unit, rows, .. } in made {
                let outcome = if rows.is_ok() { Outcome::Computed } else { Outcome::Failed };
                tell(self.listener, self.graph, *unit, outcome, rows.as_ref().err());
            }
        };
        let mut made = pending.spread(worker.compute(&pending.first, &usable, &done));
        let repeats = pending.repeats();
        for Made { unit, rows, .. } in made.iter().filter(|m| repeats.contains(&m.unit)) {
            let outcome = if rows.is_ok() { Outcome::Reused } else { Outcome::Failed };
            tell(self.listener, self.graph, *unit, outcome, rows.as_ref().err());
        }
        let lost = self.write(cut, layout, range, known, &mut made, &|i| whole || stale(&i)).err();
        Answer { made, lost }
    }

    /// Writes the pack of a chunk: the new results, and the existing ones in `also`. The rows in `made` are
    /// moved out.
    fn write(
        &self,
        cut: &Cut,
        layout: &Layout,
        range: &std::ops::Range<usize>,
        known: &[Known],
        made: &mut [Made],
        also: &dyn Fn(usize) -> bool,
    ) -> Result<(), Fault> {
        let mut held = Held::new(self.worker);
        let mut next = made.iter_mut().peekable();
        let nothing = RecordBatch::new_empty(Schema::empty().into());
        let (mut units, mut packed, mut written) = (vec![], vec![], vec![]);
        for i in range.clone() {
            let unit = layout.units[i];
            let new = match known[i] {
                Known::Nothing => continue,
                Known::There(Packed { key, dress, rows: FAILED }) if also(i) => {
                    let Some(fault) = self.store.failed(key)? else { continue };
                    NewUnit { key, dress, rows: Err(fault), remarks: Remarks::default() }
                }
                Known::There(Packed { key, dress, .. }) if also(i) => {
                    let it = self.graph.plan.instance(unit.table, unit.instance);
                    let names: Vec<&str> = it.yields.columns.iter().map(|c| c.name.as_str()).collect();
                    let rows = cut.rows(unit, &self.store.get(key, &names)?, &mut held)?;
                    let remarks = if unit.line.is_none() { self.store.remarks(key)? } else { Remarks::default() };
                    NewUnit { key, dress, rows: Ok(rows), remarks }
                }
                Known::There(_) => continue,
                Known::Pending(key) => {
                    let Some(own) = next.next_if(|m| m.unit == unit) else { continue };
                    match &mut own.rows {
                        Ok(rows) => {
                            let whole = cut.rows(unit, rows, &mut held)?;
                            // The pack has them now; a schema for each unit would be a large part of the memory of a
                            // sweep.
                            *rows = nothing.clone();
                            let (dress, remarks) = (cut.dress(unit), own.remarks.clone());
                            NewUnit { key, dress, rows: Ok(whole), remarks }
                        }
                        Err(fault) if !fault.owner.is_lasting() => continue,
                        Err(fault) => NewUnit {
                            key,
                            dress: cut.dress(unit),
                            rows: Err(fault.clone()),
                            remarks: Remarks::default(),
                        },
                    }
                }
            };
            written.push(unit);
            packed.push(Packed { key: new.key, dress: new.dress, rows: 0 });
            units.push(new);
        }
        if units.is_empty() {
            return Ok(());
        }
        let id = cut.id(&packed);
        self.store.pack(id, cut.kind, &cut.schema, &cut.about(id, &written), units)
    }
}
