use arrow_array::{cast::AsArray, types::Float64Type};
use numerics::{
    earth::geodesy::EarthModel,
    navigation::{
        ins_error::{InsErrors, InsGrade},
        pinson::{LAT, LON, S, VE, VN, pinson_matrix},
        transition::{step_covariance, transition_matrix},
    },
};

use super::*;

fn stage(grade: InsGrade) -> SimulateIns {
    SimulateIns {
        ins: grade.errors().into(),
        method: ErrorPropagation::ErrorModel,
        smooth_s: 0.0,
        seed: 0,
        replace: false,
    }
}

type Columns = Vec<(&'static str, Vec<f64>)>;

/// A flight at these times at 70 m/s from 45 degrees north, 10 degrees west. It turns by a degree in `turn_s` seconds.
fn true_track(tt: &[f64], turn_s: f64) -> Columns {
    let (earth, mut lat, mut lon) = (EarthModel::Wgs84, 45.0_f64, -10.0_f64);
    let mut place = [(); 2].map(|()| Vec::with_capacity(tt.len()));
    for (k, t) in tt.iter().enumerate() {
        let step_s = if k == 0 { 0.0 } else { t - tt[k - 1] };
        let (sin, cos) = ((t - 0.5 * step_s - tt[0]) / turn_s + 30.0).to_radians().sin_cos();
        let at = lat.to_radians();
        lon += earth.east_m_to_lon_rad(70.0 * sin * step_s, at, 500.0).to_degrees();
        lat += earth.north_m_to_lat_rad(70.0 * cos * step_s, at, 500.0).to_degrees();
        place[0].push(lat);
        place[1].push(lon);
    }
    let [lat, lon] = place;
    vec![("tt", tt.to_vec()), ("lat", lat), ("lon", lon), ("alt", vec![500.0; tt.len()])]
}

fn at_hz(rate_hz: f64, seconds: f64) -> Vec<f64> {
    (0..=(seconds * rate_hz) as usize).map(|k| 40_000.0 + k as f64 / rate_hz).collect()
}

fn line(name: &str, columns: &Columns) -> LineInput {
    let arrays = columns.iter().map(|(name, values)| (*name, array(values.clone())));
    let batch = RecordBatch::try_from_iter(arrays).unwrap();
    LineInput { flight: "1003".into(), line: name.into(), inputs: vec![batch], keep: None }
}

fn run(stage: &SimulateIns, line: &LineInput) -> Result<Vec<Vec<f64>>, Fault> {
    let arrays = stage.run(line, &())?;
    let numbers = arrays.iter().filter_map(|a| a.as_primitive_opt::<Float64Type>());
    Ok(numbers.map(|a| a.values().to_vec()).collect())
}

/// The 2.5 % and 97.5 % quantiles of chi-square, by Wilson and Hilferty: within 0.1 % for a hundred degrees and more.
fn band_95(freedom: f64) -> std::ops::Range<f64> {
    let spread = 2.0 / (9.0 * freedom);
    let at = |z: f64| freedom * (1.0 - spread + z * spread.sqrt()).powi(3);
    at(-1.96)..at(1.96)
}

#[test]
fn law_the_drift_over_seeds_agrees_with_the_propagated_covariance() {
    const SEEDS: usize = 1600;
    for grade in [InsGrade::Magnav, InsGrade::Navigation, InsGrade::Tactical] {
        let stage = stage(grade);
        let columns = true_track(&at_hz(1.0, 600.0), 10.0);
        let line = line("1003.02", &columns);
        let truth = TrueMotion::new(&line.inputs[0], 0.0).unwrap();
        let series = truth.series();
        let model = stage.model();
        let mut p = model.initial_covariance(45f64.to_radians(), 500.0);
        for row in 1..series.len() {
            let dt_s = series.tt_s[row] - series.tt_s[row - 1];
            let f = pinson_matrix(&series.point(row - 1), &model.time_constants(), model.pinson);
            let phi = transition_matrix(&f, dt_s);
            p = step_covariance(&p, &f, &phi, &model.noise_density(), dt_s, model.noise);
        }
        let last = |column: &[f64]| column[series.len() - 1];
        // Latitude, longitude, and the velocities north and east.
        let states = [LAT, LON, VN, VE];
        let ends: Vec<[f64; 4]> = (0..SEEDS)
            .map(|seed| {
                let ins_columns = run(&SimulateIns { seed, ..stage.clone() }, &line).unwrap();
                [
                    (last(series.lat_deg) - last(&ins_columns[0])).to_radians(),
                    (last(series.lon_deg) - last(&ins_columns[1])).to_radians(),
                    last(series.vn_mps) - last(&ins_columns[3]),
                    last(series.ve_mps) - last(&ins_columns[4]),
                ]
            })
            .collect();
        let scale = states.map(|s| p[s][s].sqrt());
        let correlation = nalgebra::Matrix4::from_fn(|a, b| p[states[a]][states[b]] / (scale[a] * scale[b]));
        let inverse = correlation.try_inverse().unwrap();
        let scaled = |end: &[f64; 4]| nalgebra::Vector4::from_fn(|k, _| end[k] / scale[k]);
        let nees: f64 = ends.iter().map(|end| scaled(end).dot(&(inverse * scaled(end)))).sum();
        let drms = (ends.iter().map(|e| scaled(e)[0].powi(2)).sum::<f64>() / SEEDS as f64).sqrt();
        println!("{}: NEES/4 {:.3}, north {drms:.3} sigma", grade.word(), nees / (4 * SEEDS) as f64);
        // The sum over the seeds is chi-square with four degrees of freedom per seed.
        assert!(band_95(4.0 * SEEDS as f64).contains(&nees), "{}: {nees}", grade.word());
        assert_eq!(p[S][S], 0.0, "the temporal variation is no part of an INS");
    }
}

#[test]
fn unit_a_seed_determines_the_ins_and_lines_differ() {
    let (stage, columns) = (stage(InsGrade::Tactical), true_track(&at_hz(10.0, 30.0), 10.0));
    let of = |stage: &SimulateIns, name| run(stage, &line(name, &columns)).unwrap();
    let (first, again) = (of(&stage, "1003.02"), of(&stage, "1003.02"));
    let bits = |x: &[Vec<f64>]| x.iter().flatten().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&first), bits(&again));
    for other in [of(&stage, "1003.03"), of(&SimulateIns { seed: 1, ..stage.clone() }, "1003.02")] {
        assert!((0..12).all(|k| other[k] != first[k]));
    }
}

