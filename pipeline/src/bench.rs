//! Benchmark `magline-bench`: scores predictions of any program on the test flight of a simulated data set with known
//! truth.
//!
//! The tasks are fixed: [`TASKS`] lists their columns, lines and metrics. A line has a score if all its samples are
//! predicted. If predictions are missing for some samples, the line fails, and so does its task.

mod flights;
mod predictions;
mod table;

use std::path::Path;

use numerics::{
    earth::EarthModel,
    regression::statistics::{self, SampleStatistic},
};
use schemas::Fault;

pub use flights::{BenchLine, data, open};
pub use predictions::Predictions;
pub use table::{as_json, as_text, write};

/// Spec of the benchmark's flights.
pub const SPEC: &str = "datasets/examples/magline-bench.synth.toml";
/// Flight that is scored.
pub const TEST_FLIGHT: &str = "3";
/// Scored lines of the test flight; its calibration box `3.01` is not scored.
pub const TEST_LINES: [&str; 2] = ["3.02", "3.03"];

/// Error measure of a column of predictions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BenchMetric {
    /// Standard deviation of prediction minus truth, in nT; the bias is ignored, because compensation does not
    /// determine it.
    StdError,
    /// Distance root mean square of two columns, latitude and longitude, in metres.
    Drms,
}

impl BenchMetric {
    /// Name in the table of results.
    pub fn name(self) -> &'static str {
        match self {
            BenchMetric::StdError => "std_error",
            BenchMetric::Drms => "drms",
        }
    }

    /// Unit.
    pub fn unit(self) -> &'static str {
        match self {
            BenchMetric::StdError => "nT",
            BenchMetric::Drms => "m",
        }
    }
}

/// A prediction task of the benchmark.
#[derive(Clone, Copy, Debug)]
pub struct BenchTask {
    /// The task.
    pub name: &'static str,
    /// Required columns of predictions.
    pub columns: &'static [&'static str],
    /// Columns of the flight with the truth.
    pub truth: &'static [&'static str],
    /// Columns of the flight that serve as the naive baseline.
    pub naive: &'static [&'static str],
    /// Metric of the task.
    pub measure: BenchMetric,
    /// Task and permitted inputs.
    pub about: &'static str,
}

macro_rules! compensate {
    ($column:literal, $naive:literal) => {
        BenchTask {
            name: "compensate",
            columns: &[$column],
            truth: &["mag_1_c"],
            naive: &[$naive],
            measure: BenchMetric::StdError,
            about: "the total field without the aircraft field, for each magnetometer",
        }
    };
}

macro_rules! navigate {
    ($name:literal, $lat:literal, $lon:literal, $about:literal) => {
        BenchTask {
            name: $name,
            columns: &[$lat, $lon],
            truth: &["lat", "lon"],
            naive: &["ins_lat", "ins_lon"],
            measure: BenchMetric::Drms,
            about: $about,
        }
    };
}

/// Tasks, one row per scored quantity.
pub const TASKS: [BenchTask; 8] = [
    compensate!("mag_1_comp", "mag_1_uc"),
    compensate!("mag_2_comp", "mag_2_uc"),
    compensate!("mag_3_comp", "mag_3_uc"),
    compensate!("mag_4_comp", "mag_4_uc"),
    compensate!("mag_5_comp", "mag_5_uc"),
    navigate!("navigate", "lat", "lon", "the position, with the map and with the calibration flights"),
    navigate!(
        "navigate_cold",
        "cold_lat",
        "cold_lon",
        "the position, with the map but without any calibration: only the cabin magnetometers, and no data from other \
         lines"
    ),
    navigate!("map_free", "free_lat", "free_lon", "the position without the map"),
];

/// Score of a prediction on one line, or on all lines.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchScore {
    /// The task.
    pub task: &'static str,
    /// Predicted columns, joined by `+`.
    pub column: String,
    /// Line; `None` for all lines together.
    pub line: Option<String>,
    /// The measure.
    pub measure: BenchMetric,
    /// Score; `None` if the scoring failed.
    pub value: Option<f64>,
    /// Score of the naive baseline.
    pub naive: f64,
    /// Number of scored samples.
    pub samples: usize,
    /// Number of samples without a prediction.
    pub missing: usize,
}

