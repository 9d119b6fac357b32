//! The output columns of a table of a mapping: recipe, unit and role.

use arrow_schema::{DataType, Field};
use schemas::{Fault, Role, convert, convertible_to, field, flight};

use super::{
    columns::{ColumnRecipe, MappingColumns, NumberSource, is_number, is_text},
    declare::{ColumnRole, ConstantValue, MappingColumnKeys, QuaternionKeys, VectorSensorKeys},
    document::{MappingSpan, SpannedValue, TableDecl},
    vector::{SensorMounting, read_axes},
};

/// Output columns of a mapping table, with their recipes.
#[derive(Default)]
pub(super) struct ColumnRecipes {
    /// Arrow fields of the columns, each with the column's position in the mapping.
    pub fields: Vec<(Field, MappingSpan)>,
    /// Recipes of the columns.
    pub outputs: Vec<ColumnRecipe>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Unit of the values of the column `name`, from the mapping, otherwise from the file.
fn unit_of(
    name: &str,
    unit: Option<&str>,
    declared: Option<&str>,
    at: (MappingSpan, MappingSpan),
    columns: &mut MappingColumns,
) -> Option<String> {
    let wanted = flight::describe(name).unit;
    let Some(own) = unit.or(declared) else {
        if wanted.is_empty() {
            return Some(String::new());
        }
        let what = format!(
            "the unit of `{name}` is in neither the file nor the mapping, but is needed for the conversion to {wanted}"
        );
        let known = convertible_to(wanted).join(", ");
        columns.push(Fault::new(what).help(format!("set `unit`: {known}")).at(at.0));
        return None;
    };
    if !wanted.is_empty() && convert(own, wanted).is_none() {
        let who = if unit.is_some() { "" } else { "according to the file, " };
        let what = format!("{who}`{name}` is in `{own}`, which does not convert to {wanted}");
        columns.push(Fault::new(what).nearest(own, &convertible_to(wanted)).at(at.1));
        return None;
    }
    Some(own.to_owned())
}

/// Role of the column `name`, if the name determines a role.
fn role_of(name: &str, given: Option<ColumnRole>, at: MappingSpan, columns: &mut MappingColumns) -> Role {
    let known = flight::describe(name);
    let given = given.map(|role| match role {
        ColumnRole::Truth => Role::Truth,
        ColumnRole::Sensor => Role::Sensor,
        ColumnRole::Aux => Role::Aux,
    });
    if known.description.is_empty() {
        return given.unwrap_or(known.role);
    }
    if let Some(other) = given.filter(|role| *role != known.role) {
        let what = format!("a column `{name}` has the role {}, not {}", known.role.as_str(), other.as_str());
        columns.push(Fault::new(what).help("the name determines the role; use another name").at(at));
    }
    known.role
}

fn is_key(name: &str, at: &MappingSpan, columns: &mut MappingColumns) -> bool {
    let key = flight::KEYS.contains(&name);
    if key {
        let help = if name == "tt" {
            "declare the time with the key `time`"
        } else {
            "set the key in the table itself, not in `columns`"
        };
        columns.push(Fault::new(format!("`{name}` cannot be mapped as a column")).help(help).at(at.clone()));
    }
    key
}

pub(super) fn one_column(
    name: &str,
    column: &SpannedValue<MappingColumnKeys>,
    columns: &mut MappingColumns,
    made: &mut ColumnRecipes,
) {
    if is_key(name, &column.at, columns) {
        return;
    }
    let declared = &column.value;
    let role = role_of(name, declared.role, column.at("role"), columns);
    let known = flight::describe(name);
    let linear = declared.scale != 1.0 || declared.offset != 0.0;
    let (output, kind, own_unit) = match (&declared.from, &declared.sql, &declared.value) {
        (Some(from), None, None) => {
            let Some(at) = columns.find(from, column.at("from")) else { return };
            let of_file = columns.unit_of_file(at).map(str::to_owned);
            if linear || !known.unit.is_empty() {
                let Some(at) = columns.number(from, column.at("from")) else { return };
                if linear {
                    let (scale, offset) = (declared.scale, declared.offset);
                    (
                        ColumnRecipe::Linear { numbers: NumberSource::Column(at), scale, offset },
                        DataType::Float64,
                        of_file,
                    )
                } else {
                    (ColumnRecipe::AsItIs(at), columns.source.field(at).data_type().clone(), of_file)
                }
            } else {
                (ColumnRecipe::AsItIs(at), columns.source.field(at).data_type().clone(), of_file)
            }
        }
        (None, Some(sql), None) => {
            let Some(sql) = columns.expression(sql, column.at("sql")) else { return };
            let kind = sql.value.data_type().clone();
            if (linear || !known.unit.is_empty()) && !is_number(&kind) {
                let what = format!("`{name}` requires numbers, but this expression gives {kind}");
                columns.push(Fault::new(what).at(column.at("sql")));
                return;
            }
            if linear {
                let (scale, offset) = (declared.scale, declared.offset);
                (ColumnRecipe::Linear { numbers: NumberSource::Sql(sql), scale, offset }, DataType::Float64, None)
            } else {
                (ColumnRecipe::AsGiven(sql), kind, None)
            }
        }
        (None, None, Some(ConstantValue::Number(x)))
            if matches!(name, "year" | "doy") && !linear && x.fract() == 0.0 =>
        {
            (ColumnRecipe::Whole(*x as i64), DataType::Int64, None)
        }
        (None, None, Some(ConstantValue::Number(x))) => {
            (ColumnRecipe::Number(declared.scale * x + declared.offset), DataType::Float64, None)
        }
        (None, None, Some(ConstantValue::Text(text))) => {
            if linear || !known.unit.is_empty() || matches!(name, "year" | "doy") {
                let what = format!("`{name}` is a number, not the text `{text}`");
                columns.push(Fault::new(what).at(column.at("value")));
                return;
            }
            (ColumnRecipe::Text(text.clone()), DataType::Utf8, None)
        }
        _ => {
            let fault = Fault::new(format!("`{name}` requires exactly one of `from`, `sql` and `value`"));
            columns.push(fault.at(column.at.clone()));
            return;
        }
    };
    let at = (column.at.clone(), column.at("unit"));
    let Some(unit) = unit_of(name, declared.unit.as_deref(), own_unit.as_deref(), at, columns) else { return };
    if let (Some(ours), Some(theirs)) = (&declared.unit, &own_unit)
        && convert(theirs, ours).is_some_and(|factor| factor != 1.0)
    {
        made.notes
            .push(format!("`{name}`: the unit is {theirs} in the file and {ours} in the mapping; the mapping is used"));
    }
    let description = declared.description.as_deref().unwrap_or(known.description);
    made.fields.push((field(name, kind, &unit, role, description), column.at.clone()));
    made.outputs.push(output);
}

pub(super) fn one_vector(
    name: &str,
    vector: &SpannedValue<VectorSensorKeys>,
    columns: &mut MappingColumns,
    made: &mut ColumnRecipes,
) {
    let declared = &vector.value;
    let axes = read_axes(&declared.axes);
    if axes.is_none() {
        let fault = Fault::new(format!("`axes` cannot be `{}`", declared.axes));
        let help = "give each axis of the sensor once, with its sign, such as `+x -y -z`";
        columns.push(fault.help(help).at(vector.at("axes")));
    }
    let rotation: Option<[f64; 3]> = three(&declared.rotation_deg, "rotation_deg", vector, columns);
    let offset: Option<[f64; 3]> = three(&declared.offset, "offset", vector, columns);
    let scale = match declared.scale.as_slice() {
        [one] => Some([*one; 3]),
        _ => three(&declared.scale, "scale", vector, columns),
    };
    let mut own_unit = None;
    let parts: Vec<Option<NumberSource>> = match (declared.from.as_slice(), declared.sql.as_slice()) {
        ([_, _, _], []) => {
            let found: Vec<Option<usize>> =
                declared.from.iter().map(|name| columns.number(name, vector.at("from"))).collect();
            let units: Vec<Option<&str>> = found.iter().map(|at| at.and_then(|at| columns.unit_of_file(at))).collect();
            if units.windows(2).any(|w| w[0] != w[1]) && declared.unit.is_none() {
                let what = format!("the axes of `{name}` have different units in the file");
                columns.push(Fault::new(what).help("set `unit`").at(vector.at("from")));
            }
            own_unit = units.first().copied().flatten().map(str::to_owned);
            found.into_iter().map(|at| at.map(NumberSource::Column)).collect()
        }
        ([], [_, _, _]) => {
            let each = declared.sql.iter().map(|sql| {
                let sql = columns.expression(sql, vector.at("sql"))?;
                if !is_number(sql.value.data_type()) {
                    let what =
                        format!("`{name}` requires numbers, but this expression gives {}", sql.value.data_type());
                    columns.push(Fault::new(what).at(sql.at.clone()));
                    return None;
                }
                Some(NumberSource::Sql(sql))
            });
            each.collect()
        }
        _ => {
            let fault = Fault::new(format!("`{name}` requires `from` or `sql` with three entries: x, y and z"));
            columns.push(fault.at(vector.at.clone()));
            return;
        }
    };
    let axes_names = ["x", "y", "z"].map(|axis| format!("{name}_{axis}"));
    let at = (vector.at.clone(), vector.at("unit"));
    let unit = unit_of(&axes_names[0], declared.unit.as_deref(), own_unit.as_deref(), at, columns);
    if let (Some(ours), Some(theirs)) = (&declared.unit, &own_unit)
        && convert(theirs, ours).is_some_and(|factor| factor != 1.0)
    {
        made.notes
            .push(format!("`{name}`: the unit is {theirs} in the file and {ours} in the mapping; the mapping is used"));
    }
    let role = role_of(&axes_names[0], declared.role, vector.at("role"), columns);
    let parts: Option<[NumberSource; 3]> =
        parts.into_iter().collect::<Option<Vec<_>>>().and_then(|p| p.try_into().ok());
    let (Some(axes), Some(rotation), Some(offset), Some(scale), Some(unit), Some(numbers)) =
        (axes, rotation, offset, scale, unit, parts)
    else {
        return;
    };
    let mounting = SensorMounting::new(axes, rotation);
    if mounting.is_mirror() {
        made.notes
            .push(format!("`{name}`: its axes `{}` form a left-handed frame; a sign is probably wrong", declared.axes));
    }
    for axis in &axes_names {
        let description = declared.description.as_deref().unwrap_or(flight::describe(axis).description);
        made.fields.push((field(axis, DataType::Float64, &unit, role, description), vector.at.clone()));
    }
    made.outputs.push(ColumnRecipe::Vector { numbers: Box::new(numbers), scale, offset, mounting });
}

fn three(
    list: &[f64],
    key: &str,
    vector: &SpannedValue<VectorSensorKeys>,
    columns: &mut MappingColumns,
) -> Option<[f64; 3]> {
    let found = <[f64; 3]>::try_from(list).ok();
    if found.is_none() {
        let what = format!("`{key}` requires three entries, not {}", list.len());
        columns.push(Fault::new(what).at(vector.at(key)));
    }
    found
}

pub(super) fn one_quaternion(
    quaternion: &SpannedValue<QuaternionKeys>,
    columns: &mut MappingColumns,
    made: &mut ColumnRecipes,
) {
    let QuaternionKeys { from, to, order, frames } = &quaternion.value;
    let at: Vec<Option<usize>> = from.iter().map(|name| columns.number(name, quaternion.at("from"))).collect();
    let at: Option<Vec<usize>> = at.into_iter().collect();
    let (Some(at), [_, _, _]) = (at, to.as_slice()) else {
        if to.len() != 3 {
            let what = "`to` requires the names of three columns: roll, pitch and yaw";
            columns.push(Fault::new(what).at(quaternion.at("to")));
        }
        return;
    };
    let Ok(at) = <[usize; 4]>::try_from(at) else {
        let what = format!("a quaternion has four entries, not {}", from.len());
        columns.push(Fault::new(what).at(quaternion.at("from")));
        return;
    };
    if angle_fields(to, quaternion, columns, made) {
        made.outputs.push(ColumnRecipe::Quaternion { at, order: *order, frames: *frames });
    }
}

/// Adds fields of angles in degrees, with the names in the key `to` of a table. Returns false if one of the names is a
/// key of the flight table.
pub(super) fn angle_fields<T>(
    to: &[String],
    table: &SpannedValue<T>,
    columns: &mut MappingColumns,
    made: &mut ColumnRecipes,
) -> bool {
    for name in to {
        let known = flight::describe(name);
        if is_key(name, &table.at, columns) {
            return false;
        }
        if !known.unit.is_empty() && known.unit != "deg" {
            let what = format!("`{name}` is in {}, not an angle", known.unit);
            columns.push(Fault::new(what).at(table.at("to")));
        }
        made.fields.push((field(name, DataType::Float64, "deg", known.role, known.description), table.at.clone()));
    }
    true
}

/// Adds the columns that the mapping does not name, under their names in the file.
pub(super) fn others(decl: &TableDecl, columns: &mut MappingColumns, made: &mut ColumnRecipes) {
    let named = |name: &String| {
        decl.columns.iter().any(|(_, c)| c.value.from.as_ref() == Some(name))
            || decl.vectors.iter().any(|(_, v)| v.value.from.contains(name))
            || decl.quaternions.iter().any(|q| q.value.from.contains(name))
            || decl.projected.iter().any(|p| [&p.value.easting, &p.value.northing].contains(&name))
            || decl.time.value.from.contains(name)
            || made.fields.iter().any(|(f, _)| f.name() == name)
            || flight::KEYS.contains(&name.as_str())
    };
    let rest: Vec<usize> =
        columns.source.fields().iter().enumerate().filter(|(_, f)| !named(f.name())).map(|(i, _)| i).collect();
    for at in rest {
        let source = columns.source.field(at).clone();
        let name = source.name().clone();
        let of_file = columns.unit_of_file(at).map(str::to_owned);
        let here = (decl.head.at("others"), decl.head.at("others"));
        if !flight::describe(&name).unit.is_empty() && is_text(columns.source, at) {
            let what = format!("the column `{name}` of {} contains text, not numbers", columns.place);
            columns.push(Fault::new(what).at(here.0));
            continue;
        }
        let Some(unit) = unit_of(&name, None, of_file.as_deref(), here.clone(), columns) else { continue };
        let known = flight::describe(&name);
        let own = source.metadata().get("description").map(String::as_str).filter(|d| !d.is_empty());
        let description = own.unwrap_or(known.description);
        made.fields.push((field(&name, source.data_type().clone(), &unit, known.role, description), here.0));
        made.outputs.push(ColumnRecipe::AsItIs(at));
    }
}
