//! Map grids in GeoTIFF: one band of numbers, any compression and layout that the TIFF decoder supports, row 0 in the
//! north. [OGC 19-008r4, GeoTIFF 1.1]

use std::path::Path;

use tiff::tags::Tag;

use super::{
    FileHead, MapFormat, MapOptions,
    geotiff_band::{self, TiffDecoder, damaged},
    geotiff_keys::{
        ANGULAR_UNIT, GDAL_METADATA, GEOGRAPHIC_CODE, LINEAR_UNIT, LINEAR_UNIT_SIZE, MODEL_TYPE, PROJECTED_CODE,
        RASTER_TYPE, unit_of_code,
    },
    geotiff_metadata::GdalMetadata,
    guarded, map_geotiff_write,
};
use crate::{
    ReadError,
    grid::{AxisUnit, FileAxis, FileCrs, MapDraft},
};
use grids::{AnomalyGrid, Registration};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "geotiff",
    about: "GeoTIFF with one band of float or integer values",
    extensions: &["tif", "tiff"],
    recognise: |head: &FileHead| MAGICS.iter().any(|m| head.starts_with(m)),
    companions: None,
    read,
    write: Some(map_geotiff_write::write),
};

/// Little- and big-endian TIFF and BigTIFF.
const MAGICS: [&[u8]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let (place, values, metadata, further) = guarded(path, || {
        let mut decoder = geotiff_band::decoder(path)?;
        let (width, height) = decoder.dimensions().map_err(|e| damaged(path, &e))?;
        let place = Georeference::read(path, &mut decoder, width as usize, height as usize)?;
        let metadata = decoder.get_tag_ascii_string(GDAL_METADATA).unwrap_or_default();
        let (values, further) = geotiff_band::values(path, &mut decoder)?;
        Ok((place, values, metadata, further))
    })?;
    let system = match place.epsg {
        Some(code) => FileCrs::Epsg(code),
        None if place.geographic => FileCrs::Degrees,
        None => FileCrs::Projected,
    };
    let metadata = GdalMetadata::read(path, &metadata)?;
    let mut draft = MapDraft::new(path, place.x, place.y, values, system);
    draft.registration = place.registration;
    draft.raster_rows = true;
    draft.axis_unit = place.unit;
    if !place.y.descends() {
        draft.notes.push("the file's first row is the southernmost".to_owned());
    }
    if further > 0 {
        draft.notes.push(format!("{further} other images of the file are ignored"));
    }
    draft.packing = metadata.packing()?;
    draft.unit = metadata.item(&["unit", "units", "UNITTYPE"]).map(|(_, unit)| unit.to_owned());
    if options.alt_m.is_none() {
        draft.level_m = height_m(&metadata, &mut draft.notes);
    }
    draft.finish(options)
}

/// The positions of the cells.
struct Georeference {
    /// Centres of the columns.
    x: FileAxis,
    /// Centres of the rows.
    y: FileAxis,
    registration: Registration,
    /// The code of the coordinate system, if the file has one.
    epsg: Option<u16>,
    /// Whether the coordinates are degrees.
    geographic: bool,
    /// The unit of the coordinates, if the file has one.
    unit: Option<AxisUnit>,
}

impl Georeference {
    fn read(path: &Path, decoder: &mut TiffDecoder, width: usize, height: usize) -> Result<Georeference, ReadError> {
        if width < 2 || height < 2 {
            return Err(ReadError::data(path, format!("a map requires at least 2 x 2 nodes, not {width} x {height}")));
        }
        let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap_or_default();
        let key = |id: u16| keys.chunks_exact(4).skip(1).find(|k| k[0] == id && k[1] == 0).map(|k| k[3]);
        // User-defined systems have the code 32767, unknown ones 0.
        let code = |id: u16| key(id).filter(|c| *c != 0 && *c != USER_DEFINED);
        let geographic = key(MODEL_TYPE) == Some(2);
        let epsg = if geographic { code(GEOGRAPHIC_CODE) } else { code(PROJECTED_CODE) };
        // Without a raster type the tie point is the corner of a cell, not its centre.
        let registration = if key(RASTER_TYPE) == Some(2) { Registration::Node } else { Registration::Pixel };
        let to_centre = if registration == Registration::Node { 0.0 } else { 0.5 };
        let [x0, dx, y0, dy] = affine(path, decoder)?;
        let x = FileAxis::new(path, "x", x0 + dx * to_centre, dx, width)?;
        let y = FileAxis::new(path, "y", y0 + dy * to_centre, dy, height)?;
        let code = key(if geographic { ANGULAR_UNIT } else { LINEAR_UNIT }).filter(|c| *c != 0);
        let unit = match code {
            None => None,
            Some(USER_DEFINED) if !geographic => Some(own_unit(path, decoder, &keys)?),
            Some(code) => Some(unit_of_code(code).ok_or_else(|| {
                ReadError::data(path, format!("the unit EPSG:{code} of the coordinates is unknown"))
                    .help("convert the map to a system in metres first")
            })?),
        };
        Ok(Georeference { x, y, registration, epsg, geographic, unit })
    }
}

/// The code that marks a GeoTIFF key as user-defined.
const USER_DEFINED: u16 = 32_767;

/// The length that the file defines as its unit, in metres.
fn own_unit(path: &Path, decoder: &mut TiffDecoder, keys: &[u16]) -> Result<AxisUnit, ReadError> {
    let doubles = decoder.get_tag_f64_vec(Tag::GeoDoubleParamsTag).unwrap_or_default();
    let entry = keys.chunks_exact(4).skip(1).find(|k| k[0] == LINEAR_UNIT_SIZE);
    let size = entry.and_then(|k| doubles.get(usize::from(k[3]))).copied().filter(|m| m.is_finite() && *m > 0.0);
    let size = size.ok_or_else(|| {
        ReadError::data(path, "the unit of the coordinates is user-defined, but the file does not give its size")
            .help("convert the map to a system in metres first")
    })?;
    Ok(AxisUnit::Length(format!("units of {size} m"), size))
}

/// x of column 0, step of x, y of row 0 and step of y.
fn affine(path: &Path, decoder: &mut TiffDecoder) -> Result<[f64; 4], ReadError> {
    let scale = decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap_or_default();
    let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap_or_default();
    if let ([dx, dy, ..], [column, row, _, x, y, _]) = (scale.as_slice(), tie.as_slice()) {
        return Ok([x - column * dx, *dx, y + row * dy, -dy]);
    }
    let matrix = decoder.get_tag_f64_vec(Tag::ModelTransformationTag).unwrap_or_default();
    match matrix.as_slice() {
        [dx, xy, _, x, yx, dy, _, y, ..] if *xy == 0.0 && *yx == 0.0 => Ok([*x, *dx, *y, *dy]),
        [_, _, _, _, _, _, _, _, ..] => {
            Err(ReadError::data(path, "the grid is rotated").help("warp the grid to north-up first"))
        }
        _ => Err(ReadError::data(
            path,
            "the file lacks the positions of its cells (tags ModelPixelScale and ModelTiepoint)",
        )),
    }
}

/// The height of the map: an item of GDAL's metadata with a height in metres.
fn height_m(metadata: &GdalMetadata, notes: &mut Vec<String>) -> Option<f64> {
    const NAMES: [&str; 5] = ["level_height_m", "height_m", "altitude_m", "alt_m", "alt"];
    let (name, text) = metadata.item(&NAMES)?;
    let alt_m = text.parse::<f64>().ok().filter(|x| x.is_finite())?;
    notes.push(format!("the height {alt_m} m in the file's `{name}` is used as the height above the ellipsoid"));
    Some(alt_m)
}
