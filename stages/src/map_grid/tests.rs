#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{Float64Array, RecordBatch};
use arrow_schema::{Field, Schema};
use schemas::{LineInput, Literal, SpecEntries, SpecEntry, SurveyAggregator};

use super::*;

/// The stage with parameters as in a spec.
fn stage(args: &[(&str, Literal)]) -> MapGrid {
    let given = |(name, value): &(&str, Literal)| {
        ((*name).to_owned(), SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 })
    };
    let args: SpecEntries = args.iter().map(given).collect();
    let built = (MapGrid::entry().build)(&args).unwrap();
    built.as_any().downcast_ref::<MapGrid>().unwrap().clone()
}

const METRE_DEG: f64 = 1.0 / 111_195.0;

/// A smooth field, in nT, as a function of the metres east and north.
fn field_nt(east_m: f64, north_m: f64) -> f64 {
    200.0 * (east_m / 700.0).sin() * (north_m / 900.0).cos()
}

/// An east-west line with a point every 50 m over 3 km, at `north_m` from latitude 45 and longitude 9.
fn line(number: usize, north_m: f64, shift_nt: f64) -> LineInput {
    let east: Vec<f64> = (0..60).map(|k| 50.0 * k as f64).collect();
    let columns: Vec<(&str, Vec<f64>)> = vec![
        ("lat", vec![45.0 + north_m * METRE_DEG; 60]),
        ("lon", east.iter().map(|e| 9.0 + e * METRE_DEG / 45_f64.to_radians().cos()).collect()),
        ("alt", vec![100.0; 60]),
        ("anomaly", east.iter().map(|e| field_nt(*e, north_m) + shift_nt).collect()),
    ];
    line_of(number, columns)
}

fn line_of(number: usize, columns: Vec<(&str, Vec<f64>)>) -> LineInput {
    let fields: Vec<Field> =
        columns.iter().map(|(name, _)| Field::new(*name, arrow_schema::DataType::Float64, true)).collect();
    let arrays = columns.into_iter().map(|(_, v)| Arc::new(Float64Array::from(v)) as ArrayRef).collect();
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap();
    LineInput { flight: "1".into(), line: number.to_string(), inputs: vec![batch], keep: None }
}

fn survey() -> Vec<LineInput> {
    (0..15).map(|k| line(k, 200.0 * k as f64, 0.0)).collect()
}

fn yielded(stages: &[&MapGrid], lines: &[LineInput]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
    let gather = MapGrid::gather(stages.iter().map(|stage| crate::testing::point(*stage)).collect());
    let parts = lines.iter().map(|line| gather.map(line).unwrap()).collect();
    gather.finish(parts, &schemas::NullMonitor).into_iter().map(|made| made.map(|product| product.columns)).collect()
}

fn grid(answer: Result<Vec<ArrayRef>, Fault>) -> AnomalyGrid {
    let columns = answer.unwrap();
    let fields: Vec<Field> = schemas::map::made_columns("nT").iter().map(Column::field).collect();
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns[..7].to_vec()).unwrap();
    AnomalyGrid::of_made(&batch).unwrap()
}

#[test]
fn law_gridded_points_reproduce_the_field() {
    let level = stage(&[("spacing_m", Literal::Float(100.0)), ("level_m", Literal::Float(100.0))]);
    let surface = stage(&[("spacing_m", Literal::Float(100.0)), ("method", Literal::Text("minimum_curvature".into()))]);
    let mut answers = yielded(&[&level, &surface], &survey()).into_iter().map(grid);
    for map in [answers.next().unwrap(), answers.next().unwrap()] {
        assert_eq!(map.crs.code(), 32632);
        assert_eq!(map.height_at(200), 100.0);
        let mut sum = (0.0, 0.0);
        for (i, value) in map.anomaly_nt.iter().enumerate() {
            let (x, y) = (map.x.at((i % map.x.len) as f64), map.y.at((i / map.x.len) as f64));
            let (lat, lon) = map.crs.unproject(x, y).unwrap();
            let (north, east) = ((lat - 45.0) / METRE_DEG, (lon - 9.0) / METRE_DEG * 45_f64.to_radians().cos());
            let inside = (300.0..2600.0).contains(&north) && (300.0..2600.0).contains(&east);
            if inside {
                sum = (sum.0 + (value - field_nt(east, north)).powi(2), sum.1 + 1.0);
            }
        }
        // Lines are 200 m apart over waves of 4 km and more. The field is not exactly a potential field.
        assert!(sum.1 > 300.0 && (sum.0 / sum.1).sqrt() < 2.0, "{sum:?}");
    }
}

