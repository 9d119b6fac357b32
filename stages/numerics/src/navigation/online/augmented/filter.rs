//! Recursion of the filter.

use pulp::{Simd, WithSimd};

use crate::earth::field_value::FieldValue;
use crate::inner_product::dot;
use crate::navigation::aided::filter::MeasurementOutcome;
use crate::navigation::aids::{AidInnovations, AidStates, LinearisedAid, SampleInnovations, SampleUsage};
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::StepModel;
use crate::navigation::gaussian::covariance::{Covariance, WIDEST, add_scaled};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::measurement::{Reading, usable};
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::navigation::position_fixes::{NO_FIX, StateFix};
use crate::navigation::stream::StateVisitor;
use crate::navigation::transition::propagate_state;
use crate::signal::gauss_markov::GaussMarkov;

use super::{
    AircraftFieldModel, AugmentedOutput, ExtraStates, LineModel, MagnetometerColumns, MagnetometerReport,
    MagnetometerTrack, OnlineParameters, refused,
};

/// Filter along a line, as a kernel compiled for the SIMD instructions of the machine.
pub(super) struct AugmentedFilterRun<'a, M> {
    pub(super) filter: AugmentedFilter<'a, M>,
    pub(super) line: &'a LineModel<'a>,
    pub(super) magnetometers: &'a [MagnetometerColumns<'a>],
}

impl<M: AircraftFieldModel> WithSimd for AugmentedFilterRun<'_, M> {
    type Output = Result<AugmentedOutput, NavigationError>;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> Self::Output {
        let Self { mut filter, line, magnetometers } = self;
        for row in 0..line.ins.len() {
            let fixes = line.fixes.map_or(NO_FIX, |fixes| fixes.at(line.ins, row, line.errors.earth));
            let reading = |of: usize| (magnetometers[of].0[row], magnetometers[of].1[row]);
            filter.sample(line, row, fixes, &reading)?;
        }
        Ok(filter.finish())
    }
}

/// Vectors of the length of a padded row.
#[derive(Clone)]
struct AugmentedBuffers {
    /// Row H of each magnetometer.
    h: Vec<f64>,
    /// P Hᵀ, which becomes K.
    gain: Vec<f64>,
    rest: Vec<f64>,
    cross: Vec<f64>,
    /// State before the measurements of a sample.
    before: Vec<f64>,
    decay: Vec<f64>,
    noise: Vec<f64>,
}

/// Nonzero entries of a row of H, with their states.
#[inline(always)]
fn nonzero(h: &[f64]) -> impl Iterator<Item = (usize, f64)> {
    h.iter().copied().enumerate().filter(|(_, h)| *h != 0.0)
}

/// Residual of a magnetometer at a sample, or the reason why the residual is missing.
#[derive(Clone, Copy)]
enum MagnetometerResidual {
    Missing,
    OffMap,
    /// Measurement minus prediction before the sample, in nT, and the variance of the measurement, in nT².
    Residual(f64, f64),
}

/// Filter of the augmented state along a line.
#[derive(Clone)]
pub(super) struct AugmentedFilter<'a, M> {
    pub(super) model: M,
    /// Number of states of the aircraft field model.
    own: usize,
    /// States of the aircraft field model, followed by those of the further measurements.
    states: ExtraStates,
    of_aids: AidStates,
    parameters: OnlineParameters,
    predicted: PredictedField<'a>,
    process: StepModel,
    x: Vec<f64>,
    p: Covariance,
    /// Residuals of the magnetometers at the present sample.
    readings: Vec<MagnetometerResidual>,
    /// Number of consecutive rejections of each magnetometer.
    rejected: Vec<usize>,
    scratch: AugmentedBuffers,
    pub(super) output: AugmentedOutput,
}

