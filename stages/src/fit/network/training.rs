//! The training of a network within a fit.

use std::{ops::ControlFlow, time::Instant};

use learning::{
    inputs::{Inputs, InputsError},
    network::{
        Epoch, Form, Runs, Shape, State, TermScaling, Trained, Training, TrainingError, Windowed, train, train_windowed,
    },
};
use numerics::{random::seed_of, regression::statistics};
use schemas::Fault;

use super::{LinearPart, Network, Window, warm_start::WarmStart};
use crate::{
    fit::{
        model::Learnt,
        samples::{PointWork, Samples},
        settings::Settings,
    },
    trained::{self, Learned, Term, list},
};

/// Seconds between two states that are kept.
const KEPT_EVERY_S: f64 = 1.0;
/// A validation loss of so many times the training loss is said to overfit.
const OVERFITS: f64 = 4.0;

/// What stands beside a network.
pub struct Beside<'a> {
    /// How the two are put together.
    pub form: Form,
    /// Units of the hidden layers where the spec gives none.
    pub hidden: &'a [usize],
    /// The linear model, but for `m1`.
    pub linear: Option<&'a LinearPart>,
    /// Whether all features are its terms where the spec names none.
    pub all_features: bool,
    /// The weight of the distance from the linear model in the loss.
    pub physics: f64,
    /// What sees a window of samples before the network; none sees each sample alone.
    pub window: Option<Window>,
}

/// The inputs of a network, which networks with the same keys share.
pub struct NetworkInputs {
    /// Their places among the features.
    at: Vec<usize>,
    /// The places of those that are constant on the lines to train on, which are none.
    constant: Vec<usize>,
    scaling: Inputs,
    /// Scaled, of the lines to train on and of those to validate with, row-major.
    train: Vec<f64>,
    validate: Vec<f64>,
}

impl NetworkInputs {
    /// Those of a network that begins at random.
    ///
    /// # Errors
    /// When the keys name none, or every input is constant, or there are no components as `whiten` asks for.
    pub fn of(keys: &Network, samples: &Samples, whiten: Option<f64>) -> Result<Self, Fault> {
        let (train_on, validate_on) = samples.split(&keys.validation)?;
        let mut at = samples.places(keys.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (scaling, constant, x) = scaling(samples, &train_on, &mut at, whiten)?;
        let validate = scaling.apply(&samples.columns(&at, &validate_on));
        Ok(Self { train: scaling.apply(&x), validate, at, constant, scaling })
    }

    /// Those of a network that begins as another one.
    fn warm(warm: &WarmStart, keys: &Network, samples: &Samples, whiten: Option<f64>) -> Result<Self, Fault> {
        let (train_on, validate_on) = samples.split(&keys.validation)?;
        let mut at = samples.places(keys.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let scaling = warm.scaling(samples, &mut at, whiten)?;
        let of = |lines: &[usize]| scaling.apply(&samples.columns(&at, lines));
        Ok(Self { train: of(&train_on), validate: of(&validate_on), constant: vec![], at, scaling })
    }
}

/// The rows of some lines, scaled.
struct Scaled<'a> {
    x: &'a [f64],
    a: Vec<f64>,
    y: Vec<f64>,
    /// Rows of each run of samples that follow each other.
    runs: Vec<usize>,
}

impl Scaled<'_> {
    fn samples(&self) -> learning::network::Samples<'_> {
        learning::network::Samples { x: self.x, a: &self.a, y: &self.y }
    }

    fn runs(&self) -> Runs<'_> {
        Runs { samples: self.samples(), lengths: &self.runs }
    }
}

/// What the training of the members begins with.
struct Beginning {
    /// The parameters of each member.
    members: Vec<Vec<f64>>,
    /// The coefficients of the linear model, of scaled terms and in the scale of the target.
    linear: Vec<f64>,
}

/// The network that is trained.
pub enum Core {
    /// Of each sample alone.
    Dense(Shape),
    /// Of a window of samples.
    Windowed(Windowed),
}

