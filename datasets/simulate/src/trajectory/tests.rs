#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::needless_range_loop)]

use std::{f64::consts::TAU, fs};

use datasets::samples;
use numerics::navigation::strapdown::slopes;
use numerics::signal::spectrum::{SpectralTaper, welch};

use super::{
    super::{Simulation, random::RandomStream},
    gusts::DrydenGusts,
    *,
};

/// The lines of a spec with one flight. `tables` precede the flight, `lines` are its lines.
fn lines(tables: &str, lines: &str) -> Result<Vec<SynthLine>, String> {
    let folder = tempfile::TempDir::new().unwrap();
    let map = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    let text = format!("{tables}\n[map]\npath = '{}'\n[[flights]]\nname = 'F'\n{lines}", map.display());
    let path = folder.path().join("s.synth.toml");
    fs::write(&path, text).unwrap();
    let simulation = Simulation::open(&path).map_err(|e| e.to_string())?;
    Ok(simulation.spec().flights[0].lines.clone())
}

fn line(tables: &str, keys: &str) -> SynthLine {
    lines(tables, &format!("[[flights.lines]]\nname = 'L'\nalt_m = 500.0\n{keys}")).unwrap().remove(0)
}

fn fly(line: &SynthLine, rate_hz: f64) -> TrueTrajectory {
    line.fly_on(true, rate_hz, [0.0; 3], &mut RandomStream::new(1, &["test"]))
}

const WIND: &str = "[wind]\nspeed_mps = 12.0\nfrom_deg = 240.0\n";

const EACH: [&str; 8] = [
    "kind = 'survey'\nduration_s = 900.0\nweave_deg = 8.0\nwaypoints = [[-22.0, 140.5], [-21.9, 140.5], [-21.9, \
     140.65]]",
    "kind = 'free'\nwaypoints = [[-22.0, 140.5], [-21.9, 140.55], [-22.0, 140.65], [-21.9, 140.7]]\n\
     alts_m = [500.0, 600.0, 550.0, 700.0]",
    "kind = 'box'\nstart = [-22.0, 140.5]\nheading_deg = 30.0",
    "kind = 'grid'\nsplit = false\norigin = [-22.0, 140.5]\nheading_deg = 10.0\nline_m = 4000.0\nspacing_m = 400.0\n\
     count = 4\ntie_spacing_m = 2000.0",
    "kind = 'circle'\ncenter = [-22.0, 140.5]\nradius_m = 1500.0\nturns = 2.0",
    "kind = 'looping'\ncenter = [-22.0, 140.5]\nturns = 1.0\nrounds = 2\ntop_m = 700.0\ndirection = 'left'",
    "kind = 'figure_eight'\ncenter = [-22.0, 140.5]\nheading_deg = 20.0\nrounds = 2",
    "kind = 'loiter'\nstart = [-22.0, 140.5]\nheading_deg = 70.0\nrounds = 2",
];

const CLOVERLEAF: &str = "kind = 'cloverleaf'\ncenter = [-22.0, 140.5]\nheading_deg = 15.0";

fn ned_m(truth: &TrueTrajectory, i: usize, from: (f64, f64)) -> (f64, f64) {
    let place = (truth.lat_deg[i], truth.lon_deg[i]);
    numerics::earth::geodesy::EarthModel::Wgs84.offset_ne_m(from, place, truth.alt_m[i])
}

