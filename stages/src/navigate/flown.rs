//! The points of a sweep over one line: those with the same INS and the same filter are filtered together.

use std::sync::Arc;

use arrow_array::RecordBatch;
use numerics::{earth::core_field::CoreField, navigation::ins_error::InsErrorModel};
use schemas::{Arrays, Fault, LinePoint, OrAuto};

use super::{
    Navigate, PreparedMap,
    filter::{self, Filter, Flown},
    ins::{self, Ins},
};
use crate::columns::data;

/// Points with the same INS.
struct Flight<'a> {
    batch: &'a RecordBatch,
    ins: Result<Ins<'a>, Fault>,
    places: Vec<usize>,
}

/// Core fields by date: a sweep has few dates.
#[derive(Default)]
struct CoreFields(Vec<(f64, Arc<CoreField>)>);

impl CoreFields {
    fn at(&mut self, year: f64) -> Result<Arc<CoreField>, Fault> {
        if let Some((_, core)) = self.0.iter().find(|(of, _)| *of == year) {
            return Ok(core.clone());
        }
        let core = Arc::new(CoreField::at(year).map_err(data)?);
        self.0.push((year, core.clone()));
        Ok(core)
    }
}

/// One answer a point, in their order.
pub(super) fn run(points: &[LinePoint<Navigate>]) -> Vec<Arrays> {
    let mut answers: Vec<Option<Arrays>> = vec![];
    let mut flights: Vec<Flight> = vec![];
    for (place, LinePoint { line, .. }) in points.iter().enumerate() {
        answers.push(None);
        let Some(batch) = line.inputs.first() else {
            answers[place] = Some(Err(Fault::bug("the line is missing")));
            continue;
        };
        match flights.iter_mut().find(|flight| ins::same(flight.batch, batch)) {
            Some(flight) => flight.places.push(place),
            None => flights.push(Flight { batch, ins: Ins::of(batch), places: vec![place] }),
        }
    }
    let mut cores = CoreFields::default();
    for Flight { ins, places, .. } in &flights {
        let mut works = vec![];
        for place in places {
            let point = points[*place];
            match ins.as_ref().map_err(Clone::clone).and_then(|ins| flown(point, ins, &mut cores)) {
                Ok((flown, map)) => works.push((*place, point.stage, flown, map)),
                Err(fault) => answers[*place] = Some(Err(fault)),
            }
        }
        let Ok(ins) = ins else { continue };
        let mut filters: Vec<(&'static Filter, Vec<usize>)> = vec![];
        for (work, (_, stage, ..)) in works.iter().enumerate() {
            let filter = stage.filter.kind;
            match filters.iter_mut().find(|(known, _)| known.name == filter.name) {
                Some((_, of)) => of.push(work),
                None => filters.push((filter, vec![work])),
            }
        }
        for (filter, of) in filters {
            let together: Vec<filter::Point> = of.iter().map(|i| (&*works[*i].1.filter.keys, &works[*i].2)).collect();
            for (i, track) in of.iter().zip((filter.navigate_points)(&together)) {
                let (place, stage, _, map) = &works[*i];
                let height = map.errors.of_height_nt(ins.alt_m());
                answers[*place] = Some(track.and_then(|track| stage.arrays(track, ins.len(), height)));
            }
        }
    }
    // Every point has a fault or is of a flight.
    answers.into_iter().map(|a| a.unwrap_or_else(|| Err(Fault::bug("a point was lost")))).collect()
}

/// What one point gives to its filter.
fn flown<'a>(
    LinePoint { stage, line, prepared: map }: LinePoint<'a, Navigate>,
    ins: &'a Ins,
    cores: &mut CoreFields,
) -> Result<(Flown<'a>, &'a PreparedMap), Fault> {
    let batch = line.inputs.first().ok_or_else(|| Fault::bug("the line is missing"))?;
    let measured_nt = stage.measured(batch)?;
    let core = stage.core_year(batch)?.map(|year| cores.at(year)).transpose()?;
    let mut noise = stage.expected(batch)?;
    if stage.noise.measurement_sigma_nt == OrAuto::Auto {
        noise.sigma_nt = noise.sigma_nt.hypot(map.errors.of_interpolation_nt(ins.step_m()));
    }
    let errors = InsErrorModel {
        fogm_sigma_nt: noise.fogm_sigma_nt,
        fogm_tau_s: noise.fogm_tau_s,
        ..InsErrorModel::of(stage.ins)
    };
    let (measurement_sigma_nt, offset_window_s) = (noise.sigma_nt, stage.offset_window_s);
    let ins = ins.series();
    Ok((Flown { ins, measured_nt, map: &map.field, core, errors, measurement_sigma_nt, offset_window_s }, map))
}

#[cfg(test)]
mod tests;
