//! Start of the training of a network, and the resulting model.

use std::sync::Arc;

use learning::{
    inputs::InputScalingError,
    network::{NetworkForm, NetworkShape, TermScaling, TrainingEpoch, TrainingResult, WindowedNetworkShape},
};
use numerics::{random::seed_of, regression::statistics};
use schemas::Fault;

use super::{
    NetworkInputs, NetworkKeys, NetworkModel, SharedInputs, WindowLayers,
    core::{NetworkCore, ScaledRows},
    warm_start::WarmStart,
};
use crate::{
    fit::{
        model::LearningResult,
        samples::{FitSamples, PointMonitor},
        settings::FitSettings,
    },
    trained::{self, LearnedModel, TermValue, list},
};

/// Overfitting is reported if the validation loss exceeds the training loss by more than this factor.
const OVERFITS: f64 = 4.0;

/// Network of one point of a sweep, to be trained.
pub struct TrainingTask<'a> {
    /// Declaration of the model.
    pub model: NetworkModel<'a>,
    /// Settings that most models have.
    pub settings: &'a FitSettings,
    /// Model that training starts from instead of random weights.
    pub start: Option<&'a LearnedModel>,
    /// Inputs shared with other networks. `None` with a warm start, which has its own scaling.
    pub inputs: Option<&'a SharedInputs>,
    /// Storage of the training states.
    pub work: PointMonitor<'a>,
}

/// A training task with the inputs of its network.
pub struct TrainingInputs<'a> {
    task: &'a TrainingTask<'a>,
    warm: Option<WarmStart<'a>>,
    inputs: Arc<NetworkInputs>,
}

impl<'a> TrainingInputs<'a> {
    /// # Errors
    /// Fails in the cases of [`WarmStart::from_model`] and [`NetworkInputs::from_samples`].
    pub fn new(task: &'a TrainingTask<'a>, samples: &FitSamples) -> Result<Self, Fault> {
        let warm = task.start.map(|model| WarmStart::from_model(model, task.model.form)).transpose()?;
        let inputs = match task.inputs.filter(|_| warm.is_none()) {
            Some(shared) => shared.clone()?,
            None => NetworkInputs::from_samples(&task.model, samples, task.settings.whiten, warm.as_ref())?,
        };
        Ok(Self { task, warm, inputs })
    }

    /// Network with `linear` linear terms.
    fn core(&self, linear: usize) -> NetworkCore {
        let (model, scaling) = (&self.task.model, &self.inputs.scaling);
        let usual = || self.warm.as_ref().map_or_else(|| model.hidden.to_vec(), WarmStart::hidden);
        let head = NetworkShape {
            inputs: model.window.map_or_else(|| scaling.width(), |window| window.features(scaling.width())),
            linear,
            hidden: if model.has_inputs() { model.keys.hidden.clone().unwrap_or_else(usual) } else { vec![] },
            activation: model.keys.activation,
            form: model.form,
        };
        match model.window {
            None => NetworkCore::Dense(head),
            Some(layers) => {
                let WindowLayers { memory, window, heads, .. } = layers;
                let (inputs, units) = (scaling.width(), layers.units(scaling.width()));
                NetworkCore::Windowed(WindowedNetworkShape { memory, inputs, window, heads, units, head })
            }
        }
    }
}

/// Start of the training of all members.
pub struct TrainingSetup<'a> {
    /// Task to train.
    pub task: &'a TrainingTask<'a>,
    /// Network to train.
    pub core: NetworkCore,
    /// Initial parameters of each member.
    pub members: Vec<Vec<f64>>,
    /// Coefficients of the linear model in the scale of the target. They apply to the scaled terms or, for a vector
    /// form, to the original terms.
    pub linear: Vec<f64>,
    /// Training rows.
    pub rows: ScaledRows<'a>,
    /// Validation rows, if any.
    pub validation: Option<ScaledRows<'a>>,
    inputs: &'a NetworkInputs,
    terms: TermScaling,
    linear_at: Vec<usize>,
    /// Mean and scale of the target, in nT.
    target: (f64, f64),
    /// Warning about inputs that are far from the training data of the warm start.
    far: String,
}

