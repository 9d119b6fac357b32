//! Tests of the models `m3...` on flights that are simulated from vectors, not from Tolles-Lawson terms.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use learning::network::VECTOR_TERMS;
use schemas::{Literal, NullMonitor};

use super::testing::{FitOutput, fitted_to, number, stage, whole, word, words, worked};
use crate::{
    fitted::{FittedModel, FittedModelForm},
    trained::LearnedModel,
};

type Keys = Vec<(String, Literal)>;
type Vector = [f64; 3];

/// Lines of the training, and lines that no model sees.
const TRAINING: std::ops::Range<usize> = 0..5;
const HELD_OUT: std::ops::Range<usize> = 5..8;
const RATE_HZ: f64 = 10.0;
/// Earth field in the navigation frame, in nT.
const EARTH_NT: Vector = [20_000.0, 3_000.0, 45_000.0];

fn sum(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn size(a: Vector) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

fn times(m: &[Vector; 3], a: Vector) -> Vector {
    m.map(|row| row[0] * a[0] + row[1] * a[1] + row[2] * a[2])
}

/// Earth field in the body frame at a time of a line: straight flight with manoeuvres in roll, pitch and yaw. Its
/// magnitude changes along the line; otherwise the aircraft field would be a multiple of the total field, plus a
/// constant.
fn earth_nt(line: usize, t: f64) -> Vector {
    let phase = line as f64;
    let (roll, pitch) = (0.30 * (0.9 * t + phase).sin(), 0.15 * (0.63 * t + 2.0 * phase).cos());
    let yaw = 0.8 * phase + 0.2 * (0.41 * t + phase).sin();
    let (sr, cr, sp, cp, sy, cy) = (roll.sin(), roll.cos(), pitch.sin(), pitch.cos(), yaw.sin(), yaw.cos());
    let body = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ];
    let share = 1.0 + 0.012 * (0.17 * t + 1.3 * phase).sin() + 0.006 * (0.05 * t * (1.0 + phase)).cos();
    times(&body, EARTH_NT.map(|b| share * b))
}

/// Two currents, in A.
fn currents(line: usize, t: f64) -> [f64; 2] {
    let phase = 1.7 * line as f64;
    let heater = if (0.35 * t + phase).sin() > 0.2 { 1.0 } else { 0.0 };
    [heater + 0.05 * (3.1 * t).sin(), 0.5 + 0.5 * (0.23 * t + phase).cos()]
}

/// Field of the aircraft, in nT: magnetisation, eddy currents, and `share` of the effect of the currents.
fn aircraft_nt(line: usize, t: f64, share: f64) -> Vector {
    let earth = earth_nt(line, t);
    let per_s = |i: usize| (earth_nt(line, t + 1e-4)[i] - earth_nt(line, t - 1e-4)[i]) / 2e-4;
    let induced = [[0.030, 0.004, -0.006], [0.004, -0.012, 0.003], [-0.006, 0.003, 0.020]];
    let eddy = [[0.004, 0.001, 0.0], [-0.002, 0.003, 0.001], [0.0005, 0.0, 0.002]];
    let [heater, generator] = currents(line, t);
    let of_currents = [
        share * (60.0 * heater - 40.0 * generator * generator),
        share * (-80.0 * heater + 30.0 * generator),
        share * (25.0 * heater + 90.0 * generator * generator),
    ];
    let magnetised = sum([1500.0, -2200.0, 800.0], times(&induced, earth));
    sum(sum(magnetised, times(&eddy, [per_s(0), per_s(1), per_s(2)])), of_currents)
}

/// A line: the target is the scalar field with the aircraft minus the scalar field without it.
fn line(number: usize, rows: usize, share: f64) -> RecordBatch {
    line_at(RATE_HZ, number, rows, share)
}

