//! Basis of the anomaly: eigenfunctions of the Laplacian on a rectangle, with the spectrum of the kernel.

use std::f64::consts::PI;

use crate::navigation::slam::{AnomalyKernel, CovarianceFunction};

/// Target for the fraction of the variance that the basis omits. The fraction is larger if the target requires more
/// than the maximum number of functions.
const LACKING: f64 = 1e-4;
/// Distance from the outermost sample to the boundary, in lengths of the kernel. The field is zero at the boundary,
/// which reduces its variance at the outermost sample by k(4 l)/k(0), or 0.5 % for the Matérn covariance with ν = 5/2.
const MARGIN: f64 = 2.0;

/// Function of the basis: the numbers of half waves eastward and northward, counted from 1.
pub type HalfWaves = [usize; 2];

/// Basis on the rectangle around the samples.
///
/// φ_j(x) = sin(j₁ θ₁) sin(j₂ θ₂)/√(L₁ L₂), θ = π (x + L)/2L, on a rectangle of half sides L about its middle. The
/// weights of the functions are independent, with the variances S(√λ_j), where S is the spectral density of the kernel.
/// [Solin & Särkkä 2020, (56)-(60)]
#[derive(Clone, Debug)]
pub struct LaplacianBasis {
    /// Middle of the rectangle, east and north, in metres.
    pub middle_m: [f64; 2],
    /// Half sides of the rectangle, in metres.
    pub half_m: [f64; 2],
    /// Functions, ordered by the half waves eastward, then northward.
    pub functions: Vec<HalfWaves>,
    /// Standard deviation of the weight of each function, times √(1/L₁L₂), in nT.
    pub scales_nt: Vec<f64>,
    /// Maximum numbers of half waves eastward and northward.
    pub most: HalfWaves,
    /// Variance of waves shorter than those of the basis, in nT².
    pub lacking_nt2: f64,
}

impl LaplacianBasis {
    /// Basis for the samples between `low_m` and `high_m` (east, north), with a maximum number of functions.
    pub fn new(kernel: &AnomalyKernel, low_m: [f64; 2], high_m: [f64; 2], most: usize) -> Self {
        let middle_m = [0, 1].map(|axis: usize| 0.5 * (low_m[axis] + high_m[axis]));
        let half_m = [0, 1].map(|axis: usize| 0.5 * (high_m[axis] - low_m[axis]) + MARGIN * kernel.length_m);
        let wanted = wavenumber_beyond(kernel, LACKING);
        // A quarter of an ellipse of semi-axes 2 L k/π has L₁L₂ k²/π functions.
        let cut = (PI * most as f64 / (half_m[0] * half_m[1])).sqrt().min(wanted);
        let wavenumber = |j: usize, axis: usize| PI * j as f64 / (2.0 * half_m[axis]);
        let last = |axis: usize| (2.0 * half_m[axis] * cut / PI).floor() as usize;
        let (mut functions, mut scales_nt) = (vec![], vec![]);
        let per_area = 1.0 / (half_m[0] * half_m[1]);
        for east in 1..=last(0).max(1) {
            for north in 1..=last(1).max(1) {
                let k = wavenumber(east, 0).hypot(wavenumber(north, 1));
                if k <= cut || (east == 1 && north == 1) {
                    functions.push([east, north]);
                    scales_nt.push((density(kernel, k) * per_area).sqrt());
                }
            }
        }
        let most = [0, 1].map(|axis: usize| functions.iter().map(|function| function[axis]).max().unwrap_or(1));
        let lacking_nt2 = kernel.sigma_se_nt.powi(2) * beyond(kernel, cut);
        Self { middle_m, half_m, functions, scales_nt, most, lacking_nt2 }
    }

    /// Whether a position is inside the rectangle.
    pub fn holds(&self, at_m: [f64; 2]) -> bool {
        [0, 1].into_iter().all(|axis: usize| (at_m[axis] - self.middle_m[axis]).abs() < self.half_m[axis])
    }

    /// θ of a coordinate east (0) or north (1), from 0 at the western or southern edge to π.
    pub fn angle(&self, coordinate_m: f64, axis: usize) -> f64 {
        0.5 * PI * ((coordinate_m - self.middle_m[axis]) / self.half_m[axis] + 1.0)
    }

    /// Change of θ per metre.
    pub fn angle_per_m(&self, axis: usize) -> f64 {
        0.5 * PI / self.half_m[axis]
    }
}

/// Computes cos(j θ) for j from 0 on, and sin(j θ) for j from 1 on (at the index j − 1).
pub fn waves(theta: f64, cosines: &mut [f64], sines: &mut [f64]) {
    for (j, cosine) in cosines.iter_mut().enumerate() {
        *cosine = (j as f64 * theta).cos();
    }
    for (j, sine) in sines.iter_mut().enumerate() {
        *sine = ((j + 1) as f64 * theta).sin();
    }
}

