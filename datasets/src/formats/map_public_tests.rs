//! Maps of MagNav.jl, EMAG2 and Geosoft, written by h5py, SciPy and Python (`reference/maps/make_maps.py`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, path::PathBuf};

use schemas::map::VectorComponent;
use tempfile::TempDir;

use super::*;
use grids::GridHeight;

fn reference(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/maps").join(name)
}

fn value(column: usize, row: usize) -> f64 {
    let (i, j) = (column as f64, row as f64);
    if (column, row) == (2, 1) { f64::NAN } else { 100.0 + 3.0 * i - 5.0 * j + 0.25 * i * j }
}

/// Asserts that a map has the values `factor` times those of the reference, plus `offset`.
fn check(map: &AnomalyGrid, factor: f64, offset: f64) {
    assert_eq!((map.x.len, map.y.len), (7, 5));
    for (node, found) in map.anomaly_nt.iter().enumerate() {
        let expected = factor * value(node % 7, node / 7) + offset;
        assert!(found.is_nan() && expected.is_nan() || *found == expected, "node {node}: {found}, {expected}");
    }
}

fn of(component: Option<VectorComponent>) -> MapOptions {
    MapOptions { field_component: component, ..MapOptions::default() }
}

fn fault(path: &Path, options: &MapOptions) -> String {
    read_grid(path, options).unwrap_err().to_string()
}

#[test]
fn val_matlab_maps_of_scipy_and_h5py() {
    for name in ["scipy_map.mat", "h5py_map_v73.mat"] {
        let map = read_grid(&reference(name), &MapOptions::default()).unwrap();
        assert_eq!(
            (map.format, map.crs.code(), &map.height),
            ("magnav_mat", 4326, &GridHeight::Level(300.0)),
            "{name}"
        );
        assert!((map.x.first + 5.0).abs() < 1e-12 && (map.y.last() - 51.04).abs() < 1e-12, "{name}");
        check(&map, 1.0, 0.0);
    }
}

#[test]
fn val_vector_maps_of_h5py_and_scipy_have_three_components() {
    for (name, format) in [("h5py_vector.h5", "magnav_hdf5"), ("scipy_vector.mat", "magnav_mat")] {
        for (component, factor, offset) in [
            (VectorComponent::North, 1.0, -100.0),
            (VectorComponent::East, 1.0, 0.0),
            (VectorComponent::Down, 2.0, 0.0),
        ] {
            let map = read_grid(&reference(name), &of(Some(component))).unwrap();
            assert_eq!((map.format, &map.height), (format, &GridHeight::Level(300.0)));
            // North is exactly 0 at the first node, which is known.
            check(&map, factor, offset);
            let note = format!("the values are the {} component of the field", component.word());
            assert!(map.notes.iter().any(|n| n.starts_with(&note)), "{:?}", map.notes);
        }
        let unset = fault(&reference(name), &of(None));
        assert!(unset.contains("set `field_component` to `north`, `east` or `down`"), "{unset}");
    }
    let scalar = fault(&reference("scipy_map.mat"), &of(Some(VectorComponent::East)));
    assert!(
        scalar.contains("holds one map, not components, so `east` has no meaning (remove `field_component`)"),
        "{scalar}"
    );
}

