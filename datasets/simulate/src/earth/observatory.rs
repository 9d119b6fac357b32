//! A real record of an observatory as the temporal variation.

use std::path::Path;

use datasets::{ReadError, formats::ObservatoryRecord};
use nalgebra::Vector3;
use numerics::signal::natural_cubic;

/// Hours of the local day whose mean is the quiet value.
const QUIET_H: std::ops::Range<f64> = 0.0..3.0;
/// Maximum extrapolation of the spline beyond the end of a run, in seconds.
const SLACK_S: f64 = 5e-3;

/// The deviation of a record from its baseline, by time of day.
pub(super) struct ObservatoryVariation {
    name: String,
    start_tt_s: f64,
    step_s: f64,
    /// Start of each run without gaps, and the spline's coefficients at its samples.
    runs: Vec<(usize, Vec<[f64; 3]>)>,
}

impl ObservatoryVariation {
    /// Reads a record. The baseline is the mean of the record, or of the first three hours of each local day.
    ///
    /// # Errors
    /// Fails for a file that is not an observatory record, or that has no values for the baseline.
    pub(super) fn read(path: &Path, quiet_base: bool) -> Result<ObservatoryVariation, ReadError> {
        let record = datasets::formats::read_iaga2002(path)?;
        let local_h = |k: usize| (record.tt_s(k) / 3600.0 + record.lon_deg / 15.0).rem_euclid(24.0);
        let counts = |(k, v): &(usize, &[f64; 3])| known(v) && (!quiet_base || QUIET_H.contains(&local_h(*k)));
        let chosen: Vec<&[f64; 3]> = record.ned_nt.iter().enumerate().filter(counts).map(|(_, v)| v).collect();
        if chosen.is_empty() {
            let what =
                if quiet_base { "has no value in the first three hours of any local day" } else { "has no value" };
            let error = ReadError::data(path, format!("the record {what}"));
            if let Some(note) = record.notes.first() {
                return Err(error.help(note.clone()));
            }
            return Err(if quiet_base { error.help("set `observatory_base = \"mean\"`") } else { error });
        }
        let base = [0, 1, 2].map(|axis| chosen.iter().map(|v| v[axis]).sum::<f64>() / chosen.len() as f64);
        Ok(ObservatoryVariation::from_record(&record, base))
    }

    fn from_record(record: &ObservatoryRecord, base: [f64; 3]) -> ObservatoryVariation {
        let mut runs: Vec<(usize, Vec<[f64; 3]>)> = vec![];
        for (k, v) in record.ned_nt.iter().enumerate().filter(|(_, v)| known(v)) {
            let departure = [0, 1, 2].map(|axis| v[axis] - base[axis]);
            match runs.last_mut() {
                Some((start, run)) if *start + run.len() == k => run.push(departure),
                _ => runs.push((k, vec![departure])),
            }
        }
        for (_, run) in &mut runs {
            natural_cubic::solve_along_rows(run.as_flattened_mut(), 3);
        }
        ObservatoryVariation {
            name: record.station.clone(),
            start_tt_s: record.start_tt_s,
            step_s: record.step_s,
            runs,
        }
    }

    /// The variation (north, east, down; nT) at a time in seconds past midnight: the natural cubic spline through the
    /// samples of a run.
    ///
    /// # Errors
    /// Fails, with the message as text, at a time that is not between two samples of a run.
    pub(super) fn at(&self, tt_s: f64) -> Result<Vector3<f64>, String> {
        let place = (tt_s - self.start_tt_s) / self.step_s;
        let slack = SLACK_S / self.step_s;
        let run = self.runs.partition_point(|(start, _)| *start as f64 <= place + slack).checked_sub(1);
        let Some((start, run)) = run.and_then(|k| self.runs.get(k)) else { return Err(self.missing(tt_s)) };
        let (within, last) = (place - *start as f64, run.len() - 1);
        if within > last as f64 + slack {
            return Err(self.missing(tt_s));
        }
        let cell = (within.max(0.0) as usize).min(last.saturating_sub(1));
        let weights = natural_cubic::weights(within - cell as f64);
        let at = |k: usize| match k.checked_sub(1) {
            _ if last == 0 => run[0],
            None => past(run[0], run[1]),
            Some(i) if i > last => past(run[last], run[last - 1]),
            Some(i) => run[i],
        };
        let terms = weights.iter().enumerate().map(|(k, weight)| Vector3::from(at(cell + k)) * *weight);
        Ok(terms.sum())
    }

    fn missing(&self, tt_s: f64) -> String {
        let minutes = (tt_s / 60.0).floor() as i64;
        let seconds = tt_s.rem_euclid(60.0);
        let clock = format!("{:02}:{:02}:{seconds:04.1}", minutes.div_euclid(60), minutes.rem_euclid(60));
        format!("the record of the observatory {} has no value at {clock} ({tt_s:.1} s past midnight UTC)", self.name)
    }
}

fn past(end: [f64; 3], inner: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| 2.0 * end[axis] - inner[axis])
}

fn known(v: &[f64; 3]) -> bool {
    v.iter().all(|x| x.is_finite())
}
