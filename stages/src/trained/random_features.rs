//! Random Fourier features in a model table.
//!
//! The inputs x are scaled to z = (x - `input_mean`) / `input_scale`. The features are cos(w z)/√k for the k rows w of
//! `frequency`, then sin(w z)/√k, then `linear` z if `linear` is not 0. If f are the features minus `feature_mean`, the
//! field is `intercept` + f . `weight`, and its variance is `noise_variance` (1/`rows` + |`factor` f|^2).

use learning::{inputs::InputScaling, random_features::RandomFeatures};
use schemas::Fault;

use super::{
    FieldPrediction,
    terms::{TermLookup, TermValue, broken, list, named_list, term},
};

/// Linear model of random Fourier features of scaled inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomFourierModel {
    inputs: Vec<String>,
    scaling: InputScaling,
    model: RandomFeatures,
}

impl RandomFourierModel {
    /// Creates the model from its parts. `scaling` has no components.
    ///
    /// # Errors
    /// Fails if the parts do not match.
    pub fn new(inputs: Vec<String>, scaling: InputScaling, model: RandomFeatures) -> Result<Self, Fault> {
        let width = inputs.len();
        let scaled = scaling.mean.len() == width && scaling.scale.len() == width && scaling.components.is_none();
        if !scaled || scaling.scale.iter().any(|s| *s <= 0.0) || model.width != width || model.rows == 0 {
            return Err(broken("its parts have different sizes".to_owned()));
        }
        let fits = if model.factor.is_empty() { model.mean(&[]).map(|_| ()) } else { model.predict(&[]).map(|_| ()) };
        fits.map_err(|e| broken(e.to_string()))?;
        Ok(Self { inputs, scaling, model })
    }

    /// Names of the columns of an input row.
    pub fn columns(&self) -> &[String] {
        &self.inputs
    }

    /// See [`LearnedModel::predict`](super::LearnedModel::predict).
    pub fn predict(&self, x: &[f64]) -> FieldPrediction {
        let z = self.scaling.apply(x);
        let unknown = || vec![f64::NAN; x.len() / self.inputs.len().max(1)];
        if self.model.factor.is_empty() {
            return FieldPrediction { field_nt: self.model.mean(&z).unwrap_or_else(|_| unknown()), sigma_nt: None };
        }
        let (field_nt, sigma_nt) = self.model.predict(&z).unwrap_or_else(|_| (unknown(), unknown()));
        FieldPrediction { field_nt, sigma_nt: Some(sigma_nt) }
    }

    /// See [`LearnedModel::gradient`](super::LearnedModel::gradient).
    pub fn gradient(&self, x: &[f64]) -> Vec<f64> {
        let mut by_z = self.model.gradient(&self.scaling.apply(x)).unwrap_or_else(|_| vec![f64::NAN; x.len()]);
        for row in by_z.chunks_exact_mut(self.inputs.len().max(1)) {
            row.iter_mut().zip(&self.scaling.scale).for_each(|(d, s)| *d /= s);
        }
        by_z
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<TermValue> {
        let model = &self.model;
        let matrix = |key: &'static str, values: &[f64], width: usize| -> Vec<TermValue> {
            let rows = values.chunks_exact(width.max(1)).enumerate();
            let of = |(i, row): (usize, &[f64])| {
                let all = row.iter().enumerate();
                all.map(|(j, value)| term(format!("{key}[{},{}]", i + 1, j + 1), *value)).collect::<Vec<_>>()
            };
            rows.flat_map(of).collect()
        };
        let mut out: Vec<TermValue> = named_list("input_mean", &self.inputs, &self.scaling.mean).collect();
        out.extend(list("input_scale", &self.scaling.scale));
        out.push(term("frequencies", (model.frequencies.len() / model.width.max(1)) as f64));
        out.extend(matrix("frequency", &model.frequencies, model.width));
        out.push(term("linear", model.linear));
        out.extend(list("feature_mean", &model.means));
        out.extend(list("weight", &model.weights));
        out.extend([
            term("intercept", model.intercept),
            term("noise_variance", model.noise_variance),
            term("rows", model.rows as f64),
            term("length_scale", model.length),
            term("noise_ratio", model.lambda),
            term("log_likelihood", model.log_likelihood),
            term("factors", if model.factor.is_empty() { 0.0 } else { model.means.len() as f64 }),
        ]);
        out.extend(matrix("factor", &model.factor, model.means.len()));
        out
    }