/// Order ν of the Matérn covariances; `None` for the squared exponential.
fn index(covariance: CovarianceFunction) -> Option<f64> {
    match covariance {
        CovarianceFunction::Matern52 => Some(2.5),
        CovarianceFunction::Matern32 => Some(1.5),
        CovarianceFunction::SquaredExponential => None,
    }
}

/// Spectral density of the kernel in the plane at a wavenumber (rad/m), in nT² m²: k(r) = ∫∫ S cos(k·r) d²k/4π².
/// [Rasmussen & Williams 2006, (4.15)]
pub fn density(kernel: &AnomalyKernel, wavenumber: f64) -> f64 {
    let (power, length2) = (kernel.sigma_se_nt.powi(2), kernel.length_m.powi(2));
    match index(kernel.covariance) {
        None => power * 2.0 * PI * length2 * (-0.5 * length2 * wavenumber * wavenumber).exp(),
        Some(nu) => {
            let corner = 2.0 * nu / length2;
            // 4πν (2ν)^ν/l^2ν (2ν/l² + k²)^−(ν+1), in a form without overflow.
            power * 4.0 * PI * nu / corner * (1.0 + wavenumber * wavenumber / corner).powf(-(nu + 1.0))
        }
    }
}

/// Fraction of the variance above a wavenumber.
fn beyond(kernel: &AnomalyKernel, wavenumber: f64) -> f64 {
    let waves = (wavenumber * kernel.length_m).powi(2);
    match index(kernel.covariance) {
        None => (-0.5 * waves).exp(),
        Some(nu) => (1.0 + waves / (2.0 * nu)).powf(-nu),
    }
}

/// Wavenumber above which the fraction `part` of the variance lies.
fn wavenumber_beyond(kernel: &AnomalyKernel, part: f64) -> f64 {
    let waves = match index(kernel.covariance) {
        None => -2.0 * part.ln(),
        Some(nu) => 2.0 * nu * (part.powf(-1.0 / nu) - 1.0),
    };
    waves.sqrt() / kernel.length_m
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [CovarianceFunction; 3] =
        [CovarianceFunction::Matern52, CovarianceFunction::Matern32, CovarianceFunction::SquaredExponential];

    fn kernel(covariance: CovarianceFunction) -> AnomalyKernel {
        AnomalyKernel { covariance, sigma_se_nt: 30.0, length_m: 400.0, sigma_n_nt: 1.0 }
    }

    #[test]
    fn law_the_density_is_the_transform_of_the_kernel() {
        for covariance in ALL {
            let kernel = kernel(covariance);
            // Hankel transform of order 0, computed as a mean over directions, k(r) = ∫ S(k) J₀(kr) k dk/2π.
            let j0 = |x: f64| (0..64).map(|i| (x * (PI * (f64::from(i) + 0.5) / 64.0).cos()).cos()).sum::<f64>() / 64.0;
            for r in [0.0, 200.0, 700.0] {
                let step = 2e-5;
                let sum: f64 = (0..20_000)
                    .map(|i| (f64::from(i) + 0.5) * step)
                    .map(|k| density(&kernel, k) * j0(k * r) * k * step / (2.0 * PI))
                    .sum();
                let expected = kernel.anomaly_nt2(r * r);
                // The rougher Matérn covariance has 2e-6 of its variance above the last wavenumber; the transform omits
                // a larger fraction.
                assert!((sum - expected).abs() < 2e-3 * 900.0, "{covariance:?} {r}: {sum} {expected}");
            }
        }
    }

    #[test]
    fn law_the_functions_have_the_variance_except_the_omitted_part() {
        for covariance in ALL {
            let kernel = kernel(covariance);
            for most in [100, 4000] {
                let basis = LaplacianBasis::new(&kernel, [-2000.0, 0.0], [2000.0, 3000.0], most);
                assert!(basis.functions.len() <= most, "{} {most}", basis.functions.len());
                // A position in the middle, where the effect of the boundary is negligible.
                let theta = [0, 1].map(|axis: usize| basis.angle(basis.middle_m[axis] + 11.0, axis));
                let variance: f64 = basis
                    .functions
                    .iter()
                    .zip(&basis.scales_nt)
                    .map(|([a, b], s)| (s * (*a as f64 * theta[0]).sin() * (*b as f64 * theta[1]).sin()).powi(2))
                    .sum();
                let whole = variance + basis.lacking_nt2;
                assert!((whole / 900.0 - 1.0).abs() < 0.06, "{covariance:?} {most}: {variance} {}", basis.lacking_nt2);
            }
        }
    }
}
