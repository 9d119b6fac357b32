//! From spec to plan.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    sync::Arc,
};

use schemas::{Args, Column, Entry, Fault, Given, Grain, InputDecl, InputKind, Literal, Passes, Shape, Table, Yield};

use super::{
    Instance, Plan, Point, Ref, TableNode,
    axes::{At, args_at, axes_of, count, mentioned, points, position, put_in, spelt_in},
};
use crate::{
    predicate::Predicate,
    sources::{Flights, MapSource},
    spec::{Faults, Spec, StageDecl},
};

/// More points than this are more likely a slip than a wish.
const MOST_POINTS: usize = 100_000;
/// After so many faults of a stage its other points are not looked at.
const MOST_FAULTS: usize = 20;

/// See [`Plan::new`].
pub fn build(spec: Spec, catalogue: &[Entry]) -> Result<Plan, Faults> {
    let mut builder = Builder {
        spec: &spec,
        catalogue,
        faults: vec![],
        flights: vec![],
        shapes: vec![],
        maps: vec![],
        map_shape: Arc::new(Table::Map(schemas::map::shape())),
        sources: BTreeMap::new(),
        tables: vec![],
        broken: vec![],
        notes: vec![],
        predicates: HashMap::new(),
    };
    builder.names();
    for i in builder.order() {
        let decl = &builder.spec.stages[i];
        if builder.stage(decl).is_none() {
            builder.broken.push(decl.name.clone());
        }
    }
    let Builder { mut faults, flights, maps, tables, notes, .. } = builder;
    let mut seen = HashSet::new();
    faults.retain(|f| seen.insert((f.what.clone(), f.at.clone())));
    faults.sort_by_key(|f| f.at.as_ref().map_or(0, |a| a.start));
    if faults.is_empty() { Ok(Plan { spec, flights, maps, tables, notes }) } else { Err(spec.faults(faults)) }
}

struct Builder<'a> {
    spec: &'a Spec,
    catalogue: &'a [Entry],
    faults: Vec<Fault>,
    flights: Vec<Flights>,
    /// The table that each of `flights` is to a stage.
    shapes: Vec<Arc<Table>>,
    maps: Vec<MapSource>,
    map_shape: Arc<Table>,
    /// Tables of files already opened, by name and use; `None` where that failed.
    sources: BTreeMap<(String, bool), Option<Ref>>,
    tables: Vec<TableNode>,
    /// Stages already found wrong; what rests on them is not judged.
    broken: Vec<String>,
    notes: Vec<String>,
    /// Predicates already read, by text and the columns they see: most points of a sweep share one.
    predicates: HashMap<(String, Option<*const Table>), Predicate>,
}

/// The tables that a run writes beside those of the stages.
const BESIDE: [(&str, &str); 3] = [
    ("failures", "what failed"),
    ("quality", "the quality of the data"),
    ("warnings", "what is not to be trusted as it is"),
];

