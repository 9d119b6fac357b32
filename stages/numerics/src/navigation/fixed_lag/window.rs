//! States of a window: Gauss-Newton with a line search. Each step is a forward pass and its adjoint.

use std::ops::Range;

use super::nodes::{FixedLagNode, LocalField};
use super::parameters::{FixedLagParameters, WindowReport};
use crate::inner_product::dot;
use crate::navigation::aids::{Aid, AidMeasurements, AidStates, Aids};
use crate::navigation::gaussian::covariance::add_scaled;
use crate::navigation::gaussian::{AugmentedSensitivity, Gaussian, StateLayout, adjoint, propagate_mean};
use crate::navigation::loss::TrajectoryLoss;
use crate::navigation::output::Innovation;
use crate::navigation::pinson::{ALT, LAT, LON, StateMatrix};
use crate::navigation::{NavigationLine, PredictedField};

/// Maximum number of halvings of a step.
const MOST_HALVINGS: u32 = 8;

/// Path through the nodes: x = m − P λ at the first node, x ← Φ x − Q λ at the other nodes, with the adjoint λ of the
/// path.
#[derive(Clone, Debug, Default)]
struct WindowPath {
    x: Vec<f64>,
    adjoint: Vec<f64>,
    /// Half the squared distance from prior and process.
    distance: f64,
}

/// Measurements of all nodes, linearised about a path.
#[derive(Clone, Debug, Default)]
struct WindowLinearisation {
    /// One entry per node and magnetometer.
    fields: Vec<Option<LocalField>>,
    /// One entry per node, if there are further measurements.
    rows: Vec<AidMeasurements>,
}

/// Values of a measurement that the forward pass saves for its adjoint.
#[derive(Clone, Copy, Debug)]
pub(super) struct AdjointTrace {
    pub(super) of: MeasurementSource,
    /// Innovation divided by its variance, and the variance.
    scaled: f64,
    variance: f64,
    /// Factor of a robust loss on the variance.
    inflated: f64,
}

impl AdjointTrace {
    /// Innovation, and its square over the variance without the factor of the loss.
    pub(super) fn innovation(&self) -> Innovation {
        let residual_nt = self.scaled * self.variance;
        Innovation { residual_nt, nis: residual_nt * residual_nt / (self.variance - self.inflated) }
    }
}

/// Source of a measurement, by its index among the measurements of the node.
#[derive(Clone, Copy, Debug)]
pub(super) enum MeasurementSource {
    Magnetometer(usize),
    Fix(usize),
    Aid(Aid),
}

/// Window that slides along the nodes.
pub(super) struct SmoothingWindow<'a> {
    parameters: &'a FixedLagParameters,
    layout: &'a StateLayout,
    line: &'a NavigationLine<'a>,
    aids: (&'a Aids<'a>, &'a AidStates),
    /// The window is also solved if one step changes every position by less than this, in metres.
    pub tolerance_m: f64,
    field: PredictedField<'a>,
    /// Nodes; the first is the window's start.
    pub nodes: Vec<FixedLagNode>,
    /// States at the first node, before its measurements are applied.
    pub prior: Gaussian,
    /// States at the last node, with all measurements up to it.
    pub last: Gaussian,
    path: WindowPath,
    trial: WindowPath,
    /// Linearisation point of the last forward pass.
    about: WindowLinearisation,
    /// Linearisation about the trial path or, between windows, about the path.
    trial_about: WindowLinearisation,
    /// Index of the first trace of each node; and one more index at the end.
    starts: Vec<usize>,
    traces: Vec<AdjointTrace>,
    gains: Vec<f64>,
    /// Predicted states of the requested nodes.
    predicted: Vec<Option<Gaussian>>,
    spare: Vec<f64>,
    row: Vec<f64>,
}

