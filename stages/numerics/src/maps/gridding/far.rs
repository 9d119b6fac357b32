//! Points that are far from a survey: zero or swapped coordinates, or positions of a receiver without a fix.

use std::collections::{BTreeMap, BTreeSet};

/// Minimum reach of a survey, in metres; otherwise the reach is the range of the middle 80 % of the coordinates.
const LEAST_REACH_M: f64 = 1000.0;

/// Column and row of a square cell of the plane.
type PlaneCell = [i64; 2];

/// Indices, ascending, of points that are far from all others. Such points are single or in groups of fewer than a
/// hundredth of all points, and the distance to all other points exceeds half of the survey's reach. The reach is the
/// diagonal of the rectangle between the 10th and 90th percentiles of the coordinates, at least 1 km. Coordinates are
/// metres on one plane; points with a coordinate that is not finite are never far.
///
/// Groups are connected sets of occupied square cells with a side of half the reach.
pub fn far_points(east_m: &[f64], north_m: &[f64]) -> Vec<usize> {
    let known: Vec<usize> =
        (0..east_m.len().min(north_m.len())).filter(|&i| (east_m[i] + north_m[i]).is_finite()).collect();
    let sides = [east_m, north_m].map(|axis| middle(known.iter().map(|&i| axis[i]).collect()));
    let cell_m = 0.5 * sides[0].hypot(sides[1]).max(LEAST_REACH_M);
    let cell = |i: usize| [east_m[i], north_m[i]].map(|x| (x / cell_m).floor() as i64);
    let mut cells: BTreeMap<PlaneCell, Vec<usize>> = BTreeMap::new();
    known.iter().for_each(|&i| cells.entry(cell(i)).or_default().push(i));
    let groups = groups(cells.keys().copied().collect());
    let count = |group: &Vec<PlaneCell>| group.iter().map(|c| cells[c].len()).sum::<usize>();
    let most = groups.iter().map(count).max().unwrap_or(0);
    let few = |group: &&Vec<PlaneCell>| {
        let n = count(group);
        n < most && (n == 1 || 100 * n < known.len())
    };
    let mut far: Vec<usize> = groups.iter().filter(few).flatten().flat_map(|c| cells[c].iter().copied()).collect();
    far.sort_unstable();
    far
}

/// Range of the middle 80 % of values.
fn middle(mut values: Vec<f64>) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return 0.0 };
    let [low, high] = [0.1, 0.9].map(|part| {
        let at = (part * last as f64).round() as usize;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    });
    high - low
}

/// Groups of cells that touch each other, including at corners.
fn groups(mut left: BTreeSet<PlaneCell>) -> Vec<Vec<PlaneCell>> {
    let mut groups = vec![];
    while let Some(first) = left.pop_first() {
        let (mut group, mut next) = (vec![], vec![first]);
        while let Some([column, row]) = next.pop() {
            group.push([column, row]);
            for beside in [-1, 0, 1].into_iter().flat_map(|a| [-1, 0, 1].map(|b| (a, b))) {
                let cell = [column.saturating_add(beside.0), row.saturating_add(beside.1)];
                if left.remove(&cell) {
                    next.push(cell);
                }
            }
        }
        groups.push(group);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines 200 m apart over 10 km by 4 km.
    fn survey() -> [Vec<f64>; 2] {
        let place = |k: usize| [10.0 * (k % 1000) as f64, 200.0 * (k / 1000) as f64];
        [0, 1].map(|axis| (0..20_000).map(|k| place(k)[axis] + 5e5).collect())
    }

    #[test]
    fn unit_a_survey_has_no_far_points_and_two_areas_are_one_survey() {
        let [mut east, mut north] = survey();
        assert!(far_points(&east, &north).is_empty());
        // A second area at a distance of 300 km with 2 % of the points, and a line to this area.
        east.extend((0..400).map(|k| 8e5 + 10.0 * f64::from(k)));
        north.extend([6e5; 400]);
        assert!(far_points(&east, &north).is_empty());
        let [mut east, mut north] = survey();
        east.extend((0..150).map(|k| 5e5 - 1e3 * f64::from(k)));
        north.extend([5e5; 150]);
        assert!(far_points(&east, &north).is_empty(), "a ferry flight hangs together with the survey");
        assert!(far_points(&[], &[]).is_empty() && far_points(&[f64::NAN], &[1.0]).is_empty());
        assert!(far_points(&[0.0, 1e7], &[0.0, 0.0]).is_empty(), "of two points neither is the survey");
    }

    #[test]
    fn unit_single_points_and_small_groups_far_away_are_found() {
        let [mut east, mut north] = survey();
        (east[77], north[77]) = (0.0, 0.0);
        (east[500], north[500]) = (north[500] - 4e4, east[500]);
        (east[900], north[900]) = (1e300, -1e300);
        (east[901], north[901]) = (f64::NAN, f64::INFINITY);
        east[3000..3100].iter_mut().for_each(|x| *x += 2e5);
        let expected: Vec<usize> = [77, 500, 900].into_iter().chain(3000..3100).collect();
        assert_eq!(far_points(&east, &north), expected);
        // Among a few points, up to a tenth may have wrong positions.
        let few: Vec<f64> = (0..20).map(|k| if k == 7 { 6e6 } else { 100.0 * f64::from(k) }).collect();
        assert_eq!(far_points(&few, &[0.0; 20]), [7]);
    }
}
