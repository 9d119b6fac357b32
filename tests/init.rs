//! `magline init` on logs of other people: the spec runs as it is, and its numbers are those of the log.

use std::{f64::consts::TAU, fmt::Write, fs};

use crate::support::{magline, numbers, read, repository, stderr, stdout};

/// Earth's field north, east, down, in nT.
const EARTH: [f64; 3] = [18_000.0, 1_500.0, 48_000.0];
/// Permanent field of the aircraft, in nT.
const PERMANENT: [f64; 3] = [30.0, -20.0, 50.0];
const SAMPLES: usize = 2_400;

/// One sample: seconds from the start, scalar magnetometer and vector magnetometer in nT, latitude, longitude.
struct Sample {
    t: f64,
    scalar: f64,
    vector: [f64; 3],
    lat: f64,
    lon: f64,
}

/// A flight with manoeuvres on four headings, 10 Hz. The noise is a fixed sequence of a standard deviation of 0.02 nT.
fn flight() -> Vec<Sample> {
    let size = EARTH.iter().map(|b| b * b).sum::<f64>().sqrt();
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    (0..SAMPLES)
        .map(|i| {
            let t = i as f64 / 10.0;
            let (roll, pitch) = (0.17 * (TAU * 0.25 * t).sin(), 0.1 * (TAU * 0.21 * t + 1.0).sin());
            let yaw = (t / 60.0).floor() * TAU / 4.0 + 0.1 * (TAU * 0.17 * t).sin();
            let vector = body(roll, pitch, yaw);
            let along: f64 = PERMANENT.iter().zip(vector).map(|(p, b)| p * b / size).sum();
            let noise = 0.02 * (0..12).map(|_| uniform()).sum::<f64>();
            Sample { t, scalar: size + along + noise, vector, lat: 45.0 + 5e-5 * t, lon: -75.0 + 2e-6 * t }
        })
        .collect()
}