/// A folder of CSV files of MagNav.jl with two longitudes and two latitudes.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = TempDir::new().unwrap();
    for (name, text) in files {
        fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

#[test]
fn unit_vector_maps_as_csv_with_unknown_and_zero_nodes() {
    let files = [
        ("xx.csv", "10\n11\n"),
        ("yy.csv", "50\n51\n"),
        ("alt.csv", "500\n"),
        ("mapX.csv", "0,1\nNaN,0\n"),
        ("mapY.csv", "2,3\n4,0\n"),
        ("mapZ.csv", "5,6\n7,0\n"),
    ];
    let whole = folder(&files);
    let north = read_grid(whole.path(), &of(Some(VectorComponent::North))).unwrap();
    assert_eq!(north.format, "magnav_csv");
    assert!(north.anomaly_nt[..2] == [0.0, 1.0] && north.anomaly_nt[2..].iter().all(|v| v.is_nan()), "{north:?}");
    let down = read_grid(whole.path(), &of(Some(VectorComponent::Down))).unwrap();
    assert!(down.anomaly_nt[..3] == [5.0, 6.0, 7.0] && down.anomaly_nt[3].is_nan());
    let mut short = files;
    short[5].1 = "5,6\n";
    let size = fault(folder(&short).path(), &of(Some(VectorComponent::Down)));
    assert!(size.contains("must have the 2 longitudes of `xx` and the 2 latitudes of `yy`"), "{size}");
    let csv = MapOptions { format: Some("magnav_csv".into()), ..of(Some(VectorComponent::Down)) };
    let missing = fault(folder(&files[..5]).path(), &csv);
    assert!(missing.contains("mapZ.csv: the file does not exist"), "{missing}");
}

#[test]
fn unit_coordinates_in_radians_are_rejected_unless_epsg_confirms_degrees() {
    let files =
        [("xx.csv", "-1.32,-1.31\n"), ("yy.csv", "0.78,0.79\n"), ("alt.csv", "500\n"), ("map.csv", "1,2\n3,4\n")];
    let radians = folder(&files);
    let unset = fault(radians.path(), &MapOptions::default());
    assert!(unset.contains("the coordinates look like radians") && unset.contains("file_units = :rad"), "{unset}");
    let confirmed = MapOptions { epsg: Some(4326), ..MapOptions::default() };
    assert_eq!(read_grid(radians.path(), &confirmed).unwrap().y.first, 0.78);
}

#[test]
fn val_emag2_has_two_levels_and_unknown_cells() {
    let at = |alt_m: f64| MapOptions { alt_m: Some(alt_m), ..MapOptions::default() };
    let path = reference("emag2_v3.csv");
    let high = read_grid(&path, &at(4000.0)).unwrap();
    assert_eq!((high.format, high.crs.code(), &high.height), ("emag2_csv", 4326, &GridHeight::Level(4000.0)));
    // Longitudes of 355 degrees and more are shifted by 360 degrees.
    assert!((high.x.first - (-5.0 + 1.0 / 60.0)).abs() < 1e-6 && (high.y.first - (51.0 + 1.0 / 60.0)).abs() < 1e-6);
    check(&high, 1.0, 0.0);
    check(&read_grid(&path, &at(0.0)).unwrap(), 2.0, 0.0);
    for options in [MapOptions::default(), at(300.0)] {
        let text = fault(&path, &options);
        assert!(text.contains("set `alt_m` to 0 or 4000 to select one"), "{text}");
    }
}

#[test]
fn gold_damaged_emag2_files_name_the_row() {
    let text = fs::read_to_string(reference("emag2_v3.csv")).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("e.csv");
    let options = MapOptions { alt_m: Some(4000.0), ..MapOptions::default() };
    let read = |text: &str| {
        fs::write(&path, text).unwrap();
        read_grid(&path, &options).map_err(|e| e.to_string())
    };
    assert!(read(&text[..text.len() - 4]).unwrap_err().contains("the file is cut short"));
    let wrong = |change: &dyn Fn(&mut Vec<String>)| {
        let mut rows: Vec<String> = rows.iter().map(ToString::to_string).collect();
        change(&mut rows);
        read(&(rows.join("\n") + "\n"))
    };
    let field = |at: usize, to: &str| {
        let mut words: Vec<&str> = rows[9].split(',').collect();
        words[at] = to;
        words.join(",")
    };
    for (at, to) in [(2, "355.10"), (3, "north"), (0, "-1"), (1, "1e9"), (7, "")] {
        let found = wrong(&|rows| rows[9] = field(at, to));
        assert!(at == 7 && found.is_ok() || found.as_ref().is_err_and(|e| e.contains("row 9")), "{at}: {found:?}");
    }
    assert!(wrong(&|rows| rows.push(rows[9].clone())).unwrap_err().contains("row 35: duplicate cell"));
    let moved = wrong(&|rows| rows[9] = field(2, "355.116667")).unwrap_err();
    assert!(moved.contains("has the coordinate 355.116667, but a different coordinate in an earlier row"), "{moved}");
    // A cell far away declares a grid of millions of cells.
    let far = "1,1,0.016667,-89.983333,1.00,1.00,1,1".to_owned();
    assert!(wrong(&|rows| rows.push(far.clone())).is_err());
    let absent = wrong(&|rows| drop(rows.remove(10))).unwrap();
    assert!(absent.anomaly_nt[10].is_nan() && absent.notes.iter().any(|n| n.starts_with("1 cells of the region")));
}

#[test]
fn val_geosoft_grids_of_three_layouts() {
    let utm = MapOptions { epsg: Some(32630), ..MapOptions::default() };
    for name in ["geosoft_float.grd", "geosoft_short_columns.grd", "geosoft_double_blocks.grd"] {
        let path = reference(name);
        let map = read_grid(&path, &utm).unwrap();
        assert_eq!((map.format, map.x.first, map.y.first), ("geosoft_grd", 370_000.0, 5_676_500.0), "{name}");
        assert_eq!((map.x.step, map.y.step), (500.0, 500.0));
        check(&map, 1.0, 0.0);
        assert!(fault(&path, &MapOptions::default()).contains("set `epsg`"), "{name}");
    }
}

#[test]
fn gold_geosoft_grids_that_are_not_read_say_why() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("g.grd");
    let utm = MapOptions { epsg: Some(32630), ..MapOptions::default() };
    let whole = fs::read(reference("geosoft_float.grd")).unwrap();
    let changed = |at: usize, bytes: &[u8]| {
        let mut file = whole.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        fs::write(&path, file).unwrap();
        fault(&path, &utm)
    };
    assert!(changed(52, &30.0_f64.to_le_bytes()).contains("the grid is rotated by 30 degrees"));
    assert!(changed(4, &3_i32.to_le_bytes()).contains("are not numbers (export the grid as GXF or ER Mapper)"));
    assert!(changed(16, &2_i32.to_le_bytes()).contains("the orientation 2 of the grid is not supported"));
    assert!(changed(8, &1_000_000_i32.to_le_bytes()).contains("it declares 1000000 x 5 nodes but has 140 bytes"));
    assert!(changed(68, &0.0_f64.to_le_bytes()).contains("the scale inf"), "a multiplier of 0");
    let packed = fs::read(reference("geosoft_double_blocks.grd")).unwrap();
    let blocks = |at: usize, bytes: &[u8]| {
        let mut file = packed.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        fs::write(&path, file).unwrap();
        fault(&path, &utm)
    };
    assert!(blocks(8, &2_000_000_000_i32.to_le_bytes()).contains("it declares 2000000000 x 5 nodes"));
    assert!(blocks(8, &70_i32.to_le_bytes()).contains("hold 280 of 2800 bytes of the grid"));
    assert!(blocks(8, &3_i32.to_le_bytes()).contains("hold more than the 120 bytes of the grid"));
    assert!(blocks(520, &1_000_000_i32.to_le_bytes()).contains("it declares 1000000 compressed blocks"));
    assert!(blocks(528, &u64::MAX.to_le_bytes()).contains("the file is truncated in the compressed block 0"));
    assert!(blocks(570, &[0; 4]).contains("the compressed block 0 is damaged"));
}
