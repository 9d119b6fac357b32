#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{Array, Float64Array, RecordBatch};
use arrow_schema::Schema;
use numerics::maps::plane_grid::EvenAxis;
use schemas::map::NativeGrid;

use grids::{AnomalyGrid, Crs, GridHeight, geographic};

use crate::{MapOptions, read_grid, read_map, samples};

#[test]
fn unit_stages_receive_a_projected_map_unchanged() {
    let path = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    let grid = read_grid(&path, &MapOptions::default()).unwrap();
    let table = grid.table().unwrap();
    let column = |name: &str| {
        let column = table.column_by_name(name).unwrap().as_any().downcast_ref::<Float64Array>().unwrap();
        column.values().to_vec()
    };
    assert_eq!(column("anomaly").len(), grid.anomaly_nt.len());
    let same = |a: &f64, b: &f64| a == b || a.is_nan() && b.is_nan();
    assert!(column("anomaly").iter().zip(&grid.anomaly_nt).all(|(a, b)| same(a, b)));
    assert!(column("alt").iter().all(|a| *a == 500.0));
    assert_eq!((column("easting")[1], column("northing")[1]), (grid.x.at(1.0), grid.y.first));
    let own = NativeGrid::from_schema(&table.schema()).unwrap().unwrap();
    assert_eq!((own.epsg, own.unit_m), (32754, [1.0, 1.0]));
    for (x, y) in grid.outline() {
        let (lat, lon) = grid.crs.unproject(x, y).unwrap();
        assert!(own.lat_deg[0] < lat && lat < own.lat_deg[1] && own.lon_deg[0] < lon && lon < own.lon_deg[1]);
    }
    // The conversion back to the standard map table.
    assert_eq!(geographic(&table).unwrap().batch, read_map(&path, &MapOptions::default()).unwrap().batch);
}

#[test]
fn unit_the_map_of_a_stage_is_read_back_unchanged() {
    for (sample, own) in [("osborne/osborne_anomaly_100m_at_500m.tif", true), ("simple_magnav/map.h5", false)] {
        let grid = read_grid(&samples::path(sample), &MapOptions::default()).unwrap();
        let fields: Vec<_> = schemas::map::made_columns("nT").iter().map(schemas::Column::field).collect();
        let rows = RecordBatch::try_new(Arc::new(Schema::new(fields)), grid.made().unwrap()).unwrap();
        let names: Vec<String> = rows.schema().fields().iter().map(|f| f.name().clone()).collect();
        assert_eq!(names, schemas::map::MADE_COLUMNS);
        assert_eq!(rows.column_by_name("easting").unwrap().null_count() == 0, own);
        let back = AnomalyGrid::of_made(&rows).unwrap();
        assert_eq!((back.crs.code(), back.x.len, back.y.len), (grid.crs.code(), grid.x.len, grid.y.len));
        let same = |a: &f64, b: &f64| a == b || a.is_nan() && b.is_nan();
        assert!(back.anomaly_nt.iter().zip(&grid.anomaly_nt).all(|(a, b)| same(a, b)));
        let ends = [(back.x, grid.x), (back.y, grid.y)];
        assert!(ends.iter().all(|(a, b)| a.first == b.first && (a.last() - b.last()).abs() < 1e-9 * b.last().abs()));
        assert_eq!(back.height_at(7), grid.height_at(7));
    }
}

#[test]
fn unit_a_map_in_degrees_is_the_standard_table() {
    let path = samples::path("simple_magnav/map.h5");
    let (grid, map) =
        (read_grid(&path, &MapOptions::default()).unwrap(), read_map(&path, &MapOptions::default()).unwrap());
    assert_eq!(grid.table().unwrap(), map.batch);
    assert_eq!(geographic(&map.batch).unwrap().batch, map.batch);
}

#[test]
fn unit_stages_receive_a_map_around_a_pole() {
    let crs = Crs::from_epsg(std::path::Path::new("map"), 3413).unwrap();
    let axis = EvenAxis { first: -300_000.0, step: 50_000.0, len: 13 };
    let grid = AnomalyGrid::new(axis, axis, crs, vec![1.0; 169], GridHeight::Level(1000.0)).unwrap();
    let own = NativeGrid::from_schema(&grid.table().unwrap().schema()).unwrap().unwrap();
    assert_eq!((own.lat_deg[1], own.lon_deg), (90.0, [-180.0, 180.0]));
    assert!(own.lat_deg[0] < 87.0 && own.lat_deg[0] > 84.0, "{:?}", own.lat_deg);
    assert!(grid.to_geographic().is_err());
}
