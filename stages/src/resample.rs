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
