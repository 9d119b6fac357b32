//! The extension module `magline._magline`. The package `magline` in the folder `magline/` wraps its functions.
//!
//! The module sets no allocator, because an allocator may need more thread-local memory than a library that is loaded
//! at run time has.

mod attended;
mod command;
mod core_field;
mod faults;
mod filters;
mod maps;
mod metrics;
mod parts;
mod runs;
mod signal;
mod stream;
mod tables;
mod tolles_lawson;
mod views;

use pyo3::prelude::*;

#[pymodule]
fn _magline(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<tables::QueryResult>()?;
    module.add_class::<stream::FilterStream>()?;
    module.add_function(wrap_pyfunction!(command::command, module)?)?;
    module.add_function(wrap_pyfunction!(runs::check, module)?)?;
    module.add_function(wrap_pyfunction!(runs::run, module)?)?;
    module.add_function(wrap_pyfunction!(views::explain, module)?)?;
    module.add_function(wrap_pyfunction!(views::why, module)?)?;
    module.add_function(wrap_pyfunction!(views::report, module)?)?;
    module.add_function(wrap_pyfunction!(tables::sql, module)?)?;
    module.add_function(wrap_pyfunction!(tables::tables, module)?)?;
    module.add_function(wrap_pyfunction!(tables::table_parts, module)?)?;
    module.add_function(wrap_pyfunction!(core_field::core_field, module)?)?;
    module.add_function(wrap_pyfunction!(filters::navigate, module)?)?;
    module.add_function(wrap_pyfunction!(maps::open_map, module)?)?;
    module.add_function(wrap_pyfunction!(maps::upward, module)?)?;
    module.add_function(wrap_pyfunction!(maps::vector, module)?)?;
    module.add_function(wrap_pyfunction!(signal::bandpass, module)?)?;
    module.add_function(wrap_pyfunction!(tolles_lawson::a_matrix, module)?)?;
    module.add_function(wrap_pyfunction!(tolles_lawson::fit, module)?)?;
    module.add_function(wrap_pyfunction!(tolles_lawson::predict, module)?)?;
    module.add_function(wrap_pyfunction!(tolles_lawson::term_names, module)?)?;
    parts::register_types(module)?;
    metrics::register(module)
}
