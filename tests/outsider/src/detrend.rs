//! Removes the straight line over time from a column.

use std::sync::Arc;

use arrow_array::{Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Stage, StageSchema, Table, stage};

stage! {
    /// Subtracts the best-fitting straight line over time from a column, line by line, as `COLUMN_detrended`.
    ///
    /// Source: ordinary least squares.
    Detrend = "detrend", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name   = "detrend"
stage  = "detrend"
input  = "resample"
column = "mag_1_c"
"#;
    /// Column to detrend.
    column: String, unit "nT", default "mag_1_c";
}

impl Stage for Detrend {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = inputs.first().map(|table| table.shape()).ok_or_else(|| vec![Fault::new("there is no input")])?;
        let column = shape.number(&self.column, "nT").map_err(|fault| vec![fault.of_param("column")])?;
        let made =
            Column::float(format!("{}_detrended", self.column), &column.unit, "the column less its straight line");
        let reads = ["tt", self.column.as_str()];
        Ok(StageSchema::append(vec![made.from(0, &reads)], &reads))
    }
}

impl LineStage for Detrend {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let [time, values] = ["tt", &self.column].map(|name| numbers(&line.inputs[0], name));
        let detrended = detrended(&time?, &values?);
        Ok(vec![Arc::new(Float64Array::from(detrended))])
    }
}

fn numbers(batch: &RecordBatch, name: &str) -> Result<Vec<f64>, Fault> {
    let column = batch.column_by_name(name).and_then(|c| c.as_primitive_opt::<Float64Type>());
    column.map(|c| c.values().to_vec()).ok_or_else(|| Fault::data("not a column of numbers").in_column(name))
}

/// `values` minus the least-squares straight line in `time` through the finite values.
fn detrended(time: &[f64], values: &[f64]) -> Vec<f64> {
    let finite = || time.iter().zip(values).filter(|(_, y)| y.is_finite());
    let n = finite().count() as f64;
    let [mean_t, mean_y] = [finite().map(|(t, _)| t).sum::<f64>() / n, finite().map(|(_, y)| y).sum::<f64>() / n];
    let of_time = finite().map(|(t, _)| (t - mean_t).powi(2)).sum::<f64>();
    let both = finite().map(|(t, y)| (t - mean_t) * (y - mean_y)).sum::<f64>();
    let slope = if of_time > 0.0 { both / of_time } else { 0.0 };
    time.iter().zip(values).map(|(t, y)| y - mean_y - slope * (t - mean_t)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_straight_line_has_a_zero_residual() {
        let time: Vec<f64> = (0..50).map(f64::from).collect();
        let mut values: Vec<f64> = time.iter().map(|t| 3.0 - 0.25 * t).collect();
        values[7] = f64::NAN;
        let left = detrended(&time, &values);
        assert!(left[7].is_nan());
        assert!(left.iter().filter(|x| x.is_finite()).all(|x| x.abs() < 1e-12));
    }
}
