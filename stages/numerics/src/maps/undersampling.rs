//! Interpolation error of a map, estimated from its own nodes.
//!
//! Each node is predicted by cubic interpolation from the nodes that are one and three spacings away on both sides. The
//! residual is the error of a grid with twice the spacing, in the middle between its nodes. At a height h above its
//! sources, a field is attenuated by exp(−k h) at the wavenumber k [Blakely 1996, (12.8)]. A grid with the spacing d
//! cannot represent wavenumbers above π/d. If the sources are white, the rms error of this grid is therefore
//!
//! E(d) = A exp(−π h/d), which gives E(d) = E(2d) (E(2d) / E(4d))².
//!
//! The formula neglects the error of cubic interpolation at smaller wavenumbers, which matters only where d is far
//! below h. The error is largest around strong anomalies, so each node has the rms error of its neighbourhood. White
//! noise of the nodes gives the same error at every spacing. The estimate includes this noise. It therefore exceeds the
//! noise of an interpolated value.

use super::plane_grid::PlaneGrid;

/// Weights of cubic interpolation in the middle of four nodes: inner pair, outer pair.
const CUBIC: [f64; 2] = [9.0 / 16.0, -1.0 / 16.0];
/// Weight of the squared residual of each direction in the mean over a cell. If every second node is kept in each
/// direction, two thirds of the removed nodes are on edges of cells and one third in the middle.
const BETWEEN: f64 = 2.0 / 3.0;
/// Standard deviation and half width of the Gaussian window of the mean, in nodes.
const WINDOW: (f64, usize) = (1.0, 4);
/// Smallest number of nodes that have both predictions.
const FEWEST: usize = 50;

/// Standard deviation of the error of cubic interpolation around each node, in the unit of the map, by rows; NaN far
/// from known nodes. `None` if the map is too small to estimate the error, or constant.
pub fn interpolation_error(map: &PlaneGrid) -> Option<Vec<f64>> {
    let (fine, coarse) = (squares(map, 1), squares(map, 2));
    let (mut sums, mut count) = ([0.0; 2], 0);
    for (fine, coarse) in fine.iter().zip(&coarse).filter(|(fine, coarse)| fine.is_finite() && coarse.is_finite()) {
        sums = [sums[0] + fine, sums[1] + coarse];
        count += 1;
    }
    let [twice, four] = sums;
    if count < FEWEST || twice <= 0.0 || four <= 0.0 {
        return None;
    }
    // Ratio of the mean squares E(2d)² / E(4d)².
    let factor = (twice / four).min(1.0);
    let known: Vec<bool> = map.values.iter().map(|value| value.is_finite()).collect();
    let mean = averaged(map, &averaged(map, &sums_and_weights(&fine), Axis::East), Axis::North);
    let error = |(at, [sum, weight]): (usize, &[f64; 2])| {
        if known[at] && *weight > 0.0 { factor * (sum / weight).sqrt() } else { f64::NAN }
    };
    Some(mean.iter().enumerate().map(error).collect())
}

#[derive(Clone, Copy)]
enum Axis {
    East,
    North,
}

/// Squared error of the prediction of each node from nodes at `step` and 3 `step`, for an average position in a cell;
/// NaN where it is unknown.
fn squares(map: &PlaneGrid, step: usize) -> Vec<f64> {
    let value = |row: usize, column: usize, axis: Axis| {
        let along = |offset: usize, forward: bool| {
            let moved = |at: usize| if forward { Some(at + offset) } else { at.checked_sub(offset) };
            match axis {
                Axis::East => moved(column).map_or(f64::NAN, |column| map.get(row, column)),
                Axis::North => moved(row).map_or(f64::NAN, |row| map.get(row, column)),
            }
        };
        let pair = |offset: usize| along(offset, false) + along(offset, true);
        (map.get(row, column) - CUBIC[0] * pair(step) - CUBIC[1] * pair(3 * step)).powi(2)
    };
    let at = |row: usize, column: usize| {
        let [east, north] = [Axis::East, Axis::North].map(|axis| value(row, column, axis));
        match (east.is_finite(), north.is_finite()) {
            (true, true) => BETWEEN * (east + north),
            (true, false) => 2.0 * BETWEEN * east,
            (false, true) => 2.0 * BETWEEN * north,
            (false, false) => f64::NAN,
        }
    };
    let columns = map.columns();
    (0..map.rows() * columns).map(|node| at(node / columns, node % columns)).collect()
}

fn sums_and_weights(squares: &[f64]) -> Vec<[f64; 2]> {
    squares.iter().map(|square| if square.is_finite() { [*square, 1.0] } else { [0.0; 2] }).collect()
}

