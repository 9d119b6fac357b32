//! Damaged, truncated, oversized and unusual maps: each is read correctly or rejected with its name. None causes a
//! panic or takes more memory than its file permits.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, panic::catch_unwind, path::PathBuf};

use tempfile::TempDir;

use super::*;

fn reference() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/maps")
}

/// One file of each format and kind of layout.
const FILES: [&str; 23] = [
    "gdal.tif",
    "gdal_i16.tif",
    "gdal.nc",
    "xarray_0_360.nc",
    "xarray_ut.nc",
    "xarray_transposed.nc",
    "gmt_old_pixel.grd",
    "h5py_map.h5",
    "scipy_map.mat",
    "scipy_vector.mat",
    "h5py_map_v73.mat",
    "geosoft_float.grd",
    "geosoft_short_columns.grd",
    "geosoft_double_blocks.grd",
    "gdal_surfer7.grd",
    "gdal_surfer6.grd",
    "gdal_surfer6_text.grd",
    "text.gxf",
    "packed.gxf",
    "gdal.asc",
    "gdal.ers",
    "written/small.xyz",
    "written/small.tif",
];

fn is_text(name: &str) -> bool {
    ["gdal_surfer6_text.grd", "text.gxf", "packed.gxf", "gdal.asc", "gdal.ers", "written/small.xyz"].contains(&name)
}

fn given() -> MapOptions {
    MapOptions { epsg: Some(32630), alt_m: Some(300.0), ..MapOptions::default() }
}

/// Reads a map from bytes under the name of a file; a panic is reported with the bytes that caused it.
fn outcome(folder: &TempDir, name: &str, bytes: &[u8], what: &str) -> Result<AnomalyGrid, String> {
    let file = Path::new(name).file_name().unwrap();
    let path = folder.path().join(file);
    // A new file each time: some file systems write an overwritten one to the disk at once.
    let _ = fs::remove_file(&path);
    fs::write(&path, bytes).unwrap();
    // A file whose axes are in degrees contradicts a projected system.
    let options = match name {
        "scipy_vector.mat" => MapOptions { field_component: Some(schemas::map::VectorComponent::Down), ..given() },
        _ if name.contains("xarray") => MapOptions::default(),
        _ => given(),
    };
    let read = catch_unwind(|| read_grid(&path, &options));
    let read = read.unwrap_or_else(|_| panic!("{name}, {what}: panicked"));
    read.map_err(|e| {
        let message = e.to_string();
        assert!(message.contains("gdal") || message.contains(&*file.to_string_lossy()), "{name}, {what}: {message}");
        message
    })
}

/// Pseudo-random bits, so that the damage is reproducible.
struct Bits(u64);

impl Bits {
    fn next(&mut self) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize
    }
}

#[test]
fn unit_a_truncated_map_is_an_error() {
    let folder = TempDir::new().unwrap();
    fs::copy(reference().join("gdal"), folder.path().join("gdal")).unwrap();
    for name in FILES {
        let whole = fs::read(reference().join(name)).unwrap();
        // Truncation may shorten the last number of a string without an error; headers end in words without effect,
        // binary files in padding.
        let slack = match name {
            "gdal.ers" => 160,
            _ if is_text(name) => 9,
            _ => 3,
        };
        let step = (whole.len() / 400).max(1);
        let end = if is_text(name) { whole.trim_ascii_end().len() } else { whole.len() };
        for length in (0..end.saturating_sub(slack)).step_by(step) {
            let read = outcome(&folder, name, &whole[..length], &format!("{length} bytes"));
            assert!(read.is_err(), "{name}: {length} of {} bytes were accepted as complete", whole.len());
        }
        outcome(&folder, name, &whole, "whole").unwrap();
    }
}

#[test]
fn unit_flipped_bits_never_panic() {
    let folder = TempDir::new().unwrap();
    fs::copy(reference().join("gdal"), folder.path().join("gdal")).unwrap();
    let mut bits = Bits(20_240_229);
    for name in FILES {
        let whole = fs::read(reference().join(name)).unwrap();
        let mut faults = 0;
        for trial in 0..300 {
            let mut bytes = whole.clone();
            // Half of the flips are in the first kilobyte, which holds the structure.
            let span = if trial % 2 == 0 { bytes.len().min(1024) } else { bytes.len() };
            for _ in 0..1 + trial % 3 {
                let at = bits.next() % span;
                bytes[at] ^= 1 << (bits.next() % 8);
            }
            match outcome(&folder, name, &bytes, &format!("trial {trial}")) {
                Ok(map) => map.check().unwrap(),
                Err(_) => faults += 1,
            }
        }
        assert!(faults > 15, "{name}: {faults} of 300 damages were noticed");
    }
}

