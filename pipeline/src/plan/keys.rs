//! The plan with its data: which lines each table has, and the key of every column and object.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Mutex,
};

use schemas::{Fault, Grain, InputKind};

use super::{Instance, Plan, Ref};
use crate::{
    keys::Key,
    sources::{Bytes, LineRecord, Lines, ReadStep},
    spec::Faults,
    store::Store,
};

/// A line, as a position in [`Graph::lines`].
pub type LineId = usize;

/// Keys already made.
type Memo<K> = Mutex<HashMap<K, Result<Key, Fault>>>;

/// A plan whose sources have been read.
pub struct Graph<'a> {
    /// The plan.
    pub plan: &'a Plan,
    /// Every (flight, line) of all sources, sorted.
    pub lines: Vec<(String, String)>,
    /// The records of each table of flights.
    pub records: Vec<BTreeMap<LineId, LineRecord>>,
    /// The files behind each table of flights, then behind each map.
    pub bytes: Vec<Vec<Bytes>>,
    /// The key of each map.
    pub maps: Vec<Key>,
    /// The lines of each instance of each table.
    of: Vec<Vec<Vec<LineId>>>,
    units: Memo<(Ref, LineId)>,
    columns: Memo<(Ref, LineId, String)>,
}

/// One thing to compute: an instance of a table, on one line or on all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Unit {
    /// The table.
    pub table: usize,
    /// Its instance.
    pub instance: usize,
    /// The line; `None` for a survey stage.
    pub line: Option<LineId>,
}

/// Where the values of a column lie.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Origin {
    /// What made it.
    pub made_by: Ref,
    /// Its name there.
    pub column: String,
}

