//! Survey points: scattered values along lines, with their positions in one projection.

use numerics::angle::wrap_deg;
use std::path::Path;

use numerics::maps::plane_grid::{EvenAxis, PlaneGrid};

use crate::{AnomalyGrid, Crs, GridHeight, LineType, ReadError};

/// Survey points in the file's order. Every vector except `lines` and `types` has one entry per point.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyPointSet {
    /// The projection of eastings and northings.
    pub crs: Crs,
    /// Eastings, in metres even if the projection has another unit.
    pub easting_m: Vec<f64>,
    /// Northings, in metres.
    pub northing_m: Vec<f64>,
    /// WGS-84 latitudes, in degrees.
    pub lat_deg: Vec<f64>,
    /// WGS-84 longitudes, in degrees.
    pub lon_deg: Vec<f64>,
    /// Heights in metres above the file's reference level; NaN where unknown.
    pub height_m: Vec<f64>,
    /// The values; NaN where missing.
    pub value_nt: Vec<f64>,
    /// The line of each point, as an index into `lines`; one line for all points if the file names no line.
    pub line: Vec<u32>,
    /// The names of the lines, in the order in which they first occur.
    pub lines: Vec<String>,
    /// The type of each line; `None` where the file does not give it.
    pub types: Vec<Option<LineType>>,
    /// Additional columns of the file that reductions use.
    pub extra: ReductionColumns,
    /// The row of each point in the file, counted from 0.
    pub row: Vec<u64>,
    /// Notes on the file and its processing.
    pub notes: Vec<String>,
}

/// Optional columns of a survey, one entry per point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReductionColumns {
    /// Seconds past midnight UTC.
    pub tt_s: Option<Vec<f64>>,
    /// The temporal variation, in nT.
    pub diurnal_nt: Option<Vec<f64>>,
    /// The magnitude of the core field, in nT.
    pub igrf_nt: Option<Vec<f64>>,
    /// The year.
    pub year: Option<Vec<f64>>,
    /// The day of the year.
    pub doy: Option<Vec<f64>>,
}

impl SurveyPointSet {
    /// Points at finite WGS-84 latitudes and longitudes, on the plane of `to_epsg`, by default the UTM zone of the
    /// points. They have no values, no heights and one unnamed line; the caller adds these.
    ///
    /// # Errors
    /// Fails if there are no points, the system is unknown or in degrees, the points have no UTM zone, or points are
    /// invalid in the system.
    pub fn at(lat_deg: Vec<f64>, lon_deg: Vec<f64>, to_epsg: Option<u16>) -> Result<SurveyPointSet, ReadError> {
        let nowhere = Path::new("");
        if lat_deg.is_empty() {
            return Err(ReadError::data(nowhere, "no point has a position"));
        }
        let lon_deg: Vec<f64> = lon_deg.into_iter().map(wrap_deg).collect();
        let crs = plane(nowhere, to_epsg, &lat_deg, &lon_deg)?;
        let row: Vec<u64> = (0..lat_deg.len() as u64).collect();
        let mut notes = vec![];
        let (easting_m, northing_m) = metres(nowhere, &crs, (&lat_deg, &lon_deg), &row, &mut notes)?;
        let unknown = vec![f64::NAN; lat_deg.len()];
        Ok(SurveyPointSet {
            crs,
            easting_m,
            northing_m,
            lat_deg,
            lon_deg,
            height_m: unknown.clone(),
            value_nt: unknown,
            line: vec![0; row.len()],
            lines: vec![String::new()],
            types: vec![None],
            extra: ReductionColumns::default(),
            row,
            notes,
        })
    }

    /// A map on a grid that lies on the points' plane.
    ///
    /// # Errors
    /// Fails in the cases of [`AnomalyGrid::new`].
    pub fn grid(&self, grid: PlaneGrid, height: GridHeight) -> Result<AnomalyGrid, ReadError> {
        let unit_m = self.crs.unit_m();
        let axis = |a: EvenAxis| EvenAxis { first: a.first / unit_m, step: a.step / unit_m, len: a.len };
        AnomalyGrid::new(axis(grid.east_m), axis(grid.north_m), self.crs.clone(), grid.values, height)
    }

    /// The tie lines: lines of the type `Tie`, and lines in `alike`. If any line has the type `Tie`, lines of the type
    /// `Line` are not tie lines, even if they are in `alike`.
    pub fn ties(&self, alike: &[usize]) -> Vec<usize> {
        let of = |line: usize| self.types.get(line).copied().flatten();
        let typed = self.types.contains(&Some(LineType::Tie));
        let is_tie = |line: &usize| match of(*line) {
            Some(LineType::Tie) => true,
            Some(LineType::Line) if typed => false,
            _ => alike.contains(line),
        };
        (0..self.lines.len()).filter(is_tie).collect()
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.value_nt.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.value_nt.is_empty()
    }
}

/// The fault of a system in degrees where metres are required.
pub fn no_metres(path: &Path, crs: &Crs) -> ReadError {
    let what = format!("EPSG:{} is in degrees, but points require metres", crs.code());
    ReadError::options(path, what).help("set a projected coordinate system for the points")
}

/// The projection of points in degrees: the requested one, else their UTM zone.
///
/// # Errors
/// Fails for an unknown system, a system in degrees, or points without a UTM zone.
pub fn plane(path: &Path, to_epsg: Option<u16>, lat: &[f64], lon: &[f64]) -> Result<Crs, ReadError> {
    let crs = match to_epsg {
        Some(code) => Crs::from_epsg(path, code)?,
        None => {
            // The mean direction handles a survey across the date line.
            let (sin, cos) =
                lon.iter().fold((0.0, 0.0), |(s, c), l| (s + l.to_radians().sin(), c + l.to_radians().cos()));
            let middle = lat.iter().sum::<f64>() / lat.len() as f64;
            Crs::utm_zone_of(middle, sin.atan2(cos).to_degrees())?
        }
    };
    if crs.is_geographic() { Err(no_metres(path, &crs)) } else { Ok(crs) }
}

/// Eastings and northings in metres of points in degrees.
///
/// # Errors
/// Fails if more than 1 % of the points cannot be projected.
pub fn metres(
    path: &Path,
    crs: &Crs,
    (lat, lon): (&[f64], &[f64]),
    rows: &[u64],
    notes: &mut Vec<String>,
) -> Result<(Vec<f64>, Vec<f64>), ReadError> {
    let unit_m = crs.unit_m();
    let mut places = (Vec::with_capacity(lat.len()), Vec::with_capacity(lat.len()));
    let mut nowhere = None;
    for ((lat, lon), row) in lat.iter().zip(lon).zip(rows) {
        let place = crs.project(*lat, *lon);
        if place.is_none() {
            let (first, count) = nowhere.unwrap_or(((*lat, *lon, *row), 0_usize));
            nowhere = Some((first, count + 1));
        }
        let (easting, northing) = place.unwrap_or((f64::NAN, f64::NAN));
        places.0.push(easting * unit_m);
        places.1.push(northing * unit_m);
    }
    if let Some(((lat, lon, row), count)) = nowhere {
        let what = format!("latitude {lat}, longitude {lon} cannot be projected to EPSG:{}", crs.code());
        // A few failures are wrong positions, which can be omitted. Many failures indicate the wrong projection.
        if 100 * count > places.0.len() && count > 1 {
            return Err(ReadError::data(path, what).in_row(row).help("check the EPSG codes"));
        }
        notes.push(format!("row {row}: {what}; {count} such points are omitted"));
    }
    Ok(places)
}
