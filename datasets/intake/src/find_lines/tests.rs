//! Lines detected in simulated flights, where the true lines are known, and in real flights.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{collections::BTreeMap, fs, sync::Arc};

use arrow_array::{cast::AsArray, types::Float64Type};
use datasets::{FlightOptions, ReadHints, samples};
use tempfile::TempDir;

use super::*;
use crate::{mapping::Mapping, open_log};

/// First and last time of each line.
type Times = BTreeMap<String, (f64, f64)>;

/// Lines found in a simulated flight, and the simulator's times of the lines.
fn detect_in_simulation(lines: &str) -> (LineDetection, Times) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.synth.toml");
    let map = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    let text = format!(
        "seed = 3\nyear = 2020\ndoy = 185\n[map]\npath = '{}'\n[wind]\nspeed_mps = 8.0\nfrom_deg = 240.0\n\
         [turbulence]\nlevel = 'light'\n[[flights]]\nname = 'F'\nstart_tt_s = 40000.0\n{lines}",
        map.display()
    );
    fs::write(&path, text).unwrap();
    let open = || open_log(&path, &FlightOptions::default(), None, &ReadHints::default()).unwrap();
    let mut times: Times = BTreeMap::new();
    let mut log = open();
    while let Some(part) = log.next_part() {
        let batch = part.unwrap().batch;
        let names = batch.column_by_name("line").unwrap().as_string::<i32>().clone();
        let tt = batch.column_by_name("tt").unwrap().as_primitive::<Float64Type>().clone();
        for row in 0..batch.num_rows() {
            let t = tt.value(row);
            let known = times.entry(names.value(row).to_owned()).or_insert((t, t));
            *known = (known.0.min(t), known.1.max(t));
        }
    }
    let mut collector = ChannelCollector::default();
    collector.read(open(), "").unwrap();
    let mut flights = collector.found();
    assert_eq!(flights.len(), 1);
    (flights.remove(0).1, times)
}

fn line(name: &str, keys: &str) -> String {
    format!("[[flights.lines]]\nname = '{name}'\nalt_m = 600.0\n{keys}\n")
}

fn kinds(found: &LineDetection) -> Vec<LinePattern> {
    found.lines.iter().map(|l| l.kind).collect()
}

/// Maximum error of the times of a line, in seconds.
const SHARP_S: f64 = 4.0;

fn close(found: (f64, f64), known: (f64, f64)) -> bool {
    (found.0 - known.0).abs() < SHARP_S && (found.1 - known.1).abs() < SHARP_S
}

#[test]
fn unit_simulated_calibrations_are_found_at_their_times() {
    let spec = [
        line("1", "kind = 'box'\nstart = [-22.0, 140.6]\nheading_deg = 30.0"),
        line("2", "kind = 'cloverleaf'\ncenter = [-22.0, 140.6]\nheading_deg = 15.0"),
        line("3", "kind = 'figure_eight'\ncenter = [-22.0, 140.6]\nheading_deg = 70.0"),
        line("4", "kind = 'box'\nstart = [-22.0, 140.6]\nlegs = 8\namplitude_deg = [5.0, 0.0, 4.0]\nspeed_mps = 30.0"),
        line("5", "kind = 'circle'\ncenter = [-22.0, 140.6]\nradius_m = 1500.0\nturns = 1.5"),
        line("6", "kind = 'figure_eight'\ncenter = [-22.0, 140.6]\nrounds = 3\nspeed_mps = 28.0"),
        line("7", "kind = 'cloverleaf'\ncenter = [-22.0, 140.6]\ncrossings = 9\ndirection = 'left'"),
    ];
    let (found, known) = detect_in_simulation(&spec.concat());
    let expected = [
        LinePattern::Box,
        LinePattern::Cloverleaf,
        LinePattern::FigureEight,
        LinePattern::Box,
        LinePattern::Circle,
        LinePattern::FigureEight,
        LinePattern::Cloverleaf,
    ];
    assert_eq!(kinds(&found), expected, "{:?}", found.spans());
    for (line, known) in found.lines.iter().zip(known.values()) {
        let times = found.times_s(line);
        assert!(close(times, *known), "{}: {times:?} {known:?}", line.name);
    }
    let names: Vec<&str> = found.lines.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["box1", "cloverleaf1", "figure_eight1", "box2", "circle1", "figure_eight2", "cloverleaf2"]);
    // No pitch was flown on the second box.
    assert_eq!(found.lines[0].manoeuvres, [true; 3]);
    assert_eq!(found.lines[3].manoeuvres, [true, false, true]);
}

