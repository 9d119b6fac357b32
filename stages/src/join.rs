//! Appends columns of another table of the same lines, matched by time.

use arrow_array::{ArrayRef, RecordBatch, UInt64Array};
use arrow_select::take::take;
use numerics::signal::{
    resample::{ResamplePlan, SampleInterpolation},
    segments::check_increasing,
};
use schemas::{
    Column, ColumnType, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, TableShape, choice,
    stage,
};

use crate::{
    columns::{array, data, floats, is_key, list, matrix, shape},
    dates::{date_columns, offset_s},
    whole_numbers::between_samples,
};

stage! {
    /// Appends columns of another table (`with`) to each line. Rows are matched by flight, line and time.
    ///
    /// `exact` uses the row at the same time, within one microsecond, and fails if there is none. Use it for tables
    /// with the same times, such as two tables computed from the same `resample`. `nearest` uses the nearest row within
    /// `tolerance_s`; of two equally near rows, the earlier one. `linear` interpolates between the rows before and
    /// after, if they are at most `tolerance_s` apart. It interpolates angles (unit deg) along the shorter arc. Text,
    /// integers and booleans take the nearest value, and whole numbers without a unit stay whole, as in `resample`.
    /// Without a matching row the value is missing (NaN or null). If both tables have a date, their times are converted
    /// to seconds past the same midnight.
    ///
    /// A line that is absent from `with` is omitted without a message, here and in later stages. A column that is also
    /// in `input` is rejected, unless `suffix` renames it. Repeated or decreasing times are rejected.
    Join = "join", version 3, grain Line, inputs [input: Lines, with: Lines],
    example r#"
[[stages]]
name    = "join"
stage   = "join"
input   = "resample"
with    = "bandpass"
columns = ["mag_4_uc_bp"]
"#;
    /// Columns to append.
    columns: Option<Vec<String>>, unit "", absent "all columns that are not in `input`";
    /// Method that matches rows.
    method: JoinMethod, unit "", default JoinMethod::Exact;
    /// Maximum time to the nearest row, or between the two rows of an interpolation.
    tolerance_s: f64, unit "s", default 1.0, rule Rule::Positive;
    /// Suffix of the name of each appended column.
    suffix: String, unit "", default "";
}

choice! {
    /// Method that matches a row to the rows of another table.
    pub enum JoinMethod {
        /// Row at the same time.
        Exact = "exact",
        /// Row at the nearest time.
        Nearest = "nearest",
        /// Interpolation between the rows before and after.
        Linear = "linear",
    }
}

/// Maximum difference between times that count as equal, in seconds. It is far below a sample interval, and far above
/// the rounding error of the seconds of a day.
const SAME_S: f64 = 1e-6;

/// Indices of the inputs.
const INPUT: usize = 0;
const WITH: usize = 1;

impl Join {
    /// The columns to append, in the order of `with`.
    fn chosen<'a>(&self, input: &TableShape, with: &'a TableShape) -> Result<Vec<&'a Column>, Vec<Fault>> {
        let Some(names) = &self.columns else {
            let new = with.columns.iter().filter(|c| !is_key(&c.name));
            let new = new.filter(|c| input.get(&format!("{}{}", c.name, self.suffix)).is_none());
            return Ok(new.collect());
        };
        let (mut found, mut faults) = (vec![], vec![]);
        for name in names {
            let made = format!("{name}{}", self.suffix);
            match with.need(name) {
                Err(fault) => faults.push(fault.of_param("columns")),
                Ok(_) if is_key(name) => {
                    faults.push(Fault::new(format!("`{name}` is a key of every line")).of_param("columns"));
                }
                Ok(_) if input.get(&made).is_some() => {
                    let fault = Fault::new(format!("`input` already has a column `{made}`"));
                    faults.push(fault.help("rename the column with `suffix`").of_param("columns"));
                }
                Ok(_) if found.iter().any(|c: &&Column| c.name == *name) => {
                    faults.push(Fault::new(format!("`{name}` is a duplicate")).of_param("columns"));
                }
                Ok(column) => found.push(column),
            }
        }
        if faults.is_empty() { Ok(found) } else { Err(faults) }
    }
}

