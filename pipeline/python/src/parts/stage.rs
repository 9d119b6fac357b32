//! A stage of flight lines, written in Python.

use std::sync::Arc;

use arrow_array::{ArrayRef, FixedSizeListArray, Float64Array, StringArray};
use arrow_schema::{DataType, Field};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use schemas::{
    AnyStage, ChoiceRegistry, Column, ColumnType, CorrectionSet, Fault, Grain, InputDecl, InputKind, LineInput,
    LineOutput, LineStage, ParamDoc, ParamReader, Params, Role, SpecEntries, Stage, StageEntry, StageSchema, Table,
    TableKind, TableShape, flight,
};
use serde::Deserialize;

use super::{
    PartDecl, PartHead,
    call::{broken, in_python},
    line::Line,
    params::{PartValues, leaked},
};

/// Key of the source's hash, which is listed among the parameters of a result.
const SOURCE: &str = "source";

/// A column that a stage reads.
#[derive(Debug, Deserialize)]
struct ReadColumn {
    name: String,
    /// `None` for any unit.
    unit: Option<String>,
}

/// A column that a stage makes.
#[derive(Debug, Deserialize)]
struct MadeColumn {
    name: String,
    unit: String,
    doc: String,
    /// Names of the entries of a list column.
    terms: Option<Vec<String>>,
    /// Whether the column holds text.
    text: bool,
}

/// Declaration of a stage.
#[derive(Debug, Deserialize)]
pub struct StageDecl {
    #[serde(flatten)]
    head: PartDecl,
    reads: Vec<ReadColumn>,
    makes: Vec<MadeColumn>,
}

/// A registered stage.
pub struct StagePart {
    pub head: PartHead,
    reads: Vec<ReadColumn>,
    makes: Vec<MadeColumn>,
    example: &'static str,
}

impl StagePart {
    /// The stage of a declaration. `run` is called with a line, the parameters and the names of the columns to make.
    ///
    /// # Errors
    /// Fails if a default is invalid.
    pub fn new(decl: StageDecl, run: Py<PyAny>) -> Result<StagePart, String> {
        let StageDecl { head, reads, makes } = decl;
        let head = PartHead::new(head, run)?;
        let name = head.name;
        let example = leaked(&format!("\n[[stages]]\nname  = \"{name}\"\nstage = \"{name}\"\ninput = \"flights\"\n"));
        Ok(StagePart { head, reads, makes, example })
    }

    /// The entry of the stage in the catalogue.
    pub fn entry(&'static self) -> StageEntry {
        let build = |part: &'static StagePart, args: &SpecEntries| -> Result<AnyStage, Vec<Fault>> {
            let lists = ChoiceRegistry::default();
            let mut reader = ParamReader::new(part.head.name, args, None, &lists);
            let values = PartValues::read(&part.head.params, &mut reader);
            let known: Vec<&str> = part.head.params.iter().map(|param| param.name).collect();
            reader.unknown_keys(&known, &["input"]);
            let faults = reader.into_faults();
            match values {
                Some(values) if faults.is_empty() => Ok(AnyStage::Line(Arc::new(PythonStage { part, values }))),
                Some(_) | None => Err(faults),
            }
        };
        StageEntry {
            name: self.head.name,
            version: self.head.version,
            grain: Grain::Line,
            yields: TableKind::Lines,
            role: None,
            inputs: &[InputDecl { name: "input", kind: InputKind::Lines, optional: false }],
            doc: self.head.doc.to_owned(),
            example: self.example,
            kinds: vec![],
            metrics: vec![],
            params: self.head.documents(),
            build: Arc::new(move |args| build(self, args)),
        }
    }
}

/// A stage with its parameters.
#[derive(Clone)]
pub struct PythonStage {
    part: &'static StagePart,
    values: PartValues,
}

impl Params for PythonStage {
    fn read(reader: &mut ParamReader, _: Option<&Self>) -> Option<Self> {
        reader.push(Fault::bug("only the catalogue entry of a stage written in Python can read its parameters"));
        None
    }

