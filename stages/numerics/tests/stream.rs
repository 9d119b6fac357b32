//! Filters fed sample by sample against the filters of a whole line: bits, allocations, irregular samples, states.
#![allow(clippy::unwrap_used)]
// A counting allocator implements an unsafe trait.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::{Arc, OnceLock};

use numerics::earth::core_field::CoreField;
use numerics::maps::{FieldMap, MapInterpolation, MapSurface};
use numerics::navigation::adaptive::{self, AdaptiveForm, AdaptiveMagnetometer, AdaptiveNoise, AdaptiveParameters};
use numerics::navigation::ekf::{EkfInput, run_together};
use numerics::navigation::ins_error::simulate_ins_error;
use numerics::navigation::online::{self, CoefficientPrior, LineModel, OnlineMagnetometer, OnlineParameters};
use numerics::navigation::position_fixes::PositionFixes;
use numerics::navigation::stream::{
    FilterStream, InsSample, PositionFix, StateError, StreamError, StreamMagnetometer, StreamSample, StreamSetup,
};
use numerics::navigation::{
    EkfParameters, InsErrorModel, InsSeries, NavigationLine, NavigationOutput, NoiseDiscretisation,
};
use numerics::random::NormalGenerator;

mod osborne;
use osborne::{Line, core_field, grid, temporal_nt};

/// Allocator that counts the allocations of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        unsafe { System.dealloc(place, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const SAMPLES: u32 = 600;
const TERMS: [usize; 2] = [6, 3];

struct World {
    map: Arc<FieldMap>,
    core: Arc<CoreField>,
}

fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| World {
        map: Arc::new(FieldMap::Flat(MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic))),
        core: Arc::new(core_field().unwrap()),
    })
}

/// Flight with two magnetometers, missing values, gaps in the times, fixes, and an end off the map.
struct Flight {
    ins: Line,
    measured_nt: [Vec<f64>; 2],
    sigma_nt: [Vec<f64>; 2],
    terms: [Vec<f64>; 2],
    fixes: Option<PositionFixes>,
    setup: StreamSetup,
}

impl Flight {
    fn flown(kind: u32) -> Self {
        let World { map, core } = world();
        let mut truth = Line::flown(SAMPLES, 0.5, f64::from(kind)).unwrap();
        // Two gaps in the times, of 3 s and of 20 s.
        truth.columns[0].iter_mut().skip(100).for_each(|tt_s| *tt_s += 3.0);
        truth.columns[0].iter_mut().skip(400).for_each(|tt_s| *tt_s += 20.0);
        let mut normals = NormalGenerator::new(u64::from(kind));
        let noise = [NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::Rectangular, NoiseDiscretisation::VanLoan];
        let errors = InsErrorModel { noise: noise[kind as usize % 3], ..InsErrorModel::default() };
        let drift = simulate_ins_error(&truth.series(), &errors, || normals.draw()).unwrap();
        let with_core = kind.is_multiple_of(2);
        let mut flight = Self {
            ins: truth.with_errors(&drift),
            measured_nt: Default::default(),
            sigma_nt: Default::default(),
            terms: Default::default(),
            fixes: None,
            setup: StreamSetup {
                core: with_core.then(|| core.clone()),
                errors,
                second_order: kind % 4 == 1,
                max_gap_s: 30.0,
                ..StreamSetup::new(map.clone())
            },
        };
        for (row, error) in drift.iter().enumerate() {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            let main_nt = if with_core { core.magnitude_nt(lat, lon, alt) } else { 0.0 };
            let field_nt = map.at(lat, lon, alt).unwrap().value_nt + main_nt + temporal_nt(error);
            for (magnetometer, terms) in TERMS.into_iter().enumerate() {
                let spike_nt = if (row + 5 * magnetometer) % 37 == 36 { 300.0 } else { 0.0 };
                flight.measured_nt[magnetometer].push(field_nt + spike_nt + 3.0 * normals.draw());
                flight.sigma_nt[magnetometer].push(3.0 + (row % 7) as f64);
                let wave = |term: usize| (0.05 * (row * (term + 2)) as f64).sin();
                flight.terms[magnetometer].extend((0..terms).map(wave));
            }
        }
        flight.measured_nt[0][50..70].fill(f64::NAN);
        flight.sigma_nt[1][60..80].fill(0.0);
        flight.terms[0][6 * 200..6 * 205].fill(f64::NAN);
        // The INS leaves the map.
        flight.ins.columns[1].iter_mut().skip(580).for_each(|lat| *lat += 5.0);
        flight.fixes = kind.is_multiple_of(3).then(|| {
            let there = |row: usize, value: f64| if row % 50 == 20 { value } else { f64::NAN };
            let of = |column: usize| truth.columns[column].iter().enumerate().map(|(row, x)| there(row, *x)).collect();
            let mut fixes = PositionFixes {
                lat_deg: of(1),
                lon_deg: of(2),
                alt_m: of(3),
                horizontal_sigma_m: 4.0,
                vertical_sigma_m: 9.0,
            };
            fixes.lat_deg[70] = f64::NAN;
            fixes
        });
        flight
    }