impl<'a, M: AircraftFieldModel> AugmentedFilter<'a, M> {
    /// Filter before the first sample, with capacity for the output of `rows`.
    pub(super) fn new(
        predicted: PredictedField<'a>,
        errors: &InsErrorModel,
        model: M,
        (own, states, of_aids): (usize, ExtraStates, AidStates),
        parameters: &OnlineParameters,
        [magnetometers, rows]: [usize; 2],
    ) -> Self {
        let others = states.mean.len();
        let p = Covariance::block_diagonal(&[[0.0; STATES]; STATES], &states.covariance, others);
        let stride = p.stride();
        let mut x = vec![0.0; stride];
        x[STATES..STATES + others].copy_from_slice(&states.mean);
        let zeros = || vec![0.0; stride];
        let scratch = AugmentedBuffers {
            h: vec![0.0; stride * magnetometers],
            gain: zeros(),
            rest: zeros(),
            cross: Vec::with_capacity(STATES * others),
            before: zeros(),
            decay: vec![1.0; others],
            noise: vec![0.0; others],
        };
        let column = || Vec::with_capacity(rows);
        let track = |_| MagnetometerTrack {
            residual_nt: column(),
            nis: column(),
            aircraft_nt: column(),
            gated: Vec::with_capacity(rows),
            report: MagnetometerReport::default(),
        };
        let kept = if parameters.keep_coefficients { rows * own } else { 0 };
        let output = AugmentedOutput {
            navigation: NavigationOutput::with_capacity(rows, parameters.keep_states, parameters.keep_covariance),
            magnetometers: (0..magnetometers).map(track).collect(),
            c: vec![],
            c_covariance: vec![],
            usage: vec![],
            aids: AidInnovations::default(),
            slope_nt_per_m: vec![],
            c_by_row: Vec::with_capacity(kept),
            c_sigma_by_row: Vec::with_capacity(kept),
        };
        let readings = vec![MagnetometerResidual::Missing; magnetometers];
        let (parameters, process) = (*parameters, StepModel::from_error_model(errors));
        let rejected = vec![0; magnetometers];
        Self { model, own, states, of_aids, parameters, predicted, process, x, p, readings, rejected, scratch, output }
    }

