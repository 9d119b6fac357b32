#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field, Schema};
use grids::AnomalyGrid;
use schemas::{LineInput, Literal, SpecEntries, SpecEntry, SurveyAggregator};

use super::*;

/// The stage with parameters as in a spec.
fn stage(args: &[(&str, Literal)]) -> TrackMap {
    let given = |(name, value): &(&str, Literal)| {
        ((*name).to_owned(), SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 })
    };
    let args: SpecEntries = args.iter().map(given).collect();
    let built = (TrackMap::entry().build)(&args).unwrap();
    built.as_any().downcast_ref::<TrackMap>().unwrap().clone()
}

/// A given kernel, without core field, constants and temporal variation.
fn plain(more: &[(&str, Literal)]) -> TrackMap {
    let given = [
        ("hyperparameters", Literal::Text("fixed".into())),
        ("sigma_se_nt", Literal::Float(100.0)),
        ("length_m", Literal::Float(800.0)),
        ("sigma_n_nt", Literal::Float(0.5)),
        ("core_field", Literal::Bool(false)),
        ("fogm_sigma_nt", Literal::Float(0.0)),
        ("line_sigma_nt", Literal::Float(0.0)),
    ];
    let kept = given.into_iter().filter(|(name, _)| more.iter().all(|(other, _)| other != name));
    stage(&kept.chain(more.iter().cloned()).collect::<Vec<_>>())
}

const METRE_DEG: f64 = 1.0 / 111_195.0;

/// A smooth field, in nT, as a function of the metres east and north of latitude 45, longitude 9.
fn field_nt(east_m: f64, north_m: f64) -> f64 {
    200.0 * (east_m / 700.0).sin() * (north_m / 900.0).cos()
}

fn place(east_m: f64, north_m: f64) -> (f64, f64) {
    (45.0 + north_m * METRE_DEG, 9.0 + east_m * METRE_DEG / 0.5_f64.sqrt())
}

fn batch(columns: Vec<(&str, Vec<f64>)>) -> RecordBatch {
    let fields: Vec<Field> = columns.iter().map(|(name, _)| Field::new(*name, DataType::Float64, true)).collect();
    let arrays = columns.into_iter().map(|(_, v)| Arc::new(Float64Array::from(v)) as ArrayRef).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// An eastward line of 3 km with a sample every 50 m and every second; its track is `off_m` east of it.
fn line(number: usize, north_m: f64, off_m: f64) -> LineInput {
    let east: Vec<f64> = (0..60).map(|k| 50.0 * f64::from(k)).collect();
    let all = |x: f64| vec![x; 60];
    let tt: Vec<f64> = (0..60).map(|k| (100 * number + k) as f64).collect();
    let at = |off_m: f64| -> (Vec<f64>, Vec<f64>) { east.iter().map(|e| place(e + off_m, north_m)).unzip() };
    let ((lat, lon), (track_lat, track_lon)) = (at(0.0), at(off_m));
    let mag = east.iter().map(|e| field_nt(*e, north_m) + 40.0).collect();
    let lines = vec![
        ("tt", tt.clone()),
        ("mag_c", mag),
        ("lat", lat),
        ("lon", lon),
        ("alt", all(100.0)),
        ("diurnal", all(40.0)),
    ];
    let track = vec![
        ("tt", tt),
        ("lat", track_lat),
        ("lon", track_lon),
        ("alt", all(100.0)),
        ("sd_n", all(1.0)),
        ("sd_e", all(30.0)),
        ("cov_ne", all(0.0)),
    ];
    LineInput { flight: "1".into(), line: number.to_string(), inputs: vec![batch(lines), batch(track)], keep: None }
}

fn survey(off_m: f64, tracked: bool) -> Vec<LineInput> {
    let inputs = if tracked { 2 } else { 1 };
    (0..11)
        .map(|k| line(k, 300.0 * k as f64, off_m))
        .map(|l| LineInput { inputs: l.inputs[..inputs].to_vec(), ..l })
        .collect()
}

fn yielded(stage: &TrackMap, lines: &[LineInput]) -> Result<StageOutput, Fault> {
    let gather = TrackMap::gather(vec![crate::testing::point(stage)]);
    let parts = lines.iter().map(|line| gather.map(line).unwrap()).collect();
    gather.finish(parts, &schemas::NullMonitor).remove(0)
}

/// The map and the standard deviations of its nodes.
fn grid(product: &StageOutput) -> (AnomalyGrid, Vec<f64>) {
    let fields: Vec<Field> = schemas::map::made_columns("nT").iter().map(Column::field).collect();
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), product.columns[..7].to_vec()).unwrap();
    (AnomalyGrid::of_made(&batch).unwrap(), product.columns[7].as_primitive::<Float64Type>().values().to_vec())
}

