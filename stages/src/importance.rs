//! Which inputs matter to a model.

use std::{convert::Infallible, fmt::Display, sync::Arc};

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use learning::importance::{
    Attributions, Blocks, Permuted, Sampling, expected_gradients, pearson, permutation, shapley_linear,
    shapley_sampled, shapley_trees, spearman,
};
use numerics::regression::statistics;
use schemas::{Arrays, Column, Fault, LineIn, LineStage, Passes, Role, Rule, Stage, Table, Yield, choice, stage};

use crate::{
    columns::{array, data, even_rate_hz, faults_of, floats, shape},
    fitted::{Body, Fitted},
    trained::Learned,
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
    }
}

stage! {
    /// Finds how much each input matters to a fitted model on each line: a row for each group of inputs, with `value` and,
    /// for what is a mean, the `spread` behind it. Models of all kinds are explained, by their predictions alone.
    ///
    /// Every entry of the features that the model uses is a group by itself, but for those that `groups` put together.
    /// Inputs that say the same share what they matter or hide it from each other: put what comes of one sensor into one
    /// group.
    ///
    /// | `method` | `value` | `spread` |
    /// |---|---|---|
    /// | `permutation` | by how much the mean square error against `target` grows, nT2 | of the repeats |
    /// | `shapley` | mean absolute part of the prediction, nT | of the samples |
    /// | `expected_gradients` | the same by gradients, nT | of the samples |
    /// | `pearson`, `spearman` | correlation with `target` | |
    ///
    /// Blocks of `block_s` are exchanged, never single samples, which would make noise of a slow signal; the mean of what the
    /// model misses of the target does not count. `shapley` and
    /// `expected_gradients` explain `samples` of the line against `background` samples of it, both evenly spread; Shapley
    /// values of linear models and of trees are exact, others are sampled, with `error` as the mean standard error of a value
    /// that is due to that. Samples without a value in an input or the target, and those that `where` leaves out, do not
    /// count. A line that is too short is refused.
    ///
    /// Source: Breiman 2001; Lundberg & Lee 2017; Lundberg et al. 2020; Erion et al. 2021; thesis 000, section 4.3.
    Importance = "importance", version 1, grain Line, yields Scores, inputs [input: Lines, model: Model],
    example r#"
[[stages]]
name    = "importance"
stage   = "importance"
input   = "a_matrix"
model   = "fit"
target  = "mag_4_uc"
block_s = 1.0
"#;
    /// What the model was fitted to explain, such as `mag_4_uc`.
    target: String, unit "nT";
    /// How it is found.
    method: Method, unit "", default Method::Permutation;
    /// Entries that are one group: their name, or what their names have before a `_`, such as `TL_A_flux_a`.
    groups: Vec<String>, unit "", default Vec::<String>::new();
    /// The length of the blocks that are exchanged: longer than the target and the inputs take to change.
    block_s: f64, unit "s", default 30.0, rule Rule::Positive;
    /// How often they are exchanged.
    repeats: usize, unit "1", default 10usize, rule Rule::Between(1.0, 10_000.0);
    /// How many samples of a line are explained.
    samples: usize, unit "samples", default 200usize, rule Rule::Between(2.0, 1e6);
    /// How many samples they are compared with.
    background: usize, unit "samples", default 50usize, rule Rule::Between(1.0, 1e5);
    /// How many orders of the groups, each with its reverse, are drawn for each sample and background sample; so many times
    /// `background` points have a gradient.
    draws: usize, unit "1", default 2usize, rule Rule::Between(2.0, 1e5);
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
        let made = |c: Column| c.from(0, &reads).from(1, &["term", "value"]);
        let columns = vec![
            made(Column::text("flight", "flight identifier").role(Role::Key)),
            made(Column::text("line", "line identifier").role(Role::Key)),
            made(Column::text("method", "how it was found").role(Role::Key)),
            made(Column::text("group", "the group of inputs, or the input").role(Role::Key)),
            made(Column::float("value", "", "how much it matters")),
            made(Column::float("spread", "", "standard deviation behind a mean; null of a correlation")),
            made(Column::float("error", "", "standard error of a sample's value that is due to sampling")),
            made(Column::text("unit", "the unit of these")),
            made(Column::integer("n", "", "repeats, or samples behind it")),
        ];
        let mut yields = Yield::append(columns, &reads);
        yields.passes = Passes::None;
        yields.reads.push(["term", "value"].map(str::to_owned).to_vec());
        Ok(yields)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let needs = |methods: &str| Some(Fault::new(format!("`{key}` has no effect without the method {methods}")));
        let (permuted, explained) = match self.method {
            Method::Permutation => (true, false),
            Method::Shapley | Method::ExpectedGradients => (false, true),
            Method::Pearson | Method::Spearman => (false, false),
        };
        match key {
            "block_s" | "repeats" if !permuted => needs("`permutation`"),
            "samples" | "background" | "draws" if !explained => needs("`shapley` or `expected_gradients`"),
            "seed" if !permuted && !explained => needs("`permutation`, `shapley` or `expected_gradients`"),
            _ => None,
        }
    }
}

