//! Impossible values of maps and survey points.

use super::*;

#[test]
fn unit_impossible_values_of_maps_are_rejected() {
    let fault = read_grid(&case("emag2.nc"), &MapOptions::default()).unwrap_err().to_string();
    for part in [
        "emag2.nc, column `anomaly`: in row ",
        "99,999 nT is not a magnetic anomaly (-20,000 to 20,000 nT); other values out of range: 1 of 63",
        "set `missing = [99999]` in the table of the spec or use `--missing=99999`",
        "`accept = [\"range\"]`",
    ] {
        assert!(fault.contains(part), "{part}: {fault}");
    }
    let missing = MapOptions { missing: vec!["99999".into()], ..MapOptions::default() };
    assert!(same(&read_grid(&case("emag2.nc"), &missing).unwrap(), (0.025, 600.825, 2)));
    let accepted = MapOptions { accept: vec![PlausibilityCheck::Range], ..MapOptions::default() };
    assert_eq!(range_of(&read_grid(&case("emag2.nc"), &accepted).unwrap()).1, 99_999.0);

    let cells = [5.0, 6.0, 7.0, 1e308_f64].into_iter().flat_map(f64::to_le_bytes).collect();
    let huge = tiff(&[TiffImageFixture::band(2, 2, 64, 3, cells)]);
    let fault = bytes("m.tif", &huge, &MapOptions::default()).unwrap_err();
    assert!(fault.contains("1e308 nT is not a magnetic anomaly") && fault.contains("missing = [1e308]"), "{fault}");
    let summary = bytes("m.tif", &huge, &accepted).unwrap().summary().unwrap();
    let (low, mean, high) = summary.min_mean_max_nt;
    assert!(low.is_finite() && mean.is_finite() && high == 1e308 && summary.std_nt.is_finite(), "{summary:?}");
    let unknown = MapOptions { missing: vec!["1e308".into()], ..MapOptions::default() };
    assert!(same(&bytes("m.tif", &huge, &unknown).unwrap(), (5.0, 7.0, 1)));

    // Each variant adds one impossible value to three values of an anomaly, in the unit of the file.
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
    // A total field is accepted with a note; a derivative has the same bound.
    let total = "lon,lat,anomaly\n1,1,54000\n2,1,54100\n1,2,54200\n2,2,54300\n";
    let map = bytes("m.csv", total.as_bytes(), &MapOptions::default()).unwrap();
    assert!(map.notes.iter().any(|n| n.contains("are a total field")), "{:?}", map.notes);
    let fault = bytes("m.csv", total.replace("54300", "99999").as_bytes(), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("99,999 nT is not a total field of the earth (15,000 to 80,000 nT)"), "{fault}");
    let slope = MapOptions { unit: Some("nT/m".into()), ..MapOptions::default() };
    assert!(read("99999", &slope).unwrap_err().contains("a derivative of a magnetic anomaly"));
    let heights = "lon,lat,anomaly,alt\n1,1,5,300\n2,1,6,300\n1,2,7,310\n2,2,8,1e7\n";
    let fault = bytes("m.csv", heights.as_bytes(), &MapOptions::default()).unwrap_err();
    assert!(fault.contains("10000000 m is outside the plausible range of map heights above the ellipsoid"), "{fault}");
    let map = bytes("m.csv", heights.replace("1e7", "-99999").as_bytes(), &MapOptions::default()).unwrap();
    assert!(matches!(&map.height, GridHeight::Cells(cells) if cells[3].is_nan()), "{:?}", map.height);
    let word = MapOptions { missing: vec!["dropout".into()], ..MapOptions::default() };
    assert!(read("8", &word).unwrap_err().contains("`dropout` of `missing` is not a number"));
}

#[test]
fn unit_impossible_values_of_survey_points_are_rejected() {
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
        let accepted = PointOptions { accept: vec![PlausibilityCheck::Range], ..PointOptions::default() };
        assert!(read(&rows(value, "100"), &accepted).unwrap().value_nt[2] > 9000.0, "{value}");
    }
    assert!(read(&rows("inf", "100"), &plain).unwrap().value_nt[2].is_nan());
    let fault = read(&rows("7", "1e7"), &plain).unwrap_err();
    assert!(
        fault.contains("column `alt`") && fault.contains("is outside the plausible range of flight heights"),
        "{fault}"
    );
    assert!(read(&rows("7", "-99999"), &plain).unwrap().height_m[1].is_nan());
    let total =
        rows("54300", "100").replace(",5\n", ",54000\n").replace(",6\n", ",54100\n").replace(",8\n", ",54200\n");
    assert!(read(&total, &plain).unwrap().notes.iter().any(|n| n.contains("total field")));
}
