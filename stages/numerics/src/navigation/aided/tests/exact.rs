//! Two magnetometers in the exact field of dipoles, and incomplete maps of it.

use super::flights::drifting;
use super::*;
use crate::maps::magnetic_sources::{Dipole, direction};
use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::{GeographicGrid, MapSurface, VerticalDerivative};
use crate::navigation::flights::OsborneFlight;
use crate::navigation::ins_error::simulate_ins_error;
use crate::navigation::osborne::Line;
use crate::navigation::pinson::{StateVector, TILT_D};
use crate::random::NormalGenerator;

const SAMPLES: u32 = 900;
const FLIGHTS: u64 = 10;
const ALT_M: f64 = 500.0;
/// Pitch of an aircraft in trimmed flight, in degrees.
const TRIM_DEG: f64 = 2.5;
const BASELINE: [f64; 3] = [15.0, 0.0, 0.0];
const SIGMA_NT: f64 = 0.05;
const MIDDLE_DEG: [f64; 2] = [-21.958, 140.6675];

/// Field of dipoles up to 1 km below the ellipsoid.
struct Ground {
    dipoles: Vec<Dipole>,
    along: [f64; 3],
    m_per_deg: [f64; 2],
}

impl Ground {
    fn new() -> Self {
        let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(MIDDLE_DEG[0].to_radians(), ALT_M);
        let m_per_deg = [north, east].map(|m| m / 1_f64.to_degrees());
        let mut normals = NormalGenerator::new(77);
        let along = direction(-53.0, 6.0);
        let mut even = || (0.5 * (normals.draw() * 1e6).fract()).abs() * 2.0;
        let one = |_| {
            let at_m = [52e3 * even() - 26e3, 56e3 * even() - 28e3, -1000.0 * even()];
            let size = (2.0 * even() - 1.0) * 4e8;
            Dipole { at_m, moment_am2: along.map(|part| size * part) }
        };
        Self { dipoles: (0..250).map(one).collect(), along, m_per_deg }
    }

    /// Anomaly, in nT, and the derivative of the anomaly upwards, in nT/m.
    fn at(&self, lat: f64, lon: f64, alt: f64) -> f64 {
        let east = (lon - MIDDLE_DEG[1]) * self.m_per_deg[1];
        let north = (lat - MIDDLE_DEG[0]) * self.m_per_deg[0];
        let of = |dipole: &Dipole| {
            dipole.field_nt([east, north, alt]).iter().zip(self.along).map(|(b, u)| b * u).sum::<f64>()
        };
        self.dipoles.iter().map(of).sum()
    }

    /// Map with nodes 150 m apart, of a function of latitude and longitude.
    fn map(&self, of: impl Fn(f64, f64) -> f64) -> GeographicGrid {
        let axis = |at: usize, half: i32| -> Vec<f64> {
            (-half..=half).map(|k| MIDDLE_DEG[at] + 150.0 * f64::from(k) / self.m_per_deg[at]).collect()
        };
        let (lat, lon) = (axis(0, 140), axis(1, 100));
        let nodes: Vec<f64> =
            lat.iter().flat_map(|lat| lon.iter().map(|lon| of(*lat, *lon)).collect::<Vec<_>>()).collect();
        GeographicGrid::new(&lat, &lon, &nodes).unwrap()
    }

    /// Level map without the upward slope.
    fn level(&self) -> FieldMap {
        FieldMap::Flat(MapSurface::new(&self.map(|lat, lon| self.at(lat, lon, ALT_M)), MapInterpolation::Cubic))
    }

    /// Level map with the upward slope.
    fn with_slope(&self) -> FieldMap {
        let up = self.map(|lat, lon| (self.at(lat, lon, ALT_M + 1.0) - self.at(lat, lon, ALT_M - 1.0)) / 2.0);
        let vertical = VerticalDerivative { d_alt_nt_per_m: up.values(), alt_m: ALT_M };
        let level = self.map(|lat, lon| self.at(lat, lon, ALT_M));
        FieldMap::Flat(MapSurface::with_vertical(&level, vertical, MapInterpolation::Cubic).unwrap())
    }