    fn fix(&self, row: usize) -> Option<PositionFix> {
        self.fixes.as_ref().map(|fixes| PositionFix {
            lat_deg: fixes.lat_deg[row],
            lon_deg: fixes.lon_deg[row],
            alt_m: fixes.alt_m[row],
            horizontal_sigma_m: fixes.horizontal_sigma_m,
            vertical_sigma_m: fixes.vertical_sigma_m,
        })
    }

    /// Values of a row for the first `magnetometers`, and their terms.
    fn values(&self, row: usize, magnetometers: usize, with_terms: bool) -> [Vec<f64>; 3] {
        let of = |columns: &[Vec<f64>; 2]| columns.iter().take(magnetometers).map(|column| column[row]).collect();
        let mut terms = vec![];
        for (width, of) in TERMS.into_iter().zip(&self.terms).take(if with_terms { magnetometers } else { 0 }) {
            terms.extend_from_slice(&of[row * width..][..width]);
        }
        [of(&self.measured_nt), of(&self.sigma_nt), terms]
    }

    fn line<'a>(&'a self, ins: &'a InsSeries<'a>) -> NavigationLine<'a> {
        NavigationLine {
            ins,
            measurement_nt: &self.measured_nt[0],
            sigma_nt: &self.sigma_nt[0],
            map: &self.setup.map,
            core: self.setup.core.as_ref(),
            errors: self.setup.errors,
            offset_window_s: 0.0,
            fixes: self.fixes.as_ref(),
            second_order: self.setup.second_order,
        }
    }
}

/// Filter with the number of its magnetometers and whether it takes terms.
#[derive(Clone)]
struct Fed {
    filter: FilterStream,
    magnetometers: usize,
    with_terms: bool,
}

impl Fed {
    fn push(&mut self, flight: &Flight, row: usize) -> Result<Vec<u64>, StreamError> {
        let [measurement_nt, sigma_nt, terms] = flight.values(row, self.magnetometers, self.with_terms);
        let ins = InsSample::from_series(&flight.ins.series(), row);
        let fix = flight.fix(row);
        let (measurement_nt, sigma_nt, terms) = (&measurement_nt[..], &sigma_nt[..], &terms[..]);
        let before = ALLOCATIONS.with(Cell::get);
        let estimate = self.filter.push(&StreamSample { ins, measurement_nt, sigma_nt, terms, fix })?;
        let allocated = ALLOCATIONS.with(Cell::get) - before;
        assert!(row == 0 || allocated == 0, "{allocated} allocations at row {row}");
        let [vn, ve, vd] = estimate.velocity_ned_mps;
        let mut all = vec![estimate.residual_nt, estimate.nis, estimate.lat_deg, estimate.lon_deg, estimate.alt_m];
        all.extend([vn, ve, vd, estimate.sd_n_m, estimate.sd_e_m, estimate.cov_ne_m2]);
        all.extend(self.filter.states().unwrap());
        all.extend(self.filter.covariance().unwrap().as_flattened());
        Ok(all.into_iter().map(f64::to_bits).collect())
    }
}

/// A row of an output, in the order of `Fed::push`.
fn row_bits(output: &NavigationOutput, row: usize) -> Vec<u64> {
    let columns = [
        &output.residual_nt,
        &output.nis,
        &output.lat_deg,
        &output.lon_deg,
        &output.alt_m,
        &output.vn_mps,
        &output.ve_mps,
        &output.vd_mps,
        &output.sd_n_m,
        &output.sd_e_m,
        &output.cov_ne_m2,
    ];
    let own = columns.into_iter().map(|column| column[row]);
    own.chain(output.x[row]).chain(output.p[row].into_iter().flatten()).map(f64::to_bits).collect()
}

