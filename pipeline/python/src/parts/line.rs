//! One flight line as a Python object. Columns of numbers are NumPy views of the run's own memory.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, Float64Array, RecordBatch, StructArray, cast::AsArray, ffi::to_ffi, types::Float64Type,
};
use arrow_schema::ffi::FFI_ArrowSchema;
use pyo3::{
    exceptions::{PyKeyError, PyTypeError},
    prelude::*,
    types::{PyCapsule, PyDict},
};
use schemas::{ColumnType, LineInput, describe_field};

use crate::faults::value_error;

/// A flight line: the columns that a stage declares, in time order. ``line["tt"]`` is a NumPy array that shares the
/// memory of the run and is read-only; a list column has one row per sample. A text column is a list of text.
#[pyclass(frozen, module = "magline", name = "Line")]
pub struct Line {
    batch: RecordBatch,
    /// Flight identifier.
    #[pyo3(get)]
    flight: String,
    /// Line identifier.
    #[pyo3(get)]
    line: String,
}

impl Line {
    /// The first input of a line stage.
    pub fn new(input: &LineInput) -> Line {
        let batch = input.inputs.first().cloned();
        let batch = batch.unwrap_or_else(|| RecordBatch::new_empty(arrow_schema::Schema::empty().into()));
        Line { batch, flight: input.flight.clone(), line: input.line.clone() }
    }
}

#[pymethods]
impl Line {
    /// Number of samples.
    fn __len__(&self) -> usize {
        self.batch.num_rows()
    }

    fn __contains__(&self, name: &str) -> bool {
        self.batch.column_by_name(name).is_some()
    }

    fn __repr__(&self) -> String {
        format!("<magline.Line {}/{}: {} samples of {:?}>", self.flight, self.line, self.__len__(), self.columns())
    }

    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.batch.schema_ref().fields().iter().map(|field| field.name().clone()).collect()
    }

    /// Units of the columns, by name; empty for none.
    #[getter]
    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let units = PyDict::new(py);
        for field in self.batch.schema_ref().fields() {
            units.set_item(field.name(), describe_field(field).unit)?;
        }
        Ok(units)
    }

    /// Names of the entries of a list column, such as the terms of `tl`.
    fn terms(&self, name: &str) -> PyResult<Vec<String>> {
        match self.batch.schema_ref().field_with_name(name).map(|field| describe_field(field).column_type) {
            Ok(ColumnType::List(terms)) => Ok(terms),
            Ok(_) => Err(PyTypeError::new_err(format!("the column `{name}` is not a list"))),
            Err(_) => Err(self.missing(name)),
        }
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let array = self.batch.column_by_name(name).ok_or_else(|| self.missing(name))?;
        if let Some(texts) = array.as_string_opt::<i32>() {
            return texts.iter().collect::<Vec<Option<&str>>>().into_pyobject(py).map(Bound::into_any);
        }
        let view = ColumnView::new(name, array)?;
        py.import("numpy")?.call_method1("asarray", (view,))
    }

    /// Capsules of Arrow's C data interface: schema and array of all columns, without a copy. `requested_schema` has no
    /// effect.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_array__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyCapsule>, Bound<'py, PyCapsule>)> {
        let _ = requested_schema;
        let data = StructArray::from(self.batch.clone()).into_data();
        let (array, _) = to_ffi(&data).map_err(value_error)?;
        Ok((self.__arrow_c_schema__(py)?, PyCapsule::new_with_value(py, array, c"arrow_array")?))
    }

    /// Capsule of the Arrow C schema.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.batch.schema_ref().as_ref()).map_err(value_error)?;
        PyCapsule::new_with_value(py, schema, c"arrow_schema")
    }
}

impl Line {
    fn missing(&self, name: &str) -> PyErr {
        let known = self.columns().join(", ");
        PyKeyError::new_err(format!("the line has no column `{name}`; declare it in `reads` (known here: {known})"))
    }
}

/// Numbers of a column, which NumPy reads through `__array_interface__`. The array keeps a reference to this object and
/// thus to the memory.
#[pyclass(frozen, module = "magline._magline")]
pub struct ColumnView {
    values: ArrayRef,
    rows: usize,
    /// Number of entries of a row of a list column.
    width: Option<usize>,
    /// Position of the first value.
    start: usize,
}

impl ColumnView {
    fn new(name: &str, array: &ArrayRef) -> PyResult<ColumnView> {
        let other =
            || PyTypeError::new_err(format!("the column `{name}` has no Float64 values; read it through Arrow"));
        let rows = array.len();
        let (values, width, start) = match array.as_fixed_size_list_opt() {
            Some(list) => {
                let width = usize::try_from(list.value_length()).map_err(value_error)?;
                (list.values().clone(), Some(width), list.offset() * width)
            }
            None => (array.clone(), None, 0),
        };
        let numbers = values.as_primitive_opt::<Float64Type>().ok_or_else(other)?;
        // A missing value is NaN in columns of magline; only columns of other programs have nulls.
        let values: ArrayRef = match numbers.null_count() {
            0 => values.clone(),
            _ => Arc::new(numbers.iter().map(|x| Some(x.unwrap_or(f64::NAN))).collect::<Float64Array>()),
        };
        let end = start + rows * width.unwrap_or(1);
        if values.len() < end {
            return Err(value_error(format!("the column `{name}` is shorter than the line")));
        }
        Ok(ColumnView { values, rows, width, start })
    }
}

#[pymethods]
impl ColumnView {
    /// Address, shape and type of the numbers, read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let numbers = self.values.as_primitive::<Float64Type>();
        let address = numbers.values()[self.start..].as_ptr() as usize;
        let found = PyDict::new(py);
        found.set_item("version", 3)?;
        found.set_item("typestr", "<f8")?;
        found.set_item("data", (address, true))?;
        match self.width {
            Some(width) => found.set_item("shape", (self.rows, width))?,
            None => found.set_item("shape", (self.rows,))?,
        }
        Ok(found)
    }
}