#[test]
fn law_an_ins_without_error_sources_equals_the_truth() {
    let tt: Vec<f64> = (0..300).map(|k| 5.0 + 0.2 * f64::from(k) + 0.05 * (1.3 * f64::from(k)).sin()).collect();
    let columns = true_track(&tt, 2.0);
    let none = InsErrors {
        init_position_sigma_m: 0.0,
        init_altitude_sigma_m: 0.0,
        init_velocity_sigma_mps: 0.0,
        init_attitude_sigma_deg: 0.0,
        vrw_sigma: 0.0,
        arw_sigma: 0.0,
        baro_sigma_m: 0.0,
        ha_sigma_m: 0.0,
        a_hat_sigma_mps2: 0.0,
        acc_sigma_mps2: 0.0,
        gyro_sigma_radps: 0.0,
        ..InsErrors::default()
    };
    let exact = SimulateIns { ins: none.into(), ..stage(InsGrade::Magnav) };
    for method in [ErrorPropagation::ErrorModel, ErrorPropagation::Mechanisation] {
        let ins_columns = run(&SimulateIns { method, ..exact.clone() }, &line("1", &columns)).unwrap();
        let speed = |k: usize| ins_columns[3][k].hypot(ins_columns[4][k]);
        (1..299).for_each(|k| {
            for axis in 0..3 {
                // The height of the mechanisation is rounded to 1e-10 m, a degree of 45 to 1e-14.
                assert!((ins_columns[axis][k] - columns[axis + 1].1[k]).abs() < 1e-9, "{axis} {k}");
            }
            // Steps are chords of a turn at 0.5 degrees per second, with the heading of their middle.
            assert!((speed(k) - 70.0).abs() < 0.01, "{k}: {}", speed(k));
            let course = ins_columns[4][k].atan2(ins_columns[3][k]).to_degrees();
            assert!(
                (ins_columns[11][k] - course).abs() < 1e-9 && ins_columns[9][k].abs() < 1e-9,
                "level along the course"
            );
            assert!((ins_columns[8][k] + 9.8).abs() < 0.05, "{k}: {} m/s2 down", ins_columns[8][k]);
        });
        // A turn of rate ω requires the acceleration ω v to the side; ends excluded.
        let omega = 0.5f64.to_radians();
        let across =
            |k: usize| (ins_columns[7][k] * ins_columns[3][k] - ins_columns[6][k] * ins_columns[4][k]) / speed(k);
        let mean = (20..280).map(across).sum::<f64>() / 260.0;
        // Coriolis adds 2 Ω sin φ v = 0.0072 m/s², opposite to the turn.
        assert!((mean - omega * 70.0 + 0.0072).abs() < 0.02, "{mean}");
    }
}

