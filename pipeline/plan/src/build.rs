//! Building of a plan from a spec.

use std::collections::HashSet;

use schemas::{Column, Fault, Grain, Role, StageEntry};

use super::{
    Plan, RecordedPlan, TableNode, axes::mentioned, builder::PlanBuilder, grid::SweepGrid, seen::IN_SAMPLE,
    variants::StageVariants,
};
use crate::spec::{Spec, SpecFaults, StageDecl};

/// Maximum number of points; more are probably a mistake.
const MOST_POINTS: usize = 10_000_000;

/// Builds a plan as [`Plan::new`] does; with a record, the inputs are not opened.
pub fn build(spec: Spec, catalogue: &[StageEntry], recorded: Option<&RecordedPlan>) -> Result<Plan, SpecFaults> {
    let mut builder = PlanBuilder::new(&spec, catalogue, recorded);
    builder.names();
    for i in builder.order() {
        if builder.stage(i).is_none() {
            builder.broken.push(builder.spec.stages[i].name.clone());
        }
    }
    if let Some(search) = &builder.spec.search {
        builder.search(search);
    }
    let PlanBuilder { mut faults, flights, maps, tables, mut notes, .. } = builder;
    if let Some(Err(wrong)) = &spec.publish {
        let all: Vec<String> = wrong.iter().map(ToString::to_string).collect();
        notes.push(format!("`[publish]` is incomplete, so `magline publish` will reject it: {}", all.join("; ")));
    }
    let mut seen = HashSet::new();
    faults.retain(|f| seen.insert((f.what.clone(), f.at.clone())));
    faults.sort_by_key(|f| f.at.as_ref().map_or(0, |a| a.start));
    if faults.is_empty() { Ok(Plan { spec, flights, maps, tables, notes }) } else { Err(spec.faults(faults)) }
}

/// Tables that a run writes in addition to the tables of the stages.
const RESERVED_TABLES: [(&str, &str); 5] = [
    ("failures", "failed results"),
    ("quality", "data quality"),
    ("warnings", "warnings"),
    ("scores_pooled", "scores pooled over lines"),
    ("trials", "search trials"),
];

