//! The keys of every column and object of a plan with its data.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    sync::Arc,
};

use schemas::{Fault, Grain, InputKind, keys::HashKey};

use super::{
    Plan, StageInstance, TableRef,
    graph::{PlanGraph, PlanUnit},
    grid::{SweepGrid, SweepPointMap},
    lines::{LineId, LineSets},
    node::{InputTarget, StageVariant, TableNode},
    seen::IN_SAMPLE,
};
use crate::sources::LineRecord;

/// Number that represents a column name.
pub(super) type ColumnNumber = u32;

/// The names of columns that stages make or read.
#[derive(Default)]
pub(super) struct ColumnNames {
    words: Vec<String>,
    pub(super) known: HashMap<String, ColumnNumber>,
}

impl ColumnNames {
    fn number(&mut self, word: &str) -> ColumnNumber {
        if let Some(known) = self.known.get(word) {
            return *known;
        }
        let next = self.words.len() as ColumnNumber;
        self.known.insert(word.to_owned(), next);
        self.words.push(word.to_owned());
        next
    }
}

/// The properties of a table that determine its keys.
pub(super) struct NodeKeys {
    pub(super) variants: Vec<Arc<VariantKeys>>,
    /// The columns that the table makes at any point.
    pub(super) makes: Vec<ColumnNumber>,
    /// Mapping from the table's points to the points of a smaller grid, which has only the axes on which the input data
    /// depend.
    to_data: SweepPointMap,
    /// Maximum number of lines of a point; 1 for a survey stage.
    width: u64,
    /// First cache numbers of the keys of units, of the keys of the units' data, and of the keys of the units' columns.
    units: u64,
    data_units: Option<u64>,
    columns: u64,
}

/// The properties of a variant that keys need.
#[derive(PartialEq, Eq, Hash)]
pub(super) struct VariantKeys {
    pub(super) made: Vec<ColumnNumber>,
    /// The inputs of each of the columns in `made`.
    from: Vec<Vec<(usize, ColumnNumber)>>,
    /// Columns that are read from each input.
    reads: Vec<Vec<ColumnNumber>>,
    /// Key of the predicate in `where`, which restricts rows.
    rows: HashKey,
}

impl VariantKeys {
    fn new(variant: &StageVariant, names: &mut ColumnNames) -> VariantKeys {
        let columns = &variant.yields.columns;
        let made = columns.iter().map(|c| names.number(&c.name)).collect();
        let from = columns.iter().map(|c| c.from.iter().map(|(i, n)| (*i, names.number(n))).collect()).collect();
        let inputs = variant.yields.reads.len().max(usize::from(variant.predicate.is_some()));
        let reads = (0..inputs).map(|i| read(variant, i).iter().map(|n| names.number(n)).collect()).collect();
        let rows = variant.predicate.as_ref().map(|p| p.canonical.as_str()).unwrap_or_default();
        VariantKeys { made, from, reads, rows: HashKey::from_parts(["rows", rows]) }
    }
}

/// Columns that are read from input `i`, including the columns of `where`.
fn read(variant: &StageVariant, i: usize) -> Vec<String> {
    let mut columns = variant.yields.reads.get(i).cloned().unwrap_or_default();
    if i == 0
        && let Some(p) = &variant.predicate
    {
        let more: Vec<String> = p.columns.iter().filter(|c| !columns.contains(c)).cloned().collect();
        columns.extend(more);
    }
    columns
}

