//! Points of a sweep over one line. Points with the same INS and the same filter are filtered together.

use std::sync::Arc;

use arrow_array::RecordBatch;
use numerics::{
    earth::core_field::CoreField,
    navigation::{field::PredictedField, ins_error::InsErrorModel, line::NavigationLine, pinson::StateMatrix},
};
use schemas::{Fault, LineOutput, LinePoint, NumberOrAuto};

use super::{
    Navigate,
    filter::{self, FilterDecl, FilterInput, FilterMagnetometer},
    ins::{self, InsColumns},
    line_noise::{LineNoiseEstimate, LineNoiseInputs},
    prepared::NavigationMap,
    start::InitialCondition,
    tuning::AssumedNoise,
};
use crate::columns::data;

/// Points with the same INS and the same initial estimate.
struct FilterPointGroup<'a> {
    batch: &'a RecordBatch,
    begin: InitialCondition,
    ins: Result<InsColumns<'a>, Fault>,
    places: Vec<usize>,
}

/// Cached core fields, by date; a sweep has few dates.
#[derive(Default)]
struct CoreFieldCache(Vec<(f64, Arc<CoreField>)>);

impl CoreFieldCache {
    fn at(&mut self, year: f64) -> Result<Arc<CoreField>, Fault> {
        if let Some((_, core)) = self.0.iter().find(|(of, _)| *of == year) {
            return Ok(core.clone());
        }
        let core = Arc::new(CoreField::at(year).map_err(data)?);
        self.0.push((year, core.clone()));
        Ok(core)
    }
}

