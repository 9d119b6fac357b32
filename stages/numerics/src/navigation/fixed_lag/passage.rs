//! Windows along a line. An estimate is returned when no later window can improve it.

use std::collections::VecDeque;
use std::ops::Range;

use crate::navigation::aids::{AidStates, Aids, SampleInnovations};
use crate::navigation::gaussian::{Gaussian, StateLayout};
use crate::navigation::output::Innovation;
use crate::navigation::pinson::{ALT, LAT, LON, STATES, StateMatrix, StateVector};
use crate::navigation::{NavigationError, NavigationLine, PredictedField};

use super::nodes::{FixedLagNode, LineNodeBuilder, SLACK_S, carry};
use super::parameters::FixedLagParameters;
use super::window::SmoothingWindow;
use super::{FixedLagMagnetometer, FixedLagOutput, FixedLagUsage};

/// Estimate at a node, with its innovation.
pub(super) struct NodeEstimate {
    rows: Range<usize>,
    tt_s: f64,
    x: StateVector,
    p: StateMatrix,
    coefficients: Vec<f64>,
    innovation: Innovation,
    further: SampleInnovations,
    /// Horizontal slope of the predicted field, in nT/m.
    pub(super) slope_nt_per_m: f64,
    pub(super) usage: FixedLagUsage,
}

/// Filter ahead of the windows, linearised at its own predictions.
pub(super) struct FrontFilter<'a> {
    parameters: &'a FixedLagParameters,
    layout: &'a StateLayout,
    line: &'a NavigationLine<'a>,
    aids: (&'a Aids<'a>, &'a AidStates),
    field: PredictedField<'a>,
    pub(super) now: Gaussian,
    gain: Vec<f64>,
    spare: Vec<f64>,
}

impl<'a> FrontFilter<'a> {
    pub(super) fn new(
        parameters: &'a FixedLagParameters,
        layout: &'a StateLayout,
        line: &'a NavigationLine<'a>,
        aids: (&'a Aids<'a>, &'a AidStates),
        prior: Gaussian,
    ) -> Self {
        let gain = vec![0.0; prior.dim()];
        Self { parameters, layout, line, aids, field: line.predicted(), now: prior, gain, spare: vec![] }
    }

    /// Uses the measurements of a node: the first node of the line, or the node after the node of the previous call.
    /// Drops the node's measurements for which the map is too flat.
    pub(super) fn take(&mut self, node: &mut FixedLagNode) -> NodeEstimate {
        if node.rows.start > 0 {
            self.now.propagate(self.layout, &node.step, &mut self.spare);
        }
        for fix in &node.fixes {
            let residual = fix.residual(&self.now.x);
            let s = self.now.predict(&fix.sensitivity(), fix.variance, &mut self.gain);
            self.now.update(residual, s, &mut self.gain, &mut self.spare);
        }
        let (mut innovation, mut squares, mut used) = (Innovation::NONE, 0.0, 0_usize);
        let (mut flat, measured) = (false, node.measurements.iter().any(Option::is_some));
        for of in 0..node.measurements.len() {
            let Some(field) = node.field(of, self.line, &mut self.field, &self.now.x) else { continue };
            let Some(measurement) = &node.measurements[of] else { continue };
            if measurement.is_flat(self.aids.0, &field, self.line, node.rows.start) {
                (node.measurements[of], flat) = (None, true);
                continue;
            }
            let h = measurement.sensitivity(&field, self.layout, of);
            let residual = measurement.residual(&field, &h, &self.now.x);
            let s = self.now.predict(&h, measurement.variance_nt2, &mut self.gain);
            let nis = residual * residual / s;
            let inflated = measurement.variance_nt2 * (1.0 / self.parameters.robust().weight(nis.sqrt()) - 1.0);
            self.now.update(residual, s + inflated, &mut self.gain, &mut self.spare);
            if used == 0 {
                innovation.residual_nt = residual;
            }
            squares += nis;
            used += 1;
        }
        let mut usage = match used {
            0 if flat => FixedLagUsage::Flat,
            0 if !measured => FixedLagUsage::Missing,
            0 => FixedLagUsage::OffMap,
            _ => FixedLagUsage::Used,
        };
        if used > 0 {
            innovation.nis = squares / used as f64;
        }
        let (mut further, mut slope_nt_per_m) = (SampleInnovations::default(), f64::NAN);
        if self.aids.0.is_any() {
            let (line, row) = (self.line, node.rows.start);
            let position = [LAT, LON, ALT].map(|state| self.now.x[state]);
            let at = self.field.at_error(line.ins, row, position);
            slope_nt_per_m = at.map_or(f64::NAN, |at| line.slope_nt_per_m(row, &at));
            further = self.further(node);
            usage = if further.is_none() { usage } else { FixedLagUsage::Used };
            innovation = if used == 0 { further.difference } else { innovation };
        }
        NodeEstimate {
            rows: node.rows.clone(),
            tt_s: node.tt_s,
            x: self.now.ins_state(),
            p: self.now.p.ins(),
            coefficients: self.now.x[self.layout.coefficients()..].to_vec(),
            innovation,
            further,
            slope_nt_per_m,
            usage,
        }
    }

    /// Uses the further measurements of a node, all linearised at the state after its scalar measurements.
    fn further(&mut self, node: &FixedLagNode) -> SampleInnovations {
        let mut innovations = SampleInnovations::default();
        let rows = node.aid_rows(self.aids, self.layout, self.line, &mut self.field, &self.now.x);
        for linear in rows.iter() {
            let residual_nt = linear.residual(&self.now.x);
            let s = self.now.predict(&linear.sensitivity(), linear.variance, &mut self.gain);
            innovations.note(linear.of, Innovation { residual_nt, nis: residual_nt * residual_nt / s });
            self.now.update(residual_nt, s, &mut self.gain, &mut self.spare);
        }
        innovations
    }
}

/// Fixed-lag smoother along a line: its nodes, front filter, window and pending estimates.
pub(super) struct FixedLagRun<'a> {
    parameters: &'a FixedLagParameters,
    layout: &'a StateLayout,
    magnetometers: &'a [FixedLagMagnetometer<'a>],
    aids: &'a Aids<'a>,
    nodes: LineNodeBuilder<'a>,
    front: FrontFilter<'a>,
    window: SmoothingWindow<'a>,
    /// Estimates that are not yet final. The last estimates belong to the nodes of the window.
    pending: VecDeque<NodeEstimate>,
    output: FixedLagOutput,
}