    fn docs(_: &ChoiceRegistry) -> Vec<ParamDoc> {
        vec![]
    }

    fn spell(&self, out: &mut Vec<(&'static str, String)>) {
        self.values.spell(out);
        out.push((SOURCE, self.part.head.source.to_owned()));
    }

    fn check(&self) -> Result<(), Fault> {
        Ok(())
    }
}

impl PythonStage {
    /// Names of the columns that the stage reads; the error holds the faults of the input table.
    fn reads(&self, shape: &TableShape) -> Result<Vec<String>, Vec<Fault>> {
        let (mut names, mut faults) = (vec![], vec![]);
        for read in &self.part.reads {
            for name in self.values.expand(&read.name).map_err(|fault| vec![fault])? {
                let needed = match &read.unit {
                    Some(unit) => needed(shape, &name, unit),
                    None => shape.need(&name).map(|_| ()),
                };
                faults.extend(needed.err());
                if !names.contains(&name) {
                    names.push(name);
                }
            }
        }
        if faults.is_empty() { Ok(names) } else { Err(faults) }
    }

    /// Columns that the stage makes from the columns `reads`.
    fn made(&self, shape: &TableShape, reads: &[String]) -> Result<Vec<Column>, Fault> {
        let sources: Vec<&Column> = reads.iter().filter_map(|name| shape.get(name)).collect();
        let role = if sources.iter().any(|column| column.role == Role::Truth) { Role::Truth } else { Role::Derived };
        let magnetic = sources.iter().filter(|column| column.unit == "nT").map(|column| &column.removed);
        let removed: CorrectionSet = magnetic.flatten().copied().collect();
        // A constant column has as many rows as the line.
        let from: Vec<&str> = if reads.is_empty() { vec!["tt"] } else { reads.iter().map(String::as_str).collect() };
        let mut columns: Vec<Column> = vec![];
        for made in &self.part.makes {
            for name in self.values.expand(&made.name)? {
                check_made(&name, &made.unit)?;
                if columns.iter().any(|column| column.name == name) {
                    return Err(Fault::new(format!("`{}` makes the column `{name}` twice", self.part.head.name)));
                }
                let column = match (&made.terms, made.text) {
                    (Some(terms), _) => Column::list(name, &made.unit, &made.doc, terms.clone()),
                    (None, true) => Column::text(name, &made.doc),
                    (None, false) => Column::float(name, &made.unit, &made.doc),
                };
                let removed = if made.unit == "nT" { removed.clone() } else { CorrectionSet::new() };
                columns.push(column.role(role).from(0, &from).without(removed));
            }
        }
        Ok(columns)
    }
}

/// Checks the name and unit of a column that a stage makes.
fn check_made(name: &str, unit: &str) -> Result<(), Fault> {
    if flight::KEYS.contains(&name) {
        return Err(Fault::new(format!("`{name}` is a key of every line and cannot be made by a stage")));
    }
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
    if name.is_empty() || !name.chars().all(word) {
        let what = format!("`{name}` is not a valid column name; use letters, digits, `_` and `.`");
        return Err(Fault::new(what));
    }
    let known = flight::describe(name).unit;
    if !known.is_empty() && known != unit {
        let given = if unit.is_empty() { "no unit" } else { unit };
        let fault = Fault::new(format!("the column `{name}` is in {known}, but the stage declares {given}"));
        return Err(fault.help(format!("convert the values to {known}, and declare {known} in `makes`")));
    }
    Ok(())
}

/// Checks that a table has the column `name` in `unit`.
fn needed(shape: &TableShape, name: &str, unit: &str) -> Result<(), Fault> {
    let column = shape.need(name)?;
    if matches!(column.column_type, ColumnType::List(_) | ColumnType::Text) {
        let other = !column.unit.is_empty() && column.unit != unit;
        let what = || format!("column `{name}` is in {}, but {unit} is needed", column.unit);
        return if other { Err(Fault::new(what())) } else { Ok(()) };
    }
    shape.number(name, unit).map(|_| ())
}

impl Stage for PythonStage {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape =
            inputs.first().map(|table| table.shape()).ok_or_else(|| vec![Fault::bug("a stage has no input")])?;
        let reads = self.reads(shape)?;
        let columns = self.made(shape, &reads).map_err(|fault| vec![fault])?;
        let reads: Vec<String> = if reads.is_empty() { vec!["tt".to_owned()] } else { reads };
        Ok(StageSchema::append(columns, &reads))
    }
}

