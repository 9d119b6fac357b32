//! The quality of a line's data: missing, infinite, impossible, constant and stuck values of each column, and the
//! faults that make the line unusable.
//!
//! Infinities, scalar magnetometer readings of exactly 0, and a few impossible values of a sensor become missing
//! values; each of these kinds is a finding. An impossible position, attitude or date is a fault. A sensor with
//! impossible values in more than a tenth of its samples is also a fault.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, Float64Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{DataType, Schema};
use schemas::{
    Fault, Role, describe_field, flight,
    plausible::{
        OutlierTreatment, PhysicalQuantity, PlausibilityCheck, PlausibleRange, ProbableCause, VECTOR, likely, limits,
        residual, shown,
    },
};

pub use super::finding::{FileColumns, Finding, FindingKind};
use super::{checks::stuck, consistency};

/// Impossible values of a sensor count as spikes if their share of the samples is at most this.
const SPIKES: f64 = 0.1;

/// Minimum number of rows of a line in which a constant column is reported.
const CONSTANT_ROWS: usize = 10;

/// Result of the examination of a line.
pub struct LineExamination {
    /// Samples, with NaN for values that count as missing.
    pub batch: RecordBatch,
    /// The findings, in the order of the columns.
    pub findings: Vec<Finding>,
    /// The faults that make the line unusable, one for each mistake.
    pub faults: Vec<Fault>,
}

/// Examines a whole line.
///
/// # Errors
/// Fails if the batch cannot be rebuilt, which data cannot cause.
pub fn examine(
    batch: &RecordBatch,
    origins: &FileColumns,
    accept: &[PlausibilityCheck],
) -> Result<LineExamination, Fault> {
    let mut line = QualityLine { columns: batch.columns().to_vec(), findings: vec![], faults: vec![], origins };
    let accepted = accept.contains(&PlausibilityCheck::Range);
    let schema = batch.schema();
    for (i, field) in schema.fields().iter().enumerate() {
        match field.data_type() {
            DataType::Float64 => line.column(i, &describe_field(field), accepted),
            DataType::Int64 => line.whole_numbers(i, field.name(), accepted),
            _ => {}
        }
    }
    line.vectors(&schema, accepted);
    let QualityLine { columns, mut findings, mut faults, .. } = line;
    let batch = RecordBatch::try_new(schema, columns).map_err(|e| Fault::data(e.to_string()))?;
    // An impossible value also contradicts other columns, but it is reported only once.
    let faulty: Vec<String> = faults.iter().filter_map(|f| f.place.column.clone()).collect();
    for (fault, finding) in consistency::contradictions(&batch, &faulty, origins) {
        findings.push(finding);
        if !accepted {
            faults.push(fault);
        }
    }
    Ok(LineExamination { batch, findings, faults })
}

struct QualityLine<'a> {
    columns: Vec<ArrayRef>,
    findings: Vec<Finding>,
    faults: Vec<Fault>,
    origins: &'a FileColumns,
}

/// Number of samples of a kind, and the row of the first of them.
#[derive(Clone, Copy, Default)]
struct RowTally {
    n: usize,
    first: usize,
}

impl RowTally {
    fn add(&mut self, row: usize) {
        if self.n == 0 {
            self.first = row;
        }
        self.n += 1;
    }
}

/// Number of samples of a column by kind.
struct SampleCounts {
    missing: RowTally,
    infinite: RowTally,
    zero: RowTally,
    outside: RowTally,
    /// Number of samples that are neither missing nor counted as missing.
    known: usize,
    constant: bool,
}

impl SampleCounts {
    /// Counts the samples. With `zeros`, a 0 is a dropout.
    fn from_values(values: &[f64], limits: Option<&PlausibleRange>, zeros: bool) -> SampleCounts {
        let [mut missing, mut infinite, mut zero, mut outside] = [RowTally::default(); 4];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (row, &x) in values.iter().enumerate() {
            if x.is_nan() {
                missing.add(row);
            } else if x.is_infinite() {
                infinite.add(row);
            } else if zeros && x == 0.0 {
                zero.add(row);
            } else {
                (low, high) = (low.min(x), high.max(x));
                if limits.is_some_and(|l| !l.holds(x)) {
                    outside.add(row);
                }
            }
        }
        let known = values.len() - missing.n - infinite.n - zero.n;
        SampleCounts { missing, infinite, zero, outside, known, constant: known >= CONSTANT_ROWS && low == high }
    }
}

