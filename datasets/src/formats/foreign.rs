//! Formats that magline does not read, identified by their first bytes, each with its name and the required conversion.

use super::FileHead;
use crate::ReadError;

/// Position of a signature, its bytes, the name of the format, and the remedy.
type FormatSignature = (usize, &'static [u8], &'static str, &'static str);

const UNPACK: &str = "unpack the archive and use the file inside";
const EXPORT: &str = "export the data as GeoTIFF, NetCDF, GXF, CSV or Parquet";

const SIGNATURES: &[FormatSignature] = &[
    (0, b"%PDF", "a PDF document", EXPORT),
    (0, b"PK\x03\x04", "a zip archive", UNPACK),
    (0, b"\x1f\x8b", "a gzip file", UNPACK),
    (0, b"BZh", "a bzip2 file", UNPACK),
    (0, b"\xfd7zXZ\0", "an xz file", UNPACK),
    (0, b"\x28\xb5\x2f\xfd", "a zstd file", UNPACK),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive", UNPACK),
    (0, b"Rar!\x1a\x07", "a RAR archive", UNPACK),
    (257, b"ustar", "a tar archive", UNPACK),
    (0, b"\x0e\x03\x13\x01", "an HDF4 file", "convert the file to NetCDF-4 or HDF5, for example with `h4toh5`"),
    (0, b"GRIB", "a GRIB file", "convert the file to NetCDF, for example with `gdal_translate -of netCDF`"),
    (0, b"EHFA_HEADER_TAG", "an ERDAS Imagine raster", "convert the file to GeoTIFF with `gdal_translate`"),
    (0, b"GRID1.2\0", "the header of an Esri binary grid", "convert the grid folder to GeoTIFF with `gdal_translate`"),
    (
        0,
        b"\0\0\x27\x0a\xff\xff",
        "a part of an Esri binary grid",
        "convert the grid folder to GeoTIFF with `gdal_translate`",
    ),
    (0, b"\0\0\x27\x0a\0\0", "an Esri shapefile", "export the points as CSV or Parquet"),
    (0, b"SQLite format 3\0", "an SQLite database, such as a GeoPackage", EXPORT),
    (0, b"ARROW1\0\0", "an Arrow IPC or Feather file", "write it as Parquet"),
    (0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a document of a Microsoft Office program", EXPORT),
    (0, b"\x89PNG\r\n\x1a\n", "a PNG picture", "use the grid from which the picture was made"),
    (0, b"\xff\xd8\xff", "a JPEG picture", "use the grid from which the picture was made"),
    (0, b"GIF8", "a GIF picture", "use the grid from which the picture was made"),
    (0, b"version https://git-lfs", "a pointer of Git LFS, not the file itself", "fetch the file with `git lfs pull`"),
    (0, b"\xff\xfe", "text in UTF-16", "save it as UTF-8"),
    (0, b"\xfe\xff", "text in UTF-16", "save it as UTF-8"),
    (0, b"NITF", "an NITF raster", "convert the file to GeoTIFF with `gdal_translate`"),
    (0, b"ENVI\n", "the header of an ENVI raster", "convert the file to GeoTIFF with `gdal_translate`"),
    (0, b"ENVI\r\n", "the header of an ENVI raster", "convert the file to GeoTIFF with `gdal_translate`"),
    (0, b"{\\rtf", "a document in RTF", EXPORT),
];

/// The kind of a file, and the remedy; `None` if its first bytes are unknown.
fn known(head: &FileHead) -> Option<(&'static str, &'static str)> {
    let holds = |name: &str| head.path.is_dir() && head.path.join(name).is_file();
    if holds("hdr.adf") {
        return Some(("an Esri binary grid", "convert the folder to GeoTIFF with `gdal_translate`"));
    }
    if [".zgroup", ".zarray", "zarr.json"].into_iter().any(holds) {
        return Some(("a Zarr store", "write it as NetCDF"));
    }
    if let Some((_, _, what, help)) = SIGNATURES.iter().find(|(at, bytes, ..)| head.has_at(*at, bytes)) {
        return Some((what, help));
    }
    if let Some(line) = head.first_line() {
        let line = line.trim_start().to_ascii_lowercase();
        if line.starts_with("<!doctype html") || line.starts_with("<html") {
            return Some(("an HTML page, perhaps an error message of a server", "download the file itself"));
        }
        if line.starts_with("<?xml") || line.starts_with("<kml") {
            return Some(("an XML document", EXPORT));
        }
        let key = |k: &str| line.strip_prefix(k).is_some_and(|rest| rest.starts_with([' ', '\t', '=']));
        if ["byteorder", "layout", "nbands"].into_iter().any(key) {
            let help = "convert the raster to GeoTIFF with `gdal_translate`";
            return Some(("the header of a raw raster (.flt, .bil)", help));
        }
        return None;
    }
    let raw = ["flt", "bil", "bip", "bsq", "adf"].into_iter();
    let ends = |ending: &str| head.path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    raw.into_iter().any(ends).then_some((
        "a raw raster, whose layout is in a file next to it",
        "convert the file to GeoTIFF with `gdal_translate`",
    ))
}

/// The error of a file in a known format that magline does not read; `None` for an unknown format.
pub(super) fn refused(head: &FileHead) -> Option<ReadError> {
    known(head).map(|(what, help)| ReadError::data(head.path, format!("the file is {what}")).help(help))
}
