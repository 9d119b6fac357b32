//! The contents of a map file, and their conversion to an [`AnomalyGrid`]: rules that all formats share.

use std::path::Path;

use schemas::{convert, map::VectorComponent};

use super::{
    axis::FileAxis,
    axis_unit::{AxisUnit, CrsSource},
    markers::without_markers,
    plausible::{self, ValueUnit, accepted},
};
use crate::{
    MapOptions, ReadError,
    formats::{markers, side_files::SideFiles},
};
use grids::{AnomalyGrid, Crs, DERIVATIVES, GridHeight, NANOTESLA, Registration, WGS84, check_count, longitude};

/// A map in the order of its file.
pub(crate) struct MapDraft<'a> {
    pub(crate) path: &'a Path,
    /// The axis that runs fastest in `values`.
    pub(crate) x: FileAxis,
    pub(crate) y: FileAxis,
    /// The stored values row by row; values marked as unknown in the file are already NaN.
    pub(crate) values: Vec<f64>,
    /// Scale and offset from the stored values to those in `unit`.
    pub(crate) packing: [f64; 2],
    /// Whether the first row in memory is the first row of the raster, with which masks in side files begin.
    pub(crate) raster_rows: bool,
    /// Heights in the same order, if the file has them.
    pub(crate) heights: Option<Vec<f64>>,
    /// Standard deviation of the error of each value in the same order and unit, if the file has it.
    pub(crate) errors: Option<Vec<f64>>,
    /// The height of all nodes, if the file gives one.
    pub(crate) level_m: Option<f64>,
    /// The unit of the values, if the file gives it.
    pub(crate) unit: Option<String>,
    /// The component of the field that the values represent; `None` for the total-field anomaly.
    pub(crate) component: Option<VectorComponent>,
    /// The unit of the coordinates, if the file gives it.
    pub(crate) axis_unit: Option<AxisUnit>,
    pub(crate) system: FileCrs,
    pub(crate) registration: Registration,
    pub(crate) notes: Vec<String>,
}

/// Coordinate system stated by a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileCrs {
    /// A code.
    Epsg(u16),
    /// Degrees, of an unnamed datum.
    Degrees,
    /// Eastings and northings in an unknown projection.
    Projected,
    /// None.
    Unknown,
}

/// Note on a map whose height is unknown. An unknown height is no error, because only a continuation needs the height.
pub(crate) const NO_HEIGHT: &str = "the file does not give the height of the map, so `alt` is NaN; set `alt_m`";

/// Scale and offset of values that are not packed.
pub(crate) const PLAIN: [f64; 2] = [1.0, 0.0];

/// Plausible heights of a map in metres: from the deepest ocean to satellites.
const HEIGHTS_M: [f64; 2] = [-12_000.0, 2_000_000.0];

/// The note on a map whose file gives no unit.
const NO_UNIT: &str = "the file gives no unit; nT is assumed";

