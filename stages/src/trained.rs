//! Nonlinear models in the table of a `fit`, and their predictions.
//!
//! The table of such a model begins with the term `family NAME`. The module `trained::terms` defines the layout of the
//! other terms. A table without that term is a linear model: a sum of coefficients times terms.

mod boosted_trees;
mod columns;
mod external;
mod network;
mod parts;
mod random_features;
mod terms;
mod windowed;

use learning::{
    inputs::InputScaling,
    network::{NetworkShape, VectorFrame, WindowedNetworkShape},
};
use schemas::{Fault, choice};

pub use boosted_trees::BoostedTrees;
pub use columns::NetworkColumns;
pub use external::{ExternalModel, ExternalModelReader, ForeignModel, set_external_reader};
pub use network::NetworkEnsemble;
pub use parts::{PART_VECTORS, PredictionParts};
pub use random_features::RandomFourierModel;
pub use terms::{TermLookup, TermValue, list, term};
pub use windowed::WindowedNetwork;

pub(crate) use terms::{broken, named_list};

choice! {
    /// Form of a nonlinear model.
    pub enum LearnedModelFamily {
        /// Network of layers, alone or together with a linear model.
        Network = "network",
        /// Network over a window of samples.
        Windowed = "windowed_network",
        /// Sum of regression trees.
        BoostedTrees = "boosted_trees",
        /// Linear model of random Fourier features.
        RandomFeatures = "random_features",
        /// Model written in Python.
        Python = "python",
    }
}

/// First term of the table of a nonlinear model.
const FAMILY: &str = "family";

/// Returns whether a term describes the training and is not part of the model.
fn is_of_training(name: &str) -> bool {
    name.split_once('.').map_or(name, |(_, rest)| rest).starts_with("epoch_")
}

/// Prediction of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldPrediction {
    /// Predicted field of each row, in nT.
    pub field_nt: Vec<f64>,
    /// Standard deviation of the prediction, in nT. `None` if the model does not provide one.
    pub sigma_nt: Option<Vec<f64>>,
}

/// Layers of a network.
#[derive(Clone, Copy, Debug)]
pub enum NetworkLayers<'a> {
    /// Layers of a network of single samples.
    Dense(&'a NetworkShape),
    /// Layers of a network over a window of samples, and the sample rate, in Hz.
    Windowed(&'a WindowedNetworkShape, f64),
}

/// Parts of a network from which another training can start.
#[derive(Clone, Copy, Debug)]
pub struct NetworkParts<'a> {
    /// Names of the inputs.
    pub inputs: &'a [String],
    /// Scaling of the inputs.
    pub scaling: &'a InputScaling,
    /// Names of the linear terms.
    pub linear: &'a [String],
    /// Vector form of the linear terms, if any.
    pub frame: Option<VectorFrame>,
    /// Layers of the network.
    pub layers: NetworkLayers<'a>,
    /// Parameters of each member.
    pub members: &'a [Vec<f64>],
    /// Scale of the target, in nT.
    pub scale_nt: f64,
}

/// Nonlinear model.
#[derive(Clone, Debug, PartialEq)]
pub enum LearnedModel {
    /// See [`NetworkEnsemble`].
    Network(NetworkEnsemble),
    /// See [`WindowedNetwork`].
    Windowed(WindowedNetwork),
    /// See [`BoostedTrees`].
    BoostedTrees(BoostedTrees),
    /// See [`RandomFourierModel`].
    RandomFeatures(RandomFourierModel),
    /// See [`ForeignModel`].
    Python(ForeignModel),
}

impl LearnedModel {
    /// Entries of the features that the model requires, in the order of [`LearnedModel::predict`].
    pub fn columns(&self) -> &[String] {
        match self {
            LearnedModel::Network(network) => network.columns(),
            LearnedModel::Windowed(network) => network.columns(),
            LearnedModel::BoostedTrees(trees) => trees.columns(),
            LearnedModel::RandomFeatures(kernel) => kernel.columns(),
            LearnedModel::Python(model) => model.columns(),
        }
    }

