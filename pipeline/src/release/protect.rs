//! Restricted data in a published set: restricted columns of tables of files, and all columns computed from them row by
//! row.
//!
//! The lineage of columns is followed from each column to be published. It ends at tables of scores and models that are
//! aggregates by the rules of [`aggregate`]. Lists in such tables hold single samples and are not aggregates. Maps and
//! flight lines are never aggregates, however many steps lie between them and the restricted column.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};

use plan::{
    PlanGraph,
    spec::publish::{ColumnRestriction, ProtectionKeys},
};
use results::{SnapshotTable, described};
use schemas::Fault;
use store::Store;

use super::{
    aggregate::{self, Aggregate},
    set::{ReleaseTable, RestrictedReleaseColumn},
};

/// Identifiers of a line, which are columns of every table and score.
const IDENTIFIERS: [&str; 2] = ["flight", "line"];

/// Help text for a request that would publish restricted data.
const HELP: &str = "publish only tables that do not carry restricted columns row by row, for example scores or models; \
                    or, if you have the right to publish the restricted columns, use `--include-restricted`: the \
                    published set then states the restrictions";

/// Column of a table: names of table and column.
pub type LineageColumn = (String, String);

/// Lineage of a plan's columns.
pub struct Lineage<'a> {
    /// Tables of the stages.
    pub stages: HashMap<String, SnapshotTable>,
    /// Columns that the stage of each table reads, which may affect all columns it makes.
    reads: HashMap<String, Vec<LineageColumn>>,
    sources: HashMap<&'a str, &'a ProtectionKeys>,
    /// Small tables that depend on restricted columns. Each is an aggregate, or has the reason why it is not one.
    aggregates: HashMap<String, Result<Aggregate, String>>,
}

