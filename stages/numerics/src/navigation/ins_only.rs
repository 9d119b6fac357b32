//! INS without measurements of the field, with the covariance of its errors.

use crate::navigation::gaussian::StateEstimate;
use crate::navigation::gaussian::recursion::{FilterRecursion, run_along};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::position_fixes::{NO_FIX, PositionFixes};

/// INS along a line, with the covariance of its error: P ← Φ P Φᵀ + Q, starting from the initial covariance. With
/// `fixes`, aiding positions correct the INS at every sample that has a position.
///
/// # Errors
/// Returns the errors of [`InsErrorModel::check`], [`InsSeries::check`] and [`PositionFixes::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite.
pub fn run(
    ins: &InsSeries<'_>,
    errors: &InsErrorModel,
    fixes: Option<&PositionFixes>,
) -> Result<NavigationOutput, NavigationError> {
    errors.check()?;
    ins.check()?;
    fixes.map_or(Ok(()), |fixes| fixes.check(ins.len()))?;
    let filter = InsOnlyFilter { output: NavigationOutput::with_capacity(ins.len(), false, false) };
    let fixes_at = |row| fixes.map_or(NO_FIX, |fixes| fixes.at(ins, row, errors.earth));
    Ok(run_along(filter, ins, errors, fixes_at)?.output)
}

/// Filter without measurements of the field.
struct InsOnlyFilter {
    output: NavigationOutput,
}

impl FilterRecursion for InsOnlyFilter {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output
    }

    fn measure(&mut self, _: &mut StateEstimate, _: usize) -> Innovation {
        Innovation::NONE
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::earth::geodesy::EarthModel;
    use crate::navigation::ins_error::{InsErrors, simulate_ins_error};
    use crate::navigation::pinson::{LAT, LON};
    use crate::random::NormalGenerator;

    const ROWS: usize = 301;

    /// INS at rest at 45° N for ten minutes, one sample every 2 s.
    fn columns() -> [Vec<f64>; 13] {
        let of = |value: f64| vec![value; ROWS];
        let mut columns = [0.0, 45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0].map(of);
        columns[0] = (0..ROWS).map(|k| 2.0 * k as f64).collect();
        columns
    }

    #[test]
    fn law_the_covariance_equals_that_of_simulated_errors() {
        let columns = columns();
        let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
        let errors = InsErrorModel::default();
        let output = run(&ins, &errors, None).unwrap();
        assert_eq!(output.lat_deg, columns[1]);
        let runs = 300_u64;
        let mut squares = [0.0; 2];
        for seed in 0..runs {
            let mut normals = NormalGenerator::new(seed);
            let last = *simulate_ins_error(&ins, &errors, || normals.draw()).unwrap().last().unwrap();
            let earth = EarthModel::Wgs84;
            squares[0] += earth.lat_rad_to_north_m(last[LAT], 45_f64.to_radians(), 300.0).powi(2);
            squares[1] += earth.lon_rad_to_east_m(last[LON], 45_f64.to_radians(), 300.0).powi(2);
        }
        // The mean of a chi-square of 300 degrees of freedom is within 27 % of its expected value in 999 of 1000 cases.
        for (square, sd) in squares.iter().zip([output.sd_n_m[ROWS - 1], output.sd_e_m[ROWS - 1]]) {
            let ratio = square / runs as f64 / sd.powi(2);
            assert!((ratio - 1.0).abs() < 0.27, "{ratio}");
        }
    }

    #[test]
    fn law_an_initial_velocity_error_alone_grows_with_time() {
        let mut columns = columns();
        columns.iter_mut().for_each(|column| column.truncate(31));
        let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
        let sources = InsErrors {
            init_position_sigma_m: 0.0,
            init_attitude_sigma_deg: 0.0,
            init_velocity_sigma_mps: 2.0,
            vrw_sigma: 0.0,
            arw_sigma: 0.0,
            acc_sigma_mps2: 0.0,
            gyro_sigma_radps: 0.0,
            ..InsErrors::default()
        };
        let output = run(&ins, &InsErrorModel::from_sources(sources), None).unwrap();
        // The displacement is 2 m/s for 60 s. The Schuler oscillation reduces the displacement by (ω t)²/6 = 0.1 %.
        assert!((output.sd_n_m[30] / 120.0 - 1.0).abs() < 0.005, "{}", output.sd_n_m[30]);
    }
}
