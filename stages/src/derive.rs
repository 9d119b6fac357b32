//! Columns from SQL expressions over other columns.

use std::collections::BTreeMap;

use arrow_schema::DataType;
use expressions::{Expression, ExpressionUnit};
use schemas::{
    Column, CorrectionSet, Fault, LineInput, LineOutput, LineStage, Stage, StageSchema, Table, TableShape, flight,
    stage,
};

use crate::{
    columns::{array, is_key, role_of, shape},
    corrections::of_expression,
};

stage! {
    /// Appends columns defined by SQL expressions over the columns of the same row: differences, ratios, clips
    /// (`greatest(-5, least(5, x))`), choices (`case when radar < 50 then NULL else mag_4_uc end`).
    ///
    /// Expressions may use the DataFusion functions that depend only on the row. Clocks, random numbers and other rows
    /// are not available. A missing value (NaN) is NULL in an expression. Arithmetic with a missing value gives a
    /// missing value, and a comparison with a missing value is unknown. `coalesce` and `is null` detect missing values.
    /// An infinite result, such as 1/0, becomes a missing value. A line fails if SQL rejects a value, such as the
    /// square root of a negative number. Division gives a real number, even for two integers. `greatest` and `least`
    /// return a missing value if any argument is missing.
    ///
    /// The unit is inferred for sums, differences, clips, choices and multiples of columns of one unit, and for ratios
    /// of equal units. Otherwise set it in `units`. Sums and comparisons of columns with different units are rejected.
    /// An expression can use the columns of `input` but not the other new columns. An existing column of the same name
    /// is replaced. A column computed from a truth column has the role truth.
    ///
    /// For a column in nT, the metadata entry `removed` lists the corrections already applied to the columns of the
    /// expression. It also lists `igrf` or `diurnal` if the expression subtracts it. Later stages do not repeat these
    /// corrections.
    Derive = "derive", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "derive"
stage   = "derive"
input   = "resample"
columns = { mag_d = "mag_4_uc - mag_5_uc", heading = "degrees(atan2(-flux_a_y, flux_a_x))", year = "2014", doy = "308" }
units   = { heading = "deg" }
"#;
    /// SQL expression of each new column, by column name.
    columns: BTreeMap<String, String>, unit "";
    /// Unit of each new column, by column name. Required if the unit cannot be inferred, or if a multiplication
    /// converts the unit, as in `alt * 3.28084` for metres to feet.
    units: BTreeMap<String, String>, unit "", default BTreeMap::new();
}

impl Derive {
    fn expression(name: &str, sql: &str, shape: &TableShape) -> Result<Expression, Fault> {
        let expression = Expression::new(sql, shape, &format!("`{name}`"))?;
        match &expression.data_type {
            kind if kind.is_numeric() => Ok(expression),
            DataType::Boolean => {
                let fault =
                    Fault::new(format!("the expression for `{name}` gives true or false, but a column holds numbers"));
                Err(fault.help("write `case when ... then 1 else 0 end`"))
            }
            kind => Err(Fault::new(format!("the expression for `{name}` gives {kind}, but a column holds numbers"))),
        }
    }

