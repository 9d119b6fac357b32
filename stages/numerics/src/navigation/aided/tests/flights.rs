//! Consistency of each filter on flights over the Osborne map with known truth.

use super::*;
use crate::navigation::flights::{OsborneFlight, chi_square, world};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::pinson::{TILT_D, VE, VN};
use crate::random::NormalGenerator;

pub(super) const SAMPLES: u32 = 900;
const FLIGHTS: u64 = 20;

fn linearisations() -> [(&'static str, Linearisation); 3] {
    [
        ("once", Linearisation::Once),
        ("iterated", Linearisation::Iterated { iterations: 5, tolerance_m: 0.1 }),
        ("unscented", Linearisation::Unscented(UkfParameters::default())),
    ]
}

/// Additional field common to both magnetometers: a storm of 150 nT in a few minutes.
fn storm_nt(t_s: f64) -> f64 {
    150.0 * (t_s / 40.0).sin() + 60.0 * (t_s / 7.0).cos()
}

/// Difference of two magnetometers with this baseline.
pub(super) fn difference_nt(flight: &OsborneFlight, baseline_m: [f64; 3], sigma_nt: f64, seed: u64) -> Vec<f64> {
    let mut normals = NormalGenerator::new(seed);
    let bias = GaussMarkov { sigma: 0.3, tau_s: 600.0 }.realisation(&flight.truth.columns[0], || normals.draw());
    let (world, columns) = (world(), &flight.truth.columns);
    let field = |lat: f64, lon: f64, alt: f64| {
        world.map.at(lat, lon, alt).unwrap().value_nt + world.core.magnitude_nt(lat, lon, alt)
    };
    let of = |row: usize| {
        let [lat, lon, alt] = [1, 2, 3].map(|column: usize| columns[column][row]);
        let [roll, pitch, yaw] = [10, 11, 12].map(|column: usize| columns[column][row].to_radians());
        let tilt = Vector3::from_row_slice(&flight.errors[row][TILT_N..=TILT_D]);
        let arm = tilted(&body_to_ned(roll, pitch, yaw), &tilt) * Vector3::from(baseline_m);
        let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(lat.to_radians(), alt);
        let (dlat, dlon) = ((0.5 * arm.x / north).to_degrees(), (0.5 * arm.y / east).to_degrees());
        let up = -0.5 * arm.z;
        field(lat + dlat, lon + dlon, alt + up) - field(lat - dlat, lon - dlon, alt - up)
    };
    (0..columns[0].len()).map(|row| of(row) + bias[row] + sigma_nt * normals.draw()).collect()
}

/// Mean NEES of the position over flights, by time, and the mean square errors of filter and INS, in m².
pub(super) struct Consistency {
    nees: Vec<f64>,
    pub(super) square_m2: f64,
    ins_m2: f64,
    nis: f64,
}

const TIMES: [usize; 4] = [200, 450, 700, 899];

/// Consistency over flights with an error model; `of` filters the flight of a seed.
fn consistency(
    model: InsErrorModel,
    nis: impl Fn(&AidedOutput) -> &[f64],
    of: impl Fn(&OsborneFlight, u64) -> AidedOutput,
) -> Consistency {
    consistency_of(model, |flight, seed| {
        let mut output = of(flight, seed);
        output.navigation.nis = nis(&output).to_vec();
        output.navigation
    })
}

/// Same as `consistency`, for filters that return a track.
pub(super) fn consistency_of(
    model: InsErrorModel,
    of: impl Fn(&OsborneFlight, u64) -> NavigationOutput,
) -> Consistency {
    let mut found = Consistency { nees: vec![0.0; TIMES.len()], square_m2: 0.0, ins_m2: 0.0, nis: 0.0 };
    let n = FLIGHTS as f64;
    for seed in 0..FLIGHTS {
        let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
        let output = of(&flight, seed);
        for (sum, row) in found.nees.iter_mut().zip(TIMES) {
            *sum += flight.nees(&output, row) / n;
        }
        found.square_m2 += flight.square_m2(&output, 100) / n;
        let ins = crate::navigation::ins_only::run(&flight.ins.series(), &flight.model, None).unwrap();
        found.ins_m2 += flight.square_m2(&ins, 100) / n;
        let all: Vec<f64> = output.nis.iter().copied().filter(|nis| nis.is_finite()).collect();
        found.nis += all.iter().sum::<f64>() / (all.len() as f64 * n);
    }
    found
}

impl Consistency {
    /// Asserts that the NEES is within the 99.9 % band at each of four times, and that the NIS is near 1.
    pub(super) fn assert(&self, what: &str, nis_within: f64) {
        let freedom = 2.0 * FLIGHTS as f64;
        let (low, high) = (chi_square(freedom, -3.29) / FLIGHTS as f64, chi_square(freedom, 3.29) / FLIGHTS as f64);
        let (error, ins) = (self.square_m2.sqrt(), self.ins_m2.sqrt());
        println!(
            "{what}: NEES {:.2?} ({low:.2}..{high:.2}), NIS {:.3}, DRMS {error:.1} m of {ins:.1} m",
            self.nees, self.nis
        );
        assert!(self.nees.iter().all(|nees| (low..=high).contains(nees)), "{what}: {:?}", self.nees);
        assert!((self.nis - 1.0).abs() < nis_within, "{what}: NIS {}", self.nis);
    }
}

/// INS with a drift of hundreds of metres in 15 min.
pub(super) fn drifting() -> InsErrorModel {
    InsErrorModel::from_sources(InsErrors { init_velocity_sigma_mps: 0.3, ..InsErrors::default() })
}

const BASELINE: [f64; 3] = [15.0, 0.0, 0.0];

fn with_difference(flight: &OsborneFlight, seed: u64, linearisation: Linearisation, scalar: bool) -> AidedOutput {
    let difference = difference_nt(flight, BASELINE, 0.05, 500 + seed);
    let mut measured = flight.measured(1000 + seed, 5.0);
    if scalar {
        measured.iter_mut().zip(&flight.truth.columns[0]).for_each(|(nt, t_s)| *nt += storm_nt(*t_s));
    } else {
        measured.fill(f64::NAN);
    }
    let (ins, sigma) = (flight.ins.series(), vec![5.0; SAMPLES as usize]);
    let line = flight.line(&ins, &measured, &sigma);
    let aids = Aids {
        difference: Some(DifferenceAid {
            difference_nt: &difference,
            sigma_nt: 0.05,
            baseline_m: BASELINE,
            slope: SlopeError::default(),
            bias: GaussMarkov { sigma: 0.3, tau_s: 600.0 },
        }),
        ..Aids::default()
    };
    let aids = if scalar { Aids::default() } else { aids };
    run(&line, &aids, &AidedParameters { linearisation, ..AidedParameters::default() }).unwrap()
}

#[test]
fn law_a_difference_navigates_through_a_magnetic_storm() {
    for (name, linearisation) in linearisations() {
        let by = |scalar: bool| {
            consistency(
                drifting(),
                |output| if scalar { &output.navigation.nis } else { &output.aids.difference.nis },
                |flight, seed| with_difference(flight, seed, linearisation, scalar),
            )
        };
        let difference = by(false);
        difference.assert(&format!("difference, {name}"), 0.05);
        assert!(
            difference.square_m2 < 0.1 * difference.ins_m2,
            "{name}: {} {}",
            difference.square_m2,
            difference.ins_m2
        );
        let scalar = by(true);
        println!("scalar, {name}: NEES {:.0?}, DRMS {:.0} m", scalar.nees, scalar.square_m2.sqrt());
        assert!(scalar.nees.iter().all(|nees| *nees > 20.0), "{name}: {:?}", scalar.nees);
    }
}

#[test]
fn law_a_difference_is_consistent_with_a_heading_error_of_half_a_degree() {
    let sources = InsErrors { init_heading_sigma_deg: Some(0.5), init_velocity_sigma_mps: 0.3, ..InsErrors::default() };
    for (name, linearisation) in linearisations() {
        let found = consistency(
            InsErrorModel::from_sources(sources),
            |output| &output.aids.difference.nis,
            |flight, seed| with_difference(flight, seed, linearisation, false),
        );
        found.assert(&format!("difference, half a degree, {name}"), 0.05);
    }
}

/// Gauss-Markov process of the distance flown.
pub(super) fn lasting_error_nt(flight: &OsborneFlight, of: MapErrorProcess, seed: u64) -> Vec<f64> {
    let mut normals = NormalGenerator::new(seed);
    let columns = &flight.truth.columns;
    let mut error_nt = of.sigma_nt * normals.draw();
    let mut all = vec![error_nt];
    for row in 1..columns[0].len() {
        let step_m = columns[4][row - 1].hypot(columns[5][row - 1]);
        let decay = (-step_m / of.length_m).exp();
        error_nt = decay * error_nt + of.sigma_nt * (1.0 - decay * decay).sqrt() * normals.draw();
        all.push(error_nt);
    }
    all
}

#[test]
fn law_a_correlated_map_error_is_a_state() {
    let lasting = MapErrorProcess { sigma_nt: 15.0, length_m: 1000.0 };
    let by = |map_error: Option<MapErrorProcess>| {
        consistency(
            drifting(),
            |output| &output.navigation.nis,
            |flight, seed| {
                let mut measured = flight.measured(1000 + seed, 2.0);
                let errors = lasting_error_nt(flight, lasting, 700 + seed);
                measured.iter_mut().zip(errors).for_each(|(nt, error)| *nt += error);
                // White noise of the same standard deviation, for the filter without this state.
                let sigma_nt = map_error.map_or(15.0_f64.hypot(2.0), |_| 2.0);
                let (ins, sigma) = (flight.ins.series(), vec![sigma_nt; SAMPLES as usize]);
                let aids = Aids { map_error, ..Aids::default() };
                run(&flight.line(&ins, &measured, &sigma), &aids, &AidedParameters::default()).unwrap()
            },
        )
    };
    by(Some(lasting)).assert("map error as a state", 0.05);
    let white = by(None);
    println!("map error as white noise: NEES {:.1?}", white.nees);
    assert!(white.nees.iter().sum::<f64>() > 3.0 * 2.0 * TIMES.len() as f64, "{:?}", white.nees);
}

/// Vector magnetometer with biases, in the crustal field of a flight.
pub(super) fn vector_nt(flight: &OsborneFlight, seed: u64) -> [Vec<f64>; 3] {
    let mut normals = NormalGenerator::new(seed);
    let (world, columns) = (world(), &flight.truth.columns);
    let mut of = |sigma: f64, tau_s: f64| GaussMarkov { sigma, tau_s }.realisation(&columns[0], || normals.draw());
    let biases = [(); 3].map(|()| of(20.0, 3600.0));
    let mut field = [vec![], vec![], vec![]];
    let mut crustal = [0.0; 3];
    for row in 0..columns[0].len() {
        let [lat, lon, alt] = [1, 2, 3].map(|column: usize| columns[column][row]);
        let [roll, pitch, yaw] = [10, 11, 12].map(|column: usize| columns[column][row].to_radians());
        for part in &mut crustal {
            let step_m = if row == 0 { f64::INFINITY } else { columns[4][row - 1].hypot(columns[5][row - 1]) };
            let decay = (-step_m / 2000.0).exp();
            *part = decay * *part + 40.0 * (1.0 - decay * decay).sqrt() * normals.draw();
        }
        let core = Vector3::from(world.core.field_ned_nt(lat, lon, alt));
        let along = world.map.at(lat, lon, alt).unwrap().value_nt + flight.errors[row][S];
        let ned = core + core.normalize() * along + Vector3::from(crustal);
        let tilt = &flight.errors[row][TILT_N..=TILT_D];
        let turn = tilted(&body_to_ned(roll, pitch, yaw), &Vector3::new(tilt[0], tilt[1], tilt[2]));
        let body = turn.transpose() * ned;
        (0..3).for_each(|axis| field[axis].push(body[axis] + biases[axis][row] + 5.0 * normals.draw()));
    }
    field
}

#[test]
fn law_a_vector_observes_the_heading_and_little_of_the_position() {
    // Heading accurate to half a degree, as for an INS without gyrocompassing.
    let sources = InsErrors { init_heading_sigma_deg: Some(0.5), ..InsErrors::default() };
    let model = InsErrorModel::from_sources(sources);
    let mut figures = vec![];
    for with in [false, true] {
        let fly = |flight: &OsborneFlight, seed: u64| {
            let (measured, field) = (flight.measured(1000 + seed, 5.0), vector_nt(flight, 300 + seed));
            let (ins, sigma) = (flight.ins.series(), vec![5.0; SAMPLES as usize]);
            let vector = VectorAid {
                field_nt: field.each_ref().map(Vec::as_slice),
                sigma_nt: 5.0,
                bias: GaussMarkov { sigma: 20.0, tau_s: 3600.0 },
                crustal_sigma_nt: 40.0,
                crustal_length_m: 2000.0,
                core: &world().core,
            };
            let aids = Aids { vector: with.then_some(vector), ..Aids::default() };
            let parameters = AidedParameters { keep_states: true, keep_covariance: true, ..AidedParameters::default() };
            run(&flight.line(&ins, &measured, &sigma), &aids, &parameters).unwrap()
        };
        let mut heading = [0.0; 2];
        let n = FLIGHTS as f64;
        let mut velocity = 0.0;
        let found =
            consistency(model, |output| if with { &output.aids.vector.nis } else { &output.navigation.nis }, fly);
        for seed in 0..FLIGHTS {
            let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
            let out = fly(&flight, seed).navigation;
            let row = 300;
            let off = flight.errors[row][TILT_D] - out.x[row][TILT_D];
            heading[0] += off * off / n;
            heading[1] += off * off / out.p[row][TILT_D][TILT_D] / n;
            velocity += (VN..=VE).map(|k| (flight.errors[row][k] - out.x[row][k]).powi(2)).sum::<f64>() / n;
        }
        let deg = heading[0].sqrt().to_degrees();
        println!(
            "with a vector {with}: heading {deg:.3} degrees after 300 s, its NEES {:.2}; velocity {:.3} m/s",
            heading[1],
            velocity.sqrt()
        );
        found.assert(&format!("vector {with}"), 0.05);
        // The 99.9 % band of chi-square with 20 degrees of freedom.
        assert!((0.25..2.4).contains(&heading[1]), "{}", heading[1]);
        figures.push((deg, found.square_m2.sqrt()));
    }
    let [(without_deg, without_m), (with_deg, with_m)] = [figures[0], figures[1]];
    assert!(with_deg < 0.5 * without_deg && with_deg < 0.1, "{with_deg} {without_deg}");
    assert!(with_m < 1.1 * without_m, "{with_m} {without_m}");
}

#[test]
fn law_a_height_bounds_the_drift_of_the_vertical_channel() {
    // INS barometer with an error of 30 m, and another height of 3 m with a bias of 5 m.
    let sources =
        InsErrors { baro_sigma_m: 30.0, ha_sigma_m: 30.0, init_altitude_sigma_m: 10.0, ..InsErrors::default() };
    let model = InsErrorModel::from_sources(sources);
    let (mut squares, mut nees) = ([0.0; 2], 0.0);
    for seed in 0..FLIGHTS {
        let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
        let mut normals = NormalGenerator::new(900 + seed);
        let bias = GaussMarkov { sigma: 5.0, tau_s: 1200.0 };
        let lasting = bias.realisation(&flight.truth.columns[0], || normals.draw());
        let heights: Vec<f64> =
            flight.truth.columns[3].iter().zip(lasting).map(|(alt, b)| alt + b + 3.0 * normals.draw()).collect();
        let (measured, sigma) = (flight.measured(1000 + seed, 5.0), vec![5.0; SAMPLES as usize]);
        let ins = flight.ins.series();
        let line = flight.line(&ins, &measured, &sigma);
        let parameters = AidedParameters { keep_states: true, keep_covariance: true, ..AidedParameters::default() };
        for (k, height) in [None, Some(HeightAid { alt_m: &heights, sigma_m: 3.0, bias })].into_iter().enumerate() {
            let out = run(&line, &Aids { height, ..Aids::default() }, &parameters).unwrap().navigation;
            let square = (flight.errors[899][ALT] - out.x[899][ALT]).powi(2);
            squares[k] += square / FLIGHTS as f64;
            if k == 1 {
                nees += square / out.p[899][ALT][ALT] / FLIGHTS as f64;
            }
        }
    }
    println!("height {:.1} m without, {:.1} m with, NEES {nees:.2}", squares[0].sqrt(), squares[1].sqrt());
    assert!((0.25..2.4).contains(&nees) && squares[1] < 0.5 * squares[0], "{nees} {squares:?}");
}
