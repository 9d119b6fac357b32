//! The HDF5 files of MagNav.jl for the SGL surveys of 2020 and 2021: one data set per field. One line of the survey at
//! a time is in memory.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints,
    adopt::{FlightColumnTarget, in_counted_unit, named},
    hdf5::{Hdf5Dataset as DataSet, Hdf5Source},
    missing::MissingMarkers,
    sgl,
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "sgl_hdf5",
    about: "SGL survey 2020 or 2021 in HDF5, one data set per field",
    extensions: &["h5", "hdf5"],
    recognise: |head: &FileHead| {
        let names = head.hdf5_names();
        ["tt", "lat", "utm_z"].iter().all(|n| names.iter().any(|m| m == n))
    },
    open,
    topics: None,
    made_from: None,
};

/// A data set, and its column of the flight table.
struct SglHdf5Column {
    own: String,
    named: FlightColumnTarget,
    set: DataSet,
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let file = Hdf5Source::open(path)?;
    let time = options.rename.iter().find(|(own, to)| *to == "tt" && file.has(own)).map_or("tt", |(own, _)| own);
    let rows = file.need(time)?.shape.first().copied().unwrap_or(0);
    if rows == 0 {
        return Err(ReadError::data(path, "the file holds no samples").in_column("tt"));
    }
    let mut sets = vec![];
    for name in file.names() {
        let set = file.need(name)?;
        // `N`, `dt` and other single values describe the file; 2-D data sets do not belong in a table of samples.
        if set.shape.len() != 1 || !set.is_numeric() || (set.shape == [1] && rows != 1) {
            continue;
        }
        if set.shape != [rows] {
            return Err(set.damaged(&format!("has {} values, but `tt` has {rows}", set.shape[0])));
        }
        sets.push((name.clone(), set));
    }
    let own = sets.iter().map(|(own, _)| own.clone()).collect();
    let first = |name: &str| -> Option<f64> {
        let (_, set) = sets.iter().find(|(own, _)| own == name)?;
        set.rows(0..1).ok()?.first().copied()
    };
    let ins_angle = sgl::ins_angle(first("lat"), first("ins_lat"));
    let column = |(own, set): (String, DataSet)| {
        let named = named(path, &[&own], Some(sgl::unit_of(&own, ins_angle)), options)?;
        Ok(SglHdf5Column { own, named, set })
    };
    let sets = sets.into_iter().map(column).collect::<Result<Vec<_>, ReadError>>()?;
    let mut lines = lines(&sets, rows)?.into_iter();
    let file =
        SglHdf5Datasets { path: path.to_path_buf(), sets, ins_angle, missing: MissingMarkers::from_options(options) };
    let schema = sgl::finish(path, file.table(0..0)?)?.0.schema();
    let next = move || {
        let part = file.table(lines.next()?).and_then(|t| {
            let (table, faults) = sgl::finish(&file.path, t)?;
            Ok(FlightBatch { batch: table.into_batch(&file.path)?, faults })
        });
        Some(part)
    };
    Ok(RawFlight { own: Some(own), ..RawFlight::new(schema, Box::new(std::iter::from_fn(next))) })
}

/// The rows of each line of the survey, in the file's order.
fn lines(sets: &[SglHdf5Column], rows: u64) -> Result<Vec<Range<u64>>, ReadError> {
    let mut keys = vec![];
    for name in ["flight", "line"] {
        if let Some(column) = sets.iter().find(|c| c.named.name == name) {
            keys.push(column.set.all()?);
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

/// The data sets of a file.
struct SglHdf5Datasets {
    path: PathBuf,
    sets: Vec<SglHdf5Column>,
    ins_angle: &'static str,
    missing: MissingMarkers,
}

impl SglHdf5Datasets {
    fn table(&self, rows: Range<u64>) -> Result<ColumnTable, ReadError> {
        let mut table = ColumnTable::default();
        for SglHdf5Column { own, named, set } in &self.sets {
            let values = if rows.is_empty() { vec![] } else { set.rows(rows.clone())? };
            let values = values.into_iter().map(|x| self.missing.kept(x)).collect();
            let counted = sgl::unit_of(&named.name, self.ins_angle);
            let (unit, values) = in_counted_unit(&self.path, own, named, counted, values)?;
            if table.has(&named.name) {
                return Err(ReadError::options(&self.path, "two columns would have this name").in_column(&named.name));
            }
            table.push(&named.name, &unit, ColumnValues::Number(values));
        }
        Ok(table)
    }
}
