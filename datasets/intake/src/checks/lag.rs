//! Lag of one magnetometer of an aircraft against another.

use numerics::signal::lag::{SignalLag, lag_of};

use super::sampling;

/// Maximum lag of the search, in seconds and in samples.
const MOST_S: f64 = 2.0;
const MOST_SAMPLES: f64 = 100.0;
/// Maximum number of samples used from the longest stretch without a gap.
const SAMPLES: usize = 50_000;
/// Minimum correlation. Magnetometers at different places measure different aircraft fields, which shifts the peak.
const LEAST_CORRELATION: f64 = 0.9;
/// The lag is ambiguous, for example with mains hum, if a second peak is at least this high relative to the highest
/// peak.
const NEXT_PEAK: f64 = 0.8;
/// Maximum standard error of the lag, in samples.
const KNOWN: f64 = 0.1;

/// The lag of `signal` against `reference`, both at the times `tt`, from the cross-correlation of their differences
/// from sample to sample. The differences remove slow changes, whose correlation has a flat peak. If `turned`, the
/// signals may have opposite signs. `None` if the correlation is too low or the lag is ambiguous.
pub fn lag(reference: &[f64], signal: &[f64], tt: &[f64], turned: bool) -> Option<SignalLag> {
    let rate_hz = sampling::sampling(tt)?.rate_hz;
    let breaks = sampling::breaks(tt);
    let (mut longest, mut start) = (0..0, 0);
    for row in 1..=tt.len() {
        if breaks.get(row).copied().unwrap_or(true) {
            if row - start > longest.len() {
                longest = start..row;
            }
            start = row;
        }
    }
    let rows = longest.start..longest.end.min(longest.start + SAMPLES);
    let differences =
        |x: &[f64]| -> Option<Vec<f64>> { Some(x.get(rows.clone())?.windows(2).map(|w| w[1] - w[0]).collect()) };
    let (reference, signal) = (differences(reference)?, differences(signal)?);
    let found = lag_of(&reference, &signal, rate_hz, MOST_S.min(MOST_SAMPLES / rate_hz), turned).ok()?;
    let clear = found.correlation.abs() >= LEAST_CORRELATION && found.next_peak <= NEXT_PEAK;
    (clear && found.sd_s * rate_hz <= KNOWN).then_some(found)
}

#[cfg(test)]
mod tests {
    use numerics::random::NormalGenerator;

    use super::*;

    fn manoeuvres(t: f64) -> f64 {
        50_000.0
            + 40.0 * (0.9 * t).sin()
            + 30.0 * (2.3 * t + 1.0).sin()
            + 25.0 * (4.1 * t).cos()
            + 9.0 * (5.7 * t).sin()
    }

    #[test]
    fn unit_the_lag_is_found_next_to_a_gap() {
        let tt: Vec<f64> = (0..4000).map(|k| f64::from(k) * 0.1 + if k >= 500 { 30.0 } else { 0.0 }).collect();
        let mut normals = NormalGenerator::new(3);
        for late_s in [0.0, 0.07, -0.23, 0.4] {
            let one: Vec<f64> = tt.iter().map(|t| manoeuvres(*t) + 0.05 * normals.draw()).collect();
            let two: Vec<f64> = tt.iter().map(|t| 0.8 * manoeuvres(t - late_s) + 0.05 * normals.draw()).collect();
            let found = lag(&one, &two, &tt, false).map_or(f64::NAN, |lag| lag.lag_s);
            assert!((found - late_s).abs() < 0.002, "{found} {late_s}");
        }
    }

    #[test]
    fn unit_unrelated_signals_have_no_lag() {
        let tt: Vec<f64> = (0..4000).map(|k| f64::from(k) * 0.1).collect();
        let mut normals = NormalGenerator::new(5);
        let noise: Vec<f64> = tt.iter().map(|_| normals.draw()).collect();
        let signal: Vec<f64> = tt.iter().map(|t| manoeuvres(*t)).collect();
        assert!(lag(&signal, &noise, &tt, false).is_none());
        // The cross-correlation of hum has a peak at every period.
        let hum: Vec<f64> = tt.iter().map(|t| (std::f64::consts::TAU * 1.3 * t).sin()).collect();
        let later: Vec<f64> = tt.iter().map(|t| (std::f64::consts::TAU * 1.3 * (t - 0.1)).sin()).collect();
        assert!(lag(&hum, &later, &tt, false).is_none());
        assert!(lag(&signal, &[50_000.0; 4000], &tt, false).is_none());
        let turned: Vec<f64> = signal.iter().map(|x| -x).collect();
        assert!(lag(&signal, &turned, &tt, false).is_none() && lag(&signal, &turned, &tt, true).is_some());
        assert!(lag(&[], &[], &[], false).is_none());
    }
}
