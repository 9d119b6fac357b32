//! The simple flights of MagNav.jl (`XYZ0`, `XYZ1`): derivation of columns that a file lacks. The HDF5 and the CSV
//! reader share this module.

use std::path::Path;

use schemas::canonical::identifier;

use super::{FlightOptions, RowFault};
use crate::{
    ReadError,
    motion::GeodeticTrack,
    table::{ColumnTable, ColumnValues, whole},
};

/// The required columns.
pub(super) const NEEDED: [&str; 3] = ["lat", "lon", "alt"];

/// The whole flight with the canonical columns. Missing columns are derived:
///
/// - flight and line are `1`, as in MagNav.jl,
/// - `vn`, `ve`, `vd` and `ins_vn`, `ins_ve`, `ins_vd` are differences of the positions on the ellipsoid,
/// - `ins_fn`, `ins_fe`, `ins_fd` are differences of the INS velocity, with Coriolis and gravity.
///
/// The true specific force (`fn`, `fe`, `fd`) of a file keeps its name.
///
/// Faults of single rows are returned with the table.
pub(super) fn finish(
    path: &Path,
    mut table: ColumnTable,
    options: &FlightOptions,
) -> Result<(ColumnTable, Vec<RowFault>), ReadError> {
    let mut faults = vec![];
    for name in NEEDED {
        if !table.has(name) {
            return Err(ReadError::data(path, "a MagNav.jl flight requires this column").in_column(name));
        }
    }
    push_motion(&mut table, "");
    if table.has("ins_lat") {
        push_motion(&mut table, "ins_");
        push_specific_force(&mut table);
    }
    for name in ["year", "doy"] {
        if let Some(ColumnValues::Number(x)) = table.take(name) {
            let (values, wrong) = whole(path, name, &x);
            faults.extend(wrong);
            table.push(name, "", values);
        }
    }
    let rows = table.rows();
    for (name, given) in [("line", &options.line), ("flight", &options.flight)] {
        let values = match table.take(name) {
            Some(ColumnValues::Number(x)) => {
                x.iter().map(|x| if x.is_finite() { identifier(*x) } else { String::new() }).collect()
            }
            Some(ColumnValues::Text(x)) => x,
            _ => vec![given.clone().unwrap_or_else(|| "1".to_owned()); rows],
        };
        table.push_front(name, ColumnValues::Text(values));
    }
    Ok((table, faults))
}

/// Velocity from position, for the truth or with the prefix `ins_`.
fn push_motion(table: &mut ColumnTable, prefix: &str) {
    let names = ["vn", "ve", "vd"].map(|n| format!("{prefix}{n}"));
    if names.iter().all(|n| table.has(n)) {
        return;
    }
    let places = ["lat", "lon", "alt"].map(|n| format!("{prefix}{n}"));
    let columns =
        [table.numbers("tt"), table.numbers(&places[0]), table.numbers(&places[1]), table.numbers(&places[2])];
    let [Some(tt), Some(lat_deg), Some(lon_deg), Some(alt_m)] = columns else { return };
    let velocity = GeodeticTrack { tt, lat_deg, lon_deg, alt_m }.velocity_mps();
    for (name, values) in names.iter().zip(velocity) {
        table.take(name);
        table.push_described(name, "m/s", "velocity, from differences of the positions", ColumnValues::Number(values));
    }
}

fn push_specific_force(table: &mut ColumnTable) {
    let forces = ["ins_fn", "ins_fe", "ins_fd"];
    if forces.iter().all(|n| table.has(n)) {
        return;
    }
    let columns = ["tt", "ins_lat", "ins_lon", "ins_alt"].map(|n| table.numbers(n));
    let [Some(tt), Some(lat_deg), Some(lon_deg), Some(alt_m)] = columns else { return };
    let velocity = ["ins_vn", "ins_ve", "ins_vd"].map(|n| table.numbers(n).map(<[f64]>::to_vec));
    let [Some(vn), Some(ve), Some(vd)] = velocity else { return };
    let force = GeodeticTrack { tt, lat_deg, lon_deg, alt_m }.specific_force_mps2(&[vn, ve, vd]);
    for (name, values) in forces.into_iter().zip(force) {
        table.take(name);
        table.push_described(
            name,
            "m/s2",
            "specific force, from differences of the velocity",
            ColumnValues::Number(values),
        );
    }
}
