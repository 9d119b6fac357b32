//! Small files that declare large contents: each is rejected before memory is allocated, by an error with the file's
//! name.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, io::Write, path::PathBuf, sync::Arc};

use ::parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::properties::WriterProperties,
};
use arrow_array::{ArrayRef, FixedSizeBinaryArray, Float64Array, RecordBatch, StringArray};
use flate2::{Compression as Deflate, write::ZlibEncoder};
use hdf5_pure::{AttrValue, FileBuilder};
use tempfile::TempDir;

use super::{FlightOptions, MapOptions, ReadHints, open_raw, read_grid};

struct Case {
    folder: TempDir,
}

impl Case {
    fn new() -> Case {
        Case { folder: TempDir::new().unwrap() }
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    /// The error of reading a flight to its end.
    fn flight(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.file(name, bytes);
        let read = || open_raw(&path, &FlightOptions::default(), &ReadHints::default())?.collect::<Result<Vec<_>, _>>();
        let message = read().map(|all| all.len()).expect_err("a bomb").to_string();
        assert!(message.contains(name), "{message}");
        message
    }
}

fn parquet(batch: &RecordBatch) -> Vec<u8> {
    let properties = WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
    let mut writer = ArrowWriter::try_new(vec![], batch.schema(), Some(properties)).unwrap();
    writer.write(batch).unwrap();
    writer.into_inner().unwrap()
}

fn table(columns: Vec<(String, ArrayRef)>) -> RecordBatch {
    RecordBatch::try_from_iter_with_nullable(columns.into_iter().map(|(name, values)| (name, values, true))).unwrap()
}

#[test]
fn unit_a_parquet_file_that_declares_too_much_is_rejected() {
    let case = Case::new();
    // 300 values of 1 MiB, all null.
    let nulls = FixedSizeBinaryArray::new_null(1 << 20, 300);
    let bytes = parquet(&table(vec![("x".into(), Arc::new(nulls))]));
    assert!(bytes.len() < 10_000);
    let message = case.flight("nulls.parquet", &bytes);
    assert!(
        message.contains("declares 315 MB of values") && message.contains("the limit for this file size is 268 MB"),
        "{message}"
    );
    let map = read_grid(&case.file("map.parquet", &bytes), &MapOptions::default()).unwrap_err().to_string();
    assert!(map.contains("map.parquet: declares 315 MB"), "{map}");
}

#[test]
fn unit_a_text_of_a_dictionary_is_not_repeated_in_memory() {
    let case = Case::new();
    // One text of 512 kB in 600 rows is 300 MB as rows.
    let long = "A".repeat(1 << 19);
    let bytes = parquet(&table(vec![("line".into(), Arc::new(StringArray::from(vec![long.as_str(); 600])))]));
    assert!(bytes.len() < 100_000);
    let message = case.flight("texts.parquet", &bytes);
    assert!(message.contains("the text in 600 rows exceeds 256 MB") && message.contains("line"), "{message}");
    // Strings of every length are unchanged.
    let texts: Vec<String> = (0..40).map(|k| "é".repeat(k)).collect();
    let batch = table(vec![("line".into(), Arc::new(StringArray::from(texts)))]);
    let path = case.file("plain.parquet", &parquet(&batch));
    let mut read = open_raw(&path, &FlightOptions::default(), &ReadHints::default()).unwrap();
    assert_eq!(read.next().unwrap().unwrap().column(0), batch.column(0));
}

#[test]
fn unit_tables_of_too_many_columns_are_rejected() {
    let case = Case::new();
    let names: Vec<String> = (0..20_000).map(|k| format!("c{k}")).collect();
    let row = vec!["1"; names.len()].join(",");
    let message = case.flight("wide.csv", format!("{}\n{row}\n", names.join(",")).as_bytes());
    assert!(message.contains("has 20000 columns; the limit is 16384"), "{message}");
    let one: ArrayRef = Arc::new(Float64Array::from(vec![1.0]));
    let bytes = parquet(&table(names.into_iter().map(|name| (name, one.clone())).collect()));
    assert!(case.flight("wide.parquet", &bytes).contains("has 20000 columns"));
}

#[test]
fn unit_an_hdf5_file_that_declares_too_much_is_rejected() {
    let case = Case::new();
    let mut file = FileBuilder::new();
    // Bytes become Float64: 8 times 9 MiB for each of the four columns, of which three are within the limit.
    let zeros = vec![0_i8; 9 << 20];
    for name in ["lat", "lon", "tt", "utm_z"] {
        let shape = [zeros.len() as u64];
        file.create_dataset(name).with_i8_data(&zeros).with_shape(&shape).with_chunks(&[1 << 20]).with_lzf();
    }
    let bytes = file.finish().unwrap();
    assert!(bytes.len() < 1_000_000);
    let options = FlightOptions { format: Some("sgl_hdf5".into()), ..FlightOptions::default() };
    let path = case.file("zeros.h5", &bytes);
    let message = open_raw(&path, &options, &ReadHints::default()).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("zeros.h5") && message.contains("of values, but the file has"), "{message}");
}

