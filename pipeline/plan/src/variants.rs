//! The parameters, inputs and outputs of a stage over a sweep: parameters are checked once for each combination of the
//! axes that they mention, columns once for each combination of parameters and input tables.

use std::{
    collections::HashMap,
    hash::{DefaultHasher, Hash, Hasher},
    sync::Arc,
};

use schemas::{
    AnyStage, Column, Fault, Grain, PassThroughColumns, SpecEntries, SpecEntry, StageEntry, StageSchema, Table,
    TableKind, TableShape, keys::HashKey,
};
use store::arithmetic::ARITHMETIC;

use super::{
    axes::{args_at, axes_in, axes_of, spelt_in},
    builder::{MOST_FAULTS, PlanBuilder},
    grid::{SweepGrid, SweepPointMap, SweepValues},
    node::{InputSlot, InputTarget, StageVariant, own_args},
};
use crate::{
    predicate::Predicate,
    spec::{Spec, StageDecl},
};

/// The differences between the points of a table.
pub struct StageVariants {
    pub variants: Vec<StageVariant>,
    pub variant: SweepValues<u32>,
    pub tables: Vec<Arc<Table>>,
    pub table: SweepValues<u32>,
    pub questions: SweepValues<HashKey>,
}

/// Input tables of a stage, and the predicate on its rows.
struct StageContext {
    tables: Vec<Arc<Table>>,
    predicate: Option<Arc<Predicate>>,
}

/// Contexts of a stage, indexed by the axes that they depend on.
struct StageContexts {
    grid: SweepGrid,
    at: Vec<u32>,
    all: Vec<StageContext>,
}

