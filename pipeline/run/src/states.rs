//! State of each unit of a run.

use plan::{PlanGraph, PlanUnit, TableNode};
use schemas::Grain;

/// State of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnitState {
    /// The result is in the store.
    Done,
    /// The unit cannot be computed from the data, in any run.
    Failed,
    /// The machine failed, or an input is missing.
    Missing,
}

/// States of all units.
pub struct UnitStates<'a> {
    graph: &'a PlanGraph<'a>,
    /// States by table, in the order of points, then lines.
    of: Vec<Vec<UnitState>>,
    /// Number of states that each point of a table has, by table.
    width: Vec<usize>,
}

impl<'a> UnitStates<'a> {
    /// States in which all units are missing.
    pub fn new(graph: &'a PlanGraph<'a>) -> UnitStates<'a> {
        let tables = &graph.plan.tables;
        let width = |(t, node): (usize, &TableNode)| match node.entry.grain {
            Grain::Survey | Grain::Map => 1,
            Grain::Line => graph.most_lines_of(t),
        };
        let width: Vec<usize> = tables.iter().enumerate().map(width).collect();
        let of = tables.iter().zip(&width).map(|(node, w)| vec![UnitState::Missing; node.len() * w]).collect();
        UnitStates { graph, of, width }
    }

    fn place(&self, unit: PlanUnit) -> Option<usize> {
        let own = match unit.line {
            None => 0,
            Some(line) => self.graph.lines_of(unit.table, unit.instance).binary_search(&line).ok()?,
        };
        Some(unit.instance * self.width.get(unit.table)? + own)
    }

    /// State of a unit.
    pub fn get(&self, unit: PlanUnit) -> UnitState {
        let found = self.place(unit).and_then(|i| self.of.get(unit.table)?.get(i));
        found.copied().unwrap_or(UnitState::Missing)
    }

    /// Records the state of a unit.
    pub fn set(&mut self, unit: PlanUnit, state: UnitState) {
        let found = self.place(unit).and_then(|i| self.of.get_mut(unit.table)?.get_mut(i));
        found.into_iter().for_each(|s| *s = state);
    }
}
