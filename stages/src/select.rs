//! Selects rows and columns of lines.

use arrow_array::BooleanArray;
use arrow_schema::DataType;
use arrow_select::filter::filter;
use expressions::Expression;
use schemas::{
    Column, Fault, LineInput, LineOutput, LineStage, PassThroughColumns, Stage, StageSchema, Table, TableShape, stage,
};

use crate::columns::{data, is_key, shape};

stage! {
    /// Keeps the rows of each line for which `rows` is true. Keeps the columns listed in `columns`, or all columns
    /// except those listed in `drop`.
    ///
    /// `rows` is an SQL predicate over the columns of a row. A row is dropped if the predicate is unknown because a
    /// value is missing (NaN). A line fails if no row is kept. Rows dropped in the middle of a line leave a gap in
    /// time, at which filters restart.
    ///
    /// `where` selects lines. The columns `flight`, `line` and `tt` are always kept.
    Select = "select", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name  = "select"
stage = "select"
input = "resample"
rows  = "mag_4_uc is not null and alt > 0"
drop  = ["mag_5_uc"]
"#;
    /// Predicate that selects the rows to keep, such as `radar > 100 and abs(roll) < 5`.
    rows: Option<String>, unit "", absent "all";
    /// Columns that are kept.
    columns: Option<Vec<String>>, unit "", absent "all columns except those of `drop`";
    /// Columns that are dropped.
    drop: Vec<String>, unit "", default Vec::<String>::new();
}

/// Name of the predicate in faults.
const SUBJECT: &str = "`rows`";

impl Select {
    fn keeps(&self, name: &str) -> bool {
        let named = self.columns.as_ref().is_none_or(|names| names.iter().any(|n| n == name));
        is_key(name) || named && !self.drop.iter().any(|n| n == name)
    }

    fn predicate(&self, shape: &TableShape) -> Result<Option<Expression>, Fault> {
        let Some(sql) = &self.rows else { return Ok(None) };
        let predicate = Expression::new(sql, shape, SUBJECT)?;
        match &predicate.data_type {
            DataType::Boolean => Ok(Some(predicate)),
            kind => Err(Fault::new(format!("{SUBJECT} must be true or false, but this expression gives {kind}"))),
        }
    }
}

impl Stage for Select {
    fn expressions(&self) -> Vec<(Option<&str>, &str)> {
        self.rows.iter().map(|sql| (None, sql.as_str())).collect()
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = vec![];
        let named = self.columns.iter().flatten().map(|name| (name, "columns"));
        for (name, param) in named.chain(self.drop.iter().map(|name| (name, "drop"))) {
            faults.extend(shape.need(name).err().map(|fault| fault.of_param(param)));
        }
        for name in self.drop.iter().filter(|name| is_key(name)) {
            faults.push(Fault::new(format!("`{name}` is a key of every line and cannot be dropped")).of_param("drop"));
        }
        if let (Some(_), Some(name)) = (&self.columns, self.drop.first()) {
            let what = format!("`columns` and `drop` cannot be combined, but `drop` names `{name}`; remove `drop`");
            faults.push(Fault::new(what).of_param("drop"));
        }
        if self.rows.is_none() && self.columns.is_none() && self.drop.is_empty() {
            faults.push(Fault::new("nothing is selected; set `rows`, `columns` or `drop`"));
        }
        let predicate = self.predicate(shape).map_err(|fault| faults.push(fault.of_param("rows"))).ok().flatten();
        if !faults.is_empty() {
            return Err(faults);
        }
        let kept: Vec<&Column> = shape.columns.iter().filter(|c| self.keeps(&c.name)).collect();
        let Some(predicate) = predicate else {
            // The rows are unchanged, so the columns are those of the input. Only the time is a new column, because a
            // table needs at least one.
            let names = kept.iter().map(|c| c.name.clone()).filter(|name| name != "tt").collect();
            let time = kept
                .iter()
                .filter(|c| c.name == "tt")
                .map(|c| Column { from: vec![], ..(*c).clone() }.from(0, &["tt"]));
            return Ok(StageSchema {
                passes: PassThroughColumns::Only(names),
                ..StageSchema::append(time.collect(), &["tt"])
            });
        };
        let made = kept.iter().map(|c| {
            let mut from = predicate.columns.clone();
            if !from.contains(&c.name) {
                from.push(c.name.clone());
            }
            Column { from: vec![], ..(*c).clone() }.from(0, &from)
        });
        let mut reads: Vec<String> = kept.iter().map(|c| c.name.clone()).collect();
        reads.extend(predicate.columns.iter().filter(|name| !kept.iter().any(|c| c.name == **name)).cloned());
        let made: Vec<Column> = made.collect();
        Ok(StageSchema { passes: PassThroughColumns::None, lenient: true, ..StageSchema::append(made, &reads) })
    }
}