/// What a group matters.
struct Weight {
    value: f64,
    spread: f64,
    error: f64,
    n: usize,
}

/// The rows of a line that count.
struct Rows {
    x: Vec<f64>,
    y: Vec<f64>,
    width: usize,
    rate_hz: f64,
}

impl Rows {
    fn of(stage: &Importance, line: &LineIn, fitted: &Fitted) -> Result<Self, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage without an input"))?;
        let (tt, target) = (floats(batch, "tt")?, floats(batch, &stage.target)?);
        let inputs = fitted.inputs(batch)?;
        let kept = |row: usize| line.keep.as_ref().is_none_or(|keep| keep.get(row).copied().unwrap_or(false));
        let value = |column: &Vec<f64>, row: usize| column.get(row).copied().unwrap_or(f64::NAN);
        let whole =
            |row: &usize| kept(*row) && target[*row].is_finite() && inputs.iter().all(|c| value(c, *row).is_finite());
        let rows: Vec<usize> = (0..target.len()).filter(whole).collect();
        if rows.len() < 2 {
            return Err(Fault::data("no two samples of the line have the target and all inputs of the model"));
        }
        let x = rows.iter().flat_map(|&row| inputs.iter().map(move |c| value(c, row))).collect();
        let y = rows.iter().map(|&row| target[row]).collect();
        Ok(Self { x, y, width: inputs.len(), rate_hz: even_rate_hz(tt)? })
    }

    /// Some of the rows, evenly spread.
    fn spread(&self, most: usize) -> Vec<f64> {
        let (rows, count) = (self.y.len(), self.y.len().min(most));
        let at = (0..count).map(|k| (2 * k + 1) * rows / (2 * count));
        at.flat_map(|row| self.x[row * self.width..(row + 1) * self.width].iter().copied()).collect()
    }

    fn column(&self, at: usize) -> Vec<f64> {
        self.x.iter().skip(at).step_by(self.width.max(1)).copied().collect()
    }
}

impl Importance {
    /// The groups of entries: those that are named, then every other entry by itself.
    fn grouped(&self, columns: &[String]) -> Result<(Vec<String>, Vec<Vec<usize>>), Fault> {
        let mut left: Vec<bool> = vec![true; columns.len()];
        let (mut names, mut groups) = (vec![], vec![]);
        for group in &self.groups {
            let is_of = |name: &String| {
                name == group || name.strip_prefix(group.as_str()).is_some_and(|rest| rest.starts_with('_'))
            };
            let own: Vec<usize> = (0..columns.len()).filter(|&i| is_of(&columns[i])).collect();
            let wrong = |what: String| Fault::data(what).of_param("groups");
            if own.is_empty() {
                return Err(wrong(format!("the model has no input `{group}`")).nearest(group, columns));
            }
            if let Some(&i) = own.iter().find(|&&i| !left[i]) {
                return Err(wrong(format!("`{}` is in two groups", columns[i])));
            }
            own.iter().for_each(|&i| left[i] = false);
            names.push(group.clone());
            groups.push(own);
        }
        for i in (0..columns.len()).filter(|&i| left[i]) {
            names.push(columns[i].clone());
            groups.push(vec![i]);
        }
        if groups.is_empty() { Err(Fault::data("the model has no inputs")) } else { Ok((names, groups)) }
    }

