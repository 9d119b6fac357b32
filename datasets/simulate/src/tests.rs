#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::needless_range_loop)]

use std::{fs, path::PathBuf};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use datasets::{MapOptions, motion::GeodeticTrack, samples};
use nalgebra::Vector3;
use numerics::{
    earth::{attitude::body_to_ned, core_field::CoreField, dates::decimal_year, geodesy::EarthModel},
    maps::{
        map_stack::FieldMap,
        map_surface::{GeographicGrid, MapInterpolation, MapSurface},
    },
    navigation::{
        ekf::{self, EkfParameters},
        ins_series::InsSeries,
    },
};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use tempfile::TempDir;

use super::*;

const EXAMPLE: &str = "../examples/osborne.synth.toml";

fn example() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(EXAMPLE)
}

/// A short spec over Osborne, with `more` before the flights.
fn spec_text(more: &str, flights: &str) -> String {
    let map = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    format!("seed = 3\nyear = 2020\ndoy = 185\n{more}\n[map]\npath = '{}'\n{flights}", map.display())
}

const SHORT: &str = "
[[magnetometers]]
name = 'mag_2_uc'
permanent_nt = 100.0
induced_nt = 30.0
noise_nt = 0.1
[[vector_magnetometers]]
name = 'flux_a'
noise_nt = 1.0
[[flights]]
name = 'A'
[[flights.lines]]
name = 'A.1'
alt_m = 500.0
duration_s = 60.0
waypoints = [[-22.05, 140.6], [-21.9, 140.65]]
[[flights.lines]]
name = 'A.2'
alt_m = 800.0
duration_s = 30.0
waypoints = [[-21.9, 140.6], [-22.0, 140.65]]
";

fn written(folder: &TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("s.synth.toml");
    fs::write(&path, text).unwrap();
    path
}

fn lines(path: &std::path::Path) -> Vec<RecordBatch> {
    let simulation = Simulation::open(path).unwrap();
    let schema = simulation.schema();
    let lines: Vec<_> = simulation.into_lines(1).map(|l| l.unwrap().into_batch(path).unwrap()).collect();
    assert!(lines.iter().all(|l| l.schema() == schema), "the schema is known before a line is flown");
    lines
}

fn column<'a>(line: &'a RecordBatch, name: &str) -> &'a [f64] {
    line.column_by_name(name).unwrap().as_primitive::<Float64Type>().values()
}

fn name(line: &RecordBatch) -> &str {
    line.column_by_name("line").unwrap().as_string::<i32>().value(0)
}

fn flat(line: &RecordBatch, names: [&str; 3]) -> Vec<Vector3<f64>> {
    let c = names.map(|n| column(line, n));
    (0..line.num_rows()).map(|i| Vector3::new(c[0][i], c[1][i], c[2][i])).collect()
}