    /// Computes the offset of each magnetometer.
    pub(super) fn take_offsets(&mut self, lines: &[NavigationLine<'_>]) {
        for (magnetometer, line) in lines.iter().enumerate() {
            let (ins, window_s) = (line.ins, line.offset_window_s);
            let within = ins.tt_s.iter().take_while(|tt_s| **tt_s - ins.tt_s[0] <= window_s).count();
            let mut left_nt = Vec::with_capacity(within);
            for row in 0..within {
                let aircraft_nt =
                    self.model.value(magnetometer, row, &self.states.mean[..self.own]).unwrap_or(f64::NAN);
                left_nt.push(line.measured(row, 0.0).map_or(f64::NAN, |(nt, _)| nt - aircraft_nt));
            }
            let report = &mut self.output.magnetometers[magnetometer].report;
            (report.offset_nt, report.offset_samples) = self.predicted.offset(ins, &left_nt, window_s);
        }
        if let Some(first) = self.output.magnetometers.first().map(|track| track.report) {
            let report = &mut self.output.navigation.report;
            (report.offset_nt, report.offset_samples) = (first.offset_nt, first.offset_samples);
        }
    }

    /// Filters one sample of a line: the step from the row before, if any, the aiding positions, and the measurements.
    /// `reading` gives the measurement and sigma of each magnetometer; the line's own fixes are not read.
    #[inline(always)]
    pub(super) fn sample(
        &mut self,
        line: &LineModel<'_>,
        row: usize,
        fixes: [Option<StateFix>; 3],
        reading: &impl Fn(usize) -> Reading,
    ) -> Result<(), NavigationError> {
        if row > 0 {
            self.propagate(line.ins, row);
        } else {
            self.p.set_ins(&line.errors.initial_covariance(line.ins.point(0).lat_rad, line.ins.alt_m[0]));
        }
        self.aid(fixes);
        let innovation = self.update(line, row, reading)?;
        self.store(line, row, innovation)
    }

    /// Propagates from the previous sample to `row`.
    #[inline(always)]
    fn propagate(&mut self, ins: &InsSeries<'_>, row: usize) {
        let step = self.process.transition(ins, row);
        let dt_s = step.dt_s;
        let moved = propagate_state(&step.phi, &std::array::from_fn(|state| self.x[state]));
        self.x[..STATES].copy_from_slice(&moved);
        let AugmentedBuffers { decay, noise, cross, .. } = &mut self.scratch;
        self.states.step(dt_s, decay, noise);
        let speed_mps = ins.vn_mps[row - 1].hypot(ins.ve_mps[row - 1]);
        for (place, length_m) in &self.of_aids.lengths_m {
            let error = GaussMarkov { tau_s: length_m / speed_mps, ..self.of_aids.errors[*place] };
            (decay[self.own + place], noise[self.own + place]) = (error.decay(dt_s), error.step_variance(dt_s));
        }
        for ((c, mean), decay) in self.x[STATES..].iter_mut().zip(&self.states.mean).zip(&*decay) {
            if *decay != 1.0 {
                *c = mean + decay * (*c - mean);
            }
        }
        let block = self.process.covariance(&self.p.ins(), &step);
        self.p.set_ins(&block);
        self.p.propagate_cross(&step.phi, decay, cross);
        self.p.decay_together(decay);
        for (state, noise) in (STATES..).zip(&*noise) {
            *self.p.at_mut(state, state) += noise;
        }
    }

    /// Uses the aiding positions of a sample.
    #[inline(always)]
    fn aid(&mut self, fixes: [Option<StateFix>; 3]) {
        for StateFix { state, error, variance } in fixes.into_iter().flatten() {
            let AugmentedBuffers { gain, rest, .. } = &mut self.scratch;
            gain.copy_from_slice(self.p.row(state));
            let s = gain[state] + variance;
            let residual = error - self.x[state];
            self.p.update(s, gain, rest);
            add_scaled(&mut self.x, residual, gain);
        }
    }

    /// Uses the measurements of a sample.
    #[inline(always)]
    fn update(
        &mut self,
        line: &LineModel<'_>,
        row: usize,
        reading: &impl Fn(usize) -> Reading,
    ) -> Result<Innovation, NavigationError> {
        self.scratch.before.copy_from_slice(&self.x);
        // All are linearised before the state is updated.
        let mut measured = false;
        for magnetometer in 0..self.readings.len() {
            self.readings[magnetometer] = self.linearise(magnetometer, row, reading(magnetometer));
            measured |= matches!(self.readings[magnetometer], MagnetometerResidual::Residual(..));
        }
        let slope_nt_per_m = self.predict_field(line, row, measured);
        let (mut off_map, mut used, mut sum, mut samples, mut residual_nt) = (false, None, 0.0, 0_usize, f64::NAN);
        for magnetometer in 0..self.readings.len() {
            let (mut own_nt, mut own_nis, mut gated) = (f64::NAN, f64::NAN, false);
            match self.readings[magnetometer] {
                MagnetometerResidual::Missing => self.output.magnetometers[magnetometer].report.missing += 1,
                MagnetometerResidual::OffMap => {
                    off_map = true;
                    self.output.magnetometers[magnetometer].report.off_map += 1;
                }
                MagnetometerResidual::Residual(before_nt, variance_nt2) => {
                    let flat = line.aids.is_flat(variance_nt2, slope_nt_per_m);
                    let (nis, was_used) = self.correct(magnetometer, before_nt, variance_nt2, flat)?;
                    if was_used && used != Some(SampleUsage::Used) {
                        used = Some(if flat { SampleUsage::Flat } else { SampleUsage::Used });
                    }
                    (own_nt, own_nis, gated) = (before_nt, nis, !was_used);
                    (sum, samples) = (sum + nis, samples + 1);
                    residual_nt = if residual_nt.is_nan() { before_nt } else { residual_nt };
                }
            }
            let track = &mut self.output.magnetometers[magnetometer];
            track.residual_nt.push(own_nt);
            track.nis.push(own_nis);
            track.gated.push(gated);
        }
        let innovation = Innovation { residual_nt, nis: if samples > 0 { sum / samples as f64 } else { f64::NAN } };
        let scalar = match (used, samples, off_map) {
            (Some(SampleUsage::Flat), ..) => MeasurementOutcome::Flat(innovation),
            (Some(_), ..) => MeasurementOutcome::Used(innovation),
            (None, 1.., _) => MeasurementOutcome::Gated(innovation),
            (None, 0, true) => MeasurementOutcome::OffMap,
            (None, 0, false) => MeasurementOutcome::Missing,
        };
        Ok(self.further(line, row, scalar, innovation, slope_nt_per_m))
    }

    /// Uses the further measurements of a sample, each linearised at the state directly before it is used. Outputs
    /// their innovations.
    #[inline(always)]
    fn further(
        &mut self,
        line: &LineModel<'_>,
        row: usize,
        scalar: MeasurementOutcome,
        innovation: Innovation,
        slope_nt_per_m: f64,
    ) -> Innovation {
        if !line.aids.is_any() {
            self.output.navigation.report.count(MeasurementOutcome::usage(&[scalar]));
            return innovation;
        }
        let aids = &line.aids;
        let mut sample = SampleInnovations::default();
        let line = &line.with(&[], &[]);
        let difference = match aids.difference_row(&self.of_aids, &mut self.predicted, line, row, &self.x) {
            None => MeasurementOutcome::Missing,
            Some(None) => MeasurementOutcome::OffMap,
            Some(Some(difference)) => self.take(&difference, &mut sample),
        };
        let mut vector = MeasurementOutcome::Missing;
        match aids.vector_rows(&self.of_aids, line, row, &self.x) {
            None => {}
            Some(None) => vector = MeasurementOutcome::OffMap,
            Some(Some(components)) => {
                for component in &components {
                    let outcome = self.take(component, &mut sample);
                    if !matches!(vector, MeasurementOutcome::Used(_)) {
                        vector = outcome;
                    }
                }
            }
        }
        if let Some(height) = aids.height_row(&self.of_aids, line, row) {
            self.take(&height, &mut sample);
        }
        let usage = MeasurementOutcome::usage(&[scalar, difference, vector]);
        self.output.navigation.report.count(usage);
        self.output.usage.push(usage);
        self.output.aids.push(aids, &sample);
        self.output.slope_nt_per_m.push(slope_nt_per_m);
        if innovation.nis.is_nan() { sample.difference } else { innovation }
    }

    /// Processes a further measurement.
    fn take(&mut self, linear: &LinearisedAid, sample: &mut SampleInnovations) -> MeasurementOutcome {
        let AugmentedBuffers { h, gain, rest, .. } = &mut self.scratch;
        let h = &mut h[..self.p.stride()];
        h.fill(0.0);
        linear.sensitivity().add_to(h, 1.0);
        self.p.times(nonzero(h), gain);
        let s = dot(h, gain) + linear.variance;
        let residual_nt = linear.residual(&self.x);
        let innovation = Innovation { residual_nt, nis: residual_nt * residual_nt / s };
        sample.note(linear.of, innovation);
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            return MeasurementOutcome::Gated(innovation);
        }
        self.p.update(s, gain, rest);
        add_scaled(&mut self.x, residual_nt, gain);
        MeasurementOutcome::Used(innovation)
    }

