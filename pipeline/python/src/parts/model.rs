//! A model of `fit`, written in Python. The model is fitted to the unfiltered samples of all lines.
//!
//! Its table holds the name and source of the model, its parameters and inputs, and the state of the fitted object:
//! either numbers by name, or a pickle in base 64.

use std::{fmt, sync::Arc};

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};
use schemas::{ChoiceKeys, Fault, ParamReader};
use serde::Deserialize;
use stages::{
    fit::{
        Divisor, FitData, FitModel, FitModelDecl, FitSamples, FitSettings, KeyDocsFn, LearningResult, ModelSelection,
        PointMonitor, ReadModelFn,
    },
    trained::{ExternalModel, FieldPrediction, ForeignModel, LearnedModel, TermLookup, TermValue, term},
};

use super::{PartDecl, PartHead, call::in_python, params::PartValues, parts};

/// Declaration of a model.
#[derive(Debug, Deserialize)]
pub struct ModelDecl {
    #[serde(flatten)]
    head: PartDecl,
}

/// A registered model.
pub struct ModelPart {
    pub head: &'static PartHead,
    pub decl: &'static FitModelDecl,
}

impl ModelPart {
    /// The model of a declaration. `run` is the object `magline._calls.ModelCall` with the methods `fit`, `load` and
    /// `predict`.
    ///
    /// # Errors
    /// Fails if a default is invalid.
    pub fn new(decl: ModelDecl, run: Py<PyAny>) -> Result<ModelPart, String> {
        let head: &'static PartHead = Box::leak(Box::new(PartHead::new(decl.head, run)?));
        // A catalogue keeps using the same part, even if the part is replaced during a run.
        let docs: &'static KeyDocsFn = Box::leak(Box::new(move || head.documents()));
        let read: &'static ReadModelFn = Box::leak(Box::new(move |reader: &mut ParamReader| read_keys(head, reader)));
        let decl = FitModelDecl {
            name: head.name,
            version: head.version,
            source: Some(head.source),
            doc: Box::leak(Box::new([head.doc])),
            scaling: Divisor::None,
            intercept: true,
            made_of: FitData::Samples,
            choose: &[ModelSelection::Given],
            takes: &[],
            example: "",
            docs,
            read,
        };
        Ok(ModelPart { head, decl: Box::leak(Box::new(decl)) })
    }
}

fn read_keys(part: &'static PartHead, reader: &mut ParamReader) -> Option<ChoiceKeys<dyn FitModel>> {
    let values = PartValues::read(&part.params, reader)?;
    let mut spelt = vec![];
    values.spell(&mut spelt);
    Some(ChoiceKeys { keys: Arc::new(PythonModel { part, values }), spelt })
}

/// A model with its parameters.
struct PythonModel {
    part: &'static PartHead,
    values: PartValues,
}

impl FitModel for PythonModel {
    fn learn(&self, samples: &FitSamples, _: &FitSettings, work: &PointMonitor) -> Result<LearningResult, Fault> {
        work.report_progress("fit in Python")?;
        let lines: Vec<usize> = (0..samples.lines.len()).collect();
        let at: Vec<usize> = (0..samples.names.len()).collect();
        let (x, y) = (samples.columns(&at, &lines), samples.target(&lines));
        let of_line = samples.lines.iter().enumerate().flat_map(|(i, line)| vec![i as i64; line.y.len()]).collect();
        let name = self.part.name;
        let (parameters, state) = in_python(name, |py| {
            let (rows, width) = (y.len(), at.len());
            let x = PyArray1::from_vec(py, x).reshape([rows, width])?;
            let groups: Vec<i64> = of_line;
            let call = (
                self.values.arguments(py)?,
                x,
                PyArray1::from_vec(py, y),
                PyArray1::from_vec(py, groups),
                samples.names.to_vec(),
            );
            let found = self.part.run.bind(py).call_method1("fit", call)?;
            found.extract::<(String, Vec<(String, f64)>)>()
        })?;
        let mut terms = vec![
            term(format!("model {name}"), f64::from(self.part.version)),
            term(format!("source {}", self.part.source), 1.0),
            term(format!("parameters {parameters}"), 1.0),
        ];
        let inputs = samples.names.iter().enumerate();
        terms.extend(inputs.map(|(i, input)| term(format!("input[{}] {input}", i + 1), 1.0)));
        terms.extend(state.into_iter().map(|(name, value)| term(name, value)));
        // The model is read back from its terms, so that residuals belong to the model in the published table.
        let (names, values): (Vec<String>, Vec<f64>) = terms.into_iter().map(|t| (t.name, t.value)).unzip();
        let model = LearnedModel::Python(ForeignModel(read(&TermLookup::new(&names, &values)?)?));
        Ok(LearningResult { model, chosen: f64::NAN, curve: vec![], warning: String::new() })
    }
}

