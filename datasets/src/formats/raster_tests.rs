//! Rasters whose stored numbers are not the values: packing, masks, markers, units of coordinates, and values that
//! cannot be. `tests/cases/maps` holds files of other programs; their siblings are made here.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::{
    fs,
    path::{Path, PathBuf},
};

use schemas::plausible::Accept;
use tempfile::TempDir;

use super::{
    raster_files::{Attribute, Image, netcdf, tiff},
    *,
};
use grids::{Crs, Height};

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

/// Whether the least and the largest value are these within a hundredth of a nT, and as many are unknown.
fn same(map: &AnomalyGrid, (low, high, unknown): (f64, f64, usize)) -> bool {
    let found = range_of(map);
    (found.0 - low).abs() < 0.01 && (found.1 - high).abs() < 0.01 && found.2 == unknown
}

/// Reads bytes as a file of a name.
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
    // Four cells: a marker, 0, 10 and 100; the marker is compared as stored.
    for (name, image, no_data) in [
        ("i16", Image::band(2, 2, 16, 2, cells(&[-9999_i16, 0, 10, 100], i16::to_le_bytes)), "-9999"),
        ("u16", Image::band(2, 2, 16, 1, cells(&[65535_u16, 0, 10, 100], u16::to_le_bytes)), "65535"),
        ("u8", Image::band(2, 2, 8, 1, vec![255, 0, 10, 100]), "255"),
        ("i8", Image::band(2, 2, 8, 2, cells(&[-128_i8, 0, 10, 100], i8::to_le_bytes)), "-128"),
        ("i32", Image::band(2, 2, 32, 2, cells(&[i32::MIN, 0, 10, 100], i32::to_le_bytes)), "-2147483648"),
        ("f32", Image::band(2, 2, 32, 3, cells(&[-999.9_f32, 0., 10., 100.], f32::to_le_bytes)), "-999.9"),
        ("f32 low", Image::band(2, 2, 32, 3, cells(&[f32::MIN, 0., 10., 100.], f32::to_le_bytes)), "-3.40282e+38"),
        ("f64", Image::band(2, 2, 64, 3, cells(&[-1e4, 0., 10., 100.], f64::to_le_bytes)), "-10000"),
        ("nan", Image::band(2, 2, 32, 3, cells(&[f32::NAN, 0., 10., 100.], f32::to_le_bytes)), "nan"),
    ] {
        let file = tiff(&[image.text(42113, no_data).text(42112, SCALED)]);
        let map = bytes("m.tif", &file, &MapOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(same(&map, (50.0, 100.0, 1)), "{name}: {:?}", map.anomaly_nt);
        // Written and read again, nothing is doubled.
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("again.tif");
        write_grid(&path, &map, None).unwrap();
        assert!(same(&read_grid(&path, &MapOptions::default()).unwrap(), (50.0, 100.0, 1)), "{name}");
    }
    let broken = Image::band(2, 2, 8, 1, vec![255, 0, 10, 100]).text(42113, "none");
    let fault = bytes("m.tif", &tiff(&[broken]), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("the no-data value `none` (tag 42113) is not a number"), "{fault}");
    let partial = SCALED.replace(" role=\"scale\"", "");
    let broken = Image::band(2, 2, 8, 1, vec![255, 0, 10, 100]).text(42112, &partial);
    let fault = bytes("m.tif", &tiff(&[broken]), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("the scale of the band (tag 42112) lacks its band and role"), "{fault}");
}