#[test]
fn unit_smoothing_reduces_receiver_noise_in_the_specific_force() {
    let tt = at_hz(10.0, 120.0);
    let mut noisy = true_track(&tt, 10.0);
    let clean = run(&stage(InsGrade::Navigation), &line("1", &noisy)).unwrap();
    let mut normals = NormalGenerator::new(8);
    let m = 1.0 / 111_000.0;
    for (_, column) in &mut noisy[1..3] {
        column.iter_mut().for_each(|x| *x += 0.02 * m * normals.draw());
    }
    let rms = |smooth_s: f64| {
        let ins_columns = run(&SimulateIns { smooth_s, ..stage(InsGrade::Navigation) }, &line("1", &noisy)).unwrap();
        let square = |k: usize| (ins_columns[6][k] - clean[6][k]).powi(2);
        let position = (ins_columns[0][600] - clean[0][600]).abs() / m;
        assert!(position < 0.1, "{position} m off: the realisation is the same but for centimetres");
        ((50..1150).map(square).sum::<f64>() / 1100.0).sqrt()
    };
    // Twice the central difference, with an error of 2 cm: 0.02 m √6/(4 · 0.01 s²) = 1.2 m/s².
    let (raw, smooth) = (rms(0.0), rms(5.0));
    assert!((0.9..1.6).contains(&raw), "{raw} m/s2");
    assert!(smooth < 0.03, "{smooth} m/s2");
}

#[test]
fn unit_existing_columns_are_used_instead_of_derived_ones() {
    let tt = at_hz(10.0, 20.0);
    let mut columns = true_track(&tt, 1e9);
    let n = tt.len();
    columns.extend([("vn", vec![55.0; n]), ("ve", vec![-5.0; n]), ("vd", vec![0.5; n])]);
    columns.extend([("roll", vec![10.0; n]), ("pitch", vec![3.0; n]), ("yaw", vec![200.0; n])]);
    let ins_columns = run(&SimulateIns { smooth_s: 5.0, ..stage(InsGrade::Navigation) }, &line("1", &columns)).unwrap();
    for (column, expected, within) in
        [(3, 55.0, 0.01), (4, -5.0, 0.01), (5, 0.5, 0.1), (9, 10.0, 1e-3), (10, 3.0, 1e-3), (11, -160.0, 1e-3)]
    {
        assert!(
            ins_columns[column].iter().all(|x| (x - expected).abs() < within),
            "{}: {:?}",
            MADE[column],
            ins_columns[column][5]
        );
    }
}

#[test]
fn unit_the_column_of_the_grade_has_the_error_sources() {
    let grade_of = |stage: &SimulateIns| {
        let arrays = stage.run(&line("1", &true_track(&at_hz(10.0, 10.0), 10.0)), &()).unwrap();
        arrays.last().unwrap().as_string::<i32>().value(7).to_owned()
    };
    assert_eq!(grade_of(&stage(InsGrade::Tactical)), "tactical");
    let mut own = stage(InsGrade::Navigation);
    own.ins.sources.baro_sigma_m = 2.5;
    assert_eq!(grade_of(&own), "navigation, baro_sigma_m = 2.5");
}

