//! Anomaly retention of a compensation.
//!
//! A compensation model also fits signals that resemble the aircraft field. If the anomaly changes while the aircraft
//! turns, part of it resembles the aircraft field and is removed. The loss can be measured where the anomaly a is known
//! (a simulated flight, or an accurate map). For a line, let c be the compensated reading, r the true reading, and r −
//! a the true reading without the anomaly. Then
//!
//! y = c − (r − a) = ρ a + e,
//!
//! where e is the residual aircraft field plus noise. The retention ρ is the least-squares slope of y on a, both minus
//! their means. ρ is 1 if the anomaly is kept, 0 if it is removed completely, and above 1 if it is amplified. For a
//! model that removes only the projection P a of the anomaly on the terms of the aircraft, ρ is exactly 1 − |P
//! a|²/|a|², the retained fraction of the anomaly's energy. The aircraft's terms are therefore not included in the
//! regression: they would hide the loss.
//!
//! The residual e may be correlated with a by chance. Both change slowly, so a thousand samples may correspond to only
//! a dozen independent samples. The standard error includes this effect: if a and e are independent, the variance of Σ
//! a e is the sum, over all lags, of the product of their autocovariances [Bartlett 1935, J. R. Stat. Soc. 98(3)]. This
//! variance is computed as the mean square of Σ a e over all circular shifts of one series against the other, with one
//! Fourier transform of each. Fitting the slope removes one degree of freedom from e. The standard error is corrected
//! for this with the number of independent samples, which is the reciprocal of the mean squared correlation over the
//! shifts. A retention within two standard errors of 1 is no evidence of a loss.

use rustfft::{FftPlanner, num_complex::Complex};

use crate::inner_product::dot;

/// Error of an anomaly retention.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RetentionError {
    /// The columns have different lengths.
    #[error(
        "the retention requires columns of equal length, but they have {compensated}, {reference} and {anomaly} samples"
    )]
    Lengths {
        /// Samples of the compensated reading.
        compensated: usize,
        /// Samples of the true reading.
        reference: usize,
        /// Samples of the anomaly.
        anomaly: usize,
    },
    /// Too few rows are finite.
    #[error("{n} rows have all three values, but the retention requires at least 3")]
    TooFew {
        /// The number of complete rows.
        n: usize,
    },
    /// The anomaly is constant.
    #[error("the anomaly is {value_nt} nT in all rows; the retention is undefined for a constant anomaly")]
    NoAnomaly {
        /// Value of the anomaly, in nT.
        value_nt: f64,
    },
}

/// Fraction of the crustal anomaly that a compensated reading retains, by regression on the anomaly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnomalyRetention {
    /// Slope ρ: 1 if the anomaly is kept, 0 if it is removed.
    pub slope: f64,
    /// Standard error of the slope; infinite for at most two independent samples.
    pub standard_error: f64,
    /// Correlation of y and the anomaly; NaN if y is constant.
    pub correlation: f64,
    /// Root mean square of the residual after removal of anomaly and mean, in nT.
    pub residual_nt: f64,
    /// Root mean square of the anomaly minus its mean, in nT.
    pub anomaly_nt: f64,
    /// Number of rows used.
    pub n: usize,
    /// Number of rows excluded because a value is not finite.
    pub left_out: usize,
}

