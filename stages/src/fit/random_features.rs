//! Ridge regression on random Fourier features.

use learning::random_features::{RandomFeatureSettings, fit};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LearningResult, model},
    network::scaling,
    samples::{FitSamples, PointMonitor},
    settings::FitSettings,
};
use crate::trained::{self, LearnedModel};

model! {
    /// A linear model plus a Gaussian process, both with standardised inputs. Random Fourier features of a Gaussian
    /// kernel approximate the process. The solution is a ridge regression whose ridge parameter maximises the
    /// likelihood. The model requires no iterative training and little tuning. The standard deviation of the prediction
    /// is larger where training samples are rare. It includes only the uncertainty of the function, and is too small if
    /// errors are correlated.
    ///
    /// Source: Rahimi & Recht 2007; Rasmussen & Williams 2006, chapters 2 and 5.
    RandomFeatures = "random_features", version 1, scaling Standardise, intercept true, made of Samples, choose [Given],
    takes [], example "random_features = 20";
    /// Entries of `features` that are inputs of the model. A name selects one entry; a prefix such as `TL_A_flux_a`
    /// selects all entries whose names begin with `TL_A_flux_a_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// Number of random features. More features approximate the Gaussian process better. Computing time is proportional
    /// to the square of this number.
    random_features: usize, unit "1", default 200usize, rule Rule::Between(2.0, 10_000.0);
    /// Length scale of the kernel: the distance over which values are correlated, in standard deviations of the inputs.
    length_scale: Option<f64>, unit "1",
        absent "the most likely of 1/4, 1/2, 1, 2 and 4 times the median distance between samples", rule Rule::Positive;
    /// Weight of the linear model: prior standard deviation of its coefficients for standardised inputs, divided by the
    /// standard deviation of the process. 0 removes the linear model.
    linear_weight: f64, unit "1", default 1.0, rule Rule::NotNegative;
    /// Variance of the errors divided by the variance of the process.
    noise_ratio: Option<f64>, unit "1", absent "the most likely value", rule Rule::Positive;
    /// Stores the matrix factor that `compensate` requires for the standard deviation of the prediction. For n random
    /// features, the factor adds n² rows to the table of the fit.
    sigma: bool, unit "", default true;
    /// Seed of the random features.
    seed: usize, unit "", default 0usize;
}

impl FitModel for RandomFeatures {
    fn effort(&self) -> f64 {
        (self.random_features * self.random_features) as f64
    }

    fn learn(&self, samples: &FitSamples, _: &FitSettings, work: &PointMonitor) -> Result<LearningResult, Fault> {
        let lines: Vec<usize> = (0..samples.lines.len()).collect();
        let mut at = samples.places(self.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (scaling, constant, x) = scaling(samples, &lines, &mut at, None)?;
        let y = samples.target(&lines);
        work.report_progress(&format!("{} random features of {} samples", self.random_features, y.len()))?;
        let kernel = RandomFeatureSettings {
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
            names => format!("constant and not used as inputs of the model: `{}`", names.join("`, `")),
        };
        let chosen = model.lambda;
        let model = LearnedModel::RandomFeatures(trained::RandomFourierModel::new(names(&at), scaling, model)?);
        Ok(LearningResult { model, chosen, curve: vec![], warning })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::NullMonitor;

    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, bent, fitted_to, flag, number, plain, whole, worked};

    #[test]
    fn unit_random_features_fit_a_nonlinear_target() {
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
    fn unit_the_linear_part_fits_a_linear_target() {
        let found = fitted_to(&plain(INTERCEPT_NT), "random_features", &[whole("random_features", 20)]);
        let of = |name: &str| found.value[found.term.iter().position(|t| t == name).unwrap()];
        for (j, truth) in COEFFICIENTS.into_iter().enumerate() {
            let slope = of(&format!("weight[{}]", 21 + j)) / of(&format!("input_scale[{}]", j + 1));
            assert!((slope - truth).abs() < 0.02, "{slope} {truth}");
        }
    }

    #[test]
    fn unit_a_constant_target_is_rejected() {
        let lines: Vec<_> = plain(0.0)
            .into_iter()
            .map(|line| {
                let mut columns = line.columns().to_vec();
                columns[1] = crate::columns::array(vec![50_000.0; line.num_rows()]);
                arrow_array::RecordBatch::try_new(line.schema(), columns).unwrap()
            })
            .collect();
        let fault = worked(&lines, "random_features", &[], &NullMonitor).err().unwrap();
        assert!(fault.what.contains("constant"), "{fault}");
    }
}
