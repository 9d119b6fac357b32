#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, path::PathBuf};

use numerics::maps::plane_grid::EvenAxis;
use tempfile::TempDir;

use super::*;
use grids::{Crs, GridHeight, Registration};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/maps")
}

fn epsg(code: u16) -> MapOptions {
    MapOptions { epsg: Some(code), ..MapOptions::default() }
}

fn axis(first: f64, step: f64, len: usize) -> EvenAxis {
    EvenAxis { first, step, len }
}

/// The map of `reference/maps/make_maps.py`: 7 x 5 nodes, one unknown.
fn value(column: usize, row: usize) -> f64 {
    let (i, j) = (column as f64, row as f64);
    if (column, row) == (2, 1) { f64::NAN } else { 100.0 + 3.0 * i - 5.0 * j + 0.25 * i * j }
}

fn small(geographic: bool) -> AnomalyGrid {
    let values = (0..5).flat_map(|j| (0..7).map(move |i| value(i, j))).collect();
    let (x, y, code) = match geographic {
        true => (axis(-5.0, 0.01, 7), axis(51.0, 0.01, 5), 4326),
        false => (axis(370_000.0, 500.0, 7), axis(5_676_500.0, 500.0, 5), 32630),
    };
    let crs = Crs::from_epsg(Path::new("small"), code).unwrap();
    AnomalyGrid::new(x, y, crs, values, GridHeight::Level(300.0)).unwrap()
}

fn same_axis(a: &EvenAxis, b: &EvenAxis) -> bool {
    // Coordinates in text or computed from corners have errors of a few roundings of the largest coordinate.
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b.abs().max(1.0);
    a.len == b.len && close(a.first, b.first) && close(a.last(), b.last())
}

/// The largest difference of two maps' values, which are unknown at the same nodes.
fn difference(a: &AnomalyGrid, b: &AnomalyGrid) -> f64 {
    assert!(same_axis(&a.x, &b.x) && same_axis(&a.y, &b.y), "{:?} {:?} {:?} {:?}", a.x, b.x, a.y, b.y);
    let pairs = a.anomaly_nt.iter().zip(&b.anomaly_nt);
    pairs.fold(0.0, |most: f64, (a, b)| {
        assert_eq!(a.is_nan(), b.is_nan());
        if a.is_nan() { most } else { most.max((a - b).abs()) }
    })
}

mod val_other_programs {
    use super::*;

    fn check(name: &str, geographic: bool, options: &MapOptions) -> AnomalyGrid {
        let map = read_grid(&folder().join(name), options).unwrap_or_else(|e| panic!("{e}"));
        let expected = small(geographic);
        assert_eq!(map.crs, expected.crs, "{name}");
        // Every value is a multiple of 0.25 below 2^8, which is exact in single precision and in 16 scaled bits.
        let worst = difference(&map, &expected);
        assert!(worst < 1e-12, "{name}: {worst}");
        map
    }

    #[test]
    fn val_projected_maps_with_a_coordinate_system() {
        let default = MapOptions::default();
        for (name, format) in [
            ("gdal.tif", "geotiff"),
            ("gdal.asc", "esri_ascii"),
            ("gdal.nc", "netcdf"),
            ("gdal_nc4.nc", "netcdf"),
            ("gdal.ers", "er_mapper"),
            ("text.gxf", "gxf"),
            ("packed.gxf", "gxf"),
        ] {
            assert_eq!(check(name, false, &default).format, format, "{name}");
        }
    }

    #[test]
    fn val_projected_maps_that_need_a_code() {
        for (name, format) in [
            ("gdal_surfer7.grd", "surfer7"),
            ("surfer7_v2.grd", "surfer7"),
            ("gdal_surfer6.grd", "surfer6"),
            ("gdal_surfer6_text.grd", "surfer6_text"),
            ("gmt_old_node.grd", "netcdf"),
            ("gdal.xyz", "xyz"),
        ] {
            let fault = read_grid(&folder().join(name), &MapOptions::default()).unwrap_err().to_string();
            assert!(fault.contains("set `epsg`"), "{name}: {fault}");
            assert_eq!(check(name, false, &epsg(32630)).format, format, "{name}");
        }
        let pixel = check("gmt_old_pixel.grd", false, &epsg(32630));
        assert_eq!(pixel.registration, Registration::Pixel);
        assert!(pixel.notes.iter().any(|n| n.contains("edges of cells")), "{:?}", pixel.notes);
    }

