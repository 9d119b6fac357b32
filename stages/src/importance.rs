//! Importance of the inputs of a model.

mod sensitivity;
#[cfg(test)]
mod tests;
mod weights;

use std::sync::Arc;

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use schemas::{
    Column, Fault, LineInput, LineOutput, LineStage, PassThroughColumns, Role, Rule, Stage, StageSchema, Table, choice,
    stage,
};
use weights::{GroupImportance, ImportanceRows, LineImportance};

use crate::{
    columns::{array, faults_of, list, shape},
    fitted::{FittedModel, FittedModelForm},
    model_columns::RATE,
};

choice! {
    /// Method that computes the importance.
    pub enum ImportanceMethod {
        /// Increase in the mean square error when time blocks of a group are permuted.
        Permutation = "permutation",
        /// Mean absolute Shapley value over the samples.
        Shapley = "shapley",
        /// Mean absolute expected gradient over the samples. Not available for trees, which have no gradient.
        ExpectedGradients = "expected_gradients",
        /// Largest Pearson correlation of an entry of the group with the target. Independent of the model.
        Pearson = "pearson",
        /// Largest Spearman rank correlation of an entry of the group with the target. Independent of the model.
        Spearman = "spearman",
        /// Coefficients of the best linear model with `terms` entries, by iterative hard thresholding. Independent of
        /// the model.
        HardThresholding = "hard_thresholding",
        /// Weights of a network's first layer. A sparse group lasso (`group_lasso` of `fit`) shrinks the weights of
        /// unimportant inputs.
        GroupLasso = "group_lasso",
        /// Mean absolute elementary effect over the ranges of the inputs.
        Morris = "morris",
        /// First-order Sobol index over the ranges of the inputs: share of the variance from the group alone.
        SobolFirst = "sobol_first",
        /// Total Sobol index over the ranges of the inputs: share of the variance from the group and its interactions.
        SobolTotal = "sobol_total",
    }
}

impl ImportanceMethod {
    /// Returns whether the method gives each sample its own value.
    fn explains_samples(self) -> bool {
        match self {
            ImportanceMethod::Shapley | ImportanceMethod::ExpectedGradients => true,
            ImportanceMethod::Permutation
            | ImportanceMethod::Pearson
            | ImportanceMethod::Spearman
            | ImportanceMethod::HardThresholding
            | ImportanceMethod::GroupLasso
            | ImportanceMethod::Morris
            | ImportanceMethod::SobolFirst
            | ImportanceMethod::SobolTotal => false,
        }
    }

    /// Returns whether the values are shares of a variance.
    fn is_share(self) -> bool {
        matches!(self, ImportanceMethod::SobolFirst | ImportanceMethod::SobolTotal)
    }

    /// Unit of the values.
    fn unit(self) -> &'static str {
        match self {
            ImportanceMethod::Permutation => "nT2",
            ImportanceMethod::Shapley
            | ImportanceMethod::ExpectedGradients
            | ImportanceMethod::HardThresholding
            | ImportanceMethod::Morris => "nT",
            ImportanceMethod::Pearson
            | ImportanceMethod::Spearman
            | ImportanceMethod::GroupLasso
            | ImportanceMethod::SobolFirst
            | ImportanceMethod::SobolTotal => "1",
        }
    }
}

