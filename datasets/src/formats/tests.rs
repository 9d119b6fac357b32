#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    fs::{self, File},
    path::PathBuf,
    sync::Arc,
};

use ::parquet::{arrow::ArrowWriter, file::properties::WriterProperties};
use arrow_array::{
    Array, ArrayRef, DictionaryArray, Float32Array, Float64Array, LargeStringArray, RecordBatch, StringViewArray,
    cast::AsArray,
    types::{Float64Type, Int32Type, Int64Type},
};
use arrow_schema::{DataType, Field, Schema};
use arrow_select::concat::concat_batches;
use tempfile::TempDir;

use super::*;
use crate::samples;

fn read(path: &Path, options: &FlightOptions) -> Result<RecordBatch, ReadError> {
    let reader = open_flight(path, options)?;
    let schema = reader.schema().clone();
    let batches = reader.collect::<Result<Vec<_>, _>>()?;
    assert!(batches.iter().all(|b| b.schema() == schema), "every batch has the reader's schema");
    Ok(concat_batches(&schema, &batches).unwrap())
}

fn sample(name: &str) -> RecordBatch {
    read(&samples::path(name), &FlightOptions::default()).unwrap()
}

fn numbers(batch: &RecordBatch, name: &str) -> Vec<f64> {
    let column = batch.column_by_name(name).unwrap_or_else(|| panic!("no column {name}"));
    column.as_primitive::<Float64Type>().values().to_vec()
}

fn texts(batch: &RecordBatch, name: &str) -> Vec<String> {
    batch.column_by_name(name).unwrap().as_string::<i32>().iter().map(|s| s.unwrap().to_owned()).collect()
}

fn unit(batch: &RecordBatch, name: &str) -> String {
    batch.schema().field_with_name(name).unwrap().metadata()["unit"].clone()
}

fn reference(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference").join(name)
}

fn written(folder: &TempDir, name: &str, text: &str) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, text).unwrap();
    path
}

fn options(flight: &str, line: &str) -> FlightOptions {
    FlightOptions { flight: Some(flight.into()), line: Some(line.into()), ..FlightOptions::default() }
}

/// Columns and rows of a small CSV file of numbers.
fn table(path: &Path) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').map(str::to_owned).collect();
    (names, lines.map(|l| l.split(',').map(|w| w.parse().unwrap()).collect()).collect())
}

#[test]
fn val_derived_columns_of_the_sgl_sample() {
    for file in ["magnavjl_sample/Flt1003_sample.xyz", "magnavjl_sample/sgl_2020.h5"] {
        let flight = sample(file);
        let (names, rows) = table(&reference("sgl_expected.csv"));
        assert_eq!(flight.num_rows(), rows.len());
        for (k, name) in names.iter().enumerate().filter(|(_, n)| *n != "ins_lat_deg") {
            for (i, (ours, row)) in numbers(&flight, name).iter().zip(&rows).enumerate() {
                // Differences of velocities: 2e-7 of 33 m/s by the radii at a sample and along the chord, and 1e-5 of
                // 3e-5 by the height factor of the geodesic. Others are printed to 1e-9.
                let tolerance = if name.starts_with('v') { 1e-4 } else { 2e-9 };
                assert!((ours - row[k]).abs() < tolerance, "{file} {name} row {i}: {ours} {}", row[k]);
            }
        }
        assert_eq!(unit(&flight, "ins_lat"), "rad");
        for (ours, row) in numbers(&flight, "ins_lat").iter().zip(&rows) {
            assert!((ours.to_degrees() - row[9]).abs() < 1e-9);
        }
        assert_eq!(texts(&flight, "flight"), ["1003"; 9]);
        let lines = ["1003.01", "1003.02", "1003.03"].map(|l| [l; 3]).concat();
        assert_eq!(texts(&flight, "line"), lines);
        assert_eq!(flight.column_by_name("year").unwrap().as_primitive::<Int64Type>().value(0), 2020);
        for gone in ["utm_z", "ins_vw", "ins_vu"] {
            assert!(flight.column_by_name(gone).is_none(), "{gone} has a canonical name");
        }
        assert_eq!(numbers(&flight, "alt")[0], 190.04);
        assert_eq!(numbers(&flight, "mag_5_uc")[0], 53676.320);
        assert_eq!(numbers(&flight, "flux_d_t")[0], 53811.282);
        // Sensors report to three digits; the HDF5 file keeps voltages in single precision.
        assert!((numbers(&flight, "vol_acc_n")[0] - -14.656).abs() < 2e-6);
    }
}

