//! Flights over the real Osborne map with known truth.
#![allow(clippy::unwrap_used)]
use std::sync::{Arc, OnceLock};

use super::*;
use crate::earth::core_field::CoreField;
use crate::earth::geodesy::EarthModel;
use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::{MapInterpolation, MapSurface};
use crate::navigation::ekf::{self, EkfParameters};
use crate::navigation::ins_error::{InsErrorModel, simulate_ins_error};
use crate::navigation::osborne::{Line, core_field, grid, temporal_nt};
use crate::random::NormalGenerator;

const RUNS: u64 = 40;
const SAMPLES: u32 = 1500;
/// Rows far enough apart to be nearly independent.
const EPOCHS: [usize; 6] = [20, 300, 600, 900, 1200, 1499];

struct Flight {
    ins: Line,
    truth: Line,
    measured_nt: Vec<f64>,
    errors: InsErrorModel,
}

fn world() -> &'static (FieldMap, Arc<CoreField>) {
    static WORLD: OnceLock<(FieldMap, Arc<CoreField>)> = OnceLock::new();
    WORLD.get_or_init(|| {
        let surface = MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic);
        (FieldMap::Flat(surface), Arc::new(core_field().unwrap()))
    })
}

impl Flight {
    fn new(seed: u64, outliers: f64) -> Self {
        Self::of(seed, outliers, InsErrorModel::default())
    }

    fn of(seed: u64, outliers: f64, model: InsErrorModel) -> Self {
        let (map, core) = world();
        let truth = Line::flown(SAMPLES, 1.0, 0.16 * seed as f64).unwrap();
        let mut normals = NormalGenerator::new(seed);
        let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
        let mut measured_nt = vec![];
        for (row, error) in errors.iter().enumerate() {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            let field_nt = map.at(lat, lon, alt).unwrap().value_nt + core.magnitude_nt(lat, lon, alt);
            measured_nt.push(field_nt + temporal_nt(error) + 5.0 * normals.draw());
        }
        // Drawn after the noise, so that a flight with outliers is otherwise unchanged. All outliers have the same
        // sign, as for magnetic objects.
        let threshold = 1.645 * if outliers > 0.0 { 1.0 } else { f64::INFINITY };
        for measured_nt in &mut measured_nt {
            *measured_nt += if normals.draw() > threshold { outliers } else { 0.0 };
        }
        Self { ins: truth.with_errors(&errors), truth, measured_nt, errors: model }
    }

    fn smoothed(&self, loss: TrajectoryLoss) -> RtsOutput {
        let (map, core) = world();
        let (ins, sigma_nt) = (self.ins.series(), vec![5.0; self.measured_nt.len()]);
        let line = NavigationLine {
            ins: &ins,
            measurement_nt: &self.measured_nt,
            sigma_nt: &sigma_nt,
            map,
            core: Some(core),
            errors: self.errors,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        };
        run(&line, &RtsParameters { loss, ..RtsParameters::default() }).unwrap()
    }

    fn filtered(&self) -> NavigationOutput {
        let (map, core) = world();
        let parameters = EkfParameters { errors: self.errors, ..EkfParameters::default() };
        ekf::run(&parameters, &self.ins.series(), &self.measured_nt, map, Some(core)).unwrap()
    }

    /// Errors north and east, in metres.
    fn error_m(&self, output: &NavigationOutput, row: usize) -> [f64; 2] {
        let lat_rad = self.truth.columns[1][row].to_radians();
        let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(lat_rad, 500.0);
        let off = |estimate: f64, column: usize| (estimate - self.truth.columns[column][row]).to_radians();
        [north * off(output.lat_deg[row], 1), east * off(output.lon_deg[row], 2)]
    }

    /// NEES: chi-square with 2 degrees of freedom.
    fn nees(&self, output: &NavigationOutput, row: usize) -> f64 {
        let [n, e] = self.error_m(output, row);
        let (a, b, c) = (output.sd_n_m[row].powi(2), output.cov_ne_m2[row], output.sd_e_m[row].powi(2));
        (c * n * n - 2.0 * b * n * e + a * e * e) / (a * c - b * b)
    }

    fn square_m2(&self, output: &NavigationOutput, row: usize) -> f64 {
        self.error_m(output, row).iter().map(|error| error * error).sum()
    }

