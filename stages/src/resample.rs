//! Brings a line onto an even grid of times.

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, StringArray, UInt64Array};
use arrow_select::take::take;
use numerics::signal::resample::{Method, Plan};
use schemas::{Arrays, Column, ColumnType, Fault, LineIn, LineStage, Passes, Rule, Stage, Table, Yield, stage};

use crate::columns::{array, data, floats, list, matrix, shape};

stage! {
    /// Brings every column of a line onto evenly spaced times, whole multiples of 1/`rate_hz`.
    ///
    /// Numbers are interpolated, angles (unit deg) along the shorter arc; text, whole numbers and booleans take the
    /// nearest sample. The grid begins at the first multiple at or after the first sample and ends at or before the last,
    /// so that all sensors and lines of a flight share their times.
    ///
    /// Times inside of a gap longer than `max_gap_s` are kept, with NaN (or null) in every column but `flight`, `line` and
    /// `tt`. A missing value of one column counts as a gap of that column; a column that a line lacks, but others have, is
    /// missing throughout. Repeated or backward time is an error.
    ///
    /// Nothing is filtered: when going to a lower rate, what is faster than half of it folds back. Use `bandpass` before.
    Resample = "resample", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "resample"
stage   = "resample"
input   = "flights"
rate_hz = 10.0
"#;
    /// Samples per second of the new grid.
    rate_hz: f64, unit "Hz", rule Rule::Positive;
    /// How values between samples are found; `cubic` is Akima's.
    method: Method, unit "", default Method::Linear;
    /// The longest gap that is bridged.
    max_gap_s: f64, unit "s", default 1.0, rule Rule::Positive;
}

impl Stage for Resample {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let made = shape.columns.iter().map(|c| {
            let of: &[&str] = if c.name == "tt" { &["tt"] } else { &["tt", &c.name] };
            Column { from: vec![], ..c.clone() }.from(0, of)
        });
        let reads: Vec<&str> = shape.columns.iter().map(|c| c.name.as_str()).collect();
        let mut yields = Yield::append(made.collect(), &reads);
        yields.passes = Passes::None;
        yields.lenient = true;
        yields.rate_hz = Some(self.rate_hz);
        Ok(yields)
    }
}

impl LineStage for Resample {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    fn run(&self, line: &LineIn, (): &()) -> Arrays {
        let batch = &line.inputs[0];
        let plan = Plan::new(floats(batch, "tt")?, self.rate_hz, self.max_gap_s).map_err(data)?;
        if plan.grid().is_empty() {
            return Err(Fault::data(format!("the line is too short to hold a sample at {} Hz", self.rate_hz)));
        }
        let schema = batch.schema();
        let fields = schema.fields().iter();
        fields
            .map(|f| self.column(batch, &plan, &schemas::describe_field(f), line).map_err(|e| e.in_column(f.name())))
            .collect()
    }
}

