//! Gradient-boosted trees.

use std::{ops::ControlFlow, time::Instant};

use learning::trees::{Boosted, Boosting, Tree, boost_on, trees_from_bytes, trees_to_bytes};
use numerics::regression::statistics;
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, Learnt, model},
    samples::{PointWork, Samples},
    settings::Settings,
};
use crate::trained::{self, Learned, list};

/// Seconds between two states that are kept.
const KEPT_EVERY_S: f64 = 1.0;
/// Ratio of validation loss to training loss above which a warning reports overfitting.
const OVERFITS: f64 = 4.0;

model! {
    /// Gradient-boosted regression trees of the features, on histograms of 256 bins, for squared errors. They take columns of
    /// any scale, need little choosing, and are the first thing to compare a network with. They are constant beyond the
    /// values that they were trained on, so that neither a drift nor an attitude that was not flown is followed.
    ///
    /// Source: Friedman 2001; Chen & Guestrin 2016; Ke et al. 2017. scikit-learn's `HistGradientBoostingRegressor` has the same trees
    /// where columns have up to 256 values.
    BoostedTrees = "boosted_trees", version 1, scaling None, intercept true, made of Samples, choose [Given], takes [],
    example "trees = 20";
    /// The inputs of the trees: entries of the features, by their names or what several names have before a `_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// How many trees at most.
    trees: usize, unit "1", default 200usize, rule Rule::Between(1.0, 100_000.0);
    /// Factor on each tree, often called the learning rate. Half of it needs twice as many trees.
    shrinkage: f64, unit "1", default 0.1, rule Rule::Between(1e-6, 1.0);
    /// Leaves of a tree at most.
    leaves: usize, unit "1", default 31usize, rule Rule::Between(2.0, 65_536.0);
    /// Splits on the way to a leaf at most.
    depth: Option<usize>, unit "1", absent "no limit but `leaves`", rule Rule::Positive;
    /// The least number of samples of a leaf.
    leaf_samples: usize, unit "samples", default 20usize, rule Rule::Positive;
    /// Constant added to the number of samples of a leaf when its value is computed. It shrinks small leaves.
    leaf_l2: f64, unit "samples", default 0.0, rule Rule::NotNegative;
    /// The part of the samples that each tree sees.
    subsample: f64, unit "1", default 1.0, rule Rule::Between(1e-3, 1.0);
    /// Lines (`1003.08` or `1003/1003.08`) or whole flights that are not trained on: the number of trees with the smallest
    /// loss on them is taken.
    validation: Vec<String>, unit "", default Vec::<String>::new();
    /// Trees without a smaller validation loss after which the training ends.
    patience: Option<usize>, unit "1", absent "all trees are trained", rule Rule::Positive;
    /// The seed of which samples each tree sees.
    seed: usize, unit "", default 0usize;
}

impl FitModel for BoostedTrees {
    fn effort(&self) -> f64 {
        self.trees as f64
    }

