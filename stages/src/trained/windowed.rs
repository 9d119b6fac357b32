//! A network over a window of samples in a model table.
//!
//! The inputs are scaled as in [`network`](super::network): z = (x - `input_mean`) / `input_scale`. `memory` computes
//! features of `window` samples at `rate_hz`, of which the last is the predicted sample. A dense network with `hidden`
//! layers computes the field from these features: `target_mean` + `target_scale` N. If a run of samples is shorter than
//! the window, its first sample replaces the missing earlier samples. With the linear terms of a vector form, the
//! prediction has the form `m3s` of [`network`](super::network). The weights have the names of their PyTorch layout:
//! [`learning::network::WindowedNetworkShape`].

use learning::{
    inputs::InputScaling,
    network::{MemoryLayers, NetworkForm, NetworkShape, WindowedNetworkShape},
};
use numerics::regression::statistics;
use schemas::Fault;

use super::{
    FieldPrediction, NetworkColumns, NetworkLayers, NetworkParts,
    terms::{TermLookup, TermValue, broken, list, member_of, named_list, term},
};

/// Largest relative difference between the sample rates of a line and of the training.
const RATE_TOLERANCE: f64 = 0.01;

/// Network over a window of samples, or the mean of several of one shape.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowedNetwork {
    columns: NetworkColumns,
    scaling: InputScaling,
    core: WindowedNetworkShape,
    members: Vec<Vec<f64>>,
    /// Mean and scale of the target, in nT.
    target: (f64, f64),
    /// Sample rate, in Hz.
    rate_hz: f64,
}

impl WindowedNetwork {
    /// Creates the model from its parts. The parameters of each member are in the order of
    /// [`WindowedNetworkShape::names`].
    ///
    /// # Errors
    /// Fails if the parts do not match.
    pub fn new(
        columns: NetworkColumns,
        scaling: InputScaling,
        core: WindowedNetworkShape,
        members: Vec<Vec<f64>>,
        target: (f64, f64),
        rate_hz: f64,
    ) -> Result<Self, Fault> {
        core.check().map_err(|e| broken(e.to_string()))?;
        let inputs = columns.inputs.len();
        let fits = scaling.components.is_none()
            && scaling.mean.len() == inputs
            && scaling.scale.len() == inputs
            && core.inputs == inputs
            && core.head.linear == columns.linear.len()
            && core.head.form.is_vector() == columns.frame.is_some()
            && rate_hz > 0.0
            && !members.is_empty()
            && members.iter().all(|m| m.len() == core.parameters());
        if !fits {
            return Err(broken("its parts have different sizes".to_owned()));
        }
        Ok(Self { columns, scaling, core, members, target, rate_hz })
    }

    /// Names of the columns of an input row.
    pub fn columns(&self) -> &[String] {
        &self.columns.all
    }

