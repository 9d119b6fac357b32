//! The CSV that Geometrics' Survey Manager exports from MagArrow and MFAM loggers: a counter, date and time (UTC),
//! position, one or two scalar magnetometers, and in some rows the compass, the gyroscopes and GNSS.
//!
//! Date and time become `tt`, which continues past midnight, and `year` and `doy` of the first row. A magnetometer
//! reading that `MagValid` marks as invalid is missing. The compass becomes the vector magnetometer `a` in the body
//! frame: its X points to starboard, Y aft, Z down. The GNSS height above the sea is `msl`; the sum of `msl` and the
//! height of the geoid is `alt`. NMEA sentences and events, from the column `GgaSentence` on, are not read.
//! [Geometrics, MagArrow User Manual, section Data Format]

use std::path::{Path, PathBuf};

use arrow_schema::SchemaRef;
use csv::ByteRecord;
use numerics::earth::dates::day_of_year;

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints, RowFault,
    adopt::{FlightColumnTarget, in_counted_unit, named},
    csv as plain,
    iaga2002::days_between,
    missing::MissingMarkers,
    text_end::{TextFile, is_whole},
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "mfam",
    about: "CSV exports of Geometrics' Survey Manager for MagArrow and MFAM magnetometers",
    extensions: &[],
    recognise: |head: &FileHead| {
        let header = head.first_line().unwrap_or_default();
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        names.first() == Some(&"Counter")
            && ["Date", "Time", "Latitude", "Longitude"].iter().all(|n| names.contains(n))
            && names.iter().any(|n| n.starts_with("Mag"))
    },
    open,
    topics: None,
    made_from: None,
};

/// Rows per batch.
const ROWS: usize = 65_536;

/// Names in the header, each with the name of the column and the unit; the unit is empty if it is canonical.
const COLUMNS: [(&str, &str, &str); 27] = [
    ("Counter", "counter", ""),
    ("MFAM Fiducial", "fiducial", ""),
    ("Latitude", "lat", "deg"),
    ("Longitude", "lon", "deg"),
    ("Mag", "mag_1_uc", "nT"),
    ("MagValid", "mag_1_valid", ""),
    ("Mag1Data", "mag_1_uc", "nT"),
    ("Mag1Valid", "mag_1_valid", ""),
    ("Mag1Deadzone", "mag_1_deadzone", ""),
    ("Mag2Data", "mag_2_uc", "nT"),
    ("Mag2Valid", "mag_2_valid", ""),
    ("Mag2Deadzone", "mag_2_deadzone", ""),
    ("MagAverage", "mag_average", "nT"),
    ("MagAverageValid", "mag_average_valid", ""),
    ("CompassTemperature", "compass_temperature", "degC"),
    ("GyroscopeX", "gyroscope_x", ""),
    ("GyroscopeY", "gyroscope_y", ""),
    ("GyroscopeZ", "gyroscope_z", ""),
    ("AccelerometerX", "accelerometer_x", ""),
    ("AccelerometerY", "accelerometer_y", ""),
    ("AccelerometerZ", "accelerometer_z", ""),
    ("ImuTemperature", "imu_temperature", "degC"),
    ("Track", "track", "deg"),
    ("Altitude", "msl", "m"),
    // Despite its name in the header, this is the height of the geoid above the ellipsoid, which follows the height in
    // a GGA sentence.
    ("HeightOverEllipsoid", "geoid", "m"),
    ("SpeedOverGround", "speed_over_ground", "kn"),
    ("LocationSource", "location_source", ""),
];
/// Text columns.
const WORDS: [&str; 3] = ["location_source", "variationdirection", "modeindicator"];
/// The first column that is not read.
const SENTENCES: &str = "GgaSentence";
/// The axes of the compass: to starboard, aft, down.
const COMPASS: [&str; 3] = ["CompassX", "CompassY", "CompassZ"];
const WHEN: [&str; 2] = ["Date", "Time"];