#[test]
fn unit_a_damaged_table_of_nodes_never_panics() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("m.parquet");
    let map = read_grid(&reference().join("gdal.tif"), &given()).unwrap();
    write_grid(&path, &map, None).unwrap();
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(whole.len() / 60) {
        outcome(&folder, "m.parquet", &whole[..length], &format!("{length} bytes")).unwrap_err();
    }
    let mut bits = Bits(7);
    for trial in 0..200 {
        let mut bytes = whole.clone();
        let at = bits.next() % bytes.len();
        bytes[at] ^= 1 << (bits.next() % 8);
        if let Ok(map) = outcome(&folder, "m.parquet", &bytes, &format!("trial {trial}")) {
            map.check().unwrap();
        }
    }
}

#[test]
fn unit_truncated_or_missing_cells_are_an_error() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("gdal.ers");
    fs::copy(reference().join("gdal.ers"), &path).unwrap();
    let fault = read_grid(&path, &MapOptions::default()).unwrap_err().to_string();
    assert!(fault.ends_with("gdal: the file does not exist"), "{fault}");
    let cells = fs::read(reference().join("gdal")).unwrap();
    fs::write(folder.path().join("gdal"), &cells[..139]).unwrap();
    let fault = read_grid(&path, &MapOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("it declares 7 x 5 nodes but has 139 bytes"), "{fault}");
    assert_eq!(map_files(&path).unwrap(), [path.clone(), folder.path().join("gdal")]);
}

#[test]
fn unit_an_excessive_size_in_a_small_file_is_rejected_at_once() {
    let folder = TempDir::new().unwrap();
    let mut surfer7 = fs::read(reference().join("gdal_surfer7.grd")).unwrap();
    surfer7[20..28].copy_from_slice(&[0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 0x7f]);
    let mut surfer6 = fs::read(reference().join("gdal_surfer6.grd")).unwrap();
    surfer6[4..8].copy_from_slice(&[0xff, 0x7f, 0xff, 0x7f]);
    let mut classic = fs::read(reference().join("gmt_old_node.grd")).unwrap();
    // The length of the second dimension, `xysize`, of 35.
    let at = classic.windows(8).position(|w| w == b"size\0\0\0\x23" || w == b"ze\0\0\0\0\0\x23").unwrap() + 4;
    classic[at..at + 4].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff]);
    let text = |text: &str| text.as_bytes().to_vec();
    for (name, bytes) in [
        ("a.grd", surfer7),
        ("b.grd", surfer6),
        ("c.grd", classic),
        ("d.grd", text("DSAA\n2000000000 2000000000\n0 1\n0 1\n0 1\n1 2 3\n")),
        ("e.asc", text("ncols 2000000000\nnrows 2000000000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")),
        ("f.gxf", text("#POINTS\n9000000000\n#ROWS\n9000000000\n#GTYPE\n3\n#GRID\n\"\"\"~~~%%%\n")),
        ("g.gxf", text("#POINTS\n1e18\n#ROWS\n1e18\n#GRID\n1 2\n")),
        ("h.xyz", text("x y z\n0 0 1\n1e-6 0 1\n2e-6 0 1\n0 1e-6 2\n1e6 1e6 3\n")),
    ] {
        outcome(&folder, name, &bytes, "huge").expect_err(name);
    }
}

#[test]
fn gold_unusual_texts() {
    let folder = TempDir::new().unwrap();
    let fault_text = |name: &str, text: &str| outcome(&folder, name, text.as_bytes(), text).unwrap_err();
    let infinite = outcome(&folder, "i.grd", b"DSAA\n2 2\n0 10\n0 10\n0 1\n1 2 -inf 4\n", "infinite").unwrap();
    assert!(infinite.notes.contains(&"1 infinite values are treated as unknown".to_owned()), "{:?}", infinite.notes);
    let surfer = |size: &str, x: &str, values: &str| format!("DSAA\n{size}\n{x}\n0 10\n0 1\n{values}\n");
    for (text, expected) in [
        (surfer("3 1", "0 20", "1 2 3"), "a map requires at least 2 x 2 nodes, not 3 x 1"),
        (surfer("2 2", "5 5", "1 2 3 4"), "the axis has a step of 0, which does not define a grid"),
        (surfer("2 2", "0 inf", "1 2 3 4"), "the axis begins at 0 with a step of inf, which does not define a grid"),
        (surfer("2 2", "0 10", "1 2 3 x"), "row 3: `x` is not a number"),
        (surfer("2 2", "0 10", "1 2 3"), "the file is truncated: it has 3 of 4 values"),
        (surfer("2 2", "0 10", "2e38 2e38 2e38 2e38"), "column `anomaly`: the map has no known value"),
    ] {
        let fault = fault_text("a.grd", &text);
        assert!(fault.ends_with(expected), "{fault}");
    }
    let gxf = |more: &str| format!("#POINTS\n2\n#ROWS\n2\n{more}#GRID\n1 2\n3 4\n");
    assert!(fault_text("a.gxf", &gxf("#ROTATION\n30\n")).contains("the grid is rotated (warp the grid to north-up"));
    assert!(fault_text("a.gxf", &gxf("#SENSE\n7\n")).ends_with("#SENSE 7 is invalid"));
    assert!(fault_text("a.gxf", "#POINTS\n2\n#ROWS\n2\n").ends_with("it has no #GRID"));
    assert!(
        fault_text("a.gxf", "#POINTS\n2\n#ROWS\n2\n#GTYPE\n2\n#GRID\n\"\"~~%%\n").ends_with("is longer than the grid")
    );
    for (text, expected) in [
        (
            "easting northing anomaly\n0 0 1\n1 0 1\n3 0 1\n0 1 1\n",
            "the axis is not evenly spaced: it has 1 instead of 1.5",
        ),
        ("easting northing anomaly\n0 0 1\n1 0 1\n0 1 1\n0 1 1\n", "row 3: duplicate node"),
        (
            "easting northing anomaly\n0 0 1\n1 0 1\n2 0 1\n3 0 1\n",
            "a map requires at least two nodes along each axis, not 1",
        ),
        (
            "easting northing anomaly\n0 0 1\n1 * 1\n2 0 1\n3 0 1\n",
            "column `northing`, row 1: the node has no position",
        ),
        ("a b c d\n0 0 1 2\n1 0 1 2\n2 0 1 2\n", "`easting`, `northing` and `anomaly`)"),
        ("0 0 1 2\n1 0 1 2\n2 0 1 2\n", "`lon`, `lat`, `anomaly`, or `easting`, `northing`, `anomaly`)"),
    ] {
        let fault = fault_text("a.xyz", text);
        assert!(fault.contains(expected), "{fault}");
    }
}