/// Metres east and north of each node within the lines, with value and standard deviation.
fn nodes(product: &StageOutput) -> Vec<[f64; 4]> {
    let (map, sd) = grid(product);
    let mut nodes = vec![];
    for (i, (value, sd)) in map.anomaly_nt.iter().zip(sd).enumerate() {
        let (x, y) = (map.x.at((i % map.x.len) as f64), map.y.at((i / map.x.len) as f64));
        let (lat, lon) = map.crs.unproject(x, y).unwrap();
        let (east, north) = ((lon - 9.0) / METRE_DEG * 0.5_f64.sqrt(), (lat - 45.0) / METRE_DEG);
        if (200.0..2700.0).contains(&east) && (200.0..2800.0).contains(&north) {
            nodes.push([east, north, *value, sd]);
        }
    }
    nodes
}

fn rms(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0.0), |(sum, count), e| (sum + e * e, count + 1.0));
    (sum / count).sqrt()
}

#[test]
fn law_measurements_at_known_positions_reproduce_the_field() {
    let product = yielded(&plain(&[("spacing_m", Literal::Float(100.0))]), &survey(0.0, false)).unwrap();
    let (map, _) = grid(&product);
    assert_eq!((map.crs.code(), map.height_at(5), map.x.step), (32632, 100.0, 100.0));
    let nodes = nodes(&product);
    let (error, sd) =
        (rms(nodes.iter().map(|[e, n, value, _]| value - field_nt(*e, *n))), rms(nodes.iter().map(|node| node[3])));
    println!("error {error:.2} nT, sd {sd:.2} nT");
    // The field is smoother than the kernel, so the error is below its expected value.
    assert!(nodes.len() > 500 && error < sd && error < 1.5, "{error} {sd}");
    assert!(product.warnings.is_empty(), "{:?}", product.warnings);
}

#[test]
fn unit_the_map_follows_the_track() {
    let product = yielded(&plain(&[("spacing_m", Literal::Float(100.0))]), &survey(25.0, true)).unwrap();
    let nodes = nodes(&product);
    let moved = rms(nodes.iter().map(|[e, n, value, _]| value - field_nt(e - 25.0, *n)));
    let error = rms(nodes.iter().map(|[e, n, value, _]| value - field_nt(*e, *n)));
    let sd = rms(nodes.iter().map(|node| node[3]));
    println!("{moved:.2} nT where the track is, {error:.2} nT where the lines are, sd {sd:.2} nT");
    // The track error is 25 m, its standard deviation 30 m, and slopes are up to 0.29 nT/m. The field is smoother than
    // the kernel.
    assert!(moved < 1.5 && error > 2.0 && (0.3..1.5).contains(&(error / sd)), "{moved} {error} {sd}");
}

#[test]
fn unit_unknown_nodes_are_nan_and_bounds_are_respected() {
    let known = |args: &[(&str, Literal)]| {
        let product = yielded(&plain(args), &survey(0.0, false)).unwrap();
        let (map, sd) = grid(&product);
        assert!(map.anomaly_nt.iter().zip(&sd).all(|(value, sd)| value.is_nan() == sd.is_nan()));
        (sd.iter().filter(|sd| sd.is_finite()).fold(0.0_f64, |most, sd| most.max(*sd)), map)
    };
    let (all, whole) = known(&[("max_sd_nt", Literal::Float(1e9))]);
    let (some, _) = known(&[("max_sd_nt", Literal::Float(5.0))]);
    assert!(all > 5.0 && some <= 5.0, "{all} {some}");
    assert!((whole.x.step - 800.0 / 6.0).abs() < 1e-9);
    let (west, south) = (whole.x.at(5.0), whole.y.at(5.0));
    let bounds = [west, south, west + 1000.0, south + 800.0].map(Literal::Float).to_vec();
    let (_, part) = known(&[("bounds", Literal::List(bounds)), ("spacing_m", Literal::Float(200.0))]);
    assert!(part.x.first <= west && part.x.last() >= west + 1000.0 && part.x.len <= 7, "{:?}", part.x);
}

