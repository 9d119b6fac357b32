#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::columns;
use crate::regression::least_squares::QrAccumulator;
use crate::signal::filter::{ConstantColumns, FilterBand, ZeroPhaseFilter};

/// The input of MagNav.jl's golden cases.
fn flight() -> ([Vec<f64>; 3], Vec<f64>) {
    let series = |f: &dyn Fn(f64) -> f64| (1..=80).map(|t| f(f64::from(t))).collect::<Vec<f64>>();
    let x = series(&|t| 20_000.0 + 9000.0 * (0.21 * t).sin());
    let y = series(&|t| 5000.0 + 7000.0 * (0.13 * t).cos());
    let z = series(&|t| 45_000.0 + 3000.0 * (0.17 * t + 0.4).sin());
    let ripple = series(&|t| 15.0 * (0.21 * t).sin() + 4.0 * (0.13 * t).cos());
    let scalar = (0..80).map(|i| x[i].hypot(y[i]).hypot(z[i]) + ripple[i]).collect();
    ([x, y, z], scalar)
}

fn field(vector: &[Vec<f64>; 3]) -> BodyFieldColumns<'_> {
    let [x, y, z] = vector;
    BodyFieldColumns { x, y, z, bt: None }
}

#[test]
fn val_rows_equal_magnav() {
    let (vector, _) = flight();
    let terms = TermSelection::new(&["permanent", "induced", "eddy", "derivative", "bias"]).unwrap();
    let a = matrix(&field(&vector), &terms, DEFAULT_SCALE_NT).unwrap();
    let table = columns(include_str!("../../../reference/signal/magnav_tl_a.csv"));
    for (name, row) in [("row0", 0), ("row1", 1), ("row2", 79)] {
        let ours = &a[row * 22..(row + 1) * 22];
        for ((term, ours), magnav) in terms.names().iter().zip(ours).zip(&table[name]) {
            // Differences of 45,000 nT are rounded to 7e-12.
            let near = (ours - magnav).abs() < 1e-15 + 1e-11 * f64::from(term.len() == 5);
            assert!(near, "{term} in {name}: {ours} against {magnav}");
        }
    }
}

/// The complete calibration of MagNav.jl: filter, trim and ridge.
#[test]
fn val_coefficients_equal_magnav() {
    let (vector, scalar) = flight();
    let default = FilterBand::Band { low_hz: 0.1, high_hz: 0.9 };
    let low = FilterBand::Low { high_hz: 0.9 };
    let cases: [(&[&str], FilterBand, f64, &str); 3] = [
        (&["p", "i", "e"], default, 0.025, include_str!("../../../reference/signal/magnav_tl_coef.csv")),
        (
            &["permanent", "induced3", "eddy3", "bias"],
            default,
            0.1,
            include_str!("../../../reference/signal/magnav_tl_coef_i3_e3_b.csv"),
        ),
        (&["p", "i"], low, 0.025, include_str!("../../../reference/signal/magnav_tl_coef_lowpass.csv")),
    ];
    for (groups, band, lambda, text) in cases {
        let terms = TermSelection::new(groups).unwrap();
        let filter = ZeroPhaseFilter::new(band, 10.0, 4).unwrap();
        let mut a = matrix(&field(&vector), &terms, DEFAULT_SCALE_NT).unwrap();
        filter.apply_matrix(&mut a, terms.len(), ConstantColumns::Keep).unwrap();
        let y = filter.apply(&scalar).unwrap();
        let a = &a[20 * terms.len()..60 * terms.len()];
        let factor = QrAccumulator::from_matrix(a, terms.len(), &[&y[20..60]]).unwrap();
        let path = factor.solve(&[lambda], &terms.names()).unwrap();
        let magnav = &columns(text)["row0"];
        let scale = magnav.iter().fold(0.0f64, |scale, b| scale.max(b.abs()));
        for (term, (ours, magnav)) in path.solutions[0].coefficients[0].iter().zip(magnav).enumerate() {
            // MagNav.jl solves the normal equations. The tolerance is the condition number of the columns with this
            // ridge (up to 1e5) times the rounding error of the filtered columns.
            assert!((ours - magnav).abs() < 1e-7 * scale, "{groups:?} {term}: {ours} against {magnav}");
        }
    }
}

#[test]
fn unit_names_follow_the_table_in_any_order_of_request() {
    let terms = TermSelection::new(&["bias", "e3", "permanent", "induced5"]).unwrap();
    let names = ["x", "y", "z", "xx", "xy", "xz", "yy", "yz", "xx_dot", "yy_dot", "zz_dot", "bias"];
    assert_eq!(terms.names(), names);
    let classical = TermSelection::new(&["permanent", "induced", "eddy"]).unwrap();
    assert_eq!(TermSelection::default(), classical);
    assert_eq!(classical.len(), 18);
    assert_eq!(classical.names()[9..12], ["xx_dot", "xy_dot", "xz_dot"]);
    assert_eq!(TermSelection::new(&["i3"]).unwrap().names(), ["xx", "yy", "zz"]);
    assert_eq!(TermSelection::new(&["e8"]).unwrap().names()[7], "zy_dot");
    assert_eq!(TermSelection::new(&["fdm", "derivative3"]).unwrap().names(), ["x_dot", "y_dot", "z_dot"]);
}

