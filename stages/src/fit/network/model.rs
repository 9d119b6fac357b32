//! What a model declares that is a network.

use learning::network::Form;
use schemas::Fault;

use super::{LinearPart, Network, Window};

/// A model that is a network: its keys, and what stands beside the network.
#[derive(Clone, Copy)]
pub struct NetworkModel<'a> {
    /// The keys of the network and of its training.
    pub keys: &'a Network,
    /// How the network and the linear model are put together.
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

impl<'a> NetworkModel<'a> {
    /// Of eight hidden units and each sample alone, with nothing beside it.
    pub fn of(keys: &'a Network, form: Form) -> Self {
        Self { keys, form, hidden: &[8], linear: None, all_features: false, physics: 0.0, window: None }
    }

    /// What is wrong with its keys among themselves.
    pub fn faults(&self) -> Vec<Fault> {
        let mut faults = self.keys.faults();
        faults.extend(self.window.iter().flat_map(Window::faults));
        faults
    }

    /// How much work a sample is.
    pub fn effort(&self) -> f64 {
        self.keys.effort() * self.window.as_ref().map_or(1.0, Window::effort)
    }
}
