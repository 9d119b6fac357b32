//! Training of networks within a fit.

use std::{ops::ControlFlow, time::Instant};

use learning::network::{
    NetworkTraining, TrainingEpoch, TrainingError, TrainingJob, TrainingResult, TrainingState, train_together,
};
use schemas::Fault;

use super::{
    NetworkModel,
    prepared::{TrainingInputs, TrainingSetup, TrainingTask, member_seed},
};
use crate::fit::{model::LearningResult, samples::FitSamples};

/// Time between two saved states, in seconds.
const KEPT_EVERY_S: f64 = 1.0;

/// Trains networks. Where possible, they share passes over the samples. The results equal those of separate training.
///
/// # Errors
/// A network yields a fault instead of a model if the data do not determine it, its loss is not finite, or the run is
/// interrupted.
pub fn learn_together(tasks: &[TrainingTask<'_>], samples: &FitSamples) -> Vec<Result<LearningResult, Fault>> {
    let ready: Vec<Result<TrainingInputs<'_>, Fault>> =
        tasks.iter().map(|task| TrainingInputs::new(task, samples)).collect();
    let of = |ready| Ok(EnsembleTraining::new(TrainingSetup::new(ready, samples)?));
    let mut networks: Vec<Result<EnsembleTraining<'_>, Fault>> =
        ready.iter().map(|ready| ready.as_ref().map_err(Clone::clone).and_then(of)).collect();
    let most = networks.iter().flatten().map(|network| network.prepared.members.len()).max().unwrap_or(0);
    for member in 0..most {
        train_members(member, &mut networks);
    }
    let learnt = |network: EnsembleTraining<'_>| network.prepared.learnt(samples, &network.trained);
    networks.into_iter().map(|network| network.and_then(learnt)).collect()
}

/// Network whose members are trained one at a time.
struct EnsembleTraining<'a> {
    prepared: TrainingSetup<'a>,
    /// States of members saved by an earlier run.
    kept: Vec<TrainingState>,
    /// States of the finished members.
    done: Vec<TrainingState>,
    trained: Vec<TrainingResult>,
}

impl<'a> EnsembleTraining<'a> {
    fn new(prepared: TrainingSetup<'a>) -> Self {
        let kept = prepared.task.work.kept().and_then(|bytes| read_states(&bytes)).unwrap_or_default();
        Self { prepared, kept, done: vec![], trained: vec![] }
    }

    /// State from which a member starts or resumes.
    fn start(&self, member: usize) -> Option<TrainingState> {
        let first = self.prepared.members.get(member)?;
        Some(self.kept.get(member).cloned().unwrap_or_else(|| {
            let mut state = self.prepared.core.start(first.clone());
            state.tolles_lawson.clone_from(&self.prepared.linear);
            state
        }))
    }

    /// Reports progress after an epoch and saves the state at intervals.
    fn report_progress(
        &self,
        number: usize,
        (from, begun): (usize, Instant),
        epoch: &TrainingEpoch,
        state: &TrainingState,
        kept: &mut Option<Instant>,
    ) -> Result<(), Fault> {
        let TrainingTask { model: NetworkModel { keys, .. }, work, .. } = self.prepared.task;
        let (done, all) = (state.epoch, keys.epochs + keys.lbfgs_epochs);
        if kept.is_none_or(|last| last.elapsed().as_secs_f64() > KEPT_EVERY_S) {
            *kept = Some(Instant::now());
            work.keep(&states_bytes(&self.done, state));
        }
        let left_s = begun.elapsed().as_secs_f64() / (done - from).max(1) as f64 * (all - done) as f64;
        let message = progress(epoch, done, all, number, keys.members, self.prepared.scale_nt(), left_s);
        work.report_progress(&message).inspect_err(|_| work.keep(&states_bytes(&self.done, state)))
    }
}

/// Trains the member `number` of each network that has a member of this number.
fn train_members(number: usize, networks: &mut [Result<EnsembleTraining<'_>, Fault>]) {
    let mut members: Vec<(usize, MemberTraining<'_>)> = vec![];
    for (at, network) in networks.iter().enumerate() {
        let member = network.as_ref().ok().and_then(|network| MemberTraining::new(number, network));
        members.extend(member.map(|member| (at, member)));
    }
    let found = train_together(members.iter_mut().map(|(_, member)| member.job()).collect());
    let ends = members.into_iter().zip(found).map(|((at, member), found)| (at, member.end(found)));
    for (at, end) in ends.collect::<Vec<_>>() {
        match (end, &mut networks[at]) {
            (Ok((state, trained)), Ok(network)) => {
                network.done.push(state);
                network.trained.push(trained);
            }
            (Err(fault), network) => *network = Err(fault),
            (Ok(_), Err(_)) => {}
        }
    }
}

/// Member in training.
struct MemberTraining<'a> {
    network: &'a EnsembleTraining<'a>,
    number: usize,
    training: NetworkTraining,
    /// Current state.
    state: TrainingState,
    /// First epoch of this run, and the start time of the run.
    from: (usize, Instant),
    /// Time of the last saved state.
    kept: Option<Instant>,
    /// Fault that ended the training.
    stopped: Option<Fault>,
}

impl<'a> MemberTraining<'a> {
    fn new(number: usize, network: &'a EnsembleTraining<'a>) -> Option<Self> {
        let model = &network.prepared.task.model;
        let training = NetworkTraining {
            physics: model.physics,
            conditioning: network.prepared.conditioning(),
            curriculum: model.curriculum,
            ..model.keys.training(member_seed(model.keys, number))
        };
        let state = network.start(number)?;
        let from = (state.epoch, Instant::now());
        Some(Self { network, number, training, state, from, kept: None, stopped: None })
    }

    fn job(&mut self) -> Result<TrainingJob<'_>, TrainingError> {
        let Self { network, number, training, state, from, kept, stopped } = self;
        let TrainingSetup { core, rows, validation, .. } = &network.prepared;
        let start = state.clone();
        let each = move |epoch: &TrainingEpoch, now: &TrainingState| {
            state.clone_from(now);
            match network.report_progress(*number, *from, epoch, now, kept) {
                Ok(()) => ControlFlow::Continue(()),
                Err(fault) => {
                    *stopped = Some(fault);
                    ControlFlow::Break(())
                }
            }
        };
        core.job(start, training, rows, validation.as_ref(), Box::new(each))
    }

    fn end(self, found: Result<TrainingResult, TrainingError>) -> Result<(TrainingState, TrainingResult), Fault> {
        match self.stopped {
            Some(stopped) => Err(stopped),
            None => Ok((self.state, found.map_err(fault)?)),
        }
    }
}

