//! Differences of the field where the track of a line crosses itself.

use crate::regression::statistics::SampleStatistic;

/// Maximum horizontal distance between the two samples of a crossing, in metres.
pub const NEAR_M: f64 = 1.0;

/// Minimum time between the two samples of a crossing, in seconds.
pub const APART_S: f64 = 1.0;

/// Maximum number of compared pairs of samples.
const MOST_PAIRS: u128 = 50_000_000;

/// The figure of merit of the crossings of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineCrossingFigure {
    /// The figure, in the unit of the measurements; `n` counts pairs. NaN without a pair.
    pub figure: SampleStatistic,
    /// Stride of the used samples: 1 except for long stays at one position.
    pub stride: usize,
}

/// The root mean square of z − z* over all pairs of samples that are at most 1 m apart horizontally
/// and more than 1 s apart in time. [Lee 2019, (66)]
///
/// `north_m` and `east_m` are local positions in metres, `z` measurements in any unit, `tt` seconds. Samples with a
/// value that is not finite are excluded. Every pair counts once.
///
/// Samples are sorted into cells of 1 m, and only neighbours are compared: the computation time grows linearly with the
/// number of samples, not quadratically. A hovering aircraft puts thousands of samples into one cell. If more than 50
/// million pairs would be compared, only every k-th sample is used, where k is the smallest power of two that meets the
/// limit. `stride` returns k.
pub fn figure_of_merit_crossings(north_m: &[f64], east_m: &[f64], z: &[f64], tt: &[f64]) -> LineCrossingFigure {
    let mut stride = 1;
    let cells = loop {
        let cells = CrossingCells::new(north_m, east_m, z, tt, stride);
        if cells.candidates() <= MOST_PAIRS {
            break cells;
        }
        stride *= 2;
    };
    let (mut squares, mut pairs) = (0.0, 0usize);
    cells.each_pair(|one, other| {
        let (dn, de) = (one.north_m - other.north_m, one.east_m - other.east_m);
        let near = dn * dn + de * de <= NEAR_M * NEAR_M;
        if near && (one.tt - other.tt).abs() > APART_S {
            squares += (one.z - other.z) * (one.z - other.z);
            pairs += 1;
        }
    });
    LineCrossingFigure { figure: SampleStatistic { value: (squares / pairs as f64).sqrt(), n: pairs }, stride }
}

#[derive(Debug, Clone, Copy)]
struct CrossingSample {
    cell: (i64, i64),
    north_m: f64,
    east_m: f64,
    z: f64,
    tt: f64,
}

/// Samples sorted by cell, with an index of the occupied cells.
struct CrossingCells {
    samples: Vec<CrossingSample>,
    /// Cell, index of its first sample, and index after its last sample.
    index: Vec<((i64, i64), usize, usize)>,
    /// For each entry of the index, the first entry that does not precede the cell to the north-west.
    north_west: Vec<usize>,
}

impl CrossingCells {
    fn new(north_m: &[f64], east_m: &[f64], z: &[f64], tt: &[f64], stride: usize) -> Self {
        let cell = |x: f64| (x / NEAR_M).floor() as i64;
        let columns = north_m.iter().zip(east_m).zip(z).zip(tt);
        let mut samples: Vec<CrossingSample> = columns
            .step_by(stride)
            .map(|(((&north_m, &east_m), &z), &tt)| CrossingSample {
                cell: (cell(north_m), cell(east_m)),
                north_m,
                east_m,
                z,
                tt,
            })
            .filter(|s| (s.north_m + s.east_m + s.z + s.tt).is_finite())
            .collect();
        samples.sort_by_key(|sample| sample.cell);
        let mut index: Vec<((i64, i64), usize, usize)> = Vec::new();
        for (at, sample) in samples.iter().enumerate() {
            match index.last_mut() {
                Some((cell, _, end)) if *cell == sample.cell => *end = at + 1,
                _ => index.push((sample.cell, at, at + 1)),
            }
        }
        // The neighbours of sorted cells are sorted too, so one pass over the cells finds all neighbours.
        let (mut north_west, mut at) = (Vec::with_capacity(index.len()), 0);
        for ((north, east), ..) in &index {
            let wanted = (north.saturating_add(1), east.saturating_sub(1));
            while index.get(at).is_some_and(|entry| entry.0 < wanted) {
                at += 1;
            }
            north_west.push(at);
        }
        Self { samples, index, north_west }
    }