/// A column of the file.
struct MfamColumn {
    header: String,
    meant: String,
    named: FlightColumnTarget,
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let headers = plain::header(path)?;
    let width = headers.iter().position(|h| h == SENTENCES).unwrap_or(headers.len());
    let rest = headers.len() - width;
    let column = |header: &String| {
        let known = COLUMNS.iter().find(|(theirs, ..)| theirs == header);
        let meant =
            known.map_or_else(|| header.to_ascii_lowercase().replace(' ', "_"), |(_, ours, _)| (*ours).to_owned());
        // Date, time and compass become other columns.
        let made = WHEN.contains(&header.as_str()) || COMPASS.contains(&header.as_str());
        let named = if made {
            FlightColumnTarget { name: header.clone(), unit: String::new() }
        } else {
            named(path, &[header, &meant], known.map(|(.., unit)| *unit), options)?
        };
        Ok(MfamColumn { header: header.clone(), meant, named })
    };
    let columns = headers.iter().take(width).map(column).collect::<Result<Vec<_>, ReadError>>()?;
    for needed in ["Date", "Time", "Latitude", "Longitude"] {
        if !columns.iter().any(|c| c.header == needed) {
            return Err(ReadError::data(path, "an export of Survey Manager requires this column").in_column(needed));
        }
    }
    let own = columns.iter().filter(|c| !WHEN.contains(&c.header.as_str()) && !COMPASS.contains(&c.header.as_str()));
    let own = own.flat_map(|c| [c.header.clone(), c.meant.clone()]).collect();
    let file = TextFile::open(path)?;
    let reader = csv::ReaderBuilder::new().flexible(true).from_reader(file);
    let rows = MfamRowParser {
        path: path.to_path_buf(),
        columns,
        rest,
        missing: MissingMarkers::from_options(options),
        day: None,
    };
    let schema = rows.table(&MfamBatch::new(&rows.columns))?.schema();
    let notes = match is_whole(path) {
        Ok(false) => vec![format!("{}: the file does not end with a newline, so it may be truncated", path.display())],
        _ => vec![],
    };
    Ok(RawFlight {
        own: Some(own),
        notes,
        ..RawFlight::new(schema.clone(), Box::new(MfamBatchReader { rows, reader, schema, row: 0, done: false }))
    })
}

/// The rows of a batch, stored column by column.
struct MfamBatch {
    rows: usize,
    numbers: Vec<Vec<f64>>,
    words: Vec<Vec<String>>,
    tt: Vec<f64>,
    faults: Vec<RowFault>,
}

impl MfamBatch {
    fn new(columns: &[MfamColumn]) -> MfamBatch {
        let (numbers, words) = (vec![vec![]; columns.len()], vec![vec![]; columns.len()]);
        MfamBatch { rows: 0, numbers, words, tt: vec![], faults: vec![] }
    }
}

struct MfamRowParser {
    path: PathBuf,
    columns: Vec<MfamColumn>,
    /// Number of columns of the header that are not read.
    rest: usize,
    missing: MissingMarkers,
    /// Year and day of the first row.
    day: Option<(i32, u32)>,
}

struct MfamBatchReader {
    rows: MfamRowParser,
    reader: csv::Reader<TextFile>,
    schema: SchemaRef,
    row: u64,
    done: bool,
}

impl Iterator for MfamBatchReader {
    type Item = Result<FlightBatch, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let MfamBatchReader { rows, reader, schema, row, done } = self;
        let (mut gathered, mut record) = (MfamBatch::new(&rows.columns), ByteRecord::new());
        while !*done && gathered.rows < ROWS {
            match reader.read_byte_record(&mut record) {
                Ok(true) => rows.gather(&record, *row, &mut gathered),
                Ok(false) => *done = true,
                Err(error) => {
                    *done = true;
                    return Some(Err(plain::broken(&rows.path, &error)));
                }
            }
            *row += u64::from(!*done);
        }
        if gathered.rows == 0 {
            return None;
        }
        let faults = std::mem::take(&mut gathered.faults);
        let batch = rows.table(&gathered).and_then(|t| t.into_batch(&rows.path));
        debug_assert!(batch.as_ref().is_ok_and(|b| b.schema() == *schema));
        Some(batch.map(|batch| FlightBatch { batch, faults }))
    }
}

impl MfamRowParser {
    /// Appends a row.
    fn gather(&mut self, record: &ByteRecord, row: u64, to: &mut MfamBatch) {
        let width = self.columns.len();
        // NMEA sentences without quotes are split into several values. A row may also lack values of unread columns at
        // its end, or have additional empty values there.
        let spare = record.iter().skip(width + self.rest).any(|w| !w.trim_ascii().is_empty());
        let whole = record.len() >= width && (self.rest > 0 || !spare);
        let mut wrong = |what: ReadError| to.faults.push(RowFault { row: to.rows, fault: what.in_row(row) });
        if !whole {
            let what = format!("the row has {} values, but the header has {}", record.len(), width + self.rest);
            wrong(ReadError::data(&self.path, what));
        }
        let word = |i: usize| record.get(i).filter(|_| whole).map(|w| String::from_utf8_lossy(w.trim_ascii()));
        let (mut date, mut seconds) = (None, None);
        for (i, column) in self.columns.iter().enumerate() {
            let text = word(i).unwrap_or_default();
            match column.header.as_str() {
                "Date" => date = day(&text),
                "Time" => seconds = time_of_day_s(&text),
                _ if WORDS.contains(&column.meant.as_str()) => to.words[i].push(text.into_owned()),
                _ => {
                    let number = if whole { self.missing.number(&text) } else { Some(f64::NAN) };
                    if number.is_none() {
                        let what = ReadError::data(&self.path, format!("`{text}` is not a number"));
                        wrong(
                            what.in_column(&column.header)
                                .help("if the text marks a missing value, add it to `missing`"),
                        );
                    }
                    to.numbers[i].push(number.unwrap_or(f64::NAN));
                }
            }
        }
        let tt = date.zip(seconds).map(|(date, seconds)| {
            let first = *self.day.get_or_insert(date);
            days_between(first, date) as f64 * 86_400.0 + seconds
        });
        if tt.is_none() && whole {
            wrong(ReadError::data(
                &self.path,
                "the date or the time is invalid; valid examples are 2020/10/27 and 10:33:09.001",
            ));
        }
        to.tt.push(tt.unwrap_or(f64::NAN));
        to.rows += 1;
    }