/// A line at another sample rate.
fn line_at(rate_hz: f64, number: usize, rows: usize, share: f64) -> RecordBatch {
    let time = |row: usize| row as f64 / rate_hz;
    let total = |row: usize| sum(earth_nt(number, time(row)), aircraft_nt(number, time(row), share));
    let target = |row: usize| size(total(row)) - size(earth_nt(number, time(row)));
    let term = |row: usize, which: usize| {
        let (field, at) = (total(row), size(total(row)));
        let (before, after) = (total(row.saturating_sub(1)), total((row + 1).min(rows - 1)));
        let steps = ((row + 1).min(rows - 1) - row.saturating_sub(1)) as f64;
        let change = |j: usize| (after[j] - before[j]) / steps;
        match which {
            0..3 => field[which] / at,
            3..9 => {
                let (i, j) = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)][which - 3];
                field[i] * field[j] / (at * 50_000.0)
            }
            _ => field[(which - 9) / 3] * change((which - 9) % 3) / (at * 50_000.0),
        }
    };
    let column = |of: &dyn Fn(usize) -> f64| -> ArrayRef { Arc::new((0..rows).map(of).collect::<Float64Array>()) };
    let mut all = vec![("tt", column(&time)), ("target", column(&target))];
    all.extend(VECTOR_TERMS.iter().enumerate().map(|(k, name)| (*name, column(&|row| term(row, k)))));
    all.push(("heater", column(&|row| currents(number, time(row))[0])));
    all.push(("generator", column(&|row| currents(number, time(row))[1])));
    RecordBatch::try_from_iter(all).unwrap()
}

fn flight(lines: std::ops::Range<usize>, share: f64) -> Vec<RecordBatch> {
    lines.map(|number| line(number, 400, share)).collect()
}

/// Keys of the fit: the target, and terms and currents as features.
fn keys(more: &[(String, Literal)]) -> Keys {
    let features: Vec<&str> = VECTOR_TERMS.iter().copied().chain(["heater", "generator"]).collect();
    [vec![word("target", "target"), words("features", &features)], more.to_vec()].concat()
}

/// Keys of a network with two currents as inputs.
fn with_currents(more: &[(String, Literal)]) -> Keys {
    keys(&[vec![words("inputs", &["heater", "generator"])], training(), more.to_vec()].concat())
}

/// Keys of a network with two currents and the attitude as inputs, which a scalar correction requires.
fn with_attitude(more: &[(String, Literal)]) -> Keys {
    keys(&[vec![words("inputs", &["heater", "generator", "x", "y", "z"])], training(), more.to_vec()].concat())
}

/// Keys of a short training.
fn training() -> Keys {
    vec![whole("epochs", 60), number("learning_rate", 0.01), whole("batch", 200), number("whiten", 0.999_999_9)]
}

/// Values of a column.
fn values(line: &RecordBatch, name: &str) -> Vec<f64> {
    line.column_by_name(name).unwrap().as_primitive::<Float64Type>().values().to_vec()
}

/// The model in the table of a fit.
fn model(found: &FitOutput) -> LearnedModel {
    LearnedModel::read(&found.term, &found.value).unwrap().unwrap()
}

/// Standard deviation of the error of a prediction on some lines, in nT: the mean of each line is removed.
fn error_nt(lines: &[RecordBatch], predict: &dyn Fn(&RecordBatch) -> Vec<f64>) -> f64 {
    let squares = |line: &RecordBatch| {
        let error: Vec<f64> = values(line, "target").iter().zip(predict(line)).map(|(y, f)| y - f).collect();
        let mean = error.iter().sum::<f64>() / error.len() as f64;
        error.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / error.len() as f64
    };
    (lines.iter().map(squares).sum::<f64>() / lines.len() as f64).sqrt()
}

/// Prediction of a network for a line.
fn predicted(found: &FitOutput, line: &RecordBatch) -> Vec<f64> {
    let model = model(found);
    let columns: Vec<Vec<f64>> = model.columns().iter().map(|name| values(line, name)).collect();
    let x: Vec<f64> = (0..line.num_rows()).flat_map(|row| columns.iter().map(move |c| c[row])).collect();
    model.predict(&x, &[line.num_rows()]).unwrap().field_nt
}

/// Error of a network on held-out lines, in nT.
fn network_error_nt(name: &str, share: f64, keys: &Keys) -> f64 {
    let found = fitted_to(&flight(TRAINING, share), name, keys);
    error_nt(&flight(HELD_OUT, share), &|line| predicted(&found, line))
}