impl Resample {
    fn column(&self, batch: &RecordBatch, plan: &Plan, column: &Column, line: &LineIn) -> Result<ArrayRef, Fault> {
        let rows = plan.grid().len();
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; rows])) };
        match (column.name.as_str(), &column.column_type) {
            ("tt", _) => Ok(array(plan.grid().to_vec())),
            ("flight", _) => Ok(same(&line.flight)),
            ("line", _) => Ok(same(&line.line)),
            (name, ColumnType::Float) if column.unit == "deg" => {
                plan.angle_deg(floats(batch, name)?, self.method).map(array).map_err(data)
            }
            (name, ColumnType::Float) => plan.column(floats(batch, name)?, self.method).map(array).map_err(data),
            (name, ColumnType::List(_)) => self.entries(batch, plan, name),
            (name, _) => {
                let at: UInt64Array = plan.nearest_rows().into_iter().map(|r| r.map(|r| r as u64)).collect();
                let values = batch.column_by_name(name).ok_or_else(|| Fault::data("is missing"))?;
                take(values, &at, None).map_err(data)
            }
        }
    }

    /// A list column, entry by entry.
    fn entries(&self, batch: &RecordBatch, plan: &Plan, name: &str) -> Result<ArrayRef, Fault> {
        let (values, terms) = matrix(batch, name)?;
        let width = terms.len();
        let mut out = vec![0.0; plan.grid().len() * width];
        for at in 0..width {
            let one: Vec<f64> = values.iter().skip(at).step_by(width).copied().collect();
            let even = plan.column(&one, self.method).map_err(data)?;
            out.iter_mut().skip(at).step_by(width).zip(even).for_each(|(o, x)| *o = x);
        }
        list(out, width)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{
        Array, Int64Array,
        cast::AsArray,
        types::{Float64Type, Int64Type},
    };
    use arrow_schema::{DataType, Field, Schema};
    use schemas::{Role, Shape};

    use super::*;

    fn resample() -> Resample {
        Resample { rate_hz: 10.0, method: Method::Linear, max_gap_s: 1.0 }
    }

    fn columns() -> Vec<Column> {
        vec![
            Column::text("flight", "").role(Role::Key),
            Column::text("line", "").role(Role::Key),
            Column::float("tt", "s", "").role(Role::Time),
            Column::float("x", "nT", "").role(Role::Sensor),
            Column::float("yaw", "deg", "").role(Role::Truth),
            Column::list("tl", "", "", ["a", "b"].map(str::to_owned).to_vec()),
            Column::integer("count", "", ""),
            Column::text("pilot", ""),
        ]
    }

    fn straight(t: f64) -> f64 {
        3.0 + 2.0 * (t - 100.0)
    }

    /// Turns through north: 340 degrees at 100 s, eight degrees a second.
    fn heading(t: f64) -> f64 {
        (340.0 + 8.0 * (t - 100.0)).rem_euclid(360.0)
    }

    fn line(tt: Vec<f64>) -> LineIn {
        let rows = tt.len();
        let text = |values: Vec<&str>| Arc::new(StringArray::from(values)) as ArrayRef;
        let of = |f: fn(f64) -> f64| array(tt.iter().map(|t| f(*t)).collect());
        let arrays = vec![
            text(vec!["1"; rows]),
            text(vec!["1.01"; rows]),
            array(tt.clone()),
            of(straight),
            of(heading),
            list(tt.iter().flat_map(|t| [straight(*t), -straight(*t)]).collect(), 2).unwrap(),
            Arc::new(Int64Array::from_iter_values(0..rows as i64)) as ArrayRef,
            text(tt.iter().map(|t| if *t < 102.0 { "A" } else { "B" }).collect()),
        ];
        let fields: Vec<Field> = columns().iter().map(Column::field).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap();
        LineIn { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
    }

    /// Ten seconds at 4 Hz from 100.05 s, without a sample between 103.05 s and 106.05 s.
    fn with_a_gap() -> LineIn {
        line((0..=40).filter(|k| !(13..24).contains(k)).map(|k| 100.05 + 0.25 * f64::from(k)).collect())
    }

    fn in_gap(t: f64) -> bool {
        t > 103.05 && t < 106.05
    }

    fn numbers(array: &ArrayRef) -> &[f64] {
        array.as_primitive::<Float64Type>().values()
    }

    #[test]
    fn law_a_straight_line_is_the_same_on_any_grid() {
        let made = resample().run(&with_a_gap(), &()).unwrap();
        let tt = numbers(&made[2]);
        // Tenths of a second from 100.1 s to 110.0 s.
        assert_eq!(tt, (1001..=1100).map(|k| f64::from(k) / 10.0).collect::<Vec<_>>());
        let terms = made[5].as_fixed_size_list().values();
        for (k, t) in tt.iter().enumerate() {
            let row = [numbers(&made[3])[k], numbers(&made[4])[k], numbers(terms)[2 * k], numbers(terms)[2 * k + 1]];
            if in_gap(*t) {
                assert!(row.iter().all(|x| x.is_nan()), "{t}: {row:?}");
                continue;
            }
            // Times of 100 s are rounded to 1.4e-14.
            for (found, expected) in row.iter().zip([straight(*t), heading(*t), straight(*t), -straight(*t)]) {
                let off = (found - expected).abs();
                // North is 0 as well as 360.
                assert!(off.min((off - 360.0).abs()) < 1e-9, "{t}: {found} {expected}");
            }
        }
        assert_eq!(tt.iter().filter(|t| in_gap(**t)).count(), 30);
        let bridged = Resample { max_gap_s: 3.0, ..resample() }.run(&with_a_gap(), &()).unwrap();
        assert!(numbers(&bridged[3]).iter().zip(tt).all(|(x, t)| (x - straight(*t)).abs() < 1e-9));
    }

    #[test]
    fn unit_what_is_no_number_takes_the_nearest_sample_and_the_keys_stay() {
        let made = resample().run(&with_a_gap(), &()).unwrap();
        let tt = numbers(&made[2]);
        for (key, word) in made[..2].iter().zip(["1", "1.01"]) {
            assert!(key.as_string::<i32>().iter().all(|text| text == Some(word)));
        }
        assert_eq!((made[6].data_type(), made[7].data_type()), (&DataType::Int64, &DataType::Utf8));
        // Samples at 100.05, 100.3 and 100.55 s; the grid from 100.1 s.
        let counts = made[6].as_primitive::<Int64Type>();
        assert_eq!(counts.values()[..5], [0, 1, 1, 1, 2]);
        let pilots = made[7].as_string::<i32>();
        for (k, t) in tt.iter().enumerate() {
            assert_eq!((counts.is_null(k), pilots.is_null(k)), (in_gap(*t), in_gap(*t)), "{t}");
        }
        // The change is between 101.8 s and 102.05 s.
        assert_eq!((pilots.value(18), pilots.value(19)), ("A", "B"));
    }

    #[test]
    fn unit_a_line_without_a_time_of_the_grid_and_time_that_goes_back_are_faults() {
        let fault = resample().run(&line(vec![100.01, 100.09]), &()).unwrap_err();
        assert_eq!(fault.what, "the line is too short to hold a sample at 10 Hz");
        let fault = resample().run(&line(vec![100.0, 100.2, 100.1]), &()).unwrap_err();
        assert!(fault.what.contains("row 2"), "{fault}");
    }

    #[test]
    fn unit_every_column_goes_on_at_the_new_rate() {
        let table = Table::Lines(Shape { columns: columns(), rate_hz: None });
        let made = resample().yields(&[&table]).unwrap();
        assert_eq!((made.rate_hz, made.passes, made.lenient), (Some(10.0), Passes::None, true));
        let bare = |c: &Column| Column { from: vec![], ..c.clone() };
        assert_eq!(made.columns.iter().map(bare).collect::<Vec<_>>(), columns());
        let of = |place: usize| made.columns[place].from.iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>();
        assert_eq!((of(2), of(3)), (vec!["tt"], vec!["tt", "x"]));
    }
}
