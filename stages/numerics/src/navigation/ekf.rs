//! The 18-state extended Kalman filter of magnetic navigation.
//!
//! The states are errors of the INS (truth - INS; see `pinson`) and the temporal variation S; the
//! measurement is the compensated scalar field, h(x) = map(position) + core(position) + S at the
//! position INS + x. At each sample the filter updates, returns the state, and then propagates to
//! the next with the INS of this one. [Gnadt 2022, section 5.3, with the corrections of H and Q]
//!
//! Irregularities along the line are documented and counted, never hidden:
//!
//! - a measurement that is NaN or infinite: no update, `residual` and `nis` are NaN;
//! - a predicted position off the map or in an unknown cell: the same;
//! - a flat map: without a core field the update only moves S, with one its slope corrects the position too;
//! - an INS value that is not finite, time that does not ascend, a covariance that is no longer
//!   finite and non-negative: an error that names the row.
//!
//! Filters over one line run side by side in the lanes of a vector register and share the transition matrices. A filter
//! alone runs through the same code with registers of one lane, and the lanes do not touch: its bits are the same in
//! any company.

mod measurement;
mod pack;
mod parameters;
mod steps;

use std::sync::Arc;

use pulp::{Scalar, Simd, WithSimd};

use crate::earth::core_field::CoreField;
use crate::maps::map_stack::FieldMap;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::position_fixes::PositionFixes;
use pack::{EkfLane, EkfPack};
pub use parameters::EkfParameters;
use steps::EkfStepModel;

/// Filters one line.
///
/// `measurement_nt` is the compensated field at each sample of `ins`; it holds the core field if,
/// and only if, `core` is given. Costs about 3 microseconds a sample and allocates little but the output.
///
/// # Errors
/// Fails as [`EkfParameters::check`] and [`InsSeries::check`], with [`SeriesError::Length`] for a measurement of
/// another length than the INS, and with [`NavigationError::Diverged`] when states or variances are no longer finite or
/// a variance is negative.
pub fn run(
    parameters: &EkfParameters,
    ins: &InsSeries<'_>,
    measurement_nt: &[f64],
    map: &FieldMap,
    core: Option<&CoreField>,
) -> Result<NavigationOutput, NavigationError> {
    let core = core.map(|core| Arc::new(core.clone()));
    let point = EkfInput { parameters, measurement_nt, sigma_nt: None, fixes: None, map, core: core.as_ref() };
    // One point has one result.
    run_together(ins, &[point]).pop().unwrap_or_else(|| Ok(NavigationOutput::default()))
}

/// Input of one of several filters over the same line.
#[derive(Clone, Copy, Debug)]
pub struct EkfInput<'a> {
    /// The parameters.
    pub parameters: &'a EkfParameters,
    /// The compensated field at each sample; it holds the core field if, and only if, `core` is given.
    pub measurement_nt: &'a [f64],
    /// The standard deviation of the noise of each measurement, in nT, in place of
    /// [`EkfParameters::measurement_sigma_nt`]; a value that is not above 0 makes its measurement a missing one.
    pub sigma_nt: Option<&'a [f64]>,
    /// Aiding positions, each used before the measurement of its sample.
    pub fixes: Option<&'a PositionFixes>,
    /// The map.
    pub map: &'a FieldMap,
    /// The core field.
    pub core: Option<&'a Arc<CoreField>>,
}