#[test]
fn law_tie_lines_reveal_biased_lines() {
    let mut lines: Vec<LineInput> =
        (0..15).map(|k| line(k, 200.0 * k as f64, if k == 7 { 30.0 } else { 0.0 })).collect();
    for tie in 0..4 {
        let east_m = 600.0 * f64::from(tie) + 300.0;
        let north: Vec<f64> = (0..60).map(|k| 50.0 * k as f64 - 25.0).collect();
        lines.push(line_of(
            100 + tie as usize,
            vec![
                ("lat", north.iter().map(|n| 45.0 + n * METRE_DEG).collect()),
                ("lon", vec![9.0 + east_m * METRE_DEG / 45_f64.to_radians().cos(); 60]),
                ("alt", vec![100.0; 60]),
                ("anomaly", north.iter().map(|n| field_nt(east_m, *n)).collect()),
            ],
        ));
    }
    let of = |args: &[(&str, Literal)]| {
        let surface = [
            ("spacing_m", Literal::Float(100.0)),
            ("method", Literal::Text("minimum_curvature".into())),
            ("block_m", Literal::Float(0.0)),
        ];
        grid(yielded(&[&stage(&[&surface[..], args].concat())], &lines).remove(0))
    };
    let (raw, levelled) = (of(&[]), of(&[("level_order", Literal::Int(0))]));
    let worst = |map: &AnomalyGrid| {
        let value = |north_m: f64| {
            let (x, y) =
                map.crs.project(45.0 + north_m * METRE_DEG, 9.0 + 1500.0 * METRE_DEG / 0.5_f64.sqrt()).unwrap();
            let (i, j) = ((x - map.x.first) / map.x.step, (y - map.y.first) / map.y.step);
            map.anomaly_nt[j.round() as usize * map.x.len + i.round() as usize]
        };
        (value(1400.0) - 0.5 * (value(1200.0) + value(1600.0))).abs()
    };
    assert!(worst(&raw) > 15.0 && worst(&levelled) < 8.0, "{} {}", worst(&raw), worst(&levelled));
}

#[test]
fn unit_the_expected_error_is_a_column() {
    let stage = stage(&[("cross_validate", Literal::Int(3)), ("spacing_m", Literal::Float(200.0))]);
    let columns = yielded(&[&stage], &survey()).remove(0).unwrap();
    assert_eq!(columns.len(), 8);
    let table = Table::Lines(TableShape {
        columns: vec![
            Column::float("lat", "deg", ""),
            Column::float("lon", "deg", ""),
            Column::float("alt", "m", ""),
            Column::float("anomaly", "nT", ""),
        ]
        .into(),
        rate_hz: None,
    });
    let yields = stage.yields(&[&table]).unwrap();
    assert_eq!(yields.columns.last().map(|c| c.name.as_str()), Some("error"));
}

#[test]
fn gold_invalid_surveys_are_rejected_with_the_reason() {
    let refused = |args: &[(&str, Literal)], lines: &[LineInput]| {
        let fault = yielded(&[&stage(args)], lines).remove(0).err();
        fault.map(|f| format!("{f} {}", f.help.clone().unwrap_or_default())).unwrap_or_default()
    };
    let spacing = |spacing_m: f64| ("spacing_m", Literal::Float(spacing_m));
    let all = survey();
    assert!(refused(&[spacing(1e5)], &all).contains("below the extent"), "{}", refused(&[spacing(1e5)], &all));
    let low = [spacing(200.0), ("level_m", Literal::Float(-500.0))];
    assert!(refused(&low, &all).contains("set `level_m = "), "{}", refused(&low, &all));
    let level = [spacing(200.0), ("level_order", Literal::Int(0))];
    assert!(refused(&level, &all).contains("no lines cross"), "{}", refused(&level, &all));
    let nothing = |name: &str| {
        let replaced = |line: &LineInput| {
            let batch = &line.inputs[0];
            let column = |other: &str| match other == name {
                true => vec![f64::NAN; batch.num_rows()],
                false => crate::columns::floats(batch, other).unwrap().to_vec(),
            };
            line_of(1, ["lat", "lon", "alt", "anomaly"].map(|other| (other, column(other))).into())
        };
        all.iter().map(replaced).collect::<Vec<LineInput>>()
    };
    for (name, expected) in
        [("anomaly", "900 without a finite"), ("alt", "900 without a finite"), ("lat", "no point has a position")]
    {
        assert!(
            refused(&[spacing(200.0)], &nothing(name)).contains(expected),
            "{}",
            refused(&[spacing(200.0)], &nothing(name))
        );
    }
    let one = line_of(1, ["lat", "lon", "alt", "anomaly"].map(|name| (name, vec![45.0])).into());
    let message = refused(&[spacing(200.0)], &[one]);
    assert!(message.contains("1 on lines with too few points"), "{message}");
    let message = refused(&[spacing(200.0)], &all[..1]);
    assert!(message.contains("no node of the map is within `mask_m`"), "{message}");
}
