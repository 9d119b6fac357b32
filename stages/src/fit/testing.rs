//! A small fit for the tests of models: two lines of three features with known coefficients.

use std::{
    ops::ControlFlow,
    sync::{Arc, Mutex},
};

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use schemas::{
    AnyStage, AnySurveyPoint, CheckpointMonitor, Fault, LineInput, Literal, NullMonitor, SpecEntries, SpecEntry,
};

/// Coefficients of the target.
pub const COEFFICIENTS: [f64; 3] = [12.0, -7.0, 3.5];
/// The constant in the target, in nT.
pub const INTERCEPT_NT: f64 = 40.0;
/// Rows of a line.
const ROWS: usize = 200;

/// Output of a fit.
pub struct FitOutput {
    /// The terms.
    pub term: Vec<String>,
    /// Warning about the fit.
    pub warning: String,
    /// The coefficients; an intercept is last.
    pub value: Vec<f64>,
    /// Standard deviation of each coefficient.
    pub std: Vec<f64>,
    pub residual_std: f64,
    pub chosen: f64,
    /// Number of rows used.
    pub rows: f64,
}

pub fn number(key: &str, value: f64) -> (String, Literal) {
    (key.to_owned(), Literal::Float(value))
}

pub fn whole(key: &str, value: i64) -> (String, Literal) {
    (key.to_owned(), Literal::Int(value))
}

pub fn word(key: &str, value: &str) -> (String, Literal) {
    (key.to_owned(), Literal::Text(value.to_owned()))
}

pub fn flag(key: &str, value: bool) -> (String, Literal) {
    (key.to_owned(), Literal::Bool(value))
}

pub fn words(key: &str, values: &[&str]) -> (String, Literal) {
    (key.to_owned(), Literal::List(values.iter().map(|value| Literal::Text((*value).to_owned())).collect()))
}

/// Two lines whose target is exactly the sum of the features times [`COEFFICIENTS`], plus `constant_nt`.
pub fn plain(constant_nt: f64) -> Vec<RecordBatch> {
    lines(&|_, exact| exact + constant_nt)
}

/// The [`plain`] lines with a spike of 500 nT in every twentieth row.
pub fn spiked() -> Vec<RecordBatch> {
    lines(&|row, exact| exact + INTERCEPT_NT + if row % 20 == 7 { 500.0 } else { 0.0 })
}

/// The [`plain`] lines with a nonlinear target, which no linear model fits.
pub fn bent() -> Vec<RecordBatch> {
    lines(&|_, exact| exact + INTERCEPT_NT + 15.0 * (exact / 8.0).tanh())
}

/// The first of the [`plain`] lines with a nonlinear target, on another aircraft with larger fields and another
/// constant.
pub fn another() -> Vec<RecordBatch> {
    lines(&|_, exact| 1.1 * exact + 700.0 + 17.0 * (exact / 8.0).tanh())[..1].to_vec()
}

/// The [`plain`] lines, but with a target that lags the features by half a second.
pub fn delayed() -> Vec<RecordBatch> {
    let late = |line: RecordBatch| {
        let y = line.column(1).as_primitive::<Float64Type>().values().to_vec();
        let y: ArrayRef = Arc::new((0..ROWS).map(|row| y[row.saturating_sub(5)]).collect::<Float64Array>());
        let mut columns = line.columns().to_vec();
        columns[1] = y;
        RecordBatch::try_new(line.schema(), columns).unwrap()
    };
    plain(0.0).into_iter().map(late).collect()
}

fn lines(target: &dyn Fn(usize, f64) -> f64) -> Vec<RecordBatch> {
    [0.0, 5.0].map(|phase| line(phase, target)).to_vec()
}

fn line(phase: f64, target: &dyn Fn(usize, f64) -> f64) -> RecordBatch {
    let t = |row: usize| 0.1 * row as f64;
    let features = |row: usize| {
        let t = t(row) + phase;
        [(1.3 * t).sin(), 2.0 * (0.7 * t).cos() + 0.3 * (1.3 * t).sin(), (0.41 * t).sin() + 0.2]
    };
    let exact = |row: usize| features(row).iter().zip(COEFFICIENTS).map(|(a, b)| a * b).sum::<f64>();
    let column = |of: &dyn Fn(usize) -> f64| -> ArrayRef { Arc::new((0..ROWS).map(of).collect::<Float64Array>()) };
    RecordBatch::try_from_iter([
        ("tt", column(&t)),
        ("y", column(&|row| target(row, exact(row)))),
        ("a", column(&|row| features(row)[0])),
        ("b", column(&|row| features(row)[1])),
        ("c", column(&|row| features(row)[2])),
    ])
    .unwrap()
}