/// Earth's field in the body frame (forward, right, down), for angles in rad.
fn body(roll: f64, pitch: f64, yaw: f64) -> [f64; 3] {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    let [n, e, d] = EARTH;
    [
        cp * cy * n + cp * sy * e - sp * d,
        (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d,
        (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d,
    ]
}

fn csv(head: &str, row: impl Fn(&Sample) -> String) -> String {
    let mut text = format!("{head}\n");
    for sample in flight() {
        writeln!(text, "{}", row(&sample)).unwrap();
    }
    text
}

/// A time of day on 3 June 2024, with this form of the date.
fn dated(date: &str, t: f64) -> String {
    format!("{date} 12:{:02}:{:06.3}", (t / 60.0) as u32, t % 60.0)
}

/// A time of day on 3 June 2024, in ISO 8601 with a time zone two hours ahead of UTC.
fn iso(t: f64) -> String {
    let (hours, rest) = (14 + (t / 3600.0) as u32, t % 3600.0);
    format!("2024-06-03T{hours:02}:{:02}:{:06.3}+02:00", (rest / 60.0) as u32, rest % 60.0)
}

#[test]
fn user_a_spec_for_a_csv_file_runs_as_it_is_and_removes_the_aircraft_field() {
    let kinds = [
        (
            "zone",
            csv("time,Mag1 [nT],FluxX,FluxY,FluxZ,Lat,Lon,Height(m),Const", |s| {
                let [x, y, z] = s.vector.map(|b| b / 1e3);
                format!("{},{:.3},{x:.5},{y:.5},{z:.5},{:.7},{:.7},300.0,7", iso(s.t), s.scalar, s.lat, s.lon)
            }),
        ),
        (
            "week",
            csv("GPSWeek,GPSTime,Mag1 [nT],Mag2 [nT],FluxX,FluxY,FluxZ,Lat,Lon", |s| {
                let [x, y, z] = s.vector;
                let (time, other) = (216_000.0 + s.t, s.scalar + 100.0);
                format!("2317,{time:.3},{:.3},{other:.3},{x:.2},{y:.2},{z:.2},{:.7},{:.7}", s.scalar, s.lat, s.lon)
            }),
        ),
        (
            "day",
            csv("UTC_seconds,mag,flux_x,flux_y,flux_z,latitude,longitude", |s| {
                let [x, y, z] = s.vector;
                format!("{:.3},{:.3},{x:.2},{y:.2},{z:.2},{:.7},{:.7}", 50_000.0 + s.t, s.scalar, s.lat, s.lon)
            }),
        ),
        (
            "names",
            csv("stamp,profile,cs_vl_nT,Bx,By,Bz", |s| {
                let [x, y, z] = s.vector;
                format!("{},L 7,{:.3},{x:.2},{y:.2},{z:.2}", dated("2024/06/03", s.t), s.scalar)
            }),
        ),
        (
            "german",
            csv("Zeit;TMI [nT];fx;fy;fz", |s| {
                let [x, y, z] = s.vector.map(|b| b / 1e3);
                format!("{};{:.3};{x:.5};{y:.5};{z:.5}", dated("03.06.2024", s.t), s.scalar).replace('.', ",")
            })
            .replace("03,06,2024", "03.06.2024"),
        ),
        (
            "coarse",
            csv("UTC,mag,Bx,By,Bz", |s| {
                let [x, y, z] = s.vector;
                format!(
                    "2024-06-03 12:{:02}:{:02},{:.3},{x:.2},{y:.2},{z:.2}",
                    (s.t / 60.0) as u32,
                    (s.t % 60.0) as u32,
                    s.scalar
                )
            }),
        ),
        (
            "latin_1",
            csv("date;time;mag;flux_x;flux_y;flux_z;lat;lon\ndd/mm/yyyy;hh:mm:ss;nT;µT;µT;µT;°;°", |s| {
                let [x, y, z] = s.vector.map(|b| b / 1e3);
                let time = dated("23/06/2024", s.t).replace(' ', ";");
                format!("{time};{:.3};{x:.5};{y:.5};{z:.5};{:.7};{:.7}", s.scalar, s.lat, s.lon)
            }),
        ),
        (
            "blanks",
            csv("  Time   Mag      Bx By Bz", |s| {
                let [x, y, z] = s.vector;
                format!("{}  {:9.3}\t{x:9.2} {y:9.2} {z:9.2} ", &dated("", s.t)[1..], s.scalar)
            }),
        ),
        (
            "canonical",
            csv("tt,mag_1_uc,flux_a_x,flux_a_y,flux_a_z,lat,lon", |s| {
                let [x, y, z] = s.vector;
                format!("{:.3},{:.3},{x:.2},{y:.2},{z:.2},{:.7},{:.7}", 50_000.0 + s.t, s.scalar, s.lat, s.lon)
            }),
        ),
    ];
    for (name, text) in kinds {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let latin_1: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let bytes = if name == "latin_1" { latin_1 } else { text.into_bytes() };
        fs::write(folder.join(format!("{name}.csv")), bytes).unwrap();
        let output = magline(folder, &["init", &format!("{name}.csv")]);
        let found = stdout(&output);
        assert!(output.status.success(), "{name}: {found}{}", stderr(&output));
        assert!(found.contains(&format!("next: magline run {name}.toml\n")), "{name}: {found}");
        let output = magline(folder, &["run", &format!("{name}.toml"), "--quiet"]);
        assert!(output.status.success(), "{name}: {}{}", stderr(&output), stdout(&output));
        // The earth's field is constant, so what remains is the error of the compensation.
        let query = format!("select stddev(mag_1_uc) as before, stddev(mag_c) as after from {name}.clean");
        let found = stdout(&magline(folder, &["sql", &query, "--format", "csv"]));
        let values = found.lines().nth(1).unwrap().split(',').map(|x| x.parse().unwrap()).collect::<Vec<f64>>();
        let (before, after) = (values[0], values[1]);
        assert!(before > 5.0 && after < 0.2, "{name}: {before} to {after} nT");
    }
}

#[test]
fn user_a_date_with_two_readings_is_a_question() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = csv("time,mag,Bx,By,Bz", |s| {
        let [x, y, z] = s.vector;
        format!("{},{:.3},{x:.2},{y:.2},{z:.2}", dated("03/06/2024", s.t), s.scalar)
    });
    fs::write(folder.join("log.csv"), text).unwrap();
    let found = stdout(&magline(folder, &["init", "log.csv"]));
    assert!(found.contains("2024-06-03 or 2024-03-06"), "{found}");
    assert!(magline(folder, &["run", "log.toml", "--quiet"]).status.success());
    assert_eq!(numbers(&read(&folder.join("store/tables/log/even")), "doy")[0], 155.0, "3 June");
}

#[test]
fn user_columns_without_readable_values_are_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = csv("tt,mag,alt,lat,lon,what", |s| {
        format!("{:.3},{:.5},300.0,{:.6}N,{:.6}W,x", 50_000.0 + s.t, s.scalar / 1e3, s.lat, -s.lon)
    });
    fs::write(folder.join("log.csv"), text).unwrap();
    let found = stdout(&magline(folder, &["init", "log.csv"]));
    assert!(found.contains("no value is a number: lat, lon") && found.contains("not recognised: what"), "{found}");
    assert!(found.contains("mag: omitted: a median of 51.") && found.contains("in uT, the median would be"), "{found}");
}

