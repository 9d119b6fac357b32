//! Simple flights of MagNav.jl in HDF5: one data set per field, angles in degrees.
//!
//! MagNav.jl 1.3.3 writes simulated flights with angles in radians, which its readers interpret as degrees. Such a file
//! is recognised by its velocities and rejected.

use std::path::Path;

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints,
    adopt::{in_counted_unit, named},
    hdf5::Hdf5Source,
    magnav,
    missing::MissingMarkers,
};
use crate::{
    ReadError,
    motion::GeodeticTrack,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "magnav_hdf5",
    about: "simple flight of MagNav.jl (XYZ0, XYZ1) in HDF5",
    extensions: &["h5", "hdf5"],
    recognise: |head: &FileHead| {
        let names = head.hdf5_names();
        magnav::NEEDED.iter().all(|n| names.iter().any(|m| m == n))
    },
    open,
    topics: None,
    made_from: None,
};

/// The default time step of MagNav.jl.
const DEFAULT_DT_S: f64 = 0.1;

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let file = Hdf5Source::open(path)?;
    let latitude = options.rename.iter().find(|(own, to)| *to == "lat" && file.has(own)).map_or("lat", |(own, _)| own);
    let rows = file.need(latitude)?.shape.first().copied().unwrap_or(0);
    if rows == 0 {
        return Err(ReadError::data(path, "the file holds no samples").in_column("lat"));
    }
    let (mut table, missing) = (ColumnTable::default(), MissingMarkers::from_options(options));
    let mut own = vec![];
    for name in file.names() {
        let set = file.need(name)?;
        if set.shape.len() != 1 || !set.is_numeric() || (set.shape == [1] && rows != 1) {
            continue;
        }
        if set.shape != [rows] {
            return Err(set.damaged(&format!("has {} values, but `lat` has {rows}", set.shape[0])));
        }
        let named = named(path, &[name], None, options)?;
        let counted = if named.name == "ins_tt" { "s" } else { "" };
        let values = set.all()?.into_iter().map(|x| missing.kept(x)).collect();
        let (unit, values) = in_counted_unit(path, name, &named, counted, values)?;
        if table.has(&named.name) {
            return Err(ReadError::options(path, "two columns would have this name").in_column(&named.name));
        }
        table.push(&named.name, &unit, ColumnValues::Number(values));
        own.push(name.clone());
    }
    if !table.has("tt") {
        let dt = if file.has("dt") { file.need("dt")?.scalar()? } else { DEFAULT_DT_S };
        table.push("tt", "", ColumnValues::Number((0..rows).map(|i| dt * i as f64).collect()));
    }
    for (prefix, set) in [("", "Cnb"), ("ins_", "ins_Cnb")] {
        if file.has(set) && !table.has(&format!("{prefix}roll")) {
            push_attitude(&mut table, prefix, &file, set, rows)?;
        }
    }
    refuse_radians(path, &table)?;
    let (table, faults) = magnav::finish(path, table, options)?;
    let (schema, batch) = (table.schema(), table.into_batch(path)?);
    let notes = file.notes().into_iter().map(|note| format!("{}: {note}", path.display())).collect();
    Ok(RawFlight {
        own: Some(own),
        notes,
        ..RawFlight::new(schema, Box::new(std::iter::once(Ok(FlightBatch { batch, faults }))))
    })
}

/// Roll, pitch and yaw from the direction cosines. Julia stores columns first, so the 3 x 3 x N array appears here as
/// N x 3 x 3, each matrix transposed.
fn push_attitude(
    table: &mut ColumnTable,
    prefix: &str,
    file: &Hdf5Source,
    name: &str,
    rows: u64,
) -> Result<(), ReadError> {
    let set = file.need(name)?;
    if set.shape != [rows, 3, 3] {
        return Err(set.damaged(&format!("must have the shape [{rows}, 3, 3], not {:?}", set.shape)));
    }
    let all = set.all()?;
    let mut angles = [vec![], vec![], vec![]];
    for c in all.chunks_exact(9) {
        // Row i, column j of the matrix from body to navigation frame is c[3 j + i].
        let (c11, c21, c31, c32, c33) = (c[0], c[1], c[2], c[5], c[8]);
        angles[0].push(c32.atan2(c33).to_degrees());
        angles[1].push(-c31.clamp(-1.0, 1.0).asin().to_degrees());
        angles[2].push(c21.atan2(c11).to_degrees());
    }
    for (name, values) in ["roll", "pitch", "yaw"].into_iter().zip(angles) {
        table.push(&format!("{prefix}{name}"), "", ColumnValues::Number(values));
    }
    Ok(())
}

/// Rejects positions in radians, which change 57 times too slowly for the velocities in the file.
pub(super) fn refuse_radians(path: &Path, table: &ColumnTable) -> Result<(), ReadError> {
    let columns = ["tt", "lat", "lon", "alt", "vn", "ve"].map(|n| table.numbers(n));
    let [Some(tt), Some(lat_deg), Some(lon_deg), Some(alt_m), Some(vn), Some(ve)] = columns else { return Ok(()) };
    let [north, east, _] = GeodeticTrack { tt, lat_deg, lon_deg, alt_m }.velocity_mps();
    let speed = |n: &[f64], e: &[f64]| n.iter().zip(e).map(|(n, e)| n.hypot(*e)).filter(|s| s.is_finite()).sum::<f64>();
    let (moved, reported_mps) = (speed(&north, &east), speed(vn, ve));
    if reported_mps > 20.0 * moved && lat_deg.iter().all(|x| x.abs() < 1.6) && lon_deg.iter().all(|x| x.abs() < 3.2) {
        let what =
            "latitudes and longitudes must be in degrees, but are in radians, as in simulated flights of MagNav.jl";
        return Err(ReadError::data(path, what).in_column("lat").help("convert the angles to degrees"));
    }
    Ok(())
}
