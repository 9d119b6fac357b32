//! A run of some tables only: what the others have already, and what stays as it was.

use schemas::Grain;

use super::runner::{PlanRunner, UnitLookup};
use crate::plan::{Plan, PlanUnit, TableRef};

/// The target tables of a run up to one table.
pub struct TargetTables {
    /// Their positions; `None` for all.
    tables: Option<Vec<usize>>,
    /// Those that are not up to date and were not asked for.
    pub left: Vec<usize>,
}

impl TargetTables {
    /// Up to the table at position `until`, or all.
    pub fn new(plan: &Plan, until: Option<usize>) -> TargetTables {
        TargetTables { tables: until.map(|t| plan.rests_on(t)), left: vec![] }
    }

    /// Whether the table `t` is computed.
    pub fn is(&self, t: usize) -> bool {
        self.tables.as_ref().is_none_or(|all| all.contains(&t))
    }

    /// Message for the user about the skipped tables.
    pub fn note(&self, plan: &Plan) -> Option<String> {
        let names: Vec<&str> = self.names(plan).collect();
        (!names.is_empty()).then(|| {
            let which = names.join(", ");
            format!("unchanged, because `--until` does not include them: {which}")
        })
    }

    /// The names of the tables that were left, of those that are published.
    pub fn names<'p>(&self, plan: &'p Plan) -> impl Iterator<Item = &'p str> {
        let published = |t: &usize| plan.decl(*t).is_some_and(|d| d.publish);
        self.left.iter().copied().filter(published).filter_map(|t| plan.tables.get(t)).map(|node| node.name.as_str())
    }
}

impl PlanRunner<'_> {
    /// Whether the table `t`, which is not asked for, is left as it is: something of it would be computed.
    pub(super) fn is_left(&self, t: usize, left: &[usize]) -> bool {
        let node = &self.graph.plan.tables[t];
        let on_left = |r: TableRef| matches!(r, TableRef::Stage(up, _) if left.contains(&up));
        if node.sources().into_iter().any(on_left) {
            return true;
        }
        let unit_needs = |unit: PlanUnit| matches!(self.look(unit), UnitLookup::Need(_));
        // Results that are not kept cost nothing until they are needed.
        let kept = node.keep || node.entry.grain != Grain::Line;
        kept && self.graph.units(t).any(unit_needs)
    }
}
