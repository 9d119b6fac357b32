//! Elementary effects and Sobol indices over the ranges of the inputs on a line.

use learning::importance::{
    ElementaryEffects, ImportanceError, MorrisDesign, SobolDesign, SobolIndex, SobolIndices, morris, sobol,
};
use schemas::Fault;

use super::weights::{GroupImportance, ImportanceRows, LineImportance, failed};
use super::{Importance, ImportanceMethod};
use crate::fitted::FittedModel;

impl Importance {
    /// Elementary effects.
    ///
    /// # Errors
    /// Fails if the model fails, or the number of levels is odd.
    pub(super) fn screened(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<LineImportance, Fault> {
        let design = MorrisDesign { trajectories: self.trajectories, levels: self.levels, seed: self.seed as u64 };
        let found = morris(&|x: &[f64]| fitted.field_nt(x), &self.ranges(rows), groups, &design);
        let one = |(of, group): (&ElementaryEffects, &Vec<usize>)| GroupImportance {
            value: of.mean_absolute(),
            // The effect of a group of several columns has no sign.
            spread: if group.len() == 1 { of.deviation() } else { f64::NAN },
            error: of.error(),
            n: of.effects.len(),
        };
        let found = found.map_err(|fault| failed(fault, None))?;
        Ok(found.iter().zip(groups).map(one).collect::<Vec<_>>().into())
    }

    /// Sobol indices.
    ///
    /// # Errors
    /// Fails if the model fails, or its predictions are equal over the ranges.
    pub(super) fn shares(
        &self,
        rows: &ImportanceRows,
        fitted: &FittedModel,
        groups: &[Vec<usize>],
    ) -> Result<LineImportance, Fault> {
        let design = SobolDesign { points: self.points, seed: self.seed as u64 };
        let found = sobol(&|x: &[f64]| fitted.field_nt(x), &self.ranges(rows), groups, &design);
        let found: Vec<SobolIndices> = found.map_err(|fault| {
            let is_constant = matches!(fault, ImportanceError::Constant);
            failed(fault, is_constant.then_some("model"))
        })?;
        let index = |of: &SobolIndices| if self.method == ImportanceMethod::SobolFirst { of.first } else { of.total };
        let one = |of: &SobolIndices| {
            let SobolIndex { value, error, .. } = index(of);
            GroupImportance { value, spread: f64::NAN, error, n: self.points }
        };
        let weights = found.iter().map(one).collect();
        let intervals = found.iter().map(|of| index(of).interval).collect();
        Ok(LineImportance { weights, samples: None, intervals: Some(intervals) })
    }

    /// Range of each input: quantiles of its values on the line.
    fn ranges(&self, rows: &ImportanceRows) -> Vec<[f64; 2]> {
        let of = |column: usize| {
            let mut values = rows.column(column);
            values.sort_by(f64::total_cmp);
            [self.tails, 1.0 - self.tails].map(|part| quantile(&values, part))
        };
        (0..rows.width).map(of).collect()
    }
}

/// Quantile of sorted values, interpolated linearly.
fn quantile(sorted: &[f64], part: f64) -> f64 {
    let place = part * (sorted.len() - 1) as f64;
    let (below, rest) = (place.floor() as usize, place.fract());
    let above = sorted[(below + 1).min(sorted.len() - 1)];
    sorted[below] + rest * (above - sorted[below])
}
