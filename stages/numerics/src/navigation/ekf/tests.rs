#![allow(clippy::unwrap_used)]
use super::*;
use crate::maps::map_surface::tests::golden_grid;
use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::pinson::tests::{golden, golden_entries};
use crate::navigation::pinson::{ALT, LAT, LON, MAGNAV_POSITION, S, STATES, StateVector, VN};
use crate::navigation::transition::NoiseDiscretisation;
use nalgebra::SMatrix;

/// Navigation line that owns the columns.
#[derive(Clone)]
struct Line {
    columns: [Vec<f64>; 13],
    measurement_nt: Vec<f64>,
}

impl Line {
    fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    fn run(&self, parameters: &EkfParameters, map: &MapSurface) -> Result<NavigationOutput, NavigationError> {
        run(parameters, &self.series(), &self.measurement_nt, &FieldMap::Flat(map.clone()), None)
    }

    /// MagNav.jl's golden line: 20 samples at 10 Hz over the golden map, the measurement off by (1e-6, -2e-6) rad and
    /// 0.5 sin(k) nT.
    fn golden() -> Self {
        let map = cubic();
        let of = |f: &dyn Fn(f64) -> f64| (0..20).map(|k| f(f64::from(k))).collect::<Vec<f64>>();
        let (lat, lon) = (|k: f64| 0.7004 + 1e-6 * k, |k: f64| -1.2996 + 2e-6 * k);
        let columns = [
            of(&|k| 0.1 * k),
            of(&|k| lat(k).to_degrees()),
            of(&|k| lon(k).to_degrees()),
            of(&|_| 400.0),
            of(&|_| 63.0),
            of(&|_| 97.0),
            of(&|_| 0.0),
            of(&|k| 0.01 * k),
            of(&|k| -0.02 * k),
            of(&|_| -9.80665),
            of(&|k| (0.02 * k).to_degrees()),
            of(&|_| 0.03_f64.to_degrees()),
            of(&|_| 1.0_f64.to_degrees()),
        ];
        let measurement_nt = of(&|k| {
            let (lat, lon) = ((lat(k) + 1e-6).to_degrees(), (lon(k) - 2e-6).to_degrees());
            map.at(lat, lon).unwrap().value_nt + 0.5 * k.sin()
        });
        Self { columns, measurement_nt }
    }
}

fn cubic() -> MapSurface {
    MapSurface::new(&golden_grid(), MapInterpolation::Cubic)
}

/// MagNav.jl's `create_model(0.1, lat[1])`.
fn magnav() -> EkfParameters {
    EkfParameters {
        errors: InsErrorModel::compatible(),
        measurement_sigma_nt: 3.0,
        keep_covariance: true,
        ..EkfParameters::default()
    }
}

#[test]
fn val_magnav_filter_in_the_compatible_form() {
    let output = Line::golden().run(&magnav(), &cubic()).unwrap();
    let (x, p) = (golden("ekf_x_1_10_20"), golden("ekf_P20_diag"));
    for (ours, theirs) in MAGNAV_POSITION.into_iter().enumerate() {
        let sigma = p[0][theirs].sqrt();
        assert!((output.p[19][ours][ours] / p[0][theirs] - 1.0).abs() < 1e-8, "{ours}");
        for (row, x) in [0, 9, 19].into_iter().zip(&x) {
            // MagNav.jl's gradient is a central difference over 1e-8 rad with 1e-7 of rounding.
            let difference = (output.x[row][ours] - x[theirs]).abs();
            assert!(difference < 2e-7 * (sigma + x[theirs].abs()), "{row} {ours} {difference:e}");
        }
    }
    for (_, row, theirs) in golden_entries("ekf_resid") {
        // The positions of MagNav.jl's residuals have the same rounding error, which is 1e-7 of 1 nT in the residual.
        let ours = output.residual_nt[row];
        assert!((ours - theirs).abs() < 1e-6, "{row} {ours} {theirs}");
    }
    assert_eq!(output.report.updates, 20);
}

