//! The keys `carry` and `keep` of a stage: the columns of a table of flight lines that are written in addition to the
//! computed columns, and whether results are stored.

use std::{collections::HashSet, sync::Arc};

use schemas::{Fault, Grain, Role, StageEntry, Table};

use super::{builder::PlanBuilder, node::StageVariant};
use crate::spec::StageDecl;

impl PlanBuilder<'_> {
    /// The columns of `carry` that would not be written without `carry`, unlike key, time, axis and computed columns.
    pub fn carry(
        &mut self,
        decl: &StageDecl,
        entry: &StageEntry,
        axes: &[usize],
        variants: &[StageVariant],
        tables: &[Arc<Table>],
    ) -> Option<Vec<String>> {
        let before = self.faults.len();
        let of_lines = entry.grain == Grain::Line && !entry.yields.is_small();
        if !decl.keep.0 {
            self.faults.extend(kept(decl, of_lines).map(|fault| fault.at(decl.keep.1.clone())));
        }
        if let (false, Some((_, at))) = (of_lines, decl.carry.first()) {
            let what = format!("`carry` applies only to tables of flight lines, and `{}` is not one", decl.name);
            self.faults.push(Fault::new(what).at(at.clone()).help(
                "remove `carry`; the published table has all \
                columns",
            ));
            return None;
        }
        let columns = || tables.iter().flat_map(|t| &t.shape().columns);
        let axes: HashSet<&str> = axes.iter().filter_map(|a| self.spec.axes.get(*a)).map(|a| a.name.as_str()).collect();
        let made: HashSet<&str> = variants.iter().flat_map(|v| &v.yields.columns).map(|c| c.name.as_str()).collect();
        let mut carried: Vec<String> = vec![];
        for (name, at) in &decl.carry {
            let own = axes.contains(name.as_str()) || made.contains(name.as_str());
            match columns().find(|c| c.name == *name) {
                _ if own || carried.contains(name) => {}
                Some(c) if matches!(c.role, Role::Key | Role::Time) => {}
                Some(_) => carried.push(name.clone()),
                None => {
                    let mut known: Vec<&str> = columns().map(|c| c.name.as_str()).collect();
                    known.sort_unstable();
                    known.dedup();
                    let fault = Fault::new(format!("`{}` has no column `{name}` to carry", decl.name));
                    self.faults.push(fault.nearest(name, &known).at(at.clone()));
                }
            }
        }
        (self.faults.len() == before).then_some(carried)
    }
}

/// Fault for `keep = false` where it is not permitted.
fn kept(decl: &StageDecl, of_lines: bool) -> Option<Fault> {
    if !of_lines {
        let what = format!("`keep` applies only to tables of flight lines, and `{}` is not one", decl.name);
        return Some(Fault::new(what).help("remove `keep`"));
    }
    decl.publish.then(|| {
        let what = format!("`{}` is published, so its results must be kept", decl.name);
        Fault::new(what).help("add `publish = false`, or remove `keep`")
    })
}
