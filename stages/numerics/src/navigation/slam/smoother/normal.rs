//! Normal equations of the smoother: set-up for a list of measurements, prior of the weights, and solution.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::likelihood::{SlamMeasurement, SlamProblem};
use super::motion::{InsErrorTransitions, PositionErrorBasis};
use super::search::SlamWeightPrior;
use super::{START_M, SlamFilterResult};
use crate::navigation::slam::samples::SlamLine;

/// Problem for the likelihood: the thinned measurements `thin`, and their displacements as functions of the weights.
pub(super) fn problem_of(
    thin: &[(SlamMeasurement, [f64; 2])],
    motion: &InsErrorTransitions,
    functions: &PositionErrorBasis,
    of: &SlamFilterResult<'_>,
) -> SlamProblem {
    let measured: Vec<SlamMeasurement> = thin.iter().map(|(measured, _)| *measured).collect();
    let mut rows = Vec::with_capacity(2 * measured.len() * functions.count);
    for one in &measured {
        let [north, east] = functions.between(motion.between(one.tt_s));
        rows.extend(north);
        rows.extend(east);
    }
    let centre_nt = measured.iter().map(|one| one.value_nt).sum::<f64>() / measured.len() as f64;
    let errors = &of.line.errors;
    SlamProblem {
        functions: MatRef::from_row_major_slice(&rows, 2 * measured.len(), functions.count).to_owned(),
        measured,
        temporal: (errors.fogm_sigma_nt, errors.fogm_tau_s),
        mean_nt2: of.kernel.mean_nt2(),
        centre_nt,
    }
}

/// Prior of the weights, with the position fixes.
pub(super) fn prior_of(
    motion: &InsErrorTransitions,
    functions: &PositionErrorBasis,
    line: &SlamLine<'_>,
) -> SlamWeightPrior {
    let count = functions.count;
    let mut information = Mat::<f64>::identity(count, count);
    let mut force = vec![0.0; count];
    if let Some(fixes) = line.fixes {
        let (known, forced) = motion.known(functions, line, fixes);
        information += MatRef::from_row_major_slice(&known, count, count);
        force = forced;
    }
    SlamWeightPrior { information, force }
}

/// Weights whose displacements approximate the given displacements.
pub(super) fn near(problem: &SlamProblem, prior: &SlamWeightPrior, moved: &[[f64; 2]]) -> Option<Vec<f64>> {
    let weight = 1.0 / (START_M * START_M);
    let flat: Vec<f64> = moved.iter().flatten().copied().collect();
    let b = &problem.functions;
    let information = &prior.information + faer::Scale(weight) * (b.transpose() * b);
    let force = b.transpose() * MatRef::from_column_major_slice(&flat, flat.len(), 1);
    let force: Vec<f64> = prior.force.iter().enumerate().map(|(k, f)| f + weight * force[(k, 0)]).collect();
    solved(&information, &force)
}

/// Solution of the normal equations; `None` if the information is not positive definite.
pub(super) fn solved(information: &Mat<f64>, force: &[f64]) -> Option<Vec<f64>> {
    let factor = information.llt(Side::Lower).ok()?;
    let solved = factor.solve(&MatRef::from_column_major_slice(force, force.len(), 1));
    Some((0..force.len()).map(|k| solved[(k, 0)]).collect())
}