    fn numbers<'a>(&self, gathered: &'a MfamBatch, header: &str) -> Option<&'a Vec<f64>> {
        gathered.numbers.get(self.columns.iter().position(|c| c.header == header)?)
    }

    /// The rows as a table.
    fn table(&self, gathered: &MfamBatch) -> Result<ColumnTable, ReadError> {
        let mut table = ColumnTable::default();
        table.push("tt", "s", ColumnValues::Number(gathered.tt.clone()));
        let whole = |x: Option<i64>| ColumnValues::Whole(vec![x; gathered.rows]);
        table.push("year", "", whole(self.day.map(|(year, _)| i64::from(year))));
        table.push("doy", "", whole(self.day.map(|(_, day)| i64::from(day))));
        for (i, column) in self.columns.iter().enumerate() {
            let MfamColumn { header, meant, named } = column;
            if WHEN.contains(&header.as_str()) || COMPASS.contains(&header.as_str()) {
                continue;
            }
            if table.has(&named.name) {
                return Err(ReadError::options(&self.path, "two columns would have this name").in_column(&named.name));
            }
            if WORDS.contains(&meant.as_str()) {
                let words = gathered.words.get(i).cloned().unwrap_or_default();
                table.push(&named.name, "", ColumnValues::Text(words));
                continue;
            }
            let mut values = gathered.numbers.get(i).cloned().unwrap_or_default();
            let valid = header.strip_suffix("Data").unwrap_or(header);
            if let Some(valid) = self.numbers(gathered, &format!("{valid}Valid")) {
                let not = values.iter_mut().zip(valid).filter(|(_, valid)| **valid == 0.0);
                not.for_each(|(x, _)| *x = f64::NAN);
            }
            let counted = COLUMNS.iter().find(|(theirs, ..)| theirs == header).map_or("", |(.., unit)| *unit);
            let (unit, values) = in_counted_unit(&self.path, header, named, counted, values)?;
            table.push(&named.name, &unit, ColumnValues::Number(values));
        }
        if let [Some(x), Some(y), Some(z)] = COMPASS.map(|c| self.numbers(gathered, c)) {
            let aft = y.iter().map(|y| -y).collect();
            for (name, values) in [("flux_a_x", aft), ("flux_a_y", x.clone()), ("flux_a_z", z.clone())] {
                table.push(name, "nT", ColumnValues::Number(values));
            }
        }
        let heights = ["msl", "geoid"].map(|n| table.numbers(n).map(<[f64]>::to_vec));
        if let [Some(msl), Some(geoid)] = heights
            && !table.has("alt")
        {
            table.push("alt", "m", ColumnValues::Number(msl.iter().zip(&geoid).map(|(a, b)| a + b).collect()));
        }
        Ok(table)
    }
}

/// Year and day of the year of a date such as `2020/10/27`.
fn day(text: &str) -> Option<(i32, u32)> {
    let mut words = text.split(['/', '-']);
    let (year, month, day) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let doy = day_of_year(year, month, day).ok()?;
    (words.next().is_none() && (1900..2200).contains(&year)).then_some((year, doy))
}