#[test]
fn law_covariances_are_symmetric_and_positive() {
    let map = cubic();
    for (sigma, noise) in [
        (1e-3, NoiseDiscretisation::Trapezoidal),
        (5.0, NoiseDiscretisation::VanLoan),
        (5.0, NoiseDiscretisation::Rectangular),
    ] {
        let errors = InsErrorModel { noise, ..InsErrorModel::default() };
        let parameters =
            EkfParameters { errors, measurement_sigma_nt: sigma, keep_covariance: true, ..EkfParameters::default() };
        let output = Line::golden().run(&parameters, &map).unwrap();
        for p in &output.p {
            for (row, entries) in p.iter().enumerate() {
                for (column, entry) in entries.iter().enumerate() {
                    assert_eq!(*entry, p[column][row]);
                }
            }
            let correlation = SMatrix::<f64, STATES, STATES>::from_fn(|row, column| {
                p[row][column] / (p[row][row] * p[column][column]).sqrt()
            });
            // Correlations near one have a rounding error of 1e-16 each. After a measurement with a noise of 0.001 nT,
            // some correlations equal 1 to ten digits.
            let smallest = correlation.symmetric_eigenvalues().min();
            assert!(smallest > -1e-13, "{smallest:e}");
        }
    }
}

#[test]
fn law_one_update_equals_the_dense_formula() {
    let map = cubic();
    let output = Line::golden().run(&magnav(), &map).unwrap();
    let line = Line::golden();
    let p0 = magnav().errors.initial_covariance(0.7004, 400.0);
    let field = map.at(line.columns[1][0], line.columns[2][0]).unwrap();
    let mut h = [0.0; STATES];
    (h[LAT], h[LON], h[S]) = (field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, 1.0);
    let ph: StateVector = std::array::from_fn(|state| p0[state][state] * h[state]);
    let variance = h.iter().zip(&ph).map(|(h, ph)| h * ph).sum::<f64>() + 9.0;
    let residual = line.measurement_nt[0] - field.value_nt;
    assert!((output.residual_nt[0] - residual).abs() < 1e-12);
    assert!((output.nis[0] - residual * residual / variance).abs() < 1e-14);
    for row in 0..STATES {
        assert!((output.x[0][row] - ph[row] / variance * residual).abs() <= 1e-15 * ph[row].abs());
        for column in 0..STATES {
            let diagonal = if row == column { p0[row][row] } else { 0.0 };
            let expected = diagonal - ph[row] * ph[column] / variance;
            let size = (p0[row][row] * p0[column][column]).sqrt();
            assert!((output.p[0][row][column] - expected).abs() < 1e-15 * size, "{row} {column}");
        }
    }
}

#[test]
fn law_output_equals_the_ins_plus_the_state() {
    let line = Line::golden();
    let output = line.run(&EkfParameters { keep_covariance: true, ..EkfParameters::default() }, &cubic()).unwrap();
    for row in [0, 19] {
        let x = &output.x[row];
        assert_eq!(output.lat_deg[row], line.columns[1][row] + x[LAT].to_degrees());
        assert_eq!(output.lon_deg[row], line.columns[2][row] + x[LON].to_degrees());
        assert_eq!(output.alt_m[row], 400.0 + x[ALT]);
        assert_eq!(output.vn_mps[row], 63.0 + x[VN]);
        let north_m = output.p[row][LAT][LAT].sqrt() * 6.363e6;
        // The meridian radius at 40°, to 0.1 %.
        assert!((output.sd_n_m[row] / north_m - 1.0).abs() < 1e-3, "{}", output.sd_n_m[row]);
        assert!(output.cov_ne_m2[row].abs() <= output.sd_n_m[row] * output.sd_e_m[row]);
    }
    assert!((output.sd_n_m[0] - 3.0).abs() < 0.1 && output.sd_n_m[0] < 3.0);
    assert!(line.run(&EkfParameters::default(), &cubic()).unwrap().p.is_empty());
}