#[test]
fn unit_a_grid_has_the_same_lines_whole_and_split() {
    let grid = |split: bool| {
        let keys = format!(
            "kind = 'grid'\nsplit = {split}\norigin = [-22.0, 140.6]\nheading_deg = 20.0\nline_m = 9000.0\n\
             spacing_m = 800.0\n\
             count = 5\ntie_spacing_m = 4000.0"
        );
        detect_in_simulation(&line("G", &keys))
    };
    // The simulator's lines of the split grid have the times of the whole grid without the turns.
    let ((found, whole), (_, known)) = (grid(false), grid(true));
    assert_eq!((whole.len(), known.len()), (1, 8));
    for (name, times) in &known {
        let near = |l: &&DetectedLine| close(found.times_s(l), *times);
        let line = found.lines.iter().find(near).unwrap_or_else(|| panic!("{name} {times:?} in {:?}", found.spans()));
        assert_eq!(line.kind, if name.contains('T') { LinePattern::Tie } else { LinePattern::Line }, "{name}");
    }
    // A further straight stretch leads from the last line to the first tie line.
    let overlaps = |a: (f64, f64), b: (f64, f64)| a.0 < b.1 - SHARP_S && b.0 < a.1 - SHARP_S;
    for line in &found.lines {
        let times = found.times_s(line);
        assert!(known.values().filter(|k| overlaps(times, **k)).count() <= 1, "{} {times:?}", line.name);
    }
    assert!(found.lines.len() <= 8 + 1, "{:?}", found.spans());
}

#[test]
fn unit_survey_legs_are_lines_and_plain_squares_are_no_boxes() {
    let square =
        "kind = 'free'\nwaypoints = [[-22.0, 140.6], [-21.9, 140.6], [-21.9, 140.7], [-22.0, 140.7], [-22.0, 140.58]]";
    let narrow = "kind = 'grid'\nsplit = false\norigin = [-22.0, 140.6]\nline_m = 3000.0\nspacing_m = 50.0\ncount = 6\n\
                  speed_mps = 28.0";
    let (found, known) = detect_in_simulation(&line("1", square));
    assert_eq!(kinds(&found), [LinePattern::Line; 4], "{:?}", found.spans());
    let headings: Vec<f64> = found.lines.iter().filter_map(|l| l.heading_deg).collect();
    for (heading, expected) in headings.iter().zip([0.0, 90.0, 180.0, 270.0]) {
        assert!((heading - expected + 180.0_f64).rem_euclid(360.0) - 180.0 < 1.0, "{headings:?}");
    }
    let (first, last) = (found.times_s(&found.lines[0]).0, found.times_s(&found.lines[3]).1);
    assert!(close((first, last), known["1"]));
    // Loops of 270 degrees from one line to a nearby next line are not cloverleafs.
    let (found, _) = detect_in_simulation(&line("1", narrow));
    assert!(kinds(&found).iter().all(|k| *k == LinePattern::Line) && found.lines.len() >= 6, "{:?}", found.spans());
}

/// Lines found in tables of a log, through a ready mapping.
fn through(mapping: &str, files: &[(&str, &str)]) -> LineDetection {
    let mapping = Arc::new(Mapping::load(mapping, |name| Ok(name.into())).unwrap());
    let mut collector = ChannelCollector::default();
    for (file, table) in files {
        let mapped = mapping.table(Some(table)).unwrap();
        let path = samples::path(file);
        let log = open_log(&path, &FlightOptions::default(), Some(&mapped), &ReadHints::default()).unwrap();
        collector.read(log, table).unwrap();
    }
    collector.found().remove(0).1
}

