//! Test of a track: agreement of the measurements of revisits.
//!
//! On a lost track the revisits contradict each other. The likelihood then prefers a kernel with a large white part,
//! which can explain any measurements, so neither misfit nor covariance indicates the contradiction. A comparison with
//! the same flight, stretched to a straight line without revisits, reveals the contradiction:
//!
//! ```text
//! E = log p(z | path) − log p(z | the path drawn out)
//! ```
//!
//! each with its own most probable kernel, if the kernel is fitted. If the noise equals the assumed noise, E is about
//!
//! ```text
//! D = (log |C drawn out| − log |C|)/2
//! ```
//!
//! with the kernel of the stretched path, which does not depend on the track: the mutual information of the revisits.

use super::likelihood::{SlamMeasurement, SlamProblem};
use super::search::{SlamSearch, SlamSearchParameters, SlamWeightPrior};

/// Evidence of the revisits for a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RevisitEvidence {
    /// E.
    pub found: f64,
    /// D.
    pub expected: f64,
}

impl RevisitEvidence {
    /// E over D: 1 if two visits differ only by the expected noise and roughness of the field, 0 if the two visits are
    /// unrelated. NaN if there are no revisits, or if they contain almost no information (D below 5, a factor of 150 in
    /// probability).
    pub fn agreement(&self) -> f64 {
        if self.expected >= LEAST { self.found / self.expected } else { f64::NAN }
    }
}

/// Smallest D for a comparison.
const LEAST: f64 = 5.0;

/// Evidence at the optimum of a search; `None` if the covariance is not positive.
pub fn evidence(
    problem: &SlamProblem,
    prior: &SlamWeightPrior,
    rules: SlamSearchParameters,
    search: &SlamSearch<'_>,
) -> Option<RevisitEvidence> {
    let out = drawn_out(problem, &search.weights);
    let mut alone = SlamSearch::from(&out, prior, rules, search.weights.clone(), search.kernel)?;
    alone.settle_kernel();
    let both = [&out, problem].map(|of| Some(of.factored(&alone.kernel, &search.weights)?.logarithm()));
    let [Some(apart), Some(together)] = both else { return None };
    Some(RevisitEvidence { found: alone.likelihood_cost() - search.likelihood_cost(), expected: apart - together })
}

/// Problem with the path stretched to a straight line of the same length.
fn drawn_out(problem: &SlamProblem, weights: &[f64]) -> SlamProblem {
    let mut along_m = 0.0;
    let mut before = None::<[f64; 2]>;
    let mut measured = vec![];
    for (of, moved_m) in problem.measured.iter().zip(problem.displacements_m(weights)) {
        let at_m = [0, 1].map(|axis: usize| of.at_m[axis] + moved_m[axis]);
        let from_m = before.replace(at_m).unwrap_or(at_m);
        along_m += (at_m[0] - from_m[0]).hypot(at_m[1] - from_m[1]);
        measured.push(SlamMeasurement { at_m: [along_m - moved_m[0], -moved_m[1]], ..*of });
    }
    SlamProblem { measured, functions: problem.functions.clone(), ..*problem }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;

    #[test]
    fn unit_a_straightened_path_has_the_same_steps() {
        let at = [[0.0, 0.0], [30.0, 40.0], [0.0, 0.0]];
        let measured = at.map(|at_m| SlamMeasurement {
            tt_s: 0.0,
            at_m,
            value_nt: 1.0,
            variance_nt2: 1.0,
            core_nt_per_m: [0.1, 0.2],
        });
        // One function that moves the second position 30 m to the south.
        let functions = Mat::from_fn(6, 1, |row, _| if row == 2 { -30.0 } else { 0.0 });
        let (measured, temporal) = (measured.to_vec(), (0.0, 1.0));
        let problem = SlamProblem { measured, functions, temporal, mean_nt2: 1.0, centre_nt: 0.0 };
        let out = drawn_out(&problem, &[1.0]);
        let moved = out.displacements_m(&[1.0]);
        let found: Vec<[f64; 2]> =
            (0..3).map(|i| [0, 1].map(|k: usize| out.measured[i].at_m[k] + moved[i][k])).collect();
        assert_eq!(found, [[0.0, 0.0], [40.0, 0.0], [80.0, 0.0]]);
    }
}