/// Error of linear Tolles-Lawson on held-out lines, in nT.
fn linear_error_nt(share: f64) -> f64 {
    let terms =
        keys(&[words("features", &VECTOR_TERMS), number("lambda", 0.0), super::testing::flag("intercept", true)]);
    let found = fitted_to(&flight(TRAINING, share), "ridge", &terms);
    let at = |name: &str| found.value[found.term.iter().position(|term| term == name).unwrap()];
    error_nt(&flight(HELD_OUT, share), &|line| {
        let mut sum = vec![at("intercept"); line.num_rows()];
        for name in VECTOR_TERMS {
            sum.iter_mut().zip(values(line, name)).for_each(|(sum, x)| *sum += at(name) * x);
        }
        sum
    })
}

/// Keys of a trained vector form without a filter in its ridge fit.
fn unfiltered() -> Keys {
    vec![number("linear_low_hz", 0.0), number("linear_high_hz", 0.0), number("lambda", 1e-9)]
}

#[test]
fn law_m3tl_recovers_the_vector_field_and_the_projection_does_not() {
    let keys = |coupling: &str| {
        let long = [whole("epochs", 0), whole("lbfgs_epochs", 2000), number("whiten", 0.999_999_999)];
        keys(&[unfiltered(), long.to_vec(), vec![word("coupling", coupling)]].concat())
    };
    let linear = linear_error_nt(0.0);
    let (magnitude, projection) =
        (network_error_nt("m3tl", 0.0, &keys("magnitude")), network_error_nt("m3tl", 0.0, &keys("projection")));
    println!("linear {linear:.3} nT, m3tl projection {projection:.3} nT, m3tl magnitude {magnitude:.3} nT");
    assert!(linear > 1.0 && magnitude < 0.1 * linear, "{magnitude} {linear}");
    assert!((projection / linear - 1.0).abs() < 0.1, "{projection} {linear}");
}

#[test]
fn law_the_models_beat_tolles_lawson_on_held_out_lines_with_currents() {
    let linear = linear_error_nt(1.0);
    for name in ["m3s", "m3v", "m3sc", "m3vc", "m3w", "m3tf"] {
        let mut keys =
            if ["m3v", "m3vc"].contains(&name) { with_currents(&unfiltered()) } else { with_attitude(&unfiltered()) };
        if ["m3w", "m3tf"].contains(&name) {
            keys.retain(|(key, _)| key != "whiten");
        }
        let found = network_error_nt(name, 1.0, &keys);
        println!("{name} {found:.2} nT, linear Tolles-Lawson {linear:.2} nT");
        let share = if name == "m3v" { 0.1 } else { 0.5 };
        assert!(found < share * linear, "{name}: {found} {linear}");
    }
}

#[test]
fn law_m3s_with_the_projection_equals_m2c() {
    let lines = flight(TRAINING, 1.0);
    let m2c = fitted_to(&lines, "m2c", &with_currents(&[words("linear", &VECTOR_TERMS)]));
    let m3s = fitted_to(&lines, "m3s", &with_currents(&[word("coupling", "projection")]));
    assert!((m2c.residual_std / m3s.residual_std - 1.0).abs() < 1e-6, "{} {}", m2c.residual_std, m3s.residual_std);
    for (one, other) in predicted(&m2c, &lines[0]).iter().zip(predicted(&m3s, &lines[0])) {
        assert!((one - other).abs() < 1e-4, "{one} {other}");
    }
}

/// A line with its terms in one list column, as `a_matrix` makes them.
fn listed(line: &RecordBatch) -> RecordBatch {
    let names = VECTOR_TERMS.map(str::to_owned).to_vec();
    let columns: Vec<Vec<f64>> = VECTOR_TERMS.iter().map(|name| values(line, name)).collect();
    let rows = (0..line.num_rows()).flat_map(|row| columns.iter().map(move |c| c[row])).collect();
    let mut fields = vec![schemas::Column::list("tl", "", "", names).field()];
    let mut arrays = vec![crate::columns::list(rows, 18).unwrap()];
    for name in ["tt", "heater", "generator"] {
        fields.push(line.schema().field_with_name(name).unwrap().clone());
        arrays.push(line.column_by_name(name).unwrap().clone());
    }
    RecordBatch::try_new(Arc::new(arrow_schema::Schema::new(fields)), arrays).unwrap()
}

