//! Names, units and keys from the options and from column names, and the flight and line that a file lacks.

use std::{collections::HashSet, path::Path, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use schemas::{Role, convert, convertible_to, describe_field, field, flight};

use super::{FlightBatch, FlightOptions, RawFlight, missing::MissingMarkers, unit_name};
use crate::ReadError;

/// Name and unit in the flight table for a column of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FlightColumnTarget {
    /// Name in the flight table.
    pub(super) name: String,
    /// The unit of the values; empty for the canonical unit.
    pub(super) unit: String,
}

/// The name and unit of a column.
///
/// `own` holds its name in the file and, if different, its name in the format; `declared` is the unit in the file. The
/// unit in the options takes precedence, then the unit in the file, then the unit in the name.
///
/// # Errors
/// Fails for a unit that does not convert to the unit of the column, or for a name whose unit contradicts the unit in
/// the file.
pub(super) fn named(
    path: &Path,
    own: &[&str],
    declared: Option<&str>,
    options: &FlightOptions,
) -> Result<FlightColumnTarget, ReadError> {
    let first = own.first().copied().unwrap_or_default();
    let renamed = own.iter().find_map(|n| options.rename.get(*n)).map(String::as_str);
    let name = renamed.or(own.last().copied()).unwrap_or_default();
    let wanted = flight::describe(name).unit;
    let done = |unit: &str| Ok(FlightColumnTarget { name: name.to_owned(), unit: unit.to_owned() });
    let declared = declared.filter(|u| !u.is_empty());
    if let Some(unit) = own.iter().find_map(|n| options.units.get(*n)) {
        let fits = wanted.is_empty() || convert(unit, wanted).is_some();
        return if fits { done(unit) } else { Err(other_unit(path, first, name, "`units` gives", unit, wanted)) };
    }
    if renamed.is_none() {
        doubted(path, name, wanted, declared)?;
        return done(&declared.map(str::to_owned).or_else(|| unit_name::kept_unit(first)).unwrap_or_default());
    }
    if wanted.is_empty() {
        return done(&declared.map(str::to_owned).or_else(|| unit_name::kept_unit(first)).unwrap_or_default());
    }
    match (declared, unit_name::unit_of_renamed(first, name, wanted)) {
        (Some(declared), _) if convert(declared, wanted).is_none() => {
            Err(other_unit(path, first, name, "the file gives", declared, wanted))
        }
        (Some(declared), Ok(Some(unit))) if convert(declared, &unit) != Some(1.0) => {
            let what = format!("its name implies `{unit}`, but the file gives `{declared}`");
            Err(ReadError::options(path, what).in_column(first).help(way_out(first, wanted)))
        }
        (Some(declared), _) => done(declared),
        (None, Ok(unit)) => done(&unit.unwrap_or_default()),
        (None, Err(unit_name::UnitNameError::Other(unit))) => {
            Err(other_unit(path, first, name, "its name implies", &unit, wanted))
        }
        (None, Err(unit_name::UnitNameError::Ambiguous(unit))) => {
            let what = format!("its name ends in `{unit}`, which may be the unit, but `{name}` must be in {wanted}");
            Err(ReadError::options(path, what).in_column(first).help(way_out(first, wanted)))
        }
    }
}

fn other_unit(path: &Path, own: &str, name: &str, who: &str, unit: &str, wanted: &str) -> ReadError {
    let what = format!("{who} `{unit}`, which does not convert to {wanted}, the unit of `{name}`");
    ReadError::options(path, what).in_column(own).help(way_out(own, wanted))
}

fn way_out(own: &str, wanted: &str) -> String {
    let known = convertible_to(wanted).join(", ");
    format!("set the unit of the values: `units = {{ {own:?} = {wanted:?} }}`; known units: {known}")
}

/// A name such as `cur_heater_mA` is a standard name, in A, but ends in mA: the unit is ambiguous.
fn doubted(path: &Path, name: &str, wanted: &str, declared: Option<&str>) -> Result<(), ReadError> {
    let listed = flight::COLUMNS.iter().any(|(known, _)| *known == name);
    let Some((_, unit)) = name.rsplit_once('_').filter(|_| !listed && !wanted.is_empty()) else { return Ok(()) };
    let in_earnest = unit.bytes().any(|b| b.is_ascii_lowercase()) && unit.bytes().any(|b| b.is_ascii_uppercase());
    match convert(unit, wanted) {
        // The file gives no unit, or the unit of the standard name.
        Some(factor) if in_earnest && factor != 1.0 && declared.is_none_or(|s| s == wanted) => {
            let what = format!("its name implies `{unit}`, but a column of this name must be in {wanted}");
            Err(ReadError::options(path, what).in_column(name).help(way_out(name, wanted)))
        }
        _ => Ok(()),
    }
}

