//! A map in another coordinate system, by polynomial interpolation between its nodes.

use std::borrow::Cow;

use numerics::{
    earth::geodesy::{meridian_radius_m, transverse_radius_m},
    maps::plane_grid::EvenAxis,
};
use rayon::prelude::*;

use super::{
    AnomalyGrid, Crs, GridHeight, MapTable, WGS84,
    anomaly_grid::{Registration, ground_m, node_on},
    interpolate, longitude,
};
use crate::ReadError;

/// Number of additional columns past each end of a map around the earth: half of the nodes of a polynomial, plus one.
const SEAM: usize = 6;

/// Minimum number of nodes on each axis for interpolation.
const LEAST_NODES: usize = 4;

/// Maximum number of nodes; more indicate a spacing in the wrong unit.
const MOST_NODES: f64 = 1e9;

/// The smallest and the largest coordinate.
type CoordinateRange = (f64, f64);

impl AnomalyGrid {
    /// The map in degrees: unchanged if its coordinates are WGS-84 degrees (within 1 m), else resampled to a regular
    /// grid of latitude and longitude that covers the map. The spacing is at most the map's spacing. Nodes of a
    /// resampled map are NaN if they lie outside the original map or within two nodes of an unknown node.
    ///
    /// # Errors
    /// Fails for a map of fewer than 4 x 4 nodes, a map around a pole, or coordinates that are invalid in their system.
    pub fn to_geographic(&self) -> Result<MapTable, ReadError> {
        if self.crs.is_wgs84_at(self.middle().1, self.middle().0) {
            return MapTable::from_grid(self);
        }
        MapTable::from_grid(&self.to_crs(WGS84, None)?)
    }

    /// The map in another coordinate system, on a grid that covers it. The nodes are whole multiples of `spacing` (in
    /// units of that system, or degrees). By default, the spacing is at most the map's spacing, and the grid begins at
    /// the edge of the map. Nodes outside the map, or within two nodes of an unknown node, are NaN.
    ///
    /// # Errors
    /// Fails for an unknown system or an invalid spacing. Also fails in the cases of [`AnomalyGrid::to_geographic`].
    pub fn to_crs(&self, epsg: u16, spacing: Option<f64>) -> Result<AnomalyGrid, ReadError> {
        let target = Crs::from_epsg(&self.source, epsg)?;
        if self.crs == target && spacing.is_none() {
            return Ok(self.clone());
        }
        if self.x.len < LEAST_NODES || self.y.len < LEAST_NODES {
            let kind = if self.is_geographic() { "map" } else { "projected map" };
            let what = format!("resampling requires a {kind} of at least {LEAST_NODES} x {LEAST_NODES} nodes");
            return Err(self.fault(what));
        }
        self.check()?;
        let (x, y) = self.axes_in(&target, spacing)?;
        let (anomaly_nt, heights) = self.beyond_the_seam().values_on(&target, &x, &y);
        let height = match &self.height {
            GridHeight::Level(alt_m) => GridHeight::Level(*alt_m),
            GridHeight::Cells(_) => GridHeight::Cells(heights),
        };
        let mut notes = self.notes.clone();
        notes.push(self.note_of(&target));
        let (registration, source) = (Registration::Node, self.source.clone());
        let (value_unit, format) = (self.value_unit, self.format);
        let map = AnomalyGrid {
            x,
            y,
            crs: target,
            anomaly_nt,
            error_nt: None,
            value_unit,
            height,
            registration,
            format,
            source,
            notes,
        };
        map.check()?;
        Ok(map)
    }