impl PlanBuilder<'_> {
    /// The axes that the parameters of a stage mention.
    fn own_axes(&self, own: &SpecEntries) -> SweepGrid {
        let axes: Vec<usize> = own.values().flat_map(|g| axes_of(&g.value, self.spec)).collect();
        SweepGrid::new(&axes, self.spec)
    }

    /// Checks only the parameters of a stage, because nothing else can be checked.
    pub fn parameters(&mut self, decl: &StageDecl, entry: &StageEntry) {
        let own = own_args(decl, entry);
        let grid = self.own_axes(&own);
        let before = self.faults.len();
        let mut silent = UnusedParameters::new(&own, self.spec);
        for p in 0..grid.len() {
            silent.keep_unused(self.made(decl, entry, &own, &grid, p).as_ref());
            if self.faults.len() > before + MOST_FAULTS {
                return;
            }
        }
        self.faults.extend(silent.faults());
    }

    fn made(
        &mut self,
        decl: &StageDecl,
        entry: &StageEntry,
        own: &SpecEntries,
        grid: &SweepGrid,
        p: usize,
    ) -> Option<AnyStage> {
        let made = if grid.len() == 1 && grid.axes().next().is_none() {
            (entry.build)(own)
        } else {
            (entry.build)(&args_at(own, &grid.point(p, self.spec)))
        };
        made.map_err(|faults| self.faults.extend(faults.into_iter().map(|f| f.at(decl.at.clone())))).ok()
    }

    /// The differences between the points of `whole`; `None` if there is a fault.
    pub fn variants(
        &mut self,
        decl: &StageDecl,
        entry: &StageEntry,
        whole: &SweepGrid,
        slots: &[InputSlot],
    ) -> Option<StageVariants> {
        let before = self.faults.len();
        let own = own_args(decl, entry);
        let grid = self.own_axes(&own);
        let reach = self.reach(decl, entry, slots);
        let rest = reach.grid.without(&grid);
        let axes: Vec<usize> = grid.axes().chain(rest.axes()).collect();
        let vary = SweepGrid::new(&axes, self.spec);
        let (own_reach, rest_reach) = (grid.onto(&reach.grid), rest.onto(&reach.grid));
        let (own_vary, rest_vary) = (grid.onto(&vary), rest.onto(&vary));
        let mut questions = vec![];
        let mut values = vec![0u32; vary.len()];
        let mut found = VariantCollector::default();
        let mut here: HashMap<u32, Option<u32>> = HashMap::new();
        let mut silent = UnusedParameters::new(&own, self.spec);
        for p in 0..grid.len() {
            // A fault that is repeated at thousands of points is reported once.
            if self.faults.len() > before + MOST_FAULTS {
                return None;
            }
            let stage = self.made(decl, entry, &own, &grid, p);
            silent.keep_unused(stage.as_ref());
            let Some(stage) = stage else { continue };
            questions.push(question(entry, &stage));
            here.clear();
            for r in 0..rest.len() {
                let situation = reach.at[own_reach.at(p) + rest_reach.at(r)];
                let variant = match here.get(&situation) {
                    Some(known) => *known,
                    None => {
                        let variant = self.variant(decl, entry, &stage, &reach, situation, &mut found);
                        here.insert(situation, variant);
                        variant
                    }
                };
                values[own_vary.at(p) + rest_vary.at(r)] = variant.unwrap_or_default();
            }
        }
        self.faults.extend(silent.faults());
        if self.faults.len() > before {
            return None;
        }
        let VariantCollector { variants, tables, table, .. } = found.in_order(&mut values);
        let of: Vec<u32> = values.iter().map(|v| table[*v as usize]).collect();
        Some(StageVariants {
            variants,
            variant: SweepValues::new(whole, vary.clone(), values),
            tables,
            table: SweepValues::new(whole, vary, of),
            questions: SweepValues::new(whole, grid, questions),
        })
    }

    /// The contexts of a stage: its input tables, and the predicate on its rows.
    fn reach(&mut self, decl: &StageDecl, entry: &StageEntry, slots: &[InputSlot]) -> StageContexts {
        let spec = self.spec;
        let of_where = decl.predicate.as_ref().map(|(text, _)| axes_in(text, spec)).unwrap_or_default();
        let mut axes = of_where.clone();
        for slot in slots {
            axes.extend(slot.targets.grid().axes());
            for target in slot.targets.values().iter().flat_map(|t| t.iter()) {
                if let InputTarget::Stage(t, _) = target {
                    axes.extend(self.tables[*t].table.grid().axes());
                }
            }
        }
        let grid = SweepGrid::new(&axes, spec);
        let of_where = SweepGrid::new(&of_where, spec);
        let to_where = grid.onto(&of_where);
        let to_slots: Vec<SweepPointMap> = slots.iter().map(|s| grid.onto(s.targets.grid())).collect();
        let to_tables: Vec<SweepPointMap> = self.tables.iter().map(|t| grid.onto(t.table.grid())).collect();
        let before = self.faults.len();
        let mut known: HashMap<(Vec<usize>, usize), u32> = HashMap::new();
        let mut reach = StageContexts { at: Vec::with_capacity(grid.len()), grid, all: vec![] };
        for w in 0..reach.grid.len() {
            if self.faults.len() > before + MOST_FAULTS {
                break;
            }
            let mut tables: Vec<Arc<Table>> = vec![];
            for (slot, to) in slots.iter().zip(&to_slots) {
                for target in slot.targets.values()[to.at(w)].iter() {
                    tables.push(match target {
                        InputTarget::Flights(i) => self.shapes[*i].clone(),
                        InputTarget::Map(i) => self.wholes[*i].clone(),
                        InputTarget::Stage(t, _) => {
                            let node = &self.tables[*t];
                            node.tables[node.table.values()[to_tables[*t].at(w)] as usize].clone()
                        }
                    });
                }
            }
            let addresses = tables.iter().map(|t| Arc::as_ptr(t) as usize).collect();
            let next = reach.all.len() as u32;
            let situation = *known.entry((addresses, to_where.at(w))).or_insert(next);
            if situation == next {
                let point = of_where.point(to_where.at(w), spec);
                let text = decl.predicate.as_ref().map(|(text, at)| (spelt_in(text, &point), at.clone()));
                let predicate = text.and_then(|(text, at)| {
                    let found = self.predicate(&text, entry, tables.first());
                    found.map_err(|fault| self.faults.push(fault.at(at))).ok()
                });
                reach.all.push(StageContext { tables, predicate });
            }
            reach.at.push(situation);
        }
        reach
    }

    fn predicate(
        &mut self,
        text: &str,
        entry: &StageEntry,
        seen: Option<&Arc<Table>>,
    ) -> Result<Arc<Predicate>, Fault> {
        let key = (text.to_owned(), seen.map(Arc::as_ptr));
        if let Some(known) = self.predicates.get(&key) {
            return Ok(known.clone());
        }
        let shape = seen.map(|t| t.shape().clone()).unwrap_or_default();
        let predicate = Predicate::new(text, &shape)?;
        if entry.grain == Grain::Line && !predicate.is_of_lines() {
            let what = format!("`{}` works on whole lines, so `where` may use only `flight` and `line`", entry.name);
            return Err(Fault::new(what));
        }
        let predicate = Arc::new(predicate);
        self.predicates.insert(key, predicate.clone());
        Ok(predicate)
    }

    /// The inputs and outputs of a stage in one context.
    fn variant(
        &mut self,
        decl: &StageDecl,
        entry: &StageEntry,
        stage: &AnyStage,
        reach: &StageContexts,
        situation: u32,
        found: &mut VariantCollector,
    ) -> Option<u32> {
        let StageContext { tables, predicate } = reach.all.get(situation as usize)?;
        let seen: Vec<&Table> = tables.iter().map(AsRef::as_ref).collect();
        match stage.yields(&seen) {
            Ok(yields) => Some(found.add(entry, yields, tables.first(), predicate.as_ref())),
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|f| placed(f, decl)));
                None
            }
        }
    }
}

