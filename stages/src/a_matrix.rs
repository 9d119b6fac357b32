//! Builds the matrix of a Tolles-Lawson model.

use std::ops::Range;

use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns, TermSelection, matrix_in_runs},
    signal::segments::RowMask,
};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, stage};

use crate::columns::{data, even_rate_hz, faults_of, floats, list, no_truth, shape, vector_axes};

stage! {
    /// Builds the Tolles-Lawson terms of a vector magnetometer and appends them as the list column `tl`.
    ///
    /// B is the reading of the vector magnetometer, and dB its central difference per sample. Bt is the magnitude of B,
    /// or the reading of `scalar` if set. s is `bt_scale_nt`. The terms are permanent (B_i/Bt), induced (B_i B_j/(Bt
    /// s)), eddy (B_i dB_j/(Bt s)), derivative (dB_i) and bias (1).
    ///
    /// The column's metadata list the terms (`terms`) and the terms that are differences (`per_sample`). They also hold
    /// the sample rate (`rate_hz`) if a `resample` stage set it. `fit` writes this rate to its table, and stages that
    /// apply a model convert its coefficients to the rate of their input.
    ///
    /// Differences are one-sided at the ends of a line and at gaps. They never cross a gap. A sample without a vector
    /// reading gives a row of NaN. Terms that are differences require evenly spaced samples; lines with uneven samples
    /// are rejected.
    ///
    /// Source: W. E. Tolles and J. D. Lawson 1950; Gnadt 2022, (3.13) to (3.20) with the scale of its Tables 3.1 and
    /// 3.2.
    AMatrix = "a_matrix", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name   = "a_matrix"
stage  = "a_matrix"
input  = "resample"
vector = "flux_a"
"#;
    /// Vector magnetometer, such as `flux_a` for the columns `flux_a_x`, `flux_a_y` and `flux_a_z`.
    vector: String, unit "";
    /// Groups of terms: `permanent`, `induced`, `eddy`, `derivative`, `bias`. `induced5` and `eddy8` omit zz and
    /// zz_dot; `induced3` and `eddy3` contain only the diagonal terms.
    terms: Vec<String>, unit "", default ["permanent", "induced", "eddy"].map(String::from);
    /// Scalar magnetometer whose reading replaces Bt. This gives the modified Tolles-Lawson model.
    scalar: Option<String>, unit "", absent "the magnitude of `vector`";
    /// Scale s of the induced and eddy terms. A value near the total field gives all terms similar magnitudes.
    bt_scale_nt: f64, unit "nT", default 50_000.0, rule Rule::Positive;
    /// Allows truth columns as inputs.
    allow_truth: bool, unit "", default false;
}

impl AMatrix {
    fn terms(&self) -> Result<TermSelection, Fault> {
        TermSelection::new(&self.terms).map_err(|e| Fault::new(e.to_string()).of_param("terms"))
    }
}

impl Stage for AMatrix {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let axes = vector_axes(&self.vector);
        let mut faults = vec![];
        if axes.iter().all(|a| shape.get(a).is_none()) {
            let known: Vec<&str> = shape.columns.iter().filter_map(|c| c.name.strip_suffix("_x")).collect();
            let fault = Fault::new(format!("there is no vector magnetometer `{}`", self.vector));
            faults.push(fault.nearest(&self.vector, &known).of_param("vector"));
        } else {
            faults.extend(faults_of(
                axes.iter().map(|a| shape.number(a, "nT").and_then(|c| no_truth(c, "vector", self.allow_truth))),
                "vector",
            ));
        }
        if let Some(scalar) = &self.scalar {
            faults.extend(faults_of(
                [shape.number(scalar, "nT").and_then(|c| no_truth(c, "scalar", self.allow_truth))],
                "scalar",
            ));
        }
        let terms = match self.terms() {
            Ok(terms) if faults.is_empty() => terms,
            Ok(_) => return Err(faults),
            Err(fault) => return Err(faults.into_iter().chain([fault]).collect()),
        };
        let names = terms.names().into_iter().map(str::to_owned).collect();
        let mut reads: Vec<&str> = vec!["tt"];
        reads.extend(axes.iter().map(String::as_str));
        reads.extend(self.scalar.as_deref());
        let mut tl = Column::list("tl", "", "Tolles-Lawson terms", names).from(0, &reads);
        tl.sampling.rate_hz = shape.rate_hz.filter(|_| !tl.sampling.entries.is_empty());
        Ok(StageSchema::append(vec![tl], &reads))
    }
}