#[test]
fn unit_samples_without_measurement_or_map_value_are_predicted_and_counted() {
    let map = cubic();
    let mut line = Line::golden();
    for row in [0, 4, 5] {
        line.measurement_nt[row] = f64::NAN;
    }
    line.measurement_nt[6] = f64::INFINITY;
    line.columns[1][10] += 1.0;
    let output = line.run(&EkfParameters::default(), &map).unwrap();
    let report = output.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map), (15, 4, 1));
    for row in [0, 4, 5, 6, 10] {
        assert!(output.residual_nt[row].is_nan() && output.nis[row].is_nan());
        assert!(output.sd_n_m[row].is_finite() && output.lat_deg[row].is_finite());
    }
    assert!((output.sd_n_m[0] - 3.0).abs() < 1e-9, "the initial uncertainty, untouched");
    assert_eq!(output.x[0], [0.0; STATES]);
}

#[test]
fn law_without_measurements_the_output_is_the_ins() {
    let mut line = Line::golden();
    line.measurement_nt.fill(f64::NAN);
    let output = line.run(&EkfParameters::default(), &cubic()).unwrap();
    assert_eq!(output.lat_deg, line.columns[1]);
    assert!(output.sd_n_m.windows(2).all(|pair| pair[1] >= pair[0]));
}

#[test]
fn law_a_flat_map_corrects_only_the_temporal_variation() {
    let (lat, lon) = ([40.0, 40.2], [-75.0, -74.0]);
    let flat = MapSurface::new(&GeographicGrid::new(&lat, &lon, &[10.0; 4]).unwrap(), MapInterpolation::Linear);
    let mut line = Line::golden();
    line.measurement_nt.fill(14.0);
    let output = line.run(&EkfParameters::default(), &flat).unwrap();
    assert_eq!(output.report.updates, 20);
    let last = output.x[19];
    assert!(last[..S].iter().all(|x| *x == 0.0) && last[S] > 2.0, "{last:?}");
}

#[test]
fn law_the_offset_of_the_first_seconds_is_subtracted() {
    let map = cubic();
    let mut line = Line::golden();
    line.measurement_nt.iter_mut().for_each(|measured| *measured += 1000.0);
    line.measurement_nt[1] = f64::NAN;
    let parameters = EkfParameters { offset_window_s: 0.45, ..EkfParameters::default() };
    let output = line.run(&parameters, &map).unwrap();
    assert_eq!(output.report.offset_samples, 4, "0.0, 0.2, 0.3 and 0.4 s");
    let expected: f64 = [0, 2, 3, 4]
        .into_iter()
        .map(|row| line.measurement_nt[row] - map.at(line.columns[1][row], line.columns[2][row]).unwrap().value_nt)
        .sum::<f64>()
        / 4.0;
    assert!((output.report.offset_nt - expected).abs() < 1e-10);
    assert!(output.residual_nt[0].abs() < 2.0);
    let without = line.run(&EkfParameters::default(), &map).unwrap();
    assert_eq!((without.report.offset_nt, without.report.offset_samples), (0.0, 0));
    assert!(without.residual_nt[0] > 990.0);
}

#[test]
fn unit_the_gate_rejects_outliers() {
    let mut line = Line::golden();
    line.measurement_nt[7] += 500.0;
    let gated = EkfParameters { gate_nis: Some(10.83), ..EkfParameters::default() };
    let output = line.run(&gated, &cubic()).unwrap();
    assert_eq!((output.report.gated, output.report.updates), (1, 19));
    assert!(output.nis[7] > 1000.0 && output.residual_nt[7] > 400.0);
    let mut missing = line.clone();
    missing.measurement_nt[7] = f64::NAN;
    let expected = missing.run(&EkfParameters::default(), &cubic()).unwrap();
    assert_eq!(output.x, expected.x, "as if it had not been measured");
    assert_eq!(line.run(&EkfParameters::default(), &cubic()).unwrap().report.gated, 0);
}

