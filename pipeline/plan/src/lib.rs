//! The plan: the tables, their points of the sweep, and their inputs.
//!
//! All faults of a spec are found here, before anything runs. The points of a sweep are not listed. A table stores only
//! the differences between its points, and the axis values of a point are computed from its index.

mod axes;
mod build;
mod builder;
mod carry;
mod graph;
mod grid;
mod inputs;
mod keys;
mod lines;
mod memo;
mod node;
pub mod predicate;
mod recorded;
mod search;
mod seen;
pub mod sources;
pub mod spec;
mod variants;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use schemas::{Fault, StageEntry, StageRole, metric::Metric};

pub use graph::{ColumnLocation, PlanGraph, PlanUnit};
pub use grid::{SweepGrid, SweepPoint};
pub use lines::LineId;
pub use node::{StageInstance, StageVariant, TableNode};
pub use recorded::RecordedPlan;
pub use search::SearchGoal;
pub use seen::{IN_SAMPLE, InSampleColumn, InSampleLines};

use crate::{
    sources::{Flights, MapSource},
    spec::{Spec, SpecFaults, StageDecl},
};

#[cfg(test)]
mod tests;

/// Reads the spec at `path` and applies the assignments of `--set`.
///
/// # Errors
/// Fails if it cannot be read or its form is wrong.
pub fn read_spec(path: &Path, sets: &[String]) -> Result<Spec, SpecFaults> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| SpecFaults {
        file: file.clone(),
        text: String::new(),
        sets: vec![],
        faults: vec![Fault::new(format!("cannot read {file}: {e}")).help("give a spec, which is a TOML file")],
    })?;
    let folder =
        path.parent().map(Path::to_owned).filter(|p| !p.as_os_str().is_empty()).unwrap_or_else(|| PathBuf::from("."));
    parse_spec(&file, folder, text, sets)
}

/// Parses the text of a spec and applies the assignments of `--set`. `file` is the name of the spec in messages;
/// relative paths start from `folder`.
///
/// # Errors
/// Fails if its form is wrong, or its store cannot be prepared.
pub fn parse_spec(file: &str, folder: PathBuf, text: String, sets: &[String]) -> Result<Spec, SpecFaults> {
    let spec = Spec::parse(file, folder, text, sets)?;
    if let Some((address, at)) = &spec.store_at {
        store::prepared(address).map_err(|fault| spec.faults(vec![fault.at(at.clone())]))?;
    }
    Ok(spec)
}

/// A checked pipeline.
pub struct Plan {
    /// The spec from which the plan was made.
    pub spec: Spec,
    /// The tables of flights that the spec reads.
    pub flights: Vec<Flights>,
    /// The maps that the spec reads, and the models that were fitted elsewhere.
    pub maps: Vec<MapSource>,
    /// The tables of the stages, each after its inputs.
    pub tables: Vec<TableNode>,
    /// Automatic choices that are reported to the user.
    pub notes: Vec<String>,
}

/// The table to which an input of a stage refers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TableRef {
    /// A table of flights, as a position in [`Plan::flights`].
    Flights(usize),
    /// A map or a model of files, as a position in [`Plan::maps`].
    Map(usize),
    /// A stage at a point: a position in [`Plan::tables`], and the number of the point.
    Stage(usize, usize),
}

impl Plan {
    /// Plans `spec` with the stages of `catalogue`: opens its tables, checks everything, reads no samples.
    ///
    /// # Errors
    /// Fails with all faults, one message per mistake.
    pub fn new(spec: Spec, catalogue: &[StageEntry]) -> Result<Plan, SpecFaults> {
        build::build(spec, catalogue, None)
    }

    /// The stage of the table `table` at its point `index`.
    pub fn instance(&self, table: usize, index: usize) -> StageInstance<'_> {
        let node = &self.tables[table];
        StageInstance { plan: self, node, index, variant: &node.variants[node.variant(index)] }
    }

    /// The stage of the table `table` at each of its points.
    pub fn instances(&self, table: usize) -> impl Iterator<Item = StageInstance<'_>> {
        (0..self.tables[table].len()).map(move |i| self.instance(table, i))
    }

    /// Maximum number of points of a table. In a search, the points of all trials at all rungs count, including trials
    /// that are not known yet.
    pub fn most_points(&self, table: &TableNode) -> usize {
        let searched = &self.spec.searched;
        let depends = table.axes.iter().any(|a| searched.contains(a));
        let known = self.spec.axes.get(searched.start).map_or(1, |a| a.values.len()).max(1);
        match self.spec.search.as_ref().filter(|_| depends) {
            Some(search) => (table.len() / known).saturating_mul(search.most_rows()),
            None => table.len(),
        }
    }

    /// The declaration of the table `table`.
    pub fn decl(&self, table: usize) -> Option<&StageDecl> {
        self.spec.stages.get(self.tables.get(table)?.decl)
    }

    /// The position of the table `name`.
    ///
    /// # Errors
    /// Fails if there is no such table; the fault suggests the nearest name.
    pub fn table(&self, name: &str) -> Result<usize, Fault> {
        let known: Vec<&str> = self.tables.iter().map(|t| t.name.as_str()).collect();
        let found = known.iter().position(|n| *n == name);
        found.ok_or_else(|| Fault::new(format!("there is no table `{name}`")).nearest(name, &known))
    }

    /// The metric `name` of one of the plan's stages.
    pub fn metric(&self, name: &str) -> Option<&Metric> {
        self.tables.iter().flat_map(|t| &t.entry.metrics).find(|m| m.name == name)
    }

    /// The nearest table, among `from` and the tables upstream, whose stage has the role `role`.
    pub fn upstream(&self, from: &[TableRef], role: StageRole) -> Option<TableRef> {
        let mut queue: Vec<TableRef> = from.to_vec();
        let mut seen: BTreeSet<TableRef> = BTreeSet::new();
        let mut next = 0;
        while let Some(r) = queue.get(next).copied() {
            next += 1;
            let TableRef::Stage(t, i) = r else { continue };
            if !seen.insert(r) {
                continue;
            }
            if self.tables[t].entry.role == Some(role) {
                return Some(r);
            }
            queue.extend(self.instance(t, i).inputs());
        }
        None
    }

    /// The tables whose stage has the role `role`, in the plan's order.
    pub fn tables_of(&self, role: StageRole) -> impl Iterator<Item = usize> + '_ {
        (0..self.tables.len()).filter(move |t| self.tables[*t].entry.role == Some(role))
    }

    /// The tables that `table` depends on, including itself, sorted.
    pub fn rests_on(&self, table: usize) -> Vec<usize> {
        let mut found = BTreeSet::from([table]);
        let mut queue = vec![table];
        while let Some(t) = queue.pop() {
            for r in self.tables[t].sources() {
                if let TableRef::Stage(s, _) = r
                    && found.insert(s)
                {
                    queue.push(s);
                }
            }
        }
        found.into_iter().collect()
    }

    /// The name of the table at a position; empty for an invalid position.
    pub fn table_name(&self, table: usize) -> &str {
        self.tables.get(table).map_or("", |t| t.name.as_str())
    }

    /// The name of the table `r` in the spec.
    pub fn name_of(&self, r: TableRef) -> &str {
        match r {
            TableRef::Flights(i) => &self.flights[i].name,
            TableRef::Map(i) => &self.maps[i].name,
            TableRef::Stage(t, _) => &self.tables[t].name,
        }
    }
}