impl<'a> FixedLagRun<'a> {
    pub fn new(
        parameters: &'a FixedLagParameters,
        layout: &'a StateLayout,
        magnetometers: &'a [FixedLagMagnetometer<'a>],
        aids: (&'a Aids<'a>, &'a AidStates),
        nodes: LineNodeBuilder<'a>,
        prior: Gaussian,
        output: FixedLagOutput,
    ) -> Self {
        let line = nodes.line;
        let front = FrontFilter::new(parameters, layout, line, aids, prior.clone());
        let window = SmoothingWindow::new(parameters, layout, line, aids, prior);
        let (pending, aids) = (VecDeque::new(), aids.0);
        Self { parameters, layout, magnetometers, aids, nodes, front, window, pending, output }
    }

    /// Processes all windows.
    pub fn run(mut self) -> Result<FixedLagOutput, NavigationError> {
        let tt_s = self.nodes.line.ins.tt_s;
        let (first_s, last_s) = (tt_s[0], tt_s[tt_s.len() - 1]);
        let stride_s = self.parameters.stride_s();
        let end_after = |tt_s: f64| first_s + stride_s * (((tt_s - first_s + SLACK_S) / stride_s).floor() + 1.0);
        while let Some(next_s) = self.nodes.next_s() {
            let end_s = end_after(next_s);
            while let Some(mut node) = self.nodes.take(end_s) {
                let estimate = self.front.take(&mut node);
                self.pending.push_back(estimate);
                self.window.nodes.push(node);
                if self.nodes.next_s().is_some_and(|next_s| next_s >= end_s - SLACK_S) {
                    break;
                }
            }
            let following_s = self.nodes.next_s().map(end_after);
            self.solve(end_s.min(last_s), following_s.map(|end_s| end_s.min(last_s)))?;
        }
        let last = &self.front.now;
        let first = self.layout.coefficients();
        self.output.coefficients = last.x[first..].to_vec();
        self.output.coefficient_covariance = last.p.block_from(first);
        Ok(self.output)
    }

