//! Sampling errors of coefficients whose residual is correlated, from cross-spectra of terms and target in bands.
//!
//! A filter leaves residuals that are correlated over its impulse response. Coloured noise also leaves correlated
//! residuals. The usual covariance s² (AᵀA)⁻¹ assumes independent residuals. After a pass band of 0.1 to 0.9 Hz at 10
//! Hz, its standard deviations are 2.5 times too small. The covariance of b = G Aᵀ y, with G = (AᵀA + λ)⁻¹, is
//!
//! ```text
//! G (Aᵀ Σ A) G,   Aᵀ Σ A ≈ Σ over bands  s_band C_band
//! ```
//!
//! where C_band is the part of AᵀA in a band of frequencies, and s_band the power of the residual in this band, per
//! degree of freedom. The bands are an eighth of an octave wide. Neighbouring bands are merged until enough degrees of
//! freedom for a power estimate remain after the fit. Terms and residual may have any spectrum that is smooth within a
//! band.
//!
//! A drifting residual, such as a random walk in a fit without a filter, has different values at its ends. The
//! resulting jump correlates the residual's Fourier components, and a slow term fits the ramp: standard deviations are
//! then 2 to 4 times too small. If the slowest waves are far stronger than the next waves, the residual is therefore
//! split into a ramp from its first to its last sample and a remainder with independent waves. The variance of the ramp
//! is that of a random walk with the increments of the slowest waves ([`ResidualDrift::Wandering`]). The uncertainty of
//! a constant increases with the length of the walk and is not included in its standard deviation.
//!
//! Source: Hannan 1963, Regression for time series; Robinson 1998, Inference without smoothing in the presence of
//! nonparametric autocorrelation, Econometrica 66(5).

use std::collections::BTreeMap;

use realfft::{RealFftPlanner, num_complex::Complex};

/// Number of bands per octave.
const BANDS: f64 = 8.0;
/// Lower edge of the lowest regular band, in Hz; all slower waves form one further band.
const LOWEST_HZ: f64 = 1e-3;
/// Minimum degrees of freedom that a band must have after the fit.
const LEAST_FREEDOM: f64 = 16.0;

/// Waves of a run that indicate a drifting residual: the slowest waves, and the waves with which they are compared.
const SLOWEST: std::ops::Range<usize> = 1..5;
const NEXT: std::ops::Range<usize> = 9..25;
/// Minimum ratio of the power of the slowest waves to the power of the next waves for a drifting residual. Fewer than
/// one in a million runs of independent samples reaches this ratio; a random walk has 80.
const WANDERS: f64 = 10.0;

/// Model of a residual's drift between the first and the last sample of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResidualDrift {
    /// No drift: the residual is as far from 0 at one end as at the other, as for rows after a high-pass.
    Bound,
    /// Free drift.
    Wandering,
}

/// Cross-products of columns within a band of frequencies.
#[derive(Clone, Debug, PartialEq)]
struct SpectralBand {
    /// Real degrees of freedom: two for each frequency, but one for the first and for the last.
    freedom: f64,
    /// The upper triangle of the cross-products, row by row.
    products: Vec<f64>,
    /// Upper triangle of the cross-products after subtraction of the columns' ramps; empty for
    /// [`ResidualDrift::Bound`].
    level: Vec<f64>,
}

impl SpectralBand {
    fn none(size: usize, level: bool) -> Self {
        Self { freedom: 0.0, products: vec![0.0; size], level: vec![0.0; if level { size } else { 0 }] }
    }

    fn add(&mut self, other: &Self) {
        self.freedom += other.freedom;
        self.products.iter_mut().zip(&other.products).for_each(|(a, b)| *a += b);
        self.level.iter_mut().zip(&other.level).for_each(|(a, b)| *a += b);
    }
}

/// Statistics of a drifting residual. All except the last are upper triangles of sums over runs.
#[derive(Clone, Debug, PartialEq)]
struct DriftStatistics {
    /// Mean powers of the slowest waves.
    slowest: Vec<f64>,
    /// The mean powers of the next waves.
    next: Vec<f64>,
    /// Mean squares of the increments of a random walk, from the slowest waves of the columns after subtraction of
    /// their ramps.
    increments: Vec<f64>,
    /// n Aᵀt (Aᵀt)ᵀ with the ramp t from −½ to ½ over n rows.
    ramps: Vec<f64>,
    /// Number of runs that are long enough for the slowest and the next waves.
    runs: f64,
}