/// Seconds past midnight of a time such as `10:33:09.001`.
fn time_of_day_s(text: &str) -> Option<f64> {
    let mut words = text.split(':');
    let (hours, minutes) = (words.next()?.parse::<u32>().ok()?, words.next()?.parse::<u32>().ok()?);
    let seconds = words.next()?.parse::<f64>().ok()?;
    let valid = hours < 24 && minutes < 60 && (0.0..61.0).contains(&seconds) && words.next().is_none();
    valid.then(|| f64::from(hours * 3600 + minutes * 60) + seconds)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use std::fs;

    use super::super::{log_tests::numbers, open_flight, open_raw};
    use super::*;

    /// Rows from the manual and from the documentation of other readers.
    const ONE: &str = "\
        Counter,Date,Time,Latitude,Longitude,Mag, MagValid,CompassX, CompassY, CompassZ,GyroscopeX, GyroscopeY, \
        GyroscopeZ,AccelerometerX, AccelerometerY, AccelerometerZ,ImuTemperature,Track,LocationSource,Hdop,FixQuality, \
        SatellitesUsed, Altitude,HeightOverEllipsoid,SpeedOverGround,MagneticVariation,VariationDirection,\
        ModeIndicator,GgaSentence,RmcSentence,EventCode,EventInfo,EventDataLength,EventData\n\
        120232,2026/04/25,23:59:59.300,8.13484366,-2.59298368,32575.15635,1,24246,-11815,-20435,-51.052,3.699,27.426,\
        -0.01903,-0.05149,1.39587,35.805,106.9,I,,,,,,,,,,,,,,,,\n\
        120932,2026/04/26,00:00:00.000,8.13484113,-2.59297533,32566.24340,0,24071,-4093,-24359,-8.798,1.837,-1.450,\
        0.01505,0.14099,0.92321,35.785,106.7,G,0.980,1,12,301.40,24.10,2.578,0.000, ,,\
        '$GNGGA,094000.00,0808.09039,N,00235.57826,W,1,12,0.98,301.4,M,24.1,M,,*57',\
        '$GNRMC,094000.00,A,0808.09039,N,00235.57826,W,2.578,106.69,250426,,,A,V*1B',,,,,\n";

    fn options() -> FlightOptions {
        FlightOptions { flight: Some("1".into()), line: Some("1".into()), ..FlightOptions::default() }
    }

    #[test]
    fn ref_rows_of_a_magarrow() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.csv");
        fs::write(&path, ONE).unwrap();
        let mut reader = open_flight(&path, &options()).unwrap();
        assert_eq!(reader.format(), "mfam");
        let canonical = schemas::canonical::FlightConversion::new(reader.schema()).unwrap();
        let flight = canonical.apply(&reader.next().unwrap().unwrap()).unwrap();
        assert_eq!(numbers(&flight, "tt"), [86_399.3, 86_400.0]);
        assert_eq!(numbers(&flight, "lat"), [8.13484366, 8.13484113]);
        let mag = numbers(&flight, "mag_1_uc");
        assert!(mag[0] == 32575.15635 && mag[1].is_nan(), "{mag:?}");
        assert_eq!(
            ["flux_a_x", "flux_a_y", "flux_a_z"].map(|n| numbers(&flight, n)[0]),
            [11_815.0, 24_246.0, -20_435.0]
        );
        // The sentence gives 301.4 m above the sea, with the geoid 24.1 m above the ellipsoid.
        let alt = numbers(&flight, "alt");
        assert!(alt[0].is_nan() && (alt[1] - 325.5).abs() < 1e-9, "{alt:?}");
        let year = flight.column_by_name("doy").unwrap();
        assert_eq!(
            arrow_array::cast::AsArray::as_primitive::<arrow_array::types::Int64Type>(year).values(),
            &[115, 115]
        );
    }

    #[test]
    fn unit_rows_that_cannot_be_read_are_faults() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.csv");
        let header = "Counter,Date,Time,Latitude,Longitude,Mag1Data, Mag1Valid, Mag1Deadzone, Mag2Data, Mag2Valid, \
                      Mag2Deadzone\n";
        let row = "1,2020/10/27,10:33:09.000,49.5,7.0,48590.4, 1, 0, 48589.1, 1, 0\n";
        let bad = [
            "1,2020/10/27,10:33",
            "2,2020/02/30,10:33:09.000,49.5,7,1, 1, 0, 1, 1, 0",
            "3,2020/10/27,10:33:09.1,x,7,1, 1, 0, 1, 1, 0",
        ];
        fs::write(&path, format!("{header}{row}{}\n{row}", bad.join("\n"))).unwrap();
        let mut reader = open_raw(&path, &options(), &ReadHints::default()).unwrap();
        let part = reader.next_part().unwrap().unwrap();
        assert_eq!(part.batch.num_rows(), 5);
        let row_faults: Vec<(usize, String)> = part.faults.iter().map(|f| (f.row, f.fault.to_string())).collect();
        assert_eq!(row_faults.iter().map(|(row, _)| *row).collect::<Vec<_>>(), [1, 2, 3]);
        assert!(row_faults[0].1.contains("the row has 3 values, but the header has 11"), "{row_faults:?}");
        assert!(row_faults[1].1.contains("the date or the time is invalid"), "{row_faults:?}");
        assert!(row_faults[2].1.contains("column `Latitude`, row 3: `x` is not a number"), "{row_faults:?}");
        let mut units = options();
        units.units = [("Mag2Data".to_owned(), "uT".to_owned())].into();
        let mut reader = open_flight(&path, &units).unwrap();
        let part = reader.next_part().unwrap().unwrap();
        assert_eq!(numbers(&part.batch, "mag_2_uc")[0], 48_589_100.0);
    }
}
