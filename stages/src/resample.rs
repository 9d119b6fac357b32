//! Resamples a line, and sensors with separate tables, to an even grid of times.

use std::{collections::BTreeMap, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch, StringArray, UInt64Array};
use arrow_select::take::take;
use numerics::signal::resample::{ResamplePlan, SampleInterpolation, even_grid};
use schemas::{
    Column, ColumnType, Fault, LineInput, LineOutput, LineStage, MagneticCorrection, PassThroughColumns, RateLaw, Rule,
    Stage, StageSchema, Table, TableShape, choice, stage,
};

use crate::{
    columns::{array, data, floats, list, matrix, rate_factor, sampling, shape},
    dates::{date_columns, offset_s},
    whole_numbers::between_samples,
};

stage! {
    /// Resamples every column of a line to evenly spaced times: the whole multiples of 1/`rate_hz`.
    ///
    /// Numbers are interpolated; angles (unit deg) are interpolated along the shorter arc. Text, booleans and columns
    /// of integer type take the value of the nearest sample. Other columns of whole numbers without a unit stay whole.
    /// A column with few distinct values holds codes or flags, and takes the value of the nearest sample. A column with
    /// many distinct values holds counts, which are interpolated and rounded. A column with a unit, or with the role
    /// sensor or truth, is a measured quantity. It is interpolated even if its values are whole. To have a column
    /// treated as measured, set its unit in `units` of its table.
    ///
    /// The new times begin at the first multiple at or after the first sample. They end at the last multiple at or
    /// before the last sample. Sensors that are resampled separately therefore have the same times.
    ///
    /// Times within a gap longer than `max_gap_s` are kept, with NaN (or null) in every column except `flight`, `line`
    /// and `tt`. A missing value counts as a gap in its column. If a line lacks a column that other lines have, the
    /// column's values are missing on that whole line. Repeated or decreasing times are rejected.
    ///
    /// `input` can list several tables of sensors with different sample rates, as in `input = ["mag", "imu", "gps"]`. A
    /// line combines the rows of the same flight and line in all tables. The columns of all tables are resampled to the
    /// same times. `span` selects whether these times cover the time common to all tables, or the time of the first
    /// table. If several tables have a date, their times are converted to seconds past the same midnight. A column name
    /// that occurs in two tables is rejected, except `year` and `doy`, which are read from the first table that has
    /// them. A line whose tables have no common time is rejected.
    ///
    /// `lag_s` and `input_lag_s` remove the lag of a sensor. With a lag of 0.06 s, a reading stamped t was measured at
    /// t - 0.06 s. The resampled value at t is therefore the reading stamped t + 0.06 s. The `lag` stage estimates lags
    /// with this sign.
    ///
    /// Some entries of list columns are differences per sample, such as the eddy terms of `tl`. They are converted to
    /// the new rate. A list with values of earlier samples is rejected: compute it after resampling. The stage also
    /// rejects a second removal of the lag of a column.
    ///
    /// The stage does not filter: at a lower rate, frequencies above half the new rate are aliased. Apply `lowpass` or
    /// `bandpass` first.
    Resample = "resample", version 3, grain Line, inputs [input: ManyLines],
    example r#"
[[stages]]
name    = "resample"
stage   = "resample"
input   = "flights"
rate_hz = 10.0
"#;
    /// New sample rate.
    rate_hz: f64, unit "Hz", rule Rule::Positive;
    /// Interpolation between samples; `cubic` is Akima's.
    method: SampleInterpolation, unit "", default SampleInterpolation::Linear;
    /// Longest gap over which values are interpolated: one value for all inputs, or one value per input.
    max_gap_s: Vec<f64>, unit "s", default vec![1.0], rule Rule::Positive;
    /// For several inputs: time that the line covers after resampling. `all` is the time common to all inputs, `first`
    /// the time of the first input.
    span: GridSpan, unit "", default GridSpan::All;
    /// Lag of each column, by column name. The name of a vector magnetometer, such as `flux_a`, sets the lag of its
    /// `x`, `y`, `z` and `t`. `lag_s` overrides `input_lag_s`.
    lag_s: BTreeMap<String, f64>, unit "s", default BTreeMap::new(), rule Rule::Finite;
    /// Lag of each input's sensors, one value per input.
    input_lag_s: Option<Vec<f64>>, unit "s", absent "0 for all", rule Rule::Finite;
}

