//! Scaling of linear terms for training.

use numerics::regression::least_squares::{ColumnScaling, RegressionMoments};
use rayon::prelude::*;

use super::shape::{NetworkForm, NetworkShape};
use crate::inputs::{InputScalingError, LEAST_COMPONENT, LEAST_DEVIATION};

/// Rows per task of a thread.
const CHUNK: usize = 4096;

/// Scaling of linear terms and of their parameters for training.
///
/// A step of Adam moves every coefficient by about the learning rate, so terms should have equal size and low
/// correlation. If their coefficients are trained ([`NetworkForm::TrainedLinear`]), the terms a become u = (a − mean)
/// M, which have variance 1 and, with `whiten`, are uncorrelated. The coefficients b = M c are replaced by c, and the
/// output's bias absorbs mean·b. M is invertible, so both networks give the same predictions, up to rounding.
///
/// The vector forms train the coefficients c too, but compute the field from vectors and b = M c. The constant of the
/// prediction is then the trained constant − mean·(b − b₀), with the initial coefficients b₀. The gradient with respect
/// to c follows by the chain rule.
///
/// If the outputs of the network are the weights of the terms ([`NetworkForm::Weights`],
/// [`NetworkForm::WeightsAroundFixed`]), the terms are not scaled: each term has its own output, and scaling would
/// amplify terms that hardly vary. The other forms do not train coefficients of terms.
#[derive(Debug, Clone, PartialEq)]
pub struct TermScaling {
    /// Tolles-Lawson value at the mean of the terms.
    offset: f64,
    maps: Option<TermTransform>,
}

#[derive(Debug, Clone, PartialEq)]
struct TermTransform {
    mean: Vec<f64>,
    /// M, row-major: a row for each term.
    to: Vec<f64>,
    /// The inverse of M.
    back: Vec<f64>,
}

impl TermScaling {
    /// Scales rows of `width` terms, row-major, and the coefficients of Tolles-Lawson. `whiten` is as in
    /// [`InputScaling::whitened`](crate::inputs::InputScaling::whitened). No component can be omitted. Therefore the
    /// components beyond the kept components are divided by the standard deviation of the last kept component.
    ///
    /// # Errors
    /// Fails for an incomplete row, no rows, a `whiten` out of range, or a decomposition that does not converge.
    pub fn new(
        form: NetworkForm,
        a: &[f64],
        width: usize,
        whiten: Option<f64>,
        tolles_lawson: &[f64],
    ) -> Result<Self, InputScalingError> {
        match form {
            NetworkForm::Plain | NetworkForm::FixedLinear | NetworkForm::Weights | NetworkForm::WeightsAroundFixed => {
                return Ok(Self { offset: 0.0, maps: None });
            }
            NetworkForm::TrainedLinear
            | NetworkForm::VectorOnly
            | NetworkForm::VectorScalar
            | NetworkForm::VectorNetwork => {}
        }
        if width == 0 || !a.len().is_multiple_of(width) || a.is_empty() {
            return Err(InputScalingError::Shape { given: a.len(), width });
        }
        let moments = RegressionMoments::from_matrix(a, width, &[])?;
        let mean = moments.term_means();
        // A constant term is 0 after centring, so its divisor has no effect.
        let usable = |size: f64| if size > 0.0 && size.is_finite() { size } else { 1.0 };
        let maps = match whiten {
            Some(keep) => {
                let prepared = moments.prepare(ColumnScaling::Standardise, true)?;
                let singular = prepared.singular()?;
                let rows = (moments.rows() as f64 - 1.0).max(1.0);
                let deviations: Vec<f64> = singular.values.iter().map(|s| s / rows.sqrt()).collect();
                let largest = deviations.first().copied().unwrap_or(0.0);
                let least = usable(last_kept(&deviations, keep)?.max(LEAST_COMPONENT * largest));
                let deviations: Vec<f64> = deviations.into_iter().map(|d| d.max(least)).collect();
                TermTransform::whitening(mean, prepared.scales(), &singular.right, &deviations)
            }
            None => {
                // A standard deviation below this limit is the rounding error of a constant column.
                let size = |(mean, deviation): (&f64, f64)| {
                    if deviation > LEAST_DEVIATION * mean.abs() { usable(deviation) } else { 1.0 }
                };
                let sizes: Vec<f64> = mean.iter().zip(moments.term_deviations()).map(size).collect();
                TermTransform::diagonal(mean, &sizes)
            }
        };
        Ok(Self { offset: dot(&maps.mean, tolles_lawson), maps: Some(maps) })
    }