#[test]
fn law_velocity_force_and_rates_are_the_derivatives_of_position_and_attitude() {
    let tables = format!("{WIND}[turbulence]\nlevel = 'moderate'\n");
    for keys in EACH.iter().chain([&CLOVERLEAF]) {
        let line = line(&tables, keys);
        let truth = fly(&line, 250.0);
        let rows = truth.tt_s.len().min(40_000);
        let t = &truth.tt_s[..rows];
        let earth = numerics::earth::geodesy::EarthModel::Wgs84;
        let slope = |x: &[f64]| slopes(t, &x[..rows]);
        let (dlat, dlon, dalt) = (slope(&truth.lat_deg), slope(&truth.lon_deg), slope(&truth.alt_m));
        let dv = truth.velocity_mps.each_ref().map(|v| slope(v));
        let angles = truth.attitude_deg.each_ref();
        let mut sum = 0.0;
        for i in 1..rows - 1 {
            let (lat, alt) = (truth.lat_deg[i].to_radians(), truth.alt_m[i]);
            let v = truth.velocity_mps.each_ref().map(|v| v[i]);
            let differenced = [
                dlat[i].to_radians() * earth.north_m_per_rad(lat, alt),
                dlon[i].to_radians() * earth.east_m_per_rad(lat, alt),
                -dalt[i],
            ];
            let f = specific_force_mps2(lat, alt, v, [dv[0][i], dv[1][i], dv[2][i]]);
            for axis in 0..3 {
                // Errors of central differences over 8 ms: the jerk jumps at the nodes by up to 100 m/s³, as does the
                // gusts' slope. The error is dt²/6 of the jump for the velocity and dt/4 for the force.
                assert!((differenced[axis] - v[axis]).abs() < 3e-4, "{keys} {i} {axis}: {differenced:?} {v:?}");
                let error = f[axis] - truth.force_mps2[axis][i];
                assert!(error.abs() < 0.1, "{keys} {i} {axis}: {error}");
                sum += error * error;
            }
            if (1..3).all(|a| (angles[a][i + 1] - angles[a][i - 1]).abs() < 90.0) {
                let turn = truth.attitude(i - 1).transpose() * truth.attitude(i + 1);
                let skew = (turn - turn.transpose()) * (0.5 / (t[i + 1] - t[i - 1]));
                let rates = [skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]].map(f64::to_degrees);
                for axis in 0..3 {
                    let error = rates[axis] - truth.rates_degps[axis][i];
                    // The error is dt/4 times the jump of the rate of the angular acceleration, below 50 deg/s³.
                    assert!(error.abs() < 5e-2, "{keys} {i} {axis}: {error} of {}", rates[axis]);
                }
            }
        }
        // A missing Coriolis term would be 9e-3 m/s².
        let rms = (sum / (3 * rows) as f64).sqrt();
        assert!(rms < 4e-3, "{keys}: {rms}");
    }
}

#[test]
fn law_the_flight_does_not_depend_on_the_sample_rate() {
    let tables = format!("{WIND}[turbulence]\nlevel = 'light'\n");
    let line = line(&tables, EACH[2]);
    let fly = |rate| line.fly_on(true, rate, [1.0, 0.5, 0.5], &mut RandomStream::new(1, &["test"]));
    let (slow, fast) = (fly(10.0), fly(250.0));
    assert_eq!((fast.tt_s.len() - 1) / 25, slow.tt_s.len() - 1);
    for i in 0..slow.tt_s.len() {
        let columns = |t: &TrueTrajectory, i: usize| {
            let mut all = vec![t.lat_deg[i], t.lon_deg[i], t.alt_m[i]];
            for set in [&t.velocity_mps, &t.attitude_deg, &t.rates_degps] {
                all.extend(set.iter().map(|x| x[i]));
            }
            all
        };
        for (a, b) in columns(&slow, i).iter().zip(columns(&fast, 25 * i)) {
            // Rounding of the time within a step.
            assert!((a - b).abs() < 1e-7, "{i}: {a} {b}");
        }
    }
}

