//! SQL expressions over the columns of one row, parsed and evaluated by DataFusion.
//!
//! An expression is a function of one row only. It uses no clock, random numbers, other rows or other tables. Its unit
//! is inferred from the units of its columns where possible.
//!
//! ```
//! use expressions::{Expression, ExpressionUnit};
//! use schemas::{Column, TableShape};
//!
//! let columns = vec![Column::float("mag_2_uc", "nT", ""), Column::float("mag_3_uc", "nT", "")];
//! let shape = TableShape { columns: columns.into(), rate_hz: None };
//! let difference = Expression::new("mag_2_uc - mag_3_uc", &shape, "`mag_d`").unwrap();
//! assert_eq!(difference.unit, ExpressionUnit::Of("nT".to_owned()));
//! ```

mod bounded;
pub mod deep;
mod linear;
pub mod row;
mod sum;
mod unit;

use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, RecordBatchOptions, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use datafusion::{
    common::{
        DFSchema, ScalarValue, SchemaError,
        tree_node::{Transformed, TreeNode, TreeNodeRecursion},
    },
    error::DataFusionError,
    execution::SessionState,
    logical_expr::{BinaryExpr, Expr, Operator, cast, lit, simplify::SimplifyContext, when},
    optimizer::simplify_expressions::ExprSimplifier,
    physical_expr::PhysicalExpr,
    prelude::SessionContext,
    sql::sqlparser::parser::ParserError,
};
use schemas::{ColumnList, Fault, TableShape};

pub use linear::is_linear;
pub use unit::ExpressionUnit;

/// DataFusion with all its functions; it is shared, because building it takes a millisecond and a sweep may have one
/// expression per point.
pub(crate) static SQL: LazyLock<SessionState> = LazyLock::new(|| SessionContext::new().state());

/// The Arrow schema of a table's columns in expressions.
pub fn schema_of(shape: &TableShape) -> Schema {
    Schema::new(fields(shape.columns.iter()))
}

/// Columns, and their schema.
type KnownSchema = (ColumnList, Arc<DFSchema>);

/// The schema of a table's columns, which is reused for the next expression: the points of a sweep have expressions
/// over the same columns.
fn known_schema(shape: &TableShape) -> Result<Arc<DFSchema>, DataFusionError> {
    static LAST: Mutex<Option<KnownSchema>> = Mutex::new(None);
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, schema)) = last.as_ref().filter(|(columns, _)| *columns == shape.columns) {
        return Ok(schema.clone());
    }
    let schema = Arc::new(DFSchema::try_from(schema_of(shape))?);
    *last = Some((shape.columns.clone(), schema.clone()));
    Ok(schema)
}

fn fields<'a>(columns: impl Iterator<Item = &'a schemas::Column>) -> Vec<Field> {
    columns.map(|c| Field::new(&c.name, c.column_type.data_type(), true)).collect()
}

/// Parses `sql` as an expression over the columns of `shape`. Call it through [`deep::over`], because it recurses over
/// the nested text. `subject` is the name of the expression in faults.
///
/// # Errors
/// Fails for invalid SQL, unknown columns, excessive nesting, or anything but a function of one row.
pub fn parse(sql: &str, shape: &TableShape, subject: &str) -> Result<Expr, Fault> {
    let wrong = |e: DataFusionError| wrong(&e, shape, subject);
    let schema = known_schema(shape).map_err(wrong)?;
    let dialect = SQL.config().options().sql_parser.dialect;
    let parsed = SQL.sql_to_expr_with_alias(sql, &dialect).map_err(wrong)?;
    deep::check(&parsed.expr, deep::PREDICATE)?;
    let expr = SQL.create_logical_expr_from_sql_expr(parsed, &schema).map_err(wrong)?;
    row::check(&expr, subject)?;
    bounded::check(&expr, &schema, subject)?;
    Ok(expr)
}

