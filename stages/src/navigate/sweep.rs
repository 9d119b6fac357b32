//! The points of a sweep over one line, filtered together.

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch};
use numerics::{
    earth::core_field::CoreField,
    navigation::ekf::{EkfOutput, EkfParameters, EkfPoint, run_together},
};
use schemas::{Fault, LineIn, OrAuto};

use super::{
    Navigate, PreparedMap,
    ins::{self, Ins},
};
use crate::columns::data;

type Answer = Result<Vec<ArrayRef>, Fault>;

/// Points with the same INS.
struct Flown<'a> {
    batch: &'a RecordBatch,
    ins: Result<Ins<'a>, Fault>,
    places: Vec<usize>,
}

/// What one point gives to the filter, all that the INS is not.
struct Work<'a> {
    stage: &'a Navigate,
    map: &'a PreparedMap,
    measured_nt: Vec<f64>,
    parameters: EkfParameters,
    core: Option<Arc<CoreField>>,
}

/// Core fields by their dates, of which a sweep has few.
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
pub(super) fn run(points: &[(&Navigate, &LineIn)]) -> Vec<Answer> {
    let mut answers: Vec<Option<Answer>> = vec![];
    let mut flights: Vec<Flown<'_>> = vec![];
    for (place, (_, line)) in points.iter().enumerate() {
        answers.push(None);
        let Some(batch) = line.inputs.first() else {
            answers[place] = Some(Err(Fault::data("the line is missing")));
            continue;
        };
        match flights.iter_mut().find(|flown| ins::same(flown.batch, batch)) {
            Some(flown) => flown.places.push(place),
            None => flights.push(Flown { batch, ins: Ins::of(batch), places: vec![place] }),
        }
    }
    let mut cores = CoreFields::default();
    for Flown { ins, places, .. } in flights {
        let mut works = vec![];
        for place in places {
            let (stage, line) = points[place];
            let work = ins.as_ref().map_err(Clone::clone).and_then(|ins| Work::of(stage, line, ins, &mut cores));
            match work {
                Ok(work) => works.push((place, work)),
                Err(fault) => answers[place] = Some(Err(fault)),
            }
        }
        if let Ok(ins) = &ins {
            let filters: Vec<EkfPoint<'_>> = works.iter().map(|(_, work)| work.point()).collect();
            let outputs = run_together(&ins.series(), &filters);
            for ((place, work), output) in works.iter().zip(outputs) {
                answers[*place] = Some(output.map_err(data).and_then(|output| work.answer(output, ins)));
            }
        }
    }
    // Every point has a fault or is of a flight.
    answers.into_iter().flatten().collect()
}

impl<'a> Work<'a> {
    fn of(stage: &'a Navigate, line: &'a LineIn, ins: &Ins<'_>, cores: &mut CoreFields) -> Result<Self, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::data("the line is missing"))?;
        let map = line.prepared.as_ref().and_then(|p| p.downcast_ref::<PreparedMap>());
        let map = map.ok_or_else(|| Fault::data("the map is missing"))?;
        let measured_nt = stage.measured(batch)?;
        let core = stage.core_year(batch)?.map(|year| cores.at(year)).transpose()?;
        let mut noise = stage.expected(batch)?;
        if stage.measurement_sigma_nt == OrAuto::Auto {
            noise.sigma_nt = noise.sigma_nt.hypot(map.errors.of_interpolation_nt(ins.step_m()));
        }
        Ok(Self { stage, map, measured_nt, parameters: stage.parameters(noise), core })
    }

    fn point(&self) -> EkfPoint<'_> {
        let Self { parameters, measured_nt, map, core, .. } = self;
        EkfPoint { parameters, measurement_nt: measured_nt, map: &map.field, core: core.as_ref() }
    }

    fn answer(&self, output: EkfOutput, ins: &Ins<'_>) -> Answer {
        let report = output.report;
        if report.updates == 0 {
            let what = format!(
                "no sample could be used: {} without a measurement, {} off the map",
                report.missing_measurements, report.off_map
            );
            return Err(Fault::data(what).help("does the map cover the flight?"));
        }
        if self.stage.offset_window_s > 0.0 && report.offset_samples == 0 {
            return Err(Fault::data(
                "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
            ));
        }
        self.stage.arrays(output, &self.measured_nt, self.map.errors.of_height_nt(ins.alt_m()))
    }
}

#[cfg(test)]
mod tests;