/// Retention on one line. `compensated` and `reference` are the compensated and the true reading, both with the
/// anomaly; `anomaly` is the anomaly itself. All three are in nT and evenly sampled; their means are subtracted.
///
/// Rows with a value that is not finite are excluded.
///
/// # Errors
/// Fails for columns of different lengths, for fewer than three finite rows, or for a constant anomaly.
pub fn anomaly_retention(
    compensated: &[f64],
    reference: &[f64],
    anomaly: &[f64],
) -> Result<AnomalyRetention, RetentionError> {
    let rows = anomaly.len();
    if compensated.len() != rows || reference.len() != rows {
        let (compensated, reference) = (compensated.len(), reference.len());
        return Err(RetentionError::Lengths { compensated, reference, anomaly: rows });
    }
    let three = compensated.iter().zip(reference).zip(anomaly);
    // The difference is taken first: the common 5e4 nT cancel before they reduce the precision of the anomaly.
    let left: Vec<f64> = three.map(|((c, r), a)| (c - r) + a).collect();
    let known = |i: usize| left[i].is_finite() && anomaly[i].is_finite();
    let n = (0..rows).filter(|i| known(*i)).count();
    if n < 3 {
        return Err(RetentionError::TooFew { n });
    }
    let centred = |x: &[f64]| {
        let mean = (0..rows).filter(|i| known(*i)).map(|i| x[i]).sum::<f64>() / n as f64;
        // An excluded row does not contribute to any sum.
        (0..rows).map(|i| if known(i) { x[i] - mean } else { 0.0 }).collect::<Vec<f64>>()
    };
    let (a, y) = (centred(anomaly), centred(&left));
    let (aa, ay, yy) = (dot(&a, &a), dot(&a, &y), dot(&y, &y));
    if aa <= f64::EPSILON * f64::EPSILON * n as f64 * anomaly.iter().fold(0.0, |m: f64, x| m.max(x.abs())).powi(2) {
        let value_nt = anomaly.iter().copied().find(|x| x.is_finite()).unwrap_or(f64::NAN);
        return Err(RetentionError::NoAnomaly { value_nt });
    }
    let slope = ay / aa;
    let residual: Vec<f64> = y.iter().zip(&a).map(|(y, a)| y - slope * a).collect();
    let ee = dot(&residual, &residual);
    Ok(AnomalyRetention {
        slope,
        standard_error: standard_error(&a, &residual, n),
        correlation: ay / (aa * yy).sqrt(),
        residual_nt: (ee / n as f64).sqrt(),
        anomaly_nt: (aa / n as f64).sqrt(),
        n,
        left_out: rows - n,
    })
}

/// Retention over several lines, each relative to its own mean. The slopes are weighted by the energy of the anomaly,
/// which gives the slope of all rows together. `None` for no lines.
pub fn pooled(lines: &[AnomalyRetention]) -> Option<AnomalyRetention> {
    let energy = |line: &AnomalyRetention| line.n as f64 * line.anomaly_nt * line.anomaly_nt;
    let sum = |of: &dyn Fn(&AnomalyRetention) -> f64| lines.iter().map(of).sum::<f64>();
    let (all, n) = (sum(&energy), lines.iter().map(|line| line.n).sum::<usize>());
    if n == 0 {
        return None;
    }
    let slope = sum(&|line| energy(line) * line.slope) / all;
    // With the common slope, the residual of a line is the residual with the line's own slope plus the effect of the
    // difference between the slopes.
    let residual = sum(&|l| l.n as f64 * l.residual_nt * l.residual_nt + energy(l) * (l.slope - slope).powi(2));
    Some(AnomalyRetention {
        slope,
        standard_error: sum(&|line| (energy(line) * line.standard_error).powi(2)).sqrt() / all,
        correlation: slope * all / (all * (residual + slope * slope * all)).sqrt(),
        residual_nt: (residual / n as f64).sqrt(),
        anomaly_nt: (all / n as f64).sqrt(),
        n,
        left_out: lines.iter().map(|line| line.left_out).sum(),
    })
}