/// Prepares the expression for evaluation on batches of `schema`.
///
/// # Errors
/// Fails for functions and operators that reject values of these types, or for excessive nesting.
pub fn physical(
    expr: Expr,
    schema: &Schema,
    shape: &TableShape,
    subject: &str,
) -> Result<Arc<dyn PhysicalExpr>, Fault> {
    let wrong = |e: DataFusionError| wrong(&e, shape, subject);
    let schema = DFSchema::try_from(schema.clone()).map_err(wrong)?;
    let expr = row::balanced(expr).map_err(wrong)?;
    row::shallow(&expr, subject)?;
    let expr = if calls_a_function(&expr).map_err(wrong)? { simplified(expr, &schema).map_err(wrong)? } else { expr };
    SQL.create_physical_expr(expr, &schema).map_err(wrong)
}

fn calls_a_function(expr: &Expr) -> Result<bool, DataFusionError> {
    expr.exists(|e| Ok(matches!(e, Expr::ScalarFunction(_))))
}

/// The expression, rewritten with functions that can be evaluated: `coalesce`, for example, becomes a `case`.
fn simplified(expr: Expr, schema: &DFSchema) -> Result<Expr, DataFusionError> {
    let context = SimplifyContext::builder().with_schema(Arc::new(schema.clone())).build();
    let simplifier = ExprSimplifier::new(context);
    simplifier.simplify(simplifier.coerce(expr, schema)?)
}

/// Rewords DataFusion's error on an unknown name.
fn wrong(e: &DataFusionError, shape: &TableShape, subject: &str) -> Fault {
    let have: Vec<&str> = shape.columns.iter().map(|c| c.name.as_str()).collect();
    match e.find_root() {
        DataFusionError::SchemaError(inner, _) => match inner.as_ref() {
            SchemaError::FieldNotFound { field, .. } => {
                let fault = Fault::new(format!("there is no column `{}`", field.name()));
                match have.iter().find(|name| **name != field.name() && name.to_lowercase() == field.name()) {
                    // SQL converts names without quotes to lower case.
                    Some(name) => fault.help(format!("put the name in double quotes: `\"{name}\"`")),
                    None => fault.nearest(field.name(), &have),
                }
            }
            other => Fault::new(format!("{subject} cannot be read: {other}")),
        },
        DataFusionError::SQL(inner, _) if matches!(inner.as_ref(), ParserError::RecursionLimitExceeded) => {
            deep::too_deep()
        }
        other => Fault::new(format!("{subject} cannot be read: {other}")),
    }
}

/// An expression that has been checked against its columns.
///
/// NaN in a flight line is a missing value and becomes SQL's NULL. Functions of a missing value, including `greatest`
/// and `least`, are missing. Comparisons with a missing value are unknown. `coalesce` and `is null` detect missing
/// values. Division is real division, even of whole numbers.
#[derive(Clone, Debug)]
pub struct Expression {
    physical: Arc<dyn PhysicalExpr>,
    schema: SchemaRef,
    subject: String,
    /// The columns that it reads, sorted.
    pub columns: Vec<String>,
    /// The type of its values.
    pub data_type: DataType,
    /// The unit of its values.
    pub unit: ExpressionUnit,
    /// Columns of the expression, each with 1 if it is added, -1 if it is subtracted, and 0 for any other use.
    pub terms: Vec<(i8, String)>,
}

impl Expression {
    /// Parses `sql` against the columns of `shape`. `subject` is the name of the expression in faults.
    ///
    /// # Errors
    /// Fails in the cases of [`parse`] and [`physical`]. Also fails if values of different units are added or compared.
    pub fn new(sql: &str, shape: &TableShape, subject: &str) -> Result<Expression, Fault> {
        deep::over(sql, || Self::read(sql, shape, subject))?
    }

    fn read(sql: &str, shape: &TableShape, subject: &str) -> Result<Expression, Fault> {
        let expr = parse(sql, shape, subject)?;
        // The nesting depth is checked first, because the checks below recurse without a limit.
        row::shallow(&expr, subject)?;
        let (unit, terms) = (unit::infer_unit(&expr, shape)?, sum::signed_terms(&expr));
        if extremes_deep(&expr) > MOST_EXTREMES {
            return Err(Fault::new(format!("more than {MOST_EXTREMES} calls of `greatest` and `least` are nested")));
        }
        let expr = real_division(expr).and_then(missing_extremes).map_err(|e| wrong(&e, shape, subject))?;
        let mut columns: Vec<String> = expr.column_refs().into_iter().map(|c| c.name.clone()).collect();
        columns.sort();
        columns.dedup();
        let schema = Arc::new(Schema::new(fields(columns.iter().filter_map(|name| shape.get(name)))));
        let physical = physical(expr, &schema, shape, subject)?;
        let data_type = physical.data_type(&schema).map_err(|e| wrong(&e, shape, subject))?;
        Ok(Expression { physical, schema, subject: subject.to_owned(), columns, data_type, unit, terms })
    }

