//! Map grids in GeoTIFF: one band of numbers, any compression and layout that the TIFF decoder knows,
//! row 0 in the north. [OGC 19-008r4, GeoTIFF 1.1]

use std::{fs::File, io::BufReader, path::Path};

use tiff::{
    ColorType,
    decoder::{Decoder, DecodingResult, Limits},
    tags::Tag,
};

use super::{
    Head, MapFormat, MapOptions,
    geotiff_keys::{GDAL_METADATA, GEOGRAPHIC_CODE, MODEL_TYPE, PROJECTED_CODE, RASTER_TYPE},
    guarded, map_geotiff_write,
};
use crate::{
    ReadError,
    grid::{Draft, FileAxis, System},
};
use grids::{AnomalyGrid, Registration};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "geotiff",
    about: "GeoTIFF with one band of float or integer values",
    extensions: &["tif", "tiff"],
    recognise: |head: &Head| MAGICS.iter().any(|m| head.starts_with(m)),
    beside: None,
    read,
    write: Some(map_geotiff_write::write),
};

/// Little- and big-endian TIFF and BigTIFF.
const MAGICS: [&[u8]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

/// The largest expansion factor of a TIFF compression.
const MOST_INFLATION: u64 = 1100;

type Reader = Decoder<BufReader<File>>;

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let (place, values, metadata) = guarded(path, || {
        let mut decoder = decoder(path)?;
        let (width, height) = decoder.dimensions().map_err(|e| damaged(path, &e))?;
        let place = Georeference::read(path, &mut decoder, width as usize, height as usize)?;
        let values = values(path, &mut decoder)?;
        Ok((place, values, text(&mut decoder, GDAL_METADATA).unwrap_or_default()))
    })?;
    let system = match place.epsg {
        Some(code) => System::Epsg(code),
        None if place.geographic => System::Degrees,
        None => System::Projected,
    };
    let mut draft = Draft::new(path, place.x, place.y, values, system);
    draft.registration = place.registration;
    if !place.y.descends() {
        draft.notes.push("the file's first row is the southernmost".to_owned());
    }
    draft.unit = item(&metadata, &["unit", "units", "UNITTYPE"]).map(|(_, unit)| unit);
    if options.alt_m.is_none() {
        draft.level_m = height_m(&metadata, &mut draft.notes);
    }
    draft.finish(options)
}

fn decoder(path: &Path) -> Result<Reader, ReadError> {
    let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
    let bytes = file.metadata().map_err(|e| ReadError::io(path, &e))?.len();
    // A damaged size must not exhaust memory: a size that the file cannot hold is rejected.
    let mut limits = Limits::default();
    let most = usize::try_from(bytes.saturating_mul(MOST_INFLATION).max(1 << 20)).unwrap_or(usize::MAX);
    limits.decoding_buffer_size = most;
    limits.intermediate_buffer_size = most;
    limits.ifd_value_size = most.min(1 << 28);
    let decoder = Decoder::new(BufReader::new(file)).map_err(|e| damaged(path, &e))?;
    Ok(decoder.with_limits(limits))
}

fn damaged(path: &Path, error: &tiff::TiffError) -> ReadError {
    ReadError::data(path, format!("not a whole TIFF file that can be read: {error}"))
}

