//! Ridge regression on random Fourier features.

use learning::random_features::{Kernel, fit};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, Learnt, model},
    network::scaling,
    samples::{PointWork, Samples},
    settings::Settings,
};
use crate::trained::{self, Learned};

model! {
    /// A linear model with a Gaussian process on top, of standardised inputs. It combines the inputs with random
    /// Fourier features of a Gaussian kernel and solves a ridge of the most likely strength. It needs no training and
    /// few choices. The standard deviation of its prediction grows where samples are rare. It is that of the function,
    /// and too small where errors are correlated from sample to sample.
    ///
    /// Source: Rahimi & Recht 2007; Rasmussen & Williams 2006, chapters 2 and 5.
    RandomFeatures = "random_features", version 1, scaling Standardise, intercept true, made of Samples, choose [Given],
    takes [], example "random_features = 20";
    /// The inputs: entries of the features, by their names or what several names have before a `_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// How many random features: the more, the nearer to the Gaussian process. Time grows with the square.
    random_features: usize, unit "1", default 200usize, rule Rule::Between(2.0, 10_000.0);
    /// The distance between samples, in standard deviations of the inputs, at which their values are akin.
    length_scale: Option<f64>, unit "1", absent "the most likely of 1/4, 1/2, 1, 2 and 4 times the median distance between samples", rule Rule::Positive;
    /// The weight of the linear model: the expected size of a coefficient of a standardised input over that of the process.
    /// 0 leaves the linear model out.
    linear_weight: f64, unit "1", default 1.0, rule Rule::NotNegative;
    /// The variance of the errors over that of the process.
    noise_ratio: Option<f64>, unit "1", absent "the most likely one", rule Rule::Positive;
    /// Whether the table has what one sigma of the prediction is computed from: as many rows as the square of the features.
    sigma: bool, unit "", default true;
    /// The seed of the features.
    seed: usize, unit "", default 0usize;
}

impl FitModel for RandomFeatures {
    fn effort(&self) -> f64 {
        (self.random_features * self.random_features) as f64
    }

    fn learn(&self, samples: &Samples, _: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let lines: Vec<usize> = (0..samples.lines.len()).collect();
        let mut at = samples.places(self.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (scaling, constant, x) = scaling(samples, &lines, &mut at, None)?;
        let y = samples.target(&lines);
        work.goes_on(&format!("{} random features of {} samples", self.random_features, y.len()))?;
        let kernel = Kernel {
            features: self.random_features,
            length: self.length_scale,
            linear: self.linear_weight,
            lambda: self.noise_ratio,
            seed: self.seed as u64,
        };
        let x = scaling.apply(&x);
        let mut model = fit(&x, at.len(), &y, &kernel).map_err(|e| Fault::data(e.to_string()))?;
        if !self.sigma {
            model.factor.clear();
        }
        let names = |at: &[usize]| at.iter().filter_map(|&i| samples.names.get(i).cloned()).collect::<Vec<_>>();
        let warning = match names(&constant).as_slice() {
            [] => String::new(),
            names => format!("constant, so no inputs of the model: `{}`", names.join("`, `")),
        };
        let chosen = model.lambda;
        let model = Learned::RandomFeatures(trained::Kernel::new(names(&at), scaling, model)?);
        Ok(Learnt { model, chosen, curve: vec![], warning })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::Unattended;

    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, bent, fitted_to, flag, number, plain, whole, worked};

    #[test]
    fn law_they_explain_a_target_that_bends() {
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "random_features", &[whole("random_features", 100)]);
        assert!(found.residual_std < 0.02 * straight, "{} {straight}", found.residual_std);
        assert!(found.term.iter().any(|t| t == "factor[103,103]"));
        let keys = [whole("random_features", 100), flag("sigma", false)];
        let without = fitted_to(&bent(), "random_features", &keys);
        assert!(!without.term.iter().any(|t| t.starts_with("factor[")));
        assert_eq!(without.residual_std, found.residual_std);
    }

    #[test]
    fn law_a_linear_target_is_left_to_the_linear_model() {
        let found = fitted_to(&plain(INTERCEPT_NT), "random_features", &[whole("random_features", 20)]);
        let of = |name: &str| found.value[found.term.iter().position(|t| t == name).unwrap()];
        for (j, truth) in COEFFICIENTS.into_iter().enumerate() {
            let slope = of(&format!("weight[{}]", 21 + j)) / of(&format!("input_scale[{}]", j + 1));
            assert!((slope - truth).abs() < 0.02, "{slope} {truth}");
        }
    }

    #[test]
    fn unit_a_constant_target_is_refused() {
        let lines: Vec<_> = plain(0.0)
            .into_iter()
            .map(|line| {
                let mut columns = line.columns().to_vec();
                columns[1] = crate::columns::array(vec![50_000.0; line.num_rows()]);
                arrow_array::RecordBatch::try_new(line.schema(), columns).unwrap()
            })
            .collect();
        let fault = worked(&lines, "random_features", &[], &Unattended).err().unwrap();
        assert!(fault.what.contains("constant"), "{fault}");
    }
}