#[test]
fn law_the_wind_triangle_closes_without_sideslip_or_lateral_force() {
    for (tables, wind) in [("", 0.0), (WIND, 12.0)] {
        for keys in EACH.iter().chain([&CLOVERLEAF]).filter(|k| !k.contains("box")) {
            let truth = fly(&line(tables, keys), 10.0);
            let from = 240f64.to_radians();
            for i in 0..truth.tt_s.len() {
                let v = Vector3::from_fn(|a, _| truth.velocity_mps[a][i]);
                let air = v + Vector3::new(from.cos(), from.sin(), 0.0) * wind;
                // Both radii are scaled by the height in the same way, with an error of 3e-7 at 500 m. The curve
                // through the nodes has errors of 1e-5.
                assert!((air.norm() - 60.0).abs() < 2e-3, "{keys} {i}: {}", air.norm());
                let body = truth.attitude(i).transpose();
                let through = body * air;
                assert!(through.y.abs() < 0.02, "{keys} {i}: sideslip {}", through.y);
                let f = body * Vector3::from_fn(|a, _| truth.force_mps2[a][i]);
                // The attitude uses derivatives of fourth order at 0.05 s.
                assert!(f.y.abs() < 5e-3, "{keys} {i}: sideways {}", f.y);
                let (attack, load) = (through.z.atan2(through.x).to_degrees(), f.norm() / 9.79);
                assert!((attack - 2.0 * load).abs() < 0.02, "{keys} {i}: {attack} {load}");
            }
        }
    }
}

#[test]
fn law_bank_is_that_of_a_coordinated_turn_within_the_roll_rate() {
    let truth = fly(&line("", EACH[4]), 10.0);
    let expected = (60f64 * 60.0 / (1500.0 * 9.79)).atan().to_degrees();
    // The Coriolis term 2 Ω v sin(lat) = 0.0033 m/s² of 9.8: 0.02 degrees; the earth's curvature and the trim
    // contribute 0.1 %.
    assert!(truth.attitude_deg[0].iter().all(|bank| (bank - expected).abs() < 0.05));
    let tables = format!("{WIND}[dynamics]\nbank_deg = 20.0\nroll_rate_degps = 6.0\n");
    for keys in EACH {
        let truth = fly(&line(&tables, &keys.replace("radius_m = 1500.0", "")), 10.0);
        let most = |x: &[f64]| x.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        if keys.contains("box") {
            continue;
        }
        // The bank angle is the arc tangent of the centripetal acceleration over g. The curvature is 3 % above the
        // curvature estimated from the chord, and the wind contributes 5 % to the turn.
        assert!(most(&truth.attitude_deg[0]) < 20.0 * 1.02, "{keys}: {}", most(&truth.attitude_deg[0]));
        assert!(most(&truth.rates_degps[0]) < 6.0 * 1.1, "{keys}: {}", most(&truth.rates_degps[0]));
        assert!(most(&truth.attitude_deg[0]) > 10.0);
    }
}

#[test]
fn law_lines_of_a_grid_are_straight_parallel_and_evenly_spaced() {
    let keys = EACH[3].replace("split = false", "").replace("400.0", "300.0");
    let text = format!("[[flights.lines]]\nname = 'G'\nalt_m = 500.0\n{keys}");
    let lines = lines(WIND, &text).unwrap();
    let names: Vec<_> = lines.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["G.01", "G.02", "G.03", "G.04", "G.T01", "G.T02", "G.T03"]);
    let axis = 10f64.to_radians();
    let scale = 1.0 + 500.0 / 6.37e6;
    let mut before_s = 0.0;
    for (k, line) in lines.iter().enumerate() {
        let truth = fly(line, 10.0);
        assert!(line.start_tt_s > before_s || k == 0);
        before_s = line.start_tt_s + line.duration_s();
        for i in 0..truth.tt_s.len() {
            let (north, east) = ned_m(&truth, i, (-22.0, 140.5));
            let (ahead, right) = (north * axis.cos() + east * axis.sin(), east * axis.cos() - north * axis.sin());
            let (ahead, right) = (ahead / scale, right / scale);
            // `offset_ne_m` uses mean radii: 4e-8 of 4 km, and 0.1 m for the convergence of the meridians over 1 km.
            match k {
                0..=3 => assert!((right - 300.0 * k as f64).abs() < 0.3 && (-1.0..=4001.0).contains(&ahead), "{k} {i}"),
                _ => {
                    assert!((ahead - 2000.0 * (k - 4) as f64).abs() < 0.3 && (-1.0..=901.0).contains(&right), "{k} {i}")
                }
            }
        }
        let (north, _) = ned_m(&truth, truth.tt_s.len() - 1, (truth.lat_deg[0], truth.lon_deg[0]));
        if k < 4 {
            assert_eq!(north > 0.0, k % 2 == 0, "every other line runs back");
        }
    }
    // The grid as one line has the same positions at the same times, and the turns between the lines.
    let whole = fly(&line(WIND, &keys.replace("spacing_m = 300", "split = false\nspacing_m = 300")), 10.0);
    let third = fly(&lines[2], 10.0);
    let at = ((lines[2].start_tt_s - lines[0].start_tt_s) * 10.0).ceil() as usize;
    let ((lat, lon), (n, e)) =
        ((third.lat_deg[0], third.lon_deg[0]), ned_m(&whole, at, (third.lat_deg[0], third.lon_deg[0])));
    assert!(n.hypot(e) < 8.0, "within a sample's way of {lat} {lon}: {n} {e}");
}

