//! Survey points: scattered values along lines, in any table, with their positions in one projection.

use numerics::angle::wrap_deg;
use std::path::Path;

use schemas::{
    VerbatimText,
    plausible::{PlausibilityCheck, limits},
};

use super::{
    markers,
    points_table::{PointColumn, PointTable, load},
    unit_name,
};
use crate::{
    ReadError,
    grid::{AxisUnit, CrsSource, ValueUnit, accepted, check_values, without_markers},
};
use grids::{Crs, LineType, ReductionColumns, SurveyPointSet, WGS84, metres, no_metres, plane};

/// Options for reading survey points. Columns that are not named here are found by their usual names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PointOptions {
    /// A flight format, `parquet` or `text`; by default detected from content and extension.
    pub format: Option<String>,
    /// The column of longitudes or eastings.
    pub x: Option<String>,
    /// The column of latitudes or northings.
    pub y: Option<String>,
    /// The column of heights.
    pub height: Option<String>,
    /// The column of the values to be gridded.
    pub value: Option<String>,
    /// The column of line names.
    pub line: Option<String>,
    /// The EPSG code of `x` and `y`; by default WGS-84 degrees if the columns are named latitude and longitude.
    pub epsg: Option<u16>,
    /// The EPSG code of the plane of the points; by default the system of `x` and `y` if they are eastings and
    /// northings, else the UTM zone of the middle of the points.
    pub to_epsg: Option<u16>,
    /// Numbers that mark a missing position, height or value, in the unit of the file.
    pub missing: Vec<VerbatimText>,
    /// Plausibility checks that are disabled.
    pub accept: Vec<PlausibilityCheck>,
}

const LATITUDES: &[&str] = &["lat", "latitude_deg", "latitude", "lat_deg", "lat_wgs84", "latitude_wgs84", "gps_lat"];
const LONGITUDES: &[&str] =
    &["lon", "longitude_deg", "longitude", "lon_deg", "long", "lon_wgs84", "longitude_wgs84", "lng", "gps_lon"];
const EASTINGS: &[&str] =
    &["easting", "easting_m", "utm_easting_m", "osgb_easting_m", "utm_x", "utm_e", "east", "east_m", "e", "x", "x_m"];
const NORTHINGS: &[&str] = &[
    "northing",
    "northing_m",
    "utm_northing_m",
    "osgb_northing_m",
    "utm_y",
    "utm_n",
    "north",
    "north_m",
    "n",
    "y",
    "y_m",
];
const HEIGHTS: &[&str] = &[
    "alt",
    "alt_m",
    "altitude_m",
    "altitude",
    "height_m",
    "height",
    "height_ellipsoidal_m",
    "height_orthometric_m",
    "gps_alt",
    "galt",
    "elevation_m",
    "elevation",
    "msl",
    "z",
    "z_m",
];
const VALUES: &[&str] = &[
    "anomaly",
    "anomaly_nt",
    "total_field_anomaly_nt",
    "total_field_anomaly",
    "mag_anomaly",
    "magnetic_anomaly",
    "tmi",
    "tmi_nt",
    "tmi_anomaly",
    "total_field",
    "total_field_nt",
    "mag_lev",
    "mag_1_c",
    "mag_c",
    "mag",
    "mag_nt",
    "magnetics",
    "residual",
    "value",
    "f",
];
const LINES: &[&str] = &[
    "line",
    "flight_line",
    "line_and_segment",
    "line_id",
    "line_number",
    "line_no",
    "lineno",
    "line_name",
    "survey_line",
];

/// Reads survey points from Parquet, CSV, columns of text (including Geosoft's XYZ with line records) or any flight
/// format.
///
/// Points without a position are skipped and counted in the notes; points without a value are kept as NaN.
///
/// # Errors
/// Fails for a file that cannot be read, missing or non-numeric columns, units that do not convert, or coordinates in
/// an unknown system.
pub fn read_points(path: &Path, options: &PointOptions) -> Result<SurveyPointSet, ReadError> {
    let table = load(path, options.format.as_deref())?;
    let found = PointColumnRoles::from_table(path, &table, options)?;
    let mut points = found.points(path, options)?;
    if points.value_nt.iter().all(|v| v.is_nan()) {
        return Err(ReadError::data(path, "no point has a value").in_column(&found.value.name));
    }
    points.notes.splice(0..0, found.notes());
    Ok(points)
}

