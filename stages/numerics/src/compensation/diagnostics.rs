//! Diagnostics of a calibration: terms that the flight did not excite, closeness of the fit to the trivial solution,
//! and differences between calibrations.

use crate::regression::least_squares::{
    LeastSquaresError, LinearFit, RegressionMoments, ScaledFactor, expect, setting,
};

/// A term is listed in a weak direction if its component is at least this large.
const NAMED_FROM: f64 = 0.1;

/// A combination of terms that the rows barely excite.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// Ratio of the combination's singular value to the largest singular value, with all columns scaled to the same
    /// length.
    pub strength: f64,
    /// Terms of the combination with their components (of a unit vector), largest first.
    pub terms: Vec<(String, f64)>,
}

/// Excitation of the terms by a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Excitation {
    /// Ratio of the largest singular value to the smallest; infinite if all values of a term are zero.
    pub condition: f64,
    /// Variance inflation factor of each term: ratio of the variance of the coefficient to the variance that it would
    /// have if the terms were not correlated. Infinite if the term is a combination of other terms. 10 is a common
    /// limit.
    pub variance_inflation: Vec<f64>,
    /// Directions weaker than the limit, weakest first.
    pub weak: Vec<WeakDirection>,
}

/// Finds the combinations of terms with a singular value below `weak_below` times the largest.
///
/// Requires a factor with standardised columns ([`crate::regression::least_squares::ColumnScaling::Standardise`]), so
/// that the result depends on the flight and not on units.
///
/// # Errors
/// Fails with [`LeastSquaresError::Shape`] if the number of names differs from the number of terms, with
/// [`LeastSquaresError::Setting`] for a limit outside 0 to 1, or with [`LeastSquaresError::NoConvergence`] if the
/// decomposition does not converge.
pub fn excitation<S: AsRef<str>>(
    prepared: &ScaledFactor,
    names: &[S],
    weak_below: f64,
) -> Result<Excitation, LeastSquaresError> {
    expect("the list of term names", names.len(), prepared.terms())?;
    setting("the limit below which a direction is weak", weak_below, "from 0 to 1", (0.0..=1.0).contains(&weak_below))?;
    let singular = prepared.singular()?;
    let largest = singular.values.first().copied().unwrap_or(f64::NAN);
    let smallest = singular.values.last().copied().unwrap_or(f64::NAN);
    let named = |(strength, right): (f64, &Vec<f64>)| {
        let mut terms: Vec<(String, f64)> = names.iter().map(|n| n.as_ref().to_owned()).zip(right.clone()).collect();
        terms.retain(|(_, part)| part.abs() >= NAMED_FROM);
        terms.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        WeakDirection { strength, terms }
    };
    let strengths = singular.values.iter().map(|s| s / largest);
    let weak = strengths.zip(&singular.right).rev().take_while(|(s, _)| *s < weak_below).map(named).collect();
    Ok(Excitation { condition: largest / smallest, variance_inflation: variance_inflation(prepared, &singular), weak })
}

/// Variance inflation factors (Rᵀ R)⁻¹ⱼⱼ (Rᵀ R)ⱼⱼ, from the decomposition.
fn variance_inflation(
    prepared: &ScaledFactor,
    singular: &crate::regression::least_squares::ScaledFactorSvd,
) -> Vec<f64> {
    let p = prepared.terms();
    let rounding = singular.values.first().copied().unwrap_or(0.0) * p as f64 * f64::EPSILON;
    let of = |j: usize| {
        let square: f64 = prepared.factor().chunks_exact(p).map(|row| row[j] * row[j]).sum();
        let inverse: f64 = singular
            .values
            .iter()
            .zip(&singular.right)
            .filter(|(s, v)| **s > rounding || v[j].abs() > 1e-8)
            .map(|(s, v)| if *s > rounding { (v[j] / s).powi(2) } else { f64::INFINITY })
            .sum();
        square * inverse
    };
    (0..p).map(of).collect()
}

