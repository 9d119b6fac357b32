//! Noriega's figure of merit: residual signal of the manoeuvres of a calibration box after compensation.
//!
//! A box has four headings. On each heading the aircraft flies a pitch, a roll and a yaw manoeuvre, each a few periods
//! of a sinusoid. The index is the sum over these twelve manoeuvres of the signal's mean peak-to-peak amplitude.
//! [Noriega 2011, "Performance measures in aeromagnetic compensation", The Leading Edge 30(10)]

use crate::angle::{unwrapped_deg, wrap_deg};
use std::ops::Range;

use crate::regression::statistics::SampleStatistic;

/// Minimum swing of a manoeuvre between successive extremes, in degrees.
const LEAST_SWING_DEG: f64 = 3.0;
/// Maximum time between extremes of one manoeuvre, in seconds.
const SLOWEST_HALF_S: f64 = 12.0;
/// Minimum time between extremes of a manoeuvre, in seconds; faster changes are gusts.
const FASTEST_HALF_S: f64 = 1.0;
/// Minimum number of extremes of a manoeuvre: slightly more than two periods.
const LEAST_EXTREMES: usize = 5;
/// Maximum ratio between successive swings, and between successive half periods, of a manoeuvre. Gusts are less
/// regular.
const REGULAR: f64 = 1.7;
/// Half of the averaging window for the mean attitude of a manoeuvre, in seconds.
const TREND_S: f64 = 15.0;

/// Axis of rotation of a manoeuvre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ManoeuvreAxis {
    /// Rotation about the longitudinal axis.
    Roll,
    /// Rotation about the lateral axis.
    Pitch,
    /// Rotation about the vertical axis.
    Yaw,
}

/// A roll, pitch or yaw manoeuvre of a calibration box.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxManoeuvre {
    /// The axis.
    pub axis: ManoeuvreAxis,
    /// Mean heading during the manoeuvre, in degrees from north.
    pub heading_deg: f64,
    /// Rows of the extremes of the manoeuvre, alternately high and low.
    pub extremes: Vec<usize>,
    /// Mean swing between successive extremes, in degrees.
    pub swing_deg: f64,
}

impl BoxManoeuvre {
    /// Rows from the first extreme to the last.
    fn rows(&self) -> Range<usize> {
        let ends = self.extremes.first().copied().zip(self.extremes.last().copied());
        ends.map_or(0..0, |(first, last)| first..last + 1)
    }
}

/// Manoeuvres found in an attitude record (roll, pitch and yaw in degrees at the times `tt_s`), in order of time.
///
/// A manoeuvre is a sequence of five or more extremes of one axis, with similar swings of at least 3 degrees and
/// similar spacing. If two axes swing at the same time, the manoeuvre belongs to the axis with the larger swing.
pub fn manoeuvres(tt_s: &[f64], attitude_deg: [&[f64]; 3]) -> Vec<BoxManoeuvre> {
    let mut found: Vec<BoxManoeuvre> = vec![];
    for (axis, angle) in [ManoeuvreAxis::Roll, ManoeuvreAxis::Pitch, ManoeuvreAxis::Yaw].into_iter().zip(attitude_deg) {
        let swing = about_trend(tt_s, &unwrapped_deg(angle));
        for extremes in regular_chains(tt_s, &swing) {
            let rows = extremes[0]..extremes[extremes.len() - 1] + 1;
            let swings = extremes.windows(2).map(|w| (swing[w[1]] - swing[w[0]]).abs());
            let swing_deg = swings.sum::<f64>() / (extremes.len() - 1) as f64;
            found.push(BoxManoeuvre {
                axis,
                heading_deg: mean_heading_deg(&attitude_deg[2][rows]),
                extremes,
                swing_deg,
            });
        }
    }
    found.sort_by(|a, b| b.swing_deg.total_cmp(&a.swing_deg));
    let mut kept: Vec<BoxManoeuvre> = vec![];
    for one in found {
        let overlaps = |k: &BoxManoeuvre| k.rows().start < one.rows().end && one.rows().start < k.rows().end;
        if !kept.iter().any(overlaps) {
            kept.push(one);
        }
    }
    kept.sort_by_key(|m| m.rows().start);
    kept
}

