//! Rejection of queries that change anything.

use datafusion::{
    common::tree_node::TreeNodeRecursion,
    logical_expr::LogicalPlan,
    sql::{parser::Statement, sqlparser::ast::Statement as Sql},
};
use expressions::deep;
use schemas::Fault;

/// Rejects a statement that is not a query, and a statement that is nested too deep.
///
/// # Errors
/// Fails with the reason why the statement is rejected.
pub fn statement(statement: &Statement) -> Result<(), Fault> {
    match statement {
        Statement::Statement(sql) => match sql.as_ref() {
            Sql::Query(query) => deep::check(query, deep::QUERY),
            // DataFusion turns these statements into queries of its internal tables.
            Sql::ExplainTable { .. }
            | Sql::ShowTables { .. }
            | Sql::ShowColumns { .. }
            | Sql::ShowFunctions { .. }
            | Sql::ShowVariable { .. } => Ok(()),
            Sql::Explain { statement, .. } => match statement.as_ref() {
                Sql::Query(query) => deep::check(query, deep::QUERY),
                other => Err(refused(&other.to_string())),
            },
            other => Err(refused(&other.to_string())),
        },
        Statement::Explain(explain) => self::statement(&explain.statement),
        Statement::CreateExternalTable(_) => Err(refused("CREATE EXTERNAL TABLE")),
        Statement::CopyTo(_) => Err(refused("COPY")),
        Statement::Reset(_) => Err(refused("RESET")),
    }
}

/// Rejects a plan if any part, at any depth, does more than read.
///
/// # Errors
/// Fails with the reason why the part is rejected.
pub fn plan(plan: &LogicalPlan) -> Result<(), Fault> {
    let mut found = None;
    let visited = plan.apply_with_subqueries(|part| {
        found = does(part);
        Ok(if found.is_some() { TreeNodeRecursion::Stop } else { TreeNodeRecursion::Continue })
    });
    visited.map_err(|e| Fault::new(format!("cannot run the query: {e}")))?;
    found.map_or(Ok(()), |what| Err(refused(&what)))
}

/// Name of the action of a part of a plan; `None` if the part only reads.
fn does(part: &LogicalPlan) -> Option<String> {
    match part {
        LogicalPlan::Ddl(x) => Some(x.name().to_owned()),
        LogicalPlan::Dml(x) => Some(x.op.to_string()),
        LogicalPlan::Copy(_) => Some("COPY".to_owned()),
        LogicalPlan::Statement(x) => Some(x.name().to_owned()),
        LogicalPlan::Extension(x) => Some(x.node.name().to_owned()),
        LogicalPlan::Projection(_)
        | LogicalPlan::Filter(_)
        | LogicalPlan::Window(_)
        | LogicalPlan::Aggregate(_)
        | LogicalPlan::Sort(_)
        | LogicalPlan::Join(_)
        | LogicalPlan::Repartition(_)
        | LogicalPlan::Union(_)
        | LogicalPlan::TableScan(_)
        | LogicalPlan::EmptyRelation(_)
        | LogicalPlan::Subquery(_)
        | LogicalPlan::SubqueryAlias(_)
        | LogicalPlan::Limit(_)
        | LogicalPlan::Values(_)
        | LogicalPlan::Explain(_)
        | LogicalPlan::Analyze(_)
        | LogicalPlan::Distinct(_)
        | LogicalPlan::DescribeTable(_)
        | LogicalPlan::Unnest(_)
        | LogicalPlan::RecursiveQuery(_) => None,
    }
}

/// Fault for a rejected statement that begins with `text`.
fn refused(text: &str) -> Fault {
    const KINDS: [&str; 4] = ["CREATE", "DROP", "ALTER", "EXPLAIN"];
    let words: Vec<&str> = text.split_whitespace().take(3).collect();
    let named = words.first().is_some_and(|w| KINDS.contains(&w.to_uppercase().as_str()));
    let kind = words.iter().take(if named { 2 } else { 1 }).map(|w| w.to_uppercase()).collect::<Vec<_>>().join(" ");
    let fault = Fault::new(format!("`{kind}` is rejected: queries are read-only"));
    fault.help("use SELECT; `magline sql -o FILE` writes the result to a file")
}