    /// Subtracts map and core field from the residuals, and writes the slopes of the fields to the rows of H. Returns
    /// the horizontal slope in nT/m, if requested.
    #[inline(always)]
    fn predict_field(&mut self, line: &LineModel<'_>, row: usize, measured: bool) -> f64 {
        let (ins, asked) = (line.ins, line.aids.flat_over_m.is_some());
        if !measured && !asked {
            return f64::NAN;
        }
        let error = [LAT, LON, ALT].map(|state| self.x[state]);
        let field = self.predicted.at_error(ins, row, error);
        let mut remainder_nt2 = 0.0;
        if let Some(at) = &field {
            let covariance = [[LAT, LAT], [LAT, LON], [LON, LON]].map(|[row, column]| self.p.at(row, column));
            remainder_nt2 = self.predicted.curvature_nt2(ins, row, error, at.value_nt, covariance);
        }
        let rows = self.scratch.h.chunks_exact_mut(self.p.stride());
        for (reading, h) in self.readings.iter_mut().zip(rows) {
            let MagnetometerResidual::Residual(nt, variance_nt2) = *reading else { continue };
            let Some(FieldValue { value_nt, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m }) = field else {
                *reading = MagnetometerResidual::OffMap;
                continue;
            };
            (h[LAT], h[LON], h[ALT]) = (d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m);
            *reading = MagnetometerResidual::Residual(nt - value_nt, variance_nt2 + remainder_nt2);
        }
        field.filter(|_| asked).map_or(f64::NAN, |at| line.with(&[], &[]).slope_nt_per_m(row, &at))
    }

    /// Residual of a magnetometer without map and core field, and the row of H without the slope of map and core field,
    /// at the state before the sample.
    #[inline(always)]
    fn linearise(&mut self, magnetometer: usize, row: usize, reading: Reading) -> MagnetometerResidual {
        let stride = self.p.stride();
        let h = &mut self.scratch.h[magnetometer * stride..][..stride];
        h.fill(0.0);
        let (c, d_c) = (&self.x[STATES..][..self.own], &mut h[STATES..][..self.own]);
        let offset_nt = self.output.magnetometers[magnetometer].report.offset_nt;
        let Some((nt, variance_nt2)) = usable(reading, offset_nt) else {
            return MagnetometerResidual::Missing;
        };
        let aircraft_nt = match self.model.linearised(magnetometer, row, c, d_c) {
            Some(nt) if nt.is_finite() && d_c.iter().all(|h| h.is_finite()) => nt,
            _ => return MagnetometerResidual::Missing,
        };
        h[S] = 1.0;
        let mut expected_nt = self.x[S] + aircraft_nt;
        if let Some(state) = self.of_aids.map_error {
            h[state] = 1.0;
            expected_nt += self.x[state];
        }
        MagnetometerResidual::Residual(nt - expected_nt, variance_nt2)
    }

