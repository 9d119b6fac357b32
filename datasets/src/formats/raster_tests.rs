//! Rasters whose stored numbers differ from the values: packing, masks, markers, units of coordinates, and impossible
//! values. `tests/cases/maps` holds files of other programs; variants of them are made here.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::{
    fs,
    path::{Path, PathBuf},
};

use schemas::plausible::PlausibilityCheck;
use tempfile::TempDir;

use super::{
    raster_files::{NetcdfValueFixture, TiffImageFixture, netcdf, tiff},
    *,
};
use grids::{Crs, GridHeight};

mod coordinates;
mod implausible;

fn case(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/cases/maps").join(name)
}

fn utm() -> MapOptions {
    MapOptions { epsg: Some(32754), ..MapOptions::default() }
}

fn range_of(map: &AnomalyGrid) -> (f64, f64, usize) {
    let known: Vec<f64> = map.anomaly_nt.iter().copied().filter(|v| !v.is_nan()).collect();
    let low = known.iter().copied().fold(f64::INFINITY, f64::min);
    let high = known.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (low, high, map.anomaly_nt.len() - known.len())
}

/// Whether the smallest and the largest value are as given within 0.01 nT, and the number of unknown nodes is as given.
fn same(map: &AnomalyGrid, (low, high, unknown): (f64, f64, usize)) -> bool {
    let found = range_of(map);
    (found.0 - low).abs() < 0.01 && (found.1 - high).abs() < 0.01 && found.2 == unknown
}

/// Reads bytes as a file with a name.
fn bytes(name: &str, bytes: &[u8], options: &MapOptions) -> Result<AnomalyGrid, String> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    read_grid(&path, options).map_err(|e| e.to_string())
}

#[test]
fn ref_cases_of_other_programs() {
    let default = MapOptions::default();
    for (name, options, expected) in [
        ("packed.tif", &default, (0.0, 600.8, 2)),
        ("offset.tif", &default, (0.025, 600.825, 2)),
        ("mask.tif", &default, (0.025, 600.825, 2)),
        ("unsigned.nc", &default, (0.02, 600.82, 2)),
        ("range.nc", &default, (0.025, 600.825, 2)),
        ("vmax.nc", &default, (0.025, 600.825, 2)),
        ("nodata.asc", &utm(), (0.025, 600.825, 2)),
        ("m1e20.nc", &default, (0.025, 600.825, 2)),
    ] {
        let map = read_grid(&case(name), options).unwrap_or_else(|e| panic!("{e}"));
        assert!(same(&map, expected), "{name}: {:?} {:?}", range_of(&map), map.notes);
    }
}

const SCALED: &str = "<GDALMetadata>\n<Item name=\"OFFSET\" sample=\"0\" role=\"offset\">50</Item>\n\
                      <Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.5</Item>\n</GDALMetadata>";

fn cells<T: Copy, const N: usize>(values: &[T], bytes: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|v| bytes(*v)).collect()
}