/// Feeds a flight and compares every row; restarts the filter from its saved state now and then.
fn compare(flight: &Flight, mut fed: Fed, output: &NavigationOutput, check: impl Fn(&FilterStream, usize)) {
    let fresh = fed.clone();
    for row in 0..SAMPLES as usize {
        assert!(fed.push(flight, row).unwrap() == row_bits(output, row), "row {row}");
        check(&fed.filter, row);
        if row % 97 == 13 {
            let bytes = fed.filter.save();
            let mut resumed = fresh.clone();
            resumed.filter.restore(&bytes).unwrap();
            assert!(resumed.filter.estimate().is_none());
            assert_eq!(resumed.filter.save(), bytes);
            let mut once = resumed.clone();
            // The first sample after restoring may allocate.
            let next = (row + 1).min(SAMPLES as usize - 1);
            let [measurement_nt, sigma_nt, terms] = flight.values(next, fed.magnetometers, fed.with_terms);
            let ins = InsSample::from_series(&flight.ins.series(), next);
            let (measurement_nt, sigma_nt, terms) = (&measurement_nt[..], &sigma_nt[..], &terms[..]);
            let sample = StreamSample { ins, measurement_nt, sigma_nt, terms, fix: flight.fix(next) };
            let estimate = once.filter.push(&sample).unwrap();
            assert_eq!(estimate.lat_deg.to_bits(), output.lat_deg[next].to_bits());
            assert_eq!(once.filter.covariance().unwrap(), &output.p[next]);
        }
    }
    let (found, mut expected) = (fed.filter.report(), output.report);
    (expected.offset_nt, expected.offset_samples) = (0.0, 0);
    assert_eq!(found, expected);
    assert!(found.updates > 400 && found.off_map > 0, "{found:?}");
}

fn ekf(flight: &Flight, gate_nis: Option<f64>) -> Fed {
    Fed { filter: FilterStream::ekf(&flight.setup, gate_nis).unwrap(), magnetometers: 1, with_terms: false }
}

#[test]
fn law_the_streamed_ekf_is_the_filter_of_the_line() {
    for kind in 0..8 {
        let flight = Flight::flown(kind);
        let ins = flight.ins.series();
        let gate_nis = (kind % 2 == 1).then_some(10.83);
        let StreamSetup { errors, second_order, .. } = flight.setup;
        let parameters =
            EkfParameters { errors, gate_nis, second_order, keep_covariance: true, ..EkfParameters::default() };
        let point = EkfInput {
            parameters: &parameters,
            measurement_nt: &flight.measured_nt[0],
            sigma_nt: Some(&flight.sigma_nt[0]),
            fixes: flight.fixes.as_ref(),
            map: &flight.setup.map,
            core: flight.setup.core.as_ref(),
        };
        let output = run_together(&ins, &[point]).remove(0).unwrap();
        assert_eq!(output.report.gated > 0, gate_nis.is_some());
        compare(&flight, ekf(&flight, gate_nis), &output, |_, _| {});
    }
}

#[test]
fn law_the_streamed_adaptive_filter_is_the_filter_of_the_line() {
    let forms = [AdaptiveForm::Residual, AdaptiveForm::Matched, AdaptiveForm::Compatible];
    let noises = [AdaptiveNoise::R, AdaptiveNoise::Both, AdaptiveNoise::Q];
    for kind in 0..6 {
        let flight = Flight::flown(kind);
        let ins = flight.ins.series();
        let parameters = AdaptiveParameters {
            form: forms[kind as usize % 3],
            adapt: noises[(kind as usize + 1) % 3],
            window: 20,
            relative: kind > 2,
            gate_nis: (kind % 2 == 0).then_some(10.83),
            keep_covariance: true,
            ..AdaptiveParameters::default()
        };
        let magnetometers: Vec<_> = (0..1 + kind as usize % 2)
            .map(|of| AdaptiveMagnetometer {
                measurement_nt: &flight.measured_nt[of],
                sigma_nt: &flight.sigma_nt[of],
                sigma_min_nt: 0.5,
                sigma_max_nt: 60.0,
            })
            .collect();
        let output = adaptive::run(&parameters, &flight.line(&ins), &magnetometers).unwrap();
        let bounds = vec![[0.5, 60.0]; magnetometers.len()];
        let filter = FilterStream::adaptive(&flight.setup, &parameters, &bounds).unwrap();
        let fed = Fed { filter, magnetometers: bounds.len(), with_terms: false };
        compare(&flight, fed, &output.navigation, |filter, row| {
            for (of, magnetometer) in output.magnetometers.iter().enumerate() {
                let sigma_nt = filter.magnetometer(of).unwrap().sigma_nt;
                assert_eq!(sigma_nt.to_bits(), magnetometer.sigma_nt[row].to_bits());
            }
        });
    }
}

fn online_prior(terms: usize) -> (CoefficientPrior, Vec<f64>) {
    (CoefficientPrior::independent(&vec![1.0; terms], &vec![40.0; terms]), vec![0.01; terms])
}

