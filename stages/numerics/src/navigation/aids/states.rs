//! Positions of the states of the further measurements in the state vector of a filter.

use crate::navigation::gaussian::StateLayout;
use crate::navigation::pinson::S;
use crate::signal::gauss_markov::GaussMarkov;

use super::{Aids, JacobianBlock, SlopeError};

/// Standard deviation, in nT, of the constant offset that accompanies a change of the permanent field. The value
/// exceeds any constant offset that calibration and map leave undetermined.
const OFFSET_SIGMA_NT: f64 = 100.0;

/// Gauss-Markov states of the further measurements, in consecutive order.
#[derive(Clone, Debug, Default)]
pub(crate) struct AidStates {
    /// Index of the first state.
    first: usize,
    /// Error models of the states. Errors with a correlation length have no time constant.
    pub(crate) errors: Vec<GaussMarkov>,
    /// Positions of the states with a correlation length, and this length in metres.
    pub(crate) lengths_m: Vec<(usize, f64)>,
    pub(crate) difference: Option<usize>,
    pub(crate) height: Option<usize>,
    pub(crate) map_error: Option<usize>,
    /// Index of the first of the three components of the change of the permanent field; the constant offset follows.
    pub(crate) permanent: Option<usize>,
    /// Index of the height bias (in m), the state for the bias between the height of the INS and the height on the map.
    /// It is directly after the states of the permanent field.
    pub(crate) map_height: Option<usize>,
    /// Index of the first of the two errors of the map's slope, horizontal and upward. Both states are in units of
    /// their standard deviations.
    pub(crate) slope: Option<usize>,
    /// Index of the lag of the scalar magnetometer, in seconds.
    pub(crate) latency: Option<usize>,
    /// Indices of the first of the three biases of the vector, and of the first of the three parts of the crustal
    /// field.
    pub(crate) vector: Option<(usize, usize)>,
}

impl AidStates {
    /// Layout of the states; `first` is the index of the first one.
    pub(crate) fn new(aids: &Aids<'_>, first: usize) -> Self {
        let mut states = Self { first, ..Self::default() };
        states.difference = aids.difference.map(|of| states.add(of.bias));
        states.slope = aids.difference.map(|of| of.slope).filter(SlopeError::is_any).map(|slope| {
            let [horizontal, _] = [(); 2].map(|()| states.add_along(1.0, slope.length_m));
            horizontal
        });
        states.height = aids.height.map(|of| states.add(of.bias));
        states.map_error = aids.map_error.map(|of| states.add_along(of.sigma_nt, of.length_m));
        let constant = |sigma| GaussMarkov { sigma, tau_s: f64::INFINITY };
        states.permanent = aids.permanent.map(|of| {
            let [nose, _, _] = [(); 3].map(|()| states.add(of.process));
            states.add(constant(OFFSET_SIGMA_NT));
            nose
        });
        states.map_height = aids.map_height_sigma_m.map(|sigma_m| states.add(constant(sigma_m)));
        states.latency = aids.latency_sigma_s.map(|sigma_s| states.add(constant(sigma_s)));
        states.vector = aids.vector.map(|of| {
            let biases = [(); 3].map(|()| states.add(of.bias));
            let crustal = [(); 3].map(|()| states.add_along(of.crustal_sigma_nt, of.crustal_length_m));
            (biases[0], crustal[0])
        });
        states
    }

    fn add(&mut self, error: GaussMarkov) -> usize {
        self.errors.push(error);
        self.first + self.errors.len() - 1
    }

    fn add_along(&mut self, sigma: f64, length_m: f64) -> usize {
        let state = self.add(GaussMarkov { sigma, tau_s: f64::INFINITY });
        self.lengths_m.push((state - self.first, length_m));
        state
    }

    /// Appends the states to the errors of a layout.
    pub(crate) fn extend(&self, layout: &mut StateLayout) {
        let before = layout.errors.len();
        layout.errors.extend(&self.errors);
        layout.lengths_m.extend(self.lengths_m.iter().map(|(place, length_m)| (before + place, *length_m)));
    }

    /// Index and entry of H of a scalar measurement for the map error.
    pub(crate) fn of_map(&self) -> (usize, f64) {
        self.map_error.map_or((S, 0.0), |state| (state, 1.0))
    }

    /// Entries of H of a scalar measurement for the change of the permanent field at a row, and for the height bias at
    /// this vertical slope in nT/m.
    pub(crate) fn of_scalar(&self, aids: &Aids<'_>, row: usize, d_alt_nt_per_m: f64) -> JacobianBlock {
        let mut block = self.permanent.zip(aids.permanent).map_or_else(JacobianBlock::default, |(first, of)| {
            let [nose, right, down] = of.direction[row];
            JacobianBlock { first, count: 4, entries: [nose, right, down, 1.0, 0.0] }
        });
        if let Some(state) = self.map_height {
            block.first = state - block.count;
            block.entries[block.count] = d_alt_nt_per_m;
            block.count += 1;
        }
        block
    }

    /// Prior variance of a state, if it is one of these states.
    pub(crate) fn variance(&self, state: usize) -> Option<f64> {
        let place = state.checked_sub(self.first)?;
        self.errors.get(place).map(|error| error.sigma * error.sigma)
    }
}
