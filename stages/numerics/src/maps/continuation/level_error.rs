//! The error of a map continued downward: the map's amplified error, and the field removed by damping.

use super::gain::gain;
use super::radial_power::{RadialPower, WavenumberBin};

/// If the noise is not given, waves above this fraction of the largest wavenumber are treated as noise.
const NOISE_FROM: f64 = 0.7;
/// A wave is treated as field if its mean square exceeds this multiple of the mean square of the noise.
const RESOLVED: f64 = 4.0;
/// A slope is fitted to the waves above this fraction of the largest resolved wavenumber.
const FITTED_FROM: f64 = 0.35;
/// Minimum number of bins for a slope.
const LEAST_BINS: usize = 4;

/// Mean squares of field and noise in a wavenumber bin, in nT².
struct BinMeanSquares {
    bin: WavenumberBin,
    field: f64,
    noise: f64,
}

impl RadialPower {
    /// Root mean square error, in nT, of the map continued downward by `down_m` metres with this α. The error contains
    /// the amplified noise of the nodes and the field that the damping removes. The noise has a standard deviation of
    /// `noise_nt` and is independent from node to node.
    ///
    /// Without `noise_nt` the noise is estimated from the shortest waves of the map, including any field in them. Waves
    /// of the field below the noise level are extrapolated from the resolved waves by ln P = a − 2 k d, the spectrum of
    /// sources at a depth d. [Spector & Grant 1970, Geophysics 35] Edge errors are not included; see
    /// [`super::edge_error()`].
    pub fn downward_error_nt(&self, down_m: f64, alpha_m2: f64, noise_nt: Option<f64>) -> f64 {
        let error = |parts: &BinMeanSquares| {
            let k = parts.bin.k;
            let amplified = gain(k, -down_m, alpha_m2);
            // e^(k h) − e^(k h)/(1 + α k² e^(k h)), without overflow.
            let lost = alpha_m2 * k * k * amplified * (k * down_m).min(300.0).exp();
            parts.noise * amplified * amplified + parts.field * lost * lost
        };
        self.parts(noise_nt).iter().map(error).sum::<f64>().sqrt()
    }

    fn parts(&self, noise_nt: Option<f64>) -> Vec<BinMeanSquares> {
        let floor = self.noise_floor();
        let noise = noise_nt.map_or(floor, |noise| noise * noise);
        // Padding leaks part of the long waves into all wavenumbers.
        let least = RESOLVED * noise.max(floor);
        let resolved: Vec<&WavenumberBin> = self.bins.iter().filter(|bin| bin.square > least * bin.part).collect();
        let longest = self.bins.iter().map(|bin| bin.square / bin.part).fold(0.0, f64::max);
        let last_k = resolved.last().map_or(0.0, |bin| bin.k);
        let beyond = decay(&resolved, last_k);
        let split = |bin: &WavenumberBin| {
            let noise = (noise * bin.part).min(if noise_nt.is_some() { f64::INFINITY } else { bin.square });
            let field = if bin.k <= last_k { bin.square - noise } else { bin.part * beyond(bin.k).min(longest) };
            BinMeanSquares { bin: *bin, field: field.max(0.0), noise }
        };
        self.bins.iter().map(split).collect()
    }

    /// Upper bound, in nT², of the mean square of white noise, from the shortest waves of the map: the median over
    /// their bins.
    fn noise_floor(&self) -> f64 {
        let short = |bin: &&WavenumberBin| (NOISE_FROM * self.round_k..=self.round_k).contains(&bin.k);
        let mut all: Vec<f64> = self.bins.iter().filter(short).map(|bin| bin.square / bin.part).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(0.0)
    }
}

/// Mean square, in nT², that all waves together would have if each had the power of the field at a given wavenumber.
/// This power is extrapolated with the slope of the resolved waves; 0 without a slope.
fn decay(resolved: &[&WavenumberBin], last_k: f64) -> impl Fn(f64) -> f64 + use<> {
    let fitted: Vec<(f64, f64)> = resolved
        .iter()
        .filter(|bin| bin.k >= FITTED_FROM * last_k)
        .map(|bin| (bin.k, (bin.square / bin.part).ln()))
        .collect();
    let n = fitted.len() as f64;
    let (k, ln) = fitted.iter().fold((0.0, 0.0), |(k, ln), one| (k + one.0 / n, ln + one.1 / n));
    let (mut across, mut along) = (0.0, 0.0);
    for (one_k, one_ln) in &fitted {
        across += (one_k - k) * (one_ln - ln);
        along += (one_k - k).powi(2);
    }
    let slope = if fitted.len() >= LEAST_BINS && along > 0.0 { (across / along).min(0.0) } else { f64::NEG_INFINITY };
    move |at: f64| if slope.is_finite() { (ln + slope * (at - k)).exp() } else { 0.0 }
}
