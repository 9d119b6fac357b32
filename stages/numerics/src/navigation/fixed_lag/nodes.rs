//! Nodes of the line: times at which states are estimated, each with the measurements of an interval.

use std::ops::Range;

use crate::earth::field_value::FieldValue;
use crate::navigation::aids::{AidMeasurements, AidStates, Aids};
use crate::navigation::gaussian::covariance::add_scaled;
use crate::navigation::gaussian::{AugmentedSensitivity, StateLayout};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};
use crate::navigation::transition::{add, identity, product, propagate_covariance};
use crate::navigation::{LineStep, NavigationLine, PredictedField};

use super::FixedLagMagnetometer;

/// Tolerance of the interval limits, in seconds, for the rounding of decimal times.
pub(super) const SLACK_S: f64 = 1e-6;

/// Instant at the first sample of an interval, with the measurements of the interval.
#[derive(Clone, Debug)]
pub(super) struct FixedLagNode {
    /// Samples of the interval.
    pub rows: Range<usize>,
    pub tt_s: f64,
    /// Step from the previous node; unused at the first node.
    pub step: LineStep,
    /// Position rows of Φ from the node to each sample.
    positions: Vec<[StateVector; 3]>,
    /// Measurement of each magnetometer.
    pub measurements: Vec<Option<NodeMeasurement>>,
    /// Aiding positions at the samples of the node.
    pub fixes: Vec<NodeFix>,
    /// Propagation of the node's states to its later samples; empty without further measurements.
    later: Vec<NodePropagation>,
}

/// Propagation from a node to one of its later samples.
#[derive(Clone, Debug)]
struct NodePropagation {
    dt_s: f64,
    speed_mps: f64,
    phi: StateMatrix,
}

/// Coordinate of an aiding position, as a measurement of the node's states.
#[derive(Clone, Debug)]
pub(super) struct NodeFix {
    /// Row of Φ from the node to the sample.
    h: StateVector,
    /// Error of the INS at the sample according to the fix, and the variance of the fix.
    error: f64,
    pub variance: f64,
}

impl NodeFix {
    /// Row of H.
    pub fn sensitivity(&self) -> AugmentedSensitivity<'_> {
        AugmentedSensitivity::of_ins(&self.h)
    }

    /// Measurement minus prediction at a state.
    pub fn residual(&self, x: &[f64]) -> f64 {
        self.error - self.sensitivity().dot(x)
    }
}

/// Average of the measurements over a node's interval, weighted by the inverse variances.
#[derive(Clone, Debug)]
pub(super) struct NodeMeasurement {
    value_nt: f64,
    pub variance_nt2: f64,
    /// Weight of each sample.
    weights: Vec<f64>,
    /// Mean decay factors of the node's temporal variation and of its Gauss-Markov error.
    temporal: f64,
    error: f64,
    /// Index of the map error state, and the decay factor of this state.
    map_error: (usize, f64),
    regressors: Vec<f64>,
}

/// Average predicted field about a state, and its derivative with respect to the 18 states of the node.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalField {
    /// Field minus its derivative times the state: the prediction at x = 0.
    at_zero_nt: f64,
    derivative: StateVector,
}

impl FixedLagNode {
    /// Predicted field of a magnetometer at a state; `None` off the map or without a measurement.
    pub fn field(
        &self,
        magnetometer: usize,
        line: &NavigationLine,
        field: &mut PredictedField,
        x: &[f64],
    ) -> Option<LocalField> {
        let measurement = self.measurements[magnetometer].as_ref()?;
        let mut local = LocalField { at_zero_nt: 0.0, derivative: [0.0; STATES] };
        for ((row, position), weight) in self.rows.clone().zip(&self.positions).zip(&measurement.weights) {
            if *weight == 0.0 {
                continue;
            }
            let error = position.map(|row| row.iter().zip(x).map(|(phi, x)| phi * x).sum());
            let value = field.at_error(line.ins, row, error)?;
            local.at_zero_nt += weight * value.value_nt;
            let gradient = [value.d_lat_nt_per_rad, value.d_lon_nt_per_rad, value.d_alt_nt_per_m];
            for (gradient, position) in gradient.into_iter().zip(position) {
                add_scaled(&mut local.derivative, weight * gradient, position);
            }
        }
        local.at_zero_nt -= local.derivative.iter().zip(x).map(|(h, x)| h * x).sum::<f64>();
        local.derivative[S] += measurement.temporal;
        // Map values that are not finite are treated as off the map.
        (local.at_zero_nt + local.derivative.iter().sum::<f64>()).is_finite().then_some(local)
    }
}