    /// Map from east-west lines at the given spacing, with a smooth curve from line to line.
    fn of_lines(&self, apart_m: f64) -> FieldMap {
        let between = |lat: f64, lon: f64| {
            let north = (lat - MIDDLE_DEG[0]) * self.m_per_deg[0] / apart_m;
            let (line, part) = (north.floor(), north - north.floor());
            let on = |k: f64| self.at(MIDDLE_DEG[0] + (line + k) * apart_m / self.m_per_deg[0], lon, ALT_M);
            let [before, low, high, after] = [-1.0, 0.0, 1.0, 2.0].map(on);
            let (a, b) = (0.5 * (high - before), 0.5 * (after - low));
            let bend = 3.0 * (high - low) - 2.0 * a - b;
            low + part * (a + part * (bend + part * (a + b - 2.0 * (high - low))))
        };
        FieldMap::Flat(MapSurface::new(&self.map(between), MapInterpolation::Cubic))
    }
}

/// Flight in the exact field, with the field at the positions of the flight, and the difference of two magnetometers.
struct Flown {
    flight: OsborneFlight,
    measured_nt: Vec<f64>,
    difference_nt: Vec<f64>,
}

fn flown(ground: &Ground, seed: u64) -> Flown {
    let mut truth = Line::flown(SAMPLES, 1.0, 0.37 * seed as f64).unwrap();
    truth.columns[3].fill(ALT_M);
    truth.columns[6].fill(0.0);
    truth.columns[11].fill(TRIM_DEG);
    let model = drifting();
    let mut normals = NormalGenerator::new(40 + seed);
    let errors: Vec<StateVector> = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
    let mut measured_nt = vec![];
    let mut difference_nt = vec![];
    for (row, error) in errors.iter().enumerate() {
        let [lat, lon, alt, roll, pitch, yaw] = [1, 2, 3, 10, 11, 12].map(|column: usize| truth.columns[column][row]);
        let tilt = Vector3::from_row_slice(&error[TILT_N..=TILT_D]);
        let turn = tilted(&body_to_ned(roll.to_radians(), pitch.to_radians(), yaw.to_radians()), &tilt);
        let half = turn * Vector3::from(BASELINE) / 2.0;
        let (dlat, dlon) = (half.x / ground.m_per_deg[0], half.y / ground.m_per_deg[1]);
        let (front, rear) =
            (ground.at(lat + dlat, lon + dlon, alt - half.z), ground.at(lat - dlat, lon - dlon, alt + half.z));
        difference_nt.push(front - rear + SIGMA_NT * normals.draw());
        measured_nt.push(ground.at(lat, lon, alt) + error[S] + 5.0 * normals.draw());
    }
    let ins = truth.with_errors(&errors);
    Flown { flight: OsborneFlight { truth, ins, errors, field_nt: vec![], model }, measured_nt, difference_nt }
}

/// Statistics over all flights from 200 s on: mean NEES, DRMS in m, NIS of the difference.
#[derive(Debug)]
struct Figures {
    nees: f64,
    drms_m: f64,
    nis: f64,
}

/// Assumed error of the map's slope.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Told {
    /// Exact map.
    Exact,
    /// Error from [`MapSlope`] and [`likely_slope_error`].
    Found,
}