    /// Reads the model of a table.
    ///
    /// # Errors
    /// Fails if the table is incomplete.
    pub fn read(terms: &TermLookup) -> Result<Self, Fault> {
        let matrix = |key: &str, rows: usize, width: usize| {
            let at = (1..=rows).flat_map(|i| (1..=width).map(move |j| (i, j)));
            at.map(|(i, j)| terms.value(&format!("{key}[{i},{j}]"))).collect::<Result<Vec<_>, Fault>>()
        };
        let (inputs, mean) = terms.list("input_mean")?;
        let (_, scale) = terms.list("input_scale")?;
        let frequencies = matrix("frequency", terms.count("frequencies")?, inputs.len())?;
        let (_, means) = terms.list("feature_mean")?;
        let (_, weights) = terms.list("weight")?;
        let factor = matrix("factor", terms.count("factors")?, means.len())?;
        let model = RandomFeatures {
            width: inputs.len(),
            frequencies,
            linear: terms.value("linear")?,
            means,
            weights,
            intercept: terms.value("intercept")?,
            factor,
            noise_variance: terms.value("noise_variance")?,
            rows: terms.count("rows")?,
            length: terms.value("length_scale")?,
            lambda: terms.value("noise_ratio")?,
            log_likelihood: terms.value("log_likelihood")?,
        };
        RandomFourierModel::new(inputs, InputScaling { mean, scale, components: None }, model)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use learning::random_features::{RandomFeatureSettings as Settings, fit};

    use super::super::LearnedModel;
    use super::*;

    fn kernel(sigma: bool) -> RandomFourierModel {
        let x: Vec<f64> = (0..80).map(|k| (0.7 * f64::from(k)).sin() + f64::from(k % 3)).collect();
        let y: Vec<f64> = x.chunks(2).map(|x| 40.0 + x[0] * x[1]).collect();
        let scaling = InputScaling::standardised(&x, 2).unwrap();
        let mut model = fit(&scaling.apply(&x), 2, &y, &Settings { features: 6, ..Settings::default() }).unwrap();
        if !sigma {
            model.factor.clear();
        }
        RandomFourierModel::new(vec!["a".into(), "b".into()], scaling, model).unwrap()
    }

    #[test]
    fn unit_random_features_are_read_from_complete_tables_in_any_order() {
        for sigma in [true, false] {
            let learned = LearnedModel::RandomFeatures(kernel(sigma));
            let mut terms = learned.terms();
            terms.sort_by(|a, b| b.name.cmp(&a.name));
            let (names, values): (Vec<String>, Vec<f64>) = terms.into_iter().map(|t| (t.name, t.value)).unzip();
            assert_eq!(LearnedModel::read(&names, &values).unwrap(), Some(learned));
            for lost in 0..names.len() {
                let without = [&names[..lost], &names[lost + 1..]].concat();
                let read = LearnedModel::read(&without, &[&values[..lost], &values[lost + 1..]].concat());
                let family = names[lost].starts_with("family");
                assert!(if family { read.unwrap().is_none() } else { read.is_err() }, "{}", names[lost]);
            }
        }
    }

    #[test]
    fn jac_the_gradient_agrees_with_differences_of_the_prediction() {
        let kernel = kernel(true);
        let at = [0.4, 1.2];
        let gradient = kernel.gradient(&at);
        for j in 0..2 {
            let moved = |by: f64| {
                let mut x = at;
                x[j] += by;
                kernel.predict(&x).field_nt[0]
            };
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!((gradient[j] - difference).abs() < 1e-6 * (1.0 + difference.abs()), "{gradient:?} {difference}");
        }
        assert!(kernel.predict(&at).sigma_nt.unwrap()[0] > 0.0);
    }
}
