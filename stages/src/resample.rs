//! Brings a line, and the sensors that have tables of their own, onto an even grid of times.

use std::{collections::BTreeMap, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch, StringArray, UInt64Array};
use arrow_select::take::take;
use numerics::signal::resample::{Method, Plan, even_grid};
use schemas::{
    Arrays, Column, ColumnType, Correction, Fault, LineIn, LineStage, Passes, RateLaw, Rule, Shape, Stage, Table,
    Yield, choice, stage,
};

use crate::{
    columns::{array, data, floats, list, matrix, rate_factor, sampling, shape},
    dates::{date_columns, offset_s},
};

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
    /// Sensors with different sampling rates are separate tables, `input = ["mag", "imu", "gps"]`. A line combines the
    /// same flight and line of each of them. The columns of all are brought onto one grid, over the time that all of
    /// them cover, or over that of the first (`span`). Where two tables have a date, their times count from one common
    /// midnight, even if the tables count from different ones. A column of the same name in two tables is an error,
    /// except `year` and `doy`, which come from the first table with them. A line without a common time is an error
    /// too.
    ///
    /// `lag_s` and `input_lag_s` take out how late a sensor reports: with a lag of 0.06 s, what is stamped t was so at
    /// t - 0.06 s, and a value at t is what is stamped t + 0.06 s. `lag` finds lags of this sign.
    ///
    /// Entries of lists that are differences per sample, such as those of `tl`, become differences at the new rate. A list that
    /// holds values of earlier samples is an error: make it afterwards. A lag that was taken out before is an error too.
    ///
    /// Nothing is filtered: when going to a lower rate, what is faster than half of it folds back. Use `lowpass` or `bandpass`
    /// before.
    Resample = "resample", version 2, grain Line, inputs [input: ManyLines],
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
    /// The longest gap that is bridged: one for all inputs, or one for each.
    max_gap_s: Vec<f64>, unit "s", default vec![1.0], rule Rule::Positive;
    /// Time that the grid covers, with several inputs.
    span: Span, unit "", default Span::All;
    /// How late columns report, by their name; of a vector magnetometer by that, such as `flux_a` for its `x`, `y`, `z` and
    /// `t`. It takes the place of the lag of the column's input.
    lag_s: BTreeMap<String, f64>, unit "s", default BTreeMap::new(), rule Rule::Finite;
    /// How late the sensors of each input report, one for each.
    input_lag_s: Option<Vec<f64>>, unit "s", absent "0 for all", rule Rule::Finite;
}

choice! {
    /// The time that a grid of several tables covers.
    pub enum Span {
        /// Time that all of them cover.
        All = "all",
        /// Time that the first covers; the others have NaN where they have no samples.
        First = "first",
    }
}

impl Resample {
    /// The lag of a column of the input `i`.
    fn lag_of(&self, i: usize, name: &str) -> f64 {
        let of_vector = || {
            let (vector, _) = schemas::flight::vector_part(name)?;
            self.lag_s.get(vector)
        };
        let own = self.lag_s.get(name).or_else(of_vector);
        own.copied().unwrap_or_else(|| self.lag_of_input(i))
    }

    /// Why the lag of a column cannot be taken out: it was before.
    fn lag_again(&self, i: usize, column: &Column) -> Option<Fault> {
        let again = self.lag_of(i, &column.name) != 0.0 && column.removed.contains(&Correction::Lag);
        let param = if self.lag_of_input(i) == 0.0 { "lag_s" } else { "input_lag_s" };
        again.then(|| {
            let what = format!("the lag of `{}` was taken out before", column.name);
            Fault::new(what).help(format!("leave it out of `{param}`")).of_param(param)
        })
    }

    fn lag_of_input(&self, i: usize) -> f64 {
        self.input_lag_s.as_ref().and_then(|lags| lags.get(i)).copied().unwrap_or(0.0)
    }

    fn max_gap_of(&self, i: usize) -> f64 {
        self.max_gap_s.get(i).or(self.max_gap_s.first()).copied().unwrap_or(1.0)
    }