#[test]
fn unit_a_missing_value_is_nan_and_a_missing_data_set_no_column() {
    let (xyz, h5) = (sample("magnavjl_sample/Flt1003_sample.xyz"), sample("magnavjl_sample/sgl_2020.h5"));
    // The first line of the sample has no drape surface.
    assert_eq!(numbers(&xyz, "drape").iter().map(|x| x.is_nan()).collect::<Vec<_>>()[2..4], [true, false]);
    assert!(h5.column_by_name("mag_6_uc").is_none(), "there is no sixth magnetometer on this flight");
    assert!(h5.column_by_name("N").is_none() && h5.column_by_name("dt").is_none());
}

#[test]
fn unit_lines_come_one_batch_each() {
    for file in ["magnavjl_sample/Flt1003_sample.xyz", "magnavjl_sample/sgl_2020.h5"] {
        let reader = open_flight(&samples::path(file), &FlightOptions::default()).unwrap();
        let rows: Vec<usize> = reader.map(|b| b.unwrap().num_rows()).collect();
        assert_eq!(rows, [3, 3, 3], "{file}");
    }
}

#[test]
fn unit_the_simple_flight_is_the_same_in_hdf5_and_csv() {
    let (h5, csv) = (sample("simple_magnav/xyz.h5"), sample("simple_magnav/xyz.csv"));
    assert_eq!((h5.num_rows(), csv.num_rows()), (100, 100));
    for field in csv.schema().fields() {
        let (a, b) = (h5.column_by_name(field.name()), csv.column_by_name(field.name()));
        assert_eq!(a.map(|c| c.as_ref()), b.map(|c| c.as_ref()), "{}", field.name());
    }
    assert_eq!(texts(&csv, "flight"), ["1"; 100]);
    assert_eq!(texts(&csv, "line"), ["1"; 100]);
    // README of the sample: 29 km in 99 s, course about 69 degrees, level.
    let (vn, ve) = (numbers(&csv, "vn"), numbers(&csv, "ve"));
    for i in 0..100 {
        assert!((vn[i].hypot(ve[i]) - 287.0).abs() < 20.0, "{i}: {} {}", vn[i], ve[i]);
    }
    let (north, east) = (vn.iter().sum::<f64>(), ve.iter().sum::<f64>());
    assert!((east.atan2(north).to_degrees() - 69.0).abs() < 2.0, "{}", east.atan2(north).to_degrees());
    assert!(numbers(&csv, "ins_fd").iter().all(|f| (f + 9.8).abs() < 0.5));
    let given = read(&samples::path("simple_magnav/xyz.csv"), &options("K", "7")).unwrap();
    assert_eq!((texts(&given, "flight")[0].as_str(), texts(&given, "line")[0].as_str()), ("K", "7"));
}

#[test]
fn unit_renaming_takes_the_unit_from_the_name() {
    let mut options = options("tl", "1");
    for (from, to) in [("time_s", "tt"), ("flux_a_x_nt", "flux_a_x"), ("mag_1_uc_nt", "mag_1_uc")] {
        options.rename.insert(from.into(), to.into());
    }
    let flight = read(&samples::path("magnavjl_tl/magnavjl_tl.parquet"), &options).unwrap();
    assert_eq!(flight.num_rows(), 1000);
    assert_eq!(unit(&flight, "mag_1_uc"), "nT");
    assert_eq!(unit(&flight, "tt"), "s");
    assert!(flight.column_by_name("flux_a_y_nt").is_some(), "what is not renamed is kept");
    options.rename.insert("flux_a_z".into(), "flux_b_z".into());
    let fault = read(&samples::path("magnavjl_tl/magnavjl_tl.parquet"), &options).unwrap_err().to_string();
    assert!(fault.contains("no column `flux_a_z` to rename (did you mean `flux_a_z_nt`?)"), "{fault}");
}