fn figures(flights: &[Flown], map: &FieldMap, told: Option<Told>, scalar: bool, by: Linearisation) -> Figures {
    let (mut nees, mut square, mut nis, mut count) = (0.0, 0.0, 0.0, 0.0);
    for Flown { flight, measured_nt, difference_nt } in flights {
        let (ins, sigma) = (flight.ins.series(), vec![5.0; SAMPLES as usize]);
        let none = vec![f64::NAN; SAMPLES as usize];
        let measurement_nt = if scalar { measured_nt } else { &none };
        let line = NavigationLine {
            ins: &ins,
            measurement_nt,
            sigma_nt: &sigma,
            map,
            core: None,
            errors: flight.model,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        };
        let bias = GaussMarkov { sigma: 0.02, tau_s: 3600.0 };
        let slope = SlopeError::default();
        let of = |slope| DifferenceAid { difference_nt, sigma_nt: SIGMA_NT, baseline_m: BASELINE, slope, bias };
        let mut aids = Aids { difference: told.map(|_| of(slope)), ..Aids::default() };
        let slope = MapSlope::along(&line);
        if told == Some(Told::Found) {
            let horizontal = likely_slope_error(&line, &aids, &slope);
            aids.difference = Some(of(slope.error(horizontal)));
        }
        let parameters = AidedParameters { linearisation: by, ..AidedParameters::default() };
        let Ok(output) = run(&line, &aids, &parameters) else {
            return Figures { nees: f64::INFINITY, drms_m: f64::INFINITY, nis: f64::INFINITY };
        };
        for row in (200..SAMPLES as usize).step_by(20) {
            nees += flight.nees(&output.navigation, row);
            count += 1.0;
        }
        square += flight.square_m2(&output.navigation, 200) / flights.len() as f64;
        let all: Vec<f64> = output.aids.difference.nis.iter().copied().filter(|nis| nis.is_finite()).collect();
        nis += all.iter().sum::<f64>() / (all.len() * flights.len()) as f64;
    }
    Figures { nees: nees / count, drms_m: square.sqrt(), nis }
}

#[test]
fn law_a_difference_of_the_exact_field_is_consistent_on_incomplete_maps() {
    let ground = Ground::new();
    let flights: Vec<Flown> = (0..FLIGHTS).map(|seed| flown(&ground, seed)).collect();
    let level = ground.level();
    let once = Linearisation::Once;
    let (alone, naive) =
        (figures(&flights, &level, None, true, once), figures(&flights, &level, Some(Told::Exact), true, once));
    println!("one height: field alone {alone:.2?}, slope taken as exact {naive:.2?}");
    let whole = figures(&flights, &ground.with_slope(), Some(Told::Found), true, once);
    println!("slope upwards known: {whole:.2?}");
    assert!((1.0..4.0).contains(&whole.nees) && whole.drms_m < 0.8 * alone.drms_m, "{whole:?} {alone:?}");
    assert!(naive.nees > 10.0, "what a map of one height does if its slope counts as exact: {naive:?}");
    for (name, by) in [
        ("once", once),
        ("iterated", Linearisation::Iterated { iterations: 5, tolerance_m: 0.1 }),
        ("unscented", Linearisation::Unscented(UkfParameters::default())),
    ] {
        let found = figures(&flights, &level, Some(Told::Found), true, by);
        let difference = figures(&flights, &level, Some(Told::Found), false, by);
        println!("one height, {name}: {found:.2?}, without the field {difference:.2?}");
        assert!((1.0..4.0).contains(&found.nees), "{name}: {found:?}");
        // Without the field the position is uncertain by 100 m, over which the map is curved.
        assert!((1.0..5.0).contains(&difference.nees), "{name}: {difference:?}");
        assert!(found.drms_m < 1.02 * alone.drms_m, "{name}: {found:?} {alone:?}");
    }
}

#[test]
fn law_a_difference_does_not_diverge_on_a_map_of_sparse_lines() {
    let ground = Ground::new();
    let flights: Vec<Flown> = (0..FLIGHTS).map(|seed| flown(&ground, seed)).collect();
    let sparse = ground.of_lines(2000.0);
    let by = |told, scalar| figures(&flights, &sparse, told, scalar, Linearisation::Once);
    let (alone, naive, found) = (by(None, true), by(Some(Told::Exact), true), by(Some(Told::Found), true));
    let (lost, difference) = (by(Some(Told::Exact), false), by(Some(Told::Found), false));
    println!("sparse lines: field alone {alone:.2?}; with the difference, slope exact {naive:.2?}, found {found:.2?}");
    println!("without the field: slope exact {lost:.2?}, found {difference:.2?}");
    // The field alone diverges on such a map; the difference must not increase the error.
    assert!(naive.drms_m > 1.2 * alone.drms_m, "{naive:?} {alone:?}");
    assert!(found.drms_m < 1.05 * alone.drms_m && found.nees < 1.1 * alone.nees, "{found:?} {alone:?}");
    assert!(difference.drms_m < 0.3 * lost.drms_m && difference.nees < 0.1 * lost.nees, "{difference:?} {lost:?}");
    assert!(found.nis < 3.0 && naive.nis > 10.0, "{found:?} {naive:?}");
}