    #[test]
    fn val_geographic_maps_in_any_order_of_rows() {
        let default = MapOptions::default();
        for name in ["gdal_geographic.nc", "xarray_down.nc", "xarray_transposed.nc", "xarray_0_360.nc", "h5py_map.h5"] {
            let map = check(name, true, &default);
            assert_eq!(map.notes.iter().any(|n| n.contains("355")), name == "xarray_0_360.nc", "{:?}", map.notes);
        }
        let map = check("xarray_ut.nc", true, &default);
        assert!(map.notes.iter().any(|n| n == "values in uT are multiplied by 1000 to give nT"), "{:?}", map.notes);
        let fault = read_grid(&folder().join("xarray_mgal.nc"), &default).unwrap_err().to_string();
        assert!(fault.ends_with("column `anomaly`: the unit `mGal` does not convert to nT"), "{fault}");
        let in_nt = MapOptions { unit: Some("nT".into()), ..MapOptions::default() };
        check("xarray_mgal.nc", true, &in_nt);
    }

    #[test]
    fn gold_rasters_that_are_not_maps() {
        for (name, expected) in [
            ("gdal_rotated.tif", "the grid is rotated (warp the grid to north-up first)"),
            ("gdal_nowhere.tif", "the file lacks the positions of its cells (tags ModelPixelScale and ModelTiepoint)"),
            ("gdal_two_bands.tif", "a map must have one band, not "),
            ("gdal_unknown.tif", "column `anomaly`: the map has no known value"),
            (
                "gdal_uncoded.tif",
                "the file does not give the coordinate system of its eastings and northings (set `epsg` to the code of",
            ),
        ] {
            let fault = read_grid(&folder().join(name), &MapOptions::default()).unwrap_err().to_string();
            assert!(fault.contains(expected), "{name}: {fault}");
        }
    }

    #[test]
    fn val_sixteen_bit_maps_with_a_no_data_value() {
        let map = read_grid(&folder().join("gdal_i16.tif"), &MapOptions::default()).unwrap();
        let whole: Vec<f64> = small(false).anomaly_nt.iter().map(|v| v.trunc()).collect();
        assert!(difference(&map, &small(false).with_plane_values(whole).unwrap()) == 0.0);
    }
}

mod round_trips {
    use super::*;

    /// Properties of a map that each format keeps.
    struct Kept {
        format: &'static str,
        file: &'static str,
        /// Values in single precision.
        single: bool,
        /// Whether reading requires the code.
        needs_code: bool,
        height: bool,
        varying: bool,
        geographic_only: bool,
    }

    const fn kept(format: &'static str, file: &'static str) -> Kept {
        Kept { format, file, single: false, needs_code: false, height: true, varying: false, geographic_only: false }
    }

    const ALL: [Kept; 11] = [
        Kept { varying: true, ..kept("parquet", "m.parquet") },
        kept("geotiff", "m.tif"),
        Kept { varying: true, ..kept("netcdf", "m.nc") },
        Kept { varying: true, geographic_only: true, ..kept("magnav_hdf5", "m.h5") },
        Kept { varying: true, ..kept("xyz", "m.xyz") },
        Kept { varying: true, ..kept("xyz", "m.csv") },
        Kept { needs_code: true, height: false, ..kept("surfer7", "m7.grd") },
        Kept { needs_code: true, height: false, single: true, ..kept("surfer6", "m6.grd") },
        Kept { needs_code: true, height: false, ..kept("surfer6_text", "mt.grd") },
        Kept { height: false, ..kept("gxf", "m.gxf") },
        Kept { height: false, ..kept("er_mapper", "m.ers") },
    ];

