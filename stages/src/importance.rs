//! Which inputs matter to a model.

#[cfg(test)]
mod tests;
mod weights;

use std::sync::Arc;

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use schemas::{Arrays, Column, Fault, LineIn, LineStage, Passes, Role, Rule, Stage, Table, Yield, choice, stage};
use weights::{Found, Rows, Weight};

use crate::{
    columns::{array, faults_of, list, shape},
    fitted::{Body, Fitted},
    model_columns::RATE,
};

choice! {
    /// How it is found what an input matters.
    pub enum Method {
        /// By how much the mean square error grows when the group's blocks of time are exchanged.
        Permutation = "permutation",
        /// The mean absolute Shapley value of the samples.
        Shapley = "shapley",
        /// The mean absolute expected gradient of the samples; not of trees, which have no gradient.
        ExpectedGradients = "expected_gradients",
        /// Pearson's correlation with the target, of the entry of the group where it is largest; the model does not matter.
        Pearson = "pearson",
        /// Spearman's rank correlation with the target, of the entry of the group where it is largest; the model does not
        /// matter.
        Spearman = "spearman",
        /// The coefficients of the linear model of `terms` entries that explains the target best, by iterative hard
        /// thresholding; the model does not matter.
        HardThresholding = "hard_thresholding",
        /// The weights of a network's first layer, which a sparse group lasso (`group_lasso` of `fit`) makes small where an
        /// input does not matter.
        GroupLasso = "group_lasso",
    }
}

impl Method {
    /// Whether it gives each sample its own value.
    fn explains_samples(self) -> bool {
        match self {
            Method::Shapley | Method::ExpectedGradients => true,
            Method::Permutation
            | Method::Pearson
            | Method::Spearman
            | Method::HardThresholding
            | Method::GroupLasso => false,
        }
    }

    /// The unit of its values.
    fn unit(self) -> &'static str {
        match self {
            Method::Permutation => "nT2",
            Method::Shapley | Method::ExpectedGradients | Method::HardThresholding => "nT",
            Method::Pearson | Method::Spearman | Method::GroupLasso => "1",
        }
    }
}

stage! {
    /// Finds how much each input matters to a fitted model on each line: a row for each group of inputs, with `value` and,
    /// for what is a mean, the `spread` behind it. Models of all kinds are explained, by their predictions alone.
    ///
    /// Every entry of the features that the model uses is a separate group, except those that `groups` combines.
    /// Correlated inputs share or mask importance: put the inputs of one sensor into one group.
    ///
    /// | `method` | `value` | `spread` |
    /// |---|---|---|
    /// | `permutation` | by how much the mean square error against `target` grows, nT2 | of the repeats |
    /// | `shapley` | mean absolute part of the prediction, nT | of the samples |
    /// | `expected_gradients` | the same by gradients, nT | of the samples |
    /// | `pearson`, `spearman` | correlation with `target` | |
    /// | `hard_thresholding` | coefficient of the standardised entry, nT; 0 for those left out | |
    /// | `group_lasso` | size of an input's weights times its deviation on the line, 1 | of the networks of an ensemble |
    ///
    /// Blocks of `block_s` are exchanged, never single samples, which would make noise of a slow signal; the mean of what the
    /// model misses of the target does not count. `shapley` and
    /// `expected_gradients` explain `samples` of the line against `background` samples of it, both evenly spread; Shapley
    /// values of linear models and of trees are exact, others are sampled, with `error` as the mean standard error of a value
    /// that is due to that. Samples without a value in an input or the target, and those that `where` leaves out, do not
    /// count. A line that is too short is refused.
    ///
    /// For `shapley` and `expected_gradients` the lists `sample_values` and `sample_inputs` hold `kept_samples` of the
    /// samples. They are the part of the prediction, and the value of the input, NaN for a group of several. The report
    /// draws them as the beeswarm of the SHAP package, of all lines together.
    ///
    /// By how much the error grows when an input is dropped and the model refitted is a sweep: an axis of all subsets that lack
    /// one at most, `{ subsets_of = [...], at_least = n - 1 }`, as `entries` or `inputs` of the fit; a sweep over `seed` of the fit
    /// gives the spread over seeds.
    ///
    /// Source: Breiman 2001; Lundberg & Lee 2017; Lundberg et al. 2020; Erion et al. 2021; Blumensath & Davies 2010; thesis 000,
    /// section 4.3 and (4.10).
    Importance = "importance", version 2, grain Line, yields Scores, inputs [input: Lines, model: Model],
    example r#"
[[stages]]
name    = "importance"
stage   = "importance"
input   = "a_matrix"
model   = "fit"
target  = "mag_4_uc"
block_s = 1.0
"#;
    /// Signal that the model was fitted to, such as `mag_4_uc`.
    target: String, unit "nT";
    /// How it is found.
    method: Method, unit "", default Method::Permutation;
    /// Entries that are one group: their name, or what their names have before a `_`, such as `TL_A_flux_a`.
    groups: Vec<String>, unit "", default Vec::<String>::new();
    /// The length of the blocks that are exchanged: longer than the target and the inputs take to change.
    block_s: f64, unit "s", default 30.0, rule Rule::Positive;
    /// Number of exchanges.
    repeats: usize, unit "1", default 10usize, rule Rule::Between(1.0, 10_000.0);
    /// How many samples of a line are explained.
    samples: usize, unit "samples", default 200usize, rule Rule::Between(2.0, 1e6);
    /// How many samples they are compared with.
    background: usize, unit "samples", default 50usize, rule Rule::Between(1.0, 1e5);
    /// Number of orders of the groups, each with its reverse, drawn for each sample and background sample. Gradients
    /// are computed at `draws` times `background` points.
    draws: usize, unit "1", default 2usize, rule Rule::Between(2.0, 1e5);
    /// How many of the explained samples are kept one by one, evenly spread; 0 keeps none.
    kept_samples: usize, unit "samples", default 100usize, rule Rule::Between(0.0, 10_000.0);
    /// How many entries the linear model of `hard_thresholding` has.
    terms: usize, unit "1", default 10usize, rule Rule::Between(1.0, 10_000.0);
    /// The seed of what is drawn.
    seed: usize, unit "", default 0usize;
}