impl Excitation {
    /// Warning about weakly excited directions, with the two weakest. `None` if there are no weak directions.
    pub fn message(&self) -> Option<String> {
        const SHOWN: usize = 2;
        let of = |direction: &WeakDirection| {
            let terms: Vec<String> =
                direction.terms.iter().map(|(name, part)| format!("{part:+.2} `{name}`")).collect();
            format!("{} (excitation {:.1e} of the strongest)", terms.join(" "), direction.strength)
        };
        let mut weak: Vec<String> = self.weak.iter().take(SHOWN).map(of).collect();
        match self.weak.len().saturating_sub(SHOWN) {
            0 => {}
            1 => weak.push("1 more combination".to_owned()),
            more => weak.push(format!("{more} more combinations")),
        }
        (!weak.is_empty()).then(|| {
            format!("the flight hardly excites {}: fly more manoeuvres, omit terms, or use a ridge", weak.join("; "))
        })
    }
}

/// Distance of a Tolles-Lawson fit from the trivial solution, which attributes the whole field to the aircraft.
///
/// The trivial solution [van der Meer 2025, 4.2.1] has no permanent field, the unit matrix as induced field and no eddy
/// currents. Σ B̂ᵢ Bᵢ = |B| then explains the total field exactly, with a residual of zero. Band-passed rows cannot
/// separate the trivial solution from the true one where the magnitude of the earth's field is constant. Unfiltered
/// terms can separate them. Of a field of 50,000 nT, the true solution explains some hundreds of nT, and the trivial
/// solution explains the whole field.
#[derive(Debug, Clone, PartialEq)]
pub struct TrivialSolution {
    /// Fraction of the total field that the fit explains, in the metric of the unfiltered terms: 0.002 for 100 nT in
    /// 50,000 nT, 1 for the trivial solution.
    pub share: f64,
    /// Distance ‖A (β − trivial)‖/‖A trivial‖ over the unfiltered terms: near 1 for a true fit, 0 for the trivial
    /// solution.
    pub distance: f64,
    /// The same distance, computed over the fitted rows. If it is small, only the ridge separates the two solutions.
    pub distance_fitted: f64,
    /// Loss of the fit, ‖y − A β‖² + λ ‖β‖².
    pub loss: f64,
    /// Loss of the trivial solution: λ · 3 s² (van der Meer 2025's 3 λ for s = 1) plus its squared residuals.
    pub trivial_loss: f64,
}

impl TrivialSolution {
    /// Whether the fit explains more than half of the field.
    pub fn is_trivial(&self) -> bool {
        self.share > 0.5
    }

    /// Whether the loss of the fit is less than the loss of the trivial solution, that is, whether the ridge excludes
    /// the trivial solution.
    pub fn is_excluded(&self) -> bool {
        self.loss < self.trivial_loss
    }
}

