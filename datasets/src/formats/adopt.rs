//! Settles names and keys: what the options rename, and the flight and line that a file lacks.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use schemas::{convert, field, flight};

use super::{FlightOptions, Raw};
use crate::ReadError;

/// Units that a column name may end in, longest first where one ends in another.
const SUFFIXES: [(&str, &str); 21] = [
    ("_m_s2", "m/s2"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_mgauss", "mgauss"),
    ("_gauss", "gauss"),
    ("_nt", "nT"),
    ("_ut", "uT"),
    ("_mps", "m/s"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_ft", "ft"),
    ("_km", "km"),
    ("_kn", "kn"),
    ("_ms", "ms"),
    ("_us", "us"),
    ("_ns", "ns"),
    ("_ma", "mA"),
    ("_mv", "mV"),
    ("_m", "m"),
    ("_s", "s"),
    ("_a", "A"),
];

/// Applies `rename`, `flight` and `line`.
///
/// # Errors
/// A name to change that the file does not have, two columns of one name, or no flight or line.
pub(super) fn adopt(path: &Path, raw: Raw, options: &FlightOptions) -> Result<Raw, ReadError> {
    let names: Vec<&str> = raw.schema.fields().iter().map(|f| f.name().as_str()).collect();
    if let Some(missing) = options.rename.keys().find(|k| !names.contains(&k.as_str())) {
        let what = format!("there is no column `{missing}` to rename");
        return Err(ReadError::options(path, what).nearest(missing, &names));
    }
    let mut fields: Vec<Field> = raw.schema.fields().iter().map(|f| renamed(f, options)).collect();
    let keys = added_keys(path, &fields, options)?;
    let front = keys.iter().map(|(name, _)| {
        let known = flight::describe(name);
        field(name, DataType::Utf8, known.unit, known.role, known.description)
    });
    fields.splice(0..0, front);
    for (i, one) in fields.iter().enumerate() {
        if fields.iter().take(i).any(|f| f.name() == one.name()) {
            return Err(ReadError::options(path, "two columns would have this name").in_column(one.name()));
        }
    }
    let schema = Arc::new(Schema::new(fields));
    let (to, path) = (schema.clone(), path.to_path_buf());
    let batches = raw.batches.map(move |batch| {
        let batch = batch?;
        let constant = |v: &String| Arc::new(StringArray::from(vec![v.as_str(); batch.num_rows()])) as ArrayRef;
        let columns = keys.iter().map(|(_, v)| constant(v)).chain(batch.columns().iter().cloned()).collect();
        RecordBatch::try_new(to.clone(), columns).map_err(|e| ReadError::data(&path, e.to_string()))
    });
    Ok(Raw { schema, batches: Box::new(batches) })
}

/// The flight and line to add, where the file has none.
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
            return Err(ReadError::data(path, what).help(format!("give `{name}`, or rename the column that has it")));
        };
        added.push((name, given.clone()));
    }
    Ok(added)
}

fn renamed(source: &Field, options: &FlightOptions) -> Field {
    let Some(name) = options.rename.get(source.name()) else { return source.clone() };
    let known = flight::describe(name);
    let unit = source.metadata().get("unit").filter(|u| !u.is_empty()).cloned();
    let unit = unit.or_else(|| suffix_unit(source.name(), known.unit).map(str::to_owned));
    let unit = unit.unwrap_or_else(|| known.unit.to_owned());
    field(name, source.data_type().clone(), &unit, known.role, known.description)
}

/// The unit that a column's name ends in. One letter can be anything (`flux_a`), so it counts only where
/// it converts to the unit that is wanted.
fn suffix_unit(name: &str, wanted: &str) -> Option<&'static str> {
    let lower = name.to_ascii_lowercase();
    let (suffix, unit) = SUFFIXES.iter().find(|(s, _)| lower.ends_with(s))?;
    (suffix.len() > 2 || convert(unit, wanted).is_some()).then_some(*unit)
}

/// The unit that a name says by its end, where it cannot be read otherwise.
pub(super) fn unit_of_name(name: &str) -> Option<String> {
    let long = suffix_unit(name, "").map(str::to_owned);
    long.or_else(|| name.to_ascii_lowercase().ends_with("_m").then(|| "m".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_units_at_the_end_of_names() {
        let cases = [
            ("mag_x_mgauss", Some("mgauss")),
            ("ins_lat_rad", Some("rad")),
            ("gyro_x_rad_s", Some("rad/s")),
            ("accel_m_s2", Some("m/s2")),
            ("flux_a_x_nt", Some("nT")),
            ("time_s", Some("s")),
            ("flux_a_x", None),
            ("flux_a", None),
        ];
        for (name, unit) in cases {
            let wanted = if name == "time_s" { "s" } else { "nT" };
            assert_eq!(suffix_unit(name, wanted), unit, "{name}");
        }
    }
}
