//! Access to HDF5 files, with every damage as an error; shared by the flight and map readers.

use std::{
    fs::File,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use hdf5_reader::{
    ByteOrder, Dataset, Datatype, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem,
    group::Group,
    storage::{DynStorage, FileStorage},
};

use super::{
    guarded,
    hdf5_early::{Early, bytes, early},
};
use crate::ReadError;

/// What every HDF5 file starts with.
pub(super) const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// The largest number of values per deflated byte: a larger data set indicates a damaged header.
const MOST_INFLATION: u64 = 1032;

/// An HDF5 file with data sets at its root.
pub(super) struct Hdf5 {
    path: PathBuf,
    root: Group,
    names: Vec<String>,
    groups: Vec<String>,
    bytes: u64,
    /// Where the HDF5 data begin in the file.
    base: u64,
}

/// What the macro `$numbers` makes of the Rust type of a data type's numbers; an error of `$of` for what is no number.
macro_rules! of_type {
    ($of:expr, $kind:expr, $numbers:ident) => {
        match $kind {
            Datatype::FloatingPoint { size: 8, .. } => $numbers!(f64),
            Datatype::FloatingPoint { size: 4, .. } => $numbers!(f32),
            Datatype::FixedPoint { size: 1, signed: true, .. } => $numbers!(i8),
            Datatype::FixedPoint { size: 2, signed: true, .. } => $numbers!(i16),
            Datatype::FixedPoint { size: 4, signed: true, .. } => $numbers!(i32),
            Datatype::FixedPoint { size: 8, signed: true, .. } => $numbers!(i64),
            Datatype::FixedPoint { size: 1, signed: false, .. } => $numbers!(u8),
            Datatype::FixedPoint { size: 2, signed: false, .. } => $numbers!(u16),
            Datatype::FixedPoint { size: 4, signed: false, .. } => $numbers!(u32),
            Datatype::FixedPoint { size: 8, signed: false, .. } => $numbers!(u64),
            other => return Err($of.damaged(&format!("holds {other:?}, not numbers"))),
        }
    };
}

impl Hdf5 {
    /// Opens a file and lists its data sets.
    pub(super) fn open(path: &Path) -> Result<Hdf5, ReadError> {
        let bytes = std::fs::metadata(path).map_err(|e| ReadError::io(path, &e))?.len();
        let (root, groups, names, base) = guarded(path, || {
            // Plain reads, not a memory map: a file cut short while it is read is then an error.
            let storage: DynStorage = Arc::new(FileStorage::open(path).map_err(|e| damaged(path, &e))?);
            let options = OpenOptions::default().with_max_object_header_bytes(1 << 24);
            let file = Hdf5File::from_storage_with_options(storage, options).map_err(|e| damaged(path, &e))?;
            // Counted from the start of the file, a block of the user's before the data included.
            let declared = file.superblock().eof_address;
            if declared > bytes {
                return Err(ReadError::data(
                    path,
                    format!("the file is cut short: it has {bytes} of {declared} bytes"),
                ));
            }
            let root = file.root_group().map_err(|e| damaged(path, &e))?;
            let (groups, names) = members(path, &root)?;
            Ok((root, groups, names, file.superblock().base_address))
        })?;
        Ok(Hdf5 { path: path.to_path_buf(), root, names, groups, bytes, base })
    }

    /// Whether the root has an attribute.
    pub(super) fn has_attribute(&self, name: &str) -> bool {
        let read = || self.root.attributes().map_err(|e| damaged(&self.path, &e));
        guarded(&self.path, read).is_ok_and(|all| all.iter().any(|a| a.name == name))
    }

    /// The groups at the root, sorted.
    pub(super) fn groups(&self) -> &[String] {
        &self.groups
    }

    /// The group `name`, as the root of its members.
    pub(super) fn group(&self, name: &str) -> Result<Hdf5, ReadError> {
        let (path, bytes) = (&self.path, self.bytes);
        let (root, groups, names) = guarded(path, || {
            let root = self.root.group(name).map_err(|e| damaged(path, &e).in_column(name))?;
            let (groups, names) = members(path, &root)?;
            Ok((root, groups, names))
        })?;
        Ok(Hdf5 { path: path.clone(), root, names, groups, bytes, base: self.base })
    }

    /// The data sets at the root, sorted.
    pub(super) fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether there is a data set `name`.
    pub(super) fn has(&self, name: &str) -> bool {
        self.names.iter().any(|n| n == name)
    }

    /// The data set `name`, or an error that names it.
    pub(super) fn need(&self, name: &str) -> Result<Values, ReadError> {
        if !self.has(name) {
            let what = format!("holds no data set `{name}`");
            return Err(ReadError::data(&self.path, what).nearest(name, &self.names));
        }
        guarded(&self.path, || {
            let set = self.root.dataset(name).map_err(|e| damaged(&self.path, &e).in_column(name))?;
            let early = early(&self.path, self.base, set.address());
            let (path, shape) = (self.path.clone(), set.shape().to_vec());
            let values = Values { path, name: name.to_owned(), shape, set, early };
            // A shape that multiplies past 64 bits is as invalid as one that is too large for the file.
            let count = values.shape.iter().try_fold(1u64, |n, d| n.checked_mul(*d));
            let most = self.bytes.saturating_mul(MOST_INFLATION);
            match count.filter(|n| *n <= most) {
                Some(_) => Ok(values),
                None => Err(values.damaged("its shape does not fit the size of the file")),
            }
        })
    }
}

/// The groups and the data sets in a group, sorted.
fn members(path: &Path, of: &Group) -> Result<(Vec<String>, Vec<String>), ReadError> {
    let (mut groups, mut sets) = of.member_names().map_err(|e| damaged(path, &e))?;
    groups.sort();
    sets.sort();
    Ok((groups, sets))
}

/// One data set of numbers.
pub(super) struct Values {
    path: PathBuf,
    name: String,
    /// Rows first.
    pub(super) shape: Vec<u64>,
    set: Dataset,
    /// Where the values are in a layout that the reader does not know.
    early: Option<Early>,
}

impl Values {
    /// Whether its values are numbers.
    pub(super) fn is_numeric(&self) -> bool {
        matches!(self.set.dtype(), Datatype::FixedPoint { .. } | Datatype::FloatingPoint { .. })
    }

    /// Whether its values are whole numbers of 64 bits.
    pub(super) fn is_wide(&self) -> bool {
        matches!(self.set.dtype(), Datatype::FixedPoint { size: 8, .. })
    }

    /// The text of an attribute.
    pub(super) fn text_attribute(&self, name: &str) -> Option<String> {
        let read = || self.set.attribute(name).and_then(|a| a.read_string()).map_err(|e| damaged(&self.path, &e));
        guarded(&self.path, read).ok().map(|text| text.trim_end_matches('\0').to_owned())
    }

    /// Whether there is an attribute.
    pub(super) fn has_attribute(&self, name: &str) -> bool {
        guarded(&self.path, || Ok(self.set.attributes().iter().any(|a| a.name == name))).unwrap_or(false)
    }

    /// All values in the order they are stored in.
    pub(super) fn all(&self) -> Result<Vec<f64>, ReadError> {
        self.read(None)
    }

    /// The values of some rows.
    pub(super) fn rows(&self, rows: Range<u64>) -> Result<Vec<f64>, ReadError> {
        self.read(Some(rows))
    }

    /// The first value.
    pub(super) fn scalar(&self) -> Result<f64, ReadError> {
        self.all()?.first().copied().ok_or_else(|| self.damaged("holds no value"))
    }

    fn read(&self, rows: Option<Range<u64>>) -> Result<Vec<f64>, ReadError> {
        if self.shape.contains(&0) {
            return Ok(vec![]);
        }
        match self.early {
            None => {
                let mut slice = SliceInfo::all(self.shape.len());
                if let Some((first, rows)) = slice.selections.first_mut().zip(rows) {
                    *first = SliceInfoElem::Slice { start: rows.start, end: rows.end, step: 1 };
                }
                guarded(&self.path, || self.read_numbers(&slice))
            }
            Some(Early::Contiguous(at)) => self.read_early(at, rows),
            Some(Early::Other) => {
                let error =
                    self.damaged("is in a layout of before HDF5 1.6.3 that is not contiguous, which is not read");
                Err(error.help("write the file anew with a later version of MATLAB or of the HDF5 library"))
            }
        }
    }

    /// Numbers that stand `at` bytes into the file, one after another.
    fn read_early(&self, at: u64, rows: Option<Range<u64>>) -> Result<Vec<f64>, ReadError> {
        let kind = self.set.dtype();
        let (Datatype::FloatingPoint { size, byte_order } | Datatype::FixedPoint { size, byte_order, .. }) = kind
        else {
            return Err(self.damaged(&format!("holds {kind:?}, not numbers")));
        };
        let a_row = self.shape.iter().skip(1).product::<u64>();
        let all = self.shape.first().copied().unwrap_or(1);
        let rows = rows.unwrap_or(0..all);
        let (from, to) = (rows.start.min(all) * a_row * u64::from(*size), rows.end.min(all) * a_row * u64::from(*size));
        let read = || {
            let mut file = File::open(&self.path).ok()?;
            bytes(&mut file, at.checked_add(from)?, usize::try_from(to.checked_sub(from)?).ok()?)
        };
        let raw = read().ok_or_else(|| self.damaged("its values are beyond the end of the file"))?;
        macro_rules! numbers {
            ($t:ty) => {
                raw.chunks_exact(size_of::<$t>())
                    .filter_map(|b| {
                        let b = b.try_into().ok()?;
                        Some(match byte_order {
                            ByteOrder::LittleEndian => <$t>::from_le_bytes(b),
                            ByteOrder::BigEndian => <$t>::from_be_bytes(b),
                        } as f64)
                    })
                    .collect()
            };
        }
        Ok(of_type!(self, kind, numbers))
    }

    fn read_numbers(&self, slice: &SliceInfo) -> Result<Vec<f64>, ReadError> {
        macro_rules! numbers {
            ($t:ty) => {{
                let array =
                    if self.shape.is_empty() { self.set.read_array::<$t>() } else { self.set.read_slice::<$t>(slice) };
                array.map_err(|e| self.damaged(&e.to_string()))?.iter().map(|x| *x as f64).collect()
            }};
        }
        Ok(of_type!(self, self.set.dtype(), numbers))
    }

    /// An error about this data set.
    pub(super) fn damaged(&self, what: &str) -> ReadError {
        ReadError::data(&self.path, what).in_column(&self.name)
    }
}

fn damaged(path: &Path, error: &hdf5_reader::error::Error) -> ReadError {
    match error {
        hdf5_reader::error::Error::Io(e) => ReadError::io(path, e),
        e => ReadError::data(path, format!("not a whole HDF5 file: {e}")),
    }
}
