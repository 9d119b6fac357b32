//! Run of selected tables: the tables to compute, and the other tables that stay unchanged.

use plan::{Plan, PlanUnit, TableRef};
use schemas::Grain;

use super::runner::{PlanRunner, UnitLookup};

/// The target tables of a run up to one table.
pub struct TargetTables {
    /// Positions; `None` for all tables.
    tables: Option<Vec<usize>>,
    /// Tables that are out of date and were not requested.
    pub left: Vec<usize>,
}

impl TargetTables {
    /// The table at position `until` and all tables upstream of it; without `until`, all tables.
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
            format!("tables left unchanged, because `--until` does not include them: {which}")
        })
    }

    /// Names of the published tables that stay unchanged.
    pub fn names<'p>(&self, plan: &'p Plan) -> impl Iterator<Item = &'p str> {
        let published = |t: &usize| plan.decl(*t).is_some_and(|d| d.publish);
        self.left.iter().copied().filter(published).filter_map(|t| plan.tables.get(t)).map(|node| node.name.as_str())
    }
}

impl PlanRunner<'_> {
    /// Whether the table `t`, which is not requested, stays unchanged. This is the case if an update would require
    /// computing some of its units, or if one of its inputs stays unchanged.
    pub(super) fn is_left(&self, t: usize, left: &[usize]) -> bool {
        let node = &self.graph.plan.tables[t];
        let on_left = |r: TableRef| matches!(r, TableRef::Stage(up, _) if left.contains(&up));
        if node.sources().into_iter().any(on_left) {
            return true;
        }
        let unit_needs = |unit: PlanUnit| matches!(self.look(unit), UnitLookup::Need(_));
        // Results that are not kept need no update: they are computed when they are used.
        let kept = node.keep || node.entry.grain != Grain::Line;
        kept && self.graph.units(t).any(unit_needs)
    }
}