/// Filters one line by several points, whose results are in their order and bit-identical to [`run`].
///
/// Points of equal time constants (except that of the temporal variation), discretisation and, for
/// [`VanLoan`](crate::navigation::transition::NoiseDiscretisation::VanLoan), process noise share the transition
/// matrices. All results are in memory together.
///
/// # Errors
/// Each result fails as [`run`].
pub fn run_together(ins: &InsSeries<'_>, points: &[EkfInput<'_>]) -> Vec<Result<NavigationOutput, NavigationError>> {
    let series = ins.check();
    let mut answers: Vec<Option<Result<NavigationOutput, NavigationError>>> = vec![];
    let mut groups: Vec<(EkfStepModel, Vec<usize>)> = vec![];
    for (place, point) in points.iter().enumerate() {
        let refused = point.check(ins, &series).err();
        if refused.is_none() {
            let model = EkfStepModel::from_error_model(&point.parameters.errors);
            match groups.iter_mut().find(|(of, _)| *of == model) {
                Some((_, places)) => places.push(place),
                None => groups.push((model, vec![place])),
            }
        }
        answers.push(refused.map(Err));
    }
    for (model, places) in groups {
        let filters = places.iter().map(|place| EkfLane::new(points[*place], ins)).collect();
        let filtered = pulp::Arch::new().dispatch(EkfBatch { ins, model, filters });
        for (place, filter) in places.into_iter().zip(filtered) {
            answers[place] = Some(filter.finish());
        }
    }
    // Every point was rejected or belongs to a group.
    answers.into_iter().flatten().collect()
}

impl EkfInput<'_> {
    fn check(&self, ins: &InsSeries<'_>, series: &Result<(), SeriesError>) -> Result<(), NavigationError> {
        self.parameters.check()?;
        series.clone()?;
        if self.measurement_nt.len() != ins.len() {
            let (column, rows, expected) = ("measurement", self.measurement_nt.len(), ins.len());
            return Err(SeriesError::Length { column, rows, expected }.into());
        }
        if let Some(fixes) = self.fixes {
            fixes.check(ins.len())?;
        }
        if let Some(sigma_nt) = self.sigma_nt
            && sigma_nt.len() != ins.len()
        {
            let (column, rows, expected) = ("measurement sigma", sigma_nt.len(), ins.len());
            return Err(SeriesError::Length { column, rows, expected }.into());
        }
        Ok(())
    }
}

/// Steps that are computed before the filters use them, one pack after the other: the covariances of a pack stay in the
/// innermost cache meanwhile, and the steps in the next-level cache.
const BLOCK: usize = 32;

/// Number of filters up to which they run one by one: with few filters the vector unit is faster along the rows of a
/// matrix than across the filters.
const FEW: usize = 2;

/// Filters with common steps, dispatched together to the vector unit of the machine.
struct EkfBatch<'a> {
    ins: &'a InsSeries<'a>,
    model: EkfStepModel,
    filters: Vec<EkfLane<'a>>,
}

impl<'a> WithSimd for EkfBatch<'a> {
    type Output = Vec<EkfLane<'a>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { ins, model, mut filters } = self;
        let rest = filters.len() % S::F64_LANES;
        let few = filters.split_off(if rest <= FEW { filters.len() - rest } else { filters.len() });
        let (mut packs, mut lone) = (packed(simd, filters, &model, ins), packed(Scalar, few, &model, ins));
        let mut steps = Vec::with_capacity(BLOCK);
        for first in (1..ins.len()).step_by(BLOCK) {
            steps.clear();
            for row in first..(first + BLOCK).min(ins.len()) {
                steps.push(model.step(ins, row));
            }
            for pack in &mut packs {
                pack.advance(simd, ins, first, &steps);
            }
            for pack in &mut lone {
                pack.advance(Scalar, ins, first, &steps);
            }
        }
        let lone = lone.into_iter().flat_map(EkfPack::into_filters);
        packs.into_iter().flat_map(EkfPack::into_filters).chain(lone).collect()
    }
}

/// Packs of as many filters as a register has lanes, after their first sample.
#[inline(always)]
fn packed<'a, S: Simd>(
    simd: S,
    filters: Vec<EkfLane<'a>>,
    model: &EkfStepModel,
    ins: &InsSeries<'_>,
) -> Vec<EkfPack<'a, S>> {
    let mut packs = vec![];
    let mut filters = filters.into_iter().peekable();
    while filters.peek().is_some() {
        let mut pack = EkfPack::new(simd, filters.by_ref().take(S::F64_LANES).collect(), model.noise(), ins);
        pack.start(simd, ins);
        packs.push(pack);
    }
    packs
}

#[cfg(test)]
mod aided_tests;
#[cfg(test)]
mod curvature_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod together_tests;
