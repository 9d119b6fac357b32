#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::columns;

fn samples() -> Vec<f64> {
    columns(include_str!("../../../reference/signal/spectrum_samples.csv"))["x"].clone()
}

#[test]
fn val_densities_equal_scipy() {
    let even = columns(include_str!("../../../reference/signal/spectrum_64.csv"));
    let odd = columns(include_str!("../../../reference/signal/spectrum_65.csv"));
    let cases = [
        (&even, "hann", 64, SpectralTaper::Hann),
        (&even, "hamming", 64, SpectralTaper::Hamming),
        (&odd, "hann", 65, SpectralTaper::Hann),
    ];
    for (table, name, segment, window) in cases {
        let ours = welch(&samples(), 20.0, segment, window).unwrap();
        assert_eq!(ours.frequency_hz.len(), table["frequency"].len());
        for (ours, scipy) in ours.frequency_hz.iter().zip(&table["frequency"]) {
            // Both frequencies are results of divisions with different rounding.
            assert!((ours - scipy).abs() <= 2.0 * f64::EPSILON * scipy);
        }
        for (ours, scipy) in ours.density.iter().zip(&table[name]) {
            // The tolerance is the rounding error of two transforms of values near 1. The bin at 0 Hz holds the
            // residual of the mean.
            assert!((ours - scipy).abs() < 1e-13 * (1.0 + scipy), "{name} {segment}");
        }
    }
}

#[test]
fn law_the_integral_is_the_variance() {
    // Zero-mean noise, so that the taper does not matter. Parseval's theorem holds on average over many segments, to 2
    // % over 100 segments.
    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let x: Vec<f64> = (0..6400).map(|_| noise()).collect();
    let spectrum = welch(&x, 50.0, 128, SpectralTaper::Hann).unwrap();
    let integral: f64 = spectrum.density.iter().sum::<f64>() * 50.0 / 128.0;
    assert!((integral * 12.0 - 1.0).abs() < 0.03, "{integral}");
    assert_eq!(spectrum.segments, 99);
}

#[test]
fn unit_segments_with_gaps_are_excluded_and_counted() {
    let mut x = samples();
    let tail = welch(&x[64..], 20.0, 64, SpectralTaper::Hann).unwrap();
    x[10] = f64::NAN;
    let gap = welch(&x, 20.0, 64, SpectralTaper::Hann).unwrap();
    assert_eq!((gap.left_out, gap.segments), (1, 7));
    assert_ne!(gap.density, tail.density);
    x[40] = f64::INFINITY;
    let gap = welch(&x, 20.0, 64, SpectralTaper::Hann).unwrap();
    assert_eq!(gap.left_out, 2);
    assert_eq!(gap.density, tail.density);
}

#[test]
fn unit_invalid_series_are_rejected() {
    let error = |x: &[f64], rate, segment| welch(x, rate, segment, SpectralTaper::Hann).unwrap_err().to_string();
    assert!(error(&[1.0; 9], 10.0, 10).contains("the 9 samples have no 10 consecutive finite"));
    assert!(error(&[f64::NAN; 20], 10.0, 10).contains("use shorter"));
    assert!(error(&[1.0; 9], 0.0, 4).contains("above 0 Hz"));
    assert!(error(&[1.0; 9], 1.0, 1).contains("at least 2"));
}