/// Warnings about probably wrong units and about constant values of survey points, one sentence each.
pub fn doubts(points: &SurveyPointSet) -> Vec<String> {
    /// Maximum latitude and longitude of positions in radians, π/2 and π. Positions in radians that are read as degrees
    /// lie in this area of open sea.
    const TURNS: (f64, f64) = (std::f64::consts::FRAC_PI_2, std::f64::consts::PI);
    /// Minimum range of the values of a survey, in nT.
    const LEAST_NT: f64 = 1e-3;
    let mut suspicions: Vec<String> = vec![];
    let mut places = points.lat_deg.iter().zip(&points.lon_deg);
    if places.all(|(lat, lon)| lat.abs() <= TURNS.0 && lon.abs() <= TURNS.1) {
        suspicions.push("all points lie in the Gulf of Guinea; are the positions in radians?".to_owned());
    }
    let known: Vec<f64> = points.value_nt.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) = known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    if known.len() > 1 && low == high {
        suspicions.push(format!("all values are {low} nT"));
    } else if known.len() > 1 && high - low < LEAST_NT {
        suspicions.push(format!("all values are within {} nT; are they in another unit?", high - low));
    }
    suspicions
}

/// Lines of a set of points: the line of each point, and the names and types of the lines.
struct PointLines {
    /// The line of each point.
    line: Vec<u32>,
    lines: Vec<String>,
    types: Vec<Option<LineType>>,
}

/// Columns of a table by their role, and the coordinate system of x and y.
struct PointColumnRoles<'a> {
    table: &'a PointTable,
    x: &'a PointColumn,
    y: &'a PointColumn,
    height: Option<&'a PointColumn>,
    value: &'a PointColumn,
    line: Option<&'a PointColumn>,
    system: Crs,
}

