//! One table of the plan: a stage over some axes. Data that many points share are stored once.

use std::{collections::HashSet, ops::Deref, sync::Arc};

use schemas::{
    AnyStage, Column, Fault, InputKind, Literal, SpecEntries, StageEntry, StageSchema, Table, keys::HashKey,
};

use super::{
    Plan, TableRef,
    axes::args_at,
    grid::{SweepGrid, SweepPoint, SweepPointMap, SweepValues},
};
use crate::{
    predicate::Predicate,
    spec::{Spec, SpecSpan, StageDecl},
};

/// One table: a stage at every point of the axes on which it depends.
pub struct TableNode {
    /// Name in the spec.
    pub name: String,
    /// The position of the table's declaration in the text of the spec.
    pub at: SpecSpan,
    /// Declaration, as a position in the spec's stages.
    pub decl: usize,
    /// The stage.
    pub entry: StageEntry,
    /// The axes that the table depends on, as positions in the spec.
    pub axes: Vec<usize>,
    /// Distinct inputs and outputs, in order of first appearance; points with equal inputs and outputs share an entry.
    pub variants: Vec<StageVariant>,
    /// Columns that pass through the stage and are also written to its published table.
    pub carry: Vec<String>,
    /// Whether the table's results are stored; otherwise they are recomputed on demand.
    pub keep: bool,
    pub(super) grid: SweepGrid,
    pub(super) slots: Vec<InputSlot>,
    /// A position in `variants`.
    pub(super) variant: SweepValues<u32>,
    /// A position in `tables`.
    pub(super) table: SweepValues<u32>,
    /// The distinct schemas of the table.
    pub(super) tables: Vec<Arc<Table>>,
    /// Key of the computation at a point: stage, version and parameters.
    pub(super) questions: SweepValues<HashKey>,
}

/// Inputs and outputs of a stage, common to some points of the sweep.
pub struct StageVariant {
    /// Inputs and outputs.
    pub yields: Arc<StageSchema>,
    /// Schema of the table as seen by later stages.
    pub table: Arc<Table>,
    /// Predicate on rows, if the stage has a `where`.
    pub predicate: Option<Arc<Predicate>>,
}

impl StageVariant {
    /// The column `name` if this stage makes it.
    pub fn makes(&self, name: &str) -> Option<&Column> {
        self.yields.columns.iter().find(|c| c.name == name)
    }
}

/// Input of a stage: one name or a list of names.
pub(super) struct InputSlot {
    /// Kind.
    pub kind: InputKind,
    /// Target tables, which may depend on axes.
    pub targets: SweepValues<Arc<[InputTarget]>>,
}

/// The target of an input at the points of the stage that uses it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum InputTarget {
    Flights(usize),
    Map(usize),
    Stage(usize, Arc<SweepPointMap>),
}

impl InputTarget {
    /// The target at the point `i` of the stage.
    pub fn at(&self, i: usize) -> TableRef {
        match self {
            InputTarget::Flights(t) => TableRef::Flights(*t),
            InputTarget::Map(m) => TableRef::Map(*m),
            InputTarget::Stage(t, onto) => TableRef::Stage(*t, onto.at(i)),
        }
    }
}

impl TableNode {
    /// The number of the table's points of the sweep.
    pub fn len(&self) -> usize {
        self.grid.len()
    }

    /// Whether the table has no points; always false, because a table has at least one point.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The grid of the table's points.
    pub fn grid(&self) -> &SweepGrid {
        &self.grid
    }

    /// Whether the table is one small file, such as a table of models or scores.
    pub fn is_small(&self) -> bool {
        self.entry.yields.is_small()
    }

    /// The position in [`TableNode::variants`] of the point `i`.
    pub fn variant(&self, i: usize) -> usize {
        *self.variant.at(i) as usize
    }

