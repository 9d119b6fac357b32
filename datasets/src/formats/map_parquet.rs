//! Map grids in Parquet, one row per node, in latitude and longitude or in eastings and northings.

use std::{ops::Range, path::Path, sync::Arc};

use ::parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    errors::ParquetError,
    file::properties::WriterProperties,
};
use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use schemas::{Role, field, map::ERROR};

use super::{FileHead, MapFormat, MapOptions, output::MapOutputFiles, parquet};
use crate::{
    ReadError,
    grid::{AxisUnit, FileCrs, MapDraft, from_nodes, split_unit},
};
use grids::{AnomalyGrid, WGS84};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "parquet",
    about: "Apache Parquet, one row per node",
    extensions: &["parquet", "pq"],
    recognise: |head: &FileHead| head.starts_with(parquet::MAGIC),
    companions: None,
    read,
    write: Some(write),
};

/// Accepted column names for each coordinate and quantity.
pub(super) const LATITUDES: &[&str] = &["lat", "latitude_deg", "latitude"];
pub(super) const LONGITUDES: &[&str] = &["lon", "longitude_deg", "longitude"];
pub(super) const EASTINGS: &[&str] = &["easting", "easting_m", "utm_easting_m", "osgb_easting_m", "x"];
pub(super) const NORTHINGS: &[&str] = &["northing", "northing_m", "utm_northing_m", "osgb_northing_m", "y"];
pub(super) const HEIGHTS: &[&str] = &["alt", "alt_m", "altitude_m"];
pub(super) const ANOMALIES: &[&str] = &["anomaly", "anomaly_nt", "total_field_anomaly_nt"];

/// Whether a map's file gives the error of each node; `false` for a file that cannot be read.
pub(super) fn gives_error(path: &Path) -> bool {
    path.is_file() && parquet::ParquetSource::new(path).is_ok_and(|open| open.schema.field_with_name(ERROR).is_ok())
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let file = parquet::ParquetSource::new(path)?;
    let schema = file.schema.clone();
    let names: Vec<String> = schema.fields().iter().map(|f| f.name().clone()).collect();
    let exact = |kinds: &[&str]| names.iter().find(|n| kinds.contains(&n.as_str())).cloned();
    let ends_in_unit = |kinds: &[&str]| kinds == EASTINGS || kinds == NORTHINGS;
    let known = |kinds: &[&str]| {
        let base = |n: &&String| kinds.contains(&split_unit(n).0.to_ascii_lowercase().as_str());
        exact(kinds).or_else(|| names.iter().find(base).filter(|_| ends_in_unit(kinds)).cloned())
    };
    let need = |kinds: &[&str]| {
        known(kinds).ok_or_else(|| {
            ReadError::data(path, format!("the map requires a column `{}`", kinds[0])).nearest(kinds[0], &names)
        })
    };
    let anomaly = need(ANOMALIES)?;
    let projected = known(LATITUDES).is_none() && known(EASTINGS).is_some();
    let (x, y) = if projected { (need(EASTINGS)?, need(NORTHINGS)?) } else { (need(LONGITUDES)?, need(LATITUDES)?) };
    let unit = schema.field_with_name(&anomaly).ok().and_then(|f| f.metadata().get("unit").cloned());
    let code = schema.field_with_name(&x).ok().and_then(|f| f.metadata().get("epsg")?.parse().ok());
    let metadata_of = |name: &str, key: &str| schema.field_with_name(name).ok()?.metadata().get(key).cloned();
    let units = [metadata_of(&x, "unit"), metadata_of(&y, "unit")];
    let axis_unit = axis_unit(path, [&x, &y], units.each_ref().map(Option::as_deref))?;
    let packing = ["scale_factor", "add_offset"].map(|key| metadata_of(&anomaly, key));
    let alt_unit =
        known(HEIGHTS).and_then(|name| metadata_of(&name, "unit").or_else(|| Some(split_unit(&name).1.to_owned())));
    let batches: Vec<RecordBatch> = file.batches(path)?.collect::<Result<_, _>>()?;
    let made = of_stage(path, &names, &batches)?;
    let (x, y, code, axis_unit) = match made {
        Some(made) if made != WGS84 => ("easting".to_owned(), "northing".to_owned(), Some(made), None),
        Some(_) => (x, y, code, None),
        None => (x, y, code, axis_unit),
    };
    let (xs, ys) = (numbers(path, &batches, &x)?, numbers(path, &batches, &y)?);
    let (x, y) = ((x.as_str(), xs.as_slice()), (y.as_str(), ys.as_slice()));
    let values = numbers(path, &batches, &anomaly)?;
    let mut height = known(HEIGHTS).map(|name| numbers(path, &batches, &name)).transpose()?;
    if let (Some(heights), Some(unit)) = (&mut height, alt_unit.filter(|u| !u.is_empty())) {
        let metres = schemas::convert(&unit, "m").ok_or_else(|| {
            ReadError::data(path, format!("the unit `{unit}` does not convert to m")).in_column("alt")
        })?;
        heights.iter_mut().for_each(|alt| *alt *= metres);
    }
    let error = known(&[ERROR]).map(|name| numbers(path, &batches, &name)).transpose()?;
    let columns = [Some(&values), height.as_ref(), error.as_ref()];
    let columns: Vec<&[f64]> = columns.into_iter().flatten().map(Vec::as_slice).collect();
    let mut nodes = from_nodes(path, x, y, &columns)?;
    let errors = nodes.values.pop_if(|_| error.is_some());
    let heights = nodes.values.pop_if(|_| height.is_some());
    let system = match code {
        Some(code) => FileCrs::Epsg(code),
        None if projected => FileCrs::Projected,
        None => FileCrs::Degrees,
    };
    let mut draft = MapDraft::new(path, nodes.x, nodes.y, nodes.values.pop().unwrap_or_default(), system);
    draft.unit = unit;
    (draft.heights, draft.errors) = (heights, errors);
    draft.axis_unit = axis_unit;
    for (own, declared) in draft.packing.iter_mut().zip(packing) {
        let Some(text) = declared else { continue };
        let number = text.trim().parse::<f64>();
        *own = number.map_err(|_| {
            ReadError::data(path, format!("the scale or offset `{text}` is not a number")).in_column(&anomaly)
        })?;
    }
    draft.finish(options)
}

