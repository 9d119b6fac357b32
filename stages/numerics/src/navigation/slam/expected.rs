//! Prediction of the measurement of each particle from the earlier measurements along its own path.

use rayon::prelude::*;

use super::history::{AncestorDisplacements, ParticleHistory};
use super::index::SlamSampleIndex;
use super::kernel::{AnomalyKernel, BorderedCovariance, KrigingPrediction, MOST_NEIGHBOURS};
use super::parameters::{ExpectedMeasurement, SlamParameters};
use super::particles::PIECE;
use super::samples::SlamSample;

/// Maximum number of samples of a cell that are used.
const MOST_IN_CELL: usize = 4;
/// Maximum number of candidates. If there are more, every second, third, … is used.
const MOST_CANDIDATES: usize = 512;
/// Number of particles from which the spread for the selection of candidates is estimated.
const SCOUTS: usize = 64;
/// A sample counts as an earlier sample after this distance has been flown, in radii. The value also suffices for
/// particles that fly at half the speed.
const RADII_FLOWN: f64 = 2.5;
/// A sample is a candidate if it is within the radius of a position that is at most this number of standard deviations
/// from the mean of the particles.
const SPREADS: f64 = 3.0;

/// Rules of the expected measurement, with all defaults resolved.
#[derive(Clone, Copy, Debug)]
pub struct PredictionRules {
    /// Method.
    pub method: ExpectedMeasurement,
    /// Process of the anomaly.
    pub kernel: AnomalyKernel,
    /// Standard deviation of the temporal variation, in nT, and its correlation time, in seconds.
    pub temporal: (f64, f64),
    /// Maximum number of earlier samples in one prediction.
    pub neighbours: usize,
    /// Number of most recent samples used in addition; 0 except for nearest neighbours.
    pub recent: usize,
    /// Smallest age of earlier samples, in seconds.
    pub ignore_s: f64,
    /// Radius, in metres, within which more than `trigger_points` samples count as a revisit.
    pub trigger_m: f64,
    /// A revisit requires more than this number of samples within `trigger_m`.
    pub trigger_points: usize,
    /// Radius, in metres, within which samples are used for a prediction.
    pub radius_m: f64,
    /// Size of the cells of the index, in metres.
    pub cell_m: f64,
    /// Largest difference in height, in metres.
    pub height_m: f64,
    /// Standard deviation of an inverse-distance-weighted prediction, in nT.
    pub interpolant_sigma_nt: f64,
}

impl PredictionRules {
    /// Rules derived from the parameters for the distance between samples, in metres, and the speed, in m/s.
    ///
    /// A straight line has no revisits: a sample counts as an earlier sample only after a flight of two and a half
    /// radii.
    pub fn new(
        parameters: &SlamParameters,
        kernel: AnomalyKernel,
        temporal: (f64, f64),
        spacing_m: f64,
        speed_mps: f64,
    ) -> Self {
        let near = parameters.expected == ExpectedMeasurement::NearestNeighbour;
        let trigger_m = parameters.trigger_radius_m.unwrap_or((1.6 * spacing_m).max(18.0));
        let nearer = if speed_mps > 0.0 { speed_mps * parameters.ignore_s / RADII_FLOWN } else { f64::INFINITY };
        let radius_m = parameters.interpolation_radius_m.unwrap_or((0.5 * kernel.length_m).min(nearer.max(trigger_m)));
        let (trigger_m, trigger_points) = if near { (radius_m, 0) } else { (trigger_m, parameters.trigger_points) };
        Self {
            method: parameters.expected,
            kernel,
            temporal,
            neighbours: parameters.neighbours,
            recent: if near { parameters.recent } else { 0 },
            ignore_s: if speed_mps > 0.0 {
                parameters.ignore_s.max(RADII_FLOWN * radius_m / speed_mps)
            } else {
                parameters.ignore_s
            },
            trigger_m,
            trigger_points,
            radius_m: radius_m.max(trigger_m),
            // A cell has two samples per pass, or is so large that about a hundred cells are within the radius.
            cell_m: (2.0 * spacing_m).max(radius_m / 6.0),
            height_m: parameters.max_height_difference_m,
            interpolant_sigma_nt: parameters.interpolant_sigma_nt,
        }
    }

