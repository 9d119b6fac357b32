//! Positions and attitudes of the flights of a log.

use std::{collections::BTreeMap, path::Path};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use schemas::{Fault, canonical::FlightConversion};

use super::{AttitudeChannel, FlightChannels, LineDetection, PositionChannel};
use crate::{line_table::LineTable, log_reader::LogReader, midnight::MidnightUnwrapper};

/// Minimum time between used samples, in seconds: lines are found at a few samples per second.
const STEP_S: f64 = 0.095;
/// Columns of positions, in order of preference.
const POSITIONS: [[&str; 3]; 2] = [["lat", "lon", "alt"], ["ins_lat", "ins_lon", "ins_alt"]];
/// Column of the height in a table without the usual height columns.
const OTHER_HEIGHT: &str = "msl";
/// Columns of attitudes, in order of preference.
const ATTITUDES: [[&str; 3]; 2] = [["ins_roll", "ins_pitch", "ins_yaw"], ["roll", "pitch", "yaw"]];

/// Three columns of a flight in one table.
#[derive(Clone, Debug, Default)]
struct TimedTriples {
    rows: Vec<[f64; 4]>,
}

impl TimedTriples {
    /// Number of rows in which the first two values are known.
    fn known(&self) -> usize {
        self.rows.iter().filter(|[_, a, b, _]| a.is_finite() && b.is_finite()).count()
    }

    /// The rows in the order of time, without repeated times.
    fn in_time(mut self) -> Vec<[f64; 4]> {
        self.rows.retain(|row| row[0].is_finite());
        self.rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
        self.rows.dedup_by(|a, b| a[0] == b[0]);
        self.rows
    }
}

/// Positions and attitudes of one flight, from one table of a log.
#[derive(Default)]
struct FlightReadings {
    rise: MidnightUnwrapper,
    last_s: Option<f64>,
    positions: [TimedTriples; 2],
    attitudes: [TimedTriples; 2],
}

/// Collector of positions and attitudes by flight, from the tables of a log.
#[derive(Default)]
pub struct ChannelCollector {
    /// Readings of each table, by flight.
    flights: BTreeMap<String, BTreeMap<String, FlightReadings>>,
}

impl ChannelCollector {
    /// Reads a table of a log; tables with the same name are concatenated.
    ///
    /// # Errors
    /// Fails for a log that cannot be read.
    pub fn read(&mut self, mut log: LogReader, table: &str) -> Result<(), Fault> {
        let canonical = FlightConversion::new(&log.schema).map_err(|f| f.into_iter().next().unwrap_or_default())?;
        for reading in self.flights.values_mut().filter_map(|tables| tables.get_mut(table)) {
            (reading.rise, reading.last_s) = (MidnightUnwrapper::default(), None);
        }
        while let Some(part) = log.next_part() {
            let batch = canonical.apply_with_zeros(&part.map_err(Fault::from)?.batch)?;
            self.add(&batch, table)?;
        }
        Ok(())
    }

    /// The flights, each with its detected lines.
    pub fn found(self) -> Vec<(String, LineDetection)> {
        let best = |all: &mut dyn Iterator<Item = TimedTriples>| {
            // Of several tables with the same number of known rows, the first is used.
            let best = all.reduce(|a, b| if b.known() > a.known() { b } else { a }).filter(|t| t.known() > 0);
            best.map(TimedTriples::in_time).unwrap_or_default()
        };
        let one = |(flight, tables): (String, BTreeMap<String, FlightReadings>)| {
            let (mut positions, mut attitudes) = (vec![], vec![]);
            for table in tables.into_values() {
                positions.extend(table.positions);
                attitudes.extend(table.attitudes);
            }
            let (at, turned) = (best(&mut positions.into_iter()), best(&mut attitudes.into_iter()));
            let column = |rows: &[[f64; 4]], k: usize| rows.iter().map(|row| row[k]).collect::<Vec<f64>>();
            let channels = FlightChannels {
                position: PositionChannel {
                    tt_s: column(&at, 0),
                    lat_deg: column(&at, 1),
                    lon_deg: column(&at, 2),
                    alt_m: column(&at, 3),
                },
                attitude: AttitudeChannel {
                    tt_s: column(&turned, 0),
                    angles_deg: [column(&turned, 1), column(&turned, 2), column(&turned, 3)],
                },
            };
            (flight, LineDetection::from_channels(&channels))
        };
        self.flights.into_iter().map(one).collect()
    }

    /// Adds rows of the flight table.
    fn add(&mut self, batch: &RecordBatch, table: &str) -> Result<(), Fault> {
        let lost = || Fault::bug("a batch of flights lacks a key column");
        let flights = batch.column_by_name("flight").and_then(|c| c.as_string_opt::<i32>()).ok_or_else(lost)?;
        let column = |name: &str| batch.column_by_name(name).and_then(|c| c.as_primitive_opt::<Float64Type>());
        let tt = column("tt").ok_or_else(lost)?;
        let mut triples = [POSITIONS, ATTITUDES].map(|all| all.map(|names| names.map(column)));
        for [_, _, height] in &mut triples[0] {
            *height = height.or(column(OTHER_HEIGHT));
        }
        for row in 0..batch.num_rows() {
            let flight = if flights.is_null(row) { "" } else { flights.value(row) };
            if !self.flights.contains_key(flight) {
                self.flights.insert(flight.to_owned(), BTreeMap::new());
            }
            let Some(tables) = self.flights.get_mut(flight) else { continue };
            if !tables.contains_key(table) {
                tables.insert(table.to_owned(), FlightReadings::default());
            }
            let Some(reading) = tables.get_mut(table) else { continue };
            let tt_s = reading.rise.next(if tt.is_null(row) { f64::NAN } else { tt.value(row) });
            if reading.last_s.is_some_and(|last| (0.0..STEP_S).contains(&(tt_s - last))) {
                continue;
            }
            reading.last_s = Some(tt_s);
            let value = |c: Option<&arrow_array::Float64Array>| {
                c.filter(|c| c.is_valid(row)).map_or(f64::NAN, |c| c.value(row))
            };
            let [positions, attitudes] = &triples;
            for (from, to) in
                positions.iter().zip(&mut reading.positions).chain(attitudes.iter().zip(&mut reading.attitudes))
            {
                if from[0].is_some() && from[1].is_some() {
                    to.rows.push([tt_s, value(from[0]), value(from[1]), value(from[2])]);
                }
            }
        }
        Ok(())
    }
}

/// The lines detected in the flights of a file.
///
/// # Errors
/// Fails for a file that cannot be read, or for a flight without lines.
pub fn table(log: LogReader, path: &Path) -> Result<LineTable, Fault> {
    let mut collector = ChannelCollector::default();
    collector.read(log, "")?;
    let flights = collector.found();
    let file = path.display().to_string();
    if let Some(fault) = flights.iter().find_map(|(flight, found)| found.missing(flight)) {
        return Err(fault.in_file(&file));
    }
    Ok(LineTable::new("the lines that were found", flights.iter().map(|(f, found)| (f.clone(), found.spans()))))
}
