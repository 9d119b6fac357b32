//! Recursion of the filter along a line.

use crate::navigation::aided::filter::MeasurementOutcome;
use crate::navigation::aids::{Aid, AidStates, Aids, SampleInnovations, SampleUsage};
use crate::navigation::gaussian::StateLayout;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{LAT, LON, STATES};

use super::UNEXPLAINED_NIS;
use super::cloud::{ParticleCloud, SparseTransition};
use super::count::ParticleCount;
use super::covariance::{GaussMarkovStep, ParticleMatrix, condition_on_position, measure, predict, times};
use super::draws::{DrawPurpose, ParticleDraws};
use super::hand_over::{HandOver, HandOverEstimate, HandOverTest};
use super::look::ParticleFields;
use super::measurement::{CloudMeasurement, CloudPrediction, CloudResidual};
use super::modes::ModeClusters;
use super::output::{MpfOutput, modes_of};
use super::parameters::MpfParameters;
use super::resampling::{ParticleResampler, ParticleResampling};

/// Smallest fraction of effective particles after a measurement; below this fraction the measurement is split.
pub(super) const LEAST_LEFT: f64 = 0.1;
/// Smallest fraction of the remaining information of a measurement that is used in one part.
const LEAST_PART: f64 = 1.0 / 256.0;
/// Maximum number of parts of a measurement.
pub(super) const MOST_PARTS: usize = 64;

/// Source of a correction of the particles at a sample. Each source has separate resamplings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CorrectionSource {
    Scalar,
    Fixes,
    Further(Aid),
}

impl CorrectionSource {
    fn place(self) -> usize {
        match self {
            Self::Scalar => 0,
            Self::Fixes => 1,
            Self::Further(aid) => 2 + aid.place(),
        }
    }
}

/// Marginalised particle filter of `N` states along a line.
pub(super) struct MarginalisedParticleFilter<'a, const N: usize> {
    pub(super) line: &'a NavigationLine<'a>,
    pub(super) parameters: &'a MpfParameters,
    pub(super) cloud: ParticleCloud<N>,
    /// Covariance of the linear states given a particle's position, common to all particles.
    pub(super) p: ParticleMatrix<N>,
    aids: &'a Aids<'a>,
    /// Further states, after the 18.
    pub(super) layout: StateLayout,
    look: ParticleFields<'a>,
    predictor: CloudPrediction,
    resampler: ParticleResampler<N>,
    pub(super) clusters: ModeClusters,
    output: MpfOutput,
    /// Current numbers of consecutive unexplained and collapsed samples.
    in_a_row: [usize; 2],
}

/// Results of a sample.
struct MpfSampleResult {
    innovation: Innovation,
    usage: SampleUsage,
}

