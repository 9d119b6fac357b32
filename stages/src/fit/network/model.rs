//! Declaration of a model that is a network.

use learning::network::{CURRICULUM_EPOCHS, NetworkForm};
use schemas::Fault;

use super::{LinearPart, NetworkKeys, VectorModelKeys, WindowLayers};

/// A model that is a network: its keys, and the linear model combined with it.
#[derive(Clone, Copy)]
pub struct NetworkModel<'a> {
    /// Keys of the network and of its training.
    pub keys: &'a NetworkKeys,
    /// Combination of the network and the linear model.
    pub form: NetworkForm,
    /// Default number of units of the hidden layers.
    pub hidden: &'a [usize],
    /// Linear model; `None` for `m1`.
    pub linear: Option<&'a LinearPart>,
    /// Whether all features are linear terms by default.
    pub all_features: bool,
    /// Weight of the term of the loss function that penalises deviations from the linear model.
    pub physics: f64,
    /// Vector form of the linear model. `None` unless the model is of type `m3...` (`m3tl` to `m3tf`).
    pub vector: Option<&'a VectorModelKeys>,
    /// The first phases of a curriculum use the samples at which the ridge fit's error deviates from the mean error by
    /// at most this number of standard deviations. `None` for training without a curriculum.
    pub curriculum: Option<f64>,
    /// Layers over a window of samples before the network. `None` for a network of single samples.
    pub window: Option<WindowLayers>,
}

impl<'a> NetworkModel<'a> {
    /// Network of single samples with eight hidden units and no linear model.
    pub fn new(keys: &'a NetworkKeys, form: NetworkForm) -> Self {
        Self {
            keys,
            form,
            hidden: &[8],
            linear: None,
            all_features: false,
            physics: 0.0,
            vector: None,
            curriculum: None,
            window: None,
        }
    }

    /// Model `m3...`: a network combined with the vector form of Tolles-Lawson.
    pub fn vector(keys: &'a NetworkKeys, form: NetworkForm, part: &'a LinearPart, vector: &'a VectorModelKeys) -> Self {
        Self { linear: Some(part), vector: Some(vector), ..Self::new(keys, form) }
    }

    /// Returns whether the model has a network with inputs.
    pub fn has_inputs(&self) -> bool {
        self.form != NetworkForm::VectorOnly
    }

    /// Reason why a key has no effect.
    pub fn unused_key(&self, key: &str) -> Option<Fault> {
        self.keys.unused_key(key).or_else(|| self.vector?.unused_key(key))
    }

    /// Faults of incompatible keys.
    pub fn faults(&self) -> Vec<Fault> {
        let mut faults = self.keys.faults();
        faults.extend(self.window.iter().flat_map(WindowLayers::faults));
        if self.curriculum.is_some() && self.keys.epochs < CURRICULUM_EPOCHS {
            let what = format!("a curriculum requires at least {CURRICULUM_EPOCHS} `epochs`, one in each phase");
            faults.push(Fault::new(what).of_param("epochs"));
        }
        faults
    }

    /// Cost of a sample, in relative units.
    pub fn effort(&self) -> f64 {
        self.keys.effort() * self.window.as_ref().map_or(1.0, WindowLayers::effort)
    }
}
