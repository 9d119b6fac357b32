//! Writes maps in the layout of MagNav.jl's `save_map`: data sets `info`, `map`, `xx`, `yy`, `alt` and `mask` at the
//! root of an HDF5 file, in degrees, with the longitudes first, as in Julia.

use hdf5_pure::FileBuilder;

use super::{guarded, output::MapOutputFiles};
use crate::ReadError;
use grids::{AnomalyGrid, GridHeight, WGS84};

/// Unknown nodes are 0 with a mask of 0. MagNav.jl would treat a known value of exactly 0 as unknown, so the smallest
/// nonzero number replaces it.
///
/// # Errors
/// Fails for a map that is not in WGS-84 degrees, or a path that cannot be written.
pub(super) fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    if map.crs.code() != WGS84 {
        let what = format!("a MagNav.jl map must be in WGS-84 latitude and longitude, not {}", map.crs);
        return Err(ReadError::options(outputs.path(), what).help("convert the map to EPSG:4326 first"));
    }
    let path = outputs.path().to_path_buf();
    let bytes = guarded(&path, || encoded(map).map_err(|e| ReadError::machine(&path, e)))?;
    outputs.whole(&bytes)
}

fn encoded(map: &AnomalyGrid) -> Result<Vec<u8>, String> {
    let (width, height) = (map.x.len as u64, map.y.len as u64);
    let known = |v: f64| match v {
        v if v.is_nan() => 0.0,
        0.0 => f64::MIN_POSITIVE,
        v => v,
    };
    let values = by_columns(map, |node| known(map.anomaly_nt.get(node).copied().unwrap_or(f64::NAN)));
    let mask = by_columns(map, |node| i8::from(map.anomaly_nt.get(node).is_some_and(|v| !v.is_nan())));
    let mut file = FileBuilder::new();
    file.create_dataset("info").with_strings(&[INFO]).map_err(|e| e.to_string())?.with_shape(&[]);
    file.create_dataset("map").with_f64_data(&values).with_shape(&[width, height]);
    file.create_dataset("xx").with_f64_data(&map.x.coordinates()).with_shape(&[width]);
    file.create_dataset("yy").with_f64_data(&map.y.coordinates()).with_shape(&[height]);
    match &map.height {
        GridHeight::Level(alt_m) => file.create_dataset("alt").with_f64_data(&[*alt_m]).with_shape(&[]),
        GridHeight::Cells(_) => {
            let heights = by_columns(map, |node| map.height_at(node));
            file.create_dataset("alt").with_f64_data(&heights).with_shape(&[width, height])
        }
    };
    file.create_dataset("mask").with_i8_data(&mask).with_shape(&[width, height]);
    file.finish().map_err(|e| e.to_string())
}

const INFO: &str = "magline";

/// One value per node, longitude by longitude: first all latitudes of the first longitude.
fn by_columns<T>(map: &AnomalyGrid, value: impl Fn(usize) -> T) -> Vec<T> {
    let (width, height) = (map.x.len, map.y.len);
    (0..width).flat_map(|i| (0..height).map(move |j| j * width + i)).map(value).collect()
}
