//! Fits all points of a sweep together. Each line is reduced once for all points, and points with the same matrix share
//! its factors.

use std::{collections::BTreeMap, sync::Arc};

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use rayon::prelude::*;
use schemas::{CheckpointMonitor, Fault, LineInput, StageOutput, SurveyAggregator, SurveyPoint};

use super::{
    Fit,
    point::FitPoint,
    problem::FitProblem,
    question::{DesignMatrixKey, FitRequest, TargetColumns},
    residual::residual_noise,
    rows::FitLineSummary,
    settings::{FitData, FitSettings},
    solve::{FitSolution, ModelTableRow, solve},
};
use crate::{
    columns::array,
    fitted::{FittedModel, FittedModelForm},
    trained::LearnedModel,
};

/// Model of `warm_start`, from which training starts.
pub(super) struct TrainingStart {
    pub(super) model: LearnedModel,
    /// Sample rate of those inputs of the model that are differences per sample, in Hz. `None` if the table does not
    /// contain the rate.
    pub(super) rate_hz: Option<f64>,
}

/// Reads the model of `warm_start`.
fn start(table: &RecordBatch) -> Result<TrainingStart, Fault> {
    let FittedModel { body, rate_hz } = FittedModel::read(table, &[]).map_err(|fault| fault.of_param("warm_start"))?;
    match body {
        FittedModelForm::Learned(learned) => Ok(TrainingStart { model: *learned, rate_hz }),
        FittedModelForm::Linear { .. } => {
            let fault = Fault::data("the model of `warm_start` is linear and has no weights");
            Err(fault.of_param("warm_start").help("give the table of a `fit` stage with a network"))
        }
    }
}

/// Points of a sweep that are fitted to the same lines.
pub struct FitAggregator {
    pub(super) points: Vec<FitPoint>,
    questions: BTreeMap<DesignMatrixKey, FitRequest>,
    /// Model from which the training of each point starts, if given.
    pub(super) starts: Vec<Result<Option<TrainingStart>, Fault>>,
}

/// Requests to each line.
fn questions(points: &[FitPoint]) -> BTreeMap<DesignMatrixKey, FitRequest> {
    let mut all: BTreeMap<DesignMatrixKey, FitRequest> = BTreeMap::new();
    for point in points {
        let question = all.entry(point.matrix.clone()).or_default();
        let targets = point.targets();
        if point.kind.made_of != FitData::Moments && !question.keeps_rows.contains(&targets) {
            question.keeps_rows.push(targets.clone());
        }
        if point.model.wants_errors() && point.settings.whiten.is_none() && !question.wants_errors.contains(&targets) {
            question.wants_errors.push(targets.clone());
        }
        if !question.targets.contains(&targets) {
            question.targets.push(targets);
        }
    }
    all
}

impl FitAggregator {
    /// The points of a sweep, with the models from which their training starts.
    pub(super) fn new(points: Vec<SurveyPoint<Fit>>) -> FitAggregator {
        let starts = points.iter().map(|point| point.inputs.get(1).map(start).transpose()).collect();
        let points: Vec<FitPoint> = points.into_iter().map(|point| point.stage.point()).collect();
        FitAggregator { questions: questions(&points), points, starts }
    }

    /// Models of the points at `places`. These points have the same matrix, target, entries and components.
    fn solved(
        &self,
        whole: &Result<FitProblem, Fault>,
        places: &[usize],
        work: &dyn CheckpointMonitor,
    ) -> Vec<Result<FitSolution, Fault>> {
        let Some(first) = places.first().map(|i| &self.points[*i]) else { return vec![] };
        let cut = whole.as_ref().map_err(Clone::clone).and_then(|whole| whole.cut(first.places(&whole.terms)?));
        if first.kind.made_of == FitData::Samples {
            return self.learnt(&cut, places, work);
        }
        let mut problem = match cut.and_then(|p| p.whitened(first.settings.whiten)) {
            Ok(problem) => problem,
            Err(fault) => return places.iter().map(|_| Err(fault.clone())).collect(),
        };
        let ridge = |i: &usize| Some((self.points[*i].settings, self.points[*i].given_ridge()?));
        let ridges: Vec<(FitSettings, f64)> = places.iter().filter_map(ridge).collect();
        let mut done: Vec<FitSettings> = vec![];
        for (settings, _) in &ridges {
            if !done.iter().any(|d| d.same_scale(settings)) {
                done.push(*settings);
                let same = ridges.iter().filter(|(s, _)| s.same_scale(settings)).map(|(_, lambda)| *lambda);
                if let Err(fault) = problem.solve_ridges(settings, &same.collect::<Vec<_>>()) {
                    return places.iter().map(|_| Err(fault.clone())).collect();
                }
            }
        }
        places.iter().map(|i| solve(&mut problem, &self.points[*i])).collect()
    }
}

