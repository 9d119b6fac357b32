//! Importance of groups of inputs on a line, by each method.

use std::fmt::Display;

use learning::{
    importance::{
        AttributionSampling, Attributions, ImportanceError, PermutationBlocks, PermutationImportance,
        expected_gradients, iterative_hard_thresholding, pearson, permutation, shapley_linear, shapley_sampled,
        shapley_trees, spearman,
    },
    network::NetworkForm,
};
use numerics::regression::statistics;
use schemas::{Fault, LineInput};

use super::{Importance, ImportanceMethod};
use crate::{
    columns::{data, even_rate_hz, floats},
    fitted::{FittedModel, FittedModelForm},
    trained::{LearnedModel, NetworkLayers, NetworkParts},
};

/// If the standard deviation of a column is below this fraction of its mean, its variation is rounding error.
const LEAST_DEVIATION: f64 = 1e-12;

/// Importance of a group.
pub struct GroupImportance {
    /// Value of the importance.
    pub value: f64,
    /// Standard deviation of the averaged values. NaN if there is none.
    pub spread: f64,
    /// Standard error from random sampling. NaN if there is none.
    pub error: f64,
    /// Number of repeats, samples or networks used.
    pub n: usize,
}

/// Results for a line.
pub struct LineImportance {
    /// Importance of each group.
    pub weights: Vec<GroupImportance>,
    /// Values of single samples, if the method explains samples.
    pub samples: Option<SampleAttributions>,
    /// 95 % bootstrap interval of each value, if the method has one.
    pub intervals: Option<Vec<[f64; 2]>>,
}

impl From<Vec<GroupImportance>> for LineImportance {
    fn from(weights: Vec<GroupImportance>) -> LineImportance {
        LineImportance { weights, samples: None, intervals: None }
    }
}

/// Explained samples.
pub struct SampleAttributions {
    /// Contribution of each group to the prediction of each sample, row-major.
    values: Vec<f64>,
    /// Inputs, row-major.
    x: Vec<f64>,
    width: usize,
}

impl SampleAttributions {
    /// Values and inputs of `kept` evenly spaced samples, group by group. The lists are padded with NaN if there are
    /// fewer samples. The inputs of a group of several inputs are NaN.
    pub fn lists(&self, kept: usize, groups: &[Vec<usize>]) -> [Vec<f64>; 2] {
        let count = self.x.len() / self.width.max(1);
        let shown = kept.min(count);
        let place = |k: usize| (k < shown).then(|| (2 * k + 1) * count / (2 * shown));
        let of = |table: &[f64], width: usize, column: Option<usize>| -> Vec<f64> {
            let value = |row: usize| column.and_then(|column| table.get(row * width + column).copied());
            (0..kept).map(|k| place(k).and_then(value).unwrap_or(f64::NAN)).collect()
        };
        let single = |group: &Vec<usize>| if let [column] = group[..] { Some(column) } else { None };
        let values = (0..groups.len()).flat_map(|g| of(&self.values, groups.len(), Some(g))).collect();
        [values, groups.iter().flat_map(|group| of(&self.x, self.width, single(group))).collect()]
    }
}

/// Used rows of a line.
pub struct ImportanceRows {
    x: Vec<f64>,
    y: Vec<f64>,
    pub(super) width: usize,
    rate_hz: f64,
}