#[test]
fn law_terms_at_another_rate_are_converted() {
    let found = fitted_to(&flight(TRAINING, 1.0), "m3v", &with_currents(&unfiltered()));
    let fitted =
        |rate_hz: Option<f64>| FittedModel { body: FittedModelForm::Learned(Box::new(model(&found))), rate_hz };
    let of = |rate_hz: Option<f64>, line: &RecordBatch| {
        fitted(rate_hz).predict(&listed(line), line.num_rows()).map(|made| made.field_nt)
    };
    let (ten, five) = (line(6, 200, 1.0), line_at(5.0, 6, 100, 1.0));
    let expected = of(Some(10.0), &ten).unwrap();
    assert_eq!(expected, predicted(&found, &ten));
    let most = |found: Vec<f64>| {
        let pairs = found.into_iter().zip(expected.iter().step_by(2)).skip(1).take(98);
        pairs.map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
    };
    let (converted, unconverted) = (most(of(Some(10.0), &five).unwrap()), most(of(Some(5.0), &five).unwrap()));
    assert!(converted < 0.1 * unconverted, "{converted} {unconverted}");
    let fault = of(None, &five).err().unwrap();
    assert!(fault.what.contains("is a difference per sample"), "{fault}");
    // A model over a window has one rate.
    let windowed = fitted_to(&flight(0..2, 1.0), "m3w", &keys(&[whole("epochs", 2)]));
    let windowed = FittedModel { body: FittedModelForm::Learned(Box::new(model(&windowed))), rate_hz: Some(10.0) };
    let fault = windowed.predict(&listed(&five), 100).err().unwrap();
    assert!(fault.what.contains("but the line is sampled at"), "{fault}");
}

#[test]
fn unit_the_table_holds_the_whole_model() {
    let line = line(6, 50, 1.0);
    for (name, more) in
        [("m3tl", vec![]), ("m3v", vec![whole("members", 2)]), ("m3w", vec![whole("window", 3)]), ("m3tf", vec![])]
    {
        let found = fitted_to(&flight(0..2, 1.0), name, &keys(&[vec![whole("epochs", 2)], more].concat()));
        let model = model(&found);
        let kept: Vec<&String> = found.term.iter().filter(|term| !term.contains("epoch_")).collect();
        assert_eq!(model.terms().len(), kept.len(), "{name}");
        assert!(predicted(&found, &line).iter().all(|x| x.is_finite()), "{name}");
        for lost in ["coupling", "bt_scale_nt", "linear_term[4]", "linear[18]"] {
            let keep = |i: &usize| found.term[*i].split(' ').next() != Some(lost);
            let rows: Vec<usize> = (0..found.term.len()).filter(keep).collect();
            assert!(rows.len() < found.term.len(), "{name} {lost}");
            let names: Vec<String> = rows.iter().map(|i| found.term[*i].clone()).collect();
            let values: Vec<f64> = rows.iter().map(|i| found.value[*i]).collect();
            assert!(LearnedModel::read(&names, &values).is_err(), "{name} {lost}");
        }
    }
}

#[test]
fn unit_a_warm_start_continues_the_same_model() {
    for name in ["m3tl", "m3s", "m3v", "m3w", "m3tf"] {
        let keys = |rate: f64| keys(&[vec![whole("epochs", 3), number("learning_rate", rate)], unfiltered()].concat());
        let first = fitted_to(&flight(0..2, 1.0), name, &keys(0.01));
        let second = super::testing::begun_with(&first, &flight(0..2, 1.0), name, &keys(1e-300)).unwrap();
        let line = line(6, 50, 1.0);
        let (before, after) = (predicted(&first, &line), predicted(&second, &line));
        let constant = after[0] - before[0];
        for (before, after) in before.iter().zip(after) {
            assert!((after - before - constant).abs() < 1e-6, "{name}: {after} {before}");
        }
        let other = [keys(1e-3), vec![word("coupling", "projection")]].concat();
        let fault = super::testing::begun_with(&first, &flight(0..2, 1.0), name, &other).err().unwrap();
        assert!(fault.what.contains("has `coupling` magnitude with"), "{fault}");
    }
}

