#![allow(clippy::unwrap_used)]

use arrow_array::{
    Array, Int64Array,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{DataType, Field, Schema};
use schemas::{Role, TableShape};

use super::*;

fn resample() -> Resample {
    Resample {
        rate_hz: 10.0,
        method: SampleInterpolation::Linear,
        max_gap_s: vec![1.0],
        span: GridSpan::All,
        lag_s: BTreeMap::new(),
        input_lag_s: None,
    }
}

fn columns() -> Vec<Column> {
    vec![
        Column::text("flight", "").role(Role::Key),
        Column::text("line", "").role(Role::Key),
        Column::float("tt", "s", "").role(Role::Time),
        Column::float("x", "nT", "").role(Role::Sensor),
        Column::float("yaw", "deg", "").role(Role::Truth),
        Column::list("tl", "", "", ["a", "b"].map(str::to_owned).to_vec()),
        Column::integer("count", "", ""),
        Column::text("pilot", ""),
    ]
}

fn straight(t: f64) -> f64 {
    3.0 + 2.0 * (t - 100.0)
}

/// A turn through north from 340 degrees at 100 s, at 8 degrees per second.
fn heading(t: f64) -> f64 {
    (340.0 + 8.0 * (t - 100.0)).rem_euclid(360.0)
}

fn line(tt: Vec<f64>) -> LineInput {
    let rows = tt.len();
    let text = |values: Vec<&str>| Arc::new(StringArray::from(values)) as ArrayRef;
    let of = |f: fn(f64) -> f64| array(tt.iter().map(|t| f(*t)).collect());
    let arrays = vec![
        text(vec!["1"; rows]),
        text(vec!["1.01"; rows]),
        array(tt.clone()),
        of(straight),
        of(heading),
        list(tt.iter().flat_map(|t| [straight(*t), -straight(*t)]).collect(), 2).unwrap(),
        Arc::new(Int64Array::from_iter_values(0..rows as i64)) as ArrayRef,
        text(tt.iter().map(|t| if *t < 102.0 { "A" } else { "B" }).collect()),
    ];
    let fields: Vec<Field> = columns().iter().map(Column::field).collect();
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap();
    LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
}

/// Ten seconds at 4 Hz from 100.05 s, without a sample between 103.05 s and 106.05 s.
fn with_a_gap() -> LineInput {
    line((0..=40).filter(|k| !(13..24).contains(k)).map(|k| 100.05 + 0.25 * f64::from(k)).collect())
}

fn in_gap(t: f64) -> bool {
    t > 103.05 && t < 106.05
}

fn numbers(array: &ArrayRef) -> &[f64] {
    array.as_primitive::<Float64Type>().values()
}

#[test]
fn law_a_straight_line_is_interpolated_exactly() {
    let made = resample().run(&with_a_gap(), &()).unwrap();
    let tt = numbers(&made[2]);
    // Tenths of a second from 100.1 s to 110.0 s.
    assert_eq!(tt, (1001..=1100).map(|k| f64::from(k) / 10.0).collect::<Vec<_>>());
    let terms = made[5].as_fixed_size_list().values();
    for (k, t) in tt.iter().enumerate() {
        let row = [numbers(&made[3])[k], numbers(&made[4])[k], numbers(terms)[2 * k], numbers(terms)[2 * k + 1]];
        if in_gap(*t) {
            assert!(row.iter().all(|x| x.is_nan()), "{t}: {row:?}");
            continue;
        }
        // Times of about 100 s are rounded to 1.4e-14 s.
        for (found, expected) in row.iter().zip([straight(*t), heading(*t), straight(*t), -straight(*t)]) {
            let off = (found - expected).abs();
            // North is both 0 and 360.
            assert!(off.min((off - 360.0).abs()) < 1e-9, "{t}: {found} {expected}");
        }
    }
    assert_eq!(tt.iter().filter(|t| in_gap(**t)).count(), 30);
    let bridged = Resample { max_gap_s: vec![3.0], ..resample() }.run(&with_a_gap(), &()).unwrap();
    assert!(numbers(&bridged[3]).iter().zip(tt).all(|(x, t)| (x - straight(*t)).abs() < 1e-9));
}

#[test]
fn unit_other_types_take_the_nearest_sample_and_keys_stay() {
    let made = resample().run(&with_a_gap(), &()).unwrap();
    let tt = numbers(&made[2]);
    for (key, word) in made[..2].iter().zip(["1", "1.01"]) {
        assert!(key.as_string::<i32>().iter().all(|text| text == Some(word)));
    }
    assert_eq!((made[6].data_type(), made[7].data_type()), (&DataType::Int64, &DataType::Utf8));
    // Samples at 100.05, 100.3 and 100.55 s; the grid from 100.1 s.
    let counts = made[6].as_primitive::<Int64Type>();
    assert_eq!(counts.values()[..5], [0, 1, 1, 1, 2]);
    let pilots = made[7].as_string::<i32>();
    for (k, t) in tt.iter().enumerate() {
        assert_eq!((counts.is_null(k), pilots.is_null(k)), (in_gap(*t), in_gap(*t)), "{t}");
    }
    // The change is between 101.8 s and 102.05 s.
    assert_eq!((pilots.value(18), pilots.value(19)), ("A", "B"));
}

#[test]
fn unit_lines_between_grid_times_and_decreasing_times_are_rejected() {
    let fault = resample().run(&line(vec![100.01, 100.09]), &()).unwrap_err();
    assert_eq!(fault.what, "the line is too short for a sample at 10 Hz");
    let fault = resample().run(&line(vec![100.0, 100.2, 100.1]), &()).unwrap_err();
    assert!(fault.what.contains("row 2"), "{fault}");
}

#[test]
fn unit_every_column_has_the_new_rate() {
    let table = Table::Lines(TableShape { columns: columns().into(), rate_hz: None });
    let made = resample().yields(&[&table]).unwrap();
    assert_eq!((made.rate_hz, made.passes, made.lenient), (Some(10.0), PassThroughColumns::None, true));
    let bare = |c: &Column| Column { from: vec![], ..c.clone() };
    assert_eq!(made.columns.iter().map(bare).collect::<Vec<_>>(), columns());
    let of = |place: usize| made.columns[place].from.iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>();
    assert_eq!((of(2), of(3)), (vec!["tt"], vec!["tt", "x"]));
}

/// A table of one sensor: its times and measured columns, as floats with a unit.
fn sensor(tt: Vec<f64>, columns: Vec<(&str, &str, Vec<f64>)>) -> RecordBatch {
    let columns = [("tt", "s", tt)].into_iter().chain(columns);
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) =
        columns.map(|(name, unit, values)| (Column::float(name, unit, "").field(), array(values))).unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

fn times(first: f64, rate_hz: f64, rows: i32) -> Vec<f64> {
    (0..rows).map(|k| first + f64::from(k) / rate_hz).collect()
}

fn of(tt: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
    tt.iter().map(|t| f(*t)).collect()
}

fn together(stage: &Resample, inputs: Vec<RecordBatch>) -> Result<Vec<Vec<f64>>, Fault> {
    let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs, keep: None };
    Ok(stage.run(&line, &())?.iter().map(|a| numbers(a).to_vec()).collect())
}