/// Scores predictions on the test lines of `flights`. Scores the tasks in `wanted`, or all tasks for which the
/// predictions have columns.
///
/// # Errors
/// Fails for unknown or missing columns, unknown samples, duplicates, missing values, or values in another unit.
pub fn score(flights: &[BenchLine], predictions: &Predictions, wanted: &[String]) -> Result<Vec<BenchScore>, Fault> {
    let tasks = chosen(predictions, wanted)?;
    let lines: Vec<&BenchLine> = flights.iter().filter(|f| TEST_LINES.contains(&f.line.as_str())).collect();
    if lines.len() != TEST_LINES.len() {
        let what = format!("the flights lack some of the lines {}", TEST_LINES.join(", "));
        return Err(
            Fault::new(what).help(format!("use the flights of {SPEC}, or simulate the same lines with another seed"))
        );
    }
    let places = predictions.places(&lines)?;
    let mut found = vec![];
    for task in tasks {
        let columns = predictions.columns(task)?;
        let mut own = vec![];
        for (line, rows) in lines.iter().zip(&places) {
            own.push(score_line(task, line, rows, &columns, predictions)?);
        }
        let all = pooled(&own);
        found.extend(own);
        found.extend(all);
    }
    Ok(found)
}

/// Tasks to score.
fn chosen(predictions: &Predictions, wanted: &[String]) -> Result<Vec<&'static BenchTask>, Fault> {
    let mut names: Vec<&str> = TASKS.iter().map(|t| t.name).collect();
    names.dedup();
    if let Some(unknown) = wanted.iter().find(|w| !names.contains(&w.as_str())) {
        return Err(Fault::new(format!("there is no task `{unknown}`")).nearest(unknown, &names));
    }
    let has = |task: &&BenchTask| task.columns.iter().any(|c| predictions.has(c));
    let asked = |task: &&BenchTask| wanted.iter().any(|w| w == task.name);
    let tasks: Vec<&BenchTask> = TASKS.iter().filter(|t| has(t) && (wanted.is_empty() || asked(t))).collect();
    let unanswered = wanted.iter().find(|w| !tasks.iter().any(|t| t.name == w.as_str()));
    if let Some(name) = unanswered.or((tasks.is_empty()).then_some(&wanted.first().cloned().unwrap_or_default())) {
        let columns: Vec<String> = TASKS
            .iter()
            .filter(|t| wanted.is_empty() || t.name == name)
            .map(|t| t.columns.iter().map(|c| format!("`{c}`")).collect::<Vec<_>>().join(" and "))
            .collect();
        let what = if name.is_empty() {
            "the predictions have no column of any task".to_owned()
        } else {
            format!("the predictions have no column of the task `{name}`")
        };
        return Err(Fault::data(what).help(format!("the columns of predictions are {}", columns.join(", "))));
    }
    Ok(tasks)
}

/// Score of a task on one line, whose samples have their predictions in `rows`.
fn score_line(
    task: &BenchTask,
    line: &BenchLine,
    rows: &[Option<usize>],
    columns: &[&[f64]],
    predictions: &Predictions,
) -> Result<BenchScore, Fault> {
    let known: Vec<(usize, usize)> =
        rows.iter().enumerate().filter_map(|(sample, row)| Some((sample, (*row)?))).collect();
    let truth = task.truth.iter().map(|c| line.column(c)).collect::<Result<Vec<_>, Fault>>()?;
    let naive = task.naive.iter().map(|c| line.column(c)).collect::<Result<Vec<_>, Fault>>()?;
    let all: Vec<(usize, usize)> = (0..rows.len()).map(|i| (i, i)).collect();
    let baseline = measured(task.measure, &truth, &naive, &all);
    let value = measured(task.measure, &truth, columns, &known);
    if task.measure == BenchMetric::Drms {
        in_radians(task, line, &truth, columns, &known, predictions)?;
    }
    constant(task, line, columns, &known, predictions)?;
    let missing = rows.len() - known.len();
    Ok(BenchScore {
        task: task.name,
        column: task.columns.join("+"),
        line: Some(line.line.clone()),
        measure: task.measure,
        value: Some(value.value).filter(|v| missing == 0 && v.is_finite()),
        naive: baseline.value,
        samples: rows.len(),
        missing,
    })
}

