//! Appends the value of a map at every sample.

use arrow_array::RecordBatch;
use numerics::{
    earth::geodesy::EarthModel,
    maps::{map_stack::FieldMap, map_surface::MapInterpolation},
};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Role, Stage, StageSchema, Table, TableShape, stage};

use crate::{
    columns::{array, faults_of, floats, role_of, shape},
    core_field::PositionSource,
    maps::{check_levels, field_map},
};

stage! {
    /// Appends the value of a map at every sample: the anomaly `map_anomaly` and its slopes `map_grad_n`, `map_grad_e`,
    /// `map_grad_u` (per metre north, east and up).
    ///
    /// Use `map_value` to compare a signal with the map, or to assess a map for navigation. The result is NaN for a
    /// sample off the map, in a cell with an unknown node, or without a position. A map in eastings and northings is
    /// interpolated on its native grid: the position is projected, and the slopes are rotated back to north and east.
    ///
    /// By default, the map is used at its own height, and `map_grad_u` is 0. `map_levels_m` gives the heights to which
    /// the map is continued. The stage interpolates between these levels, so that the values follow climbs and
    /// descents. The result is NaN for a sample that is outside the levels by more than half the distance between two
    /// levels. Downward continuation amplifies short wavelengths, so keep the levels at or above the height of the map.
    ///
    /// Source: Gnadt 2022, section 2.3; Blakely 1996, chapter 12.
    MapValue = "map_value", version 5, grain Line, role ReadsMap, inputs [input: Lines, map: Map],
    example r#"
[[stages]]
name         = "map_value"
stage        = "map_value"
input        = "resample"
map          = "anomaly"
map_levels_m = [300.0, 400.0]
"#;
    /// Position at which the map is evaluated: the true position (`lat`, `lon`, `alt`) or the INS position. Columns
    /// computed at the true position have the role truth; a model can use them as features only with `allow_truth`.
    position: Option<PositionSource>, unit "",
        absent "the INS position if the flight has `ins_lat`, `ins_lon` and `ins_alt`, otherwise the true position";
    /// Interpolation of the map. The field above its sources is smooth, so spline interpolation is more accurate than
    /// bilinear interpolation.
    map_interpolation: MapInterpolation, unit "", default MapInterpolation::Cubic;
    /// Heights above the WGS-84 ellipsoid, ascending, to which the map is continued.
    map_levels_m: Option<Vec<f64>>, unit "m", absent "the map is used at its own height";
}

/// Value of the map at each sample.
pub(crate) const MAP_ANOMALY: &str = "map_anomaly";

impl MapValue {
    /// Columns of the position. `has` states whether the table has a column.
    fn place(&self, has: impl Fn(&str) -> bool) -> [&'static str; 3] {
        let ins = PositionSource::Ins.columns();
        let found = if ins.iter().all(|name| has(name)) { PositionSource::Ins } else { PositionSource::Truth };
        self.position.unwrap_or(found).columns()
    }
}

/// Note on a table whose `map_anomaly` is at the INS position, for a stage that uses it as the true field.
pub(crate) fn note_of_ins_position(shape: &TableShape) -> Option<String> {
    let derived = shape.get(MAP_ANOMALY).is_some_and(|column| column.role == Role::Derived);
    let is_known =
        PositionSource::Truth.columns().iter().all(|name| shape.get(name).is_some_and(|c| c.role == Role::Truth));
    let what = "`map_anomaly` is evaluated at the INS position and includes the INS error; set `position = \
                \"truth\"` in `map_value` for the true field";
    (derived && is_known).then(|| what.to_owned())
}

