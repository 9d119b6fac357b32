//! Access to HDF5 files, which reports all damage as errors; shared by the flight and map readers.

use std::{
    collections::BTreeMap,
    fs::File,
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use hdf5_reader::{
    ByteOrder, Dataset, Datatype, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem,
    group::Group,
    storage::{DynStorage, FileStorage},
};
use netcdf_reader::NcType;

use super::{
    guarded,
    hdf5_early::{Hdf5LegacyLayout, bytes, early},
    limits::DecodeLimit,
    netcdf_values::{ATTRIBUTES, NetcdfAttribute, NetcdfEncoding},
};
use crate::ReadError;

/// The first bytes of every HDF5 file.
pub(super) const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// An HDF5 file with data sets at its root.
pub(super) struct Hdf5Source {
    path: PathBuf,
    root: Group,
    names: Vec<String>,
    groups: Vec<String>,
    limit: Arc<DecodeLimit>,
    /// Whether NetCDF wrote the file; its default fill values then mark missing values.
    netcdf: bool,
    notes: Arc<Mutex<Vec<String>>>,
    /// Start of the HDF5 data in the file.
    base: u64,
}

/// Calls the macro `$numbers` with the Rust type of a numeric data type; `$otherwise` for any other data type.
macro_rules! of_kind {
    ($kind:expr, $numbers:ident, $otherwise:expr) => {
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
            _ => $otherwise,
        }
    };
}

impl Hdf5Source {
    /// Opens a file and lists its data sets.
    pub(super) fn open(path: &Path) -> Result<Hdf5Source, ReadError> {
        let bytes = std::fs::metadata(path).map_err(|e| ReadError::io(path, &e))?.len();
        let (root, groups, names, base) = guarded(path, || {
            // With plain reads instead of a memory map, truncation of the file during reading is reported as an error.
            let storage: DynStorage = Arc::new(FileStorage::open(path).map_err(|e| damaged(path, &e))?);
            let most = DecodeLimit::new(bytes).most_here();
            let options = OpenOptions::default()
                .with_max_object_header_bytes(1 << 24)
                .with_max_chunk_bytes(most)
                .with_max_read_bytes(most);
            let file = Hdf5File::from_storage_with_options(storage, options).map_err(|e| damaged(path, &e))?;
            // The declared end is counted from the start of the file, and includes a user block before the data.
            let declared = file.superblock().eof_address;
            if declared > bytes {
                return Err(ReadError::data(
                    path,
                    format!("the file is truncated: it has {bytes} of {declared} bytes"),
                ));
            }
            let root = file.root_group().map_err(|e| damaged(path, &e))?;
            let (groups, names) = members(path, &root)?;
            Ok((root, groups, names, file.superblock().base_address))
        })?;
        let (limit, notes) = (Arc::new(DecodeLimit::new(bytes)), Arc::default());
        let mut file = Hdf5Source { path: path.to_path_buf(), root, names, groups, limit, netcdf: false, notes, base };
        file.netcdf = file.has_attribute("_NCProperties");
        Ok(file)
    }

