//! Geosoft binary grids of Oasis montaj, version 2: a header of 512 bytes, then vectors of elements, plain or as
//! deflated blocks. [Seequent, Oasis montaj, Grid file format (*.GRD)]
//!
//! The format has neither a height nor a coordinate system: Oasis montaj keeps the latter in a file `.gi`, which is not
//! read. The grids of the North American magnetic anomaly map (USGS Open-File Report 02-414) have this format.

use std::{io::Read, path::Path};

use flate2::read::ZlibDecoder;

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{FieldCursor, bytes_of, nodes, transposed},
    limits::DecodeLimit,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "geosoft_grd",
    about: "Geosoft binary grid of Oasis montaj, plain or compressed",
    extensions: &["grd"],
    recognise: |head: &FileHead| GeosoftHeader::parse(head.path, &head.bytes).is_ok_and(|h| h.is_plausible()),
    companions: None,
    read,
    write: None,
};

/// Length of the header.
const HEADER: usize = 512;
/// Value by which the header of a compressed grid increases the number of bytes per element.
const COMPRESSED: i32 = 1024;
/// Bytes at the start of each compressed block that are not part of its deflated data.
const BLOCK_HEAD: usize = 16;
/// Floating-point elements at or below this number are unknown.
const DUMMY: f64 = -1e32;

/// Types of elements: bytes per element and sign flag.
#[derive(Clone, Copy, Debug, PartialEq)]
enum GeosoftElement {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl GeosoftElement {
    fn new(bytes: i32, sign: i32) -> Option<GeosoftElement> {
        Some(match (bytes, sign) {
            (1, 0) => GeosoftElement::U8,
            (1, 1) => GeosoftElement::I8,
            (2, 0) => GeosoftElement::U16,
            (2, 1) => GeosoftElement::I16,
            (4, 0) => GeosoftElement::U32,
            (4, 1) => GeosoftElement::I32,
            (4, 2) => GeosoftElement::F32,
            (8, _) => GeosoftElement::F64,
            _ => return None,
        })
    }

    /// The number of an element; NaN where unknown.
    fn number(self, bytes: &[u8]) -> f64 {
        macro_rules! read {
            ($t:ty) => {
                bytes.try_into().map_or(f64::NAN, |b| f64::from(<$t>::from_le_bytes(b)))
            };
        }
        let (number, is_unknown): (f64, fn(f64) -> bool) = match self {
            GeosoftElement::U8 => (read!(u8), |x| x == 255.0),
            GeosoftElement::I8 => (read!(i8), |x| x == -127.0),
            GeosoftElement::U16 => (read!(u16), |x| x == 65_535.0),
            GeosoftElement::I16 => (read!(i16), |x| x == -32_767.0),
            GeosoftElement::U32 => (read!(u32), |x| x == 4_294_967_295.0),
            GeosoftElement::I32 => (read!(i32), |x| x == -2_147_483_647.0),
            GeosoftElement::F32 => (read!(f32), |x| x <= f64::from(DUMMY as f32)),
            GeosoftElement::F64 => (read!(f64), |x| x <= DUMMY),
        };
        if is_unknown(number) { f64::NAN } else { number }
    }
}

/// The header of a grid.
struct GeosoftHeader {
    /// Bytes per element, plus 1024 if the grid is compressed.
    size: i32,
    /// 0 unsigned, 1 signed, 2 floating point, 3 colour.
    sign: i32,
    /// Elements per vector.
    elements: i32,
    /// Number of vectors.
    vectors: i32,
    /// 1: vectors are rows that start in the west, and the first vector is the southernmost row. -1: vectors are
    /// columns that start in the south, and the first vector is the westernmost column.
    order: i32,
    /// Distances between elements and between vectors.
    steps: [f64; 2],
    /// Easting and northing of the first element.
    origin: [f64; 2],
    /// Counterclockwise rotation of the grid, degrees.
    rotation: f64,
    /// Number that is added to an element after division by `multiplier`.
    base: f64,
    multiplier: f64,
}

impl GeosoftHeader {
    fn parse(path: &Path, bytes: &[u8]) -> Result<GeosoftHeader, ReadError> {
        let mut fields = FieldCursor::new(path, bytes);
        let mut head = FieldCursor::new(path, fields.take(HEADER)?);
        let (size, sign, elements) = (head.i32()?, head.i32()?, head.i32()?);
        let (vectors, order) = (head.i32()?, head.i32()?);
        let steps = [head.f64()?, head.f64()?];
        let origin = [head.f64()?, head.f64()?];
        let (rotation, base, multiplier) = (head.f64()?, head.f64()?, head.f64()?);
        Ok(GeosoftHeader { size, sign, elements, vectors, order, steps, origin, rotation, base, multiplier })
    }