impl Stage for MapValue {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let place = self.place(|name| shape.get(name).is_some());
        let units = ["deg", "deg", "m"];
        let mut faults = faults_of(place.iter().zip(units).map(|(c, unit)| shape.number(c, unit)), "position");
        faults.extend(check_levels(self.map_levels_m.as_ref(), "map_levels_m"));
        if !faults.is_empty() {
            return Err(faults);
        }
        // The map at the true position reveals the position, so it cannot be a feature.
        let role = role_of(shape, &place);
        let made = |name: &str, unit: &str, doc: &str| {
            Column::float(name, unit, doc).role(role).from(0, &place).from(1, &["anomaly"])
        };
        let columns = vec![
            made(MAP_ANOMALY, "nT", "anomaly of the map"),
            made("map_grad_n", "nT/m", "slope of the map to the north"),
            made("map_grad_e", "nT/m", "slope of the map to the east"),
            made("map_grad_u", "nT/m", "upward slope of the map"),
        ];
        let map = ["lat", "lon", "alt", "anomaly"].map(str::to_owned).to_vec();
        let place = place.map(str::to_owned).to_vec();
        Ok(StageSchema { reads: vec![place.clone(), map], ..StageSchema::append(columns, &place) })
    }
}

impl LineStage for MapValue {
    type Prepared = FieldMap;

    fn run(&self, line: &LineInput, map: &FieldMap) -> LineOutput {
        let batch = &line.inputs[0];
        let [lat, lon, alt] = self.place(|name| batch.column_by_name(name).is_some());
        let columns = looked_up(map, floats(batch, lat)?, floats(batch, lon)?, floats(batch, alt)?)?;
        Ok(columns.map(array).into())
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<FieldMap, Fault> {
        let map = inputs.get(1).ok_or_else(|| Fault::data("the map is missing"))?;
        field_map(map, self.map_interpolation, self.map_levels_m.as_deref())
    }

    fn prepare_key(&self) -> String {
        format!("{} {:?}", self.map_interpolation.word(), self.map_levels_m)
    }
}

/// Value of a map at positions (degrees, degrees, metres above the WGS-84 ellipsoid): the anomaly in nT and its slopes
/// north, east and up in nT/m. NaN off the map, in a cell with an unknown node and without a position.
///
/// # Errors
/// Fails if no sample is on the map.
pub(crate) fn looked_up(map: &FieldMap, lat: &[f64], lon: &[f64], alt: &[f64]) -> Result<[Vec<f64>; 4], Fault> {
    let earth = EarthModel::Wgs84;
    let mut columns = [(); 4].map(|()| Vec::with_capacity(lat.len()));
    for i in 0..lat.len() {
        let row = map.at(lat[i], lon[i], alt[i]).map_or([f64::NAN; 4], |field| {
            let at = lat[i].to_radians();
            [
                field.value_nt,
                field.d_lat_nt_per_rad / earth.north_m_per_rad(at, alt[i]),
                field.d_lon_nt_per_rad / earth.east_m_per_rad(at, alt[i]),
                field.d_alt_nt_per_m,
            ]
        });
        columns.iter_mut().zip(row).for_each(|(column, x)| column.push(x));
    }
    if columns[0].iter().all(|x| x.is_nan()) {
        return Err(Fault::data("no sample is on the map")
            .help("check that the map covers the flight, and that `map_levels_m` covers its heights"));
    }
    Ok(columns)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use arrow_array::{ArrayRef, Float64Array, cast::AsArray, types::Float64Type};

    fn map_value() -> MapValue {
        MapValue { position: None, map_interpolation: MapInterpolation::Linear, map_levels_m: None }
    }

    fn batch(columns: Vec<(&str, Vec<f64>)>) -> RecordBatch {
        let columns = columns.into_iter().map(|(name, x)| (name, Arc::new(Float64Array::from(x)) as ArrayRef));
        RecordBatch::try_from_iter(columns).unwrap()
    }

    /// A plane with slopes of 500 nT per degree north and -300 nT per degree east.
    fn plane(lat: f64, lon: f64) -> f64 {
        80.0 + 500.0 * (lat - 45.0) - 300.0 * (lon + 75.0)
    }

    /// Map of 11 by 9 nodes around 45 degrees north, 75 degrees west.
    fn map() -> RecordBatch {
        let nodes = || (0..11).flat_map(|row| (0..9).map(move |column| (f64::from(row), f64::from(column))));
        let lat = |row: f64| 44.995 + 0.001 * row;
        let lon = |column: f64| -75.004 + 0.001 * column;
        batch(vec![
            ("lat", nodes().map(|(row, _)| lat(row)).collect()),
            ("lon", nodes().map(|(_, column)| lon(column)).collect()),
            ("alt", vec![300.0; 99]),
            ("anomaly", nodes().map(|(row, column)| plane(lat(row), lon(column))).collect()),
        ])
    }

    fn run(stage: &MapValue, lat: &[f64], lon: &[f64]) -> Result<Vec<Vec<f64>>, Fault> {
        let line_batch = batch(vec![("lat", lat.to_vec()), ("lon", lon.to_vec()), ("alt", vec![0.0; lat.len()])]);
        let prepared = stage.prepare(&[line_batch.slice(0, 0), map()]).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![line_batch], keep: None };
        let arrays = stage.run(&line, &prepared)?;
        Ok(arrays.iter().map(|a| a.as_primitive::<Float64Type>().values().to_vec()).collect())
    }