impl<'a> SmoothingWindow<'a> {
    pub fn new(
        parameters: &'a FixedLagParameters,
        layout: &'a StateLayout,
        line: &'a NavigationLine<'a>,
        aids: (&'a Aids<'a>, &'a AidStates),
        prior: Gaussian,
    ) -> Self {
        Self {
            parameters,
            layout,
            line,
            aids,
            tolerance_m: 0.0,
            field: line.predicted(),
            nodes: vec![],
            last: prior.clone(),
            row: vec![0.0; prior.dim()],
            prior,
            path: WindowPath::default(),
            trial: WindowPath::default(),
            about: WindowLinearisation::default(),
            trial_about: WindowLinearisation::default(),
            starts: vec![],
            traces: vec![],
            gains: vec![],
            predicted: vec![],
            spare: vec![],
        }
    }

    fn dim(&self) -> usize {
        self.layout.dim()
    }

    /// Smoothed states of a node.
    pub fn state(&self, node: usize) -> &[f64] {
        &self.path.x[node * self.dim()..(node + 1) * self.dim()]
    }

    /// Solves for the states of all nodes and keeps the predicted states of the nodes in `wanted`.
    pub fn solve(&mut self, wanted: &[bool]) -> WindowReport {
        let new = self.extend();
        std::mem::swap(&mut self.about, &mut self.trial_about);
        self.evaluate(new.start);
        self.path.distance = self.distance(&self.path);
        let before = self.cost(&self.path, &self.about, &self.about);
        self.iterate(&new, wanted, before)
    }

    /// Solves for the states of all nodes, first linearised about `x`, regardless of the cost of `x`.
    pub fn solve_from(&mut self, x: Vec<f64>, wanted: &[bool]) -> WindowReport {
        self.path = WindowPath { adjoint: vec![0.0; x.len()], x, distance: 0.0 };
        self.evaluate(0);
        self.iterate(&(0..0), wanted, f64::INFINITY)
    }

    /// Evaluates the measurements about the path, from a node on.
    fn evaluate(&mut self, first: usize) {
        let (mut about, path) = (std::mem::take(&mut self.about), std::mem::take(&mut self.path));
        self.linearise(&path.x, first, &mut about);
        (self.about, self.path) = (about, path);
    }

    /// Gauss-Newton iteration from the path with cost `before`. The residuals of the nodes in `new` are not yet known.
    fn iterate(&mut self, new: &Range<usize>, wanted: &[bool], mut before: f64) -> WindowReport {
        self.predicted.resize(self.nodes.len(), None);
        let mut report = WindowReport { smallest_step: 1.0, states: self.dim(), ..WindowReport::default() };
        let tolerance = self.parameters.tolerance;
        while report.iterations < self.parameters.iterations.max(1) && !report.converged {
            // The new residuals are unknown before the first iteration.
            let trusted = if report.iterations == 0 { new.clone() } else { 0..0 };
            self.forward(&trusted, wanted);
            self.adjoint();
            report.iterations += 1;
            let linear = self.cost(&self.trial, &self.about, &self.about);
            report.last_step_m = if before.is_finite() { self.step_m() } else { f64::INFINITY };
            let (share, after) = self.search(before);
            report.smallest_step = report.smallest_step.min(share);
            report.converged = share > 0.0
                && match self.parameters.loss {
                    // The cost equals that of the linear model, so another iteration would not change it.
                    TrajectoryLoss::None => {
                        before - after < tolerance || (share == 1.0 && (linear - after).abs() < tolerance)
                    }
                    TrajectoryLoss::Huber | TrajectoryLoss::Cauchy => {
                        before - after < tolerance && report.iterations > 1
                    }
                };
            report.converged |= share == 1.0 && report.last_step_m < self.tolerance_m;
            if share == 0.0 {
                break;
            }
            if report.converged {
                // The last pass is kept, with the predicted fields.
                std::mem::swap(&mut self.about, &mut self.trial_about);
                before = after;
            } else {
                // The set of samples on the map may have changed with the path.
                before = self.cost(&self.path, &self.about, &self.about);
            }
        }
        if !report.converged {
            self.forward(&(0..0), wanted);
            self.trial_about.clone_from(&self.about);
        }
        report.span_s = [self.nodes[0].tt_s, self.nodes[self.nodes.len() - 1].tt_s];
        report.nodes = self.nodes.len();
        report.measurements = self.traces.len();
        report.chi_square = 2.0 * before;
        report.prior_chi_square = self.prior_cost(&self.path);
        report.inconsistent = WindowReport::contradicts(report.prior_chi_square, report.states);
        report
    }

    /// Extends the path to the new nodes, without process noise. Returns these nodes.
    fn extend(&mut self) -> Range<usize> {
        let dim = self.dim();
        let known = self.path.x.len() / dim;
        for node in known..self.nodes.len() {
            if node == 0 {
                self.path.x.extend_from_slice(&self.prior.x);
            } else {
                self.path.x.extend_from_within((node - 1) * dim..node * dim);
                propagate_mean(self.layout, &self.nodes[node].step, &mut self.path.x[node * dim..]);
            }
        }
        self.path.adjoint.resize(self.nodes.len() * dim, 0.0);
        known..self.nodes.len()
    }

    /// Linearises the measurements about the states of all nodes, from a node on.
    fn linearise(&mut self, x: &[f64], first: usize, out: &mut WindowLinearisation) {
        let (dim, magnetometers) = (self.dim(), self.layout.blocks.len());
        out.fields.truncate(first * magnetometers);
        out.rows.truncate(first);
        for (node, x) in self.nodes.iter().zip(x.chunks_exact(dim)).skip(first) {
            for of in 0..magnetometers {
                out.fields.push(node.field(of, self.line, &mut self.field, x));
            }
            if self.aids.0.is_any() {
                out.rows.push(node.aid_rows(self.aids, self.layout, self.line, &mut self.field, x));
            }
        }
    }

    /// Largest distance from the path to the trial path, in metres.
    fn step_m(&self) -> f64 {
        let dim = self.dim();
        let mut largest = 0.0_f64;
        for (node, (to, from)) in
            self.nodes.iter().zip(self.trial.x.chunks_exact(dim).zip(self.path.x.chunks_exact(dim)))
        {
            let (ins, row) = (self.line.ins, node.rows.start);
            let m_per_rad = self.line.errors.earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]);
            let (north, east) = (m_per_rad.0 * (to[LAT] - from[LAT]), m_per_rad.1 * (to[LON] - from[LON]));
            largest = largest.max((north * north + east * east + (to[ALT] - from[ALT]).powi(2)).sqrt());
        }
        largest
    }

    /// Values of the measurements of a node in the last forward pass.
    pub fn traces(&self, node: usize) -> &[AdjointTrace] {
        &self.traces[self.starts[node]..self.starts[node + 1]]
    }

    /// Half the squared distance of a path from prior and process: ½ λᵀ P λ of the first node, ½ λᵀ Q λ of the other
    /// nodes.
    fn distance(&self, path: &WindowPath) -> f64 {
        let dim = self.dim();
        let mut noise = vec![0.0; dim];
        let mut sum = 0.5 * self.prior_cost(path);
        for (node, adjoint) in self.nodes.iter().zip(path.adjoint.chunks_exact(dim)).skip(1) {
            adjoint::noise_times(self.layout, &node.step, adjoint, &mut noise);
            sum += 0.5 * dot(adjoint, &noise);
        }
        sum
    }

    /// Half the squared distance plus the loss of the residuals in `counted`; those without a field are of the path.
    fn cost(&self, path: &WindowPath, about: &WindowLinearisation, counted: &WindowLinearisation) -> f64 {
        let (dim, magnetometers) = (self.dim(), self.layout.blocks.len());
        let (loss, mut sum) = (self.parameters.robust(), path.distance);
        for (k, node) in self.nodes.iter().enumerate() {
            let range = k * dim..(k + 1) * dim;
            for (of, measurement) in node.measurements.iter().enumerate() {
                let place = k * magnetometers + of;
                let (Some(measurement), Some(known)) = (measurement, &counted.fields[place]) else { continue };
                let (field, x) = match &about.fields[place] {
                    Some(field) => (field, &path.x[range.clone()]),
                    None => (known, &self.path.x[range.clone()]),
                };
                let residual = measurement.residual(field, &measurement.sensitivity(field, self.layout, of), x);
                sum += loss.value(residual / measurement.variance_nt2.sqrt());
            }
            for known in counted.rows.get(k).into_iter().flat_map(AidMeasurements::iter) {
                let (linear, x) = match about.rows.get(k).and_then(|rows| rows.get(known.of)) {
                    Some(linear) => (linear, &path.x[range.clone()]),
                    None => (known, &self.path.x[range.clone()]),
                };
                sum += 0.5 * linear.residual(x).powi(2) / linear.variance;
            }
            for fix in &node.fixes {
                sum += 0.5 * fix.residual(&path.x[range.clone()]).powi(2) / fix.variance;
            }
        }
        sum
    }

    /// λᵀ P λ at the window's start: the squared distance from the prior.
    fn prior_cost(&self, path: &WindowPath) -> f64 {
        let dim = self.dim();
        let Some(adjoint) = path.adjoint.get(..dim) else { return 0.0 };
        self.prior.p.rows().zip(adjoint).map(|(row, entry)| entry * dot(row, adjoint)).sum()
    }

    /// Filters about the path. Measurements of the nodes in `trusted` have their full weight.
    fn forward(&mut self, trusted: &Range<usize>, wanted: &[bool]) {
        let (dim, magnetometers) = (self.dim(), self.layout.blocks.len());
        self.traces.clear();
        self.starts.clear();
        self.gains.clear();
        let (loss, mut now) = (self.parameters.robust(), std::mem::take(&mut self.last));
        now.copy_from(&self.prior);
        for (k, node) in self.nodes.iter().enumerate() {
            if k > 0 {
                now.propagate(self.layout, &node.step, &mut self.spare);
            }
            if wanted.get(k) == Some(&true) {
                self.predicted[k].get_or_insert_default().copy_from(&now);
            }
            self.starts.push(self.traces.len());
            for (of, fix) in node.fixes.iter().enumerate() {
                let (innovation, at) = (fix.residual(&now.x), self.gains.len());
                self.gains.resize(at + dim, 0.0);
                let s = now.predict(&fix.sensitivity(), fix.variance, &mut self.gains[at..]);
                now.update(innovation, s, &mut self.gains[at..], &mut self.spare);
                let (of, scaled) = (MeasurementSource::Fix(of), innovation / s);
                self.traces.push(AdjointTrace { of, scaled, variance: s, inflated: 0.0 });
            }
            for (of, measurement) in node.measurements.iter().enumerate() {
                let (Some(measurement), Some(field)) = (measurement, &self.about.fields[k * magnetometers + of]) else {
                    continue;
                };
                let h = measurement.sensitivity(field, self.layout, of);
                let mut variance = measurement.variance_nt2;
                if !trusted.contains(&k) {
                    let residual = measurement.residual(field, &h, &self.path.x[k * dim..(k + 1) * dim]);
                    variance /= loss.weight(residual / variance.sqrt());
                }
                let innovation = measurement.residual(field, &h, &now.x);
                let at = self.gains.len();
                self.gains.resize(at + dim, 0.0);
                let s = now.predict(&h, variance, &mut self.gains[at..]);
                now.update(innovation, s, &mut self.gains[at..], &mut self.spare);
                let (of, scaled) = (MeasurementSource::Magnetometer(of), innovation / s);
                self.traces.push(AdjointTrace {
                    of,
                    scaled,
                    variance: s,
                    inflated: variance - measurement.variance_nt2,
                });
            }
            for linear in self.about.rows.get(k).into_iter().flat_map(AidMeasurements::iter) {
                let (innovation, at) = (linear.residual(&now.x), self.gains.len());
                self.gains.resize(at + dim, 0.0);
                let s = now.predict(&linear.sensitivity(), linear.variance, &mut self.gains[at..]);
                now.update(innovation, s, &mut self.gains[at..], &mut self.spare);
                let (of, scaled) = (MeasurementSource::Aid(linear.of), innovation / s);
                self.traces.push(AdjointTrace { of, scaled, variance: s, inflated: 0.0 });
            }
        }
        self.starts.push(self.traces.len());
        self.last = now;
    }

    /// Computes the adjoint of the forward pass and the resulting path, the Gauss-Newton step. [Bryson & Frazier 1963;
    /// Bierman 1973]
    fn adjoint(&mut self) {
        let dim = self.dim();
        let nodes = self.nodes.len();
        self.trial.adjoint.clear();
        self.trial.adjoint.resize(nodes * dim, 0.0);
        let mut adjoint = std::mem::take(&mut self.row);
        adjoint.fill(0.0);
        for k in (0..nodes).rev() {
            for trace in (self.starts[k]..self.starts[k + 1]).rev() {
                let AdjointTrace { of, scaled, .. } = self.traces[trace];
                let gain = &self.gains[trace * dim..(trace + 1) * dim];
                if let Some(h) = self.sensitivity(k, of) {
                    let factor = scaled + dot(gain, &adjoint);
                    h.add_to(&mut adjoint, -factor);
                }
            }
            self.trial.adjoint[k * dim..(k + 1) * dim].copy_from_slice(&adjoint);
            if k > 0 {
                adjoint::propagate_adjoint(self.layout, &self.nodes[k].step, &mut adjoint);
            }
        }
        self.row = adjoint;
        self.follow();
    }

    /// Row of H of a measurement in the last forward pass.
    fn sensitivity(&self, node: usize, of: MeasurementSource) -> Option<AugmentedSensitivity<'_>> {
        match of {
            MeasurementSource::Fix(of) => self.nodes[node].fixes.get(of).map(|fix| fix.sensitivity()),
            MeasurementSource::Magnetometer(of) => {
                let measurement = self.nodes[node].measurements[of].as_ref()?;
                let field = self.about.fields[node * self.layout.blocks.len() + of].as_ref()?;
                Some(measurement.sensitivity(field, self.layout, of))
            }
            MeasurementSource::Aid(of) => Some(self.about.rows.get(node)?.get(of)?.sensitivity()),
        }
    }

    /// Computes the states of the trial path from its adjoint.
    fn follow(&mut self) {
        let dim = self.dim();
        self.trial.x.clear();
        let first = &self.trial.adjoint[..dim];
        let moved = self.prior.x.iter().zip(self.prior.p.rows()).map(|(x, row)| x - dot(row, first));
        self.trial.x.extend(moved);
        let mut squared = self.prior_cost(&self.trial);
        for k in 1..self.nodes.len() {
            self.trial.x.extend_from_within((k - 1) * dim..k * dim);
            let x = &mut self.trial.x[k * dim..];
            propagate_mean(self.layout, &self.nodes[k].step, x);
            let adjoint = &self.trial.adjoint[k * dim..(k + 1) * dim];
            adjoint::noise_times(self.layout, &self.nodes[k].step, adjoint, &mut self.row);
            squared += dot(adjoint, &self.row);
            add_scaled(x, -1.0, &self.row);
        }
        self.trial.distance = 0.5 * squared;
    }

    /// Takes the largest of the fractions 1, 1/2, 1/4 … of the step that lowers the cost, or no step. Returns the
    /// fraction and the cost.
    fn search(&mut self, before: f64) -> (f64, f64) {
        let mut share = 1.0;
        for _ in 0..MOST_HALVINGS {
            let (mut about, trial) = (std::mem::take(&mut self.trial_about), std::mem::take(&mut self.trial));
            self.linearise(&trial.x, 0, &mut about);
            (self.trial_about, self.trial) = (about, trial);
            let after = self.cost(&self.trial, &self.trial_about, &self.about);
            // Rounding may raise the cost of a path that is already the solution.
            if after <= before + 1e-9 * before.abs() {
                std::mem::swap(&mut self.path, &mut self.trial);
                std::mem::swap(&mut self.about, &mut self.trial_about);
                return (share, after);
            }
            share *= 0.5;
            halve(&mut self.trial.x, &self.path.x);
            halve(&mut self.trial.adjoint, &self.path.adjoint);
            self.trial.distance = self.distance(&self.trial);
        }
        (0.0, before)
    }

    /// Smoothed covariances of the 18 states at the nodes with stored predicted states, from the last to the first of
    /// `range`: P − P Λ P with the adjoint Λ of the information.
    pub fn covariances(&self, range: Range<usize>, mut take: impl FnMut(usize, StateMatrix)) {
        let dim = self.dim();
        let mut information = vec![0.0; dim * dim];
        let (mut column, mut dense, mut spare) = (vec![0.0; dim], vec![0.0; dim], vec![]);
        for k in (range.start..self.nodes.len()).rev() {
            for trace in (self.starts[k]..self.starts[k + 1]).rev() {
                let AdjointTrace { of, variance, .. } = self.traces[trace];
                let gain = &self.gains[trace * dim..(trace + 1) * dim];
                let Some(h) = self.sensitivity(k, of) else { continue };
                dense.fill(0.0);
                h.add_to(&mut dense, 1.0);
                adjoint::correct_information(&mut information, &dense, gain, variance, &mut column);
            }
            if let (true, Some(predicted)) = (k < range.end, &self.predicted[k]) {
                take(k, adjoint::smoothed(predicted, &information));
            }
            if k > 0 {
                adjoint::propagate_information(self.layout, &self.nodes[k].step, &mut information, &mut spare);
            }
        }
    }

    /// Drops the nodes before `first`. The predicted states, which include the dropped measurements, become the prior.
    pub fn slide(&mut self, first: usize) {
        if first == 0 {
            return;
        }
        let dim = self.dim();
        if let Some(predicted) = self.predicted[first].take() {
            self.prior = predicted;
        }
        self.nodes.drain(..first);
        self.predicted.drain(..first);
        self.path.x.drain(..first * dim);
        self.path.adjoint.drain(..first * dim);
        self.trial_about.fields.drain(..first * self.layout.blocks.len());
        self.trial_about.rows.drain(..first.min(self.trial_about.rows.len()));
    }
}

/// Replaces the vector by the midpoint between this vector and another vector.
fn halve(to: &mut [f64], other: &[f64]) {
    to.iter_mut().zip(other).for_each(|(to, other)| *to = 0.5 * (*to + other));
}