/// Compares `fit` with the trivial solution.
///
/// `unfiltered` holds the unfiltered terms and `fitted` the rows of the fit; both have the terms `names` in the same
/// order. The terms `xx`, `yy` and `zz` are required; all others are arbitrary. `scale_nt` is the scale s of the
/// induced terms; `lambda` is the ridge parameter of unscaled columns. `None` if a diagonal term is missing, because
/// the trivial solution cannot be expressed without it.
///
/// # Errors
/// Fails with [`LeastSquaresError::Shape`] if the number of names, unfiltered terms or coefficients differs from the
/// number of fitted terms. If the diagonal terms exist, also fails with [`LeastSquaresError::NoRows`] if `unfiltered`
/// or `fitted` has no rows. Also fails with [`LeastSquaresError::NoSuch`] for an unknown target.
pub fn trivial_solution<S: AsRef<str>>(
    unfiltered: &RegressionMoments,
    fitted: &RegressionMoments,
    target: usize,
    names: &[S],
    fit: &LinearFit,
    lambda: f64,
    scale_nt: f64,
) -> Result<Option<TrivialSolution>, LeastSquaresError> {
    use crate::regression::least_squares::ColumnScaling;
    for (what, given) in [
        ("the list of term names", names.len()),
        ("the list of unfiltered terms", unfiltered.terms()),
        ("the list of coefficients", fit.coefficients.len()),
    ] {
        expect(what, given, fitted.terms())?;
    }
    let mut trivial = LinearFit { coefficients: vec![0.0; names.len()], intercept: 0.0 };
    for diagonal in ["xx", "yy", "zz"] {
        let Some(place) = names.iter().position(|name| name.as_ref() == diagonal) else { return Ok(None) };
        trivial.coefficients[place] = scale_nt;
    }
    let difference: Vec<f64> = fit.coefficients.iter().zip(&trivial.coefficients).map(|(b, t)| b - t).collect();
    let over = |moments: &RegressionMoments| {
        let prepared = moments.prepare(ColumnScaling::None, false)?;
        let zero = vec![0.0; names.len()];
        let image = |b: &[f64]| prepared.left_of(&zero, b);
        Ok::<_, LeastSquaresError>([image(&fit.coefficients), image(&trivial.coefficients), image(&difference)])
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let [ours, its, apart] = over(unfiltered)?;
    let [_, its_fitted, apart_fitted] = over(fitted)?;
    let loss = |fit: &LinearFit| {
        let size = dot(&fit.coefficients, &fit.coefficients);
        fitted.residuals(target, fit).map(|left| left.squares + lambda * size)
    };
    Ok(Some(TrivialSolution {
        share: dot(&ours, &its) / dot(&its, &its),
        distance: (dot(&apart, &apart) / dot(&its, &its)).sqrt(),
        distance_fitted: (dot(&apart_fitted, &apart_fitted) / dot(&its_fitted, &its_fitted)).sqrt(),
        loss: loss(fit)?,
        trivial_loss: loss(&trivial)?,
    }))
}

/// Upper bound in nT, for any attitude, of the error of the linear Tolles-Lawson model.
///
/// The aircraft's field F changes the magnitude B of the earth's field by F·B̂ + F⊥²/2B + …; the model contains only
/// the first term. F is `permanent_nt` p (nose, right, down) plus M B. The symmetric matrix M is `induced` (xx, xy, xz,
/// yy, yz, zz, per unit field). A term xy of the model is the sum of xy and yx. The magnitude of F is at most |p| + ‖M‖
/// B, where ‖M‖ is the largest absolute eigenvalue of M. The bound is therefore (|p| + ‖M‖ B)²/2B. The bound
/// corresponds to the relative error b²/2 of van der Meer 2025 (section 4.1: 0.4 nT for 200 nT in 50,000 nT). The bound
/// excludes eddy currents and the antisymmetric part of M, which a scalar magnetometer cannot observe.
pub fn approximation_bound_nt(permanent_nt: [f64; 3], induced: [f64; 6], field_nt: f64) -> f64 {
    let [xx, xy, xz, yy, yz, zz] = induced;
    let (xy, xz, yz) = (0.5 * xy, 0.5 * xz, 0.5 * yz);
    let m = nalgebra::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    if !m.iter().chain(&permanent_nt).all(|v| v.is_finite()) {
        return f64::NAN;
    }
    let induced = m.symmetric_eigenvalues().iter().fold(0.0, |most: f64, e| most.max(e.abs()));
    let aircraft_nt = nalgebra::Vector3::from(permanent_nt).norm() + induced * field_nt;
    aircraft_nt * aircraft_nt / (2.0 * field_nt)
}

/// Scatter of one coefficient over several calibrations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoefficientVariation {
    /// The mean of the coefficient.
    pub mean: f64,
    /// Standard deviation with divisor n − 1; NaN for a single calibration.
    pub std: f64,
    /// Coefficient of variation, std/|mean|. [Gnadt 2022 eq. 3.28, Tables 3.1 and 3.2, Figure 3-8]
    pub coefficient_of_variation: f64,
}