#[test]
fn law_closed_patterns_return_to_their_start_and_cross_at_their_centre() {
    for tables in ["", WIND] {
        for k in [4, 5, 6, 7] {
            let line = line(tables, EACH[k]);
            let truth = fly(&line, 20.0);
            let last = truth.tt_s.len() - 1;
            let (n, e) = ned_m(&truth, last, (truth.lat_deg[0], truth.lon_deg[0]));
            // The last sample is up to 0.05 s, 3.6 m, before the end.
            assert!(n.hypot(e) < 3.8, "{}: {n} {e}", EACH[k]);
        }
        let truth = fly(&line(tables, CLOVERLEAF), 20.0);
        let away = |i: usize| {
            let (n, e) = ned_m(&truth, i, (-22.0, 140.5));
            n.hypot(e)
        };
        let near =
            (1..truth.tt_s.len() - 1).filter(|i| away(*i) < 2.0 && away(*i) <= away(i - 1) && away(*i) < away(i + 1));
        let courses: Vec<_> = near
            .map(|i| truth.velocity_mps[1][i].atan2(truth.velocity_mps[0][i]).to_degrees().rem_euclid(360.0).round())
            .collect();
        assert_eq!(courses, [15.0, 285.0, 195.0, 105.0]);
    }
}

#[test]
fn law_waypoints_are_reached_and_legs_are_geodesics() {
    let nearest = |truth: &TrueTrajectory, place: (f64, f64)| {
        let away = |i: usize| {
            let (n, e) = ned_m(truth, i, place);
            n.hypot(e)
        };
        (0..truth.tt_s.len()).map(away).fold(f64::INFINITY, f64::min)
    };
    // A return flight: a turn by more than a right angle begins over its waypoint. Samples are 7 m apart.
    let back = "kind = 'survey'\nduration_s = 800.0\nwaypoints = [[-22.0, 140.5], [-21.9, 140.5]]";
    let truth = fly(&line(WIND, back), 10.0);
    let later = TrueTrajectory { lat_deg: truth.lat_deg[3000..].to_vec(), ..TrueTrajectory::default() };
    assert!(nearest(&truth, (-21.9, 140.5)) < 4.0);
    assert!(later.lat_deg.iter().any(|lat| (lat + 22.0).abs() < 4e-5), "and back over the first");
    // Smaller turns are flown inside the corner, and the middle of each leg is on the geodesic.
    let places = [(-22.0, 140.5), (-21.8, 140.5), (-21.8, 140.8), (-21.7, 140.8)];
    let list = places.map(|(lat, lon)| format!("[{lat:?}, {lon:?}]")).join(", ");
    let truth = fly(&line(WIND, &format!("kind = 'free'\nwaypoints = [{list}]")), 50.0);
    for leg in places.windows(2) {
        let way = geodesic::Geodesic::between(leg[0], leg[1]).unwrap();
        let middle = geodesic::RoutePosition::new(leg[0], way.leaves_rad).along(0.5 * way.length_m, 1000.0, |_| 0.0);
        // Half of the distance between samples along the track: 0.8 m.
        assert!(nearest(&truth, middle.degrees()) < 0.8, "{leg:?}");
    }
    let corner = nearest(&truth, places[1]);
    // R = (72 m/s)² / (g tan 25°) = 1134 m: the track is 0.41 R inside the corner, plus the roll-in and roll-out.
    assert!((470.0..650.0).contains(&corner), "{corner}");
    assert!(nearest(&truth, places[3]) < 1.5);
}