#[test]
fn ref_a_small_aircraft_flies_its_squares_between_take_off_and_landing() {
    // According to the log, the aircraft is in the air from 211 to 579 s and flies squares of 150 m from 235 to 533 s.
    // The clock of the log was 0 at 16:45:31.259 UTC.
    let found = through("thor75_parquet", &[("thor75/flight.parquet", "flight")]);
    let start_s = 16.0 * 3600.0 + 45.0 * 60.0 + 31.259;
    let on_squares = |line: &&DetectedLine| {
        let (from, to) = found.times_s(line);
        assert!(from > start_s + 210.0 && to < start_s + 580.0, "{} {from} {to}", line.name);
        from > start_s + 235.0 && to < start_s + 533.0
    };
    let sides: Vec<&DetectedLine> = found.lines.iter().filter(on_squares).collect();
    // The flight has seven laps. The downwind leg counts as part of one turn, because the roll is never level for two
    // seconds.
    let headings: Vec<f64> = sides.iter().map(|side| (side.heading_deg.unwrap() + 5.0).rem_euclid(360.0)).collect();
    for course in [0.0, 180.0, 270.0] {
        let of = headings.iter().filter(|h| ((**h - course + 180.0).rem_euclid(360.0) - 180.0).abs() < 30.0).count();
        assert_eq!(of, 7, "{course}: {:?}", found.spans());
    }
    assert_eq!(sides.len(), 21, "{:?}", found.spans());
    for side in sides {
        // The autopilot's squares are 5 degrees off the compass; wind and GNSS at 1 Hz cause further deviation.
        let off = (side.heading_deg.unwrap() + 5.0).rem_euclid(90.0);
        let length_m = found.length_m(side).unwrap();
        assert!(off.min(90.0 - off) < 22.0 && length_m < 150.0, "{side:?} {length_m}");
    }
    // Before that time the aircraft climbed in a turn.
    let mut later = found.lines.iter().filter(|l| found.times_s(l).0 > start_s + 235.0);
    assert!(later.all(|l| l.kind == LinePattern::Line), "{:?}", found.spans());
}

#[test]
fn ref_an_aerobatic_flight_has_circles_and_none_on_the_ground() {
    // According to the log, the aircraft is on the ground until 262 s and in flight from 262 to 580 s. The log has
    // three tables with separate clocks.
    let tables = [("skywalker_x8/gps.parquet", "gps"), ("skywalker_x8/attitude.parquet", "attitude")];
    let found = through("skywalker_x8_parquet", &tables);
    let start_s = 21.0 * 3600.0 + 59.0 * 60.0 + 47.52;
    assert!(found.lines.iter().filter(|l| l.kind == LinePattern::Circle).count() >= 5, "{:?}", found.spans());
    for line in &found.lines {
        let (from, to) = found.times_s(line);
        assert!(from > start_s + 260.0 && to < start_s + 582.0, "{} {from} {to}", line.name);
    }
    // Columns of the table of attitudes.
    let known = |x: &[f64]| x.iter().filter(|x| x.is_finite()).count();
    assert!(known(&found.motion.angles_deg[0]) > 2000 && known(&found.motion.alt_m) > 1000);
}