fn fault(error: TrainingError) -> Fault {
    let fault = Fault::data(error.to_string());
    if matches!(error, TrainingError::Diverged { .. }) { fault.of_param("learning_rate") } else { fault }
}

fn progress(
    epoch: &TrainingEpoch,
    done: usize,
    all: usize,
    member: usize,
    members: usize,
    scale_nt: f64,
    left_s: f64,
) -> String {
    let mut text = format!("epoch {done} of {all}, loss {:.4}", epoch.train_loss);
    if epoch.validation_loss.is_finite() {
        text.push_str(&format!(", validation {:.4}", epoch.validation_loss));
    }
    text.push_str(&format!(" (1 corresponds to {scale_nt:.1} nT), {left_s:.0} s left"));
    if members > 1 {
        text.push_str(&format!(", network {} of {members}", member + 1));
    }
    text
}

/// States of the finished members and of the current member, each preceded by its length.
fn states_bytes(done: &[TrainingState], now: &TrainingState) -> Vec<u8> {
    let mut out = vec![];
    for state in done.iter().chain([now]) {
        let bytes = state.to_bytes();
        out.extend((bytes.len() as u64).to_le_bytes());
        out.extend(bytes);
    }
    out
}

fn read_states(mut bytes: &[u8]) -> Option<Vec<TrainingState>> {
    let mut states = vec![];
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_first_chunk::<8>()?;
        let (state, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        states.push(TrainingState::from_bytes(state).ok()?);
        bytes = rest;
    }
    Some(states)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use schemas::Literal;

    use crate::fit::testing::{FitOutput, InterruptMonitor, bent, fitted_to, number, stage, whole, words, worked};

    fn keys() -> Vec<(String, Literal)> {
        let validation = words("validation", &["1.1"]);
        vec![validation, whole("epochs", 12), whole("members", 2), whole("batch", 50), number("dropout", 0.1)]
    }

    fn table(found: &FitOutput) -> Vec<(String, u64)> {
        found.term.iter().cloned().zip(found.value.iter().map(|v| v.to_bits())).collect()
    }

    #[test]
    fn unit_a_resumed_training_gives_the_same_table() {
        let whole_way = table(&fitted_to(&bent(), "m1", &keys()));
        for stop in [1, 7, 12, 13, 20] {
            let first = InterruptMonitor::after(stop, None);
            let fault = worked(&bent(), "m1", &keys(), &first).err().unwrap();
            assert_eq!(fault.what, "interrupted");
            let second = InterruptMonitor::after(usize::MAX, first.state());
            let found = worked(&bent(), "m1", &keys(), &second).unwrap();
            assert_eq!(table(&found), whole_way, "stopped after {stop}");
            assert!(second.reports() <= 24 - stop, "it began again");
        }
        let damaged = InterruptMonitor::after(usize::MAX, Some(b"nothing".to_vec()));
        assert_eq!(table(&worked(&bent(), "m1", &keys(), &damaged).unwrap()), whole_way);
    }

    #[test]
    fn unit_constant_inputs_are_omitted_and_listed() {
        let mut lines = bent();
        for line in &mut lines {
            let constant: arrow_array::ArrayRef = std::sync::Arc::new(arrow_array::Float64Array::from(vec![3.0; 200]));
            let mut columns = line.columns().to_vec();
            columns[4] = constant;
            *line = arrow_array::RecordBatch::try_new(line.schema(), columns).unwrap();
        }
        let found = fitted_to(&lines, "m1", &[whole("epochs", 2)]);
        assert_eq!(found.warning, "constant and not used as inputs of the network: `c`");
        assert!(!found.term.iter().any(|t| t.ends_with(" c")), "{:?}", found.term);
    }

    #[test]
    fn unit_invalid_settings_are_reported_with_their_parameter() {
        let fault_texts = |keys: &[(String, Literal)]| {
            let fault = match stage("m1", keys) {
                Ok(_) => worked(&bent(), "m1", keys, &schemas::NullMonitor).err().unwrap(),
                Err(mut faults) => faults.remove(0),
            };
            format!("{} [{}]", fault.what, fault.param.unwrap_or_default())
        };
        assert_eq!(
            fault_texts(&[words("validation", &["1.7"])]),
            "`1.7` is neither a line nor a flight of the fit [validation]"
        );
        assert_eq!(fault_texts(&[words("validation", &["1"])]), "no line remains for training [validation]");
        assert_eq!(fault_texts(&[words("inputs", &["d"])]), "the features have no entry `d` [inputs]");
        let diverged = fault_texts(&[number("learning_rate", 1e200), whole("batch", 10)]);
        let expected = diverged.starts_with("training diverged in epoch 1:") && diverged.ends_with("[learning_rate]");
        assert!(expected, "{diverged}");
    }
}
