//! Longitudes of 0 to 360 degrees, wrapped to -180 to 180 without splitting the axis.

use numerics::maps::plane_grid::EvenAxis;

/// Maximum deviation of 360 degrees from a whole number of steps, in steps.
const SLACK: f64 = 1e-3;

/// The wrapped axis, and for each of its columns the column in the file; `None` if no change is needed.
///
/// A map around the earth begins at its first meridian east of -180 degrees. Any other map keeps its columns and is
/// shifted by multiples of 360 degrees until its middle lies between -180 and 180 degrees. A map across the date line
/// therefore exceeds 180 degrees.
pub fn turned(axis: &EvenAxis) -> Option<(EvenAxis, Vec<usize>)> {
    if round_the_earth(axis) && axis.last() > 180.0 + SLACK * axis.step {
        return Some(rolled(axis));
    }
    let middle = 0.5 * (axis.first + axis.last());
    let rounds = ((middle + 180.0) / 360.0).floor();
    // A middle of exactly 180 degrees becomes -180; both are valid.
    let moved = EvenAxis { first: axis.first - 360.0 * rounds, ..*axis };
    (rounds != 0.0).then(|| (moved, (0..axis.len).collect()))
}

fn round_the_earth(axis: &EvenAxis) -> bool {
    axis.step * axis.len as f64 >= 360.0 - SLACK * axis.step
}

/// The number of distinct meridians of a map around the earth; `None` for any other map.
pub fn round(axis: &EvenAxis) -> Option<usize> {
    let nodes = (360.0 / axis.step).round();
    let whole = (nodes * axis.step - 360.0).abs() <= SLACK * axis.step;
    (round_the_earth(axis) && whole && nodes >= 2.0).then_some(nodes as usize)
}

fn rolled(axis: &EvenAxis) -> (EvenAxis, Vec<usize>) {
    let distinct = ((360.0 / axis.step).round() as usize).clamp(1, axis.len);
    // The first meridian that is not west of -180 degrees, counted in steps from the first meridian of the file.
    let ahead = ((-180.0 - axis.first) / axis.step - SLACK).ceil();
    let first = axis.first + ahead * axis.step;
    let start = (ahead as i64).rem_euclid(distinct as i64) as usize;
    let columns = (0..axis.len).map(|i| (start + i) % distinct).collect();
    (EvenAxis { first, ..*axis }, columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(first: f64, step: f64, len: usize) -> EvenAxis {
        EvenAxis { first, step, len }
    }

    /// Checks that the longitudes ascend and differ from the file's by multiples of 360 degrees.
    fn check(from: EvenAxis) -> EvenAxis {
        let Some((to, columns)) = turned(&from) else { return from };
        assert_eq!(columns.len(), to.len);
        for (i, column) in columns.iter().enumerate() {
            let rounds = (to.at(i as f64) - from.at(*column as f64)) / 360.0;
            // Rounding: at least 360 steps, each with an error of 1e-14.
            assert!((rounds - rounds.round()).abs() < 1e-9, "{i} {column}: {rounds}");
        }
        to
    }

    #[test]
    fn law_wrapped_columns_keep_their_meridian() {
        assert_eq!(check(axis(0.0, 1.0, 360)), axis(-180.0, 1.0, 360));
        assert_eq!(check(axis(0.5, 1.0, 360)), axis(-179.5, 1.0, 360));
        assert_eq!(check(axis(0.0, 1.0, 361)), axis(-180.0, 1.0, 361), "0 and 360 are one meridian, -180 and 180 too");
        assert_eq!(check(axis(-180.0, 0.5, 721)), axis(-180.0, 0.5, 721));
        assert_eq!(check(axis(-180.0, 0.5, 720)), axis(-180.0, 0.5, 720));
        assert_eq!(check(axis(220.0, 0.5, 40)), axis(-140.0, 0.5, 40));
        assert_eq!(check(axis(170.0, 0.5, 39)), axis(170.0, 0.5, 39), "across the date line");
        assert_eq!(check(axis(175.0, 0.5, 39)), axis(-185.0, 0.5, 39));
        assert_eq!(check(axis(-10.0, 0.1, 200)), axis(-10.0, 0.1, 200));
        assert_eq!(turned(&axis(100.0, 1.0, 80)), None);
    }
}
