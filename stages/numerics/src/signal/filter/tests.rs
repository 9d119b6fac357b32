#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::columns;

fn band(low_hz: f64, high_hz: f64) -> FilterBand {
    FilterBand::Band { low_hz, high_hz }
}

fn magnav_input() -> Vec<f64> {
    (1..=60).map(|i| (0.3 * f64::from(i)).sin() + 0.01 * f64::from(i)).collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |worst, (a, b)| worst.max((a - b).abs()))
}

#[test]
fn val_zero_phase_filters_equal_scipy() {
    let table = columns(include_str!("../../../reference/signal/filters.csv"));
    let low = |high_hz| FilterBand::Low { high_hz };
    let high = |low_hz| FilterBand::High { low_hz };
    let designs = [
        ("band_4", band(0.1, 0.9), 4),
        ("band_1", band(0.5, 2.0), 1),
        ("band_3", band(0.4, 4.5), 3),
        ("band_6", band(0.8, 3.0), 6),
        ("low_4", low(0.2), 4),
        ("low_5", low(1.5), 5),
        ("high_4", high(0.5), 4),
        ("high_7", high(2.5), 7),
    ];
    for (name, band, order) in designs {
        let filter = ZeroPhaseFilter::new(band, 10.0, order).unwrap();
        let ours = filter.apply(&table["x"]).unwrap();
        let worst = largest_difference(&ours, &table[name]);
        // Both filters round a field of 50,000 nT to 7e-12 nT in every section and at every sample. A low corner
        // amplifies this up to some hundred times.
        assert!(worst < 3e-9, "{name}: {worst:e} nT");
    }
}

#[test]
fn val_default_low_and_high_pass_equal_magnav() {
    let cases = [
        (band(0.1, 0.9), include_str!("../../../reference/signal/magnav_bpf_default.csv")),
        (FilterBand::Low { high_hz: 0.2 }, include_str!("../../../reference/signal/magnav_lpf_02.csv")),
        (FilterBand::High { low_hz: 0.5 }, include_str!("../../../reference/signal/magnav_hpf_05.csv")),
    ];
    for (band, text) in cases {
        let filter = ZeroPhaseFilter::new(band, 10.0, 4).unwrap();
        let ours = filter.apply(&magnav_input()).unwrap();
        let worst = largest_difference(&ours, &columns(text)["row0"]);
        // Values near 1, poles 0.02 from the unit circle.
        assert!(worst < 1e-12, "{band}: {worst:e}");
    }
}

/// The sections that MagNav.jl and scipy print for the default band-pass, to the printed digits.
#[test]
fn val_sections_of_the_default_band_pass() {
    let filter = ZeroPhaseFilter::new(band(0.1, 0.9), 10.0, 4).unwrap();
    assert!((filter.gain() / 0.0022348916980823265 - 1.0).abs() < 1e-13);
    let printed = [
        (-1.2850126432, 0.4387649163),
        (-1.4603171736, 0.7169559916),
        (-1.8696631749, 0.8751934078),
        (-1.9565142836, 0.9605568001),
    ];
    assert_eq!(filter.sections().len(), 4);
    for (section, (a1, a2)) in filter.sections().iter().zip(printed) {
        assert!((section.a1 - a1).abs() < 1e-10 && (section.a2 - a2).abs() < 1e-10);
        assert_eq!((section.b1, section.b2), (0.0, -1.0));
    }
    assert_eq!((filter.padding(), filter.least_rows()), (24, 25));
}

/// |H(f)|² of one pass through the sections.
fn squared_gain(filter: &ZeroPhaseFilter, frequency: f64) -> f64 {
    let angle = std::f64::consts::TAU * frequency;
    let square = |c1: f64, c2: f64| {
        let re = 1.0 + c1 * angle.cos() + c2 * (2.0 * angle).cos();
        let im = c1 * angle.sin() + c2 * (2.0 * angle).sin();
        re * re + im * im
    };
    let sections = filter.sections().iter();
    let gain = sections.map(|s| square(s.b1, s.b2) / square(s.a1, s.a2)).product::<f64>();
    gain * filter.gain() * filter.gain()
}

