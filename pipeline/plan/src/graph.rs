//! The plan with its data: the lines of each table, the units, and the stage that made each column.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    path::PathBuf,
    sync::OnceLock,
};

use arrow_array::RecordBatch;
use schemas::{Fault, Grain, keys::HashKey};
use store::Store;

use super::{
    Plan, StageInstance, TableRef,
    keys::{ColumnNames, ColumnNumber, NodeKeys, columns_of},
    lines::{LineId, LineSets},
    memo::KeyCache,
    seen::InSampleLines,
};
use crate::{
    sources::{FileDigest, FlightLines, LineRecord, ReadProgress, made_map_batch, map_batch},
    spec::SpecFaults,
};

/// A plan whose sources have been read.
pub struct PlanGraph<'a> {
    /// The plan.
    pub plan: &'a Plan,
    /// Every (flight, line) of all sources, sorted.
    pub lines: Vec<(String, String)>,
    /// The records of each table of flights.
    pub records: Vec<BTreeMap<LineId, LineRecord>>,
    /// The files from which each table of flights was read, then the files of each map.
    pub bytes: Vec<Vec<FileDigest>>,
    /// Folders with the quality figures of each table of flights.
    pub quality: Vec<Vec<PathBuf>>,
    /// Key of each map.
    pub maps: Vec<HashKey>,
    /// The lines of each point of each table.
    pub(super) sets: LineSets,
    /// Column names, by number.
    pub(super) names: ColumnNames,
    /// Keys of the columns that stages read: for each table of flights and each column, the key on each line.
    pub(super) sources: Vec<HashMap<ColumnNumber, Vec<Option<HashKey>>>>,
    /// Key data of each table.
    pub(super) nodes: Vec<NodeKeys>,
    /// Cache of keys.
    pub(super) memo: KeyCache,
    /// In-sample lines of each table of scores, computed at first use.
    pub(super) seen: Vec<OnceLock<Result<InSampleLines, Fault>>>,
}

/// Unit of computation: a table at one point of the sweep, on one line or on all lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PlanUnit {
    /// The table.
    pub table: usize,
    /// Point of the table's stage.
    pub instance: usize,
    /// The line; `None` for a stage of a whole survey or of maps.
    pub line: Option<LineId>,
}

/// Location of the values of a column: a stage, and the column's name in this stage.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct ColumnLocation {
    /// The stage that made the column.
    pub made_by: TableRef,
    /// Name of the column in that stage.
    pub column: String,
}

impl<'a> PlanGraph<'a> {
    /// Reads missing sources of `plan` into `store`.
    ///
    /// # Errors
    /// Fails for files that cannot be read.
    pub fn new(
        plan: &'a Plan,
        store: &Store,
        tick: &(dyn Fn(&str, &ReadProgress) + Sync),
    ) -> Result<PlanGraph<'a>, SpecFaults> {
        let mut faults = vec![];
        let mut sources: Vec<FlightLines> = vec![];
        for flights in &plan.flights {
            match flights.lines(store, &|step| tick(&flights.name, step)) {
                Ok(lines) => sources.push(lines),
                Err(wrong) => faults.extend(wrong),
            }
        }
        let (mut maps, mut map_bytes) = (vec![], vec![]);
        for map in &plan.maps {
            tick(&map.name, &ReadProgress::of_file(&map.path, 0, 1));
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
        let bytes = sources.iter().map(|s| s.files.clone()).chain(map_bytes).collect();
        let quality = sources.iter().map(|s| s.quality.clone()).collect();
        let graph = PlanGraph::from_records(plan, sources.into_iter().map(|s| s.lines).collect(), bytes, maps)?;
        Ok(PlanGraph { quality, ..graph })
    }

