//! The record of an observatory or a base station.

use numerics::{
    earth::geodesy::ecef_m,
    regression::statistics::median,
    signal::resample::{ResamplePlan, SampleInterpolation},
};
use schemas::Fault;

use crate::{columns::data, dates::DAY_S};

/// The record of one station.
#[derive(Debug)]
pub struct Station {
    pub(super) name: String,
    /// Earth-centred position, in metres. `None` if the record has no position.
    pub(super) place_m: Option<[f64; 3]>,
    /// Seconds from midnight of the day [`Stations::first_day`], ascending.
    pub(super) t_s: Vec<f64>,
    pub(super) value_nt: Vec<f64>,
}

/// Stations, and the day from which their times are counted.
#[derive(Debug)]
pub struct Stations {
    pub(super) first_day: i64,
    pub(super) all: Vec<Station>,
}

/// Samples of a station from its tables: day, seconds and value.
#[derive(Default)]
pub(super) struct StationSamples {
    pub(super) place_deg: Option<(f64, f64)>,
    pub(super) rows: Vec<(i64, f64, f64)>,
}

impl Station {
    pub(super) fn new(name: String, samples: StationSamples, first_day: i64, max_gap_s: f64) -> Result<Station, Fault> {
        let second = |(day, tt, _): &(i64, f64, f64)| DAY_S * (day - first_day) as f64 + tt;
        let mut rows: Vec<(f64, f64)> = samples.rows.iter().map(|row| (second(row), row.2)).collect();
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        // A value that occurs in two overlapping files counts once.
        rows.dedup_by(|b, a| a == b);
        if let Some(pair) = rows.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let time_s = pair[0].0.rem_euclid(DAY_S);
            let what = format!(
                "the record of {name} has two values at {time_s} s of a day: {} and {} nT",
                pair[0].1, pair[1].1
            );
            return Err(Fault::data(what).help("give each station one table, without overlapping files"));
        }
        let mut steps: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        let usual_s = median(&mut steps);
        if usual_s > max_gap_s {
            let what = format!(
                "the record of {name} has a value every {usual_s} s, so every step is longer than `max_gap_s` = \
                 {max_gap_s} s"
            );
            return Err(Fault::data(what).help("raise `max_gap_s`"));
        }
        let place_m = samples.place_deg.map(|(lat, lon)| ecef_m(lat.to_radians(), lon.to_radians(), 0.0));
        let (t_s, value_nt) = rows.into_iter().unzip();
        Ok(Station { name, place_m, t_s, value_nt })
    }

    /// The values at ascending times.
    pub(super) fn at(&self, times_s: &[f64], method: SampleInterpolation, max_gap_s: f64) -> Result<Vec<f64>, Fault> {
        // The rate sets the tolerance for equal times: a millionth of a second.
        let plan =
            ResamplePlan::onto(&self.t_s, times_s.to_vec(), 1.0, max_gap_s).map_err(|e| data(e).in_column("tt"))?;
        plan.column(&self.value_nt, method).map_err(data)
    }

    /// First and last day.
    pub(super) fn span(&self) -> Option<(f64, f64)> {
        Some((*self.t_s.first()?, *self.t_s.last()?))
    }
}