impl FixedLagNode {
    /// Averages of the further measurements of the node's samples, linearised about a state.
    pub fn aid_rows(
        &self,
        (aids, states): (&Aids<'_>, &AidStates),
        layout: &StateLayout,
        line: &NavigationLine<'_>,
        field: &mut PredictedField<'_>,
        x: &[f64],
    ) -> AidMeasurements {
        let first = aids.rows(states, field, line, self.rows.start, x);
        if self.later.is_empty() {
            return first;
        }
        let mut samples = vec![first];
        for (row, NodePropagation { dt_s, speed_mps, phi }) in self.rows.clone().skip(1).zip(&self.later) {
            let decay = |state: usize| match state.checked_sub(STATES) {
                Some(place) if place < layout.errors.len() => layout.error_at(place, *speed_mps).decay(*dt_s),
                Some(_) | None => 1.0,
            };
            let mut then: Vec<f64> = x.iter().enumerate().map(|(state, x)| decay(state) * x).collect();
            for (then, row) in then.iter_mut().zip(phi) {
                *then = row.iter().zip(x).map(|(phi, x)| phi * x).sum();
            }
            samples.push(aids.rows(states, field, line, row, &then).carried(phi, decay));
        }
        AidMeasurements::mean(samples)
    }
}

impl NodeMeasurement {
    /// Whether the map is too flat to observe the position. `local` is the field about a state.
    pub fn is_flat(&self, aids: &Aids<'_>, local: &LocalField, line: &NavigationLine<'_>, row: usize) -> bool {
        let [d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m] = [LAT, LON, ALT].map(|state| local.derivative[state]);
        let at = FieldValue { value_nt: 0.0, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m };
        aids.is_flat(self.variance_nt2, line.slope_nt_per_m(row, &at))
    }

    /// Row of H.
    pub fn sensitivity<'a>(
        &'a self,
        field: &'a LocalField,
        layout: &StateLayout,
        magnetometer: usize,
    ) -> AugmentedSensitivity<'a> {
        AugmentedSensitivity {
            ins: &field.derivative,
            error: (STATES + magnetometer, self.error),
            common: self.map_error,
            first: layout.blocks[magnetometer].start,
            regressors: &self.regressors,
        }
    }

    /// Measurement minus prediction at a state.
    pub fn residual(&self, field: &LocalField, h: &AugmentedSensitivity, x: &[f64]) -> f64 {
        self.value_nt - field.at_zero_nt - h.dot(x)
    }
}

/// Builder of the nodes of a line, one after another.
pub(super) struct LineNodeBuilder<'a> {
    pub line: &'a NavigationLine<'a>,
    magnetometers: &'a [FixedLagMagnetometer<'a>],
    layout: &'a StateLayout,
    offsets_nt: &'a [f64],
    interval_s: f64,
    /// Index of the map error state.
    map_error: Option<usize>,
    /// Whether there are further measurements.
    aided: bool,
    /// First sample of the next node.
    pub next: usize,
    arrival: LineStep,
}