choice! {
    /// Time that the grid of several tables covers.
    pub enum GridSpan {
        /// Time that all tables cover.
        All = "all",
        /// Time that the first table covers. Columns of other tables are NaN where they have no samples.
        First = "first",
    }
}

impl Resample {
    /// Lag of a column of the input `i`, in seconds.
    fn lag_of(&self, i: usize, name: &str) -> f64 {
        let of_vector = || {
            let (vector, _) = schemas::flight::vector_part(name)?;
            self.lag_s.get(vector)
        };
        let own = self.lag_s.get(name).or_else(of_vector);
        own.copied().unwrap_or_else(|| self.lag_of_input(i))
    }

    /// Fault if the lag of a column has already been removed.
    fn lag_again(&self, i: usize, column: &Column) -> Option<Fault> {
        let again = self.lag_of(i, &column.name) != 0.0 && column.removed.contains(&MagneticCorrection::Lag);
        let param = if self.lag_of_input(i) == 0.0 { "lag_s" } else { "input_lag_s" };
        again.then(|| {
            let what = format!("the lag of `{}` has already been removed", column.name);
            Fault::new(what).help(format!("remove the lag from `{param}`")).of_param(param)
        })
    }

    fn lag_of_input(&self, i: usize) -> f64 {
        self.input_lag_s.as_ref().and_then(|lags| lags.get(i)).copied().unwrap_or(0.0)
    }

    fn max_gap_of(&self, i: usize) -> f64 {
        self.max_gap_s.get(i).or(self.max_gap_s.first()).copied().unwrap_or(1.0)
    }

    /// Contradictions between the parameters and the inputs.
    fn contradictions(&self, shapes: &[&TableShape]) -> Vec<Fault> {
        let mut faults = vec![];
        let n = shapes.len();
        let mut count = |given: usize, param: &str| {
            let what = format!("there are {n} inputs, but `{param}` has {given} values");
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
                let what = format!("`{name}` is not a measured column, so it has no lag to remove");
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

/// Columns that are not interpolated: identifiers and the time.
const KEPT: [&str; 3] = ["flight", "line", "tt"];
const DATE: [&str; 2] = ["year", "doy"];

/// Whether a column is a magnetic reading, for which corrections are recorded.
fn is_field(column: &Column) -> bool {
    column.column_type == ColumnType::Float && column.unit == "nT"
}

/// Reason why a list column cannot be resampled to another rate.
fn lagged_entry(column: &Column) -> Option<Fault> {
    let (name, _) = column.sampling.entries.iter().find(|(_, law)| *law == RateLaw::Lag)?;
    let what = format!(
        "`{}` holds `{name}`, the value of an earlier sample, which has no equivalent at another rate",
        column.name
    );
    Some(Fault::new(what).help("compute the column after `resample`, or drop it with `select`").of_param("input"))
}

/// Resampled columns of the input `i`: columns that no earlier input has.
fn own_columns<'a>(shapes: &[&'a TableShape], i: usize) -> Result<Vec<&'a Column>, Fault> {
    let mut own = vec![];
    for column in shapes.get(i).into_iter().flat_map(|shape| &shape.columns) {
        let before = shapes.iter().take(i).position(|shape| shape.get(&column.name).is_some());
        match before {
            None => own.push(column),
            Some(_) if KEPT.contains(&column.name.as_str()) || DATE.contains(&column.name.as_str()) => {}
            Some(first) => {
                let name = &column.name;
                let what = format!("both input {} and input {} have a column `{name}`", first + 1, i + 1);
                let help = "rename one of the columns with `rename` in its table, or drop it with `select`";
                return Err(Fault::new(what).help(help).of_param("input"));
            }
        }
    }
    Ok(own)
}

impl Stage for Resample {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        shape(inputs, 0)?;
        let shapes: Vec<&TableShape> = inputs.iter().map(|table| table.shape()).collect();
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
        // The grid, and therefore every value on it, depends on the times of all inputs.
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
                column.removed.insert(MagneticCorrection::Lag);
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
        let mut yields = StageSchema::append(made.collect(), &[""; 0]);
        yields.reads = own.iter().enumerate().map(reads).collect();
        yields.passes = PassThroughColumns::None;
        yields.lenient = true;
        yields.rate_hz = Some(self.rate_hz);
        Ok(yields)
    }
}