stage! {
    /// Computes the importance of each input of a fitted model on each line. Each group of inputs gives one row with
    /// `value`. If `value` is a mean, `spread` is the standard deviation of the averaged values. `permutation`,
    /// `shapley`, `morris` and the Sobol indices use predictions only, so they apply to all kinds of models.
    ///
    /// Each entry of the model's features is a separate group, unless `groups` combines it with others. Correlated
    /// inputs share or mask importance, so put all inputs from one sensor into one group.
    ///
    /// | `method` | `value` | `value` is a mean over |
    /// |---|---|---|
    /// | `permutation` | increase in the mean square error of the predicted `target`, in nT2 | the repeats |
    /// | `shapley` | mean absolute contribution to the prediction, in nT | the samples |
    /// | `expected_gradients` | mean absolute contribution, computed from gradients, in nT | the samples |
    /// | `pearson`, `spearman` | correlation with `target` | |
    /// | `hard_thresholding` | coefficient of the standardised entry, in nT; 0 if the entry is not selected | |
    /// | `group_lasso` | norm of an input's weights times the input's standard deviation on the line | the ensemble |
    /// | `morris` | mean absolute change in the prediction over the input's range, in nT | the trajectories |
    /// | `sobol_first` | share of the prediction's variance from the group alone | |
    /// | `sobol_total` | share of the prediction's variance from the group and all its interactions | |
    ///
    /// `permutation` permutes blocks of length `block_s`, because permuting single samples would turn a slow signal
    /// into noise. A constant error of the model has no effect. `shapley` and `expected_gradients` explain `samples`
    /// samples of the line relative to `background` samples of the line, both evenly spaced. Shapley values of linear
    /// models and of trees are exact. For other models, Shapley values are estimated by sampling, and `error` is the
    /// mean standard error of the estimates. Samples that `where` omits, or that lack an input or the target, are
    /// ignored. A line that is too short for the method is rejected.
    ///
    /// For `shapley` and `expected_gradients`, up to `kept_samples` samples are stored. The list `sample_values` holds
    /// the contribution of the group to the prediction for each of these samples, and `sample_inputs` holds the value
    /// of the input. `sample_inputs` is NaN for a group of several inputs. The report plots both lists for all lines
    /// together, like the beeswarm plot of the SHAP package.
    ///
    /// `morris` and the Sobol indices vary all inputs independently over their ranges. The range of an input is from
    /// the quantile `tails` to the quantile 1 - `tails` of its values on the line. Correlated inputs then take
    /// combinations that do not occur in the data. The values therefore describe the model over the ranges, not its
    /// behaviour on the line. The shares of correlated inputs do not add up to the variance of the prediction on the
    /// line. An input that is constant on the line has an importance of 0. `error` is the standard error; `low` and
    /// `high` are the bounds of a Sobol index's 95 % bootstrap interval. A first-order index below the total index of
    /// the same group indicates interactions. With `morris`, a group of several inputs has no `spread`.
    ///
    /// To compute the increase in error when an input is dropped and the model is refitted, use a sweep. Its axis holds
    /// all subsets of `entries` or `inputs` of the fit that lack at most one input: `{ subsets_of = [...], at_least = n
    /// - 1 }`. A sweep over `seed` of the fit gives the spread over seeds.
    ///
    /// Source: Breiman 2001; Lundberg & Lee 2017; Lundberg et al. 2020; Erion et al. 2021; Blumensath & Davies 2010;
    /// Morris 1991; Campolongo, Cariboni & Saltelli 2007; Sobol 2001; Jansen 1999; Saltelli et al. 2010; Gnadt 2022,
    /// section 4.8 and (4.10).
    Importance = "importance", version 2, grain Line, yields Scores, role RanksInputs,
    inputs [input: Lines, model: Model],
    example r#"
[[stages]]
name    = "importance"
stage   = "importance"
input   = "a_matrix"
model   = "fit"
target  = "mag_4_uc"
block_s = 1.0
"#;
    /// Target of the fitted model, such as `mag_4_uc`.
    target: String, unit "nT";
    /// Method that computes the importance.
    method: ImportanceMethod, unit "", default ImportanceMethod::Permutation;
    /// Groups of entries, each given by a name or a prefix. A prefix is the part of a name before a `_`, such as
    /// `TL_A_flux_a`. It selects all names that begin with this part.
    groups: Vec<String>, unit "", default Vec::<String>::new();
    /// Length of the permuted blocks. The length must exceed the correlation times of the target and the inputs.
    block_s: f64, unit "s", default 30.0, rule Rule::Positive;
    /// Number of repeats of the permutation.
    repeats: usize, unit "1", default 10usize, rule Rule::Between(1.0, 10_000.0);
    /// Number of samples of each line for which contributions are computed.
    samples: usize, unit "samples", default 200usize, rule Rule::Between(2.0, 1e6);
    /// Number of background samples of each line, relative to which contributions are computed.
    background: usize, unit "samples", default 50usize, rule Rule::Between(1.0, 1e5);
    /// Number of random orders in which the groups change from the values of a background sample to the values of a
    /// sample, for each pair of the two. Each order is also used in reverse. With `expected_gradients`: number of
    /// gradients per sample, divided by the number of background samples.
    draws: usize, unit "1", default 2usize, rule Rule::Between(2.0, 1e5);
    /// Number of explained samples whose values are stored, evenly spaced. 0 stores none.
    kept_samples: usize, unit "samples", default 100usize, rule Rule::Between(0.0, 10_000.0);
    /// Number of entries in the linear model of `hard_thresholding`.
    terms: usize, unit "1", default 10usize, rule Rule::Between(1.0, 10_000.0);
    /// Number of trajectories of `morris`. Each trajectory requires (number of groups + 1) predictions.
    trajectories: usize, unit "1", default 200usize, rule Rule::Between(2.0, 1e6);
    /// Number of levels of each input in `morris`, an even number.
    levels: usize, unit "1", default 4usize, rule Rule::Between(2.0, 1000.0);
    /// Number of rows in each of the two random matrices for a Sobol index. The model predicts (number of groups + 2)
    /// times this number of rows. Errors are proportional to the inverse square root of `points`.
    points: usize, unit "1", default 2000usize, rule Rule::Between(2.0, 1e6);
    /// Fraction of an input's values on the line that lie outside its range at each end. 0 uses the extremes.
    tails: f64, unit "1", default 0.01, rule Rule::Between(0.0, 0.49);
    /// Seed of the random draws.
    seed: usize, unit "", default 0usize;
}