#[test]
fn law_manoeuvres_of_a_box_in_wind_are_flown_between_its_turns() {
    let keys = "kind = 'box'\nstart = [-22.0, 140.5]\nheading_deg = 70.0\namplitude_deg = [0.0, 5.0, 0.0]\ncycles = 5";
    let truth = fly(&line(WIND, keys), 10.0);
    let (mut swinging, mut turning) = (0, 0);
    for i in 0..truth.tt_s.len() {
        let (roll, pitch) = (truth.attitude_deg[0][i], truth.attitude_deg[1][i]);
        // In a turn the load factor adds a fifth to the 2 degrees of trim.
        let swings = (pitch - 2.0).abs() > 0.5;
        swinging += usize::from(swings);
        turning += usize::from(roll > 5.0);
        assert!(!swings || roll.abs() < 0.5, "{i}: {roll} {pitch}");
    }
    // Four legs of 30 s, on 6 % of which the course is within half a degree; and three right-angled turns.
    assert!((1000..1200).contains(&swinging) && turning > 300, "{swinging} {turning}");
}

#[test]
fn law_heights_are_as_requested_and_climbs_within_the_limit() {
    let truth = fly(&line("", EACH[1]), 10.0);
    let climb = truth.velocity_mps[2].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    assert!(climb < 5.0 && climb > 0.5, "{climb}");
    assert!((truth.alt_m[0] - 500.0).abs() < 1e-9 && (truth.alt_m.last().unwrap() - 700.0).abs() < 0.2);
    let steep = EACH[1].replace("600.0", "1900.0");
    let message = lines("", &format!("[[flights.lines]]\nname = 'L'\nalt_m = 500.0\n{steep}")).unwrap_err();
    assert!(message.contains("the climb after height no. 1 is") && message.contains("`drape = true`"), "{message}");
    let truth = fly(&line("", &format!("{steep}\ndrape = true")), 10.0);
    let most = truth.alt_m.iter().fold(0.0_f64, |a, b| a.max(*b));
    let climb = truth.velocity_mps[2].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    // Rounding off lowers the crest by 5/32 of the change of slope, 2 x 5 / 60, times 300 m: 8 m.
    assert!((1891.0..1901.0).contains(&most) && climb < 5.01, "{most} {climb}");
    let top = fly(&line("", EACH[5]), 10.0).alt_m.iter().fold(0.0_f64, |a, b| a.max(*b));
    assert!((695.0..700.5).contains(&top), "{top}");
}