impl Stage for Importance {
    fn effort(&self) -> f64 {
        self.repeats as f64
    }

    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let lines = shape(inputs, 0)?;
        let Some(Table::Model { features, shape }) = inputs.get(1) else {
            return Err(vec![Fault::new("`model` is not a model table").of_param("model")]);
        };
        if shape.get("term").is_none() {
            return Err(vec![Fault::new("`model` has no terms").help("name the table of a `fit`").of_param("model")]);
        }
        let mut faults = faults_of([lines.number(&self.target, "nT")], "target");
        for feature in features {
            if let Err(fault) = lines.need(feature) {
                let what = format!("the model was fitted on `{feature}`, and {}", fault.what);
                faults.push(Fault { what, ..fault }.of_param("input"));
            }
        }
        if let Some((_, name)) = self.groups.iter().enumerate().find(|(i, name)| self.groups[..*i].contains(name)) {
            faults.push(Fault::new(format!("duplicate group `{name}`")).of_param("groups"));
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
            made(Column::text("method", "how it was found").role(Role::Key)),
            made(Column::text("group", "the group of inputs, or the input").role(Role::Key)),
            made(Column::float("value", "", "how much it matters")),
            made(Column::float("spread", "", "standard deviation behind a mean; null of a correlation")),
            made(Column::float("error", "", "standard error of a sample's value that is due to sampling")),
            made(Column::text("unit", "the unit of these")),
            made(Column::integer("n", "", "repeats, samples or networks behind it")),
        ];
        if let Some(kept) = self.kept() {
            let names = || (1..=kept).map(|sample| sample.to_string()).collect();
            let of = |name: &str, unit: &str, what: &str| made(Column::list(name, unit, what, names()));
            columns.push(of("sample_values", "nT", "part of the prediction of some samples"));
            columns.push(of("sample_inputs", "", "the input of these samples, in its unit; NaN of a group of several"));
        }
        let mut yields = Yield::append(columns, &reads);
        yields.passes = Passes::None;
        yields.reads.push(of_model.into_iter().map(str::to_owned).collect());
        Ok(yields)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let needs = |methods: &str| Some(Fault::new(format!("`{key}` has no effect without the method {methods}")));
        let (permuted, explained) = (self.method == Method::Permutation, self.method.explains_samples());
        match key {
            "block_s" | "repeats" if !permuted => needs("`permutation`"),
            "terms" if self.method != Method::HardThresholding => needs("`hard_thresholding`"),
            "samples" | "background" | "draws" | "kept_samples" if !explained => {
                needs("`shapley` or `expected_gradients`")
            }
            "seed" if !permuted && !explained => needs("`permutation`, `shapley` or `expected_gradients`"),
            _ => None,
        }
    }
}

impl LineStage for Importance {
    type Prepared = Fitted;

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Fitted, Fault> {
        let fitted = Fitted::read(inputs.get(1).ok_or_else(|| Fault::data("the model is missing"))?, &[])?;
        // Samples are exchanged one by one, without those before them.
        if matches!(&fitted.body, Body::Learned(learned) if learned.sees_a_window()) {
            let what = "the model sees a window of samples, and importance is of models that see one at a time";
            return Err(Fault::data(what).of_param("model"));
        }
        Ok(fitted)
    }

    fn prepare_key(&self) -> String {
        String::new()
    }

    fn run(&self, line: &LineIn, fitted: &Fitted) -> Arrays {
        let rows = Rows::of(self, line, fitted)?;
        let (names, groups) = self.grouped(&fitted.columns())?;
        let Found { weights: found, samples } = self.weights(&rows, fitted, &groups)?;
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; names.len()])) };
        let figure = |of: fn(&Weight) -> f64| array(found.iter().map(of).collect());
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
        if let (Some(kept), Some(samples)) = (self.kept(), samples) {
            let [values, inputs] = samples.lists(kept, &groups);
            arrays.extend([list(values, kept)?, list(inputs, kept)?]);
        }
        Ok(arrays)
    }
}

impl Importance {
    /// The length of the lists of samples.
    fn kept(&self) -> Option<usize> {
        let kept = self.kept_samples.min(self.samples);
        (self.method.explains_samples() && kept > 0).then_some(kept)
    }
}