    fn unit(&self, name: &str, found: &ExpressionUnit) -> Result<String, Fault> {
        let given = self.units.get(name);
        let other = |unit: &String| given.filter(|given| *given != unit);
        let unit = match (found, given) {
            (ExpressionUnit::Of(unit), _) if !unit.is_empty() => match other(unit) {
                Some(given) => {
                    let fault = Fault::new(format!("`{name}` is in {unit}, not in {given}"));
                    return Err(fault
                        .help("multiply the expression by the factor between the two units")
                        .of_param("units"));
                }
                None => unit.clone(),
            },
            (_, Some(given)) => given.clone(),
            (ExpressionUnit::Of(unit) | ExpressionUnit::Scaled(unit), None) => unit.clone(),
            // A dimensionless column, such as the year.
            (ExpressionUnit::Any, None)
                if flight::COLUMNS.iter().any(|(known, about)| *known == name && about.unit.is_empty()) =>
            {
                String::new()
            }
            (ExpressionUnit::Any | ExpressionUnit::Unknown, None) => {
                let fault = Fault::new(format!("the unit of `{name}` cannot be inferred from its expression"));
                return Err(fault
                    .help(format!("set the unit, for example `units = {{ {name} = \"nT\" }}`"))
                    .of_param("columns"));
            }
        };
        let known = flight::describe(name).unit;
        if !known.is_empty() && known != unit {
            let fault = Fault::new(format!("`{name}` is in {unit}, but the column that it replaces is in {known}"));
            return Err(fault.help("choose another name, or convert the expression to that unit").of_param("columns"));
        }
        Ok(unit)
    }

    fn column(&self, name: &str, sql: &str, shape: &TableShape) -> Result<Column, Fault> {
        if is_key(name) {
            return Err(Fault::new(format!(
                "`{name}` is a key of every line and cannot be replaced; choose another name"
            )));
        }
        let word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
        if name.is_empty() || !name.chars().all(word) {
            let what = format!("`{name}` is not a valid column name; use letters, digits, `_` and `.`");
            return Err(Fault::new(what));
        }
        let expression = Self::expression(name, sql, shape)?;
        let unit = self.unit(name, &expression.unit)?;
        let doc = sql.split_whitespace().collect::<Vec<_>>().join(" ");
        let reads = &expression.columns;
        // A constant column has as many rows as the line.
        let from: Vec<&str> = if reads.is_empty() { vec!["tt"] } else { reads.iter().map(String::as_str).collect() };
        let removed = if unit == "nT" { of_expression(&expression, shape) } else { CorrectionSet::new() };
        Ok(Column::float(name, unit, doc).role(role_of(shape, reads)).from(0, &from).without(removed))
    }
}