impl LineStage for Select {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let schema = batch.schema();
        let kept = schema.fields().iter().zip(batch.columns()).filter(|(field, _)| self.keeps(field.name()));
        let Some(predicate) = self.predicate(&TableShape::from_schema(&schema))? else {
            return Ok(kept.map(|(_, array)| array.clone()).collect());
        };
        let mask = predicate.mask(batch)?;
        if !mask.contains(&true) {
            return Err(Fault::data(format!("{SUBJECT} is true for no row of the line")));
        }
        let mask = BooleanArray::from(mask);
        kept.map(|(field, array)| filter(array, &mask).map_err(|e| data(e).in_column(field.name()))).collect()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, table};

    fn select(rows: Option<&str>, columns: Option<&[&str]>, drop: &[&str]) -> Select {
        let texts = |names: &[&str]| names.iter().map(ToString::to_string).collect();
        Select { rows: rows.map(str::to_owned), columns: columns.map(texts), drop: texts(drop) }
    }

    fn lines() -> Table {
        table(&[("tt", "s"), ("alt", "m"), ("mag_4_uc", "nT"), ("radar", "m")], Some(10.0))
    }

    #[test]
    fn unit_only_rows_with_a_true_predicate_are_kept() {
        let input = batch(vec![
            ("tt", "s", vec![0.0, 0.1, 0.2, 0.3]),
            ("alt", "m", vec![100.0, 900.0, f64::NAN, 950.0]),
            ("mag_4_uc", "nT", vec![1.0, 2.0, 3.0, f64::NAN]),
        ]);
        let run = |rows: &str| numbers(select(Some(rows), None, &[]).run(&line(vec![input.clone()]), &()));
        let made = run("alt > 500").unwrap();
        assert_eq!((made[0].as_slice(), made[1].as_slice(), made[2][0]), (&[0.1, 0.3][..], &[900.0, 950.0][..], 2.0));
        assert!(made[2][1].is_nan());
        assert_eq!(run("alt > 500 and mag_4_uc < 3").unwrap()[0], [0.1]);
        assert!(run("alt > 5000").unwrap_err().what.contains("no row"));
    }

    #[test]
    fn unit_kept_columns_are_read_and_the_time_is_always_kept() {
        let made = select(Some("radar > 3"), Some(&["mag_4_uc"]), &[]).yields(&[&lines()]).unwrap();
        let names: Vec<&str> = made.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!((names, made.passes), (vec!["tt", "mag_4_uc"], PassThroughColumns::None));
        assert_eq!(made.reads, [["tt", "mag_4_uc", "radar"]]);
        assert!(made.columns[1].from.contains(&(0, "radar".into())));
        let made = select(None, None, &["radar"]).yields(&[&lines()]).unwrap();
        assert_eq!(made.passes, PassThroughColumns::Only(vec!["alt".into(), "mag_4_uc".into()]));
        assert_eq!((made.columns[0].name.as_str(), made.reads), ("tt", vec![vec!["tt".to_owned()]]));
    }

    #[test]
    fn unit_an_invalid_selection_is_reported() {
        let of = |stage: Select| fault_texts(stage.yields(&[&lines()]).unwrap_err());
        assert!(of(select(Some("rada > 3"), None, &[])).contains("did you mean `radar`?"));
        assert!(of(select(Some("radar + 3"), None, &[])).contains("true or false"));
        assert!(of(select(Some("radar > mag_4_uc"), None, &[])).contains("in m"));
        assert!(of(select(None, Some(&["rada"]), &[])).ends_with("[columns]"));
        assert!(of(select(None, None, &["tt"])).contains("is a key"));
        assert!(of(select(None, Some(&["alt"]), &["radar"])).contains("cannot be combined"));
        assert!(of(select(None, None, &[])).contains("nothing is selected"));
    }
}
