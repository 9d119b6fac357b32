//! Monte Carlo of the filter on simulated flights over the real Osborne map: consistency, and reduction of an INS drift
//! of hundreds of metres to tens of metres.
#![allow(clippy::unwrap_used)]

mod osborne;

use std::sync::OnceLock;

use numerics::{
    earth::geodesy::EarthModel,
    maps::{
        map_stack::FieldMap,
        map_surface::{MapInterpolation, MapSurface},
    },
    navigation::{
        ekf::{EkfParameters, run},
        ins_error::{InsErrorModel, simulate_ins_error},
        output::NavigationOutput,
        pinson::{LAT, LON, S, STATES, StateMatrix},
        transition::NoiseDiscretisation,
    },
    random::NormalGenerator,
    signal::{
        gauss_markov::GaussMarkov,
        noise::{BlockMeans, noise},
    },
};
use osborne::{Line, core_field, grid, temporal_nt};

const RUNS: u64 = 100;
const SAMPLES: u32 = 3600;
const DT_S: f64 = 1.0;
/// Samples at which consistency is tested: far enough apart to be nearly independent.
const EPOCHS: [usize; 11] = [120, 450, 780, 1110, 1440, 1770, 2100, 2430, 2760, 3090, 3599];

struct Run {
    output: NavigationOutput,
    /// Covariance at the epochs; all samples would take a gigabyte.
    p_at_epochs: Vec<StateMatrix>,
    errors: Vec<[f64; STATES]>,
}

/// One flight with its realisation of the INS errors, the temporal variation and the measurement noise.
fn fly(seed: u64, map: &MapSurface, noise: NoiseDiscretisation) -> Run {
    let truth = Line::flown(SAMPLES, DT_S, 0.1 * seed as f64).unwrap();
    let model = InsErrorModel::default();
    let mut normals = NormalGenerator::new(seed);
    let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
    let core = core_field().unwrap();
    let parameters =
        EkfParameters { errors: InsErrorModel { noise, ..model }, keep_covariance: true, ..EkfParameters::default() };
    let measured: Vec<f64> = errors
        .iter()
        .enumerate()
        .map(|(row, error)| {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            let field = map.at(lat, lon).unwrap().value_nt + core.magnitude_nt(lat, lon, alt);
            field + temporal_nt(error) + parameters.measurement_sigma_nt * normals.draw()
        })
        .collect();
    let ins = truth.with_errors(&errors);
    let mut output = run(&parameters, &ins.series(), &measured, &FieldMap::Flat(map.clone()), Some(&core)).unwrap();
    let p = std::mem::take(&mut output.p);
    let p_at_epochs = EPOCHS.map(|row| p[row]).to_vec();
    Run { output, p_at_epochs, errors }
}

/// Flights that three of the tests share.
fn runs() -> &'static [Run] {
    static RUNS_FLOWN: OnceLock<Vec<Run>> = OnceLock::new();
    RUNS_FLOWN.get_or_init(|| {
        let map = MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic);
        (0..RUNS).map(|seed| fly(seed, &map, NoiseDiscretisation::default())).collect()
    })
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normals, by the formula of Wilson and Hilferty; the
/// error is below 0.1 % for a hundred or more degrees of freedom.
fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

impl Run {
    fn remaining(&self, row: usize) -> [f64; STATES] {
        std::array::from_fn(|state| self.errors[row][state] - self.output.x[row][state])
    }

    /// NEES of the horizontal position at an epoch: chi-square with 2 degrees of freedom.
    fn position_nees(&self, epoch: usize) -> f64 {
        let (e, p) = (self.remaining(EPOCHS[epoch]), &self.p_at_epochs[epoch]);
        let (a, b, c) = (p[LAT][LAT], p[LAT][LON], p[LON][LON]);
        (c * e[LAT] * e[LAT] - 2.0 * b * e[LAT] * e[LON] + a * e[LON] * e[LON]) / (a * c - b * b)
    }

    /// Root mean square of the horizontal error of an error series, in metres.
    fn drms_m(&self, error_of: impl Fn(usize) -> [f64; STATES]) -> f64 {
        let earth = EarthModel::Wgs84;
        let rows = self.errors.len();
        let square = |row: usize| {
            let (error, lat) = (error_of(row), self.output.lat_deg[row].to_radians());
            let north = earth.lat_rad_to_north_m(error[LAT], lat, 500.0);
            let east = earth.lon_rad_to_east_m(error[LON], lat, 500.0);
            north * north + east * east
        };
        ((0..rows).map(square).sum::<f64>() / rows as f64).sqrt()
    }
}

