//! Output of the filter on a line.

use crate::earth::geodesy::EarthModel;
use crate::navigation::aids::{AidInnovations, SampleUsage};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::NavigationOutput;
use crate::navigation::pinson::{LAT, LON};

use super::cloud::ParticleCloud;
use super::modes::ModeClusters;
use super::resampling::position;

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct MpfOutput {
    /// Weighted mean of the particles and covariance of their positions, after the measurement of each sample and
    /// before resampling. The residual is the measurement minus the mean prediction of the particles on the map, and
    /// its variance is the variance of the mixture. Measurements that no particle explains are counted as gated.
    pub track: NavigationOutput,
    /// Effective number of particles 1/Σq² after the measurement of each sample, before resampling.
    pub effective: Vec<f64>,
    /// Number of particles at each sample, before resampling.
    pub particles: Vec<usize>,
    /// Outcome of each sample.
    pub usage: Vec<SampleUsage>,
    /// Innovations of the further measurements for the whole cloud, defined as for the field.
    pub aids: AidInnovations,
    /// Modes of the samples selected by [`super::MpfParameters::modes_every`], and of the last sample.
    pub modes: Vec<SampleModes>,
    /// Report on the particles.
    pub report: MpfReport,
}

/// Report on the particles. A cloud that has lost the aircraft appears as `unexplained` or `collapsed` samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MpfReport {
    /// Number of resamplings.
    pub resamplings: usize,
    /// Samples whose measurement of the field is not used because no particle explains it ([`super::UNEXPLAINED_NIS`]).
    pub unexplained: usize,
    /// Longest run of these samples; samples without a measurement do not interrupt it.
    pub unexplained_in_a_row: usize,
    /// Samples whose effective number of particles is below 2 after the measurement: the estimate is a single particle,
    /// and its covariance is meaningless.
    pub collapsed: usize,
    /// Longest run of these samples; samples without a used measurement do not interrupt it.
    pub collapsed_in_a_row: usize,
    /// Smallest effective number of particles.
    pub least_effective: f64,
}

/// Modes at a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleModes {
    /// Index of the sample, from 0.
    pub row: usize,
    /// Modes by descending weight; the weights add up to 1.
    pub modes: Vec<PositionMode>,
}

/// Mode of the density of the particles' positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionMode {
    /// Probability that the aircraft is in this mode.
    pub weight: f64,
    /// Mean latitude, in degrees.
    pub lat_deg: f64,
    /// Mean longitude, in degrees.
    pub lon_deg: f64,
    /// Standard deviation of the north position about the mean of the mode, in metres.
    pub sd_n_m: f64,
    /// Standard deviation of the east position, in metres.
    pub sd_e_m: f64,
    /// Covariance of north with east, in m².
    pub cov_ne_m2: f64,
}

/// Sums over a mode.
#[derive(Clone, Copy, Default)]
struct ModeSums {
    weight: f64,
    mean: [f64; 2],
    covariance: [f64; 3],
}

/// Modes of a cloud at a row, by descending weight.
pub(super) fn modes_of<const N: usize>(
    clusters: &mut ModeClusters,
    cloud: &ParticleCloud<N>,
    ins: &InsSeries<'_>,
    row: usize,
    earth: EarthModel,
) -> SampleModes {
    let weights = &cloud.weights.as_flattened()[..cloud.particles];
    clusters.find(weights, |index| position(cloud, index));
    let mut sums = vec![ModeSums::default(); clusters.count];
    let own = || weights.iter().zip(&clusters.labels).enumerate();
    for (index, (weight, own)) in own() {
        let (sums, [lat, lon]) = (&mut sums[*own as usize], position(cloud, index));
        sums.weight += weight;
        sums.mean = [sums.mean[0] + weight * lat, sums.mean[1] + weight * lon];
    }
    sums.iter_mut().for_each(|sums| sums.mean = sums.mean.map(|sum| sum / sums.weight));
    for (index, (weight, own)) in own() {
        let (sums, at) = (&mut sums[*own as usize], position(cloud, index));
        let (lat, lon) = (at[0] - sums.mean[0], at[1] - sums.mean[1]);
        let [a, b, c] = sums.covariance;
        sums.covariance = [a + weight * lat * lat, b + weight * lat * lon, c + weight * lon * lon];
    }
    sums.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let all: f64 = sums.iter().map(|sums| sums.weight).sum();
    let mode = |sums: &ModeSums| {
        let (lat_deg, lon_deg) = (sums.mean[LAT].to_degrees(), sums.mean[LON].to_degrees());
        let (lat_deg, lon_deg) = (ins.lat_deg[row] + lat_deg, ins.lon_deg[row] + lon_deg);
        let (north, east) = earth.north_east_m_per_rad(lat_deg.to_radians(), ins.alt_m[row]);
        let [a, b, c] = sums.covariance.map(|sum| sum / sums.weight);
        let (sd_n_m, sd_e_m) = (north * a.sqrt(), east * c.sqrt());
        PositionMode { weight: sums.weight / all, lat_deg, lon_deg, sd_n_m, sd_e_m, cov_ne_m2: north * east * b }
    };
    SampleModes { row, modes: sums.iter().map(mode).collect() }
}
