#![allow(clippy::unwrap_used)]

use arrow_array::{Array, cast::AsArray, types::Float64Type};

use super::*;

const WHOLE: SeriesWindow = SeriesWindow { from: f64::NEG_INFINITY, to: f64::INFINITY, pixels: 1000 };

fn column(values: Vec<f64>) -> SeriesColumn {
    let text = String::new;
    SeriesColumn {
        name: "x".to_owned(),
        unit: "nT".to_owned(),
        role: text(),
        description: text(),
        values: Arc::new(values),
    }
}

fn made(tt: &[f64], values: Vec<f64>, window: SeriesWindow) -> Series {
    series(tt, &[column(values)], window, SeriesPrecision::Full, HashMap::new()).unwrap()
}

fn floats<'a>(series: &'a Series, name: &str) -> &'a [f64] {
    series.batch.column_by_name(name).unwrap().as_primitive::<Float64Type>().values()
}

#[test]
fn unit_one_spike_in_a_million_samples_is_kept() {
    let tt: Vec<f64> = (0..1_000_000).map(|k| 45_000.0 + f64::from(k) / 10.0).collect();
    for row in [0, 1, 499_999, 777_777, 999_999] {
        let mut values = vec![0.5; tt.len()];
        values[row] = -3e4;
        let thin = made(&tt, values, WHOLE);
        assert!(thin.is_thinned && thin.batch.num_rows() == 1000);
        let lowest = floats(&thin, "x.min").iter().position(|v| *v == -3e4).unwrap();
        assert!((floats(&thin, "tt_first")[lowest]..=floats(&thin, "tt_last")[lowest]).contains(&tt[row]));
        assert_eq!(floats(&thin, "x.min").iter().filter(|v| **v == 0.5).count(), 999);
    }
}

#[test]
fn law_each_interval_has_the_extremes_of_its_rows() {
    let tt: Vec<f64> = (0..50_000).map(|k| f64::from(k) * 0.1 + f64::from(k % 7) * 0.01).collect();
    let values: Vec<f64> = tt.iter().map(|t| (t * 0.37).sin() * t).collect();
    let thin = made(&tt, values.clone(), WHOLE);
    let counts = thin.batch.column_by_name("n").unwrap().as_primitive::<arrow_array::types::UInt32Type>().values();
    assert_eq!(counts.iter().sum::<u32>(), 50_000);
    for i in 0..thin.batch.num_rows() {
        let (from, to) = (floats(&thin, "tt_first")[i], floats(&thin, "tt_last")[i]);
        let inside: Vec<f64> = tt.iter().zip(&values).filter(|(t, _)| **t >= from && **t <= to).map(|p| *p.1).collect();
        assert_eq!(inside.len(), counts[i] as usize);
        assert_eq!(floats(&thin, "x.min")[i], inside.iter().copied().fold(f64::INFINITY, f64::min));
        assert_eq!(floats(&thin, "x.max")[i], inside.iter().copied().fold(f64::NEG_INFINITY, f64::max));
    }
    // The intervals have equal widths.
    let width = (tt[49_999] - tt[0]) / 1000.0;
    assert!((0..1000).all(|i| floats(&thin, "tt_last")[i] - floats(&thin, "tt_first")[i] <= width));
}

#[test]
fn unit_the_window_includes_the_nearest_row_on_each_side() {
    let tt: Vec<f64> = (0..100).map(f64::from).collect();
    let of = |from: f64, to: f64| selected(&tt, SeriesWindow { from, to, pixels: 10 });
    assert_eq!(of(f64::NEG_INFINITY, f64::INFINITY), 0..100);
    assert_eq!((of(10.0, 20.0), of(10.5, 20.5)), (9..22, 10..22));
    assert_eq!((of(10.2, 10.8), of(-5.0, -1.0), of(200.0, 300.0)), (10..12, 0..1, 99..100));
    assert_eq!((of(50.0, 40.0).len() < 100, selected(&[], WHOLE)), (true, 0..0));
    let raw = made(&tt, tt.clone(), SeriesWindow { from: 10.0, to: 20.0, pixels: 7 });
    assert!(!raw.is_thinned && raw.batch.num_rows() == 13);
    assert_eq!((floats(&raw, "x"), floats(&raw, "tt")), (&tt[9..22], &tt[9..22]));
    assert!(made(&tt, tt.clone(), SeriesWindow { from: 10.0, to: 20.0, pixels: 6 }).is_thinned);
}

