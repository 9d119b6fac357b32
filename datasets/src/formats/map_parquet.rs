//! Map grids in Parquet, one row a node: of latitude and longitude, or of eastings and northings.

use std::path::Path;

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::DataType;
use schemas::convert;

use super::{Head, MapFormat, MapOptions, RawMap, guarded, parquet};
use crate::{
    ReadError,
    grid::{Crs, Height, Map, Projected, from_nodes},
};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "parquet",
    about: "Apache Parquet, one row a node",
    extensions: &["parquet", "pq"],
    recognise: |head: &Head| head.starts_with(parquet::MAGIC),
    read,
};

/// Names a column of each kind may have.
const LATITUDES: &[&str] = &["lat", "latitude_deg", "latitude"];
const LONGITUDES: &[&str] = &["lon", "longitude_deg", "longitude"];
const EASTINGS: &[&str] = &["easting", "easting_m", "utm_easting_m", "osgb_easting_m", "x"];
const NORTHINGS: &[&str] = &["northing", "northing_m", "utm_northing_m", "osgb_northing_m", "y"];
const HEIGHTS: &[&str] = &["alt", "alt_m", "altitude_m"];
const ANOMALIES: &[&str] = &["anomaly", "anomaly_nt", "total_field_anomaly_nt"];

fn read(path: &Path, options: &MapOptions) -> Result<RawMap, ReadError> {
    let builder = parquet::builder(path)?;
    let names: Vec<String> = builder.schema().fields().iter().map(|f| f.name().clone()).collect();
    let known = |kinds: &[&str]| names.iter().find(|n| kinds.contains(&n.as_str())).cloned();
    let need = |kinds: &[&str]| {
        known(kinds).ok_or_else(|| {
            ReadError::data(path, format!("the map needs a column `{}`", kinds[0])).nearest(kinds[0], &names)
        })
    };
    let anomaly = need(ANOMALIES)?;
    let projected = known(LATITUDES).is_none() && known(EASTINGS).is_some();
    let (x, y) = if projected { (need(EASTINGS)?, need(NORTHINGS)?) } else { (need(LONGITUDES)?, need(LATITUDES)?) };
    let unit = builder.schema().field_with_name(&anomaly).ok().and_then(|f| f.metadata().get("unit").cloned());
    let factor = anomaly_factor(path, options, unit.as_deref())?;
    let batches: Vec<RecordBatch> = guarded(path, || {
        let reader = builder.with_batch_size(65_536).build();
        let reader = reader.map_err(|e| parquet::damaged(path, &e.to_string()))?;
        reader.collect::<Result<_, _>>().map_err(|e| parquet::damaged(path, &e.to_string()))
    })?;
    let (xs, ys) = (numbers(path, &batches, &x)?, numbers(path, &batches, &y)?);
    let (x, y) = ((x.as_str(), xs.as_slice()), (y.as_str(), ys.as_slice()));
    let values = scaled(numbers(path, &batches, &anomaly)?, factor);
    let height = known(HEIGHTS).map(|name| numbers(path, &batches, &name)).transpose()?;
    if projected {
        return projected_map(path, options, x, y, &values, height);
    }
    let given = options.alt_m;
    let columns = [values, height.clone().unwrap_or_default()];
    let columns: Vec<&[f64]> = columns.iter().filter(|c| !c.is_empty()).map(Vec::as_slice).collect();
    let mut nodes = from_nodes(path, x, y, &columns)?;
    let cells = nodes.values.pop_if(|_| height.is_some());
    let mut notes = vec![];
    let height = match (given, cells) {
        (Some(alt_m), _) => Height::Level(alt_m),
        (None, Some(cells)) => Height::Cells(cells),
        (None, None) => {
            notes.push(NO_HEIGHT.to_owned());
            Height::Level(f64::NAN)
        }
    };
    let values = nodes.values.pop().unwrap_or_default();
    Map::new(path, &nodes.y, &nodes.x, height, values, notes).map(RawMap::Geographic)
}

fn projected_map(
    path: &Path,
    options: &MapOptions,
    easting: (&str, &[f64]),
    northing: (&str, &[f64]),
    values: &[f64],
    height: Option<Vec<f64>>,
) -> Result<RawMap, ReadError> {
    let code = options.epsg.ok_or_else(|| no_epsg(path))?;
    let crs = Crs::from_epsg(path, code)?;
    let level = height.as_ref().and_then(|h| h.first()).copied();
    if options.alt_m.is_none() && height.is_some_and(|h| h.iter().any(|x| Some(*x) != level)) {
        let what = "the height varies from node to node, which a projected map cannot have";
        return Err(ReadError::data(path, what).in_column("alt"));
    }
    let alt_m = options.alt_m.or(level).unwrap_or(f64::NAN);
    let notes = if alt_m.is_nan() { vec![NO_HEIGHT.to_owned()] } else { vec![] };
    let mut nodes = from_nodes(path, easting, northing, &[values])?;
    let anomaly_nt = nodes.values.pop().unwrap_or_default();
    let (easting, northing) = (nodes.x_axis, nodes.y_axis);
    Ok(RawMap::Projected(Box::new(Projected { easting, northing, anomaly_nt, crs, alt_m, notes })))
}

fn numbers(path: &Path, batches: &[RecordBatch], name: &str) -> Result<Vec<f64>, ReadError> {
    let mut out = vec![];
    for column in batches.iter().filter_map(|b| b.column_by_name(name)) {
        if !column.data_type().is_numeric() {
            let what = format!("holds {}, not numbers", column.data_type());
            return Err(ReadError::data(path, what).in_column(name));
        }
        let numbers = cast(column, &DataType::Float64).map_err(|e| ReadError::data(path, e.to_string()))?;
        let numbers = numbers.as_primitive::<Float64Type>();
        out.extend(numbers.iter().map(|x| x.unwrap_or(f64::NAN)));
    }
    if out.is_empty() { Err(ReadError::data(path, "the map has no rows")) } else { Ok(out) }
}

pub(super) fn scaled(mut values: Vec<f64>, factor: f64) -> Vec<f64> {
    if factor != 1.0 {
        values.iter_mut().for_each(|v| *v *= factor);
    }
    values
}

/// What turns the anomaly into nT: the unit of the options, else of the file, else nT.
pub(super) fn anomaly_factor(path: &Path, options: &MapOptions, file: Option<&str>) -> Result<f64, ReadError> {
    let unit = options.unit.as_deref().or(file.filter(|u| !u.is_empty())).unwrap_or("nT");
    convert(unit, "nT").ok_or_else(|| {
        ReadError::options(path, format!("the unit `{unit}` does not convert to nT")).in_column("anomaly")
    })
}

/// Said of a map whose height is unknown: nothing but a continuation needs it.
pub(super) const NO_HEIGHT: &str = "the file does not say how high the map is, so `alt` is NaN; `alt_m` gives it";

pub(super) fn no_epsg(path: &Path) -> ReadError {
    ReadError::options(path, "the file does not say what its eastings and northings are")
        .help("give `epsg`, the code of the coordinate system, such as 32754 for UTM zone 54 south")
}
