//! Sampling errors of coefficients whose residual is correlated, from cross-spectra of terms and target in bands.
//!
//! A filter leaves residuals that are correlated over its impulse response, and so does coloured noise. The usual
//! covariance s² (AᵀA)⁻¹ takes them for independent: behind a pass band of 0.1 to 0.9 Hz at 10 Hz its standard deviations
//! are 2.5 times too small. The covariance of b = G Aᵀ y, with G = (AᵀA + λ)⁻¹, is
//!
//! ```text
//! G (Aᵀ Σ A) G,   Aᵀ Σ A ≈ Σ over bands  s_band C_band
//! ```
//!
//! where C_band is the part of AᵀA that lies in a band of frequencies and s_band the power of the residual there, per degree
//! of freedom. The bands are an eighth of an octave wide; neighbours are joined until the fit has left them enough degrees of
//! freedom to estimate a power. Terms and residual may have any spectrum that is smooth within a band.
//!
//! Source: Hannan 1963, Regression for time series; Robinson 1998, Inference without smoothing in the presence of
//! nonparametric autocorrelation, Econometrica 66(5).

use std::collections::BTreeMap;

use realfft::{RealFftPlanner, num_complex::Complex};

/// Bands of an octave.
const BANDS: f64 = 8.0;
/// The lower edge of the lowest band, Hz; what is slower is one band.
const LOWEST_HZ: f64 = 1e-3;
/// Degrees of freedom that a band has at least after the fit.
const LEAST_FREEDOM: f64 = 16.0;

/// Cross-products of columns within one band of frequencies.
#[derive(Clone, Debug, PartialEq)]
struct Band {
    /// Real degrees of freedom: two for each frequency but the first and the last.
    freedom: f64,
    /// The upper triangle of the cross-products, row by row.
    products: Vec<f64>,
}

/// Cross-products of columns in bands of frequencies; over all bands they are those of the rows.
#[derive(Clone, Debug, PartialEq)]
pub struct CrossSpectra {
    width: usize,
    rows: f64,
    sums: Vec<f64>,
    /// By their number; the lowest holds the means of the runs.
    bands: BTreeMap<i32, Band>,
}

/// The number of the band that holds a frequency.
fn band_of(f_hz: f64) -> i32 {
    (BANDS * (f_hz / LOWEST_HZ).log2()).floor().max(-1.0) as i32
}

/// Where the entry (i, j), i <= j, of a triangle of `width` columns is.
fn place(width: usize, i: usize, j: usize) -> usize {
    i * width - i * (i + 1) / 2 + j
}

impl CrossSpectra {
    /// Spectra without rows, of `width` columns.
    pub fn new(width: usize) -> Self {
        Self { width, rows: 0.0, sums: vec![0.0; width], bands: BTreeMap::new() }
    }

    /// Adds a run of evenly spaced rows, row-major, whose values are finite.
    pub fn push(&mut self, rows: &[f64], rate_hz: f64) {
        let (width, n) = (self.width, rows.len() / self.width.max(1));
        if n == 0 {
            return;
        }
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(n);
        let mut spectra: Vec<Vec<Complex<f64>>> = Vec::with_capacity(width);
        for column in 0..width {
            let mut values: Vec<f64> = rows.iter().skip(column).step_by(width).copied().collect();
            let mut spectrum = fft.make_output_vec();
            // The lengths are those of the plan.
            if fft.process(&mut values, &mut spectrum).is_err() {
                return;
            }
            self.sums[column] += spectrum[0].re;
            spectra.push(spectrum);
        }
        self.rows += n as f64;
        let of = |k: usize| if k == 0 { -1 } else { band_of(k as f64 * rate_hz / n as f64) };
        let mut first = 0;
        while first <= n / 2 {
            let number = of(first);
            let last = (first..=n / 2).take_while(|k| of(*k) == number).last().unwrap_or(first);
            let weight = |k: usize| if k == 0 || 2 * k == n { 1.0 } else { 2.0 };
            let none = || Band { freedom: 0.0, products: vec![0.0; width * (width + 1) / 2] };
            let band = self.bands.entry(number).or_insert_with(none);
            band.freedom += (first..=last).map(weight).sum::<f64>();
            for i in 0..width {
                for j in i..width {
                    let product = |k: usize| {
                        let (a, b) = (spectra[i][k], spectra[j][k]);
                        weight(k) * (a.re * b.re + a.im * b.im)
                    };
                    band.products[place(width, i, j)] += (first..=last).map(product).sum::<f64>() / n as f64;
                }
            }
            first = last + 1;
        }
    }

