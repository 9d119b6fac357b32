//! DataFusion's errors as faults that list the existing tables and columns.

use datafusion::{
    common::{SchemaError, TableReference},
    error::DataFusionError,
    sql::sqlparser::parser::ParserError,
};
use expressions::deep;
use schemas::Fault;

use super::{memory, scan::ScanFault, session::SqlSession, tables::QueryTables};

/// Fault for the error `e`.
pub fn fault(e: &DataFusionError, session: &SqlSession, query: &str) -> Fault {
    match e.find_root() {
        DataFusionError::ResourcesExhausted(_) => memory::fault(session.memory()),
        DataFusionError::SQL(inner, _) if matches!(inner.as_ref(), ParserError::RecursionLimitExceeded) => {
            deep::too_deep()
        }
        DataFusionError::SchemaError(inner, _) => match inner.as_ref() {
            SchemaError::FieldNotFound { field, valid_fields } => {
                let have: Vec<&str> = valid_fields.iter().map(|c| c.name.as_str()).collect();
                Fault::new(format!("there is no column `{}`", field.name)).nearest(&field.name, &have)
            }
            other => Fault::new(format!("cannot run the query: {other}")),
        },
        DataFusionError::External(inner) if inner.is::<ScanFault>() => match inner.downcast_ref::<ScanFault>() {
            Some(ScanFault(fault)) => fault.clone(),
            None => Fault::machine(inner.to_string()),
        },
        root => {
            let text = root.strip_backtrace();
            let text = text.lines().next().unwrap_or_default().to_owned();
            // Offsets of strings and lists have 31 bits; DataFusion's tasks panic at larger offsets.
            let lower = text.to_lowercase();
            let too_long = ["offset overflow", "size overflow", "failed to allocate"].iter().any(|w| lower.contains(w));
            if text.contains("panicked") || too_long {
                return Fault::machine(format!("the query has values that are too large: {text}"))
                    .help("select fewer rows with WHERE, or select fewer columns or shorter texts");
            }
            let no_table = text.contains("not found") && (text.contains("table") || text.contains("schema"));
            let missing = if no_table { missing(session, query) } else { None };
            missing.unwrap_or_else(|| Fault::new(format!("cannot run the query: {text}")))
        }
    }
}

/// First table in the query that is missing from the store.
fn missing(session: &SqlSession, query: &str) -> Option<Fault> {
    let (known, state) = (session.known(), session.context().state());
    let statement = state.sql_to_statement(query, &state.config().options().sql_parser.dialect).ok()?;
    let asked = state.resolve_table_references(&statement).ok()?;
    if known.tables.is_empty() && !asked.is_empty() {
        let fault = Fault::new(format!("there are no tables in the store {}", session.store().display()));
        return Some(fault.help("run a spec first, then give its store with `--store`"));
    }
    asked.iter().find_map(|table| not_there(table, known))
}

fn not_there(table: &TableReference, known: &QueryTables) -> Option<Fault> {
    let name = match table.schema() {
        Some(schema) => format!("{schema}.{}", table.table()),
        None => table.table().to_owned(),
    };
    if table.schema() == Some("information_schema") || known.tables.contains(&name) {
        return None;
    }
    if known.elsewhere.contains(&name) {
        let fault = Fault::new(format!("the table `{name}` is a link to a place outside the store"));
        return Some(fault.help("`magline sql` reads only files in the store"));
    }
    let fault = Fault::new(format!("there is no table `{name}`"));
    let same = |k: &&String| {
        let own = k.split_once('.').map_or(k.as_str(), |(_, own)| own);
        k.eq_ignore_ascii_case(&name) || own.eq_ignore_ascii_case(&name)
    };
    Some(match known.tables.iter().find(same) {
        Some(one) => fault.help(format!("did you mean `{}`?", quoted(one))),
        None => {
            let all: Vec<String> = known.tables.iter().map(|k| quoted(k)).collect();
            fault.nearest(&name, &all)
        }
    })
}

/// A table name in SQL; a name that is not lower case is quoted.
fn quoted(name: &str) -> String {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let part = |p: &str| if p.chars().all(plain) { p.to_owned() } else { format!("\"{p}\"") };
    name.split('.').map(part).collect::<Vec<_>>().join(".")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_the_nearest_table_is_named_as_it_is_written() {
        let tables = ["small.scores", "small.clean", "Big-one.scores"].map(str::to_owned).to_vec();
        let known = QueryTables { pins: Default::default(), tables, elsewhere: vec![] };
        let help_for =
            |name: &str| not_there(&TableReference::from(name), &known).and_then(|f| f.help).unwrap_or_default();
        assert_eq!(help_for("small.score"), "did you mean `small.scores`?");
        assert_eq!(help_for("clean"), "did you mean `small.clean`?");
        assert_eq!(help_for("\"big-one\".scores"), "did you mean `\"Big-one\".scores`?");
        assert_eq!(help_for("small.clean"), "");
        assert!(help_for("quite.different").starts_with("known here: small.scores"));
    }
}