#[test]
fn law_velocity_and_force_are_the_derivatives_of_position() {
    for line in lines(&example()).iter().take(2) {
        let track = GeodeticTrack {
            tt: column(line, "tt"),
            lat_deg: column(line, "lat"),
            lon_deg: column(line, "lon"),
            alt_m: column(line, "alt"),
        };
        let differenced = track.velocity_mps();
        let velocity = ["vn", "ve", "vd"].map(|n| column(line, n).to_vec());
        for axis in 0..3 {
            for i in 1..line.num_rows() - 1 {
                // Central differences at 0.1 s have the error dt²/6 times the second derivative of the velocity. At the
                // start of a turn this is 60 m/s times 0.035 rad/s²: 3.5e-3 m/s.
                let error = differenced[axis][i] - velocity[axis][i];
                assert!(error.abs() < 4e-3, "{} axis {axis} row {i}: {error}", name(line));
            }
        }
        let truth =
            Simulation::open(&example()).unwrap().spec.flights[0].lines[usize::from(name(line) != "1.01")].clone();
        let true_track = truth.fly(10.0, [0.0; 3], &mut random::RandomStream::new(0, &[]));
        let force = track.specific_force_mps2(&true_track.velocity_mps);
        for axis in 0..3 {
            let mut sum = 0.0;
            for i in 1..line.num_rows() - 1 {
                let error = force[axis][i] - true_track.force_mps2[axis][i];
                // At a change of waypoint the rate of turn has a kink of up to 0.07 rad/s². A central difference then
                // has the error 60 m/s times the kink times dt/4.
                assert!(error.abs() < 0.11, "{} axis {axis} row {i}: {error}", name(line));
                sum += error * error;
            }
            // Elsewhere the error is v w³ dt²/6 = 4e-5 m/s²; a missing Coriolis term would be 9e-3 m/s².
            let rms = (sum / line.num_rows() as f64).sqrt();
            assert!(rms < 2e-3, "{} axis {axis}: {rms}", name(line));
        }
        let speed: Vec<f64> = (0..line.num_rows()).map(|i| velocity[0][i].hypot(velocity[1][i])).collect();
        // Along the surface, both radii of curvature are scaled by the height in the same way, with an error of 1.5e-6
        // at 3000 m.
        assert!(speed.iter().all(|v| (v - 60.0).abs() < 2e-3));
    }
}

#[test]
fn law_a_coordinated_turn_has_no_lateral_force() {
    let line = Simulation::open(&example()).unwrap().spec.flights[0].lines[1].clone();
    let true_track = line.fly(10.0, [0.0; 3], &mut random::RandomStream::new(0, &[]));
    let most_bank = true_track.attitude_deg[0].iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    assert!(most_bank > 15.0, "there is a turn");
    for i in 0..true_track.tt_s.len() {
        let [roll, pitch, yaw] = true_track.attitude_deg.each_ref().map(|a| a[i].to_radians());
        let f = Vector3::from_fn(|k, _| true_track.force_mps2[k][i]);
        let body = body_to_ned(roll, pitch, yaw).transpose() * f;
        // The Coriolis term 2 Ω v = 0.009 m/s², and the trim of 2 degrees of pitch, 6e-4 of the lift: 0.006 m/s².
        assert!(body.y.abs() < 0.03, "{i}: {}", body.y);
    }
}

#[test]
fn law_the_box_has_four_headings_and_its_manoeuvres() {
    let line = Simulation::open(&example()).unwrap().spec.flights[0].lines[0].clone();
    let true_track = line.fly(10.0, [0.0; 3], &mut random::RandomStream::new(0, &[]));
    for (axis, amplitude) in [(0, 9.0), (1, 4.5), (2, 5.0)] {
        let steady: Vec<f64> =
            (0..true_track.tt_s.len()).map(|i| line_manoeuvre(&line, &true_track, i)[axis]).collect();
        let most = steady.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        assert!((most / amplitude - 1.0).abs() < 0.02, "axis {axis}: {most}");
        let crossings = steady.windows(2).filter(|w| w[0] < 0.0 && w[1] >= 0.0).count();
        assert!((8..=14).contains(&crossings), "axis {axis}: four times three periods, not {crossings}");
    }
    let course =
        |i: usize| true_track.velocity_mps[1][i].atan2(true_track.velocity_mps[0][i]).to_degrees().rem_euclid(360.0);
    let end = course(true_track.tt_s.len() - 1);
    // The meridians converge by 0.02 degrees along the sides.
    assert!((end - 270.0).abs() < 0.05, "three right-angled turns to the right: {end}");
}

fn line_manoeuvre(line: &SynthLine, true_track: &trajectory::TrueTrajectory, i: usize) -> [f64; 3] {
    line.manoeuvre_deg(true_track.tt_s[i] - line.start_tt_s)
}

