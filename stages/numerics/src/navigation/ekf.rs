//! 18-state extended Kalman filter of magnetic navigation.
//!
//! The states are errors of the INS (truth - INS; see `pinson`) and the temporal variation S; the measurement is the
//! compensated scalar field, h(x) = map(position) + core(position) + S at the position INS + x. At each sample, the
//! filter updates and returns the state. It then propagates the state to the next sample with the INS values of the
//! present sample. [Gnadt 2022, section 5.3, with the corrections of H and Q]
//!
//! Irregularities along the line are counted:
//!
//! - a measurement that is NaN or infinite: no update, `residual` and `nis` are NaN;
//! - a predicted position off the map or in an unknown cell: as above;
//! - a flat map: without a core field the update changes only S; with one, the slope of the core field also corrects
//!   the position;
//! - an INS value that is not finite, time that does not ascend, or a covariance that is not finite and non-negative:
//!   an error with the row.
//!
//! Filters over one line run in parallel in the lanes of a vector register and share the transition matrices. A single
//! filter runs the same code with registers of one lane. Lanes are independent, so the results of a filter are
//! bit-identical for any number of filters.

mod pack;
mod parameters;
mod stepped;
mod streamed;

use std::sync::Arc;

use pulp::{Scalar, Simd, WithSimd};

use crate::earth::core_field::CoreField;
use crate::maps::map_stack::FieldMap;
use crate::navigation::gaussian::StepModel;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::position_fixes::PositionFixes;
use pack::{EkfLane, EkfPack};
pub use parameters::EkfParameters;
pub(crate) use stepped::{NoiseFactors, NoiseSource, run_stepped};
pub(crate) use streamed::StreamedEkf;

/// Filters one line.
///
/// `measurement_nt` is the compensated field at each sample of `ins`; the field contains the core field if, and only
/// if, `core` is given. Costs about 3 µs per sample and allocates little except the output.
///
/// # Errors
/// Returns the errors of [`EkfParameters::check`] and [`InsSeries::check`]. Also fails with [`SeriesError::Length`] for
/// a measurement whose length differs from that of the INS, or with [`NavigationError::Diverged`] if a state or
/// variance is not finite or a variance is negative.
pub fn run(
    parameters: &EkfParameters,
    ins: &InsSeries<'_>,
    measurement_nt: &[f64],
    map: &FieldMap,
    core: Option<&CoreField>,
) -> Result<NavigationOutput, NavigationError> {
    let core = core.map(|core| Arc::new(core.clone()));
    let point = EkfInput { parameters, measurement_nt, sigma_nt: None, fixes: None, map, core: core.as_ref() };
    // A single point gives exactly one result.
    run_together(ins, &[point]).pop().unwrap_or_else(|| Ok(NavigationOutput::default()))
}

/// Input of one of several filters over the same line.
#[derive(Clone, Copy, Debug)]
pub struct EkfInput<'a> {
    /// Parameters.
    pub parameters: &'a EkfParameters,
    /// Compensated field at each sample; the field contains the core field if, and only if, `core` is given.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the noise of each measurement, in nT, in place of [`EkfParameters::measurement_sigma_nt`].
    /// A measurement with a value that is not above 0 counts as missing.
    pub sigma_nt: Option<&'a [f64]>,
    /// Aiding positions, each used before the measurement of its sample.
    pub fixes: Option<&'a PositionFixes>,
    /// Map.
    pub map: &'a FieldMap,
    /// Core field.
    pub core: Option<&'a Arc<CoreField>>,
}

/// Runs one filter over the same line for each of `points`. The results are in the order of the points and
/// bit-identical to [`run`].
///
/// Points with equal time constants (except that of the temporal variation), discretisation and, for
/// [`VanLoan`](crate::navigation::transition::NoiseDiscretisation::VanLoan), process noise share the transition
/// matrices. All results are in memory at the same time.
///
/// # Errors
/// Each result can be one of the errors of [`run`].
pub fn run_together(ins: &InsSeries<'_>, points: &[EkfInput<'_>]) -> Vec<Result<NavigationOutput, NavigationError>> {
    let series = ins.check();
    let mut answers: Vec<Option<Result<NavigationOutput, NavigationError>>> = vec![];
    let mut groups: Vec<(StepModel, Vec<usize>)> = vec![];
    for (place, point) in points.iter().enumerate() {
        let refused = point.check(ins, &series).err();
        if refused.is_none() {
            let model = StepModel::shared(&point.parameters.errors);
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

/// Number of steps that are computed at once. The filters then use these steps, one pack of filters after the other.
/// The covariances of a pack then stay in the first-level cache, and the steps in the second-level cache.
const BLOCK: usize = 32;

/// Largest number of filters that run one by one. With few filters, vectorisation along the rows of a matrix is faster
/// than across filters.
const FEW: usize = 2;

/// Filters with common steps, dispatched together to the vector unit of the machine.
struct EkfBatch<'a> {
    ins: &'a InsSeries<'a>,
    model: StepModel,
    filters: Vec<EkfLane<'a, EkfInput<'a>>>,
}

impl<'a> WithSimd for EkfBatch<'a> {
    type Output = Vec<EkfLane<'a, EkfInput<'a>>>;

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
                steps.push(model.lane_step(ins, row));
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

/// Packs with one filter per lane of a register, after their first sample.
#[inline(always)]
fn packed<'a, S: Simd>(
    simd: S,
    filters: Vec<EkfLane<'a, EkfInput<'a>>>,
    model: &StepModel,
    ins: &InsSeries<'_>,
) -> Vec<EkfPack<'a, S, EkfInput<'a>>> {
    let mut packs = vec![];
    let mut filters = filters.into_iter().peekable();
    while filters.peek().is_some() {
        let mut pack = EkfPack::new(simd, filters.by_ref().take(S::F64_LANES).collect(), model.noise());
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