impl SurveyAggregator for FitAggregator {
    type Part = FitLineSummary;

    fn map(&self, line: &LineInput) -> Result<FitLineSummary, Fault> {
        FitLineSummary::new(line, &self.questions)
    }

    fn refused(&self, part: &FitLineSummary) -> Vec<(usize, Fault)> {
        let why = |point: &FitPoint| part.refused.get(&(point.matrix.clone(), point.targets())).cloned();
        self.points.iter().enumerate().filter_map(|(i, point)| Some((i, why(point)?))).collect()
    }

    fn finish(&self, parts: Vec<FitLineSummary>, work: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let parts: Vec<&FitLineSummary> = parts.iter().collect();
        type At = (DesignMatrixKey, TargetColumns);
        type Kind = (Option<Vec<String>>, Option<u64>, bool);
        let mut problems: BTreeMap<At, BTreeMap<Kind, Vec<usize>>> = BTreeMap::new();
        for (i, point) in self.points.iter().enumerate() {
            let of_matrix = problems.entry((point.matrix.clone(), point.targets())).or_default();
            let learns = point.kind.made_of == FitData::Samples;
            let kind = (point.entries.clone(), point.settings.whiten.map(f64::to_bits), learns);
            of_matrix.entry(kind).or_default().push(i);
        }
        let problems: Vec<(At, Vec<Vec<usize>>)> =
            problems.into_iter().map(|(at, cuts)| (at, cuts.into_values().collect())).collect();
        let solved: Vec<(usize, Result<FitSolution, Fault>)> = problems
            .into_par_iter()
            .flat_map(|(at, cuts)| {
                let whole = FitProblem::new(&parts, &at);
                let answers = |places: Vec<usize>| {
                    let answers = self.solved(&whole, &places, work);
                    places.into_iter().zip(answers).collect::<Vec<_>>()
                };
                cuts.into_par_iter().with_max_len(1).flat_map_iter(answers).collect::<Vec<_>>()
            })
            .collect();
        let mut tables: Vec<_> =
            self.points.iter().map(|_| Err(Fault::bug("the result of a fit is missing"))).collect();
        for (i, answer) in solved {
            tables[i] = answer.map(|s| s.columns(&self.points[i], residual_noise(&parts, &self.points[i], &s)).into());
        }
        tables
    }
}

impl FitSolution {
    fn columns(&self, point: &FitPoint, [white, lasting, tau]: [f64; 3]) -> Vec<ArrayRef> {
        let rows = self.table.len();
        let each = |of: &dyn Fn(&ModelTableRow) -> f64| -> ArrayRef { array(self.table.iter().map(of).collect()) };
        let text = |x: &str| -> ArrayRef { Arc::new(StringArray::from(vec![x; rows])) };
        let count = |n: usize| -> ArrayRef { Arc::new(Int64Array::from(vec![n as i64; rows])) };
        let number = |x: f64| -> ArrayRef { array(vec![x; rows]) };
        let names = self.table.iter().map(|row| row.term.name.as_str());
        vec![
            text(point.kind.name),
            Arc::new(names.map(Some).collect::<StringArray>()),
            each(&|row| row.term.value),
            each(&|row| row.std),
            count(self.rows.0),
            count(self.rows.1),
            number(self.condition),
            number(self.residual_std),
            number(self.chosen),
            number(self.trivial_share),
            number(self.approximation_bound_nt),
            text(&self.lines),
            text(&self.warning),
            number(white),
            number(lasting),
            number(tau),
            number(self.rate_hz),
        ]
    }
}