#[test]
fn law_the_earths_field_is_the_sum_of_its_parts() {
    let folder = TempDir::new().unwrap();
    let quiet = "[[magnetometers]]\nname = 'mag_1_c'\n[[vector_magnetometers]]\nname = 'flux_a'\n";
    let text = spec_text(
        "gusts_deg = [1.0, 1.0, 1.0]",
        &format!(
            "{quiet}[diurnal]\nsigma_nt = 5.0\n{}",
            SHORT.split_once("[[flights]]").unwrap().1.replacen("\nname", "[[flights]]\nname", 1)
        ),
    );
    let path = written(&folder, &text);
    let line = &lines(&path)[0];
    let flux = flat(line, ["flux_a_x", "flux_a_y", "flux_a_z"]);
    for i in (0..line.num_rows()).step_by(17) {
        let (lat, lon, tt) = (column(line, "lat")[i], column(line, "lon")[i], column(line, "tt")[i]);
        let core = CoreField::at(decimal_year(2020, 185, tt).unwrap()).unwrap();
        let b = Vector3::from(core.field_ned_nt(lat, lon, 500.0));
        // Rounding of 5e4 nT.
        assert!((column(line, "igrf")[i] - b.norm()).abs() < 1e-9);
        assert!((column(line, "mag_1_c")[i] - flux[i].norm()).abs() < 1e-9);
        let [roll, pitch, yaw] = ["roll", "pitch", "yaw"].map(|n| column(line, n)[i].to_radians());
        let added = body_to_ned(roll, pitch, yaw) * flux[i] - b;
        let along = column(line, "diurnal")[i] * b.normalize();
        // The irregular variation lies along the core field, so the sum without it is the anomaly. The conversion of
        // angles to degrees has errors of a few 1e-15 of 5e4 nT.
        let anomaly = (b + added - along).norm() - b.norm();
        assert!((anomaly - column(line, "anomaly_truth")[i]).abs() < 1e-8);
        assert!(column(line, "diurnal")[i] != 0.0 && anomaly != 0.0);
    }
}

#[test]
fn unit_the_same_spec_gives_the_same_bytes_and_one_row_group_per_line() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder, &spec_text("", SHORT));
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    let first = synthesise(&path, &a).unwrap();
    let second = synthesise(&path, &b).unwrap();
    assert_eq!(first.len(), 1);
    assert_eq!(fs::read(&first[0]).unwrap(), fs::read(&second[0]).unwrap());
    assert_eq!(fs::read_dir(&a).unwrap().count(), 1, "nothing half-written is left");
    let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(&first[0]).unwrap()).unwrap();
    let rows: Vec<i64> = reader.metadata().row_groups().iter().map(|g| g.num_rows()).collect();
    assert_eq!(rows, [601, 301]);
    let back: Vec<_> = reader.build().unwrap().map(Result::unwrap).collect();
    let schema = back[0].schema();
    assert_eq!(schema.field_with_name("mag_2_uc").unwrap().metadata()["unit"], "nT");
    let whole = arrow_select::concat::concat_batches(&schema, &back).unwrap();
    let simulated = arrow_select::concat::concat_batches(&schema, &lines(&path)).unwrap();
    assert_eq!(whole, simulated, "the file holds what the format yields");
}

#[test]
fn unit_an_added_flight_or_sensor_changes_no_other() {
    let folder = TempDir::new().unwrap();
    let before = lines(&written(&folder, &spec_text("", SHORT)));
    let current = "[[currents]]\nname = 'cur_x'\non_a = 1.0\n[[magnetometers]]\nname = 'mag_9_uc'\nnoise_nt = 1.0\n";
    let flight = "[[flights]]\nname = '0'\n[[flights.lines]]\nname = '0.1'\nalt_m = 900.0\nduration_s = 9.0\n\
                  waypoints = [[-21.9, 140.6], [-22.0, 140.65]]\n";
    let more = SHORT.replacen("[[flights]]", &format!("{current}{flight}[[flights]]"), 1);
    let after = lines(&written(&folder, &spec_text("", &more)));
    assert_eq!((before.len(), after.len()), (2, 3));
    for line in &before {
        let same = after.iter().find(|l| name(l) == name(line)).unwrap();
        for field in line.schema().fields() {
            assert_eq!(line.column_by_name(field.name()), same.column_by_name(field.name()), "{}", field.name());
        }
    }
    let other = lines(&written(&folder, &spec_text("", SHORT).replace("seed = 3", "seed = 4")));
    assert_ne!(column(&other[0], "mag_2_uc"), column(&before[0], "mag_2_uc"));
    assert_eq!(column(&other[0], "lat"), column(&before[0], "lat"), "without gusts the truth has nothing drawn");
}

