//! Writes GeoTIFF: one band of double precision, rows from the north, deflated strips. [OGC 19-008r4, GeoTIFF 1.1]

use tiff::{
    TiffError,
    encoder::{Compression, DeflateLevel, TiffEncoder, TiffKind, colortype::Gray64Float},
    tags::Tag,
};

use super::{
    geotiff_keys::{GDAL_METADATA, GEOGRAPHIC_CODE, MODEL_TYPE, PROJECTED_CODE, RASTER_TYPE},
    grid_bytes::{level_m, rows},
    guarded,
    output::{MapFileSink, MapOutputFiles},
};
use crate::ReadError;
use grids::{AnomalyGrid, Registration};

/// Maximum size of the values in a TIFF file, whose offsets have 32 bits; a larger file is BigTIFF.
const MOST_BYTES: usize = 4_000_000_000;

/// Values per strip: half a megabyte.
const STRIP_VALUES: usize = 65_536;

/// The level height is an item of GDAL's metadata, as expected by the reader.
///
/// # Errors
/// Fails for heights that vary, more than 2^32 nodes per side, or a path that cannot be written.
pub(super) fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    let level_m = level_m(outputs, map, "geotiff")?;
    let mut sink = outputs.create()?;
    let path = outputs.path().to_path_buf();
    let failed = |e: TiffError| match e {
        TiffError::IoError(e) => ReadError::io(&path, &e),
        e => ReadError::machine(&path, e.to_string()),
    };
    guarded(&path, || {
        let done = if map.nodes() < MOST_BYTES / 8 {
            TiffEncoder::new(&mut sink).and_then(|t| encode(t, map, level_m))
        } else {
            TiffEncoder::new_big(&mut sink).and_then(|t| encode(t, map, level_m))
        };
        done.map_err(failed)
    })?;
    outputs.finish(sink)
}

fn encode<K: TiffKind>(
    tiff: TiffEncoder<&mut MapFileSink, K>,
    map: &AnomalyGrid,
    level_m: f64,
) -> Result<(), TiffError> {
    let mut tiff = tiff.with_compression(Compression::Deflate(DeflateLevel::Balanced));
    let (width, height) = (u32::try_from(map.x.len)?, u32::try_from(map.y.len)?);
    let mut image = tiff.new_image::<Gray64Float>(width, height)?;
    image.rows_per_strip((STRIP_VALUES / map.x.len).clamp(1, map.y.len) as u32)?;
    let (x, y) = (map.x.first, map.y.last());
    let pixel = map.registration == Registration::Pixel;
    let half = if pixel { 0.5 } else { 0.0 };
    let tie = [0.0, 0.0, 0.0, x - half * map.x.step, y + half * map.y.step, 0.0];
    let (model, code_key) = if map.is_geographic() { (2, GEOGRAPHIC_CODE) } else { (1, PROJECTED_CODE) };
    let raster = if pixel { 1 } else { 2 };
    let keys = [[1, 1, 0, 3], [MODEL_TYPE, 0, 1, model], [RASTER_TYPE, 0, 1, raster], [code_key, 0, 1, map.crs.code()]];
    let directory = image.encoder();
    directory.write_tag(Tag::ModelPixelScaleTag, &[map.x.step, map.y.step, 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &tie[..])?;
    directory.write_tag(Tag::GeoKeyDirectoryTag, keys.as_flattened())?;
    directory.write_tag(Tag::GdalNodata, "nan")?;
    directory.write_tag(GDAL_METADATA, metadata(level_m, map.value_unit).as_str())?;
    let north_first: Vec<f64> = rows(map, true).flatten().copied().collect();
    image.write_data(&north_first)
}

fn metadata(level_m: f64, value_unit: &str) -> String {
    let height = match level_m.is_nan() {
        true => String::new(),
        false => format!("  <Item name=\"level_height_m\">{level_m}</Item>\n"),
    };
    let unit = format!("  <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">{value_unit}</Item>\n");
    format!("<GDALMetadata>\n{height}{unit}</GDALMetadata>\n")
}
