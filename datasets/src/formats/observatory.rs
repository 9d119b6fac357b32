//! The record of an observatory as a flight log: the station is the flight, and each UTC day is a line.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use numerics::{
    angle::wrap_deg,
    earth::dates::{day_of_year, days_in_year},
};
use schemas::{Role, field, flight};

use super::{FlightBatch, ObservatoryRecord, RawFlight};
use crate::ReadError;

const DAY_S: f64 = 86_400.0;

/// Names and descriptions of the field's columns, all in nT.
const FIELD: [(&str, &str); 4] = [
    ("field_n", "north component of the field at the station"),
    ("field_e", "east component of the field at the station"),
    ("field_d", "down component of the field at the station"),
    ("field_f", "total field at the station, from its scalar magnetometer"),
];

/// The columns `flight`, `line` (such as `2014-11-04`), `tt`, `year`, `doy`, the position of the station if known, and
/// the field; components without any value are omitted. A step without a sample is a row of NaN.
///
/// # Errors
/// Fails for a record without the name of its station.
pub(super) fn raw(path: &Path, record: &ObservatoryRecord) -> Result<RawFlight, ReadError> {
    if record.station.is_empty() {
        let what = "the record lacks the name of its station";
        return Err(ReadError::data(path, what).help("add the header line `IAGA CODE`"));
    }
    let rows = record.ned_nt.len();
    let days: Vec<Day> = days(record);
    let day = |k: usize| days.get(k);
    let name = |k: usize| day(k).map(|d| d.name.as_str());
    let lines: StringArray = (0..rows).map(name).collect();
    let figure =
        |of: &dyn Fn(usize) -> f64| -> ArrayRef { Arc::new((0..rows).map(|k| Some(of(k))).collect::<Float64Array>()) };
    let known = |name: &str, kind: DataType| {
        let known = flight::describe(name);
        field(name, kind, known.unit, known.role, known.description)
    };
    let number = |name: &str| known(name, DataType::Float64);
    let mut columns: Vec<(Field, ArrayRef)> = vec![
        (known("flight", DataType::Utf8), Arc::new(StringArray::from(vec![record.station.as_str(); rows]))),
        (known("line", DataType::Utf8), Arc::new(lines)),
        (number("tt"), figure(&|k| record.tt_s(k) - day(k).map_or(0.0, |d| d.midnight_s))),
        (number("year"), figure(&|k| day(k).map_or(f64::NAN, |d| f64::from(d.year)))),
        (number("doy"), figure(&|k| day(k).map_or(f64::NAN, |d| f64::from(d.doy)))),
    ];
    let lon_deg = wrap_deg(record.lon_deg);
    for (name, value) in [("lat", record.lat_deg), ("lon", lon_deg), ("msl", record.msl_m)] {
        if value.is_finite() {
            columns.push((number(name), figure(&|_| value)));
        }
    }
    for (component, (name, about)) in FIELD.iter().enumerate() {
        let of = |k: usize| {
            let vector = record.ned_nt.get(k).and_then(|ned| ned.get(component));
            vector.or(record.total_nt.get(k)).copied().unwrap_or(f64::NAN)
        };
        if (0..rows).any(|k| of(k).is_finite()) {
            columns.push((field(name, DataType::Float64, "nT", Role::Sensor, about), figure(&of)));
        }
    }
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_iter().unzip();
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|e| ReadError::data(path, e.to_string()))?;
    let notes = record.notes.iter().map(|note| format!("{}: {note}", path.display())).collect();
    Ok(RawFlight { notes, ..RawFlight::new(schema, Box::new(std::iter::once(Ok(FlightBatch::whole(batch))))) })
}

/// The day of a sample.
#[derive(Clone)]
struct Day {
    name: String,
    year: i32,
    doy: u32,
    /// Time of the day's midnight, in seconds after the first day's midnight.
    midnight_s: f64,
}

impl Day {
    fn new(year: i32, doy: u32, midnight_s: f64) -> Day {
        let first_of = |month: &u32| day_of_year(year, *month, 1).unwrap_or(u32::MAX);
        let month = (1..=12).rev().find(|month| first_of(month) <= doy).unwrap_or(1);
        let name = format!("{year:04}-{month:02}-{:02}", doy + 1 - first_of(&month).min(doy));
        Day { name, year, doy, midnight_s }
    }

