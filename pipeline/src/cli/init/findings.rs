//! The columns, lines, rates and sensors of a log.

use std::{collections::BTreeMap, path::Path};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::DataType;
use datasets::{FlightOptions, ReadHints};
use intake::{mapping::MappingTable, open_log};
use schemas::{Fault, canonical::FlightConversion, flight};

use super::text::InitSource;

/// Length of the running mean of the direction, in seconds; manoeuvres are deviations from this mean.
const MEAN_S: f64 = 10.0;
/// An aircraft counts as flying above this ground speed, in m/s.
const FLYING_M_S: f64 = 3.0;
/// Number of time steps from which the rate of a line is determined.
const STEPS: usize = 5_000;

/// One line of a log.
#[derive(Clone, Debug, Default)]
pub struct LineFinding {
    pub rows: usize,
    pub first_tt: f64,
    pub last_tt: f64,
    pub rate_hz: Option<f64>,
    /// Root mean square deviation of the direction of the first vector magnetometer from its running mean over
    /// [`MEAN_S`], in degrees.
    pub swing_deg: Option<f64>,
    /// First and last time with a ground speed above [`FLYING_M_S`].
    pub flying: Option<(f64, f64)>,
    steps: Vec<f64>,
    mean: Option<[f64; 3]>,
    swing: (f64, usize),
}

/// Range of a column.
#[derive(Clone, Debug, Default)]
pub struct ColumnFinding {
    pub unit: String,
    pub known: usize,
    pub low: f64,
    pub high: f64,
}

/// One table of a log.
#[derive(Clone, Debug, Default)]
pub struct TableFindings {
    /// Name in the mapping; empty without a mapping or for the only table.
    pub name: String,
    pub columns: BTreeMap<String, ColumnFinding>,
    /// By flight and line.
    pub lines: BTreeMap<(String, String), LineFinding>,
    pub faults: usize,
    pub scalars: Vec<String>,
    pub vectors: Vec<String>,
}

/// The findings in a log.
pub struct LogFindings {
    pub format: String,
    pub tables: Vec<TableFindings>,
    pub questions: Vec<String>,
    /// The keys that the spec must give, because the log lacks them.
    pub flight: Option<String>,
    pub line: Option<String>,
}

impl LogFindings {
    /// Reads all tables of a log.
    pub fn read(log: &Path, source: &InitSource) -> Result<LogFindings, Fault> {
        let mut options = super::choose::keys(source.mapping.is_some(), log, FlightOptions::default());
        let mut found = LogFindings {
            format: String::new(),
            tables: vec![],
            questions: vec![],
            flight: options.flight.take(),
            line: options.line.take(),
        };
        let options = FlightOptions { flight: found.flight.clone(), line: found.line.clone(), ..options };
        let mut mapped: Vec<Option<MappingTable>> = vec![];
        match &source.mapping {
            None => mapped.push(None),
            Some(mapping) => {
                for name in mapping.tables() {
                    mapped.push(Some(mapping.table(Some(name))?));
                }
            }
        }
        let (several, mut last) = (mapped.len() > 1, None);
        for table in mapped {
            match found.table(log, &options, table.as_ref(), several) {
                Ok(table) => found.tables.push(table),
                // A table of a mapping may be absent from a log.
                Err(fault) => last = Some(fault),
            }
        }
        match last {
            Some(fault) if found.tables.is_empty() => Err(fault),
            _ => Ok(found),
        }
    }

    fn table(
        &mut self,
        log: &Path,
        options: &FlightOptions,
        mapped: Option<&MappingTable>,
        several: bool,
    ) -> Result<TableFindings, Fault> {
        let mut reader = open_log(log, options, mapped, &ReadHints::default()).map_err(Fault::from)?;
        self.format = reader.format.to_owned();
        let canonical = FlightConversion::new(&reader.schema).map_err(|f| f.into_iter().next().unwrap_or_default())?;
        let mut table = TableFindings::default();
        if several {
            table.name = mapped.map_or("", MappingTable::name).to_owned();
        }
        let names: Vec<String> = canonical.schema().fields().iter().map(|f| f.name().clone()).collect();
        let vector = names.iter().find_map(|n| flight::vector_part(n).map(|(sensor, _)| sensor.to_owned()));
        while let Some(part) = reader.next_part() {
            let part = part.map_err(Fault::from)?;
            table.faults += part.faults.len();
            table.add(&canonical.apply(&part.batch)?, vector.as_deref())?;
        }
        table.finish();
        Ok(table)
    }
}