#[test]
fn unit_short_and_impossible_lines_are_handled() {
    let fine = stage(InsGrade::Navigation);
    for n in 2..6 {
        let ins_columns =
            run(&SimulateIns { smooth_s: 5.0, ..fine.clone() }, &line("1", &true_track(&at_hz(10.0, 10.0)[..n], 10.0)));
        assert!(ins_columns.unwrap().iter().all(|c| c.len() == n && c.iter().all(|x| x.is_finite())), "{n}");
    }
    let fault = |columns: &Columns| run(&fine, &line("1", columns)).unwrap_err();
    assert!(fault(&true_track(&[5.0], 10.0)).what.contains("at least 2"));
    let whole = true_track(&at_hz(10.0, 5.0), 10.0);
    let spoilt = |column: usize, row: usize, value: f64| {
        let mut columns = whole.clone();
        columns[column].1[row] = value;
        let place = fault(&columns).place;
        (place.column, place.row)
    };
    assert_eq!(spoilt(2, 7, f64::NAN), (Some("lon".into()), Some(7)));
    assert_eq!(spoilt(1, 3, 91.0), (Some("lat".into()), Some(3)));
    assert_eq!(spoilt(0, 9, 40_000.8), (Some("tt".into()), Some(9)), "a time again");
    let lost = run(&stage(InsGrade::Commercial), &line("1", &true_track(&at_hz(1.0, 3600.0), 10.0))).unwrap_err();
    assert!(lost.what.contains("1,000 km") && lost.help.unwrap().contains("ins_grade"));
}

#[test]
fn unit_an_existing_ins_is_kept_and_wrong_units_are_reported() {
    let table = |columns: &[(&str, &str)]| {
        let columns = columns.iter().map(|(name, unit)| Column::float(*name, *unit, "")).collect();
        Table::Lines(TableShape { columns, rate_hz: None })
    };
    let place = [("tt", "s"), ("lat", "deg"), ("lon", "deg"), ("alt", "m")];
    let with = |more: &[(&'static str, &'static str)]| table(&[&place[..], more].concat());
    let keeping = stage(InsGrade::Navigation);
    let faults = keeping.yields(&[&with(&[("ins_yaw", "deg")])]).unwrap_err();
    assert_eq!((faults.len(), faults[0].param.as_deref()), (1, Some("replace")));
    assert!(faults[0].what.contains("`ins_yaw`") && faults[0].help.as_deref().unwrap().contains("`replace = true`"));
    let made = SimulateIns { replace: true, ..keeping.clone() }.yields(&[&with(&[("ins_yaw", "deg")])]).unwrap();
    let (grade, numbers) = made.columns.split_last().unwrap();
    assert_eq!(numbers.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), MADE);
    assert!(numbers.iter().all(|c| c.unit == flight::describe(&c.name).unit && !c.unit.is_empty()));
    assert_eq!((grade.name.as_str(), grade.unit.as_str()), (INS_GRADE, ""));
    assert_eq!(made.reads, [["tt", "lat", "lon", "alt"]]);
    assert_eq!(made.notes.len(), 2);
    let rich = with(&[("vn", "m/s"), ("ve", "m/s"), ("vd", "m/s"), ("roll", "deg")]);
    let made = keeping.yields(&[&rich]).unwrap();
    assert_eq!(made.reads, [["tt", "lat", "lon", "alt", "vn", "ve", "vd"]], "a roll without the rest is not read");
    let wrong = table(&[("lat", "rad"), ("lon", "deg"), ("vn", "m/s"), ("ve", "km/h"), ("vd", "m/s")]);
    let messages: Vec<String> = keeping.yields(&[&wrong]).unwrap_err().into_iter().map(|f| f.what).collect();
    let expected = [
        "column `lat` is in rad, but deg is needed",
        "there is no column `alt`",
        "column `ve` is in km/h, but m/s is needed",
    ];
    assert_eq!(messages, expected);
}