impl Stage for Derive {
    fn expressions(&self) -> Vec<(Option<&str>, &str)> {
        self.columns.iter().map(|(name, sql)| (Some(name.as_str()), sql.as_str())).collect()
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let (mut made, mut faults) = (vec![], vec![]);
        if self.columns.is_empty() {
            faults.push(Fault::new("`columns` is empty; add at least one expression").of_param("columns"));
        }
        for (name, sql) in &self.columns {
            match self.column(name, sql, shape) {
                Ok(column) => made.push(column),
                Err(fault) => faults.push(fault.of_param("columns")),
            }
        }
        let names: Vec<&String> = self.columns.keys().collect();
        for name in self.units.keys().filter(|name| !self.columns.contains_key(*name)) {
            let fault = Fault::new(format!("`units` names `{name}`, which `columns` does not define"));
            faults.push(fault.nearest(name, &names).of_param("units"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned()];
        for (_, name) in made.iter().flat_map(|column: &Column| &column.from) {
            if !reads.contains(name) {
                reads.push(name.clone());
            }
        }
        Ok(StageSchema::append(made, &reads))
    }
}

impl LineStage for Derive {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let shape = TableShape::from_schema(&batch.schema());
        let one = |(name, sql): (&String, &String)| Ok(array(Self::expression(name, sql, &shape)?.numbers(batch)?));
        self.columns.iter().map(|pair| one(pair).map_err(|fault: Fault| fault.in_column(pair.0))).collect()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use schemas::Role;

    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, table};

    fn derive(columns: &[(&str, &str)], units: &[(&str, &str)]) -> Derive {
        let map = |pairs: &[(&str, &str)]| pairs.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        Derive { columns: map(columns), units: map(units) }
    }

    fn lines() -> Table {
        table(
            &[("tt", "s"), ("mag_4_uc", "nT"), ("mag_5_uc", "nT"), ("mag_1_c", "nT"), ("alt", "m"), ("count", "")],
            None,
        )
    }

    #[test]
    fn unit_an_expression_is_evaluated_row_by_row() {
        let stage = derive(
            &[
                ("d", "mag_4_uc - mag_5_uc"),
                ("clipped", "greatest(-1, least(1, mag_4_uc - mag_5_uc))"),
                ("chosen", "case when alt < 500 then mag_4_uc else mag_5_uc end"),
                ("ratio", "mag_4_uc / mag_5_uc"),
            ],
            &[],
        );
        let nan = f64::NAN;
        let input = batch(vec![
            ("tt", "s", vec![0.0, 0.1, 0.2]),
            ("mag_4_uc", "nT", vec![50_000.0, nan, 50_004.0]),
            ("mag_5_uc", "nT", vec![49_999.5, 1.0, 0.0]),
            ("alt", "m", vec![100.0, 900.0, nan]),
        ]);
        let made = numbers(stage.run(&line(vec![input]), &())).unwrap();
        let same = |found: &[f64], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(x, y)| *x == y || x.is_nan() && y.is_nan()), "{found:?}");
        };
        // The columns are in alphabetical order. For an unknown height, the last alternative applies. The value of x/0
        // is missing.
        same(&made[0], [50_000.0, 1.0, 0.0]);
        same(&made[1], [0.5, nan, 1.0]);
        same(&made[2], [0.5, nan, 50_004.0]);
        same(&made[3], [50_000.0 / 49_999.5, nan, nan]);
    }

    #[test]
    fn unit_units_are_inferred_or_given_and_truth_stays_truth() {
        let stage = derive(
            &[
                ("d", "mag_4_uc - mag_1_c"),
                ("half", "0.5 * mag_4_uc"),
                ("pt", "1000 * mag_4_uc"),
                ("sq", "mag_4_uc * alt"),
            ],
            &[("pt", "pT"), ("sq", "nT m")],
        );
        let made = stage.yields(&[&lines()]).unwrap();
        let columns: Vec<_> = made.columns.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        assert_eq!(
            columns,
            [
                ("d", "nT", Role::Truth),
                ("half", "nT", Role::Derived),
                ("pt", "pT", Role::Derived),
                ("sq", "nT m", Role::Truth)
            ]
        );
        assert_eq!(made.reads, [["tt", "mag_1_c", "mag_4_uc", "alt"]]);
        assert_eq!(made.columns[0].from, [(0, "mag_1_c".into()), (0, "mag_4_uc".into())]);
    }

    #[test]
    fn unit_wrong_units_and_types_are_reported_before_the_run() {
        let of = |columns: &[(&str, &str)], units: &[(&str, &str)]| {
            fault_texts(derive(columns, units).yields(&[&lines()]).unwrap_err())
        };
        assert!(of(&[("x", "mag_4_uc + alt")], &[]).contains("in m"));
        assert!(of(&[("x", "mag_4_uc * alt")], &[]).contains("`units = { x = \"nT\" }`"));
        assert!(of(&[("x", "mag_4_uc - mag_5_uc")], &[("x", "T")]).ends_with("[units]"));
        assert!(of(&[("x", "mag_4_uc")], &[("xx", "nT")]).contains("`units` names `xx`"));
        assert!(of(&[("mag_7_uc", "mag_4_uc / mag_5_uc")], &[]).contains("the column that it replaces is in nT"));
        assert!(of(&[("tt", "mag_4_uc")], &[]).contains("cannot be replaced"));
        assert!(of(&[("x y", "mag_4_uc")], &[]).contains("not a valid column name"));
        assert!(of(&[("x", "mag_4_uc > 3")], &[]).contains("case when"));
        assert!(of(&[("x", "random() * mag_4_uc")], &[]).contains("a different value each time"));
        assert!(of(&[("x", "mag_6_uc")], &[]).contains("there is no column `mag_6_uc`"));
        assert!(of(&[], &[]).contains("`columns` is empty"));
    }
}