#[test]
fn unit_an_unrenamed_column_keeps_the_unit_in_its_name() {
    let folder = TempDir::new().unwrap();
    let text =
        "flight,line,tt,MagCabin_T,GPS Alt ft,Gyro [rad/s],Flux_A,counter,mag_2_uc,cur_x\n1,1,0.5,5e-5,1,1,1,1,1,1\n";
    let path = written(&folder, "f.csv", text);
    let flight = read(&path, &FlightOptions::default()).unwrap();
    for (name, message) in [
        ("MagCabin_T", "T"),
        ("GPS Alt ft", "ft"),
        ("Gyro [rad/s]", "rad/s"),
        ("Flux_A", ""),
        ("counter", ""),
        ("mag_2_uc", "nT"),
        ("cur_x", "A"),
    ] {
        assert_eq!(unit(&flight, name), message, "{name}");
    }
    let mut options = FlightOptions::default();
    options.units.insert("counter".into(), "V".into());
    assert_eq!(unit(&read(&path, &options).unwrap(), "counter"), "V");
    assert_eq!(numbers(&flight, "MagCabin_T"), [5e-5], "the values are kept as well");
}

#[test]
fn unit_a_unit_in_the_options_overrides_the_file_and_the_name() {
    let folder = TempDir::new().unwrap();
    let field = |unit: &str| {
        Field::new("cabin_uT", DataType::Float64, true).with_metadata([("unit".to_owned(), unit.to_owned())].into())
    };
    let path = folder.path().join("f.parquet");
    let write = |unit: &str| {
        let keys = ["flight", "line", "tt"].map(|n| Field::new(n, DataType::Float64, true));
        let schema = Arc::new(Schema::new([keys.to_vec(), vec![field(unit)]].concat()));
        let columns = (0..4).map(|_| Arc::new(Float64Array::from(vec![1.0])) as ArrayRef).collect();
        let mut writer = ArrowWriter::try_new(File::create(&path).unwrap(), schema.clone(), None).unwrap();
        writer.write(&RecordBatch::try_new(schema, columns).unwrap()).unwrap();
        writer.close().unwrap();
    };
    let mut options = FlightOptions::default();
    options.rename.insert("cabin_uT".into(), "mag_4_uc".into());
    write("");
    assert_eq!(unit(&read(&path, &options).unwrap(), "mag_4_uc"), "uT");
    write("nT");
    let fault = read(&path, &options).unwrap_err().to_string();
    assert!(fault.contains("column `cabin_uT`: its name implies `uT`, but the file gives `nT`"), "{fault}");
    options.units.insert("cabin_uT".into(), "mgauss".into());
    assert_eq!(unit(&read(&path, &options).unwrap(), "mag_4_uc"), "mgauss");
}

#[test]
fn unit_a_standard_name_that_ends_in_another_unit_is_rejected() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder, "f.csv", "flight,line,tt,cur_heater_mA\n1,1,0.5,1200\n");
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    assert!(
        fault.contains("column `cur_heater_mA`: its name implies `mA`, but a column of this name must be in A"),
        "{fault}"
    );
    let mut options = FlightOptions::default();
    options.units.insert("cur_heater_mA".into(), "mA".into());
    assert_eq!(unit(&read(&path, &options).unwrap(), "cur_heater_mA"), "mA");
}

#[test]
fn gold_a_table_without_flight_and_line_is_an_error_with_a_remedy() {
    let path = samples::path("magnavjl_tl/magnavjl_tl.parquet");
    let fault = read(&path, &FlightOptions::default()).unwrap_err();
    let message = "holds no column `flight` (set `flight`, or rename the column that holds it)";
    assert!(fault.to_string().ends_with(message), "{fault}");
}