impl Builder<'_> {
    /// Every table has one name.
    fn names(&mut self) {
        let sources = self.spec.tables.iter().map(|t| (&t.name, &t.at));
        let mut seen: Vec<&str> = vec![];
        for (name, at) in sources.chain(self.spec.stages.iter().map(|s| (&s.name, &s.at))) {
            if seen.contains(&name.as_str()) {
                self.faults.push(Fault::new(format!("two tables are called `{name}`")).at(at.clone()));
            }
            if let Some((_, what)) = BESIDE.iter().find(|(taken, _)| name == taken) {
                let fault = Fault::new(format!("`{name}` is the table of {what}; choose another name"));
                self.faults.push(fault.at(at.clone()));
            }
            seen.push(name);
        }
    }

    /// The names a stage takes its inputs from, at any point of the sweep.
    fn inputs_of(&self, decl: &StageDecl) -> Vec<String> {
        let Some(entry) = self.catalogue.iter().find(|e| e.name == decl.stage.0) else { return vec![] };
        let mut names = BTreeSet::new();
        for given in entry.inputs.iter().filter_map(|i| decl.args.get(i.name)) {
            let axes = axes_of(&given.value, self.spec);
            // A stage with more points than that is refused later.
            for at in points(&axes, self.spec).take(MOST_POINTS) {
                names.extend(texts(&put_in(&given.value, &at.point)));
            }
        }
        names.into_iter().collect()
    }

    /// The stages, each after those it takes its inputs from.
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
            self.faults.push(
                Fault::new(format!("`{}` is made from itself, through its inputs", decl.name)).at(decl.at.clone()),
            );
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

    /// Plans one stage, or says what is wrong with it.
    fn stage(&mut self, decl: &StageDecl) -> Option<()> {
        if self.broken.contains(&decl.name) {
            return None;
        }
        let names: Vec<&str> = self.catalogue.iter().map(|e| e.name).collect();
        let Some(entry) = self.catalogue.iter().find(|e| e.name == decl.stage.0).copied() else {
            let fault = Fault::new(format!("there is no stage `{}`", decl.stage.0)).nearest(&decl.stage.0, &names);
            self.faults.push(fault.at(decl.stage.1.clone()));
            return None;
        };
        let mut axes = match mentioned(decl, self.spec) {
            Ok(axes) => axes,
            Err(faults) => {
                self.faults.extend(faults);
                return None;
            }
        };
        for name in self.inputs_of(decl) {
            if self.broken.contains(&name) {
                // Its own parameters are still worth a look.
                if let Some(first) = points(&axes, self.spec).next() {
                    self.parameters(decl, &entry, &first.point);
                }
                return None;
            }
            axes.extend(self.tables.iter().filter(|t| t.name == name).flat_map(|t| t.axes.clone()));
        }
        axes.sort_unstable();
        axes.dedup();
        let size = count(&axes, self.spec);
        if size > MOST_POINTS {
            self.faults.push(self.too_many(decl, &axes));
            return None;
        }
        let before = self.faults.len();
        let mut instances: Vec<Instance> = Vec::with_capacity(size);
        let spec = self.spec;
        for at in points(&axes, spec) {
            instances.extend(self.instance(decl, &entry, at, instances.last()));
            // What is wrong at each of thousands of points need not be said of each.
            if self.faults.len() > before + MOST_FAULTS {
                break;
            }
        }
        if self.faults.len() > before || instances.len() != size {
            return None;
        }
        for note in instances.iter().flat_map(|i| &i.yields.notes) {
            let note = format!("`{}`: {note}", decl.name);
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
        let node = TableNode { name: decl.name.clone(), at: decl.at.clone(), entry, axes, carry: vec![], instances };
        self.axis_columns(&node);
        self.tables.push(node);
        Some(())
    }

    /// The stage would be run at too many points of the sweep.
    fn too_many(&self, decl: &StageDecl, axes: &[usize]) -> Fault {
        let axes = axes.iter().filter_map(|i| self.spec.axes.get(*i));
        let product: Vec<String> = axes.clone().map(|a| format!("{} ({})", a.name, a.values.len())).collect();
        let size = axes.fold(1u128, |n, a| n.saturating_mul(a.values.len() as u128));
        let size = if size > 10u128.pow(30) { "more than 10^30".to_owned() } else { size.to_string() };
        let what = format!("`{}` would be run at {size} points: {}", decl.name, product.join(" x "));
        let help = format!("at most {MOST_POINTS}: take fewer values, a smaller `up_to`, or several specs");
        Fault::new(what).at(decl.at.clone()).help(help)
    }

    /// An axis column must not hide another column.
    fn axis_columns(&mut self, node: &TableNode) {
        for axis in node.axes.iter().filter_map(|i| self.spec.axes.get(*i)) {
            let clash = node.columns().into_iter().find(|c| c.name == axis.name);
            // A model table's `model` is the axis' own value where the sweep is over models.
            if clash.is_some() && !(node.is_tidy() && axis.name == "model") {
                let what = format!("the axis `{}` has the name of a column of `{}`", axis.name, node.name);
                self.faults.push(Fault::new(what).at(axis.at.clone()).help("rename the axis"));
            }
        }
    }

    fn parameters(&mut self, decl: &StageDecl, entry: &Entry, point: &Point) -> Option<Arc<dyn schemas::StageDyn>> {
        let inputs: Vec<&str> = entry.inputs.iter().map(|i| i.name).collect();
        let own: Args = args_at(&decl.args, point).into_iter().filter(|(k, _)| !inputs.contains(&k.as_str())).collect();
        match (entry.build)(&own) {
            Ok(stage) => Some(stage),
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|f| f.at(decl.at.clone())));
                None
            }
        }
    }

    /// The stage at one point; what is the same as in the point before is shared with it.
    fn instance(&mut self, decl: &StageDecl, entry: &Entry, at: At, before: Option<&Instance>) -> Option<Instance> {
        let stage = self.parameters(decl, entry, &at.point);
        let inputs = self.resolve(decl, entry, &at);
        let (stage, inputs) = (stage?, inputs?);
        let predicate = match self.predicate(decl, entry, &at.point, &inputs) {
            Ok(p) => p,
            Err(fault) => {
                self.faults.push(fault);
                return None;
            }
        };
        let tables: Vec<Arc<Table>> = inputs.iter().map(|r| self.table(*r)).collect();
        let seen: Vec<&Table> = tables.iter().map(AsRef::as_ref).collect();
        let yields = match stage.yields(&seen) {
            Ok(yields) => yields,
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|f| placed(f, decl)));
                return None;
            }
        };
        let of_same = |b: &&Instance| match (b.inputs.first(), tables.first()) {
            (Some(theirs), Some(own)) => Arc::ptr_eq(&self.table(*theirs), own),
            (theirs, own) => theirs.is_none() && own.is_none(),
        };
        let (yields, table) = match before.filter(|b| *b.yields == yields).filter(of_same) {
            Some(b) => (b.yields.clone(), b.table.clone()),
            None => {
                let table = outcome(entry, &yields, tables.first().map(AsRef::as_ref));
                (Arc::new(yields), Arc::new(table))
            }
        };
        Some(Instance { point: at.point, params: stage.canonical(), stage, inputs, yields, table, predicate })
    }

    /// What each input refers to at this point.
    fn resolve(&mut self, decl: &StageDecl, entry: &Entry, at: &At) -> Option<Vec<Ref>> {
        let mut found = vec![];
        let mut fine = true;
        for input in entry.inputs {
            let Some(given) = decl.args.get(input.name) else {
                let what = format!("`{}` needs `{}`, the name of {}", entry.name, input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(decl.at.clone()));
                fine = false;
                continue;
            };
            let given = Given { value: put_in(&given.value, &at.point), ..given.clone() };
            let names = texts(&given.value);
            let right = match (&given.value, input.kind) {
                (Literal::Text(_), _) => true,
                (Literal::List(items), InputKind::ManyLines) => names.len() == items.len() && !items.is_empty(),
                _ => false,
            };
            if !right {
                let what = format!("`{}` must be the name of {}", input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(given.at.clone()));
                fine = false;
                continue;
            }
            for name in names {
                match self.refer(&name, input, &given, at) {
                    Some(r) => found.push(r),
                    None => fine = false,
                }
            }
        }
        fine.then_some(found)
    }

    fn refer(&mut self, name: &str, input: &InputDecl, given: &Given, at: &At) -> Option<Ref> {
        let spec = self.spec;
        if let Some(t) = self.tables.iter().position(|t| t.name == name) {
            let node = &self.tables[t];
            let i = position(at, &node.axes, &spec.axes)?;
            let table = node.instances[i].table.as_ref();
            let fits = match table {
                Table::Lines(_) if node.is_tidy() => input.kind == InputKind::Scores,
                Table::Lines(_) => matches!(input.kind, InputKind::Lines | InputKind::ManyLines),
                Table::Model { .. } => input.kind == InputKind::Model,
                Table::Map(_) => input.kind == InputKind::Map,
            };
            if !fits {
                let kind =
                    if node.is_tidy() && node.entry.grain == Grain::Line { "a table of scores" } else { table.kind() };
                let what = format!("`{}` needs {}, but `{name}` is {kind}", input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(given.at.clone()));
                return None;
            }
            return Some(Ref::Stage(t, i));
        }
        if spec.tables.iter().any(|t| t.name == name) {
            return self.source(name, input, given);
        }
        let known: Vec<&str> = spec
            .tables
            .iter()
            .map(|t| &t.name)
            .chain(spec.stages.iter().map(|s| &s.name))
            .map(String::as_str)
            .collect();
        self.faults.push(Fault::new(format!("there is no table `{name}`")).nearest(name, &known).at(given.at.clone()));
        None
    }

    /// A table of files, opened at its first use.
    fn source(&mut self, name: &str, input: &InputDecl, given: &Given) -> Option<Ref> {
        let is_map = input.kind == InputKind::Map;
        if matches!(input.kind, InputKind::Model | InputKind::Scores) {
            let what = format!("`{}` needs {}, but `{name}` is read from files", input.name, kind_words(input.kind));
            self.faults.push(Fault::new(what).at(given.at.clone()));
            return None;
        }
        if let Some(known) = self.sources.get(&(name.to_owned(), is_map)) {
            return *known;
        }
        let decl = self.spec.tables.iter().find(|t| t.name == name)?;
        let opened = if is_map {
            MapSource::open(decl, &self.spec.folder).map(|m| {
                self.maps.push(m);
                Ref::Map(self.maps.len() - 1)
            })
        } else {
            Flights::open(decl, &self.spec.folder).map(|f| {
                self.notes.extend(f.notes.iter().cloned());
                self.shapes.push(Arc::new(Table::Lines(f.shape.clone())));
                self.flights.push(f);
                Ref::Flights(self.flights.len() - 1)
            })
        };
        let found = opened.map_err(|faults| self.faults.extend(faults)).ok();
        self.sources.insert((name.to_owned(), is_map), found);
        found
    }

    fn table(&self, r: Ref) -> Arc<Table> {
        match r {
            Ref::Flights(i) => self.shapes[i].clone(),
            Ref::Map(_) => self.map_shape.clone(),
            Ref::Stage(t, i) => self.tables[t].instances[i].table.clone(),
        }
    }

    fn predicate(
        &mut self,
        decl: &StageDecl,
        entry: &Entry,
        point: &Point,
        inputs: &[Ref],
    ) -> Result<Option<Predicate>, Fault> {
        let Some((text, at)) = &decl.predicate else { return Ok(None) };
        let seen = inputs.first().map(|r| self.table(*r));
        let key = (spelt_in(text, point), seen.as_ref().map(Arc::as_ptr));
        if let Some(known) = self.predicates.get(&key) {
            return Ok(Some(known.clone()));
        }
        let shape = seen.map(|t| t.shape().clone()).unwrap_or_default();
        let predicate = Predicate::new(&key.0, &shape).map_err(|f| f.at(at.clone()))?;
        if entry.grain == Grain::Line && !predicate.is_of_lines() {
            let what =
                format!("`{}` works on whole lines, so its `where` may only name `flight` and `line`", entry.name);
            return Err(Fault::new(what).at(at.clone()));
        }
        self.predicates.insert(key, predicate.clone());
        Ok(Some(predicate))
    }
}