    /// Values, one for each row of `batch`, which must contain [`Expression::columns`].
    ///
    /// # Errors
    /// Fails for a column that is missing or of another type, or for values on which it cannot be evaluated.
    pub fn evaluate(&self, batch: &RecordBatch) -> Result<ArrayRef, Fault> {
        let rows = batch.num_rows();
        let column = |field: &Arc<Field>| {
            let array = batch.column_by_name(field.name());
            let array = array.ok_or_else(|| Fault::data("is missing").in_column(field.name()))?;
            Ok(known(array))
        };
        let arrays = self.schema.fields().iter().map(column).collect::<Result<Vec<_>, Fault>>()?;
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        let batch = RecordBatch::try_new_with_options(self.schema.clone(), arrays, &options);
        let batch = batch.map_err(|e| Fault::data(e.to_string()))?;
        evaluate(&self.physical, &batch)
            .map_err(|e| Fault::data(format!("{} cannot be evaluated: {}", self.subject, e.find_root())))
    }

    /// Values as numbers; NaN for missing and infinite values.
    ///
    /// # Errors
    /// Fails in the cases of [`Expression::evaluate`]. Also fails for values that are not numbers.
    pub fn numbers(&self, batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
        let array = arrow_cast::cast(&self.evaluate(batch)?, &DataType::Float64);
        let array = array.map_err(|e| Fault::data(format!("{} does not give numbers: {e}", self.subject)))?;
        let numbers = array.as_primitive::<Float64Type>().iter();
        Ok(numbers.map(|x| x.filter(|x| x.is_finite()).unwrap_or(f64::NAN)).collect())
    }

    /// Rows for which the expression is true. An unknown value counts as false.
    ///
    /// # Errors
    /// Fails in the cases of [`Expression::evaluate`]. Also fails for values that are not Boolean.
    pub fn mask(&self, batch: &RecordBatch) -> Result<Vec<bool>, Fault> {
        let array = self.evaluate(batch)?;
        let gives = || Fault::data(format!("{} gives {}, not true or false", self.subject, array.data_type()));
        Ok(array.as_boolean_opt().ok_or_else(gives)?.iter().map(|x| x.unwrap_or(false)).collect())
    }
}

/// The values of an expression, one for each row of `batch`. Expressions with strings are evaluated a few rows at a
/// time, because intermediate values may be large.
///
/// # Errors
/// Fails for values on which it cannot be evaluated.
pub fn evaluate(expr: &Arc<dyn PhysicalExpr>, batch: &RecordBatch) -> Result<ArrayRef, DataFusionError> {
    let rows = batch.num_rows();
    let texts = batch.schema_ref().fields().iter().any(|f| !f.data_type().is_numeric());
    if rows <= bounded::ROWS || !(texts || has_text(expr, batch.schema_ref())) {
        return expr.evaluate(batch)?.into_array(rows);
    }
    let part = |from| {
        let part = batch.slice(from, bounded::ROWS.min(rows - from));
        expr.evaluate(&part)?.into_array(part.num_rows())
    };
    let parts = (0..rows).step_by(bounded::ROWS).map(part).collect::<Result<Vec<_>, DataFusionError>>()?;
    let parts: Vec<&dyn Array> = parts.iter().map(|array| array.as_ref()).collect();
    Ok(arrow_select::concat::concat(&parts)?)
}

/// Whether any intermediate value is text.
fn has_text(expr: &Arc<dyn PhysicalExpr>, schema: &Schema) -> bool {
    let is_text = |kind: DataType| matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View);
    expr.data_type(schema).is_ok_and(is_text) || expr.children().into_iter().any(|child| has_text(child, schema))
}

