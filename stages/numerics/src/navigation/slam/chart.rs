//! Map estimated from a flight.

use super::index::SlamSampleIndex;
use super::kernel::{AnomalyKernel, BorderedCovariance, MOST_NEIGHBOURS};
use super::output::{PathSample, SlamOutput};
use rayon::prelude::*;

/// Map of the anomaly on a regular grid, by rows from the south.
#[derive(Clone, Debug)]
pub struct SlamMap {
    /// Latitudes of the rows, in degrees, ascending.
    pub lat_deg: Vec<f64>,
    /// Longitudes of the columns, in degrees, ascending.
    pub lon_deg: Vec<f64>,
    /// Anomaly, in nT; NaN without a measurement nearby.
    pub value_nt: Vec<f64>,
    /// Standard deviation, in nT, given the path; NaN if the anomaly is NaN.
    pub sd_nt: Vec<f64>,
}

/// Nodes of a grid: first latitude and longitude, steps and counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamMapGrid {
    /// Latitude of the first row and longitude of the first column, in degrees.
    pub south_west_deg: (f64, f64),
    /// Steps of latitude and longitude, in degrees, above 0.
    pub step_deg: (f64, f64),
    /// Numbers of rows and columns.
    pub size: (usize, usize),
}

impl SlamOutput {
    /// Computes the map of the flight by kriging of the measurements at the positions of [`SlamOutput::path`]. Each
    /// node uses the 24 nearest measurements within three lengths of the kernel.
    ///
    /// The Gaussian process is the same as in the filter: an anomaly with an unknown mean, white noise, and a temporal
    /// variation, which is removed from the map. `temporal` has the standard deviation (nT) and correlation time (s) of
    /// the temporal variation. Differences from the mean height are treated as noise. Nodes whose standard deviation is
    /// above `most_sd_nt` are NaN.
    pub fn chart(&self, temporal: (f64, f64), grid: &SlamMapGrid, most_sd_nt: f64) -> SlamMap {
        let axis = |first: f64, step: f64, count: usize| (0..count).map(move |place| first + step * place as f64);
        let (rows, columns) = grid.size;
        let lat_deg: Vec<f64> = axis(grid.south_west_deg.0, grid.step_deg.0, rows).collect();
        let lon_deg: Vec<f64> = axis(grid.south_west_deg.1, grid.step_deg.1, columns).collect();
        let drawing = PathKriging::new(self, temporal);
        let node = |place: usize| {
            let at_m = self.frame.at_m(lat_deg[place / columns], lon_deg[place % columns]);
            drawing.krige(at_m).filter(|(_, sd_nt)| *sd_nt <= most_sd_nt)
        };
        let nodes: Vec<Option<(f64, f64)>> = (0..rows * columns).into_par_iter().map(node).collect();
        let (value_nt, sd_nt) = nodes.into_iter().map(|node| node.unwrap_or((f64::NAN, f64::NAN))).unzip();
        SlamMap { lat_deg, lon_deg, value_nt, sd_nt }
    }
}

/// Path, with the spatial index and the kernel for interpolating the measurements along it.
struct PathKriging<'a> {
    path: &'a [PathSample],
    index: SlamSampleIndex,
    kernel: AnomalyKernel,
    temporal: (f64, f64),
    alt_m: f64,
}

impl<'a> PathKriging<'a> {
    fn new(output: &'a SlamOutput, temporal: (f64, f64)) -> Self {
        let (path, kernel) = (output.path.as_slice(), output.report.kernel);
        let mut index = SlamSampleIndex::new(0.5 * kernel.length_m, usize::MAX);
        for (place, sample) in path.iter().enumerate() {
            index.insert(place as u32, sample.at_m);
        }
        let alt_m = path.iter().map(|sample| sample.alt_m).sum::<f64>() / path.len().max(1) as f64;
        Self { path, index, kernel, temporal, alt_m }
    }

    /// Nearest measurements, by distance.
    fn near(&self, at_m: [f64; 2]) -> Vec<&'a PathSample> {
        let mut found = vec![];
        self.index.within(at_m, 3.0 * self.kernel.length_m, &mut found);
        let mut near: Vec<(f64, u32)> = vec![];
        near.extend(found.iter().map(|place| (distance2(self.path[*place as usize].at_m, at_m), *place)));
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.iter().take(MOST_NEIGHBOURS).map(|(_, place)| &self.path[*place as usize]).collect()
    }

    /// Value and standard deviation at a position, in nT.
    fn krige(&self, at_m: [f64; 2]) -> Option<(f64, f64)> {
        let near = self.near(at_m);
        if near.is_empty() {
            return None;
        }
        let centre = near.iter().map(|sample| sample.value_nt).sum::<f64>() / near.len() as f64;
        let (kernel, (sigma_nt, tau_s)) = (&self.kernel, self.temporal);
        let covariance = |row: usize, column: usize| {
            let spatial = |a: [f64; 2], b: [f64; 2]| kernel.anomaly_nt2(distance2(a, b)) + kernel.mean_nt2();
            match (near.get(row), near.get(column)) {
                (Some(a), Some(b)) => {
                    let temporal = sigma_nt * sigma_nt * (-(a.tt_s - b.tt_s).abs() / tau_s).exp();
                    let white = a.variance_nt2 + kernel.sigma_n_nt.powi(2) + kernel.height_nt2(a.alt_m - self.alt_m);
                    spatial(a.at_m, b.at_m) + temporal + if row == column { white } else { 0.0 }
                }
                (Some(a), None) | (None, Some(a)) => spatial(a.at_m, at_m),
                (None, None) => spatial(at_m, at_m),
            }
        };
        let mut system = BorderedCovariance::new(near.len());
        system.fill(covariance, |place| near.get(place).map_or(0.0, |sample| sample.value_nt - centre));
        let expected = system.solve()?;
        Some((expected.value_nt + centre, expected.variance_nt2.sqrt()))
    }
}

fn distance2(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