/// Parameters that the spec sets directly and that have had no effect at any point so far. A value from an axis is
/// permitted to have no effect, because the axis may affect other points or another model.
struct UnusedParameters<'a> {
    keys: Vec<(&'a str, &'a SpecEntry, Option<Fault>)>,
    /// Whether a point was rejected, so that the effect of its parameters is unknown.
    refused: bool,
}

impl<'a> UnusedParameters<'a> {
    fn new(own: &'a SpecEntries, spec: &Spec) -> UnusedParameters<'a> {
        let outright = own.iter().filter(|(_, given)| axes_of(&given.value, spec).is_empty());
        UnusedParameters { keys: outright.map(|(key, given)| (key.as_str(), given, None)).collect(), refused: false }
    }

    /// Removes from the list the parameters that have an effect in `stage`.
    fn keep_unused(&mut self, stage: Option<&AnyStage>) {
        let Some(stage) = stage else {
            self.refused = true;
            return;
        };
        self.keys.retain_mut(|(key, _, why)| {
            let unused = stage.unused_key(key);
            let silent = unused.is_some();
            *why = why.take().or(unused);
            silent
        });
    }

    fn faults(self) -> Vec<Fault> {
        if self.refused {
            return vec![];
        }
        self.keys.into_iter().filter_map(|(_, given, why)| Some(why?.at(given.key_at.clone()))).collect()
    }
}

/// Collector of distinct variants of a stage and their tables.
#[derive(Default)]
struct VariantCollector {
    variants: Vec<StageVariant>,
    /// Position of each variant's table in `tables`.
    table: Vec<u32>,
    tables: Vec<Arc<Table>>,
    /// Distinct schemas by hash.
    schemas: HashMap<u64, Vec<Arc<StageSchema>>>,
    /// Index of each variant, by the addresses of its schema, its first input table and its restriction of rows (0 if
    /// absent).
    known: HashMap<[usize; 3], u32>,
    /// Index of each table, by the address of its schema and by its first input table: the address if columns pass
    /// through, otherwise only the sample rate.
    outcomes: HashMap<(usize, usize, Option<u64>), u32>,
    tables_alike: HashMap<u64, Vec<u32>>,
}

/// Address of a shared value; 0 for none.
fn address<T>(shared: Option<&Arc<T>>) -> usize {
    shared.map_or(0, |shared| Arc::as_ptr(shared) as usize)
}

impl VariantCollector {
    fn add(
        &mut self,
        entry: &StageEntry,
        yields: StageSchema,
        first: Option<&Arc<Table>>,
        predicate: Option<&Arc<Predicate>>,
    ) -> u32 {
        let yields = self.schema(yields);
        let next = self.variants.len() as u32;
        let place = [address(Some(&yields)), address(first), address(predicate)];
        let variant = *self.known.entry(place).or_insert(next);
        if variant < next {
            return variant;
        }
        let table = self.outcome(entry, &yields, first);
        self.variants.push(StageVariant {
            yields,
            table: self.tables[table as usize].clone(),
            predicate: predicate.cloned(),
        });
        self.table.push(table);
        next
    }

    /// Returns the schema, or an equal schema that is already stored.
    fn schema(&mut self, yields: StageSchema) -> Arc<StageSchema> {
        let alike = self.schemas.entry(of_schema(&yields)).or_default();
        if let Some(known) = alike.iter().find(|known| ***known == yields) {
            return known.clone();
        }
        let made = Arc::new(yields);
        alike.push(made.clone());
        made
    }

    /// The position of the table that a stage makes from its first input table.
    fn outcome(&mut self, entry: &StageEntry, yields: &Arc<StageSchema>, first: Option<&Arc<Table>>) -> u32 {
        let schema = address(Some(yields));
        let place = match yields.passes {
            PassThroughColumns::None => (schema, 0, first.and_then(|t| t.shape().rate_hz).map(f64::to_bits)),
            PassThroughColumns::All | PassThroughColumns::Only(_) => (schema, address(first), None),
        };
        if let Some(known) = self.outcomes.get(&place) {
            return *known;
        }
        let table = self.table(outcome(entry, yields, first.map(AsRef::as_ref)));
        self.outcomes.insert(place, table);
        table
    }