impl<'a> MapDraft<'a> {
    /// A draft with only axes and values.
    pub(crate) fn new(path: &'a Path, x: FileAxis, y: FileAxis, values: Vec<f64>, system: FileCrs) -> MapDraft<'a> {
        MapDraft {
            path,
            x,
            y,
            values,
            packing: PLAIN,
            raster_rows: false,
            heights: None,
            errors: None,
            level_m: None,
            unit: None,
            component: None,
            axis_unit: None,
            system,
            registration: Registration::Node,
            notes: vec![],
        }
    }

    /// The map: rows from the south, columns from the west, nT, longitudes wrapped to -180 to 180 degrees.
    ///
    /// # Errors
    /// Fails for a unit that is not a unit of the field, or for an unknown coordinate system. Also fails in the cases
    /// of [`AnomalyGrid::new`].
    pub(crate) fn finish(mut self, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
        self.check_component(options)?;
        let nodes = self.x.len().saturating_mul(self.y.len());
        check_count(self.path, self.values.len(), nodes)?;
        self.unpack()?;
        self.flip();
        let missing = markers(self.path, &options.missing)?;
        without_markers(&mut self.values, &missing, !accepted(&options.accept), &mut self.notes);
        let crs = self.crs(options)?;
        let value_unit = self.scale(options)?;
        let height = self.height(options, &missing)?;
        if self.errors.iter().flatten().any(|error| *error < 0.0 || error.is_infinite()) {
            self.errors = None;
            self.notes.push("the column `error` is ignored, because it has negative or infinite values".to_owned());
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

    /// Rejects a requested component that the file does not hold, and adds a note on the component that it holds.
    fn check_component(&mut self, options: &MapOptions) -> Result<(), ReadError> {
        match (self.component, options.field_component) {
            (None, Some(component)) => {
                let what = format!("the file holds one map, not components, so `{}` has no meaning", component.word());
                Err(ReadError::options(self.path, what).help("remove `field_component`"))
            }
            (Some(component), _) => {
                let word = component.word();
                self.notes.push(format!("the values are the {word} component of the field, not a total-field anomaly"));
                Ok(())
            }
            (None, None) => Ok(()),
        }
    }

    /// The values in their unit, with the side files of the map applied.
    fn unpack(&mut self) -> Result<(), ReadError> {
        if let Some(side) = SideFiles::read(self.path, self.x.len(), self.y.len())? {
            let reversed = !self.raster_rows && !self.y.descends();
            side.apply(self.path, &mut self.values, &mut self.packing, reversed, &mut self.notes)?;
            self.unit = self.unit.take().or(side.unit);
        }
        let [scale, offset] = self.packing;
        if !(scale.is_finite() && scale != 0.0 && offset.is_finite()) {
            let what = format!("the scale {scale} and the offset {offset} of the values are invalid");
            return Err(ReadError::data(self.path, what).help("correct scale and offset in the file"));
        }
        if self.packing != PLAIN {
            self.values.iter_mut().for_each(|v| *v = *v * scale + offset);
            self.notes.push(format!("stored values are multiplied by {scale}, then {offset} is added"));
        }
        Ok(())
    }

    /// Sorts rows and columns in ascending order.
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
            self.notes.push("the file's columns run from east to west, so they are reversed".to_owned());
        }
    }

    /// Converts the values to nT, except derivatives; returns the resulting unit.
    fn scale(&mut self, options: &MapOptions) -> Result<&'static str, ReadError> {
        let declared = self.unit.take().filter(|u| !u.trim().is_empty());
        if declared.is_none() && options.unit.is_none() {
            self.notes.push(NO_UNIT.to_owned());
            self.check_values(&ValueUnit { name: NANOTESLA, factor: 1.0, canonical: NANOTESLA }, options)?;
            return Ok(NANOTESLA);
        }
        let unit = options.unit.clone().or(declared).unwrap_or_default();
        if let Some(derivative) = DERIVATIVES.iter().find(|d| **d == unit.trim()) {
            self.check_values(&ValueUnit { name: derivative, factor: 1.0, canonical: derivative }, options)?;
            return Ok(derivative);
        }
        let factor = convert(&unit, NANOTESLA).ok_or_else(|| {
            ReadError::options(self.path, format!("the unit `{unit}` does not convert to nT")).in_column("anomaly")
        })?;
        self.check_values(&ValueUnit { name: &unit, factor, canonical: NANOTESLA }, options)?;
        if factor != 1.0 {
            // Values that `accept` permits may overflow when multiplied by the factor.
            let finite = |v: f64| if v.is_finite() { v } else { f64::NAN };
            self.values.iter_mut().chain(self.errors.iter_mut().flatten()).for_each(|v| *v = finite(*v * factor));
            self.notes.push(format!("values in {unit} are multiplied by {factor} to give nT"));
        }
        Ok(NANOTESLA)
    }

    fn check_values(&mut self, unit: &ValueUnit, options: &MapOptions) -> Result<(), ReadError> {
        if accepted(&options.accept) {
            return Ok(());
        }
        let wrong = |cell: usize, what: String| self.in_cell("anomaly", cell, &what);
        let mut notes = vec![];
        plausible::check(&self.values, unit, &mut notes, wrong)?;
        self.notes.append(&mut notes);
        Ok(())
    }

    /// A fault of one cell, whose index counts from the south-west.
    fn in_cell(&self, column: &str, cell: usize, what: &str) -> ReadError {
        let (row, along) = (cell / self.x.len(), cell % self.x.len());
        let (x, y) = (self.x.ascending().at(along as f64), self.y.ascending().at(row as f64));
        let place = format!("in row {row} from the south and column {along} from the west, at ({x}, {y})");
        ReadError::data(self.path, format!("{place}: {what}")).in_column(column)
    }