impl<'a> TrainingSetup<'a> {
    /// # Errors
    /// Fails if the data do not determine the network, or the warm start does not match.
    pub fn new(ready: &'a TrainingInputs<'a>, samples: &FitSamples) -> Result<Self, Fault> {
        let TrainingInputs { task, warm, inputs } = ready;
        let TrainingTask { model, settings, .. } = task;
        let NetworkInputs { at, lines: (train_on, validate_on), rows: (train, validate), .. } = inputs.as_ref();
        let (linear_at, coefficients) = match model.linear {
            Some(part) => {
                let mut places = match model.vector {
                    Some(_) => part.vector_places(samples)?,
                    None => part.places(samples, model.all_features)?,
                };
                if let Some(warm) = warm {
                    warm.order_terms(samples, &mut places)?;
                    warm.check_frame(model.vector)?;
                }
                let fitted = part.fit(samples, train_on, &places)?;
                (places, fitted)
            }
            None => (vec![], vec![]),
        };
        if let Some(keys) = model.vector {
            keys.check(&samples.columns(&linear_at, train_on), linear_at.len())?;
        }
        let mut target = target(samples, train_on, &linear_at, &coefficients, model)?;
        if let Some(warm) = warm {
            target.1 = warm.scale_nt();
        }
        let in_scale: Vec<f64> = coefficients.iter().map(|b| b / target.1).collect();
        // The first phases of a curriculum train groups of coefficients, which whitening would mix.
        let whiten = settings.whiten.filter(|_| model.curriculum.is_none());
        let terms = term_scaling(samples, train_on, &linear_at, &in_scale, model.form, whiten)?;
        let frame = model.vector.map(|keys| keys.frame(target.1));
        let rows_of = |lines: &[usize]| {
            let a = samples.columns(&linear_at, lines);
            frame.map_or_else(|| terms.apply(a.clone()), |frame| frame.rows(&a, linear_at.len()))
        };
        let offset = if frame.is_some() { 0.0 } else { terms.offset() };
        let scaled = |lines: &[usize], x, (mean, scale): (f64, f64)| ScaledRows {
            x,
            a: rows_of(lines),
            y: samples.target(lines).iter().map(|y| (y - mean) / scale - offset).collect(),
            runs: samples.runs(lines),
        };
        let core = ready.core(linear_at.len());
        let linear = terms.coefficients(&in_scale);
        let mut rows = scaled(train_on, train, if warm.is_some() { (0.0, target.1) } else { target });
        let members: Vec<Vec<f64>> = match warm {
            Some(warm) => {
                warm.check(model.keys, &core, samples)?;
                let members = warm.members(model.form, &in_scale);
                let scaled: Vec<Vec<f64>> = members.iter().map(|m| core.scaled(&terms, m)).collect();
                // The constant of another aircraft does not apply to this aircraft.
                let left = if frame.is_some() { &members } else { &scaled }.iter().flat_map(|m| {
                    let made = core.predict(m, &rows);
                    rows.y.iter().zip(made).map(|(y, made)| y - made).collect::<Vec<f64>>()
                });
                let mean = statistics::mean(&left.collect::<Vec<f64>>()).value;
                if !mean.is_finite() {
                    return Err(warm.fault("predicts values that are not finite on these lines"));
                }
                target.0 = mean * target.1;
                rows.y.iter_mut().for_each(|y| *y -= mean);
                scaled
            }
            None => (0..model.keys.members).map(|m| core.initial(member_seed(model.keys, m), &linear)).collect(),
        };
        let far = warm.as_ref().map(|warm| warm.far(samples, at, train_on)).unwrap_or_default();
        let validation = (!validate_on.is_empty()).then(|| scaled(validate_on, validate, target));
        let linear = if frame.is_some() { in_scale } else { linear };
        Ok(Self { task, core, members, linear, rows, validation, inputs, terms, linear_at, target, far })
    }

    /// Scaling that training applies to the coefficients of a vector form. `None` for other forms.
    pub fn conditioning(&self) -> Option<TermScaling> {
        self.task.model.vector.map(|_| self.terms.clone())
    }

    /// Scale of the target, in nT.
    pub fn scale_nt(&self) -> f64 {
        self.target.1
    }

    /// Model after the training of its members.
    ///
    /// # Errors
    /// Fails if the parameters of the network do not match its shape, or the samples of a network over a window have no
    /// rate.
    pub fn learnt(self, samples: &FitSamples, trained: &[TrainingResult]) -> Result<LearningResult, Fault> {
        let names = |at: &[usize]| at.iter().map(|&i| samples.names[i].clone()).collect::<Vec<_>>();
        let parameters = trained.iter().map(|t| self.core.original(&self.terms, &t.parameters)).collect();
        let NetworkInputs { at, constant, scaling, .. } = self.inputs;
        let (inputs, scaling, linear) = (names(at), scaling.clone(), names(&self.linear_at));
        let frame = self.task.model.vector.map(|keys| keys.frame(self.target.1));
        let model = match self.core {
            NetworkCore::Dense(shape) => {
                let parts = trained::NetworkColumns::new(inputs, linear, frame);
                LearnedModel::Network(trained::NetworkEnsemble::new(parts, scaling, shape, parameters, self.target)?)
            }
            NetworkCore::Windowed(windowed) => {
                let rate_hz = samples.rate_hz()?;
                let parts = trained::NetworkColumns::new(inputs, linear, frame);
                let network =
                    trained::WindowedNetwork::new(parts, scaling, windowed, parameters, self.target, rate_hz)?;
                LearnedModel::Windowed(network)
            }
        };
        let first = trained.first().ok_or_else(|| Fault::bug("nothing was trained"))?;
        Ok(LearningResult {
            model,
            chosen: first.best as f64,
            curve: curve(trained),
            warning: [self.far, warning(self.task.model.keys, samples, constant, trained, self.validation.is_some())]
                .into_iter()
                .filter(|message| !message.is_empty())
                .collect::<Vec<_>>()
                .join("; "),
        })
    }
}

