//! Rates of change of columns.

use numerics::{
    angle::unwrapped_deg,
    signal::{
        difference::{DifferenceScheme, difference},
        savitzky_golay::SavitzkyGolay,
        segments::RowMask,
    },
};
use schemas::{Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, choice, stage};

use crate::columns::{array, even_rate_hz, floats, is_angle, made_of_each, not_numbers_among, shape};

stage! {
    /// Appends the rate of change per second of each column as `<column>_dot`.
    ///
    /// `central` is the central difference divided by the time between samples. At the ends of a run, the difference is
    /// one-sided. `savitzky_golay` is the slope of the least-squares polynomial over a window. It amplifies noise less
    /// than `central`. For white noise with a standard deviation of 1, the standard deviation of the slope is 0.32 per
    /// sample with the default window and degree. With `central` it is 0.71.
    ///
    /// Changes in angle (unit deg) are taken along the shorter arc. A missing value or a gap in time ends a run. A run
    /// that is too short for the method gives NaN. Samples must be evenly spaced. The unit is the column's unit per
    /// second.
    ///
    /// Source: Savitzky & Golay 1964, Analytical Chemistry 36(8).
    Derivative = "derivative", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "derivative"
stage   = "derivative"
input   = "resample"
columns = ["flux_a_x", "mag_4_uc"]
method  = "savitzky_golay"
"#;
    /// Columns to differentiate.
    columns: Vec<String>, unit "";
    /// Method of differentiation.
    method: DerivativeMethod, unit "", default DerivativeMethod::Central;
    /// For `savitzky_golay`: odd number of samples in a window.
    window: Option<usize>, unit "", absent "5", rule Rule::Between(3.0, 10001.0);
    /// For `savitzky_golay`: degree of the polynomial.
    degree: Option<usize>, unit "", absent "2", rule Rule::Between(1.0, 8.0);
}

choice! {
    /// Method of differentiation.
    pub enum DerivativeMethod {
        /// Central difference.
        Central = "central",
        /// Least-squares polynomials over a window.
        SavitzkyGolay = "savitzky_golay",
    }
}

/// Differentiator of a run; its result is per sample.
enum Differentiator {
    Central,
    Fitted(SavitzkyGolay),
}

impl Differentiator {
    fn apply(&self, x: &[f64]) -> Option<Vec<f64>> {
        match self {
            Differentiator::Central => difference(x, DifferenceScheme::Central),
            Differentiator::Fitted(polynomial) => polynomial.apply(x),
        }
    }

    fn least_rows(&self) -> usize {
        match self {
            Differentiator::Central => DifferenceScheme::Central.least_rows(),
            Differentiator::Fitted(polynomial) => polynomial.window(),
        }
    }
}

impl Derivative {
    fn slope(&self) -> Result<Differentiator, Fault> {
        match self.method {
            DerivativeMethod::Central => Ok(Differentiator::Central),
            DerivativeMethod::SavitzkyGolay => {
                let fitted = SavitzkyGolay::new(self.window.unwrap_or(5), self.degree.unwrap_or(2), 1);
                fitted.map(Differentiator::Fitted).map_err(|e| Fault::new(e.to_string()).of_param("window"))
            }
        }
    }
}

/// The unit of a rate of change.
fn per_second(unit: &str) -> String {
    match unit {
        "" => "1/s".to_owned(),
        // The usual spelling of the unit.
        "m/s" => "m/s2".to_owned(),
        other => format!("{other}/s"),
    }
}

impl Stage for Derivative {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = not_numbers_among(shape, &self.columns, "columns");
        faults.extend(self.slope().err());
        if !faults.is_empty() {
            return Err(faults);
        }
        let made = made_of_each(shape, &self.columns, "_dot", "rate of change", per_second);
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(StageSchema::append(made, &reads))
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let fitted = self.method == DerivativeMethod::SavitzkyGolay;
        let is_unused = !fitted && (key == "window" || key == "degree");
        is_unused.then(|| Fault::new(format!("`{key}` has no effect with the method `central`")))
    }
}

