#![allow(clippy::unwrap_used)]
use super::*;
use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::transition::NoiseDiscretisation;

const ROWS: usize = 230;

/// 23 s of a turning flight with two gaps in the times.
fn columns() -> [Vec<f64>; 13] {
    let of = |f: &dyn Fn(f64) -> f64| (0..ROWS).map(|k| f(k as f64)).collect::<Vec<f64>>();
    let late = |k: f64| if k > 150.0 { 9.0 } else { 0.0 } + if k > 90.0 { 0.4 } else { 0.0 };
    [
        of(&|k| 0.1 * k + late(k)),
        of(&|k| 40.1 + 6e-5 * k),
        of(&|k| -74.9 + 7e-5 * k),
        of(&|k| 400.0 + (0.05 * k).sin()),
        of(&|k| 63.0 + 0.1 * k),
        of(&|k| 57.0 - 0.05 * k),
        of(&|k| (0.1 * k).cos()),
        of(&|k| 0.01 * k),
        of(&|k| -0.02 * k),
        of(&|_| -9.80665),
        of(&|k| 0.3 * k),
        of(&|k| 2.0 * (0.2 * k).sin()),
        of(&|k| 40.0 + 0.2 * k),
    ]
}

/// A wavy map from -74.91° to `east_deg`.
fn map(east_deg: f64, interpolation: MapInterpolation) -> FieldMap {
    let columns = ((east_deg + 74.91) / 0.001).round();
    let lat: Vec<f64> = (0..30).map(|k| 40.09 + 0.001 * f64::from(k)).collect();
    let lon: Vec<f64> = (0..columns as i32).map(|k| -74.91 + 0.001 * f64::from(k)).collect();
    let value = |lat: &f64, lon: &f64| 80.0 * (700.0 * lat).sin() + 60.0 * (500.0 * lon).cos();
    let values: Vec<f64> = lat.iter().flat_map(|lat| lon.iter().map(move |lon| value(lat, lon))).collect();
    FieldMap::Flat(MapSurface::new(&GeographicGrid::new(&lat, &lon, &values).unwrap(), interpolation))
}

/// All numbers of an output, as bits.
fn bits(output: &NavigationOutput) -> Vec<u64> {
    let columns = [
        &output.residual_nt,
        &output.nis,
        &output.lat_deg,
        &output.lon_deg,
        &output.alt_m,
        &output.vn_mps,
        &output.ve_mps,
        &output.vd_mps,
        &output.sd_n_m,
        &output.sd_e_m,
        &output.cov_ne_m2,
    ];
    let x = output.x.as_flattened().iter();
    let p = output.p.as_flattened().as_flattened().iter();
    columns.into_iter().flatten().chain(x).chain(p).map(|value| value.to_bits()).collect()
}

/// Inputs of a point without the line.
struct Owned {
    parameters: EkfParameters,
    measurement_nt: Vec<f64>,
    map: usize,
    core: bool,
}

/// Points that differ in all parameters that may differ: noises, time constants, maps, gaps in the measurement, gate
/// and offset.
fn points(maps: &[FieldMap], core: &Arc<CoreField>, ins: &InsSeries<'_>) -> Vec<Owned> {
    let point = |k: usize| {
        let f = k as f64;
        let noise = [
            NoiseDiscretisation::Trapezoidal,
            NoiseDiscretisation::Trapezoidal,
            NoiseDiscretisation::Rectangular,
            NoiseDiscretisation::VanLoan,
        ][k % 4];
        let errors = InsErrorModel {
            sources: InsErrors {
                init_position_sigma_m: 3.0 + f,
                vrw_sigma: 2.38e-4 * [2.0, 1.0, 1.0][k % 3],
                acc_tau_s: if k % 7 == 6 { 900.0 } else { 3600.0 },
                ..InsErrors::default()
            },
            fogm_sigma_nt: 1.0 + (k % 5) as f64,
            fogm_tau_s: 60.0 + 20.0 * (k % 6) as f64,
            noise,
            ..InsErrorModel::default()
        };
        let parameters = EkfParameters {
            errors,
            measurement_sigma_nt: 2.0 + 0.3 * f,
            offset_window_s: if k % 5 == 1 { 1.0 } else { 0.0 },
            gate_nis: (k % 4 == 1).then_some(0.05),
            keep_covariance: true,
            ..EkfParameters::default()
        };
        let (map, with_core) = (k % maps.len(), k % 3 == 1);
        let mut measurement_nt = vec![];
        for row in 0..ROWS {
            let [lat, lon, alt] = [ins.lat_deg[row] + 1e-5, ins.lon_deg[row] - 1e-5, ins.alt_m[row]];
            let anomaly = maps[0].at(lat, lon, alt).unwrap().value_nt;
            let main = if with_core { core.magnitude_nt(lat, lon, alt) } else { 0.0 };
            measurement_nt.push(anomaly + main + 2.0 * (0.7 * row as f64 + f).sin());
        }
        if k % 2 == 1 {
            measurement_nt[10 * k..10 * k + 15].fill(f64::NAN);
        }
        if k == 4 {
            measurement_nt.fill(f64::NAN);
        }
        Owned { parameters, measurement_nt, map, core: with_core }
    };
    (0..21).map(point).collect()
}