#[test]
fn unit_parquet_of_other_writers_and_row_groups_across_lines() {
    let folder = TempDir::new().unwrap();
    let n = 70_000;
    let line = |i: usize| if i < 40_000 { "a" } else { "b" };
    let dictionary: DictionaryArray<Int32Type> = (0..n).map(line).collect();
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("flight", Arc::new(LargeStringArray::from(vec!["x"; n]))),
        ("line", Arc::new(dictionary)),
        ("note", Arc::new(StringViewArray::from(vec!["a rather long text beyond twelve bytes"; n]))),
        ("tt", Arc::new((0..n).map(|i| i as f64 / 8.0).collect::<Float64Array>())),
        ("mag_1_uc", Arc::new((0..n).map(|i| Some(i as f32)).collect::<Float32Array>())),
    ];
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let path = folder.path().join("flight.bin");
    let properties = WriterProperties::builder().set_max_row_group_row_count(Some(9_999)).build();
    let mut writer = ArrowWriter::try_new(File::create(&path).unwrap(), batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    let reader = open_flight(&path, &FlightOptions::default()).unwrap();
    assert_eq!(reader.format(), "parquet", "known by its content");
    let schema = reader.schema().clone();
    let batches: Vec<_> = reader.map(Result::unwrap).collect();
    assert!(batches.iter().all(|b| b.num_rows() <= 65_536));
    let whole = concat_batches(&schema, &batches).unwrap();
    assert_eq!(whole.num_rows(), n);
    let table = schemas::canonical::FlightConversion::new(&schema).unwrap().apply(&whole).unwrap();
    assert_eq!(texts(&table, "line")[39_999..40_001], ["a", "b"]);
    assert_eq!(numbers(&table, "mag_1_uc")[69_999], 69_999.0);
}

#[test]
fn unit_every_sample_becomes_canonical() {
    for name in ["magnavjl_sample/Flt1003_sample.xyz", "magnavjl_sample/sgl_2020.h5", "simple_magnav/xyz.h5"] {
        let flight = sample(name);
        let table = schemas::canonical::FlightConversion::new(&flight.schema()).unwrap().apply(&flight).unwrap();
        let off = numbers(&table, "ins_lat")[0] - numbers(&table, "lat")[0];
        assert!(off.abs() < 0.01, "{name}: degrees in the end");
    }
}

#[test]
fn unit_csv_types_are_inferred_from_the_whole_file() {
    let folder = TempDir::new().unwrap();
    let text = "flight,line,tt,mag_1_uc,event,year,extra\n7,1.10,0.0,50000,1,2020,1\n7,1.10,0.1,*,flaps,2020,\n\
                7,1.20,0.2,,2,,NaN\n";
    let flight = read(&written(&folder, "f.csv", text), &FlightOptions::default()).unwrap();
    assert_eq!(texts(&flight, "line"), ["1.10", "1.10", "1.20"], "identifiers keep their spelling");
    assert_eq!(texts(&flight, "event"), ["1", "flaps", "2"]);
    let mag = numbers(&flight, "mag_1_uc");
    assert!(mag[0] == 50000.0 && mag[1].is_nan() && mag[2].is_nan());
    let extra = numbers(&flight, "extra");
    assert!(extra[0] == 1.0 && extra[1].is_nan() && extra[2].is_nan());
    let year = flight.column_by_name("year").unwrap().as_primitive::<Int64Type>();
    assert!(year.value(0) == 2020 && year.is_null(2));
}