impl QualityLine<'_> {
    fn column(&mut self, i: usize, about: &schemas::Column, accepted: bool) {
        let (name, unit) = (about.name.as_str(), about.unit.as_str());
        let array = self.columns[i].clone();
        let values: &[f64] = array.as_primitive::<Float64Type>().values();
        let usual = limits(name);
        let residual = usual.and_then(|l| residual(&l, values));
        let limits = residual.or(usual);
        let zeros = flight::is_scalar_reading(name);
        let counts = SampleCounts::from_values(values, limits.as_ref(), zeros);
        let kept = |x: f64| x.is_finite() && !(zeros && x == 0.0);
        let first = values.iter().position(|x| kept(*x)).unwrap_or(0);
        // A height may be constant.
        let dead =
            counts.constant && about.role == Role::Sensor && limits.is_none_or(|l| l.kind != PhysicalQuantity::Height);
        let unusual = |yes: bool| RowTally { n: if yes { counts.known } else { 0 }, first };
        for (check, tally) in [
            (FindingKind::Missing, counts.missing),
            (FindingKind::Infinite, counts.infinite),
            (FindingKind::ZeroReading, counts.zero),
            (FindingKind::Impossible, counts.outside),
            (FindingKind::NotTotalField, unusual(residual.is_some())),
            (FindingKind::Constant, unusual(dead)),
            (FindingKind::Stuck, if dead { RowTally::default() } else { stuck_samples(name, values) }),
        ] {
            if tally.n > 0 {
                let value = values.get(tally.first).copied().unwrap_or(f64::NAN);
                self.findings.push(Finding::new(name, check, tally.n, tally.first, value, unit));
            }
        }
        let mut spikes = None;
        if let Some(limits) = limits.filter(|_| counts.outside.n > 0 && !accepted) {
            if limits.outlier == OutlierTreatment::Missing && counts.outside.n as f64 <= SPIKES * counts.known as f64 {
                spikes = Some(limits);
            } else {
                let (value, n) = (values[counts.outside.first], (counts.outside, counts.known));
                self.faults.push(impossible(name, &limits, value, unit, n, self.origins));
            }
        }
        if counts.infinite.n + counts.zero.n > 0 || spikes.is_some() {
            let clean = |x: &f64| if kept(*x) && spikes.is_none_or(|l| l.holds(*x)) { *x } else { f64::NAN };
            self.columns[i] = Arc::new(values.iter().map(clean).collect::<Float64Array>());
        }
    }

    /// Examines a column of whole numbers, such as years and days.
    fn whole_numbers(&mut self, i: usize, name: &str, accepted: bool) {
        let Some(limits) = limits(name) else { return };
        let array = self.columns[i].as_primitive::<Int64Type>();
        let mut outside = RowTally::default();
        let rows = (0..array.len()).filter(|row| array.is_valid(*row));
        rows.filter(|row| !limits.holds(array.value(*row) as f64)).for_each(|row| outside.add(row));
        if outside.n == 0 {
            return;
        }
        let value = array.value(outside.first) as f64;
        let finite = array.len() - array.null_count();
        self.findings.push(Finding::new(name, FindingKind::Impossible, outside.n, outside.first, value, ""));
        if !accepted {
            self.faults.push(impossible(name, &limits, value, "", (outside, finite), self.origins));
        }
    }

    /// Examines the magnitude of each vector magnetometer. The components have already been examined.
    fn vectors(&mut self, schema: &Schema, accepted: bool) {
        for (at, vector) in vectors(schema) {
            let faulty =
                |f: &Fault| f.place.column.as_deref().and_then(flight::vector_part).is_some_and(|p| p.0 == vector);
            let parts: Vec<Float64Array> =
                at.iter().map(|i| self.columns[*i].as_primitive::<Float64Type>().clone()).collect();
            let [x, y, z] = parts.as_slice() else { continue };
            let magnitude = |row: usize| {
                let (x, y, z) = (x.value(row), y.value(row), z.value(row));
                (x * x + y * y + z * z).sqrt()
            };
            let (mut outside, mut finite) = (RowTally::default(), 0);
            for row in 0..x.len() {
                let b = magnitude(row);
                if b.is_finite() {
                    finite += 1;
                    if !VECTOR.holds(b) {
                        outside.add(row);
                    }
                }
            }
            if outside.n == 0 {
                continue;
            }
            let value = magnitude(outside.first);
            self.findings.push(Finding::new(&vector, FindingKind::Impossible, outside.n, outside.first, value, "nT"));
            if accepted {
                continue;
            }
            if outside.n as f64 > SPIKES * finite as f64 {
                // The fault of a magnitude replaces the fault of a component with the same cause.
                self.faults.retain(|f| !faulty(f));
                let column = format!("{vector}_x");
                let fault = impossible(&column, &VECTOR, value, "nT", (outside, finite), self.origins);
                self.faults.push(fault);
                continue;
            }
            for (i, part) in at.into_iter().zip(&parts) {
                let kept = |row: usize| !magnitude(row).is_finite() || VECTOR.holds(magnitude(row));
                let clean = (0..part.len()).map(|row| if kept(row) { part.value(row) } else { f64::NAN });
                self.columns[i] = Arc::new(clean.collect::<Float64Array>());
            }
        }
    }
}