#[test]
fn unit_missing_values_are_null_and_counted() {
    let tt: Vec<f64> = (0..10_000).map(f64::from).collect();
    let values = tt.iter().map(|t| if (4000.0..5005.0).contains(t) { f64::NAN } else { *t }).collect();
    let thin = made(&tt, values, WHOLE);
    let least = thin.batch.column_by_name("x.min").unwrap();
    let present = thin.batch.column_by_name("x.n").unwrap().as_primitive::<arrow_array::types::UInt32Type>();
    assert_eq!(present.values().iter().sum::<u32>(), 10_000 - 1005);
    for i in 0..thin.batch.num_rows() {
        assert_eq!(least.is_null(i), present.value(i) == 0);
    }
    assert!(least.null_count() >= 100);
    assert!(made(&tt, tt.clone(), WHOLE).batch.column_by_name("x.n").is_none());
    let infinite = made(&[0.0, 1.0], vec![f64::INFINITY, 2.0], WHOLE);
    assert!(infinite.batch.column_by_name("x").unwrap().is_null(0));
}

#[test]
fn unit_times_that_do_not_ascend_lose_no_row() {
    let zigzag: Vec<f64> = (0..10_000).map(|k| if k % 2 == 0 { 0.0 } else { 100.0 }).collect();
    let constant = vec![7.0; 10_000];
    let mut holes: Vec<f64> = (0..10_000).map(f64::from).collect();
    holes[5] = f64::NAN;
    holes[9_999] = f64::NAN;
    let unknown = vec![f64::NAN; 10_000];
    for tt in [zigzag, constant, holes, unknown] {
        let parts = intervals(&tt, 0..10_000, 300);
        assert!(parts.len() <= 300 && parts.first().unwrap().start == 0 && parts.last().unwrap().end == 10_000);
        assert!(parts.windows(2).all(|w| w[0].end == w[1].start));
    }
}

#[test]
fn law_compact_values_are_within_the_stated_error() {
    let tt: Vec<f64> = (0..5000).map(f64::from).collect();
    let values: Vec<f64> = tt.iter().map(|t| 54_321.25 + 300.0 * (t * 0.01).sin()).collect();
    let thin = series(&tt, &[column(values.clone())], WHOLE, SeriesPrecision::Compact, HashMap::new()).unwrap();
    let exact = made(&tt, values, WHOLE);
    let field = thin.batch.schema().field_with_name("x.max").unwrap().clone();
    let offset: f64 = field.metadata()["offset"].parse().unwrap();
    let stored = thin.batch.column_by_name("x.max").unwrap().as_primitive::<arrow_array::types::Float32Type>();
    let error = |i: usize| (f64::from(stored.value(i)) + offset - floats(&exact, "x.max")[i]).abs();
    let largest = (0..stored.len()).map(error).fold(0.0, f64::max);
    assert!(largest <= thin.errors[0] && thin.errors[0] <= 300.0 * f64::from(f32::EPSILON), "{:?}", thin.errors);
    // One large outlier would hide the other values, so they stay Float64.
    let mut odd: Vec<f64> = tt.iter().map(|t| (t * 0.01).sin()).collect();
    odd[77] = 1e12;
    let thin = series(&tt, &[column(odd)], WHOLE, SeriesPrecision::Compact, HashMap::new()).unwrap();
    assert_eq!(thin.batch.column_by_name("x.max").unwrap().data_type(), &DataType::Float64);
    assert_eq!(thin.errors, [0.0]);
}

#[test]
fn val_the_stream_is_read_by_arrow() {
    let tt: Vec<f64> = (0..10).map(f64::from).collect();
    let about = HashMap::from([("line".to_owned(), "1\"<\u{1b}\u{202e}".to_owned())]);
    let made = series(&tt, &[column(tt.clone())], WHOLE, SeriesPrecision::Full, about).unwrap();
    let bytes = made.stream().unwrap();
    let mut reader = arrow_ipc::reader::StreamReader::try_new(bytes.as_slice(), None).unwrap();
    let batch = reader.next().unwrap().unwrap();
    assert_eq!((batch.clone(), reader.next().is_none()), (made.batch.clone(), true));
    let schema = batch.schema();
    assert_eq!((schema.metadata()["line"].as_str(), schema.metadata()["first"].as_str()), ("1\"<\u{1b}\u{202e}", "0"));
    assert_eq!(schema.field(1).metadata()["unit"], "nT");
}

#[test]
fn unit_elements_of_a_list_have_the_values_of_one_sample() {
    let tt: Vec<f64> = (0..10_000).map(f64::from).collect();
    let element = SeriesColumn { name: "modes[2]".to_owned(), ..column(tt.iter().map(|t| t * t).collect()) };
    let window = SeriesWindow { pixels: 100, ..WHOLE };
    let thin = series(&tt, &[element], window, SeriesPrecision::Full, HashMap::new()).unwrap();
    let squares: Vec<f64> = floats(&thin, "tt_first").iter().map(|t| t * t).collect();
    assert!(thin.is_thinned && floats(&thin, "modes[2].first") == squares);
    assert_eq!(list_element("modes[2]"), Some(("modes", 2)));
    assert!(["modes", "modes[]", "modes[-1]", "modes[2", "[x]"].iter().all(|name| list_element(name).is_none()));
}