/// Checks that every name in `units` is a name in the file, and every name in `rename` a name in the file or of a
/// derived column.
fn check_names(path: &Path, own: &[String], made: &[String], options: &FlightOptions) -> Result<(), ReadError> {
    let names: Vec<&String> = own.iter().chain(made).collect();
    if let Some(missing) = options.rename.keys().find(|k| !names.contains(k)) {
        let what = format!("there is no column `{missing}` to rename");
        return Err(ReadError::options(path, what).nearest(missing, &names));
    }
    let Some(missing) = options.units.keys().find(|k| !own.contains(k)) else { return Ok(()) };
    let fault = ReadError::options(path, format!("`units` names the column `{missing}`, which does not exist"));
    Err(match options.rename.iter().find(|(_, to)| *to == missing) {
        Some((from, _)) => fault.help(format!("use the name in the file: `{from}`")),
        None => fault.nearest(missing, own),
    })
}

/// Applies `rename`, `units`, `flight` and `line`.
///
/// # Errors
/// Fails for a renamed column that the file does not have, units that do not convert, duplicate column names, or no
/// flight or line.
pub(super) fn adopt(path: &Path, raw: RawFlight, options: &FlightOptions) -> Result<RawFlight, ReadError> {
    let names: Vec<String> = raw.schema.fields().iter().map(|f| f.name().clone()).collect();
    // A column `alt [ft]` can be renamed, and given another unit, as `alt [ft]` or as `alt`.
    let heads = names.iter().flat_map(|name| [name.as_str(), name_of_head(name)]);
    let heads: Vec<String> = heads.map(str::to_owned).collect();
    check_names(path, raw.own.as_deref().unwrap_or(&heads), &names, options)?;
    let one = |f: &Arc<Field>| match &raw.own {
        // Derived columns can also be renamed.
        Some(own) if own.contains(f.name()) => Ok(f.as_ref().clone()),
        Some(_) => Ok(options.rename.get(f.name()).map_or(f.as_ref().clone(), |to| f.as_ref().clone().with_name(to))),
        None => settled(path, f, raw.unstated, options),
    };
    let mut fields: Vec<Field> = raw.schema.fields().iter().map(one).collect::<Result<_, _>>()?;
    let keys = added_keys(path, &fields, options)?;
    let front = keys.iter().map(|(name, _)| {
        let known = flight::describe(name);
        field(name, DataType::Utf8, known.unit, known.role, known.description)
    });
    fields.splice(0..0, front);
    let mut names = HashSet::new();
    if let Some(twice) = fields.iter().find(|f| !names.insert(f.name().as_str())) {
        return Err(ReadError::options(path, "two columns would have this name").in_column(twice.name()));
    }
    let schema = Arc::new(Schema::new(fields));
    let (to, path) = (schema.clone(), path.to_path_buf());
    let raw = without_fillers(&path, raw, options);
    let parts = raw.parts.map(move |part| {
        let FlightBatch { batch, faults } = part?;
        let constant = |v: &String| Arc::new(StringArray::from(vec![v.as_str(); batch.num_rows()])) as ArrayRef;
        let columns = keys.iter().map(|(_, v)| constant(v)).chain(batch.columns().iter().cloned()).collect();
        let batch = RecordBatch::try_new(to.clone(), columns).map_err(|e| ReadError::data(&path, e.to_string()))?;
        Ok(FlightBatch { batch, faults })
    });
    Ok(RawFlight { schema, parts: Box::new(parts), ..raw })
}

/// The rows with nulls for the numbers that mark missing values, if such numbers remain.
pub(super) fn without_fillers(path: &Path, raw: RawFlight, options: &FlightOptions) -> RawFlight {
    if !raw.fillers {
        return raw;
    }
    let (missing, path) = (MissingMarkers::from_options(options), path.to_path_buf());
    let parts = raw.parts.map(move |part| {
        let FlightBatch { batch, faults } = part?;
        let columns = batch.columns().iter().map(|c| missing.nulled(c)).collect();
        let nullable =
            batch.schema().fields().iter().map(|f| f.as_ref().clone().with_nullable(true)).collect::<Vec<_>>();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(nullable)), columns);
        Ok(FlightBatch { batch: batch.map_err(|e| ReadError::data(&path, e.to_string()))?, faults })
    });
    let nullable = raw.schema.fields().iter().map(|f| f.as_ref().clone().with_nullable(true)).collect::<Vec<_>>();
    RawFlight { schema: Arc::new(Schema::new(nullable)), parts: Box::new(parts), fillers: false, ..raw }
}

