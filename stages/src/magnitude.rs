//! The magnitude of a vector magnetometer.

use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Stage, StageSchema, Table, stage};

use crate::columns::{array, faults_of, floats, no_truth, shape, vector_axes};

stage! {
    /// Appends the magnitude of a vector magnetometer, `flux_a_t` for `flux_a`. It can then be compensated like a
    /// scalar magnetometer.
    ///
    /// An existing column of that name is replaced. The result is NaN for a sample with a missing component.
    ///
    /// Source: van der Meer 2025, section 4.2.2 (its Tables 4.3 and 4.5).
    Magnitude = "magnitude", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name   = "magnitude"
stage  = "magnitude"
input  = "resample"
vector = "flux_a"
"#;
    /// Vector magnetometer, such as `flux_a` for the columns `flux_a_x`, `flux_a_y` and `flux_a_z`.
    vector: String, unit "";
    /// Allows truth columns as inputs.
    allow_truth: bool, unit "", default false;
}

impl Stage for Magnitude {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let axes = vector_axes(&self.vector);
        let fine = |name: &String| shape.number(name, "nT").and_then(|c| no_truth(c, "vector", self.allow_truth));
        let faults = faults_of(axes.iter().map(fine), "vector");
        if !faults.is_empty() {
            return Err(faults);
        }
        let column = Column::float(format!("{}_t", self.vector), "nT", "magnitude of the vector magnetometer");
        Ok(StageSchema::append(vec![column.from(0, &axes)], &axes))
    }
}

impl LineStage for Magnitude {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let [x, y, z] = vector_axes(&self.vector);
        let of = |name: &str| floats(&line.inputs[0], name);
        let rows = of(&x)?.iter().zip(of(&y)?).zip(of(&z)?);
        Ok(vec![array(rows.map(|((x, y), z)| (x * x + y * y + z * z).sqrt()).collect())])
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use arrow_array::{Float64Array, RecordBatch, cast::AsArray, types::Float64Type};

    use super::*;

    #[test]
    fn law_the_magnitude_is_the_root_of_the_sum_of_squares() {
        let column = |a: f64, b: f64| Arc::new(Float64Array::from(vec![a, b])) as arrow_array::ArrayRef;
        let columns =
            [("flux_a_x", column(2.0, 1.0)), ("flux_a_y", column(-3.0, f64::NAN)), ("flux_a_z", column(6.0, 1.0))];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let line = LineInput { flight: "1".into(), line: "1".into(), inputs: vec![batch], keep: None };
        let made = Magnitude { vector: "flux_a".into(), allow_truth: false }.run(&line, &()).unwrap();
        let made = made[0].as_primitive::<Float64Type>().values();
        assert_eq!(made[0], 7.0);
        assert!(made[1].is_nan());
    }
}
