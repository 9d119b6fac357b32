//! The map table: a regular grid, one row per node, sorted by latitude then longitude.
//!
//! Stages read a map in another coordinate system on its native grid, and interpolate between its original values. The
//! table then has northing and easting instead of latitude and longitude; field metadata describe the coordinate
//! system.
//!
//! A map that a stage yields has columns for both pairs of coordinates and for the code of the coordinate system
//! ([`made_columns`]). One table can then hold maps in several systems, such as the maps that a sweep makes at its
//! points.

use arrow_schema::{DataType, Field, Schema};

use crate::{Column, ColumnDescription, Fault, PassThroughColumns, Role, StageSchema, TableShape, choice, field};

choice! {
    /// Component of the anomaly field.
    pub enum VectorComponent {
        /// Towards true north.
        North = "north",
        /// Towards true east.
        East = "east",
        /// Down.
        Down = "down",
    }
}

/// The version of the map table's contract.
pub const VERSION: u32 = 1;

/// Columns: name, unit and meaning.
pub const COLUMNS: [(&str, ColumnDescription); 4] = [
    ("lat", ColumnDescription { unit: "deg", role: Role::Key, description: "latitude of the node, WGS-84" }),
    ("lon", ColumnDescription { unit: "deg", role: Role::Key, description: "longitude of the node, WGS-84" }),
    ("alt", ColumnDescription { unit: "m", role: Role::Aux, description: "height above the WGS-84 ellipsoid" }),
    (
        "anomaly",
        ColumnDescription { unit: "nT", role: Role::Aux, description: "total field anomaly; NaN where unknown" },
    ),
];

/// Column of a map with the standard deviation of each node's error, in nT. A map has this column if its source gives
/// the errors.
pub const ERROR: &str = "error";

/// The quantity [`ERROR`] as a column.
pub fn error_column() -> Column {
    Column::float(ERROR, ANOMALY_UNIT, "standard deviation of the anomaly's error")
}

/// The shape of every map.
pub fn shape() -> TableShape {
    let columns = COLUMNS.iter().map(|(name, d)| Column::float(*name, d.unit, d.description).role(d.role));
    TableShape { columns: columns.collect(), rate_hz: None }
}

/// The shape of a map that gives the error of each node.
pub fn shape_with_error() -> TableShape {
    let mut shape = shape();
    shape.columns.push(error_column());
    shape
}

/// Columns, in order, of every map that a stage yields. A stage may add further columns.
pub const MADE_COLUMNS: [&str; 7] = ["lat", "lon", "alt", "anomaly", "easting", "northing", "epsg"];

/// The unit of the anomaly.
pub const ANOMALY_UNIT: &str = "nT";

/// The columns of a map that a stage yields: [`COLUMNS`], then the node on the native grid. Nodes are listed in rows
/// from south to north, each row from west to east. `easting` and `northing` are in the unit of the coordinate system
/// `epsg`; both are null for a map in latitude and longitude. `unit` is the unit of the column `anomaly`; it differs
/// from nT for a derivative.
pub fn made_columns(unit: &str) -> Vec<Column> {
    let mut columns: Vec<Column> = shape().columns.iter().cloned().collect();
    for column in columns.iter_mut().filter(|c| c.name == "anomaly") {
        if unit != ANOMALY_UNIT {
            column.doc = "derivative of the total field anomaly; NaN where unknown".to_owned();
        }
        column.unit = unit.to_owned();
    }
    let own = |name: &str, doc: &str| Column::float(name, "", doc).role(Role::Key);
    columns.push(own("easting", "easting in the map's coordinate system; null for a map in latitude and longitude"));
    columns.push(own("northing", "northing in the map's coordinate system; null for a map in latitude and longitude"));
    columns.push(Column::integer("epsg", "", "EPSG code of the map's coordinate system").role(Role::Key));
    columns
}

/// The yield of a stage that makes a map from the columns `reads` of each of its inputs, with values in `unit`.
pub fn yields(unit: &str, reads: Vec<Vec<String>>) -> StageSchema {
    let among = |names: &[String], wanted: &[&str]| -> Vec<String> {
        names.iter().filter(|n| wanted.contains(&n.as_str())).cloned().collect()
    };
    let from = |column: Column| {
        reads.iter().enumerate().fold(column, |c, (i, names)| match c.name.as_str() {
            "anomaly" => c.from(i, names),
            "alt" => c.from(i, &among(names, &["alt"])),
            _ => c.from(i, &among(names, &["lat", "lon"])),
        })
    };
    StageSchema {
        columns: made_columns(unit).into_iter().map(from).collect(),
        passes: PassThroughColumns::None,
        reads,
        rate_hz: None,
        features: vec![],
        lenient: false,
        notes: vec![],
    }
}