/// Samples of one input, with times in s from the midnight of the first input's day.
struct ResampleInput<'a> {
    batch: &'a RecordBatch,
    tt: Vec<f64>,
}

impl LineStage for Resample {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let inputs = self.samples(line)?;
        let grid = self.grid(&inputs)?;
        if grid.is_empty() {
            return Err(Fault::data(format!("the line is too short for a sample at {} Hz", self.rate_hz)));
        }
        let shapes: Vec<TableShape> = inputs.iter().map(|i| TableShape::from_schema(&i.batch.schema())).collect();
        let shapes: Vec<&TableShape> = shapes.iter().collect();
        let mut made = vec![];
        for (i, samples) in inputs.iter().enumerate() {
            let plan = self.plan(samples, &grid, i)?;
            for column in own_columns(&shapes, i)? {
                let more = self.lag_of(i, &column.name) - self.lag_of_input(i);
                let array = match more == 0.0 {
                    true => self.column(samples.batch, &plan, column, line),
                    false => {
                        let later =
                            ResampleInput { batch: samples.batch, tt: samples.tt.iter().map(|t| t - more).collect() };
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
    /// Inputs. The lag of each input is subtracted from the times of the input.
    fn samples<'a>(&self, line: &'a LineInput) -> Result<Vec<ResampleInput<'a>>, Fault> {
        let first = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let one = |(i, batch): (usize, &'a RecordBatch)| {
            let shift = if i == 0 { 0.0 } else { offset_s(first, batch)? } - self.lag_of_input(i);
            Ok(ResampleInput { batch, tt: floats(batch, "tt")?.iter().map(|t| t + shift).collect() })
        };
        line.inputs.iter().enumerate().map(one).collect()
    }

    fn plan<'a>(&self, samples: &'a ResampleInput, grid: &[f64], i: usize) -> Result<ResamplePlan<'a>, Fault> {
        ResamplePlan::onto(&samples.tt, grid.to_vec(), self.rate_hz, self.max_gap_of(i)).map_err(data)
    }

    /// The times of the grid.
    fn grid(&self, inputs: &[ResampleInput]) -> Result<Vec<f64>, Fault> {
        let counted = match self.span {
            GridSpan::All => inputs,
            GridSpan::First => inputs.get(..1).unwrap_or_default(),
        };
        let mut ends = vec![];
        for (i, samples) in counted.iter().enumerate() {
            // The first and last time of a faulty clock are meaningless.
            ResamplePlan::onto(&samples.tt, vec![], self.rate_hz, self.max_gap_of(i)).map_err(data)?;
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
            return Err(Fault::data(what)
                .in_column("tt")
                .help("check that all inputs count seconds past midnight UTC"));
        }
        even_grid(first_s, last_s, self.rate_hz).map_err(data)
    }

    fn column(
        &self,
        batch: &RecordBatch,
        plan: &ResamplePlan,
        column: &Column,
        line: &LineInput,
    ) -> Result<ArrayRef, Fault> {
        let rows = plan.grid().len();
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; rows])) };
        match (column.name.as_str(), &column.column_type) {
            ("tt", _) => Ok(array(plan.grid().to_vec())),
            ("flight", _) => Ok(same(&line.flight)),
            ("line", _) => Ok(same(&line.line)),
            (name, ColumnType::Float) => {
                between_samples(plan, column, floats(batch, name)?, self.method).map(array).map_err(data)
            }
            (name, ColumnType::List(_)) => self.entries(batch, plan, name),
            (name, _) => {
                let at: UInt64Array = plan.nearest_rows().into_iter().map(|r| r.map(|r| r as u64)).collect();
                let values = batch.column_by_name(name).ok_or_else(|| Fault::data("is missing"))?;
                take(values, &at, None).map_err(data)
            }
        }
    }

    /// Resamples a list column, entry by entry. Differences per sample are converted to the new rate.
    fn entries(&self, batch: &RecordBatch, plan: &ResamplePlan, name: &str) -> Result<ArrayRef, Fault> {
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
mod tests;