    /// Samples in half of the neighbours of a cell, chosen so that every pair of cells is visited once.
    fn around(&self, entry: usize) -> impl Iterator<Item = &[CrossingSample]> {
        let (cell, ..) = self.index[entry];
        let next = self.index.get(entry + 1).filter(move |e| e.0 == (cell.0, cell.1.saturating_add(1)));
        let last = (cell.0.saturating_add(1), cell.1.saturating_add(1));
        let row = self.index[self.north_west[entry]..].iter().take_while(move |e| e.0 <= last);
        next.into_iter().chain(row).map(|&(_, start, end)| &self.samples[start..end])
    }

    fn candidates(&self) -> u128 {
        let pairs = self.index.iter().enumerate().map(|(entry, &(_, start, end))| {
            let n = (end - start) as u128;
            let beside: usize = self.around(entry).map(<[CrossingSample]>::len).sum();
            n * (n - 1) / 2 + n * beside as u128
        });
        pairs.sum()
    }

    fn each_pair(&self, mut visit: impl FnMut(&CrossingSample, &CrossingSample)) {
        for (entry, &(_, start, end)) in self.index.iter().enumerate() {
            let own = &self.samples[start..end];
            for (i, one) in own.iter().enumerate() {
                own[i + 1..].iter().for_each(|other| visit(one, other));
                for beside in self.around(entry) {
                    beside.iter().for_each(|other| visit(one, other));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    /// The definition, pair by pair.
    fn every_pair(north: &[f64], east: &[f64], z: &[f64], tt: &[f64]) -> (f64, usize) {
        let (mut squares, mut n) = (0.0, 0);
        for i in 0..z.len() {
            for j in 0..i {
                let near = (north[i] - north[j]).hypot(east[i] - east[j]) <= 1.0;
                if near && (tt[i] - tt[j]).abs() > 1.0 {
                    squares += (z[i] - z[j]).powi(2);
                    n += 1;
                }
            }
        }
        ((squares / f64::from(n)).sqrt(), n as usize)
    }

    fn clover(rows: usize) -> [Vec<f64>; 4] {
        let tt: Vec<f64> = (0..rows).map(|k| 0.1 * k as f64).collect();
        let r = |t: f64| 40.0 * (0.11 * t).sin();
        let north = tt.iter().map(|t| r(*t) * (0.05 * t).cos()).collect();
        let east = tt.iter().map(|t| r(*t) * (0.05 * t).sin()).collect();
        let z = tt.iter().map(|t| (0.3 * t).sin() + 0.01 * t).collect();
        [north, east, z, tt]
    }

    #[test]
    fn unit_cells_find_the_pairs_of_the_definition() {
        let [north, east, z, tt] = clover(3000);
        let (value, n) = every_pair(&north, &east, &z, &tt);
        let found = figure_of_merit_crossings(&north, &east, &z, &tt);
        assert!(n > 1000);
        assert_eq!((found.figure.n, found.stride), (n, 1));
        // The two results are sums of the same squares in a different order.
        assert!((found.figure.value / value - 1.0).abs() < 1e-12);
    }

    #[test]
    fn law_two_passes_over_one_point_give_their_difference() {
        let found = figure_of_merit_crossings(
            &[0.0, 50.0, -0.6, f64::NAN],
            &[0.0, 0.0, -0.8, 0.0],
            &[100.0, 0.0, 103.0, 9.0],
            &[0.0, 10.0, 20.0, 30.0],
        );
        assert_eq!(found.figure, SampleStatistic { value: 3.0, n: 1 });
        let just_apart = figure_of_merit_crossings(&[0.0, 1.001], &[0.0; 2], &[0.0; 2], &[0.0, 9.0]);
        assert_eq!(just_apart.figure.n, 0);
        assert!(just_apart.figure.value.is_nan());
        let at_once = figure_of_merit_crossings(&[0.0; 2], &[0.0; 2], &[0.0, 5.0], &[0.0, 1.0]);
        assert_eq!(at_once.figure.n, 0);
    }

    #[test]
    fn unit_an_hour_at_one_position_is_thinned_and_reported() {
        let rows = 36_000;
        let tt: Vec<f64> = (0..rows).map(|k| 0.1 * f64::from(k)).collect();
        let z: Vec<f64> = (0..rows).map(|k| f64::from(k / 100 % 2)).collect();
        let still = vec![0.25; tt.len()];
        let found = figure_of_merit_crossings(&still, &still, &z, &tt);
        assert_eq!(found.stride, 4);
        // Half of the pairs differ by 1, so the root mean square is √½, except for pairs within a second.
        assert!((found.figure.value - 0.5f64.sqrt()).abs() < 1e-3);
    }
}
