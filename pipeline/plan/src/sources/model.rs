//! A model that was fitted elsewhere: the published table of a `fit`.

use std::{fs::File, path::Path, sync::Arc};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use arrow_select::{concat::concat_batches, filter::filter_record_batch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use schemas::{Fault, Literal, Table, TableShape, casting::cast};

use super::{
    files::walk,
    options::{ModelOptions, model_options},
};
use crate::{
    predicate::Predicate,
    spec::{SourceDecl, SpecSpan},
};

/// The key that selects one model in a table of models.
const WHERE: &str = "where";
const TERM: &str = "term";
const VALUE: &str = "value";

/// The table of one model.
pub struct ModelTable {
    /// The condition that selects the model, in canonical spelling; empty without a condition.
    pub condition: String,
    /// Columns.
    pub schema: SchemaRef,
    features: Vec<String>,
}

impl ModelTable {
    /// Reads the table once to check that it holds one model.
    ///
    /// # Errors
    /// Fails for unknown options, files that are not the table of a `fit`, or several models in one table.
    pub fn open(decl: &SourceDecl, path: &Path) -> Result<ModelTable, Vec<Fault>> {
        let (condition, at, features) = options(decl)?;
        let rows = read(path, &condition).map_err(|fault| vec![fault.at(at)])?;
        Ok(ModelTable { condition, features, schema: rows.schema() })
    }

    /// A model whose rows are in the store.
    ///
    /// # Errors
    /// Fails for unknown options.
    pub fn recorded(decl: &SourceDecl, schema: SchemaRef) -> Result<ModelTable, Vec<Fault>> {
        let (condition, _, features) = options(decl)?;
        Ok(ModelTable { condition, features, schema })
    }

    /// The table of the model as stages see it.
    pub fn table(&self) -> Table {
        Table::Model { shape: TableShape::from_schema(&self.schema), features: self.features.clone() }
    }
}

/// Reads the options of a model: the condition, its position in the spec, and the features.
fn options(decl: &SourceDecl) -> Result<(String, SpecSpan, Vec<String>), Vec<Fault>> {
    let mut rest = decl.clone();
    let (condition, at) = match rest.options.remove(WHERE) {
        None => (String::new(), decl.path.1.clone()),
        Some(given) => match given.value {
            Literal::Text(text) => (text, given.at),
            _ => return Err(vec![Fault::new("`where` must be text that contains an SQL condition").at(given.at)]),
        },
    };
    let ModelOptions { features } = model_options(&rest)?;
    Ok((condition, at, features))
}

/// The rows of one model of the Parquet files at `path`, as strings, integers and floating-point numbers. A missing
/// number is NaN.
///
/// # Errors
/// Fails if a file is not Parquet, the columns of a fit are missing, the condition cannot be evaluated, or the selected
/// rows are not one model.
pub fn read(path: &Path, condition: &str) -> Result<RecordBatch, Fault> {
    let mut files = vec![];
    if path.is_dir() {
        walk(path, &mut files).map_err(|e| Fault::machine(format!("cannot read {}: {e}", path.display())))?;
        files.retain(|file| file.extension().is_some_and(|e| e == "parquet"));
    } else {
        files.push(path.to_owned());
    }
    let mut batches: Vec<RecordBatch> = vec![];
    for file in &files {
        let in_file = |f: Fault| f.in_file(&file.display().to_string());
        let wrong = |e: &dyn std::fmt::Display| in_file(Fault::data(format!("not a Parquet file: {e}")));
        let reader = File::open(file).map_err(|e| in_file(Fault::machine(e.to_string())))?;
        let reader = ParquetRecordBatchReaderBuilder::try_new(reader).map_err(|e| wrong(&e))?;
        for batch in reader.build().map_err(|e| wrong(&e))? {
            batches.push(plain(&batch.map_err(|e| wrong(&e))?).map_err(in_file)?);
        }
    }
    let Some(first) = batches.first() else {
        return Err(Fault::data(format!("{} contains no rows of a model", path.display())));
    };
    let whole = concat_batches(&first.schema(), &batches)
        .map_err(|_| Fault::data(format!("the files of {} have different columns", path.display())))?;
    let rows = selected(&whole, condition)?;
    one_model(&rows, path)?;
    Ok(rows)
}

/// Columns of a model in the types that stages accept: strings, integers and floating-point numbers.
fn plain(batch: &RecordBatch) -> Result<RecordBatch, Fault> {
    let (mut fields, mut arrays): (Vec<Field>, Vec<ArrayRef>) = (vec![], vec![]);
    for (field, array) in batch.schema().fields().iter().zip(batch.columns()) {
        let kind = match field.data_type() {
            DataType::Dictionary(_, value) => value.as_ref().clone(),
            kind => kind.clone(),
        };
        let array: ArrayRef = match kind {
            DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => cast(array, &DataType::Utf8)?,
            kind if kind.is_integer() => cast(array, &DataType::Int64)?,
            kind if kind.is_floating() => {
                let array = cast(array, &DataType::Float64)?;
                let numbers = array.as_primitive::<Float64Type>();
                Arc::new(numbers.iter().map(|x| Some(x.unwrap_or(f64::NAN))).collect::<Float64Array>())
            }
            _ => continue,
        };
        fields.push(Field::new(field.name(), array.data_type().clone(), true).with_metadata(field.metadata().clone()));
        arrays.push(array);
    }
    for (name, kind) in [(TERM, DataType::Utf8), (VALUE, DataType::Float64)] {
        if !fields.iter().any(|field| field.name() == name && *field.data_type() == kind) {
            let what = format!("the table is not made by a stage `fit`: it has no column `{name}` of {kind}");
            return Err(Fault::data(what));
        }
    }
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
}

/// The rows that the condition selects; all rows without a condition.
fn selected(batch: &RecordBatch, condition: &str) -> Result<RecordBatch, Fault> {
    if condition.is_empty() {
        return Ok(batch.clone());
    }
    let predicate = Predicate::new(condition, &TableShape::from_schema(&batch.schema()))?;
    let schema = batch.schema();
    let places: Vec<usize> = predicate.columns.iter().filter_map(|name| schema.index_of(name).ok()).collect();
    let seen = batch.project(&places).map_err(|e| Fault::machine(e.to_string()))?;
    match predicate.rows(&seen)? {
        None => Ok(batch.clone()),
        Some(mask) => filter_record_batch(batch, &mask.into()).map_err(|e| Fault::machine(e.to_string())),
    }
}

/// Rejects rows that are not exactly one model.
fn one_model(rows: &RecordBatch, path: &Path) -> Result<(), Fault> {
    let terms: Option<&StringArray> = rows.column_by_name(TERM).and_then(|terms| terms.as_string_opt());
    let terms = terms.ok_or_else(|| Fault::bug("a model without terms"))?;
    if terms.is_empty() {
        return Err(Fault::data(format!("`where` selects no row of {}", path.display())));
    }
    let mut names: Vec<&str> = terms.iter().map(Option::unwrap_or_default).collect();
    names.sort_unstable();
    if names.windows(2).any(|pair| pair[0] == pair[1]) {
        let fault = Fault::data(format!("{} contains several models", path.display()));
        return Err(fault.help("select one model by its axes, such as `where = \"mag = 'mag_4_uc'\"`"));
    }
    if names.contains(&"") {
        return Err(Fault::data(format!("a term of {} has no name", path.display())));
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use parquet::arrow::ArrowWriter;

    use super::*;

    fn write(path: &Path, terms: Vec<Option<&str>>, values: Vec<Option<f64>>, lambda: Vec<f64>) {
        let terms: ArrayRef = Arc::new(StringArray::from(terms));
        let values: ArrayRef = Arc::new(Float64Array::from(values));
        let lambda: ArrayRef = Arc::new(Float64Array::from(lambda));
        let batch = RecordBatch::try_from_iter_with_nullable([
            ("term", terms, true),
            ("value", values, true),
            ("lambda", lambda, true),
        ])
        .unwrap();
        let mut writer = ArrowWriter::try_new(File::create(path).unwrap(), batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
    }

    #[test]
    fn unit_only_a_single_model_is_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.parquet");
        write(
            &path,
            vec![Some("x"), Some("y"), Some("x"), Some("y")],
            vec![Some(1.0), None, Some(3.0), Some(4.0)],
            vec![0.0, 0.0, 0.5, 0.5],
        );
        let values = |condition: &str| -> Vec<f64> {
            let rows = read(folder.path(), condition).unwrap();
            rows.column_by_name("value").unwrap().as_primitive::<Float64Type>().values().to_vec()
        };
        assert_eq!(values("lambda = 0.5"), [3.0, 4.0]);
        let first = values("lambda < 0.1");
        assert!(first[0] == 1.0 && first[1].is_nan(), "a missing number is no zero: {first:?}");
        let why = |condition: &str| read(&path, condition).unwrap_err().what;
        assert!(why("").ends_with("contains several models"), "{}", why(""));
        assert!(why("lambda = 7").contains("selects no row of"), "{}", why("lambda = 7"));
        assert!(why("lamda = 7").contains("lamda"), "{}", why("lamda = 7"));
        write(&path, vec![Some("x"), None], vec![Some(1.0), Some(2.0)], vec![0.0; 2]);
        assert!(why("").contains("has no name"), "{}", why(""));
        std::fs::write(&path, b"PAR1 and no more").unwrap();
        assert!(why("").contains("not a Parquet file"), "{}", why(""));
    }
}