#[test]
fn unit_a_mean_over_an_interval_is_one_measurement() {
    let stage = plain(&[("interval_s", Literal::Float(2.0))]);
    let line = line(3, 0.0, 0.0);
    let gather = TrackMap::gather(vec![crate::testing::point(&stage)]);
    let part = gather.map(&line).unwrap();
    assert!(gather.refused(&part).is_empty());
    let all = stage.measured(&line).unwrap();
    assert_eq!(all.len(), 30);
    let expected = 0.5 * (field_nt(100.0, 0.0) + field_nt(150.0, 0.0));
    assert!((all[1].value_nt - expected).abs() < 1e-9 && (all[1].tt_s - 302.5).abs() < 1e-9, "{:?}", all[1]);
    assert_eq!(all[1].position_m2, [900.0, 1.0, 0.0]);
    let keep = Some((0..60).map(|row| row < 10).collect());
    assert_eq!(stage.measured(&LineInput { keep, ..line }).unwrap().len(), 5);
}

#[test]
fn gold_unusable_lines_are_rejected_with_the_reason() {
    let plainly = plain(&[]);
    let two = line(1, 0.0, 0.0);
    let later = batch(
        two.inputs[1]
            .schema()
            .fields()
            .iter()
            .map(|f| (f.name().as_str(), crate::columns::floats(&two.inputs[1], f.name()).unwrap().to_vec()))
            .map(|(name, x)| (name, if name == "tt" { x.iter().map(|t| t + 1.0).collect() } else { x }))
            .collect(),
    );
    let fault = plainly.measured(&LineInput { inputs: vec![two.inputs[0].clone(), later], ..two.clone() }).unwrap_err();
    assert!(fault.to_string().contains("different samples"), "{fault}");
    let none = LineInput { keep: Some(vec![false; 60]), ..two.clone() };
    assert!(plainly.measured(&none).unwrap_err().to_string().contains("no sample has a height, a measurement"));
    let gather = TrackMap::gather(vec![crate::testing::point(&plainly)]);
    assert_eq!(gather.refused(&gather.map(&none).unwrap()).len(), 1);
    let refused = |args: &[(&str, Literal)]| yielded(&plain(args), &survey(0.0, false)).unwrap_err().to_string();
    assert!(refused(&[("max_sd_nt", Literal::Float(1e-3))]).contains("no node has a standard deviation below"));
    assert!(refused(&[("spacing_m", Literal::Float(1e-2))]).contains("nodes, 0.0 m apart"));
    let far = [9e5, 9e6, 9.1e5, 9.1e6].map(Literal::Float).to_vec();
    assert!(refused(&[("bounds", Literal::List(far))]).contains("no measurement"));
    assert!(refused(&[("max_functions", Literal::Int(3))]).contains("too large"));
    let columns = |names: &[(&str, &str)]| {
        Table::Lines(TableShape {
            columns: names.iter().map(|(n, u)| Column::float(*n, *u, "")).collect(),
            rate_hz: None,
        })
    };
    let lines = columns(&[("tt", "s"), ("mag_c", "nT"), ("lat", "deg"), ("lon", "deg"), ("alt", "m")]);
    let faults = stage(&[]).yields(&[&lines]).unwrap_err();
    assert!(faults.iter().any(|f| f.what.contains("needs a date")), "{faults:?}");
    let faults = plainly.yields(&[&lines, &lines]).unwrap_err();
    assert!(faults.iter().any(|f| f.what.contains("sd_n")), "{faults:?}");
    let yields = plainly.yields(&[&lines]).unwrap();
    assert_eq!(yields.columns.last().map(|c| c.name.as_str()), Some("sd"));
}