impl<'a> LineNodeBuilder<'a> {
    pub fn new(
        line: &'a NavigationLine<'a>,
        magnetometers: &'a [FixedLagMagnetometer<'a>],
        layout: &'a StateLayout,
        offsets_nt: &'a [f64],
        interval_s: f64,
    ) -> Self {
        let (map_error, aided) = (None, false);
        Self { line, magnetometers, layout, offsets_nt, interval_s, map_error, aided, next: 0, arrival: no_step() }
    }

    /// Enables nodes with further measurements.
    pub fn with(self, aids: &Aids<'_>, states: &AidStates) -> Self {
        Self { map_error: states.map_error, aided: aids.is_any(), ..self }
    }

    /// Time of the next node, in seconds; `None` after the last node.
    pub fn next_s(&self) -> Option<f64> {
        self.line.ins.tt_s.get(self.next).copied()
    }

    /// Next node, with the samples before `end_s`, but at least one sample. `None` after the last node.
    pub fn take(&mut self, end_s: f64) -> Option<FixedLagNode> {
        let first_s = self.next_s()?;
        let tt_s = self.line.ins.tt_s;
        let mut node = FixedLagNode {
            rows: self.next..self.next,
            tt_s: first_s,
            step: self.arrival.clone(),
            positions: vec![],
            measurements: vec![],
            fixes: vec![],
            later: vec![],
        };
        let mut walked = no_step();
        loop {
            if self.aided && walked.dt_s > 0.0 {
                let LineStep { dt_s, speed_mps, phi, .. } = walked;
                node.later.push(NodePropagation { dt_s, speed_mps, phi });
            }
            node.positions.push([walked.phi[LAT], walked.phi[LON], walked.phi[ALT]]);
            for fix in self.line.fixes_at(node.rows.end).into_iter().flatten() {
                node.fixes.push(NodeFix { h: walked.phi[fix.state], error: fix.error, variance: fix.variance });
            }
            node.rows.end += 1;
            let row = node.rows.end;
            if row == tt_s.len() {
                break;
            }
            walk(&mut walked, self.line, row);
            if tt_s[row] - first_s > self.interval_s - SLACK_S || tt_s[row] >= end_s - SLACK_S {
                break;
            }
        }
        self.next = node.rows.end;
        self.arrival = walked;
        node.measurements = (0..self.magnetometers.len()).map(|of| self.measurement(of, &node)).collect();
        Some(node)
    }

    fn measurement(&self, of: usize, node: &FixedLagNode) -> Option<NodeMeasurement> {
        let (magnetometer, tt_s) = (&self.magnetometers[of], self.line.ins.tt_s);
        let weights: Vec<f64> = node.rows.clone().map(|row| magnetometer.precision(row)).collect();
        let precision: f64 = weights.iter().sum();
        if !(precision > 0.0 && precision.is_finite()) {
            return None;
        }
        let weights: Vec<f64> = weights.into_iter().map(|weight| weight / precision).collect();
        let mut average = NodeMeasurement {
            value_nt: 0.0,
            variance_nt2: 1.0 / precision,
            temporal: 0.0,
            error: 0.0,
            map_error: (0, 0.0),
            regressors: vec![0.0; magnetometer.coefficients.terms()],
            weights,
        };
        for (row, weight) in node.rows.clone().zip(&average.weights) {
            if *weight > 0.0 {
                let after_s = tt_s[row] - node.tt_s;
                average.value_nt += weight * (magnetometer.measurement_nt[row] - self.offsets_nt[of]);
                average.temporal += weight * (-after_s / self.line.errors.fogm_tau_s).exp();
                average.error += weight * self.layout.errors[of].decay(after_s);
                add_scaled(&mut average.regressors, *weight, magnetometer.coefficients.row(row));
            }
        }
        if let Some(state) = self.map_error {
            let mut left = 0.0;
            for (k, weight) in average.weights.iter().enumerate() {
                let later = k.checked_sub(1).and_then(|later| node.later.get(later));
                let decay = later.map_or(1.0, |at| self.layout.error_at(state - STATES, at.speed_mps).decay(at.dt_s));
                left += weight * decay;
            }
            average.map_error = (state, left);
        }
        Some(average)
    }
}

/// Step of zero length.
fn no_step() -> LineStep {
    LineStep { dt_s: 0.0, speed_mps: 0.0, phi: identity(), noise: [[0.0; STATES]; STATES] }
}

/// Extends a step to `row`.
fn walk(walked: &mut LineStep, line: &NavigationLine, row: usize) {
    let step = line.step(row);
    if walked.dt_s == 0.0 {
        *walked = step;
        return;
    }
    let travelled_m = walked.speed_mps * walked.dt_s + step.speed_mps * step.dt_s;
    walked.dt_s += step.dt_s;
    walked.speed_mps = travelled_m / walked.dt_s;
    walked.phi = product(&step.phi, &walked.phi);
    walked.noise = propagate_covariance(&step.phi, &walked.noise);
    add(&mut walked.noise, &step.noise);
}

/// Propagates a state and its covariance from the first sample of a node to its later samples. There are no
/// measurements in between.
pub(super) fn carry(line: &NavigationLine, row: usize, x: &mut StateVector, p: &mut StateMatrix) {
    let step = line.step(row);
    *x = crate::navigation::transition::propagate_state(&step.phi, x);
    *p = propagate_covariance(&step.phi, p);
    add(p, &step.noise);
}