/// The unit of coordinates: from the metadata of the columns, else from their names.
///
/// # Errors
/// Fails for an unknown unit, or if the two coordinates have different units.
pub(super) fn axis_unit(
    path: &Path,
    names: [&str; 2],
    declared: [Option<&str>; 2],
) -> Result<Option<AxisUnit>, ReadError> {
    let of = |name: &str, declared: Option<&str>| {
        let unit = declared.filter(|u| !u.is_empty()).unwrap_or_else(|| split_unit(name).1);
        AxisUnit::read(path, name, unit)
    };
    AxisUnit::of_both(path, of(names[0], declared[0])?, of(names[1], declared[1])?)
}

/// The coordinate system of a map that a stage has made ([`schemas::map::MADE_COLUMNS`]); `None` for another table.
///
/// # Errors
/// Fails for several maps in one table, such as the maps of a sweep.
fn of_stage(path: &Path, names: &[String], batches: &[RecordBatch]) -> Result<Option<u16>, ReadError> {
    if schemas::map::MADE_COLUMNS.iter().any(|made| !names.iter().any(|name| name == made)) {
        return Ok(None);
    }
    let codes = numbers(path, batches, "epsg")?;
    let first = codes.first().copied().unwrap_or(f64::NAN);
    if codes.iter().any(|code| *code != first) {
        let what = "the table holds several coordinate systems, because it has one map for each point of a sweep";
        return Err(ReadError::data(path, what).in_column("epsg"));
    }
    // An invalid code is rejected later.
    Ok(Some(first as u16))
}

/// Number of nodes per written batch.
const BATCH_NODES: usize = 1 << 20;

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    let schema = schema(map);
    let properties = WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
    let sink = outputs.create()?;
    let failed = |e: ParquetError, path: &Path| ReadError::machine(path, e.to_string());
    let path = outputs.path().to_path_buf();
    let writer = ArrowWriter::try_new(sink, schema.clone(), Some(properties));
    let mut writer = writer.map_err(|e| failed(e, &path))?;
    let rows = (BATCH_NODES / map.x.len).max(1);
    for from in (0..map.y.len).step_by(rows) {
        let batch = batch(map, &schema, from..(from + rows).min(map.y.len)).map_err(|e| map.fault(e.to_string()))?;
        writer.write(&batch).map_err(|e| failed(e, &path))?;
    }
    let sink = writer.into_inner().map_err(|e| failed(e, &path))?;
    outputs.finish(sink)
}

/// The canonical columns; eastings and northings, with their code, for a projected map.
fn schema(map: &AnomalyGrid) -> SchemaRef {
    let mut fields: Vec<Field> = schemas::map::shape().columns.iter().map(schemas::Column::field).collect();
    if map.value_unit != "nT" {
        let what = "derivative of the total field anomaly; NaN where unknown";
        fields.splice(3..4, [field("anomaly", DataType::Float64, map.value_unit, Role::Aux, what)]);
    }
    if !map.is_geographic() {
        let unit = map.unit();
        let axis = |name: &str, what: &str| field(name, DataType::Float64, unit, Role::Key, what);
        fields.splice(0..2, [axis("easting", "easting of the node"), axis("northing", "northing of the node")]);
    }
    if map.crs.code() != WGS84 {
        for field in fields.iter_mut().take(2) {
            let mut metadata = field.metadata().clone();
            metadata.insert("epsg".to_owned(), map.crs.code().to_string());
            field.set_metadata(metadata);
        }
    }
    Arc::new(Schema::new(fields))
}

/// The batch with the given rows of the map.
fn batch(map: &AnomalyGrid, schema: &SchemaRef, rows: Range<usize>) -> Result<RecordBatch, ArrowError> {
    let nodes = rows.start * map.x.len..rows.end * map.x.len;
    let x = map.x.coordinates().repeat(rows.len());
    let y: Vec<f64> = rows.flat_map(|j| std::iter::repeat_n(map.y.at(j as f64), map.x.len)).collect();
    let alt: Vec<f64> = nodes.clone().map(|node| map.height_at(node)).collect();
    let anomaly = map.anomaly_nt.get(nodes).unwrap_or_default().to_vec();
    let (first, second) = if map.is_geographic() { (y, x) } else { (x, y) };
    let columns = [first, second, alt, anomaly].map(|c| Arc::new(Float64Array::from(c)) as ArrayRef);
    RecordBatch::try_new(schema.clone(), columns.to_vec())
}

fn numbers(path: &Path, batches: &[RecordBatch], name: &str) -> Result<Vec<f64>, ReadError> {
    let mut out = vec![];
    for column in batches.iter().filter_map(|b| b.column_by_name(name)) {
        if !column.data_type().is_numeric() {
            let what = format!("must hold numbers, not {}", column.data_type());
            return Err(ReadError::data(path, what).in_column(name));
        }
        let numbers = cast(column, &DataType::Float64).map_err(|e| ReadError::data(path, e.to_string()))?;
        let numbers = numbers.as_primitive::<Float64Type>();
        out.extend(numbers.iter().map(|x| x.unwrap_or(f64::NAN)));
    }
    if out.is_empty() { Err(ReadError::data(path, "the map has no rows")) } else { Ok(out) }
}
