//! The recursion along a line.

use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix};

use super::UNEXPLAINED_NIS;
use super::cloud::{Cloud, SparseTransition};
use super::covariance::{measure, predict};
use super::draws::{Draws, Purpose};
use super::measurement::Predictor;
use super::modes::Clusters;
use super::output::{MpfOutput, modes_of};
use super::parameters::MpfParameters;
use super::resampling::{Resampler, Resampling};

/// A measurement that would leave less than this part of the particles effective is used in parts.
pub(super) const LEAST_LEFT: f64 = 0.1;
/// The smallest part of what is left of a measurement.
const LEAST_PART: f64 = 1.0 / 256.0;
/// The most parts of a measurement.
pub(super) const MOST_PARTS: usize = 64;

/// A filter on its way along a line.
pub(super) struct Filter<'a> {
    pub(super) line: &'a NavigationLine<'a>,
    pub(super) parameters: &'a MpfParameters,
    pub(super) cloud: Cloud,
    /// The covariance of the linear states given a particle's position, that all particles share.
    pub(super) p: StateMatrix,
    predictor: Predictor<'a>,
    resampler: Resampler,
    clusters: Clusters,
    offset_nt: f64,
    output: MpfOutput,
    /// Unexplained and collapsed samples in a row up to now.
    in_a_row: [usize; 2],
}

impl<'a> Filter<'a> {
    /// The particles at the first sample, before its measurement.
    pub(super) fn new(line: &'a NavigationLine<'a>, parameters: &'a MpfParameters) -> Self {
        let ins = line.ins;
        let mut p = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let sigmas = [LAT, LON].map(|state| p[state][state].sqrt());
        (p[LAT][LAT], p[LON][LON]) = (0.0, 0.0);
        let cloud = Cloud::new(parameters.particles, sigmas, Draws::new(parameters.seed, Purpose::Start, 0));
        let (offset_nt, samples) = line.predicted().offset(ins, line.measurement_nt, line.offset_window_s);
        let track = NavigationOutput::with_capacity(ins.len(), parameters.keep_states, parameters.keep_covariance);
        let mut output = MpfOutput { track, ..MpfOutput::default() };
        output.track.report.offset_nt = offset_nt;
        output.track.report.offset_samples = samples;
        output.report.least_effective = parameters.particles as f64;
        let predictor = Predictor::new(line, &cloud);
        let (resampler, clusters) = (Resampler::default(), Clusters::default());
        Self { line, parameters, cloud, p, predictor, resampler, clusters, offset_nt, output, in_a_row: [0; 2] }
    }

    /// Filters the line.
    pub(super) fn run(mut self) -> Result<MpfOutput, NavigationError> {
        for row in 0..self.line.ins.len() {
            if row > 0 {
                self.propagate(row);
            }
            self.aid(row);
            let innovation = self.measure(row);
            self.report(row, innovation)?;
            let effective = self.output.effective.last().copied().unwrap_or(0.0);
            if effective < self.parameters.resample_threshold * self.cloud.particles as f64 {
                self.resample(row, 0);
            }
        }
        Ok(self.output)
    }

    fn propagate(&mut self, row: usize) {
        let step = self.line.step(row);
        let spread = predict(&mut self.p, &step);
        let draws = Draws::new(self.parameters.seed, Purpose::Motion, row);
        self.cloud.propagate(&SparseTransition::of(&step.phi), &spread, draws);
    }