/// Filters the points. Returns one result per point, in order.
pub(super) fn run(points: &[LinePoint<Navigate>]) -> Vec<LineOutput> {
    let mut answers: Vec<Option<LineOutput>> = vec![];
    let mut flights: Vec<FilterPointGroup> = vec![];
    for (place, LinePoint { line, .. }) in points.iter().enumerate() {
        answers.push(None);
        let Some(batch) = line.inputs.first() else {
            answers[place] = Some(Err(Fault::bug("the line is missing")));
            continue;
        };
        let begin = match points[place].stage.begin(batch) {
            Ok(begin) => begin,
            Err(fault) => {
                answers[place] = Some(Err(fault));
                continue;
            }
        };
        match flights.iter_mut().find(|flight| flight.begin == begin && ins::same(flight.batch, batch)) {
            Some(flight) => flight.places.push(place),
            None => flights.push(FilterPointGroup { batch, begin, ins: begun(batch, &begin), places: vec![place] }),
        }
    }
    let mut cores = CoreFieldCache::default();
    for FilterPointGroup { ins, places, begin, .. } in &flights {
        let mut maps = vec![];
        for place in places {
            let LinePoint { stage, prepared, .. } = points[*place];
            let at_heights = |ins: &InsColumns| {
                let Some(maps) = &prepared.map else { return Ok([None, None]) };
                let around = if stage.searches_height() { maps.around_heights(ins.alt_m())? } else { None };
                Ok([Some(maps.for_heights(ins.alt_m())?), around])
            };
            match ins.as_ref().map_err(Clone::clone).and_then(at_heights) {
                Ok(maps_of_place) => maps.push((*place, maps_of_place)),
                Err(fault) => answers[*place] = Some(Err(fault)),
            }
        }
        let mut works = vec![];
        let mut found = vec![];
        for (place, maps_of_place) in &maps {
            let (point, own_and_around) = (points[*place], maps_of_place.each_ref().map(Option::as_deref));
            let of = |ins| flown_on(point, ins, begin, own_and_around, (&mut cores, &mut found));
            match ins.as_ref().map_err(Clone::clone).and_then(of) {
                Ok((flown, map)) => works.push((*place, point.stage, flown, map)),
                Err(fault) => answers[*place] = Some(Err(fault)),
            }
        }
        let Ok(ins) = ins else { continue };
        let mut filters: Vec<(&'static FilterDecl, Vec<usize>)> = vec![];
        for (work, (_, stage, ..)) in works.iter().enumerate() {
            let filter = stage.filter.kind;
            match filters.iter_mut().find(|(known, _)| known.name == filter.name) {
                Some((_, of)) => of.push(work),
                None => filters.push((filter, vec![work])),
            }
        }
        for (filter, of) in filters {
            let together: Vec<filter::FilterPoint> =
                of.iter().map(|i| (&*works[*i].1.filter.keys, &works[*i].2)).collect();
            for (i, track) in of.iter().zip((filter.navigate_points)(&together)) {
                let (place, stage, flown, map) = &works[*i];
                let height = map.map_or(f64::NAN, |map| map.errors.of_height_nt(ins.alt_m()));
                answers[*place] = Some(track.and_then(|track| stage.arrays(track, flown, height)));
            }
        }
    }
    // Every point either has a fault or belongs to a group.
    answers.into_iter().map(|a| a.unwrap_or_else(|| Err(Fault::bug("the result of a point is missing")))).collect()
}

/// Calls `of` with the filter input of one point and the map of its line, for a stage that prepares lines as `navigate`
/// does.
///
/// # Errors
/// Fails for a line that `navigate` rejects, or without a map. Also fails in the cases of `of`.
pub(crate) fn with_filter_input<T>(
    point: LinePoint<Navigate>,
    of: impl FnOnce(&FilterInput, Arc<NavigationMap>) -> Result<T, Fault>,
) -> Result<T, Fault> {
    let batch = point.line.inputs.first().ok_or_else(|| Fault::bug("the line is missing"))?;
    let begin = point.stage.begin(batch)?;
    let ins = begun(batch, &begin)?;
    let maps = point.prepared.map.as_ref().ok_or_else(|| Fault::bug("the map is missing"))?;
    let map = maps.for_heights(ins.alt_m())?;
    let (mut cores, mut found) = (CoreFieldCache::default(), vec![]);
    let flown = flown(point, &ins, &begin, Some(&*map), (&mut cores, &mut found))?;
    of(&flown, map.clone())
}

/// INS of a line, corrected if a filter starts from a fix.
fn begun<'a>(batch: &'a RecordBatch, begin: &InitialCondition) -> Result<InsColumns<'a>, Fault> {
    let ins = InsColumns::from_batch(batch)?;
    ins.series().check().map_err(data)?;
    match begin {
        InitialCondition::Fixed { fix, row, .. } => Ok(ins.corrected(fix, *row)),
        InitialCondition::Given | InitialCondition::Aligned { .. } => Ok(ins),
    }
}

/// Filter input of one point and its map. The map is `own`, at the heights of the line. If the line has a height bias,
/// the map is `around`, which is continued below and above these heights.
fn flown_on<'a>(
    point: LinePoint<'a, Navigate>,
    ins: &'a InsColumns,
    begin: &InitialCondition,
    [own, around]: [Option<&'a NavigationMap>; 2],
    (cores, found): (&mut CoreFieldCache, &mut Vec<(LineNoiseInputs, LineNoiseEstimate)>),
) -> Result<(FilterInput<'a>, Option<&'a NavigationMap>), Fault> {
    let exact = flown(point, ins, begin, own, (cores, found))?;
    let Some((tuned, around)) = exact.tuned.as_ref().zip(around) else { return Ok((exact, own)) };
    // With a height bias, heights may lie outside the levels of `own`.
    let has_bias = exact.map_height_sigma_m.is_some();
    if has_bias || tuned.may_be_biased(&exact, around)? {
        let biased = flown(point, ins, begin, Some(around), (cores, found))?;
        if has_bias || biased.map_height_sigma_m.is_some() {
            return Ok((biased, Some(around)));
        }
    }
    Ok((exact, own))
}