    fn next(&self) -> Day {
        let (year, doy) =
            if self.doy < days_in_year(self.year) { (self.year, self.doy + 1) } else { (self.year + 1, 1) };
        Day::new(year, doy, self.midnight_s + DAY_S)
    }
}

/// The day of each sample of a record.
fn days(record: &ObservatoryRecord) -> Vec<Day> {
    let (year, doy) = record.date;
    let mut day = Day::new(year, doy, 0.0);
    let one = |k: usize| {
        // The tolerance of 1e-6 s is far smaller than the sample interval of any record.
        while record.tt_s(k) >= day.midnight_s + DAY_S - 1e-6 {
            day = day.next();
        }
        day.clone()
    };
    (0..record.ned_nt.len()).map(one).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{cast::AsArray, types::Float64Type};

    use super::*;
    use crate::{FlightOptions, open_flight, samples};

    fn record(date: (i32, u32), start_tt_s: f64, rows: usize) -> ObservatoryRecord {
        ObservatoryRecord {
            station: "ABC".into(),
            lat_deg: f64::NAN,
            lon_deg: 254.764,
            msl_m: 10.0,
            components: "XYZF".into(),
            date,
            start_tt_s,
            step_s: 3600.0,
            ned_nt: vec![[1.0, f64::NAN, 3.0]; rows],
            total_nt: (0..rows).map(|k| k as f64).collect(),
            notes: vec![],
        }
    }

    fn batch(record: &ObservatoryRecord) -> RecordBatch {
        let mut parts = raw(Path::new("x.min"), record).unwrap().parts;
        parts.next().unwrap().unwrap().batch
    }

    #[test]
    fn unit_days_are_consecutive_across_the_end_of_a_leap_year() {
        let made = batch(&record((2024, 365), 22.0 * 3600.0, 28));
        let schema = made.schema();
        let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
        // The record has neither a latitude nor an east component.
        assert_eq!(names, ["flight", "line", "tt", "year", "doy", "lon", "msl", "field_n", "field_d", "field_f"]);
        let lines: Vec<&str> = made["line"].as_string::<i32>().iter().flatten().collect();
        let of = |name: &str| made[name].as_primitive::<Float64Type>().values().to_vec();
        let (tt, year, doy) = (of("tt"), of("year"), of("doy"));
        for (row, line, at) in
            [(0, "2024-12-30", 22.0), (1, "2024-12-30", 23.0), (2, "2024-12-31", 0.0), (26, "2025-01-01", 0.0)]
        {
            assert_eq!((lines[row], tt[row]), (line, at * 3600.0), "{row}");
        }
        assert_eq!((year[25], doy[25], year[26], doy[26]), (2024.0, 366.0, 2025.0, 1.0));
        assert!((of("lon")[0] + 105.236).abs() < 1e-9);
        assert_eq!(of("field_f")[27], 27.0);
    }

    #[test]
    fn ref_boulder_is_a_flight_of_its_days() {
        let reader = open_flight(&samples::path("boulder/bou20141104vmin.min"), &FlightOptions::default()).unwrap();
        assert_eq!(reader.format(), "iaga2002");
        let batches: Vec<RecordBatch> = reader.map(Result::unwrap).collect();
        let of = |name: &str| batches[0][name].as_primitive::<Float64Type>().values().to_vec();
        assert_eq!((batches.len(), batches[0].num_rows()), (1, 1440));
        assert_eq!(batches[0]["line"].as_string::<i32>().value(1439), "2014-11-04");
        // Values in the last row of the file.
        assert_eq!((of("tt")[1439], of("field_f")[0]), (86_340.0, 52_397.24));
        let (n, e, d) = (of("field_n"), of("field_e"), of("field_d"));
        let vector = (0..1440).map(|k| n[k].hypot(e[k]).hypot(d[k]));
        // The two instruments are at different places: their difference is constant within 2 nT.
        let off: Vec<f64> = vector.zip(of("field_f")).map(|(v, f)| v - f).collect();
        let spread = off.iter().copied().fold(f64::MIN, f64::max) - off.iter().copied().fold(f64::MAX, f64::min);
        assert!(spread < 2.0, "{spread}");
        let nameless = ObservatoryRecord { station: String::new(), ..record((2024, 1), 0.0, 1) };
        assert!(raw(Path::new("x.min"), &nameless).is_err());
    }
}