#[test]
fn unit_masks_alpha_bands_and_white_as_zero() {
    let values = [1.0_f32, 2.0, 3.0, 4.0];
    let band = Image::band(2, 2, 32, 3, cells(&values, f32::to_le_bytes));
    let mask = |bits: u16, subfile: u16, cells: Vec<u8>| {
        Image::band(2, 2, bits, 1, cells).with(254, &[subfile]).with(262, &[4])
    };
    let read = |images: &[Image]| bytes("m.tif", &tiff(images), &MapOptions::default());
    for (name, images) in [
        ("1 bit", vec![band.clone(), mask(1, 4, vec![0b0100_0000, 0b1100_0000])]),
        ("8 bits", vec![band.clone(), mask(8, 4, vec![0, 255, 255, 255])]),
        (
            "after an overview",
            vec![
                band.clone(),
                Image::band(1, 1, 32, 3, cells(&[9.0_f32], f32::to_le_bytes)).with(254, &[1]),
                mask(8, 4, vec![0, 1, 1, 1]),
                Image::band(1, 1, 8, 1, vec![0]).with(254, &[5]).with(262, &[4]),
            ],
        ),
    ] {
        let map = read(&images).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(same(&map, (2.0, 4.0, 1)), "{name}: {:?}", map.anomaly_nt);
        assert!(map.anomaly_nt[2].is_nan(), "{name}: the north-western cell");
    }
    let small = Image::band(1, 2, 8, 1, vec![0, 1]).with(254, &[4]).with(262, &[4]);
    let fault = read(&[band.clone(), small]).unwrap_err();
    assert!(fault.contains("the mask of the file has 1 x 2 cells, not 2 x 2"), "{fault}");
    let second = read(&[band.clone(), band.clone()]).unwrap();
    assert!(second.notes.iter().any(|n| n == "1 other images of the file are ignored"), "{:?}", second.notes);

    // An alpha band, cell by cell and plane by plane.
    let mixed = cells(&[1.0_f32, 0.0, 2.0, 255.0, 3.0, 255.0, 4.0, 255.0], f32::to_le_bytes);
    let planes = cells(&[1.0_f32, 2.0, 3.0, 4.0, 0.0, 255.0, 255.0, 255.0], f32::to_le_bytes);
    for (extra, layout, both) in [(2, 1, mixed.clone()), (1, 1, mixed.clone()), (2, 2, planes)] {
        let image = Image::band(2, 2, 32, 3, both).with(277, &[2]).with(338, &[extra]).with(284, &[layout]);
        let image = image.with(258, &[32, 32]).with(339, &[3, 3]);
        let map = read(&[image]).unwrap();
        assert!(same(&map, (2.0, 4.0, 1)), "{:?}", map.anomaly_nt);
    }
    let two = Image::band(2, 2, 32, 3, mixed).with(277, &[2]).with(338, &[0]).with(258, &[32, 32]).with(339, &[3, 3]);
    let fault = read(&[two]).unwrap_err();
    assert!(fault.contains("a map must have one band"), "{fault}");

    // Photometric interpretation is for screens: the numbers are the values.
    let white = Image::band(2, 2, 16, 1, cells(&[1_u16, 2, 3, 4], u16::to_le_bytes)).with(262, &[0]);
    assert!(same(&read(&[white]).unwrap(), (1.0, 4.0, 0)));
}

#[test]
fn unit_side_files_are_applied_and_never_to_another_file() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("m.tif");
    let image = Image::band(2, 2, 16, 2, cells(&[7_i16, 10, 20, 100], i16::to_le_bytes));
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
    // What contradicts the file itself is refused.
    fs::write(&path, tiff(&[image.clone().text(42112, SCALED)])).unwrap();
    let fault = read_grid(&path, &MapOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("has 2 as scale or offset, but the file itself has 0.5"), "{fault}");
    fs::remove_file(&aux).unwrap();
    fs::write(&path, tiff(&[image])).unwrap();
    // A mask in a file: the first row is the northernmost.
    let mask = tiff(&[Image::band(2, 2, 8, 1, vec![0, 255, 255, 255])]);
    fs::write(folder.path().join("m.tif.msk"), &mask).unwrap();
    assert!(same(&read_grid(&path, &MapOptions::default()).unwrap(), (10.0, 100.0, 1)));
    let grid = folder.path().join("m.grd");
    fs::write(&grid, "DSAA\n2 2\n500000 500200\n7600000 7600200\n0 9\n3 4\n1 2\n").unwrap();
    fs::write(folder.path().join("m.grd.msk"), &mask).unwrap();
    let map = read_grid(&grid, &utm()).unwrap();
    assert!(map.anomaly_nt[2].is_nan() && same(&map, (2.0, 4.0, 1)), "{:?}", map.anomaly_nt);
}