#[test]
fn law_a_scalar_reads_the_magnitude_of_the_vector_sum() {
    let folder = TempDir::new().unwrap();
    let sensors = "[[magnetometers]]\nname = 'mag_1_c'\n[[magnetometers]]\nname = 'mag_2_uc'\npermanent_nt = 500.0\n";
    let flights = &SHORT[SHORT.find("[[flights]]").unwrap()..];
    let line = &lines(&written(&folder, &spec_text("gusts_deg = [3.0, 3.0, 3.0]", &format!("{sensors}{flights}"))))[0];
    let (truth, read) = (column(line, "mag_1_c"), column(line, "mag_2_uc"));
    let most = truth.iter().zip(read).fold(0.0_f64, |a, (t, r)| a.max((r - t).abs()));
    // A permanent field changes the magnitude by its component along the earth's field. The change is at most the
    // magnitude of the permanent field, and not zero.
    assert!(most <= 500.0 && most > 10.0, "{most}");
}

#[test]
fn law_the_velocity_of_the_ins_follows_from_its_measured_force() {
    // The velocity and position of the INS follow from its measured specific force.
    const ROWS: usize = 1200;
    for line in lines(&example()) {
        let c = |n: &str| column(&line, n);
        let (tt, ins_v) = (c("tt"), ["ins_vn", "ins_ve", "ins_vd"].map(c));
        let force = ["ins_fn", "ins_fe", "ins_fd"].map(c);
        let lat = |i: usize| c("ins_lat")[i].to_radians();
        let mut velocity = [ins_v[0][0], ins_v[1][0]];
        let mut moved_m = 0.0;
        for i in 0..ROWS {
            let half = 0.5 * (tt[i + 1] - tt[i]);
            for j in [i, i + 1] {
                // The specific force of zero acceleration. This subtraction removes the Coriolis and transport terms
                // and adds gravity.
                let v = [ins_v[0][j], ins_v[1][j], ins_v[2][j]];
                let rest = numerics::navigation::strapdown::specific_force_mps2(lat(j), c("ins_alt")[j], v, [0.0; 3]);
                velocity[0] += half * (force[0][j] - rest[0]);
                velocity[1] += half * (force[1][j] - rest[1]);
                moved_m += half * v[0];
            }
        }
        for axis in 0..2 {
            // The tolerance is five standard deviations of the velocity random walk over 120 s, which is 2.6e-3 m/s. A
            // tilt of 0.01 degrees of the wrong sign would give 0.4 m/s.
            let error = velocity[axis] - ins_v[axis][ROWS];
            assert!(error.abs() < 0.013, "{} axis {axis}: {error}", name(&line));
        }
        let middle = 0.5 * (lat(0) + lat(ROWS));
        let north_m = EarthModel::Wgs84.lat_rad_to_north_m(lat(ROWS) - lat(0), middle, c("alt")[0]);
        // The spherical error model differs from the meridian by 0.5 %, for an error of at most 10 m.
        assert!((north_m - moved_m).abs() < 0.3, "{}: {north_m} {moved_m}", name(&line));
    }
}

/// The INS' columns in the order of a series.
const IN_SERIES: [&str; 12] = [
    "ins_lat",
    "ins_lon",
    "ins_alt",
    "ins_vn",
    "ins_ve",
    "ins_vd",
    "ins_fn",
    "ins_fe",
    "ins_fd",
    "ins_roll",
    "ins_pitch",
    "ins_yaw",
];