    /// Creates the graph from records: the lines of each table of flights, and the key of each map.
    ///
    /// # Errors
    /// Fails for a `where` that selects nothing.
    pub(super) fn from_records(
        plan: &'a Plan,
        sources: Vec<Vec<LineRecord>>,
        bytes: Vec<Vec<FileDigest>>,
        maps: Vec<HashKey>,
    ) -> Result<PlanGraph<'a>, SpecFaults> {
        let names: BTreeSet<(String, String)> =
            sources.iter().flatten().map(|l| (l.flight.clone(), l.line.clone())).collect();
        let lines: Vec<(String, String)> = names.into_iter().collect();
        // `lines` is made from all records, so the line of each record is found.
        let known = |l: LineRecord| Some((lines.binary_search(&(l.flight.clone(), l.line.clone())).ok()?, l));
        let records: Vec<BTreeMap<LineId, LineRecord>> =
            sources.into_iter().map(|s| s.into_iter().filter_map(known).collect()).collect();
        let flights = records.iter().map(|r| r.keys().copied().collect()).collect();
        let sets = LineSets::new(plan, flights, &lines).map_err(|(t, fault)| {
            let at = plan.decl(t).and_then(|d| d.predicate.clone()).map_or(plan.tables[t].at.clone(), |(_, at)| at);
            plan.spec.faults(vec![fault.at(at)])
        })?;
        let mut names = ColumnNames::default();
        let mut numbers = 0;
        let mut nodes: Vec<NodeKeys> = vec![];
        for (t, node) in plan.tables.iter().enumerate() {
            nodes.push(NodeKeys::new(plan, node, &sets, t, &mut names, &mut numbers));
        }
        let sources = records.iter().map(|r| columns_of(r, lines.len(), &names)).collect();
        Ok(PlanGraph {
            plan,
            lines,
            records,
            bytes,
            quality: vec![],
            maps,
            sets,
            names,
            sources,
            nodes,
            memo: KeyCache::new(numbers),
            seen: plan.tables.iter().map(|_| OnceLock::new()).collect(),
        })
    }

    /// The inputs that are tables of flight lines, with their positions.
    pub fn line_inputs(&self, instance: &StageInstance) -> Vec<(usize, TableRef)> {
        let inputs = instance.node.inputs(instance.index).enumerate();
        inputs.filter(|(_, (kind, _))| kind.is_by_line()).map(|(i, (_, r))| (i, r)).collect()
    }

    /// Lines of a record, without the lines of unreadable files.
    pub fn lines_in(&self, r: TableRef) -> Vec<LineId> {
        match r {
            TableRef::Flights(i) => {
                let records = self.records.get(i).into_iter().flatten();
                records.filter(|(_, record)| record.fault.is_none()).map(|(line, _)| *line).collect()
            }
            TableRef::Stage(t, i) => self.lines_of(t, i).to_vec(),
            TableRef::Map(_) => vec![],
        }
    }

    /// The lines of a table at one of its points.
    pub fn lines_of(&self, table: usize, instance: usize) -> &[LineId] {
        self.sets.point_lines(table, instance)
    }

    /// Number that identifies the set of lines of an instance: equal sets have equal numbers.
    pub fn line_set(&self, table: usize, instance: usize) -> u32 {
        self.sets.set(table, instance)
    }

    /// All lines of a table, over all its points, sorted.
    pub fn all_lines_of(&self, table: usize) -> Vec<LineId> {
        let each: BTreeSet<LineId> = self.sets.each(table, 1).flat_map(|(set, _)| set).copied().collect();
        each.into_iter().collect()
    }

    /// The largest number of lines of a point of a table.
    pub fn most_lines_of(&self, table: usize) -> usize {
        self.sets.each(table, 1).map(|(set, _)| set.len()).max().unwrap_or(0)
    }

    /// The units of one table.
    pub fn units(&self, table: usize) -> impl Iterator<Item = PlanUnit> + '_ {
        let node = &self.plan.tables[table];
        let grain = node.entry.grain;
        (0..node.len()).flat_map(move |instance| {
            let (survey, lines): (Option<PlanUnit>, &[LineId]) = match grain {
                Grain::Survey | Grain::Map => (Some(PlanUnit { table, instance, line: None }), &[]),
                Grain::Line => (None, self.lines_of(table, instance)),
            };
            survey.into_iter().chain(lines.iter().map(move |l| PlanUnit { table, instance, line: Some(*l) }))
        })
    }

    /// The number of units of one table.
    pub fn unit_count(&self, table: usize) -> usize {
        let node = &self.plan.tables[table];
        match node.entry.grain {
            Grain::Survey | Grain::Map => node.len(),
            Grain::Line => self.sets.each(table, node.len()).map(|(set, times)| set.len() * times).sum(),
        }
    }

    /// Origin of the column `column` of `r`: the upstream stage that made the column, not a stage through which it only
    /// passes.
    pub fn origin(&self, r: TableRef, column: &str) -> ColumnLocation {
        let made_by = match self.names.known.get(column) {
            Some(name) => self.made_by(r, *name).0,
            None => self.bottom(r),
        };
        ColumnLocation { made_by, column: column.to_owned() }
    }

    /// The stage that made a column of `r`, and the index of the column among the columns that this stage makes. For a
    /// column that no stage makes, the source of the column and `None`.
    pub(super) fn made_by(&self, mut r: TableRef, name: ColumnNumber) -> (TableRef, Option<usize>) {
        while let TableRef::Stage(t, i) = r {
            let node = &self.plan.tables[t];
            if self.nodes[t].makes.binary_search(&name).is_ok() {
                let made = &self.nodes[t].variants[node.variant(i)].made;
                if let Some(at) = made.iter().position(|n| *n == name) {
                    return (r, Some(at));
                }
            }
            match node.inputs(i).next() {
                Some((_, first)) => r = first,
                None => break,
            }
        }
        (r, None)
    }

    /// The source of the columns of `r` that no stage makes.
    pub(super) fn bottom(&self, mut r: TableRef) -> TableRef {
        while let TableRef::Stage(t, i) = r
            && let Some((_, first)) = self.plan.tables[t].inputs(i).next()
        {
            r = first;
        }
        r
    }

    /// The map `r` on its native grid, from a file or a stage.
    ///
    /// # Errors
    /// Fails if `r` is not in the store, or is not a map.
    pub fn map(&self, store: &Store, r: TableRef) -> Result<RecordBatch, Fault> {
        let key = self.whole(r)?;
        match r {
            TableRef::Stage(..) => made_map_batch(store, key),
            TableRef::Map(_) | TableRef::Flights(_) => map_batch(store, key),
        }
    }
}