/// Standard error of a slope on `a` with the residual `e`. Both series have zero mean, and only `n` rows are not zero.
fn standard_error(a: &[f64], e: &[f64], n: usize) -> f64 {
    let (rows, aa, ee) = (a.len(), dot(a, a), dot(e, e));
    if ee == 0.0 {
        return 0.0;
    }
    let fft = FftPlanner::new().plan_fft_forward(rows);
    // Two real series of equal length in one transform: the spectrum of the first series is the conjugate-even part,
    // the spectrum of the second is the conjugate-odd part.
    let (to_a, to_e) = (1.0 / aa.sqrt(), 1.0 / ee.sqrt());
    let mut both: Vec<Complex<f64>> = a.iter().zip(e).map(|(a, e)| Complex::new(a * to_a, e * to_e)).collect();
    fft.process(&mut both);
    let power = |k: usize| {
        let (here, there) = (both[k], both[(rows - k) % rows].conj());
        ((here + there) * 0.5).norm_sqr() * ((here - there) * 0.5).norm_sqr()
    };
    // The mean squared correlation over all shifts [Parseval]; in series with gaps, fewer rows overlap.
    let mean_square = (0..rows).map(power).sum::<f64>() / (rows as f64).powi(2) * (rows as f64 / n as f64);
    let independent = 1.0 / mean_square;
    if independent <= 2.0 { f64::INFINITY } else { (ee / aa / (independent - 2.0)).sqrt() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;
    use crate::random::NormalGenerator;
    use crate::signal::gauss_markov::GaussMarkov;

    const ROWS: usize = 3000;

    fn series(seed: u64, sigma: f64, tau_s: f64, rows: usize) -> Vec<f64> {
        let tt: Vec<f64> = (0..rows).map(|k| 0.1 * k as f64).collect();
        let mut normals = NormalGenerator::new(seed);
        GaussMarkov { sigma, tau_s }.realisation(&tt, || normals.draw())
    }

    fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| a + b).collect()
    }

    #[test]
    fn law_an_exact_mixture_gives_its_share() {
        let (anomaly, rest) = (series(1, 80.0, 30.0, ROWS), series(2, 20.0, 300.0, ROWS));
        let reference: Vec<f64> = sum(&anomaly, &rest).iter().map(|x| x + 54_000.0).collect();
        for kept in [1.0, 0.0, 0.6, 1.3, -0.2] {
            let lost: Vec<f64> = anomaly.iter().map(|a| (kept - 1.0) * a + 12.0).collect();
            let found = anomaly_retention(&sum(&reference, &lost), &reference, &anomaly).unwrap();
            // The rounding error of 5.4e4 nT is about 1e-13 of the anomaly of 80 nT.
            assert!((found.slope - kept).abs() < 1e-11, "{found:?}");
            assert!(found.residual_nt < 1e-10 && found.standard_error < 1e-9 && found.n == ROWS, "{found:?}");
            assert!(kept == 0.0 || (found.correlation - kept.signum()).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn law_a_projection_keeps_one_less_the_squared_cosine() {
        let (anomaly, term) = (series(3, 50.0, 20.0, ROWS), series(4, 1.0, 20.0, ROWS));
        let centre = |x: &[f64]| {
            let mean = x.iter().sum::<f64>() / ROWS as f64;
            x.iter().map(|x| x - mean).collect::<Vec<f64>>()
        };
        let (a, x) = (centre(&anomaly), centre(&sum(&term, &anomaly.iter().map(|a| 0.03 * a).collect::<Vec<_>>())));
        let size = dot(&a, &x) / dot(&x, &x);
        let clean: Vec<f64> = a.iter().zip(&x).map(|(a, x)| a - size * x).collect();
        let found = anomaly_retention(&clean, &a, &a).unwrap();
        let cosine_squared = dot(&a, &x).powi(2) / (dot(&a, &a) * dot(&x, &x));
        assert!(cosine_squared > 0.3, "the term looks like the geology: {cosine_squared}");
        assert!((found.slope - (1.0 - cosine_squared)).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn law_the_standard_error_is_the_scatter_of_the_slope() {
        // Anomaly and residual both vary slowly: 3000 samples contain about 30 independent samples, and the standard
        // error for independent samples would be ten times too small.
        let (mut scatter, mut said, mut textbook) = (0.0, 0.0, 0.0);
        const DRAWS: u64 = 300;
        for draw in 0..DRAWS {
            let (anomaly, residue) = (series(1000 + draw, 50.0, 8.0, ROWS), series(5000 + draw, 5.0, 8.0, ROWS));
            let found = anomaly_retention(&sum(&anomaly, &residue), &anomaly, &anomaly).unwrap();
            scatter += (found.slope - 1.0).powi(2) / DRAWS as f64;
            said += found.standard_error.powi(2) / DRAWS as f64;
            textbook += (found.residual_nt / found.anomaly_nt).powi(2) / ROWS as f64 / DRAWS as f64;
        }
        // 300 draws determine a variance to 8 %. Each standard error is also an estimate, from about 30 independent
        // samples.
        assert!((said / scatter - 1.0).abs() < 0.35, "{said} {scatter}");
        assert!(scatter > 20.0 * textbook, "{scatter} {textbook}");
    }

    #[test]
    fn law_white_residue_has_the_textbook_error() {
        let anomaly = series(7, 50.0, 1.0, ROWS);
        let mut normals = NormalGenerator::new(8);
        let noisy: Vec<f64> = anomaly.iter().map(|a| a + 2.0 * normals.draw()).collect();
        let found = anomaly_retention(&noisy, &anomaly, &anomaly).unwrap();
        let textbook = found.residual_nt / found.anomaly_nt / (ROWS as f64).sqrt();
        // The tolerance is three standard deviations of 10 %, because the band of the anomaly (0.16 Hz over 300 s)
        // contains about a hundred independent components of the white noise.
        assert!((found.standard_error / textbook - 1.0).abs() < 0.3, "{} {textbook}", found.standard_error);
        assert!((found.slope - 1.0).abs() < 4.0 * found.standard_error, "{found:?}");
    }

    #[test]
    fn unit_rows_that_are_not_finite_are_excluded() {
        let (anomaly, residue) = (series(9, 50.0, 10.0, ROWS), series(10, 3.0, 2.0, ROWS));
        let compensated = sum(&anomaly, &residue);
        let short = anomaly_retention(&compensated[..2000], &anomaly[..2000], &anomaly[..2000]).unwrap();
        let (mut holed, mut reference, mut known) = (compensated.clone(), anomaly.clone(), anomaly.clone());
        for i in 2000..ROWS {
            [&mut holed, &mut reference, &mut known][i % 3][i] = f64::NAN;
        }
        let found = anomaly_retention(&holed, &reference, &known).unwrap();
        assert_eq!((found.n, found.left_out), (2000, 1000));
        assert!((found.slope - short.slope).abs() < 1e-12 && (found.residual_nt - short.residual_nt).abs() < 1e-12);
        // Every shift is weighted with the mean number of rows that overlap, which is approximate for a series with a
        // gap.
        assert!((found.standard_error / short.standard_error - 1.0).abs() < 0.2, "{found:?} {short:?}");
    }

    #[test]
    fn law_pooled_lines_equal_all_rows_together() {
        let lines: Vec<(Vec<f64>, Vec<f64>)> = (0..3)
            .map(|k| {
                let anomaly = series(20 + k, 10.0 * (k + 1) as f64, 10.0, 1000);
                let kept: Vec<f64> = anomaly.iter().map(|a| (0.9 - 0.2 * k as f64) * a).collect();
                (sum(&kept, &series(30 + k, 2.0, 1.0, 1000)), anomaly)
            })
            .collect();
        let each: Vec<_> = lines.iter().map(|(c, a)| anomaly_retention(c, a, a).unwrap()).collect();
        let found = pooled(&each).unwrap();
        let centred = |x: &[f64]| {
            let mean = x.iter().sum::<f64>() / 1000.0;
            x.iter().map(|x| x - mean).collect::<Vec<f64>>()
        };
        let (c, a): (Vec<_>, Vec<_>) = lines.iter().map(|(c, a)| (centred(c), centred(a))).unzip();
        let whole = anomaly_retention(&c.concat(), &a.concat(), &a.concat()).unwrap();
        assert!((found.slope - whole.slope).abs() < 1e-12, "{found:?} {whole:?}");
        assert!((found.residual_nt - whole.residual_nt).abs() < 1e-10 && found.n == 3000);
        assert!((found.correlation - whole.correlation).abs() < 1e-12);
        assert_eq!(pooled(&[]), None);
    }

    #[test]
    fn unit_invalid_columns_are_rejected() {
        let said = |c: &[f64], r: &[f64], a: &[f64]| anomaly_retention(c, r, a).unwrap_err().to_string();
        assert!(said(&[1.0], &[1.0, 2.0], &[1.0]).contains("they have 1, 2 and 1 samples"));
        assert!(said(&[1.0, f64::NAN, 3.0], &[0.0; 3], &[1.0, 2.0, 3.0]).contains("2 rows have all three values"));
        assert!(said(&[1.0, 2.0, 3.0], &[0.0; 3], &[7.0; 3]).contains("the anomaly is 7 nT in all rows"));
    }
}
