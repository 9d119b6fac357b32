#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use tempfile::TempDir;

use super::*;
use crate::samples;

fn read(name: &str, options: &PointOptions) -> SurveyPointSet {
    read_points(&samples::path(name), options).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn val_osborne_is_projected_to_the_zone_of_its_survey() {
    let points = read("osborne/osborne_survey_points.parquet", &PointOptions::default());
    assert_eq!(points.crs.code(), 32754, "the zone of the middle");
    assert_eq!(points.len(), 973_416);
    // The first point of the file, with UTM coordinates by pyproj, rounded to a centimetre.
    assert!((points.easting_m[0] - 465_297.09).abs() < 0.02 && (points.northing_m[0] - 7_581_709.06).abs() < 0.02);
    assert_eq!((points.value_nt[0], points.height_m[0]), (-124.0, 367.0));
    assert_eq!((points.lines[0].as_str(), points.line[0]), ("5576", 0));
    assert!(points.notes.iter().any(|n| n.contains("above sea level")), "{:?}", points.notes);
    let given = PointOptions { epsg: Some(32754), ..PointOptions::default() };
    let given = read("osborne/osborne_survey_points.parquet", &given);
    assert_eq!(given.easting_m[0], 465_297.09, "its own eastings where the system is given");
    let worst = points.easting_m.iter().zip(&given.easting_m).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // The file's eastings are rounded to a centimetre.
    assert!(worst < 0.011, "{worst}");
}

#[test]
fn val_britain_has_named_lines_years_and_another_grid() {
    let points = read("britain/britain_sw_survey_points.parquet", &PointOptions::default());
    assert_eq!(points.crs.code(), 32630);
    assert_eq!(&points.lines[..2], ["T-1-1", "CL-A-1"]);
    assert_eq!(points.extra.year.as_ref().unwrap()[0], 1957.0);
    let to = PointOptions { to_epsg: Some(27700), ..PointOptions::default() };
    let grid = read("britain/britain_sw_survey_points.parquet", &to);
    // The file's national grid uses the grid-shift file; the seven parameters agree within 5 m.
    assert!((grid.easting_m[0] - 299_027.9).abs() < 5.0 && (grid.northing_m[0] - 133_360.7).abs() < 5.0);
}

#[test]
fn unit_a_flight_log_is_a_table_of_points() {
    let points = read("magnavjl_sample/Flt1003_sample.xyz", &PointOptions::default());
    assert_eq!(points.lines, ["1003.01", "1003.02", "1003.03"]);
    assert_eq!(points.line, [0, 0, 0, 1, 1, 1, 2, 2, 2]);
    assert_eq!(points.height_m[0], 190.04);
    assert!(points.extra.tt_s.is_some() && points.extra.diurnal_nt.is_some());
    assert!(points.notes.iter().any(|n| n.contains("values from `mag_1_c`")), "{:?}", points.notes);
}

#[test]
fn unit_text_with_line_records_equals_a_table_with_a_line_column() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let records = write("a.xyz", "/ x y tmi alt_ft\nLine 10\n1000 2000 5 100\n1010 2000 * 100\nTie 7\n1000 2010 7 *\n");
    let column = write("a.csv", "line,x,y,tmi,alt_ft\n10,1000,2000,5,100\n10,1010,2000,,100\n7,1000,2010,7,\n");
    let options = PointOptions { epsg: Some(32630), ..PointOptions::default() };
    let fault = read_points(&records, &PointOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("the coordinate system of `x` and `y` is unknown"), "{fault}");
    let both = [records, column]
        .map(|p| read_points(&p, &PointOptions { height: Some("alt_ft".into()), ..options.clone() }).unwrap());
    for points in &both {
        assert_eq!((&points.line[..], &points.lines[..]), (&[0, 0, 1][..], &["10".to_owned(), "7".to_owned()][..]));
        assert!((points.height_m[0] - 30.48).abs() < 1e-12 && points.height_m[2].is_nan());
        assert!(points.value_nt[1].is_nan() && points.value_nt[2] == 7.0);
        assert_eq!(points.easting_m, [1000.0, 1010.0, 1000.0]);
    }
    let missing = write("b.csv", "lon,lat,strength\n1,2,3\n");
    let fault = read_points(&missing, &PointOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("the columns lon, lat, strength"), "{fault}");
    let lost = write("c.csv", "lon,lat,mag\n1,2,3\n,2,4\n");
    let lost = read_points(&lost, &PointOptions::default()).unwrap();
    assert!(lost.len() == 1 && lost.notes.iter().any(|n| n.starts_with("1 points without a position")));
    let off = write("d.csv", "lon,lat,mag\n1,2,3\n1,95,4\n");
    let fault = read_points(&off, &PointOptions::default()).unwrap_err().to_string();
    assert!(fault.contains("row 1: x 1 and y 95 are not a position"), "{fault}");
    let options = PointOptions { epsg: Some(32630), ..PointOptions::default() };
    let kept = PointOptions { accept: vec![PlausibilityCheck::Range], ..options.clone() };
    // Exchanged columns, a wrong zone, and no position at all.
    for (row, never) in [("5600000,500000", false), ("1400000,5600000", false), ("50000000,5600000", true)] {
        let far = write("e.csv", &format!("easting,northing,mag\n500000,5600000,2\n{row},3\n{row},4\n"));
        let fault = read_points(&far, &options).unwrap_err().to_string();
        assert!(fault.contains("row 1") && fault.contains("EPSG:32630"), "{fault}");
        assert_eq!(read_points(&far, &kept).is_err(), never);
    }
}

