//! The HDF5 files of the SGL surveys of 2020 and 2021, as MagNav.jl writes them: one data set a field.
//! One line of the survey at a time is in memory.

use std::{ops::Range, path::Path};

use super::{
    FlightFormat, FlightOptions, Head, Raw,
    hdf5::{Hdf5, Values as DataSet},
    sgl,
};
use crate::{
    ReadError,
    table::{Table, Values},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "sgl_hdf5",
    about: "SGL survey 2020 or 2021 in HDF5, one data set a field",
    extensions: &["h5", "hdf5"],
    recognise: |head: &Head| {
        let names = head.hdf5_names();
        ["tt", "lat", "utm_z"].iter().all(|n| names.iter().any(|m| m == n))
    },
    open,
};

fn open(path: &Path, _: &FlightOptions) -> Result<Raw, ReadError> {
    let file = Hdf5::open(path)?;
    let rows = file.need("tt")?.shape.first().copied().unwrap_or(0);
    if rows == 0 {
        return Err(ReadError::data(path, "holds no samples").in_column("tt"));
    }
    let mut sets = vec![];
    for name in file.names() {
        let set = file.need(name)?;
        // `N`, `dt` and the like describe the file; 2-D sets have no place in a table of samples.
        if set.shape.len() != 1 || !set.is_numeric() || (set.shape == [1] && rows != 1) {
            continue;
        }
        if set.shape != [rows] {
            return Err(set.damaged(&format!("holds {} values where `tt` has {rows}", set.shape[0])));
        }
        sets.push((name.clone(), set));
    }
    let first = |name: &str| -> Option<f64> {
        let (_, set) = sets.iter().find(|(n, _)| n == name)?;
        set.rows(0..1).ok()?.first().copied()
    };
    let ins_angle = sgl::ins_angle(first("lat"), first("ins_lat"));
    let mut lines = lines(&sets, rows)?.into_iter();
    let schema = sgl::finish(path, table(&sets, 0..0, ins_angle)?)?.schema();
    let path = path.to_path_buf();
    let next =
        move || table(&sets, lines.next()?, ins_angle).and_then(|t| sgl::finish(&path, t)?.into_batch(&path)).into();
    let batches = std::iter::from_fn(next);
    Ok(Raw { schema, batches: Box::new(batches) })
}

/// The rows of each line of the survey, in the file's order.
fn lines(sets: &[(String, DataSet)], rows: u64) -> Result<Vec<Range<u64>>, ReadError> {
    let mut keys = vec![];
    for name in ["flight", "line"] {
        if let Some((_, set)) = sets.iter().find(|(n, _)| n == name) {
            keys.push(set.all()?);
        }
    }
    let changes = (1..rows).filter(|r| {
        let at = *r as usize;
        keys.iter().any(|k| k.get(at - 1).map(|x| x.to_bits()) != k.get(at).map(|x| x.to_bits()))
    });
    let mut starts: Vec<u64> = std::iter::once(0).chain(changes).collect();
    starts.push(rows);
    Ok(starts.windows(2).map(|w| w[0]..w[1]).collect())
}

fn table(sets: &[(String, DataSet)], rows: Range<u64>, ins_angle: &'static str) -> Result<Table, ReadError> {
    let mut table = Table::default();
    for (name, set) in sets {
        let values = if rows.is_empty() { vec![] } else { set.rows(rows.clone())? };
        table.push(name, sgl::unit_of(name, ins_angle), Values::Number(values));
    }
    Ok(table)
}
