//! Parameters of a query: `$1`, `$name` or `?`, open until a client gives their values.

use std::collections::BTreeMap;

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use datafusion::{
    common::{ParamValues, ScalarValue},
    logical_expr::LogicalPlan,
    sql::sqlparser::{
        dialect::GenericDialect,
        tokenizer::{Token, Tokenizer},
    },
};
use schemas::Fault;

/// Returns `query` with `$1`, `$2`, ... for each parameter `?`, in the order of the text.
///
/// # Errors
/// Fails if the query contains both `?` and numbered or named parameters.
pub fn numbered(query: &str) -> Result<String, Fault> {
    if !query.contains('?') {
        return Ok(query.to_owned());
    }
    // Text that is not SQL stays unchanged: planning reports its fault.
    let Ok(tokens) = Tokenizer::new(&GenericDialect {}, query).tokenize_with_location() else {
        return Ok(query.to_owned());
    };
    let mut marks = BTreeMap::new();
    for one in &tokens {
        match &one.token {
            Token::Placeholder(p) if p == "?" => {
                marks.insert((one.span.start.line, one.span.start.column), marks.len() + 1);
            }
            Token::Placeholder(_) if tokens.iter().any(|t| t.token == Token::Placeholder("?".to_owned())) => {
                return Err(Fault::new("the query mixes parameters `?` and numbered parameters")
                    .help("use only one of the two forms"));
            }
            _ => {}
        }
    }
    let (mut line, mut column, mut text) = (1, 1, String::with_capacity(query.len() + 2 * marks.len()));
    for c in query.chars() {
        match marks.get(&(line, column)) {
            Some(number) => text.push_str(&format!("${number}")),
            None => text.push(c),
        }
        (line, column) = if c == '\n' { (line + 1, 1) } else { (line, column + 1) };
    }
    Ok(text)
}

fn number(name: &str) -> Option<usize> {
    name.strip_prefix('$')?.parse().ok()
}

/// Parameters of a plan that have no value yet, in their order; a parameter of unknown type has the type `Null`.
pub fn open(plan: &LogicalPlan) -> Schema {
    let types = plan.get_parameter_types().unwrap_or_default();
    let mut found: Vec<(String, Option<DataType>)> = types.into_iter().collect();
    found.sort_by_key(|(name, _)| (number(name).unwrap_or(usize::MAX), name.clone()));
    let field = |(name, kind): (String, Option<DataType>)| Field::new(name, kind.unwrap_or(DataType::Null), true);
    Schema::new(found.into_iter().map(field).collect::<Vec<_>>())
}

fn listed(names: &[&str]) -> String {
    names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
}

/// Checks that all parameters of a plan have values.
///
/// # Errors
/// Fails with the names of the parameters.
pub fn bound(plan: &LogicalPlan) -> Result<(), Fault> {
    valued(&open(plan))
}

/// Checks that there are no open parameters.
///
/// # Errors
/// Fails with their names.
pub fn valued(open: &Schema) -> Result<(), Fault> {
    let names: Vec<&str> = open.fields().iter().map(|f| f.name().as_str()).collect();
    if names.is_empty() {
        return Ok(());
    }
    let fault = Fault::new(format!("the query has parameters without a value: {}", listed(&names)));
    Err(fault.help("prepare the query, and bind one row of values"))
}

/// Values for the open parameters of `plan`, from the only row of `values`. Numbered parameters are matched by
/// position, other parameters by name.
///
/// # Errors
/// Fails if the columns of `values` do not match the open parameters.
pub fn values(plan: &LogicalPlan, values: &RecordBatch) -> Result<ParamValues, Fault> {
    let open = open(plan);
    let names: Vec<&str> = open.fields().iter().map(|f| f.name().as_str()).collect();
    let wrong = |what: String| Fault::new(what).help("bind one row with one column for each parameter");
    if values.num_rows() != 1 {
        return Err(wrong(format!("{} rows of parameters were bound; a query requires one", values.num_rows())));
    }
    let value = |column: &ArrayRef| ScalarValue::try_from_array(column, 0);
    let scalars = values.columns().iter().map(value).collect::<Result<Vec<ScalarValue>, _>>();
    let scalars = scalars.map_err(|e| wrong(format!("the parameters are invalid: {e}")))?;
    let numbers: Vec<usize> = names.iter().filter_map(|n| number(n)).collect();
    if numbers.len() == names.len() {
        let most = numbers.iter().copied().max().unwrap_or(0);
        if most != scalars.len() {
            let what = format!("the query has {most} parameters, but {} values were bound", scalars.len());
            return Err(wrong(what));
        }
        return Ok(scalars.into());
    }
    let given: Vec<String> =
        values.schema().fields().iter().map(|f| f.name().trim_start_matches('$').to_owned()).collect();
    let lacks = |name: &&&str| !given.iter().any(|g| g == name.trim_start_matches('$'));
    let missing: Vec<&str> = names.iter().filter(lacks).copied().collect();
    if !missing.is_empty() || given.len() != names.len() {
        return Err(wrong(format!("the query requires the parameters {}", listed(&names))));
    }
    Ok(given.into_iter().zip(scalars).collect::<Vec<(String, ScalarValue)>>().into())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_question_marks_are_numbered_in_the_order_of_the_text() {
        let marks = "SELECT '?', \"a?\", '\u{e9}' || ? -- ?\nFROM t /* ? */ WHERE b = ?\n  AND c > ? LIMIT ?";
        let numbers = "SELECT '?', \"a?\", '\u{e9}' || $1 -- ?\nFROM t /* ? */ WHERE b = $2\n  AND c > $3 LIMIT $4";
        assert_eq!(numbered(marks).unwrap(), numbers);
        assert_eq!(numbered("SELECT 'it''s ?', ?").unwrap(), "SELECT 'it''s ?', $1");
        assert_eq!(numbered("SELECT $1").unwrap(), "SELECT $1");
        assert!(numbered("SELECT $1, ?").is_err() && numbered("SELECT ?, $2").is_err());
        assert_eq!(numbered("SELECT 'open ?").unwrap(), "SELECT 'open ?");
    }
}