impl Stage for Join {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let (input, with) = (shape(inputs, INPUT)?, shape(inputs, WITH)?);
        let chosen = self.chosen(input, with)?;
        if chosen.is_empty() {
            let fault = Fault::new("there is no column to append: `input` has all columns of `with`");
            return Err(vec![fault.of_param("with")]);
        }
        let times = |shape: &TableShape| -> Vec<&'static str> {
            std::iter::once("tt").chain(date_columns(shape).iter().copied()).collect()
        };
        let (ours, theirs) = (times(input), times(with));
        let made = chosen.iter().map(|c| {
            let mut from = theirs.clone();
            if !from.contains(&c.name.as_str()) {
                from.push(&c.name);
            }
            let column = Column { from: vec![], name: format!("{}{}", c.name, self.suffix), ..(*c).clone() };
            column.from(INPUT, &ours).from(WITH, &from)
        });
        let mut yields = StageSchema::append(made.collect(), &ours);
        let mut reads: Vec<String> = chosen.iter().map(|c| c.name.clone()).collect();
        reads.extend(theirs.iter().filter(|name| !chosen.iter().any(|c| c.name == **name)).map(ToString::to_string));
        yields.reads.push(reads);
        Ok(yields)
    }
}

/// Row nearest to each time; `None` if no row is within `within_s`. `tt` holds the times of the rows. Both lists of
/// times increase. Of two equally near rows, the earlier one is used.
fn nearest(times: &[f64], tt: &[f64], within_s: f64) -> Vec<Option<u64>> {
    let mut first = 0;
    let one = |time: &f64| {
        while tt.get(first + 1).is_some_and(|next| (next - time).abs() < (tt[first] - time).abs()) {
            first += 1;
        }
        tt.get(first).filter(|t| (*t - time).abs() <= within_s).map(|_| first as u64)
    };
    times.iter().map(one).collect()
}

impl LineStage for Join {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let [input, with] = line.inputs.as_slice() else {
            return Err(Fault::bug("a join requires exactly two tables"));
        };
        let times = floats(input, "tt")?;
        let shift = offset_s(input, with)?;
        let tt: Vec<f64> = floats(with, "tt")?.iter().map(|t| t + shift).collect();
        for (tt, whose) in [(times, "`input`"), (&tt, "`with`")] {
            check_increasing(tt).map_err(|e| Fault::data(format!("in {whose}: {e}")).in_column("tt"))?;
        }
        let shape = TableShape::from_schema(&with.schema());
        let chosen = match &self.columns {
            Some(names) => names.iter().map(|name| shape.need(name)).collect::<Result<_, Fault>>()?,
            None => self.chosen(&TableShape::from_schema(&input.schema()), &shape).unwrap_or_default(),
        };
        let chosen = chosen.into_iter();
        match self.method {
            JoinMethod::Exact => {
                let rows = nearest(times, &tt, SAME_S);
                if let Some(row) = rows.iter().position(Option::is_none) {
                    let time = times.get(row).copied().unwrap_or(f64::NAN);
                    let fault =
                        Fault::data(format!("`with` has no row at {time} s")).in_column("tt").in_row(row as u64);
                    return Err(fault.help("set `method` to `\"nearest\"` or `\"linear\"`"));
                }
                chosen.map(|c| taken(with, c, &rows)).collect()
            }
            JoinMethod::Nearest => {
                let rows = nearest(times, &tt, self.tolerance_s);
                chosen.map(|c| taken(with, c, &rows)).collect()
            }
            JoinMethod::Linear => {
                let step_s = times.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
                // A single row has no sample interval, so any rate is valid.
                let rate_hz = if step_s.is_finite() { 1.0 / step_s } else { 1.0 };
                let plan = ResamplePlan::onto(&tt, times.to_vec(), rate_hz, self.tolerance_s)
                    .map_err(|e| data(e).in_column("tt"))?;
                chosen.map(|c| interpolated(with, c, &plan).map_err(|e| e.in_column(&c.name))).collect()
            }
        }
    }
}