/// Mean over the runs at one epoch.
fn mean(runs: &[Run], of: impl Fn(&Run) -> f64) -> f64 {
    runs.iter().map(of).sum::<f64>() / runs.len() as f64
}

#[test]
fn law_the_filter_is_consistent() {
    let runs = runs();
    let n = runs.len() as f64;
    let (low, high) = (chi_square(2.0 * n, -1.96) / n, chi_square(2.0 * n, 1.96) / n);
    let nees: Vec<f64> = (0..EPOCHS.len()).map(|epoch| mean(runs, |run| run.position_nees(epoch))).collect();
    println!("position NEES by epoch, band {low:.2}..{high:.2}: {nees:.2?}");
    let outside = nees.iter().filter(|nees| !(low..=high).contains(nees)).count();
    // By chance, one epoch in twenty is outside the band: 2 or more of 11 epochs in 10 % of all cases, 3 or more epochs
    // in 1.5 %.
    assert!(outside <= 2, "{outside} of {} epochs outside {low:.2}..{high:.2}", EPOCHS.len());
    // All epochs together; the 99.9 % band, as neighbouring epochs are not quite independent.
    let all = 2.0 * n * EPOCHS.len() as f64;
    let average = nees.iter().sum::<f64>() / EPOCHS.len() as f64 / 2.0;
    assert!(
        (chi_square(all, -3.29)..=chi_square(all, 3.29)).contains(&(average * all)),
        "mean NEES per degree of freedom {average:.3}"
    );
    // The temporal variation alone: chi-square of 1 degree.
    for (epoch, row) in EPOCHS.into_iter().enumerate() {
        let s = mean(runs, |run| run.remaining(row)[S].powi(2) / run.p_at_epochs[epoch][S][S]);
        // 99.9 % band, for tests at 11 epochs.
        assert!((chi_square(n, -3.29)..=chi_square(n, 3.29)).contains(&(s * n)), "{row} {s:.2}");
    }
}

#[test]
fn law_innovations_are_white_and_of_the_predicted_size() {
    let runs = runs();
    let samples = f64::from(SAMPLES) * runs.len() as f64;
    let nis = mean(runs, |run| run.output.nis.iter().sum::<f64>()) / f64::from(SAMPLES);
    println!("mean NIS {nis:.4}");
    // The mean of 360,000 values has a standard deviation of sqrt(2/360000) = 0.0024; the linearisation in the first
    // minutes and over steep anomalies adds a further error.
    assert!((nis - 1.0).abs() < 0.02, "{nis}");
    let white = |run: &Run| -> Vec<f64> {
        let pairs = run.output.residual_nt.iter().zip(&run.output.nis);
        pairs.map(|(residual, nis)| nis.sqrt() * residual.signum()).collect()
    };
    let series: Vec<Vec<f64>> = runs.iter().map(white).collect();
    for lag in [1, 2, 5, 20, 100] {
        let products = |x: &Vec<f64>| x.iter().zip(&x[lag..]).map(|(a, b)| a * b).sum::<f64>();
        let correlation = series.iter().map(products).sum::<f64>() / samples;
        println!("autocorrelation of the innovations at {lag} s: {correlation:.4}");
        // The standard deviation, the inverse square root of the number of samples, is 0.0017. The limit is 4 standard
        // deviations and the same amount for linearisation.
        assert!(correlation.abs() < 0.012, "{lag} {correlation}");
    }
}

#[test]
fn law_the_map_bounds_a_drifting_ins() {
    let runs = runs();
    let filter = mean(runs, |run| run.drms_m(|row| run.remaining(row)).powi(2)).sqrt();
    let ins = mean(runs, |run| run.drms_m(|row| run.errors[row]).powi(2)).sqrt();
    let worst = runs.iter().map(|run| run.drms_m(|row| run.remaining(row))).fold(0.0, f64::max);
    println!("DRMS: INS {ins:.0} m, filter {filter:.1} m, worst flight {worst:.1} m");
    assert!(ins > 300.0, "the INS drifts: {ins}");
    assert!(filter < 30.0 && worst < 100.0, "{filter} {worst}");
    assert!(runs.iter().all(|run| run.output.report.updates == SAMPLES as usize));
}