    /// The coordinate system, with the coordinates in its unit. A code in the options takes precedence over a code in
    /// the file.
    fn crs(&mut self, options: &MapOptions) -> Result<Crs, ReadError> {
        let code = match (options.epsg, self.system) {
            (Some(code), _) | (None, FileCrs::Epsg(code)) => code,
            (None, FileCrs::Degrees) => WGS84,
            (None, FileCrs::Projected) => return Err(no_epsg(self.path)),
            (None, FileCrs::Unknown) => return Err(self.no_system()),
        };
        let crs = Crs::from_epsg(self.path, code)?;
        if let Some(unit) = self.axis_unit.take() {
            let origin = if options.epsg.is_some() { CrsSource::Given } else { CrsSource::File };
            let factor = unit.to_system(self.path, &crs, origin, &mut self.notes)?;
            (self.x, self.y) = (self.x.scaled(factor), self.y.scaled(factor));
        }
        Ok(crs)
    }

    fn no_system(&self) -> ReadError {
        let (x, y) = (self.x.ascending(), self.y.ascending());
        let degrees = x.first >= -180.0 && x.last() <= 360.0 && y.first >= -90.0 && y.last() <= 90.0;
        let help = if degrees {
            "set `epsg` = 4326 if the coordinates are degrees, otherwise `epsg` of the coordinate system"
        } else {
            "set `epsg` to the code of the coordinate system, such as 32754 for UTM zone 54 south"
        };
        ReadError::options(self.path, "the file does not give its coordinate system").help(help)
    }

    fn height(&mut self, options: &MapOptions, missing: &[f64]) -> Result<GridHeight, ReadError> {
        if let Some(alt_m) = options.alt_m {
            return Ok(GridHeight::Level(alt_m));
        }
        let possible = |alt: f64| alt.is_nan() || (HEIGHTS_M[0]..=HEIGHTS_M[1]).contains(&alt);
        let possible = |alt: f64| accepted(&options.accept) || possible(alt);
        let impossible = |alt: f64| {
            format!(
                "{} m is outside the plausible range of map heights above the ellipsoid, {} to {} m",
                plausible::number(alt),
                HEIGHTS_M[0],
                HEIGHTS_M[1]
            )
        };
        let Some(mut cells) = self.heights.take() else {
            let level_m = self.level_m.unwrap_or(f64::NAN);
            if level_m.is_nan() {
                self.notes.push(NO_HEIGHT.to_owned());
            } else if !possible(level_m) {
                return Err(ReadError::data(self.path, impossible(level_m)).in_column("alt").help("set `alt_m`"));
            }
            return Ok(GridHeight::Level(level_m));
        };
        check_count(self.path, cells.len(), self.values.len()).map_err(|e| e.in_column("alt"))?;
        without_markers(&mut cells, missing, !accepted(&options.accept), &mut self.notes);
        if let Some(cell) = cells.iter().position(|alt| !possible(*alt)) {
            let alt = cells.get(cell).copied().unwrap_or(f64::NAN);
            let help = "if the value marks missing data, add it to `missing`; set `accept = [\"range\"]` to keep it";
            return Err(self.in_cell("alt", cell, &impossible(alt)).help(help));
        }
        let first = cells.iter().copied().find(|a| !a.is_nan());
        match first {
            None => {
                self.notes.push(NO_HEIGHT.to_owned());
                Ok(GridHeight::Level(f64::NAN))
            }
            Some(level_m) if cells.iter().all(|a| a.is_nan() || *a == level_m) => Ok(GridHeight::Level(level_m)),
            Some(_) => Ok(GridHeight::Cells(cells)),
        }
    }
}

pub(crate) fn no_epsg(path: &Path) -> ReadError {
    ReadError::options(path, "the file does not give the coordinate system of its eastings and northings")
        .help("set `epsg` to the code of the coordinate system, such as 32754 for UTM zone 54 south")
}

/// Wraps the longitudes to -180 to 180 degrees.
fn turn(map: &mut AnomalyGrid) {
    let turned = if map.is_geographic() { longitude::turned(&map.x) } else { None };
    let Some((axis, columns)) = turned else { return };
    map.notes.push(format!(
        "longitudes {} to {} of the file are shifted to {} to {}",
        map.x.first,
        map.x.last(),
        axis.first,
        axis.last()
    ));
    let heights = match &mut map.height {
        GridHeight::Cells(cells) => Some(cells),
        GridHeight::Level(_) => None,
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
