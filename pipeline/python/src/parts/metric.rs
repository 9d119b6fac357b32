//! A metric of `score`, written in Python.

use numpy::PyArray1;
use pyo3::{prelude::*, types::PyDict};
use schemas::{
    Fault,
    metric::{Metric, MetricDisplay, MetricPreference, PoolingRule},
};
use serde::Deserialize;
use stages::score::{SampleStatistic, ScoreFn, ScoreLine, ScoreSource, Scorer};

use super::{
    PartDecl, PartHead,
    call::{broken, in_python},
    params::leaked,
};

/// Position of the metrics written in Python among the columns of pooled scores: after the built-in ones.
const PLACE: u16 = 60_000;
/// Weight of these columns.
const WEIGHT: u16 = 45;

/// Pooling over lines.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Pool {
    Rms,
    Mean,
    Sum,
}

/// Preferred values.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Better {
    Lower,
    Higher,
    Neither,
    Near(f64),
}

/// Declaration of a metric.
#[derive(Debug, Deserialize)]
pub struct MetricDecl {
    #[serde(flatten)]
    head: PartDecl,
    unit: String,
    pool: Pool,
    better: Better,
    /// Names of the arguments.
    needs: Vec<String>,
}

/// A registered metric.
pub struct MetricPart {
    pub head: PartHead,
    pub scorer: &'static Scorer,
}

/// An argument of a metric.
#[derive(Clone, Copy)]
enum Argument {
    Time,
    /// Signal minus truth.
    Error,
    /// North error of the track; `East` is the east error.
    North,
    East,
    Source(ScoreSource),
}

impl Argument {
    fn new(name: &str) -> Argument {
        match name {
            "tt" => Argument::Time,
            "error" => Argument::Error,
            "north_m" => Argument::North,
            "east_m" => Argument::East,
            "signal" => Argument::Source(ScoreSource::Signal),
            "truth" => Argument::Source(ScoreSource::Truth),
            "aircraft" => Argument::Source(ScoreSource::Aircraft),
            other => Argument::Source(ScoreSource::Column(leaked(other))),
        }
    }

    fn needs(self) -> Vec<ScoreSource> {
        match self {
            Argument::Time => vec![],
            Argument::Error => vec![ScoreSource::Signal, ScoreSource::Truth],
            Argument::North | Argument::East => vec![ScoreSource::Track, ScoreSource::Position],
            Argument::Source(source) => vec![source],
        }
    }

    fn values(self, line: &ScoreLine) -> Result<Vec<f64>, Fault> {
        Ok(match self {
            Argument::Time => line.tt()?.to_vec(),
            Argument::Error => {
                let (signal, truth) = (line.column(ScoreSource::Signal)?, line.column(ScoreSource::Truth)?);
                signal.iter().zip(truth).map(|(signal, truth)| signal - truth).collect()
            }
            Argument::North => line.track_error()?.north_m.clone(),
            Argument::East => line.track_error()?.east_m.clone(),
            Argument::Source(source) => line.column(source)?.to_vec(),
        })
    }
}

impl MetricPart {
    /// The metric of a declaration. `run` is called with the arguments by name.
    ///
    /// # Errors
    /// Fails if the metric has parameters or no arguments.
    pub fn new(decl: MetricDecl, run: Py<PyAny>) -> Result<MetricPart, String> {
        let MetricDecl { head, unit, pool, better, needs } = decl;
        let head = PartHead::new(head, run)?;
        if !head.params.is_empty() {
            return Err(format!("the metric `{}` has parameters, but a metric has only inputs", head.name));
        }
        let arguments: Vec<(&'static str, Argument)> =
            needs.iter().map(|name| (leaked(name), Argument::new(name))).collect();
        let mut sources: Vec<ScoreSource> = vec![];
        for source in arguments.iter().flat_map(|(_, argument)| argument.needs()) {
            if !sources.contains(&source) {
                sources.push(source);
            }
        }
        if sources.is_empty() {
            return Err(format!("the metric `{}` needs at least one input, such as `signal` or `error`", head.name));
        }
        let (name, run) = (head.name, Python::attach(|py| head.run.clone_ref(py)));
        let score: &'static ScoreFn = Box::leak(Box::new(move |line: &ScoreLine| score(name, &run, &arguments, line)));
        let metric = Metric {
            name,
            unit: leaked(&unit),
            meaning: head.doc,
            pool: match pool {
                Pool::Rms => PoolingRule::Rms,
                Pool::Mean => PoolingRule::Mean,
                Pool::Sum => PoolingRule::Sum,
            },
            better: match better {
                Better::Lower => MetricPreference::Lower,
                Better::Higher => MetricPreference::Higher,
                Better::Neither => MetricPreference::Neither,
                Better::Near(target) => MetricPreference::Near(target),
            },
            shown: MetricDisplay::column(PLACE, WEIGHT),
            baseline: None,
            limit: None,
        };
        let (version, source) = (head.version, Some(head.source));
        let scorer = Scorer { metric, version, source, needs: sources.leak(), uses: &[], score, spread: None };
        Ok(MetricPart { head, scorer: Box::leak(Box::new(scorer)) })
    }
}

/// Value on a line, over the samples at which all arguments are finite.
fn score(
    name: &'static str,
    run: &Py<PyAny>,
    arguments: &[(&'static str, Argument)],
    line: &ScoreLine,
) -> Result<SampleStatistic, Fault> {
    let columns = arguments.iter().map(|(_, argument)| argument.values(line)).collect::<Result<Vec<_>, Fault>>()?;
    let rows = columns.iter().map(Vec::len).min().unwrap_or(0);
    let whole: Vec<usize> = (0..rows).filter(|&row| columns.iter().all(|column| column[row].is_finite())).collect();
    if whole.is_empty() {
        return Ok(SampleStatistic { value: f64::NAN, n: 0 });
    }
    let found = in_python(name, |py| {
        let given = PyDict::new(py);
        for ((name, _), column) in arguments.iter().zip(&columns) {
            given.set_item(name, PyArray1::from_vec(py, whole.iter().map(|&row| column[row]).collect()))?;
        }
        run.bind(py).call1((given, whole.len()))?.extract::<(f64, i64)>()
    })?;
    let n = usize::try_from(found.1).map_err(|_| broken(name, "returned a negative number of samples"))?;
    Ok(SampleStatistic { value: found.0, n })
}