    /// Contradictions between the parameters and the inputs.
    fn contradictions(&self, shapes: &[&Shape]) -> Vec<Fault> {
        let mut faults = vec![];
        let n = shapes.len();
        let mut count = |given: usize, param: &str| {
            let what = format!("there are {n} inputs, but {given} values for them");
            faults.push(Fault::new(what).of_param(param));
        };
        if self.max_gap_s.len() != 1 && self.max_gap_s.len() != n {
            count(self.max_gap_s.len(), "max_gap_s");
        }
        if let Some(given) = self.input_lag_s.as_ref().map(Vec::len).filter(|given| *given != n) {
            count(given, "input_lag_s");
        }
        let all = || shapes.iter().flat_map(|shape| shape.columns.iter()).map(|c| c.name.as_str());
        for name in self.lag_s.keys() {
            let vector = |column: &str| schemas::flight::vector_part(column).is_some_and(|(vector, _)| vector == name);
            if KEPT.contains(&name.as_str()) {
                let what = format!("`{name}` has no lag: it is not measured");
                faults.push(Fault::new(what).of_param("lag_s"));
            } else if !all().any(|column| column == name || vector(column)) {
                let known: Vec<&str> = all().collect();
                let fault = Fault::new(format!("there is no column or vector `{name}`")).nearest(name, &known);
                faults.push(fault.of_param("lag_s"));
            }
        }
        faults
    }
}

/// The columns that are not interpolated: identifiers and the time.
const KEPT: [&str; 3] = ["flight", "line", "tt"];
const DATE: [&str; 2] = ["year", "doy"];

/// Whether a column is a magnetic reading, whose corrections are kept account of.
fn is_field(column: &Column) -> bool {
    column.column_type == ColumnType::Float && column.unit == "nT"
}

/// Why a list column cannot be brought to another rate.
fn lagged_entry(column: &Column) -> Option<Fault> {
    let (name, _) = column.sampling.entries.iter().find(|(_, law)| *law == RateLaw::Lag)?;
    let what = format!(
        "`{}` holds `{name}`, the value of an earlier sample, which has no equivalent at another rate",
        column.name
    );
    Some(Fault::new(what).help("make the column after `resample`, or drop it by `select`").of_param("input"))
}

/// The columns of the input `i` that are brought onto the grid: those that no input before it has brought.
fn own_columns<'a>(shapes: &[&'a Shape], i: usize) -> Result<Vec<&'a Column>, Fault> {
    let mut own = vec![];
    for column in shapes.get(i).map_or(&[][..], |shape| shape.columns.as_slice()) {
        let before = shapes.iter().take(i).position(|shape| shape.get(&column.name).is_some());
        match before {
            None => own.push(column),
            Some(_) if KEPT.contains(&column.name.as_str()) || DATE.contains(&column.name.as_str()) => {}
            Some(first) => {
                let name = &column.name;
                let what = format!("both input {} and input {} have a column `{name}`", first + 1, i + 1);
                let help = "rename one with `rename` of its table, or leave it out with `select`";
                return Err(Fault::new(what).help(help).of_param("input"));
            }
        }
    }
    Ok(own)
}

impl Stage for Resample {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        shape(inputs, 0)?;
        let shapes: Vec<&Shape> = inputs.iter().map(|table| table.shape()).collect();
        let mut faults = self.contradictions(&shapes);
        let own: Vec<Vec<&Column>> = (0..shapes.len())
            .filter_map(|i| own_columns(&shapes, i).map_err(|fault| faults.push(fault)).ok())
            .collect();
        for (i, columns) in own.iter().enumerate() {
            faults.extend(columns.iter().filter_map(|c| lagged_entry(c)));
            faults.extend(columns.iter().filter_map(|c| self.lag_again(i, c)));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        // The grid, and so every value on it, depends on the times of all inputs.
        let times: Vec<(usize, String)> = (0..shapes.len())
            .flat_map(|i| {
                let date = if shapes.len() > 1 { date_columns(shapes[i]) } else { &[] };
                std::iter::once("tt").chain(date.iter().copied()).map(move |name| (i, name.to_owned()))
            })
            .collect();
        let made = own.iter().enumerate().flat_map(|(i, columns)| columns.iter().map(move |c| (i, *c)));
        let made = made.map(|(i, c)| {
            let mut from = times.clone();
            if !from.contains(&(i, c.name.clone())) {
                from.push((i, c.name.clone()));
            }
            let mut column = Column { from, ..c.clone() };
            let rated = !column.sampling.entries.is_empty();
            column.sampling.rate_hz = rated.then_some(self.rate_hz);
            if self.lag_of(i, &c.name) != 0.0 && is_field(c) {
                column.removed.insert(Correction::Lag);
            }
            column
        });
        let reads = |(i, columns): (usize, &Vec<&Column>)| {
            let mut names: Vec<String> = columns.iter().map(|c| c.name.clone()).collect();
            let missing = times.iter().filter(|(input, name)| *input == i && !names.contains(name));
            let missing: Vec<String> = missing.map(|(_, name)| name.clone()).collect();
            names.extend(missing);
            names
        };
        let mut yields = Yield::append(made.collect(), &[""; 0]);
        yields.reads = own.iter().enumerate().map(reads).collect();
        yields.passes = Passes::None;
        yields.lenient = true;
        yields.rate_hz = Some(self.rate_hz);
        Ok(yields)
    }
}