/// Samples of a magnetometer at which it stays at one value for far longer than usual; none for other columns.
fn stuck_samples(name: &str, values: &[f64]) -> RowTally {
    let is_scalar = flight::is_scalar_reading(name);
    if !is_scalar && flight::vector_part(name).is_none() {
        return RowTally::default();
    }
    let is_reading = |x: &f64| x.is_finite() && !(is_scalar && *x == 0.0);
    let runs = stuck::stretches(values);
    let rows = runs.into_iter().filter(|run| values.get(run.start).is_some_and(is_reading)).flatten();
    let mut tally = RowTally::default();
    rows.for_each(|row| tally.add(row));
    tally
}

/// The vector magnetometers of a flight, each with the positions of its three components.
fn vectors(schema: &Schema) -> Vec<([usize; 3], String)> {
    let at = |name: String| schema.index_of(&name).ok().filter(|i| *schema.field(*i).data_type() == DataType::Float64);
    let of = |field: &Arc<arrow_schema::Field>| match flight::vector_part(field.name())? {
        (vector, 'x') => {
            let [x, y, z] = ["x", "y", "z"].map(|part| at(format!("{vector}_{part}")));
            Some(([x?, y?, z?], vector.to_owned()))
        }
        _ => None,
    };
    schema.fields().iter().filter_map(of).collect()
}

/// The fault of a column that has impossible values: with the first value, the number of values, and the valid range.
fn impossible(
    name: &str,
    limits: &PlausibleRange,
    value: f64,
    unit: &str,
    (outside, finite): (RowTally, usize),
    origins: &FileColumns,
) -> Fault {
    let unit_of = |x: f64| if unit.is_empty() { shown(x) } else { format!("{} {unit}", shown(x)) };
    let mut what =
        format!("{} is not {} ({} to {})", unit_of(value), limits.kind.noun(), shown(limits.low), unit_of(limits.high));
    if outside.n > 1 {
        what += &format!("; this applies to {} of {} values", outside.n, finite);
    }
    // One wrong value among many is not a unit error.
    let common = 2 * outside.n > finite;
    let hint = common.then(|| likely(limits, value, origins.unit(name))).flatten();
    let hint = hint.map(|l| described(name, &l, origins)).or_else(|| guessed(limits.kind, value));
    let accept = "`accept = [\"range\"]` accepts the values unchanged";
    let help = hint.map_or_else(|| format!("correct the file; {accept}"), |hint| format!("{hint}; {accept}"));
    Fault::data(what).in_column(name).in_row(outside.first as u64).help(help)
}

/// The probable meaning of a value, and how to declare it.
fn described(name: &str, likely: &ProbableCause, origins: &FileColumns) -> String {
    match likely {
        ProbableCause::Unit(unit, value) => {
            let ours = flight::describe(name).unit;
            let units = match flight::vector_part(name) {
                Some((vector, 'x' | 'y' | 'z')) => {
                    let all = ["x", "y", "z"].map(|part| format!("{vector}_{part}"));
                    origins.units(&all.each_ref().map(String::as_str), unit)
                }
                _ => origins.units(&[name], unit),
            };
            format!("if the value is in {unit}, it is {} {ours}: {units}", shown(*value))
        }
        ProbableCause::DegreesMinutes(value) => {
            format!(
                "if the value is in degrees and minutes (NMEA ddmm.mm), it is {} deg; convert the column",
                shown(*value)
            )
        }
        ProbableCause::GpsWeek(day, second) => format!(
            "if the value is in seconds of a GPS week, it is {} s of day {day}; `tt` must be in seconds past midnight \
             UTC",
            shown(*second)
        ),
        ProbableCause::Unix(second) => {
            format!(
                "if the value is a Unix time, it is {} s of the day; `tt` must be in seconds past midnight UTC",
                shown(*second)
            )
        }
    }
}

/// The possible meaning of an impossible value that no other unit explains.
fn guessed(kind: PhysicalQuantity, value: f64) -> Option<String> {
    let digits = value.abs().to_string();
    if digits.len() >= 3 && digits.bytes().all(|b| b == b'9') {
        return Some(format!("if {value} represents a missing value, set `missing = [\"{value}\"]`"));
    }
    match kind {
        PhysicalQuantity::Variation | PhysicalQuantity::Anomaly if (15_000.0..80_000.0).contains(&value) => {
            Some("the column is probably a total field; subtract its mean or the core field".to_owned())
        }
        PhysicalQuantity::Year if (0.0..100.0).contains(&value) => Some(format!(
            "write the year with four digits, \
            {}",
            2000.0 + value
        )),
        _ => None,
    }
}
