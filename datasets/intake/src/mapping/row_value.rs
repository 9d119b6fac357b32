//! `sql`: an expression over the columns of one row of a file.

use arrow_array::{ArrayRef, RecordBatch, RecordBatchOptions};
use arrow_cast::cast;
use arrow_schema::{DataType, Field, Schema};
use expressions::Expression;
use schemas::{Column, ColumnType, Fault, TableShape};

/// Name of the expression in a fault.
const SUBJECT: &str = "`sql`";

/// Expression checked against the columns of a file; its numeric inputs are Float64.
#[derive(Clone, Debug)]
pub struct RowExpression {
    expression: Expression,
    /// The columns that the expression reads: their positions in the batches of the file, and their names and types
    /// for the expression.
    reads: Vec<(usize, Field)>,
}

impl RowExpression {
    /// Parses `sql` and checks it against the columns of a file.
    ///
    /// # Errors
    /// Returns the errors of [`Expression::new`].
    pub fn new(sql: &str, source: &Schema) -> Result<RowExpression, Fault> {
        let seen: Vec<(usize, Column)> =
            source.fields().iter().enumerate().filter_map(|(at, field)| Some((at, seen(field)?))).collect();
        let shape = TableShape { columns: seen.iter().map(|(_, column)| column.clone()).collect(), rate_hz: None };
        let expression = Expression::new(sql, &shape, SUBJECT)?;
        let read = seen.into_iter().filter(|(_, column)| expression.columns.contains(&column.name));
        let reads = read.map(|(at, column)| (at, column.field().with_nullable(true))).collect();
        Ok(RowExpression { expression, reads })
    }

    /// The type of the expression's values.
    pub fn data_type(&self) -> &DataType {
        &self.expression.data_type
    }

    /// The value for each row of a batch of the file.
    ///
    /// # Errors
    /// Fails if the expression cannot be evaluated on these values.
    pub fn evaluate(&self, batch: &RecordBatch) -> Result<ArrayRef, Fault> {
        let one = |(at, field): &(usize, Field)| {
            let lost = || Fault::bug(format!("a batch lacks its column {at}"));
            let column = cast(batch.columns().get(*at).ok_or_else(lost)?, field.data_type());
            column.map_err(|e| Fault::data(e.to_string()).in_column(field.name()))
        };
        let columns = self.reads.iter().map(one).collect::<Result<Vec<_>, Fault>>()?;
        let schema = Schema::new(self.reads.iter().map(|(_, field)| field.clone()).collect::<Vec<_>>());
        let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        let rows = RecordBatch::try_new_with_options(schema.into(), columns, &options);
        self.expression.evaluate(&rows.map_err(|e| Fault::data(e.to_string()))?)
    }
}

/// A column as seen by expressions; `None` for lists and other unsupported types.
fn seen(field: &Field) -> Option<Column> {
    let kind = match field.data_type() {
        DataType::Dictionary(_, value) => value.as_ref(),
        other => other,
    };
    if kind.is_numeric() {
        Some(Column::float(field.name(), "", ""))
    } else if matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View | DataType::Null) {
        Some(Column::text(field.name(), ""))
    } else if kind == &DataType::Boolean || matches!(kind, DataType::Timestamp(..) | DataType::Date32) {
        Some(Column { column_type: ColumnType::Other(kind.clone()), ..Column::text(field.name(), "") })
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{Float64Array, Int32Array, StringArray, cast::AsArray, types::Float64Type};

    use super::*;

    fn batch() -> RecordBatch {
        let fields = vec![
            Field::new("Raw", DataType::Int32, true),
            Field::new("x", DataType::Float64, true),
            Field::new("mode", DataType::Utf8, true),
        ];
        let columns: Vec<ArrayRef> = vec![
            Arc::new(Int32Array::from(vec![Some(3), Some(50), None])),
            Arc::new(Float64Array::from(vec![1.0, 2.0, f64::NAN])),
            Arc::new(StringArray::from(vec!["a", "b", "c"])),
        ];
        RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).unwrap()
    }

    fn evaluate_sql(sql: &str) -> Result<Vec<Option<f64>>, Fault> {
        let batch = batch();
        let value = RowExpression::new(sql, &batch.schema())?.evaluate(&batch)?;
        Ok(cast(&value, &DataType::Float64).unwrap().as_primitive::<Float64Type>().iter().collect())
    }

    #[test]
    fn unit_whole_numbers_keep_their_fraction_and_nan_is_missing() {
        assert_eq!(evaluate_sql("\"Raw\" / 100").unwrap(), [Some(0.03), Some(0.5), None]);
        assert_eq!(evaluate_sql("\"Raw\" * 0.05 + x").unwrap(), [Some(1.15), Some(4.5), None]);
        assert_eq!(
            evaluate_sql("case when mode = 'b' then 1.0 else 0.0 end").unwrap(),
            [Some(0.0), Some(1.0), Some(0.0)]
        );
        assert_eq!(evaluate_sql("5").unwrap(), [Some(5.0); 3]);
        assert_eq!(evaluate_sql("x * (1 / 2)").unwrap(), [Some(0.5), Some(1.0), None]);
        assert_eq!(evaluate_sql("coalesce(x, 0.0)").unwrap(), [Some(1.0), Some(2.0), Some(0.0)]);
    }

    #[test]
    fn unit_only_functions_of_one_row_are_accepted() {
        for (sql, expected) in [
            ("random()", "a different value each time"),
            ("avg(x)", "requires several rows"),
            ("(select 1)", "`sql` cannot contain a query"),
            ("lag(x) over ()", "requires several rows"),
            ("y + 1", "there is no column `y`"),
            ("Raw + 1", "put the name in double quotes: `\"Raw\"`"),
            ("x +", "cannot be read"),
        ] {
            let fault = RowExpression::new(sql, &batch().schema()).unwrap_err();
            assert!(fault.to_string().contains(expected), "{sql}: {fault}");
        }
    }

    #[test]
    fn unit_a_value_that_cannot_be_cast_is_an_error() {
        assert!(evaluate_sql("cast(mode as double)").is_err());
    }
}