/// Scaling of the linear terms during training.
fn term_scaling(
    samples: &FitSamples,
    lines: &[usize],
    at: &[usize],
    tolles_lawson: &[f64],
    form: NetworkForm,
    whiten: Option<f64>,
) -> Result<TermScaling, Fault> {
    let found = TermScaling::new(form, &samples.columns(at, lines), at.len(), whiten, tolles_lawson);
    found.map_err(|e| {
        let whitening = matches!(e, InputScalingError::Keep { .. });
        let fault = Fault::data(e.to_string());
        if whitening { fault.of_param("whiten") } else { fault }
    })
}

/// Mean and scale of the target of the network.
fn target(
    samples: &FitSamples,
    lines: &[usize],
    linear_at: &[usize],
    coefficients: &[f64],
    model: &NetworkModel<'_>,
) -> Result<(f64, f64), Fault> {
    let mut y = samples.target(lines);
    match model.form {
        NetworkForm::VectorOnly | NetworkForm::VectorScalar | NetworkForm::VectorNetwork => {
            let fields =
                model.vector.map(|keys| keys.frame(1.0).fields(&samples.columns(linear_at, lines), coefficients));
            y.iter_mut().zip(fields.iter().flatten()).for_each(|(y, field)| *y -= field);
        }
        NetworkForm::Plain | NetworkForm::Weights => {}
        NetworkForm::FixedLinear | NetworkForm::TrainedLinear | NetworkForm::WeightsAroundFixed => {
            let a = samples.columns(linear_at, lines);
            let rows = a.chunks_exact(coefficients.len().max(1));
            let explained = |row: &[f64]| row.iter().zip(coefficients).map(|(a, b)| a * b).sum::<f64>();
            y.iter_mut().zip(rows).for_each(|(y, row)| *y -= explained(row));
        }
    }
    let (mean, scale) = (statistics::mean(&y).value, statistics::std(&y).value);
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(Fault::data("the target is constant, so there is nothing to fit").of_param("target"));
    }
    Ok((mean, scale))
}

/// Seed of a member's initial weights, batches and dropout.
pub fn member_seed(keys: &NetworkKeys, member: usize) -> u64 {
    seed_of(keys.seed as u64, &["member", &member.to_string()])
}

/// Losses of all epochs, as rows of the table.
fn curve(trained: &[TrainingResult]) -> Vec<TermValue> {
    let mut out = vec![];
    for (m, member) in trained.iter().enumerate() {
        let key = |what: &str| if m == 0 { format!("epoch_{what}") } else { format!("member{}.epoch_{what}", m + 1) };
        let of = |value: fn(&TrainingEpoch) -> f64| member.epochs.iter().map(value).collect::<Vec<f64>>();
        out.extend(list(&key("training"), &of(|e| e.train_loss)));
        let validation = of(|e| e.validation_loss);
        if validation.iter().any(|loss| loss.is_finite()) {
            out.extend(list(&key("validation"), &validation));
        }
        out.extend(list(&key("rate"), &of(|e| e.learning_rate)));
    }
    out
}

fn warning(
    keys: &NetworkKeys,
    samples: &FitSamples,
    constant: &[usize],
    trained: &[TrainingResult],
    validated: bool,
) -> String {
    let mut all = vec![];
    if !constant.is_empty() {
        let names: Vec<&str> = constant.iter().map(|&i| samples.names[i].as_str()).collect();
        all.push(format!("constant and not used as inputs of the network: `{}`", names.join("`, `")));
    }
    let epochs = keys.epochs + keys.lbfgs_epochs;
    if validated && trained.iter().any(|t| t.best == epochs) {
        all.push("the validation loss was still falling at the last epoch; increase `epochs`".to_owned());
    }
    let ratio = |t: &TrainingResult| {
        let best = t.epochs.get(t.best.checked_sub(1)?)?;
        Some(best.validation_loss / best.train_loss)
    };
    let worst = trained.iter().filter_map(ratio).filter(|r| r.is_finite()).fold(0.0, f64::max);
    if validated && worst > OVERFITS {
        all.push(format!("the validation loss is {worst:.1} times the training loss; the network overfits"));
    }
    all.join("; ")
}