/// DRMS of filter and INS in metres, and the mean NEES divided by 2, of a line navigated with the true field of the
/// stinger.
fn navigated(line: &RecordBatch, anomaly: &MapSurface) -> (f64, f64, f64) {
    let c = |n: &str| column(line, n);
    let columns: Vec<&[f64]> = std::iter::once("tt").chain(IN_SERIES).map(c).collect();
    let ins = InsSeries::from_columns(columns.try_into().unwrap());
    let core = CoreField::at(decimal_year(2020, 185, c("tt")[0]).unwrap()).unwrap();
    let parameters = EkfParameters { measurement_sigma_nt: 5.0, ..EkfParameters::default() };
    let out = ekf::run(&parameters, &ins, c("mag_1_c"), &FieldMap::Flat(anomaly.clone()), Some(&core)).unwrap();
    let (mut filter, mut drift, mut nees) = (0.0, 0.0, 0.0);
    let n = line.num_rows();
    for i in 0..n {
        let truth = (c("lat")[i], c("lon")[i]);
        let offset = |lat: f64, lon: f64| EarthModel::Wgs84.offset_ne_m(truth, (lat, lon), 500.0);
        let (dn, de) = offset(out.lat_deg[i], out.lon_deg[i]);
        let (ins_n, ins_e) = offset(c("ins_lat")[i], c("ins_lon")[i]);
        let (vn, ve, cov) = (out.sd_n_m[i].powi(2), out.sd_e_m[i].powi(2), out.cov_ne_m2[i]);
        filter += dn * dn + de * de;
        drift += ins_n * ins_n + ins_e * ins_e;
        nees += (ve * dn * dn - 2.0 * cov * dn * de + vn * de * de) / (vn * ve - cov * cov) / 2.0;
    }
    let mean = n as f64;
    ((filter / mean).sqrt(), (drift / mean).sqrt(), nees / mean)
}

#[test]
fn law_the_filter_is_more_accurate_than_the_ins_over_osborne() {
    let map =
        datasets::read_map(&samples::path("osborne/osborne_anomaly_100m_at_500m.tif"), &MapOptions::default()).unwrap();
    let grid = GeographicGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), map.column("anomaly")).unwrap();
    let anomaly = MapSurface::new(&grid, MapInterpolation::Cubic);
    let simulated = lines(&example());
    let surveys: Vec<_> = simulated.iter().filter(|l| !name(l).ends_with(".01")).collect();
    assert_eq!(surveys.len(), 6);
    for line in surveys {
        let (filter, drift, nees) = navigated(line, &anomaly);
        println!("{}: filter {filter:.1} m, INS {drift:.0} m, NEES/2 {nees:.2}", name(line));
        // A navigation-grade INS drifts by hundreds of metres in a quarter of an hour.
        assert!(filter < 50.0, "{}: {filter} m", name(line));
        assert!(drift > filter, "{}: {drift} m", name(line));
    }
}

#[test]
fn gold_all_faults_of_a_spec_are_reported_with_their_place() {
    let folder = TempDir::new().unwrap();
    let text = "seed = 1\nrate_hs = 10.0\n[map]\npath = 'none.tif'\n[[magnetometers]]\nname = 'mag_2_uc'\n\
                permanent_n = 3.0\n[[magnetometers]]\nname = 'mag_3_uc'\ncurrents = { cur_y = 1.0 }\n[[currents]]\n\
                name = 'cur_x'\non_a = 1.0\n[[currents]]\nname = 'cur_z'\non_a = 'much'\n\
                [[flights]]\nname = '1'\n[[flights.lines]]\nname = '1.1'\nkind = 'bok'\nalt_m = 500\n";
    let path = written(&folder, text);
    let message = Simulation::open(&path).unwrap_err().to_string();
    for (place, what) in [
        ("2:1", "`synth` has no key `rate_hs`"),
        ("7:1", "`magnetometers` has no parameter `permanent_n`"),
        ("10:14", "there is no current `cur_y`"),
        ("16:8", "`on_a` of `currents` must be a number"),
        ("21:8", "`kind` cannot be `bok`"),
    ] {
        assert!(message.contains(what), "{what} is not in\n{message}");
        assert!(message.contains(&format!("s.synth.toml:{place}\n")), "{place} is not in\n{message}");
    }
    for help in
        ["did you mean `rate_hz`?", "did you mean `permanent_nt`?", "did you mean `cur_x`?", "did you mean `box`?"]
    {
        assert!(message.contains(help), "{help} is not in\n{message}");
    }
    let message = Simulation::open(&written(&folder, "seed = \n")).unwrap_err().to_string();
    assert!(message.contains("s.synth.toml:1:"), "{message}");
}

