//! The plan: which tables there are, at which points of the sweep, and what each is made from.
//!
//! Everything that can be wrong with a spec is found here, before anything runs.

mod axes;
mod build;
mod keys;

use std::{collections::BTreeSet, sync::Arc};

use schemas::{Column, Entry, Fault, Literal, StageDyn, Table, Yield};

pub use axes::Point;
pub use keys::{Graph, LineId, Unit};

use crate::{
    predicate::Predicate,
    sources::{Flights, MapSource},
    spec::{Faults, Span, Spec},
};

/// A checked pipeline.
pub struct Plan {
    /// The spec it was made from.
    pub spec: Spec,
    /// The tables of flights that it reads.
    pub flights: Vec<Flights>,
    /// The maps that it reads.
    pub maps: Vec<MapSource>,
    /// The tables that its stages yield, each after those it is made from.
    pub tables: Vec<TableNode>,
    /// Choices made for the user that he should know of.
    pub notes: Vec<String>,
}

/// One table: a stage at every point of the axes it depends on.
pub struct TableNode {
    /// Its name in the spec.
    pub name: String,
    /// Where it is declared.
    pub at: Span,
    /// The stage.
    pub entry: Entry,
    /// The axes it depends on, as positions in the spec.
    pub axes: Vec<usize>,
    /// Columns that pass through and stand in its files all the same.
    pub carry: Vec<String>,
    /// One for each point of those axes.
    pub instances: Vec<Instance>,
}

/// A stage at one point of the sweep.
pub struct Instance {
    /// The values of the table's axes.
    pub point: Point,
    /// The stage with its parameters.
    pub stage: Arc<dyn StageDyn>,
    /// Its parameters in one spelling.
    pub params: Vec<(&'static str, String)>,
    /// What it is made from, in the order of the stage's inputs.
    pub inputs: Vec<Ref>,
    /// What it reads and makes.
    pub yields: Arc<Yield>,
    /// Its table as later stages see it.
    pub table: Arc<Table>,
    /// The rows it is restricted to.
    pub predicate: Option<Predicate>,
}

/// What an input of a stage refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Ref {
    /// A table of flights, as a position in [`Plan::flights`].
    Flights(usize),
    /// A map, as a position in [`Plan::maps`].
    Map(usize),
    /// A stage at a point: positions in [`Plan::tables`] and [`TableNode::instances`].
    Stage(usize, usize),
}

impl Plan {
    /// Plans `spec` with the stages of `catalogue`: opens its tables, checks everything, reads no samples.
    ///
    /// # Errors
    /// All that is wrong, one message for one mistake.
    pub fn new(spec: Spec, catalogue: &[Entry]) -> Result<Plan, Faults> {
        build::build(spec, catalogue)
    }

    /// The instance that a reference points at.
    pub fn instance(&self, table: usize, instance: usize) -> &Instance {
        &self.tables[table].instances[instance]
    }

    /// The position of the table `name`.
    ///
    /// # Errors
    /// When there is none; the fault suggests the nearest.
    pub fn table(&self, name: &str) -> Result<usize, Fault> {
        let known: Vec<&str> = self.tables.iter().map(|t| t.name.as_str()).collect();
        let found = known.iter().position(|n| *n == name);
        found.ok_or_else(|| Fault::new(format!("there is no table `{name}`")).nearest(name, &known))
    }

    /// The nearest table above `from`, itself among them, that `stage` made.
    pub fn upstream(&self, from: &[Ref], stage: &str) -> Option<Ref> {
        let mut queue: Vec<Ref> = from.to_vec();
        let mut seen: BTreeSet<Ref> = BTreeSet::new();
        let mut next = 0;
        while let Some(r) = queue.get(next).copied() {
            next += 1;
            let Ref::Stage(t, i) = r else { continue };
            if !seen.insert(r) {
                continue;
            }
            if self.tables[t].entry.name == stage {
                return Some(r);
            }
            queue.extend(self.instance(t, i).inputs.iter().copied());
        }
        None
    }

    /// The name by which a reference is known in the spec.
    pub fn name_of(&self, r: Ref) -> &str {
        match r {
            Ref::Flights(i) => &self.flights[i].name,
            Ref::Map(i) => &self.maps[i].name,
            Ref::Stage(t, _) => &self.tables[t].name,
        }
    }
}

impl TableNode {
    /// Whether it is one small file, such as models and scores.
    pub fn is_tidy(&self) -> bool {
        self.instances.first().is_some_and(|i| i.yields.tidy)
    }

    /// Names and values of the axis columns at one point.
    pub fn axis_columns<'a>(&self, instance: &'a Instance, spec: &Spec) -> Vec<(String, &'a Literal)> {
        let names = self.axes.iter().filter_map(|i| spec.axes.get(*i)).map(|a| a.name.clone());
        names.filter_map(|n| instance.point.get(&n).map(|v| (n, v))).collect()
    }

    /// The columns of all its instances together, in order of first appearance.
    pub fn columns(&self) -> Vec<Column> {
        let mut all: Vec<Column> = vec![];
        let mut before = None;
        for instance in &self.instances {
            // Most points of a sweep share the columns of the one before.
            if before.replace(&instance.table).is_some_and(|b| Arc::ptr_eq(b, &instance.table)) {
                continue;
            }
            for column in &instance.table.shape().columns {
                if !all.iter().any(|c| c.name == column.name) {
                    all.push(column.clone());
                }
            }
        }
        all
    }
}

impl Instance {
    /// The column `name` where this stage makes it.
    pub fn makes(&self, name: &str) -> Option<&Column> {
        self.yields.columns.iter().find(|c| c.name == name)
    }
}
