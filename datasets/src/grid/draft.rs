//! The contents of a map file, and their conversion to a [`AnomalyGrid`]: the rules that all formats share.

use std::path::Path;

use schemas::convert;

use super::axis::FileAxis;
use crate::{MapOptions, ReadError};
use grids::{AnomalyGrid, Crs, DERIVATIVES, Height, NANOTESLA, Registration, WGS84, check_count, longitude};

/// A map in the order of its file.
pub(crate) struct Draft<'a> {
    pub(crate) path: &'a Path,
    /// The axis that runs fastest in `values`.
    pub(crate) x: FileAxis,
    pub(crate) y: FileAxis,
    /// Row by row; values that the file marks as unknown are already NaN.
    pub(crate) values: Vec<f64>,
    /// Heights in the same order, where the file has them.
    pub(crate) heights: Option<Vec<f64>>,
    /// One sigma of the error of each value in the same order and unit, where the file has it.
    pub(crate) errors: Option<Vec<f64>>,
    /// The one height of all nodes, where the file gives it.
    pub(crate) level_m: Option<f64>,
    /// The unit of the values, where the file gives it.
    pub(crate) unit: Option<String>,
    pub(crate) system: System,
    pub(crate) registration: Registration,
    pub(crate) notes: Vec<String>,
}

/// The coordinate system that a file gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum System {
    /// A code.
    Epsg(u16),
    /// Degrees, of an unnamed datum.
    Degrees,
    /// Eastings and northings of no known projection.
    Projected,
    /// None.
    Unknown,
}

/// The note on a map whose height is unknown: only a continuation needs it.
pub(crate) const NO_HEIGHT: &str = "the file does not give the height of the map, so `alt` is NaN; set it with `alt_m`";

/// The note on a map whose file gives no unit.
const NO_UNIT: &str = "the file gives no unit; the values are taken as nT";

impl<'a> Draft<'a> {
    /// A draft of axes and values alone.
    pub(crate) fn new(path: &'a Path, x: FileAxis, y: FileAxis, values: Vec<f64>, system: System) -> Draft<'a> {
        Draft {
            path,
            x,
            y,
            values,
            heights: None,
            errors: None,
            level_m: None,
            unit: None,
            system,
            registration: Registration::Node,
            notes: vec![],
        }
    }

    /// The map: rows from the south, columns from the west, nT, longitudes around Greenwich.
    ///
    /// # Errors
    /// Fails for a unit that is no field's, a coordinate system that is unknown, and as [`AnomalyGrid::new`].
    pub(crate) fn finish(mut self, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
        let nodes = self.x.len().saturating_mul(self.y.len());
        check_count(self.path, self.values.len(), nodes)?;
        self.flip();
        let value_unit = self.scale(options)?;
        let crs = self.crs(options)?;
        let height = self.height(options)?;
        if self.errors.iter().flatten().any(|error| *error < 0.0 || error.is_infinite()) {
            self.errors = None;
            self.notes.push("the column `error` is not used: it has values that are no standard deviations".to_owned());
        }
        let mut map = AnomalyGrid {
            x: self.x.ascending(),
            y: self.y.ascending(),
            crs,
            anomaly_nt: self.values,
            error_nt: self.errors,
            value_unit,
            height,
            registration: self.registration,
            format: "",
            source: self.path.to_path_buf(),
            notes: self.notes,
        };
        map.check()?;
        turn(&mut map);
        Ok(map)
    }

    /// Brings rows and columns into ascending order.
    fn flip(&mut self) {
        let (width, x_down, y_down) = (self.x.len(), self.x.descends(), self.y.descends());
        let columns = [Some(&mut self.values), self.heights.as_mut(), self.errors.as_mut()];
        for values in columns.into_iter().flatten() {
            if y_down {
                *values = values.chunks(width).rev().flatten().copied().collect();
            }
            if x_down {
                values.chunks_mut(width).for_each(<[f64]>::reverse);
            }
        }
        if x_down {
            self.notes.push("the file's columns run from east to west; reversed".to_owned());
        }
    }

    /// Brings the values into nT, derivatives aside; the unit that they have then.
    fn scale(&mut self, options: &MapOptions) -> Result<&'static str, ReadError> {
        let said = self.unit.take().filter(|u| !u.trim().is_empty());
        if said.is_none() && options.unit.is_none() {
            self.notes.push(NO_UNIT.to_owned());
            return Ok(NANOTESLA);
        }
        let unit = options.unit.clone().or(said).unwrap_or_default();
        if let Some(derivative) = DERIVATIVES.iter().find(|d| **d == unit.trim()) {
            return Ok(derivative);
        }
        let factor = convert(&unit, NANOTESLA).ok_or_else(|| {
            ReadError::options(self.path, format!("the unit `{unit}` does not convert to nT")).in_column("anomaly")
        })?;
        if factor != 1.0 {
            self.values.iter_mut().chain(self.errors.iter_mut().flatten()).for_each(|v| *v *= factor);
            self.notes.push(format!("values in {unit} times {factor} are nT"));
        }
        Ok(NANOTESLA)
    }