impl Core {
    fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.initial(seed, linear),
            Core::Windowed(windowed) => windowed.initial(seed, linear),
        }
    }

    fn start(&self, parameters: Vec<f64>) -> State {
        match self {
            Core::Dense(shape) => State::new(shape, parameters),
            Core::Windowed(windowed) => windowed.start(parameters),
        }
    }

    fn predict(&self, parameters: &[f64], rows: &Scaled<'_>) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.predict(parameters, rows.x, &rows.a),
            Core::Windowed(windowed) => windowed.predict(parameters, rows.x, &rows.a, &rows.runs),
        }
    }

    /// The parameters of a network of scaled terms. Over a window there are none.
    fn scaled(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.scaled(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    /// Those of a network of the terms as they are.
    fn original(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.original(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    fn train(
        &self,
        start: State,
        training: &Training,
        rows: &Scaled<'_>,
        validation: Option<&Scaled<'_>>,
        each: &mut dyn FnMut(&Epoch, &State) -> ControlFlow<()>,
    ) -> Result<Trained, TrainingError> {
        match self {
            Core::Dense(shape) => {
                let validation = validation.map(Scaled::samples);
                train(shape, start, training, &rows.samples(), validation.as_ref(), each)
            }
            Core::Windowed(windowed) => {
                let validation = validation.map(Scaled::runs);
                train_windowed(windowed, start, training, &rows.runs(), validation.as_ref(), each)
            }
        }
    }
}

/// Trains a network.
///
/// # Errors
/// When the data do not determine it, the loss is not finite, or the run is interrupted.
pub fn learn(
    keys: &Network,
    beside: &Beside,
    samples: &Samples,
    settings: &Settings,
    work: &PointWork,
) -> Result<Learnt, Fault> {
    let (train_on, validate_on) = samples.split(&keys.validation)?;
    let warm = work.start.map(|model| WarmStart::of(model, beside.form)).transpose()?;
    let own;
    let NetworkInputs { at, constant, scaling, train, validate } = match (&warm, work.inputs) {
        (None, Some(shared)) => shared.as_ref().map_err(Clone::clone)?,
        (None, None) => {
            own = NetworkInputs::of(keys, samples, settings.whiten)?;
            &own
        }
        (Some(warm), _) => {
            own = NetworkInputs::warm(warm, keys, samples, settings.whiten)?;
            &own
        }
    };
    let (linear_at, coefficients) = match beside.linear {
        Some(part) => {
            let mut places = part.places(samples, beside.all_features)?;
            if let Some(warm) = &warm {
                warm.order_terms(samples, &mut places)?;
            }
            let fitted = part.fit(samples, &train_on, &places)?;
            (places, fitted)
        }
        None => (vec![], vec![]),
    };
    let mut target = target(samples, &train_on, &linear_at, &coefficients, beside.form)?;
    if let Some(warm) = &warm {
        target.1 = warm.scale_nt();
    }
    let in_scale: Vec<f64> = coefficients.iter().map(|b| b / target.1).collect();
    let terms = term_scaling(samples, &train_on, &linear_at, &in_scale, beside.form, settings.whiten)?;
    let scaled = |lines: &[usize], x, (mean, scale): (f64, f64)| Scaled {
        x,
        a: terms.apply(samples.columns(&linear_at, lines)),
        y: samples.target(lines).iter().map(|y| (y - mean) / scale - terms.offset()).collect(),
        runs: samples.runs(lines),
    };
    let inputs = beside.window.as_ref().map_or_else(|| scaling.width(), |window| window.units);
    let usual = || warm.as_ref().map_or_else(|| beside.hidden.to_vec(), WarmStart::hidden);
    let shape = Shape {
        inputs,
        linear: linear_at.len(),
        hidden: keys.hidden.clone().unwrap_or_else(usual),
        activation: keys.activation,
        form: beside.form,
    };
    let core = match &beside.window {
        None => Core::Dense(shape),
        Some(Window { memory, window, units }) => {
            let (memory, window, units) = (*memory, *window, *units);
            Core::Windowed(Windowed { memory, inputs: scaling.width(), window, units, head: shape })
        }
    };
    let tolles_lawson = terms.coefficients(&in_scale);
    let (members, rows) = match &warm {
        Some(warm) => {
            warm.check(keys, &core, samples)?;
            let members = warm.members(beside.form, &in_scale);
            let members: Vec<Vec<f64>> = members.iter().map(|m| core.scaled(&terms, m)).collect();
            let mut rows = scaled(&train_on, train, (0.0, target.1));
            // The constant of another aircraft is not that of this one.
            let left = members.iter().flat_map(|m| {
                let made = core.predict(m, &rows);
                rows.y.iter().zip(made).map(|(y, made)| y - made).collect::<Vec<f64>>()
            });
            let mean = statistics::mean(&left.collect::<Vec<f64>>()).value;
            if !mean.is_finite() {
                return Err(warm.fault("predicts numbers that are not finite on these lines"));
            }
            target.0 = mean * target.1;
            rows.y.iter_mut().for_each(|y| *y -= mean);
            (members, rows)
        }
        None => {
            let members = (0..keys.members).map(|member| core.initial(member_seed(keys, member), &tolles_lawson));
            (members.collect(), scaled(&train_on, train, target))
        }
    };
    let far = warm.as_ref().map(|warm| warm.far(samples, at, &train_on)).unwrap_or_default();
    let validation = scaled(&validate_on, validate, target);
    let beginning = Beginning { members, linear: tolles_lawson };
    let training_rows = (&rows, &validation);
    let trained = train_members(keys, beside.physics, &core, &beginning, training_rows, target.1, work)?;
    let names = |at: &[usize]| at.iter().map(|&i| samples.names[i].clone()).collect::<Vec<_>>();
    let parameters = trained.iter().map(|t| core.original(&terms, &t.parameters)).collect();
    let model = match core {
        Core::Dense(shape) => {
            let linear = names(&linear_at);
            Learned::Network(trained::Network::new(names(at), scaling.clone(), linear, shape, parameters, target)?)
        }
        Core::Windowed(windowed) => {
            let rate_hz = samples.rate_hz()?;
            let network =
                trained::WindowedNetwork::new(names(at), scaling.clone(), windowed, parameters, target, rate_hz)?;
            Learned::Windowed(network)
        }
    };
    let first = trained.first().ok_or_else(|| Fault::bug("nothing was trained"))?;
    Ok(Learnt {
        model,
        chosen: first.best as f64,
        curve: curve(&trained),
        warning: [far, warning(keys, samples, constant, &trained, !validate_on.is_empty())]
            .into_iter()
            .filter(|said| !said.is_empty())
            .collect::<Vec<_>>()
            .join("; "),
    })
}

/// How the inputs are scaled; those that are constant on the lines to train on are taken out of `at`, and returned. The last
/// are the rows of the lines that the scaling is made of, row-major.
///
/// # Errors
/// When every input is constant, or there are no components as `whiten` asks for.
pub fn scaling(
    samples: &Samples,
    lines: &[usize],
    at: &mut Vec<usize>,
    whiten: Option<f64>,
) -> Result<(Inputs, Vec<usize>, Vec<f64>), Fault> {
    let mut constant = vec![];
    let mut x = samples.columns(at, lines);
    let mut found = Inputs::standardised(&x, at.len());
    if let Err(InputsError::Constant { columns }) = &found {
        constant = columns.iter().filter_map(|&i| at.get(i).copied()).collect();
        at.retain(|i| !constant.contains(i));
        if at.is_empty() {
            return Err(Fault::data("every input is constant").of_param("inputs"));
        }
        x = samples.columns(at, lines);
        found = Inputs::standardised(&x, at.len());
    }
    let fault = |e: InputsError| Fault::data(e.to_string());
    let scaling = found.map_err(fault)?;
    let scaling = match whiten {
        Some(keep) => scaling.whitened(&x, keep).map_err(|e| fault(e).of_param("whiten"))?,
        None => scaling,
    };
    Ok((scaling, constant, x))
}

/// How the linear terms are scaled for the training.
fn term_scaling(
    samples: &Samples,
    lines: &[usize],
    at: &[usize],
    tolles_lawson: &[f64],
    form: Form,
    whiten: Option<f64>,
) -> Result<TermScaling, Fault> {
    let found = TermScaling::of(form, &samples.columns(at, lines), at.len(), whiten, tolles_lawson);
    found.map_err(|e| {
        let whitening = matches!(e, InputsError::Keep { .. });
        let fault = Fault::data(e.to_string());
        if whitening { fault.of_param("whiten") } else { fault }
    })
}

/// Mean and scale of what the network is to explain.
fn target(
    samples: &Samples,
    lines: &[usize],
    linear_at: &[usize],
    coefficients: &[f64],
    form: Form,
) -> Result<(f64, f64), Fault> {
    let mut y = samples.target(lines);
    match form {
        Form::Plain | Form::Weights => {}
        Form::FixedLinear | Form::TrainedLinear | Form::WeightsAroundFixed => {
            let a = samples.columns(linear_at, lines);
            let rows = a.chunks_exact(coefficients.len().max(1));
            let explained = |row: &[f64]| row.iter().zip(coefficients).map(|(a, b)| a * b).sum::<f64>();
            y.iter_mut().zip(rows).for_each(|(y, row)| *y -= explained(row));
        }
    }
    let (mean, scale) = (statistics::mean(&y).value, statistics::std(&y).value);
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(Fault::data("the target is constant: there is nothing to learn").of_param("target"));
    }
    Ok((mean, scale))
}

/// The seed of a member's first weights, batches and dropout.
fn member_seed(keys: &Network, member: usize) -> u64 {
    seed_of(keys.seed as u64, &["member", &member.to_string()])
}

/// Trains all members, one after the other, from where an earlier run left them.
fn train_members(
    keys: &Network,
    physics: f64,
    core: &Core,
    beginning: &Beginning,
    (rows, validation): (&Scaled<'_>, &Scaled<'_>),
    scale_nt: f64,
    work: &PointWork,
) -> Result<Vec<Trained>, Fault> {
    let kept_states = work.kept().and_then(|bytes| read_states(&bytes)).unwrap_or_default();
    let mut states = vec![];
    let validation = (!validation.y.is_empty()).then_some(validation);
    let all_epochs = keys.epochs + keys.lbfgs_epochs;
    let mut trained = vec![];
    for (member, first) in beginning.members.iter().enumerate() {
        let state = kept_states.get(member).cloned().unwrap_or_else(|| {
            let mut state = core.start(first.clone());
            state.tolles_lawson.clone_from(&beginning.linear);
            state
        });
        let training = Training { physics, ..keys.training(member_seed(keys, member)) };
        let (mut stopped, mut kept, begun, from) = (None, None::<Instant>, Instant::now(), state.epoch);
        let mut each = |epoch: &Epoch, state: &State| {
            let done = state.epoch;
            if kept.is_none_or(|last| last.elapsed().as_secs_f64() > KEPT_EVERY_S) {
                kept = Some(Instant::now());
                work.keep(&states_bytes(&states, state));
            }
            let left_s = begun.elapsed().as_secs_f64() / (done - from).max(1) as f64 * (all_epochs - done) as f64;
            match work.goes_on(&progress(epoch, done, all_epochs, member, keys.members, scale_nt, left_s)) {
                Ok(()) => ControlFlow::Continue(()),
                Err(fault) => {
                    work.keep(&states_bytes(&states, state));
                    stopped = Some(fault);
                    ControlFlow::Break(())
                }
            }
        };
        let mut last = None;
        let mut each_kept = |epoch: &Epoch, state: &State| {
            last = Some(state.clone());
            each(epoch, state)
        };
        let found = core.train(state.clone(), &training, rows, validation, &mut each_kept);
        let found = found.map_err(fault)?;
        if let Some(fault) = stopped {
            return Err(fault);
        }
        states.push(last.unwrap_or(state));
        trained.push(found);
    }
    Ok(trained)
}

fn fault(error: TrainingError) -> Fault {
    let fault = Fault::data(error.to_string());
    if matches!(error, TrainingError::Diverged { .. }) { fault.of_param("learning_rate") } else { fault }
}

fn progress(
    epoch: &Epoch,
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
    text.push_str(&format!(" (1 is {scale_nt:.1} nT), {left_s:.0} s left"));
    if members > 1 {
        text.push_str(&format!(", network {} of {members}", member + 1));
    }
    text
}

/// The states of the members that are done, and of the one that is trained: each with its length before it.
fn states_bytes(done: &[State], now: &State) -> Vec<u8> {
    let mut out = vec![];
    for state in done.iter().chain([now]) {
        let bytes = state.to_bytes();
        out.extend((bytes.len() as u64).to_le_bytes());
        out.extend(bytes);
    }
    out
}

fn read_states(mut bytes: &[u8]) -> Option<Vec<State>> {
    let mut states = vec![];
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_first_chunk::<8>()?;
        let (state, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        states.push(State::from_bytes(state).ok()?);
        bytes = rest;
    }
    Some(states)
}

/// The losses of all epochs, as rows of the table.
fn curve(trained: &[Trained]) -> Vec<Term> {
    let mut out = vec![];
    for (m, member) in trained.iter().enumerate() {
        let key = |what: &str| if m == 0 { format!("epoch_{what}") } else { format!("member{}.epoch_{what}", m + 1) };
        let of = |value: fn(&Epoch) -> f64| member.epochs.iter().map(value).collect::<Vec<f64>>();
        out.extend(list(&key("training"), &of(|e| e.train_loss)));
        let validation = of(|e| e.validation_loss);
        if validation.iter().any(|loss| loss.is_finite()) {
            out.extend(list(&key("validation"), &validation));
        }
        out.extend(list(&key("rate"), &of(|e| e.learning_rate)));
    }
    out
}

fn warning(keys: &Network, samples: &Samples, constant: &[usize], trained: &[Trained], validated: bool) -> String {
    let mut all = vec![];
    if !constant.is_empty() {
        let names: Vec<&str> = constant.iter().map(|&i| samples.names[i].as_str()).collect();
        all.push(format!("constant, so no inputs of the network: `{}`", names.join("`, `")));
    }
    let epochs = keys.epochs + keys.lbfgs_epochs;
    if validated && trained.iter().any(|t| t.best == epochs) {
        all.push("the validation loss still fell at the last epoch: more `epochs` would do better".to_owned());
    }
    let ratio = |t: &Trained| {
        let best = t.epochs.get(t.best.checked_sub(1)?)?;
        Some(best.validation_loss / best.train_loss)
    };
    let worst = trained.iter().filter_map(ratio).filter(|r| r.is_finite()).fold(0.0, f64::max);
    if validated && worst > OVERFITS {
        all.push(format!(
            "the loss on the lines of `validation` is {worst:.1} times that of the training: the network overfits"
        ));
    }
    all.join("; ")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use schemas::Literal;

    use crate::fit::testing::{Found, Stopping, bent, fitted_to, number, stage, whole, words, worked};

    fn keys() -> Vec<(String, Literal)> {
        let validation = words("validation", &["1.1"]);
        vec![validation, whole("epochs", 12), whole("members", 2), whole("batch", 50), number("dropout", 0.1)]
    }

    fn table(found: &Found) -> Vec<(String, u64)> {
        found.term.iter().cloned().zip(found.value.iter().map(|v| v.to_bits())).collect()
    }

    #[test]
    fn law_a_training_that_is_stopped_goes_on_to_the_same_table() {
        let whole_way = table(&fitted_to(&bent(), "m1", &keys()));
        for stop in [1, 7, 12, 13, 20] {
            let first = Stopping::after(stop, None);
            let fault = worked(&bent(), "m1", &keys(), &first).err().unwrap();
            assert_eq!(fault.what, "interrupted");
            let second = Stopping::after(usize::MAX, first.state());
            let found = worked(&bent(), "m1", &keys(), &second).unwrap();
            assert_eq!(table(&found), whole_way, "stopped after {stop}");
            assert!(second.told() <= 24 - stop, "it began again");
        }
        let damaged = Stopping::after(usize::MAX, Some(b"nothing".to_vec()));
        assert_eq!(table(&worked(&bent(), "m1", &keys(), &damaged).unwrap()), whole_way);
    }

    #[test]
    fn unit_constant_inputs_are_left_out_and_named() {
        let mut lines = bent();
        for line in &mut lines {
            let constant: arrow_array::ArrayRef = std::sync::Arc::new(arrow_array::Float64Array::from(vec![3.0; 200]));
            let mut columns = line.columns().to_vec();
            columns[4] = constant;
            *line = arrow_array::RecordBatch::try_new(line.schema(), columns).unwrap();
        }
        let found = fitted_to(&lines, "m1", &[whole("epochs", 2)]);
        assert_eq!(found.warning, "constant, so no inputs of the network: `c`");
        assert!(!found.term.iter().any(|t| t.ends_with(" c")), "{:?}", found.term);
    }

    #[test]
    fn unit_what_cannot_be_trained_is_told_with_its_parameter() {
        let said = |keys: &[(String, Literal)]| {
            let fault = match stage("m1", keys) {
                Ok(_) => worked(&bent(), "m1", keys, &schemas::Unattended).err().unwrap(),
                Err(mut faults) => faults.remove(0),
            };
            format!("{} [{}]", fault.what, fault.param.unwrap_or_default())
        };
        assert_eq!(said(&[words("validation", &["1.7"])]), "`1.7` is no line of the fit, and no flight [validation]");
        assert_eq!(said(&[words("validation", &["1"])]), "no line is left to train on [validation]");
        assert_eq!(said(&[words("inputs", &["d"])]), "the features have no entry `d` [inputs]");
        let diverged = said(&[number("learning_rate", 1e200), whole("batch", 10)]);
        let expected = diverged.starts_with("training diverged in epoch 1:") && diverged.ends_with("[learning_rate]");
        assert!(expected, "{diverged}");
    }
}