    /// Adds the rows of others with the same columns.
    pub fn merge(&mut self, other: &Self) {
        self.rows += other.rows;
        self.sums.iter_mut().zip(&other.sums).for_each(|(a, b)| *a += b);
        for (number, band) in &other.bands {
            match self.bands.get_mut(number) {
                Some(own) => {
                    own.freedom += band.freedom;
                    own.products.iter_mut().zip(&band.products).for_each(|(a, b)| *a += b);
                }
                None => {
                    self.bands.insert(*number, band.clone());
                }
            }
        }
    }

    /// The same of some columns, each multiplied by its factor; a column that is not there is left out.
    pub fn select(&self, columns: &[(usize, f64)]) -> Self {
        let columns: Vec<(usize, f64)> = columns.iter().copied().filter(|(c, _)| *c < self.width).collect();
        let cut = |band: &Band| {
            let row = |(i, (a, x)): (usize, &(usize, f64))| {
                let own = columns.iter().skip(i);
                own.map(|(b, y)| x * y * band.products[place(self.width, *a.min(b), *a.max(b))]).collect::<Vec<f64>>()
            };
            Band { freedom: band.freedom, products: columns.iter().enumerate().flat_map(row).collect() }
        };
        Self {
            width: columns.len(),
            rows: self.rows,
            sums: columns.iter().map(|(c, x)| x * self.sums[*c]).collect(),
            bands: self.bands.iter().map(|(number, band)| (*number, cut(band))).collect(),
        }
    }

    /// The covariance of the coefficients b of all columns but the last, which is the target, row-major, in its unit squared
    /// over those of the terms. `gain` is the symmetric matrix G of b = G Aᵀ y, row-major; `centred` says that columns were
    /// taken about their means. `None` where the rows have no degree of freedom beyond the coefficients.
    pub fn covariance(&self, coefficients: &[f64], gain: &[f64], centred: bool) -> Option<Vec<f64>> {
        let p = self.width.checked_sub(1).filter(|p| coefficients.len() == *p && gain.len() == p * p)?;
        let at = |band: &Band, i: usize, j: usize| band.products[place(self.width, i.min(j), i.max(j))];
        let mut joined: Vec<(Band, f64)> = vec![];
        let mut open: Option<Band> = None;
        let fitted_of = |band: &Band| -> f64 {
            (0..p).map(|i| (0..p).map(|j| gain[i * p + j] * at(band, i, j)).sum::<f64>()).sum()
        };
        for band in self.about_means(centred) {
            let band = match open.take() {
                Some(mut before) => {
                    before.freedom += band.freedom;
                    before.products.iter_mut().zip(&band.products).for_each(|(a, b)| *a += b);
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
                    band.freedom += rest.freedom;
                    band.products.iter_mut().zip(&rest.products).for_each(|(a, b)| *a += b);
                    *of_band += fitted;
                }
                None => joined.push((rest, fitted)),
            }
        }
        let signed: Vec<f64> = coefficients.iter().map(|b| -b).chain([1.0]).collect();
        let mut middle = vec![0.0; p * p];
        for (band, fitted) in &joined {
            let left = band.freedom - fitted;
            if left <= 0.0 {
                return None;
            }
            let row = |i: usize| (0..=p).map(|j| signed[j] * at(band, i, j)).sum::<f64>();
            let power = (0..=p).map(|i| signed[i] * row(i)).sum::<f64>().max(0.0) / left;
            middle.iter_mut().enumerate().for_each(|(ij, m)| *m += power * at(band, ij / p, ij % p));
        }
        Some(product(&product(gain, &middle, p), gain, p))
    }

    /// The bands, from the slowest, of the columns as they are or about their means.
    fn about_means(&self, centred: bool) -> impl Iterator<Item = Band> + '_ {
        let off = move |(number, band): (&i32, &Band)| {
            let mut band = band.clone();
            if centred && *number == -1 && self.rows > 0.0 {
                band.freedom -= 1.0;
                for i in 0..self.width {
                    for j in i..self.width {
                        band.products[place(self.width, i, j)] -= self.sums[i] * self.sums[j] / self.rows;
                    }
                }
            }
            band
        };
        self.bands.iter().map(off)
    }
}

