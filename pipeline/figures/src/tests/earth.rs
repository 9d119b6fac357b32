//! Maps and tracks for Google Earth.

use super::*;

/// Map of 2 x 2 degrees that crosses the date line.
fn at_the_date_line(values: &[f64]) -> MapPicture<'_> {
    let axis = |first| EvenAxis { first, step: 0.1, len: 20 };
    MapPicture {
        x: axis(179.05),
        y: axis(-1.0),
        plane: AxisQuantity::Degrees,
        title: "A & B",
        ..picture(20, 20, values)
    }
}

#[test]
fn unit_kml_has_the_position_of_the_map() {
    let values: Vec<f64> = (0..400).map(|k| f64::from(k % 20)).collect();
    let made = kml(&at_the_date_line(&values), &MapStyle { width_px: 400, ..MapStyle::default() }, &[], "rio").unwrap();
    well_formed(&made.document).unwrap();
    let names: Vec<&str> = made.files.iter().map(|f| f.0.as_str()).collect();
    assert_eq!(names, ["rio_map_1.png", "rio_map_2.png", "rio_bar.png"]);
    assert!(names.iter().all(|n| made.document.contains(&format!("<href>{n}</href>"))));
    // Half a step beyond the nodes at 179.05 to 180.95 and -1 to 0.9.
    let boxes: Vec<&str> =
        made.document.split("<LatLonBox>").skip(1).filter_map(|b| b.split("</LatLonBox>").next()).collect();
    assert_eq!(
        boxes,
        [
            "<north>0.95</north><south>-1.05</south><east>180</east><west>179</west>",
            "<north>0.95</north><south>-1.05</south><east>-179</east><west>-180</west>",
        ]
    );
    let west = decode(&made.files[0].1).unwrap();
    let east = decode(&made.files[1].1).unwrap();
    assert_eq!((west.0, east.0.0), ((200, 400), 200));
    // Values rise to the east; the two pictures meet without a step.
    assert!(west.1.chunks_exact(4).chain(east.1.chunks_exact(4)).all(|p| p[3] == 255));
    let (last, first) = (&west.1[4 * 199..4 * 200], &east.1[..4]);
    assert!(last.iter().zip(first).all(|(a, b)| a.abs_diff(*b) < 12), "{last:?} {first:?}");
}

#[test]
fn unit_kml_tracks_are_broken_wrapped_and_timed() {
    let values = vec![1.0; 400];
    let map = at_the_date_line(&values);
    let lon = [179.5, 180.5, f64::NAN, 181.0, 182.0];
    let (lat, alt) = ([0.0, 0.5, 0.5, 0.5, 0.7], [300.0, 300.0, 300.0, 310.5, 300.0]);
    let times = [0.0, 10.0, 20.0, 30.0, 40.0];
    let track = EarthTrack {
        name: "<1>",
        lat_deg: &lat,
        lon_deg: &lon,
        alt_m: &alt,
        time_unix_s: None,
        colour: Some([255, 0, 128]),
    };
    let look = MapStyle { width_px: 200, colour_bar: false, ..MapStyle::default() };
    let plain = kml(&map, &look, &[track], "m").unwrap().document;
    well_formed(&plain).unwrap();
    let lines: Vec<&str> = plain.split("<coordinates>").skip(1).filter_map(|c| c.split('<').next()).collect();
    assert_eq!(lines, ["179.5,0,300 180,0.25,300", "-180,0.25,300 -179.5,0.5,300", "-179,0.5,310.5 -178,0.7,300"]);
    assert!(plain.contains("<name>&lt;1&gt;</name>") && plain.contains("<color>ff8000ff</color>"));
    let timed = kml(&map, &look, &[EarthTrack { time_unix_s: Some(&times), ..track }], "m").unwrap().document;
    well_formed(&timed).unwrap();
    assert_eq!(timed.matches("<gx:Track>").count(), 3);
    assert!(
        timed.contains("<when>1970-01-01T00:00:05.000Z</when>")
            && timed.contains("<gx:coord>-179 0.5 310.5</gx:coord>")
    );
    let short = EarthTrack { alt_m: &alt[1..], ..track };
    assert!(kml(&map, &look, &[short], "m").is_err());
    let flat = picture(20, 20, &values);
    assert!(kml(&flat, &look, &[], "m").unwrap_err().what.contains("latitude and longitude"));
}

#[test]
fn unit_kmz_contains_document_and_pictures_without_times() {
    let values = vec![1.0; 400];
    let made = kml(&at_the_date_line(&values), &MapStyle { width_px: 200, ..MapStyle::default() }, &[], "m").unwrap();
    let zipped = made.kmz().unwrap();
    assert_eq!(zipped, made.kmz().unwrap());
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(&zipped)).unwrap();
    let names: Vec<String> = archive.file_names().map(|n| n.unwrap().into_owned()).collect();
    assert_eq!(names, ["doc.kml", "m_map_1.png", "m_map_2.png", "m_bar.png"]);
    let mut document = String::new();
    std::io::Read::read_to_string(&mut archive.by_name("doc.kml").unwrap(), &mut document).unwrap();
    assert_eq!(document, made.document);
    assert_eq!(archive.by_name("doc.kml").unwrap().compression(), zip::CompressionMethod::Stored);
}