    fn table(&mut self, table: Table) -> u32 {
        let mut hasher = DefaultHasher::new();
        table.shape().columns.iter().for_each(|c| (&c.name, &c.unit, &c.doc).hash(&mut hasher));
        let alike = self.tables_alike.entry(hasher.finish()).or_default();
        if let Some(known) = alike.iter().find(|i| same_table(&self.tables[**i as usize], &table)) {
            return *known;
        }
        let next = self.tables.len() as u32;
        alike.push(next);
        self.tables.push(Arc::new(table));
        next
    }

    /// The variants and their tables, in the order of their first occurrence in `values`, which is the order of the
    /// sweep.
    fn in_order(self, values: &mut [u32]) -> VariantCollector {
        let mut place: Vec<Option<u32>> = vec![None; self.variants.len()];
        let mut order: Vec<u32> = vec![];
        for value in values.iter_mut() {
            let old = *value;
            *value = *place[old as usize].get_or_insert_with(|| {
                order.push(old);
                order.len() as u32 - 1
            });
        }
        let mut all: Vec<Option<StageVariant>> = self.variants.into_iter().map(Some).collect();
        let mut found = VariantCollector::default();
        let mut tables: HashMap<u32, u32> = HashMap::new();
        for old in order {
            let old_table = self.table[old as usize];
            let next = found.tables.len() as u32;
            let table = *tables.entry(old_table).or_insert(next);
            if table == next {
                found.tables.push(self.tables[old_table as usize].clone());
            }
            found.table.push(table);
            found.variants.extend(all[old as usize].take());
        }
        found
    }
}

/// Hash of a schema.
fn of_schema(yields: &StageSchema) -> u64 {
    let mut hasher = DefaultHasher::new();
    (&yields.reads, &yields.features).hash(&mut hasher);
    yields.columns.iter().for_each(|c| (&c.name, &c.unit, &c.doc, &c.from).hash(&mut hasher));
    hasher.finish()
}

fn same_table(one: &Table, other: &Table) -> bool {
    let features = match (one, other) {
        (Table::Lines(_), Table::Lines(_)) | (Table::Scores(_), Table::Scores(_)) | (Table::Map(_), Table::Map(_)) => {
            true
        }
        (Table::Model { features: a, .. }, Table::Model { features: b, .. }) => a == b,
        (Table::Lines(_) | Table::Model { .. } | Table::Scores(_) | Table::Map(_), _) => false,
    };
    features && one.shape() == other.shape()
}

/// Key of the computation without the data.
fn question(entry: &StageEntry, stage: &AnyStage) -> HashKey {
    let params = stage.canonical();
    let version = entry.version.to_string();
    let words = params.iter().flat_map(|(k, v)| [k.as_bytes(), v.as_bytes()]);
    let what = ["question".as_bytes(), ARITHMETIC.as_ref(), entry.name.as_bytes(), version.as_bytes()];
    HashKey::from_parts(what.into_iter().chain(words))
}

/// The table that later stages see. Its columns list no inputs; only the stage that made a column lists the column's
/// inputs.
fn outcome(entry: &StageEntry, yields: &StageSchema, first: Option<&Table>) -> Table {
    let made = yields.columns.iter().map(|c| Arc::new(Column { from: vec![], ..c.clone() }));
    let from = first.map(|t| t.shape().columns.shared()).unwrap_or_default();
    let passed: Vec<Arc<Column>> = match &yields.passes {
        PassThroughColumns::All => {
            from.iter().filter(|c| !yields.columns.iter().any(|m| m.name == c.name)).cloned().collect()
        }
        PassThroughColumns::Only(names) => {
            names.iter().filter_map(|n| from.iter().find(|c| c.name == *n).cloned()).collect()
        }
        PassThroughColumns::None => vec![],
    };
    let rate_hz = yields.rate_hz.or_else(|| first.and_then(|t| t.shape().rate_hz));
    let shape = TableShape { columns: passed.into_iter().chain(made).collect(), rate_hz };
    match entry.yields {
        TableKind::Lines => Table::Lines(shape),
        TableKind::Model => Table::Model { shape, features: yields.features.clone() },
        TableKind::Scores => Table::Scores(shape),
        TableKind::Map => Table::Map(shape),
    }
}

/// A fault of a stage, at the position of the faulty parameter.
fn placed(fault: Fault, decl: &StageDecl) -> Fault {
    let given = fault.param.as_ref().and_then(|p| decl.args.get(p));
    let at = given.map_or(decl.at.clone(), |g| g.at.clone());
    Fault { what: format!("`{}`: {}", decl.name, fault.what), ..fault }.at(at)
}
