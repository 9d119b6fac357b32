//! Other names for the columns of a mapping, as set by `rename` in a table of a spec.

use std::{
    collections::{BTreeMap, HashSet},
    path::Path,
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_schema::{Field, Schema};
use datasets::{FlightBatch, ReadError};
use schemas::{Role, convert, describe_field, field, flight};

use super::log_reader::LogReader;

/// The log with the columns of `rename` under their new names. Values keep their units. A column that gets a standard
/// name has the role of this name, except that truth remains truth.
///
/// # Errors
/// Fails for an unknown column, for the columns flight, line and tt, for a standard name whose unit does not fit, or
/// for two columns with the same name.
pub fn renamed(mut log: LogReader, path: &Path, rename: &BTreeMap<String, String>) -> Result<LogReader, ReadError> {
    if rename.is_empty() {
        return Ok(log);
    }
    let names: Vec<&str> = log.schema.fields().iter().map(|f| f.name().as_str()).collect();
    if let Some(missing) = rename.keys().find(|name| !names.contains(&name.as_str())) {
        let what = format!("the mapping has no column `{missing}` to rename");
        return Err(ReadError::options(path, what).nearest(missing, &names));
    }
    let one = |own: &Arc<Field>| match rename.get(own.name()) {
        Some(name) => of_name(path, own, name),
        None => Ok(own.as_ref().clone()),
    };
    let fields: Vec<Field> = log.schema.fields().iter().map(one).collect::<Result<_, _>>()?;
    let mut seen = HashSet::new();
    if let Some(twice) = fields.iter().find(|f| !seen.insert(f.name().as_str())) {
        let fault = ReadError::options(path, "two columns would have this name").in_column(twice.name());
        return Err(fault.help("choose another name in `rename`"));
    }
    let schema = Arc::new(Schema::new(fields));
    let (to, path) = (schema.clone(), path.to_path_buf());
    log.parts = Box::new(log.parts.map(move |part| {
        let FlightBatch { batch, faults } = part?;
        let batch = RecordBatch::try_new(to.clone(), batch.columns().to_vec());
        Ok(FlightBatch { batch: batch.map_err(|e| ReadError::data(&path, e.to_string()))?, faults })
    }));
    Ok(LogReader { schema, ..log })
}

/// The field `own` under the name `name`.
fn of_name(path: &Path, own: &Field, name: &str) -> Result<Field, ReadError> {
    let fixed = |name: &str| flight::KEYS.contains(&name) || name == "tt";
    if fixed(own.name()) || fixed(name) {
        let what = format!("`{}` cannot be renamed to `{name}` after a mapping", own.name());
        let help = "set flight, line and time in the mapping";
        return Err(ReadError::options(path, what).in_column(own.name()).help(help));
    }
    let (column, known) = (describe_field(own), flight::describe(name));
    if !known.unit.is_empty() && convert(&column.unit, known.unit).is_none() {
        let unit = if column.unit.is_empty() { "no unit".to_owned() } else { format!("the unit {}", column.unit) };
        let what = format!("the mapping gives {unit}, but `{name}` must be in {}", known.unit);
        let help = "choose another name, or set the unit in the mapping";
        return Err(ReadError::options(path, what).in_column(own.name()).help(help));
    }
    let is_known = !known.unit.is_empty() || flight::COLUMNS.iter().any(|(listed, _)| *listed == name);
    let role = if is_known && column.role != Role::Truth { known.role } else { column.role };
    let description = if is_known { known.description } else { column.doc.as_str() };
    let renamed = field(name, own.data_type().clone(), &column.unit, role, description);
    Ok(renamed.with_nullable(own.is_nullable()))
}