#[test]
fn unit_all_faults_are_in_the_order_of_the_file() {
    let folder = TempDir::new().unwrap();
    // The invalid day, and a source with height and depth, are found after the keys of the tables below them.
    let text = "seed = 1\nyear = 2021\ndoy = 366\nrate_hs = 10.0\n[[sources]]\nlat = -22.0\nlon = 140.6\n\
                depth_m = 1.0\nalt_m = -1.0\nmoment_am2 = 1.0\n[ins]\ngrade = 'navigatoin'\n[[flights]]\n\
                name = '1'\n[[flights.lines]]\nname = '1.1'\nkind = 'bok'\nalt_m = 500\n";
    let message = Simulation::open(&written(&folder, text)).unwrap_err().to_string();
    let place = |line: &str| {
        let (line, column) = line.split_once("s.synth.toml:")?.1.split_once(':')?;
        Some((line.parse::<u32>().ok()?, column.parse::<u32>().ok()?))
    };
    let places: Vec<(u32, u32)> = message.lines().filter_map(place).collect();
    let lines: Vec<u32> = places.iter().map(|p| p.0).collect();
    assert!(
        [3, 4, 12, 17].iter().all(|line| lines.contains(line)) && lines.iter().any(|l| (5..=10).contains(l)),
        "{message}"
    );
    assert!(places.is_sorted(), "{message}");
}

#[test]
fn gold_lines_that_cannot_be_flown() {
    let folder = TempDir::new().unwrap();
    let first = |text: &str| {
        let simulation = Simulation::open(&written(&folder, text)).unwrap();
        simulation.into_lines(1).find_map(Result::err).unwrap().to_string()
    };
    let low = first(&spec_text("", &SHORT.replace("alt_m = 500.0", "alt_m = 100.0")));
    let expected = "the map's height (500 m) is above the line's height (100 m) (raise `alt_m` of the line to the \
                    map's height or above)";
    assert!(low.ends_with(expected), "{low}");
    let away = first(&spec_text("", &SHORT.replace("[-22.05, 140.6]", "[-22.05, 149.6]")));
    let expected = "flight A, line A.1: the line leaves the known part of the map after 0.0 s, at -22.05000, 149.60000";
    assert!(away.contains(expected), "{away}");
    let gone = spec_text("", SHORT).replace("osborne_anomaly_100m_at_500m.tif", "gone.tif");
    let gone = Simulation::open(&written(&folder, &gone)).unwrap_err().to_string();
    assert!(gone.contains("gone.tif` does not exist"), "{gone}");
}

#[test]
fn unit_a_failed_synthesis_leaves_no_file() {
    let folder = TempDir::new().unwrap();
    let path = written(
        &folder,
        &spec_text("", &SHORT.replace("[-21.9, 140.6], [-22.0, 140.65]", "[-21.9, 150.6], [-22.0, 140.65]")),
    );
    let to = folder.path().join("out");
    assert!(synthesise(&path, &to).is_err());
    assert_eq!(fs::read_dir(&to).unwrap().count(), 0);
}