    /// Prediction for rows of [`LearnedModel::columns`], row-major and finite. `runs` are the lengths of runs of
    /// consecutive rows. Only a network over a window uses them.
    ///
    /// # Errors
    /// Fails if a model written in Python fails.
    pub fn predict(&self, x: &[f64], runs: &[usize]) -> Result<FieldPrediction, Fault> {
        Ok(match self {
            LearnedModel::Network(network) => network.predict(x),
            LearnedModel::Windowed(network) => network.predict(x, runs),
            LearnedModel::BoostedTrees(trees) => trees.predict(x),
            LearnedModel::RandomFeatures(kernel) => kernel.predict(x),
            LearnedModel::Python(model) => return model.predict(x),
        })
    }

    /// Derivatives of the predicted field with respect to each column, row-major. `None` if the model has none.
    pub fn gradient(&self, x: &[f64]) -> Option<Vec<f64>> {
        match self {
            LearnedModel::Network(network) => Some(network.gradient(x)),
            LearnedModel::BoostedTrees(_) | LearnedModel::Windowed(_) | LearnedModel::Python(_) => None,
            LearnedModel::RandomFeatures(kernel) => Some(kernel.gradient(x)),
        }
    }

    /// Parts of a network. `None` for other models.
    pub fn parts(&self) -> Option<NetworkParts<'_>> {
        match self {
            LearnedModel::Network(network) => Some(network.parts()),
            LearnedModel::Windowed(network) => Some(network.parts()),
            LearnedModel::BoostedTrees(_) | LearnedModel::RandomFeatures(_) | LearnedModel::Python(_) => None,
        }
    }

    /// Checks that the model accepts samples at this rate.
    ///
    /// # Errors
    /// Fails if the model uses a window of samples at another rate.
    pub fn check_rate(&self, rate_hz: f64) -> Result<(), Fault> {
        match self {
            LearnedModel::Windowed(network) => network.check_rate(rate_hz),
            LearnedModel::Network(_)
            | LearnedModel::BoostedTrees(_)
            | LearnedModel::RandomFeatures(_)
            | LearnedModel::Python(_) => Ok(()),
        }
    }

    /// Returns whether the model uses more than one sample at a time.
    pub fn sees_a_window(&self) -> bool {
        match self {
            LearnedModel::Windowed(_) => true,
            LearnedModel::Network(_)
            | LearnedModel::BoostedTrees(_)
            | LearnedModel::RandomFeatures(_)
            | LearnedModel::Python(_) => false,
        }
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<TermValue> {
        let (family, rest) = match self {
            LearnedModel::Network(network) => (LearnedModelFamily::Network, network.terms()),
            LearnedModel::Windowed(network) => (LearnedModelFamily::Windowed, network.terms()),
            LearnedModel::BoostedTrees(trees) => (LearnedModelFamily::BoostedTrees, trees.terms()),
            LearnedModel::RandomFeatures(kernel) => (LearnedModelFamily::RandomFeatures, kernel.terms()),
            LearnedModel::Python(model) => (LearnedModelFamily::Python, model.terms()),
        };
        std::iter::once(term(format!("{FAMILY} {}", family.word()), 1.0)).chain(rest).collect()
    }

    /// Model of a table with these terms. `None` for a linear model.
    ///
    /// # Errors
    /// Fails if terms are missing, duplicate or inconsistent, because the table is incomplete.
    pub fn read(names: &[String], values: &[f64]) -> Result<Option<LearnedModel>, Fault> {
        if !names.iter().any(|name| name.strip_prefix(FAMILY).is_some_and(|rest| rest.starts_with(' '))) {
            return Ok(None);
        }
        let model = names.iter().zip(values).filter(|(name, _)| !is_of_training(name));
        let (names, values): (Vec<String>, Vec<f64>) = model.map(|(name, value)| (name.clone(), *value)).unzip();
        let reading = TermLookup::new(&names, &values)?;
        let learned = match reading.choice(FAMILY)? {
            LearnedModelFamily::Network => LearnedModel::Network(NetworkEnsemble::read(&reading)?),
            LearnedModelFamily::Windowed => LearnedModel::Windowed(WindowedNetwork::read(&reading)?),
            LearnedModelFamily::BoostedTrees => LearnedModel::BoostedTrees(BoostedTrees::read(&reading)?),
            LearnedModelFamily::RandomFeatures => LearnedModel::RandomFeatures(RandomFourierModel::read(&reading)?),
            LearnedModelFamily::Python => LearnedModel::Python(ForeignModel::read(&reading)?),
        };
        if learned.terms().len() != names.len() {
            return Err(broken("its terms do not match its layout".to_owned()));
        }
        Ok(Some(learned))
    }
}