    /// Values of many magnitudes and spellings, a tenth of them unknown.
    fn rough(geographic: bool, registration: Registration) -> AnomalyGrid {
        let values = (0..35_u64).map(|i| match i % 10 {
            3 => f64::NAN,
            4 => 0.0,
            _ => (i as f64 - 17.3) * 10_f64.powi(i as i32 % 7 - 3) / 7.0,
        });
        let map = small(geographic);
        AnomalyGrid { registration, ..map.with_plane_values(values.collect()).unwrap() }
    }

    fn check(folder: &TempDir, kept: &Kept, map: &AnomalyGrid) {
        let path = folder.path().join(kept.file);
        write_grid(&path, map, Some(kept.format)).unwrap_or_else(|e| panic!("{}: {e}", kept.format));
        let options = MapOptions { epsg: kept.needs_code.then_some(map.crs.code()), ..MapOptions::default() };
        let back = read_grid(&path, &options).unwrap_or_else(|e| panic!("{}: {e}", kept.format));
        assert_eq!((back.format, &back.crs), (kept.format, &map.crs));
        if ["geotiff", "netcdf"].contains(&kept.format) {
            assert_eq!(back.registration, map.registration);
        }
        let worst = difference(&back, map);
        // Half a unit in the last place of single precision of 2400 nT; else exact.
        let most = if kept.single { 2400.0 * f64::from(f32::EPSILON) / 2.0 } else { f64::MIN_POSITIVE };
        assert!(worst <= most, "{}: {worst}", kept.format);
        match (&back.height, &map.height) {
            (GridHeight::Level(a), GridHeight::Level(b)) => assert!(if kept.height { a == b } else { a.is_nan() }),
            (a, b) => assert_eq!(a, b, "{}", kept.format),
        }
        let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert!(left.iter().all(|n| !n.to_string_lossy().contains("part")), "{left:?}");
    }

    #[test]
    fn unit_a_written_map_is_read_back() {
        let folder = TempDir::new().unwrap();
        for registration in [Registration::Node, Registration::Pixel] {
            for kept in &ALL {
                check(&folder, kept, &rough(true, registration));
                if !kept.geographic_only {
                    check(&folder, kept, &rough(false, registration));
                }
            }
        }
        check(&folder, &Kept { height: false, ..kept("esri_ascii", "m.asc") }, &rough(false, Registration::Pixel));
        let oblong = AnomalyGrid { y: axis(5_676_500.0, 250.0, 5), ..rough(false, Registration::Node) };
        check(&folder, &Kept { height: false, ..kept("esri_ascii", "m.asc") }, &oblong);
    }

    #[test]
    fn unit_a_drape_is_stored_or_rejected() {
        let folder = TempDir::new().unwrap();
        let heights = (0..35).map(|i| 100.0 + f64::from(i) / 3.0).collect();
        let drape = AnomalyGrid { height: GridHeight::Cells(heights), ..small(true) };
        for kept in &ALL {
            if kept.varying {
                check(&folder, kept, &drape);
                continue;
            }
            let path = folder.path().join("drape").with_extension(kept.file.split('.').nth(1).unwrap());
            let fault = write_grid(&path, &drape, Some(kept.format)).unwrap_err().to_string();
            assert!(fault.contains("the height of the map varies") && !path.exists(), "{fault}");
        }
    }

    #[test]
    fn unit_coordinate_systems_are_kept() {
        let folder = TempDir::new().unwrap();
        for code in [32630, 32754, 28354, 7854, 27700, 3857, 2193, 4283, 2263] {
            let crs = Crs::from_epsg(Path::new("a"), code).unwrap();
            let (x, y) = if crs.is_geographic() { (140.0, -30.0) } else { (300_000.0, 200_000.0) };
            let step = if crs.is_geographic() { 0.25 } else { 100.0 };
            let map = AnomalyGrid { x: axis(x, step, 7), y: axis(y, step, 5), crs, ..small(false) };
            for kept in ALL.iter().filter(|k| !k.needs_code && !k.geographic_only) {
                check(&folder, kept, &map);
            }
            check(&folder, &Kept { height: false, ..kept("esri_ascii", "m.asc") }, &map);
        }
    }

