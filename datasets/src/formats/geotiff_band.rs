//! The values of a TIFF's band, with NaN for nodes that its no-data value, alpha band or mask marks as unknown.
//! [TIFF 6.0, NewSubfileType, ExtraSamples; GDAL, tag 42113]

use std::{
    fs::File,
    io::{BufReader, Cursor, Read, Seek},
    path::Path,
};

use tiff::{
    ColorType,
    decoder::{Decoder, DecodingResult, Limits},
    tags::Tag,
};

use super::{grid_bytes::bytes_of, guarded, limits::DecodeLimit, tiff_directories::directories};
use crate::{ReadError, grid::is_marker};

pub(super) type TiffDecoder = Decoder<BufReader<File>>;

/// Opens a file.
///
/// # Errors
/// Fails for a file that cannot be read.
pub(super) fn decoder(path: &Path) -> Result<TiffDecoder, ReadError> {
    let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
    let bytes = file.metadata().map_err(|e| ReadError::io(path, &e))?.len();
    limited(path, BufReader::new(file), bytes)
}

/// Rejects a size that the file cannot hold, so that a damaged size does not exhaust memory.
fn limited<R: Read + Seek>(path: &Path, from: R, bytes: u64) -> Result<Decoder<R>, ReadError> {
    let mut limits = Limits::default();
    let most = DecodeLimit::new(bytes).most_here();
    limits.decoding_buffer_size = most;
    limits.intermediate_buffer_size = most;
    limits.ifd_value_size = most.min(1 << 28);
    Ok(Decoder::new(from).map_err(|e| damaged(path, &e))?.with_limits(limits))
}

pub(super) fn damaged(path: &Path, error: &tiff::TiffError) -> ReadError {
    ReadError::data(path, format!("the TIFF file is incomplete or unsupported: {error}"))
}

/// The values as stored, NaN where unknown, and the number of further images of full size.
///
/// # Errors
/// Fails for a band of colours, a mask that cannot be read, or a no-data value that is not a number.
pub(super) fn values(path: &Path, decoder: &mut TiffDecoder) -> Result<(Vec<f64>, usize), ReadError> {
    let (width, height) = decoder.dimensions().map_err(|e| damaged(path, &e))?;
    let (width, height) = (width as usize, height as usize);
    let no_data = decoder.get_tag_ascii_string(Tag::GdalNodata).ok();
    let inverted = decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation).ok().flatten() == Some(0);
    let samples = samples(path, decoder)?;
    let planar = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).ok().flatten() == Some(2);
    // The directories of the file are examined only if it holds more than the band.
    let directories = if decoder.more_images() || inverted { directories(&bytes_of(path)?) } else { vec![] };
    let mut image = if inverted { plain_image(path, 0)? } else { image(path, decoder)? };
    let alpha = (samples == 2).then(|| image.split(planar));
    let mut values = image.numbers(path, no_data.as_deref())?;
    let mut unknown = |known: &[bool]| {
        values.iter_mut().zip(known).filter(|(_, known)| !**known).for_each(|(v, _)| *v = f64::NAN);
    };
    if let Some(alpha) = alpha {
        let alpha: Vec<bool> = alpha.numbers(path, None)?.iter().map(|a| *a > 0.0).collect();
        unknown(&alpha);
    }
    let mut further = 0;
    for (index, directory) in directories.iter().enumerate().skip(1) {
        match (directory.is_mask(), directory.is_reduced()) {
            (true, false) => unknown(&mask(path, index, width, height)?),
            (false, false) => further += 1,
            (_, true) => {}
        }
    }
    Ok((values, further))
}

/// The number of samples of a cell: one, or two where the second is an alpha band.
fn samples<R: Read + Seek>(path: &Path, decoder: &mut Decoder<R>) -> Result<usize, ReadError> {
    let colour = decoder.colortype().map_err(|e| damaged(path, &e))?;
    let extra = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).ok().flatten().unwrap_or_default();
    match colour {
        ColorType::Gray(_) => Ok(1),
        // Associated or unassociated alpha.
        ColorType::GrayA(_) | ColorType::Multiband { num_samples: 2, .. } if matches!(extra[..], [1 | 2]) => Ok(2),
        _ => Err(ReadError::data(path, format!("a map must have one band, not {colour:?}"))
            .help("keep one band, for example with `gdal_translate -b 1`")),
    }
}

/// Decoded samples.
struct TiffSamples(DecodingResult);

fn image<R: Read + Seek>(path: &Path, decoder: &mut Decoder<R>) -> Result<TiffSamples, ReadError> {
    let mut result = DecodingResult::U8(vec![]);
    let layout = decoder.read_image_to_buffer(&mut result).map_err(|e| damaged(path, &e))?;
    if result.as_buffer(0).byte_len() < layout.complete_len {
        return Err(ReadError::data(path, "the planes of the image hold more data than a file of this size can store"));
    }
    Ok(TiffSamples(result))
}