impl PlanGraph<'_> {
    /// The key of the columns `columns` of all lines of a record.
    ///
    /// # Errors
    /// Fails if one of its lines lacks an input.
    pub fn record(&self, r: TableRef, columns: &[String]) -> Result<HashKey, Fault> {
        let mut text = b"record".to_vec();
        for line in self.lines_in(r) {
            let (flight, name) = &self.lines[line];
            word(&mut text, flight);
            word(&mut text, name);
            for column in columns {
                self.part(&mut text, column, self.column(r, line, column), true)?;
            }
        }
        Ok(HashKey::of_bytes(&text))
    }

    /// Key of the object with the result of `r` for `line`.
    ///
    /// # Errors
    /// Fails if the line lacks a required column.
    pub fn object(&self, r: TableRef, line: LineId) -> Result<HashKey, Fault> {
        match r {
            TableRef::Flights(i) => self.records[i].get(&line).map(|l| l.object).ok_or_else(|| self.no_line(line)),
            TableRef::Map(i) => Ok(self.maps[i]),
            TableRef::Stage(t, i) => {
                let of_lines = self.plan.tables[t].entry.grain == Grain::Line;
                self.key(PlanUnit { table: t, instance: i, line: of_lines.then_some(line) })
            }
        }
    }

    /// Key of the object with the model or map `r`, which has no lines.
    ///
    /// # Errors
    /// Fails if one of its inputs is missing, or if `r` has lines.
    pub fn whole(&self, r: TableRef) -> Result<HashKey, Fault> {
        match r {
            TableRef::Map(i) => Ok(self.maps[i]),
            TableRef::Stage(t, i) if self.plan.tables[t].entry.grain != Grain::Line => {
                self.key(PlanUnit { table: t, instance: i, line: None })
            }
            TableRef::Stage(..) | TableRef::Flights(_) => {
                Err(Fault::bug("a table of lines is used where a model or map is required"))
            }
        }
    }

    fn no_line(&self, line: LineId) -> Fault {
        let fault = Fault::data("the line is not in this table");
        match self.lines.get(line) {
            Some((flight, name)) => fault.in_line(flight, name),
            None => fault,
        }
    }

    /// Index of a line among the lines of the point `i` of the table `t`. `None` for any other line, whose key is not
    /// cached.
    fn position(&self, t: usize, i: usize, line: Option<LineId>) -> Option<u64> {
        match line {
            None => Some(0),
            Some(line) => self.lines_of(t, i).binary_search(&line).ok().map(|p| p as u64),
        }
    }

    fn remembered(&self, number: Option<u64>, make: impl FnOnce() -> Result<HashKey, Fault>) -> Result<HashKey, Fault> {
        let Some(number) = number else { return make() };
        if let Some(known) = self.memo.get(number) {
            return Ok(known);
        }
        let key = make()?;
        self.memo.put(number, key);
        Ok(key)
    }

    /// Key of a unit: stage, version, parameters and the keys of its inputs.
    ///
    /// # Errors
    /// Fails if a line lacks a column that is read.
    pub fn key(&self, unit: PlanUnit) -> Result<HashKey, Fault> {
        let PlanUnit { table: t, instance: i, line } = unit;
        let keys = &self.nodes[t];
        let at = self.position(t, i, line);
        self.remembered(at.map(|at| keys.units + i as u64 * keys.width + at), || {
            let number = at.zip(keys.data_units).map(|(at, first)| first + keys.to_data.at(i) as u64 * keys.width + at);
            let data = self.remembered(number, || self.data(t, i, line))?;
            let node = &self.plan.tables[t];
            let mut text = [0; 52];
            text[..4].copy_from_slice(b"unit");
            text[4..20].copy_from_slice(node.questions.at(i).as_ref());
            text[20..36].copy_from_slice(keys.variants[node.variant(i)].rows.as_ref());
            text[36..].copy_from_slice(data.as_ref());
            Ok(HashKey::of_bytes(&text))
        })
    }

    /// Key of all inputs of a unit.
    fn data(&self, t: usize, i: usize, line: Option<LineId>) -> Result<HashKey, Fault> {
        let node = &self.plan.tables[t];
        let v = node.variant(i);
        let keys = &self.nodes[t].variants[v];
        let lenient = line.is_none() || node.variants[v].yields.lenient;
        let lines: &[LineId] = match &line {
            Some(line) => std::slice::from_ref(line),
            None => self.lines_of(t, i),
        };
        let inputs: Vec<(InputKind, TableRef)> = node.inputs(i).collect();
        let mut text = b"data".to_vec();
        for line in lines {
            let (flight, name) = &self.lines[*line];
            word(&mut text, flight);
            word(&mut text, name);
            for ((kind, r), reads) in inputs.iter().zip(&keys.reads).filter(|((kind, _), _)| kind.is_by_line()) {
                for column in reads {
                    if let Some(seen) = self.read_in_sample((*kind, *r), *line, *column)? {
                        word(&mut text, if seen { "in sample" } else { "held out" });
                        continue;
                    }
                    // A fit skips a line that lacks a column; a stage of single lines cannot compute it.
                    let name = &self.names.words[*column as usize];
                    self.part(&mut text, name, self.column_of(*r, *line, *column), lenient)?;
                }
            }
        }
        for (n, (kind, r)) in inputs.iter().enumerate().filter(|(_, (kind, _))| !kind.is_by_line()) {
            word(&mut text, &format!("input {n}"));
            let key = if kind.is_record() { self.record(*r, &read(&node.variants[v], n))? } else { self.whole(*r)? };
            text.extend(key.as_ref());
        }
        Ok(HashKey::of_bytes(&text))
    }

    /// Whether a line is in sample for the input scores, if `column` is `IN_SAMPLE`; otherwise `None`.
    fn read_in_sample(
        &self,
        (kind, r): (InputKind, TableRef),
        line: LineId,
        column: ColumnNumber,
    ) -> Result<Option<bool>, Fault> {
        let asked = kind == InputKind::Scores && self.names.words[column as usize] == IN_SAMPLE;
        if asked { self.in_sample(r, line) } else { Ok(None) }
    }

    /// Appends the name and key of one input column.
    fn part(&self, text: &mut Vec<u8>, name: &str, key: Result<HashKey, Fault>, lenient: bool) -> Result<(), Fault> {
        match key {
            Ok(key) => {
                word(text, name);
                text.extend(key.as_ref());
                Ok(())
            }
            Err(_) if lenient => {
                word(text, "without");
                word(text, name);
                Ok(())
            }
            Err(fault) => Err(fault),
        }
    }

    /// Columns that are read from input `i`, including the columns of `where`.
    pub fn read(&self, it: &StageInstance, i: usize) -> Vec<String> {
        read(it.variant, i)
    }

    /// The key of one column of one line.
    ///
    /// # Errors
    /// Fails if the line lacks the column or an input of the column.
    pub fn column(&self, r: TableRef, line: LineId, name: &str) -> Result<HashKey, Fault> {
        match (self.names.known.get(name), self.bottom(r)) {
            (Some(number), _) => self.column_of(r, line, *number),
            (None, TableRef::Flights(i)) => {
                let record = self.records[i].get(&line).ok_or_else(|| self.no_line(line))?;
                record.columns.get(name).copied().ok_or_else(|| lacks(record, name))
            }
            (None, TableRef::Map(i)) => Ok(HashKey::from_parts([self.maps[i].as_ref(), name.as_bytes()])),
            (None, r @ TableRef::Stage(..)) => {
                Ok(HashKey::from_parts([self.object(r, line)?.as_ref(), name.as_bytes()]))
            }
        }
    }

    fn column_of(&self, r: TableRef, line: LineId, name: ColumnNumber) -> Result<HashKey, Fault> {
        let (made_by, at) = self.made_by(r, name);
        let word = || self.names.words[name as usize].as_str();
        match made_by {
            TableRef::Flights(i) => {
                let known = self.sources[i].get(&name).and_then(|lines| lines.get(line)).copied().flatten();
                known.ok_or_else(|| match self.records[i].get(&line) {
                    Some(record) => lacks(record, word()),
                    None => self.no_line(line),
                })
            }
            TableRef::Map(i) => Ok(HashKey::from_parts([self.maps[i].as_ref(), word().as_bytes()])),
            TableRef::Stage(t, i) => self.made(t, i, line, name, at),
        }
    }

    fn made(&self, t: usize, i: usize, line: LineId, name: ColumnNumber, at: Option<usize>) -> Result<HashKey, Fault> {
        let node = &self.plan.tables[t];
        let keys = &self.nodes[t];
        let v = node.variant(i);
        let from: &[(usize, ColumnNumber)] = at.and_then(|at| keys.variants[v].from.get(at)).map_or(&[], Vec::as_slice);
        let of_lines = node.entry.grain == Grain::Line;
        if !of_lines || from.is_empty() {
            let whole = self.key(PlanUnit { table: t, instance: i, line: of_lines.then_some(line) })?;
            return Ok(HashKey::from_parts([whole.as_ref(), self.names.words[name as usize].as_bytes()]));
        }
        let column = keys.makes.binary_search(&name).ok();
        let number = column
            .zip(self.position(t, i, Some(line)))
            .map(|(column, at)| keys.columns + (column as u64 * node.len() as u64 + i as u64) * keys.width + at);
        self.remembered(number, || {
            let lenient = node.variants[v].yields.lenient;
            let inputs: Vec<(InputKind, TableRef)> = node.inputs(i).collect();
            let mut text = b"column".to_vec();
            text.extend(node.questions.at(i).as_ref());
            text.extend(keys.variants[v].rows.as_ref());
            word(&mut text, &self.names.words[name as usize]);
            for (input, column) in from {
                let (kind, r) = inputs
                    .get(*input)
                    .ok_or_else(|| Fault::new("a column is made from an input that does not exist"))?;
                let name = &self.names.words[*column as usize];
                let key = match r {
                    TableRef::Stage(..) | TableRef::Flights(_) if kind.is_record() => {
                        self.record(*r, std::slice::from_ref(name))
                    }
                    TableRef::Stage(..) | TableRef::Flights(_) => self.column_of(*r, line, *column),
                    TableRef::Map(_) => self.object(*r, line),
                };
                self.part(&mut text, name, key, lenient)?;
            }
            Ok(HashKey::of_bytes(&text))
        })
    }
}