/// The product of two square matrices of `p` rows.
fn product(a: &[f64], b: &[f64], p: usize) -> Vec<f64> {
    (0..p * p).map(|ij| (0..p).map(|k| a[ij / p * p + k] * b[k * p + ij % p]).sum()).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::random::Normals;

    fn rows(n: usize, phase: f64) -> Vec<f64> {
        (0..n).flat_map(|k| [(0.3 * k as f64 + phase).sin() + 2.0, (0.07 * k as f64).cos(), k as f64]).collect()
    }

    #[test]
    fn law_the_bands_add_up_to_the_products_of_the_rows() {
        for n in [1, 2, 101, 300] {
            let (mut found, x) = (CrossSpectra::new(3), rows(n, 0.4));
            found.push(&x, 10.0);
            let freedom: f64 = found.bands.values().map(|b| b.freedom).sum();
            assert_eq!(freedom, n as f64);
            for (i, j) in [(0, 0), (0, 2), (1, 2)] {
                let all: f64 = found.bands.values().map(|b| b.products[place(3, i, j)]).sum();
                let expected: f64 = x.chunks(3).map(|row| row[i] * row[j]).sum();
                assert!((all - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{n}: {all} {expected}");
            }
        }
    }

    #[test]
    fn law_two_runs_merged_and_cut_are_those_of_the_cut_rows() {
        let (mut one, mut other, mut cut) = (CrossSpectra::new(3), CrossSpectra::new(3), CrossSpectra::new(2));
        for (spectra, n, phase) in [(&mut one, 200, 0.0), (&mut other, 150, 1.0)] {
            spectra.push(&rows(n, phase), 10.0);
            let part: Vec<f64> = rows(n, phase).chunks(3).flat_map(|row| [row[2], 3.0 * row[0]]).collect();
            cut.push(&part, 10.0);
        }
        one.merge(&other);
        let found = one.select(&[(2, 1.0), (0, 3.0), (9, 1.0)]);
        for (a, b) in found.bands.values().zip(cut.bands.values()) {
            assert!(a.products.iter().zip(&b.products).all(|(x, y)| (x - y).abs() < 1e-9 * (1.0 + y.abs())));
        }
        assert_eq!(found.bands.len(), cut.bands.len());
    }

    /// One sinusoidal term with the noise `of` each run: the scatter of the coefficient over what is claimed, root mean
    /// square.
    fn scatter(of: impl Fn(&mut Normals) -> Vec<f64>, f: f64) -> f64 {
        let (runs, n) = (300, 1000);
        let term: Vec<f64> = (0..n).map(|k| (f * k as f64).sin()).collect();
        let gain = 1.0 / term.iter().map(|x| x * x).sum::<f64>();
        let one = |run: u64| {
            let y = of(&mut Normals::new(run));
            let b = gain * term.iter().zip(&y).map(|(a, y)| a * y).sum::<f64>();
            let mut spectra = CrossSpectra::new(2);
            spectra.push(&term.iter().zip(&y).flat_map(|(a, y)| [*a, *y]).collect::<Vec<f64>>(), 10.0);
            (b, spectra.covariance(&[b], &[gain], false).unwrap()[0])
        };
        let found: Vec<(f64, f64)> = (0..runs).map(one).collect();
        (found.iter().map(|(b, _)| b * b).sum::<f64>() / found.iter().map(|(_, v)| v).sum::<f64>()).sqrt()
    }

    #[test]
    fn law_the_scatter_is_the_one_claimed_with_white_and_with_coloured_noise() {
        let white = |normals: &mut Normals| (0..1000).map(|_| normals.draw()).collect();
        let coloured = |normals: &mut Normals| {
            let mut x = 0.0;
            (0..1000)
                .map(|_| {
                    x = 0.9 * x + normals.draw();
                    x
                })
                .collect()
        };
        for f in [0.02, 0.2] {
            for found in [scatter(white, f), scatter(coloured, f)] {
                // 300 draws of a standard deviation: 4 %.
                assert!((0.88..1.12).contains(&found), "{f}: {found}");
            }
        }
    }

    #[test]
    fn law_white_noise_has_the_covariance_of_independent_rows() {
        let mut normals = Normals::new(7);
        let x: Vec<f64> = (0..4000).flat_map(|_| [normals.draw(), normals.draw() + 5.0]).collect();
        let mut spectra = CrossSpectra::new(2);
        spectra.push(&x, 10.0);
        let gain = 1.0 / 4000.0;
        let found = spectra.covariance(&[0.0], &[gain], true).unwrap()[0];
        assert!((found / gain - 1.0).abs() < 0.15, "{found}");
        assert!(
            spectra.covariance(&[0.0], &[gain], false).unwrap()[0] > found,
            "the mean of 5 counts without a constant"
        );
        assert_eq!(spectra.covariance(&[], &[gain], true), None);
    }
}