impl LineStage for AMatrix {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let [x, y, z] = vector_axes(&self.vector);
        let (x, y, z) = (floats(batch, &x)?, floats(batch, &y)?, floats(batch, &z)?);
        let bt = self.scalar.as_ref().map(|s| floats(batch, s)).transpose()?;
        let terms = self.terms()?;
        let runs = runs_of(&terms, tt, [x, y, z])?;
        let rows = matrix_in_runs(&BodyFieldColumns { x, y, z, bt }, &terms, self.bt_scale_nt, &runs).map_err(data)?;
        Ok(vec![list(rows, terms.len())?])
    }
}

/// Runs of samples in which each sample has a row of terms. All components of the vector magnetometer are finite in a
/// run. If a term is a difference, a run has no gap in time.
///
/// # Errors
/// Fails if a term is a difference and the samples are not evenly spaced.
pub fn runs_of(terms: &TermSelection, tt_s: &[f64], [x, y, z]: [&[f64]; 3]) -> Result<Vec<Range<usize>>, Fault> {
    let usable = RowMask::all(tt_s.len()).and_finite(x).and_finite(y).and_finite(z);
    if !terms.names().iter().any(|name| name.ends_with("_dot")) {
        return Ok(usable.runs());
    }
    let rate_hz = even_rate_hz(tt_s)?;
    Ok(usable.runs_in_time(tt_s, rate_hz))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
    use schemas::{ColumnType, Role, TableShape};

    use super::*;

    const ALL: [&str; 5] = ["permanent", "induced", "eddy", "derivative", "bias"];

    fn a_matrix(terms: &[&str]) -> AMatrix {
        AMatrix {
            vector: "flux_a".into(),
            terms: terms.iter().map(ToString::to_string).collect(),
            scalar: None,
            bt_scale_nt: 50_000.0,
            allow_truth: false,
        }
    }

    fn columns() -> Vec<Column> {
        let columns = ["flux_a_x", "flux_a_y", "flux_a_z", "mag_4_uc"].map(|name| Column::float(name, "nT", ""));
        let truth = Column::float("mag_1_c", "nT", "").role(Role::Truth);
        [Column::float("tt", "s", "")].into_iter().chain(columns).chain([truth]).collect()
    }

    fn table(columns: Vec<Column>) -> Table {
        Table::Lines(TableShape { columns: columns.into(), rate_hz: None })
    }

    /// The names and rows of three samples whose vector is (x, -10,000, 20,000) nT.
    fn made(stage: &AMatrix, x: [f64; 3]) -> (Vec<String>, Vec<f64>) {
        let (y, z, mag) = ([-10_000.0; 3], [20_000.0; 3], [40_000.0; 3]);
        let sensors = [("tt", [0.0, 0.1, 0.2]), ("flux_a_x", x), ("flux_a_y", y), ("flux_a_z", z), ("mag_4_uc", mag)];
        let array = |values: [f64; 3]| Arc::new(Float64Array::from(values.to_vec())) as ArrayRef;
        let batch = RecordBatch::try_from_iter(sensors.map(|(name, values)| (name, array(values)))).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None };
        let yields = stage.yields(&[&table(columns())]).unwrap();
        let ColumnType::List(names) = yields.columns[0].column_type.clone() else { unreachable!("a list") };
        let arrays = stage.run(&line, &()).unwrap();
        let list = arrays[0].as_fixed_size_list();
        assert_eq!((list.len(), list.value_length() as usize), (3, names.len()));
        (names, list.values().as_primitive::<Float64Type>().values().to_vec())
    }

    /// Direction cosines and fields are divided in double precision, with an error of a few units in the last place.
    fn near(found: f64, expected: f64) -> bool {
        (found - expected).abs() <= 1e-15 * expected.abs().max(1.0)
    }

    #[test]
    fn law_a_constant_vector_has_permanent_and_induced_terms_only() {
        // (20, -10, 20) uT is 30 uT long, with the cosines 2/3, -1/3, 2/3. Divided by the scale: (0.4, -0.2, 0.4).
        let (names, values) = made(&a_matrix(&ALL), [20_000.0; 3]);
        let permanent = [("x", 2.0 / 3.0), ("y", -1.0 / 3.0), ("z", 2.0 / 3.0)];
        let mixed = [("xx", 0.8 / 3.0), ("xy", -0.4 / 3.0), ("xz", 0.8 / 3.0)];
        let others = [("yy", 0.2 / 3.0), ("yz", -0.4 / 3.0), ("zz", 0.8 / 3.0)];
        let eddy = ["xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"].map(|pair| (pair, 0.0));
        let changes = ["x", "y", "z"].map(|axis| (axis, 0.0));
        let dotted = eddy.into_iter().chain(changes).map(|(name, value)| (format!("{name}_dot"), value));
        let plain = permanent.into_iter().chain(mixed).chain(others).map(|(name, value)| (name.to_owned(), value));
        let expected: Vec<(String, f64)> = plain.chain(dotted).chain([("bias".to_owned(), 1.0)]).collect();
        assert_eq!(names, expected.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>());
        for row in values.chunks_exact(22) {
            for (found, (name, expected)) in row.iter().zip(&expected) {
                assert!(near(*found, *expected), "{name}: {found} {expected}");
            }
        }
    }

    #[test]
    fn law_eddy_terms_are_cosines_times_scaled_rates() {
        let (names, values) = made(&a_matrix(&ALL), [19_600.0, 20_000.0, 20_300.0]);
        let at = |row: usize, name: &str| values[row * names.len() + names.iter().position(|n| n == name).unwrap()];
        // The differences are one-sided, central and one-sided.
        assert_eq!([0, 1, 2].map(|row| at(row, "x_dot")), [400.0, 350.0, 300.0]);
        // 350 nT divided by 50,000 nT: 0.007.
        for (name, expected) in [("xx_dot", 0.014 / 3.0), ("yx_dot", -0.007 / 3.0), ("zx_dot", 0.014 / 3.0)] {
            assert!(near(at(1, name), expected), "{name}: {}", at(1, name));
        }
        for name in ["xy_dot", "xz_dot", "yy_dot", "yz_dot", "zy_dot", "zz_dot", "y_dot", "z_dot"] {
            assert_eq!(at(1, name), 0.0, "{name}");
        }
    }

    #[test]
    fn unit_a_scalar_can_replace_the_magnitude_and_missing_vectors_give_nan() {
        let modified = AMatrix { scalar: Some("mag_4_uc".into()), ..a_matrix(&["induced3", "permanent"]) };
        let (names, values) = made(&modified, [20_000.0, f64::NAN, 20_000.0]);
        assert_eq!(names, ["x", "y", "z", "xx", "yy", "zz"], "the groups are in the order of the model");
        for row in [&values[..6], &values[12..]] {
            // (20, -10, 20) divided by 40, and the quotient times (0.4, -0.2, 0.4).
            let expected = [0.5, -0.25, 0.5, 0.2, 0.05, 0.2];
            assert!(row.iter().zip(expected).all(|(found, expected)| near(*found, expected)), "{row:?}");
        }
        assert!(values[6..12].iter().all(|x| x.is_nan()));
    }

    #[test]
    fn unit_invalid_inputs_are_reported_with_their_parameter() {
        let fault_texts = |stage: &AMatrix, columns: Vec<Column>| {
            let faults = stage.yields(&[&table(columns)]).unwrap_err();
            faults.iter().map(|f| format!("{f} [{}]", f.param.clone().unwrap_or_default())).collect::<Vec<_>>()
        };
        let other = AMatrix { vector: "flux_b".into(), ..a_matrix(&ALL) };
        let expected = "there is no vector magnetometer `flux_b` (did you mean `flux_a`?) [vector]";
        assert_eq!(fault_texts(&other, columns()), [expected]);
        let mut in_microtesla = columns();
        in_microtesla[2].unit = "uT".into();
        let expected = "column `flux_a_y` is in uT, but nT is needed [vector]";
        assert_eq!(fault_texts(&a_matrix(&ALL), in_microtesla), [expected]);
        let lame: Vec<Column> = columns().into_iter().filter(|c| c.name != "flux_a_z").collect();
        let faults = fault_texts(&a_matrix(&["permanant"]), lame);
        assert_eq!(faults.len(), 2, "{faults:?}");
        assert!(faults[0].starts_with("there is no column `flux_a_z`") && faults[0].ends_with("[vector]"));
        assert!(faults[1].contains("`permanant`") && faults[1].ends_with("[terms]"), "{faults:?}");
        let truth = AMatrix { scalar: Some("mag_1_c".into()), ..a_matrix(&ALL) };
        let faults = fault_texts(&truth, columns());
        assert!(faults[0].contains("`mag_1_c` is a truth column") && faults[0].ends_with("[scalar]"), "{faults:?}");
        assert!(AMatrix { allow_truth: true, ..truth }.yields(&[&table(columns())]).is_ok());
    }
}