impl NodeKeys {
    /// Creates the key data; the first cache number is `numbers`, which is advanced.
    pub(super) fn new(
        plan: &Plan,
        node: &TableNode,
        sets: &LineSets,
        t: usize,
        names: &mut ColumnNames,
        numbers: &mut u64,
    ) -> NodeKeys {
        let mut known: HashSet<Arc<VariantKeys>> = HashSet::new();
        let mut shared = |keys: VariantKeys| {
            let keys = known.get(&keys).cloned().unwrap_or_else(|| Arc::new(keys));
            known.insert(keys.clone());
            keys
        };
        let variants: Vec<Arc<VariantKeys>> =
            node.variants.iter().map(|v| shared(VariantKeys::new(v, names))).collect();
        let mut makes: Vec<ColumnNumber> = variants.iter().flat_map(|v| v.made.iter().copied()).collect();
        makes.sort_unstable();
        makes.dedup();
        let mut axes: Vec<usize> = node.variant.grid().axes().chain(sets.grid(t).axes()).collect();
        for slot in &node.slots {
            axes.extend(slot.targets.grid().axes());
            for target in slot.targets.values().iter().flat_map(|t| t.iter()) {
                if let InputTarget::Stage(t, _) = target {
                    axes.extend(plan.tables[*t].grid.axes());
                }
            }
        }
        let data = SweepGrid::new(&axes, &plan.spec);
        let width = match node.entry.grain {
            Grain::Survey | Grain::Map => 1,
            Grain::Line => sets.each(t, 1).map(|(set, _)| set.len() as u64).max().unwrap_or(0).max(1),
        };
        let mut take = |points: usize| {
            let first = *numbers;
            *numbers += points as u64 * width;
            first
        };
        let units = take(node.len());
        let data_units = (data.len() < node.len()).then(|| take(data.len()));
        let columns = take(node.len().saturating_mul(makes.len()));
        let to_data = node.grid.onto(&data);
        NodeKeys { variants, makes, to_data, width, units, data_units, columns }
    }
}

/// The keys of the columns that stages read, by line.
pub(super) fn columns_of(
    records: &BTreeMap<LineId, LineRecord>,
    lines: usize,
    names: &ColumnNames,
) -> HashMap<ColumnNumber, Vec<Option<HashKey>>> {
    let mut found: HashMap<ColumnNumber, Vec<Option<HashKey>>> = HashMap::new();
    for (line, record) in records {
        for (name, key) in &record.columns {
            if let Some(number) = names.known.get(name) {
                found.entry(*number).or_insert_with(|| vec![None; lines])[*line] = Some(*key);
            }
        }
    }
    found
}

fn lacks(record: &LineRecord, name: &str) -> Fault {
    Fault::data(format!("the line has no column `{name}`")).in_line(&record.flight, &record.line)
}

/// Appends a part to the hashed bytes, prefixed by the length of the part.
fn word(text: &mut Vec<u8>, word: &str) {
    text.extend((word.len() as u32).to_le_bytes());
    text.extend(word.as_bytes());
}