/// Figure of merit of a band-passed signal over the manoeuvres of a box, in the signal's unit, with the number of
/// manoeuvres used. NaN unless pitch, roll and yaw manoeuvres exist on four headings at right angles.
pub fn figure_of_merit(signal: &[f64], manoeuvres: &[BoxManoeuvre]) -> SampleStatistic {
    let Some(first) = manoeuvres.first() else { return SampleStatistic { value: f64::NAN, n: 0 } };
    let (mut sums, mut counts) = ([0.0; 12], [0usize; 12]);
    for one in manoeuvres {
        let quarter = (wrap_deg(one.heading_deg - first.heading_deg) / 90.0).round().rem_euclid(4.0) as usize;
        let Some(amplitude) = mean_peak_to_peak(signal, &one.extremes) else { continue };
        let group = 3 * quarter + one.axis as usize;
        sums[group] += amplitude;
        counts[group] += 1;
    }
    let value = sums.iter().zip(counts).map(|(sum, n)| if n > 0 { sum / n as f64 } else { f64::NAN }).sum();
    SampleStatistic { value, n: counts.iter().sum() }
}

/// Difference between the largest and the smallest value of a period, averaged over the periods of a manoeuvre; `None`
/// if a value is not finite.
fn mean_peak_to_peak(signal: &[f64], extremes: &[usize]) -> Option<f64> {
    let periods = extremes.windows(3).step_by(2).map(|w| {
        let part = signal.get(w[0]..=w[2])?;
        let ends = part.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
        part.iter().all(|x| x.is_finite()).then_some(ends.1 - ends.0)
    });
    let all: Option<Vec<f64>> = periods.collect();
    all.filter(|a| !a.is_empty()).map(|a| a.iter().sum::<f64>() / a.len() as f64)
}

fn mean_heading_deg(yaw_deg: &[f64]) -> f64 {
    let (sin, cos) = yaw_deg.iter().fold((0.0, 0.0), |(s, c), y| (s + y.to_radians().sin(), c + y.to_radians().cos()));
    f64::atan2(sin, cos).to_degrees()
}

/// `x` minus its mean over the samples within [`TREND_S`] before and after each sample.
fn about_trend(tt_s: &[f64], x: &[f64]) -> Vec<f64> {
    let n = tt_s.len().min(x.len());
    let (mut from, mut to, mut sum) = (0, 0, 0.0);
    let one = |i: usize| {
        while to < n && tt_s[to] <= tt_s[i] + TREND_S {
            sum += x[to];
            to += 1;
        }
        while tt_s[from] < tt_s[i] - TREND_S {
            sum -= x[from];
            from += 1;
        }
        x[i] - sum / (to - from) as f64
    };
    (0..n).map(one).collect()
}

/// Turning points that differ by at least [`LEAST_SWING_DEG`], high and low alternating.
fn extremes(x: &[f64]) -> Vec<usize> {
    let mut out: Vec<usize> = vec![];
    let (mut high, mut low) = (0, 0);
    // 1 while rising to a high, -1 while falling to a low, 0 before the first swing.
    let mut rising = 0;
    for (i, v) in x.iter().enumerate() {
        if *v > x[high] {
            high = i;
        }
        if *v < x[low] {
            low = i;
        }
        if rising >= 0 && x[high] - v >= LEAST_SWING_DEG {
            out.push(high);
            (rising, low) = (-1, i);
        } else if rising <= 0 && v - x[low] >= LEAST_SWING_DEG {
            out.push(low);
            (rising, high) = (1, i);
        }
    }
    out
}