fn setting() -> ([Vec<f64>; 13], Vec<FieldMap>, Arc<CoreField>) {
    // The second map ends halfway along the flight.
    let maps = vec![
        map(-74.88, MapInterpolation::Linear),
        map(-74.892, MapInterpolation::Cubic),
        map(-74.88, MapInterpolation::Cubic),
        map(-74.88, MapInterpolation::Quadratic),
    ];
    (columns(), maps, Arc::new(CoreField::at(2020.5).unwrap()))
}

fn borrowed<'a>(of: &'a Owned, maps: &'a [FieldMap], core: &'a Arc<CoreField>) -> EkfInput<'a> {
    let Owned { parameters, measurement_nt, map, core: with_core } = of;
    EkfInput {
        parameters,
        measurement_nt,
        sigma_nt: None,
        fixes: None,
        map: &maps[*map],
        core: with_core.then_some(core),
    }
}

fn alone(ins: &InsSeries<'_>, point: &EkfInput<'_>) -> Result<NavigationOutput, NavigationError> {
    run(point.parameters, ins, point.measurement_nt, point.map, point.core.map(|core| &**core))
}

#[test]
fn unit_a_point_is_bit_identical_in_any_batch() {
    let (columns, maps, core) = setting();
    let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
    let owned = points(&maps, &core, &ins);
    let all: Vec<EkfInput<'_>> = owned.iter().map(|point| borrowed(point, &maps, &core)).collect();
    let expected: Vec<NavigationOutput> = all.iter().map(|point| alone(&ins, point).unwrap()).collect();
    let report = |k: usize| expected[k].report;
    assert!(expected.iter().map(|e| e.report.gated).sum::<usize>() > 20, "the gate rejects");
    assert!(report(1).missing_measurements == 15 && report(1).off_map > 80 && report(1).offset_samples == 10);
    assert_eq!((report(4).missing_measurements, report(0).updates), (ROWS, ROWS));
    for company in 1..=all.len() {
        for first in [0, 7, 13] {
            let places: Vec<usize> = (0..company).map(|k| (first + 5 * k) % all.len()).collect();
            let few: Vec<EkfInput<'_>> = places.iter().map(|place| all[*place]).collect();
            for (place, output) in places.into_iter().zip(run_together(&ins, &few)) {
                let output = output.unwrap();
                assert!(bits(&output) == bits(&expected[place]), "{place} among {company}");
                assert_eq!(output.report, expected[place].report);
            }
        }
    }
}

#[test]
fn unit_an_error_of_one_point_does_not_affect_the_others() {
    let (columns, maps, core) = setting();
    let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
    let mut owned: Vec<Owned> = points(&maps, &core, &ins).into_iter().take(10).collect();
    let whole: Vec<EkfInput<'_>> = owned.iter().map(|point| borrowed(point, &maps, &core)).collect();
    let expected: Vec<Vec<u64>> = whole.iter().map(|point| bits(&alone(&ins, point).unwrap())).collect();
    owned[1].parameters.errors.sources.init_velocity_sigma_mps = 1e160;
    // The largest number is reached after about 200 steps.
    owned[4].parameters.errors.sources.vrw_sigma = 3e153;
    owned[5].parameters.measurement_sigma_nt = -1.0;
    owned[8].measurement_nt.pop();
    let all: Vec<EkfInput<'_>> = owned.iter().map(|point| borrowed(point, &maps, &core)).collect();
    for (place, answer) in run_together(&ins, &all).into_iter().enumerate() {
        match (place, answer) {
            (1, Err(NavigationError::Diverged { row, .. })) => assert_eq!(row, 0),
            (4, Err(fault)) => {
                assert!(matches!(fault, NavigationError::Diverged { row: 1.., .. }), "{fault}");
                assert_eq!(alone(&ins, &all[4]).unwrap_err(), fault);
            }
            (5, Err(NavigationError::Parameter(fault))) => {
                assert_eq!(fault.0.param.as_deref(), Some("measurement_sigma_nt"))
            }
            (8, Err(NavigationError::Series(SeriesError::Length { rows, .. }))) => assert_eq!(rows, ROWS - 1),
            (_, answer) => assert!(bits(&answer.unwrap()) == expected[place], "{place}"),
        }
    }
    let mut bad = columns.clone();
    bad[5][12] = f64::NAN;
    let ins = InsSeries::from_columns(bad.each_ref().map(Vec::as_slice));
    assert!(run_together(&ins, &all[..4]).iter().all(|answer| matches!(answer, Err(NavigationError::Series(_)))));
    assert!(run_together(&ins, &[]).is_empty());
}

#[test]
fn unit_a_step_in_lanes_equals_the_step_of_one_matrix() {
    // Compares the covariance after the first step, without measurements, to the scalar step of the error model.
    let (columns, maps, core) = setting();
    let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
    for place in [0, 2, 3, 9] {
        let mut owned = points(&maps, &core, &ins).swap_remove(place);
        owned.measurement_nt.fill(f64::NAN);
        let output = alone(&ins, &borrowed(&owned, &maps, &core)).unwrap();
        let errors = owned.parameters.errors;
        let f = crate::navigation::pinson::pinson_matrix(&ins.point(0), &errors.time_constants(), errors.pinson);
        let phi = crate::navigation::transition::transition_matrix(&f, 0.1);
        let density = errors.noise_density();
        let step = crate::navigation::transition::step_covariance(&output.p[0], &f, &phi, &density, 0.1, errors.noise);
        for (ours, theirs) in output.p[1].iter().flatten().zip(step.iter().flatten()) {
            assert!((ours - theirs).abs() <= 1e-12 * theirs.abs(), "{place} {ours:e} {theirs:e}");
        }
    }
}