/// The table that later stages see.
fn outcome(entry: &Entry, yields: &Yield, first: Option<&Table>) -> Table {
    let made = &yields.columns;
    let from = first.map(|t| t.shape().columns.clone()).unwrap_or_default();
    let passed: Vec<Column> = match &yields.passes {
        Passes::All => from.into_iter().filter(|c| !made.iter().any(|m| m.name == c.name)).collect(),
        Passes::Only(names) => names.iter().filter_map(|n| from.iter().find(|c| c.name == *n).cloned()).collect(),
        Passes::None => vec![],
    };
    let rate_hz = yields.rate_hz.or_else(|| first.and_then(|t| t.shape().rate_hz));
    let shape = Shape { columns: passed.into_iter().chain(made.iter().cloned()).collect(), rate_hz };
    match entry.grain {
        Grain::Line => Table::Lines(shape),
        Grain::Survey => Table::Model { shape, features: yields.features.clone() },
    }
}

/// A stage's fault, at the parameter it concerns.
fn placed(fault: Fault, decl: &StageDecl) -> Fault {
    let given = fault.param.as_ref().and_then(|p| decl.args.get(p));
    let at = given.map_or(decl.at.clone(), |g| g.at.clone());
    Fault { what: format!("`{}`: {}", decl.name, fault.what), ..fault }.at(at)
}

fn texts(value: &Literal) -> Vec<String> {
    match value {
        Literal::Text(text) => vec![text.clone()],
        Literal::List(items) => items.iter().filter_map(|v| v.as_text().map(str::to_owned)).collect(),
        _ => vec![],
    }
}

fn kind_words(kind: InputKind) -> &'static str {
    match kind {
        InputKind::Lines => "a table of flight lines",
        InputKind::ManyLines => "one or several tables of flight lines",
        InputKind::Model => "a model table",
        InputKind::Map => "a map",
        InputKind::Scores => "a table of scores",
    }
}
