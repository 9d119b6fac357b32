//! Data sets in the layout of HDF5 before 1.6.3: versions 1 and 2 of the data layout message, as in the first MATLAB
//! 7.3 files. `hdf5-reader` 0.12 looks for these data sets at the wrong position. Contiguous data sets are read; others
//! are errors. [The HDF Group, HDF5 File Format Specification 3.0, IV.A.1.a and IV.A.2.i]

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

/// Maximum number of messages in a header, and of blocks of messages.
const MOST: usize = 4096;
/// The largest block of messages, in bytes.
const BLOCK: u64 = 1 << 20;
const LAYOUT: u16 = 0x0008;
const CONTINUATION: u16 = 0x0010;

/// Position of the values of a data set in the layout of HDF5 before 1.6.3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hdf5LegacyLayout {
    /// One block, this many bytes from the start of the file.
    Contiguous(u64),
    /// In chunks, or in the header itself.
    Other,
}

/// The values of a data set with an early layout, whose header is `header` bytes after `base`, the start of the HDF5
/// data in the file. `None` for any other layout, and for a damaged header, which `hdf5-reader` reports.
pub(super) fn early(path: &Path, base: u64, header: u64) -> Option<Hdf5LegacyLayout> {
    let mut file = File::open(path).ok()?;
    let first = bytes(&mut file, base.checked_add(header)?, 16)?;
    // A header of version 2, which begins with its signature, is from a later library.
    if *first.first()? != 1 {
        return None;
    }
    let mut blocks = vec![(header.checked_add(16)?, u64::from(u32_at(&first, 8)?))];
    let mut seen = 0;
    while let Some((at, length)) = blocks.pop() {
        if length > BLOCK {
            return None;
        }
        let block = bytes(&mut file, base.checked_add(at)?, usize::try_from(length).ok()?)?;
        let mut rest = block.as_slice();
        while rest.len() >= 8 {
            let (kind, size) = (u16_at(rest, 0)?, usize::from(u16_at(rest, 2)?));
            let body = rest.get(8..8 + size)?;
            match kind {
                LAYOUT => return layout(body, base),
                CONTINUATION => blocks.push((u64_at(body, 0)?, u64_at(body, 8)?)),
                _ => {}
            }
            rest = rest.get(8 + size..)?;
            seen += 1;
            if seen > MOST {
                return None;
            }
        }
    }
    None
}

/// Version, dimensions, class, five reserved bytes, and an address.
fn layout(body: &[u8], base: u64) -> Option<Hdf5LegacyLayout> {
    match (body.first()?, body.get(2)?) {
        (1 | 2, 1) => Some(Hdf5LegacyLayout::Contiguous(base.checked_add(u64_at(body, 8)?)?)),
        (1 | 2, _) => Some(Hdf5LegacyLayout::Other),
        _ => None,
    }
}

/// Bytes of a file; `None` beyond its end.
pub(super) fn bytes(file: &mut File, at: u64, length: usize) -> Option<Vec<u8>> {
    let whole = file.metadata().ok()?.len();
    if at.checked_add(length as u64)? > whole {
        return None;
    }
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut read = vec![0; length];
    file.read_exact(&mut read).ok()?;
    Some(read)
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::fs;

    use super::{
        super::log_tests::{log, read, reference},
        *,
    };
    use crate::FlightOptions;

    /// The layout of the data set of MATLAB 7.4: its header begins 0x3d0 bytes after the start of the HDF5 data, and
    /// the layout message 80 bytes later.
    const HEADER: u64 = 0x3d0;

    #[test]
    fn unit_an_early_layout_is_distinguished_from_later_ones_and_from_damage() {
        let old = log("matlab/testhdf5_7.4_GLNX86.mat");
        assert_eq!(early(&old, 512, HEADER), Some(Hdf5LegacyLayout::Contiguous(512 + 0xe00)));
        assert_eq!(early(&old, 512, 0), None);
        assert_eq!(early(&old, 512, u64::MAX - 3), None);
        assert_eq!(early(&reference("made_v73.mat"), 512, HEADER), None);
        let whole = fs::read(&old).unwrap();
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("x.mat");
        let at = whole.windows(8).position(|w| w == [2, 3, 1, 0, 0, 0, 0, 0]).unwrap();
        // A chunked data set is rejected with a remedy.
        let mut chunked = whole.clone();
        chunked[at + 2] = 2;
        fs::write(&path, &chunked).unwrap();
        let message = read(&path, &FlightOptions::default()).unwrap_err().to_string();
        assert!(message.contains("testdouble") && message.contains("HDF5 before 1.6.3"), "{message}");
        // An address beyond the end of the file.
        let mut far = whole;
        far[at + 8 + 5] = 1;
        fs::write(&path, &far).unwrap();
        let message = read(&path, &FlightOptions::default()).unwrap_err().to_string();
        assert!(message.contains("testdouble"), "{message}");
    }
}
