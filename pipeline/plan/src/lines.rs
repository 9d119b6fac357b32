//! Lines of each point of each table. A set of lines is stored once for all points that share it.

use std::{collections::HashMap, sync::Arc};

use schemas::Fault;

use super::{
    Plan,
    grid::{SweepGrid, SweepPointMap, SweepValues},
    node::{InputSlot, InputTarget, TableNode},
};
use crate::predicate::Predicate;

/// A line, as a position in the lines of a [graph](super::PlanGraph).
pub type LineId = usize;

/// Lines of each point of each table.
#[derive(Default)]
pub struct LineSets {
    /// The distinct sets of lines, each sorted.
    sets: Vec<Vec<LineId>>,
    known: HashMap<Vec<LineId>, u32>,
    /// The set of each point of each table, as a position in `sets`.
    of: Vec<SweepValues<u32>>,
}

impl LineSets {
    /// The lines of the point `i` of the table `t`, sorted.
    pub fn point_lines(&self, t: usize, i: usize) -> &[LineId] {
        &self.sets[self.set(t, i) as usize]
    }

    /// Number that identifies the set of lines of the point `i` of the table `t`. Points with the same lines have the
    /// same number.
    pub fn set(&self, t: usize, i: usize) -> u32 {
        *self.of[t].at(i)
    }

    /// The axes that the lines of the table `t` depend on.
    pub fn grid(&self, t: usize) -> &SweepGrid {
        self.of[t].grid()
    }

    /// The distinct sets of lines of the table `t`, each with the number of points that use it.
    pub fn each(&self, t: usize, points: usize) -> impl Iterator<Item = (&[LineId], usize)> {
        let of = &self.of[t];
        let times = points / of.grid().len().max(1);
        of.values().iter().map(move |set| (self.sets[*set as usize].as_slice(), times))
    }

    /// Determines the lines of each table in turn, from the lines of the tables of flights.
    ///
    /// # Errors
    /// Fails if a `where` selects nothing; the fault names the table of the `where`.
    pub fn new(plan: &Plan, flights: Vec<Vec<LineId>>, lines: &[(String, String)]) -> Result<LineSets, (usize, Fault)> {
        let mut all = LineSets::default();
        let flights: Vec<u32> = flights.into_iter().map(|set| all.add(set)).collect();
        for (t, node) in plan.tables.iter().enumerate() {
            let of = all.table(plan, node, &flights, lines).map_err(|fault| (t, fault))?;
            all.of.push(of);
        }
        Ok(all)
    }

    fn add(&mut self, set: Vec<LineId>) -> u32 {
        if let Some(known) = self.known.get(&set) {
            return *known;
        }
        let next = self.sets.len() as u32;
        self.known.insert(set.clone(), next);
        self.sets.push(set);
        next
    }

    fn table(
        &mut self,
        plan: &Plan,
        node: &TableNode,
        flights: &[u32],
        lines: &[(String, String)],
    ) -> Result<SweepValues<u32>, Fault> {
        let slots: Vec<&InputSlot> = node.slots.iter().filter(|s| s.kind.is_by_line()).collect();
        let mut axes: Vec<usize> = vec![];
        for slot in &slots {
            axes.extend(slot.targets.grid().axes());
            for target in slot.targets.values().iter().flat_map(|t| t.iter()) {
                if let InputTarget::Stage(t, _) = target {
                    axes.extend(self.of[*t].grid().axes());
                }
            }
        }
        if node.variants.iter().any(|v| v.predicate.is_some()) {
            axes.extend(node.variant.grid().axes());
        }
        let grid = SweepGrid::new(&axes, &plan.spec);
        let to_slots: Vec<SweepPointMap> = slots.iter().map(|s| grid.onto(s.targets.grid())).collect();
        let to_sets: Vec<SweepPointMap> = self.of.iter().map(|of| grid.onto(of.grid())).collect();
        let to_variant = grid.onto(node.variant.grid());
        let mut known: HashMap<(Vec<u32>, Option<*const Predicate>), u32> = HashMap::new();
        let mut found = Vec::with_capacity(grid.len());
        for g in 0..grid.len() {
            let mut inputs: Vec<u32> = vec![];
            for (slot, to) in slots.iter().zip(&to_slots) {
                for target in slot.targets.values()[to.at(g)].iter() {
                    match target {
                        InputTarget::Flights(i) => inputs.push(flights[*i]),
                        InputTarget::Stage(t, _) => inputs.push(self.of[*t].values()[to_sets[*t].at(g)]),
                        InputTarget::Map(_) => {}
                    }
                }
            }
            inputs.sort_unstable();
            inputs.dedup();
            let variant = node.variant.values()[to_variant.at(g)];
            let predicate = node.variants.get(variant as usize).and_then(|v| v.predicate.as_ref());
            let question = (inputs, predicate.map(Arc::as_ptr));
            found.push(match known.get(&question) {
                Some(set) => *set,
                None => {
                    let selected = select(self.common(&question.0), predicate.map(AsRef::as_ref), lines)?;
                    let set = self.add(selected);
                    known.insert(question, set);
                    set
                }
            });
        }
        Ok(SweepValues::new(&node.grid, grid, found))
    }

    /// Lines that are in all of these sets.
    fn common(&self, sets: &[u32]) -> Vec<LineId> {
        let Some((first, others)) = sets.split_first() else { return vec![] };
        let others: Vec<&Vec<LineId>> = others.iter().map(|s| &self.sets[*s as usize]).collect();
        let in_all = |line: &&LineId| others.iter().all(|s| s.binary_search(line).is_ok());
        self.sets[*first as usize].iter().filter(in_all).copied().collect()
    }
}

/// Lines that a `where` selects.
fn select(lines: Vec<LineId>, predicate: Option<&Predicate>, all: &[(String, String)]) -> Result<Vec<LineId>, Fault> {
    let Some(predicate) = predicate else { return Ok(lines) };
    let names: Vec<(String, String)> = lines.iter().map(|l| all[*l].clone()).collect();
    let selected = predicate.lines(&names)?;
    let selected: Vec<LineId> = lines.into_iter().zip(selected).filter(|(_, s)| *s).map(|(l, _)| l).collect();
    if selected.is_empty() {
        let some: Vec<String> = all.iter().take(12).map(|(f, l)| format!("{f}/{l}")).collect();
        let fault = Fault::new("`where` selects no line");
        return Err(fault.help(format!("available lines, as flight/line: {}", some.join(", "))));
    }
    Ok(selected)
}