/// Weighted sums over the window along one axis.
fn averaged(map: &PlaneGrid, of: &[[f64; 2]], axis: Axis) -> Vec<[f64; 2]> {
    let (sigma, half) = WINDOW;
    let weights: Vec<f64> = (0..=half).map(|offset| (-0.5 * (offset as f64 / sigma).powi(2)).exp()).collect();
    let (rows, columns) = (map.rows(), map.columns());
    let at = |node: usize| {
        let (row, column) = (node / columns, node % columns);
        let (here, len, stride) = match axis {
            Axis::East => (column, columns, 1),
            Axis::North => (row, rows, columns),
        };
        let first = node - here * stride;
        let range = here.saturating_sub(half)..(here + half + 1).min(len);
        range.fold([0.0; 2], |[sum, weight], other| {
            let ([square, known], by) = (of[first + other * stride], weights[other.abs_diff(here)]);
            [sum + by * square, weight + by * known]
        })
    };
    (0..rows * columns).map(at).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
    use crate::maps::plane_grid::EvenAxis;
    use crate::random::NormalGenerator;

    const FINE_M: f64 = 50.0;
    const NODES: usize = 320;

    /// Field of random vertical dipoles at a depth below the map.
    fn field(depth_m: f64) -> Vec<f64> {
        let mut normals = NormalGenerator::new(11);
        let side_m = NODES as f64 * FINE_M;
        let mut uniform = || 1.2 * side_m * (0.5 * (1.0 + (normals.draw() / 1.6).tanh())) - 0.1 * side_m;
        let sources: Vec<[f64; 3]> =
            (0..120).map(|at| [uniform(), uniform(), if at % 2 == 0 { 1.0 } else { -1.0 }]).collect();
        let at = |node: usize| {
            let (north_m, east_m) = ((node / NODES) as f64 * FINE_M, (node % NODES) as f64 * FINE_M);
            sources
                .iter()
                .map(|[x, y, sign]| {
                    let flat2 = (east_m - x).powi(2) + (north_m - y).powi(2);
                    let r2 = flat2 + depth_m * depth_m;
                    100.0 * sign * depth_m.powi(3) * (2.0 * depth_m * depth_m - flat2) / r2.powf(2.5)
                })
                .sum()
        };
        (0..NODES * NODES).map(at).collect()
    }

    /// Every `step`-th node of the field in each direction.
    fn thinned(all: &[f64], step: usize) -> PlaneGrid {
        let count = NODES / step;
        let axis = EvenAxis { first: 0.0, step: FINE_M * step as f64, len: count };
        let at = |node: usize| all[(node / count) * step * NODES + (node % count) * step];
        PlaneGrid { east_m: axis, north_m: axis, values: (0..count * count).map(at).collect() }
    }

    /// True error of the spline through the nodes of a map, and the estimate of its standard deviation, at all fine
    /// nodes away from the edges.
    fn errors_of(all: &[f64], step: usize) -> Vec<[f64; 2]> {
        let map = thinned(all, step);
        let sigma = interpolation_error(&map).unwrap();
        let count = map.columns();
        let grid = GeographicGrid::of_nodes(count, count, &map.values).unwrap();
        let surface = MapSurface::new(&grid, MapInterpolation::Cubic);
        let edge = 4 * step;
        let mut found = vec![];
        for row in edge..NODES - edge {
            for column in edge..NODES - edge {
                let (north, east) = (row as f64 / step as f64, column as f64 / step as f64);
                let spline = surface.at(north, east);
                let near = sigma[north.round() as usize * count + east.round() as usize];
                found.extend(spline.map(|spline| [spline.value_nt - all[row * NODES + column], near]));
            }
        }
        found
    }

    #[test]
    fn val_the_error_between_nodes_is_that_of_a_known_field() {
        for (depth_m, step) in [(300.0, 4), (300.0, 8), (500.0, 8), (500.0, 16)] {
            let errors = errors_of(&field(depth_m), step);
            let rms =
                |of: usize| (errors.iter().map(|pair| pair[of].powi(2)).sum::<f64>() / errors.len() as f64).sqrt();
            let ratio = rms(1) / rms(0);
            assert!((0.4..2.5).contains(&ratio), "{depth_m} m, {step}: {ratio}, true {}", rms(0));
            if FINE_M * step as f64 > 1.4 * depth_m {
                // The map is too coarse to show where its errors are large.
                continue;
            }
            // The tenth of the map with the largest estimates has more than twice its share of the squared error.
            let mut ordered = errors.clone();
            ordered.sort_by(|a, b| b[1].total_cmp(&a[1]));
            let square = |of: &[[f64; 2]]| of.iter().map(|pair| pair[0] * pair[0]).sum::<f64>();
            let share = square(&ordered[..ordered.len() / 10]) / square(&ordered);
            assert!(share > 0.2, "{depth_m} m, {step}: {share}");
        }
    }

    #[test]
    fn law_the_error_of_white_noise_is_the_noise_and_of_a_polynomial_is_zero() {
        let mut normals = NormalGenerator::new(5);
        let noise: Vec<f64> = (0..NODES * NODES).map(|_| 3.0 * normals.draw()).collect();
        let sigma = interpolation_error(&thinned(&noise, 4)).unwrap();
        let mean = sigma.iter().sum::<f64>() / sigma.len() as f64;
        assert!((mean / 4.4 - 1.0).abs() < 0.1, "{mean}");
        let cubic: Vec<f64> = (0..NODES * NODES).map(|node| ((node % NODES) as f64 / 50.0).powi(3)).collect();
        let sigma = interpolation_error(&thinned(&cubic, 4));
        assert!(sigma.is_none_or(|sigma| sigma.iter().all(|nt| *nt < 1e-9)));
    }

    #[test]
    fn unit_unknown_nodes_and_small_maps_have_no_error() {
        let mut map = thinned(&field(300.0), 4);
        (0..200).for_each(|node| map.values[node] = f64::NAN);
        let sigma = interpolation_error(&map).unwrap();
        assert!(sigma[..200].iter().all(|nt| nt.is_nan()) && sigma[200..].iter().all(|nt| nt.is_finite()));
        assert_eq!(interpolation_error(&map.with(vec![7.0; map.values.len()])), None);
        let axis = EvenAxis { first: 0.0, step: 1.0, len: 6 };
        assert_eq!(interpolation_error(&PlaneGrid { east_m: axis, north_m: axis, values: vec![1.0; 36] }), None);
    }
}
