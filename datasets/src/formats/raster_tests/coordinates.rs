//! Units of the coordinates of rasters and survey points.

use super::*;

#[test]
fn ref_coordinates_are_converted_to_metres() {
    for (name, west, step) in [
        ("km.gxf", 500_000.0, 200.0),
        ("usft.nc", 500_000.0, 200.0),
        ("ft.gxf", 500_000.0 * 0.304_800_609_6, 200.0 * 0.304_800_609_6),
    ] {
        let map = read_grid(&case(name), &utm()).unwrap_or_else(|e| panic!("{e}"));
        assert!((map.x.first - west).abs() < 0.01 && (map.x.step - step).abs() < 1e-3, "{name}: {:?}", map.x);
        assert!(map.notes.iter().any(|n| n.starts_with("coordinates in")), "{name}: {:?}", map.notes);
    }
}

#[test]
fn unit_units_of_coordinates_in_every_format() {
    let grid = |units: [&'static str; 2], x: f64, step: f64| {
        let values = NetcdfValueFixture::Shorts(vec![1, 2, 3, 4]);
        netcdf(&[x, x + step], &[x, x + step], units, values, &[("units", NetcdfValueFixture::Text("nT"))])
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

    // GeoTIFF: ProjLinearUnits, and a user-defined unit.
    let keys = |unit: u16| vec![1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32767, 3076, 0, 1, unit];
    let image = |keys: &[u16]| TiffImageFixture::band(2, 2, 8, 1, vec![1, 2, 3, 4]).with(34735, keys);
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
    assert!(fault.contains("user-defined, but the file does not give its size"), "{fault}");
    let fault = west(&tiff(&[image(&keys(9999))]), "m.tif", &utm()).unwrap_err();
    assert!(fault.contains("the unit EPSG:9999 of the coordinates is unknown"), "{fault}");
    // The system and the unit in the file contradict each other; an `epsg` in the options resolves this.
    let mut both = keys(9003);
    both[15] = 32754;
    let fault = west(&tiff(&[image(&both)]), "m.tif", &MapOptions::default()).unwrap_err();
    assert!(
        fault.contains("in US survey feet, but EPSG:32754") && fault.contains("`epsg` = 32754 to confirm"),
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
    assert!(fault.contains("#UNIT_LENGTH gives the length of the unit `ft` as 1000 m, which is wrong"), "{fault}");
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