fn regular_chains(tt_s: &[f64], x: &[f64]) -> Vec<Vec<usize>> {
    let all = extremes(x);
    let close = |a: f64, b: f64| a < REGULAR * b && b < REGULAR * a;
    let (mut chains, mut chain): (Vec<Vec<usize>>, Vec<usize>) = (vec![], vec![]);
    for e in all {
        let fits = match chain.as_slice() {
            [] => true,
            [one] => (FASTEST_HALF_S..=SLOWEST_HALF_S).contains(&(tt_s[e] - tt_s[*one])),
            [.., a, b] => {
                close(tt_s[e] - tt_s[*b], tt_s[*b] - tt_s[*a]) && close((x[e] - x[*b]).abs(), (x[*b] - x[*a]).abs())
            }
        };
        if !fits {
            // The last extreme may be the first of the next manoeuvre.
            let begins = |l: &usize| (FASTEST_HALF_S..=SLOWEST_HALF_S).contains(&(tt_s[e] - tt_s[*l]));
            let last = chain.last().copied().filter(begins);
            chains.push(std::mem::take(&mut chain));
            chain.extend(last);
        }
        chain.push(e);
    }
    chains.push(chain);
    chains.retain(|c| c.len() >= LEAST_EXTREMES);
    chains
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A box with turns, sampled at 10 Hz: time, attitude, and a signal with the sensitivity `nt_per_deg` to each axis.
    /// Each manoeuvre has three periods of 6 s.
    fn square(amplitude_deg: [f64; 3], nt_per_deg: [f64; 3]) -> (Vec<f64>, [Vec<f64>; 3], Vec<f64>) {
        let leg_s = 100.0;
        let tt: Vec<f64> = (0..4800).map(|k| 0.1 * f64::from(k)).collect();
        let mut attitude: [Vec<f64>; 3] = Default::default();
        let mut signal = vec![];
        for t in &tt {
            let leg = (t / 120.0).floor();
            let since = t - 120.0 * leg;
            // Each leg is followed by a banked turn of twenty seconds.
            let turned = ((since - leg_s) / 20.0).clamp(0.0, 1.0);
            let bank = if turned > 0.0 { 20.0 * (0.5 * TAU * turned).sin() } else { 0.0 };
            let mut swing = [0.0; 3];
            for (slot, axis) in [1, 0, 2].into_iter().enumerate() {
                let begun = since - 10.0 - 28.0 * slot as f64;
                if (0.0..18.0).contains(&begun) {
                    swing[axis] = amplitude_deg[axis] * (TAU * begun / 6.0).sin();
                }
            }
            let steady = [bank, 2.0, wrap_deg(30.0 + 90.0 * (leg + turned))];
            for axis in 0..3 {
                attitude[axis].push(steady[axis] + swing[axis]);
            }
            signal.push((0..3).map(|k| nt_per_deg[k] * swing[k]).sum());
        }
        (tt, attitude, signal)
    }

    #[test]
    fn law_the_index_is_the_sum_of_twelve_amplitudes() {
        let (tt, attitude, signal) = square([10.0, 5.0, 5.0], [0.1, 0.3, 0.02]);
        let found = manoeuvres(&tt, attitude.each_ref().map(Vec::as_slice));
        assert_eq!(found.len(), 12, "{found:?}");
        let order = [ManoeuvreAxis::Pitch, ManoeuvreAxis::Roll, ManoeuvreAxis::Yaw];
        assert!(found.iter().zip(order.iter().cycle()).all(|(m, axis)| m.axis == *axis));
        let merit = figure_of_merit(&signal, &found);
        assert_eq!(merit.n, 12);
        // The peak-to-peak value is twice the amplitude times the sensitivity. Samples lie within 0.05 s of a peak: an
        // error of 1e-3 at a period of 6 s.
        let expected = 4.0 * 2.0 * (10.0 * 0.1 + 5.0 * 0.3 + 5.0 * 0.02);
        assert!((merit.value / expected - 1.0).abs() < 2e-3, "{} {expected}", merit.value);
    }

    #[test]
    fn unit_an_incomplete_box_has_no_index() {
        let (tt, attitude, signal) = square([10.0, 5.0, 0.0], [0.1, 0.3, 0.02]);
        let found = manoeuvres(&tt, attitude.each_ref().map(Vec::as_slice));
        assert_eq!(found.len(), 8);
        assert!(figure_of_merit(&signal, &found).value.is_nan());
        assert_eq!(figure_of_merit(&signal, &[]).n, 0);
    }

    #[test]
    fn unit_gusts_and_turns_are_not_manoeuvres() {
        let (tt, mut attitude, _) = square([0.0; 3], [0.0; 3]);
        let mut normals = crate::random::NormalGenerator::new(5);
        // Gusts of 1.5 degrees with a continuous rate, as for an airframe with inertia: two poles with a time constant
        // of 2 s.
        let (mut force, mut gust) = (0.0, 0.0);
        for roll in &mut attitude[0] {
            force = 0.95 * force + (1.0_f64 - 0.95 * 0.95).sqrt() * normals.draw();
            gust = 0.95 * gust + 0.05 * force;
            *roll += 1.5 * 2.0_f64.sqrt() * gust;
        }
        let found = manoeuvres(&tt, attitude.each_ref().map(Vec::as_slice));
        assert!(found.len() <= 2, "{} of 480 s", found.len());
    }
}
