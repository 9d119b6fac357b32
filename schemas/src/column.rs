//! Columns: type, unit, role and description.

use std::{collections::HashMap, fmt};

use arrow_schema::{DataType, Field, Schema};

use crate::{ColumnList, CorrectionSet, Fault, MagneticCorrection, RateDependence, removed};

/// Permitted use of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Names a flight, a line or a sweep point.
    Key,
    /// Time of the sample.
    Time,
    /// Truth that is unavailable on an operational flight: a target or reference, never a feature.
    Truth,
    /// Measurement on the aircraft.
    Sensor,
    /// Any other column.
    Aux,
    /// Made by a stage.
    Derived,
}

impl Role {
    /// The word in the field metadata.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::Key => "key",
            Role::Time => "time",
            Role::Truth => "truth",
            Role::Sensor => "sensor",
            Role::Aux => "aux",
            Role::Derived => "derived",
        }
    }

    fn parse(word: &str) -> Option<Role> {
        [Role::Key, Role::Time, Role::Truth, Role::Sensor, Role::Aux, Role::Derived]
            .into_iter()
            .find(|r| r.as_str() == word)
    }
}

/// Unit, role and meaning of a column with a fixed name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColumnDescription {
    /// Canonical unit; empty for none.
    pub unit: &'static str,
    /// Permitted use.
    pub role: Role,
    /// Meaning.
    pub description: &'static str,
}

/// The Arrow field of a column: nullable, with `unit`, `role` and `description` in its metadata.
pub fn field(name: &str, data_type: DataType, unit: &str, role: Role, description: &str) -> Field {
    let metadata = [("unit", unit), ("role", role.as_str()), ("description", description)];
    let metadata: HashMap<_, _> = metadata.into_iter().map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
    Field::new(name, data_type, true).with_metadata(metadata)
}

/// The type of a column's values, as far as stages distinguish types.
#[derive(Clone, Debug, PartialEq)]
pub enum ColumnType {
    /// Float64; NaN means missing.
    Float,
    /// A fixed-size list of Float64 with named entries.
    List(Vec<String>),
    /// UTF-8 text.
    Text,
    /// Any other Arrow type, kept as it is.
    Other(DataType),
}

impl ColumnType {
    /// The Arrow type.
    pub fn data_type(&self) -> DataType {
        match self {
            ColumnType::Float => DataType::Float64,
            ColumnType::Text => DataType::Utf8,
            ColumnType::Other(t) => t.clone(),
            ColumnType::List(terms) => {
                let width = i32::try_from(terms.len()).unwrap_or(i32::MAX);
                DataType::FixedSizeList(Field::new("item", DataType::Float64, false).into(), width)
            }
        }
    }
}

/// One column of a table in the plan: its name, type, unit, role, and lineage.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// The name.
    pub name: String,
    /// The type.
    pub column_type: ColumnType,
    /// The unit; empty for none.
    pub unit: String,
    /// Permitted use.
    pub role: Role,
    /// Meaning.
    pub doc: String,
    /// Source columns: (position of the input, column name).
    pub from: Vec<(usize, String)>,
    /// The entries of a list that depend on the sample rate.
    pub sampling: RateDependence,
    /// Corrections applied to a magnetic reading.
    pub removed: CorrectionSet,
    /// Correction that is applied to a reading by subtracting this column.
    pub correction: Option<MagneticCorrection>,
}

impl Column {
    /// A derived Float64 column.
    pub fn float(name: impl Into<String>, unit: impl Into<String>, doc: impl Into<String>) -> Self {
        let name = name.into();
        Self {
            correction: MagneticCorrection::by_column(&name),
            name,
            column_type: ColumnType::Float,
            unit: unit.into(),
            role: Role::Derived,
            doc: doc.into(),
            from: vec![],
            sampling: RateDependence::default(),
            removed: CorrectionSet::new(),
        }
    }

    /// A derived text column.
    pub fn text(name: impl Into<String>, doc: impl Into<String>) -> Self {
        Self { column_type: ColumnType::Text, ..Self::float(name, "", doc) }
    }

    /// A derived integer column.
    pub fn integer(name: impl Into<String>, unit: impl Into<String>, doc: impl Into<String>) -> Self {
        Self { column_type: ColumnType::Other(DataType::Int64), ..Self::float(name, unit, doc) }
    }

