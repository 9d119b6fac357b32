//! Initial weights from another trained network.

use learning::{
    inputs::InputScaling,
    network::{NetworkForm, NetworkShape, VectorFrame},
};
use schemas::Fault;

use super::{NetworkKeys, VectorModelKeys, core::NetworkCore};
use crate::{
    fit::samples::FitSamples,
    trained::{LearnedModel, NetworkLayers, NetworkParts},
};

/// Limit of the root mean square distance of an input from its mean in the first training, in standard deviations of
/// the first training. A warning names the inputs above this limit.
const FAR: f64 = 10.0;
/// Maximum number of names listed in a fault.
const NAMED: usize = 6;

/// Network of another fit from which training starts.
///
/// Inputs and target keep the scales of the initial network, which its weights require.
pub struct WarmStart<'a> {
    parts: NetworkParts<'a>,
}

impl<'a> WarmStart<'a> {
    /// Warm start from `model` for a network of the form `form`.
    ///
    /// # Errors
    /// Fails if the model is not a network, or has another form.
    pub fn from_model(model: &'a LearnedModel, form: NetworkForm) -> Result<Self, Fault> {
        let none = || {
            let fault = Fault::data("the model of `warm_start` is not a network").of_param("warm_start");
            fault.help("give the table of a `fit` stage with a network")
        };
        let start = Self { parts: model.parts().ok_or_else(none)? };
        if start.head().form == form {
            return Ok(start);
        }
        Err(start.fault(&format!("has `model` {}, but this fit has {}", start.head().form.word(), form.word())))
    }

    /// Checks that the initial network has the vector form of this fit.
    ///
    /// # Errors
    /// Fails if the coupling, or the scale of the terms, differs.
    pub fn check_frame(&self, keys: Option<&VectorModelKeys>) -> Result<(), Fault> {
        let (Some(own), Some(keys)) = (self.parts.frame, keys) else { return Ok(()) };
        let here = keys.frame(own.target_scale_nt);
        if own == here {
            return Ok(());
        }
        let text = |frame: VectorFrame| format!("{} with `bt_scale_nt` {}", frame.coupling.word(), frame.bt_scale_nt);
        Err(self.fault(&format!("has `coupling` {}, but this fit has {}", text(own), text(here))))
    }

    /// Fault of a warm start that does not match this fit.
    pub fn fault(&self, what: &str) -> Fault {
        Fault::data(format!("the network of `warm_start` {what}")).of_param("warm_start")
    }

    fn head(&self) -> &NetworkShape {
        match self.parts.layers {
            NetworkLayers::Dense(shape) => shape,
            NetworkLayers::Windowed(windowed, _) => &windowed.head,
        }
    }

    /// Number of units of the initial network's hidden layers.
    pub fn hidden(&self) -> Vec<usize> {
        self.head().hidden.clone()
    }

    /// Scale of the initial network's target, in nT.
    pub fn scale_nt(&self) -> f64 {
        self.parts.scale_nt
    }

    /// Scaling of the initial network's inputs. Sorts `at` into the order of these inputs.
    ///
    /// # Errors
    /// Fails if the initial network has other inputs, or another number of principal components than `whiten` requests.
    pub fn scaling(
        &self,
        samples: &FitSamples,
        at: &mut Vec<usize>,
        whiten: Option<f64>,
    ) -> Result<InputScaling, Fault> {
        self.order("inputs", self.parts.inputs, samples, at)?;
        let own = self.parts.scaling.components.as_ref().map(|components| components.count);
        let same = match (own, whiten) {
            (None, None) => true,
            // Below 1, `whiten` is a fraction of the variance and gives no fixed number of components.
            (Some(own), Some(keep)) => keep < 1.0 || keep == own as f64,
            (Some(_), None) | (None, Some(_)) => false,
        };
        if same {
            return Ok(self.parts.scaling.clone());
        }
        let what = match own {
            Some(count) => format!("uses {count} principal components"),
            None => "uses no principal components".to_owned(),
        };
        Err(self.fault(&what).help("set `whiten` as in the fit of that network"))
    }

    /// Sorts the positions of the linear terms into the order of the initial network's terms.
    ///
    /// # Errors
    /// Fails if the initial network has different terms.
    pub fn order_terms(&self, samples: &FitSamples, at: &mut Vec<usize>) -> Result<(), Fault> {
        self.order("linear", self.parts.linear, samples, at)
    }