#[test]
fn law_the_discretisation_of_the_noise_has_no_effect_at_one_second() {
    // Some of the flights, each filtered three times with the same draws.
    let map = MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic);
    let mean_nees = |noise: NoiseDiscretisation| {
        let nees = |run: &Run| (0..EPOCHS.len()).map(|epoch| run.position_nees(epoch)).sum::<f64>();
        (0..20).map(|seed| nees(&fly(seed, &map, noise))).sum::<f64>() / (40.0 * EPOCHS.len() as f64)
    };
    let exact = mean_nees(NoiseDiscretisation::VanLoan);
    for noise in [NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::Rectangular] {
        let ours = mean_nees(noise);
        println!("NEES per degree of freedom: {noise:?} {ours:.5}, Van Loan {exact:.5}");
        // Within 1 % of the exact noise's, a fifth of the resolution of 440 values.
        assert!((ours / exact - 1.0).abs() < 0.01, "{noise:?} {ours} {exact}");
    }
}

/// Residual of compensation: two Gauss-Markov processes with time constants of half a minute and of ten minutes, and
/// white noise.
fn left_by_compensation(samples: u32, normals: &mut NormalGenerator) -> Vec<f64> {
    let tt: Vec<f64> = (0..samples).map(|k| DT_S * f64::from(k)).collect();
    let minutes = GaussMarkov { sigma: 4.0, tau_s: 600.0 }.realisation(&tt, || normals.draw());
    let seconds = GaussMarkov { sigma: 6.0, tau_s: 30.0 }.realisation(&tt, || normals.draw());
    minutes.iter().zip(seconds).map(|(a, b)| a + b + 1.5 * normals.draw()).collect()
}

#[test]
fn law_noise_estimated_on_other_lines_makes_a_consistent_filter() {
    let map = MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic);
    let core = core_field().unwrap();
    let flights = 30_u64;
    let (mut nees, mut nis, mut naive) = (0.0, 0.0, 0.0);
    for seed in 0..flights {
        let mut normals = NormalGenerator::new(1000 + seed);
        let calibration: Vec<BlockMeans> = (0..2)
            .map(|_| {
                let left = left_by_compensation(900, &mut normals);
                BlockMeans::from_runs(&left, std::slice::from_ref(&(0..left.len())), 1.0 / DT_S)
            })
            .collect();
        let found = noise(&calibration).unwrap();
        let truth = Line::flown(SAMPLES, DT_S, 0.17 * seed as f64).unwrap();
        let quiet = InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() };
        let errors = simulate_ins_error(&truth.series(), &quiet, || normals.draw()).unwrap();
        let left = left_by_compensation(SAMPLES, &mut normals);
        let measured: Vec<f64> = (0..SAMPLES as usize)
            .map(|row| {
                let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
                map.at(lat, lon).unwrap().value_nt + core.magnitude_nt(lat, lon, alt) + left[row]
            })
            .collect();
        let ins = truth.with_errors(&errors);
        let filtered = |white_nt: f64, lasting: GaussMarkov| {
            let base = quiet;
            let model = InsErrorModel { fogm_sigma_nt: lasting.sigma, fogm_tau_s: lasting.tau_s, ..base };
            let parameters = EkfParameters {
                errors: model,
                measurement_sigma_nt: white_nt,
                keep_covariance: true,
                ..EkfParameters::default()
            };
            let field = FieldMap::Flat(map.clone());
            let mut output = run(&parameters, &ins.series(), &measured, &field, Some(&core)).unwrap();
            let p = std::mem::take(&mut output.p);
            Run { output, p_at_epochs: EPOCHS.map(|row| p[row]).to_vec(), errors: errors.clone() }
        };
        let of = |run: &Run| (0..EPOCHS.len()).map(|epoch| run.position_nees(epoch)).sum::<f64>() / EPOCHS.len() as f64;
        let run = filtered(found.white_nt, found.lasting);
        nees += of(&run) / flights as f64;
        nis += run.output.nis.iter().sum::<f64>() / f64::from(SAMPLES) / flights as f64;
        // Defaults of MagNav.jl, which ignore the process of half a minute.
        naive += of(&filtered(1.5, GaussMarkov { sigma: 3.0, tau_s: 600.0 })) / flights as f64;
    }
    println!(
        "NEES {nees:.2} and NIS {nis:.2} with the noise that was found; NEES {naive:.1} with that of the defaults"
    );
    // Noise that bounds the Allan variance makes a filter cautious: the values may be as low as half of the expected
    // values 2 and 1. With thirty flights they may exceed the expected values by a fourth by chance.
    assert!((0.8..2.5).contains(&nees), "{nees}");
    assert!((0.4..1.2).contains(&nis), "{nis}");
    assert!(naive > 2.0 * nees, "{naive}");
}