#[test]
fn law_the_box_sets_have_the_amplitudes_and_numbers_of_table_5_7() {
    let keys = "[[flights.lines]]\nname = 'B'\nkind = 'box'\nalt_m = 500.0\nstart = [-22.0, 140.5]\nsets = [1, 18]";
    let sets = lines("", keys).unwrap();
    assert_eq!(sets.len(), 18);
    // Gnadt 2022, table 5.7: pitch, roll, yaw amplitudes in degrees, and swings per leg.
    let printed = [
        ([2.5, 0.0, 0.0], 2),
        ([5.0, 0.0, 0.0], 2),
        ([10.0, 0.0, 0.0], 2),
        ([2.5, 0.0, 0.0], 6),
        ([5.0, 0.0, 0.0], 6),
        ([10.0, 0.0, 0.0], 6),
        ([2.5, 5.0, 0.0], 2),
        ([5.0, 10.0, 0.0], 2),
        ([10.0, 20.0, 0.0], 2),
        ([2.5, 5.0, 0.0], 6),
        ([5.0, 10.0, 0.0], 6),
        ([10.0, 20.0, 0.0], 6),
        ([2.5, 5.0, 2.5], 2),
        ([5.0, 10.0, 5.0], 2),
        ([10.0, 20.0, 10.0], 2),
        ([2.5, 5.0, 2.5], 6),
        ([5.0, 10.0, 5.0], 6),
        ([10.0, 20.0, 10.0], 6),
    ];
    for (k, (line, (amplitude, swings))) in sets.iter().zip(printed).enumerate() {
        assert_eq!(line.name, format!("B.{:02}", k + 1));
        let truth = fly(line, 10.0);
        // The first leg, until 3 s before the course begins to turn.
        let straight = (0..truth.tt_s.len()).take_while(|i| course_deg(&truth, *i).abs() < 0.01).count() - 30;
        for (axis, asked) in [(1, amplitude[0]), (0, amplitude[1]), (2, amplitude[2])] {
            let trim = if axis == 1 { 2.0 } else { 0.0 };
            let angle: Vec<f64> = truth.attitude_deg[axis][..straight].iter().map(|a| a - trim).collect();
            let most = angle.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            // The Coriolis term banks the aircraft by 0.02 degrees; samples deviate from a crest by up to 0.05 s of 6
            // s: 0.2 %.
            assert!((most - asked).abs() < 0.003 * asked + 0.04, "set {}: axis {axis} {most} of {asked}", k + 1);
            if asked > 0.0 {
                let crests: Vec<usize> = (1..straight - 1)
                    .filter(|i| angle[*i] > 0.9 * asked && angle[*i] >= angle[i - 1] && angle[*i] > angle[i + 1])
                    .collect();
                assert_eq!(crests.len(), swings, "set {} axis {axis}", k + 1);
                let period = (crests[swings - 1] - crests[0]) as f64 / 10.0 / (swings - 1) as f64;
                assert!((period - 6.0).abs() < 0.11, "{period}");
            }
        }
    }
}

fn course_deg(truth: &TrueTrajectory, i: usize) -> f64 {
    truth.velocity_mps[1][i].atan2(truth.velocity_mps[0][i]).to_degrees()
}

#[test]
fn ref_gusts_at_the_heights_of_the_standard() {
    // MIL-F-8785C, 3.7.3.4: at 1000 feet and above L = 1000 ft and sigma = 0.1 W20 in all axes; 3.7.2.1: 1750 ft.
    let moderate = Turbulence { wind_20ft_mps: 30.0 * 1852.0 / 3600.0, ground_m: 100.0 };
    let at = |h_ft: f64| moderate.at(100.0 + h_ft * 0.3048);
    let (low, edge, high) = (at(20.0), at(1000.0), at(3750.0));
    let ft = |x: f64| x / 0.3048;
    for axis in 0..3 {
        assert!((ft(edge.length_m[axis]) - 1000.0).abs() < 0.5);
        assert!((edge.sigma_mps[axis] - 0.1 * moderate.wind_20ft_mps).abs() < 1e-3);
        assert!((ft(high.length_m[axis]) - 1750.0).abs() < 1e-9);
        // Figure 7: 10.6 ft/s at 3750 ft, exceeded with a probability of 1e-3.
        assert!((ft(high.sigma_mps[axis]) - 10.6).abs() < 0.1);
    }
    assert!((ft(low.length_m[2]) - 20.0).abs() < 1e-9);
    assert!((ft(low.length_m[0]) - 20.0 / (0.177f64 + 0.000823 * 20.0).powf(1.2)).abs() < 1e-9);
}