    fn order(&self, key: &str, names: &[String], samples: &FitSamples, at: &mut Vec<usize>) -> Result<(), Fault> {
        let place = |name: &String| at.iter().copied().find(|&i| samples.names.get(i) == Some(name));
        let found: Vec<Option<usize>> = names.iter().map(place).collect();
        let lacking = names.iter().zip(&found).filter(|(_, place)| place.is_none()).map(|(name, _)| name);
        let more = at.iter().filter_map(|&i| samples.names.get(i)).filter(|name| !names.contains(name));
        let (lacking, more) = (listed(lacking), listed(more));
        let noun = if key == "linear" { "linear terms" } else { "inputs" };
        let what = match (lacking, more) {
            (None, None) => {
                *at = found.into_iter().flatten().collect();
                return Ok(());
            }
            (Some(lacking), None) => format!("has the {noun} {lacking}, which this fit lacks"),
            (None, Some(more)) => format!("lacks the {noun} {more}, which this fit has"),
            (Some(lacking), Some(more)) => format!("has the {noun} {lacking} instead of {more}"),
        };
        Err(self.fault(&what).help(format!("use the same `{key}` in both fits, or rename columns with `rename`")))
    }

    /// Checks that the initial network suits this fit and is of the same kind as `core`.
    ///
    /// # Errors
    /// Fails with the first difference.
    pub fn check(&self, keys: &NetworkKeys, core: &NetworkCore, samples: &FitSamples) -> Result<(), Fault> {
        let other = |key: &str, own: &dyn std::fmt::Display, here: &dyn std::fmt::Display| {
            Err(self.fault(&format!("has `{key}` {own}, but this fit has {here}")))
        };
        let head = match (core, self.parts.layers) {
            (NetworkCore::Dense(shape), NetworkLayers::Dense(_)) => shape,
            (NetworkCore::Windowed(here), NetworkLayers::Windowed(own, rate_hz)) => {
                if own.memory != here.memory {
                    return other("model", &own.memory.word(), &here.memory.word());
                }
                if own.heads != here.heads {
                    return other("heads", &own.heads, &here.heads);
                }
                if (own.window, own.units) != (here.window, here.units) {
                    let what =
                        |w: &learning::network::WindowedNetworkShape| format!("{} with {} units", w.window, w.units);
                    return other("window", &what(own), &what(here));
                }
                let here_hz = samples.rate_hz()?;
                if (here_hz / rate_hz - 1.0).abs() > 0.01 {
                    let what = format!("was trained at {rate_hz} Hz, but these lines are sampled at {here_hz} Hz");
                    return Err(self.fault(&what).help("add a `resample` stage, so that both have the same rate"));
                }
                &here.head
            }
            (NetworkCore::Dense(_), NetworkLayers::Windowed(..)) => {
                return Err(self.fault("uses a window of samples, but this model uses single samples"));
            }
            (NetworkCore::Windowed(_), NetworkLayers::Dense(_)) => {
                return Err(self.fault("uses single samples, but this model uses a window"));
            }
        };
        let own = self.head();
        if own.activation != head.activation {
            return other("activation", &own.activation.word(), &head.activation.word());
        }
        if own.hidden != head.hidden {
            return other("hidden", &format!("{:?}", own.hidden), &format!("{:?}", head.hidden));
        }
        if self.parts.members.len() != keys.members {
            return other("members", &self.parts.members.len(), &keys.members);
        }
        Ok(())
    }

    /// Parameters of the initial network's members. If the form does not train the coefficients, `linear` replaces
    /// them, in the scale of the initial network's target.
    pub fn members(&self, form: NetworkForm, linear: &[f64]) -> Vec<Vec<f64>> {
        let begin = |member: &Vec<f64>| {
            let mut member = member.clone();
            let first = member.len().saturating_sub(linear.len());
            match form {
                NetworkForm::FixedLinear | NetworkForm::WeightsAroundFixed => {
                    member.iter_mut().skip(first).zip(linear).for_each(|(own, new)| *own = *new);
                }
                NetworkForm::Plain
                | NetworkForm::Weights
                | NetworkForm::TrainedLinear
                | NetworkForm::VectorOnly
                | NetworkForm::VectorScalar
                | NetworkForm::VectorNetwork => {}
            }
            member
        };
        self.parts.members.iter().map(begin).collect()
    }

    /// Warning about inputs that are far from the data of the first training. Empty if there are no such inputs.
    pub fn far(&self, samples: &FitSamples, at: &[usize], lines: &[usize]) -> String {
        let InputScaling { mean, scale, .. } = self.parts.scaling;
        let x = samples.columns(at, lines);
        let far = at.iter().enumerate().filter(|(column, _)| {
            let (mean, scale) = (mean.get(*column).copied(), scale.get(*column).copied());
            let (mean, scale) = (mean.unwrap_or(f64::NAN), scale.unwrap_or(f64::NAN));
            let values = x.iter().skip(*column).step_by(at.len().max(1));
            let squares: f64 = values.clone().map(|x| ((x - mean) / scale).powi(2)).sum();
            (squares / values.count().max(1) as f64).sqrt() > FAR
        });
        let names = listed(far.filter_map(|(_, &i)| samples.names.get(i)));
        names.map_or_else(String::new, |names| {
            format!(
                "inputs more than {FAR} standard deviations from their mean in the training of `warm_start`: {names}"
            )
        })
    }
}