    /// Solves the window that ends at a time, returns the estimates that the next window cannot improve, and slides the
    /// window.
    fn solve(&mut self, end_s: f64, following_s: Option<f64>) -> Result<(), NavigationError> {
        let nodes = &self.window.nodes;
        let (count, lag_s) = (nodes.len(), self.parameters.lag_s);
        let start_s = following_s.map(|end_s| end_s - self.parameters.window_s);
        let next =
            start_s.map_or(0, |start_s| nodes.partition_point(|node| node.tt_s < start_s - SLACK_S).min(count - 1));
        let is_final = |tt_s: f64| match (following_s, start_s) {
            (Some(following_s), Some(start_s)) => following_s > tt_s + lag_s + SLACK_S || tt_s < start_s - SLACK_S,
            _ => true,
        };
        let ripe = self.pending.partition_point(|estimate| is_final(estimate.tt_s));
        // Nodes whose estimates are final and may use the whole window.
        let oldest = self.pending.front().map_or(0, |estimate| estimate.rows.start);
        let smooth = |node: &FixedLagNode| {
            node.rows.start >= oldest && is_final(node.tt_s) && end_s <= node.tt_s + lag_s + SLACK_S
        };
        let mut wanted: Vec<bool> = nodes.iter().map(smooth).collect();
        let smoothed = wanted.iter().position(|wanted| *wanted);
        let until = wanted.iter().rposition(|wanted| *wanted).map_or(0, |last| last + 1);
        wanted[next] = true;
        let report = self.window.solve(&wanted);
        if !self.window.last.is_sound() {
            let (row, tt_s) = self.window.nodes.last().map_or((0, end_s), |node| (node.rows.start, node.tt_s));
            return Err(NavigationError::Diverged { row, tt_s });
        }
        self.output.windows.push(report);
        self.front.now.copy_from(&self.window.last);
        if let Some(from) = smoothed {
            self.smooth(from..until);
        }
        for _ in 0..ripe {
            if let Some(estimate) = self.pending.pop_front() {
                self.emit(estimate)?;
            }
        }
        self.window.slide(next);
        Ok(())
    }

    /// Replaces the filtered states of these nodes by the smoothed states.
    fn smooth(&mut self, range: Range<usize>) {
        // The last node of the window has the last pending estimate.
        let (pending, nodes) = (self.pending.len(), self.window.nodes.len());
        let (window, estimates, layout) = (&self.window, &mut self.pending, self.layout);
        window.covariances(range.clone(), |node, p| {
            let place = (pending + node).checked_sub(nodes);
            if let Some(estimate) = place.and_then(|place| estimates.get_mut(place)) {
                let x = window.state(node);
                estimate.x.copy_from_slice(&x[..STATES]);
                estimate.p = p;
                estimate.coefficients.copy_from_slice(&x[layout.coefficients()..]);
            }
        });
    }

    /// Writes the samples of a node.
    fn emit(&mut self, estimate: NodeEstimate) -> Result<(), NavigationError> {
        let line = self.nodes.line;
        let NodeEstimate { rows, mut x, mut p, coefficients, innovation, further, slope_nt_per_m, usage, .. } =
            estimate;
        for row in rows.clone() {
            let mut innovation = innovation;
            if row > rows.start {
                carry(line, row, &mut x, &mut p);
                innovation = Innovation::NONE;
            }
            let output = &mut self.output.navigation;
            output.push(line.ins, row, |state| x[state], |row, column| p[row][column], innovation, line.errors.earth);
            if !(0..x.len()).all(|state| x[state].is_finite() && p[state][state] >= 0.0) {
                return Err(NavigationError::Diverged { row, tt_s: line.ins.tt_s[row] });
            }
            let usage = match usage {
                FixedLagUsage::Used
                    if further.is_none() && !self.magnetometers.iter().any(|one| one.precision(row) > 0.0) =>
                {
                    FixedLagUsage::Missing
                }
                usage => usage,
            };
            let report = &mut output.report;
            match usage {
                FixedLagUsage::Used | FixedLagUsage::Flat => report.updates += 1,
                FixedLagUsage::Missing => report.missing_measurements += 1,
                FixedLagUsage::OffMap => report.off_map += 1,
            }
            self.output.usage.push(usage);
            // The innovation of an averaged measurement belongs to the first sample.
            let of_row = if row == rows.start { further } else { SampleInnovations::default() };
            self.output.aids.push(self.aids, &of_row);
            self.output.slope_nt_per_m.push(slope_nt_per_m);
            for (magnetometer, block) in self.magnetometers.iter().zip(&self.layout.blocks) {
                let first = self.layout.coefficients();
                let beta = &coefficients[block.start - first..block.end - first];
                let terms = magnetometer.coefficients.row(row).iter().zip(beta);
                self.output.aircraft_nt.push(terms.map(|(term, beta)| term * beta).sum());
            }
        }
        Ok(())
    }
}