    fn learn(&self, samples: &Samples, _: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let (train, validate) = samples.split(&self.validation)?;
        let at = samples.places(self.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (x, y) = (samples.columns(&at, &train), samples.target(&train));
        let ahead = (samples.columns(&at, &validate), samples.target(&validate));
        let ahead = (!ahead.1.is_empty()).then_some((ahead.0.as_slice(), ahead.1.as_slice()));
        // An earlier run of the same training is resumed; any other training starts anew.
        let begun = work.kept().and_then(|bytes| trees_from_bytes(&bytes)).unwrap_or_default();
        let (mut stopped, mut kept, known) = (None, None::<Instant>, begun.len());
        let mut each = |trees: &[Tree], train: f64, validation: f64| {
            let goes_on = work.goes_on(&self.progress(trees.len(), train, validation));
            let due = kept.is_none_or(|last| last.elapsed().as_secs_f64() > KEPT_EVERY_S);
            if trees.len() > known && (due || goes_on.is_err()) {
                kept = Some(Instant::now());
                work.keep(&trees_to_bytes(trees));
            }
            match goes_on {
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
        Ok(Learnt { model: Learned::BoostedTrees(trees), chosen, curve, warning })
    }

    fn faults(&self, _: &Settings) -> Vec<Fault> {
        let alone = self.patience.is_some() && self.validation.is_empty();
        let what = "it needs lines or flights to validate with: name them in `validation`";
        alone.then(|| Fault::new(what).of_param("patience")).into_iter().collect()
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let whole = key == "seed" && self.subsample >= 1.0;
        whole.then(|| Fault::new("`seed` has no effect without `subsample`: every tree sees all samples"))
    }
}

impl BoostedTrees {
    fn boosting(&self) -> Boosting {
        Boosting {
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

    fn warning(&self, boosted: &Boosted) -> String {
        let Some((train, validation)) = boosted.best.checked_sub(1).and_then(|at| boosted.losses.get(at)) else {
            return String::new();
        };
        let mut all = vec![];
        if validation.is_finite() && boosted.best == self.trees {
            all.push("the validation loss still fell at the last tree: more `trees` would do better".to_owned());
        }
        if *validation > OVERFITS * train {
            let ratio = validation / train;
            all.push(format!(
                "the loss on the lines of `validation` is {ratio:.1} times that of the training: the trees overfit"
            ));
        }
        all.join("; ")
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::Unattended;

    use crate::fit::testing::{Found, Stopping, bent, fitted_to, number, stage, whole, words, worked};

    #[test]
    fn law_a_training_that_is_stopped_goes_on_to_the_same_table() {
        let keys =
            [words("validation", &["1.1"]), whole("leaf_samples", 2), whole("trees", 30), number("subsample", 0.7)];
        let table = |found: &Found| -> Vec<(String, u64)> {
            found.term.iter().cloned().zip(found.value.iter().map(|v| v.to_bits())).collect()
        };
        let whole_way = table(&fitted_to(&bent(), "boosted_trees", &keys));
        for stop in [1, 7, 29] {
            let first = Stopping::after(stop, None);
            assert_eq!(worked(&bent(), "boosted_trees", &keys, &first).err().unwrap().what, "interrupted");
            let second = Stopping::after(usize::MAX, first.state());
            let found = worked(&bent(), "boosted_trees", &keys, &second).unwrap();
            assert_eq!(table(&found), whole_way, "stopped after {stop}");
        }
        let damaged = Stopping::after(usize::MAX, Some(b"nothing".to_vec()));
        assert_eq!(table(&worked(&bent(), "boosted_trees", &keys, &damaged).unwrap()), whole_way);
    }

    #[test]
    fn law_they_explain_a_target_that_bends() {
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "boosted_trees", &[whole("leaf_samples", 2)]);
        assert!(found.residual_std < 0.1 * straight, "{} {straight}", found.residual_std);
        assert_eq!((found.chosen, found.warning.as_str()), (200.0, ""));
        assert!(found.term.iter().any(|t| t == "epoch_training[200]"));
    }

    #[test]
    fn unit_validation_takes_the_best_number_of_trees_and_warns_of_what_overfits() {
        let keys = [words("validation", &["1.1"]), whole("leaf_samples", 2), whole("patience", 5)];
        let found = fitted_to(&bent(), "boosted_trees", &keys);
        let count = found.term.iter().filter(|t| t.starts_with("nodes[")).count();
        assert_eq!(found.chosen as usize, count);
        assert!(found.chosen < 200.0 && found.warning.contains("overfit"), "{} {}", found.chosen, found.warning);
    }

    #[test]
    fn unit_what_cannot_be_trained_is_told_with_its_parameter() {
        let told = |keys: &[_]| match stage("boosted_trees", keys) {
            Ok(_) => worked(&bent(), "boosted_trees", keys, &Unattended).err().unwrap(),
            Err(mut faults) => faults.remove(0),
        };
        assert_eq!(told(&[words("inputs", &["d"])]).param.as_deref(), Some("inputs"));
        assert_eq!(told(&[words("validation", &["1.7"])]).param.as_deref(), Some("validation"));
        assert!(told(&[whole("leaf_samples", 300)]).what.contains("600"), "{}", told(&[whole("leaf_samples", 300)]));
        assert!(told(&[number("shrinkage", 2.0)]).what.contains("shrinkage"));
    }
}