#[test]
fn unit_attributes_of_netcdf_say_how_numbers_are_read() {
    use Attribute::{Bytes, Doubles, Floats, Ints, Shorts, Text};
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
<<<<<<< HEAD
=======
fn unit_units_of_coordinates_in_every_format() {
    let grid = |units: [&'static str; 2], x: f64, step: f64| {
        let values = Attribute::Shorts(vec![1, 2, 3, 4]);
        netcdf(&[x, x + step], &[x, x + step], units, values, &[("units", Attribute::Text("nT"))])
    };
    let west = |file: &[u8], name: &str, options: &MapOptions| bytes(name, file, options).map(|m| m.x.first);
    let foot = 1200.0 / 3937.0;
    for (units, x, step, expected) in [
        (["km"; 2], 500.0, 0.2, 500_000.0),
        (["kilometer"; 2], 500.0, 0.2, 500_000.0),
        (["US survey foot"; 2], 1_640_416.0, 600.0, 1_640_416.0 * foot),
        (["ft"; 2], 1_640_416.0, 600.0, 1_640_416.0 * 0.3048),
        (["0.3048 m"; 2], 1_640_416.0, 600.0, 1_640_416.0 * 0.3048),
        (["m"; 2], 500_000.0, 200.0, 500_000.0),
        (["1"; 2], 500_000.0, 200.0, 500_000.0),
    ] {
        let found = west(&grid(units, x, step), "m.nc", &utm()).unwrap();
        assert!((found - expected).abs() < 1e-6, "{units:?}: {found}");
    }
    for (units, what) in [
        (["furlong"; 2], "the unit `furlong` of the coordinates is unknown"),
        (["degrees_east", "degrees_north"], "the coordinates are in degrees, but EPSG:32754"),
        (["km", "m"], "the coordinates are in two units, km and m"),
    ] {
        let fault = west(&grid(units, 50.0, 0.2), "m.nc", &utm()).unwrap_err();
        assert!(fault.contains(what), "{units:?}: {fault}");
    }
    let degrees = MapOptions { epsg: Some(4326), ..MapOptions::default() };
    let fault = west(&grid(["m"; 2], 50.0, 0.2), "m.nc", &degrees).unwrap_err();
    assert!(fault.contains("the coordinates are in m, but EPSG:4326") && fault.contains("in degrees"), "{fault}");

    // GeoTIFF: ProjLinearUnits, and a unit of the file's own.
    let keys = |unit: u16| vec![1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32767, 3076, 0, 1, unit];
    let image = |keys: &[u16]| Image::band(2, 2, 8, 1, vec![1, 2, 3, 4]).with(34735, keys);
    let corner = 500_000.0 + 100.0;
    for (code, metres) in [(9001, 1.0), (9002, 0.3048), (9003, foot), (9036, 1000.0)] {
        let found = west(&tiff(&[image(&keys(code))]), "m.tif", &utm()).unwrap();
        assert!((found - corner * metres).abs() < 1e-6, "{code}: {found}");
    }
    let mut own = keys(32767);
    own[3] = 5;
    own.extend([3077, 34736, 1, 0]);
    let mut with_size = image(&own);
    with_size.doubles.push((34736, vec![0.5]));
    assert!((west(&tiff(&[with_size]), "m.tif", &utm()).unwrap() - 0.5 * corner).abs() < 1e-6);
    let fault = west(&tiff(&[image(&own)]), "m.tif", &utm()).unwrap_err();
    assert!(fault.contains("user-defined, but its size is missing"), "{fault}");
    let fault = west(&tiff(&[image(&keys(9999))]), "m.tif", &utm()).unwrap_err();
    assert!(fault.contains("the unit EPSG:9999 of the coordinates is unknown"), "{fault}");
    // The file's own system and unit contradict each other; naming the system settles it.
    let mut both = keys(9003);
    both[15] = 32754;
    let fault = west(&tiff(&[image(&both)]), "m.tif", &MapOptions::default()).unwrap_err();
    assert!(
        fault.contains("in US survey feet, but EPSG:32754") && fault.contains("`epsg` = 32754 confirms"),
        "{fault}"
    );

    // Columns of text, GXF, ER Mapper and Esri's well-known text.
    let text = |names: &str| format!("{names}\n500 7600 1\n500.2 7600 2\n500 7600.2 3\n500.2 7600.2 4\n");
    for names in ["easting_km northing_km anomaly", "X_km Y_km anomaly"] {
        let found = west(text(names).as_bytes(), "m.xyz", &utm()).unwrap();
        assert!((found - 500_000.0).abs() < 1e-6, "{names}: {found}");
    }
    let csv = "X (ft),Y (ft),anomaly\n500,7600,1\n510,7600,2\n500,7610,3\n510,7610,4\n";
    assert!((west(csv.as_bytes(), "m.csv", &utm()).unwrap() - 152.4).abs() < 1e-9);
    let gxf = fs::read_to_string(case("km.gxf")).unwrap();
    let fault = west(gxf.replace("\"km\",1000", "\"ft\",1000").as_bytes(), "m.gxf", &utm()).unwrap_err();
    assert!(fault.contains("#UNIT_LENGTH gives the unit `ft` a wrong length of 1000 m"), "{fault}");
    let fault = west(gxf.replace("\"km\",1000", "\"cubit\"").as_bytes(), "m.gxf", &utm()).unwrap_err();
    assert!(fault.contains("the unit `cubit` of the coordinates is unknown"), "{fault}");
    let folder = TempDir::new().unwrap();
    let asc = folder.path().join("m.asc");
    fs::copy(case("nodata.asc"), &asc).unwrap();
    let wkt = Crs::from_epsg(Path::new(""), 32754).unwrap().wkt().to_owned();
    fs::write(asc.with_extension("prj"), &wkt).unwrap();
    assert_eq!(read_grid(&asc, &MapOptions::default()).unwrap().x.first, 500_000.0);
    let metre = ["UNIT[\"metre\",1", "UNIT[\"Meter\",1"].into_iter().find(|u| wkt.contains(u)).unwrap();
    fs::write(asc.with_extension("prj"), wkt.replace(metre, "UNIT[\"Kilometer\",1000")).unwrap();
    assert_eq!(read_grid(&asc, &MapOptions::default()).unwrap().x.first, 5e8);
    write_grid(&folder.path().join("m.ers"), &read_grid(&case("km.gxf"), &utm()).unwrap(), None).unwrap();
    let header = folder.path().join("m.ers");
    let feet = fs::read_to_string(&header).unwrap().replace("METERS", "FEET");
    fs::write(&header, feet).unwrap();
    let found = read_grid(&header, &utm()).unwrap().x.first;
    assert!((found - 152_400.0).abs() < 1e-6, "{found}");
}

#[test]
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
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
<<<<<<< HEAD
=======
fn r10_values_that_no_rock_makes() {
    let fault = read_grid(&case("emag2.nc"), &MapOptions::default()).unwrap_err().to_string();
    for part in [
        "emag2.nc, column `anomaly`: in row ",
        "99,999 nT is not a magnetic anomaly (-20,000 to 20,000 nT), and 1 more of 63 values are outside too",
        "set `missing = [99999]` in the table of the spec or use `--missing=99999`",
        "`accept = [\"range\"]`",
    ] {
        assert!(fault.contains(part), "{part}: {fault}");
    }
    let missing = MapOptions { missing: vec!["99999".into()], ..MapOptions::default() };
    assert!(same(&read_grid(&case("emag2.nc"), &missing).unwrap(), (0.025, 600.825, 2)));
    let accepted = MapOptions { accept: vec![Accept::Range], ..MapOptions::default() };
    assert_eq!(range_of(&read_grid(&case("emag2.nc"), &accepted).unwrap()).1, 99_999.0);

    let cells = [5.0, 6.0, 7.0, 1e308_f64].into_iter().flat_map(f64::to_le_bytes).collect();
    let huge = tiff(&[Image::band(2, 2, 64, 3, cells)]);
    let fault = bytes("m.tif", &huge, &MapOptions::default()).unwrap_err();
    assert!(fault.contains("1e308 nT is not a magnetic anomaly") && fault.contains("missing = [1e308]"), "{fault}");
    let summary = bytes("m.tif", &huge, &accepted).unwrap().summary().unwrap();
    let (low, mean, high) = summary.min_mean_max_nt;
    assert!(low.is_finite() && mean.is_finite() && high == 1e308 && summary.std_nt.is_finite(), "{summary:?}");
    let unknown = MapOptions { missing: vec!["1e308".into()], ..MapOptions::default() };
    assert!(same(&bytes("m.tif", &huge, &unknown).unwrap(), (5.0, 7.0, 1)));

    // Siblings, in every format: one value among three of an anomaly, in the unit of the file.
    let text = |value: &str| format!("lon,lat,anomaly\n1,1,5\n2,1,6\n1,2,7\n2,2,{value}\n");
    let read = |value: &str, options: &MapOptions| bytes("m.csv", text(value).as_bytes(), options);
    for value in ["99999", "1e20", "-1e34", "32767", "-1e308", "54321", "9999", "-65536"] {
        let fault = read(value, &MapOptions::default()).unwrap_err();
        assert!(fault.contains("`missing = ["), "{value}: {fault}");
        assert!(read(value, &accepted).is_ok(), "{value}");
        let missing = MapOptions { missing: vec![value.into()], ..MapOptions::default() };
        assert_eq!(range_of(&read(value, &missing).unwrap()), (5.0, 7.0, 1), "{value}");
    }
    for value in ["-1e32", "-99999"] {
        assert!(same(&read(value, &MapOptions::default()).unwrap(), (5.0, 7.0, 1)), "{value}");
    }
    for value in ["inf", "-inf", "1e32", "-32768", "1.70141e38"] {
        let map = read(value, &MapOptions::default()).unwrap();
        assert!(same(&map, (5.0, 7.0, 1)) && map.notes.iter().any(|n| n.contains("treated as unknown")), "{value}");
    }
    let tesla = MapOptions { unit: Some("T".into()), ..MapOptions::default() };
    let fault = read("1e300", &tesla).unwrap_err();
    assert!(fault.contains(" T ("), "{fault}");
    // A total field is one, and says so; a derivative has the same bound.
    let total = "lon,lat,anomaly\n1,1,54000\n2,1,54100\n1,2,54200\n2,2,54300\n";
    let map = bytes("m.csv", total.as_bytes(), &MapOptions::default()).unwrap();
    assert!(map.notes.iter().any(|n| n.contains("are a total field")), "{:?}", map.notes);
    let fault = bytes("m.csv", total.replace("54300", "99999").as_bytes(), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("99,999 nT is not a total field of the earth (15,000 to 80,000 nT)"), "{fault}");
    let slope = MapOptions { unit: Some("nT/m".into()), ..MapOptions::default() };
    assert!(read("99999", &slope).unwrap_err().contains("a derivative of a magnetic anomaly"));
    let heights = "lon,lat,anomaly,alt\n1,1,5,300\n2,1,6,300\n1,2,7,310\n2,2,8,1e7\n";
    let fault = bytes("m.csv", heights.as_bytes(), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("10000000 m is outside the possible heights of a map"), "{fault}");
    let map = bytes("m.csv", heights.replace("1e7", "-99999").as_bytes(), &MapOptions::default()).unwrap();
    assert!(matches!(&map.height, Height::Cells(cells) if cells[3].is_nan()), "{:?}", map.height);
    let word = MapOptions { missing: vec!["dropout".into()], ..MapOptions::default() };
    assert!(read("8", &word).unwrap_err().contains("`dropout` of `missing` is not a number"));
}

#[test]
fn r10_values_of_survey_points() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("p.csv");
    let read = |rows: &str, options: &PointOptions| {
        fs::write(&path, rows).unwrap();
        read_points(&path, options).map_err(|e| e.to_string())
    };
    let plain = PointOptions::default();
    let rows = |value: &str, height: &str| {
        format!("lon,lat,alt,anomaly\n140,-22,100,5\n140.01,-22,{height},6\n140.02,-22,100,{value}\n140.03,-22,100,8\n")
    };
    for value in ["99999", "1e308", "9999"] {
        let fault = read(&rows(value, "100"), &plain).unwrap_err();
        assert!(
            fault.contains("row 2") && fault.contains("column `anomaly`") && fault.contains("--missing="),
            "{fault}"
        );
        let missing = PointOptions { missing: vec![value.into()], ..PointOptions::default() };
        assert!(read(&rows(value, "100"), &missing).unwrap().value_nt[2].is_nan(), "{value}");
        let accepted = PointOptions { accept: vec![Accept::Range], ..PointOptions::default() };
        assert!(read(&rows(value, "100"), &accepted).unwrap().value_nt[2] > 9000.0, "{value}");
    }
    assert!(read(&rows("inf", "100"), &plain).unwrap().value_nt[2].is_nan());
    let fault = read(&rows("7", "1e7"), &plain).unwrap_err();
    assert!(
        fault.contains("column `alt`") && fault.contains("is outside the possible heights of an aircraft"),
        "{fault}"
    );
    assert!(read(&rows("7", "-99999"), &plain).unwrap().height_m[1].is_nan());
    let total =
        rows("54300", "100").replace(",5\n", ",54000\n").replace(",6\n", ",54100\n").replace(",8\n", ",54200\n");
    assert!(read(&total, &plain).unwrap().notes.iter().any(|n| n.contains("total field")));
}

