//! Maps as rasters.

use arrow_schema::Schema;
use base64::{Engine, prelude::BASE64_STANDARD};
use datasets::{AnomalyGrid, ReadError};
use numerics::{
    earth::geodesy::{EarthModel, is_latitude_deg},
    maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface},
};
use schemas::{Fault, keys::HashKey};
use serde_json::{Value, json};

use super::{StoreView, ViewFault, ViewPoint};

/// Default and maximum number of columns and rows of a raster.
const PIXELS: usize = 800;
const MOST_PIXELS: usize = 2000;
/// Minimum and maximum number of steps of a profile.
const LEAST_SAMPLES: usize = 100;
const MOST_SAMPLES: usize = 4000;

/// Quantity of a map that a raster shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapBand {
    /// The anomaly.
    #[default]
    Anomaly,
    /// The standard deviation of the error of the anomaly.
    Error,
}

impl MapBand {
    /// The name of the band in a URL.
    pub fn name(self) -> &'static str {
        match self {
            MapBand::Anomaly => "anomaly",
            MapBand::Error => schemas::map::ERROR,
        }
    }

    /// The band with this name.
    pub fn from_name(name: &str) -> Option<MapBand> {
        [MapBand::Anomaly, MapBand::Error].into_iter().find(|band| band.name() == name)
    }

    /// The nodes of this band; `None` if the map has none.
    fn of(self, mut map: AnomalyGrid) -> Option<AnomalyGrid> {
        if self == MapBand::Error {
            // Resampling to latitude and longitude keeps only the anomaly, so the error takes its place.
            map.anomaly_nt = map.error_nt.take()?;
        }
        Some(map)
    }
}

/// Raster of a map, at most `pixels` wide and high. Each cell is the mean of the known nodes in it.
#[derive(Debug, PartialEq)]
pub struct MapRaster {
    /// Number of columns and rows.
    pub size: (usize, usize),
    /// Values by rows, from north to south, each from west to east; NaN where unknown.
    pub values: Vec<f32>,
    /// Smallest and largest value of the map's nodes; NaN without a known value.
    pub range: (f64, f64),
}

impl MapRaster {
    /// Raster of a map.
    pub fn new(grid: &GeographicGrid, pixels: usize) -> MapRaster {
        let (columns, rows) = (grid.lon().len(), grid.lat().len());
        let (width, height) = (columns.min(pixels), rows.min(pixels));
        let mut sums = vec![(0.0f64, 0u32); width * height];
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        for (row, line) in grid.values().chunks(columns).enumerate() {
            // The first row of the grid is the southernmost.
            let y = height - 1 - row * height / rows;
            for (column, value) in line.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                let cell = &mut sums[y * width + column * width / columns];
                *cell = (cell.0 + value, cell.1 + 1);
                range = (range.0.min(*value), range.1.max(*value));
            }
        }
        let mean = |(sum, count): (f64, u32)| if count == 0 { f32::NAN } else { (sum / f64::from(count)) as f32 };
        MapRaster { size: (width, height), values: sums.into_iter().map(mean).collect(), range }
    }
}

/// Values of a map along a line.
#[derive(Debug, Default, PartialEq)]
pub struct DrawnProfile {
    /// Distance from the first end, in metres.
    pub distance_m: Vec<f64>,
    /// Latitude, in degrees.
    pub lat: Vec<f64>,
    /// Longitude, in degrees.
    pub lon: Vec<f64>,
    /// Value, interpolated bilinearly between the nodes; `None` off the map and at unknown nodes.
    pub value: Vec<Option<f64>>,
}

impl DrawnProfile {
    /// Profile between two positions (latitude and longitude in degrees), with two samples per cell.
    pub fn new(grid: &GeographicGrid, from: (f64, f64), to: (f64, f64)) -> DrawnProfile {
        let cells = |a: f64, b: f64, step: f64| ((b - a) / step).abs();
        let cells = cells(from.0, to.0, grid.lat().step_deg()).max(cells(from.1, to.1, grid.lon().step_deg()));
        let samples = ((2.0 * cells).ceil() as usize).clamp(LEAST_SAMPLES, MOST_SAMPLES);
        let surface = MapSurface::new(grid, MapInterpolation::Linear);
        let mut found = DrawnProfile::default();
        let (mut distance_m, mut before) = (0.0, from);
        for k in 0..=samples {
            let part = k as f64 / samples as f64;
            let at = (from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1));
            let (north, east) = EarthModel::default().offset_ne_m(before, at, 0.0);
            distance_m += north.hypot(east);
            before = at;
            found.distance_m.push(distance_m);
            found.lat.push(at.0);
            found.lon.push(at.1);
            found.value.push(surface.at(at.0, at.1).map(|field| field.value_nt).filter(|v| v.is_finite()));
        }
        found
    }
}