impl PlanBuilder<'_> {
    /// Checks that table names are unique.
    fn names(&mut self) {
        let sources = self.spec.tables.iter().map(|t| (&t.name, &t.at));
        let mut seen: Vec<&str> = vec![];
        for (name, at) in sources.chain(self.spec.stages.iter().map(|s| (&s.name, &s.at))) {
            if seen.contains(&name.as_str()) {
                self.faults.push(Fault::new(format!("two tables have the name `{name}`")).at(at.clone()));
            }
            let taken = RESERVED_TABLES.iter().find(|(taken, _)| name == taken);
            if let Some((_, what)) = taken.filter(|(taken, _)| *taken != "trials" || self.spec.search.is_some()) {
                let fault = Fault::new(format!("`{name}` is the name of the table of {what}; choose another name"));
                self.faults.push(fault.at(at.clone()));
            }
            seen.push(name);
        }
    }

    /// Order in which each stage follows its inputs.
    fn order(&mut self) -> Vec<usize> {
        let names: Vec<Vec<String>> = self.spec.stages.iter().map(|s| self.inputs_of(s)).collect();
        let n = self.spec.stages.len();
        let (mut order, mut state) = (vec![], vec![0u8; n]);
        for i in 0..n {
            self.visit(i, &names, &mut state, &mut order);
        }
        order
    }

    fn visit(&mut self, i: usize, names: &[Vec<String>], state: &mut [u8], order: &mut Vec<usize>) {
        if state[i] == 2 {
            return;
        }
        let spec = self.spec;
        if state[i] == 1 {
            let decl = &spec.stages[i];
            self.faults
                .push(Fault::new(format!("`{}` depends on itself through its inputs", decl.name)).at(decl.at.clone()));
            self.broken.push(decl.name.clone());
            return;
        }
        state[i] = 1;
        for name in &names[i] {
            if let Some(j) = spec.stages.iter().position(|s| s.name == *name) {
                self.visit(j, names, state, order);
            }
        }
        state[i] = 2;
        order.push(i);
    }

    /// Plans one stage, or reports its faults.
    fn stage(&mut self, position: usize) -> Option<()> {
        let spec = self.spec;
        let decl = &spec.stages[position];
        if self.broken.contains(&decl.name) {
            return None;
        }
        let names: Vec<&str> = self.catalogue.iter().map(|e| e.name).collect();
        let Some(entry) = self.catalogue.iter().find(|e| e.name == decl.stage.0) else {
            let fault = Fault::new(format!("there is no stage `{}`", decl.stage.0)).nearest_part(&decl.stage.0, &names);
            self.faults.push(fault.at(decl.stage.1.clone()));
            return None;
        };
        let mut axes = match mentioned(decl, spec) {
            Ok(axes) => axes,
            Err(faults) => {
                self.faults.extend(faults);
                return None;
            }
        };
        let inputs = self.inputs_of(decl);
        for name in &inputs {
            axes.extend(self.tables.iter().filter(|t| t.name == *name).flat_map(|t| t.axes.clone()));
        }
        axes.sort_unstable();
        axes.dedup();
        let grid = SweepGrid::new(&axes, spec);
        if grid.len() > MOST_POINTS {
            self.faults.push(self.too_many(decl, &axes));
            return None;
        }
        if inputs.iter().any(|name| self.broken.contains(name)) {
            // The parameters of the stage are checked even if an input is faulty.
            self.parameters(decl, entry);
            return None;
        }
        let before = self.faults.len();
        if let (Grain::Map, Some((_, at))) = (entry.grain, &decl.predicate) {
            let fault = Fault::new(format!("`{}` works on maps, which have no lines; remove `where`", entry.name));
            self.faults.push(fault.at(at.clone()).help("remove `where`"));
        }
        let slots = self.slots(decl, entry, &grid);
        let made = match &slots {
            Some(slots) => self.variants(decl, entry, &grid, slots),
            None => {
                self.parameters(decl, entry);
                None
            }
        };
        let (slots, made) = (slots?, made?);
        if self.faults.len() > before {
            return None;
        }
        let mut unique_notes = HashSet::new();
        for note in made.variants.iter().flat_map(|v| &v.yields.notes) {
            let note = format!("`{}`: {note}", decl.name);
            if unique_notes.insert(note.clone()) {
                self.notes.push(note);
            }
        }
        let StageVariants { variants, variant, tables, table, questions } = made;
        let carry = self.carry(decl, entry, &axes, &variants, &tables)?;
        let (name, at) = (decl.name.clone(), decl.at.clone());
        let node = TableNode {
            name,
            at,
            decl: position,
            entry: entry.clone(),
            axes,
            variants,
            carry,
            keep: decl.keep.0,
            grid,
            slots,
            variant,
            table,
            tables,
            questions,
        };
        self.axis_columns(&node);
        self.tables.push(node);
        Some(())
    }

    /// Fault of a stage with too many sweep points.
    fn too_many(&self, decl: &StageDecl, axes: &[usize]) -> Fault {
        // Axes that are searched together count once.
        let is_own_axis = |i: &&usize| !self.spec.searched.contains(i) || **i == self.spec.searched.start;
        let axes = axes.iter().filter(is_own_axis).filter_map(|i| self.spec.axes.get(*i));
        let product: Vec<String> = axes.clone().map(|a| format!("{} ({})", a.name, a.values.len())).collect();
        let size = axes.fold(1u128, |n, a| n.saturating_mul(a.values.len() as u128));
        let size = if size > 10u128.pow(30) { "more than 10^30".to_owned() } else { size.to_string() };
        let what = format!("`{}` would be run at {size} points: {}", decl.name, product.join(" x "));
        let help =
            format!("at most {MOST_POINTS} are permitted: use fewer values, a smaller `up_to`, or several specs");
        Fault::new(what).at(decl.at.clone()).help(help)
    }

    /// Whether `column` is a key column for a parameter of the same name that takes its value from the axis of that
    /// name.
    fn is_own_value(&self, node: &TableNode, column: &Column) -> bool {
        let given = self.spec.stages.get(node.decl).and_then(|decl| decl.args.get(&column.name));
        let axis = given.and_then(|given| given.value.as_text()).and_then(|text| text.strip_prefix('$'));
        column.role == Role::Key && axis == Some(column.name.as_str())
    }

    /// Checks that no axis has the name of another column.
    fn axis_columns(&mut self, node: &TableNode) {
        let columns = node.columns();
        for axis in node.axes.iter().filter_map(|i| self.spec.axes.get(*i)) {
            if axis.name == IN_SAMPLE && node.in_sample_meaning().is_some() {
                let what = format!("the axis `{}` has the same name as a column of `{}`", axis.name, node.name);
                self.faults.push(Fault::new(what).at(axis.at.clone()).help("rename the axis"));
            }
            let clash = columns.iter().find(|c| c.name == axis.name);
            // In a small table, an axis may have the name of a column such as `model` or `method` that holds the axis
            // value.
            let own = axis.name == "model" || clash.is_some_and(|column| self.is_own_value(node, column));
            if clash.is_some() && !(node.is_small() && own) {
                let what = format!("the axis `{}` has the same name as a column of `{}`", axis.name, node.name);
                self.faults.push(Fault::new(what).at(axis.at.clone()).help("rename the axis"));
            }
        }
    }
}
