//! The tag and the GeoTIFF keys of both the reader and the writer. [OGC 19-008r4, GeoTIFF 1.1, 7.4]

use tiff::tags::Tag;

use crate::grid::AxisUnit;

/// The tag of GDAL's own metadata, an XML text.
pub(super) const GDAL_METADATA: Tag = Tag::Unknown(42112);
/// Whether coordinates are geographic (2) or projected (1).
pub(super) const MODEL_TYPE: u16 = 1024;
/// Whether the map is pixel-registered (1) or grid-registered (2).
pub(super) const RASTER_TYPE: u16 = 1025;
/// The EPSG code of a geographic system.
pub(super) const GEOGRAPHIC_CODE: u16 = 2048;
/// The EPSG code of a projected system.
pub(super) const PROJECTED_CODE: u16 = 3072;
/// The unit of angles and of lengths, and the size of a user-defined length in metres.
pub(super) const ANGULAR_UNIT: u16 = 2054;
pub(super) const LINEAR_UNIT: u16 = 3076;
pub(super) const LINEAR_UNIT_SIZE: u16 = 3077;

/// Units of length by their EPSG code: a name, and metres per unit.
const LENGTHS: [(u16, &str, f64); 11] = [
    (9001, "m", 1.0),
    (9002, "ft", 0.3048),
    (9003, "US survey feet", 1200.0 / 3937.0),
    (9005, "Clarke's feet", 0.304_797_265_4),
    (9014, "fathoms", 1.8288),
    (9030, "nautical miles", 1852.0),
    (9033, "US survey chains", 66.0 * 1200.0 / 3937.0),
    (9036, "km", 1000.0),
    (9093, "miles", 1609.344),
    (9096, "yards", 0.9144),
    (1033, "cm", 0.01),
];

/// Units of angles by their EPSG code, and degrees per unit.
const ANGLES: [(u16, f64); 6] = [
    (9101, 180.0 / std::f64::consts::PI),
    (9102, 1.0),
    (9103, 1.0 / 60.0),
    (9104, 1.0 / 3600.0),
    (9105, 0.9),
    (9122, 1.0),
];

/// The unit of an EPSG code; `None` for an unknown code.
pub(super) fn unit_of_code(code: u16) -> Option<AxisUnit> {
    let length = LENGTHS.iter().find(|(known, ..)| *known == code);
    let length = length.map(|(_, name, m)| AxisUnit::Length((*name).to_owned(), *m));
    length.or_else(|| ANGLES.iter().find(|(known, _)| *known == code).map(|(_, deg)| AxisUnit::Angle(*deg)))
}