    /// A derived fixed-size list of Float64 with the entries `terms`. Names such as `xx_dot` and `a_lag_3` mark entries
    /// that depend on the sample rate; [`Column::sampling`] can override them.
    pub fn list(name: impl Into<String>, unit: impl Into<String>, doc: impl Into<String>, terms: Vec<String>) -> Self {
        let sampling = RateDependence::of_names(&terms);
        Self { column_type: ColumnType::List(terms), sampling, ..Self::float(name, unit, doc) }
    }

    /// Adds lineage: columns of the input at position `input`.
    pub fn from<S: AsRef<str>>(mut self, input: usize, columns: &[S]) -> Self {
        self.from.extend(columns.iter().map(|c| (input, c.as_ref().to_owned())));
        self
    }

    /// Sets the role.
    pub fn role(mut self, role: Role) -> Self {
        self.role = role;
        self
    }

    /// Sets the corrections that were applied.
    pub fn without(mut self, removed: CorrectionSet) -> Self {
        self.removed = removed;
        self
    }

    /// The Arrow field, with `terms`, `per_sample` and `rate_hz` in the metadata of a list, and `removed` if not empty.
    pub fn field(&self) -> Field {
        let plain = field(&self.name, self.column_type.data_type(), &self.unit, self.role, &self.doc);
        let mut metadata = plain.metadata().clone();
        if let ColumnType::List(terms) = &self.column_type {
            metadata.insert("terms".to_owned(), terms.join(","));
            self.sampling.write(terms, &mut metadata);
        }
        removed::write(&self.name, &self.removed, self.correction, &mut metadata);
        plain.with_metadata(metadata)
    }
}

/// The column that an Arrow field with the contract's metadata describes.
pub fn describe_field(field: &Field) -> Column {
    let get = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
    let column_type = match field.data_type() {
        DataType::Float64 => ColumnType::Float,
        DataType::Utf8 => ColumnType::Text,
        DataType::FixedSizeList(item, _) if item.data_type() == &DataType::Float64 => {
            ColumnType::List(get("terms").split(',').map(str::to_owned).collect())
        }
        other => ColumnType::Other(other.clone()),
    };
    let role = Role::parse(&get("role")).unwrap_or(Role::Aux);
    let sampling = match &column_type {
        ColumnType::List(terms) => RateDependence::read(terms, field.metadata()),
        _ => RateDependence::default(),
    };
    let removed = removed::read(field.name(), field.metadata());
    let correction = removed::correction(field.name(), field.metadata());
    let (name, unit, doc) = (field.name().clone(), get("unit"), get("description"));
    Column { name, column_type, unit, role, doc, from: vec![], sampling, removed, correction }
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.name)?;
        let width = if let ColumnType::List(terms) = &self.column_type { Some(terms.len()) } else { None };
        match (self.unit.as_str(), width) {
            ("", None) => Ok(()),
            (unit, None) => write!(f, " [{unit}]"),
            (unit, Some(n)) => write!(f, " [{unit}; {n}]"),
        }
    }
}

/// Columns of a table in the plan, and its sample rate if known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableShape {
    /// The columns in the table's order.
    pub columns: ColumnList,
    /// Sample rate, in Hz, if an upstream stage made the sampling even.
    pub rate_hz: Option<f64>,
}

impl TableShape {
    /// The shape of a table with an Arrow schema, at an unknown rate.
    pub fn from_schema(schema: &Schema) -> TableShape {
        TableShape { columns: schema.fields().iter().map(|field| describe_field(field)).collect(), rate_hz: None }
    }

    /// The column `name`, if the table has it.
    pub fn get(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|c| c.name == name)
    }

    /// The column `name`.
    ///
    /// # Errors
    /// Fails if there is no such column; the fault suggests the nearest.
    pub fn need(&self, name: &str) -> Result<&Column, Fault> {
        self.get(name).ok_or_else(|| {
            let have: Vec<&str> = self.columns.iter().map(|c| c.name.as_str()).collect();
            Fault::new(format!("there is no column `{name}`")).nearest(name, &have)
        })
    }

    /// The Float64 column `name` in `unit`.
    ///
    /// # Errors
    /// Fails if it is missing, not numeric, or in another unit.
    pub fn number(&self, name: &str, unit: &str) -> Result<&Column, Fault> {
        let column = self.need(name)?;
        if column.column_type != ColumnType::Float {
            let kind = column.column_type.data_type();
            return Err(Fault::new(format!("column `{name}` must be Float64, not {kind}")));
        }
        if !column.unit.is_empty() && column.unit != unit {
            let have = &column.unit;
            return Err(Fault::new(format!("column `{name}` is in {have}, but {unit} is needed")));
        }
        Ok(column)
    }
}
