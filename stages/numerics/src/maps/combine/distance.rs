//! Distance of a known node from the edge of the known area.

use crate::maps::plane_grid::PlaneGrid;
use rayon::prelude::*;

/// The distance in metres from each node to the nearest unknown node; infinite if all nodes are known. The border of
/// the grid is not an edge. Computes the exact Euclidean distance in linear time. [Felzenszwalb and Huttenlocher 2012,
/// Theory of Computing 8]
pub(super) fn distance_to_unknown(values: &[f64], target: &PlaneGrid) -> Vec<f64> {
    let (rows, width) = (target.rows(), target.columns());
    let (north_m, east_m) = (target.north_m.step, target.east_m.step);
    // Distances along each column are computed first, in northward steps.
    let mut steps: Vec<f64> = values.iter().map(|value| if value.is_nan() { 0.0 } else { f64::INFINITY }).collect();
    for row in 1..rows {
        let (before, here) = steps.split_at_mut(row * width);
        nearer(&before[(row - 1) * width..], &mut here[..width]);
    }
    for row in (1..rows).rev() {
        let (here, after) = steps.split_at_mut(row * width);
        nearer(&after[..width], &mut here[(row - 1) * width..]);
    }
    steps.par_chunks_exact_mut(width).for_each(|row| {
        let heights: Vec<f64> = row.iter().map(|steps| (steps * north_m).powi(2)).collect();
        lower_envelope(&heights, east_m, row);
    });
    steps
}

fn nearer(from: &[f64], to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = to.min(from + 1.0));
}

/// Square root of the minimum of `heights[j] + (east (i - j))²` over j, for each i.
fn lower_envelope(heights: &[f64], east_m: f64, out: &mut [f64]) {
    // Parabolas of the envelope from west to east, each with the position from which it is the lowest.
    let mut envelope: Vec<(usize, f64)> = Vec::with_capacity(heights.len());
    let lifted = |j: usize| heights[j] + (east_m * j as f64).powi(2);
    for j in (0..heights.len()).filter(|j| heights[*j].is_finite()) {
        let mut from = f64::NEG_INFINITY;
        while let Some((last, since)) = envelope.last() {
            from = (lifted(j) - lifted(*last)) / (2.0 * east_m * east_m * (j - last) as f64);
            if from > *since {
                break;
            }
            envelope.pop();
            from = f64::NEG_INFINITY;
        }
        envelope.push((j, from));
    }
    let mut at = 0;
    for (i, out) in out.iter_mut().enumerate() {
        while envelope.get(at + 1).is_some_and(|(_, from)| *from <= i as f64) {
            at += 1;
        }
        *out = match envelope.get(at) {
            Some((j, _)) => (heights[*j] + (east_m * i.abs_diff(*j) as f64).powi(2)).sqrt(),
            None => f64::INFINITY,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::maps::plane_grid::EvenAxis;

    #[test]
    fn law_the_distance_is_to_the_nearest_unknown_node() {
        let target = PlaneGrid {
            east_m: EvenAxis { first: 0.0, step: 70.0, len: 23 },
            north_m: EvenAxis { first: 0.0, step: 100.0, len: 17 },
            values: Vec::new(),
        };
        let values: Vec<f64> = (0..17 * 23).map(|i| if (i * i + 3 * i) % 41 == 7 { f64::NAN } else { 1.0 }).collect();
        let distances = distance_to_unknown(&values, &target);
        for (node, distance) in distances.iter().enumerate() {
            let unknown = (0..values.len()).filter(|other| values[*other].is_nan());
            let far = |other: usize| {
                let north = 100.0 * (node / 23).abs_diff(other / 23) as f64;
                (70.0 * (node % 23).abs_diff(other % 23) as f64).hypot(north)
            };
            let expected = unknown.map(far).fold(f64::INFINITY, f64::min);
            // The limit exceeds the rounding errors of squared distances of some kilometres.
            assert!((distance - expected).abs() < 1e-9, "{node}: {distance} {expected}");
        }
        assert!(distance_to_unknown(&[1.0; 17 * 23], &target).iter().all(|d| d.is_infinite()));
    }
}
