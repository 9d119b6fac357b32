//! `sql`: an expression over the columns of one row of a file, evaluated by DataFusion.
//!
//! Numbers of every type are Float64 to it, so that `"x" / 100` of a whole number keeps its fraction. As in `where`, it is a
//! function of one row and of nothing else.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::{DataType, Field, Schema};
use datafusion::{
    common::{
        DFSchema, SchemaError,
        tree_node::{TreeNode, TreeNodeRecursion},
    },
    error::DataFusionError,
    logical_expr::{BinaryExpr, Expr, ExprSchemable, Operator},
    physical_expr::PhysicalExpr,
};
use schemas::Fault;

use super::{SQL, expression};
use crate::deep;

/// An expression that was checked against the columns of a file.
#[derive(Clone, Debug)]
pub struct RowValue {
    expr: Arc<dyn PhysicalExpr>,
    /// The columns it reads: their positions in the file's batches, and their fields as it sees them.
    reads: Vec<usize>,
    schema: Arc<Schema>,
    /// The type of its values.
    pub data_type: DataType,
}

impl RowValue {
    /// Reads `sql` against the columns of a file.
    ///
    /// # Errors
    /// Fails when it is not an expression of SQL, names a column that does not exist, is nested too deep, is more than a
    /// function of one row, or divides whole numbers by whole numbers, which drops the fraction.
    pub fn new(sql: &str, source: &Schema) -> Result<RowValue, Fault> {
        deep::over(sql, || Self::read(sql, source))?.map_err(reworded)
    }

    fn read(sql: &str, source: &Schema) -> Result<RowValue, Fault> {
        let seen: Vec<(usize, Field)> =
            source.fields().iter().enumerate().filter_map(|(i, f)| Some((i, seen(f)?))).collect();
        let all = Schema::new(seen.iter().map(|(_, f)| f.clone()).collect::<Vec<_>>());
        let names: Vec<&str> = source.fields().iter().map(|f| f.name().as_str()).collect();
        let failed = |e: DataFusionError| wrong(&e, &names);
        let df = DFSchema::try_from(all).map_err(failed)?;
        let dialect = SQL.config().options().sql_parser.dialect;
        let parsed = SQL.sql_to_expr_with_alias(sql, &dialect).map_err(failed)?;
        deep::check(&parsed.expr, deep::PREDICATE)?;
        let expr = SQL.create_logical_expr_from_sql_expr(parsed, &df).map_err(failed)?;
        expression::check(&expr)?;
        whole_division(&expr, &df)?;
        expression::shallow(&expr)?;
        let refs: Vec<String> = expr.column_refs().iter().map(|c| c.name.clone()).collect();
        let (reads, fields): (Vec<usize>, Vec<Field>) =
            seen.into_iter().filter(|(_, f)| refs.contains(f.name())).unzip();
        let schema = Arc::new(Schema::new(fields));
        let df = DFSchema::try_from(schema.as_ref().clone()).map_err(failed)?;
        let expr = SQL.create_physical_expr(expr, &df).map_err(failed)?;
        let data_type = expr.data_type(&schema).map_err(failed)?;
        Ok(RowValue { expr, reads, schema, data_type })
    }

    /// The value for each row of a batch of the file.
    ///
    /// # Errors
    /// Fails when it cannot be evaluated on these values.
    pub fn evaluate(&self, batch: &RecordBatch) -> Result<ArrayRef, Fault> {
        let mut columns = vec![];
        for (at, field) in self.reads.iter().zip(self.schema.fields()) {
            let lost = || Fault::bug(format!("a batch lacks its column {at}"));
            let column = batch.columns().get(*at).ok_or_else(lost)?;
            let cast = cast(column, field.data_type());
            let cast = cast.map_err(|e| Fault::data(e.to_string()).in_column(field.name()))?;
            columns.push(without_nan(cast));
        }
        let options = arrow_array::RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        let rows = RecordBatch::try_new_with_options(self.schema.clone(), columns, &options);
        let rows = rows.map_err(|e| Fault::data(e.to_string()))?;
        let value = self.expr.evaluate(&rows).and_then(|v| v.into_array(batch.num_rows()));
        value.map_err(|e| Fault::data(format!("`sql` cannot be evaluated: {}", e.strip_backtrace())))
    }
}

/// A column as expressions see it; `None` for one of lists and the like.
fn seen(field: &Field) -> Option<Field> {
    let kind = match field.data_type() {
        DataType::Dictionary(_, value) => value.as_ref(),
        other => other,
    };
    let kind = if kind.is_numeric() {
        DataType::Float64
    } else if matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View | DataType::Null) {
        DataType::Utf8
    } else if kind == &DataType::Boolean || matches!(kind, DataType::Timestamp(..) | DataType::Date32) {
        kind.clone()
    } else {
        return None;
    };
    Some(Field::new(field.name(), kind, true))
}

/// NaN is a missing value, and NULL in SQL, where it would be above all numbers otherwise.
fn without_nan(array: ArrayRef) -> ArrayRef {
    match array.as_primitive_opt::<Float64Type>() {
        Some(numbers) if numbers.values().iter().any(|x| x.is_nan()) => {
            Arc::new(numbers.iter().map(|x| x.filter(|x| !x.is_nan())).collect::<Float64Array>())
        }
        _ => array,
    }
}

