//! Akima's piecewise cubic interpolation.

use super::SamplePosition;

/// Interpolates `x` at the times `tt` for each position; each part between gaps longer than `max_gap_s` has a separate
/// curve.
pub(super) fn interpolate(tt: &[f64], x: &[f64], places: &[SamplePosition], max_gap_s: f64) -> Vec<f64> {
    let slopes = slopes(tt, x, max_gap_s);
    let value = |place: &SamplePosition| {
        let (left, weight) = (place.left, place.weight);
        if weight.is_nan() {
            return f64::NAN;
        }
        if weight == 0.0 {
            return x[left];
        }
        let (step, rise) = (tt[left + 1] - tt[left], x[left + 1] - x[left]);
        let (start, end) = (slopes[left] * step, slopes[left + 1] * step);
        let curve = (start + end - 2.0 * rise) * weight + (3.0 * rise - 2.0 * start - end);
        x[left] + weight * (start + weight * curve)
    };
    places.iter().map(value).collect()
}

/// The slope at every sample.
fn slopes(tt: &[f64], x: &[f64], max_gap_s: f64) -> Vec<f64> {
    let mut slopes = Vec::with_capacity(x.len());
    while slopes.len() < x.len() {
        let start = slopes.len();
        let gap = |k: &usize| tt[k + 1] - tt[*k] > max_gap_s;
        let end = (start..x.len() - 1).find(gap).map_or(x.len(), |k| k + 1);
        slopes.extend(part_slopes(&tt[start..end], &x[start..end]));
    }
    slopes
}

/// Slopes of one part. The two chords next to a sample are averaged; the weight of each is the difference between the
/// two chords on the other side. Two chords are added at each end in arithmetic progression.
fn part_slopes(tt: &[f64], x: &[f64]) -> Vec<f64> {
    let chord = |k: usize| (x[k + 1] - x[k]) / (tt[k + 1] - tt[k]);
    let inner: Vec<f64> = (0..x.len() - 1).map(chord).collect();
    let (Some(&first), Some(&last)) = (inner.first(), inner.last()) else {
        return vec![0.0; x.len()];
    };
    let second = inner.get(1).copied().unwrap_or(first);
    let before_last = inner.iter().rev().nth(1).copied().unwrap_or(last);
    let (fall, rise) = (first - second, last - before_last);
    let chords: Vec<f64> =
        [first + 2.0 * fall, first + fall].into_iter().chain(inner).chain([last + rise, last + 2.0 * rise]).collect();
    let slope = |m: &[f64]| {
        let (early, late) = ((m[1] - m[0]).abs(), (m[3] - m[2]).abs());
        if early + late == 0.0 { (m[1] + m[2]) / 2.0 } else { (late * m[1] + early * m[2]) / (early + late) }
    };
    chords.windows(4).map(slope).collect()
}