fn online(flight: &Flight, magnetometers: usize, gate_nis: Option<f64>) -> Fed {
    let priors = TERMS.map(online_prior);
    let of = |(prior, walk_density): &'static (CoefficientPrior, Vec<f64>)| StreamMagnetometer { prior, walk_density };
    let priors: &'static [(CoefficientPrior, Vec<f64>); 2] = Box::leak(Box::new(priors));
    let all: Vec<_> = priors.iter().take(magnetometers).map(of).collect();
    let parameters = OnlineParameters { gate_nis, ..OnlineParameters::default() };
    let filter = FilterStream::online(&flight.setup, &all, &parameters).unwrap();
    Fed { filter, magnetometers, with_terms: true }
}

#[test]
fn law_the_streamed_online_filter_is_the_filter_of_the_line() {
    for kind in 0..6 {
        let flight = Flight::flown(kind);
        let ins = flight.ins.series();
        let (count, gate_nis) = (1 + kind as usize % 2, (kind % 3 != 1).then_some(9.0));
        let kept = OnlineParameters { keep_states: true, keep_covariance: true, ..OnlineParameters::default() };
        let parameters = OnlineParameters { gate_nis, keep_coefficients: true, ..kept };
        let priors = TERMS.map(online_prior);
        let magnetometers: Vec<_> = (0..count)
            .map(|of| OnlineMagnetometer {
                measurement_nt: &flight.measured_nt[of],
                sigma_nt: &flight.sigma_nt[of],
                terms: &flight.terms[of],
                prior: &priors[of].0,
                walk_density: &priors[of].1,
            })
            .collect();
        let line = LineModel::from_line(&flight.line(&ins));
        let output = online::run(&line, &magnetometers, None, &parameters).unwrap();
        compare(&flight, online(&flight, count, gate_nis), &output.navigation, |filter, row| {
            let (mut expected, mut first) = (vec![], 0);
            for (of, (magnetometer, width)) in output.magnetometers.iter().zip(TERMS).enumerate() {
                let found = filter.magnetometer(of).unwrap();
                assert_eq!(found.aircraft_nt.to_bits(), magnetometer.track.aircraft_nt[row].to_bits());
                assert_eq!(found.residual_nt.to_bits(), magnetometer.track.residual_nt[row].to_bits());
                expected.extend_from_slice(&magnetometer.coefficients_by_row[row * width..][..width]);
                let sigma = &filter.coefficients().1[first..first + width];
                assert_eq!(sigma, &magnetometer.sigma_by_row[row * width..][..width]);
                first += width;
            }
            assert_eq!(filter.coefficients().0, expected);
        });
    }
}

#[test]
fn unit_irregular_samples_are_errors_and_leave_the_filter_unchanged() {
    let flight = Flight::flown(0);
    for mut fed in [ekf(&flight, None), online(&flight, 1, None)] {
        (0..20).for_each(|row| drop(fed.push(&flight, row).unwrap()));
        let saved = fed.filter.save();
        let [measurement_nt, sigma_nt, terms] = flight.values(20, 1, fed.with_terms);
        let (measurement_nt, sigma_nt, terms) = (&measurement_nt[..], &sigma_nt[..], &terms[..]);
        let ins = InsSample::from_series(&flight.ins.series(), 20);
        let good = StreamSample { ins, measurement_nt, sigma_nt, terms, fix: None };
        let at = |tt_s: f64| StreamSample { ins: InsSample { tt_s, ..ins }, ..good };
        let message =
            |filter: &mut FilterStream, sample: &StreamSample<'_>| filter.push(sample).unwrap_err().to_string();
        let fault =
            PositionFix { lat_deg: 0.0, lon_deg: 0.0, alt_m: 0.0, horizontal_sigma_m: 0.0, vertical_sigma_m: 1.0 };
        for (sample, expected) in [
            (at(9.0), "the sample at tt = 9 s is late: the last sample has tt = 9.5 s"),
            (at(9.5), "a sample at tt = 9.5 s was already used"),
            (at(99.0), "samples between tt = 9.5 s and 99 s are missing, more than `max_gap_s` = 30 s"),
            (at(f64::NAN), "`tt` is NaN"),
            (StreamSample { ins: InsSample { alt_m: f64::INFINITY, ..ins }, ..good }, "`ins_alt` is inf at tt = 10 s"),
            (StreamSample { ins: InsSample { lat_deg: 90.0, ..ins }, ..good }, "`ins_lat` is 90 degrees at tt = 10 s"),
            (StreamSample { measurement_nt: &[], ..good }, "the sample has 0 measurements; the filter requires 1"),
            (StreamSample { sigma_nt: &[1.0; 2], ..good }, "the sample has 2 standard deviations"),
            (StreamSample { terms: &[1.0; 7], ..good }, "the sample has 7 terms; the filter requires"),
            (StreamSample { fix: Some(fault), ..good }, "`horizontal_sigma_m` must be above 0"),
        ] {
            let found = message(&mut fed.filter, &sample);
            assert!(found.starts_with(expected), "{found}");
            assert_eq!(fed.filter.save(), saved);
        }
        fed.filter.push(&good).unwrap();
        // A specific force without bounds makes the covariance infinite one step later.
        let [x, y, _] = ins.force_ned_mps2;
        let wild = InsSample { tt_s: 10.5, force_ned_mps2: [x, y, 1e200], ..ins };
        fed.filter.push(&StreamSample { ins: wild, ..good }).unwrap();
        assert_eq!(fed.filter.push(&at(11.0)), Err(StreamError::Diverged { tt_s: 11.0 }));
        assert_eq!(fed.filter.push(&at(11.5)), Err(StreamError::Stopped));
    }
}

