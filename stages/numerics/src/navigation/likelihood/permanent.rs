//! Search for a change of the permanent field of the aircraft.

use super::{
    AidedParameters, Aids, GATE_NIS, NavigationError, NoiseLikelihood, NoisePoint, PERMANENT, PermanentChange, aided,
    has_permanent,
};
use crate::navigation::aided::AidedOutput;
use crate::signal::gauss_markov::GaussMarkov;

/// Smallest increase of the logarithm of the likelihood for which the permanent field becomes a state. With two
/// parameters that have no influence, an increase of 4 has a probability below 2 %.
const LEAST_GAIN: f64 = 4.0;

/// Time constant from which the search starts, in seconds.
pub(super) const USUAL_TAU_S: f64 = 2e4;
/// Standard deviations, in nT, of the first, coarse test, and its time constant, in seconds.
const FIRST: ([f64; 2], f64) = ([10.0, 50.0], USUAL_TAU_S);
/// The search ends if the first test increases the logarithm of the likelihood by less than this.
const HOPELESS: f64 = -3.0;
/// Grid of the standard deviation, in nT, and the time constant, in seconds.
const GRID: ([f64; 3], [f64; 3]) = ([5.0, 20.0, 80.0], [2e3, USUAL_TAU_S, 1e6]);
/// White noise (nT), and standard deviation (nT) and time constant (s) of the process, that are tried in addition to
/// the best values without a permanent field. Those best values include part of the change of the permanent field.
const NOISE: ([f64; 2], [f64; 2], [f64; 2]) = ([1.0, 4.0], [2.0, 8.0], [100.0, 1500.0]);

impl NoiseLikelihood<'_> {
    /// Best point with a permanent field if the logarithm of its likelihood is larger by [`LEAST_GAIN`], otherwise
    /// `best`.
    pub(super) fn with_permanent(&self, best: (NoisePoint, f64), least_used: usize) -> (NoisePoint, f64) {
        let given = self.search.given;
        let is_given = given[PERMANENT[0]] == Some(0.0) || PERMANENT.iter().all(|at| given[*at].is_some());
        if self.search.direction.is_none() || is_given {
            return best;
        }
        let score = |points: &[NoisePoint]| -> Vec<(NoisePoint, f64)> {
            let scores = self.scores(points);
            let mut scored: Vec<_> =
                points.iter().zip(scores).map(|(point, score)| (*point, score.log_likelihood(least_used))).collect();
            scored.sort_by(|a, b| b.1.total_cmp(&a.1));
            scored
        };
        let [sigma_nt, fogm_nt, tau_s, ..] = best.0;
        let noises = [[sigma_nt, fogm_nt, tau_s], [sigma_nt, 0.25 * fogm_nt, tau_s], [sigma_nt, 3.0, 300.0]];
        let first: Vec<NoisePoint> = noises
            .iter()
            .flat_map(|[sigma_nt, fogm_nt, tau_s]| FIRST.0.map(|own| [*sigma_nt, *fogm_nt, *tau_s, own, FIRST.1]))
            .map(|point| self.with_given(point))
            .collect();
        let first = score(&first);
        if first.first().is_none_or(|(_, log)| *log < best.1 + HOPELESS) {
            return best;
        }
        let mut grid = vec![];
        for sigma_nt in NOISE.0 {
            for fogm_nt in NOISE.1 {
                for tau_s in NOISE.2 {
                    for own_nt in GRID.0 {
                        let point = |own_s: f64| self.with_given([sigma_nt, fogm_nt, tau_s, own_nt, own_s]);
                        grid.extend(GRID.1.map(point));
                    }
                }
            }
        }
        grid.dedup();
        grid.extend(first.first().map(|(point, _)| *point));
        let found = self.best_of(score(&grid).into_iter().take(1).map(|(point, _)| point), least_used);
        if found.1 > best.1 + LEAST_GAIN { found } else { best }
    }

    /// A point with the given parameters.
    fn with_given(&self, point: NoisePoint) -> NoisePoint {
        std::array::from_fn(|at| self.search.given[at].unwrap_or(point[at]))
    }

    /// Output of the filter with the further states of a point: the permanent field, the lag, and the height bias.
    pub(super) fn output_with_states(&self, point: &NoisePoint) -> Result<AidedOutput, NavigationError> {
        let [.., sigma, tau_s] = *point;
        let (ins, sigma_nt) = (self.thinned.ins(), self.sigma_nt(point));
        let line = self.line_at(point, &ins, &sigma_nt);
        let process = GaussMarkov { sigma, tau_s };
        let direction = self.search.direction.filter(|_| has_permanent(point));
        let permanent = direction.map(|direction| PermanentChange { direction, process });
        let parameters = AidedParameters { gate_nis: Some(GATE_NIS), ..AidedParameters::default() };
        let Self { latency_sigma_s, map_height_sigma_m, .. } = *self;
        let aids = Aids { permanent, latency_sigma_s, map_height_sigma_m, ..Aids::default() };
        aided::run(&line, &aids, &parameters)
    }
}
