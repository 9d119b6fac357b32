//! Small rasters for tests: TIFF and classic NetCDF files with arbitrary tags and attributes.

/// One image of a TIFF: its tags (16-bit integers, doubles or text) and its cells.
#[derive(Clone, Default)]
pub(super) struct TiffImageFixture {
    pub(super) shorts: Vec<(u16, Vec<u16>)>,
    pub(super) doubles: Vec<(u16, Vec<f64>)>,
    pub(super) texts: Vec<(u16, String)>,
    pub(super) cells: Vec<u8>,
}

impl TiffImageFixture {
    /// One band whose cells have `bits` bits and the sample format `format` (1 unsigned, 2 signed, 3 floating point).
    /// The grid has a spacing of 200 m in UTM zone 54 south and its north-west corner at (500000, 7600000).
    pub(super) fn band(width: u16, height: u16, bits: u16, format: u16, cells: Vec<u8>) -> TiffImageFixture {
        let keys = vec![1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32754];
        let shorts = [
            (256, vec![width]),
            (257, vec![height]),
            (258, vec![bits]),
            (259, vec![1]),
            (262, vec![1]),
            (277, vec![1]),
            (278, vec![height]),
            (339, vec![format]),
            (34735, keys),
        ];
        let doubles = vec![(33550, vec![200.0, 200.0, 0.0]), (33922, vec![0.0, 0.0, 0.0, 500_000.0, 7_600_000.0, 0.0])];
        TiffImageFixture { shorts: shorts.to_vec(), doubles, texts: vec![], cells }
    }

    /// The same image with an integer tag added or replaced.
    pub(super) fn with(mut self, tag: u16, numbers: &[u16]) -> TiffImageFixture {
        self.shorts.retain(|(t, _)| *t != tag);
        self.shorts.push((tag, numbers.to_vec()));
        self
    }

    /// The same image with a text tag added.
    pub(super) fn text(mut self, tag: u16, text: &str) -> TiffImageFixture {
        self.texts.push((tag, format!("{text}\0")));
        self
    }
}

/// A little-endian TIFF of images.
pub(super) fn tiff(images: &[TiffImageFixture]) -> Vec<u8> {
    let mut file = b"II*\0\0\0\0\0".to_vec();
    let mut link = 4;
    for image in images {
        let cells_at = file.len() as u32;
        file.extend(&image.cells);
        let planes = if image.shorts.contains(&(284, vec![2])) { 2 } else { 1 };
        let strip = image.cells.len() as u32 / planes;
        let longs = |of: &dyn Fn(u32) -> u32| (0..planes).flat_map(|i| of(i).to_le_bytes()).collect::<Vec<u8>>();
        let mut entries: Vec<(u16, u16, u32, Vec<u8>)> =
            vec![(273, 4, planes, longs(&|i| cells_at + i * strip)), (279, 4, planes, longs(&|_| strip))];
        for (tag, v) in &image.shorts {
            entries.push((*tag, 3, v.len() as u32, v.iter().flat_map(|x| x.to_le_bytes()).collect()));
        }
        for (tag, v) in &image.doubles {
            entries.push((*tag, 12, v.len() as u32, v.iter().flat_map(|x| x.to_le_bytes()).collect()));
        }
        for (tag, v) in &image.texts {
            entries.push((*tag, 2, v.len() as u32, v.as_bytes().to_vec()));
        }
        entries.sort_by_key(|e| e.0);
        let mut directory = (entries.len() as u16).to_le_bytes().to_vec();
        for (tag, kind, count, bytes) in entries {
            directory.extend(tag.to_le_bytes());
            directory.extend(kind.to_le_bytes());
            directory.extend(count.to_le_bytes());
            if bytes.len() <= 4 {
                let mut value = bytes;
                value.resize(4, 0);
                directory.extend(value);
            } else {
                directory.extend((file.len() as u32).to_le_bytes());
                file.extend(&bytes);
            }
        }
        let at = file.len() as u32;
        file[link..link + 4].copy_from_slice(&at.to_le_bytes());
        file.extend(directory);
        link = file.len();
        file.extend([0; 4]);
    }
    file
}