#[test]
fn unit_damaged_and_foreign_states_are_errors() {
    let flight = Flight::flown(0);
    let mut fed = ekf(&flight, None);
    (0..30).for_each(|row| drop(fed.push(&flight, row).unwrap()));
    let bytes = fed.filter.save();
    let mut other = ekf(&flight, None).filter;
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 4;
        let fault = other.restore(&damaged).unwrap_err();
        match at {
            0..8 => assert_eq!(fault, StateError::Foreign),
            8..12 => assert!(matches!(fault, StateError::Version { .. })),
            _ => assert_eq!(fault, StateError::Damaged),
        }
    }
    (0..bytes.len()).for_each(|length| assert!(other.restore(&bytes[..length]).is_err(), "{length}"));
    assert!(other.states().is_none());
    // Other parameters, another filter, another core field, and another map.
    assert_eq!(ekf(&flight, Some(5.0)).filter.restore(&bytes), Err(StateError::Parameters));
    assert_eq!(online(&flight, 1, None).filter.restore(&bytes), Err(StateError::Parameters));
    let later = StreamSetup { core: Some(Arc::new(CoreField::at(2024.5).unwrap())), ..flight.setup.clone() };
    let fault = FilterStream::ekf(&later, None).unwrap().restore(&bytes).unwrap_err();
    assert!(fault.to_string().starts_with("the saved state belongs to another map or core field"), "{fault}");
    let linear = FieldMap::Flat(MapSurface::new(&grid().unwrap(), MapInterpolation::Linear));
    let linear = StreamSetup { map: Arc::new(linear), ..flight.setup.clone() };
    assert!(matches!(FilterStream::ekf(&linear, None).unwrap().restore(&bytes), Err(StateError::Field { .. })));
    other.restore(&bytes).unwrap();
    assert_eq!(other.save(), bytes);
}

#[test]
fn unit_what_cannot_stream_is_rejected() {
    let flight = Flight::flown(0);
    let message = |setup: StreamSetup| FilterStream::ekf(&setup, None).err().unwrap().to_string();
    let setup = || flight.setup.clone();
    let window = message(StreamSetup { offset_window_s: 60.0, ..setup() });
    assert!(window.starts_with("`offset_window_s` averages samples that a stream does not have yet"), "{window}");
    for max_gap_s in [0.0, f64::NAN] {
        assert!(message(StreamSetup { max_gap_s, ..setup() }).starts_with("`max_gap_s` must be above 0"));
    }
    let mut errors = flight.setup.errors;
    errors.fogm_tau_s = 0.0;
    assert!(message(StreamSetup { errors, ..setup() }).starts_with("`fogm_tau_s` must be above 0"));
    assert!(FilterStream::ekf(&setup(), Some(0.0)).is_err());
    let none = FilterStream::adaptive(&setup(), &AdaptiveParameters::default(), &[]);
    assert_eq!(none.err().unwrap().to_string(), "no magnetometer is given");
    assert!(FilterStream::adaptive(&setup(), &AdaptiveParameters::default(), &[[2.0, 1.0]]).is_err());
    assert!(FilterStream::online(&setup(), &[], &OnlineParameters::default()).is_err());
    let prior = CoefficientPrior::independent(&[0.0; 3], &[1.0; 3]);
    let short = StreamMagnetometer { prior: &prior, walk_density: &[0.0; 2] };
    assert!(FilterStream::online(&setup(), &[short], &OnlineParameters::default()).is_err());
}