    /// Noise of an earlier sample at another height, in nT².
    fn noise_nt2(&self, sample: &SlamSample, alt_m: f64) -> f64 {
        let white = sample.variance_nt2 + self.kernel.sigma_n_nt.powi(2);
        white + self.kernel.height_nt2(sample.alt_m - alt_m)
    }
}

/// Earlier sample, prepared for one measurement.
#[derive(Clone, Copy, Debug)]
struct EarlierSample<'a> {
    then: AncestorDisplacements<'a>,
    /// INS position of the earlier sample minus the present INS position, in metres.
    from_m: [f64; 2],
    tt_s: f64,
    value_nt: f64,
    noise_nt2: f64,
    core_nt_per_m: [f64; 2],
}

impl EarlierSample<'_> {
    /// Position relative to a particle whose displacement is `now_m`, in metres.
    #[inline(always)]
    fn from(&self, particle: usize, now_m: [f64; 2]) -> [f64; 2] {
        let then_m = self.then.displacement(particle);
        [0, 1].map(|axis| self.from_m[axis] + then_m[axis] - now_m[axis])
    }

    /// Anomaly at a particle's position at that time, in nT.
    #[inline(always)]
    fn anomaly_nt(&self, particle: usize) -> f64 {
        let then_m = self.then.displacement(particle);
        self.value_nt - self.core_nt_per_m[0] * then_m[0] - self.core_nt_per_m[1] * then_m[1]
    }
}

/// Prediction of a particle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParticlePrediction {
    /// Measurement minus expected value, in nT.
    pub residual_nt: f64,
    /// Variance of the residual, with the noise of the measurement, in nT².
    pub variance_nt2: f64,
    /// Whether the particle revisits.
    pub revisits: bool,
}

impl ParticlePrediction {
    /// No prediction.
    pub const NONE: Self = Self { residual_nt: f64::NAN, variance_nt2: f64::NAN, revisits: false };

    /// Logarithm of the likelihood, up to a constant.
    pub fn log_likelihood(&self) -> f64 {
        -0.5 * (self.residual_nt * self.residual_nt / self.variance_nt2 + self.variance_nt2.ln())
    }
}

/// Samples of a flight with the paths of the particles: the map of every particle.
#[derive(Clone, Debug)]
pub struct ParticleMap {
    rules: PredictionRules,
    /// Samples.
    pub samples: Vec<SlamSample>,
    /// Displacements of the particles at each sample, in metres.
    pub history: ParticleHistory,
    index: SlamSampleIndex,
    /// First sample that is too recent for the index.
    pending: usize,
    /// Largest spread of the particles over all indexed samples, in metres.
    spread_m: f64,
    found: Vec<u32>,
}

/// Mean displacement of some particles and their root-mean-square spread, in metres.
fn spread(count: usize, of: impl Fn(usize) -> [f64; 2]) -> ([f64; 2], f64) {
    let scouts = || (0..count).step_by(count.div_ceil(SCOUTS).max(1));
    let share = 1.0 / scouts().count() as f64;
    let mut mean = [0.0; 2];
    for [north, east] in scouts().map(&of) {
        mean[0] += share * north;
        mean[1] += share * east;
    }
    let squares = scouts().map(&of).map(|[north, east]| (north - mean[0]).powi(2) + (east - mean[1]).powi(2));
    (mean, (share * squares.sum::<f64>()).sqrt())
}