/// Rejects the division of whole numbers.
fn whole_division(expr: &Expr, df: &DFSchema) -> Result<(), Fault> {
    let mut found = false;
    let whole = |e: &Expr| e.get_type(df).is_ok_and(|t| t.is_integer());
    let visited = expr.apply(|e| {
        if let Expr::BinaryExpr(BinaryExpr { left, op: Operator::Divide, right }) = e
            && whole(left)
            && whole(right)
        {
            found = true;
        }
        Ok(if found { TreeNodeRecursion::Stop } else { TreeNodeRecursion::Continue })
    });
    visited.map_err(|e| Fault::new(format!("`sql` cannot be read: {e}")))?;
    if !found {
        return Ok(());
    }
    let fault = Fault::new("a whole number is divided by a whole number, which drops the fraction");
    Err(fault.help("write one of them with a decimal point, or `floor(...)` around the quotient of such numbers"))
}

/// The faults of [`expression`] in the words of an expression.
fn reworded(fault: Fault) -> Fault {
    let words = |text: String| text.replace("`where`", "`sql`").replace("the same spec selects", "the same file gives");
    Fault { what: words(fault.what), help: fault.help.map(words), ..fault }
}

/// Rewords DataFusion's error on an unknown name.
fn wrong(e: &DataFusionError, names: &[&str]) -> Fault {
    let DataFusionError::SchemaError(inner, _) = e.find_root() else {
        let what = format!("`sql` cannot be read: {}", e.find_root().strip_backtrace());
        return Fault::new(what).help("it is an expression of SQL, such as `\"raw\" * 0.05`");
    };
    match inner.as_ref() {
        SchemaError::FieldNotFound { field, .. } => {
            let fault = Fault::new(format!("there is no column `{}`", field.name()));
            let same = names.iter().find(|n| n.to_lowercase() == field.name() && **n != field.name());
            match same {
                // SQL folds names without quotes to small letters.
                Some(name) => fault.help(format!("put the name in double quotes: `\"{name}\"`")),
                None => fault.nearest(field.name(), names),
            }
        }
        other => Fault::new(format!("`sql` cannot be read: {other}")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use arrow_array::{Int32Array, StringArray};

    use super::*;

    fn batch() -> RecordBatch {
        let fields = vec![
            Field::new("Raw", DataType::Int32, true),
            Field::new("x", DataType::Float64, true),
            Field::new("mode", DataType::Utf8, true),
        ];
        let columns: Vec<ArrayRef> = vec![
            Arc::new(Int32Array::from(vec![Some(3), Some(50), None])),
            Arc::new(Float64Array::from(vec![1.0, 2.0, 4.0])),
            Arc::new(StringArray::from(vec!["a", "b", "c"])),
        ];
        RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).unwrap()
    }

    fn of(sql: &str) -> Result<Vec<Option<f64>>, Fault> {
        let batch = batch();
        let value = RowValue::new(sql, &batch.schema())?.evaluate(&batch)?;
        Ok(cast(&value, &DataType::Float64).unwrap().as_primitive::<Float64Type>().iter().collect())
    }

    #[test]
    fn law_whole_numbers_keep_their_fraction() {
        assert_eq!(of("\"Raw\" / 100").unwrap(), [Some(0.03), Some(0.5), None]);
        assert_eq!(of("\"Raw\" * 0.05 + x").unwrap(), [Some(1.15), Some(4.5), None]);
        assert_eq!(of("case when mode = 'b' then 1.0 else 0.0 end").unwrap(), [Some(0.0), Some(1.0), Some(0.0)]);
        assert_eq!(of("5").unwrap(), [Some(5.0); 3]);
        let fault = of("x * (1 / 2)").unwrap_err();
        assert!(fault.what.contains("drops the fraction"), "{fault}");
    }

    #[test]
    fn unit_what_is_no_function_of_one_row_is_refused() {
        for (sql, says) in [
            ("random()", "another answer each time"),
            ("avg(x)", "needs several rows"),
            ("(select 1)", "a query inside of `sql`"),
            ("lag(x) over ()", "needs several rows"),
            ("y + 1", "there is no column `y`"),
            ("raw + 1", "there is no column `raw`"),
            ("x +", "cannot be read"),
        ] {
            let fault = RowValue::new(sql, &batch().schema()).unwrap_err();
            assert!(fault.to_string().contains(says), "{sql}: {fault}");
        }
        let fault = RowValue::new("Raw + 1", &batch().schema()).unwrap_err();
        assert_eq!(fault.help.as_deref(), Some("put the name in double quotes: `\"Raw\"`"));
    }

    #[test]
    fn law_a_missing_number_is_unknown() {
        let schema = Arc::new(Schema::new(vec![Field::new("x", DataType::Float64, true)]));
        let batch =
            RecordBatch::try_new(schema.clone(), vec![Arc::new(Float64Array::from(vec![f64::NAN, 4.0]))]).unwrap();
        let above = RowValue::new("x >= 3", &schema).unwrap().evaluate(&batch).unwrap();
        assert_eq!(above.as_boolean().iter().collect::<Vec<_>>(), [None, Some(true)]);
        let filled =
            RowValue::new("case when x is null then 0.0 else x end", &schema).unwrap().evaluate(&batch).unwrap();
        assert_eq!(filled.as_primitive::<Float64Type>().values().to_vec(), [0.0, 4.0]);
    }

    #[test]
    fn unit_a_value_that_cannot_be_cast_is_an_error() {
        assert!(of("cast(mode as double)").is_err());
    }
}