impl StoreView {
    /// A band of a map as a raster of at most `pixels` columns and rows; the map is read from files, or made by a stage
    /// at a point.
    ///
    /// # Errors
    /// Fails for an unknown table or point, for a table that is not a map, or for a map without this band. Also fails
    /// if the store is damaged.
    pub fn map(&self, name: &str, point: &ViewPoint, pixels: Option<usize>, band: MapBand) -> Result<Value, ViewFault> {
        let pixels = pixels.unwrap_or(PIXELS);
        if !(1..=MOST_PIXELS).contains(&pixels) {
            let fault = Fault::new(format!("{pixels} pixels are requested"));
            return Err(ViewFault::Wrong(fault.help(format!("request 1 to {MOST_PIXELS} pixels"))));
        }
        let (map, unit) = self.nodes(name, point)?;
        let has_error = map.error_nt.is_some();
        let map = band.of(map).ok_or_else(|| {
            let fault = Fault::new(format!("the map `{name}` has no column `error`"));
            ViewFault::Wrong(fault.help("request `band=anomaly`"))
        })?;
        let grid = in_degrees(name, &map)?;
        let raster = MapRaster::new(&grid, pixels);
        let ends = |first: f64, last: f64, step: f64| (first - 0.5 * step, last + 0.5 * step);
        let (south, north) = ends(grid.lat().first_deg(), grid.lat().last_deg(), grid.lat().step_deg());
        let (west, east) = ends(grid.lon().first_deg(), grid.lon().last_deg(), grid.lon().step_deg());
        let bytes: Vec<u8> = raster.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Ok(json!({
            "table": name, "band": band.name(), "has_error": has_error, "unit": unit,
            "width": raster.size.0, "height": raster.size.1, "west": west, "east": east,
            "south": south, "north": north, "least": raster.range.0, "most": raster.range.1,
            "of": [grid.lon().len(), grid.lat().len()],
            "thinned": raster.size != (grid.lon().len(), grid.lat().len()), "values": BASE64_STANDARD.encode(bytes),
        }))
    }

    /// The values of a map along a straight line in the plane of longitude and latitude, interpolated bilinearly
    /// between the map's nodes, as JSON. `ends` are latitude and longitude in degrees; distances are in metres on the
    /// WGS-84 ellipsoid.
    ///
    /// # Errors
    /// Returns the errors of [`StoreView::map`]. Also fails for ends that are equal or that are not positions.
    pub fn profile(&self, name: &str, point: &ViewPoint, ends: [(f64, f64); 2]) -> Result<Value, ViewFault> {
        let [from, to] = ends;
        let is_position = |(lat, lon): (f64, f64)| is_latitude_deg(lat) && lon.is_finite() && lon.abs() <= 720.0;
        if !is_position(from) || !is_position(to) || from == to {
            let fault = Fault::new("a profile needs two different positions");
            return Err(ViewFault::Wrong(fault.help("give `from=LAT,LON` and `to=LAT,LON`, in degrees")));
        }
        let (map, unit) = self.nodes(name, point)?;
        let grid = in_degrees(name, &map)?;
        let found = DrawnProfile::new(&grid, from, to);
        let known = found.value.iter().flatten().count();
        Ok(json!({
            "table": name, "unit": unit, "distance_m": found.distance_m, "lat": found.lat, "lon": found.lon,
            "value": found.value, "known": known,
        }))
    }

    /// The map on its native grid, and the unit of its values; the map is read from files, or made by a stage at a
    /// point.
    fn nodes(&self, name: &str, point: &ViewPoint) -> Result<(AnomalyGrid, String), ViewFault> {
        let (pipeline, own) = name.split_once('.').unwrap_or((name, ""));
        let known = self.pipeline(pipeline)?;
        let source = known.notes.sources.iter().find(|s| s.name == own && s.kind == "map");
        let (map, unit) = match source {
            Some(source) => {
                let key = source.lines.get("map").and_then(|text| HashKey::parse(text));
                let key = key.ok_or_else(|| Fault::machine(format!("the key of the map `{name}` is missing")))?;
                let batch = self.objects.whole(key)?;
                (AnomalyGrid::of_table(&batch), unit_of(&batch.schema()))
            }
            None => self.made(name, point)?,
        };
        Ok((map.map_err(|e| undrawn(name, &e))?, unit.unwrap_or_else(|| schemas::map::ANOMALY_UNIT.to_owned())))
    }