    /// Corrects weights, linear states and their covariance by the measurement of a row, where there is one to use.
    fn measure(&mut self, row: usize) -> Innovation {
        self.output.used.push(false);
        let measured = self.line.measured(row, self.offset_nt).filter(|_| self.line.sigma_nt[row] > 0.0);
        let Some(measured) = measured else {
            self.output.track.report.missing_measurements += 1;
            return Innovation::NONE;
        };
        let middle = self.cloud.mean();
        let Some(fit) = self.predictor.look(self.line.ins, row, &self.cloud, &middle, &self.p, measured) else {
            self.output.track.report.off_map += 1;
            return Innovation::NONE;
        };
        let residual_nt = fit.residual_nt;
        let innovation = Innovation { residual_nt, nis: residual_nt * residual_nt / fit.variance_nt2 };
        let unexplained = fit.best > UNEXPLAINED_NIS;
        let report = &mut self.output.report;
        count(unexplained, &mut report.unexplained, &mut self.in_a_row[0], &mut report.unexplained_in_a_row);
        if unexplained || self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            self.output.track.report.gated += 1;
            return innovation;
        }
        self.update(row, measured, fit.on_map);
        self.output.track.report.updates += 1;
        if let Some(used) = self.output.used.last_mut() {
            *used = true;
        }
        innovation
    }

    /// Corrects by a measurement that was looked up: at once, or where next to no particle would be left, as several
    /// measurements of it whose inverse variances sum up to its own, with a resampling after each but the last.
    fn update(&mut self, row: usize, (measured_nt, variance_nt2): (f64, f64), mut on_map: f64) {
        let enough = LEAST_LEFT * self.cloud.particles as f64;
        let mut left = 1.0_f64;
        for part_of_row in 1.. {
            let mut part = left;
            while self.predictor.weigh(&self.cloud, on_map) < enough
                && part > left * LEAST_PART
                && self.parameters.regularise
                && part_of_row < MOST_PARTS
            {
                part *= 0.5;
                self.predictor.compare_all(&self.cloud, &self.p, (measured_nt, variance_nt2 / part));
            }
            let information = self.predictor.accept(&mut self.cloud);
            self.cloud.correct(&self.p, &self.predictor.slopes, &self.predictor.residuals);
            measure(&mut self.p, information);
            left -= part;
            if left <= 0.0 {
                break;
            }
            self.resample(row, part_of_row);
            let middle = self.cloud.mean();
            let rest = (measured_nt, variance_nt2 / left);
            let Some(fit) = self.predictor.look(self.line.ins, row, &self.cloud, &middle, &self.p, rest) else { break };
            on_map = fit.on_map;
        }
    }

    /// Appends the row to the output.
    fn report(&mut self, row: usize, innovation: Innovation) -> Result<(), NavigationError> {
        let Self { line, cloud, p, output, .. } = self;
        let mean = cloud.mean();
        let [a, b, c] = cloud.position_covariance(&mean);
        let fine = |x: f64| x.is_finite() && x >= 0.0;
        if !(mean.iter().all(|x| x.is_finite()) && fine(a) && fine(c) && (0..STATES).all(|k| fine(p[k][k]))) {
            return Err(NavigationError::Diverged { row, tt_s: line.ins.tt_s[row] });
        }
        let effective = cloud.effective();
        output.effective.push(effective);
        let report = &mut output.report;
        report.least_effective = report.least_effective.min(effective);
        if output.used.last() == Some(&true) {
            let collapsed = effective < 2.0 && cloud.particles > 2;
            count(collapsed, &mut report.collapsed, &mut self.in_a_row[1], &mut report.collapsed_in_a_row);
        }
        let (ins, earth) = (line.ins, line.errors.earth);
        if self.parameters.keep_covariance {
            let mut all = cloud.covariance(&mean);
            add(&mut all, p);
            output.track.push(ins, row, |k| mean[k], |r, c| all[r][c], innovation, earth);
        } else {
            let of = |r: usize, col: usize| match (r, col) {
                (LAT, LAT) => a,
                (LON, LON) => c,
                _ => b,
            };
            output.track.push(ins, row, |k| mean[k], of, innovation, earth);
        }
        let wanted = self.parameters.modes_every.is_some_and(|every| row.is_multiple_of(every));
        if wanted || row + 1 == ins.len() {
            output.modes.push(modes_of(&mut self.clusters, cloud, ins, row, earth));
        }
        Ok(())
    }

    fn resample(&mut self, row: usize, part: usize) {
        self.resample_as(row, row * MOST_PARTS + part);
    }

    /// Resamples at a row, by draws of a number that no other resampling of the line has.
    pub(super) fn resample_as(&mut self, row: usize, number: usize) {
        let MpfParameters { seed, regularise, roughening, smooth_over_m, .. } = *self.parameters;
        let lat_rad = self.line.ins.lat_deg[row].to_radians();
        let (north, east) = self.line.errors.earth.north_east_m_per_rad(lat_rad, self.line.ins.alt_m[row]);
        let how = Resampling { seed, regularise, roughening, smooth_over_m, m_per_rad: [north, east] };
        self.resampler.resample(how, number, &mut self.cloud, &mut self.p);
        self.output.report.resamplings += 1;
    }
}

/// Counts what happens, and how often in a row at most.
fn count(happens: bool, all: &mut usize, in_a_row: &mut usize, most: &mut usize) {
    if happens {
        *all += 1;
        *in_a_row += 1;
        *most = (*most).max(*in_a_row);
    } else {
        *in_a_row = 0;
    }
}

fn add(to: &mut StateMatrix, from: &StateMatrix) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += from;
    }
}