/// The stage `fit` with `model` and `keys`, for the features `a`, `b` and `c`, without a filter.
pub fn stage(model: &str, keys: &[(String, Literal)]) -> Result<AnyStage, Vec<Fault>> {
    let features = Literal::List(["a", "b", "c"].map(|name| Literal::Text(name.to_owned())).to_vec());
    let usual = [word("model", model), word("target", "y"), ("features".to_owned(), features)];
    let unfiltered = [number("low_hz", 0.0), number("high_hz", 0.0), whole("trim", 0)];
    let given = usual.into_iter().chain(unfiltered).chain(keys.iter().cloned());
    let args: SpecEntries = given.map(|(name, value)| (name, SpecEntry { value, key_at: 0..0, at: 0..0 })).collect();
    (super::entry(super::MODELS.to_vec()).build)(&args)
}

/// Monitor that interrupts training after a number of progress reports and keeps the last state.
pub struct InterruptMonitor {
    after: usize,
    kept: Mutex<Option<Vec<u8>>>,
    reports: Mutex<usize>,
}

impl InterruptMonitor {
    /// Monitor that stops after `after` reports and starts from a stored state.
    pub fn after(after: usize, kept: Option<Vec<u8>>) -> Self {
        Self { after, kept: Mutex::new(kept), reports: Mutex::default() }
    }

    /// The last saved state.
    pub fn state(&self) -> Option<Vec<u8>> {
        self.kept.lock().unwrap().clone()
    }

    /// Number of progress reports.
    pub fn reports(&self) -> usize {
        *self.reports.lock().unwrap()
    }
}

impl CheckpointMonitor for InterruptMonitor {
    fn kept(&self, _: usize) -> Option<Vec<u8>> {
        self.state()
    }

    fn keep(&self, _: usize, state: &[u8]) {
        *self.kept.lock().unwrap() = Some(state.to_vec());
    }

    fn report_progress(&self, _: usize, _: &str) -> ControlFlow<()> {
        let mut reports = self.reports.lock().unwrap();
        *reports += 1;
        if *reports >= self.after { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// A fit to [`plain`] lines.
pub fn fitted(model: &str, keys: &[(String, Literal)]) -> FitOutput {
    fitted_to(&plain(INTERCEPT_NT), model, keys)
}

/// A fit to these lines.
pub fn fitted_to(lines: &[RecordBatch], model: &str, keys: &[(String, Literal)]) -> FitOutput {
    worked(lines, model, keys, &NullMonitor).unwrap()
}

/// A fit to these lines with a monitor of its state and progress.
pub fn worked(
    lines: &[RecordBatch],
    model: &str,
    keys: &[(String, Literal)],
    work: &dyn CheckpointMonitor,
) -> Result<FitOutput, Fault> {
    begun(lines, model, keys, &[], work)
}

/// A fit with a warm start from another model.
pub fn begun_with(
    first: &FitOutput,
    lines: &[RecordBatch],
    model: &str,
    keys: &[(String, Literal)],
) -> Result<FitOutput, Fault> {
    let terms: ArrayRef = Arc::new(first.term.iter().map(Some).collect::<StringArray>());
    let values: ArrayRef = Arc::new(Float64Array::from(first.value.clone()));
    let table = RecordBatch::try_from_iter([("term", terms), ("value", values)]).unwrap();
    begun(lines, model, keys, &[lines[0].slice(0, 0), table], &NullMonitor)
}

fn begun(
    lines: &[RecordBatch],
    model: &str,
    keys: &[(String, Literal)],
    inputs: &[RecordBatch],
    work: &dyn CheckpointMonitor,
) -> Result<FitOutput, Fault> {
    let stage = stage(model, keys).unwrap();
    let stage = stage.of_surveys().unwrap();
    let gather = stage.gather(&[AnySurveyPoint { stage, inputs }]).unwrap();
    let part = |(i, line): (usize, &RecordBatch)| {
        let (flight, name, inputs) = ("1".to_owned(), format!("1.{i}"), vec![line.clone()]);
        gather.map(&LineInput { flight, line: name, inputs, keep: None }).unwrap()
    };
    let table = gather.finish(lines.iter().enumerate().map(part).collect(), work)?.remove(0)?.columns;
    let column = |i: usize| table[i].as_primitive::<Float64Type>().values().to_vec();
    let rows = table[4].as_primitive::<arrow_array::types::Int64Type>().value(0);
    let text = |i: usize| table[i].as_string::<i32>().iter().map(|t| t.unwrap_or_default().to_owned()).collect();
    let (term, warnings): (Vec<String>, Vec<String>) = (text(1), text(12));
    let warning = warnings[0].clone();
    let (value, std, rows) = (column(2), column(3), rows as f64);
    Ok(FitOutput { term, warning, value, std, residual_std: column(7)[0], chosen: column(8)[0], rows })
}