/// Butterworth: |H|² = 1/(1 + W^2n), where W is the warped frequency of the low-pass prototype.
#[test]
fn law_every_order_and_band_has_butterworth_gain() {
    let tan = |f: f64| (std::f64::consts::PI * f).tan();
    for order in 1..=12 {
        let bands = [FilterBand::Low { high_hz: 0.13 }, FilterBand::High { low_hz: 0.31 }, band(0.07, 0.22)];
        for band in bands {
            let filter = ZeroPhaseFilter::new(band, 1.0, order).unwrap();
            for k in 1..49 {
                let f = 0.01 * f64::from(k);
                let w = match band {
                    FilterBand::Low { high_hz } => tan(f) / tan(high_hz),
                    FilterBand::High { low_hz } => tan(low_hz) / tan(f),
                    FilterBand::Band { low_hz, high_hz } => {
                        let (low, high) = (tan(low_hz), tan(high_hz));
                        (tan(f) * tan(f) - low * high) / (tan(f) * (high - low))
                    }
                };
                let expected = 1.0 / (1.0 + w.powi(2 * order as i32));
                let ratio = squared_gain(&filter, f) / expected;
                // Zeros of high order near f reduce the precision of the factors that this test computes.
                assert!((ratio - 1.0).abs() < 1e-8, "order {order}, {band}, {f}: {ratio}");
            }
        }
    }
}

#[test]
fn law_a_constant_is_removed_or_passed_unchanged() {
    let constant = vec![54_321.0; 300];
    for order in 1..=12 {
        let pass = ZeroPhaseFilter::new(band(0.1, 0.9), 10.0, order).unwrap();
        assert_eq!(pass.apply(&constant).unwrap(), vec![0.0; 300], "order {order}");
        let high = ZeroPhaseFilter::new(FilterBand::High { low_hz: 0.5 }, 10.0, order).unwrap();
        assert!(high.apply(&constant).unwrap().iter().all(|y| y.abs() < 1e-6), "order {order}");
        let low = ZeroPhaseFilter::new(FilterBand::Low { high_hz: 2.0 }, 10.0, order).unwrap();
        let worst = largest_difference(&low.apply(&constant).unwrap(), &constant);
        assert!(worst < 1e-6, "order {order}: {worst:e}");
    }
}

#[test]
fn law_filtering_commutes_with_time_reversal_and_sign() {
    let x: Vec<f64> = (0..200).map(|k| (0.01 * f64::from(k * k % 97)).sin()).collect();
    let filter = ZeroPhaseFilter::new(band(0.5, 2.0), 10.0, 4).unwrap();
    let y = filter.apply(&x).unwrap();
    let negative: Vec<f64> = x.iter().map(|x| -x).collect();
    let expected: Vec<f64> = y.iter().map(|y| -y).collect();
    assert_eq!(filter.apply(&negative).unwrap(), expected);
    // A tone in the middle of the band keeps its phase, so the filter has no lag.
    let tone: Vec<f64> = (0..2000).map(|k| (0.1 * f64::from(k) * 6.0).sin()).collect();
    let y = filter.apply(&tone).unwrap();
    let scale = squared_gain(&filter, 0.6 / std::f64::consts::TAU);
    let inner = tone.iter().zip(&y).skip(500).take(1000);
    assert!(inner.map(|(x, y)| (scale * x - y).abs()).fold(0.0, f64::max) < 1e-6);
}

#[test]
fn unit_a_column_does_not_depend_on_other_columns() {
    let rows = 3000;
    for (columns, order) in [(1, 4), (2, 1), (5, 6), (8, 2), (15, 4), (18, 3), (23, 12)] {
        let value = |i: usize, j: usize| ((i * (j + 3)) as f64 * 0.013).sin() * 10f64.powi(j as i32 % 7);
        let mut matrix: Vec<f64> = (0..rows * columns).map(|k| value(k / columns, k % columns)).collect();
        let filter = ZeroPhaseFilter::new(band(0.3, 1.7), 10.0, order).unwrap();
        filter.apply_matrix(&mut matrix, columns, ConstantColumns::Filter).unwrap();
        for j in 0..columns {
            let x: Vec<f64> = (0..rows).map(|i| value(i, j)).collect();
            let y = filter.apply(&x).unwrap();
            assert!(y.iter().eq(matrix.iter().skip(j).step_by(columns)), "column {j} of {columns}");
        }
    }
}

