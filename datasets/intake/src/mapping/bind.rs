//! A table of a mapping bound to the columns of one file. Every name, unit and expression is checked before a row is
//! read.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, cast::AsArray};
use arrow_cast::cast;
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use schemas::{Fault, canonical::identifier, field, flight};

use super::{
    clock::UtcInstant,
    columns::{ColumnRecipe, MappingColumns, SqlExpression, as_numbers, column, numbers},
    document::{KeyDecl, TableDecl},
    make::{ColumnRecipes, one_column, one_quaternion, one_vector, others},
    position::one_position,
    time::TableClock,
    vector::roll_pitch_yaw_deg,
};

/// Source of the flight or line identifier.
#[derive(Clone, Debug)]
pub enum KeySource {
    /// One text for all rows.
    Constant(String),
    /// A column.
    Column(usize),
    /// An expression.
    Sql(SqlExpression),
}

/// Mapping table bound to the columns of a file.
#[derive(Clone, Debug)]
pub struct MappingBinding {
    /// Fields of the output: flight, line, tt, the date if known, and the other columns.
    pub schema: SchemaRef,
    /// Sources of the flight and of the line.
    pub keys: [KeySource; 2],
    /// The clock.
    pub time: TableClock,
    /// The condition on rows.
    pub rows: Option<SqlExpression>,
    /// Notes for the user.
    pub notes: Vec<String>,
    outputs: Vec<ColumnRecipe>,
}

/// Flight and line from the table of a spec or the command line.
#[derive(Clone, Copy, Debug, Default)]
pub struct GivenKeys<'a> {
    /// The flight.
    pub flight: Option<&'a str>,
    /// The line.
    pub line: Option<&'a str>,
    /// The name of the file without its extension.
    pub stem: &'a str,
}

impl MappingBinding {
    /// Binds the table `decl` to the columns of a file. Faults are added to `columns`.
    pub fn new(
        decl: &TableDecl,
        columns: &mut MappingColumns,
        given: GivenKeys,
        epoch: Option<UtcInstant>,
    ) -> Option<MappingBinding> {
        let flight = key(decl, "flight", (decl.flight.as_ref(), given.flight, given.stem), columns);
        let line = key(decl, "line", (decl.line.as_ref(), given.line, given.stem), columns);
        let time = TableClock::new(&decl.time, columns, epoch);
        let rows = decl.head.value.rows.as_ref().and_then(|sql| {
            let sql = columns.expression(sql, decl.head.at("rows"))?;
            if sql.value.data_type() != &DataType::Boolean {
                let what = format!(
                    "`rows` must be true or false for each row, but this expression gives {}",
                    sql.value.data_type()
                );
                columns.push(Fault::new(what).at(sql.at.clone()));
                return None;
            }
            Some(sql)
        });
        let mut made = ColumnRecipes::default();
        if time.as_ref().is_some_and(TableClock::is_dated) {
            for name in ["year", "doy"] {
                let known = flight::describe(name);
                let date = field(name, DataType::Int64, known.unit, known.role, known.description);
                made.fields.push((date, decl.time.at.clone()));
            }
        }
        for (name, column) in &decl.columns {
            one_column(name, column, columns, &mut made);
        }
        for (name, vector) in &decl.vectors {
            one_vector(name, vector, columns, &mut made);
        }
        for quaternion in &decl.quaternions {
            one_quaternion(quaternion, columns, &mut made);
        }
        if let Some(position) = &decl.projected {
            one_position(position, columns, &mut made);
        }
        if decl.head.value.others {
            others(decl, columns, &mut made);
        }
        if made.outputs.is_empty() && columns.faults.is_empty() {
            let fault = Fault::new(format!("the table `{}` has no columns except its time", decl.name));
            columns.push(fault.help("add `columns`, `vectors` or `others = true`").at(decl.head.at.clone()));
        }
        let mut fields: Vec<Field> = flight::KEYS.iter().map(|name| key_field(name)).collect();
        for (one, at) in made.fields {
            if fields.iter().any(|f| f.name() == one.name()) {
                let what = format!("two columns of the table `{}` have the name `{}`", decl.name, one.name());
                columns.push(Fault::new(what).at(at));
            }
            fields.push(one);
        }
        let keys = [flight?, line?];
        let schema = Arc::new(Schema::new(fields));
        Some(MappingBinding { schema, keys, time: time?, rows, notes: made.notes, outputs: made.outputs })
    }