    /// Notes for the user on the values that were read.
    pub(super) fn notes(&self) -> Vec<String> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).clone()
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
    pub(super) fn group(&self, name: &str) -> Result<Hdf5Source, ReadError> {
        let path = &self.path;
        let (root, groups, names) = guarded(path, || {
            let root = self.root.group(name).map_err(|e| damaged(path, &e).in_column(name))?;
            let (groups, names) = members(path, &root)?;
            Ok((root, groups, names))
        })?;
        let (limit, notes) = (self.limit.clone(), self.notes.clone());
        Ok(Hdf5Source { path: path.clone(), root, names, groups, limit, netcdf: self.netcdf, notes, base: self.base })
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
    pub(super) fn need(&self, name: &str) -> Result<Hdf5Dataset, ReadError> {
        if !self.has(name) {
            let what = format!("the file holds no data set `{name}`");
            return Err(ReadError::data(&self.path, what).nearest(name, &self.names));
        }
        guarded(&self.path, || {
            let set = self.root.dataset(name).map_err(|e| damaged(&self.path, &e).in_column(name))?;
            let early = early(&self.path, self.base, set.address());
            let (path, shape) = (self.path.clone(), set.shape().to_vec());
            let count = shape.iter().try_fold(1u64, |n, d| n.checked_mul(*d));
            // Numbers become Float64.
            let bytes = count.and_then(|n| n.checked_mul(8));
            let part = format!("{name} {}", set.address());
            self.limit.check_part(&path, &part, bytes).map_err(|e| e.in_column(name))?;
            let storage = storage(&path, name, &set, self.netcdf)?;
            Ok(Hdf5Dataset { path, name: name.to_owned(), shape, set, early, storage, notes: self.notes.clone() })
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
pub(super) struct Hdf5Dataset {
    path: PathBuf,
    name: String,
    /// Lengths of the dimensions, the number of rows first.
    pub(super) shape: Vec<u64>,
    set: Dataset,
    /// Position of the values in a layout that `hdf5-reader` does not support.
    early: Option<Hdf5LegacyLayout>,
    /// The conversion of the stored numbers, if attributes describe a conversion.
    storage: Option<NetcdfEncoding>,
    notes: Arc<Mutex<Vec<String>>>,
}

/// The storage of a data set of numbers; `None` if no conversion is needed.
fn storage(path: &Path, name: &str, set: &Dataset, netcdf: bool) -> Result<Option<NetcdfEncoding>, ReadError> {
    let Some(kind) = kind_of(set.dtype()) else { return Ok(None) };
    let (all, mut found) = (set.attributes(), BTreeMap::new());
    for known in ATTRIBUTES {
        let Some(attribute) = all.iter().find(|a| a.name == known) else { continue };
        let real = matches!(attribute.datatype, Datatype::FloatingPoint { .. });
        let read = if kind_of(&attribute.datatype).is_some() {
            numbers_of(attribute).map(|numbers| NetcdfAttribute::Numbers(numbers, real))
        } else {
            attribute.read_string().ok().map(|text| NetcdfAttribute::Text(text.trim_end_matches('\0').to_owned()))
        };
        let read = read
            .ok_or_else(|| ReadError::data(path, format!("the attribute `{known}` cannot be read")).in_column(name))?;
        found.insert(known.to_owned(), read);
    }
    if found.is_empty() && !netcdf {
        return Ok(None);
    }
    NetcdfEncoding::from_attributes(path, name, kind, &found, netcdf).map(Some)
}

/// The numbers of an attribute.
fn numbers_of(attribute: &hdf5_reader::Attribute) -> Option<Vec<f64>> {
    macro_rules! numbers {
        ($t:ty) => {
            attribute.read_1d::<$t>().ok()?.into_iter().map(|x| x as f64).collect()
        };
    }
    Some(of_kind!(&attribute.datatype, numbers, return None))
}

/// NetCDF's name of a numeric type; `None` for other types.
fn kind_of(of: &Datatype) -> Option<NcType> {
    Some(match of {
        Datatype::FloatingPoint { size: 8, .. } => NcType::Double,
        Datatype::FloatingPoint { size: 4, .. } => NcType::Float,
        Datatype::FixedPoint { size: 1, signed: true, .. } => NcType::Byte,
        Datatype::FixedPoint { size: 2, signed: true, .. } => NcType::Short,
        Datatype::FixedPoint { size: 4, signed: true, .. } => NcType::Int,
        Datatype::FixedPoint { size: 8, signed: true, .. } => NcType::Int64,
        Datatype::FixedPoint { size: 1, signed: false, .. } => NcType::UByte,
        Datatype::FixedPoint { size: 2, signed: false, .. } => NcType::UShort,
        Datatype::FixedPoint { size: 4, signed: false, .. } => NcType::UInt,
        Datatype::FixedPoint { size: 8, signed: false, .. } => NcType::UInt64,
        _ => return None,
    })
}

impl Hdf5Dataset {
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
        let stored = self.read_stored(rows)?;
        let Some(storage) = &self.storage else { return Ok(stored) };
        let mut notes = vec![];
        let known = storage.known(stored.into_iter(), &mut notes);
        let notes = notes.into_iter().map(|note| format!("`{}`: {note}", self.name));
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).extend(notes);
        let [scale, offset] = storage.packing;
        Ok(known.into_iter().map(|v| v * scale + offset).collect())
    }

    /// The numbers as they are stored.
    fn read_stored(&self, rows: Option<Range<u64>>) -> Result<Vec<f64>, ReadError> {
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
            Some(Hdf5LegacyLayout::Contiguous(at)) => self.read_early(at, rows),
            Some(Hdf5LegacyLayout::Other) => {
                let error = self.damaged("has a non-contiguous layout from HDF5 before 1.6.3, which is not supported");
                Err(error.help("rewrite the file with a later version of MATLAB or the HDF5 library"))
            }
        }
    }

    /// Contiguous numbers that start `at` bytes into the file.
    fn read_early(&self, at: u64, rows: Option<Range<u64>>) -> Result<Vec<f64>, ReadError> {
        let kind = self.set.dtype();
        let (Datatype::FloatingPoint { size, byte_order } | Datatype::FixedPoint { size, byte_order, .. }) = kind
        else {
            return Err(self.not_numbers());
        };
        let a_row = self.shape.iter().skip(1).product::<u64>();
        let all = self.shape.first().copied().unwrap_or(1);
        let rows = rows.unwrap_or(0..all);
        let (from, to) = (rows.start.min(all) * a_row * u64::from(*size), rows.end.min(all) * a_row * u64::from(*size));
        let read = || {
            let mut file = File::open(&self.path).ok()?;
            bytes(&mut file, at.checked_add(from)?, usize::try_from(to.checked_sub(from)?).ok()?)
        };
        let raw = read().ok_or_else(|| self.damaged("its values lie beyond the end of the file"))?;
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
        Ok(of_kind!(kind, numbers, return Err(self.not_numbers())))
    }

    fn read_numbers(&self, slice: &SliceInfo) -> Result<Vec<f64>, ReadError> {
        macro_rules! numbers {
            ($t:ty) => {{
                let array =
                    if self.shape.is_empty() { self.set.read_array::<$t>() } else { self.set.read_slice::<$t>(slice) };
                array.map_err(|e| self.damaged(&e.to_string()))?.iter().map(|x| *x as f64).collect()
            }};
        }
        Ok(of_kind!(self.set.dtype(), numbers, return Err(self.not_numbers())))
    }

    fn not_numbers(&self) -> ReadError {
        self.damaged(&format!("holds {:?}, not numbers", self.set.dtype()))
    }

    /// An error about this data set.
    pub(super) fn damaged(&self, what: &str) -> ReadError {
        ReadError::data(&self.path, what).in_column(&self.name)
    }
}

fn damaged(path: &Path, error: &hdf5_reader::error::Error) -> ReadError {
    match error {
        hdf5_reader::error::Error::Io(e) => ReadError::io(path, e),
        e => ReadError::data(path, format!("the file is not a complete HDF5 file: {e}")),
    }
}