impl<'a, const N: usize> MarginalisedParticleFilter<'a, N> {
    /// Particles at the first sample, before its measurement.
    pub(super) fn new(
        line: &'a NavigationLine<'a>,
        aids: &'a Aids<'a>,
        states: AidStates,
        parameters: &'a MpfParameters,
    ) -> Self {
        let ins = line.ins;
        let of_ins = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let mut layout = StateLayout::default();
        states.extend(&mut layout);
        let mut p = [[0.0; N]; N];
        for (row, of_ins) in p.iter_mut().zip(&of_ins) {
            row[..STATES].copy_from_slice(of_ins);
        }
        for (state, error) in (STATES..).zip(&layout.errors) {
            p[state][state] = error.sigma * error.sigma;
        }
        // Each particle holds a horizontal position, with the expected values of the other states.
        let spread = condition_on_position(&mut p);
        let draws = ParticleDraws::new(parameters.seed, DrawPurpose::Start, 0);
        let particles = ParticleCount::new(parameters).map_or(parameters.particles, |count| {
            let (north, east) = line.errors.earth.north_east_m_per_rad(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
            count.of_start([north, east], [spread[LAT], spread[LON]], draws)
        });
        let cloud = ParticleCloud::new(particles, &spread, draws);
        let (offset_nt, samples) = line.predicted().offset(ins, line.measurement_nt, line.offset_window_s);
        let track = NavigationOutput::with_capacity(ins.len(), parameters.keep_states, parameters.keep_covariance);
        let mut output = MpfOutput { track, ..MpfOutput::default() };
        output.track.report.offset_nt = offset_nt;
        output.track.report.offset_samples = samples;
        output.report.least_effective = particles as f64;
        let blocks = cloud.blocks.len();
        Self {
            line,
            parameters,
            cloud,
            p,
            aids,
            layout,
            look: ParticleFields::new(line, aids, states, offset_nt, blocks),
            predictor: CloudPrediction::new(blocks),
            resampler: ParticleResampler::default(),
            clusters: ModeClusters::default(),
            output,
            in_a_row: [0; 2],
        }
    }

    /// Filters the line, or its start until a Gaussian replaces the particles.
    pub(super) fn run(
        mut self,
        hand_over: Option<&HandOver>,
    ) -> Result<(MpfOutput, Option<HandOverEstimate>), NavigationError> {
        let mut test = hand_over.map(|conditions| HandOverTest::new(self.line, *conditions));
        for row in 0..self.line.ins.len() {
            if row > 0 {
                self.propagate(row);
            }
            self.aid(row);
            let sample = self.measure(row);
            self.report(row, &sample)?;
            if let Some(estimate) = test.as_mut().and_then(|test| test.estimate(&mut self, row)) {
                return Ok((self.output, Some(estimate)));
            }
            self.resample_where_few(CorrectionSource::Scalar, row, 0);
        }
        Ok((self.output, None))
    }

    fn propagate(&mut self, row: usize) {
        let step = self.line.step(row);
        let lasting = |place: usize| {
            let error = self.layout.error_at(place, step.speed_mps);
            GaussMarkovStep { decay: error.decay(step.dt_s), variance: error.step_variance(step.dt_s) }
        };
        let further: Vec<GaussMarkovStep> = (0..self.layout.errors.len()).map(lasting).collect();
        let spread = predict(&mut self.p, &step, &further);
        let draws = ParticleDraws::new(self.parameters.seed, DrawPurpose::Motion, row);
        self.cloud.propagate(&SparseTransition::new(&step.phi, &further), &spread, draws);
    }

    /// Corrects weights, linear states and their covariance with the usable measurements of a row.
    fn measure(&mut self, row: usize) -> MpfSampleResult {
        let mut unexplained = false;
        let scalar = self.take(CorrectionSource::Scalar, row, &mut unexplained);
        let mut further = SampleInnovations::default();
        let mut outcomes = vec![scalar];
        for aid in Aid::ALL.into_iter().filter(|aid| self.aids.has(*aid)) {
            let outcome = self.take(CorrectionSource::Further(aid), row, &mut unexplained);
            if !outcome.innovation().nis.is_nan() {
                further.note(aid, outcome.innovation());
            }
            // The outcome of a height carries no information about the map.
            if aid != Aid::Height {
                outcomes.push(outcome);
            }
        }
        self.output.aids.push(self.aids, &further);
        let usage = MeasurementOutcome::usage(&outcomes);
        self.output.track.report.count(usage);
        self.output.usage.push(usage);
        if outcomes.iter().any(|outcome| !outcome.innovation().nis.is_nan()) {
            let report = &mut self.output.report;
            count(unexplained, &mut report.unexplained, &mut self.in_a_row[0], &mut report.unexplained_in_a_row);
        }
        let of_scalar = scalar.innovation();
        let innovation = if of_scalar.nis.is_nan() { further.difference } else { of_scalar };
        MpfSampleResult { innovation, usage }
    }

    /// Corrects with one measurement of a row.
    fn take(&mut self, turn: CorrectionSource, row: usize, unexplained: &mut bool) -> MeasurementOutcome {
        let Some((value, variance)) = self.look.measured(turn, row) else { return MeasurementOutcome::Missing };
        if turn != CorrectionSource::Scalar {
            self.resample_where_few(turn, row, 0);
        }
        let mut measured = CloudMeasurement { value, variance, common: vec![] };
        let Some(fit) = self.fit(turn, row, &mut measured) else { return MeasurementOutcome::OffMap };
        let residual_nt = fit.residual_nt;
        let innovation = Innovation { residual_nt, nis: residual_nt * residual_nt / fit.variance_nt2 };
        let by_none = fit.best > UNEXPLAINED_NIS;
        *unexplained |= by_none && turn != CorrectionSource::Further(Aid::Height);
        if by_none || self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            return MeasurementOutcome::Gated(innovation);
        }
        self.update(turn, row, measured, fit.on_map);
        MeasurementOutcome::Used(innovation)
    }

    /// Predicts a measurement at every particle.
    fn fit(&mut self, turn: CorrectionSource, row: usize, measured: &mut CloudMeasurement) -> Option<CloudResidual> {
        let middle = self.cloud.mean();
        measured.common = self.look.at(turn, row, &self.cloud, &middle, &mut self.predictor)?;
        self.predictor.fit_of(&self.cloud, &self.p, measured)
    }

