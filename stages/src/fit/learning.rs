//! Points of a sweep whose models learn from samples, and the data that their networks share.

use std::collections::BTreeMap;

use rayon::prelude::*;
use schemas::{CheckpointMonitor, Fault, is_same_rate};

use super::{
    FitAggregator,
    model::LearningResult,
    network::{NetworkInputs, SharedInputs, TrainingTask, learn_together},
    problem::FitProblem,
    samples::{FitSamples, PointMonitor},
    solve::{FitSolution, solved},
};

/// Maximum number of networks that are trained together. Each of them requires memory for its rows of linear terms and
/// target.
const TEAM: usize = 4;

impl FitAggregator {
    /// Learned models of the points at `places`. These points have the same matrix, target and entries.
    pub(super) fn learnt(
        &self,
        problem: &Result<FitProblem, Fault>,
        places: &[usize],
        work: &dyn CheckpointMonitor,
    ) -> Vec<Result<FitSolution, Fault>> {
        let problem = match problem {
            Ok(problem) => problem,
            Err(fault) => return places.iter().map(|_| Err(fault.clone())).collect(),
        };
        // With a warm start, inputs that are differences per sample keep the sample rate of the first training.
        let mut rates: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        let mut answers: BTreeMap<usize, Result<FitSolution, Fault>> = BTreeMap::new();
        for &place in places {
            match self.rate_of_start(problem, place) {
                Ok(rate_hz) => rates.entry(rate_hz.to_bits()).or_default().push(place),
                Err(fault) => drop(answers.insert(place, Err(fault))),
            }
        }
        for (rate_hz, of_rate) in rates {
            let learnt = match f64::from_bits(rate_hz) {
                own if own == problem.rate_hz => self.learnt_at(problem, &of_rate, work),
                other => match problem.at_rate(other) {
                    Ok(problem) => self.learnt_at(&problem, &of_rate, work),
                    Err(fault) => of_rate.iter().map(|_| Err(fault.clone())).collect(),
                },
            };
            answers.extend(of_rate.into_iter().zip(learnt));
        }
        let lost = || Err(Fault::bug("the result of a training run is missing"));
        places.iter().map(|place| answers.remove(place).unwrap_or_else(lost)).collect()
    }

    /// Sample rate of those inputs of a point that are differences per sample, in Hz.
    fn rate_of_start(&self, problem: &FitProblem, place: usize) -> Result<f64, Fault> {
        let Ok(Some(start)) = &self.starts[place] else { return Ok(problem.rate_hz) };
        let parts = start.model.parts();
        let terms: Vec<String> = parts.iter().flat_map(|p| p.inputs.iter().chain(p.linear)).cloned().collect();
        match start.rate_hz {
            _ if !problem.depends_on_rate(&terms) => Ok(problem.rate_hz),
            Some(rate_hz) if is_same_rate(rate_hz, problem.rate_hz) => Ok(problem.rate_hz),
            Some(rate_hz) => Ok(rate_hz),
            None => {
                let what = "inputs are differences per sample, but the table of `warm_start` has no `rate_hz`";
                let fault = Fault::data(what).of_param("warm_start");
                Err(fault.help("fit that network again; `fit` writes `rate_hz` to its table"))
            }
        }
    }

    /// Same as [`learnt`](Self::learnt), for points at the rate of the problem.
    fn learnt_at(
        &self,
        problem: &FitProblem,
        places: &[usize],
        work: &dyn CheckpointMonitor,
    ) -> Vec<Result<FitSolution, Fault>> {
        let mut groups: BTreeMap<NetworkInputsKey<'_>, Vec<usize>> = BTreeMap::new();
        for &place in places {
            groups.entry(self.inputs_key(place)).or_default().push(place);
        }
        let of_group = |group: Vec<usize>| -> Vec<(usize, Result<FitSolution, Fault>)> {
            let samples = problem.samples();
            let inputs = self.shared_inputs(&samples, &group);
            let teams = self.teams(&group);
            let answers = teams.par_iter().with_max_len(1).flat_map_iter(|team| {
                let learnt = self.learnt_together(&samples, team, inputs.as_ref(), work);
                let solved = learnt.into_iter().map(|learnt| solved(problem, &samples, learnt?));
                team.iter().copied().zip(solved.collect::<Vec<_>>())
            });
            answers.collect()
        };
        // The inputs of a group exist only while the group is processed, because they are as large as the samples.
        let groups: Vec<Vec<usize>> = groups.into_values().collect();
        let answers = groups.into_par_iter().with_max_len(1).flat_map_iter(of_group);
        let mut answers: BTreeMap<usize, Result<FitSolution, Fault>> = answers.collect();
        let lost = || Err(Fault::bug("the result of a training run is missing"));
        places.iter().map(|place| answers.remove(place).unwrap_or_else(lost)).collect()
    }