    /// The map that a stage made, and the unit of its values.
    fn made(
        &self,
        name: &str,
        point: &ViewPoint,
    ) -> Result<(Result<AnomalyGrid, ReadError>, Option<String>), ViewFault> {
        let (_, table) = self.table(name)?;
        let columns = table.provider.columns();
        let has = |column: &str| columns.field_with_name(column).is_ok();
        if !schemas::map::MADE_COLUMNS.iter().all(|column| has(column)) {
            return Err(ViewFault::Wrong(Fault::new(format!("`{name}` is not a map"))));
        }
        let error = has(schemas::map::ERROR).then_some(schemas::map::ERROR);
        let wanted: Vec<&str> = schemas::map::MADE_COLUMNS.into_iter().chain(error).collect();
        Ok((AnomalyGrid::of_made(&table.rows_at(point, &wanted)?), unit_of(columns)))
    }
}

/// The unit of the anomaly.
fn unit_of(columns: &Schema) -> Option<String> {
    columns.field_with_name("anomaly").ok().and_then(|f| f.metadata().get("unit").cloned())
}

/// Fault for a map that cannot be drawn, with the reason.
fn undrawn(name: &str, why: &dyn std::fmt::Display) -> ViewFault {
    ViewFault::Wrong(Fault::data(format!("`{name}` cannot be drawn: {why}")))
}

/// The nodes of a map in latitude and longitude.
fn in_degrees(name: &str, map: &AnomalyGrid) -> Result<GeographicGrid, ViewFault> {
    let table = map.to_geographic().map_err(|e| undrawn(name, &e))?;
    let grid = GeographicGrid::from_rows(table.column("lat"), table.column("lon"), table.column("anomaly"));
    grid.map_err(|e| undrawn(name, &e))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn law_a_profile_of_a_plane_is_a_straight_line() {
        let axis: Vec<f64> = (0..11).map(|k| f64::from(k) * 0.01).collect();
        let mut values: Vec<f64> =
            axis.iter().flat_map(|lat| axis.iter().map(move |lon| 100.0 * lat - 300.0 * lon)).collect();
        let grid = GeographicGrid::new(&axis, &axis, &values).unwrap();
        let found = DrawnProfile::new(&grid, (0.005, 0.02), (0.085, 0.06));
        for ((lat, lon), value) in found.lat.iter().zip(&found.lon).zip(&found.value) {
            assert!((value.unwrap() - (100.0 * lat - 300.0 * lon)).abs() < 1e-9);
        }
        // At the equator, 0.08 degrees north are 110,574.3 m/deg times 0.08, and 0.04 degrees east are 111,319.5 m/deg
        // times 0.04 (WGS-84).
        let length = (110_574.3f64 * 0.08).hypot(111_319.5 * 0.04);
        assert!((found.distance_m.last().unwrap() / length - 1.0).abs() < 1e-5, "{:?}", found.distance_m.last());
        assert_eq!((found.distance_m[0], found.lat[0], found.lon.last().copied()), (0.0, 0.005, Some(0.06)));
        // Off the map and in cells with an unknown node there is no value.
        values[60] = f64::NAN;
        let holed = GeographicGrid::new(&axis, &axis, &values).unwrap();
        let found = DrawnProfile::new(&holed, (0.05, 0.0), (0.05, 0.2));
        let unknown = |lon: f64| found.value[found.lon.iter().position(|l| *l >= lon).unwrap()].is_none();
        assert!(unknown(0.051) && unknown(0.11) && !unknown(0.02) && !unknown(0.07));
    }

    #[test]
    fn law_a_cell_is_the_mean_of_its_known_nodes() {
        let lat: Vec<f64> = (0..4).map(f64::from).collect();
        let lon: Vec<f64> = (0..6).map(f64::from).collect();
        // The value of a node is 10 times its row plus its column; the row 0 is in the south.
        let mut values: Vec<f64> = (0..24).map(|k| f64::from(10 * (k / 6) + k % 6)).collect();
        values[0] = f64::NAN;
        let grid = GeographicGrid::new(&lat, &lon, &values).unwrap();
        let whole = MapRaster::new(&grid, 100);
        assert_eq!((whole.size, whole.values[..6].to_vec()), ((6, 4), vec![30.0, 31.0, 32.0, 33.0, 34.0, 35.0]));
        assert!(whole.values[18].is_nan() && whole.values[19] == 1.0);
        let few = MapRaster::new(&grid, 2);
        assert_eq!((few.size, few.range), ((2, 2), (1.0, 35.0)));
        // North-west: rows 2 and 3, columns 0 to 2.
        assert_eq!((few.values[0], few.values[1]), (26.0, 29.0));
        // South-west without the unknown node: 1, 2, 10, 11, 12.
        assert_eq!(few.values[2], 7.2);
    }
}