    /// Corrects with a predicted measurement in one step. If too few particles would remain effective, splits it into
    /// several measurements whose inverse variances add up to the original inverse variance, with a resampling after
    /// each except the last.
    fn update(&mut self, turn: CorrectionSource, row: usize, mut whole: CloudMeasurement, mut on_map: f64) {
        let mut left = 1.0_f64;
        for part_of_row in 1.. {
            let enough = LEAST_LEFT * self.cloud.particles as f64;
            let mut part = left;
            while self.predictor.weigh(&self.cloud, on_map) < enough
                && part > left * LEAST_PART
                && self.parameters.regularise
                && part_of_row < MOST_PARTS
            {
                part *= 0.5;
                self.predictor.compare_all(&self.cloud, &self.p, &whole.part(part));
            }
            let information = self.predictor.accept(&mut self.cloud);
            let of_common = times(&self.p, &whole.common);
            self.cloud.correct(&self.p, &of_common, &self.predictor.slopes, &self.predictor.residuals);
            measure(&mut self.p, &whole.common, information);
            left -= part;
            if left <= 0.0 {
                break;
            }
            self.resample(turn, row, part_of_row);
            let mut rest = whole.part(left);
            let Some(fit) = self.fit(turn, row, &mut rest) else { break };
            (on_map, whole.common) = (fit.on_map, rest.common);
        }
    }

    /// Appends the row to the output.
    fn report(&mut self, row: usize, sample: &MpfSampleResult) -> Result<(), NavigationError> {
        let Self { line, cloud, p, output, .. } = self;
        let mean = cloud.mean();
        let [a, b, c] = cloud.position_covariance(&mean);
        let fine = |x: f64| x.is_finite() && x >= 0.0;
        if !(mean.iter().all(|x| x.is_finite()) && fine(a) && fine(c) && (0..N).all(|k| fine(p[k][k]))) {
            return Err(NavigationError::Diverged { row, tt_s: line.ins.tt_s[row] });
        }
        let effective = cloud.effective();
        output.effective.push(effective);
        output.particles.push(cloud.particles);
        let report = &mut output.report;
        report.least_effective = report.least_effective.min(effective);
        if sample.usage == SampleUsage::Used {
            let collapsed = effective < 2.0 && cloud.particles > 2;
            count(collapsed, &mut report.collapsed, &mut self.in_a_row[1], &mut report.collapsed_in_a_row);
        }
        let (ins, earth, innovation) = (line.ins, line.errors.earth, sample.innovation);
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

    /// Resamples at a row. `turn` and `part` identify the draws, which are unique within the line.
    pub(super) fn resample(&mut self, turn: CorrectionSource, row: usize, part: usize) {
        let number = (turn.place() * self.line.ins.len() + row) * MOST_PARTS + part;
        let MpfParameters { seed, regularise, roughening, smooth_over_m, .. } = *self.parameters;
        let lat_rad = self.line.ins.lat_deg[row].to_radians();
        let (north, east) = self.line.errors.earth.north_east_m_per_rad(lat_rad, self.line.ins.alt_m[row]);
        let (m_per_rad, count) = ([north, east], ParticleCount::new(self.parameters));
        let how = ParticleResampling { seed, regularise, roughening, smooth_over_m, m_per_rad, count };
        self.resampler.resample(how, number, &mut self.cloud, &mut self.p);
        let blocks = self.cloud.blocks.len();
        self.look.resize(blocks);
        self.predictor.resize(blocks);
        self.output.report.resamplings += 1;
    }

    /// Resamples if the effective number of particles is below the threshold.
    pub(super) fn resample_where_few(&mut self, turn: CorrectionSource, row: usize, part: usize) {
        if self.cloud.effective() < self.parameters.resample_threshold * self.cloud.particles as f64 {
            self.resample(turn, row, part);
        }
    }
}

/// Counts an event, and updates the length of its longest run.
fn count(happens: bool, all: &mut usize, in_a_row: &mut usize, most: &mut usize) {
    if happens {
        *all += 1;
        *in_a_row += 1;
        *most = (*most).max(*in_a_row);
    } else {
        *in_a_row = 0;
    }
}

fn add<const N: usize>(to: &mut ParticleMatrix<N>, from: &ParticleMatrix<N>) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += from;
    }
}