/// The columns of a map on its native grid, in the unit of its coordinate system.
pub const OWN_COLUMNS: [&str; 4] = ["northing", "easting", "alt", "anomaly"];

/// Metadata of the fields `northing` and `easting` of a map on its native grid, in addition to unit, role and
/// description.
#[derive(Clone, Debug, PartialEq)]
pub struct NativeGrid {
    /// The EPSG code of the coordinate system.
    pub epsg: u16,
    /// Definition as a PROJ string.
    pub definition: String,
    /// Metres per unit of easting and of northing.
    pub unit_m: [f64; 2],
    /// Southern and northern edges of an area that contains the map, in WGS-84 degrees.
    pub lat_deg: [f64; 2],
    /// Western and eastern edges; they may exceed 180.
    pub lon_deg: [f64; 2],
}

impl NativeGrid {
    /// The fields of the table.
    pub fn fields(&self) -> Vec<Field> {
        let of = |name: &str, unit: &str, text: &str| field(name, DataType::Float64, unit, Role::Key, text);
        let places = ["northing of the node", "easting of the node"];
        let mut fields: Vec<Field> = OWN_COLUMNS.iter().zip(places).map(|(name, text)| of(name, "", text)).collect();
        for (field, (unit_m, ends)) in
            fields.iter_mut().zip([(self.unit_m[1], self.lat_deg), (self.unit_m[0], self.lon_deg)])
        {
            // Numbers are written so that reading them restores every bit.
            let more = [
                ("epsg", self.epsg.to_string()),
                ("definition", self.definition.clone()),
                ("unit_m", unit_m.to_string()),
                ("from_deg", ends[0].to_string()),
                ("to_deg", ends[1].to_string()),
            ];
            let mut metadata = field.metadata().clone();
            metadata.extend(more.map(|(key, value)| (key.to_owned(), value)));
            field.set_metadata(metadata);
        }
        fields.extend(shape().columns.iter().filter(|c| OWN_COLUMNS.contains(&c.name.as_str())).map(Column::field));
        fields
    }

    /// The native grid in a map's table; `None` for a map in latitude and longitude.
    ///
    /// # Errors
    /// Fails for incomplete or non-numeric metadata.
    pub fn from_schema(schema: &Schema) -> Result<Option<NativeGrid>, Fault> {
        let [Ok(northing), Ok(easting)] = ["northing", "easting"].map(|name| schema.field_with_name(name)) else {
            return Ok(None);
        };
        let text = |field: &Field, key: &str| {
            let wrong = || Fault::machine(format!("the map's metadata do not contain `{key}`")).in_column(field.name());
            field.metadata().get(key).cloned().ok_or_else(wrong)
        };
        let number = |field: &Field, key: &str| {
            let value: String = text(field, key)?;
            let wrong = || {
                Fault::machine(format!("`{key}` in the map's metadata must be a number, not `{value}`"))
                    .in_column(field.name())
            };
            value.parse::<f64>().map_err(|_| wrong())
        };
        let ends =
            |field: &Field| -> Result<[f64; 2], Fault> { Ok([number(field, "from_deg")?, number(field, "to_deg")?]) };
        let code = text(northing, "epsg")?;
        Ok(Some(NativeGrid {
            epsg: code.parse().map_err(|_| {
                Fault::machine(format!("`epsg` in the map's metadata must be an EPSG code, not `{code}`"))
            })?,
            definition: text(northing, "definition")?,
            unit_m: [number(easting, "unit_m")?, number(northing, "unit_m")?],
            lat_deg: ends(northing)?,
            lon_deg: ends(easting)?,
        }))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn unit_native_grid_metadata_read_back_bit_identically() {
        let own = NativeGrid {
            epsg: 32754,
            definition: "+proj=utm +zone=54 +south".to_owned(),
            unit_m: [0.1 + 0.2, 1.0 / 3.0],
            lat_deg: [-22.123_456_789_012_345, -21.1],
            lon_deg: [179.9, 181.3],
        };
        let schema = Schema::new(own.fields());
        let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
        assert_eq!(names, OWN_COLUMNS);
        assert_eq!(NativeGrid::from_schema(&schema).unwrap().unwrap(), own);
        let geographic: Vec<Field> = shape().columns.iter().map(Column::field).collect();
        assert_eq!(NativeGrid::from_schema(&Schema::new(geographic)).unwrap(), None);
        let bare: Vec<Field> =
            schema.fields().iter().map(|f| f.as_ref().clone().with_metadata(Default::default())).collect();
        assert!(NativeGrid::from_schema(&Schema::new(bare)).unwrap_err().to_string().contains("`epsg`"));
    }
}