/// The flight and line to add to a file without flight and line.
fn added_keys(
    path: &Path,
    fields: &[Field],
    options: &FlightOptions,
) -> Result<Vec<(&'static str, String)>, ReadError> {
    let mut added = vec![];
    for (name, given) in [("flight", &options.flight), ("line", &options.line)] {
        if fields.iter().any(|f| f.name() == name) {
            continue;
        }
        let Some(given) = given else {
            let what = format!("holds no column `{name}`");
            return Err(ReadError::data(path, what).help(format!("set `{name}`, or rename the column that holds it")));
        };
        added.push((name, given.clone()));
    }
    Ok(added)
}

/// The field of a column in the flight table; nullable, since values may be missing.
fn settled(path: &Path, source: &Field, unstated: bool, options: &FlightOptions) -> Result<Field, ReadError> {
    let metadata = source.metadata();
    let declared = metadata.get("unit").map(String::as_str).filter(|unit| !unit.is_empty());
    let head = if declared.is_none() { unit_name::split_head(source.name()) } else { None };
    let FlightColumnTarget { name, unit } = match head {
        Some((name, unit)) => of_head(path, source.name(), (name, unit), options)?,
        None => named(path, &[source.name()], declared, options)?,
    };
    let wanted = flight::describe(&name).unit;
    if unstated && unit.is_empty() && !wanted.is_empty() {
        let what = format!("the file does not give its unit, but `{name}` must be in {wanted}");
        return Err(ReadError::options(path, what).in_column(source.name()).help(way_out(source.name(), wanted)));
    }
    if name == *source.name() && metadata.get("unit").map_or("", String::as_str) == unit {
        return Ok(source.clone().with_nullable(true));
    }
    let known = flight::describe(&name);
    let unit = if unit.is_empty() { known.unit } else { &unit };
    // A role in the file applies to every name without a fixed role: truth stays truth.
    let declared = describe_field(source).role;
    let role =
        if matches!(declared, Role::Truth | Role::Sensor) && known.role == Role::Aux { declared } else { known.role };
    let own = metadata.get("description").filter(|d| name == *source.name() && !d.is_empty());
    let description = own.map_or(known.description, String::as_str);
    Ok(field(&name, source.data_type().clone(), unit, role, description))
}

/// The name and unit of a column with a header such as `alt [ft]`.
///
/// # Errors
/// Returns the errors of [`named`]. Also fails for a unit that does not convert to the unit of the name.
fn of_head(
    path: &Path,
    head: &str,
    (name, unit): (&str, &str),
    options: &FlightOptions,
) -> Result<FlightColumnTarget, ReadError> {
    let target = named(path, &[head, name], Some(unit), options)?;
    let wanted = flight::describe(&target.name).unit;
    if !wanted.is_empty() && convert(&target.unit, wanted).is_none() {
        return Err(other_unit(path, head, &target.name, "its name gives", &target.unit, wanted));
    }
    Ok(target)
}

/// The name that a header such as `alt [ft]` gives to a column; other names are unchanged.
pub fn name_of_head(head: &str) -> &str {
    unit_name::split_head(head).map_or(head, |(name, _)| name)
}

/// The unit that the end of a name implies; `None` if the end is ambiguous.
pub fn unit_of_name(name: &str) -> Option<String> {
    unit_name::kept_unit(name)
}

/// The unit of [`unit_of_name`], or an unknown string that looks like a unit. The unknown string causes an error where
/// the unit is required.
pub(super) fn any_unit_of_name(name: &str) -> Option<String> {
    unit_of_name(name).or_else(|| unit_name::unknown_unit(name))
}

/// Converts the values of a column to the unit `counted`, or to the canonical unit if `counted` is empty. Returns the
/// unit and the values.
///
/// # Errors
/// Fails for a unit that does not convert.
pub(super) fn in_counted_unit(
    path: &Path,
    own: &str,
    named: &FlightColumnTarget,
    counted: &str,
    values: Vec<f64>,
) -> Result<(String, Vec<f64>), ReadError> {
    let wanted = if counted.is_empty() { flight::describe(&named.name).unit } else { counted };
    let unit = named.unit.as_str();
    if unit.is_empty() || wanted.is_empty() {
        let unit = if unit.is_empty() { counted } else { unit };
        return Ok((unit.to_owned(), values));
    }
    let factor = convert(unit, wanted);
    // The unit converter does not have all units of the formats.
    let factor = if unit == wanted { Some(1.0) } else { factor };
    let factor = factor.ok_or_else(|| other_unit(path, own, &named.name, "the column is in", unit, wanted))?;
    let values = if factor == 1.0 { values } else { values.into_iter().map(|x| x * factor).collect() };
    Ok((wanted.to_owned(), values))
}