    #[test]
    fn gold_maps_that_cannot_be_written() {
        let folder = TempDir::new().unwrap();
        let fault_text = |name: &str, format: Option<&str>, map: &AnomalyGrid| {
            let fault = write_grid(&folder.path().join(name), map, format).unwrap_err().to_string();
            fault.split_once(name).unwrap().1.to_owned()
        };
        let map = small(false);
        let written = "the formats that can be written are parquet, geotiff, magnav_hdf5, netcdf, surfer7, surfer6, \
                       surfer6_text, gxf, er_mapper, esri_ascii, xyz";
        assert_eq!(
            fault_text("a.bin", None, &map),
            format!(": the extension belongs to no writable map format ({written})")
        );
        assert_eq!(
            fault_text("a.grd", None, &map),
            ": the extension belongs to several map formats: netcdf, surfer7, surfer6, surfer6_text (choose one with \
             `format`)"
        );
        assert_eq!(
            fault_text("a.tif", Some("geotif"), &map),
            ": there is no map format `geotif` (did you mean `geotiff`?)"
        );
        assert_eq!(
            fault_text("map.csv", Some("magnav_csv"), &map),
            format!(": the map format `magnav_csv` can be read, but not written ({written})")
        );
        assert!(
            fault_text("a.h5", None, &map)
                .contains("not EPSG:32630 (WGS 84 / UTM zone 30N) (convert the map to EPSG:4326")
        );
        fs::create_dir(folder.path().join("taken.tif")).unwrap();
        fault_text("taken.tif", None, &map);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing half-written is left");
    }

    /// The map in a file as text, without its source.
    fn unpacked(path: &Path) -> String {
        format!("{:?}", AnomalyGrid { source: PathBuf::new(), ..read_grid(path, &MapOptions::default()).unwrap() })
    }

    /// The small map in every format, in files that other programs have read (`reference/maps/check_maps.py`). A
    /// missing file is written, and must be checked with that script before it is committed.
    #[test]
    fn gold_bytes_that_other_programs_have_read() {
        let written = super::folder().join("written");
        let mut made = vec![];
        for (name, format, geographic) in [
            ("small.tif", "geotiff", false),
            ("small_geographic.tif", "geotiff", true),
            ("small.nc", "netcdf", false),
            ("small_geographic.nc", "netcdf", true),
            ("small.h5", "magnav_hdf5", true),
            ("surfer7.grd", "surfer7", false),
            ("surfer6.grd", "surfer6", false),
            ("surfer6_text.grd", "surfer6_text", false),
            ("small.gxf", "gxf", false),
            ("small.ers", "er_mapper", false),
            ("small_geographic.ers", "er_mapper", true),
            ("small.asc", "esri_ascii", false),
            ("small.xyz", "xyz", false),
        ] {
            let folder = TempDir::new().unwrap();
            write_grid(&folder.path().join(name), &small(geographic), Some(format)).unwrap();
            for entry in fs::read_dir(folder.path()).unwrap() {
                let entry = entry.unwrap();
                let kept = written.join(entry.file_name());
                if !kept.is_file() {
                    fs::create_dir_all(&written).unwrap();
                    fs::copy(entry.path(), &kept).unwrap();
                    made.push(kept);
                    continue;
                }
                // The bytes of deflate depend on the library in the build.
                let same = match name.ends_with(".tif") {
                    true => unpacked(&entry.path()) == unpacked(&kept),
                    false => fs::read(entry.path()).unwrap() == fs::read(&kept).unwrap(),
                };
                assert!(same, "{} is written otherwise than what other programs have read", kept.display());
            }
        }
        assert!(made.is_empty(), "made, to be checked and kept: {made:?}");
    }
}