impl ImportanceRows {
    /// Used rows of a line.
    ///
    /// # Errors
    /// Fails if the line lacks a column, is not evenly sampled, or has fewer than two such rows.
    pub fn new(stage: &Importance, line: &LineInput, fitted: &FittedModel) -> Result<Self, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let (tt, target) = (floats(batch, "tt")?, floats(batch, &stage.target)?);
        let inputs = fitted.inputs(batch)?;
        let kept = |row: usize| line.keep.as_ref().is_none_or(|keep| keep.get(row).copied().unwrap_or(false));
        let value = |column: &Vec<f64>, row: usize| column.get(row).copied().unwrap_or(f64::NAN);
        let whole =
            |row: &usize| kept(*row) && target[*row].is_finite() && inputs.iter().all(|c| value(c, *row).is_finite());
        let rows: Vec<usize> = (0..target.len()).filter(whole).collect();
        if rows.len() < 2 {
            return Err(Fault::data("fewer than two samples of the line have the target and all inputs of the model"));
        }
        let x = rows.iter().flat_map(|&row| inputs.iter().map(move |c| value(c, row))).collect();
        let y = rows.iter().map(|&row| target[row]).collect();
        Ok(Self { x, y, width: inputs.len(), rate_hz: even_rate_hz(tt)? })
    }

    /// At most `most` of the rows, evenly spaced.
    fn spread(&self, most: usize) -> Vec<f64> {
        let (rows, count) = (self.y.len(), self.y.len().min(most));
        let at = (0..count).map(|k| (2 * k + 1) * rows / (2 * count));
        at.flat_map(|row| self.x[row * self.width..(row + 1) * self.width].iter().copied()).collect()
    }

    /// Values of a column.
    pub(super) fn column(&self, at: usize) -> Vec<f64> {
        self.x.iter().skip(at).step_by(self.width.max(1)).copied().collect()
    }
}

