//! Output of the filter on a line.

use crate::navigation::NavigationOutput;

use super::expected::ParticleMap;
use super::kernel::AnomalyKernel;
use super::particles::SlamParticles;
use super::samples::{LocalFrame, SlamSample};
use super::smoother::SlamSmootherReport;

/// Report on the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamReport {
    /// Hyper-parameters of the filter.
    pub kernel: AnomalyKernel,
    /// Whether the hyper-parameters were fitted. If this is false although a fit was requested, the first part of the
    /// flight has too few measurements, or they are constant. The given hyper-parameters were then used.
    pub fitted: bool,
    /// Number of steps at which some particles revisited, so that all particles were weighted.
    pub revisits: usize,
    /// Number of resamplings.
    pub resamplings: usize,
    /// Maximum number of generations in the history.
    pub generations: usize,
    /// Largest squared correction of the position over the covariance of the INS alone: chi-square of 2 degrees of
    /// freedom if filter and INS are consistent.
    pub largest_correction: f64,
    /// Report on the smoother; `None` if smoothing was not requested, or if the smoother has no solution and the track
    /// of the filter is returned.
    pub smoother: Option<SlamSmootherReport>,
}

/// Output of the filter on a line.
///
/// In `navigation.report`, `off_map` counts the samples whose measurement had no separate weight: no particle had been
/// nearby before, or the measurement was averaged into the step.
#[derive(Clone, Debug)]
pub struct SlamOutput {
    /// Estimate at each sample from the measurements up to this sample.
    pub navigation: NavigationOutput,
    /// Number of revisiting particles at each sample; 0 between steps.
    pub revisiting: Vec<u32>,
    /// Effective number of particles after weighting, at each sample.
    pub effective: Vec<f64>,
    /// Measurements at positions estimated from the whole flight.
    pub path: Vec<PathSample>,
    /// Frame of `path`.
    pub frame: LocalFrame,
    /// Report on the flight.
    pub report: SlamReport,
}

/// Measurement, at its position as estimated by the particles at the end of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample {
    /// Row of the sample in the line: the last row of its step.
    pub row: usize,
    /// Mean time, in seconds.
    pub tt_s: f64,
    /// Latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height of the INS, in metres.
    pub alt_m: f64,
    /// Position north and east in the frame of the flight, in metres.
    pub at_m: [f64; 2],
    /// Root mean square distance of the particles from the mean position, in metres.
    pub spread_m: f64,
    /// Measured anomaly, in nT: the measurement minus the core field at this position.
    pub value_nt: f64,
    /// Variance of the white noise of the measurement, in nT².
    pub variance_nt2: f64,
}

/// Weighted mean of the particles' paths.
pub(super) fn path_of(map: &ParticleMap, particles: &SlamParticles, frame: &LocalFrame) -> Vec<PathSample> {
    let at = |(place, sample): (usize, &SlamSample)| {
        let then = map.history.at(place)?;
        let mean = |of: &dyn Fn([f64; 2]) -> f64| -> f64 {
            particles
                .weights
                .iter()
                .enumerate()
                .map(|(particle, weight)| weight * of(then.displacement(particle)))
                .sum()
        };
        let (north, east) = (mean(&|moved| moved[0]), mean(&|moved| moved[1]));
        let spread_m = mean(&|moved| (moved[0] - north).powi(2) + (moved[1] - east).powi(2)).sqrt();
        let at_m = [sample.at_m[0] + north, sample.at_m[1] + east];
        let (lat_deg, lon_deg) = frame.lat_lon_deg(at_m);
        let [slope_n, slope_e] = sample.core_nt_per_m;
        Some(PathSample {
            row: sample.row,
            tt_s: sample.tt_s,
            lat_deg,
            lon_deg,
            alt_m: sample.alt_m,
            at_m,
            spread_m,
            value_nt: sample.value_nt - slope_n * north - slope_e * east,
            variance_nt2: sample.variance_nt2,
        })
    };
    map.samples.iter().enumerate().filter_map(at).collect()
}
