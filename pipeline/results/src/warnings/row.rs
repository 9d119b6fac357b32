//! The scores of one line at one sweep point.

use std::collections::BTreeMap;

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use stages::score::{NOTE, Scorer, track};

/// The scores of one line: value and number of samples of each metric that has a value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineMetrics(BTreeMap<String, (f64, i64)>);

/// The metrics of one line's scores that could not be computed, each with the reason.
pub fn left_out(batch: &RecordBatch) -> Vec<String> {
    let text = |name: &str| batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
    let (Some(names), Some(notes)) = (text("metric"), text(NOTE)) else { return vec![] };
    let noted = (0..batch.num_rows()).filter(|i| notes.is_valid(*i));
    noted.map(|i| format!("`{}` cannot be computed: {}", names.value(i), notes.value(i))).collect()
}

impl LineMetrics {
    /// The columns that are read.
    pub const COLUMNS: [&'static str; 4] = ["metric", "value", "n", NOTE];

    /// Reads the rows of one line's scores. Values that are null or not a number are skipped; infinite values are kept.
    pub fn read(batch: &RecordBatch) -> LineMetrics {
        let names = batch.column_by_name("metric").and_then(|a| a.as_string_opt::<i32>());
        let values = batch.column_by_name("value").and_then(|a| a.as_primitive_opt::<Float64Type>());
        let n = batch.column_by_name("n").and_then(|a| a.as_primitive_opt::<Int64Type>());
        let (Some(names), Some(values), Some(n)) = (names, values, n) else { return LineMetrics::default() };
        let there = (0..batch.num_rows()).filter(|i| values.is_valid(*i) && !values.value(*i).is_nan());
        LineMetrics(there.map(|i| (names.value(i).to_owned(), (values.value(i), n.value(i)))).collect())
    }

    /// The value of a metric.
    pub fn get(&self, metric: &Scorer) -> Option<f64> {
        self.counted(metric).map(|(value, _)| value)
    }

    /// The share of measurements off the map.
    pub fn off_map(&self) -> Option<f64> {
        self.share(&track::SAMPLES_OFF_MAP)
    }

    /// Share of measurements that the gate rejects; `None` without a count of the used measurements.
    pub fn gated(&self) -> Option<f64> {
        let (gated, used) = (self.get(&track::SAMPLES_GATED)?, self.get(&track::SAMPLES_USED)?);
        Some(gated / (gated + used)).filter(|share| share.is_finite())
    }

    /// The share of measurements where the map is too flat.
    pub fn flat(&self) -> Option<f64> {
        self.share(&track::SAMPLES_FLAT)
    }

    /// The value of a metric, and its number of samples.
    pub fn counted(&self, metric: &Scorer) -> Option<(f64, i64)> {
        self.0.get(metric.metric.name).copied()
    }

    /// A number of measurements divided by the number of measurements that the filter considers. These are only a part
    /// of the samples if the errors of the samples are correlated. If the metrics do not include the number of used
    /// measurements, the divisor is the number of all samples.
    fn share(&self, metric: &Scorer) -> Option<f64> {
        let (count, n) = self.counted(metric).filter(|(_, n)| *n > 0)?;
        let others = [&track::SAMPLES_OFF_MAP, &track::SAMPLES_GATED, &track::SAMPLES_FLAT];
        let considered = self
            .get(&track::SAMPLES_USED)
            .map(|used| used + others.into_iter().filter_map(|other| self.get(other)).sum::<f64>());
        Some(count / considered.filter(|considered| *considered > 0.0).unwrap_or(n as f64))
    }
}

#[cfg(test)]
impl LineMetrics {
    /// Sets the value of a metric, computed from 100 samples.
    pub fn put(&mut self, metric: &str, value: f64) {
        self.0.insert(metric.to_owned(), (value, 100));
    }
}

#[cfg(test)]
impl<const N: usize> From<[(&str, f64); N]> for LineMetrics {
    fn from(figures: [(&str, f64); N]) -> LineMetrics {
        let mut row = LineMetrics::default();
        figures.iter().for_each(|(metric, value)| row.put(metric, *value));
        row
    }
}
