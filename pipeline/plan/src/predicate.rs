//! `where`: a SQL predicate over the columns of a table of flight lines, evaluated by DataFusion.
//!
//! Conditions on flight and line alone are evaluated in the plan, so that excluded lines are never read. The other
//! conditions are evaluated on the rows of each line, and read only the columns that they name. The predicate is a
//! function of one row: it cannot use the clock, random numbers, other rows or other tables.

use std::sync::Arc;

use arrow_array::{Array, BooleanArray, RecordBatch, StringArray, cast::AsArray};
use arrow_schema::{DataType, Field, Schema};
use datafusion::{
    logical_expr::{
        Expr,
        utils::{conjunction, split_conjunction_owned},
    },
    physical_expr::PhysicalExpr,
};
use expressions::{deep, parse, physical, schema_of};
use schemas::{Fault, TableShape};

/// Name of a predicate in messages.
const SUBJECT: &str = "`where`";

/// A `where` expression, checked against the columns of its input.
#[derive(Clone, Debug)]
pub struct Predicate {
    lines: Option<Arc<dyn PhysicalExpr>>,
    rows: Option<Arc<dyn PhysicalExpr>>,
    /// Columns that the row conditions read.
    pub columns: Vec<String>,
    /// Row conditions in canonical spelling, for keys.
    pub canonical: String,
}

impl Predicate {
    /// Reads `sql` against the columns of `shape`.
    ///
    /// # Errors
    /// Fails if `sql` is not valid SQL or not a predicate, refers to a missing column, is nested too deep, or depends
    /// on more than one row.
    pub fn new(sql: &str, shape: &TableShape) -> Result<Predicate, Fault> {
        deep::over(sql, || Self::read(sql, shape))?
    }

    fn read(sql: &str, shape: &TableShape) -> Result<Predicate, Fault> {
        let schema = schema_of(shape);
        let expr = parse(sql, shape, SUBJECT).map_err(|fault| match fault.help {
            Some(_) => fault,
            None => fault.help("write an SQL predicate, such as `line = '1003.02'`"),
        })?;
        let physical = |e: Expr, schema: &Schema| physical(e, schema, shape, SUBJECT);
        let whole = physical(expr.clone(), &schema)?;
        let kind = whole.data_type(&schema).map_err(|e| Fault::new(format!("{SUBJECT} is invalid: {e}")))?;
        if kind != DataType::Boolean {
            return Err(Fault::new(format!(
                "`where` must be true or false for each row, but this expression gives {kind}"
            )));
        }
        let is_key = |e: &Expr| e.column_refs().iter().all(|c| c.name == "flight" || c.name == "line");
        let (of_lines, of_rows): (Vec<Expr>, Vec<Expr>) = split_conjunction_owned(expr).into_iter().partition(is_key);
        let lines = conjunction(of_lines).map(|e| physical(e, &key_schema())).transpose()?;
        let rows = conjunction(of_rows);
        let mut columns: Vec<String> = rows.iter().flat_map(|e| e.column_refs()).map(|c| c.name.clone()).collect();
        columns.sort();
        columns.dedup();
        let canonical = rows.as_ref().map(|e| e.to_string()).unwrap_or_default();
        let read: Vec<Field> = columns.iter().filter_map(|c| schema.field_with_name(c).ok().cloned()).collect();
        let rows = rows.map(|e| physical(e, &Schema::new(read))).transpose()?;
        Ok(Predicate { lines, rows, columns, canonical })
    }

    /// Whether the predicate only selects whole lines.
    pub fn is_of_lines(&self) -> bool {
        self.rows.is_none()
    }

    /// For each (flight, line), whether any of its rows may be selected.
    ///
    /// # Errors
    /// Fails if the predicate cannot be evaluated.
    pub fn lines(&self, lines: &[(String, String)]) -> Result<Vec<bool>, Fault> {
        let Some(expr) = &self.lines else { return Ok(vec![true; lines.len()]) };
        let flights: StringArray = lines.iter().map(|l| Some(l.0.as_str())).collect();
        let names: StringArray = lines.iter().map(|l| Some(l.1.as_str())).collect();
        let batch = RecordBatch::try_new(Arc::new(key_schema()), vec![Arc::new(flights), Arc::new(names)]);
        evaluate(expr, &batch.map_err(|e| Fault::new(e.to_string()))?)
    }

    /// For each row of a line, whether it is selected. `batch` holds [`Predicate::columns`], in that order.
    ///
    /// # Errors
    /// Fails if the predicate cannot be evaluated on these values.
    pub fn rows(&self, batch: &RecordBatch) -> Result<Option<Vec<bool>>, Fault> {
        self.rows.as_ref().map(|expr| evaluate(expr, batch)).transpose()
    }
}

fn key_schema() -> Schema {
    Schema::new(vec![Field::new("flight", DataType::Utf8, true), Field::new("line", DataType::Utf8, true)])
}