#[test]
fn unit_packing_and_no_data_of_every_type_of_band() {
    // Four cells: a marker, 0, 10 and 100; the marker is compared with the stored number.
    for (name, image, no_data) in [
        ("i16", TiffImageFixture::band(2, 2, 16, 2, cells(&[-9999_i16, 0, 10, 100], i16::to_le_bytes)), "-9999"),
        ("u16", TiffImageFixture::band(2, 2, 16, 1, cells(&[65535_u16, 0, 10, 100], u16::to_le_bytes)), "65535"),
        ("u8", TiffImageFixture::band(2, 2, 8, 1, vec![255, 0, 10, 100]), "255"),
        ("i8", TiffImageFixture::band(2, 2, 8, 2, cells(&[-128_i8, 0, 10, 100], i8::to_le_bytes)), "-128"),
        ("i32", TiffImageFixture::band(2, 2, 32, 2, cells(&[i32::MIN, 0, 10, 100], i32::to_le_bytes)), "-2147483648"),
        ("f32", TiffImageFixture::band(2, 2, 32, 3, cells(&[-999.9_f32, 0., 10., 100.], f32::to_le_bytes)), "-999.9"),
        (
            "f32 low",
            TiffImageFixture::band(2, 2, 32, 3, cells(&[f32::MIN, 0., 10., 100.], f32::to_le_bytes)),
            "-3.40282e+38",
        ),
        ("f64", TiffImageFixture::band(2, 2, 64, 3, cells(&[-1e4, 0., 10., 100.], f64::to_le_bytes)), "-10000"),
        ("nan", TiffImageFixture::band(2, 2, 32, 3, cells(&[f32::NAN, 0., 10., 100.], f32::to_le_bytes)), "nan"),
    ] {
        let file = tiff(&[image.text(42113, no_data).text(42112, SCALED)]);
        let map = bytes("m.tif", &file, &MapOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(same(&map, (50.0, 100.0, 1)), "{name}: {:?}", map.anomaly_nt);
        // Packing is not applied twice after writing and reading.
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("again.tif");
        write_grid(&path, &map, None).unwrap();
        assert!(same(&read_grid(&path, &MapOptions::default()).unwrap(), (50.0, 100.0, 1)), "{name}");
    }
    let broken = TiffImageFixture::band(2, 2, 8, 1, vec![255, 0, 10, 100]).text(42113, "none");
    let fault = bytes("m.tif", &tiff(&[broken]), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("the no-data value `none` (tag 42113) is not a number"), "{fault}");
    let partial = SCALED.replace(" role=\"scale\"", "");
    let broken = TiffImageFixture::band(2, 2, 8, 1, vec![255, 0, 10, 100]).text(42112, &partial);
    let fault = bytes("m.tif", &tiff(&[broken]), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("the scale of the band (tag 42112) lacks the attribute `sample` or `role`"), "{fault}");
}

#[test]
fn unit_masks_alpha_bands_and_white_as_zero() {
    let values = [1.0_f32, 2.0, 3.0, 4.0];
    let band = TiffImageFixture::band(2, 2, 32, 3, cells(&values, f32::to_le_bytes));
    let mask = |bits: u16, subfile: u16, cells: Vec<u8>| {
        TiffImageFixture::band(2, 2, bits, 1, cells).with(254, &[subfile]).with(262, &[4])
    };
    let read = |images: &[TiffImageFixture]| bytes("m.tif", &tiff(images), &MapOptions::default());
    for (name, images) in [
        ("1 bit", vec![band.clone(), mask(1, 4, vec![0b0100_0000, 0b1100_0000])]),
        ("8 bits", vec![band.clone(), mask(8, 4, vec![0, 255, 255, 255])]),
        (
            "after an overview",
            vec![
                band.clone(),
                TiffImageFixture::band(1, 1, 32, 3, cells(&[9.0_f32], f32::to_le_bytes)).with(254, &[1]),
                mask(8, 4, vec![0, 1, 1, 1]),
                TiffImageFixture::band(1, 1, 8, 1, vec![0]).with(254, &[5]).with(262, &[4]),
            ],
        ),
    ] {
        let map = read(&images).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(same(&map, (2.0, 4.0, 1)), "{name}: {:?}", map.anomaly_nt);
        assert!(map.anomaly_nt[2].is_nan(), "{name}: the north-western cell");
    }
    let small = TiffImageFixture::band(1, 2, 8, 1, vec![0, 1]).with(254, &[4]).with(262, &[4]);
    let fault = read(&[band.clone(), small]).unwrap_err();
    assert!(fault.contains("the mask of the file has 1 x 2 cells, not 2 x 2"), "{fault}");
    let second = read(&[band.clone(), band.clone()]).unwrap();
    assert!(second.notes.iter().any(|n| n == "1 other images of the file are ignored"), "{:?}", second.notes);

    // An alpha band, interleaved by cell or by plane.
    let mixed = cells(&[1.0_f32, 0.0, 2.0, 255.0, 3.0, 255.0, 4.0, 255.0], f32::to_le_bytes);
    let planes = cells(&[1.0_f32, 2.0, 3.0, 4.0, 0.0, 255.0, 255.0, 255.0], f32::to_le_bytes);
    for (extra, layout, both) in [(2, 1, mixed.clone()), (1, 1, mixed.clone()), (2, 2, planes)] {
        let image = TiffImageFixture::band(2, 2, 32, 3, both).with(277, &[2]).with(338, &[extra]).with(284, &[layout]);
        let image = image.with(258, &[32, 32]).with(339, &[3, 3]);
        let map = read(&[image]).unwrap();
        assert!(same(&map, (2.0, 4.0, 1)), "{:?}", map.anomaly_nt);
    }
    let two = TiffImageFixture::band(2, 2, 32, 3, mixed)
        .with(277, &[2])
        .with(338, &[0])
        .with(258, &[32, 32])
        .with(339, &[3, 3]);
    let fault = read(&[two]).unwrap_err();
    assert!(fault.contains("a map must have one band"), "{fault}");

    // The photometric interpretation only affects the display; the numbers are the values.
    let white = TiffImageFixture::band(2, 2, 16, 1, cells(&[1_u16, 2, 3, 4], u16::to_le_bytes)).with(262, &[0]);
    assert!(same(&read(&[white]).unwrap(), (1.0, 4.0, 0)));
}

#[test]
fn unit_side_files_apply_only_to_their_own_raster() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("m.tif");
    let image = TiffImageFixture::band(2, 2, 16, 2, cells(&[7_i16, 10, 20, 100], i16::to_le_bytes));
    fs::write(&path, tiff(std::slice::from_ref(&image))).unwrap();
    let aux = folder.path().join("m.tif.aux.xml");
    let pam = |band: &str| format!("<PAMDataset>\n<PAMRasterBand band=\"1\">\n{band}\n</PAMRasterBand>\n</PAMDataset>");
    let all =
        "<NoDataValue le_hex_equiv=\"0\">7</NoDataValue><Offset>-5</Offset><Scale>2</Scale><UnitType>nT</UnitType>";
    fs::write(&aux, pam(all)).unwrap();
    let map = read_grid(&path, &MapOptions::default()).unwrap();
    assert!(same(&map, (15.0, 195.0, 1)), "{:?}", map.anomaly_nt);
    assert_eq!(map_files(&path).unwrap(), [path.clone(), aux.clone()]);
    let fault = write_grid(&path, &map, None).unwrap_err().to_string();
    assert!(fault.contains("m.tif.aux.xml` belongs to an earlier file"), "{fault}");
    // Options that contradict the file are rejected.
    fs::write(&path, tiff(&[image.clone().text(42112, SCALED)])).unwrap();
    let fault = read_grid(&path, &MapOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("has 2 as scale or offset, but the raster has 0.5"), "{fault}");
    fs::remove_file(&aux).unwrap();
    fs::write(&path, tiff(&[image])).unwrap();
    // A mask in a file: the first row is the northernmost.
    let mask = tiff(&[TiffImageFixture::band(2, 2, 8, 1, vec![0, 255, 255, 255])]);
    fs::write(folder.path().join("m.tif.msk"), &mask).unwrap();
    assert!(same(&read_grid(&path, &MapOptions::default()).unwrap(), (10.0, 100.0, 1)));
    let grid = folder.path().join("m.grd");
    fs::write(&grid, "DSAA\n2 2\n500000 500200\n7600000 7600200\n0 9\n3 4\n1 2\n").unwrap();
    fs::write(folder.path().join("m.grd.msk"), &mask).unwrap();
    let map = read_grid(&grid, &utm()).unwrap();
    assert!(map.anomaly_nt[2].is_nan() && same(&map, (2.0, 4.0, 1)), "{:?}", map.anomaly_nt);
}