    fn inputs_key(&self, place: usize) -> NetworkInputsKey<'_> {
        let point = &self.points[place];
        let network = point.model.network().filter(|_| matches!(self.starts[place], Ok(None)));
        NetworkInputsKey {
            network: network.map(|network| (network.keys.inputs.as_deref(), network.keys.validation.as_slice())),
            has_inputs: network.is_none_or(|network| network.has_inputs()),
            whiten: point.settings.whiten.map(f64::to_bits),
        }
    }

    /// Inputs that several networks share.
    fn shared_inputs(&self, samples: &FitSamples, group: &[usize]) -> Option<SharedInputs> {
        let first = &self.points[*group.first().filter(|_| group.len() > 1)?];
        let network = first.model.network().filter(|_| self.inputs_key(group[0]).network.is_some())?;
        Some(NetworkInputs::from_samples(&network, samples, first.settings.whiten, None))
    }

    /// Points of a group, divided into teams whose training visits the samples in the same order.
    fn teams(&self, group: &[usize]) -> Vec<Vec<usize>> {
        let mut teams: BTreeMap<Option<(usize, usize)>, Vec<usize>> = BTreeMap::new();
        for &place in group {
            let network = self.points[place].model.network();
            let shares = self.inputs_key(place).network.is_some();
            let network = network.filter(|network| shares && network.window.is_none());
            teams.entry(network.map(|network| (network.keys.seed, network.keys.batch))).or_default().push(place);
        }
        let team = |(order, places): (Option<_>, Vec<usize>)| {
            let most = if order.is_some() { TEAM } else { 1 };
            places.chunks(most).map(<[usize]>::to_vec).collect::<Vec<_>>()
        };
        teams.into_iter().flat_map(team).collect()
    }

    /// Learned models of points that are trained together. Several points are trained together only if all are
    /// networks.
    fn learnt_together(
        &self,
        samples: &FitSamples,
        team: &[usize],
        inputs: Option<&SharedInputs>,
        work: &dyn CheckpointMonitor,
    ) -> Vec<Result<LearningResult, Fault>> {
        let work = |point: usize| PointMonitor { work, point };
        if let [place] = *team
            && self.points[place].model.network().is_none()
        {
            let point = &self.points[place];
            return vec![point.model.learn(samples, &point.settings, &work(place))];
        }
        let task = |&place: &usize| {
            let point = &self.points[place];
            let model = point.model.network().ok_or_else(|| Fault::bug("models trained together must be networks"))?;
            let start = self.starts[place].as_ref().map_err(Clone::clone)?.as_ref().map(|start| &start.model);
            Ok(TrainingTask { model, settings: &point.settings, start, inputs, work: work(place) })
        };
        match team.iter().map(task).collect::<Result<Vec<TrainingTask<'_>>, Fault>>() {
            Ok(tasks) => learn_together(&tasks, samples),
            Err(fault) => team.iter().map(|_| Err(fault.clone())).collect(),
        }
    }
}

/// Settings, other than the samples, that determine the inputs of a network.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct NetworkInputsKey<'a> {
    /// Keys `inputs` and `validation`. `None` for other models, and for a network with a warm start, which has its own
    /// scales.
    network: Option<(Option<&'a [String]>, &'a [String])>,
    /// Whether the model has inputs.
    has_inputs: bool,
    whiten: Option<u64>,
}
