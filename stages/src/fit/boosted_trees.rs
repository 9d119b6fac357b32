//! Gradient-boosted trees.

use std::{ops::ControlFlow, time::Instant};

use learning::trees::{BoostingResult, BoostingSettings, RegressionTree, boost_on, trees_from_bytes, trees_to_bytes};
use numerics::regression::statistics;
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LearningResult, model},
    samples::{FitSamples, PointMonitor},
    settings::FitSettings,
};
use crate::trained::{self, LearnedModel, list};

/// Time between two saved states, in seconds.
const KEPT_EVERY_S: f64 = 1.0;
/// Overfitting is reported if the validation loss exceeds the training loss by more than this factor.
const OVERFITS: f64 = 4.0;

model! {
    /// Gradient-boosted regression trees on the features, with 256-bin histograms and the squared loss. They accept
    /// columns of any scale, require little tuning, and are a good baseline for networks. Outside the range of the
    /// training data, the prediction is constant: it does not follow a drift or a new attitude.
    ///
    /// Source: Friedman 2001; Chen & Guestrin 2016; Ke et al. 2017. scikit-learn's `HistGradientBoostingRegressor`
    /// gives the same trees for columns with at most 256 distinct values.
    BoostedTrees = "boosted_trees", version 1, scaling None, intercept true, made of Samples, choose [Given], takes [],
    example "trees = 20";
    /// Entries of `features` that are inputs of the trees. A name selects one entry; a prefix such as `TL_A_flux_a`
    /// selects all entries whose names begin with `TL_A_flux_a_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// Maximum number of trees.
    trees: usize, unit "1", default 200usize, rule Rule::Between(1.0, 100_000.0);
    /// Factor applied to each tree, also called the learning rate. Halving it requires twice as many trees.
    shrinkage: f64, unit "1", default 0.1, rule Rule::Between(1e-6, 1.0);
    /// Maximum number of leaves per tree.
    leaves: usize, unit "1", default 31usize, rule Rule::Between(2.0, 65_536.0);
    /// Maximum number of splits above a leaf.
    depth: Option<usize>, unit "1", absent "limited by `leaves` only", rule Rule::Positive;
    /// Minimum number of samples per leaf.
    leaf_samples: usize, unit "samples", default 20usize, rule Rule::Positive;
    /// L2 penalty on the values of the leaves. The value of a leaf is the sum of its residuals divided by (number of
    /// samples + `leaf_l2`). The values of leaves with few samples are therefore reduced.
    leaf_l2: f64, unit "samples", default 0.0, rule Rule::NotNegative;
    /// Fraction of the samples used for each tree.
    subsample: f64, unit "1", default 1.0, rule Rule::Between(1e-3, 1.0);
    /// Lines or flights that are used for validation instead of training. A line is given as `1003.08`, or with its
    /// flight as `1003/1003.08`. The result has the number of trees with the smallest validation loss.
    validation: Vec<String>, unit "", default Vec::<String>::new();
    /// Training stops after this number of consecutive trees without a smaller validation loss.
    patience: Option<usize>, unit "1", absent "training builds all trees", rule Rule::Positive;
    /// Seed for the subsample of each tree.
    seed: usize, unit "", default 0usize;
}

impl FitModel for BoostedTrees {
    fn effort(&self) -> f64 {
        self.trees as f64
    }

    fn learn(&self, samples: &FitSamples, _: &FitSettings, work: &PointMonitor) -> Result<LearningResult, Fault> {
        let (train, validate) = samples.split(&self.validation)?;
        let at = samples.places(self.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (x, y) = (samples.columns(&at, &train), samples.target(&train));
        let ahead = (samples.columns(&at, &validate), samples.target(&validate));
        let ahead = (!ahead.1.is_empty()).then_some((ahead.0.as_slice(), ahead.1.as_slice()));
        // Resumes from the state of an interrupted run of the same training. Any other state is ignored.
        let begun = work.kept().and_then(|bytes| trees_from_bytes(&bytes)).unwrap_or_default();
        let (mut stopped, mut kept, known) = (None, None::<Instant>, begun.len());
        let mut each = |trees: &[RegressionTree], train: f64, validation: f64| {
            let flow = work.report_progress(&self.progress(trees.len(), train, validation));
            let due = kept.is_none_or(|last| last.elapsed().as_secs_f64() > KEPT_EVERY_S);
            if trees.len() > known && (due || flow.is_err()) {
                kept = Some(Instant::now());
                work.keep(&trees_to_bytes(trees));
            }
            match flow {
                Ok(()) => ControlFlow::Continue(()),
                Err(fault) => {
                    stopped = Some(fault);
                    ControlFlow::Break(())
                }
            }
        };
        let boosted = boost_on(begun, &x, at.len(), &y, &self.boosting(), ahead, &mut each);
        if let Some(fault) = stopped {
            return Err(fault);
        }
        let boosted = boosted.map_err(|e| Fault::data(e.to_string()))?;
        let (warning, chosen) = (self.warning(&boosted), boosted.best as f64);
        let scale = statistics::std(&y).value.powi(2);
        let of = |value: fn(&(f64, f64)) -> f64| boosted.losses.iter().map(|l| value(l) / scale).collect::<Vec<f64>>();
        let mut curve: Vec<_> = list("epoch_training", &of(|l| l.0)).collect();
        if ahead.is_some() {
            curve.extend(list("epoch_validation", &of(|l| l.1)));
        }
        let names = at.iter().filter_map(|&i| samples.names.get(i).cloned()).collect();
        let trees = trained::BoostedTrees::new(names, boosted.forest)?;
        Ok(LearningResult { model: LearnedModel::BoostedTrees(trees), chosen, curve, warning })
    }

    fn faults(&self, _: &FitSettings) -> Vec<Fault> {
        let alone = self.patience.is_some() && self.validation.is_empty();
        let what = "`patience` requires validation data; name lines or flights in `validation`";
        alone.then(|| Fault::new(what).of_param("patience")).into_iter().collect()
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let whole = key == "seed" && self.subsample >= 1.0;
        whole.then(|| Fault::new("`seed` has no effect without `subsample`, because every tree uses all samples"))
    }
}

impl BoostedTrees {
    fn boosting(&self) -> BoostingSettings {
        BoostingSettings {
            trees: self.trees,
            learning_rate: self.shrinkage,
            leaves: self.leaves,
            depth: self.depth,
            least_rows: self.leaf_samples,
            l2: self.leaf_l2,
            subsample: self.subsample,
            seed: self.seed as u64,
            patience: self.patience,
        }
    }

