//! The values and slopes of a stack, node by node.

use crate::maps::map_surface::GeographicGrid;
use rayon::prelude::*;

/// Values of each map. A node that is unknown at one level is NaN at every level.
pub(super) fn union_of_unknown(maps: &[GeographicGrid]) -> Vec<Vec<f64>> {
    let nodes = maps.first().map_or(0, |map| map.values().len());
    let unknown: Vec<bool> =
        (0..nodes).into_par_iter().map(|node| maps.iter().any(|map| map.values()[node].is_nan())).collect();
    let known = |map: &GeographicGrid| {
        let values = map.values().par_iter().zip(&unknown);
        values.map(|(value, unknown)| if *unknown { f64::NAN } else { *value }).collect()
    };
    maps.iter().map(known).collect()
}

/// Slopes, per metre, of the natural cubic spline through the values of each node at ascending heights. With the steps
/// `h` and the differences d, `s[i-1]/h[i-1] + 2 s[i] (1/h[i-1] + 1/h[i]) + s[i+1]/h[i] = 3 (d[i-1]/h[i-1]² +
/// d[i]/h[i]²)`, and at the ends `2 s[0] + s[1] = 3 d[0]/h[0]`. [de Boor, A Practical Guide to Splines, IV]
pub(super) fn natural_slopes(heights_m: &[f64], values: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let levels = heights_m.len();
    let per_m: Vec<f64> = heights_m.windows(2).map(|pair| 1.0 / (pair[1] - pair[0])).collect();
    // Steps past the ends have zero weight, so the first and last rows are those of the natural spline.
    let before = |level: usize| level.checked_sub(1).map_or(0.0, |step| per_m[step]);
    let after = |level: usize| per_m.get(level).copied().unwrap_or(0.0);
    let mut pivots = vec![0.0; levels];
    let mut slopes: Vec<Vec<f64>> = Vec::with_capacity(levels);
    for level in 0..levels {
        let (low, high) = (before(level), after(level));
        let eliminated = if level > 0 { low * pivots[level - 1] * low } else { 0.0 };
        pivots[level] = 1.0 / (2.0 * (low + high) - eliminated);
        let (here, under) = (&values[level], &values[level.saturating_sub(1)]);
        let over = &values[(level + 1).min(levels - 1)];
        let previous = slopes.last();
        let row = |node: usize| {
            let rise = 3.0 * ((here[node] - under[node]) * low * low + (over[node] - here[node]) * high * high);
            (rise - previous.map_or(0.0, |slopes| low * slopes[node])) * pivots[level]
        };
        slopes.push((0..here.len()).into_par_iter().map(row).collect());
    }
    for level in (0..levels - 1).rev() {
        let (here, over) = slopes.split_at_mut(level + 1);
        let weight = after(level) * pivots[level];
        here[level].par_iter_mut().zip(&over[0]).for_each(|(slope, above)| *slope -= weight * above);
    }
    slopes
}