    /// See [`LearnedModel::parts`](super::LearnedModel::parts).
    pub fn parts(&self) -> NetworkParts<'_> {
        NetworkParts {
            inputs: &self.columns.inputs,
            scaling: &self.scaling,
            linear: &self.columns.linear,
            frame: self.columns.frame,
            layers: NetworkLayers::Windowed(&self.core, self.rate_hz),
            members: &self.members,
            scale_nt: self.target.1,
        }
    }

    /// Checks that the network accepts samples at this rate.
    ///
    /// # Errors
    /// Fails if the network was trained at another rate.
    pub fn check_rate(&self, rate_hz: f64) -> Result<(), Fault> {
        if (rate_hz / self.rate_hz - 1.0).abs() <= RATE_TOLERANCE {
            return Ok(());
        }
        let what = format!(
            "the model uses a window of samples at {} Hz, but the line is sampled at {rate_hz} Hz",
            self.rate_hz
        );
        Err(Fault::data(what).help("add a `resample` stage, so that the line has the rate of the fit"))
    }

    /// Prediction for rows that form runs of these lengths.
    pub fn predict(&self, x: &[f64], runs: &[usize]) -> FieldPrediction {
        let (mean, scale) = self.target;
        let (inputs, linear) = self.columns.split(x);
        let (z, a) = (self.scaling.apply(&inputs), self.columns.rows(linear));
        let all: Vec<Vec<f64>> = self.members.iter().map(|m| self.core.predict(m, &z, &a, runs)).collect();
        let rows = x.len() / self.columns().len().max(1);
        let of_row = |row: usize| all.iter().filter_map(|m| m.get(row)).map(|y| mean + scale * y).collect::<Vec<f64>>();
        let values: Vec<Vec<f64>> = (0..rows).map(of_row).collect();
        let sigma_nt = (self.members.len() > 1).then(|| values.iter().map(|v| statistics::std(v).value).collect());
        FieldPrediction { field_nt: values.iter().map(|v| statistics::mean(v).value).collect(), sigma_nt }
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<TermValue> {
        let WindowedNetworkShape { memory, window, units, heads, head, .. } = &self.core;
        let hidden: Vec<f64> = head.hidden.iter().map(|units| *units as f64).collect();
        let mut out = vec![
            term(format!("memory {}", memory.word()), 1.0),
            term(format!("activation {}", head.activation.word()), 1.0),
            term("window", *window as f64),
            term("units", *units as f64),
            term("rate_hz", self.rate_hz),
        ];
        if *memory == MemoryLayers::Transformer {
            out.push(term("heads", *heads as f64));
        }
        out.extend(list("hidden", &hidden));
        out.extend(named_list("input_mean", &self.columns.inputs, &self.scaling.mean));
        out.extend(list("input_scale", &self.scaling.scale));
        out.extend(self.columns.linear_terms());
        out.push(term("target_mean", self.target.0));
        out.push(term("target_scale", self.target.1));
        out.push(term("members", self.members.len() as f64));
        let names = self.core.names();
        for (m, member) in self.members.iter().enumerate() {
            out.extend(names.iter().zip(member).map(|(name, value)| term(format!("{}{name}", member_of(m)), *value)));
        }
        out
    }

    /// Reads the network of a table.
    ///
    /// # Errors
    /// Fails if the table is incomplete.
    pub fn read(terms: &TermLookup) -> Result<Self, Fault> {
        let memory: MemoryLayers = terms.choice("memory")?;
        let activation = terms.choice("activation")?;
        let (_, hidden) = terms.list("hidden")?;
        let (inputs, mean) = terms.list("input_mean")?;
        let (_, scale) = terms.list("input_scale")?;
        if scale.iter().any(|s| *s <= 0.0) {
            return Err(broken("an input has no scale".to_owned()));
        }
        let (window, units) = (terms.count("window")?, terms.count("units")?);
        let hidden = hidden.iter().map(|units| *units as usize).collect();
        let vector = terms.word("coupling").is_ok();
        let form = if vector { NetworkForm::VectorScalar } else { NetworkForm::Plain };
        let columns = NetworkColumns::read(terms, inputs, vector)?;
        let (inputs, linear) = (&columns.inputs, columns.linear.len());
        let transformer = memory == MemoryLayers::Transformer;
        let heads = if transformer { terms.count("heads")? } else { 1 };
        let features = if transformer { units.saturating_mul(window) } else { units };
        let head = NetworkShape { inputs: features, linear, hidden, activation, form };
        let core = WindowedNetworkShape { memory, inputs: inputs.len(), window, heads, units, head };
        core.check().map_err(|e| broken(e.to_string()))?;
        let names = core.names();
        let member = |m: usize| {
            let all = names.iter().map(|name| terms.value(&format!("{}{name}", member_of(m))));
            all.collect::<Result<Vec<_>, Fault>>()
        };
        let members = (0..terms.count("members")?).map(member).collect::<Result<Vec<_>, Fault>>()?;
        let target = (terms.value("target_mean")?, terms.value("target_scale")?);
        let scaling = InputScaling { mean, scale, components: None };
        WindowedNetwork::new(columns, scaling, core, members, target, terms.value("rate_hz")?)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use learning::network::ActivationFunction;

    use super::*;
    use crate::trained::LearnedModel;

    fn network(memory: MemoryLayers) -> WindowedNetwork {
        let head = NetworkShape {
            inputs: 3,
            linear: 0,
            hidden: vec![4],
            activation: ActivationFunction::Tanh,
            form: NetworkForm::Plain,
        };
        let core = WindowedNetworkShape { memory, inputs: 2, window: 4, heads: 1, units: 3, head };
        let members = (0..2).map(|m| core.initial(m, &[])).collect();
        let scaling = InputScaling { mean: vec![1.0, -2.0], scale: vec![2.0, 0.5], components: None };
        let columns = NetworkColumns::new(vec!["a".into(), "b".into()], vec![], None);
        WindowedNetwork::new(columns, scaling, core, members, (40.0, 7.0), 5.0).unwrap()
    }

    #[test]
    fn unit_it_is_read_from_complete_tables_only() {
        for memory in [MemoryLayers::Gru, MemoryLayers::Lstm, MemoryLayers::Tcn] {
            let learned = LearnedModel::Windowed(network(memory));
            let (names, values): (Vec<String>, Vec<f64>) =
                learned.terms().into_iter().rev().map(|t| (t.name, t.value)).unzip();
            assert_eq!(LearnedModel::read(&names, &values).unwrap(), Some(learned), "{memory:?}");
            for lost in 0..names.len() - 1 {
                let without = |v: &[String]| [&v[..lost], &v[lost + 1..]].concat();
                let values = [&values[..lost], &values[lost + 1..]].concat();
                assert!(LearnedModel::read(&without(&names), &values).is_err(), "{}", names[lost]);
            }
        }
    }

    #[test]
    fn unit_a_prediction_depends_only_on_the_window() {
        for memory in [MemoryLayers::Gru, MemoryLayers::Lstm, MemoryLayers::Tcn] {
            let network = network(memory);
            let rows: Vec<f64> = (0..20).map(|i| f64::from(i * i % 7)).collect();
            let whole = network.predict(&rows, &[10]).field_nt;
            // The last four rows determine the last prediction.
            let last = network.predict(&rows[12..], &[4]).field_nt;
            assert_eq!(whole[9], last[3], "{memory:?}");
            // Later samples have no effect, and runs are independent.
            assert_eq!(whole[..7], network.predict(&rows[..14], &[7]).field_nt, "{memory:?}");
            assert_eq!(network.predict(&rows, &[4, 6]).field_nt[4], network.predict(&rows[8..], &[6]).field_nt[0]);
        }
    }

    #[test]
    fn unit_another_rate_is_rejected() {
        let network = network(MemoryLayers::Gru);
        assert!(network.check_rate(5.001).is_ok());
        assert!(network.check_rate(10.0).unwrap_err().what.contains("at 5 Hz, but the line is sampled at 10 Hz"));
    }
}
