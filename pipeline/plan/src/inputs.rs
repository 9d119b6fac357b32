//! The inputs of a stage: from names in the spec to tables at the points of a sweep.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use schemas::{Fault, InputDecl, InputKind, Literal, SpecEntry, StageEntry, Table, map::ANOMALY_UNIT};

use super::{
    axes::{axes_of, put_in},
    builder::{MOST_FAULTS, PlanBuilder, TableUse},
    grid::{SweepGrid, SweepValues},
    node::{InputSlot, InputTarget},
};
use crate::{
    sources::{Flights, MapSource, ReusePolicy},
    spec::{SourceDecl, StageDecl},
};

/// Maximum number of names to which one string with references to axes may expand.
const MOST_NAMES: usize = 1_000_000;

impl PlanBuilder<'_> {
    /// Names of the inputs of a stage over all points of the sweep.
    pub fn inputs_of(&self, decl: &StageDecl) -> Vec<String> {
        let Some(entry) = self.catalogue.iter().find(|e| e.name == decl.stage.0) else { return vec![] };
        let mut names = BTreeSet::new();
        for item in entry.inputs.iter().filter_map(|i| decl.args.get(i.name)).flat_map(|g| items(&g.value)) {
            let grid = SweepGrid::new(&axes_of(item, self.spec), self.spec);
            // A stage with more names is rejected later.
            for i in 0..grid.len().min(MOST_NAMES) {
                names.extend(texts(&put_in(item, &grid.point(i, self.spec))));
            }
        }
        names.into_iter().collect()
    }

    /// The table of each input, at every point of `grid`.
    pub fn slots(&mut self, decl: &StageDecl, entry: &StageEntry, grid: &SweepGrid) -> Option<Vec<InputSlot>> {
        let mut slots = vec![];
        let mut fine = true;
        for input in entry.inputs {
            let Some(given) = decl.args.get(input.name) else {
                if input.optional {
                    continue;
                }
                let what =
                    format!("`{}` requires `{}`, the name of {}", entry.name, input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(decl.at.clone()));
                fine = false;
                continue;
            };
            let many = input.kind.is_many();
            let one_or_many = many || !matches!(given.value, Literal::List(_));
            if !one_or_many || !items(&given.value).iter().all(|item| self.is_right(item, many)) {
                self.faults.push(wrong_name(input, given));
                fine = false;
                continue;
            }
            let mut fewest = 0;
            let mut found = true;
            for item in items(&given.value) {
                let slot = self.slot(item, input, given, grid);
                found &= slot.is_some();
                if let Some((slot, tables)) = slot {
                    fewest += tables;
                    slots.push(slot);
                }
            }
            if found && fewest == 0 {
                self.faults.push(wrong_name(input, given));
            }
            fine &= found && fewest > 0;
        }
        fine.then_some(slots)
    }

    /// Whether an entry of an input expands only to names. It may expand to lists only if the input accepts several
    /// tables (`many`).
    fn is_right(&self, item: &Literal, many: bool) -> bool {
        let Literal::Text(_) = item else { return false };
        let grid = SweepGrid::new(&axes_of(item, self.spec), self.spec);
        (0..grid.len().min(MOST_NAMES)).all(|i| match put_in(item, &grid.point(i, self.spec)) {
            Literal::Text(_) => true,
            Literal::List(names) => many && names.iter().all(|n| n.as_text().is_some()),
            _ => false,
        })
    }

    /// Targets of one entry of an input, and the smallest number of tables to which the entry expands at any point.
    fn slot(
        &mut self,
        item: &Literal,
        input: &InputDecl,
        given: &SpecEntry,
        grid: &SweepGrid,
    ) -> Option<(InputSlot, usize)> {
        let spec = self.spec;
        let names = SweepGrid::new(&axes_of(item, spec), spec);
        let mut known: HashMap<String, Option<InputTarget>> = HashMap::new();
        let mut choices: Vec<Arc<[InputTarget]>> = vec![];
        let before = self.faults.len();
        for i in 0..names.len() {
            let mut targets = vec![];
            for name in texts(&put_in(item, &names.point(i, spec))) {
                let found = match known.get(&name) {
                    Some(found) => found.clone(),
                    None => {
                        let found = self.refer(&name, input, given, grid);
                        known.insert(name, found.clone());
                        found
                    }
                };
                targets.extend(found);
            }
            choices.push(targets.into());
            if self.faults.len() > before + MOST_FAULTS {
                break;
            }
        }
        if known.values().any(Option::is_none) {
            return None;
        }
        let fewest = choices.iter().map(|c| c.len()).min().unwrap_or(0);
        Some((InputSlot { kind: input.kind, targets: SweepValues::new(grid, names, choices) }, fewest))
    }

    fn refer(&mut self, name: &str, input: &InputDecl, given: &SpecEntry, grid: &SweepGrid) -> Option<InputTarget> {
        let spec = self.spec;
        if let Some(t) = self.tables.iter().position(|t| t.name == name) {
            let node = &self.tables[t];
            let table = node.tables.first()?.as_ref();
            let fits = match table {
                Table::Scores(_) => input.kind == InputKind::Scores,
                Table::Lines(_) => {
                    matches!(input.kind, InputKind::Lines | InputKind::ManyLines) || input.kind.is_record()
                }
                Table::Model { .. } => matches!(input.kind, InputKind::Model | InputKind::ManyModels),
                Table::Map(_) => matches!(input.kind, InputKind::Map | InputKind::ManyMaps),
            };
            if !fits {
                let kind = table.kind();
                let what = format!("`{}` requires {}, but `{name}` is {kind}", input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(given.at.clone()));
                return None;
            }
            if let Some(fault) = node.tables.iter().find_map(|table| derivative(name, table)) {
                self.faults.push(fault.at(given.at.clone()));
                return None;
            }
            return Some(InputTarget::Stage(t, Arc::new(grid.onto(&node.grid))));
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
    fn source(&mut self, name: &str, input: &InputDecl, given: &SpecEntry) -> Option<InputTarget> {
        let used = match input.kind {
            InputKind::Map | InputKind::ManyMaps => TableUse::Map,
            InputKind::Model | InputKind::ManyModels => TableUse::Model,
            InputKind::Lines | InputKind::ManyLines | InputKind::Record | InputKind::ManyRecords => TableUse::Flights,
            InputKind::Scores => {
                let what =
                    format!("`{}` requires {}, but `{name}` is a table of files", input.name, kind_words(input.kind));
                self.faults.push(Fault::new(what).at(given.at.clone()));
                return None;
            }
        };
        if let Some(known) = self.sources.get(&(name.to_owned(), used)) {
            return known.clone();
        }
        let decl = self.spec.tables.iter().find(|t| t.name == name)?;
        let opened = match used {
            TableUse::Map => self.open_map(decl).map(|map| self.whole(map)),
            TableUse::Model => self.open_model(decl).map(|model| self.whole(model)),
            TableUse::Flights => self.open_flights(decl).map(|f| {
                self.notes.extend(f.notes.iter().cloned());
                self.shapes.push(Arc::new(Table::Lines(f.shape.clone())));
                self.flights.push(f);
                InputTarget::Flights(self.flights.len() - 1)
            }),
        };
        let found = opened.map_err(|faults| self.faults.extend(faults)).ok();
        let known: Vec<String> = match &found {
            Some(InputTarget::Flights(i)) => {
                self.flights.get(*i).iter().flat_map(|f| &f.shape.columns).map(|c| c.name.clone()).collect()
            }
            Some(InputTarget::Map(i)) => self.maps.get(*i).map(MapSource::columns).unwrap_or_default(),
            Some(InputTarget::Stage(..)) | None => vec![],
        };
        if found.is_some() {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            let unknown = decl.protection.unknown(name, &known);
            self.faults.extend(unknown.into_iter().map(|fault| fault.at(decl.at.clone())));
        }
        self.sources.insert((name.to_owned(), used), found.clone());
        found
    }

    /// Opens a map or a model.
    fn whole(&mut self, mut source: MapSource) -> InputTarget {
        source.read_all = self.spec.verify_inputs;
        // All maps have the same schema, so that points with different maps share one plan.
        let map = &self.map_shapes[usize::from(source.gives_error())];
        self.wholes.push(source.model().map_or_else(|| map.clone(), Arc::new));
        self.maps.push(source);
        InputTarget::Map(self.maps.len() - 1)
    }

    fn open_map(&self, decl: &SourceDecl) -> Result<MapSource, Vec<Fault>> {
        if let Some(recorded) = self.recorded {
            recorded.has_map(&decl.name).map_err(|fault| vec![fault])?;
            return MapSource::recorded(decl);
        }
        MapSource::open(decl, &self.spec.folder)
    }

    fn open_model(&self, decl: &SourceDecl) -> Result<MapSource, Vec<Fault>> {
        if let Some(recorded) = self.recorded {
            let schema = recorded.model(&decl.name).map_err(|fault| vec![fault])?;
            return MapSource::recorded_model(decl, schema);
        }
        MapSource::open_model(decl, &self.spec.folder)
    }

    fn open_flights(&self, decl: &SourceDecl) -> Result<Flights, Vec<Fault>> {
        if let Some(recorded) = self.recorded {
            let schema = recorded.columns(&decl.name).map_err(|fault| vec![fault])?;
            return Ok(Flights::recorded(&decl.name, schema));
        }
        let trust =
            ReusePolicy { store: Some(&self.spec.store), read_all: self.spec.verify_inputs, settle: self.spec.settle };
        Flights::open_trusting(decl, &self.spec.folder, trust)
    }
}

/// Fault of a map whose quantity is not the anomaly.
fn derivative(name: &str, table: &Table) -> Option<Fault> {
    let Table::Map(shape) = table else { return None };
    let unit = &shape.get("anomaly")?.unit;
    let what = format!("`{name}` is a derivative in {unit}, but a map of the anomaly in {ANOMALY_UNIT} is required");
    (unit != ANOMALY_UNIT).then(|| Fault::new(what))
}

fn wrong_name(input: &InputDecl, given: &SpecEntry) -> Fault {
    Fault::new(format!("`{}` must be the name of {}", input.name, kind_words(input.kind))).at(given.at.clone())
}

/// The entries of an input. A value that is not a list is one entry.
fn items(value: &Literal) -> &[Literal] {
    match value {
        Literal::List(items) => items,
        one => std::slice::from_ref(one),
    }
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
        InputKind::ManyModels => "one or several model tables",
        InputKind::ManyMaps => "one or several maps",
        InputKind::Scores => "a table of scores",
        InputKind::Record => "a record (a table of flight lines)",
        InputKind::ManyRecords => "one or several records (tables of flight lines)",
    }
}