    /// Offset subtracted from the target, in the scale of the target: the Tolles-Lawson value at the mean of the terms.
    /// With this offset, the scaled terms times the scaled coefficients give the Tolles-Lawson value of each row.
    pub fn offset(&self) -> f64 {
        self.offset
    }

    /// The scaled terms of rows, row-major; values after the last whole row are ignored.
    pub fn apply(&self, a: Vec<f64>) -> Vec<f64> {
        let Some(TermTransform { mean, to, .. }) = &self.maps else { return a };
        let width = mean.len();
        let mut out = a;
        out.truncate(out.len() / width * width);
        out.par_chunks_mut(CHUNK * width).for_each(|rows| {
            let mut scaled = vec![0.0; width];
            for row in rows.chunks_exact_mut(width) {
                scaled.fill(0.0);
                for ((x, mean), weights) in row.iter().zip(mean).zip(to.chunks_exact(width)) {
                    scaled.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += (x - mean) * weight);
                }
                row.copy_from_slice(&scaled);
            }
        });
        out
    }

    /// Converts coefficients of the terms to coefficients of the scaled terms.
    pub fn coefficients(&self, b: &[f64]) -> Vec<f64> {
        self.maps.as_ref().map_or_else(|| b.to_vec(), |maps| product(&maps.back, b))
    }

    /// Converts the parameters of a network with unscaled terms to the parameters of the network with scaled terms.
    pub fn scaled(&self, shape: &NetworkShape, parameters: &[f64]) -> Vec<f64> {
        let Some(maps) = &self.maps else { return parameters.to_vec() };
        let mut out = parameters.to_vec();
        if let Some(bias) = out.get_mut(shape.last_bias()) {
            *bias += dot(&maps.mean, coefficients_in(shape, parameters)) - self.offset;
        }
        multiply(&maps.back, shape, &mut out);
        out
    }

    /// Converts the parameters of a network with scaled terms to the parameters of the network with unscaled terms.
    pub fn original(&self, shape: &NetworkShape, parameters: &[f64]) -> Vec<f64> {
        let Some(maps) = &self.maps else { return parameters.to_vec() };
        let mut out = parameters.to_vec();
        multiply(&maps.to, shape, &mut out);
        let at_mean = dot(&maps.mean, coefficients_in(shape, &out));
        if let Some(bias) = out.get_mut(shape.last_bias()) {
            *bias += self.offset - at_mean;
        }
        out
    }

    /// Converts the gradient with respect to the parameters of a network with unscaled terms to the gradient with
    /// respect to the parameters of the network with scaled terms.
    pub(super) fn pull_back(&self, shape: &NetworkShape, gradient: &mut [f64]) {
        let Some(maps) = &self.maps else { return };
        let by_constant = gradient[shape.last_bias()];
        let (first, width) = (shape.linear_start(), maps.mean.len());
        let by_b: Vec<f64> =
            gradient[first..][..width].iter().zip(&maps.mean).map(|(by, mean)| by - mean * by_constant).collect();
        let by_c = &mut gradient[first..][..width];
        by_c.fill(0.0);
        for (by, to) in by_b.iter().zip(maps.to.chunks_exact(width.max(1))) {
            by_c.iter_mut().zip(to).for_each(|(sum, to)| *sum += by * to);
        }
    }
}

impl TermTransform {
    fn diagonal(mean: Vec<f64>, sizes: &[f64]) -> Self {
        let width = sizes.len();
        let of = |entry: fn(f64) -> f64| {
            let mut all = vec![0.0; width * width];
            all.iter_mut().step_by(width + 1).zip(sizes).for_each(|(x, size)| *x = entry(*size));
            all
        };
        Self { mean, to: of(|size| 1.0 / size), back: of(|size| size) }
    }

    /// Transform to components along the `directions` of the scaled columns, each divided by the component's standard
    /// deviation.
    fn whitening(mean: Vec<f64>, scales: &[f64], directions: &[Vec<f64>], deviations: &[f64]) -> Self {
        let width = scales.len();
        let (mut to, mut back) = (vec![0.0; width * width], vec![0.0; width * width]);
        for (k, (direction, deviation)) in directions.iter().zip(deviations).enumerate() {
            // The decomposition does not determine the sign: the largest entry is made positive.
            let largest = direction.iter().fold(0.0_f64, |most, d| if d.abs() > most.abs() { *d } else { most });
            let deviation = deviation * largest.signum();
            for (j, (d, scale)) in direction.iter().zip(scales).enumerate() {
                to[j * width + k] = d / scale / deviation;
                back[k * width + j] = d * scale * deviation;
            }
        }
        Self { mean, to, back }
    }
}