impl Importance {
    /// Groups of entries: the named groups, then every other entry as a separate group.
    ///
    /// # Errors
    /// Fails if a group has no entry, or shares an entry with another group.
    pub fn grouped(&self, columns: &[String]) -> Result<(Vec<String>, Vec<Vec<usize>>), Fault> {
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

    /// Importance of each group on a line.
    ///
    /// # Errors
    /// Fails if the method does not suit the model, or the line is too short for it.
    pub fn weights(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<LineImportance, Fault> {
        match self.method {
            ImportanceMethod::Permutation => Ok(self.permuted(rows, fitted, groups)?.into()),
            ImportanceMethod::Shapley => {
                Ok(of_rows(self.shapley(rows, fitted, groups)?, rows.spread(self.samples), groups))
            }
            ImportanceMethod::ExpectedGradients => {
                Ok(of_rows(self.gradients(rows, fitted, groups)?, rows.spread(self.samples), groups))
            }
            ImportanceMethod::Pearson => Ok(correlations(rows, groups, pearson).into()),
            ImportanceMethod::Spearman => Ok(correlations(rows, groups, spearman).into()),
            ImportanceMethod::HardThresholding => Ok(self.sparse(rows, groups)?.into()),
            ImportanceMethod::GroupLasso => Ok(first_layer(rows, fitted, groups)?.into()),
            ImportanceMethod::Morris => self.screened(rows, fitted, groups),
            ImportanceMethod::SobolFirst | ImportanceMethod::SobolTotal => self.shares(rows, fitted, groups),
        }
    }

    fn permuted(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<Vec<GroupImportance>, Fault> {
        let predict = |x: &[f64]| fitted.field_nt(x);
        let block = (self.block_s * rows.rate_hz).round().max(1.0) as usize;
        let blocks = PermutationBlocks { rows: block, repeats: self.repeats, seed: self.seed as u64 };
        // Ignores the mean of the model's error, as in the cross-validation of `fit`.
        let missed: Vec<f64> = rows.y.iter().zip(fitted.field_nt(&rows.x)?).map(|(y, f)| y - f).collect();
        let mean = statistics::mean(&missed).value;
        let y: Vec<f64> = rows.y.iter().map(|y| y - mean).collect();
        let found = permutation(&predict, &rows.x, rows.width, &y, groups, &blocks);
        let PermutationImportance { increases, .. } = found.map_err(|e| failed(e, Some("block_s")))?;
        let one = |repeats: &Vec<f64>| GroupImportance {
            value: statistics::mean(repeats).value,
            spread: statistics::std(repeats).value,
            error: f64::NAN,
            n: repeats.len(),
        };
        Ok(increases.iter().map(one).collect())
    }

    fn shapley(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<Attributions, Fault> {
        let (some, background) = (rows.spread(self.samples), rows.spread(self.background));
        if let Some((coefficients, _)) = fitted.coefficients() {
            let width = rows.width.max(1);
            let mean = |j: usize| {
                statistics::mean(&background.iter().skip(j).step_by(width).copied().collect::<Vec<_>>()).value
            };
            let means: Vec<f64> = (0..width).map(mean).collect();
            return shapley_linear(&coefficients, &some, &means, groups).map_err(refused);
        }
        if let FittedModelForm::Learned(learned) = &fitted.body
            && let LearnedModel::BoostedTrees(trees) = learned.as_ref()
        {
            return shapley_trees(trees.forest(), &some, &background, rows.width, groups).map_err(refused);
        }
        let predict = |x: &[f64]| fitted.field_nt(x);
        let sampling = AttributionSampling { samples: self.draws, seed: self.seed as u64 };
        shapley_sampled(&predict, &some, &background, rows.width, groups, &sampling).map_err(|e| failed(e, None))
    }

    fn gradients(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<Attributions, Fault> {
        let gradient = |x: &[f64]| match (&fitted.body, fitted.coefficients()) {
            (_, Some((b, _))) => Ok(b.repeat(x.len() / b.len().max(1))),
            (FittedModelForm::Learned(learned), None) => {
                let none =
                    || Fault::data("the model has no gradient").help("set `method = \"shapley\"`").of_param("method");
                learned.gradient(x).ok_or_else(none)
            }
            (FittedModelForm::Linear { .. }, None) => Err(Fault::bug("a linear model has no coefficients")),
        };
        let (some, background) = (rows.spread(self.samples), rows.spread(self.background));
        let samples = self.draws.saturating_mul(background.len() / rows.width.max(1));
        let sampling = AttributionSampling { samples, seed: self.seed as u64 };
        let found = expected_gradients(&gradient, &some, &background, rows.width, groups, &sampling);
        found.map_err(|e| failed(e, None))
    }
}

impl Importance {
    /// Coefficients of the best sparse linear model of standardised entries.
    fn sparse(&self, rows: &ImportanceRows, groups: &[Vec<usize>]) -> Result<Vec<GroupImportance>, Fault> {
        let scales: Vec<(f64, f64)> = (0..rows.width).map(|j| mean_and_deviation(&rows.column(j))).collect();
        let varies = |j: &usize| scales[*j].1 > LEAST_DEVIATION * scales[*j].0.abs();
        let at: Vec<usize> = (0..rows.width).filter(varies).collect();
        let mut coefficients = vec![0.0; rows.width];
        if !at.is_empty() {
            let scaled =
                |row: &[f64]| -> Vec<f64> { at.iter().map(|&j| (row[j] - scales[j].0) / scales[j].1).collect() };
            let z: Vec<f64> = rows.x.chunks_exact(rows.width).flat_map(scaled).collect();
            let mean = statistics::mean(&rows.y).value;
            let y: Vec<f64> = rows.y.iter().map(|y| y - mean).collect();
            let found = iterative_hard_thresholding(&z, at.len(), &y, self.terms.min(at.len())).map_err(refused)?;
            if !found.converged {
                let what =
                    format!("the linear model of {} entries does not converge in {} steps", self.terms, found.steps);
                let help = "reduce `terms`, or remove correlated entries";
                return Err(Fault::data(what).of_param("terms").help(help));
            }
            at.iter().zip(found.coefficients).for_each(|(&j, b)| coefficients[j] = b);
        }
        let one = |group: &Vec<usize>| GroupImportance {
            value: root_of_squares(group.iter().map(|&j| coefficients[j])),
            spread: f64::NAN,
            error: f64::NAN,
            n: rows.y.len(),
        };
        Ok(groups.iter().map(one).collect())
    }
}

/// Norm of the weights of each group of inputs in the first layer of a network. The weights apply to inputs in units of
/// their standard deviation on the line. NaN for an entry that is not an input of the network.
fn first_layer(
    rows: &ImportanceRows,
    fitted: &FittedModel,
    groups: &[Vec<usize>],
) -> Result<Vec<GroupImportance>, Fault> {
    let network = match &fitted.body {
        FittedModelForm::Learned(learned) => learned.parts(),
        FittedModelForm::Linear { .. } => None,
    };
    let Some(NetworkParts { inputs, scaling, layers: NetworkLayers::Dense(shape), members, .. }) = network else {
        let what = "the model is not a network, but `group_lasso` uses the weights of the first layer of a network";
        return Err(Fault::data(what).of_param("method").help("choose another `method`"));
    };
    let outputs = match shape.form {
        NetworkForm::Weights | NetworkForm::WeightsAroundFixed => shape.linear,
        NetworkForm::VectorNetwork => 3,
        NetworkForm::Plain
        | NetworkForm::FixedLinear
        | NetworkForm::TrainedLinear
        | NetworkForm::VectorOnly
        | NetworkForm::VectorScalar => 1,
    };
    let units = shape.hidden.first().copied().unwrap_or(outputs);
    let own = inputs.len();
    // Weight of a standardised input in a unit, through the components if there are any.
    let weight = |of_unit: &[f64], j: usize| match &scaling.components {
        Some(components) => of_unit.iter().enumerate().map(|(k, w)| w * components.weights[k * own + j]).sum::<f64>(),
        None => of_unit[j],
    };
    let sizes = |member: &Vec<f64>| -> Vec<f64> {
        let layer = member.get(..units * shape.inputs).unwrap_or_default();
        let of = |j: usize| {
            let deviation = mean_and_deviation(&rows.column(j)).1 / scaling.scale[j];
            deviation * root_of_squares(layer.chunks_exact(shape.inputs.max(1)).map(|unit| weight(unit, j)))
        };
        // The first columns are inputs; the others are only linear terms.
        (0..own).map(of).collect()
    };
    let members: Vec<Vec<f64>> = members.iter().map(sizes).collect();
    let one = |group: &Vec<usize>| {
        let of = |sizes: &Vec<f64>| root_of_squares(group.iter().filter_map(|&j| sizes.get(j).copied()));
        let all: Vec<f64> = members.iter().map(of).collect();
        let has_inputs = group.iter().any(|&j| j < own);
        let value = if has_inputs { statistics::mean(&all).value } else { f64::NAN };
        let spread = if has_inputs && all.len() > 1 { statistics::std(&all).value } else { f64::NAN };
        GroupImportance { value, spread, error: f64::NAN, n: all.len() }
    };
    Ok(groups.iter().map(one).collect())
}

fn root_of_squares(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}

fn mean_and_deviation(x: &[f64]) -> (f64, f64) {
    (statistics::mean(x).value, statistics::std(x).value)
}

/// Fault for a failed model, or for unsuitable rows or settings. `param` is the parameter for which the fault is
/// reported.
pub(super) fn failed(e: ImportanceError<Fault>, param: Option<&str>) -> Fault {
    match (e, param) {
        (ImportanceError::Model(fault), _) => fault,
        (other, Some(param)) => refused(other).of_param(param),
        (other, None) => refused(other),
    }
}

fn refused(e: impl Display) -> Fault {
    data(e)
}

/// Mean absolute contribution of each group over the rows `x`, and the contributions to single rows.
fn of_rows(found: Attributions, x: Vec<f64>, groups: &[Vec<usize>]) -> LineImportance {
    let count = groups.len();
    let of = |values: &[f64], g: usize| -> Vec<f64> { values.iter().skip(g).step_by(count).map(|v| v.abs()).collect() };
    let one = |g: usize| {
        let values = of(&found.values, g);
        let (value, spread) = (statistics::mean(&values).value, statistics::std(&values).value);
        GroupImportance { value, spread, error: statistics::mean(&of(&found.errors, g)).value, n: values.len() }
    };
    let weights = (0..count).map(one).collect();
    let width = groups.iter().map(Vec::len).sum();
    let samples = Some(SampleAttributions { values: found.values, x, width });
    LineImportance { weights, samples, intervals: None }
}

/// Largest correlation of an entry of each group with the target. NaN if all entries are constant.
fn correlations(
    rows: &ImportanceRows,
    groups: &[Vec<usize>],
    of: fn(&[f64], &[f64]) -> statistics::SampleStatistic,
) -> Vec<GroupImportance> {
    let one = |group: &Vec<usize>| {
        let all = group.iter().map(|&j| of(&rows.column(j), &rows.y).value).filter(|c| c.is_finite());
        let value = all.reduce(|a, b| if b.abs() > a.abs() { b } else { a }).unwrap_or(f64::NAN);
        GroupImportance { value, spread: f64::NAN, error: f64::NAN, n: rows.y.len() }
    };
    groups.iter().map(one).collect()
}