/// The column with nulls instead of NaN.
fn known(array: &ArrayRef) -> ArrayRef {
    match array.as_primitive_opt::<Float64Type>() {
        Some(numbers) if numbers.values().iter().any(|x| x.is_nan()) => {
            Arc::new(numbers.iter().map(|x| x.filter(|x| !x.is_nan())).collect::<Float64Array>())
        }
        _ => array.clone(),
    }
}

/// The expression with real division: every dividend is converted to Float64. In SQL, the quotient of whole numbers is
/// a whole number, so `1/3` would be 0.
fn real_division(expr: Expr) -> Result<Expr, DataFusionError> {
    let one = |e: Expr| match e {
        Expr::BinaryExpr(BinaryExpr { left, op: Operator::Divide, right }) => {
            let left = Box::new(cast(*left, DataType::Float64));
            Ok(Transformed::yes(Expr::BinaryExpr(BinaryExpr { left, op: Operator::Divide, right })))
        }
        other => Ok(Transformed::no(other)),
    };
    expr.transform_up(one).map(|t| t.data)
}

/// Maximum nesting depth of `greatest` and `least`. The depth is limited because each level doubles the size of the
/// expression.
const MOST_EXTREMES: usize = 8;

fn is_extreme(expr: &Expr) -> bool {
    matches!(expr, Expr::ScalarFunction(f) if matches!(f.name(), "greatest" | "least"))
}

/// Nesting depth of `greatest` and `least`. The recursion is safe because the depth of the expression is limited.
fn extremes_deep(expr: &Expr) -> usize {
    let mut inside = 0;
    // The visit cannot fail.
    let _ = expr.apply_children(|child| {
        inside = inside.max(extremes_deep(child));
        Ok(TreeNodeRecursion::Continue)
    });
    inside + usize::from(is_extreme(expr))
}

