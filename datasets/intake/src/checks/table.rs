//! Converts the figures of lines to a table, and back.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{Field, Schema};
use schemas::{Fault, Role, field};

use super::{QualityFigure, QualityMeasure};

/// Quality measure of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct LineMeasure {
    /// The flight.
    pub flight: String,
    /// The line.
    pub line: String,
    /// The figure.
    pub measure: QualityMeasure,
}

/// The names of the columns.
pub const COLUMNS: [&str; 8] = ["flight", "line", "column", "check", "value", "unit", "count", "first_tt"];

/// The figures: flight, line and figure.
///
/// # Errors
/// Fails only if the columns have different lengths, which is an error in the program.
pub fn table(rows: &[(&str, &str, &QualityMeasure)]) -> Result<RecordBatch, Fault> {
    let text = |f: &dyn Fn(&(&str, &str, &QualityMeasure)) -> String| -> ArrayRef {
        Arc::new(rows.iter().map(|r| Some(f(r))).collect::<StringArray>())
    };
    let number = |f: fn(&QualityMeasure) -> f64| -> ArrayRef {
        // Missing values are null, not NaN, because many programs read the table.
        Arc::new(rows.iter().map(|r| Some(f(r.2)).filter(|x| x.is_finite())).collect::<Float64Array>())
    };
    let count: ArrayRef = Arc::new(rows.iter().map(|r| i64::try_from(r.2.count).ok()).collect::<Int64Array>());
    let [flight, line, column, check, value, unit, of, first_tt] = COLUMNS;
    let columns = [
        (flight, text(&|r| r.0.to_owned()), "", Role::Key, "flight identifier"),
        (line, text(&|r| r.1.to_owned()), "", Role::Key, "line identifier"),
        (column, text(&|r| r.2.column.clone()), "", Role::Key, "the checked column or vector magnetometer"),
        (check, text(&|r| r.2.check.as_str().to_owned()), "", Role::Key, "the check"),
        (value, number(|m| m.value), "", Role::Derived, "the result of the check; null if missing or infinite"),
        (unit, text(&|r| r.2.unit.clone()), "", Role::Derived, "the unit of `value`"),
        (of, count, "", Role::Derived, "the number of affected samples"),
        (
            first_tt,
            number(|m| m.first_tt),
            "s",
            Role::Derived,
            "the time of the first affected sample; null if the check gives one value for the whole line",
        ),
    ];
    let fields: Vec<Field> = columns
        .iter()
        .map(|(name, array, unit, role, about)| field(name, array.data_type().clone(), unit, *role, about))
        .collect();
    let arrays = columns.into_iter().map(|(_, array, ..)| array).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::bug(e.to_string()))
}

/// The figures of a table. Figures that other versions of magline wrote are skipped if this version does not support
/// them.
pub fn figures(table: &RecordBatch) -> Vec<LineMeasure> {
    let [flight, line, column, check, value, unit, count, first_tt] = COLUMNS;
    let text = |name: &str| table.column_by_name(name).and_then(|c| c.as_string_opt::<i32>());
    let number = |name: &str| table.column_by_name(name).and_then(|c| c.as_primitive_opt::<Float64Type>());
    let count = table.column_by_name(count).and_then(|c| c.as_primitive_opt::<Int64Type>());
    let (Some(flight), Some(line), Some(column), Some(check), Some(unit)) =
        (text(flight), text(line), text(column), text(check), text(unit))
    else {
        return vec![];
    };
    let (Some(value), Some(first_tt), Some(count)) = (number(value), number(first_tt), count) else { return vec![] };
    let at = |x: &Float64Array, row: usize| if x.is_null(row) { f64::NAN } else { x.value(row) };
    let one = |row: usize| {
        let measure = QualityMeasure {
            column: column.value(row).to_owned(),
            check: QualityFigure::from_word(check.value(row))?,
            value: at(value, row),
            unit: unit.value(row).to_owned(),
            count: u64::try_from(count.value(row)).ok()?,
            first_tt: at(first_tt, row),
        };
        Some(LineMeasure { flight: flight.value(row).to_owned(), line: line.value(row).to_owned(), measure })
    };
    (0..table.num_rows()).filter_map(one).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_a_table_restores_its_figures() {
        let all: Vec<LineMeasure> = QualityFigure::ALL
            .into_iter()
            .enumerate()
            .map(|(i, check)| LineMeasure {
                flight: "1".into(),
                line: format!("1.{i}"),
                measure: QualityMeasure {
                    column: "mag_1_uc".into(),
                    check,
                    value: 0.1 * i as f64,
                    unit: "nT".into(),
                    count: i as u64,
                    first_tt: 7.0 + i as f64,
                },
            })
            .collect();
        let rows: Vec<(&str, &str, &QualityMeasure)> =
            all.iter().map(|r| (r.flight.as_str(), r.line.as_str(), &r.measure)).collect();
        assert_eq!(figures(&table(&rows).unwrap()), all);
        let nothing = QualityMeasure { value: f64::NAN, first_tt: f64::NAN, ..all[0].measure.clone() };
        let back = figures(&table(&[("1", "2", &nothing)]).unwrap());
        assert!(back[0].measure.value.is_nan() && back[0].measure.first_tt.is_nan());
    }
}
