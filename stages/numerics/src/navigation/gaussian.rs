//! Gaussian estimates of the error states: time update, measurement update, and the recursion along a line.
//!
//! | Module | Contents |
//! |:--|:--|
//! | `state` | the 18 states as [`StateEstimate`], and with further states as [`Gaussian`] |
//! | `step` | Φ and process noise of a step; the time update |
//! | `update` | rows of H; the measurement update |
//! | `covariance` | the covariance of any number of states |
//! | `linearise` | a nonlinear field: most probable state, and regression over sigma points |
//! | `lanes` | both updates for several filters at once, one per lane of a vector register |
//! | `adjoint` | the backward pass of a smoother with further states |
//! | `recursion` | the recursion of a filter of the 18 states |
//!
//! The functions are inlined into the loop of a filter, which is compiled for each kind of vector unit. Products and
//! sums are not fused, so the results of all units are bit-identical.
//!
//! The three forms have the same equations with different rounding. The 18 states have fixed arrays, which a compiler
//! keeps in registers. Each lane holds one filter. Further states have vectors of any length.

pub(crate) mod adjoint;
pub(crate) mod covariance;
pub(crate) mod lanes;
pub(crate) mod linearise;
pub(crate) mod recursion;
mod state;
mod step;
mod update;

pub(crate) use state::{Gaussian, StateEstimate, StateLayout};
pub(crate) use step::{LaneStep, StepModel, propagate_mean};
pub(crate) use update::{
    AugmentedSensitivity, LinearisedMeasurement, MEASURED, MeasurementUpdate, Sensitivity, inner, measured_states,
    mirror,
};

#[cfg(test)]
pub(crate) mod tests;