    /// Processes a measurement. Returns the NIS of the measurement, and whether it passed the gate.
    #[inline(always)]
    fn correct(
        &mut self,
        magnetometer: usize,
        before_nt: f64,
        variance_nt2: f64,
        flat: bool,
    ) -> Result<(f64, bool), NavigationError> {
        let stride = self.p.stride();
        let AugmentedBuffers { h, gain, rest, before, .. } = &mut self.scratch;
        let h = &h[magnetometer * stride..][..stride];
        self.p.times(nonzero(h), gain);
        let predicted_nt2 = dot(h, gain);
        if predicted_nt2 > WIDEST * variance_nt2 {
            let what = format!(
                "the prior standard deviation of the aircraft field, {:.1e} nT, is too large for a noise of {:.1e} nT",
                predicted_nt2.sqrt(),
                variance_nt2.sqrt()
            );
            return Err(refused("prior", what).into());
        }
        // Change of this magnetometer's prediction by the updates with the previous magnetometers, to first order.
        let moved_nt: f64 = h.iter().zip(&self.x).zip(&*before).map(|((h, x), before)| h * (x - before)).sum();
        let residual_nt = if magnetometer == 0 { before_nt } else { before_nt - moved_nt };
        let s = predicted_nt2 + variance_nt2;
        let nis = residual_nt * residual_nt / s;
        let report = &mut self.output.magnetometers[magnetometer].report;
        if self.parameters.gate_nis.is_some_and(|gate| nis > gate) {
            let rejected = &mut self.rejected[magnetometer];
            *rejected += 1;
            if self.parameters.recover_after.is_none_or(|most| *rejected <= most) {
                report.gated += 1;
                return Ok((nis, false));
            }
        }
        self.rejected[magnetometer] = 0;
        report.updates += 1;
        if flat {
            let (own, map_error) = (STATES..STATES + self.own, self.of_aids.map_error);
            let corrects = |state: usize| state == S || own.contains(&state) || map_error == Some(state);
            self.p.consider(s, gain, rest, corrects);
        } else {
            self.p.update(s, gain, rest);
        }
        add_scaled(&mut self.x, residual_nt, gain);
        Ok((nis, true))
    }

    /// Outputs the state after a sample.
    #[inline(always)]
    fn store(&mut self, line: &LineModel<'_>, row: usize, innovation: Innovation) -> Result<(), NavigationError> {
        let LineModel { ins, errors, .. } = line;
        let sum: f64 = self.x.iter().sum();
        if !(sum.is_finite() && self.p.is_sound()) {
            return Err(NavigationError::Diverged { row, tt_s: ins.tt_s[row] });
        }
        let (x, p) = (&self.x, &self.p);
        self.output.navigation.push(ins, row, |state| x[state], |a, b| p.at(a, b), innovation, errors.earth);
        for (magnetometer, track) in self.output.magnetometers.iter_mut().enumerate() {
            let aircraft_nt = self.model.value(magnetometer, row, &x[STATES..][..self.own]);
            track.aircraft_nt.push(aircraft_nt.filter(|nt| nt.is_finite()).unwrap_or(f64::NAN));
        }
        if self.parameters.keep_coefficients {
            let states = STATES..STATES + self.own;
            self.output.c_by_row.extend(&x[states.clone()]);
            self.output.c_sigma_by_row.extend(states.map(|state| p.at(state, state).sqrt()));
        }
        Ok(())
    }

    /// Visits the state between two samples.
    pub(super) fn visit(&mut self, state: &mut dyn StateVisitor) {
        state.numbers(&mut self.x);
        self.p.rows_mut().for_each(|row| state.numbers(row));
        state.point(&mut self.predicted);
        state.report(&mut self.output.navigation.report);
        for (track, rejected) in self.output.magnetometers.iter_mut().zip(&mut self.rejected) {
            let MagnetometerReport { updates, missing, off_map, gated, .. } = &mut track.report;
            state.counts(&mut [updates, missing, off_map, gated, rejected]);
        }
    }

    fn finish(mut self) -> AugmentedOutput {
        self.output.c = self.x[STATES..][..self.own].to_vec();
        let (all, count) = (self.p.block_from(STATES), self.states.mean.len());
        let rows = all.chunks_exact(count.max(1)).take(self.own);
        self.output.c_covariance = rows.flat_map(|row| &row[..self.own]).copied().collect();
        self.output
    }
}
