//! Resamples numeric columns: measured quantities are interpolated, and whole numbers stay whole.

use std::collections::HashSet;

use numerics::signal::resample::{ResampleError, ResamplePlan, SampleInterpolation};
use schemas::{Column, Role};

/// Maximum number of distinct values of a code: the number of values of one byte.
const MOST_CODES: usize = 256;
/// A column with at most this number of distinct values holds codes even if no value recurs, as on a short line.
const FEW_CODES: usize = 16;

/// Interpolation rule of a column between two samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ColumnInterpolation {
    /// Interpolated along the shorter arc, in degrees.
    Angle,
    /// Interpolated.
    Number,
    /// Interpolated and rounded to a whole number.
    Count,
    /// Taken from the nearest sample.
    Code,
}

/// The values `x` of a column on the grid of `plan`; NaN in gaps.
///
/// A column with a unit, or with the role sensor or truth, is measured. Any other column with whole finite values stays
/// whole. It holds codes if its values recur: the number of distinct values is at most half the number of samples,
/// where this limit is at least [`FEW_CODES`] and at most [`MOST_CODES`]. Otherwise it holds counts.
///
/// # Errors
/// Fails if the column and the times of the plan have different lengths.
pub fn between_samples(
    plan: &ResamplePlan,
    column: &Column,
    x: &[f64],
    method: SampleInterpolation,
) -> Result<Vec<f64>, ResampleError> {
    match between(column, x) {
        ColumnInterpolation::Angle => plan.angle_deg(x, method),
        ColumnInterpolation::Number => plan.column(x, method),
        ColumnInterpolation::Count => Ok(plan.column(x, method)?.into_iter().map(f64::round).collect()),
        ColumnInterpolation::Code => plan.column(x, SampleInterpolation::Nearest),
    }
}

fn between(column: &Column, x: &[f64]) -> ColumnInterpolation {
    let finite = || x.iter().filter(|x| x.is_finite());
    let has_unit = !matches!(column.unit.as_str(), "" | "1");
    if column.unit == "deg" {
        ColumnInterpolation::Angle
    } else if has_unit || matches!(column.role, Role::Sensor | Role::Truth) || finite().any(|x| x.fract() != 0.0) {
        ColumnInterpolation::Number
    } else {
        let most = (finite().count() / 2).clamp(FEW_CODES, MOST_CODES);
        let mut distinct = HashSet::new();
        // Adding 0 turns -0 into 0.
        let many = finite().any(|x| distinct.insert((x + 0.0).to_bits()) && distinct.len() > most);
        if many { ColumnInterpolation::Count } else { ColumnInterpolation::Code }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn column(unit: &str, role: Role) -> Column {
        Column::float("x", unit, "").role(role)
    }

    fn doubled(column: &Column, x: &[f64]) -> Vec<f64> {
        let tt: Vec<f64> = (0..x.len()).map(|k| k as f64).collect();
        let plan = ResamplePlan::new(&tt, 2.0, 2.0).unwrap();
        between_samples(&plan, column, x, SampleInterpolation::Linear).unwrap()
    }

    #[test]
    fn unit_codes_and_flags_take_the_nearest_sample() {
        let aux = column("", Role::Aux);
        assert_eq!(doubled(&aux, &[0.0, 1.0, 1.0, 0.0]), [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!(doubled(&column("1", Role::Derived), &[8.0, 12.0]), [8.0, 8.0, 12.0]);
        // A missing value leaves a gap of two seconds, over which values are interpolated.
        assert_eq!(doubled(&aux, &[3.0, f64::NAN, 6.0]), [3.0, 3.0, 3.0, 6.0, 6.0]);
        // Large status words are codes, because their values recur.
        let status: Vec<f64> = (0..100).map(|k| f64::from(1_u32 << (k % 20))).collect();
        assert!(doubled(&aux, &status).iter().all(|x| status.contains(x)));
    }

    #[test]
    fn unit_whole_measured_quantities_are_interpolated() {
        for measured in [column("nT", Role::Aux), column("", Role::Sensor), column("", Role::Truth)] {
            assert_eq!(doubled(&measured, &[52_000.0, 52_001.0]), [52_000.0, 52_000.5, 52_001.0]);
        }
        assert_eq!(doubled(&column("deg", Role::Aux), &[350.0, 10.0]), [350.0, 0.0, 10.0]);
        assert_eq!(doubled(&column("", Role::Aux), &[0.0, 1.0, 2.5]), [0.0, 0.5, 1.0, 1.75, 2.5]);
    }

    #[test]
    fn unit_counts_stay_whole_and_do_not_jump() {
        // A latitude in 1e-7 degrees, as autopilots log it.
        let lat: Vec<f64> = (0..60).map(|k| -353_632_621.0 + f64::from(k) * 137.0).collect();
        let found = doubled(&column("", Role::Aux), &lat);
        for (k, x) in found.iter().enumerate() {
            assert!(x.fract() == 0.0 && (x - (lat[0] + 68.5 * k as f64)).abs() <= 0.5, "{k}: {x}");
        }
    }
}
