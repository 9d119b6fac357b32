//! Maps of MagNav.jl in HDF5, scalar or of three components; the module `map_magnav` describes the arrays.
//!
//! Julia stores matrices column by column, so in the file the first dimension of its `map[yy, xx]` is longitude.

use std::path::Path;

use super::{
    FileHead, MapFormat, MapOptions,
    hdf5::Hdf5Source,
    map_magnav::{self, MagnavArray, MagnavSource},
    map_magnav_write,
};
use crate::ReadError;
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "magnav_hdf5",
    about: "map of MagNav.jl in HDF5: `map`, or `mapX`, `mapY`, `mapZ` with `field_component`",
    extensions: &["h5", "hdf5"],
    recognise: |head: &FileHead| {
        let names = head.hdf5_names();
        map_magnav::is_map(|name| names.iter().any(|n| n == name))
    },
    companions: None,
    read,
    write: Some(map_magnav_write::write),
};

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let file = Hdf5Source::open(path)?;
    map_magnav::read(path, options, &file, || file.notes())
}

impl MagnavSource for Hdf5Source {
    fn has(&self, name: &str) -> bool {
        Hdf5Source::has(self, name)
    }

    fn array(&self, name: &str) -> Result<MagnavArray, ReadError> {
        let set = self.need(name)?;
        let size = |n: u64| usize::try_from(n).ok();
        let shape = match set.shape.as_slice() {
            [] => Some([1, 1]),
            [n] => size(*n).map(|n| [n, 1]),
            [n_lon, n_lat] => size(*n_lon).zip(size(*n_lat)).map(Into::into),
            _ => None,
        };
        Ok(MagnavArray::by_longitude(shape, set.all()?))
    }
}