/// An attribute of NetCDF.
#[derive(Clone)]
pub(super) enum NetcdfValueFixture {
    Text(&'static str),
    Bytes(Vec<i8>),
    Shorts(Vec<i16>),
    Ints(Vec<i32>),
    Floats(Vec<f32>),
    Doubles(Vec<f64>),
}

impl NetcdfValueFixture {
    /// The NetCDF type, the number of values, and the bytes of the values.
    pub(super) fn encoded(&self) -> (u32, u32, Vec<u8>) {
        fn all<T: Copy, const N: usize>(v: &[T], bytes: impl Fn(T) -> [u8; N]) -> (u32, Vec<u8>) {
            (v.len() as u32, v.iter().flat_map(|x| bytes(*x)).collect())
        }
        let (kind, (count, mut bytes)) = match self {
            NetcdfValueFixture::Text(t) => (2, (t.len() as u32, t.as_bytes().to_vec())),
            NetcdfValueFixture::Bytes(v) => (1, all(v, i8::to_be_bytes)),
            NetcdfValueFixture::Shorts(v) => (3, all(v, i16::to_be_bytes)),
            NetcdfValueFixture::Ints(v) => (4, all(v, i32::to_be_bytes)),
            NetcdfValueFixture::Floats(v) => (5, all(v, f32::to_be_bytes)),
            NetcdfValueFixture::Doubles(v) => (6, all(v, f64::to_be_bytes)),
        };
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        (kind, count, bytes)
    }
}

/// A variable of a NetCDF: its name, dimensions, attributes and values.
type NetcdfVariableFixture<'a> = (&'a str, Vec<u32>, Vec<(&'a str, NetcdfValueFixture)>, NetcdfValueFixture);

/// A classic NetCDF file with one grid `z` over `y` and `x`, with the given attributes of `z` and units of the axes.
pub(super) fn netcdf(
    x: &[f64],
    y: &[f64],
    units: [&'static str; 2],
    values: NetcdfValueFixture,
    attributes: &[(&str, NetcdfValueFixture)],
) -> Vec<u8> {
    let name = |out: &mut Vec<u8>, text: &str| {
        out.extend((text.len() as u32).to_be_bytes());
        out.extend(text.as_bytes());
        out.resize(out.len().next_multiple_of(4), 0);
    };
    let word = |out: &mut Vec<u8>, x: u32| out.extend(x.to_be_bytes());
    let variables: Vec<NetcdfVariableFixture> = vec![
        ("x", vec![0], vec![("units", NetcdfValueFixture::Text(units[0]))], NetcdfValueFixture::Doubles(x.to_vec())),
        ("y", vec![1], vec![("units", NetcdfValueFixture::Text(units[1]))], NetcdfValueFixture::Doubles(y.to_vec())),
        ("z", vec![1, 0], attributes.to_vec(), values),
    ];
    let header = |offsets: &[u32]| {
        let mut out = b"CDF\x01\0\0\0\0".to_vec();
        word(&mut out, 10);
        word(&mut out, 2);
        for (dimension, len) in [("x", x.len()), ("y", y.len())] {
            name(&mut out, dimension);
            word(&mut out, len as u32);
        }
        out.extend([0; 8]);
        word(&mut out, 11);
        word(&mut out, 3);
        for (i, (variable, dimensions, attributes, data)) in variables.iter().enumerate() {
            name(&mut out, variable);
            word(&mut out, dimensions.len() as u32);
            dimensions.iter().for_each(|d| word(&mut out, *d));
            word(&mut out, if attributes.is_empty() { 0 } else { 12 });
            word(&mut out, attributes.len() as u32);
            for (attribute, value) in attributes {
                let (kind, count, bytes) = value.encoded();
                name(&mut out, attribute);
                word(&mut out, kind);
                word(&mut out, count);
                out.extend(bytes);
            }
            let (kind, _, bytes) = data.encoded();
            word(&mut out, kind);
            word(&mut out, bytes.len() as u32);
            word(&mut out, offsets[i]);
        }
        out
    };
    let data: Vec<Vec<u8>> = variables.iter().map(|v| v.3.encoded().2).collect();
    let start = header(&[0; 3]).len() as u32;
    let (first, second) = (data[0].len() as u32, data[1].len() as u32);
    let mut file = header(&[start, start + first, start + first + second]);
    file.extend(data.concat());
    file
}