#[test]
fn ref_points_in_other_units_of_length() {
    let points =
        read_points(&case("points_km.parquet"), &PointOptions { epsg: Some(32754), ..PointOptions::default() });
    let points = points.unwrap_or_else(|e| panic!("{e}"));
    let (west, south) = points
        .easting_m
        .iter()
        .zip(&points.northing_m)
        .fold((f64::MAX, f64::MAX), |(a, b), (x, y)| (a.min(*x), b.min(*y)));
    assert!((500_000.0..501_000.0).contains(&west) && south > 7.5e6, "{west} {south}");
    assert!((points.lat_deg[0] + 21.7).abs() < 0.1, "{}", points.lat_deg[0]);

    let folder = TempDir::new().unwrap();
    let read = |names: &str, (x, y): (f64, f64)| {
        let path = folder.path().join("p.csv");
        let text = format!("{names},anomaly\n{x},{y},1\n{x},{},2\n", y + 0.1);
        fs::write(&path, text).unwrap();
        let found = read_points(&path, &PointOptions { epsg: Some(32754), ..PointOptions::default() });
        found.map(|p| (p.easting_m[0], p.northing_m[0])).map_err(|e| e.to_string())
    };
    let near = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() < 1e-3 && (a.1 - b.1).abs() < 1e-3;
    for (names, place, metres) in [
        ("easting_km,northing_km", (500.0, 7600.0), 1000.0),
        ("X (ft),Y (ft)", (1_640_419.9, 24_934_383.2), 0.3048),
        ("easting [US survey foot],northing [US survey foot]", (1_640_416.7, 24_934_333.3), 1200.0 / 3937.0),
        ("utm_x_m,utm_y_m", (500_000.0, 7_600_000.0), 1.0),
        ("x,y", (500_000.0, 7_600_000.0), 1.0),
    ] {
        let found = read(names, place).unwrap_or_else(|e| panic!("{names}: {e}"));
        assert!(near(found, (place.0 * metres, place.1 * metres)), "{names}: {found:?}");
    }
    let fault = read("easting_km,northing_m", (500.0, 7600.0)).unwrap_err();
    assert!(fault.contains("two units, km and m"), "{fault}");
    let fault = read("lon,lat", (140.0, -22.0)).unwrap_err();
    assert!(fault.contains("the coordinates are in degrees, but EPSG:32754"), "{fault}");
}