/// The rows `rows` of a column.
fn taken(with: &RecordBatch, column: &Column, rows: &[Option<u64>]) -> Result<ArrayRef, Fault> {
    let name = column.name.as_str();
    let at = |row: &Option<u64>| row.and_then(|row| usize::try_from(row).ok());
    match &column.column_type {
        ColumnType::Float => {
            let values = floats(with, name)?;
            Ok(array(
                rows.iter().map(|row| at(row).and_then(|row| values.get(row)).copied().unwrap_or(f64::NAN)).collect(),
            ))
        }
        ColumnType::List(terms) => {
            let width = terms.len();
            let (values, _) = matrix(with, name)?;
            let row = |row: &Option<u64>| at(row).and_then(|row| values.get(row * width..(row + 1) * width));
            list(
                rows.iter().flat_map(|r| row(r).map_or_else(|| vec![f64::NAN; width], <[f64]>::to_vec)).collect(),
                width,
            )
        }
        ColumnType::Text | ColumnType::Other(_) => {
            let values = with.column_by_name(name).ok_or_else(|| Fault::data("is missing").in_column(name))?;
            take(values, &rows.iter().copied().collect::<UInt64Array>(), None).map_err(data)
        }
    }
}

fn interpolated(with: &RecordBatch, column: &Column, plan: &ResamplePlan) -> Result<ArrayRef, Fault> {
    let name = column.name.as_str();
    match &column.column_type {
        ColumnType::Float => {
            between_samples(plan, column, floats(with, name)?, SampleInterpolation::Linear).map(array).map_err(data)
        }
        ColumnType::List(_) | ColumnType::Text | ColumnType::Other(_) => {
            let rows: Vec<Option<u64>> = plan.nearest_rows().into_iter().map(|row| row.map(|row| row as u64)).collect();
            taken(with, column, &rows)
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{RecordBatch, StringArray, cast::AsArray, types::Float64Type};

    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, sampled, table};

    fn join(method: JoinMethod, tolerance_s: f64) -> Join {
        Join { columns: None, method, tolerance_s, suffix: String::new() }
    }

    fn input() -> RecordBatch {
        batch(vec![("tt", "s", sampled(100.0, 10.0, 50, |t| t))])
    }

    fn run(stage: &Join, with: RecordBatch) -> Result<Vec<Vec<f64>>, Fault> {
        numbers(stage.run(&line(vec![input(), with]), &()))
    }

    #[test]
    fn unit_exact_joins_require_the_same_times() {
        let values = sampled(100.0, 10.0, 70, |t| t * t);
        // The other table begins before the line and ends after it.
        let with = batch(vec![("x", "nT", values.clone()), ("tt", "s", sampled(99.0, 10.0, 70, |t| t))]);
        assert_eq!(run(&join(JoinMethod::Exact, 1.0), with.clone()).unwrap(), [values[10..60].to_vec()]);
        let fault = run(&join(JoinMethod::Exact, 1.0), with.slice(0, 40)).unwrap_err();
        assert!(fault.what.contains("no row at 103"), "{fault}");
        assert_eq!(fault.place.row, Some(30));
    }

    #[test]
    fn unit_nearest_and_linear_joins_obey_their_tolerance() {
        let slow = |t: f64| 3.0 * t;
        let tt: Vec<f64> = sampled(99.55, 1.0, 7, |t| t).into_iter().filter(|t| (*t - 102.55).abs() > 0.1).collect();
        let heading = |t: f64| (350.0 + 8.0 * (t - 100.0)).rem_euclid(360.0);
        let of = |f: &dyn Fn(f64) -> f64| tt.iter().map(|t| f(*t)).collect::<Vec<_>>();
        let with = batch(vec![("x", "nT", of(&slow)), ("h", "deg", of(&heading)), ("tt", "s", tt.clone())]);
        let times = sampled(100.0, 10.0, 50, |t| t);
        let linear = run(&join(JoinMethod::Linear, 1.5), with.clone()).unwrap();
        for (k, t) in times.iter().enumerate() {
            if *t > 101.55 + 1e-9 && *t < 103.55 - 1e-9 {
                assert!(linear[0][k].is_nan() && linear[1][k].is_nan(), "{t}");
                continue;
            }
            let off = (linear[1][k] - heading(*t)).abs();
            assert!((linear[0][k] - slow(*t)).abs() < 1e-9 && off.min((off - 360.0).abs()) < 1e-9, "{t}");
        }
        let nearest = run(&join(JoinMethod::Nearest, 0.46), with).unwrap();
        for (k, t) in times.iter().enumerate() {
            let distance = |s: &&f64| (*s - t).abs();
            let closest = tt.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
            match (closest - t).abs() <= 0.46 {
                true => assert!((nearest[0][k] - slow(*closest)).abs() < 1e-9, "{t}"),
                false => assert!(nearest[0][k].is_nan(), "{t}"),
            }
        }
    }

    #[test]
    fn unit_text_columns_are_joined_and_null_without_a_match() {
        let words = Arc::new(StringArray::from(vec!["a", "b"])) as ArrayRef;
        let tt = Arc::new(arrow_array::Float64Array::from(vec![100.0, 101.0])) as ArrayRef;
        let with = RecordBatch::try_from_iter([("pilot", words), ("tt", tt)]).unwrap();
        let made = join(JoinMethod::Nearest, 0.2).run(&line(vec![input(), with]), &()).unwrap();
        let pilots: Vec<Option<&str>> = made[0].as_string::<i32>().iter().collect();
        assert_eq!((pilots[0], pilots[5], pilots[9]), (Some("a"), None, Some("b")));
        let clock = batch(vec![("x", "nT", vec![1.0, 2.0]), ("tt", "s", vec![100.0, 100.0])]);
        assert!(run(&join(JoinMethod::Nearest, 0.2), clock).unwrap_err().what.contains("in `with`"));
    }

    #[test]
    fn unit_tables_of_different_days_have_no_common_times() {
        let dated = |batch: RecordBatch, doy: f64| {
            let rows = batch.num_rows();
            let x = batch.column_by_name("x").map(|x| x.as_primitive::<Float64Type>().values().to_vec());
            let tt = batch.column_by_name("tt").unwrap().as_primitive::<Float64Type>().values().to_vec();
            let mut columns = vec![("tt", "s", tt), ("year", "", vec![2020.0; rows]), ("doy", "", vec![doy; rows])];
            columns.splice(0..0, x.map(|x| ("x", "nT", x)));
            crate::testing::batch(columns)
        };
        let with =
            batch(vec![("x", "nT", sampled(100.0, 10.0, 50, |t| t)), ("tt", "s", sampled(100.0, 10.0, 50, |t| t))]);
        let stage = Join { columns: Some(vec!["x".into()]), ..join(JoinMethod::Nearest, 1.0) };
        let run =
            |doy: f64| numbers(stage.run(&line(vec![dated(input(), 7.0), dated(with.clone(), doy)]), &())).unwrap();
        assert!(run(7.0)[0].iter().all(|x| x.is_finite()) && run(8.0)[0].iter().all(|x| x.is_nan()));
    }

    #[test]
    fn unit_duplicate_and_missing_names_are_reported() {
        let ours = table(&[("tt", "s"), ("mag_4_uc", "nT")], Some(10.0));
        let theirs = table(&[("tt", "s"), ("mag_4_uc", "nT"), ("mag_1_c", "nT"), ("lat", "deg")], None);
        let stage = |columns: Option<&[&str]>, suffix: &str| Join {
            columns: columns.map(|names| names.iter().map(ToString::to_string).collect()),
            suffix: suffix.into(),
            ..join(JoinMethod::Exact, 1.0)
        };
        let made = stage(None, "").yields(&[&ours, &theirs]).unwrap();
        let columns: Vec<_> = made.columns.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        assert_eq!(columns, [("mag_1_c", "nT", schemas::Role::Truth), ("lat", "deg", schemas::Role::Truth)]);
        assert_eq!(made.reads, [vec!["tt"], vec!["mag_1_c", "lat", "tt"]]);
        let again = stage(Some(&["mag_4_uc"]), "_2").yields(&[&ours, &theirs]).unwrap();
        assert_eq!((again.columns[0].name.as_str(), again.columns.len()), ("mag_4_uc_2", 1));
        let of = |stage: Join| fault_texts(stage.yields(&[&ours, &theirs]).unwrap_err());
        assert!(of(stage(Some(&["mag_4_uc"]), "")).contains("`suffix`"));
        assert!(of(stage(Some(&["mag_1_b"]), "")).contains("did you mean `mag_1_c`?"));
        assert!(of(stage(Some(&["tt"]), "")).contains("is a key"));
        assert!(fault_texts(stage(None, "").yields(&[&ours, &ours]).unwrap_err()).contains("no column to append"));
    }
}