#[test]
fn unit_sensors_of_different_rates_share_one_grid_over_their_common_time() {
    let (mag, gps) = (times(100.03, 40.0, 400), times(101.2, 1.0, 8));
    let inputs = || {
        vec![
            sensor(mag.clone(), vec![("mag_1_uc", "nT", of(&mag, straight))]),
            sensor(gps.clone(), vec![("alt", "m", of(&gps, |t| -straight(t))), ("yaw", "deg", of(&gps, heading))]),
        ]
    };
    let made = together(&resample(), inputs()).unwrap();
    assert_eq!(made.len(), 4);
    assert_eq!(made[0], (1012..=1082).map(|k| f64::from(k) / 10.0).collect::<Vec<_>>());
    for (k, t) in made[0].iter().enumerate() {
        assert!((made[1][k] - straight(*t)).abs() < 1e-9 && (made[2][k] + straight(*t)).abs() < 1e-9, "{t}");
        let off = (made[3][k] - heading(*t)).abs();
        assert!(off.min((off - 360.0).abs()) < 1e-9, "{t}");
    }
    let first = together(&Resample { span: GridSpan::First, ..resample() }, inputs()).unwrap();
    // The last sample of the first sensor is at 110.005 s.
    assert_eq!((first[0][0], first[0].last().copied()), (100.1, Some(110.0)));
    let known = |k: usize| (101.2..=108.2).contains(&first[0][k]);
    assert!((0..first[0].len()).all(|k| first[1][k].is_finite() && first[2][k].is_finite() == known(k)));
}