/// The samples of one input: their times from the midnight that those of the first count from.
struct Samples<'a> {
    batch: &'a RecordBatch,
    tt: Vec<f64>,
}

impl LineStage for Resample {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    fn run(&self, line: &LineIn, (): &()) -> Arrays {
        let inputs = self.samples(line)?;
        let grid = self.grid(&inputs)?;
        if grid.is_empty() {
            return Err(Fault::data(format!("the line is too short to hold a sample at {} Hz", self.rate_hz)));
        }
        let shapes: Vec<Shape> = inputs.iter().map(|i| Shape::of(&i.batch.schema())).collect();
        let shapes: Vec<&Shape> = shapes.iter().collect();
        let mut made = vec![];
        for (i, samples) in inputs.iter().enumerate() {
            let plan = self.plan(samples, &grid, i)?;
            for column in own_columns(&shapes, i)? {
                let more = self.lag_of(i, &column.name) - self.lag_of_input(i);
                let array = match more == 0.0 {
                    true => self.column(samples.batch, &plan, column, line),
                    false => {
                        let later = Samples { batch: samples.batch, tt: samples.tt.iter().map(|t| t - more).collect() };
                        let plan = self.plan(&later, &grid, i)?;
                        self.column(samples.batch, &plan, column, line)
                    }
                };
                made.push(array.map_err(|e| e.in_column(&column.name))?);
            }
        }
        Ok(made)
    }
}