/// The expression, rewritten so that `greatest` and `least` are missing if an argument is missing. In SQL they ignore
/// missing arguments, so a missing value clipped to 1 would be 1.
fn missing_extremes(expr: Expr) -> Result<Expr, DataFusionError> {
    let one = |e: Expr| {
        let Expr::ScalarFunction(function) = &e else { return Ok(Transformed::no(e)) };
        let missing = function.args.iter().cloned().map(Expr::is_null).reduce(Expr::or);
        match missing.filter(|_| is_extreme(&e)) {
            Some(missing) => Ok(Transformed::yes(when(missing, lit(ScalarValue::Null)).otherwise(e)?)),
            None => Ok(Transformed::no(e)),
        }
    };
    expr.transform_up(one).map(|t| t.data)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{Int64Array, StringArray};
    use schemas::Column;

    use super::*;

    fn shape() -> TableShape {
        let columns = vec![
            Column::text("line", ""),
            Column::float("a", "nT", ""),
            Column::float("b", "nT", ""),
            Column::float("tt", "s", ""),
            Column::float("plain", "", ""),
            Column::integer("doy", "", ""),
        ];
        TableShape { columns: columns.into(), rate_hz: None }
    }

    fn batch() -> RecordBatch {
        let floats = |values: [f64; 3]| Arc::new(Float64Array::from(values.to_vec())) as ArrayRef;
        RecordBatch::try_from_iter([
            ("line", Arc::new(StringArray::from(vec!["1.01"; 3])) as ArrayRef),
            ("a", floats([1.0, -2.0, f64::NAN])),
            ("b", floats([0.5, 4.0, 8.0])),
            ("tt", floats([0.0, 1.0, 2.0])),
            ("plain", floats([1.0, 2.0, 3.0])),
            ("doy", Arc::new(Int64Array::from(vec![7, 8, 9])) as ArrayRef),
        ])
        .unwrap()
    }

    fn numbers(sql: &str) -> Vec<f64> {
        Expression::new(sql, &shape(), "`x`").unwrap().numbers(&batch()).unwrap()
    }

    #[test]
    fn unit_arithmetic_is_exact_and_nan_is_missing() {
        let same = |sql: &str, expected: [f64; 3]| {
            let found = numbers(sql);
            let fits = found.iter().zip(expected).all(|(x, y)| *x == y || x.is_nan() && y.is_nan());
            assert!(fits, "{sql}: {found:?}");
        };
        let nan = f64::NAN;
        same("a - b", [0.5, -6.0, nan]);
        same("1/2 * b", [0.25, 2.0, 4.0]);
        same("doy / 2", [3.5, 4.0, 4.5]);
        same("doy % 4", [3.0, 0.0, 1.0]);
        same("coalesce(a, b)", [1.0, -2.0, 8.0]);
        same("case when a > 0 then 1 when a <= 0 then 2 else 3 end", [1.0, 2.0, 3.0]);
        same("greatest(least(b, 5), 1)", [1.0, 4.0, 5.0]);
        same("greatest(-1, least(1, a))", [1.0, -1.0, nan]);
        same("greatest(coalesce(a, b), 2)", [2.0, 2.0, 8.0]);
        same("1 / (tt - 1)", [-1.0, nan, 1.0]);
        let root = Expression::new("sqrt(a)", &shape(), "`x`").unwrap();
        assert!(root.numbers(&batch()).unwrap_err().what.contains("square root of a negative number"));
        same("3", [3.0; 3]);
        let mask = |sql: &str| Expression::new(sql, &shape(), "`x`").unwrap().mask(&batch()).unwrap();
        // In Arrow's order NaN is greater than all numbers.
        assert_eq!(mask("a > 0"), [true, false, false]);
        assert_eq!(mask("a is null or b > 1"), [false, true, true]);
        assert_eq!(mask("line like '1.%' and tt between 1 and 2"), [false, true, true]);
    }

    #[test]
    fn unit_units_are_inferred_from_columns() {
        let unit = |sql: &str| Expression::new(sql, &shape(), "`x`").unwrap().unit;
        let nt = || ExpressionUnit::Of("nT".to_owned());
        for sql in [
            "a - b",
            "-(a + 3)",
            "abs(a - b)",
            "case when tt > 3 then a else b end",
            "coalesce(a, b, 0)",
            "least(a, 5)",
        ] {
            assert_eq!(unit(sql), nt(), "{sql}");
        }
        assert_eq!(unit("0.5 * (a + b)"), ExpressionUnit::Scaled("nT".to_owned()));
        assert_eq!(unit("a / b"), ExpressionUnit::Of("1".to_owned()));
        assert_eq!(unit("a / b * a"), nt());
        assert_eq!((unit("3 * 4"), unit("plain")), (ExpressionUnit::Any, ExpressionUnit::Of(String::new())));
        for sql in ["a * b", "sqrt(a)", "a / tt", "a + plain", "1 / a", "sin(a)"] {
            assert_eq!(unit(sql), ExpressionUnit::Unknown, "{sql}");
        }
        for sql in
            ["a + tt", "case when a > tt then 1 else 0 end", "case when tt > 0 then a else tt end", "abs(a) - tt"]
        {
            let fault = Expression::new(sql, &shape(), "`x`").unwrap_err();
            assert!(fault.what.contains("nT") && fault.what.contains("in s"), "{sql}: {fault}");
        }
    }

    #[test]
    fn unit_functions_of_more_than_one_row_are_rejected_by_name() {
        let fault_text = |sql: &str| Expression::new(sql, &shape(), "`x`").unwrap_err().to_string();
        assert!(fault_text("a * random()").contains("`random()` gives a different value each time"));
        assert!(fault_text("a - avg(a)").contains("`x` is evaluated row by row"));
        assert!(fault_text("a - (select 1)").contains("`x` cannot contain a query"));
        assert!(fault_text("aa + 1").contains("there is no column `aa`"));
        assert!(fault_text("a +").contains("`x` cannot be read"));
        assert!(fault_text(&format!("a {}", "+ 1 ".repeat(9_000))).contains("nested"));
        assert!(
            fault_text(&format!("{}a{}", "least(".repeat(30), ", 1)".repeat(30))).contains("of `greatest` and `least`")
        );
        assert_eq!(Expression::new("line", &shape(), "`x`").unwrap().data_type, DataType::Utf8);
        assert!(Expression::new("a", &shape(), "`x`").unwrap().mask(&batch()).is_err());
    }
}
