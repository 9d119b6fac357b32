//! The directories of a TIFF file, which identify masks and overviews among its images. [TIFF 6.0, BigTIFF]

/// The tags that are read.
const SUBFILE: u16 = 254;
const PHOTOMETRIC: u16 = 262;

/// Maximum number of directories; more indicate a cycle.
const MOST: usize = 4096;

/// Directory of one image of a TIFF file: its subfile type and photometric interpretation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct TiffDirectory {
    subfile: u32,
    /// The position of the photometric interpretation in the file, and the bytes that represent `BlackIsZero`.
    photometric: Option<(usize, [u8; 2])>,
}

impl TiffDirectory {
    /// Whether it is the mask of another image.
    pub(super) fn is_mask(&self) -> bool {
        self.subfile & 4 != 0
    }

    /// Whether it is a smaller version of another image.
    pub(super) fn is_reduced(&self) -> bool {
        self.subfile & 1 != 0
    }

    /// Sets the photometric interpretation in the bytes of the file to black-is-zero; returns whether that is possible.
    pub(super) fn black_is_zero(&self, bytes: &mut [u8]) -> bool {
        let place = self.photometric.and_then(|(at, one)| Some((bytes.get_mut(at..at + 2)?, one)));
        place.map(|(place, one)| place.copy_from_slice(&one)).is_some()
    }
}

/// The directories of a file in the order of its images, except damaged ones.
pub(super) fn directories(bytes: &[u8]) -> Vec<TiffDirectory> {
    let mut found = vec![];
    let mut seen = std::collections::HashSet::new();
    let Some(file) = TiffBytes::new(bytes) else { return found };
    let mut next = if file.big { file.number(8, 8) } else { file.number(4, 4) };
    while let Some(at) = next.filter(|at| *at != 0 && found.len() < MOST && seen.insert(*at)) {
        let Some((directory, following)) = file.directory(at) else { break };
        found.push(directory);
        next = following;
    }
    found
}

struct TiffBytes<'a> {
    bytes: &'a [u8],
    little: bool,
    big: bool,
}

impl<'a> TiffBytes<'a> {
    fn new(bytes: &'a [u8]) -> Option<TiffBytes<'a>> {
        let little = bytes.starts_with(b"II");
        let file = TiffBytes { bytes, little, big: false };
        Some(TiffBytes { big: file.number(2, 2)? == 43, ..file })
    }

    fn number(&self, at: usize, size: usize) -> Option<usize> {
        let bytes = self.bytes.get(at..at.checked_add(size)?)?;
        let add = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
        let sum = if self.little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) };
        usize::try_from(sum).ok()
    }

    /// The directory at a position, and the position of the next.
    fn directory(&self, at: usize) -> Option<(TiffDirectory, Option<usize>)> {
        let (count_size, entry_size, value_at, link) = if self.big { (8, 20, 12, 8) } else { (2, 12, 8, 4) };
        let count = self.number(at, count_size)?;
        let first = at + count_size;
        let end = count.checked_mul(entry_size)?.checked_add(first).filter(|end| *end <= self.bytes.len())?;
        let mut directory = TiffDirectory::default();
        for entry in (first..end).step_by(entry_size) {
            let value = entry + value_at;
            match self.number(entry, 2)? as u16 {
                // A number of 16 or 32 bits.
                SUBFILE => {
                    let size = if self.number(entry + 2, 2)? == 3 { 2 } else { 4 };
                    directory.subfile = self.number(value, size)? as u32;
                }
                PHOTOMETRIC => directory.photometric = Some((value, if self.little { [1, 0] } else { [0, 1] })),
                _ => {}
            }
        }
        Some((directory, self.number(end, link)))
    }
}