impl Resample {
    /// The inputs with their times, less the lag of each.
    fn samples<'a>(&self, line: &'a LineIn) -> Result<Vec<Samples<'a>>, Fault> {
        let first = line.inputs.first().ok_or_else(|| Fault::bug("a stage without an input"))?;
        let one = |(i, batch): (usize, &'a RecordBatch)| {
            let shift = if i == 0 { 0.0 } else { offset_s(first, batch)? } - self.lag_of_input(i);
            Ok(Samples { batch, tt: floats(batch, "tt")?.iter().map(|t| t + shift).collect() })
        };
        line.inputs.iter().enumerate().map(one).collect()
    }

    fn plan<'a>(&self, samples: &'a Samples, grid: &[f64], i: usize) -> Result<Plan<'a>, Fault> {
        Plan::onto(&samples.tt, grid.to_vec(), self.rate_hz, self.max_gap_of(i)).map_err(data)
    }

    /// The times of the grid.
    fn grid(&self, inputs: &[Samples]) -> Result<Vec<f64>, Fault> {
        let counted = match self.span {
            Span::All => inputs,
            Span::First => inputs.get(..1).unwrap_or_default(),
        };
        let mut ends = vec![];
        for (i, samples) in counted.iter().enumerate() {
            // A faulty clock has no first and last time to speak of.
            Plan::onto(&samples.tt, vec![], self.rate_hz, self.max_gap_of(i)).map_err(data)?;
            if let (Some(first), Some(last)) = (samples.tt.first(), samples.tt.last()) {
                ends.push((*first, *last));
            } else {
                return Ok(vec![]);
            }
        }
        let first_s = ends.iter().map(|e| e.0).fold(f64::NEG_INFINITY, f64::max);
        let last_s = ends.iter().map(|e| e.1).fold(f64::INFINITY, f64::min);
        if first_s > last_s {
            let spans: Vec<String> = ends.iter().map(|(a, b)| format!("{a} s to {b} s")).collect();
            let what = format!("the inputs have no time in common: {}", spans.join("; "));
            return Err(Fault::data(what).in_column("tt").help("do all of them count seconds past midnight UTC?"));
        }
        even_grid(first_s, last_s, self.rate_hz).map_err(data)
    }

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

    /// A list column, entry by entry: differences per sample become those of the new rate.
    fn entries(&self, batch: &RecordBatch, plan: &Plan, name: &str) -> Result<ArrayRef, Fault> {
        let (values, terms) = matrix(batch, name)?;
        let (own, width) = (sampling(batch, name)?, terms.len());
        let mut out = vec![0.0; plan.grid().len() * width];
        for (at, term) in terms.iter().enumerate() {
            let factor = rate_factor(&own, term, Some(self.rate_hz))?;
            let one: Vec<f64> = values.iter().skip(at).step_by(width).map(|x| factor * x).collect();
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
        Resample {
            rate_hz: 10.0,
            method: Method::Linear,
            max_gap_s: vec![1.0],
            span: Span::All,
            lag_s: BTreeMap::new(),
            input_lag_s: None,
        }
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
        let bridged = Resample { max_gap_s: vec![3.0], ..resample() }.run(&with_a_gap(), &()).unwrap();
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

    /// A table of one sensor: its times and the columns that it measures, as floats of a unit.
    fn sensor(tt: Vec<f64>, columns: Vec<(&str, &str, Vec<f64>)>) -> RecordBatch {
        let columns = [("tt", "s", tt)].into_iter().chain(columns);
        let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) =
            columns.map(|(name, unit, values)| (Column::float(name, unit, "").field(), array(values))).unzip();
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
    }

    fn times(first: f64, rate_hz: f64, rows: i32) -> Vec<f64> {
        (0..rows).map(|k| first + f64::from(k) / rate_hz).collect()
    }

    fn of(tt: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
        tt.iter().map(|t| f(*t)).collect()
    }

    fn together(stage: &Resample, inputs: Vec<RecordBatch>) -> Result<Vec<Vec<f64>>, Fault> {
        let line = LineIn { flight: "1".into(), line: "1.01".into(), inputs, keep: None };
        Ok(stage.run(&line, &())?.iter().map(|a| numbers(a).to_vec()).collect())
    }

    #[test]
    fn law_sensors_of_their_own_rates_meet_on_one_grid_over_the_time_of_all() {
        let (mag, gps) = (times(100.03, 40.0, 400), times(101.2, 1.0, 8));
        let inputs = || {
            vec![
                sensor(mag.clone(), vec![("mag_1_uc", "nT", of(&mag, straight))]),
                sensor(gps.clone(), vec![("alt", "m", of(&gps, |t| -straight(t))), ("yaw", "deg", of(&gps, heading))]),
            ]
        };
        let made = together(&resample(), inputs()).unwrap();
        assert_eq!(made.len(), 4);
        assert_eq!(made[0], (1012..=1082).map(|k| f64::from(k) / 10.0).collect::<Vec<_>>());
        for (k, t) in made[0].iter().enumerate() {
            assert!((made[1][k] - straight(*t)).abs() < 1e-9 && (made[2][k] + straight(*t)).abs() < 1e-9, "{t}");
            let off = (made[3][k] - heading(*t)).abs();
            assert!(off.min((off - 360.0).abs()) < 1e-9, "{t}");
        }
        let first = together(&Resample { span: Span::First, ..resample() }, inputs()).unwrap();
        // The last sample of the first is at 110.005 s.
        assert_eq!((first[0][0], first[0].last().copied()), (100.1, Some(110.0)));
        let known = |k: usize| (101.2..=108.2).contains(&first[0][k]);
        assert!((0..first[0].len()).all(|k| first[1][k].is_finite() && first[2][k].is_finite() == known(k)));
    }

    #[test]
    fn law_a_late_sensor_is_set_back_by_its_lag() {
        let tt = times(100.0, 50.0, 500);
        let wave = |t: f64| (3.0 * t).sin();
        // A value stamped t was measured at t - 0.06 s.
        let batch = sensor(
            tt.clone(),
            vec![
                ("mag_1_uc", "nT", of(&tt, wave)),
                ("flux_a_x", "nT", of(&tt, |t| wave(t - 0.06))),
                ("flux_a_t", "nT", of(&tt, |t| wave(t - 0.06))),
                ("cur_1", "A", of(&tt, |t| wave(t + 0.1))),
            ],
        );
        let lag_s = [("flux_a".to_owned(), 0.06), ("cur_1".to_owned(), -0.1)].into();
        let made = together(&Resample { lag_s, ..resample() }, vec![batch.clone()]).unwrap();
        let inside = 2..made[0].len() - 2;
        for k in inside {
            for column in &made[1..] {
                // Straight lines between samples of 50 Hz: 9/8 of 4e-4.
                assert!((column[k] - wave(made[0][k])).abs() < 5e-4, "{k}");
            }
        }
        // The same as the lag of the whole table, but for the grid, which ends with the samples.
        let late = sensor(tt.clone(), vec![("flux_b_x", "nT", of(&tt, |t| wave(t - 0.06)))]);
        let stage = Resample { input_lag_s: Some(vec![0.0, 0.06]), ..resample() };
        let made = together(&stage, vec![batch, late]).unwrap();
        assert!(made[5].iter().zip(&made[0]).all(|(x, t)| (x - wave(*t)).abs() < 5e-4));
    }

    #[test]
    fn law_tables_on_both_sides_of_midnight_meet_by_their_dates() {
        let dated = |tt: Vec<f64>, doy: f64, name: &str, from_s: f64| {
            let rows = tt.len();
            let values = of(&tt, |t| t + from_s);
            sensor(tt, vec![("year", "", vec![2020.0; rows]), ("doy", "", vec![doy; rows]), (name, "nT", values)])
        };
        let before = dated(times(86_390.0, 10.0, 200), 60.0, "a", 0.0);
        let after = dated(times(1.0, 10.0, 50), 61.0, "b", 86_400.0);
        let made = together(&resample(), vec![before.clone(), after]).unwrap();
        assert_eq!(made[0].first().copied(), Some(86_401.0));
        assert!(made[0].iter().zip(&made[4]).all(|(t, x)| (t - x).abs() < 1e-9), "a and b hold the same time");
        assert_eq!(made.len(), 5, "the date is there once");
        let late = dated(times(1.0, 10.0, 50), 62.0, "b", 0.0);
        let fault = together(&resample(), vec![before, late]).unwrap_err();
        assert!(fault.what.contains("no time in common"), "{fault}");
    }

    #[test]
    fn unit_what_two_tables_contradict_each_other_in_is_told_before_anything_runs() {
        let table = |names: &[&str]| {
            let columns = names.iter().map(|name| Column::float(*name, "", "")).collect();
            Table::Lines(Shape { columns, rate_hz: None })
        };
        let (mag, gps) = (table(&["tt", "year", "doy", "mag_1_uc"]), table(&["tt", "year", "doy", "alt"]));
        let made = resample().yields(&[&mag, &gps]).unwrap();
        let names: Vec<&str> = made.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["tt", "year", "doy", "mag_1_uc", "alt"]);
        assert_eq!(made.reads, [vec!["tt", "year", "doy", "mag_1_uc"], vec!["alt", "tt", "year", "doy"]]);
        let alt = &made.columns[4].from;
        assert!(alt.contains(&(0, "tt".into())) && alt.contains(&(1, "tt".into())) && alt.contains(&(1, "alt".into())));
        let said = |stage: Resample, inputs: &[&Table]| {
            let faults = stage.yields(inputs).unwrap_err();
            faults
                .iter()
                .map(|f| format!("{f} [{}]", f.param.clone().unwrap_or_default()))
                .collect::<Vec<_>>()
                .join("; ")
        };
        let twice = said(resample(), &[&mag, &mag]);
        assert!(
            twice.contains("both input 1 and input 2 have a column `mag_1_uc`") && twice.ends_with("[input]"),
            "{twice}"
        );
        let lag_s = |name: &str| [(name.to_owned(), 0.1)].into();
        assert!(
            said(Resample { lag_s: lag_s("mag_1_cu"), ..resample() }, &[&mag]).contains("did you mean `mag_1_uc`?")
        );
        assert!(said(Resample { lag_s: lag_s("tt"), ..resample() }, &[&mag]).contains("has no lag"));
        let short = Resample { input_lag_s: Some(vec![0.1]), max_gap_s: vec![1.0; 3], ..resample() };
        let short = said(short, &[&mag, &gps]);
        assert!(short.contains("[max_gap_s]") && short.contains("[input_lag_s]"), "{short}");
    }
}
