//! What must not be published: columns of tables of files that are restricted, and all that is made from them row by row.
//!
//! The lineage of columns is walked from each column that is to go out. It ends at tables of scores and models, which are
//! made of many rows together, but for lists in them, which hold single samples; maps and flight lines are not such aggregates,
//! however far down they are.

use std::collections::{HashMap, HashSet, VecDeque};

use schemas::Fault;

use super::set::{Held, Table};
use crate::{
    plan::Graph,
    spec::publish::{Protection, Restricted},
    views::{SnapshotTable, described},
};

/// The identifiers of a line, which every table and score names.
const IDENTIFIERS: [&str; 2] = ["flight", "line"];

/// A column of a table.
type Column = (String, String);

/// The lineage of a plan's columns.
struct Lineage<'a> {
    stages: HashMap<String, SnapshotTable>,
    /// The columns that are handed to the stage of each table, which may be in anything it makes.
    reads: HashMap<String, Vec<Column>>,
    sources: HashMap<&'a str, &'a Protection>,
}

impl<'a> Lineage<'a> {
    fn new(graph: &'a Graph) -> Lineage<'a> {
        let plan = graph.plan;
        let mut reads: HashMap<String, Vec<Column>> = HashMap::new();
        for (t, node) in plan.tables.iter().enumerate() {
            let own = reads.entry(node.name.clone()).or_default();
            for i in node.examples(&plan.spec) {
                let it = plan.instance(t, i);
                for (input, names) in it.inputs().iter().zip(&it.yields.reads) {
                    let table = plan.name_of(*input);
                    own.extend(names.iter().map(|name| (table.to_owned(), name.clone())));
                }
            }
        }
        let stages = described(graph).into_iter().map(|t| (t.name.clone(), t)).collect();
        let sources = plan.spec.tables.iter().map(|t| (t.name.as_str(), &t.protection)).collect();
        Lineage { stages, reads, sources }
    }

    /// The protection of a column of a table of files, where it is restricted today.
    fn restricted(&self, (table, column): &Column) -> Option<&'a Protection> {
        let protection = self.sources.get(table.as_str()).filter(|_| !self.stages.contains_key(table))?;
        let is = match protection.now() {
            Restricted::None => false,
            Restricted::All => !IDENTIFIERS.contains(&column.as_str()),
            Restricted::Columns(names) => names.contains(column),
        };
        is.then_some(*protection)
    }

    /// The columns that a column is made from, row by row.
    fn above(&self, (table, column): &Column) -> Vec<Column> {
        let Some(stage) = self.stages.get(table) else { return vec![] };
        let Some(own) = stage.columns.iter().find(|c| c.name == *column) else { return vec![] };
        // A list in a small table holds samples one by one, such as those of an importance.
        if stage.tidy && !own.kind.starts_with("list") {
            return vec![];
        }
        if own.from.is_empty() && !IDENTIFIERS.contains(&column.as_str()) {
            // A stage that does not say what it made a column of may have used all that it was handed.
            return self.reads.get(table).cloned().unwrap_or_default();
        }
        own.from.clone()
    }

    /// The columns from `start` to the first restricted one that it is made from.
    fn find(&self, start: &Column) -> Option<(Vec<Column>, &'a Protection)> {
        let mut queue = VecDeque::from([start.clone()]);
        let mut came_from: HashMap<Column, Column> = HashMap::new();
        let mut seen = HashSet::from([start.clone()]);
        while let Some(at) = queue.pop_front() {
            if let Some(protection) = self.restricted(&at) {
                let mut chain = vec![at];
                while let Some(below) = chain.last().and_then(|last| came_from.get(last)) {
                    chain.push(below.clone());
                }
                chain.reverse();
                return Some((chain, protection));
            }
            for above in self.above(&at) {
                if seen.insert(above.clone()) {
                    came_from.insert(above.clone(), at.clone());
                    queue.push_back(above);
                }
            }
        }
        None
    }
}

/// Names the columns that each column of `tables` was made from.
pub fn describe(graph: &Graph, tables: &mut [Table]) {
    let lineage = Lineage::new(graph);
    for table in tables {
        let Some(stage) = lineage.stages.get(&table.name) else { continue };
        for column in &mut table.columns {
            let own = stage.columns.iter().find(|c| c.name == column.name);
            column.from = own.iter().flat_map(|c| &c.from).map(|(t, c)| format!("{t}.{c}")).collect();
        }
    }
}

/// The columns of `tables` that are restricted or made from restricted ones row by row.
pub fn find(graph: &Graph, tables: &[(String, Vec<String>)]) -> Vec<Held> {
    let lineage = Lineage::new(graph);
    let mut found = vec![];
    for (table, columns) in tables {
        for column in columns {
            if let Some((chain, protection)) = lineage.find(&(table.clone(), column.clone())) {
                found.push(Held {
                    table: table.clone(),
                    column: column.clone(),
                    through: chain.iter().map(|(t, c)| format!("{t}.{c}")).collect(),
                    reason: protection.reason.clone(),
                    embargo: protection.embargo.clone(),
                });
            }
        }
    }
    found
}

/// Why a restricted column is restricted.
pub fn why(held: &Held) -> String {
    let until = held.embargo.as_ref().map(|day| format!("until {day}"));
    let why: Vec<String> = until.into_iter().chain(held.reason.clone()).collect();
    let source = held.through.last().map(String::as_str).unwrap_or_default();
    if why.is_empty() {
        format!("`{source}` is restricted")
    } else {
        format!("`{source}` is restricted: {}", why.join(", "))
    }
}

/// Where a held column comes from, in words.
pub fn chain(held: &Held) -> String {
    held.through.join(" <- ")
}

/// The fault of publishing what is restricted.
pub fn refused(held: &[Held]) -> Fault {
    const SHOWN: usize = 10;
    let mut what = "restricted data would be published".to_owned();
    for one in held.iter().take(SHOWN) {
        what += &format!("\n  {}\n    {}", chain(one), why(one));
    }
    if held.len() > SHOWN {
        what += &format!("\n  and {} more columns", held.len() - SHOWN);
    }
    Fault::new(what).help(
        "publish tables that are not made from them row by row, such as scores and models; or say `--include-restricted` \
         if you may, and the data set will say so",
    )
}
