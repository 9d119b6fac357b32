//! Another built-in mapping that fits a table: autopilots rename their columns from version to version.

use arrow_schema::Schema;
use toml::{Table, Value};

use super::READY;

/// Minimum number of columns that identify a table.
const RECOGNISABLE: usize = 3;

/// The built-in mapping with a table whose columns are all in a file.
pub(super) fn fitting(source: &Schema) -> Option<&'static str> {
    let fits = |table: &Value| {
        let columns = columns_of(table);
        columns.len() >= RECOGNISABLE && columns.iter().all(|name| source.index_of(name).is_ok())
    };
    let has = |text: &str| {
        let parsed = text.parse::<Table>().ok();
        parsed.and_then(|t| Some(t.get("tables")?.as_table()?.values().any(fits))).unwrap_or(false)
    };
    READY.iter().find(|ready| has(ready.text)).map(|ready| ready.name)
}

/// The names of a file's columns in a table of a mapping, without time columns.
fn columns_of(table: &Value) -> Vec<&str> {
    let groups = ["columns", "vectors"].into_iter().filter_map(|group| table.get(group)?.as_table());
    let sources = groups.flat_map(Table::values).filter_map(|made| made.get("from"));
    let names = sources.flat_map(|from| match from {
        Value::Array(names) => names.iter().filter_map(Value::as_str).collect(),
        other => other.as_str().into_iter().collect::<Vec<&str>>(),
    });
    names.collect()
}

#[cfg(test)]
mod tests {
    use arrow_schema::{DataType, Field};

    use super::*;

    #[test]
    fn unit_the_mapping_of_another_version_is_found_by_its_columns() {
        let schema = |names: &[&str]| {
            Schema::new(names.iter().map(|n| Field::new(*n, DataType::Float64, true)).collect::<Vec<Field>>())
        };
        let velocity = ["vel_n_m_s", "vel_e_m_s", "vel_d_m_s"];
        let new = ["latitude_deg", "longitude_deg", "altitude_ellipsoid_m", "altitude_msl_m"];
        let old = ["lat", "lon", "alt", "alt_ellipsoid"];
        assert_eq!(fitting(&schema(&[&velocity[..], &new].concat())), Some("px4_ulog_v114"));
        assert_eq!(fitting(&schema(&[&velocity[..], &old].concat())), Some("px4_ulog"));
        assert_eq!(fitting(&schema(&velocity)), None);
    }
}