    /// The inputs at the point `i`, each with its kind, in the order of the stage's inputs.
    pub fn inputs(&self, i: usize) -> impl Iterator<Item = (InputKind, TableRef)> + '_ {
        self.slots.iter().flat_map(move |s| s.targets.at(i).iter().map(move |t| (s.kind, t.at(i))))
    }

    /// Input tables over all points, without duplicates; the first point represents all points of a stage.
    pub fn sources(&self) -> Vec<TableRef> {
        let mut found = vec![];
        for target in self.slots.iter().flat_map(|s| s.targets.values()).flat_map(|t| t.iter()) {
            let r = match target.at(0) {
                TableRef::Stage(t, _) => TableRef::Stage(t, 0),
                other => other,
            };
            if !found.contains(&r) {
                found.push(r);
            }
        }
        found
    }

    /// Names and values of the axis columns at one point.
    pub fn axis_columns<'a>(&self, instance: &StageInstance, spec: &'a Spec) -> Vec<(&'a str, &'a Literal)> {
        let value = |(axis, at): (usize, usize)| {
            let axis = spec.axes.get(axis)?;
            Some((axis.name.as_str(), axis.values.get(at)?))
        };
        self.grid.place(instance.index).filter_map(value).collect()
    }

    /// The columns of all points of the table together, in order of first appearance.
    pub fn columns(&self) -> Vec<Column> {
        let mut seen: HashSet<&str> = HashSet::new();
        let (mut found, mut last): (Vec<Column>, &[Arc<Column>]) = (vec![], &[]);
        for table in &self.tables {
            let columns = table.shape().columns.shared();
            // Most columns are shared with the previous schema.
            let is_shared = |i: usize, c: &Arc<Column>| last.get(i).is_some_and(|other| Arc::ptr_eq(other, c));
            let others = columns.iter().enumerate().filter(|(i, c)| !is_shared(*i, c)).map(|(_, c)| c.as_ref());
            found.extend(others.filter(|c| seen.insert(c.name.as_str())).cloned());
            last = columns;
        }
        found
    }

    /// The distinct definitions of a column over all points.
    pub fn columns_named(&self, name: &str) -> Vec<&Column> {
        self.tables.iter().filter_map(|t| t.shape().get(name)).collect()
    }

    /// Points that together cover all inputs: one for each combination of a variant and a choice of input names.
    pub fn examples(&self, spec: &Spec) -> impl Iterator<Item = usize> + '_ {
        let names = self.slots.iter().flat_map(|s| s.targets.grid().axes());
        let axes: Vec<usize> = self.variant.grid().axes().chain(names).collect();
        let grid = SweepGrid::new(&axes, spec);
        let back = grid.onto(&self.grid);
        (0..grid.len()).map(move |i| back.at(i))
    }

    /// One point for each combination of the axes that its parameters depend on. If there are more than `most`
    /// combinations, returns one point for each value of each of these axes.
    pub fn parameter_points(&self, most: usize) -> Vec<usize> {
        let own = self.questions.grid();
        let back = own.onto(&self.grid);
        if own.len() <= most {
            return (0..own.len()).map(|p| back.at(p)).collect();
        }
        own.axes().flat_map(|axis| own.along(0, axis)).map(|p| back.at(p)).collect()
    }
}

/// A stage at one point of the sweep. The value is made on demand, and copies are cheap.
#[derive(Clone, Copy)]
pub struct StageInstance<'p> {
    /// The plan to which it belongs.
    pub plan: &'p Plan,
    /// The table of the stage.
    pub node: &'p TableNode,
    /// The point, counted with the last axis running fastest.
    pub index: usize,
    /// Inputs and outputs at this point.
    pub variant: &'p StageVariant,
}

impl Deref for StageInstance<'_> {
    type Target = StageVariant;

    fn deref(&self) -> &StageVariant {
        self.variant
    }
}

impl<'p> StageInstance<'p> {
    /// The values of the table's axes.
    pub fn point(&self) -> SweepPoint {
        self.node.grid.point(self.index, &self.plan.spec)
    }

    /// Inputs, in the order of the stage's inputs.
    pub fn inputs(&self) -> Vec<TableRef> {
        self.node.inputs(self.index).map(|(_, r)| r).collect()
    }

    /// First input.
    pub fn first_input(&self) -> Option<TableRef> {
        self.node.inputs(self.index).next().map(|(_, r)| r)
    }

    /// The kind of each input.
    pub fn kinds(&self) -> Vec<InputKind> {
        self.node.inputs(self.index).map(|(k, _)| k).collect()
    }

    /// The stage with its parameters, newly built.
    ///
    /// # Errors
    /// Never fails for a checked plan.
    pub fn stage(&self) -> Result<AnyStage, Fault> {
        let decl = self.plan.spec.stages.get(self.node.decl).ok_or_else(|| Fault::bug("a table has no stage"))?;
        let own = own_args(decl, &self.node.entry);
        let made = (self.node.entry.build)(&args_at(&own, &self.point()));
        made.map_err(|faults| {
            faults.into_iter().next().unwrap_or_else(|| Fault::bug("a stage of a checked plan is rejected"))
        })
    }

    /// Parameters in canonical spelling.
    pub fn params(&self) -> Vec<(&'static str, String)> {
        self.stage().map(|s| s.canonical()).unwrap_or_default()
    }

    /// Key of the computation without the data: equal for the same stage, version and parameters.
    pub fn question(&self) -> HashKey {
        *self.node.questions.at(self.index)
    }
}

/// The parameters among the arguments of a stage.
pub(super) fn own_args(decl: &StageDecl, entry: &StageEntry) -> SpecEntries {
    let is_input = |name: &str| entry.inputs.iter().any(|i| i.name == name);
    decl.args.iter().filter(|(k, _)| !is_input(k)).map(|(k, g)| (k.clone(), g.clone())).collect()
}