#[test]
fn law_a_lag_is_removed_from_a_late_sensor() {
    let tt = times(100.0, 50.0, 500);
    let wave = |t: f64| (3.0 * t).sin();
    // The value stamped t was measured 0.06 s earlier.
    let batch = sensor(
        tt.clone(),
        vec![
            ("mag_1_uc", "nT", of(&tt, wave)),
            ("flux_a_x", "nT", of(&tt, |t| wave(t - 0.06))),
            ("flux_a_t", "nT", of(&tt, |t| wave(t - 0.06))),
            ("cur_1", "A", of(&tt, |t| wave(t + 0.1))),
        ],
    );
    let lag_s = [("flux_a".to_owned(), 0.06), ("cur_1".to_owned(), -0.1)].into();
    let made = together(&Resample { lag_s, ..resample() }, vec![batch.clone()]).unwrap();
    let inside = 2..made[0].len() - 2;
    for k in inside {
        for column in &made[1..] {
            // Linear interpolation between samples of 50 Hz: 9/8 of 4e-4.
            assert!((column[k] - wave(made[0][k])).abs() < 5e-4, "{k}");
        }
    }
    // The result equals that for a lag of the whole table, except that the grid ends with the samples.
    let late = sensor(tt.clone(), vec![("flux_b_x", "nT", of(&tt, |t| wave(t - 0.06)))]);
    let stage = Resample { input_lag_s: Some(vec![0.0, 0.06]), ..resample() };
    let made = together(&stage, vec![batch, late]).unwrap();
    assert!(made[5].iter().zip(&made[0]).all(|(x, t)| (x - wave(*t)).abs() < 5e-4));
}

#[test]
fn unit_tables_across_midnight_are_aligned_by_their_dates() {
    let dated = |tt: Vec<f64>, doy: f64, name: &str, from_s: f64| {
        let rows = tt.len();
        let values = of(&tt, |t| t + from_s);
        sensor(tt, vec![("year", "", vec![2020.0; rows]), ("doy", "", vec![doy; rows]), (name, "nT", values)])
    };
    let before = dated(times(86_390.0, 10.0, 200), 60.0, "a", 0.0);
    let after = dated(times(1.0, 10.0, 50), 61.0, "b", 86_400.0);
    let made = together(&resample(), vec![before.clone(), after]).unwrap();
    assert_eq!(made[0].first().copied(), Some(86_401.0));
    assert!(made[0].iter().zip(&made[4]).all(|(t, x)| (t - x).abs() < 1e-9), "a and b hold the same time");
    assert_eq!(made.len(), 5, "the date is there once");
    let late = dated(times(1.0, 10.0, 50), 62.0, "b", 0.0);
    let fault = together(&resample(), vec![before, late]).unwrap_err();
    assert!(fault.what.contains("no time in common"), "{fault}");
}

#[test]
fn unit_contradictions_between_tables_are_reported_before_the_run() {
    let table = |names: &[&str]| {
        let columns = names.iter().map(|name| Column::float(*name, "", "")).collect();
        Table::Lines(TableShape { columns, rate_hz: None })
    };
    let (mag, gps) = (table(&["tt", "year", "doy", "mag_1_uc"]), table(&["tt", "year", "doy", "alt"]));
    let made = resample().yields(&[&mag, &gps]).unwrap();
    let names: Vec<&str> = made.columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["tt", "year", "doy", "mag_1_uc", "alt"]);
    assert_eq!(made.reads, [vec!["tt", "year", "doy", "mag_1_uc"], vec!["alt", "tt", "year", "doy"]]);
    let alt = &made.columns[4].from;
    assert!(alt.contains(&(0, "tt".into())) && alt.contains(&(1, "tt".into())) && alt.contains(&(1, "alt".into())));
    let fault_texts = |stage: Resample, inputs: &[&Table]| {
        let faults = stage.yields(inputs).unwrap_err();
        faults.iter().map(|f| format!("{f} [{}]", f.param.clone().unwrap_or_default())).collect::<Vec<_>>().join("; ")
    };
    let twice = fault_texts(resample(), &[&mag, &mag]);
    assert!(
        twice.contains("both input 1 and input 2 have a column `mag_1_uc`") && twice.ends_with("[input]"),
        "{twice}"
    );
    let lag_s = |name: &str| [(name.to_owned(), 0.1)].into();
    assert!(
        fault_texts(Resample { lag_s: lag_s("mag_1_cu"), ..resample() }, &[&mag]).contains("did you mean `mag_1_uc`?")
    );
    assert!(fault_texts(Resample { lag_s: lag_s("tt"), ..resample() }, &[&mag]).contains("has no lag"));
    let short = Resample { input_lag_s: Some(vec![0.1]), max_gap_s: vec![1.0; 3], ..resample() };
    let short = fault_texts(short, &[&mag, &gps]);
    assert!(short.contains("[max_gap_s]") && short.contains("[input_lag_s]"), "{short}");
}