impl DriftStatistics {
    fn none(size: usize) -> Self {
        let zeros = || vec![0.0; size];
        Self { slowest: zeros(), next: zeros(), increments: zeros(), ramps: zeros(), runs: 0.0 }
    }

    fn add(&mut self, other: &Self) {
        let own = [&mut self.slowest, &mut self.next, &mut self.increments, &mut self.ramps];
        for (own, other) in own.into_iter().zip([&other.slowest, &other.next, &other.increments, &other.ramps]) {
            own.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        }
        self.runs += other.runs;
    }
}

/// Cross-products of columns in bands of frequencies; their sum over all bands equals the cross-products of the rows.
#[derive(Clone, Debug, PartialEq)]
pub struct CrossSpectra {
    width: usize,
    rows: f64,
    sums: Vec<f64>,
    /// Bands, indexed by number; the lowest holds the means of the runs.
    bands: BTreeMap<i32, SpectralBand>,
    /// Statistics of [`ResidualDrift::Wandering`].
    walk: Option<DriftStatistics>,
}

/// The number of the band that holds a frequency.
fn band_of(f_hz: f64) -> i32 {
    (BANDS * (f_hz / LOWEST_HZ).log2()).floor().max(-1.0) as i32
}

/// Index of the entry (i, j), i <= j, in a triangle of `width` columns.
fn place(width: usize, i: usize, j: usize) -> usize {
    i * width - i * (i + 1) / 2 + j
}

impl CrossSpectra {
    /// Spectra without rows, of `width` columns.
    pub fn new(width: usize, ends: ResidualDrift) -> Self {
        let walk = (ends == ResidualDrift::Wandering).then(|| DriftStatistics::none(width * (width + 1) / 2));
        Self { width, rows: 0.0, sums: vec![0.0; width], bands: BTreeMap::new(), walk }
    }

    /// Adds a run of evenly spaced rows, row-major, whose values are finite.
    pub fn push(&mut self, rows: &[f64], rate_hz: f64) {
        let (width, n) = (self.width, rows.len() / self.width.max(1));
        if n == 0 {
            return;
        }
        let columns: Vec<Vec<f64>> =
            (0..width).map(|column| rows.iter().skip(column).step_by(width).copied().collect()).collect();
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(n);
        let transform = |mut values: Vec<f64>| {
            let mut spectrum = fft.make_output_vec();
            // The buffers have the lengths that the plan requires, so this does not fail.
            fft.process(&mut values, &mut spectrum).ok().map(|()| spectrum)
        };
        let level = self.walk.is_some().then(|| columns.iter().map(|values| transform(without_ramp(values))).collect());
        let level: Option<Option<Vec<_>>> = level;
        let spectra: Option<Vec<_>> = columns.iter().map(|values| transform(values.clone())).collect();
        let (Some(spectra), false) = (spectra, level.as_ref().is_some_and(Option::is_none)) else { return };
        let level = level.flatten();
        self.sums.iter_mut().zip(&spectra).for_each(|(sum, spectrum)| *sum += spectrum[0].re);
        self.rows += n as f64;
        let weight = |k: usize| if k == 0 || 2 * k == n { 1.0 } else { 2.0 };
        let of = |k: usize| if k == 0 { -1 } else { band_of(k as f64 * rate_hz / n as f64) };
        let size = width * (width + 1) / 2;
        let mut first = 0;
        while first <= n / 2 {
            let number = of(first);
            let last = (first..=n / 2).take_while(|k| of(*k) == number).last().unwrap_or(first);
            let band = self.bands.entry(number).or_insert_with(|| SpectralBand::none(size, level.is_some()));
            band.freedom += (first..=last).map(weight).sum::<f64>();
            let per_row = |k: usize| weight(k) / n as f64;
            add_products(&mut band.products, &spectra, first..last + 1, per_row);
            if let Some(level) = &level {
                add_products(&mut band.level, level, first..last + 1, per_row);
            }
            first = last + 1;
        }
        if let (Some(walk), Some(level)) = (&mut self.walk, &level)
            && NEXT.end <= n / 2
        {
            let mean = |waves: &std::ops::Range<usize>| 1.0 / (n * waves.len()) as f64;
            add_products(&mut walk.slowest, &spectra, SLOWEST, |_| mean(&SLOWEST));
            add_products(&mut walk.next, &spectra, NEXT, |_| mean(&NEXT));
            // A walk has the power of its increments divided by 4 sin²(π k/n).
            let increment = |k: usize| (2.0 * (std::f64::consts::PI * k as f64 / n as f64).sin()).powi(2);
            add_products(&mut walk.increments, level, SLOWEST, |k| mean(&SLOWEST) * increment(k));
            let along: Vec<f64> = columns.iter().map(|values| along_ramp(values)).collect();
            for i in 0..width {
                for j in i..width {
                    walk.ramps[place(width, i, j)] += n as f64 * along[i] * along[j];
                }
            }
            walk.runs += 1.0;
        }
    }