#[test]
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
fn gold_formats_that_are_not_read_are_named() {
    let geosoft = fs::read(case("geosoft.grd")).unwrap();
    let mut tar = vec![b'a'; 512];
    tar[257..262].copy_from_slice(b"ustar");
    let options = MapOptions::default();
    for (name, content, what) in [
        ("g.grd", geosoft.as_slice(), "a Geosoft binary grid of Oasis montaj (export it as GXF or ER Mapper)"),
        ("g.grd", b"%PDF-1.7 ...".as_slice(), "a PDF document"),
        ("g.nc", b"GRIB\0\0\0\x02....".as_slice(), "a GRIB file"),
        ("g.tif", b"PK\x03\x04....".as_slice(), "a zip archive (unpack it"),
        ("g.grd", b"\x1f\x8b\x08\0....".as_slice(), "a gzip file (unpack it"),
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
    assert!(bytes("g.grd", &geosoft, &named).unwrap_err().contains("a Geosoft binary grid"));
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("p.csv");
    fs::write(&path, b"<html>error</html>").unwrap();
    let fault = read_points(&path, &PointOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("an HTML page"), "{fault}");
    let flight = FlightOptions { flight: Some("1".into()), line: Some("1".into()), ..FlightOptions::default() };
    let fault = open_flight(&path, &flight).err().unwrap().to_string();
    assert!(fault.contains("an HTML page"), "{fault}");
}