/// Scatter of each coefficient over several calibrations, each given as a slice of coefficients. Figure 3-8 of Gnadt
/// 2022 shows the mean of the coefficients of variation as a function of λ.
///
/// # Errors
/// Fails with [`LeastSquaresError::NoRows`] without calibrations, or with [`LeastSquaresError::Shape`] if they have
/// different numbers of coefficients.
pub fn variation(calibrations: &[&[f64]]) -> Result<Vec<CoefficientVariation>, LeastSquaresError> {
    let terms = calibrations.first().ok_or(LeastSquaresError::NoRows)?.len();
    for coefficients in calibrations {
        expect("the coefficients of a calibration", coefficients.len(), terms)?;
    }
    let of = |j: usize| {
        let values: Vec<f64> = calibrations.iter().map(|c| c[j]).collect();
        let summary = crate::regression::statistics::summary(&values);
        CoefficientVariation {
            mean: summary.mean,
            std: summary.std,
            coefficient_of_variation: summary.std / summary.mean.abs(),
        }
    };
    Ok((0..terms).map(of).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix};
    use crate::random::NormalGenerator;
    use crate::regression::least_squares::ColumnScaling;
    use crate::signal::filter::{ConstantColumns, FilterBand, ZeroPhaseFilter};

    #[test]
    fn ref_variation_equals_table_3_1() {
        // Gnadt 2022, Table 3.1: coefficients cosX, cosXX and cosYZ from three boxes, without a ridge.
        let boxes = [[1974.0, -1013.0, -18.0], [1798.0, -787.0, 180.0], [1243.0, -1132.0, 190.0]];
        let variation = variation(&[&boxes[0], &boxes[1], &boxes[2]]).unwrap();
        // Computed by hand: mean 1671.667, deviations 302.333, 126.333, -428.667.
        assert!((variation[0].mean - 5015.0 / 3.0).abs() < 1e-9);
        let std = ((302.333_333_f64.powi(2) + 126.333_333_f64.powi(2) + 428.666_667_f64.powi(2)) / 2.0).sqrt();
        assert!((variation[0].std - std).abs() < 1e-5);
        assert!((variation[1].coefficient_of_variation - variation[1].std / (2932.0 / 3.0)).abs() < 1e-12);
        // Eq. 3.28: the term that changes sign varies most.
        assert!(variation[2].coefficient_of_variation > 0.9 && variation[0].coefficient_of_variation < 0.25);
        assert!(super::variation(&[]).is_err());
        assert!(super::variation(&[&[1.0], &[1.0, 2.0]]).is_err());
    }

    #[test]
    fn law_the_linear_form_errs_by_at_most_its_bound() {
        // Van der Meer 2025, section 4.1: 200 nT in 50,000 nT give 0.4 nT.
        assert!((approximation_bound_nt([200.0, 0.0, 0.0], [0.0; 6], 50_000.0) - 0.4).abs() < 1e-12);
        let permanent = nalgebra::Vector3::new(900.0, -700.0, 400.0);
        let induced = nalgebra::Matrix3::new(0.012, 0.004, -0.002, 0.004, -0.01, 0.003, -0.002, 0.003, 0.006);
        let coefficients = [0.012, 0.008, -0.004, -0.01, 0.006, 0.006];
        let field_nt = 51_000.0;
        let bound = approximation_bound_nt(permanent.into(), coefficients, field_nt);
        let mut normals = NormalGenerator::new(3);
        let mut most: f64 = 0.0;
        for _ in 0..20_000 {
            let u = nalgebra::Vector3::new(normals.draw(), normals.draw(), normals.draw()).normalize();
            let aircraft = permanent + induced * u * field_nt;
            let missed = (field_nt * u + aircraft).norm() - field_nt - aircraft.dot(&u);
            // Rounding of a field of 5e4 nT is some 1e-11 nT.
            assert!(missed > -1e-9);
            most = most.max(missed);
        }
        // The third-order term, F³/2B², is 2 % here. The worst attitude only nearly reaches the bound, because in the
        // direction in which F is largest, F need not be perpendicular to B.
        assert!(most <= bound && most > 0.4 * bound, "{most} {bound}");
        assert!(approximation_bound_nt([f64::NAN; 3], [0.0; 6], 5e4).is_nan());
    }

    #[test]
    fn law_weakly_excited_terms_are_listed_and_inflated() {
        let mut normals = NormalGenerator::new(2);
        let a: Vec<f64> = (0..500)
            .flat_map(|_| {
                let [x, y, z] = [normals.draw(), normals.draw(), normals.draw()];
                [x, y, 3.0 * x + 3e-3 * z]
            })
            .collect();
        let moments = RegressionMoments::from_matrix(&a, 3, &[]).unwrap();
        let prepared = moments.prepare(ColumnScaling::Standardise, true).unwrap();
        let found = excitation(&prepared, &["roll", "pitch", "yaw"], 1e-2).unwrap();
        assert_eq!(found.weak.len(), 1);
        let named: Vec<&str> = found.weak[0].terms.iter().map(|(name, _)| name.as_str()).collect();
        assert!(named.len() == 2 && named.contains(&"roll") && named.contains(&"yaw"), "{named:?}");
        // 1/(1 − R²) with the correlation R: 1 − R² is 1e-6 times the noise share, with a relative error of √(2/500).
        assert!((found.variance_inflation[0] / 1e6 - 1.0).abs() < 0.3, "{:?}", found.variance_inflation);
        assert!((found.variance_inflation[1] - 1.0).abs() < 0.05);
        let message = found.message().unwrap();
        assert!(message.contains("`yaw`") && !message.contains("`pitch`"), "{message}");
        assert!(excitation(&prepared, &["roll", "pitch", "yaw"], 1e-6).unwrap().message().is_none());
        let flat: Vec<f64> = a.chunks(3).flat_map(|r| [r[0], 0.0, r[0]]).collect();
        let flat =
            RegressionMoments::from_matrix(&flat, 3, &[]).unwrap().prepare(ColumnScaling::Standardise, true).unwrap();
        let found = excitation(&flat, &["a", "b", "c"], 1e-9).unwrap();
        assert_eq!((found.weak.len(), found.variance_inflation[0]), (2, f64::INFINITY));
        let many = Excitation { weak: [found.weak.clone(), found.weak].concat(), ..found };
        let message = many.message().unwrap();
        assert!(message.contains("2 more combinations") && message.matches("excitation").count() == 2, "{message}");
    }

    /// A calibration box in an earth's field of constant magnitude, with an aircraft field of some 300 nT.
    fn flight() -> (Vec<f64>, Vec<f64>, Vec<f64>, Vec<f64>) {
        let rate = 10.0;
        let (mut vector, mut scalar) = ([Vec::new(), Vec::new(), Vec::new()], Vec::new());
        for k in 0..4000 {
            let t = f64::from(k) / rate;
            let (roll, pitch, yaw) =
                (0.17 * (1.1 * t).sin(), 0.09 * (1.7 * t).sin(), 0.0157 * t + 0.09 * (2.3 * t).sin());
            let down = crate::earth::attitude::body_to_ned(roll, pitch, yaw).transpose();
            let earth = down * nalgebra::Vector3::new(18_000.0, -2000.0, 48_000.0);
            let aircraft = nalgebra::Vector3::new(150.0, -90.0, 200.0) + 2e-3 * earth;
            let total = earth + aircraft;
            vector.iter_mut().zip(total.iter()).for_each(|(column, b)| column.push(*b));
            scalar.push(total.norm());
        }
        let [x, y, z] = vector;
        let a =
            matrix(&BodyFieldColumns { x: &x, y: &y, z: &z, bt: None }, &TermSelection::default(), DEFAULT_SCALE_NT)
                .unwrap();
        let filter = ZeroPhaseFilter::new(FilterBand::Band { low_hz: 0.1, high_hz: 0.9 }, rate, 4).unwrap();
        let mut filtered = a.clone();
        filter.apply_matrix(&mut filtered, 18, ConstantColumns::Keep).unwrap();
        let y = filter.apply(&scalar).unwrap();
        (a, filtered, y, scalar)
    }

    #[test]
    fn law_the_trivial_solution_is_separated_from_the_true_one() {
        let (a, filtered, y, _) = flight();
        let names = TermSelection::default().names();
        let unfiltered = RegressionMoments::from_matrix(&a, 18, &[]).unwrap();
        let fitted = RegressionMoments::from_matrix(&filtered, 18, &[&y]).unwrap();
        let judged = |lambda: f64| {
            let path = fitted.prepare(ColumnScaling::None, false).unwrap().ridge(&[lambda], &names).unwrap();
            let fit = LinearFit { coefficients: path.solutions[0].coefficients[0].clone(), intercept: 0.0 };
            trivial_solution(&unfiltered, &fitted, 0, &names, &fit, lambda, DEFAULT_SCALE_NT).unwrap().unwrap()
        };
        // With a negligible ridge the fit is the trivial solution, which explains the scalar exactly. The true solution
        // has an error of some 1e-5 nT.
        let weak = judged(1e-22);
        assert!(weak.is_trivial() && weak.distance < 0.1, "{weak:?}");
        let strong = judged(0.025);
        assert!(!strong.is_trivial() && strong.distance > 0.9 && strong.share.abs() < 0.1, "{strong:?}");
        assert!(strong.is_excluded(), "{strong:?}");
        // The trivial solution has coefficients s and no residual, so its loss is 3 λ s².
        assert!((strong.trivial_loss / (0.025 * 3.0 * DEFAULT_SCALE_NT.powi(2)) - 1.0).abs() < 1e-6);
        let five = RegressionMoments::from_matrix(&[1.0, 2.0], 1, &[&[1.0, 2.0]]).unwrap();
        let fit = LinearFit { coefficients: vec![1.0], intercept: 0.0 };
        assert_eq!(trivial_solution(&five, &five, 0, &["xx"], &fit, 0.0, 1.0).unwrap(), None);
    }
}
