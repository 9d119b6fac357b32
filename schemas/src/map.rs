//! The map table: a regular grid, one row per cell, sorted by latitude then longitude.

use crate::{Column, Described, Role, Shape};

/// The version of the map table's contract.
pub const VERSION: u32 = 1;

/// Its columns: name, unit and meaning.
pub const COLUMNS: [(&str, Described); 4] = [
    ("lat", Described { unit: "deg", role: Role::Key, description: "latitude of the cell's centre, WGS-84" }),
    ("lon", Described { unit: "deg", role: Role::Key, description: "longitude of the cell's centre, WGS-84" }),
    ("alt", Described { unit: "m", role: Role::Aux, description: "height above the WGS-84 ellipsoid" }),
    ("anomaly", Described { unit: "nT", role: Role::Aux, description: "magnetic anomaly; NaN where unknown" }),
];

/// The shape of every map.
pub fn shape() -> Shape {
    let columns = COLUMNS.iter().map(|(name, d)| Column::float(*name, d.unit, d.description).role(d.role));
    Shape { columns: columns.collect(), rate_hz: None }
}