/// The values as stored, the no-data value as NaN.
fn values(path: &Path, decoder: &mut Reader) -> Result<Vec<f64>, ReadError> {
    let colour = decoder.colortype().map_err(|e| damaged(path, &e))?;
    if !matches!(colour, ColorType::Gray(_)) {
        return Err(ReadError::data(path, format!("a map has one band; this is {colour:?}")));
    }
    let no_data =
        text(decoder, Tag::GdalNodata).and_then(|t| t.trim().trim_end_matches('\0').trim().parse::<f64>().ok());
    let image = decoder.read_image().map_err(|e| damaged(path, &e))?;
    let whole = |x: f64| if Some(x) == no_data { f64::NAN } else { x };
    Ok(match image {
        // The text of a single-precision no-data value is rounded to single precision first.
        DecodingResult::F32(v) => {
            let no_data = no_data.map(|x| x as f32);
            v.into_iter().map(|x| if Some(x) == no_data { f64::NAN } else { f64::from(x) }).collect()
        }
        DecodingResult::F64(v) => v.into_iter().map(whole).collect(),
        DecodingResult::I8(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        DecodingResult::I16(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        DecodingResult::I32(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        DecodingResult::U8(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        DecodingResult::U16(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        DecodingResult::U32(v) => v.into_iter().map(|x| whole(f64::from(x))).collect(),
        _ => {
            return Err(ReadError::data(path, "the band's values are of a kind that is not read").help("write Float32"));
        }
    })
}

/// The positions of the cells.
struct Georeference {
    /// Centres of the columns.
    x: FileAxis,
    /// Centres of the rows.
    y: FileAxis,
    registration: Registration,
    /// The code of the coordinate system, where the file has one.
    epsg: Option<u16>,
    /// Whether the coordinates are degrees.
    geographic: bool,
}

impl Georeference {
    fn read(path: &Path, decoder: &mut Reader, width: usize, height: usize) -> Result<Georeference, ReadError> {
        if width < 2 || height < 2 {
            return Err(ReadError::data(path, format!("a map needs 2 x 2 cells or more, not {width} x {height}")));
        }
        let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap_or_default();
        let key = |id: u16| keys.chunks_exact(4).skip(1).find(|k| k[0] == id && k[1] == 0).map(|k| k[3]);
        // User-defined systems have the code 32767, unknown ones 0.
        let code = |id: u16| key(id).filter(|c| *c != 0 && *c != 32767);
        let geographic = key(MODEL_TYPE) == Some(2);
        let epsg = if geographic { code(GEOGRAPHIC_CODE) } else { code(PROJECTED_CODE) };
        // Without a raster type the tie point is the corner of a cell, not its centre.
        let registration = if key(RASTER_TYPE) == Some(2) { Registration::Node } else { Registration::Pixel };
        let to_centre = if registration == Registration::Node { 0.0 } else { 0.5 };
        let [x0, dx, y0, dy] = affine(path, decoder)?;
        let x = FileAxis::new(path, "x", x0 + dx * to_centre, dx, width)?;
        let y = FileAxis::new(path, "y", y0 + dy * to_centre, dy, height)?;
        Ok(Georeference { x, y, registration, epsg, geographic })
    }
}

/// x of column 0 and its step, y of row 0 and its step.
fn affine(path: &Path, decoder: &mut Reader) -> Result<[f64; 4], ReadError> {
    let scale = decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap_or_default();
    let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap_or_default();
    if let ([dx, dy, ..], [column, row, _, x, y, _]) = (scale.as_slice(), tie.as_slice()) {
        return Ok([x - column * dx, *dx, y + row * dy, -dy]);
    }
    let matrix = decoder.get_tag_f64_vec(Tag::ModelTransformationTag).unwrap_or_default();
    match matrix.as_slice() {
        [dx, xy, _, x, yx, dy, _, y, ..] if *xy == 0.0 && *yx == 0.0 => Ok([*x, *dx, *y, *dy]),
        [_, _, _, _, _, _, _, _, ..] => {
            Err(ReadError::data(path, "the grid is rotated").help("warp it to a north-up grid first"))
        }
        _ => Err(ReadError::data(path, "does not say where its cells are (no ModelPixelScale and ModelTiepoint)")),
    }
}

fn text(decoder: &mut Reader, tag: Tag) -> Option<String> {
    decoder.get_tag_ascii_string(tag).ok()
}

/// The height of the map: an item of GDAL's metadata with a height in metres.
fn height_m(metadata: &str, notes: &mut Vec<String>) -> Option<f64> {
    const NAMES: [&str; 5] = ["level_height_m", "height_m", "altitude_m", "alt_m", "alt"];
    let (name, text) = item(metadata, &NAMES)?;
    let alt_m = text.parse::<f64>().ok().filter(|x| x.is_finite())?;
    notes.push(format!("height {alt_m} m of the file's `{name}`, taken as above the ellipsoid"));
    Some(alt_m)
}

/// The first item of GDAL's metadata that has one of the names, with its name.
fn item<'a>(metadata: &str, names: &[&'a str]) -> Option<(&'a str, String)> {
    names.iter().find_map(|name| {
        let item = metadata.split("<Item").find(|i| i.contains(&format!("name=\"{name}\"")))?;
        let text = item.split('>').nth(1)?.split('<').next()?.trim();
        (!text.is_empty()).then(|| (*name, text.to_owned()))
    })
}
