//! Nonlinear models, as the table of a `fit` holds them, and their predictions.
//!
//! The table of such a model begins with the term `family NAME`. The other terms are laid out in `trained::terms`. A
//! table without that term is a linear model: a sum of coefficients times terms.

mod boosted_trees;
mod network;
mod random_features;
mod terms;
mod windowed;

use learning::{
    inputs::Inputs,
    network::{Shape, Windowed},
};
use schemas::{Fault, choice};

pub use boosted_trees::BoostedTrees;
pub use network::Network;
pub use random_features::Kernel;
pub use terms::{Reading, Term, list, term};
pub use windowed::WindowedNetwork;

use terms::broken;

choice! {
    /// Form of a nonlinear model.
    pub enum Family {
        /// Network of layers, alone or together with a linear model.
        Network = "network",
        /// Network over a window of samples.
        Windowed = "windowed_network",
        /// Sum of regression trees.
        BoostedTrees = "boosted_trees",
        /// Linear model of random Fourier features.
        RandomFeatures = "random_features",
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
pub struct Prediction {
    /// Predicted field of each row, nT.
    pub field_nt: Vec<f64>,
    /// Standard deviation of the prediction, nT. `None` if the model does not provide one.
    pub sigma_nt: Option<Vec<f64>>,
}

/// Layers of a network.
#[derive(Clone, Copy, Debug)]
pub enum Layers<'a> {
    /// Layers of a network that sees one sample.
    Dense(&'a Shape),
    /// Layers of a network that sees a window of samples at a rate, Hz.
    Windowed(&'a Windowed, f64),
}

/// Parts of a network, from which another training can start.
#[derive(Clone, Copy, Debug)]
pub struct Parts<'a> {
    /// Names of the inputs.
    pub inputs: &'a [String],
    /// Scaling of the inputs.
    pub scaling: &'a Inputs,
    /// Names of the linear terms.
    pub linear: &'a [String],
    /// Layers of the network.
    pub layers: Layers<'a>,
    /// Parameters of each member.
    pub members: &'a [Vec<f64>],
    /// Scale of the target, nT.
    pub scale_nt: f64,
}

/// Nonlinear model.
#[derive(Clone, Debug, PartialEq)]
pub enum Learned {
    /// See [`Network`].
    Network(Network),
    /// See [`WindowedNetwork`].
    Windowed(WindowedNetwork),
    /// See [`BoostedTrees`].
    BoostedTrees(BoostedTrees),
    /// See [`Kernel`].
    RandomFeatures(Kernel),
}

impl Learned {
    /// Entries of the features that the model requires, in the order of [`Learned::predict`].
    pub fn columns(&self) -> &[String] {
        match self {
            Learned::Network(network) => network.columns(),
            Learned::Windowed(network) => network.columns(),
            Learned::BoostedTrees(trees) => trees.columns(),
            Learned::RandomFeatures(kernel) => kernel.columns(),
        }
    }

    /// Prediction for rows of [`Learned::columns`], row-major and finite. `runs` are the lengths of runs of consecutive
    /// rows. Only a network over a window uses them.
    pub fn predict(&self, x: &[f64], runs: &[usize]) -> Prediction {
        match self {
            Learned::Network(network) => network.predict(x),
            Learned::Windowed(network) => network.predict(x, runs),
            Learned::BoostedTrees(trees) => trees.predict(x),
            Learned::RandomFeatures(kernel) => kernel.predict(x),
        }
    }

    /// Derivatives of the predicted field with respect to each column, row-major. `None` if the model has none.
    pub fn gradient(&self, x: &[f64]) -> Option<Vec<f64>> {
        match self {
            Learned::Network(network) => Some(network.gradient(x)),
            Learned::BoostedTrees(_) | Learned::Windowed(_) => None,
            Learned::RandomFeatures(kernel) => Some(kernel.gradient(x)),
        }
    }

    /// Parts of a network. `None` for other models.
    pub fn parts(&self) -> Option<Parts<'_>> {
        match self {
            Learned::Network(network) => Some(network.parts()),
            Learned::Windowed(network) => Some(network.parts()),
            Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => None,
        }
    }

    /// Checks that samples at a rate can be the input.
    ///
    /// # Errors
    /// If the model sees a window of samples at another rate.
    pub fn check_rate(&self, rate_hz: f64) -> Result<(), Fault> {
        match self {
            Learned::Windowed(network) => network.check_rate(rate_hz),
            Learned::Network(_) | Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => Ok(()),
        }
    }

    /// Returns whether the model sees more than one sample at a time.
    pub fn sees_a_window(&self) -> bool {
        match self {
            Learned::Windowed(_) => true,
            Learned::Network(_) | Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => false,
        }
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<Term> {
        let (family, rest) = match self {
            Learned::Network(network) => (Family::Network, network.terms()),
            Learned::Windowed(network) => (Family::Windowed, network.terms()),
            Learned::BoostedTrees(trees) => (Family::BoostedTrees, trees.terms()),
            Learned::RandomFeatures(kernel) => (Family::RandomFeatures, kernel.terms()),
        };
        std::iter::once(term(format!("{FAMILY} {}", family.word()), 1.0)).chain(rest).collect()
    }

    /// Model of a table with these terms. `None` for a linear one.
    ///
    /// # Errors
    /// If terms are missing, duplicate or inconsistent, because the table is incomplete.
    pub fn read(names: &[String], values: &[f64]) -> Result<Option<Learned>, Fault> {
        if !names.iter().any(|name| name.strip_prefix(FAMILY).is_some_and(|rest| rest.starts_with(' '))) {
            return Ok(None);
        }
        let model = names.iter().zip(values).filter(|(name, _)| !is_of_training(name));
        let (names, values): (Vec<String>, Vec<f64>) = model.map(|(name, value)| (name.clone(), *value)).unzip();
        let reading = Reading::new(&names, &values)?;
        let learned = match reading.choice(FAMILY)? {
            Family::Network => Learned::Network(Network::read(&reading)?),
            Family::Windowed => Learned::Windowed(WindowedNetwork::read(&reading)?),
            Family::BoostedTrees => Learned::BoostedTrees(BoostedTrees::read(&reading)?),
            Family::RandomFeatures => Learned::RandomFeatures(Kernel::read(&reading)?),
        };
        if learned.terms().len() != names.len() {
            return Err(broken("its terms do not match its layout".to_owned()));
        }
        Ok(Some(learned))
    }
}