/// The first names of a list, as text. `None` if the list is empty.
fn listed<'a>(names: impl Iterator<Item = &'a String>) -> Option<String> {
    let all: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    let rest = all.len().saturating_sub(NAMED);
    let shown = all.get(..NAMED).unwrap_or(&all).join(", ");
    match (all.is_empty(), rest) {
        (true, _) => None,
        (false, 0) => Some(shown),
        (false, rest) => Some(format!("{shown} and {rest} more")),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::Literal;

    use crate::fit::testing::{
        FitOutput, another, begun_with, bent, delayed, fitted_to, flag, number, whole, word, words,
    };

    type Keys = Vec<(String, Literal)>;

    /// Models with the keys that these tests need.
    fn models() -> Vec<(&'static str, Keys)> {
        let terms = || vec![words("linear", &["a", "b"])];
        let with_linear_terms = ["m2a", "m2b", "m2c", "m2d", "tlnn"].map(|model| (model, terms()));
        let windowed = ["gru", "lstm", "tcn"].map(|model| (model, vec![whole("window", 4)]));
        [("m1", vec![]), ("etlnn", vec![])].into_iter().chain(with_linear_terms).chain(windowed).collect()
    }

    /// The weights in a table and the scale of the target, by name.
    fn weights(found: &FitOutput) -> Vec<(&str, f64)> {
        let is_weight = |name: &str| {
            let other = ["epoch_", "target_mean", "linear["];
            !other.iter().any(|begin| name.split_once('.').map_or(name, |(_, rest)| rest).starts_with(begin))
        };
        let all = found.term.iter().zip(&found.value).filter(|(name, _)| is_weight(name));
        all.map(|(name, value)| (name.as_str(), *value)).collect()
    }

    fn value(found: &FitOutput, term: &str) -> f64 {
        found.value[found.term.iter().position(|t| t == term).unwrap()]
    }

    #[test]
    fn unit_a_learning_rate_near_zero_keeps_the_network() {
        for (model, more) in models() {
            let keys = |rate: f64| {
                let usual = [whole("epochs", 3), whole("members", 2), number("learning_rate", rate)];
                [&usual[..], &more[..]].concat()
            };
            let first = fitted_to(&bent(), model, &keys(0.01));
            let second = begun_with(&first, &another(), model, &keys(1e-300)).unwrap();
            let (before, after) = (weights(&first), weights(&second));
            assert_eq!(before.len(), after.len(), "{model}");
            for ((name, before), (same, after)) in before.into_iter().zip(after) {
                // Parameters of linear terms differ by rounding errors, because they are scaled and then unscaled.
                let near = (before - after).abs() <= 1e-12 * (1.0 + before.abs());
                assert!(name == same && near, "{model} {name} {same}: {before} {after}");
            }
            // The warm start adapts to the constant of the other aircraft, 700 nT instead of 40 nT.
            let moved = value(&second, "target_mean") - value(&first, "target_mean");
            assert!((moved - 660.0).abs() < 60.0, "{model}: {moved}");
        }
    }

    #[test]
    fn unit_only_trained_coefficients_are_taken_from_the_warm_start() {
        let keys = |rate: f64| {
            vec![
                words("linear", &["a", "b", "c"]),
                whole("epochs", 2),
                number("learning_rate", rate),
                number("linear_low_hz", 0.0),
                number("linear_high_hz", 0.0),
                number("lambda", 0.0),
            ]
        };
        let of = |found: &FitOutput| value(found, "linear[1]") * value(found, "target_scale");
        for (model, goes_along) in [("m2b", false), ("m2d", false), ("m2c", true)] {
            let first = fitted_to(&bent(), model, &keys(1e-3));
            let second = begun_with(&first, &another(), model, &keys(1e-300)).unwrap();
            let cold = fitted_to(&another(), model, &keys(1e-300));
            let expected = if goes_along { of(&first) } else { of(&cold) };
            assert!((of(&second) / expected - 1.0).abs() < 1e-12, "{model}: {} {expected}", of(&second));
        }
    }

    #[test]
    fn unit_a_warm_start_helps_with_few_epochs_and_samples() {
        let keys = |epochs: i64| vec![whole("epochs", epochs), number("learning_rate", 0.01), whole("batch", 50)];
        for model in ["m1", "gru"] {
            let first = fitted_to(&bent(), model, &keys(150));
            let warm = begun_with(&first, &another(), model, &keys(5)).unwrap();
            let cold = fitted_to(&another(), model, &keys(5));
            assert!(warm.residual_std < 0.3 * cold.residual_std, "{} {}", warm.residual_std, cold.residual_std);
            assert_eq!(warm.warning, "");
        }
    }

    #[test]
    fn unit_the_order_of_inputs_and_terms_does_not_matter() {
        let keys = |order: &[&str]| {
            vec![words("inputs", order), words("linear", order), whole("epochs", 4), number("learning_rate", 0.01)]
        };
        let first = fitted_to(&bent(), "m2c", &keys(&["a", "b", "c"]));
        let [one, other] = [["a", "b", "c"], ["c", "a", "b"]]
            .map(|order| begun_with(&first, &another(), "m2c", &keys(&order)).unwrap());
        assert_eq!((one.term.clone(), weights(&one)), (other.term.clone(), weights(&other)));
        // The order of the terms changes the last digits of the ridge solution.
        assert!((one.residual_std / other.residual_std - 1.0).abs() < 1e-9);
    }

    #[test]
    fn unit_a_different_network_is_rejected_with_the_difference() {
        let first = |model: &str, keys: &[(String, Literal)]| {
            fitted_to(&bent(), model, &[&[whole("epochs", 1)][..], keys].concat())
        };
        let why = |first: &FitOutput, model: &str, keys: &[(String, Literal)]| {
            let fault = begun_with(first, &bent(), model, &[&[whole("epochs", 1)][..], keys].concat()).err().unwrap();
            assert_eq!(fault.param.as_deref(), Some("warm_start"), "{fault}");
            fault.what
        };
        let m1 = first("m1", &[]);
        let assert_reason = |found: String, what: &str| assert!(found.contains(what), "{found}");
        assert_reason(why(&m1, "m1", &[words("inputs", &["a", "b"])]), "has the inputs `c`, which this fit lacks");
        assert_reason(
            why(&first("m1", &[words("inputs", &["a"])]), "m1", &[]),
            "lacks the inputs `b`, `c`, which this fit has",
        );
        assert_reason(why(&m1, "m1", &[word("activation", "tanh")]), "has `activation` swish, but this fit has tanh");
        let eight = ("hidden".to_owned(), Literal::List(vec![Literal::Int(8), Literal::Int(4)]));
        assert_reason(why(&m1, "m1", std::slice::from_ref(&eight)), "has `hidden` [8], but this fit has [8, 4]");
        assert_reason(why(&m1, "m1", &[whole("members", 2)]), "has `members` 1, but this fit has 2");
        assert_reason(why(&m1, "m1", &[number("whiten", 2.0)]), "uses no principal components");
        let m2c = first("m2c", &[words("linear", &["a"])]);
        assert_reason(why(&m2c, "m2b", &[words("linear", &["a"])]), "has `model` m2c, but this fit has m2b");
        assert_reason(why(&m2c, "m2c", &[words("linear", &["b"])]), "has the linear terms `a` instead of `b`");
        assert_reason(why(&m1, "gru", &[]), "uses single samples, but this model uses a window");
        let gru = first("gru", &[whole("window", 4)]);
        assert_reason(why(&gru, "lstm", &[whole("window", 4)]), "has `model` gru, but this fit has lstm");
        assert_reason(why(&gru, "gru", &[]), "has `window` 4 with 8 units, but this fit has 16 with 8 units");
        assert_reason(why(&fitted_to(&bent(), "ridge", &[flag("intercept", true)]), "m1", &[]), "is linear");
        assert_reason(why(&first_trees(), "m1", &[]), "is not a network");
        let mut cut = first("m1", &[]);
        cut.term.remove(9);
        cut.value.remove(9);
        assert_reason(why(&cut, "m1", &[]), "the model cannot be used");
        // If `hidden` is unset, the network has the layers of the initial network.
        let deep = first("m1", &[eight]);
        assert!(begun_with(&deep, &delayed(), "m1", &[whole("epochs", 1)]).is_ok());
    }

    fn first_trees() -> FitOutput {
        fitted_to(&bent(), "boosted_trees", &[whole("trees", 2)])
    }

    #[test]
    fn unit_inputs_far_from_the_first_training_are_listed() {
        let first = fitted_to(&bent(), "m1", &[whole("epochs", 1)]);
        let far: Vec<_> = another()
            .into_iter()
            .map(|line| {
                let mut columns = line.columns().to_vec();
                columns[3] = std::sync::Arc::new(arrow_array::Float64Array::from(vec![1e6; line.num_rows()]));
                arrow_array::RecordBatch::try_new(line.schema(), columns).unwrap()
            })
            .collect();
        let found = begun_with(&first, &far, "m1", &[whole("epochs", 1)]).unwrap();
        let expected = "inputs more than 10 standard deviations from their mean in the training of `warm_start`: `b`";
        assert_eq!(found.warning, expected);
    }
}