impl LineStage for Derivative {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        let slope = self.slope()?;
        let one = |name: &String| {
            let x = floats(batch, name)?;
            let turned = is_angle(batch, name).then(|| unwrapped_deg(x));
            let values = turned.as_deref().unwrap_or(x);
            let mut made = vec![f64::NAN; x.len()];
            let mut any = false;
            for run in RowMask::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz) {
                let (Some(from), Some(to)) = (values.get(run.clone()), made.get_mut(run)) else { continue };
                if let Some(rates) = slope.apply(from) {
                    to.iter_mut().zip(rates).for_each(|(to, rate)| *to = rate * rate_hz);
                    any = true;
                }
            }
            if any {
                return Ok(array(made));
            }
            let what = format!("no run of samples is long enough for the derivative ({} samples)", slope.least_rows());
            Err(Fault::data(what).in_column(name))
        };
        self.columns.iter().map(one).collect()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::Role;

    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, sampled, table};

    const RATE_HZ: f64 = 20.0;

    fn derivative(method: DerivativeMethod) -> Derivative {
        Derivative { columns: vec!["x".into()], method, window: None, degree: None }
    }

    fn run(stage: &Derivative, unit: &str, x: Vec<f64>) -> Result<Vec<f64>, Fault> {
        let tt = sampled(100.0, RATE_HZ, x.len(), |t| t);
        Ok(numbers(stage.run(&line(vec![batch(vec![("tt", "s", tt), ("x", unit, x)])]), &()))?.remove(0))
    }

    #[test]
    fn law_a_parabola_has_its_slope_per_second() {
        let x = sampled(0.0, RATE_HZ, 200, |t| 50_000.0 + 3.0 * t - 0.5 * t * t);
        for method in [DerivativeMethod::Central, DerivativeMethod::SavitzkyGolay] {
            let y = run(&derivative(method), "nT", x.clone()).unwrap();
            // One-sided differences at the ends equal the slope half a step inside.
            let inside = if method == DerivativeMethod::Central { 1..199 } else { 0..200 };
            for k in inside {
                assert!((y[k] - (3.0 - k as f64 / RATE_HZ)).abs() < 1e-8, "{k}: {}", y[k]);
            }
        }
    }

    #[test]
    fn law_a_turn_through_north_keeps_its_rate_and_gaps_are_kept() {
        let mut x = sampled(0.0, RATE_HZ, 400, |t| (300.0 + 12.0 * t).rem_euclid(360.0));
        x[250] = f64::NAN;
        let y = run(&derivative(DerivativeMethod::Central), "deg", x).unwrap();
        assert!(y.iter().enumerate().all(|(k, y)| if k == 250 { y.is_nan() } else { (y - 12.0).abs() < 1e-9 }));
    }

    #[test]
    fn law_noise_is_amplified_by_the_norm_of_the_weights() {
        let mut normals = numerics::random::NormalGenerator::new(3);
        let x: Vec<f64> = (0..20_000).map(|_| normals.draw()).collect();
        // Half of √2, and the root of (2² + 1 + 1 + 2²)/10².
        for (method, factor) in
            [(DerivativeMethod::Central, 0.5_f64.sqrt()), (DerivativeMethod::SavitzkyGolay, 0.1_f64.sqrt())]
        {
            let y = run(&derivative(method), "nT", x.clone()).unwrap();
            let rms = (y.iter().map(|y| y * y).sum::<f64>() / y.len() as f64).sqrt() / RATE_HZ;
            assert!((rms / factor - 1.0).abs() < 0.03, "{rms} {factor}");
        }
    }

    #[test]
    fn unit_units_are_per_second_and_invalid_windows_are_rejected() {
        let lines = table(&[("tt", "s"), ("yaw", "deg"), ("ins_vn", "m/s"), ("mag_4_uc", "nT")], None);
        let stage = |window| Derivative {
            columns: ["yaw", "ins_vn", "mag_4_uc"].map(str::to_owned).to_vec(),
            window,
            ..derivative(DerivativeMethod::SavitzkyGolay)
        };
        let made = stage(None).yields(&[&lines]).unwrap().columns;
        let made: Vec<_> = made.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        let truth = Role::Truth;
        assert_eq!(
            made,
            [
                ("yaw_dot", "deg/s", truth),
                ("ins_vn_dot", "m/s2", Role::Derived),
                ("mag_4_uc_dot", "nT/s", Role::Derived)
            ]
        );
        assert!(fault_texts(stage(Some(4)).yields(&[&lines]).unwrap_err()).ends_with("[window]"));
        assert!(
            derivative(DerivativeMethod::Central).unused_key("window").is_some()
                && stage(None).unused_key("window").is_none()
        );
        assert!(
            run(&derivative(DerivativeMethod::SavitzkyGolay), "nT", vec![1.0; 4])
                .unwrap_err()
                .what
                .contains("5 samples")
        );
    }
}