#[test]
fn law_uneven_time_equals_missing_samples() {
    let map = cubic();
    let mut thinned = Line::golden();
    for row in [3, 4, 5, 9, 15] {
        thinned.measurement_nt[row] = f64::NAN;
    }
    // Constant INS quantities, so that two short steps equal one long step.
    for column in [1, 2, 7, 8, 10] {
        let first = thinned.columns[column][0];
        thinned.columns[column].fill(first);
    }
    let keep = |values: &[f64]| -> Vec<f64> {
        (0..20).filter(|row| ![3, 4, 5, 9, 15].contains(row)).map(|row| values[row]).collect()
    };
    let uneven = Line {
        columns: thinned.columns.each_ref().map(|column| keep(column)),
        measurement_nt: keep(&thinned.measurement_nt),
    };
    let errors = InsErrorModel { noise: NoiseDiscretisation::VanLoan, ..InsErrorModel::default() };
    let parameters = EkfParameters { errors, ..EkfParameters::default() };
    let (a, b) = (thinned.run(&parameters, &map).unwrap(), uneven.run(&parameters, &map).unwrap());
    for (a, b) in keep(&a.residual_nt).iter().zip(&b.residual_nt) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    assert!((a.sd_n_m[19] - b.sd_n_m[14]).abs() < 1e-9);
}

#[test]
fn law_the_core_field_is_part_of_the_prediction() {
    let (map, line) = (cubic(), Line::golden());
    let core = CoreField::at(2020.5).unwrap();
    let mut total = line.measurement_nt.clone();
    for (row, measured) in total.iter_mut().enumerate() {
        let (lat, lon) = (line.columns[1][row], line.columns[2][row]);
        let offset_deg = (1e-6_f64.to_degrees(), -(2e-6_f64.to_degrees()));
        *measured += core.magnitude_nt(lat + offset_deg.0, lon + offset_deg.1, 400.0);
    }
    let with =
        run(&EkfParameters::default(), &line.series(), &total, &FieldMap::Flat(map.clone()), Some(&core)).unwrap();
    let without = line.run(&EkfParameters::default(), &map).unwrap();
    for (a, b) in with.residual_nt.iter().zip(&without.residual_nt) {
        // The core field differs by 0.05 nT between the two positions.
        assert!((a - b).abs() < 0.1, "{a} {b}");
    }
}

#[test]
fn unit_invalid_lines_are_rejected() {
    let map = cubic();
    let message = |line: &Line| line.run(&EkfParameters::default(), &map).unwrap_err().to_string();
    let mut line = Line::golden();
    line.columns[5][12] = f64::NAN;
    assert_eq!(message(&line), "column `ins_ve` is NaN in row 12; the filter requires a finite value in every row");
    let mut line = Line::golden();
    line.columns[0][3] = 0.2;
    assert_eq!(message(&line), "time does not ascend: `tt` is 0.2 s in row 3 after 0.2 s");
    let mut line = Line::golden();
    line.measurement_nt.pop();
    assert_eq!(message(&line), "column `measurement` has 19 rows, but `tt` has 20");
    let mut line = Line::golden();
    line.columns[9].pop();
    assert_eq!(message(&line), "column `ins_fd` has 19 rows, but `tt` has 20");
    let empty = Line { columns: Default::default(), measurement_nt: Vec::new() };
    assert_eq!(message(&empty), "the line has 0 sample(s); at least 1 are required");
    let mut line = Line::golden();
    line.columns[7][11] = 1e200;
    assert!(message(&line).starts_with("the filter diverged at row 12 (tt = 1.2"), "{}", message(&line));
    let sigma = EkfParameters { measurement_sigma_nt: 0.0, ..EkfParameters::default() };
    let refused = Line::golden().run(&sigma, &map).unwrap_err().to_string();
    assert_eq!(refused, "`measurement_sigma_nt` must be above 0, not 0");
}