    /// Adds the rows of other spectra with the same columns.
    pub fn merge(&mut self, other: &Self) {
        self.rows += other.rows;
        self.sums.iter_mut().zip(&other.sums).for_each(|(a, b)| *a += b);
        for (number, band) in &other.bands {
            match self.bands.get_mut(number) {
                Some(own) => own.add(band),
                None => {
                    self.bands.insert(*number, band.clone());
                }
            }
        }
        match (&mut self.walk, &other.walk) {
            (Some(own), Some(other)) => own.add(other),
            // The sum has drift statistics only if both parts have them.
            (own, _) => *own = None,
        }
    }

    /// Spectra of some columns, each multiplied by the factor of the column; columns that do not exist are ignored.
    pub fn select(&self, columns: &[(usize, f64)]) -> Self {
        let columns: Vec<(usize, f64)> = columns.iter().copied().filter(|(c, _)| *c < self.width).collect();
        let cut = |products: &Vec<f64>| -> Vec<f64> {
            let row = |(i, (a, x)): (usize, &(usize, f64))| {
                let own = columns.iter().skip(i);
                own.map(|(b, y)| x * y * products[place(self.width, *a.min(b), *a.max(b))]).collect::<Vec<f64>>()
            };
            if products.is_empty() { vec![] } else { columns.iter().enumerate().flat_map(row).collect() }
        };
        let of_band = |band: &SpectralBand| SpectralBand {
            freedom: band.freedom,
            products: cut(&band.products),
            level: cut(&band.level),
        };
        let of_walk = |walk: &DriftStatistics| DriftStatistics {
            slowest: cut(&walk.slowest),
            next: cut(&walk.next),
            increments: cut(&walk.increments),
            ramps: cut(&walk.ramps),
            runs: walk.runs,
        };
        Self {
            width: columns.len(),
            rows: self.rows,
            sums: columns.iter().map(|(c, x)| x * self.sums[*c]).collect(),
            bands: self.bands.iter().map(|(number, band)| (*number, of_band(band))).collect(),
            walk: self.walk.as_ref().map(of_walk),
        }
    }