/// Filter input of one point.
fn flown<'a>(
    LinePoint { stage, line, prepared }: LinePoint<'a, Navigate>,
    ins: &'a InsColumns,
    begin: &InitialCondition,
    map: Option<&'a NavigationMap>,
    (cores, found): (&mut CoreFieldCache, &mut Vec<(LineNoiseInputs, LineNoiseEstimate)>),
) -> Result<FilterInput<'a>, Fault> {
    let batch = line.inputs.first().ok_or_else(|| Fault::bug("the line is missing"))?;
    let mut magnetometers = vec![];
    for name in stage.magnetometers() {
        magnetometers.push(FilterMagnetometer { name, measured_nt: stage.measured(batch, name)? });
    }
    let core = stage.core_year(batch)?.map(|year| cores.at(year)).transpose()?;
    let expected = stage.expected(batch)?;
    let mut sigma_nt = expected.sigma_nt;
    if stage.noise.measurement_sigma_nt == Some(NumberOrAuto::Auto)
        && let Some(map) = map
    {
        sigma_nt = sigma_nt.hypot(map.errors.of_interpolation_nt(ins.step_m()));
    }
    let mut errors = InsErrorModel {
        fogm_sigma_nt: expected.fogm_sigma_nt,
        fogm_tau_s: expected.fogm_tau_s,
        ..InsErrorModel::from_sources(stage.ins_sources(batch)?)
    };
    let series = ins.series();
    let starts = begin.covariances(&errors, &series);
    errors.start = starts.first().copied();
    let field_nt = stage.geometry.field(batch)?;
    let cosines = field_nt.map(|field| stage.geometry.cosines(field));
    let factors = |cosines: &Vec<f64>| cosines.iter().map(|cosine| stage.geometry.noise_factor(*cosine)).collect();
    let mut flown = FilterInput {
        ins: series,
        measured_nt: vec![],
        sigma_nt: vec![],
        magnetometers,
        map: map.map(|map| &map.field),
        core,
        errors,
        measurement_sigma_nt: sigma_nt,
        offset_window_s: stage.field.offset_window_s,
        columns: batch,
        models: &prepared.models,
        noise_factors: cosines.as_ref().map(factors),
        field_nt,
        cosines,
        sample_sigma_nt: stage.sample_sigma_nt(batch)?,
        map_sigma_nt: None,
        gnss: None,
        permanent: None,
        latency_sigma_s: None,
        map_height_sigma_m: None,
        has_constants: stage.has_constants(map.is_some()),
        second_order: stage.is_auto(),
        start_range: None,
        counts: vec![],
        left_out: vec![],
        tuned: None,
    };
    flown.gnss = stage.filter.keys.aiding().map(|aiding| aiding.gnss(&flown)).transpose()?.flatten();
    // Copied before `combine` subtracts the offsets, because a filter that processes magnetometers separately subtracts
    // the offset of each itself.
    let each = stage.filter.keys.each_magnetometer().then(|| flown.magnetometers.clone());
    flown.combine()?;
    flown.start_range = stage.start_range(&flown)?;
    let noise = NoiseSources { stage, ins, map, expected: AssumedNoise { sigma_nt, ..expected } };
    if stage.filter.keys.takes_wide_start() && flown.start_range.is_some_and(|range| range.is_exceeded()) {
        noise.find_from_wide_start(&mut flown, found)?;
    } else {
        noise.find(&mut flown, each, &starts, found)?;
    }
    Ok(flown)
}

/// Data from which the noise of a line is found.
pub(super) struct NoiseSources<'a> {
    pub(super) stage: &'a Navigate,
    pub(super) ins: &'a InsColumns<'a>,
    pub(super) map: Option<&'a NavigationMap>,
    pub(super) expected: AssumedNoise,
}