#[test]
fn law_subsets_are_columns_of_the_full_matrix() {
    let (vector, scalar) = flight();
    let all = TermSelection::new(&["p", "i", "e", "f", "b"]).unwrap();
    let some = TermSelection::new(&["i5", "e3", "b"]).unwrap();
    let modified = BodyFieldColumns { bt: Some(&scalar), ..field(&vector) };
    let full = matrix(&modified, &all, 30_000.0).unwrap();
    let part = matrix(&modified, &some, 30_000.0).unwrap();
    for (j, name) in some.names().iter().enumerate() {
        let k = all.names().iter().position(|other| other == name).unwrap();
        let (part, full) = (part.iter().skip(j).step_by(some.len()), full.iter().skip(k).step_by(22));
        assert!(part.eq(full), "{name}");
    }
    // The modified model divides by the scalar.
    assert_eq!(full[0], vector[0][0] / scalar[0]);
}

#[test]
fn law_cosines_have_unit_length_and_induced_terms_sum_to_the_field() {
    let (vector, _) = flight();
    let a = matrix(&field(&vector), &TermSelection::new(&["p", "i"]).unwrap(), DEFAULT_SCALE_NT).unwrap();
    for (row, i) in a.chunks(9).zip(0..) {
        let length: f64 = row[..3].iter().map(|c| c * c).sum();
        assert!((length - 1.0).abs() < 1e-15);
        let total = vector[0][i].hypot(vector[1][i]).hypot(vector[2][i]);
        assert!((row[3] + row[6] + row[8] - total / 50_000.0).abs() < 1e-15);
    }
}

#[test]
fn unit_a_difference_never_crosses_a_gap() {
    let ([mut x, y, z], _) = flight();
    x[30] = f64::NAN;
    let terms = TermSelection::new(&["p", "e", "f", "b"]).unwrap();
    let holed = matrix(&field(&[x.clone(), y.clone(), z.clone()]), &terms, 50_000.0).unwrap();
    let cut = |range: Range<usize>| {
        let part = [&x, &y, &z].map(|c| c[range.clone()].to_vec());
        matrix(&field(&part), &terms, 50_000.0).unwrap()
    };
    let width = terms.len();
    assert_eq!(holed[..30 * width], cut(0..30));
    assert_eq!(holed[31 * width..], cut(31..80));
    let (missing, bias) = holed[30 * width..31 * width].split_at(width - 1);
    assert!(missing.iter().all(|v| v.is_nan()) && bias == [1.0]);
    // Runs from the caller break differences in the same way; rows outside the runs are missing.
    let whole = [flight().0[0].clone(), y, z];
    let in_runs = matrix_in_runs(&field(&whole), &terms, 50_000.0, &[0..30, 31..80]).unwrap();
    assert_eq!(in_runs.len(), 80 * width);
    for (a, b) in in_runs.iter().zip(&holed) {
        assert!(a == b || (a.is_nan() && b.is_nan()));
    }
}

#[test]
fn unit_missing_inputs_give_nan_only_in_their_terms() {
    let vector = [vec![3.0, f64::NAN, 1.0, 2.0], vec![0.0; 4], vec![4.0, 0.0, 0.0, 0.0]];
    let terms = TermSelection::new(&["p", "f", "b"]).unwrap();
    let a = matrix(&field(&vector), &terms, 50_000.0).unwrap();
    // A run of one sample has no difference.
    assert_eq!(a[..3], [0.6, 0.0, 0.8]);
    assert!(a[3..6].iter().all(|v| v.is_nan()));
    assert_eq!(a[6], 1.0);
    assert_eq!(a[14..21], [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let bt = [5.0, 5.0, 0.0, f64::NAN];
    let modified = matrix(&BodyFieldColumns { bt: Some(&bt), ..field(&vector) }, &terms, 50_000.0).unwrap();
    assert!(modified[14..17].iter().chain(&modified[21..24]).all(|v| v.is_nan()));
    assert_eq!(modified[17..20], [1.0, 0.0, 0.0]);
    assert!(matrix(&field(&[vec![], vec![], vec![]]), &terms, 1.0).unwrap().is_empty());
}

#[test]
fn unit_invalid_requests_are_rejected() {
    let error = |names: &[&str]| TermSelection::new(names).unwrap_err().to_string();
    assert!(error(&["permanant"]).contains("`permanant`; the available groups are permanent, induced"));
    assert!(error(&["induced", "i3"]).contains("`induced` and `induced3`"));
    assert!(error(&[]).contains("the list of groups of terms is empty"));
    let short = BodyFieldColumns { x: &[1.0], y: &[1.0, 2.0], z: &[1.0], bt: None };
    let error = matrix(&short, &TermSelection::default(), 50_000.0).unwrap_err();
    assert_eq!(error, AMatrixError::Lengths { lengths: vec![1, 2, 1] });
    let one = BodyFieldColumns { y: &[1.0], ..short };
    assert!(matrix(&one, &TermSelection::default(), 0.0).is_err());
}