/// Metric of predictions against the truth. `pairs` holds the position of each sample in the truth, and of its row in
/// the predictions.
fn measured(measure: BenchMetric, truth: &[&[f64]], predicted: &[&[f64]], pairs: &[(usize, usize)]) -> SampleStatistic {
    let at = |columns: &[&[f64]], column: usize, row: usize| {
        columns.get(column).and_then(|c| c.get(row)).copied().unwrap_or(f64::NAN)
    };
    match measure {
        BenchMetric::StdError => {
            let errors: Vec<f64> = pairs.iter().map(|(i, row)| at(predicted, 0, *row) - at(truth, 0, *i)).collect();
            statistics::std(&errors)
        }
        BenchMetric::Drms => {
            let offset = |(i, row): &(usize, usize)| {
                let (from, to) =
                    ((at(truth, 0, *i), at(truth, 1, *i)), (at(predicted, 0, *row), at(predicted, 1, *row)));
                EarthModel::default().offset_ne_m(from, to, 0.0)
            };
            let (north_m, east_m): (Vec<f64>, Vec<f64>) = pairs.iter().map(offset).unzip();
            statistics::drms(&north_m, &east_m)
        }
    }
}

/// Rejects a column that is constant on a line. The standard error of a constant equals the standard deviation of the
/// truth, which may be smaller than the standard error of a real prediction.
fn constant(
    task: &BenchTask,
    line: &BenchLine,
    columns: &[&[f64]],
    pairs: &[(usize, usize)],
    predictions: &Predictions,
) -> Result<(), Fault> {
    /// Minimum number of samples for this check: fewer samples may be equal by chance.
    const LEAST: usize = 20;
    for (name, values) in task.columns.iter().zip(columns) {
        let mut there = pairs.iter().filter_map(|(_, row)| values.get(*row));
        let Some(first) = there.next().filter(|_| pairs.len() >= LEAST) else { continue };
        if there.all(|x| x == first) {
            let what = format!("the prediction is {first} in all {} rows", pairs.len());
            let fault = Fault::data(what).in_file(&predictions.file).in_line(&line.flight, &line.line);
            return Err(fault.in_column(name).help("predict each sample, or remove the column"));
        }
    }
    Ok(())
}

/// Rejects positions that match the truth if they are read as radians.
fn in_radians(
    task: &BenchTask,
    line: &BenchLine,
    truth: &[&[f64]],
    columns: &[&[f64]],
    pairs: &[(usize, usize)],
    predictions: &Predictions,
) -> Result<(), Fault> {
    /// Distance that exceeds the length of any track of the benchmark, in metres.
    const FAR_M: f64 = 200_000.0;
    let degrees: Vec<Vec<f64>> = columns.iter().map(|c| c.iter().map(|x| x.to_degrees()).collect()).collect();
    let degrees: Vec<&[f64]> = degrees.iter().map(Vec::as_slice).collect();
    let [as_given, as_radians] = [columns, &degrees].map(|c| measured(task.measure, truth, c, pairs).value);
    if as_given > FAR_M && as_radians < FAR_M {
        let what = format!("the positions of `{}` are in radians", task.columns.join("` and `"));
        return Err(Fault::data(what)
            .in_file(&predictions.file)
            .in_line(&line.flight, &line.line)
            .help("convert the positions to degrees"));
    }
    Ok(())
}

/// Score of all lines together: the root mean square over all samples; failed if a line has failed.
fn pooled(lines: &[BenchScore]) -> Option<BenchScore> {
    let first = lines.first()?;
    let samples: usize = lines.iter().map(|s| s.samples).sum();
    let mean = |of: &dyn Fn(&BenchScore) -> Option<f64>| -> Option<f64> {
        let squares = lines.iter().map(|s| Some(of(s)?.powi(2) * s.samples as f64)).sum::<Option<f64>>()?;
        Some((squares / samples as f64).sqrt())
    };
    Some(BenchScore {
        line: None,
        value: mean(&|s| s.value),
        naive: mean(&|s| Some(s.naive)).unwrap_or(f64::NAN),
        samples,
        missing: lines.iter().map(|s| s.missing).sum(),
        ..first.clone()
    })
}

/// Text of a path, for messages.
fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_failed_line_fails_its_task() {
        let line = |value: Option<f64>, samples: usize, missing: usize| BenchScore {
            task: "compensate",
            column: "mag_4_comp".into(),
            line: Some("3.02".into()),
            measure: BenchMetric::StdError,
            value,
            naive: 10.0,
            samples,
            missing,
        };
        let both = pooled(&[line(Some(3.0), 100, 0), line(Some(4.0), 300, 0)]).unwrap();
        assert!((both.value.unwrap() - ((9.0 * 100.0 + 16.0 * 300.0) / 400.0f64).sqrt()).abs() < 1e-12);
        assert_eq!((both.samples, both.missing, both.line), (400, 0, None));
        let failed = pooled(&[line(Some(3.0), 100, 0), line(None, 300, 1)]).unwrap();
        assert_eq!((failed.value, failed.missing), (None, 1));
        assert!((failed.naive - 10.0).abs() < 1e-12);
    }
}