impl<'a> PointColumnRoles<'a> {
    fn from_table(
        path: &Path,
        table: &'a PointTable,
        options: &PointOptions,
    ) -> Result<PointColumnRoles<'a>, ReadError> {
        let (x, y) = place_columns(path, table, options)?;
        let degrees = |c: &PointColumn, known: &[&str]| known.contains(&&*c.name.to_ascii_lowercase()) || c.is_angle();
        let code = match options.epsg {
            Some(code) => code,
            None if degrees(x, LONGITUDES) && degrees(y, LATITUDES) => WGS84,
            None => {
                let what = format!("the coordinate system of `{}` and `{}` is unknown", x.name, y.name);
                let help = "set `epsg`, such as 32754 for UTM zone 54 south or 4326 for degrees";
                return Err(ReadError::options(path, what).help(help));
            }
        };
        let value = table.named_or(path, options.value.as_deref(), VALUES, "value")?;
        let value = value.ok_or_else(|| table.lacks(path, "values", "value", VALUES))?;
        Ok(PointColumnRoles {
            table,
            x,
            y,
            height: table.named_or(path, options.height.as_deref(), HEIGHTS, "height")?,
            value,
            line: table.named_or(path, options.line.as_deref(), LINES, "line")?,
            system: Crs::from_epsg(path, code)?,
        })
    }

    fn notes(&self) -> Vec<String> {
        let mut notes =
            vec![format!("positions from `{}` and `{}`, values from `{}`", self.x.name, self.y.name, self.value.name)];
        match self.height {
            Some(height) if height.name.contains("orthometric") || unit_name::without_unit(&height.name) == "msl" => {
                notes.push(format!("heights from `{}`, which are above sea level", height.name));
            }
            Some(height) => notes.push(format!("heights from `{}`", height.name)),
            None => notes.push("the file has no heights".to_owned()),
        }
        match self.line {
            Some(line) => notes.push(format!("lines from `{}`", line.name)),
            None if !self.table.records.is_empty() => notes.push("lines from the file's line records".to_owned()),
            None => notes.push("the file names no lines".to_owned()),
        }
        notes.extend(self.table.notes.iter().cloned());
        notes
    }

    fn points(&self, path: &Path, options: &PointOptions) -> Result<SurveyPointSet, ReadError> {
        let missing = markers(path, &options.missing)?;
        let usual = !accepted(&options.accept);
        let mut notes = vec![];
        let (x, y) = self.coordinates(path, options, &missing, &mut notes)?;
        let kept: Vec<usize> =
            x.iter().zip(&y).enumerate().filter(|(_, (x, y))| x.is_finite() && y.is_finite()).map(|(i, _)| i).collect();
        if kept.is_empty() {
            return Err(ReadError::data(path, "no point has a position").in_column(&self.x.name));
        }
        let pick =
            |values: &[f64]| -> Vec<f64> { kept.iter().map(|i| values.get(*i).copied().unwrap_or(f64::NAN)).collect() };
        let (x, y) = (pick(&x), pick(&y));
        let (lat_deg, lon_deg) = self.degrees(path, (&x, &y), &kept, usual)?;
        let crs = match options.to_epsg {
            None if !self.system.is_geographic() => self.system.clone(),
            to_epsg => plane(path, to_epsg, &lat_deg, &lon_deg)?,
        };
        if crs.is_geographic() {
            return Err(no_metres(path, &crs));
        }
        let (easting_m, northing_m) = if crs == self.system {
            let scaled = |values: &[f64]| values.iter().map(|v| v * crs.unit_m()).collect();
            (scaled(&x), scaled(&y))
        } else {
            let rows: Vec<u64> = kept.iter().map(|row| *row as u64).collect();
            metres(path, &crs, (&lat_deg, &lon_deg), &rows, &mut notes)?
        };
        let height_m = self.height.map(|c| self.heights(path, c, options, &missing, &mut notes)).transpose()?;
        let (factor, unit) = self.value.factor(path, "nT")?;
        let mut value_nt = pick(&self.value.numbers(path)?);
        let PointLines { line, lines, types } = self.lines(&kept);
        if kept.len() < self.table.rows {
            notes.push(format!("{} points without a position are skipped", self.table.rows - kept.len()));
        }
        without_markers(&mut value_nt, &missing, usual, &mut notes);
        if usual {
            let wrong = |i: usize, what: String| {
                let row = kept.get(i).copied().unwrap_or(i) as u64;
                ReadError::data(path, what).in_column(&self.value.name).in_row(row)
            };
            check_values(&value_nt, &ValueUnit { name: &unit, factor, canonical: "nT" }, &mut notes, wrong)?;
        }
        let finite = |v: f64| if v.is_finite() { v } else { f64::NAN };
        value_nt.iter_mut().for_each(|v| *v = finite(*v * factor));
        let unknown = value_nt.iter().filter(|v| v.is_nan()).count();
        if unknown > 0 {
            notes.push(format!("{unknown} points have no value"));
        }
        let height_m = height_m.map_or_else(|| vec![f64::NAN; kept.len()], |h| pick(&h));
        let extra = self.extra(path, &pick)?;
        let row = kept.iter().map(|row| *row as u64).collect();
        Ok(SurveyPointSet {
            crs,
            easting_m,
            northing_m,
            lat_deg,
            lon_deg,
            height_m,
            value_nt,
            line,
            lines,
            types,
            extra,
            row,
            notes,
        })
    }

    /// The coordinates in the unit of their system, NaN where missing.
    fn coordinates(
        &self,
        path: &Path,
        options: &PointOptions,
        missing: &[f64],
        notes: &mut Vec<String>,
    ) -> Result<(Vec<f64>, Vec<f64>), ReadError> {
        let unit = AxisUnit::of_both(path, self.x.axis_unit(path)?, self.y.axis_unit(path)?)?;
        let named = |c: &PointColumn, known: &[&str]| known.contains(&&*c.name.to_ascii_lowercase());
        let degrees = named(self.x, LONGITUDES) && named(self.y, LATITUDES);
        let unit = unit.or_else(|| degrees.then_some(AxisUnit::Angle(1.0)));
        let origin = if options.epsg.is_some() { CrsSource::Given } else { CrsSource::File };
        let factor = unit.map_or(Ok(1.0), |unit| unit.to_system(path, &self.system, origin, notes))?;
        let of = |column: &PointColumn, notes: &mut Vec<String>| -> Result<Vec<f64>, ReadError> {
            let mut values = column.numbers(path)?;
            without_markers(&mut values, missing, false, notes);
            values.iter_mut().for_each(|v| *v *= factor);
            Ok(values)
        };
        Ok((of(self.x, notes)?, of(self.y, notes)?))
    }

    /// Heights in metres, NaN where missing.
    fn heights(
        &self,
        path: &Path,
        column: &PointColumn,
        options: &PointOptions,
        missing: &[f64],
        notes: &mut Vec<String>,
    ) -> Result<Vec<f64>, ReadError> {
        let (factor, _) = column.factor(path, "m")?;
        let mut heights = column.numbers(path)?;
        let usual = !accepted(&options.accept);
        without_markers(&mut heights, missing, usual, notes);
        heights.iter_mut().for_each(|alt| *alt *= factor);
        let possible = |alt: &f64| alt.is_nan() || limits("alt").is_none_or(|l| l.holds(*alt));
        if let Some(row) = heights.iter().position(|alt| usual && !possible(alt)) {
            let what = format!("{} m is outside the plausible range of flight heights", heights[row]);
            let help = "if the value marks missing data, set `missing` or use `--missing`; set `accept = [\"range\"]` \
                        or use `--accept range` to keep the values";
            return Err(ReadError::data(path, what).in_column(&column.name).in_row(row as u64).help(help));
        }
        Ok(heights)
    }

    /// Latitudes and longitudes in degrees. With `usual`, fails if most positions are far from the zone of their
    /// system; a few distant positions are accepted as outliers.
    fn degrees(
        &self,
        path: &Path,
        (x, y): (&[f64], &[f64]),
        rows: &[usize],
        usual: bool,
    ) -> Result<(Vec<f64>, Vec<f64>), ReadError> {
        let mut places = (Vec::with_capacity(x.len()), Vec::with_capacity(x.len()));
        let fault = |row: usize, what: String, help: &str| {
            Err(ReadError::data(path, what).in_column(&self.x.name).in_row(row as u64).help(help))
        };
        for ((x, y), row) in x.iter().zip(y).zip(rows) {
            let place = if self.system.code() == WGS84 { Some((*y, *x)) } else { self.system.position(*x, *y) };
            let Some((lat, lon)) = place.filter(|(lat, lon)| lat.abs() <= 90.0 && lon.abs() <= 360.0) else {
                let what = format!("x {x} and y {y} are not a position in {}", self.system);
                return fault(*row, what, "check the columns, their units and the EPSG code");
            };
            places.0.push(lat);
            places.1.push(wrap_deg(lon));
        }
        let mut far = (0..rows.len()).filter(|at| usual && !self.system.is_near_zone(places.1[*at]));
        if 2 * far.clone().count() > rows.len()
            && let Some(at) = far.next()
        {
            let what = format!(
                "x {} and y {}, like most positions, are more than 6.5 degrees from the central meridian of {}",
                x[at], y[at], self.system
            );
            let help = "check the columns, their units and the EPSG code; set `accept = [\"range\"]` or use `--accept \
                        range` to keep the positions";
            return fault(rows[at], what, help);
        }
        Ok(places)
    }

    /// The line of each point, and the lines. Lines with the same name in two flights are distinct.
    fn lines(&self, rows: &[usize]) -> PointLines {
        let recorded = self.line.is_none_or(|column| column.name == "line");
        let own = self.line.map_or_else(|| self.table.recorded_lines(), PointColumn::texts);
        let kind = |row: usize| own.get(row).filter(|_| recorded).and_then(|name| self.table.types.get(name)).copied();
        let names: Vec<String> = match self.line {
            Some(_) => {
                let names = own.clone();
                let flights = self.table.column("flight").map(PointColumn::texts);
                let several = flights.as_ref().is_some_and(|f| f.iter().any(|one| Some(one) != f.first()));
                match flights.filter(|_| several) {
                    Some(flights) => flights.iter().zip(&names).map(|(f, l)| format!("{f} {l}")).collect(),
                    None => names,
                }
            }
            None => own.clone(),
        };
        let (mut lines, mut types): (Vec<String>, Vec<Option<LineType>>) = (vec![], vec![]);
        let mut places = std::collections::HashMap::new();
        let mut of = |row: &usize| {
            let name = names.get(*row).cloned().unwrap_or_default();
            *places.entry(name.clone()).or_insert_with(|| {
                lines.push(name);
                types.push(kind(*row));
                lines.len() as u32 - 1
            })
        };
        let line = rows.iter().map(&mut of).collect();
        PointLines { line, lines, types }
    }

    fn extra(&self, path: &Path, pick: &dyn Fn(&[f64]) -> Vec<f64>) -> Result<ReductionColumns, ReadError> {
        let column = |names: &[&str], unit: &str| -> Result<Option<Vec<f64>>, ReadError> {
            let column = self.table.first(names).filter(|c| c.is_number());
            column.map(|c| c.in_unit(path, unit).map(|v| pick(&v))).transpose()
        };
        Ok(ReductionColumns {
            tt_s: column(&["tt", "time_s"], "s")?,
            diurnal_nt: column(&["diurnal", "diurnal_nt"], "nT")?,
            igrf_nt: column(&["igrf", "igrf_nt"], "nT")?,
            year: column(&["year", "survey_year"], "")?,
            doy: column(&["doy", "day_of_year"], "")?,
        })
    }
}

/// The position columns: those in the options, else latitude and longitude, else eastings and northings. If a projected
/// system is given, eastings and northings are preferred.
fn place_columns<'a>(
    path: &Path,
    table: &'a PointTable,
    options: &PointOptions,
) -> Result<(&'a PointColumn, &'a PointColumn), ReadError> {
    let projected = match options.epsg {
        Some(code) => !Crs::from_epsg(path, code)?.is_geographic(),
        None => false,
    };
    let pairs = [(LONGITUDES, LATITUDES), (EASTINGS, NORTHINGS)];
    let pairs = if projected { [pairs[1], pairs[0]] } else { pairs };
    for (xs, ys) in pairs {
        let x = table.axis_or(path, options.x.as_deref(), xs, "x")?;
        let y = table.axis_or(path, options.y.as_deref(), ys, "y")?;
        if let (Some(x), Some(y)) = (x, y) {
            return Ok((x, y));
        }
    }
    Err(table.lacks(path, "positions", "x", &["longitude and latitude", "easting and northing"]))
}

#[cfg(test)]
mod tests;
