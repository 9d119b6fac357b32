//! Lines to score, for tests of the metrics.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use numerics::regression::statistics::SampleStatistic;
use schemas::{ChoiceList, ChoiceSubset, LineInput, Role, TableShape};

use super::{Score, line::ScoreLine, metric::Scorer, metrics::SCORERS, source::ScoreSourceIndex};

/// The columns of a table.
pub type ScoreTestColumns = Vec<(&'static str, Vec<f64>)>;

/// True latitude and longitude. In the table, the names of these columns have no prefix `true`, and the columns have
/// the role truth.
pub const TRUE_POSITION: [&str; 2] = ["true lat", "true lon"];

/// Every metric, for `mag_c` against `mag_1_c`.
pub fn score() -> Score {
    Score {
        truth: Some("mag_1_c".into()),
        metrics: ChoiceSubset::new(kinds(), None),
        mag: "mag_c".into(),
        low_hz: 0.1,
        high_hz: 0.4,
        order: 4,
        map_sigma_nt: 5.0,
    }
}

fn kinds() -> Arc<ChoiceList<Scorer>> {
    Arc::new(ChoiceList::new(SCORERS.to_vec()))
}

/// The metric with this name only.
pub fn only(name: &str) -> ChoiceSubset<Scorer> {
    ChoiceSubset::new(kinds(), Some(vec![kinds().find(name).unwrap()]))
}

/// Values of a function of time at `n` samples, one per second.
pub fn seconds(n: u32, f: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..n).map(|k| f(f64::from(k))).collect()
}

/// A track of these positions, with a standard deviation of 10 m in each direction and updates that repeat every ten
/// samples. In every five samples, one has a used and one a rejected GNSS position.
pub fn track(lat: Vec<f64>, lon: Vec<f64>) -> ScoreTestColumns {
    let all = |value: f64| vec![value; lat.len()];
    let rest = [("alt", 300.0), ("sd_n", 10.0), ("sd_e", 10.0), ("cov_ne", 0.0), ("nis", 0.5)];
    let rest: ScoreTestColumns = rest.into_iter().map(|(name, value)| (name, all(value))).collect();
    [("lat", lat.clone()), ("lon", lon)].into_iter().chain(rest).collect()
}

/// A line with these tables. Times are added to every table, and the outcomes of measurements to the table of a track.
pub fn line(tables: &[ScoreTestColumns]) -> LineInput {
    let inputs = tables.iter().map(batch).collect();
    LineInput { flight: "1".into(), line: "1.01".into(), inputs, keep: None }
}

fn batch(columns: &ScoreTestColumns) -> RecordBatch {
    let rows = columns[0].1.len();
    let mut fields = vec![schemas::field("tt", DataType::Float64, "s", Role::Derived, "")];
    let mut arrays: Vec<ArrayRef> = vec![Arc::new(Float64Array::from_iter_values((0..rows).map(|k| k as f64)))];
    for (name, values) in columns {
        let (name, role) = name.strip_prefix("true ").map_or((*name, Role::Derived), |name| (name, Role::Truth));
        fields.push(schemas::field(name, DataType::Float64, "", role, ""));
        arrays.push(Arc::new(Float64Array::from(values.clone())));
    }
    if columns.iter().any(|(name, _)| *name == "nis") {
        let updates = ["used", "missing", "off_map", "gated", "used", "missing", "off_map", "gated", "used", "flat"];
        fields.push(Field::new("update", DataType::Utf8, true));
        arrays.push(Arc::new((0..rows).map(|k| Some(updates[k % updates.len()])).collect::<StringArray>()));
        let gnss = |k: usize| Some(["used", "none", "none", "none", "rejected"][k % 5]);
        fields.push(Field::new("gnss_update", DataType::Utf8, true));
        arrays.push(Arc::new((0..rows).map(gnss).collect::<StringArray>()));
    }
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// The shapes of the tables of a line.
pub fn shapes(line: &LineInput) -> Vec<TableShape> {
    line.inputs.iter().map(|b| TableShape::from_schema(&b.schema())).collect()
}

/// Value of one metric for these tables.
pub fn value(scorer: &Scorer, tables: &[ScoreTestColumns]) -> SampleStatistic {
    let (stage, line) = (score(), line(tables));
    let shapes = shapes(&line);
    let places = ScoreSourceIndex::find(&stage, &shapes.iter().collect::<Vec<_>>());
    (scorer.score)(&ScoreLine::new(&stage, &line, &places)).unwrap()
}