#[test]
fn unit_wrong_units_and_constant_values_of_points_give_warnings() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("p.csv");
    let of = |scale: f64, places: f64, same: bool| {
        let row = |k: usize| {
            let value = if same { 40.0 } else { 40.0 + 30.0 * (k as f64 * 0.7).sin() };
            let (lat, lon) = (50.0 + 0.01 * k as f64, -4.0 + 0.02 * k as f64);
            format!("{},{},100,{:e}\n", lat * places, lon * places, value * scale)
        };
        let rows: String = (0..20).map(row).collect();
        fs::write(&path, format!("lat,lon,alt,anomaly\n{rows}")).unwrap();
        doubts(&read_points(&path, &PointOptions::default()).unwrap()).join("; ")
    };
    assert_eq!(of(1.0, 1.0, false), "");
    assert!(of(1e-9, 1.0, false).contains("are they in another unit?"));
    assert!(of(1.0, std::f64::consts::PI / 180.0, false).contains("are the positions in radians?"));
    assert_eq!(of(1.0, 1.0, true), "all values are 40 nT");
}

#[test]
fn gold_every_form_of_text_gives_the_same_points() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("points.csv");
    let rows = |separator: &str| {
        let row = |i: i32| {
            let (lon, lat) = (10.0 + 0.004 * f64::from(i % 5), 50.0 + 0.0012 * f64::from(i));
            let cells = [format!("L{}", i % 5), format!("{lon:.6}"), format!("{lat:.6}"), format!("{}.5", 300 - i)];
            [cells.as_slice(), &[format!("{i}.25")]].concat().join(separator)
        };
        (0..20).map(row).collect::<Vec<_>>().join("\n")
    };
    let read = |text: String| {
        fs::write(&path, text.chars().map(|c| c as u8).collect::<Vec<_>>()).unwrap();
        read_points(&path, &PointOptions::default()).unwrap_or_else(|e| panic!("{text}: {e}"))
    };
    let plain = read(format!("line,lon,lat,alt,mag\n{}\n", rows(",")));
    let forms = [
        format!("line;lon;lat;alt;mag\n{}\n", rows(";").replace('.', ",")),
        format!("line\tlon\tlat\talt\tmag\n{}\n", rows("\t").replace('.', ",")),
        format!("line,lon,lat,alt,mag\n,deg,deg,m,nT\n{}\n", rows(",")),
        format!("# survey\nline;lon [\u{b0}];lat [\u{b0}];alt;mag\n{}\n", rows(";")),
        format!("line  lon  lat  alt  mag\n{}\n", rows("  ")),
    ];
    for text in forms {
        let found = read(text.clone());
        assert_eq!((&found.easting_m, &found.northing_m), (&plain.easting_m, &plain.northing_m), "{text}");
        assert_eq!((&found.value_nt, &found.height_m), (&plain.value_nt, &plain.height_m), "{text}");
        assert_eq!((&found.lines, &found.line), (&plain.lines, &plain.line), "{text}");
    }
}