#[test]
fn user_a_date_and_a_unit_of_a_log_reach_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = csv("time,Mag1 [nT],FluxX,FluxY,FluxZ,Lat,Lon", |s| {
        let [x, y, z] = s.vector.map(|b| b / 1e3);
        format!("{},{:.3},{x:.5},{y:.5},{z:.5},{:.7},{:.7}", iso(s.t), s.scalar, s.lat, s.lon)
    });
    fs::write(folder.join("log.csv"), text).unwrap();
    assert!(magline(folder, &["init", "log.csv"]).status.success());
    assert!(magline(folder, &["run", "log.toml", "--quiet"]).status.success());
    let even = read(&folder.join("store/tables/log/even"));
    // 14:00 two hours ahead of UTC is 12:00 UTC.
    assert!((numbers(&even, "tt")[0] - 43_200.0).abs() < 1e-6);
    let size = |i: usize| {
        ["x", "y", "z"].map(|axis| numbers(&even, &format!("flux_a_{axis}"))[i]).iter().map(|b| b * b).sum::<f64>()
    };
    let earth = EARTH.iter().map(|b| b * b).sum::<f64>().sqrt();
    assert!((size(100).sqrt() - earth).abs() < 1.0, "uT became nT");
}

/// Easting and northing in UTM zone 18 north, near its central meridian and 45 degrees north. There, the meridian arc
/// from the equator is 4,984,944.378 m, and the radii of curvature are 6,367,381.8 m along the meridian and 6,388,838.3
/// m across it.
fn utm_18n(s: &Sample) -> (f64, f64) {
    let (lat, lon) = ((s.lat - 45.0).to_radians(), (s.lon + 75.0).to_radians());
    let along = 4_984_944.378 + 6_367_381.8 * lat;
    (500_000.0 + 0.9996 * 6_388_838.3 * s.lat.to_radians().cos() * lon, 0.9996 * along)
}

