//! Models that are not linear, as the table of a `fit` holds them, and what they predict.
//!
//! A table of such a model begins with the term `family NAME`; what follows is laid out in `trained::terms`. A table without that
//! term is a sum of coefficients times terms.

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
    /// How a model that is not linear predicts.
    pub enum Family {
        /// A network of layers, alone or together with a linear model.
        Network = "network",
        /// A network over a window of samples.
        Windowed = "windowed_network",
        /// A sum of regression trees.
        BoostedTrees = "boosted_trees",
        /// A linear model of random Fourier features.
        RandomFeatures = "random_features",
    }
}

/// The term that begins the table of a model that is not linear.
const FAMILY: &str = "family";

/// Whether a term tells of the training and is no part of the model.
fn is_of_training(name: &str) -> bool {
    name.split_once('.').map_or(name, |(_, rest)| rest).starts_with("epoch_")
}

/// What a model predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The field, nT, a value a row.
    pub field_nt: Vec<f64>,
    /// One sigma of that, nT, where the model knows it.
    pub sigma_nt: Option<Vec<f64>>,
}

/// The layers of a network.
#[derive(Clone, Copy, Debug)]
pub enum Layers<'a> {
    /// Of each sample alone.
    Dense(&'a Shape),
    /// Of a window of samples at a rate, Hz.
    Windowed(&'a Windowed, f64),
}

/// The parts of a network, as another training can begin with them.
#[derive(Clone, Copy, Debug)]
pub struct Parts<'a> {
    /// The names of the inputs.
    pub inputs: &'a [String],
    /// How they are scaled.
    pub scaling: &'a Inputs,
    /// The names of the linear terms.
    pub linear: &'a [String],
    /// The layers.
    pub layers: Layers<'a>,
    /// The parameters of each member.
    pub members: &'a [Vec<f64>],
    /// The scale of the target, nT.
    pub scale_nt: f64,
}

/// A model that is not linear.
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
    /// The entries of the features that it needs, in the order of [`Learned::predict`].
    pub fn columns(&self) -> &[String] {
        match self {
            Learned::Network(network) => network.columns(),
            Learned::Windowed(network) => network.columns(),
            Learned::BoostedTrees(trees) => trees.columns(),
            Learned::RandomFeatures(kernel) => kernel.columns(),
        }
    }

    /// What it predicts of rows of [`Learned::columns`], row-major, all of them finite. `runs` are the numbers of rows that
    /// follow each other in time, which only a network over a window looks at.
    pub fn predict(&self, x: &[f64], runs: &[usize]) -> Prediction {
        match self {
            Learned::Network(network) => network.predict(x),
            Learned::Windowed(network) => network.predict(x, runs),
            Learned::BoostedTrees(trees) => trees.predict(x),
            Learned::RandomFeatures(kernel) => kernel.predict(x),
        }
    }

    /// The derivatives of the predicted field with respect to each column, row-major; `None` where there are none.
    pub fn gradient(&self, x: &[f64]) -> Option<Vec<f64>> {
        match self {
            Learned::Network(network) => Some(network.gradient(x)),
            Learned::BoostedTrees(_) | Learned::Windowed(_) => None,
            Learned::RandomFeatures(kernel) => Some(kernel.gradient(x)),
        }
    }

    /// Its parts; `None` of what is no network.
    pub fn parts(&self) -> Option<Parts<'_>> {
        match self {
            Learned::Network(network) => Some(network.parts()),
            Learned::Windowed(network) => Some(network.parts()),
            Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => None,
        }
    }

    /// Whether samples at a rate can be its input.
    ///
    /// # Errors
    /// When it sees a window of samples at another rate.
    pub fn check_rate(&self, rate_hz: f64) -> Result<(), Fault> {
        match self {
            Learned::Windowed(network) => network.check_rate(rate_hz),
            Learned::Network(_) | Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => Ok(()),
        }
    }

    /// Whether it sees more than one sample at a time.
    pub fn sees_a_window(&self) -> bool {
        match self {
            Learned::Windowed(_) => true,
            Learned::Network(_) | Learned::BoostedTrees(_) | Learned::RandomFeatures(_) => false,
        }
    }

    /// The terms of its table.
    pub fn terms(&self) -> Vec<Term> {
        let (family, rest) = match self {
            Learned::Network(network) => (Family::Network, network.terms()),
            Learned::Windowed(network) => (Family::Windowed, network.terms()),
            Learned::BoostedTrees(trees) => (Family::BoostedTrees, trees.terms()),
            Learned::RandomFeatures(kernel) => (Family::RandomFeatures, kernel.terms()),
        };
        std::iter::once(term(format!("{FAMILY} {}", family.word()), 1.0)).chain(rest).collect()
    }

    /// The model of a table with these terms; `None` for a linear one.
    ///
    /// # Errors
    /// When terms are missing, duplicate, or do not fit together: the table is not whole.
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
            return Err(broken("it has other terms than its layout".to_owned()));
        }
        Ok(Some(learned))
    }
}