/// A fitted model.
struct PythonFitted {
    part: &'static PartHead,
    inputs: Vec<String>,
    terms: Vec<TermValue>,
    object: Py<PyAny>,
}

impl fmt::Debug for PythonFitted {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "PythonFitted({}, {:?})", self.part.name, self.inputs)
    }
}

/// Reads the model of a table.
///
/// # Errors
/// Fails if its Python code is not loaded or has changed, or the state cannot be read.
pub fn read(reading: &TermLookup) -> Result<Arc<dyn ExternalModel>, Fault> {
    let name = reading.word("model")?;
    let part = parts().models.get(name).map(|part| part.head).ok_or_else(|| {
        let what = format!("the model `{name}` is written in Python, but its file is not loaded");
        Fault::data(what).help("use `magline --parts FILE.py`, or import the module that declares it")
    })?;
    let source = reading.word("source")?;
    if source != part.source {
        let what = format!("the model `{name}` was fitted by other source code: {source}, not {}", part.source);
        return Err(Fault::data(what).help("fit the model again, or load the source code that it was fitted with"));
    }
    let parameters = reading.word("parameters")?;
    let (inputs, _) = reading.list("input")?;
    let (pickled, sizes) = reading.list("pickle")?;
    let (names, counts) = reading.list("numbers")?;
    let mut terms = vec![
        term(format!("model {name}"), reading.value("model")?),
        term(format!("source {source}"), 1.0),
        term(format!("parameters {parameters}"), 1.0),
    ];
    terms.extend(inputs.iter().enumerate().map(|(i, input)| term(format!("input[{}] {input}", i + 1), 1.0)));
    let chunks = pickled.iter().zip(&sizes).enumerate();
    terms.extend(chunks.map(|(i, (chunk, size))| term(format!("pickle[{}] {chunk}", i + 1), *size)));
    let mut numbers = vec![];
    for (i, (of, count)) in names.iter().zip(counts).enumerate() {
        let (_, values) = reading.list(&format!("state.{of}"))?;
        terms.push(term(format!("numbers[{}] {of}", i + 1), count));
        terms.extend(values.iter().enumerate().map(|(k, value)| term(format!("state.{of}[{}]", k + 1), *value)));
        numbers.push((of, values));
    }
    let object = in_python(name, |py| {
        let state = PyDict::new(py);
        for (of, values) in numbers {
            state.set_item(of, PyArray1::from_vec(py, values))?;
        }
        Ok(part.run.bind(py).call_method1("load", (parameters, pickled.concat(), state))?.unbind())
    })?;
    Ok(Arc::new(PythonFitted { part, inputs, terms, object }))
}

impl ExternalModel for PythonFitted {
    fn columns(&self) -> &[String] {
        &self.inputs
    }

    fn predict(&self, x: &[f64]) -> Result<FieldPrediction, Fault> {
        let width = self.inputs.len();
        let rows = x.len() / width.max(1);
        if rows == 0 {
            return Ok(FieldPrediction { field_nt: vec![], sigma_nt: None });
        }
        in_python(self.part.name, |py| {
            let x: Bound<'_, PyArray2<f64>> = PyArray1::from_slice(py, x).reshape([rows, width])?;
            let made = self.part.run.bind(py).call_method1("predict", (&self.object, x))?;
            type Found<'py> = (PyReadonlyArray1<'py, f64>, Option<PyReadonlyArray1<'py, f64>>);
            let (field, sigma): Found<'_> = made.extract()?;
            let sigma_nt = sigma.map(|sigma| sigma.as_slice().map(<[f64]>::to_vec)).transpose()?;
            Ok(FieldPrediction { field_nt: field.as_slice()?.to_vec(), sigma_nt })
        })
    }

    fn terms(&self) -> Vec<TermValue> {
        self.terms.clone()
    }
}