#[test]
fn unit_every_sense_of_gxf_gives_the_same_map() {
    // A grid of 3 columns and 2 rows; the value is 10 row + column, row 0 in the south.
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.gxf");
    for (sense, across, rows) in [
        (1, true, "0 1 2\n10 11 12"),
        (-2, true, "10 11 12\n0 1 2"),
        (3, true, "12 11 10\n2 1 0"),
        (-4, true, "2 1 0\n12 11 10"),
        (-1, false, "0 10\n1 11\n2 12"),
        (2, false, "10 0\n11 1\n12 2"),
        (-3, false, "12 2\n11 1\n10 0"),
        (4, false, "2 12\n1 11\n0 10"),
    ] {
        let (points, lines, along, between) = if across { (3, 2, 10, 20) } else { (2, 3, 20, 10) };
        let text = format!(
            "#POINTS\n{points}\n#ROWS\n{lines}\n#PTSEPARATION\n{along}\n#RWSEPARATION\n{between}\n#XORIGIN\n100\n\
             #YORIGIN\n1000\n#SENSE\n{sense}\n#GRID\n{rows}\n"
        );
        fs::write(&path, text).unwrap();
        let map = read_grid(&path, &given()).unwrap();
        assert_eq!((map.x.first, map.x.step, map.x.len, map.y.first, map.y.step), (100.0, 10.0, 3, 1000.0, 20.0));
        assert_eq!(map.anomaly_nt, [0.0, 1.0, 2.0, 10.0, 11.0, 12.0], "sense {sense}");
    }
}

#[test]
fn unit_text_conventions_of_other_programs_are_read() {
    let folder = TempDir::new().unwrap();
    let read = |name: &str, text: &str, options: &MapOptions| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        read_grid(&path, options).unwrap_or_else(|e| panic!("{text}: {e}"))
    };
    let plain = MapOptions::default();
    let degrees = "LAT,LON,TMI\n51,-5,1\n51,-4,2\n50,-5,3\n50,-4,-9999\n";
    let map = read("a.csv", degrees, &plain);
    assert_eq!((map.crs.code(), map.y.first, map.x.first), (4326, 50.0, -5.0));
    assert!(map.anomaly_nt[1].is_nan() && map.notes.iter().any(|n| n == "1 values of -9999 are treated as unknown"));
    assert_eq!(&map.anomaly_nt[2..], [1.0, 2.0]);
    let text = "# EPSG:32630 unit=uT height_m=75\n1 1 0.1\n2 1 0.2\n1 2 *\n2 2 0.4\n";
    let map = read("a.xyz", text, &plain);
    assert_eq!((map.crs.code(), &map.height), (32630, &crate::GridHeight::Level(75.0)));
    assert!((map.anomaly_nt[0] - 100.0).abs() < 1e-12 && map.anomaly_nt[2].is_nan());
    let esri = "NCOLS 2\nNROWS 2\nXLLCENTER 100\nYLLCENTER 200\nCELLSIZE 10\nNODATA_VALUE 7\n1 2\n3 7\n";
    let map = read("b.asc", esri, &given());
    assert_eq!((map.x.first, map.y.first), (100.0, 200.0));
    assert!(map.anomaly_nt[0] == 3.0 && map.anomaly_nt[1].is_nan() && map.anomaly_nt[2..] == [1.0, 2.0]);
    let gamma = MapOptions { unit: Some("T".into()), ..given() };
    let tesla =
        read("c.asc", "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1e-9 2e-9\n3e-9 4e-9\n", &gamma);
    assert!((tesla.anomaly_nt[0] - 3.0).abs() < 1e-12);
    assert_eq!((tesla.x.first, tesla.registration), (5.0, crate::Registration::Pixel));
}