/// The Dryden spectra of the three gusts at a frequency, in (m/s)²/Hz; their integrals are the variances.
/// [MIL-F-8785C, 3.7.1.2]
fn dryden_density(turbulence: &Turbulence, alt_m: f64, frequency_hz: f64, airspeed_mps: f64) -> [f64; 3] {
    let gusts = turbulence.at(alt_m);
    [0, 1, 2].map(|axis| {
        let (sigma, tau_s) = (gusts.sigma_mps[axis], gusts.length_m[axis] / airspeed_mps);
        let x2 = (TAU * frequency_hz * tau_s).powi(2);
        match axis {
            0 => 4.0 * sigma * sigma * tau_s / (1.0 + x2),
            _ => 2.0 * sigma * sigma * tau_s * (1.0 + 3.0 * x2) / (1.0 + x2).powi(2),
        }
    })
}

#[test]
fn law_gusts_have_drydens_spectra() {
    let turbulence = Turbulence { wind_20ft_mps: 15.0, ground_m: 0.0 };
    let (alt_m, v, rate_hz) = (250.0, 60.0, 20.0);
    let mut random = RandomStream::new(4, &["spectra"]);
    let mut dryden = DrydenGusts::new(&mut random);
    let mut gusts = [vec![], vec![], vec![]];
    const SEGMENT: usize = 4096;
    for _ in 0..SEGMENT * 64 {
        let now = dryden.next(&turbulence, (alt_m, v, 11.0), 1.0 / rate_hz, &mut random);
        gusts.iter_mut().zip(now).for_each(|(column, x)| column.push(x));
    }
    for (axis, gust) in gusts.iter().enumerate() {
        let spectrum = welch(gust, rate_hz, SEGMENT, SpectralTaper::Hann).unwrap();
        let density = |f: f64| {
            // The spectrum of samples is folded at half the rate.
            let folded = (1..50).flat_map(|k| [f64::from(k) * rate_hz - f, f64::from(k) * rate_hz + f]);
            std::iter::once(f).chain(folded).map(|f| dryden_density(&turbulence, alt_m, f, v)[axis]).sum::<f64>()
        };
        // Bands of bins from 0.02 Hz up. Each bin of 127 half-overlapping segments is chi-square with 2 x 127 / (1 +
        // 2/36) degrees of freedom. The correlation of neighbouring bins is 4/9, so 2.2 bins count as one independent
        // bin.
        let mut low = 4;
        while 2 * low < SEGMENT / 2 {
            let band = low..2 * low;
            let ratio = band.clone().map(|k| spectrum.density[k] / density(spectrum.frequency_hz[k])).sum::<f64>()
                / band.len() as f64;
            let freedom = 2.0 * 127.0 / 1.055 * (band.len() as f64 / 2.2).max(1.0);
            let bound = 4.5 * (2.0 / freedom).sqrt();
            assert!((ratio - 1.0).abs() < bound, "axis {axis}, {low}: {ratio} within {bound}");
            low *= 2;
        }
        let variance = gust.iter().map(|x| x * x).sum::<f64>() / gust.len() as f64;
        let sigma = turbulence.at(alt_m).sigma_mps[axis];
        // 13100 s of gusts with a scale of 6 to 10 s contain 650 independent values. The tolerance is four standard
        // errors, each 5 % of the variance.
        assert!((variance / (sigma * sigma) - 1.0).abs() < 0.22, "axis {axis}: {variance}");
    }
}