/// Flight from a place along courses, in degrees and s, at 40 m/s, with turns of 3 degrees per second.
fn along(legs: &[(f64, f64)], from: (f64, f64)) -> FlightChannels {
    let mut channels = FlightChannels::default();
    let (mut lat, mut lon, mut t) = (from.0, from.1, 1000.0);
    let mut course = legs[0].0;
    let mut fly = |course: f64| {
        let [roll, pitch, yaw] = &mut channels.attitude.angles_deg;
        channels.position.tt_s.push(t);
        channels.position.lat_deg.push(lat);
        channels.position.lon_deg.push(if lon > 180.0 { lon - 360.0 } else { lon });
        channels.position.alt_m.push(300.0);
        channels.attitude.tt_s.push(t);
        roll.push(0.0);
        pitch.push(0.0);
        yaw.push(course.rem_euclid(360.0));
        lat += 4.0 * course.to_radians().cos() / 111_000.0;
        lon += 4.0 * course.to_radians().sin() / (111_000.0 * lat.to_radians().cos());
        t += 0.1;
    };
    for (to, seconds) in legs {
        while (to - course).abs() > 1e-9 {
            course += (to - course).clamp(-0.3, 0.3);
            fly(course);
        }
        (0..(10.0 * seconds) as usize).for_each(|_| fly(course));
    }
    channels
}

#[test]
fn unit_the_same_lines_are_found_anywhere_and_from_headings_alone() {
    let legs = [(350.0, 120.0), (440.0, 90.0), (530.0, 120.0)];
    let spans = |channels: &FlightChannels| LineDetection::from_channels(channels).spans();
    let here = spans(&along(&legs, (-33.0, 20.0)));
    assert_eq!(here.len(), 3);
    // Legs of 120, 90 and 120 s with turns of 30 s between.
    for ((_, from, to), (first, last)) in here.iter().zip([(1000.0, 1120.0), (1150.0, 1240.0), (1270.0, 1390.0)]) {
        assert!(close((*from, *to), (first, last)), "{here:?}");
    }
    assert_eq!(spans(&along(&legs, (52.0, 179.95))), here, "over the date line");
    let mut headings = along(&legs, (-33.0, 20.0));
    headings.position = PositionChannel::default();
    let found = LineDetection::from_channels(&headings);
    assert_eq!(found.lines.len(), 3);
    assert!(found.lines.iter().all(|l| found.length_m(l).is_none() && l.heading_deg.is_some()));
}

#[test]
fn unit_a_flight_without_lines_has_a_reason() {
    let fault_text =
        |channels: &FlightChannels| LineDetection::from_channels(channels).missing("7").unwrap().to_string();
    assert!(fault_text(&FlightChannels::default()).contains("neither positions nor headings"));
    let mut still = along(&[(0.0, 60.0)], (10.0, 10.0));
    still.position.lat_deg.fill(10.0);
    still.position.lon_deg.fill(10.0);
    assert!(LineDetection::from_channels(&still).lines.is_empty());
    let mut gone = along(&[(0.0, 60.0)], (10.0, 10.0));
    gone.position.lat_deg.fill(f64::NAN);
    gone.attitude = AttitudeChannel::default();
    assert!(fault_text(&gone).contains("neither positions nor headings"));
    // A gap of the receiver divides a line.
    let mut gap = along(&[(0.0, 100.0)], (10.0, 10.0));
    gap.attitude = AttitudeChannel::default();
    gap.position.lat_deg[400..600].fill(f64::NAN);
    let spans = LineDetection::from_channels(&gap).spans();
    assert_eq!(spans.len(), 2, "{spans:?}");
    assert!((spans[0].2 - 1039.9).abs() < 1.0 && (spans[1].1 - 1060.0).abs() < 1.0, "{spans:?}");
}

#[test]
fn unit_the_table_of_lines_is_restored() {
    let found = LineDetection::from_channels(&along(&[(350.0, 120.0), (440.0, 90.0)], (-33.0, 20.0)));
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("lines.csv");
    let spans = found.spans();
    fs::write(&path, csv(&[("7, \"a\"".to_owned(), found.clone())])).unwrap();
    let table = crate::LineTable::read(&path).unwrap();
    assert_eq!(table.lines_of("7, \"a\""), spans);
    // Given lines are drawn like detected lines.
    let mut given = found.clone();
    given.divide(&spans);
    let rows = |f: &LineDetection| f.lines.iter().map(|l| (l.name.clone(), l.kind, l.rows.clone())).collect::<Vec<_>>();
    assert_eq!(rows(&given), rows(&found));
    assert!(svg("a flight", &found).unwrap().contains("line2"));
}