    /// Columns of some rows of the file, except keys, time and date.
    ///
    /// # Errors
    /// Fails if an expression cannot be evaluated.
    pub fn columns(&self, batch: &RecordBatch) -> Result<Vec<ArrayRef>, Fault> {
        let mut out: Vec<ArrayRef> = vec![];
        for output in &self.outputs {
            match output {
                ColumnRecipe::AsItIs(at) => out.push(column(batch, *at)?.clone()),
                ColumnRecipe::AsGiven(sql) => out.push(sql.evaluate(batch)?),
                ColumnRecipe::Linear { numbers, scale, offset } => {
                    let values = numbers.read(batch)?.into_iter().map(|x| scale * x + offset);
                    out.push(Arc::new(values.collect::<Float64Array>()));
                }
                ColumnRecipe::Number(x) => out.push(Arc::new(Float64Array::from(vec![*x; batch.num_rows()]))),
                ColumnRecipe::Whole(x) => out.push(Arc::new(Int64Array::from(vec![*x; batch.num_rows()]))),
                ColumnRecipe::Text(text) => {
                    out.push(Arc::new(StringArray::from(vec![text.as_str(); batch.num_rows()])))
                }
                ColumnRecipe::Vector { numbers, scale, offset, mounting } => {
                    let [x, y, z] = numbers.as_ref();
                    let own = [x.read(batch)?, y.read(batch)?, z.read(batch)?];
                    let rows = own[0].iter().zip(&own[1]).zip(&own[2]);
                    let body: Vec<[f64; 3]> = rows
                        .map(|((x, y), z)| {
                            let v = [x, y, z];
                            mounting.apply(std::array::from_fn(|i| scale[i] * v[i] + offset[i]))
                        })
                        .collect();
                    out.extend(axes_of(&body));
                }
                ColumnRecipe::Quaternion { at: [a, b, c, d], order, frames } => {
                    let of = |at: &usize| numbers(batch, *at);
                    let (a, b, c, d) = (of(a)?, of(b)?, of(c)?, of(d)?);
                    let rows = a.iter().zip(&b).zip(&c).zip(&d);
                    let angles: Vec<[f64; 3]> =
                        rows.map(|(((a, b), c), d)| roll_pitch_yaw_deg([*a, *b, *c, *d], *order, *frames)).collect();
                    out.extend(axes_of(&angles));
                }
                ColumnRecipe::Projected { at: [easting, northing], position } => {
                    let places = position.degrees(&numbers(batch, *easting)?, &numbers(batch, *northing)?)?;
                    out.extend(places.map(|degrees| Arc::new(Float64Array::from(degrees)) as ArrayRef));
                }
            }
        }
        Ok(out)
    }

    /// Whether the condition on rows holds for each row of the file; `None` without a condition.
    ///
    /// # Errors
    /// Fails if the condition cannot be evaluated.
    pub fn kept(&self, batch: &RecordBatch) -> Result<Option<Vec<bool>>, Fault> {
        let Some(sql) = &self.rows else { return Ok(None) };
        let mask = sql.evaluate(batch)?;
        let mask: &BooleanArray =
            mask.as_boolean_opt().ok_or_else(|| Fault::bug("`rows` did not evaluate to Boolean values"))?;
        Ok(Some(mask.iter().map(|x| x.unwrap_or(false)).collect()))
    }
}

fn axes_of(rows: &[[f64; 3]]) -> [ArrayRef; 3] {
    [0, 1, 2].map(|k| Arc::new(rows.iter().map(|v| v[k]).collect::<Float64Array>()) as ArrayRef)
}

/// The strings of a key; numbers are formatted by [`identifier`].
///
/// # Errors
/// Fails if an expression cannot be evaluated.
pub fn key_texts(source: &KeySource, batch: &RecordBatch) -> Result<StringArray, Fault> {
    let array = match source {
        KeySource::Constant(text) => return Ok(StringArray::from(vec![text.as_str(); batch.num_rows()])),
        KeySource::Column(at) => column(batch, *at)?.clone(),
        KeySource::Sql(sql) => sql.evaluate(batch)?,
    };
    let kind = match array.data_type() {
        DataType::Dictionary(_, value) => value.as_ref().clone(),
        other => other.clone(),
    };
    if kind.is_floating() {
        let numbers = as_numbers(&array)?;
        return Ok(numbers.iter().map(|x| (!x.is_nan()).then(|| identifier(*x))).collect());
    }
    let text = cast(&array, &DataType::Utf8).map_err(|e| Fault::data(e.to_string()))?;
    Ok(text.as_string::<i32>().clone())
}

fn key_field(name: &str) -> Field {
    let known = flight::describe(name);
    let kind = if name == "tt" { DataType::Float64 } else { DataType::Utf8 };
    field(name, kind, known.unit, known.role, known.description)
}

fn key(
    decl: &TableDecl,
    name: &str,
    (declared, given, stem): (Option<&KeyDecl>, Option<&str>, &str),
    columns: &mut MappingColumns,
) -> Option<KeySource> {
    if let Some(given) = given {
        return Some(KeySource::Constant(given.to_owned()));
    }
    let of = match declared {
        Some(KeyDecl::Constant(text)) => return Some(KeySource::Constant(text.clone())),
        Some(KeyDecl::Of(of)) => of,
        None => {
            let fault = Fault::new(format!("the mapping has no {name} for the table `{}`", decl.name));
            let help = format!("set `{name}` in the table of the spec, on the command line or in the mapping");
            columns.push(fault.help(help).at(decl.head.at.clone()));
            return None;
        }
    };
    match (&of.value.from, &of.value.sql, of.value.of_file) {
        (Some(from), None, false) => columns.find(from, of.at("from")).map(KeySource::Column),
        (None, Some(sql), false) => columns.expression(sql, of.at("sql")).map(KeySource::Sql),
        (None, None, true) => Some(KeySource::Constant(stem.to_owned())),
        _ => {
            let fault = Fault::new(format!("`{name}` requires exactly one of `from`, `sql` and `of_file`"));
            columns.push(fault.at(of.at.clone()));
            None
        }
    }
}

/// The date columns of some rows.
pub fn whole(values: Vec<Option<i64>>) -> ArrayRef {
    Arc::new(Int64Array::from(values))
}