#[test]
fn unit_columns_are_filtered_as_series() {
    let x = magnav_input();
    let other: Vec<f64> = x.iter().map(|x| x * x).collect();
    let filter = ZeroPhaseFilter::new(FilterBand::Low { high_hz: 1.0 }, 10.0, 4).unwrap();
    let both = filter.apply_columns(&[&x, &other]).unwrap();
    assert_eq!(both, [filter.apply(&x).unwrap(), filter.apply(&other).unwrap()]);
    assert!(filter.apply_columns(&[]).unwrap().is_empty());
    assert!(filter.apply_columns(&[&x, &other[1..]]).is_err());
}

#[test]
fn unit_a_bias_column_is_kept_only_on_request() {
    let matrix: Vec<f64> = magnav_input().iter().flat_map(|x| [*x, 1.0, 3.0 * x]).collect();
    let filter = ZeroPhaseFilter::new(band(0.1, 0.9), 10.0, 4).unwrap();
    let (mut kept, mut filtered) = (matrix.clone(), matrix);
    filter.apply_matrix(&mut kept, 3, ConstantColumns::Keep).unwrap();
    filter.apply_matrix(&mut filtered, 3, ConstantColumns::Filter).unwrap();
    assert!(kept.iter().skip(1).step_by(3).all(|x| *x == 1.0));
    assert!(filtered.iter().skip(1).step_by(3).all(|x| *x == 0.0));
    for j in [0, 2] {
        assert!(kept.iter().skip(j).step_by(3).eq(filtered.iter().skip(j).step_by(3)));
    }
}

#[test]
fn unit_invalid_series_are_rejected() {
    let filter = ZeroPhaseFilter::new(band(0.1, 0.9), 10.0, 4).unwrap();
    let short = filter.apply(&[1.0; 24]).unwrap_err();
    assert_eq!(short, FilterError::TooShort { rows: 24, needed: 25 });
    assert!(filter.apply(&[1.0; 25]).is_ok());
    for (row, bad) in [(0, f64::NAN), (7, f64::INFINITY), (60, f64::NAN), (99, f64::NEG_INFINITY)] {
        let mut matrix = vec![1.0; 300];
        matrix[3 * row + 2] = bad;
        let error = filter.apply_matrix(&mut matrix, 3, ConstantColumns::Filter).unwrap_err();
        assert_eq!(error, FilterError::NotFinite { row, column: 2 });
    }
    let error = filter.apply_matrix(&mut [1.0; 7], 2, ConstantColumns::Filter).unwrap_err();
    assert_eq!(error.to_string(), "7 values are not a whole number of rows of 2 columns");
}

#[test]
fn unit_impossible_designs_are_rejected() {
    let error = |band, rate, order| ZeroPhaseFilter::new(band, rate, order).unwrap_err().to_string();
    assert!(error(band(0.1, 5.0), 10.0, 4).contains("5 Hz is not below the Nyquist frequency of 5 Hz"));
    assert!(error(band(0.0, 1.0), 10.0, 4).contains("above 0 Hz, but is 0 Hz"));
    assert!(error(band(f64::NAN, 1.0), 10.0, 4).contains("above 0 Hz"));
    assert!(error(band(0.9, 0.1), 10.0, 4).contains("not below the upper"));
    assert!(error(band(0.1, 0.9), 0.0, 4).contains("sample rate"));
    assert!(error(band(0.1, 0.9), 10.0, 13).contains("1 to 12"));
    assert!(error(FilterBand::Low { high_hz: 1e-17 }, 10.0, 4).contains("double precision"));
    assert_eq!(FilterBand::between(None, None), Err(FilterError::NoCorner));
    assert_eq!(FilterBand::between(Some(0.1), None), Ok(FilterBand::High { low_hz: 0.1 }));
    assert_eq!(FilterBand::between(None, Some(0.9)), Ok(FilterBand::Low { high_hz: 0.9 }));
}