/// Standard deviation of the last kept component; `deviations` are in descending order.
fn last_kept(deviations: &[f64], keep: f64) -> Result<f64, InputScalingError> {
    let width = deviations.len();
    let count = if keep >= 1.0 && keep.fract() == 0.0 && keep.is_finite() {
        // The number of components that is set for the inputs may exceed the number of terms.
        (keep as usize).min(width)
    } else if keep > 0.0 && keep < 1.0 {
        let total: f64 = deviations.iter().map(|d| d * d).sum();
        let mut held = 0.0;
        let below = deviations.iter().take_while(|d| {
            held += *d * *d;
            held < keep * total
        });
        (below.count() + 1).min(width)
    } else {
        return Err(InputScalingError::Keep { given: keep, width });
    };
    Ok(count.checked_sub(1).and_then(|last| deviations.get(last)).copied().unwrap_or(0.0))
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

fn product(matrix: &[f64], x: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(x.len().max(1)).map(|row| dot(row, x)).collect()
}

/// The coefficients of the terms among the parameters of a network.
fn coefficients_in<'a>(shape: &NetworkShape, parameters: &'a [f64]) -> &'a [f64] {
    let first = shape.linear_start();
    parameters.get(first..first + shape.linear).unwrap_or_default()
}

/// Multiplies the coefficients of the terms by a matrix.
fn multiply(matrix: &[f64], shape: &NetworkShape, parameters: &mut [f64]) {
    let new = product(matrix, coefficients_in(shape, parameters));
    parameters.iter_mut().skip(shape.linear_start()).zip(new).for_each(|(to, value)| *to = value);
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::{ActivationFunction, NetworkSamples, NetworkTraining, TrainingState, train};
    use super::*;
    use crate::network::tests::near;

    const FORMS: [NetworkForm; 5] = [
        NetworkForm::Plain,
        NetworkForm::Weights,
        NetworkForm::FixedLinear,
        NetworkForm::TrainedLinear,
        NetworkForm::WeightsAroundFixed,
    ];
    const WIDTH: usize = 4;

    /// Terms of unequal size and mean. Two columns are nearly collinear, and the last column is constant.
    fn terms(rows: usize) -> Vec<f64> {
        let row = |i: usize| {
            let t = i as f64;
            let (one, other) = ((0.37 * t).sin(), (1.7 * t).cos());
            [0.9 + 0.05 * one, 3000.0 * (one + 1e-3 * (2.9 * t).sin()), 50.0 + other, 1.0]
        };
        (0..rows).flat_map(row).collect()
    }

    fn inputs(rows: usize) -> Vec<f64> {
        (0..2 * rows).map(|i| (0.61 * i as f64).sin()).collect()
    }

    fn shape(form: NetworkForm) -> NetworkShape {
        NetworkShape { inputs: 2, linear: WIDTH, hidden: vec![3], activation: ActivationFunction::Tanh, form }
    }

    #[test]
    fn law_scaled_terms_have_unit_variance_and_whitened_ones_no_covariance() {
        let a = terms(5000);
        for (form, whiten) in [(NetworkForm::TrainedLinear, None), (NetworkForm::TrainedLinear, Some(0.999_999_999))] {
            let u = TermScaling::new(form, &a, WIDTH, whiten, &[0.0; WIDTH]).unwrap().apply(a.clone());
            let column = |k: usize| u.iter().skip(k).step_by(WIDTH);
            let covariance = |j, k| column(j).zip(column(k)).map(|(a, b)| a * b).sum::<f64>() / 4999.0;
            for k in 0..3 {
                assert!(column(k).sum::<f64>().abs() < 1e-6, "{whiten:?} {k}");
                assert!((covariance(k, k) - 1.0).abs() < 1e-8, "{whiten:?} {k}: {}", covariance(k, k));
            }
            assert!(column(3).all(|x| x.abs() < 1e-9), "{whiten:?}");
            assert_eq!(covariance(0, 1).abs() < 1e-6, whiten.is_some(), "{}", covariance(0, 1));
        }
        for form in
            [NetworkForm::Plain, NetworkForm::FixedLinear, NetworkForm::Weights, NetworkForm::WeightsAroundFixed]
        {
            let as_it_is = TermScaling::new(form, &a, WIDTH, Some(3.0), &[0.0; WIDTH]).unwrap();
            assert_eq!(as_it_is.apply(a.clone()), a, "{form:?}");
        }
    }

    #[test]
    fn law_scaled_and_original_networks_predict_the_same() {
        let (a, x) = (terms(400), inputs(400));
        let b = [30.0, -0.002, 0.7, 5.0];
        for form in FORMS {
            for whiten in [None, Some(0.999_999), Some(2.0), Some(60.0)] {
                let shape = shape(form);
                let scaling = TermScaling::new(form, &a, WIDTH, whiten, &b).unwrap();
                let parameters: Vec<f64> = shape.initial(5, &[20.0, 0.001, -0.3, 2.0]);
                let scaled = scaling.scaled(&shape, &parameters);
                let u = scaling.apply(a.clone());
                let own = shape.predict(&scaled, &x, &u);
                let moved: Vec<f64> = own.iter().map(|y| y + scaling.offset()).collect();
                let name = format!("{form:?} {whiten:?}");
                near(&moved, &shape.predict(&parameters, &x, &a), 1e-9, &name);
                near(&scaling.original(&shape, &scaled), &parameters, 1e-9, &name);
                let changed = form == NetworkForm::TrainedLinear;
                assert_eq!(scaled != parameters, changed, "{name}");
                // The Tolles-Lawson values for the physics term are unchanged by the scaling.
                if changed {
                    let of = |a: &[f64], b: &[f64]| a.chunks_exact(WIDTH).map(|a| dot(a, b)).collect::<Vec<f64>>();
                    let scaled: Vec<f64> =
                        of(&u, &scaling.coefficients(&b)).iter().map(|y| y + scaling.offset()).collect();
                    near(&scaled, &of(&a, &b), 1e-9, &name);
                }
            }
        }
    }

    #[test]
    fn unit_m2c_finds_coefficients_of_terms_of_any_size_with_adam() {
        let (a, x) = (terms(4000), inputs(4000));
        let truth = [0.4, 0.8, -0.6, 0.0];
        let scaling =
            TermScaling::new(NetworkForm::TrainedLinear, &a, WIDTH, Some(0.999_999_999), &[0.0; WIDTH]).unwrap();
        let u = scaling.apply(a.clone());
        let y: Vec<f64> = u.chunks_exact(WIDTH).map(|u| dot(u, &truth)).collect();
        let shape = shape(NetworkForm::TrainedLinear);
        let training = NetworkTraining { epochs: 100, batch: 100, learning_rate: 0.01, ..NetworkTraining::default() };
        let left = |a: &[f64]| {
            let samples = NetworkSamples { x: &x, a, y: &y };
            let start = TrainingState::new(&shape, shape.initial(1, &[0.0; WIDTH]));
            let trained = train(&shape, start, &training, &samples, None, &mut |_, _| ControlFlow::Continue(()));
            trained.unwrap().epochs.last().unwrap().train_loss
        };
        let (scaled, unscaled) = (left(&u), left(&a));
        assert!(scaled < 1e-3 && unscaled > 0.1, "{scaled} {unscaled}");
    }

    #[test]
    fn unit_invalid_terms_are_rejected_and_threads_change_no_bit() {
        let a = terms(20_000);
        let of =
            |a: &[f64], keep: f64| TermScaling::new(NetworkForm::TrainedLinear, a, WIDTH, Some(keep), &[0.0; WIDTH]);
        for keep in [0.0, -1.0, 2.5, f64::NAN, f64::INFINITY] {
            assert!(matches!(of(&a, keep), Err(InputScalingError::Keep { .. })), "{keep}");
        }
        assert!(matches!(of(&a[..5], 0.9), Err(InputScalingError::Shape { .. })));
        assert!(matches!(of(&[], 0.9), Err(InputScalingError::Shape { .. })));
        // A single row has no standard deviation: only the mean is subtracted.
        let one = of(&a[..WIDTH], 0.9).unwrap();
        assert_eq!(one.apply(a[..WIDTH].to_vec()), [0.0; WIDTH]);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let scaling = of(&a, 0.999).unwrap();
                let u = scaling.apply(a.clone());
                (scaling, u)
            })
        };
        assert_eq!(on(1), on(3));
    }
}