impl ParticleMap {
    /// Empty map.
    pub fn new(rules: PredictionRules, particles: usize) -> Self {
        let index = SlamSampleIndex::new(rules.cell_m, MOST_IN_CELL);
        Self {
            rules,
            samples: vec![],
            history: ParticleHistory::new(particles),
            index,
            pending: 0,
            spread_m: 0.0,
            found: vec![],
        }
    }

    /// Appends a sample with the displacement of each particle, in metres.
    pub fn push(&mut self, sample: SlamSample, now_m: &[[f64; 2]]) {
        self.samples.push(sample);
        self.history.push(now_m.iter().map(|now_m| now_m.map(|metres| metres as f32)));
    }

    /// Moves samples that are old enough into the index, at the positions of the present particles.
    fn age(&mut self, tt_s: f64, particles: usize) {
        while let Some(sample) = self.samples.get(self.pending)
            && tt_s - sample.tt_s > self.rules.ignore_s
        {
            if let Some(then) = self.history.at(self.pending) {
                let (mean, spread_m) = spread(particles, |particle| then.displacement(particle));
                self.spread_m = self.spread_m.max(spread_m);
                self.index.insert(self.pending as u32, [0, 1].map(|axis| sample.at_m[axis] + mean[axis]));
            }
            self.pending += 1;
        }
    }

    /// Earlier samples near the sample of the last prediction.
    pub fn found(&self) -> &[u32] {
        &self.found
    }

    fn candidate(&self, sample: usize, now: &SlamSample) -> Option<EarlierSample<'_>> {
        let (then, old) = (self.history.at(sample)?, self.samples.get(sample)?);
        ((old.alt_m - now.alt_m).abs() <= self.rules.height_m).then(|| EarlierSample {
            then,
            from_m: [0, 1].map(|axis| old.at_m[axis] - now.at_m[axis]),
            tt_s: old.tt_s,
            value_nt: old.value_nt,
            noise_nt2: self.rules.noise_nt2(old, now.alt_m),
            core_nt_per_m: old.core_nt_per_m,
        })
    }

    /// Earlier samples that may be near any of the particles.
    fn candidates(&self, now: &SlamSample, now_m: &[[f64; 2]]) -> Vec<EarlierSample<'_>> {
        let mut out = vec![];
        for candidate in self.found.iter().filter_map(|sample| self.candidate(*sample as usize, now)) {
            let (mean, spread_m) = spread(now_m.len(), |particle| candidate.from(particle, now_m[particle]));
            if mean[0].hypot(mean[1]) <= self.rules.radius_m + SPREADS * spread_m {
                out.push(candidate);
            }
        }
        let stride = out.len().div_ceil(MOST_CANDIDATES).max(1);
        out.into_iter().step_by(stride).collect()
    }

    /// Prediction of each particle for a sample, given the present displacement of the particle, in metres; `None` if
    /// no particle revisits.
    pub fn predict(&mut self, now: &SlamSample, now_m: &[[f64; 2]]) -> Option<Vec<ParticlePrediction>> {
        self.age(now.tt_s, now_m.len());
        let (mean, spread_m) = spread(now_m.len(), |particle| now_m[particle]);
        self.found.clear();
        let mut found = std::mem::take(&mut self.found);
        let radius_m = self.rules.radius_m + SPREADS * (spread_m + self.spread_m);
        self.index.within([0, 1].map(|axis| now.at_m[axis] + mean[axis]), radius_m, &mut found);
        self.found = found;
        let old = self.candidates(now, now_m);
        if old.is_empty() {
            return None;
        }
        let first = self.samples.len().saturating_sub(self.rules.recent).max(self.pending);
        let recent: Vec<_> = (first..self.samples.len()).filter_map(|sample| self.candidate(sample, now)).collect();
        let mut out = vec![ParticlePrediction::NONE; now_m.len()];
        out.par_chunks_mut(PIECE).enumerate().for_each(|(piece, predictions)| {
            for (place, prediction) in predictions.iter_mut().enumerate() {
                let particle = piece * PIECE + place;
                let view = ParticleView { rules: &self.rules, now, particle, now_m: now_m[particle] };
                *prediction = view.predict(&old, &recent);
            }
        });
        out.iter().any(|prediction| prediction.revisits).then_some(out)
    }
}