impl<'a> Lineage<'a> {
    /// Lineage of the columns of a plan with results in `store`.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn new(graph: &'a PlanGraph, store: &Store) -> Result<Lineage<'a>, Fault> {
        let plan = graph.plan;
        let mut reads: HashMap<String, Vec<LineageColumn>> = HashMap::new();
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
        let mut lineage = Lineage { stages, reads, sources, aggregates: HashMap::new() };
        // Tables are visited after their inputs, so that the aggregates among the inputs are known.
        for (t, node) in plan.tables.iter().enumerate().filter(|(_, node)| node.is_small()) {
            let reached = lineage.reached(&node.name);
            let strictest = reached.iter().filter_map(|column| lineage.restricted(column)).collect::<Vec<_>>();
            if !strictest.is_empty() {
                let found = aggregate::judge(graph, store, t, &reached, &strictest)?;
                lineage.aggregates.insert(node.name.clone(), found);
            }
        }
        Ok(lineage)
    }

    /// All columns upstream of a table, followed until an aggregate is reached.
    fn reached(&self, table: &str) -> HashSet<LineageColumn> {
        let mut waiting = self.reads.get(table).cloned().unwrap_or_default();
        let mut seen = HashSet::new();
        while let Some(at) = waiting.pop() {
            if !seen.contains(&at) {
                waiting.extend(self.above(&at));
                seen.insert(at);
            }
        }
        seen
    }

    /// Protection of a column that is read from files; `None` if the column is not restricted today.
    fn restricted(&self, (table, column): &LineageColumn) -> Option<&'a ProtectionKeys> {
        let protection = self.sources.get(table.as_str()).filter(|_| !self.stages.contains_key(table))?;
        let is = match protection.now() {
            ColumnRestriction::None => false,
            ColumnRestriction::All => !IDENTIFIERS.contains(&column.as_str()),
            ColumnRestriction::Columns(names) => names.contains(column),
        };
        is.then_some(*protection)
    }

    /// Columns from which a column is made, row by row.
    fn above(&self, (table, column): &LineageColumn) -> Vec<LineageColumn> {
        let Some(stage) = self.stages.get(table) else { return vec![] };
        let Some(own) = stage.columns.iter().find(|c| c.name == *column) else { return vec![] };
        if stage.tidy {
            // A list in a small table holds values of single samples, such as the contributions in a table of feature
            // importance.
            let single = own.kind.starts_with("list") || matches!(self.aggregates.get(table), Some(Err(_)));
            if !single || IDENTIFIERS.contains(&column.as_str()) {
                return vec![];
            }
            if !own.kind.starts_with("list") {
                return self.reads.get(table).cloned().unwrap_or_default();
            }
        }
        if own.from.is_empty() && !IDENTIFIERS.contains(&column.as_str()) {
            // A stage without declared sources may have used all columns that it reads.
            return self.reads.get(table).cloned().unwrap_or_default();
        }
        own.from.clone()
    }

    /// Columns on the way from `start` to the first restricted column upstream.
    fn find(&self, start: &LineageColumn) -> Option<(Vec<LineageColumn>, &'a ProtectionKeys)> {
        let mut queue = VecDeque::from([start.clone()]);
        let mut came_from: HashMap<LineageColumn, LineageColumn> = HashMap::new();
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

/// Records the columns from which each column of `tables` was made.
pub fn describe(lineage: &Lineage, tables: &mut [ReleaseTable]) {
    for table in tables {
        let Some(stage) = lineage.stages.get(&table.name) else { continue };
        for column in &mut table.columns {
            let own = stage.columns.iter().find(|c| c.name == column.name);
            column.from = own.iter().flat_map(|c| &c.from).map(|(t, c)| format!("{t}.{c}")).collect();
        }
    }
}

/// Columns of `tables` that are restricted, or computed row by row from restricted columns.
pub fn find(lineage: &Lineage, tables: &[(String, Vec<String>)]) -> Vec<RestrictedReleaseColumn> {
    let mut found = vec![];
    for (table, columns) in tables {
        for column in columns {
            if let Some((chain, protection)) = lineage.find(&(table.clone(), column.clone())) {
                let why = chain.iter().find_map(|(t, _)| lineage.aggregates.get(t)?.as_ref().err().map(|w| (t, w)));
                found.push(RestrictedReleaseColumn {
                    table: table.clone(),
                    column: column.clone(),
                    through: chain.iter().map(|(t, c)| format!("{t}.{c}")).collect(),
                    rule: why.map(|(table, why)| format!("`{table}` is not an aggregate: {why}")),
                    reason: protection.reason.clone(),
                    embargo: protection.embargo.clone(),
                });
            }
        }
    }
    found
}

/// Checks the published aggregates of restricted columns together: differences between them must not reveal single
/// samples.
///
/// # Errors
/// Fails with the tables, and the rule that they break.
pub fn together(lineage: &Lineage, tables: &[(String, Vec<String>)]) -> Result<(), Fault> {
    let all = tables.iter().filter_map(|(t, _)| Some((t.as_str(), lineage.aggregates.get(t)?.as_ref().ok()?)));
    aggregate::together(&all.collect::<Vec<_>>())
        .map_err(|what| Fault::new(format!("this would publish restricted data\n  {what}")).help(HELP))
}

/// Rule that permits the publication of each of `tables`.
pub fn rules(
    lineage: &Lineage,
    tables: &[(String, Vec<String>)],
    held: &[RestrictedReleaseColumn],
) -> Vec<(String, String)> {
    let rule = |(table, columns): &(String, Vec<String>)| {
        if held.iter().any(|h| h.table == *table) {
            return (table.clone(), "restricted, published with `--include-restricted`".to_owned());
        }
        let mut seen: HashSet<LineageColumn> = HashSet::new();
        let mut waiting: Vec<LineageColumn> = columns.iter().map(|c| (table.clone(), c.clone())).collect();
        let mut through: BTreeMap<String, String> = BTreeMap::new();
        while let Some(at) = waiting.pop() {
            if let Some(Ok(aggregate)) = lineage.aggregates.get(&at.0) {
                through.insert(at.0.clone(), aggregate.words());
            }
            if !seen.contains(&at) {
                waiting.extend(lineage.above(&at));
                seen.insert(at);
            }
        }
        let words = through.into_iter().map(|(name, words)| {
            if name == *table {
                format!("aggregate of restricted columns, {words}")
            } else {
                format!("restricted columns are used only through the aggregate `{name}`, {words}")
            }
        });
        let words: Vec<String> = words.collect();
        let none = || "not made from restricted columns".to_owned();
        (table.clone(), if words.is_empty() { none() } else { words.join("; ") })
    };
    tables.iter().map(rule).collect()
}

/// Reason of a restriction.
pub fn why(held: &RestrictedReleaseColumn) -> String {
    let until = held.embargo.as_ref().map(|day| format!("until {day}"));
    let why: Vec<String> = until.into_iter().chain(held.reason.clone()).collect();
    let source = held.through.last().map(String::as_str).unwrap_or_default();
    if why.is_empty() {
        format!("`{source}` is restricted")
    } else {
        format!("`{source}` is restricted: {}", why.join(", "))
    }
}

/// Origin of a restricted column, in words.
pub fn chain(held: &RestrictedReleaseColumn) -> String {
    held.through.join(" <- ")
}

/// Fault for a request that would publish restricted columns.
pub fn refused(held: &[RestrictedReleaseColumn]) -> Fault {
    const SHOWN: usize = 10;
    let mut what = "this would publish restricted data".to_owned();
    for one in held.iter().take(SHOWN) {
        what += &format!("\n  {}\n    {}", chain(one), why(one));
        what += &one.rule.as_ref().map(|rule| format!("\n    {rule}")).unwrap_or_default();
    }
    if held.len() > SHOWN {
        what += &format!("\n  and {} more columns", held.len() - SHOWN);
    }
    Fault::new(what).help(HELP)
}