#[test]
fn unit_netcdf_attributes_determine_the_values() {
    use NetcdfValueFixture::{Bytes, Doubles, Floats, Ints, Shorts, Text};
    let nt = ("units", Text("nT"));
    let scale = ("scale_factor", Doubles(vec![0.5]));
    let unsigned = ("_Unsigned", Text("true"));
    for (name, values, attributes, expected) in [
        (
            "unsigned byte",
            Bytes(vec![-1, -56, 10, 100]),
            vec![unsigned.clone(), ("_FillValue", Bytes(vec![-1]))],
            (10.0, 200.0, 1),
        ),
        ("unsigned short", Shorts(vec![-32768, 0, 10, 100]), vec![unsigned.clone(), scale.clone()], (0.0, 16_384.0, 0)),
        ("signed", Bytes(vec![-1, 0, 10, 100]), vec![("_Unsigned", Text("false"))], (-1.0, 100.0, 0)),
        (
            "unsigned range",
            Shorts(vec![-1, 0, 10, 100]),
            vec![unsigned.clone(), scale.clone(), ("valid_range", Shorts(vec![0, -2]))],
            (0.0, 50.0, 1),
        ),
        (
            "packed range",
            Shorts(vec![900, 0, 10, 100]),
            vec![scale.clone(), ("valid_range", Shorts(vec![0, 500]))],
            (0.0, 50.0, 1),
        ),
        (
            "unpacked range",
            Shorts(vec![900, 0, 10, 100]),
            vec![scale.clone(), ("valid_max", Doubles(vec![400.0]))],
            (0.0, 50.0, 1),
        ),
        ("valid_min", Ints(vec![-900, 0, 10, 100]), vec![("valid_min", Ints(vec![-500]))], (0.0, 100.0, 1)),
        (
            "two markers",
            Floats(vec![-1.0, -2.0, 10.0, 100.0]),
            vec![("missing_value", Floats(vec![-1.0, -2.0]))],
            (10.0, 100.0, 2),
        ),
        (
            "double marker",
            Floats(vec![1e20, 0.0, 10.0, 100.0]),
            vec![("missing_value", Doubles(vec![1e20]))],
            (0.0, 100.0, 1),
        ),
        (
            "double fill",
            Floats(vec![-999.9, 0.0, 10.0, 100.0]),
            vec![("_FillValue", Doubles(vec![-999.9]))],
            (0.0, 100.0, 1),
        ),
        ("marker as text", Ints(vec![-999, 0, 10, 100]), vec![("missing_value", Text("-999"))], (0.0, 100.0, 1)),
        ("default fill of shorts", Shorts(vec![-32767, 0, 10, 100]), vec![], (0.0, 100.0, 1)),
        ("default fill of ints", Ints(vec![-2_147_483_647, 0, 10, 100]), vec![], (0.0, 100.0, 1)),
        ("default fill of floats", Floats(vec![9.969_21e36, 0.0, 10.0, 100.0]), vec![], (0.0, 100.0, 1)),
        (
            "double of a single fill",
            Doubles(vec![f64::from(9.969_21e36_f32), 0.0, 10.0, 100.0]),
            vec![],
            (0.0, 100.0, 1),
        ),
        ("infinite", Doubles(vec![f64::INFINITY, 0.0, 10.0, 100.0]), vec![], (0.0, 100.0, 1)),
    ] {
        let attributes = [attributes, vec![nt.clone()]].concat();
        let file = netcdf(&[140.0, 140.1], &[-22.0, -21.9], ["degrees_east", "degrees_north"], values, &attributes);
        let map = bytes("m.nc", &file, &MapOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(same(&map, expected), "{name}: {:?} {:?}", map.anomaly_nt, map.notes);
    }
    for (attribute, what) in [
        (("scale_factor", Text("a half")), "`scale_factor` must be a number, not `a half`"),
        (("_Unsigned", Text("maybe")), "`_Unsigned` must be true or false, not `maybe`"),
        (("valid_range", Shorts(vec![5])), "`valid_range` must have two numbers, not 1"),
        (("scale_factor", Doubles(vec![0.0])), "the scale 0 and the offset 0 of the values are invalid"),
    ] {
        let values = Shorts(vec![1, 2, 3, 4]);
        let file = netcdf(&[1.0, 2.0], &[1.0, 2.0], ["degrees_east", "degrees_north"], values, &[attribute]);
        let fault = bytes("m.nc", &file, &MapOptions::default()).unwrap_err();
        assert!(fault.contains(what), "{what}: {fault}");
    }
}

#[test]
fn unit_markers_of_text_and_binary_grids_in_both_precisions() {
    let asc = |marker: &str, cell: &str| {
        format!("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value {marker}\n{cell} 1\n2 3\n")
    };
    for (marker, cell) in [
        ("-3.4028234663852886e+38", "-3.402823e+38"),
        ("-9999", "-9999.0"),
        ("-999.9", "-999.90002"),
        ("1e20", "1.00000002e20"),
        ("-1e32", "-1e+32"),
        ("-9999", "-3.40282347e+38"),
        ("-9999", "inf"),
        ("-9999", "1.70141e38"),
        ("1", "-9999"),
    ] {
        let map = bytes("m.asc", asc(marker, cell).as_bytes(), &utm()).unwrap_or_else(|e| panic!("{cell}: {e}"));
        let unknown = if marker == "1" { 2 } else { 1 };
        assert_eq!(range_of(&map).2, unknown, "{marker} {cell}: {:?}", map.anomaly_nt);
    }
    let blank = "DSAA\n2 2\n0 1\n0 1\n1 3\n1.701412e+38 1\n2 3\n";
    assert!(same(&bytes("m.grd", blank.as_bytes(), &utm()).unwrap(), (1.0, 3.0, 1)));
    let gxf = fs::read_to_string(case("km.gxf")).unwrap();
    let single = gxf.replace(" -1e32 ", " -1.0000000331813535e+32 ");
    assert_eq!(range_of(&bytes("m.gxf", single.as_bytes(), &utm()).unwrap()).2, 2);
    let scaled = gxf.replace("#SENSE", "#TRANSFORM\n0.5 10\n#SENSE");
    assert!(same(&bytes("m.gxf", scaled.as_bytes(), &utm()).unwrap(), (10.0125, 310.4125, 2)));
}

#[test]
fn gold_unsupported_formats_are_named() {
    let mut tar = vec![b'a'; 512];
    tar[257..262].copy_from_slice(b"ustar");
    let options = MapOptions::default();
    for (name, content, what) in [
        ("g.grd", b"%PDF-1.7 ...".as_slice(), "a PDF document"),
        ("g.nc", b"GRIB\0\0\0\x02....".as_slice(), "a GRIB file"),
        ("g.tif", b"PK\x03\x04....".as_slice(), "a zip archive (unpack the archive"),
        ("g.grd", b"\x1f\x8b\x08\0....".as_slice(), "a gzip file (unpack the archive"),
        ("g.hdf", b"\x0e\x03\x13\x01....".as_slice(), "an HDF4 file"),
        ("hdr.adf", b"GRID1.2\0....".as_slice(), "the header of an Esri binary grid"),
        ("g.flt", b"\0\x01\x02\x03....".as_slice(), "a raw raster, whose layout is in a file next to it"),
        ("g.hdr", b"BYTEORDER I\nLAYOUT BIL\n".as_slice(), "the header of a raw raster"),
        ("g.tif", b"<!DOCTYPE html>\n<html><body>404</body></html>".as_slice(), "an HTML page"),
        ("g.csv", b"<html>\n<p>1 2 3\n4 5 6\n7 8 9\n".as_slice(), "an HTML page"),
        ("g.tif", b"version https://git-lfs.github.com/spec/v1\noid".as_slice(), "a pointer of Git LFS"),
        ("g.tar", tar.as_slice(), "a tar archive"),
        ("g.shp", b"\0\0\x27\x0a\0\0\0\0....".as_slice(), "an Esri shapefile"),
        ("g.gpkg", b"SQLite format 3\0....".as_slice(), "an SQLite database"),
    ] {
        let fault = bytes(name, content, &options).unwrap_err();
        assert!(fault.contains(&format!("the file is {what}")), "{name}: {fault}");
    }
    assert!(bytes("e.grd", b"", &options).unwrap_err().contains("the file is empty"));
    let named = MapOptions { format: Some("netcdf".into()), ..MapOptions::default() };
    assert!(bytes("g.grd", b"PK\x03\x04....", &named).unwrap_err().contains("a zip archive"));
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("p.csv");
    fs::write(&path, b"<html>error</html>").unwrap();
    let fault = read_points(&path, &PointOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("an HTML page"), "{fault}");
    let flight = FlightOptions { flight: Some("1".into()), line: Some("1".into()), ..FlightOptions::default() };
    let fault = open_flight(&path, &flight).err().unwrap().to_string();
    assert!(fault.contains("an HTML page"), "{fault}");
}