#[test]
fn law_the_motion_grows_with_turbulence_and_the_height_is_held() {
    let straight = "kind = 'free'\nwaypoints = [[-22.0, 140.5], [-21.5, 140.5]]";
    let still = fly(&line("", straight), 10.0);
    let mut shaken = vec![];
    for level in ["light", "moderate", "severe"] {
        let truth = fly(&line(&format!("[turbulence]\nlevel = '{level}'\n"), straight), 10.0);
        let rms =
            |a: &[f64], b: &[f64]| (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt();
        let angles = [0, 1, 2].map(|axis| rms(&truth.attitude_deg[axis], &still.attitude_deg[axis]));
        let alt = rms(&truth.alt_m, &still.alt_m);
        let vd = rms(&truth.velocity_mps[2], &still.velocity_mps[2]);
        println!("{level}: roll, pitch, yaw {angles:.2?} deg, height {alt:.2} m, vd {vd:.2} m/s");
        shaken.push((angles, alt));
    }
    // Light turbulence rolls a light aircraft by about a degree; the pilot holds height within metres.
    let (light, alt) = shaken[0];
    assert!((0.5..2.5).contains(&light[0]) && (0.05..1.0).contains(&light[1]) && (0.05..1.5).contains(&light[2]));
    assert!((0.3..5.0).contains(&alt), "{alt}");
    assert!(shaken[1].0[0] > 1.2 * light[0] && shaken[2].0[0] > 1.8 * light[0]);
}

#[test]
fn law_wind_changes_with_height_by_shear_and_veer() {
    let wind = Wind { speed_mps: 5.0, from_deg: 270.0, at_alt_m: 100.0, shear_mps_per_km: 10.0, veer_deg_per_km: 90.0 };
    let (north, east) = wind.at(100.0);
    assert!(north.abs() < 1e-12 && (east - 5.0).abs() < 1e-12);
    let (north, east) = wind.at(1100.0);
    assert!((north + 15.0).abs() < 1e-12 && east.abs() < 1e-12, "from the north, 15 m/s");
    assert_eq!(wind.at(-900.0).1, 0.0);
}

#[test]
fn gold_lines_that_cannot_be_flown_are_reported_at_their_key() {
    let fault_text = |tables: &str, keys: &str| {
        lines(tables, &format!("[[flights.lines]]\nname = 'L'\nalt_m = 500.0\n{keys}")).unwrap_err()
    };
    for (tables, keys, place, what) in [
        (
            "",
            "kind = 'free'\nwaypoints = [[88.5, 0.0], [88.5, 180.0]]",
            "9:8",
            "the line comes within a degree of a pole",
        ),
        ("", "kind = 'circle'\ncenter = [-22.0, 140.5]\nradius_m = 300.0", "11:12", "needs a bank of 51 degrees"),
        (
            "",
            "kind = 'free'\nwaypoints = [[-22.0, 140.5], [-22.0, 140.501], [-21.9, 140.5]]",
            "10:13",
            "the leg after waypoint 1",
        ),
        ("[wind]\nspeed_mps = 55.0", EACH[4], "7:1", "a wind of 55.0 m/s is too strong"),
        ("", "kind = 'looping'\ncenter = [-22.0, 140.5]\ntop_m = 9000.0", "11:9", "but `climb_mps`"),
        (
            "",
            "kind = 'free'\nwaypoints = [[-22.0, 140.5], [-21.9, 140.5]]\nalts_m = [500.0]",
            "11:10",
            "one height for each of the 2",
        ),
        ("", "kind = 'grid'\norigin = [-22.0, 140.5]\nline_m = 500.0", "6:1", "`lines` needs `spacing_m`"),
        ("[turbulence]\nlevel = 'lihgt'", EACH[4], "2:9", "`level` cannot be `lihgt`"),
        ("", "kind = 'box'\nstart = [-22.0, 140.5]\nsets = [3, 19]", "11:8", "must be 1 to 18"),
    ] {
        let message = fault_text(tables, keys);
        assert!(message.contains(what), "{what} is not in\n{message}");
        assert!(message.contains(&format!("s.synth.toml:{place}\n")), "{place} is not in\n{message}");
    }
}