#[test]
fn unit_missing_values_constants_and_short_lines_are_handled() {
    let few = |more: &[(String, Literal)]| keys(&[&[whole("epochs", 2)], more].concat());
    let replaced = |line: &RecordBatch, name: &str, of: &dyn Fn(usize, f64) -> f64| {
        let at = line.schema().index_of(name).unwrap();
        let mut columns = line.columns().to_vec();
        columns[at] = Arc::new(values(line, name).iter().enumerate().map(|(i, x)| of(i, *x)).collect::<Float64Array>());
        RecordBatch::try_new(line.schema(), columns).unwrap()
    };
    let lines = flight(0..2, 1.0);
    let gaps: Vec<RecordBatch> =
        lines.iter().map(|line| replaced(line, "xx", &|i, x| if i == 200 { f64::NAN } else { x })).collect();
    let found = fitted_to(&gaps, "m3v", &few(&[]));
    assert!(found.rows == 798.0 && found.residual_std.is_finite(), "{}", found.rows);
    // A row without a field has terms that are not finite, and no prediction.
    let constant: Vec<RecordBatch> = lines.iter().map(|line| replaced(line, "heater", &|_, _| 1.0)).collect();
    let found = fitted_to(&constant, "m3s", &few(&[]));
    assert_eq!(found.warning, "constant and not used as inputs of the network: `heater`");
    let short = [lines[0].slice(0, 8), lines[1].slice(0, 8)];
    let fault = worked(&short, "m3s", &few(&[]), &NullMonitor).err().unwrap();
    assert!(fault.what.contains("long enough for the filter"), "{fault}");
    // Lines shorter than the filter are used in the training, but not in the ridge fit.
    let mixed = [lines[0].clone(), lines[1].slice(0, 8)];
    assert_eq!(fitted_to(&mixed, "m3w", &few(&[whole("window", 3)])).rows, 408.0);
    let level: Vec<RecordBatch> = lines.iter().map(|line| replaced(line, "target", &|_, _| 7.0)).collect();
    let fault = worked(&level, "m3tl", &few(&[]), &NullMonitor).err().unwrap();
    assert_eq!(fault.param.as_deref(), Some("target"), "{fault}");
}

#[test]
fn unit_keys_without_an_effect_and_invalid_keys_are_reported() {
    let idle = |model: &str, given: &[(String, Literal)], key: &str| {
        stage(model, given).unwrap().unused_key(key).map(|fault| fault.what).unwrap_or_default()
    };
    assert!(idle("m3tl", &[], "hidden").contains("because `m3tl` has no network"));
    assert!(idle("m3s", &[word("coupling", "projection")], "bt_scale_nt").contains("has no effect"));
    assert_eq!(idle("m3s", &[], "bt_scale_nt"), "");
    let wrong = |model: &str, given: (String, Literal), what: &str| {
        let lines = schemas::Table::Lines(schemas::TableShape { columns: vec![].into(), rate_hz: None });
        let faults = stage(model, &[given]).unwrap().yields(&[&lines]).err().unwrap();
        assert!(faults.iter().any(|fault| fault.what.contains(what)), "{model}: {faults:?}");
    };
    wrong("m3sc", whole("epochs", 9), "a curriculum requires at least 10 `epochs`");
    wrong("m3tf", whole("heads", 3), "`units` must be a multiple of `heads`");
    assert!(idle("m3s", &[], "curriculum_sigma").contains("belongs to `m3sc` and `m3vc`"));
    let wrong = keys(&[whole("epochs", 1), number("bt_scale_nt", 1.0)]);
    let fault = worked(&flight(0..2, 1.0), "m3s", &wrong, &NullMonitor).err().unwrap();
    assert_eq!(fault.param.as_deref(), Some("bt_scale_nt"), "{fault}");
}