    /// A map around the earth with additional columns past both ends, so that a position at the seam lies between
    /// nodes.
    fn beyond_the_seam(&self) -> Cow<'_, AnomalyGrid> {
        let Some(round) = self.is_geographic().then(|| longitude::round(&self.x)).flatten() else {
            return Cow::Borrowed(self);
        };
        let width = self.x.len;
        let turned = |values: &[f64]| -> Vec<f64> {
            let columns = || (0..round + 2 * SEAM).map(|k| (k + round * SEAM - SEAM) % round);
            values.chunks(width).flat_map(|row| columns().map(|c| row.get(c).copied().unwrap_or(f64::NAN))).collect()
        };
        let step = 360.0 / round as f64;
        let x = EvenAxis { first: self.x.first - SEAM as f64 * step, step, len: round + 2 * SEAM };
        let height = match &self.height {
            GridHeight::Level(alt_m) => GridHeight::Level(*alt_m),
            GridHeight::Cells(cells) => GridHeight::Cells(turned(cells)),
        };
        Cow::Owned(AnomalyGrid { x, anomaly_nt: turned(&self.anomaly_nt), height, ..self.clone() })
    }

    fn note_of(&self, target: &Crs) -> String {
        let to = if target.code() == WGS84 {
            "latitude and longitude".to_owned()
        } else {
            format!("EPSG:{}", target.code())
        };
        format!(
            "resampled from {} x {} nodes in EPSG:{} to {to} with polynomials of degree 9 (degree 5 or 3 near edges \
             and unknown nodes)",
            self.y.len,
            self.x.len,
            self.crs.code()
        )
    }

    /// Values and heights at the nodes of another grid.
    fn values_on(&self, target: &Crs, x: &EvenAxis, y: &EvenAxis) -> (Vec<f64>, Vec<f64>) {
        let cells = match &self.height {
            GridHeight::Cells(cells) => cells.as_slice(),
            GridHeight::Level(_) => &[],
        };
        let row = |j: usize| {
            let places: Vec<_> = (0..x.len).map(|i| self.place_of(target, x.at(i as f64), y.at(j as f64))).collect();
            let of = |values: &[f64]| -> Vec<f64> {
                let at = |place: &Option<(f64, f64)>| {
                    place.map_or(f64::NAN, |(column, row)| interpolate::at(values, &self.x, &self.y, column, row))
                };
                if values.is_empty() { vec![] } else { places.iter().map(at).collect() }
            };
            (of(&self.anomaly_nt), of(cells))
        };
        let rows: Vec<(Vec<f64>, Vec<f64>)> = (0..y.len).into_par_iter().map(row).collect();
        let (values, heights): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        (values.concat(), heights.concat())
    }

    /// Column and row, as fractions, of a position in another system; `None` outside the map.
    fn place_of(&self, target: &Crs, x: f64, y: f64) -> Option<(f64, f64)> {
        let (lat, lon) = if target.code() == WGS84 { (y, x) } else { target.unproject(x, y)? };
        self.node_of(lat, lon)
    }

    /// Column and row, as fractions, of a position in WGS-84 degrees; `None` outside the map.
    pub fn node_of(&self, lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let (e, n) = self.crs.project(lat_deg, lon_deg)?;
        let row = node_on(&self.y, n)?;
        let turns: &[f64] = if self.is_geographic() { &[0.0, 360.0, -360.0] } else { &[0.0] };
        let column = turns.iter().find_map(|turn| node_on(&self.x, e + turn))?;
        Some((column, row))
    }

    /// The axes of a grid in another system that covers the map.
    fn axes_in(&self, target: &Crs, spacing: Option<f64>) -> Result<(EvenAxis, EvenAxis), ReadError> {
        let (lat, lon) = self.bounds_deg()?;
        let (x, y) = if target.is_geographic() { (lon, lat) } else { self.bounds_in(target)? };
        let (x_step, y_step) = match spacing {
            Some(step) if step.is_finite() && step > 0.0 => (step, step),
            Some(step) => return Err(self.fault(format!("the spacing must be positive and finite, not {step}"))),
            None if target.is_geographic() => self.degrees_of_steps(lat),
            None => self.units_of_steps(target, (x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0)?,
        };
        let nodes = ((x.1 - x.0) / x_step).abs() * ((y.1 - y.0) / y_step).abs();
        if nodes.is_nan() || nodes >= MOST_NODES {
            return Err(self
                .fault(format!("a grid with {nodes:.0} nodes is too large"))
                .help("choose a larger spacing"));
        }
        let axis = |ends: CoordinateRange, step: f64| match spacing {
            Some(_) => multiples(ends, step),
            None => covering(ends, step),
        };
        let (x, y) = (axis(x, x_step), axis(y, y_step));
        if x.len < 2 || y.len < 2 {
            return Err(self.fault("the spacing is wider than the map").help("choose a smaller spacing"));
        }
        Ok((x, y))
    }

    /// Steps in degrees that, on the ground, are at most as long as the map's steps. The spacings in metres are equal
    /// where a degree is longest.
    fn degrees_of_steps(&self, lat: CoordinateRange) -> (f64, f64) {
        let longest = lat.0.abs().max(lat.1.abs()).to_radians();
        let widest = if lat.0 <= 0.0 && lat.1 >= 0.0 { 0.0 } else { lat.0.abs().min(lat.1.abs()).to_radians() };
        let (x_m, y_m) = self.steps_m();
        let lat_step = (y_m / meridian_radius_m(longest)).to_degrees();
        let lon_step = (x_m / (transverse_radius_m(widest) * widest.cos())).to_degrees();
        (lon_step, lat_step)
    }

    /// The map's steps on the ground, in metres. On a projected map, both axes use the scale of the projection along
    /// the northings.
    fn steps_m(&self) -> (f64, f64) {
        if self.is_geographic() {
            let (x, y) = self.unit_m();
            return (self.x.step * x, self.y.step * y);
        }
        let scale = ground_m(&self.crs, self.middle(), (0.0, self.y.step)).unwrap_or(1.0);
        (self.x.step * scale, self.y.step * scale)
    }

    /// The map's shorter step in units of another system, at a position in that system.
    fn units_of_steps(&self, target: &Crs, x: f64, y: f64) -> Result<(f64, f64), ReadError> {
        let (x_m, y_m) = self.steps_m();
        // 1 km is small compared with the earth and large compared with rounding.
        let ground_m = ground_m(target, (x, y), (0.0, 1000.0 / target.unit_m()));
        let ground_m = ground_m.ok_or_else(|| self.no_place(x, y, target))?;
        let step = x_m.min(y_m) / ground_m;
        Ok((step, step))
    }

    /// The smallest and the largest latitude and longitude of the border, in WGS-84 degrees; longitudes exceed 180 if
    /// the map crosses the date line.
    ///
    /// # Errors
    /// Fails for a border that leaves the coordinate system or surrounds a pole.
    pub fn bounds_deg(&self) -> Result<(CoordinateRange, CoordinateRange), ReadError> {
        let (mut lat, mut lon) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        let (mut before, mut first) = (None, None);
        for (x, y) in self.outline() {
            let place = self.crs.unproject(x, y).ok_or_else(|| self.no_place(x, y, &self.crs))?;
            // Degrees are already continuous.
            let here = if self.is_geographic() { place.1 + 360.0 * ((x - place.1) / 360.0).round() } else { place.1 };
            let here = before.map_or(here, |before: f64| here + 360.0 * ((before - here) / 360.0).round());
            first.get_or_insert(here);
            before = Some(here);
            lat = (lat.0.min(place.0), lat.1.max(place.0));
            lon = (lon.0.min(here), lon.1.max(here));
        }
        if !self.is_geographic() && before.zip(first).is_some_and(|(a, b)| (a - b).abs() > 180.0) {
            return Err(self
                .fault("the map contains a pole, which a grid of latitude and longitude cannot represent")
                .help("trim the map, or keep it in its coordinate system"));
        }
        let rounds = 360.0 * ((0.5 * (lon.0 + lon.1) + 180.0) / 360.0).floor();
        Ok((lat, (lon.0 - rounds, lon.1 - rounds)))
    }

    fn bounds_in(&self, target: &Crs) -> Result<(CoordinateRange, CoordinateRange), ReadError> {
        let (mut x_ends, mut y_ends) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        for (x, y) in self.outline() {
            let (lat, lon) = self.crs.unproject(x, y).ok_or_else(|| self.no_place(x, y, &self.crs))?;
            let (x, y) = target.project(lat, lon).ok_or_else(|| self.no_place(lon, lat, target))?;
            x_ends = (x_ends.0.min(x), x_ends.1.max(x));
            y_ends = (y_ends.0.min(y), y_ends.1.max(y));
        }
        Ok((x_ends, y_ends))
    }

    pub(super) fn no_place(&self, x: f64, y: f64, crs: &Crs) -> ReadError {
        self.fault(format!("({x}, {y}) is not a position in EPSG:{}", crs.code())).help("check the EPSG code")
    }

    /// The nodes of the border in order; the last node is the first node again.
    pub fn outline(&self) -> Vec<(f64, f64)> {
        let (e, n) = (self.x.coordinates(), self.y.coordinates());
        let (west, east) = (self.x.first, self.x.last());
        let (south, north) = (self.y.first, self.y.last());
        let bottom = e.iter().map(|e| (*e, south));
        let right = n.iter().map(|n| (east, *n));
        let top = e.iter().rev().map(|e| (*e, north));
        let left = n.iter().rev().map(|n| (west, *n));
        bottom.chain(right).chain(top).chain(left).collect()
    }
}

/// An axis from end to end whose step is at most `step`.
fn covering(ends: CoordinateRange, step: f64) -> EvenAxis {
    let steps = ((ends.1 - ends.0) / step).ceil().max(1.0);
    EvenAxis { first: ends.0, step: (ends.1 - ends.0) / steps, len: steps as usize + 1 }
}

/// An axis whose nodes are the multiples of `step` between the ends.
fn multiples(ends: CoordinateRange, step: f64) -> EvenAxis {
    // Rounding of a forward and inverse projection must not move a node on the edge off the axis.
    const SLACK: f64 = 1e-6;
    let (first, last) = ((ends.0 / step - SLACK).ceil(), (ends.1 / step + SLACK).floor());
    EvenAxis { first: first * step, step, len: (last - first).max(-1.0) as usize + 1 }
}