    /// Covariance of the coefficients b of all columns except the last, which is the target. Row-major, in the squared
    /// unit of the target divided by the units of the terms. `gain` is the symmetric matrix G of b = G Aᵀ y, row-major;
    /// `centred` is true if the means of the columns were subtracted. `None` without degrees of freedom beyond the
    /// coefficients.
    pub fn covariance(&self, coefficients: &[f64], gain: &[f64], centred: bool) -> Option<Vec<f64>> {
        let p = self.width.checked_sub(1).filter(|p| coefficients.len() == *p && gain.len() == p * p)?;
        let entry = |products: &[f64], i: usize, j: usize| products[place(self.width, i.min(j), i.max(j))];
        let at = |band: &SpectralBand, i: usize, j: usize| entry(&band.products, i, j);
        let mut joined: Vec<(SpectralBand, f64)> = vec![];
        let mut open: Option<SpectralBand> = None;
        let fitted_of = |band: &SpectralBand| -> f64 {
            (0..p).map(|i| (0..p).map(|j| gain[i * p + j] * at(band, i, j)).sum::<f64>()).sum()
        };
        for band in self.about_means(centred) {
            let band = match open.take() {
                Some(mut before) => {
                    before.add(&band);
                    before
                }
                None => band,
            };
            let fitted = fitted_of(&band);
            if band.freedom - fitted >= LEAST_FREEDOM.max(0.5 * band.freedom) {
                joined.push((band, fitted));
            } else {
                open = Some(band);
            }
        }
        if let Some(rest) = open {
            let fitted = fitted_of(&rest);
            match joined.last_mut() {
                Some((band, of_band)) => {
                    band.add(&rest);
                    *of_band += fitted;
                }
                None => joined.push((rest, fitted)),
            }
        }
        let signed: Vec<f64> = coefficients.iter().map(|b| -b).chain([1.0]).collect();
        let of_residual = |products: &[f64]| -> f64 {
            let row = |i: usize| (0..=p).map(|j| signed[j] * entry(products, i, j)).sum::<f64>();
            (0..=p).map(|i| signed[i] * row(i)).sum::<f64>().max(0.0)
        };
        let walk = self
            .walk
            .as_ref()
            .filter(|walk| walk.runs > 0.0 && of_residual(&walk.slowest) > WANDERS * of_residual(&walk.next));
        let mut middle = vec![0.0; p * p];
        for (band, fitted) in &joined {
            let left = band.freedom - fitted;
            if left <= 0.0 {
                return None;
            }
            let power = of_residual(if walk.is_some() { &band.level } else { &band.products }) / left;
            middle.iter_mut().enumerate().for_each(|(ij, m)| *m += power * at(band, ij / p, ij % p));
        }
        if let Some(walk) = walk {
            let square = of_residual(&walk.increments) / walk.runs;
            middle.iter_mut().enumerate().for_each(|(ij, m)| *m += square * entry(&walk.ramps, ij / p, ij % p));
        }
        Some(product(&product(gain, &middle, p), gain, p))
    }

    /// Bands of the columns, from the slowest. With `centred`, the means of the columns are subtracted.
    fn about_means(&self, centred: bool) -> impl Iterator<Item = SpectralBand> + '_ {
        let off = move |(number, band): (&i32, &SpectralBand)| {
            let mut band = band.clone();
            if centred && *number == -1 && self.rows > 0.0 {
                band.freedom -= 1.0;
                for i in 0..self.width {
                    for j in i..self.width {
                        // A ramp has no mean.
                        let (at, means) = (place(self.width, i, j), self.sums[i] * self.sums[j] / self.rows);
                        band.products[at] -= means;
                        band.level.iter_mut().skip(at).take(1).for_each(|product| *product -= means);
                    }
                }
            }
            band
        };
        self.bands.iter().map(off)
    }
}

/// Adds the products of all pairs of columns, summed over waves with a weight for each wave, to an upper triangle.
fn add_products(
    to: &mut [f64],
    spectra: &[Vec<Complex<f64>>],
    waves: std::ops::Range<usize>,
    weight: impl Fn(usize) -> f64,
) {
    let width = spectra.len();
    for i in 0..width {
        for j in i..width {
            let product = |k: usize| {
                let (a, b) = (spectra[i][k], spectra[j][k]);
                weight(k) * (a.re * b.re + a.im * b.im)
            };
            to[place(width, i, j)] += waves.clone().map(product).sum::<f64>();
        }
    }
}

/// The ramp from −½ to ½ at a row of `n`.
fn ramp(row: usize, n: usize) -> f64 {
    row as f64 / (n.max(2) - 1) as f64 - 0.5
}

/// The sum of values times the ramp.
fn along_ramp(values: &[f64]) -> f64 {
    values.iter().enumerate().map(|(row, x)| x * ramp(row, values.len())).sum()
}

/// Values minus the ramp from the first value to the last.
fn without_ramp(values: &[f64]) -> Vec<f64> {
    let jump = values.last().zip(values.first()).map_or(0.0, |(last, first)| last - first);
    values.iter().enumerate().map(|(row, x)| x - jump * ramp(row, values.len())).collect()
}

/// The product of two square matrices of `p` rows.
fn product(a: &[f64], b: &[f64], p: usize) -> Vec<f64> {
    (0..p * p).map(|ij| (0..p).map(|k| a[ij / p * p + k] * b[k * p + ij % p]).sum()).collect()
}

#[cfg(test)]
mod tests;