impl NoiseSources<'_> {
    /// Estimates noise and outliers, with an extended Kalman filter from the first sample on. `each` are the
    /// magnetometers of a filter that processes them separately, and `starts` the possible covariances at the first
    /// sample.
    pub(super) fn find<'b>(
        &self,
        flown: &mut FilterInput<'b>,
        each: Option<Vec<FilterMagnetometer<'b>>>,
        starts: &[StateMatrix],
        found: &mut Vec<(LineNoiseInputs, LineNoiseEstimate)>,
    ) -> Result<(), Fault> {
        let Self { stage, ins, map, expected } = self;
        let finds_noise = stage.finds_noise(map.is_some());
        flown.permanent = stage.given_permanent(flown);
        [flown.latency_sigma_s, flown.map_height_sigma_m] =
            stage.given_constants().map(|sigma| sigma.filter(|sigma| *sigma > 0.0));
        if let Some(map) = map.filter(|_| finds_noise) {
            stage.tune(flown, map, starts, expected, found)?;
        }
        if let Some((map, length_m)) = map.zip(stage.field.map_error_length_m) {
            flown.map_sigma_nt =
                map.errors.own_nt(&NavigationLine { fixes: flown.fixes(), ..flown.line()? }, ins.step_m(), length_m)?;
            flown.set_sigma();
        }
        if let Some(each) = each {
            flown.restore(each);
            flown.offset_window_s = stage.field.offset_window_s;
        }
        if finds_noise && !stage.filter.keys.gates() {
            stage.reject_outliers(flown)?;
        }
        Ok(())
    }
}

impl<'a> FilterInput<'a> {
    /// Averages the available magnetometers at each sample. The predicted field is the same for all magnetometers, so
    /// the mean loses no information on the position. The offset of each magnetometer has already been subtracted.
    fn combine(&mut self) -> Result<(), Fault> {
        let mut magnetometers = std::mem::take(&mut self.magnetometers);
        if magnetometers.len() > 1 && self.offset_window_s > 0.0 && self.map.is_some() {
            for FilterMagnetometer { name, measured_nt } in &mut magnetometers {
                let mut field = PredictedField::new(self.needed_map()?, self.core.as_ref());
                let (offset_nt, samples) = field.offset(&self.ins, measured_nt, self.offset_window_s);
                if samples == 0 {
                    let what =
                        format!("`{name}` has no sample within `offset_window_s` with a measurement and a map value");
                    return Err(Fault::data(what).help("remove the column from `mag`").in_column(name));
                }
                measured_nt.iter_mut().for_each(|m| *m -= offset_nt);
            }
            self.offset_window_s = 0.0;
        }
        let rows = self.ins.len();
        self.counts = vec![1.0; rows];
        if magnetometers.len() == 1 {
            self.measured_nt = magnetometers.remove(0).measured_nt;
            self.set_sigma();
            return Ok(());
        }
        self.measured_nt = vec![f64::NAN; rows];
        for row in 0..rows {
            let (mut sum_nt, mut count) = (0.0, 0.0);
            for value in magnetometers.iter().filter_map(|mag| mag.measured_nt.get(row)).filter(|m| m.is_finite()) {
                sum_nt += value;
                count += 1.0;
            }
            if count > 0.0 {
                self.measured_nt[row] = sum_nt / count;
                self.counts[row] = count;
            }
        }
        self.set_sigma();
        Ok(())
    }

    /// Restores the individual magnetometers for a filter that processes them separately. Removed measurements stay
    /// removed.
    pub(super) fn restore(&mut self, mut magnetometers: Vec<FilterMagnetometer<'a>>) {
        for FilterMagnetometer { measured_nt, .. } in &mut magnetometers {
            let removed = measured_nt.iter_mut().zip(&self.measured_nt).filter(|(_, mean)| !mean.is_finite());
            removed.for_each(|(own, _)| *own = f64::NAN);
        }
        self.magnetometers = magnetometers;
    }

    /// Sets the standard deviation of each measurement. It follows from the noise and number of the sensors and from
    /// the map error.
    pub(super) fn set_sigma(&mut self) {
        let of = |row: usize| {
            let own_nt = self.own_sigma_nt(row) / f64::sqrt(self.counts[row]);
            if self.map_sigma_nt.is_some() { own_nt.hypot(self.map_sigma_at(row)) } else { own_nt }
        };
        self.sigma_nt = (0..self.ins.len()).map(of).collect();
    }
}

#[cfg(test)]
mod tests;