    /// A code given in the options takes precedence over the file's own.
    fn crs(&self, options: &MapOptions) -> Result<Crs, ReadError> {
        let code = match (options.epsg, self.system) {
            (Some(code), _) | (None, System::Epsg(code)) => code,
            (None, System::Degrees) => WGS84,
            (None, System::Projected) => return Err(no_epsg(self.path)),
            (None, System::Unknown) => return Err(self.no_system()),
        };
        Crs::from_epsg(self.path, code)
    }

    fn no_system(&self) -> ReadError {
        let (x, y) = (self.x.ascending(), self.y.ascending());
        let degrees = x.first >= -180.0 && x.last() <= 360.0 && y.first >= -90.0 && y.last() <= 90.0;
        let help = if degrees {
            "they may be degrees: then give `epsg` = 4326, otherwise the code of the coordinate system"
        } else {
            "give `epsg`, the code of the coordinate system, such as 32754 for UTM zone 54 south"
        };
        ReadError::options(self.path, "the file does not give its coordinate system").help(help)
    }

    fn height(&mut self, options: &MapOptions) -> Result<Height, ReadError> {
        if let Some(alt_m) = options.alt_m {
            return Ok(Height::Level(alt_m));
        }
        let Some(cells) = self.heights.take() else {
            let level_m = self.level_m.unwrap_or(f64::NAN);
            if level_m.is_nan() {
                self.notes.push(NO_HEIGHT.to_owned());
            }
            return Ok(Height::Level(level_m));
        };
        check_count(self.path, cells.len(), self.values.len()).map_err(|e| e.in_column("alt"))?;
        let first = cells.iter().copied().find(|a| !a.is_nan());
        match first {
            None => {
                self.notes.push(NO_HEIGHT.to_owned());
                Ok(Height::Level(f64::NAN))
            }
            Some(level_m) if cells.iter().all(|a| a.is_nan() || *a == level_m) => Ok(Height::Level(level_m)),
            Some(_) => Ok(Height::Cells(cells)),
        }
    }
}

pub(crate) fn no_epsg(path: &Path) -> ReadError {
    ReadError::options(path, "the file does not give the system of its eastings and northings")
        .help("give `epsg`, the code of the coordinate system, such as 32754 for UTM zone 54 south")
}

/// Brings the longitudes to -180 to 180 degrees.
fn turn(map: &mut AnomalyGrid) {
    let turned = if map.is_geographic() { longitude::turned(&map.x) } else { None };
    let Some((axis, columns)) = turned else { return };
    map.notes.push(format!(
        "longitudes {} to {} of the file turned to {} to {}",
        map.x.first,
        map.x.last(),
        axis.first,
        axis.last()
    ));
    let heights = match &mut map.height {
        Height::Cells(cells) => Some(cells),
        Height::Level(_) => None,
    };
    let width = map.x.len;
    for values in [Some(&mut map.anomaly_nt), heights, map.error_nt.as_mut()].into_iter().flatten() {
        for row in values.chunks_mut(width) {
            let turned: Vec<f64> = columns.iter().map(|c| row.get(*c).copied().unwrap_or(f64::NAN)).collect();
            row.copy_from_slice(&turned);
        }
    }
    map.x = axis;
}