fn evaluate(expr: &Arc<dyn PhysicalExpr>, batch: &RecordBatch) -> Result<Vec<bool>, Fault> {
    let wrong = |e: datafusion::error::DataFusionError| Fault::data(format!("`where` cannot be evaluated: {e}"));
    let array = expressions::evaluate(expr, batch).map_err(wrong)?;
    let mask: &BooleanArray = array
        .as_boolean_opt()
        .ok_or_else(|| Fault::data(format!("`where` returned {}, not true or false", array.data_type())))?;
    // As in SQL, a row for which the predicate is unknown is not selected.
    Ok(mask.iter().map(|x| x.unwrap_or(false)).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]

    use arrow_array::Float64Array;
    use schemas::Column;

    use super::*;

    fn shape() -> TableShape {
        let columns = vec![Column::text("flight", ""), Column::text("line", ""), Column::float("tt", "s", "")];
        TableShape { columns: columns.into(), rate_hz: None }
    }

    #[test]
    fn unit_line_conditions_are_evaluated_without_rows() {
        let p = Predicate::new("line like '1003%' and flight <> '9' and tt between 1 and 2", &shape()).unwrap();
        let lines = [("1", "1003.01"), ("9", "1003.01"), ("1", "1004")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        assert_eq!(p.lines(&lines).unwrap(), [true, false, false]);
        assert_eq!(p.columns, ["tt"]);
        let tt = Schema::new(vec![Field::new("tt", DataType::Float64, true)]);
        let batch =
            RecordBatch::try_new(Arc::new(tt), vec![Arc::new(Float64Array::from(vec![0.5, 1.5, f64::NAN]))]).unwrap();
        assert_eq!(p.rows(&batch).unwrap(), Some(vec![false, true, false]));
        let with_function = Predicate::new("coalesce(tt, 0) > 1", &shape()).unwrap();
        assert_eq!(with_function.rows(&batch.slice(0, 2)).unwrap(), Some(vec![false, true]));
    }

    #[test]
    fn unit_spelling_does_not_change_the_key() {
        let a = Predicate::new("tt>1.0   AND line = 'x'", &shape()).unwrap();
        let b = Predicate::new("(line = 'x') and (tt > 1.0)", &shape()).unwrap();
        assert_eq!(a.canonical, b.canonical);
    }

    #[test]
    fn unit_only_functions_of_one_row_are_accepted() {
        let refused = |sql: &str| Predicate::new(sql, &shape()).unwrap_err();
        for (sql, statement) in [
            ("tt > random()", "`random()` gives a different value each time"),
            ("uuid() <> line", "`uuid()` gives a different value each time"),
            ("line = '1' and not (tt + 1 > 3 * random())", "`random()`"),
            ("avg(tt) > 3", "`avg`"),
            ("row_number() over (order by tt) < 10", "`row_number`"),
            ("tt > (select 1)", "`where` cannot contain a query"),
            ("tt in (select 1)", "`where` cannot contain a query"),
            ("exists (select 1)", "`where` cannot contain a query"),
        ] {
            let fault = refused(sql);
            assert!(fault.to_string().contains(statement), "{sql}: {fault}");
        }
        let fine = ["abs(tt) > 3", "upper(line) = 'A'", "coalesce(tt, 0) >= 0", "tt is not null", "line ~ '^1'"];
        fine.iter().for_each(|sql| assert!(Predicate::new(sql, &shape()).is_ok(), "{sql}"));
    }

    #[test]
    fn unit_a_chain_of_thousands_of_terms_is_evaluated() {
        let lines = [("1", "7"), ("1", "9999"), ("1", "nine")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        let ors: Vec<String> = (0..3000).map(|i| format!("line = '{i}'")).collect();
        let selected = Predicate::new(&ors.join(" or "), &shape()).unwrap().lines(&lines).unwrap();
        assert_eq!(selected, [true, false, false]);
        let of_rows: Vec<String> = (0..3000).map(|i| format!("tt between {i} and {i}.5")).collect();
        let p = Predicate::new(&of_rows.join(" or "), &shape()).unwrap();
        let tt = Schema::new(vec![Field::new("tt", DataType::Float64, true)]);
        let values = Float64Array::from(vec![2999.25, 2999.75, -1.0, 0.0]);
        let batch = RecordBatch::try_new(Arc::new(tt), vec![Arc::new(values)]).unwrap();
        assert_eq!(p.rows(&batch).unwrap(), Some(vec![true, false, false, true]));
        assert_eq!(p.canonical.matches(" OR ").count(), 2999);
    }

    #[test]
    fn unit_deeply_nested_expressions_are_rejected() {
        for sql in [
            format!("tt > {}1", "1 + ".repeat(20_000)),
            format!("tt > {}1", "1 + ".repeat(200_000)),
            format!("tt > {}1", "1 + ".repeat(2_000)),
            format!("{}tt > 1{}", "(".repeat(300), ")".repeat(300)),
            "line = '1' or ".repeat(100_000) + "line = '2'",
        ] {
            let fault = Predicate::new(&sql, &shape()).unwrap_err();
            assert!(fault.what.contains("nested") || fault.what.contains("bytes long"), "{fault}");
            assert!(fault.what.len() < 200 && fault.help.is_some(), "{fault}");
        }
        assert!(Predicate::new(&format!("{} tt > 1", "not ".repeat(3_000)), &shape()).is_err());
    }

    #[test]
    fn gold_a_missing_column_is_named() {
        let fault = Predicate::new("lin = '1'", &shape()).unwrap_err();
        assert_eq!(fault.to_string(), "there is no column `lin` (did you mean `line`?)");
        assert!(Predicate::new("tt + 1", &shape()).unwrap_err().what.contains("true or false"));
        assert!(Predicate::new("tt >", &shape()).is_err());
    }
}