/// The stored samples of an image. The decoder would invert a white-is-zero image and does not read masks.
fn plain_image(path: &Path, index: usize) -> Result<TiffSamples, ReadError> {
    let mut bytes = bytes_of(path)?;
    let found = directories(&bytes).get(index).map(|d| d.black_is_zero(&mut bytes));
    if found != Some(true) {
        return Err(ReadError::data(path, "the image file directories (IFDs) are damaged"));
    }
    let size = bytes.len() as u64;
    let mut decoder = limited(path, Cursor::new(bytes), size)?;
    decoder.seek_to_image(index).map_err(|e| damaged(path, &e))?;
    image(path, &mut decoder)
}

/// Whether each cell is known, by the mask with this index among the images.
fn mask(path: &Path, index: usize, width: usize, height: usize) -> Result<Vec<bool>, ReadError> {
    let mut bytes = bytes_of(path)?;
    let wrong = |what: String| ReadError::data(path, format!("the mask of the file {what}"));
    if directories(&bytes).get(index).map(|d| d.black_is_zero(&mut bytes)) != Some(true) {
        return Err(wrong("has a damaged directory".to_owned()));
    }
    let size = bytes.len() as u64;
    let mut decoder = limited(path, Cursor::new(bytes), size)?;
    let failed = |e: tiff::TiffError| wrong(format!("cannot be read: {e}"));
    decoder.seek_to_image(index).map_err(failed)?;
    let (columns, rows) = decoder.dimensions().map_err(failed)?;
    if (columns as usize, rows as usize) != (width, height) {
        return Err(wrong(format!("has {columns} x {rows} cells, not {width} x {height}")));
    }
    let bits = match decoder.colortype().map_err(failed)? {
        ColorType::Gray(bits @ (1 | 8)) => bits,
        other => return Err(wrong(format!("must have 1 or 8 bits, not {other:?}"))),
    };
    let DecodingResult::U8(cells) = image(path, &mut decoder)?.0 else {
        return Err(wrong("must have 1 or 8 bits".to_owned()));
    };
    if bits == 8 {
        return Ok(cells.iter().map(|c| *c > 0).collect());
    }
    // Each row begins at a whole byte.
    let row = |bytes: &[u8]| -> Vec<bool> {
        (0..width).map(|i| bytes.get(i / 8).is_some_and(|b| b >> (7 - i % 8) & 1 == 1)).collect()
    };
    Ok(cells.chunks(width.div_ceil(8)).flat_map(row).collect())
}

/// Whether each cell is known, by a mask that is a file.
///
/// # Errors
/// Fails for a file that is not a mask of this size.
pub(super) fn mask_of(path: &Path, width: usize, height: usize) -> Result<Vec<bool>, ReadError> {
    guarded(path, || mask(path, 0, width, height))
}

/// Removes and returns every second sample, or the second half if samples are stored by planes.
fn split<T: Copy>(all: &mut Vec<T>, planar: bool) -> Vec<T> {
    if planar {
        return all.split_off(all.len() / 2);
    }
    let second = all.iter().skip(1).step_by(2).copied().collect();
    *all = all.iter().step_by(2).copied().collect();
    second
}

impl TiffSamples {
    /// Removes the second of two samples of each cell and returns it.
    fn split(&mut self, planar: bool) -> TiffSamples {
        use DecodingResult::{F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        TiffSamples(match &mut self.0 {
            U8(v) => U8(split(v, planar)),
            U16(v) => U16(split(v, planar)),
            U32(v) => U32(split(v, planar)),
            U64(v) => U64(split(v, planar)),
            I8(v) => I8(split(v, planar)),
            I16(v) => I16(split(v, planar)),
            I32(v) => I32(split(v, planar)),
            I64(v) => I64(split(v, planar)),
            F16(v) => F16(split(v, planar)),
            F32(v) => F32(split(v, planar)),
            F64(v) => F64(split(v, planar)),
        })
    }

    /// The numbers, with NaN for the no-data value in the type of the band.
    fn numbers(self, path: &Path, no_data: Option<&str>) -> Result<Vec<f64>, ReadError> {
        let text = no_data.map(|t| t.trim_matches(['\0', ' ', '\n', '\r', '\t'])).filter(|t| !t.is_empty());
        let one = |text: &str| {
            // NaN as printed by C on Windows.
            if text.contains("#IND") || text.contains("#QNAN") {
                return Ok(f64::NAN);
            }
            let number = text.parse::<f64>().ok();
            number
                .ok_or_else(|| ReadError::data(path, format!("the no-data value `{text}` (tag 42113) is not a number")))
        };
        let no_data = text.map(one).transpose()?;
        let known = |x: f64| if Some(x) == no_data { f64::NAN } else { x };
        let single = |x: f32| no_data.filter(|n| is_marker(f64::from(x), *n)).map_or(f64::from(x), |_| f64::NAN);
        Ok(match self.0 {
            DecodingResult::F32(v) => v.into_iter().map(single).collect(),
            DecodingResult::F64(v) => {
                let double = |x: f64| no_data.filter(|n| is_marker(x, *n)).map_or(x, |_| f64::NAN);
                v.into_iter().map(double).collect()
            }
            DecodingResult::I8(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            DecodingResult::I16(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            DecodingResult::I32(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            DecodingResult::U8(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            DecodingResult::U16(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            DecodingResult::U32(v) => v.into_iter().map(|x| known(f64::from(x))).collect(),
            _ => {
                let what = "the data type of the band is not supported";
                return Err(ReadError::data(path, what).help("convert the band to Float32"));
            }
        })
    }
}