#[test]
fn gold_faults_of_a_csv_are_reported_with_their_place() {
    let folder = TempDir::new().unwrap();
    let head = "flight,line,tt,mag_1_uc\n7,1,0.0,1.5\n";
    for (name, tail, message) in [
        ("ragged", "7,1,0.1\n", "row 1: the row has 3 values, but the header has 4 (line 3 of the file)"),
        (
            "word",
            "7,1,0.1,high\n",
            "column `mag_1_uc`, row 1: `high` is not a number (line 3 of the file; if the text marks a missing value, \
             add it to `missing`)",
        ),
        ("comma", "7,1,0.1,1,5\n", "row 1: the row has 5 values, but the header has 4 (line 3 of the file)"),
    ] {
        let path = written(&folder, &format!("{name}.csv"), &format!("{head}{tail}"));
        let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
        assert_eq!(fault, format!("{}, {message}", path.display()));
    }
    let path = written(&folder, "twice.csv", "tt,lat,tt\n1,2,3\n");
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    assert_eq!(fault, format!("{}, column `tt`: the header names the column twice", path.display()));
    let path = written(&folder, "bytes.csv", "flight,line,tt\n");
    fs::write(&path, b"flight,line,tt\n1,1,\xff\n").unwrap();
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("row 0: is not UTF-8 text"), "{fault}");
    // Files in the encodings and separators of spreadsheets of other countries and systems.
    let utf16: Vec<u8> = "\u{feff}flight,line,tt\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    fs::write(&path, utf16).unwrap();
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("is text in UTF-16 (save it as UTF-8)"), "{fault}");
    for text in ["flight;line;tt;mag_1_uc\n1;1;0,5;51336,25\n", "flight\tline\ttt\tmag_1_uc\n1\t1\t0.5\t51336.25\n"] {
        fs::write(&path, text).unwrap();
        let found = read(&path, &FlightOptions::default()).unwrap();
        assert_eq!((numbers(&found, "tt"), numbers(&found, "mag_1_uc")), (vec![0.5], vec![51_336.25]), "{text}");
    }
    // A row of another length has its place in the original file.
    fs::write(&path, "# a comment\nflight;line;tt\n1;1;0,5\n1;1\n").unwrap();
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("the row has 2 values, but the header has 3 (line 4 of the file)"), "{fault}");
}

#[test]
fn unit_non_ascii_text_is_read_as_text() {
    let folder = TempDir::new().unwrap();
    let text = "\u{feff}flight,line,tt,note µ\n1,1,0.5,Übung\n";
    let flight = read(&written(&folder, "f.dat", text), &FlightOptions::default()).unwrap();
    assert_eq!(texts(&flight, "note µ"), ["Übung"]);
    assert_eq!(texts(&flight, "flight"), ["1"], "the byte-order mark is no part of the name");
}

#[test]
fn gold_files_of_unknown_format() {
    let folder = TempDir::new().unwrap();
    let default = FlightOptions::default();
    let fault_text = |path: &Path, options: &FlightOptions| open_flight(path, options).unwrap_err().to_string();
    let path = written(&folder, "a.dat", "\0\u{1}\u{2}");
    let known = "known here: parquet, ulog, dataflash, mat, sgl_hdf5, magnav_hdf5, geosoft_xyz, sgl_xyz, magnav_csv, \
                 iaga2002, imf, mfam, csv, points; choose one with `format`";
    assert_eq!(fault_text(&path, &default), format!("{}: is not in a known flight format ({known})", path.display()));
    let named = FlightOptions { format: Some("parqet".into()), ..default.clone() };
    let expected = format!("{}: there is no flight format `parqet` (did you mean `parquet`?)", path.display());
    assert_eq!(fault_text(&path, &named), expected);
    let path = written(&folder, "empty.h5", "");
    assert_eq!(fault_text(&path, &default), format!("{}: the file is empty", path.display()));
    let path = folder.path().join("none.csv");
    assert_eq!(fault_text(&path, &default), format!("{}: the file does not exist", path.display()));
    let map = read_map(&written(&folder, "b.bin", "\0"), &MapOptions::default()).unwrap_err().to_string();
    assert!(
        map.ends_with(
            "is not in a known map format (known here: parquet, geotiff, magnav_hdf5, magnav_mat, netcdf, surfer7, \
             surfer6, surfer6_text, geosoft_grd, gxf, er_mapper, esri_ascii, magnav_csv, emag2_csv, xyz; choose one \
             with `format`)"
        ),
        "{map}"
    );
}

#[test]
fn gold_a_short_row_of_an_xyz_file_is_an_error() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder, "a.xyz", "/ one\n/ LINE FLT TIME LAT\n 1.01 1 0.0 45\n 1.01 1 0.1\n");
    let fault = read(&path, &FlightOptions::default()).unwrap_err().to_string();
    let message = "row 1: the row has 3 values, but the header has 4 (line 4 of the file)";
    assert_eq!(fault, format!("{}, {message}", path.display()));
}