impl<'a> Graph<'a> {
    /// Reads the sources of `plan` into `store`, as far as they are not there.
    ///
    /// # Errors
    /// Files that cannot be read.
    pub fn new(plan: &'a Plan, store: &Store, tick: &(dyn Fn(&str, &ReadStep) + Sync)) -> Result<Graph<'a>, Faults> {
        let mut faults = vec![];
        let mut sources: Vec<Lines> = vec![];
        for flights in &plan.flights {
            match flights.lines(store, &|step| tick(&flights.name, step)) {
                Ok(lines) => sources.push(lines),
                Err(wrong) => faults.extend(wrong),
            }
        }
        let (mut maps, mut map_bytes) = (vec![], vec![]);
        for map in &plan.maps {
            tick(&map.name, &ReadStep::of_file(&map.path, 0, 1));
            match map.load(store) {
                Ok((key, bytes)) => {
                    maps.push(key);
                    map_bytes.push(bytes);
                }
                Err(fault) => faults.push(fault),
            }
        }
        if !faults.is_empty() {
            return Err(plan.spec.faults(faults));
        }
        let names: BTreeSet<(String, String)> =
            sources.iter().flat_map(|s| &s.lines).map(|l| (l.flight.clone(), l.line.clone())).collect();
        let lines: Vec<(String, String)> = names.into_iter().collect();
        let id = |l: &LineRecord| lines.binary_search(&(l.flight.clone(), l.line.clone())).unwrap_or(usize::MAX);
        let records = sources.iter().map(|s| s.lines.iter().map(|l| (id(l), l.clone())).collect()).collect();
        let bytes = sources.iter().map(|s| s.files.clone()).chain(map_bytes).collect();
        let mut graph =
            Graph { plan, lines, records, bytes, maps, of: vec![], units: Mutex::default(), columns: Mutex::default() };
        for table in 0..plan.tables.len() {
            let each = (0..plan.tables[table].instances.len()).map(|i| graph.select(table, i));
            let of = each.collect::<Result<Vec<_>, Fault>>().map_err(|f| {
                let at = plan
                    .spec
                    .stages
                    .iter()
                    .find(|s| s.name == plan.tables[table].name)
                    .and_then(|s| s.predicate.clone());
                plan.spec.faults(vec![f.at(at.map_or(plan.tables[table].at.clone(), |(_, at)| at))])
            })?;
            graph.of.push(of);
        }
        Ok(graph)
    }

    /// The lines of an instance: those that all its inputs have and its `where` selects.
    fn select(&self, table: usize, instance: usize) -> Result<Vec<LineId>, Fault> {
        let it = self.plan.instance(table, instance);
        let mut lines: Option<BTreeSet<LineId>> = None;
        for (_, r) in self.line_inputs(table, it) {
            let those: BTreeSet<LineId> = match r {
                Ref::Flights(i) => self.records[i].keys().copied().collect(),
                Ref::Stage(t, i) => self.of[t][i].iter().copied().collect(),
                Ref::Map(_) => continue,
            };
            lines = Some(lines.map_or(those.clone(), |l| l.intersection(&those).copied().collect()));
        }
        let lines: Vec<LineId> = lines.unwrap_or_default().into_iter().collect();
        let Some(predicate) = &it.predicate else { return Ok(lines) };
        let names: Vec<(String, String)> = lines.iter().map(|l| self.lines[*l].clone()).collect();
        let selected = predicate.lines(&names)?;
        let selected: Vec<LineId> = lines.into_iter().zip(selected).filter(|(_, s)| *s).map(|(l, _)| l).collect();
        if selected.is_empty() {
            let some: Vec<String> = self.lines.iter().take(12).map(|(f, l)| format!("{f}/{l}")).collect();
            let fault = Fault::new("`where` selects no line");
            return Err(fault.help(format!("there are, as flight/line: {}", some.join(", "))));
        }
        Ok(selected)
    }

    /// The inputs that are tables of flight lines, with their positions.
    pub fn line_inputs(&self, table: usize, instance: &Instance) -> Vec<(usize, Ref)> {
        let kinds = self.kinds(table, instance);
        let of_lines = |k: &InputKind| matches!(k, InputKind::Lines | InputKind::ManyLines | InputKind::Scores);
        instance.inputs.iter().copied().enumerate().filter(|(i, _)| of_lines(&kinds[*i])).collect()
    }

    /// The kind of each of an instance's inputs.
    pub fn kinds(&self, table: usize, instance: &Instance) -> Vec<InputKind> {
        let declared = self.plan.tables[table].entry.inputs;
        let many = instance.inputs.len() + 1 - declared.len();
        let repeat = |k: InputKind| if k == InputKind::ManyLines { many } else { 1 };
        declared.iter().flat_map(|d| std::iter::repeat_n(d.kind, repeat(d.kind))).collect()
    }

    /// The lines of an instance.
    pub fn lines_of(&self, table: usize, instance: usize) -> &[LineId] {
        &self.of[table][instance]
    }

    /// Everything there is to compute of one table.
    pub fn units(&self, table: usize) -> Vec<Unit> {
        let node = &self.plan.tables[table];
        let mut units = vec![];
        for instance in 0..node.instances.len() {
            match node.entry.grain {
                Grain::Survey => units.push(Unit { table, instance, line: None }),
                Grain::Line => {
                    let lines = self.lines_of(table, instance).iter();
                    units.extend(lines.map(|l| Unit { table, instance, line: Some(*l) }));
                }
            }
        }
        units
    }

    /// Where the column `column` of `r` lies: in what made it, at the end of all passing through.
    pub fn origin(&self, r: Ref, column: &str) -> Origin {
        if let Ref::Stage(t, i) = r {
            let it = self.plan.instance(t, i);
            if it.makes(column).is_none()
                && let Some(first) = it.inputs.first()
            {
                return self.origin(*first, column);
            }
        }
        Origin { made_by: r, column: column.to_owned() }
    }

    /// The object that holds what `r` makes of `line`.
    ///
    /// # Errors
    /// When the line lacks a column that is needed for it.
    pub fn object(&self, r: Ref, line: LineId) -> Result<Key, Fault> {
        match r {
            Ref::Flights(i) => self.records[i].get(&line).map(|l| l.object).ok_or_else(|| self.no_line(line)),
            Ref::Map(i) => Ok(self.maps[i]),
            Ref::Stage(t, i) => {
                let survey = self.plan.tables[t].entry.grain == Grain::Survey;
                self.key(Unit { table: t, instance: i, line: (!survey).then_some(line) })
            }
        }
    }

    fn no_line(&self, line: LineId) -> Fault {
        let (flight, name) = &self.lines[line];
        Fault::data("the line is not in this table").in_line(flight, name)
    }

    /// The key of a unit: stage, version, parameters and the keys of all it reads.
    ///
    /// # Errors
    /// When a line lacks a column that is read.
    pub fn key(&self, unit: Unit) -> Result<Key, Fault> {
        let at = (Ref::Stage(unit.table, unit.instance), unit.line.unwrap_or(usize::MAX));
        if let Some(known) = self.units.lock().ok().and_then(|m| m.get(&at).cloned()) {
            return known;
        }
        let key = self.make_key(unit);
        if let Ok(mut memo) = self.units.lock() {
            memo.insert(at, key.clone());
        }
        key
    }

    fn make_key(&self, unit: Unit) -> Result<Key, Fault> {
        let it = self.plan.instance(unit.table, unit.instance);
        let mut parts = self.question(unit.table, it);
        let lines: Vec<LineId> = match unit.line {
            Some(line) => vec![line],
            None => self.lines_of(unit.table, unit.instance).to_vec(),
        };
        let of_lines: Vec<usize> = self.line_inputs(unit.table, it).into_iter().map(|(i, _)| i).collect();
        for line in lines {
            let (flight, name) = &self.lines[line];
            parts.extend([flight.clone(), name.clone()]);
            for i in &of_lines {
                for column in self.read(it, *i) {
                    match self.column(it.inputs[*i], line, &column) {
                        Ok(key) => parts.extend([column, key.to_string()]),
                        // A fit goes on without a line that lacks a column; a line stage cannot.
                        Err(_) if unit.line.is_none() || it.yields.lenient => parts.push(format!("without {column}")),
                        Err(fault) => return Err(fault),
                    }
                }
            }
        }
        for (i, r) in it.inputs.iter().enumerate().filter(|(i, _)| !of_lines.contains(i)) {
            parts.extend([format!("input {i}"), self.object(*r, usize::MAX)?.to_string()]);
        }
        Ok(Key::of(parts))
    }

    /// What is asked, without the data.
    fn question(&self, table: usize, it: &Instance) -> Vec<String> {
        let entry = &self.plan.tables[table].entry;
        let mut parts = vec![entry.name.to_owned(), entry.version.to_string()];
        parts.extend(it.params.iter().flat_map(|(k, v)| [(*k).to_owned(), v.clone()]));
        parts.push(it.predicate.as_ref().map(|p| p.canonical.clone()).unwrap_or_default());
        parts
    }

    /// The columns handed over from input `i`, those of `where` among them.
    pub fn read(&self, it: &Instance, i: usize) -> Vec<String> {
        let mut columns = it.yields.reads.get(i).cloned().unwrap_or_default();
        if i == 0
            && let Some(p) = &it.predicate
        {
            let more: Vec<String> = p.columns.iter().filter(|c| !columns.contains(c)).cloned().collect();
            columns.extend(more);
        }
        columns
    }

    /// The key of one column of one line.
    ///
    /// # Errors
    /// When the line lacks it or something it is made from.
    pub fn column(&self, r: Ref, line: LineId, name: &str) -> Result<Key, Fault> {
        let origin = self.origin(r, name);
        match origin.made_by {
            Ref::Flights(i) => {
                let record = self.records[i].get(&line).ok_or_else(|| self.no_line(line))?;
                let place =
                    || Fault::data(format!("the line has no column `{name}`")).in_line(&record.flight, &record.line);
                record.columns.get(name).copied().ok_or_else(place)
            }
            Ref::Map(i) => Ok(Key::of([self.maps[i].to_string(), name.to_owned()])),
            Ref::Stage(t, i) => {
                let at = (origin.made_by, line, origin.column);
                if let Some(known) = self.columns.lock().ok().and_then(|m| m.get(&at).cloned()) {
                    return known;
                }
                let key = self.made(t, i, line, name);
                if let Ok(mut memo) = self.columns.lock() {
                    memo.insert(at, key.clone());
                }
                key
            }
        }
    }

    fn made(&self, t: usize, i: usize, line: LineId, name: &str) -> Result<Key, Fault> {
        let it = self.plan.instance(t, i);
        let from = it.makes(name).map(|c| c.from.clone()).unwrap_or_default();
        let survey = self.plan.tables[t].entry.grain == Grain::Survey;
        if survey || from.is_empty() {
            let whole = self.key(Unit { table: t, instance: i, line: (!survey).then_some(line) })?;
            return Ok(Key::of([whole.to_string(), name.to_owned()]));
        }
        let mut parts = self.question(t, it);
        parts.extend(["column".to_owned(), name.to_owned()]);
        for (input, column) in from {
            let r = it
                .inputs
                .get(input)
                .copied()
                .ok_or_else(|| Fault::new("a column is made from an input that is not there"))?;
            let key = match r {
                Ref::Stage(..) | Ref::Flights(_) => self.column(r, line, &column),
                Ref::Map(_) => self.object(r, line),
            };
            match key {
                Ok(key) => parts.extend([column, key.to_string()]),
                Err(_) if it.yields.lenient => parts.push(format!("without {column}")),
                Err(fault) => return Err(fault),
            }
        }
        Ok(Key::of(parts))
    }
}
