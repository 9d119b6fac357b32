//! Notch filters: narrow stop bands, such as those of power lines and of their aliases.

use std::f64::consts::PI;

use super::{BiquadSection, FilterError, ZeroPhaseFilter, cascade::BiquadCascade};

/// Alias frequency, from 0 to half of the rate, of a sinusoid of `frequency_hz` in samples at `rate_hz` (above 0).
pub fn alias_hz(frequency_hz: f64, rate_hz: f64) -> f64 {
    let turn = frequency_hz.rem_euclid(rate_hz);
    turn.min(rate_hz - turn)
}

impl ZeroPhaseFilter {
    /// One second-order notch at each of `frequencies_hz` for samples at `rate_hz`, run forwards and backwards.
    ///
    /// The gain is 0 at a notch frequency, 1/2 at a distance of `width_hz`/2, and 1 for a constant. The poles have the
    /// same radius as the poles of scipy's `iirnotch(f, f / width_hz)`: [Orfanidis 1995, "Introduction to signal
    /// processing", section 11.3]
    ///
    /// ```text
    /// H(z) = g (1 - 2 cos(w) z^-1 + z^-2) / (1 - 2 g cos(w) z^-1 + (2 g - 1) z^-2)
    /// w = 2 pi f / rate,    g = 1 / (1 + tan(pi width / rate))
    /// ```
    ///
    /// The padding is six samples per section or the inverse of the width, whichever is longer. A notch rings for about
    /// the inverse of the width, so a part of the sinusoid remains near each end, over about this time.
    ///
    /// # Errors
    /// Fails for a sample rate or width that is not a finite number above 0. Also fails with [`FilterError::NoCorner`]
    /// without frequencies. Also fails for a frequency within half the width of 0 Hz or of half the sample rate.
    pub fn notches(frequencies_hz: &[f64], width_hz: f64, rate_hz: f64) -> Result<Self, FilterError> {
        if !(rate_hz > 0.0 && rate_hz.is_finite()) {
            return Err(FilterError::Rate { rate_hz });
        }
        if !(width_hz > 0.0 && width_hz.is_finite()) {
            return Err(FilterError::CornerNotPositive { corner_hz: width_hz });
        }
        if frequencies_hz.is_empty() {
            return Err(FilterError::NoCorner);
        }
        let (mut gain, mut sections) = (1.0, Vec::with_capacity(frequencies_hz.len()));
        for frequency_hz in frequencies_hz {
            let (low_hz, high_hz) = (frequency_hz - 0.5 * width_hz, frequency_hz + 0.5 * width_hz);
            if low_hz.is_nan() || low_hz <= 0.0 {
                return Err(FilterError::CornerNotPositive { corner_hz: low_hz });
            }
            if high_hz >= 0.5 * rate_hz {
                return Err(FilterError::CornerAboveNyquist { corner_hz: high_hz, nyquist_hz: 0.5 * rate_hz, rate_hz });
            }
            let g = 1.0 / (1.0 + (PI * width_hz / rate_hz).tan());
            let b1 = -2.0 * (2.0 * PI * frequency_hz / rate_hz).cos();
            gain *= g;
            sections.push(BiquadSection { b1, b2: 1.0, a1: g * b1, a2: 2.0 * g - 1.0 });
        }
        let ring = (rate_hz / width_hz).ceil() as usize;
        let padding = ring.max(6 * sections.len());
        Ok(Self { cascade: BiquadCascade::new(gain, sections), padding })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::reference_csv::columns;

    #[test]
    fn val_notches_equal_scipy() {
        let table = columns(include_str!("../../../reference/signal/notch.csv"));
        for (name, frequencies, width_hz) in [("one", &[50.0][..], 2.0), ("three", &[50.0, 60.0, 10.0], 1.5)] {
            let filter = ZeroPhaseFilter::notches(frequencies, width_hz, 160.0).unwrap();
            let ours = filter.apply(&table["x"]).unwrap();
            let worst = ours.iter().zip(&table[name]).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
            // The limit exceeds the accumulated rounding of 50,000 nT (7e-12) in each section and sample.
            assert!(worst < 1e-8, "{name}: {worst:e} nT");
        }
    }

    #[test]
    fn law_the_gain_is_zero_at_the_frequency_half_at_half_of_the_width_and_one_for_a_constant() {
        let (rate_hz, width_hz) = (160.0, 2.0);
        let filter = ZeroPhaseFilter::notches(&[50.0], width_hz, rate_hz).unwrap();
        // The bilinear transform preserves the width between the two points of half amplitude, but shifts their
        // frequencies slightly.
        let left = |hz: f64| {
            let wave = |k: i32| 10.0 * (TAU * hz * f64::from(k) / rate_hz).cos();
            let x: Vec<f64> = (-4000..=4000).map(|k| 50_000.0 + wave(k)).collect();
            (filter.apply(&x).unwrap()[4000] - 50_000.0) / 10.0
        };
        assert!(left(50.0).abs() < 1e-9, "{}", left(50.0));
        for hz in [49.0, 51.0] {
            assert!((left(hz) - 0.5).abs() < 0.02, "{hz}: {}", left(hz));
        }
        for hz in [1.0, 30.0, 75.0] {
            assert!((left(hz) - 1.0).abs() < 0.01, "{hz}: {}", left(hz));
        }
    }

    #[test]
    fn law_an_alias_has_the_samples_of_its_sinusoid() {
        for (hz, rate_hz, seen_hz) in
            [(50.0, 160.0, 50.0), (100.0, 160.0, 60.0), (150.0, 160.0, 10.0), (60.0, 25.0, 10.0)]
        {
            assert_eq!(alias_hz(hz, rate_hz), seen_hz);
            for k in 0..40 {
                let sample = |f: f64| (TAU * f * f64::from(k) / rate_hz).cos();
                assert!((sample(hz) - sample(seen_hz)).abs() < 1e-11, "{hz} {k}");
            }
        }
        assert_eq!(alias_hz(50.0, 10.0), 0.0);
    }

    #[test]
    fn unit_a_notch_that_reaches_zero_or_nyquist_is_rejected() {
        assert!(ZeroPhaseFilter::notches(&[], 1.0, 10.0).is_err());
        for frequency_hz in [0.0, 0.4, 4.6, 5.0, 7.0, f64::NAN] {
            assert!(ZeroPhaseFilter::notches(&[frequency_hz], 1.0, 10.0).is_err(), "{frequency_hz}");
        }
        assert!(
            ZeroPhaseFilter::notches(&[2.0], 0.0, 10.0).is_err()
                && ZeroPhaseFilter::notches(&[2.0], 1.0, f64::NAN).is_err()
        );
        assert!(ZeroPhaseFilter::notches(&[2.0], 1.0, 10.0).is_ok());
    }
}