    #[test]
    fn law_a_plane_is_interpolated_exactly_with_its_slopes() {
        // On a node, between nodes, and in the corners of the map.
        let (lat, lon) = ([45.0, 45.00037, 44.99951, 44.995, 45.005], [-75.0, -75.00062, -74.99923, -75.004, -74.996]);
        for map_interpolation in [MapInterpolation::Linear, MapInterpolation::Cubic] {
            let made = run(&MapValue { map_interpolation, ..map_value() }, &lat, &lon).unwrap();
            for k in 0..lat.len() {
                // Coordinates of about 75 degrees are rounded to 1.4e-14 degrees; the slope is 500 nT per degree.
                assert!((made[0][k] - plane(lat[k], lon[k])).abs() < 1e-9, "{k}: {}", made[0][k]);
                // A degree at 45 degrees is 111,132 m of latitude and 78,847 m of longitude (WGS-84, at the ellipsoid).
                // The length of a degree of longitude changes by 9e-5 from the middle of the map to its edges.
                assert!((made[1][k] * 111_132.0 / 500.0 - 1.0).abs() < 2e-4, "{k}: {} nT/m", made[1][k]);
                assert!((made[2][k] * 78_847.0 / -300.0 - 1.0).abs() < 2e-4, "{k}: {} nT/m", made[2][k]);
                assert_eq!(made[3][k], 0.0, "a map at its own height has no slope upwards");
            }
        }
    }

    #[test]
    fn unit_samples_off_the_map_are_nan() {
        let (lat, lon) = ([45.0, 45.0051, 45.0, 45.0, f64::NAN], [-75.0, -75.0, -75.0041, -74.9959, -75.0]);
        let made = run(&map_value(), &lat, &lon).unwrap();
        for column in &made {
            assert!(column[0].is_finite() && column[1..].iter().all(|x| x.is_nan()), "{made:?}");
        }
        let fault = run(&map_value(), &[46.0, 47.0], &[-75.0, -75.0]).unwrap_err();
        assert_eq!(fault.what, "no sample is on the map");
        assert!(fault.help.unwrap().contains("covers the flight"));
    }

    #[test]
    fn unit_the_map_at_the_true_position_is_truth() {
        let named = |names: [&str; 3], role: schemas::Role| {
            let columns =
                names.iter().zip(["deg", "deg", "m"]).map(|(name, unit)| Column::float(*name, unit, "").role(role));
            Table::Lines(TableShape { columns: columns.collect(), rate_hz: None })
        };
        let map = Table::Map(schemas::map::shape());
        let role = |stage: MapValue, lines: &Table| stage.yields(&[lines, &map]).unwrap().columns[0].role;
        let truth = named(["lat", "lon", "alt"], schemas::Role::Truth);
        assert_eq!(role(map_value(), &truth), schemas::Role::Truth);
        let ins = named(["ins_lat", "ins_lon", "ins_alt"], schemas::Role::Sensor);
        assert_eq!(role(MapValue { position: Some(PositionSource::Ins), ..map_value() }, &ins), schemas::Role::Derived);
        assert_eq!(role(map_value(), &ins), schemas::Role::Derived);
    }