impl LineStage for PythonStage {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let (name, rows) = (self.part.head.name, line.inputs.first().map_or(0, |batch| batch.num_rows()));
        let shape = line.inputs.first().map(|batch| TableShape::from_schema(&batch.schema())).unwrap_or_default();
        let columns = self.made(&shape, &[])?;
        let made = in_python(name, |py| {
            let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
            let arguments: Bound<'_, PyDict> = self.values.arguments(py)?;
            let made = self.part.head.run.bind(py).call1((Line::new(line), arguments, names))?;
            let made = made.cast_into::<PyList>()?;
            made.iter().map(|column| Values::read(&column)).collect::<PyResult<Vec<Values>>>()
        })?;
        columns.iter().zip(made).map(|(column, values)| values.array(name, column, rows)).collect()
    }
}

/// Numbers as an array. An infinity is a missing value.
fn numbers(values: Vec<f64>) -> ArrayRef {
    let known = |x: f64| if x.is_finite() { x } else { f64::NAN };
    Arc::new(Float64Array::from_iter_values(values.into_iter().map(known)))
}

/// Values of a column, copied from Python.
enum Values {
    Numbers(Vec<f64>),
    /// Row-major values and the number of columns.
    Matrix(Vec<f64>, usize),
    Texts(Vec<Option<String>>),
}

impl Values {
    fn read(value: &Bound<'_, PyAny>) -> PyResult<Values> {
        if let Ok(list) = value.cast::<PyList>() {
            return Ok(Values::Texts(list.extract()?));
        }
        if let Ok(matrix) = value.extract::<PyReadonlyArray2<'_, f64>>() {
            return Ok(Values::Matrix(matrix.as_slice()?.to_vec(), matrix.shape()[1]));
        }
        let numbers: PyReadonlyArray1<'_, f64> = value.extract()?;
        Ok(Values::Numbers(numbers.as_slice()?.to_vec()))
    }

    /// The array of a declared column of a line with `rows` samples.
    fn array(self, stage: &str, column: &Column, rows: usize) -> Result<ArrayRef, Fault> {
        let count = |given: usize| {
            let what = format!("returned {given} values for {rows} samples");
            if given == rows { Ok(()) } else { Err(broken(stage, &what).in_column(&column.name)) }
        };
        match (self, &column.column_type) {
            (Values::Numbers(values), ColumnType::Float) => {
                count(values.len())?;
                Ok(numbers(values))
            }
            (Values::Matrix(values, width), ColumnType::List(terms)) if width == terms.len() => {
                count(values.len() / width.max(1))?;
                let item = Arc::new(Field::new("item", DataType::Float64, false));
                let width = i32::try_from(width).map_err(|e| broken(stage, &e.to_string()))?;
                let list = FixedSizeListArray::try_new(item, width, numbers(values), None);
                Ok(Arc::new(list.map_err(|e| broken(stage, &e.to_string()))?))
            }
            (Values::Texts(texts), ColumnType::Text) => {
                count(texts.len())?;
                Ok(Arc::new(StringArray::from(texts)))
            }
            (_, wanted) => {
                let wanted = match wanted {
                    ColumnType::Float => "numbers, one per sample".to_owned(),
                    ColumnType::Text => "a list of text".to_owned(),
                    ColumnType::List(terms) => format!("a matrix of {} columns", terms.len()),
                    ColumnType::Other(other) => other.to_string(),
                };
                Err(broken(stage, &format!("must return {wanted}")).in_column(&column.name))
            }
        }
    }
}