#[test]
fn unit_a_matlab_file_that_declares_too_much_is_rejected() {
    let case = Case::new();
    let element = |kind: u32, data: &[u8]| [&kind.to_le_bytes()[..], &(data.len() as u32).to_le_bytes(), data].concat();
    let words = |words: &[u32]| words.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
    // 2^27 deflated doubles; the header is sufficient, so the zeros are omitted.
    let count = 1_u32 << 27;
    let head = [
        element(6, &words(&[6, 0])),
        element(5, &words(&[count, 1])),
        words(&[1 | 1 << 16, u32::from(b'x')]),
        words(&[9, 8 * count]),
    ]
    .concat();
    let matrix = [words(&[14, head.len() as u32 + 8 * count]), head, vec![0; 1000]].concat();
    let mut deflated = ZlibEncoder::new(vec![], Deflate::best());
    deflated.write_all(&matrix).unwrap();
    let deflated = deflated.finish().unwrap();
    let mut header = vec![b' '; 124];
    header[..19].copy_from_slice(b"MATLAB 5.0 MAT-file");
    header.extend(*b"\0\x01IM");
    let message = case.flight("zeros.mat", &[header, element(15, &deflated)].concat());
    assert!(message.contains("declares 1074 MB of values"), "{message}");
}

#[test]
fn unit_a_tiff_that_declares_too_much_is_rejected() {
    let case = Case::new();
    let side = 20_000_u32;
    let strip = [0; 64];
    // Width, height, bits, deflate, one strip of all rows, floating point, scale and tie point.
    let tags: [(u16, u16, u32, u32); 12] = [
        (256, 4, 1, side),
        (257, 4, 1, side),
        (258, 3, 1, 64),
        (259, 3, 1, 8),
        (262, 3, 1, 1),
        (273, 4, 1, 300),
        (277, 3, 1, 1),
        (278, 4, 1, side),
        (279, 4, 1, strip.len() as u32),
        (339, 3, 1, 3),
        (33_550, 12, 3, 200),
        (33_922, 12, 6, 224),
    ];
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    bytes.extend((tags.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in tags {
        bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        bytes.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
    }
    bytes.resize(200, 0);
    bytes.extend([100.0, 100.0, 0.0, 0.0, 0.0, 0.0, 4e5, 7e6, 0.0].iter().flat_map(|x: &f64| x.to_le_bytes()));
    bytes.resize(300, 0);
    bytes.extend(strip);
    // 64 bytes that declare 3.2 GB.
    let message = read_grid(&case.file("zeros.tif", &bytes), &MapOptions::default()).unwrap_err().to_string();
    assert!(message.contains("zeros.tif") && message.to_lowercase().contains("limit"), "{message}");
}

#[test]
fn unit_a_packed_gxf_that_declares_too_much_is_rejected() {
    let case = Case::new();
    // One run of 9 characters over 3.6e9 nodes.
    let text = "#POINTS\n60000\n#ROWS\n60000\n#PTSEPARATION\n100\n#RWSEPARATION\n100\n#GTYPE\n8\n#GRID\n\"%%%%%%%\n";
    let message = read_grid(&case.file("run.gxf", text.as_bytes()), &MapOptions::default()).unwrap_err().to_string();
    assert!(message.contains("run.gxf") && message.contains("it declares 60000 x 60000 nodes"), "{message}");
}

/// A flight of MagNav.jl with a magnetometer stored as whole numbers.
fn packed(attributes: &[(&str, AttrValue)], stored: &[i16]) -> Vec<u8> {
    let mut file = FileBuilder::new();
    let shape = [stored.len() as u64];
    for name in super::magnav::NEEDED {
        let values: Vec<f64> = (0..stored.len()).map(|k| 45.0 + 1e-4 * k as f64).collect();
        file.create_dataset(name).with_f64_data(&values).with_shape(&shape);
    }
    let set = file.create_dataset("mag_1_uc").with_i16_data(stored).with_shape(&shape);
    for (name, value) in attributes {
        set.set_attr(name, value.clone());
    }
    file.finish().unwrap()
}

/// Values and notes.
fn magnetometer(attributes: &[(&str, AttrValue)], stored: &[i16]) -> Result<(Vec<f64>, Vec<String>), String> {
    let case = Case::new();
    let path = case.file("packed.h5", &packed(attributes, stored));
    let options = FlightOptions { format: Some("magnav_hdf5".into()), ..FlightOptions::default() };
    let mut reader = open_raw(&path, &options, &ReadHints::default()).map_err(|e| e.to_string())?;
    let batch = reader.next().unwrap().map_err(|e| e.to_string())?;
    Ok((super::log_tests::numbers(&batch, "mag_1_uc"), reader.notes().to_vec()))
}

#[test]
fn unit_hdf5_values_are_unpacked_by_their_attributes() {
    let same = |found: &[f64], wanted: &[f64]| {
        let close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-6 || (a.is_nan() && b.is_nan());
        found.len() == wanted.len() && found.iter().zip(wanted).all(close)
    };
    let packing = [("scale_factor", AttrValue::F64(0.5)), ("add_offset", AttrValue::F64(50_000.0))];
    let fill = ("_FillValue", AttrValue::I16(-999));
    let (values, notes) = magnetometer(&[&packing[..], &[fill]].concat(), &[-2, 0, 100, -999]).unwrap();
    assert!(same(&values, &[49_999.0, 50_000.0, 50_050.0, f64::NAN]) && notes.is_empty(), "{values:?} {notes:?}");
    // Without attributes the stored numbers are the values.
    let (values, _) = magnetometer(&[], &[-2, 0, 100, -999]).unwrap();
    assert!(same(&values, &[-2.0, 0.0, 100.0, -999.0]), "{values:?}");
    let missing = ("missing_value", AttrValue::F64Array(vec![7.0, 9.0]));
    let (values, _) = magnetometer(&[missing], &[1, 7, 8, 9]).unwrap();
    assert!(same(&values, &[1.0, f64::NAN, 8.0, f64::NAN]), "{values:?}");
    let range = ("valid_range", AttrValue::I16Array(vec![0, 100]));
    let (values, notes) = magnetometer(&[range], &[-1, 0, 100, 101]).unwrap();
    assert!(same(&values, &[f64::NAN, 0.0, 100.0, f64::NAN]), "{values:?}");
    assert!(notes.iter().any(|n| n.contains("`mag_1_uc`: 2 values outside the valid range")), "{notes:?}");
    let unsigned = ("_Unsigned", AttrValue::String("true".into()));
    let (values, _) = magnetometer(&[unsigned], &[1, -1, i16::MIN, 0]).unwrap();
    assert!(same(&values, &[1.0, 65_535.0, 32_768.0, 0.0]), "{values:?}");
    let wrong = magnetometer(&[("scale_factor", AttrValue::String("big".into()))], &[1]).unwrap_err();
    assert!(wrong.contains("mag_1_uc") && wrong.contains("`scale_factor` must be a number, not `big`"), "{wrong}");
}
