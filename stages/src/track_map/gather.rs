//! Measurements of lines at the positions of their tracks.

use arrow_array::RecordBatch;
use numerics::earth::core_field::CoreField;
use schemas::{CheckpointMonitor, Fault, LineInput, StageOutput, SurveyAggregator, TableShape};

use super::{DIURNAL, PLACE, SPREAD, TrackMap};
use crate::{
    columns::{data, floats},
    dates::first_year,
};

/// A measurement, or the mean of several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnomalyMeasurement {
    /// Latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height, in metres.
    pub alt_m: f64,
    /// Time, in seconds.
    pub tt_s: f64,
    /// The anomaly, in nT.
    pub value_nt: f64,
    /// Variances of the position east and north and their covariance, in m².
    pub position_m2: [f64; 3],
}

/// Points of a sweep over the same lines.
pub struct TrackMapAggregator {
    stages: Vec<TrackMap>,
}

/// Measurements of a line, for each point.
pub struct TrackMapLinePart {
    flight: String,
    of: Vec<Result<Vec<AnomalyMeasurement>, Fault>>,
}

impl TrackMapAggregator {
    /// Gathers measurements for these points of a sweep.
    pub fn new(stages: Vec<&TrackMap>) -> TrackMapAggregator {
        TrackMapAggregator { stages: stages.into_iter().cloned().collect() }
    }
}

impl SurveyAggregator for TrackMapAggregator {
    type Part = TrackMapLinePart;

    fn map(&self, line: &LineInput) -> Result<TrackMapLinePart, Fault> {
        let of = self.stages.iter().map(|stage| stage.measured(line)).collect();
        Ok(TrackMapLinePart { flight: line.flight.clone(), of })
    }

    fn refused(&self, part: &TrackMapLinePart) -> Vec<(usize, Fault)> {
        part.of.iter().enumerate().filter_map(|(i, of)| Some((i, of.as_ref().err()?.clone()))).collect()
    }

    fn finish(&self, parts: Vec<TrackMapLinePart>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let one = |(i, stage): (usize, &TrackMap)| {
            let lines: Vec<(&str, &[AnomalyMeasurement])> = parts
                .iter()
                .filter_map(|part| Some((part.flight.as_str(), part.of.get(i)?.as_ref().ok()?.as_slice())))
                .collect();
            stage.mapped(&lines)
        };
        self.stages.iter().enumerate().map(one).collect()
    }
}

impl TrackMap {
    /// Averaged measurements of a line.
    pub(super) fn measured(&self, line: &LineInput) -> Result<Vec<AnomalyMeasurement>, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a survey without lines"))?;
        let track = line.inputs.get(1);
        let tt = floats(batch, "tt")?;
        if let Some(track) = track
            && floats(track, "tt")? != tt
        {
            return Err(Fault::data("the line and its track have different samples")
                .in_column("tt")
                .help("set `input` to the table that the track was made from"));
        }
        let [lat, lon, alt] = columns(track.unwrap_or(batch), PLACE)?;
        let spread = track.map(|track| columns(track, SPREAD)).transpose()?;
        let mag = floats(batch, &self.mag)?;
        let diurnal = match self.removes_diurnal(&TableShape::from_schema(&batch.schema())) {
            true => Some(floats(batch, DIURNAL)?),
            false => None,
        };
        let core = match (self.core_field, self.decimal_year) {
            (false, _) => None,
            (true, Some(year)) => Some(year),
            (true, None) => Some(first_year(batch)?),
        };
        let core = core.map(CoreField::at).transpose().map_err(data)?;
        let added_m2 = self.position_sigma_m.powi(2);
        let one = |row: usize| -> Option<AnomalyMeasurement> {
            let selected = line.keep.as_ref().is_none_or(|keep| keep.get(row).copied().unwrap_or(false));
            let (lat_deg, lon_deg, alt_m) = (lat[row], lon[row], alt[row]);
            let measured_nt = mag[row] - diurnal.map_or(0.0, |diurnal| diurnal[row]);
            let [ee, nn, en] = spread.map_or([0.0; 3], |[n, e, ne]| [e[row].powi(2), n[row].powi(2), ne[row]]);
            let position_m2 = [ee + added_m2, nn + added_m2, en];
            let all = [lat_deg, lon_deg, alt_m, tt[row], measured_nt].into_iter().chain(position_m2);
            if !selected || !all.into_iter().all(f64::is_finite) {
                return None;
            }
            let core_nt = core.as_ref().map_or(0.0, |core| core.magnitude_nt(lat_deg, lon_deg, alt_m));
            let value_nt = measured_nt - core_nt;
            Some(AnomalyMeasurement { lat_deg, lon_deg, alt_m, tt_s: tt[row], value_nt, position_m2 })
        };
        let averaged = averaged((0..tt.len()).filter_map(one), self.interval_s);
        match averaged.is_empty() {
            true => {
                Err(Fault::data("no sample has a height, a measurement, and a position with its standard deviation"))
            }
            false => Ok(averaged),
        }
    }
}

fn columns<'a>(batch: &'a RecordBatch, names: [&str; 3]) -> Result<[&'a [f64]; 3], Fault> {
    let [a, b, c] = names;
    Ok([floats(batch, a)?, floats(batch, b)?, floats(batch, c)?])
}

/// Means of the measurements within each interval. An interval begins with a measurement. Longitudes within an interval
/// are on one side of the date line.
fn averaged(all: impl Iterator<Item = AnomalyMeasurement>, interval_s: f64) -> Vec<AnomalyMeasurement> {
    let mut groups: Vec<(AnomalyMeasurement, f64, f64)> = vec![];
    // Rounding of time stamps must not lengthen every other interval by a sample.
    let enough = interval_s * (1.0 - 1e-6);
    for next in all {
        match groups.last_mut() {
            Some((sum, count, from_s)) if next.tt_s - *from_s < enough && next.tt_s >= *from_s => {
                let turn = 360.0 * ((sum.lon_deg / *count - next.lon_deg) / 360.0).round();
                let next = AnomalyMeasurement { lon_deg: next.lon_deg + turn, ..next };
                *sum = combined(*sum, next);
                *count += 1.0;
            }
            Some(_) | None => groups.push((next, 1.0, next.tt_s)),
        }
    }
    groups.into_iter().map(|(sum, count, _)| over(sum, count)).collect()
}

fn combined(a: AnomalyMeasurement, b: AnomalyMeasurement) -> AnomalyMeasurement {
    AnomalyMeasurement {
        lat_deg: a.lat_deg + b.lat_deg,
        lon_deg: a.lon_deg + b.lon_deg,
        alt_m: a.alt_m + b.alt_m,
        tt_s: a.tt_s + b.tt_s,
        value_nt: a.value_nt + b.value_nt,
        position_m2: [0, 1, 2].map(|i: usize| a.position_m2[i] + b.position_m2[i]),
    }
}

fn over(sum: AnomalyMeasurement, count: f64) -> AnomalyMeasurement {
    AnomalyMeasurement {
        lat_deg: sum.lat_deg / count,
        lon_deg: sum.lon_deg / count,
        alt_m: sum.alt_m / count,
        tt_s: sum.tt_s / count,
        value_nt: sum.value_nt / count,
        position_m2: sum.position_m2.map(|x| x / count),
    }
}