    fn drms_m(&self, output: &NavigationOutput) -> f64 {
        let rows = self.measured_nt.len();
        ((0..rows).map(|row| self.square_m2(output, row)).sum::<f64>() / rows as f64).sqrt()
    }
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normal deviates, by the formula of Wilson and
/// Hilferty.
fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

#[test]
fn law_the_smoother_is_consistent_and_more_accurate_than_the_filter() {
    let flights: Vec<Flight> = (0..RUNS).map(|seed| Flight::new(seed, 0.0)).collect();
    let smoothed: Vec<RtsOutput> = flights.iter().map(|flight| flight.smoothed(TrajectoryLoss::None)).collect();
    let filtered: Vec<NavigationOutput> = flights.iter().map(Flight::filtered).collect();
    let n = RUNS as f64;
    let (mut all, mut outside) = (0.0, 0);
    for row in EPOCHS {
        let pairs = || flights.iter().zip(smoothed.iter().zip(&filtered));
        let nees = pairs().map(|(flight, (ours, _))| flight.nees(&ours.line, row)).sum::<f64>() / n;
        let ours = (pairs().map(|(flight, (ours, _))| flight.square_m2(&ours.line, row)).sum::<f64>() / n).sqrt();
        let filter = (pairs().map(|(flight, (_, filter))| flight.square_m2(filter, row)).sum::<f64>() / n).sqrt();
        println!("row {row}: NEES {nees:.2}, smoother {ours:.2} m, filter {filter:.2} m");
        if row + 1 < SAMPLES as usize {
            // In the first seconds the INS is accurate to 4 m, and measurements contribute little.
            assert!(ours < if row < 100 { 1.0 } else { 0.8 } * filter, "{row} {ours} {filter}");
        } else {
            // Both estimates use the same information; the map is linearised at different positions.
            assert!((ours / filter - 1.0).abs() < 0.1, "{ours} {filter}");
        }
        all += nees / 2.0 / EPOCHS.len() as f64;
        outside += usize::from(!(chi_square(2.0 * n, -1.96) / n..=chi_square(2.0 * n, 1.96) / n).contains(&nees));
    }
    // By chance, one epoch in twenty is outside the 95 % band, and at least 2 of 6 epochs are outside in 3 % of all
    // cases.
    assert!(outside <= 1, "{outside}");
    let freedom = 2.0 * n * EPOCHS.len() as f64;
    assert!((chi_square(freedom, -1.96)..=chi_square(freedom, 1.96)).contains(&(all * freedom)), "{all}");
    let nis = smoothed.iter().map(|ours| ours.line.nis.iter().sum::<f64>()).sum::<f64>() / n / f64::from(SAMPLES);
    println!("NEES per degree of freedom {all:.3}, NIS {nis:.4}");
    // The mean of 60,000 values has a standard deviation of 0.006; the effect of linearising along the future is
    // smaller.
    assert!((nis - 1.0).abs() < 0.02, "{nis}");
    assert!(smoothed.iter().all(|ours| ours.iterations.converged && ours.iterations.passes <= 6));
}

#[test]
fn law_robust_losses_limit_the_effect_of_outliers() {
    let runs = 12;
    let mut sums = [0.0; 6];
    for seed in 0..runs {
        let (clean, spoilt) = (Flight::new(seed, 0.0), Flight::new(seed, 100.0));
        for (at, loss) in [TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy].into_iter().enumerate()
        {
            sums[at] += clean.drms_m(&clean.smoothed(loss).line).powi(2) / runs as f64;
            sums[3 + at] += spoilt.drms_m(&spoilt.smoothed(loss).line).powi(2) / runs as f64;
        }
    }
    let [none, huber, cauchy, none_spoilt, huber_spoilt, cauchy_spoilt] = sums.map(f64::sqrt);
    println!("clean: none {none:.1} m, Huber {huber:.1}, Cauchy {cauchy:.1}");
    println!("5 % outliers: none {none_spoilt:.1} m, Huber {huber_spoilt:.1}, Cauchy {cauchy_spoilt:.1}");
    // The efficiency for normal noise is 95 %.
    assert!(huber < 1.2 * none && cauchy < 1.2 * none, "{huber} {cauchy} {none}");
    assert!(cauchy_spoilt < 1.3 * none, "{cauchy_spoilt} {none}");
    assert!(huber_spoilt < 1.3 * none, "{huber_spoilt} {none}");
    assert!(none_spoilt > 2.0 * none, "{none_spoilt} {none}");
}

#[test]
fn law_a_large_initial_error_is_corrected_with_every_loss() {
    let mut model = InsErrorModel::default();
    model.sources.init_position_sigma_m = 300.0;
    let mut worst = [0.0_f64; 4];
    for seed in 0..6 {
        let flight = Flight::of(seed, 0.0, model);
        worst[3] = worst[3].max(flight.drms_m(&flight.filtered()));
        for (worst, loss) in worst.iter_mut().zip([TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy])
        {
            let smoothed = flight.smoothed(loss);
            assert!(smoothed.iterations.converged, "{seed} {loss:?} {:?}", smoothed.iterations);
            *worst = worst.max(flight.drms_m(&smoothed.line));
        }
    }
    println!("worst flight: none, Huber, Cauchy, filter {worst:.1?} m");
    // The result is as accurate as from an initial error of 3 m, for which the largest error is 20 m. The map supplies
    // the remaining information.
    assert!(worst[..3].iter().all(|worst| *worst < 40.0), "{worst:?}");
}