    /// Whether the fields are plausible for a grid; the format has no signature.
    fn is_plausible(&self) -> bool {
        let is_size = [1, 2, 4, 8].contains(&(self.size % COMPRESSED)) && self.size < 2 * COMPRESSED;
        let is_step = self.steps.iter().all(|step| step.is_normal() && *step > 0.0);
        let is_place = self.origin.iter().all(|x| x.is_finite()) && self.rotation.is_finite();
        let is_counted = self.elements > 0 && self.vectors > 0;
        is_size
            && (0..=3).contains(&self.sign)
            && is_counted
            && (1..=4).contains(&self.order.abs())
            && is_step
            && is_place
    }

    /// Whether the vectors are compressed.
    fn is_compressed(&self) -> bool {
        self.size > COMPRESSED
    }
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let bytes = bytes_of(path)?;
    let header = GeosoftHeader::parse(path, &bytes)?;
    if !header.is_plausible() {
        return Err(ReadError::data(path, "the file does not begin with the header of a Geosoft grid"));
    }
    if header.rotation != 0.0 {
        let what = format!("the grid is rotated by {} degrees", header.rotation);
        return Err(ReadError::data(path, what).help("warp the grid to north-up first"));
    }
    let help = "export the grid as GXF or ER Mapper";
    let element = GeosoftElement::new(header.size % COMPRESSED, header.sign);
    let element = element.ok_or_else(|| {
        let what = format!("elements of {} bytes with the sign flag {} are not numbers", header.size, header.sign);
        ReadError::data(path, what).help(help)
    })?;
    let is_rows = match header.order {
        1 => true,
        -1 => false,
        order => {
            let what = format!("the orientation {order} of the grid is not supported");
            return Err(ReadError::data(path, what).help(help));
        }
    };
    let each = (header.size % COMPRESSED) as usize;
    let stored = bytes.get(HEADER..).unwrap_or_default();
    let limit = DecodeLimit::new(bytes.len() as u64).most() / each as u64;
    let (least, available) = if header.is_compressed() { (1, limit) } else { (each as u64, stored.len() as u64) };
    let (elements, vectors) = nodes(path, header.elements.into(), header.vectors.into(), least, available)?;
    let needed = elements * vectors * each;
    let inflated = if header.is_compressed() { Some(inflate(path, &bytes, needed)?) } else { None };
    let data = inflated.as_deref().unwrap_or(stored).get(..needed);
    let data = data.ok_or_else(|| ReadError::data(path, "the file is truncated"))?;
    let numbers = data.chunks_exact(each).map(|bytes| element.number(bytes));
    let values: Vec<f64> =
        if is_rows { numbers.collect() } else { transposed(&numbers.collect::<Vec<f64>>(), elements) };
    let [along, across] = header.steps;
    let (steps, counts) =
        if is_rows { ([along, across], [elements, vectors]) } else { ([across, along], [vectors, elements]) };
    let axis = |k: usize, name: &str| FileAxis::new(path, name, header.origin[k], steps[k], counts[k]);
    let mut draft = MapDraft::new(path, axis(0, "x")?, axis(1, "y")?, values, FileCrs::Unknown);
    if header.multiplier != 1.0 || header.base != 0.0 {
        draft.packing = [1.0 / header.multiplier, header.base];
    }
    draft.finish(options)
}

/// Decompresses the elements of a grid, which must be `needed` bytes.
fn inflate(path: &Path, bytes: &[u8], needed: usize) -> Result<Vec<u8>, ReadError> {
    let mut fields = FieldCursor::new(path, bytes.get(HEADER..).unwrap_or_default());
    // Skips a signature and the type of the compression.
    fields.take(8)?;
    let (blocks, _) = (fields.i32()?, fields.i32()?);
    let blocks = usize::try_from(blocks).unwrap_or(0);
    let wrong = |what: String| ReadError::data(path, what);
    if blocks == 0 || (blocks as u64).saturating_mul(12) > fields.left() {
        return Err(wrong(format!("the file is truncated: it declares {blocks} compressed blocks")));
    }
    let starts: Vec<u64> = eights(fields.take(8 * blocks)?);
    let mut sizes = FieldCursor::new(path, fields.take(4 * blocks)?);
    let mut out = vec![];
    for (number, start) in starts.into_iter().enumerate() {
        let size = usize::try_from(sizes.i32()?).unwrap_or(0);
        let start = usize::try_from(start).unwrap_or(usize::MAX);
        let block = start.checked_add(size).and_then(|end| bytes.get(start..end)).and_then(|b| b.get(BLOCK_HEAD..));
        let block = block.ok_or_else(|| wrong(format!("the file is truncated in the compressed block {number}")))?;
        let left = (needed - out.len()) as u64;
        let read = ZlibDecoder::new(block).take(left + 1).read_to_end(&mut out);
        read.map_err(|e| wrong(format!("the compressed block {number} is damaged: {e}")))?;
        if out.len() > needed {
            return Err(wrong(format!("the compressed blocks hold more than the {needed} bytes of the grid")));
        }
    }
    if out.len() < needed {
        return Err(wrong(format!("the compressed blocks hold {} of {needed} bytes of the grid", out.len())));
    }
    Ok(out)
}

/// Little-endian 64-bit unsigned integers.
fn eights(bytes: &[u8]) -> Vec<u64> {
    bytes.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)).collect()
}