#[test]
fn unit_partial_files_of_another_process_are_kept() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder, &spec_text("", SHORT));
    let to = folder.path().join("out");
    fs::create_dir(&to).unwrap();
    // A partial file of another process for the same flight.
    let other = to.join(".A.parquet.partial");
    fs::write(&other, b"half").unwrap();
    synthesise(&path, &to).unwrap();
    assert_eq!(fs::read(&other).unwrap(), b"half");
    assert_eq!(fs::read_dir(&to).unwrap().count(), 2);
}

#[test]
fn unit_files_have_the_same_bytes_on_any_number_of_threads() {
    let folder = TempDir::new().unwrap();
    let second = SHORT.split_once("[[flights]]").unwrap().1;
    let flights = ["B", "C"].map(|n| format!("[[flights]]{}", second.replace("'A", &format!("'{n}")))).concat();
    let path = written(&folder, &spec_text("gusts_deg = [1.0, 1.0, 1.0]", &format!("{SHORT}{flights}")));
    let bytes = |threads: usize| {
        let to = folder.path().join(format!("out{threads}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let reports = Mutex::new(vec![]);
        let files =
            pool.install(|| synthesise_with(&path, &to, &|n, of| reports.lock().unwrap().push((n, of)))).unwrap();
        let mut reports = reports.into_inner().unwrap();
        reports.sort_unstable();
        assert_eq!(reports, (1..=6).map(|n| (n, 6)).collect::<Vec<_>>());
        assert_eq!(fs::read_dir(&to).unwrap().count(), 3);
        files.iter().map(|f| fs::read(f).unwrap()).collect::<Vec<_>>()
    };
    let one = bytes(1);
    assert_eq!(one.len(), 3);
    assert!(one == bytes(2) && one == bytes(3));
}

#[test]
fn unit_lines_do_not_depend_on_the_number_simulated_in_parallel() {
    let folder = TempDir::new().unwrap();
    let second = SHORT.split_once("[[flights]]").unwrap().1;
    let flights = ["B", "C"].map(|n| format!("[[flights]]{}", second.replace("'A", &format!("'{n}")))).concat();
    let path = written(&folder, &spec_text("gusts_deg = [1.0, 1.0, 1.0]", &format!("{SHORT}{flights}")));
    let of = |at_once: usize| {
        let lines = Simulation::open(&path).unwrap().into_lines(at_once);
        lines.map(|l| l.unwrap().into_batch(&path).unwrap()).collect::<Vec<_>>()
    };
    let one = of(1);
    assert_eq!(one.len(), 6);
    for at_once in [2, 3, 4, 100] {
        assert!(of(at_once) == one, "{at_once}");
    }
}

#[test]
fn unit_copies_of_a_flight_have_separate_draws() {
    let folder = TempDir::new().unwrap();
    let copies = SHORT.replace("name = 'A'\n", "name = 'A'\ncopies = 3\n");
    let several = lines(&written(&folder, &spec_text("", &copies)));
    let flights: Vec<&str> =
        several.iter().map(|line| line.column_by_name("flight").unwrap().as_string::<i32>().value(0)).collect();
    assert_eq!(flights, ["A-1", "A-1", "A-2", "A-2", "A-3", "A-3"]);
    let [first, second] = [&several[0], &several[2]];
    assert_eq!(column(first, "tt"), column(second, "tt"), "the plan is the same");
    let error = |line: &RecordBatch| column(line, "ins_lat")[100] - column(line, "lat")[100];
    assert!(error(first) != error(second), "the INS is not");
    // A single flight with the name of a copy has the same draws: a copy depends only on its name.
    let alone = lines(&written(&folder, &spec_text("", &SHORT.replace("name = 'A'\n", "name = 'A-2'\n"))));
    assert_eq!(column(&alone[0], "ins_lat"), column(second, "ins_lat"));
    let field = |line: &RecordBatch| column(line, "mag_2_uc").to_vec();
    assert!(field(&alone[0]) == field(second) && field(first) != field(second));
}