#[test]
fn user_eastings_and_northings_become_latitude_and_longitude() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = csv("time,mag,Bx,By,Bz,UTM_X,UTM_Y", |s| {
        let ([x, y, z], (easting, northing)) = (s.vector, utm_18n(s));
        let time = dated("2024-06-03", s.t);
        format!("{time},{:.3},{x:.2},{y:.2},{z:.2},{easting:.2},{northing:.2}", s.scalar)
    });
    fs::write(folder.join("log.csv"), text).unwrap();
    // Without a coordinate system, the positions are a question and the spec runs without them.
    let found = stdout(&magline(folder, &["init", "log.csv", "-o", "none.toml"]));
    assert!(found.contains("`UTM_X`") && found.contains("--epsg"), "{found}");
    assert!(magline(folder, &["run", "none.toml", "--quiet"]).status.success());
    // A map of the area in the same system.
    let mut points = "easting,northing,anomaly\n".to_owned();
    for (i, j) in (0..81).map(|k| (k % 9, k / 9)) {
        let (easting, northing) = (498_000 + 500 * i, 4_981_000 + 500 * j);
        writeln!(points, "{easting},{northing},{}", i * j).unwrap();
    }
    fs::write(folder.join("points.csv"), points).unwrap();
    let grid = ["map", "grid", "points.csv", "--epsg", "32618", "--method", "minimum-curvature", "--spacing", "500"];
    let output = magline(folder, &[grid.as_slice(), &["-o", "map.tif"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    for (name, more) in [("given", ["--epsg", "32618"].as_slice()), ("on_map", &["map.tif"])] {
        let spec = format!("{name}.toml");
        let output = magline(folder, &[["init", "log.csv", "-o", &spec].as_slice(), more].concat());
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let mapping = fs::read_to_string(folder.join(format!("{name}_mapping.toml"))).unwrap();
        assert!(mapping.contains("\nprojected = {") && mapping.contains("epsg = 32618"), "{mapping}");
        let output = magline(folder, &["run", &spec, "--quiet"]);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let even = read(&folder.join(format!("store/tables/{name}/even")));
        let (lat, lon) = (numbers(&even, "lat"), numbers(&even, "lon"));
        let off = |(s, (lat, lon)): (&Sample, (&f64, &f64))| (lat - s.lat).hypot(lon - s.lon);
        let worst = flight().iter().zip(lat.iter().zip(&lon)).map(off).fold(0.0, f64::max);
        assert!(worst < 1e-6, "{name}: {worst} degrees");
    }
    let output = magline(folder, &["init", "log.csv", "--epsg", "4326", "-o", "degrees.toml"]);
    assert!(!output.status.success() && stderr(&output).contains("is in degrees"), "{}", stderr(&output));
}

#[test]
fn user_specs_of_autopilot_logs_run_with_a_mapping_chosen_by_content() {
    let logs = repository().join("datasets/samples/logs");
    for (log, mapping) in [("sample_log_small.ulg", "px4_ulog"), ("log171_cut.bin", "ardupilot_dataflash")] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        fs::copy(logs.join(log), folder.join(log)).unwrap();
        let output = magline(folder, &["init", log, "-o", "own.toml"]);
        assert!(output.status.success(), "{log}: {}", stderr(&output));
        assert!(stdout(&output).contains(mapping), "{log}: {}", stdout(&output));
        let output = magline(folder, &["run", "own.toml", "--quiet"]);
        assert!(output.status.success(), "{log}: {}{}", stderr(&output), stdout(&output));
    }
}

#[test]
fn user_existing_files_are_not_overwritten_and_a_failure_leaves_none() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let names = || {
        let mut all: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        all.sort();
        all
    };
    fs::write(folder.join("log.csv"), "UTC_seconds,mag\n50000.0,51000\n50000.1,51001\n").unwrap();
    fs::write(folder.join("log.toml"), "mine").unwrap();
    let output = magline(folder, &["init", "log.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("log.toml exists and is not overwritten"), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(folder.join("log.toml")).unwrap(), "mine");
    assert_eq!(names(), ["log.csv", "log.toml"]);
    for (name, bytes) in
        [("empty.csv", &b""[..]), ("words.csv", b"a,b\nx,y\n"), ("image.csv", b"\x89PNG\r\n\x1a\n\0\0")]
    {
        fs::write(folder.join(name), bytes).unwrap();
        let output = magline(folder, &["init", name, "-o", "new.toml"]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert!(message.contains(name), "{message}");
        fs::remove_file(folder.join(name)).unwrap();
        assert_eq!(names(), ["log.csv", "log.toml"], "{name}");
    }
    let output = magline(folder, &["init", "missing.csv"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn user_hostile_names_stay_text() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let log = "a'b \"c\" $(touch x) \u{202e}.csv";
    let text = csv("UTC_seconds,mag,flux_x,flux_y,flux_z,\"<b>\u{1b}[31m\"", |s| {
        let [x, y, z] = s.vector;
        format!("{:.3},{:.3},{x:.2},{y:.2},{z:.2},1", 50_000.0 + s.t, s.scalar)
    });
    fs::write(folder.join(log), text).unwrap();
    let output = magline(folder, &["init", log, "-o", "own.toml"]);
    let shown = stdout(&output) + &stderr(&output);
    assert!(output.status.success(), "{shown}");
    assert!(!shown.contains('\u{1b}') && !shown.contains('\u{202e}'), "{shown:?}");
    let output = magline(folder, &["run", "own.toml", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
}