#[test]
fn unit_positions_in_radians_are_rejected() {
    // MagNav.jl 1.3.3 saves simulated flights in radians and reads them as degrees.
    let folder = TempDir::new().unwrap();
    let tt: Vec<f64> = (0..20).map(f64::from).collect();
    let mut table = crate::table::ColumnTable::default();
    for (name, values) in [
        ("tt", tt.clone()),
        ("lat", tt.iter().map(|t| 0.7 + t * 1e-5).collect()),
        ("lon", vec![-1.3; 20]),
        ("alt", vec![1000.0; 20]),
        ("vn", vec![63.6; 20]),
        ("ve", vec![0.0; 20]),
    ] {
        table.push(name, "", crate::table::ColumnValues::Number(values));
    }
    let fault = magnav_hdf5::refuse_radians(folder.path(), &table).unwrap_err().to_string();
    assert!(fault.contains("are in radians"), "{fault}");
}

/// Reads a file as flight or map and returns the result; a reader must not panic.
fn outcome(path: &Path, map: bool) -> Result<(), String> {
    if map {
        let options = MapOptions { alt_m: Some(300.0), ..MapOptions::default() };
        return read_map(path, &options).map(|_| ()).map_err(|e| e.to_string());
    }
    let options = options("1", "1");
    let mut reader = open_flight(path, &options).map_err(|e| e.to_string())?;
    reader.try_for_each(|b| b.map(|_| ()).map_err(|e| e.to_string()))
}

const DAMAGED: [(&str, bool); 8] = [
    ("magnavjl_tl/magnavjl_tl.parquet", false),
    ("magnavjl_sample/Flt1003_sample.xyz", false),
    ("magnavjl_sample/sgl_2020.h5", false),
    ("simple_magnav/xyz.csv", false),
    ("simple_magnav/xyz.h5", false),
    ("simple_magnav/map.h5", true),
    ("osborne/osborne_anomaly_100m_at_500m.tif", true),
    ("britain/britain_sw_anomaly_500m_at_750m.tif", true),
];

fn extension(name: &str) -> String {
    Path::new(name).extension().unwrap().to_string_lossy().into_owned()
}

#[test]
fn unit_a_truncated_file_is_an_error_with_its_name() {
    let folder = TempDir::new().unwrap();
    for (name, map) in DAMAGED {
        let whole = fs::read(samples::path(name)).unwrap();
        let path = folder.path().join(format!("cut.{}", extension(name)));
        let text = ["csv", "xyz"].contains(&extension(name).as_str());
        for k in 0..40 {
            let length = whole.len() * k / 40;
            // A new file each time: some file systems write an overwritten one to the disk at once.
            let _ = fs::remove_file(&path);
            fs::write(&path, &whole[..length]).unwrap();
            match outcome(&path, map) {
                Err(message) => assert!(message.contains("cut."), "{name} {length}: {message}"),
                // Text that is truncated at the end of a row is a shorter table.
                Ok(()) => assert!(text, "{name}: {length} bytes were accepted as complete"),
            }
        }
    }
}

#[test]
fn unit_flipped_bytes_never_panic() {
    let folder = TempDir::new().unwrap();
    for (name, map) in DAMAGED {
        let whole = fs::read(samples::path(name)).unwrap();
        let path = folder.path().join(format!("flip.{}", extension(name)));
        let mut faults = 0;
        for k in 0..60_usize {
            let mut bytes = whole.clone();
            // Half of the changes are in the first kilobytes, which hold the structure.
            let span = if k % 2 == 0 { bytes.len().min(4096) } else { bytes.len() };
            let at = (k * 7919 + 13) * 31 % span;
            bytes[at] ^= 1 << (k % 8);
            let _ = fs::remove_file(&path);
            fs::write(&path, &bytes).unwrap();
            if let Err(message) = outcome(&path, map) {
                assert!(message.contains("flip."), "{name} {at}: {message}");
                faults += 1;
            }
        }
        assert!(faults > 0, "{name}: no damage was noticed");
    }
}