    fn weights(&self, rows: &Rows, fitted: &Fitted, groups: &[Vec<usize>]) -> Result<Vec<Weight>, Fault> {
        match self.method {
            Method::Permutation => self.permuted(rows, fitted, groups),
            Method::Shapley => Ok(of_rows(&self.shapley(rows, fitted, groups)?, groups.len())),
            Method::ExpectedGradients => Ok(of_rows(&self.gradients(rows, fitted, groups)?, groups.len())),
            Method::Pearson => Ok(correlations(rows, groups, pearson)),
            Method::Spearman => Ok(correlations(rows, groups, spearman)),
        }
    }

    fn permuted(&self, rows: &Rows, fitted: &Fitted, groups: &[Vec<usize>]) -> Result<Vec<Weight>, Fault> {
        let predict = |x: &[f64]| Ok::<_, Infallible>(fitted.field_nt(x));
        let block = (self.block_s * rows.rate_hz).round().max(1.0) as usize;
        let blocks = Blocks { rows: block, repeats: self.repeats, seed: self.seed as u64 };
        // As where lines are left out in `fit`, the mean of what the model misses does not count.
        let missed: Vec<f64> = rows.y.iter().zip(fitted.field_nt(&rows.x)).map(|(y, f)| y - f).collect();
        let mean = statistics::mean(&missed).value;
        let y: Vec<f64> = rows.y.iter().map(|y| y - mean).collect();
        let found = permutation(&predict, &rows.x, rows.width, &y, groups, &blocks);
        let Permuted { increases, .. } = found.map_err(|e| refused(e).of_param("block_s"))?;
        let one = |repeats: &Vec<f64>| Weight {
            value: statistics::mean(repeats).value,
            spread: statistics::std(repeats).value,
            error: f64::NAN,
            n: repeats.len(),
        };
        Ok(increases.iter().map(one).collect())
    }

    fn shapley(&self, rows: &Rows, fitted: &Fitted, groups: &[Vec<usize>]) -> Result<Attributions, Fault> {
        let (some, background) = (rows.spread(self.samples), rows.spread(self.background));
        if let Some((coefficients, _)) = fitted.coefficients() {
            let width = rows.width.max(1);
            let mean = |j: usize| {
                statistics::mean(&background.iter().skip(j).step_by(width).copied().collect::<Vec<_>>()).value
            };
            let means: Vec<f64> = (0..width).map(mean).collect();
            return shapley_linear(&coefficients, &some, &means, groups).map_err(refused);
        }
        if let Body::Learned(learned) = &fitted.body
            && let Learned::BoostedTrees(trees) = learned.as_ref()
        {
            return shapley_trees(trees.forest(), &some, &background, rows.width, groups).map_err(refused);
        }
        let predict = |x: &[f64]| Ok::<_, Infallible>(fitted.field_nt(x));
        let sampling = Sampling { samples: self.draws, seed: self.seed as u64 };
        shapley_sampled(&predict, &some, &background, rows.width, groups, &sampling).map_err(refused)
    }

    fn gradients(&self, rows: &Rows, fitted: &Fitted, groups: &[Vec<usize>]) -> Result<Attributions, Fault> {
        let gradient = |x: &[f64]| match (&fitted.body, fitted.coefficients()) {
            (_, Some((b, _))) => Ok(b.repeat(x.len() / b.len().max(1))),
            (Body::Learned(learned), None) => {
                let none =
                    || Fault::data("the model has no gradient").help("take the method `shapley`").of_param("method");
                learned.gradient(x).ok_or_else(none)
            }
            (Body::Linear { .. }, None) => Err(Fault::bug("a linear model without coefficients")),
        };
        let (some, background) = (rows.spread(self.samples), rows.spread(self.background));
        let samples = self.draws.saturating_mul(background.len() / rows.width.max(1));
        let sampling = Sampling { samples, seed: self.seed as u64 };
        let found = expected_gradients(&gradient, &some, &background, rows.width, groups, &sampling);
        found.map_err(|e| match e {
            learning::importance::ImportanceError::Model(fault) => fault,
            other => refused(other),
        })
    }
}

fn refused(e: impl Display) -> Fault {
    data(e)
}