impl TableFindings {
    fn add(&mut self, batch: &RecordBatch, vector: Option<&str>) -> Result<(), Fault> {
        let lost = || Fault::bug("a batch of flights lacks a key column");
        let number = |name: &str| batch.column_by_name(name).and_then(|c| c.as_primitive_opt::<Float64Type>());
        for field in batch.schema().fields() {
            let Some(values) = batch.column_by_name(field.name()).filter(|c| c.data_type().is_numeric()) else {
                continue;
            };
            let wrong = |e: arrow_schema::ArrowError| Fault::data(e.to_string()).in_column(field.name());
            let values = cast(values, &DataType::Float64).map_err(wrong)?;
            let values = values.as_primitive::<Float64Type>();
            let column = self.columns.entry(field.name().clone()).or_insert_with(|| ColumnFinding {
                unit: field.metadata().get("unit").cloned().unwrap_or_default(),
                known: 0,
                low: f64::INFINITY,
                high: f64::NEG_INFINITY,
            });
            for x in values.iter().flatten().filter(|x| x.is_finite()) {
                column.known += 1;
                (column.low, column.high) = (column.low.min(x), column.high.max(x));
            }
        }
        let text = |name: &str| batch.column_by_name(name).and_then(|c| c.as_string_opt::<i32>()).ok_or_else(lost);
        let (flights, lines, tt) = (text("flight")?, text("line")?, number("tt").ok_or_else(lost)?);
        let velocity = number("vn").zip(number("ve"));
        let axes = vector.map(|v| ["x", "y", "z"].map(|axis| number(&format!("{v}_{axis}"))));
        for row in 0..batch.num_rows() {
            let word = |c: &arrow_array::StringArray| if c.is_null(row) { "" } else { c.value(row) }.to_owned();
            let line = self.lines.entry((word(flights), word(lines))).or_default();
            let value = |c: &arrow_array::Float64Array| if c.is_null(row) { f64::NAN } else { c.value(row) };
            let field = match axes {
                Some([Some(x), Some(y), Some(z)]) => Some([value(x), value(y), value(z)]),
                _ => None,
            };
            line.add(value(tt), field);
            if velocity.is_some_and(|(north, east)| value(north).hypot(value(east)) > FLYING_M_S) {
                let first = line.flying.map_or(value(tt), |(first, _)| first);
                line.flying = Some((first, value(tt)));
            }
        }
        Ok(())
    }

    fn finish(&mut self) {
        for line in self.lines.values_mut() {
            line.steps.sort_by(f64::total_cmp);
            line.rate_hz = line.steps.get(line.steps.len() / 2).filter(|step| **step > 0.0).map(|step| 1.0 / step);
            let (sum, n) = line.swing;
            line.swing_deg = (n > 0).then(|| (sum / n as f64).sqrt().to_degrees());
        }
        // A constant or empty sensor is not a candidate.
        let varies = |name: &str| self.columns.get(name).is_some_and(|c| c.known > 1 && c.high > c.low);
        self.scalars = self.columns.keys().filter(|n| flight::is_scalar_reading(n) && varies(n)).cloned().collect();
        let mut vectors: Vec<String> =
            self.columns.keys().filter_map(|n| flight::vector_part(n).map(|(v, _)| v.to_owned())).collect();
        vectors.dedup();
        vectors.retain(|v| ["x", "y", "z"].iter().all(|axis| varies(&format!("{v}_{axis}"))));
        self.vectors = vectors;
    }

    /// Whether the table has values of a column.
    pub fn has(&self, name: &str) -> bool {
        self.columns.get(name).is_some_and(|c| c.known > 0)
    }

    /// The lowest rate of the table's lines, in Hz.
    pub fn rate_hz(&self) -> Option<f64> {
        self.lines.values().filter_map(|l| l.rate_hz).reduce(f64::min)
    }
}

impl LineFinding {
    fn add(&mut self, tt: f64, field: Option<[f64; 3]>) {
        if self.rows == 0 {
            self.first_tt = tt;
        }
        let step = tt - self.last_tt;
        if self.rows > 0 && step > 0.0 && self.steps.len() < STEPS {
            self.steps.push(step);
        }
        self.rows += 1;
        self.last_tt = tt;
        let Some(field) = field else { return };
        let size = field.iter().map(|x| x * x).sum::<f64>().sqrt();
        if !(size > 0.0 && size.is_finite()) {
            return;
        }
        let unit = field.map(|x| x / size);
        let mean = *self.mean.get_or_insert(unit);
        let share = (step / MEAN_S).clamp(0.0, 1.0);
        let share = if share.is_finite() { share } else { 0.0 };
        let kept = [0, 1, 2].map(|i| mean[i] + share * (unit[i] - mean[i]));
        self.mean = Some(kept);
        self.swing.0 += (0..3).map(|i| (unit[i] - kept[i]).powi(2)).sum::<f64>();
        self.swing.1 += 1;
    }
}