    fn progress(&self, tree: usize, train: f64, validation: f64) -> String {
        let mut text = format!("tree {tree} of {}, error {:.2} nT", self.trees, train.sqrt());
        if validation.is_finite() {
            text.push_str(&format!(", validation {:.2} nT", validation.sqrt()));
        }
        text
    }

    fn warning(&self, boosted: &BoostingResult) -> String {
        let Some((train, validation)) = boosted.best.checked_sub(1).and_then(|at| boosted.losses.get(at)) else {
            return String::new();
        };
        let mut all = vec![];
        if validation.is_finite() && boosted.best == self.trees {
            all.push("the validation loss was still falling at the last tree; increase `trees`".to_owned());
        }
        if *validation > OVERFITS * train {
            let ratio = validation / train;
            all.push(format!("the validation loss is {ratio:.1} times the training loss; the trees overfit"));
        }
        all.join("; ")
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::NullMonitor;

    use crate::fit::testing::{FitOutput, InterruptMonitor, bent, fitted_to, number, stage, whole, words, worked};

    #[test]
    fn unit_a_resumed_training_gives_the_same_table() {
        let keys =
            [words("validation", &["1.1"]), whole("leaf_samples", 2), whole("trees", 30), number("subsample", 0.7)];
        let table = |found: &FitOutput| -> Vec<(String, u64)> {
            found.term.iter().cloned().zip(found.value.iter().map(|v| v.to_bits())).collect()
        };
        let whole_way = table(&fitted_to(&bent(), "boosted_trees", &keys));
        for stop in [1, 7, 29] {
            let first = InterruptMonitor::after(stop, None);
            assert_eq!(worked(&bent(), "boosted_trees", &keys, &first).err().unwrap().what, "interrupted");
            let second = InterruptMonitor::after(usize::MAX, first.state());
            let found = worked(&bent(), "boosted_trees", &keys, &second).unwrap();
            assert_eq!(table(&found), whole_way, "stopped after {stop}");
        }
        let damaged = InterruptMonitor::after(usize::MAX, Some(b"nothing".to_vec()));
        assert_eq!(table(&worked(&bent(), "boosted_trees", &keys, &damaged).unwrap()), whole_way);
    }

    #[test]
    fn unit_trees_fit_a_nonlinear_target() {
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "boosted_trees", &[whole("leaf_samples", 2)]);
        assert!(found.residual_std < 0.1 * straight, "{} {straight}", found.residual_std);
        assert_eq!((found.chosen, found.warning.as_str()), (200.0, ""));
        assert!(found.term.iter().any(|t| t == "epoch_training[200]"));
    }

    #[test]
    fn unit_validation_selects_the_number_of_trees_and_warns_of_overfitting() {
        let keys = [words("validation", &["1.1"]), whole("leaf_samples", 2), whole("patience", 5)];
        let found = fitted_to(&bent(), "boosted_trees", &keys);
        let count = found.term.iter().filter(|t| t.starts_with("nodes[")).count();
        assert_eq!(found.chosen as usize, count);
        assert!(found.chosen < 200.0 && found.warning.contains("overfit"), "{} {}", found.chosen, found.warning);
    }

    #[test]
    fn unit_invalid_settings_are_reported_with_their_parameter() {
        let fault_of = |keys: &[_]| match stage("boosted_trees", keys) {
            Ok(_) => worked(&bent(), "boosted_trees", keys, &NullMonitor).err().unwrap(),
            Err(mut faults) => faults.remove(0),
        };
        assert_eq!(fault_of(&[words("inputs", &["d"])]).param.as_deref(), Some("inputs"));
        assert_eq!(fault_of(&[words("validation", &["1.7"])]).param.as_deref(), Some("validation"));
        assert!(
            fault_of(&[whole("leaf_samples", 300)]).what.contains("600"),
            "{}",
            fault_of(&[whole("leaf_samples", 300)])
        );
        assert!(fault_of(&[number("shrinkage", 2.0)]).what.contains("shrinkage"));
    }
}