    #[test]
    fn unit_the_ins_position_is_the_default() {
        // The INS is 0.001 degrees north of the truth, where the field is half a nanotesla larger.
        let (lat, lon) = (vec![45.0, 45.001], vec![-75.0, -75.001]);
        let moved = lat.iter().map(|lat| lat + 0.001).collect();
        let alt = vec![300.0; 2];
        let truth = [("lat", lat.clone()), ("lon", lon.clone()), ("alt", alt.clone())];
        let ins = [("ins_lat", moved), ("ins_lon", lon.clone()), ("ins_alt", alt)];
        let both = batch(truth.clone().into_iter().chain(ins.clone()).collect());
        let of = |stage: &MapValue, line_batch: &RecordBatch| {
            let prepared = stage.prepare(&[line_batch.slice(0, 0), map()]).unwrap();
            let line =
                LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![line_batch.clone()], keep: None };
            stage.run(&line, &prepared).unwrap()[0].as_primitive::<Float64Type>().value(0)
        };
        let asked = MapValue { position: Some(PositionSource::Truth), ..map_value() };
        assert!((of(&map_value(), &both) - plane(45.001, -75.0)).abs() < 1e-9);
        assert!((of(&asked, &both) - plane(45.0, -75.0)).abs() < 1e-9);
        assert!((of(&map_value(), &batch(truth.to_vec())) - plane(45.0, -75.0)).abs() < 1e-9);
        // Two of three columns do not make a position.
        let part = batch(truth.into_iter().chain(ins.into_iter().take(2)).collect());
        assert!((of(&map_value(), &part) - plane(45.0, -75.0)).abs() < 1e-9);
        // The whole table determines which columns are read.
        let shape = |batch: &RecordBatch| TableShape {
            columns: batch
                .schema()
                .fields()
                .iter()
                .map(|f| {
                    let (unit, ins) =
                        (if f.name().ends_with("alt") { "m" } else { "deg" }, f.name().starts_with("ins"));
                    let role = if ins { schemas::Role::Sensor } else { schemas::Role::Truth };
                    Column::float(f.name(), unit, "").role(role)
                })
                .collect(),
            rate_hz: None,
        };
        let grid = Table::Map(schemas::map::shape());
        let yields = |stage: &MapValue, line_batch: &RecordBatch| {
            stage.yields(&[&Table::Lines(shape(line_batch)), &grid]).unwrap()
        };
        let by_default = yields(&map_value(), &both);
        assert_eq!(by_default.reads[0], ["ins_lat", "ins_lon", "ins_alt"]);
        assert_eq!(by_default.columns[0].role, schemas::Role::Derived);
        let by_truth = yields(&asked, &both);
        assert_eq!(
            (by_truth.reads[0].as_slice(), by_truth.columns[0].role),
            (["lat", "lon", "alt"].map(str::to_owned).as_slice(), schemas::Role::Truth)
        );
    }

    #[test]
    fn unit_missing_positions_and_unsorted_heights_are_reported() {
        let place = [("ins_lat", "deg"), ("ins_lon", "rad")].map(|(name, unit)| Column::float(name, unit, ""));
        let lines = Table::Lines(TableShape { columns: place.to_vec().into(), rate_hz: None });
        let map = Table::Map(schemas::map::shape());
        let stage =
            MapValue { position: Some(PositionSource::Ins), map_levels_m: Some(vec![400.0, 300.0]), ..map_value() };
        let faults = stage.yields(&[&lines, &map]).unwrap_err();
        let found: Vec<_> = faults.iter().map(|f| (f.what.as_str(), f.param.as_deref().unwrap())).collect();
        let expected = [
            ("column `ins_lon` is in rad, but deg is needed", "position"),
            ("there is no column `ins_alt`", "position"),
            ("the heights must be one or more numbers in ascending order", "map_levels_m"),
        ];
        assert_eq!(found, expected);
    }
}