/// The mean absolute value of each group over the rows.
fn of_rows(found: &Attributions, groups: usize) -> Vec<Weight> {
    let of =
        |values: &[f64], g: usize| -> Vec<f64> { values.iter().skip(g).step_by(groups).map(|v| v.abs()).collect() };
    let one = |g: usize| {
        let values = of(&found.values, g);
        let (value, spread) = (statistics::mean(&values).value, statistics::std(&values).value);
        Weight { value, spread, error: statistics::mean(&of(&found.errors, g)).value, n: values.len() }
    };
    (0..groups).map(one).collect()
}

/// The correlation with the target of that entry of each group that has the largest; NaN where all are constant.
fn correlations(rows: &Rows, groups: &[Vec<usize>], of: fn(&[f64], &[f64]) -> statistics::Figure) -> Vec<Weight> {
    let one = |group: &Vec<usize>| {
        let all = group.iter().map(|&j| of(&rows.column(j), &rows.y).value).filter(|c| c.is_finite());
        let value = all.reduce(|a, b| if b.abs() > a.abs() { b } else { a }).unwrap_or(f64::NAN);
        Weight { value, spread: f64::NAN, error: f64::NAN, n: rows.y.len() }
    };
    groups.iter().map(one).collect()
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
        let found = self.weights(&rows, fitted, &groups)?;
        let unit = match self.method {
            Method::Permutation => "nT2",
            Method::Shapley | Method::ExpectedGradients => "nT",
            Method::Pearson | Method::Spearman => "1",
        };
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; names.len()])) };
        let figure = |of: fn(&Weight) -> f64| array(found.iter().map(of).collect());
        Ok(vec![
            same(&line.flight),
            same(&line.line),
            same(self.method.word()),
            Arc::new(StringArray::from(names.clone())),
            figure(|w| w.value),
            figure(|w| w.spread),
            figure(|w| w.error),
            same(unit),
            Arc::new(Int64Array::from_iter_values(found.iter().map(|w| w.n as i64))),
        ])
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{cast::AsArray, types::Float64Type};

    use super::*;
    use crate::testing::{batch, line as line_of, said, sampled, table};

    fn importance(method: Method) -> Importance {
        Importance {
            target: "mag_4_uc".into(),
            method,
            groups: vec![],
            block_s: 1.0,
            repeats: 20,
            samples: 100,
            background: 40,
            draws: 2,
            seed: 0,
        }
    }

    const WAVES: [(&str, f64); 3] = [("cur_1", 1.9), ("cur_2", 3.1), ("vol", 4.7)];

    /// 400 s at 10 Hz: 5 cur_1 - 2 cur_2 + 100, without the third column.
    fn line() -> LineIn {
        let wave = |rate: f64| sampled(0.0, 10.0, 4000, |t| (rate * t + (0.01 * t).sin()).sin());
        let [a, b, _] = WAVES.map(|(_, rate)| wave(rate));
        let y = a.iter().zip(&b).map(|(a, b)| 5.0 * a - 2.0 * b + 100.0).collect();
        let mut columns = vec![("tt", "s", sampled(0.0, 10.0, 4000, |t| t)), ("mag_4_uc", "nT", y)];
        columns.extend(WAVES.map(|(name, rate)| (name, "A", wave(rate))));
        line_of(vec![batch(columns)])
    }

    fn model(terms: &[(&str, f64)]) -> RecordBatch {
        let names: ArrayRef = Arc::new(terms.iter().map(|(name, _)| Some(*name)).collect::<StringArray>());
        let values = array(terms.iter().map(|(_, value)| *value).collect());
        RecordBatch::try_from_iter([("term", names), ("value", values)]).unwrap()
    }

    const TERMS: [(&str, f64); 4] = [("cur_1", 5.0), ("cur_2", -2.0), ("vol", 0.0), ("intercept", 100.0)];

    fn run(stage: &Importance, terms: &[(&str, f64)]) -> Result<(Vec<String>, Vec<f64>), Fault> {
        let fitted = stage.prepare(&[line().inputs[0].slice(0, 0), model(terms)])?;
        let made = stage.run(&line(), &fitted)?;
        let names = made[3].as_string::<i32>().iter().map(|n| n.unwrap_or_default().to_owned()).collect();
        Ok((names, made[4].as_primitive::<Float64Type>().values().to_vec()))
    }

    fn near(found: &[f64], truth: &[f64], part: f64) {
        let scale = truth.iter().fold(0.0f64, |s, t| s.max(t.abs()));
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < part * scale), "{found:?} {truth:?}");
    }

    #[test]
    fn law_a_linear_model_of_sines_has_the_importance_worked_out_by_hand() {
        // Twice the variance, 25/2 and 4/2; the mean absolute sine is 2/π.
        near(&run(&importance(Method::Permutation), &TERMS).unwrap().1, &[25.0, 4.0, 0.0], 0.08);
        let mean = 2.0 / std::f64::consts::PI;
        for method in [Method::Shapley, Method::ExpectedGradients] {
            near(&run(&importance(method), &TERMS).unwrap().1, &[5.0 * mean, 2.0 * mean, 0.0], 0.08);
        }
        // Standard deviations 5 and 2 of independent parts: 5/√29 and −2/√29.
        for method in [Method::Pearson, Method::Spearman] {
            near(&run(&importance(method), &TERMS).unwrap().1, &[0.928, -0.371, 0.0], 0.06);
        }
    }

    #[test]
    fn unit_a_group_holds_all_entries_that_its_name_begins() {
        let grouped = Importance { groups: vec!["cur".into()], ..importance(Method::Permutation) };
        let (names, values) = run(&grouped, &TERMS).unwrap();
        assert_eq!(names, ["cur", "vol"]);
        near(&values, &[29.0, 0.0], 0.08);
        let lacking = Importance { groups: vec!["flux".into()], ..importance(Method::Permutation) };
        let fault = run(&lacking, &TERMS).err().unwrap();
        assert_eq!((fault.what.as_str(), fault.param.as_deref()), ("the model has no input `flux`", Some("groups")));
        let twice = Importance { groups: vec!["cur".into(), "cur_1".into()], ..importance(Method::Permutation) };
        assert_eq!(run(&twice, &TERMS).err().unwrap().what, "`cur_1` is in two groups");
    }

    #[test]
    fn unit_trees_are_explained_exactly_and_have_no_gradient() {
        let stump = [
            ("family boosted_trees", 1.0),
            ("input[1] cur_1", 1.0),
            ("input[2] vol", 1.0),
            ("base", 100.0),
            ("nodes[1]", 3.0),
            ("split[1,1] cur_1", 0.0),
            ("left[1,1]", 2.0),
            ("leaf[1,2]", -4.0),
            ("leaf[1,3]", 4.0),
        ];
        // Either 4 or -4, the mean of the background being near 0.
        near(&run(&importance(Method::Shapley), &stump).unwrap().1, &[4.0, 0.0], 0.06);
        let fault = run(&importance(Method::ExpectedGradients), &stump).err().unwrap();
        assert_eq!((fault.what.as_str(), fault.param.as_deref()), ("the model has no gradient", Some("method")));
        let sampled = run(&importance(Method::Permutation), &stump).unwrap().1;
        assert!(sampled[0] > 5.0 && sampled[1] == 0.0, "{sampled:?}");
    }

    #[test]
    fn unit_what_cannot_be_explained_is_told_with_its_parameter() {
        let long = Importance { block_s: 400.0, ..importance(Method::Permutation) };
        let fault = run(&long, &TERMS).err().unwrap();
        assert!(fault.what.contains("fewer than two blocks") && fault.param.as_deref() == Some("block_s"), "{fault}");
        let shape = |columns: Vec<Column>| schemas::Shape { columns, rate_hz: None };
        let fitted = Table::Model {
            shape: shape(vec![Column::text("term", ""), Column::float("value", "", "")]),
            features: vec!["tl".into()],
        };
        let stage = Importance { groups: vec!["a".into(), "a".into()], ..importance(Method::Pearson) };
        let lines = table(&[("tt", "s"), ("mag_4_uc", "s")], None);
        let faults = said(stage.yields(&[&lines, &fitted]).unwrap_err());
        assert!(["[target]", "`tl`", "duplicate group `a`"].iter().all(|part| faults.contains(part)), "{faults}");
        assert!(stage.idle("block_s").is_some() && stage.idle("groups").is_none());
    }
}
