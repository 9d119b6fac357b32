//! Builds the matrix of a Tolles-Lawson model.

use arrow_array::RecordBatch;
use numerics::{
    compensation::tolles_lawson::{Field, Terms, matrix_in_runs},
    signal::segments::{STEP_TOLERANCE, Usable, sample_rate},
};
use schemas::{Arrays, Column, Fault, LineIn, LineStage, Rule, Stage, Table, Yield, stage};

use crate::columns::{data, faults_of, floats, list, no_truth, shape, vector_axes};

stage! {
    /// Builds the Tolles-Lawson terms of a vector magnetometer and appends them as the list column `tl`.
    ///
    /// With B the vector magnetometer, Bt its magnitude (or `scalar`), dB the central difference of B per sample and s
    /// `bt_scale_nt`: permanent B_i/Bt, induced B_i B_j/(Bt s), eddy B_i dB_j/(Bt s), derivative dB_i, bias 1. The names
    /// of the terms are in the field's metadata `terms`.
    ///
    /// Differences are one-sided at the ends of a line and beside a gap, and never cross one. A sample without a vector
    /// gives a row of NaN. Groups with differences need evenly spaced samples, otherwise the line is an error.
    ///
    /// Source: W. E. Tolles and J. D. Lawson 1950; thesis 000, (3.13) to (3.20) with the scale of its Tables 3.1 and 3.2.
    AMatrix = "a_matrix", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name   = "a_matrix"
stage  = "a_matrix"
input  = "resample"
vector = "flux_a"
"#;
    /// The vector magnetometer, such as `flux_a` for the columns `flux_a_x`, `flux_a_y` and `flux_a_z`.
    vector: String, unit "";
    /// The groups of terms: `permanent`, `induced` (or `induced5`, `induced3`), `eddy` (or `eddy8`, `eddy3`),
    /// `derivative`, `bias`.
    terms: Vec<String>, unit "", default ["permanent", "induced", "eddy"].map(String::from);
    /// A scalar magnetometer whose reading stands for Bt: the modified model.
    scalar: Option<String>, unit "", absent "the magnitude of `vector`";
    /// The scale s of the induced and eddy terms, about the field's strength, so that all terms are of one size.
    bt_scale_nt: f64, unit "nT", default 50_000.0, rule Rule::Positive;
    /// Whether a truth column may be used.
    allow_truth: bool, unit "", default false;
}

impl AMatrix {
    fn terms(&self) -> Result<Terms, Fault> {
        Terms::new(&self.terms).map_err(|e| Fault::new(e.to_string()).of_param("terms"))
    }
}

impl Stage for AMatrix {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
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
        let tl = Column::list("tl", "", "Tolles-Lawson terms", names).from(0, &reads);
        Ok(Yield::append(vec![tl], &reads))
    }
}

impl LineStage for AMatrix {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    fn run(&self, line: &LineIn, (): &()) -> Arrays {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let [x, y, z] = vector_axes(&self.vector);
        let (x, y, z) = (floats(batch, &x)?, floats(batch, &y)?, floats(batch, &z)?);
        let bt = self.scalar.as_ref().map(|s| floats(batch, s)).transpose()?;
        let terms = self.terms()?;
        let differences = terms.names().iter().any(|n| n.ends_with("_dot"));
        let usable = Usable::all(tt.len()).and_finite(x).and_finite(y).and_finite(z);
        let runs = if differences {
            let rate_hz =
                sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
            usable.runs_in_time(tt, rate_hz)
        } else {
            usable.runs()
        };
        let rows = matrix_in_runs(&Field { x, y, z, bt }, &terms, self.bt_scale_nt, &runs).map_err(data)?;
        Ok(vec![list(rows, terms.len())?])
    }
}