impl Stage for Importance {
    fn effort(&self) -> f64 {
        match self.method {
            ImportanceMethod::Morris => self.trajectories as f64,
            ImportanceMethod::SobolFirst | ImportanceMethod::SobolTotal => self.points as f64,
            _ => self.repeats as f64,
        }
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let lines = shape(inputs, 0)?;
        let Some(Table::Model { features, shape }) = inputs.get(1) else {
            return Err(vec![Fault::new("`model` is not a model table").of_param("model")]);
        };
        if shape.get("term").is_none() {
            return Err(vec![
                Fault::new("`model` has no column `term`").help("name the table of a stage `fit`").of_param("model"),
            ]);
        }
        let mut faults = faults_of([lines.number(&self.target, "nT")], "target");
        for feature in features {
            if let Err(fault) = lines.need(feature) {
                let what = format!("the model was fitted with `{feature}`, but {}", fault.what);
                faults.push(Fault { what, ..fault }.of_param("input"));
            }
        }
        if let Some((_, name)) = self.groups.iter().enumerate().find(|(i, name)| self.groups[..*i].contains(name)) {
            faults.push(Fault::new(format!("duplicate group `{name}`")).of_param("groups"));
        }
        if self.method == ImportanceMethod::Morris && self.levels % 2 == 1 {
            faults.push(Fault::new(format!("`levels` must be even, not {}", self.levels)).of_param("levels"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned(), self.target.clone()];
        reads.extend(features.iter().cloned());
        let of_model: Vec<&str> = ["term", "value"].into_iter().chain(shape.get(RATE).map(|_| RATE)).collect();
        let made = |c: Column| c.from(0, &reads).from(1, &of_model);
        let mut columns = vec![
            made(Column::text("flight", "flight identifier").role(Role::Key)),
            made(Column::text("line", "line identifier").role(Role::Key)),
            made(Column::text("method", "method").role(Role::Key)),
            made(Column::text("group", "group of inputs, or input").role(Role::Key)),
            made(Column::float("value", "", "importance of the group")),
            made(Column::float("spread", "", "standard deviation of the averaged values; null for a correlation")),
            made(Column::float("error", "", "standard error of a sample's value from random sampling")),
            made(Column::text("unit", "unit of value, spread and error")),
            made(Column::integer("n", "", "number of repeats, samples or networks used")),
        ];
        if self.method.is_share() {
            columns.push(made(Column::float("low", "1", "lower bound of the 95 % interval of the index")));
            columns.push(made(Column::float("high", "1", "upper bound of the 95 % interval of the index")));
        }
        if let Some(kept) = self.kept() {
            let names = || (1..=kept).map(|sample| sample.to_string()).collect();
            let of = |name: &str, unit: &str, what: &str| made(Column::list(name, unit, what, names()));
            columns.push(of("sample_values", "nT", "contribution to the prediction, for some samples"));
            columns.push(of(
                "sample_inputs",
                "",
                "value of the input for these samples, in its unit; NaN for a group of several",
            ));
        }
        let mut yields = StageSchema::append(columns, &reads);
        yields.passes = PassThroughColumns::None;
        yields.reads.push(of_model.into_iter().map(str::to_owned).collect());
        Ok(yields)
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let needs = |methods: &str| Some(Fault::new(format!("`{key}` has no effect without the method {methods}")));
        let (permuted, explained) = (self.method == ImportanceMethod::Permutation, self.method.explains_samples());
        let screened = self.method == ImportanceMethod::Morris;
        let ranged = screened || self.method.is_share();
        match key {
            "block_s" | "repeats" if !permuted => needs("`permutation`"),
            "terms" if self.method != ImportanceMethod::HardThresholding => needs("`hard_thresholding`"),
            "samples" | "background" | "draws" | "kept_samples" if !explained => {
                needs("`shapley` or `expected_gradients`")
            }
            "trajectories" | "levels" if !screened => needs("`morris`"),
            "points" if !self.method.is_share() => needs("`sobol_first` or `sobol_total`"),
            "tails" if !ranged => needs("`morris`, `sobol_first` or `sobol_total`"),
            "seed" if !permuted && !explained && !ranged => {
                needs("`permutation`, `shapley`, `expected_gradients`, `morris`, `sobol_first` or `sobol_total`")
            }
            _ => None,
        }
    }
}

impl LineStage for Importance {
    type Prepared = FittedModel;

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<FittedModel, Fault> {
        let fitted = FittedModel::read(inputs.get(1).ok_or_else(|| Fault::data("the model is missing"))?, &[])?;
        // A model of a window of samples is rejected, because samples are permuted without their predecessors.
        if matches!(&fitted.body, FittedModelForm::Learned(learned) if learned.sees_a_window()) {
            let what = "the model uses a window of samples, but `importance` requires a model of single samples";
            return Err(Fault::data(what).of_param("model"));
        }
        Ok(fitted)
    }

    fn prepare_key(&self) -> String {
        String::new()
    }

    fn run(&self, line: &LineInput, fitted: &FittedModel) -> LineOutput {
        let rows = ImportanceRows::new(self, line, fitted)?;
        let (names, groups) = self.grouped(&fitted.columns())?;
        let LineImportance { weights: found, samples, intervals } = self.weights(&rows, fitted, &groups)?;
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; names.len()])) };
        let figure = |of: fn(&GroupImportance) -> f64| array(found.iter().map(of).collect());
        let mut arrays = vec![
            same(&line.flight),
            same(&line.line),
            same(self.method.word()),
            Arc::new(StringArray::from(names.clone())),
            figure(|w| w.value),
            figure(|w| w.spread),
            figure(|w| w.error),
            same(self.method.unit()),
            Arc::new(Int64Array::from_iter_values(found.iter().map(|w| w.n as i64))),
        ];
        if let Some(intervals) = intervals {
            arrays.extend([0, 1].map(|bound| array(intervals.iter().map(|interval| interval[bound]).collect())));
        }
        if let (Some(kept), Some(samples)) = (self.kept(), samples) {
            let [values, inputs] = samples.lists(kept, &groups);
            arrays.extend([list(values, kept)?, list(inputs, kept)?]);
        }
        Ok(arrays)
    }
}

impl Importance {
    /// Length of the lists of samples. `None` if there are no lists.
    fn kept(&self) -> Option<usize> {
        let kept = self.kept_samples.min(self.samples);
        (self.method.explains_samples() && kept > 0).then_some(kept)
    }
}