/// Present sample, as seen from the position of one particle.
struct ParticleView<'a> {
    rules: &'a PredictionRules,
    now: &'a SlamSample,
    particle: usize,
    now_m: [f64; 2],
}

/// Samples of a prediction: squared distance (m²), position (m), index among the candidates.
struct NeighbourSet {
    members: [(f64, [f64; 2], u32); MOST_NEIGHBOURS],
    count: usize,
}

impl ParticleView<'_> {
    /// Nearest candidates within the radius, and the number of candidates within the trigger radius.
    fn nearest(&self, old: &[EarlierSample<'_>]) -> (NeighbourSet, usize) {
        let mut chosen = NeighbourSet { members: [(0.0, [0.0; 2], 0); MOST_NEIGHBOURS], count: 0 };
        let (mut reach, trigger) = (self.rules.radius_m.powi(2), self.rules.trigger_m.powi(2));
        let mut within = 0;
        for (place, candidate) in old.iter().enumerate() {
            let at_m = candidate.from(self.particle, self.now_m);
            let distance2 = at_m[0] * at_m[0] + at_m[1] * at_m[1];
            within += usize::from(distance2 <= trigger);
            if distance2 <= reach {
                chosen.insert((distance2, at_m, place as u32), self.rules.neighbours);
                if chosen.count == self.rules.neighbours {
                    reach = chosen.members[chosen.count - 1].0;
                }
            }
        }
        (chosen, within)
    }

    fn predict(&self, old: &[EarlierSample<'_>], recent: &[EarlierSample<'_>]) -> ParticlePrediction {
        let (chosen, within) = self.nearest(old);
        let revisits = within > self.rules.trigger_points && chosen.count > 0;
        let expected = match self.rules.method {
            ExpectedMeasurement::NearestNeighbour => self.conditioned(&chosen, old, recent),
            ExpectedMeasurement::Regression if revisits => self.regression(&chosen, old),
            ExpectedMeasurement::InverseDistance if revisits => Some(self.interpolated(&chosen, old)),
            ExpectedMeasurement::Regression | ExpectedMeasurement::InverseDistance => None,
        };
        let Some(KrigingPrediction { value_nt, variance_nt2 }) = expected else { return ParticlePrediction::NONE };
        let slope = self.now.core_nt_per_m;
        let measured_nt = self.now.value_nt - slope[0] * self.now_m[0] - slope[1] * self.now_m[1];
        let white = self.now.variance_nt2 + self.rules.kernel.sigma_n_nt.powi(2);
        ParticlePrediction { residual_nt: measured_nt - value_nt, variance_nt2: variance_nt2 + white, revisits }
    }

    /// Field at the particle, given samples with their positions, times, values and noise.
    fn field(&self, samples: &[ParticleSample], temporal: (f64, f64), mean_nt2: f64) -> Option<KrigingPrediction> {
        let kernel = &self.rules.kernel;
        let n = samples.len();
        let centre = samples.iter().map(|sample| sample.value_nt).sum::<f64>() / n.max(1) as f64;
        let here = ParticleSample { at_m: [0.0; 2], tt_s: self.now.tt_s, value_nt: 0.0, noise_nt2: 0.0 };
        let (sigma_nt, tau_s) = temporal;
        let power = sigma_nt * sigma_nt;
        let of = |place: usize| samples.get(place).unwrap_or(&here);
        let covariance = |row: usize, column: usize| {
            let (a, b) = (of(row), of(column));
            let (north, east) = (a.at_m[0] - b.at_m[0], a.at_m[1] - b.at_m[1]);
            let mut sum = kernel.anomaly_nt2(north * north + east * east) + mean_nt2;
            if power > 0.0 {
                sum += power * (-(a.tt_s - b.tt_s).abs() / tau_s).exp();
            }
            if row == column { sum + a.noise_nt2 } else { sum }
        };
        let mut system = BorderedCovariance::new(n);
        system.fill(covariance, |place| of(place).value_nt - centre);
        let KrigingPrediction { value_nt, variance_nt2 } = system.solve()?;
        Some(KrigingPrediction { value_nt: value_nt + centre, variance_nt2 })
    }

    fn sighting(&self, candidate: &EarlierSample<'_>, at_m: [f64; 2]) -> ParticleSample {
        let value_nt = candidate.anomaly_nt(self.particle);
        ParticleSample { at_m, tt_s: candidate.tt_s, value_nt, noise_nt2: candidate.noise_nt2 }
    }

    /// Prediction from the nearest and the most recent samples; the prior is the process with an unknown mean.
    fn conditioned(
        &self,
        chosen: &NeighbourSet,
        old: &[EarlierSample<'_>],
        recent: &[EarlierSample<'_>],
    ) -> Option<KrigingPrediction> {
        let mut samples = [ParticleSample::default(); MOST_NEIGHBOURS];
        let mut count = 0;
        let earlier = chosen.iter().map(|(_, at_m, place)| (&old[*place as usize], *at_m));
        let last = recent.iter().map(|candidate| (candidate, candidate.from(self.particle, self.now_m)));
        for ((candidate, at_m), sample) in earlier.chain(last).zip(&mut samples) {
            *sample = self.sighting(candidate, at_m);
            count += 1;
        }
        self.field(&samples[..count], self.rules.temporal, self.rules.kernel.mean_nt2())
    }

    /// Prediction from the earlier samples within the radius, with their mean as the prior mean. [Lee 2019, (85)]
    fn regression(&self, chosen: &NeighbourSet, old: &[EarlierSample<'_>]) -> Option<KrigingPrediction> {
        let mut samples = [ParticleSample::default(); MOST_NEIGHBOURS];
        for ((_, at_m, place), sample) in chosen.iter().zip(&mut samples) {
            *sample = self.sighting(&old[*place as usize], *at_m);
        }
        self.field(&samples[..chosen.count], (0.0, 1.0), 0.0)
    }

    /// Prediction weighted by the inverse squared distance; at the position of a sample, the value of this sample.
    fn interpolated(&self, chosen: &NeighbourSet, old: &[EarlierSample<'_>]) -> KrigingPrediction {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (distance2, _, place) in chosen.iter() {
            // Samples within one centimetre count as coincident.
            let weight = 1.0 / distance2.max(1e-4);
            sum += weight * old[*place as usize].anomaly_nt(self.particle);
            weights += weight;
        }
        KrigingPrediction { value_nt: sum / weights, variance_nt2: self.rules.interpolant_sigma_nt.powi(2) }
    }
}

/// Earlier sample, with its position on the path of one particle.
#[derive(Clone, Copy, Debug, Default)]
struct ParticleSample {
    at_m: [f64; 2],
    tt_s: f64,
    value_nt: f64,
    noise_nt2: f64,
}

impl NeighbourSet {
    fn iter(&self) -> impl Iterator<Item = &(f64, [f64; 2], u32)> {
        self.members[..self.count].iter()
    }

    /// Inserts a member in the order of distance, and keeps the `most` nearest members.
    #[inline(always)]
    fn insert(&mut self, member: (f64, [f64; 2], u32), most: usize) {
        let mut place = self.count.min(most - 1);
        if self.count < most {
            self.count += 1;
        } else if self.members[place].0 <= member.0 {
            return;
        }
        while place > 0 && self.members[place - 1].0 > member.0 {
            self.members[place] = self.members[place - 1];
            place -= 1;
        }
        self.members[place] = member;
    }
}
