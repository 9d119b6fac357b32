//! The tag and the GeoTIFF keys that reading and writing share. [OGC 19-008r4, GeoTIFF 1.1, 7.4]

use tiff::tags::Tag;

/// The tag of GDAL's own metadata, an XML text.
pub(super) const GDAL_METADATA: Tag = Tag::Unknown(42112);
/// Whether coordinates are geographic (2) or projected (1).
pub(super) const MODEL_TYPE: u16 = 1024;
/// Whether a value is that of its cell (1) or of its node (2).
pub(super) const RASTER_TYPE: u16 = 1025;
/// The EPSG code of a geographic system.
pub(super) const GEOGRAPHIC_CODE: u16 = 2048;
/// The EPSG code of a projected system.
pub(super) const PROJECTED_CODE: u16 = 3072;
