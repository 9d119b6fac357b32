//! The IAGA-2002 exchange format of magnetic observatories: a header of labelled lines that end in `|`, then one line
//! per sample with date, time, day of the year and four components. [IAGA Division V, IAGA-2002 Data Exchange Format]

use std::{mem::discriminant, path::Path};

use numerics::earth::dates::{day_of_year, days_in_year};

use super::{
    FlightFormat,
    declination::{self, DeclinationSample},
    observatory,
    observatory_components::{ComponentConversion, total_nt},
    text_end,
};
use crate::ReadError;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "iaga2002",
    about: "observatory records, IAGA-2002; each station is read as a flight, and each day as a line",
    extensions: &["sec", "min"],
    recognise: |head| {
        head.first_line().is_some_and(|line| {
            let mut words = line.split_whitespace();
            words.next().is_some_and(|w| w.eq_ignore_ascii_case("Format")) && words.next() == Some("IAGA-2002")
        })
    },
    open: |path, _, _| observatory::raw(path, &read_iaga2002(path)?),
    topics: None,
    made_from: None,
};

/// Values of this size and larger mark missing (99999) or unobserved (88888) components.
const MISSING: f64 = 88_880.0;
/// Maximum deviation of a time stamp from a whole number of steps, in steps.
const EVENNESS: f64 = 0.01;

/// The record of an observatory at evenly spaced times.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservatoryRecord {
    /// The code of the station.
    pub station: String,
    /// Geodetic latitude; NaN where the header has none.
    pub lat_deg: f64,
    /// Longitude, eastward; NaN where the header has none.
    pub lon_deg: f64,
    /// Height above the sea; NaN where the header has none.
    pub msl_m: f64,
    /// The components in the file, such as `HDZF`.
    pub components: String,
    /// Year and day of the year of the first sample, UTC.
    pub date: (i32, u32),
    /// The first sample's time, in seconds past that day's midnight.
    pub start_tt_s: f64,
    /// Sampling interval.
    pub step_s: f64,
    /// North, east and down in nT at each step; NaN if a component is missing.
    pub ned_nt: Vec<[f64; 3]>,
    /// The total field of the scalar magnetometer in nT at each step; NaN where missing.
    pub total_nt: Vec<f64>,
    /// Notes for the user, such as the reason why north and east are unknown.
    pub notes: Vec<String>,
}

impl ObservatoryRecord {
    /// The time of sample `k`, in seconds past the first day's midnight.
    pub fn tt_s(&self, k: usize) -> f64 {
        self.start_tt_s + self.step_s * k as f64
    }
}

/// A sample: its time in seconds past the first day's midnight; north, east, down and total in nT.
pub(super) type ObservatorySample = (f64, [f64; 4]);

/// Header of an IAGA-2002 file: station, position, baseline and components.
struct IagaHeader {
    station: String,
    lat_deg: f64,
    lon_deg: f64,
    msl_m: f64,
    /// Whether D is relative to a baseline; `None` for a data type that does not determine it.
    relative: Option<bool>,
    baseline_rad: Option<f64>,
    /// The reported components in the header.
    reported: String,
    kind: Option<(ComponentConversion, String)>,
}

/// Reads an IAGA-2002 file: samples at intervals of a second, a minute or an hour, of one day or of consecutive days.
///
/// Components may be XYZ, HDZ, HEZ or DIF, in any order, as well as a scalar. The baseline declination (`DECBAS`,
/// tenths of minutes east) is the zero of D in data of the type `variation`, and the direction of H in HEZ. Without it,
/// north and east of such data are NaN, with a note. A sample that is absent, marked as missing or without a component
/// is NaN.
///
/// # Errors
/// Fails for a file that is not an IAGA-2002 record, a line that cannot be read, samples at uneven times, a header that
/// contradicts its columns, or a declination or inclination that has a wrong unit according to a comparison with the
/// IGRF.
pub fn read_iaga2002(path: &Path) -> Result<ObservatoryRecord, ReadError> {
    let bytes = text_end::read(path)?;
    parse(path, &String::from_utf8_lossy(&bytes))
}

pub(super) fn parse(path: &Path, text: &str) -> Result<ObservatoryRecord, ReadError> {
    let mut head = IagaHeader {
        station: String::new(),
        lat_deg: f64::NAN,
        lon_deg: f64::NAN,
        msl_m: f64::NAN,
        relative: None,
        baseline_rad: None,
        reported: String::new(),
        kind: None,
    };
    let mut samples: Vec<ObservatorySample> = vec![];
    let mut first_day = None;
    let (mut unoriented, mut sighting) = (None, None);
    for (row, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        if line.trim_end().ends_with('|') {
            head.read(path, line)?;
            continue;
        }
        let wrong = |what: &str| ReadError::data(path, format!("{what} in line {}", row + 1));
        let Some((kind, letters)) = &head.kind else {
            return Err(ReadError::data(
                path,
                "the file is not an IAGA-2002 record: it lacks the line `DATE TIME DOY ...`",
            ));
        };
        let (date, values) = sample(line).ok_or_else(|| wrong("the date, the time or a component is invalid"))?;
        if values.len() != letters.len() {
            return Err(wrong(&format!("there are {} values instead of {}", values.len(), letters.len())));
        }
        let (first_year, first_doy) = *first_day.get_or_insert((date.0, date.1));
        let days = days_between((first_year, first_doy), (date.0, date.1));
        let baseline = head.baseline(*kind);
        let baseline_rad = *baseline.as_ref().unwrap_or(&0.0);
        let ned_nt @ [mut north, mut east, down] = kind.ned_nt(&values, baseline_rad);
        let letters: Vec<char> = letters.chars().collect();
        let total = total_nt(&letters, &values, &ned_nt);
        if let Err(reason) = baseline {
            (north, east) = (f64::NAN, f64::NAN);
            unoriented.get_or_insert(reason);
        } else if sighting.is_none() && ned_nt.iter().all(|x| x.is_finite()) {
            let own_rad = kind.own_declination_rad(&values);
            let unused_rad = head.baseline_rad.filter(|_| own_rad.is_some() && head.relative == Some(false));
            sighting = Some(DeclinationSample {
                ned_nt,
                baseline_rad,
                own_rad,
                unused_rad,
                kind: *kind,
                date: (date.0, date.1),
            });
        }
        samples.push((days as f64 * 86_400.0 + date.2, [north, east, down, total]));
    }
    let Some((date, (_, letters))) = first_day.zip(head.kind) else {
        return Err(ReadError::data(path, "the IAGA-2002 record has no samples"));
    };
    let (step_s, values) = even(path, &samples)?;
    let start_tt_s = samples.first().map_or(0.0, |s| s.0);
    let (ned_nt, total_nt) = values.into_iter().map(|[n, e, d, total]| ([n, e, d], total)).unzip();
    let IagaHeader { station, lat_deg, lon_deg, msl_m, .. } = head;
    let mut record = ObservatoryRecord {
        station,
        lat_deg,
        lon_deg,
        msl_m,
        components: letters,
        date,
        start_tt_s,
        step_s,
        ned_nt,
        total_nt,
        notes: unoriented.into_iter().collect(),
    };
    if let Some(sighting) = sighting {
        declination::check(path, &mut record, &sighting)?;
    }
    Ok(record)
}

impl IagaHeader {
    fn read(&mut self, path: &Path, line: &str) -> Result<(), ReadError> {
        let line = line.trim_end().trim_end_matches('|').trim();
        let value_of = |label: &str| {
            let starts = line.get(..label.len()).is_some_and(|start| start.eq_ignore_ascii_case(label));
            starts.then(|| line.get(label.len()..).unwrap_or("").trim())
        };
        let number = |text: &str| text.split_whitespace().next().and_then(|t| t.parse::<f64>().ok());
        if let Some(code) = value_of("IAGA CODE") {
            if !self.station.is_empty() && self.station != code {
                let what = format!("the file holds the stations {} and {code}", self.station);
                return Err(ReadError::data(path, what).help("split the file by station"));
            }
            self.station = code.to_owned();
        } else if let Some(lat) = value_of("Geodetic Latitude") {
            self.lat_deg = number(lat).unwrap_or(f64::NAN);
        } else if let Some(lon) = value_of("Geodetic Longitude") {
            self.lon_deg = number(lon).unwrap_or(f64::NAN);
        } else if let Some(elevation) = value_of("Elevation") {
            // A missing-value marker is not a height.
            self.msl_m = number(elevation).filter(|m| m.abs() < 9_999.0).unwrap_or(f64::NAN);
        } else if let Some(kind) = value_of("Data Type") {
            self.relative = is_relative(kind);
        } else if let Some(components) = value_of("Reported") {
            self.reported = components.to_ascii_uppercase();
        } else if let Some(tenths) = value_of("#").and_then(declination::baseline_of) {
            self.baseline_rad = number(tenths).filter(|t| t.abs() < MISSING).map(|t| (t / 600.0).to_radians());
        } else if value_of("DATE").is_some_and(|rest| rest.trim_start().starts_with("TIME")) {
            let names: Vec<&str> = line.split_whitespace().skip(3).collect();
            let letters: Vec<char> =
                names.iter().filter_map(|n| n.chars().last()).map(|l| l.to_ascii_uppercase()).collect();
            let text: String = letters.iter().collect();
            let kind = ComponentConversion::from_letters(&letters).ok_or_else(|| {
                let what = format!("the components {text} do not form a vector");
                ReadError::data(path, what).help("a record requires XYZ, HDZ, HEZ or DIF")
            })?;
            let reported = ComponentConversion::from_letters(&self.reported.chars().collect::<Vec<char>>());
            if reported.is_some_and(|declared| discriminant(&declared) != discriminant(&kind)) {
                let what = format!("`Reported` is {}, but the columns are {}", self.reported, names.join(", "));
                return Err(
                    ReadError::data(path, what).help("correct the header line `Reported` or the names of the columns")
                );
            }
            self.kind = Some((kind, text));
        }
        Ok(())
    }

    /// The baseline to add to the declination, in radians.
    ///
    /// # Errors
    /// Returns a note for the user if north and east require a baseline that the header lacks.
    fn baseline(&self, kind: ComponentConversion) -> Result<f64, String> {
        if !kind.needs_baseline(self.relative) {
            return Ok(0.0);
        }
        let (what, remedy) = match (kind, self.baseline_rad, self.relative) {
            (ComponentConversion::Hez(_), Some(baseline), _) | (_, Some(baseline), Some(_)) => return Ok(baseline),
            (ComponentConversion::Hez(_), None, _) => (
                "H and E are relative to a direction that the file lacks",
                "add the declination of the H axis to the header, as `# DECBAS <tenths of minutes of arc, east>`",
            ),
            (_, None, _) => (
                "D is relative to a direction that the file lacks",
                "add the baseline of D to the header, as `# DECBAS <tenths of minutes of arc, east>`; use `# DECBAS 0` \
                 if D is the full declination",
            ),
            (_, Some(_), None) => (
                "D may be relative to `DECBAS`, or it may be the full declination",
                "set `Data Type` in the header: `variation` if D is relative, else `definitive`",
            ),
        };
        Err(format!("{what}: `field_n` and `field_e` are unknown; {remedy}"))
    }
}

/// Whether D of a data type is relative to a baseline; `None` for an unknown type.
fn is_relative(data_type: &str) -> Option<bool> {
    const TYPES: [(&str, bool); 9] = [
        ("var", true),
        ("rep", true),
        ("raw", true),
        ("def", false),
        ("quasi", false),
        ("prov", false),
        ("adj", false),
        ("abs", false),
        ("final", false),
    ];
    let lower = data_type.to_ascii_lowercase();
    match lower.as_str() {
        "v" | "r" => Some(true),
        "d" | "q" | "p" | "a" => Some(false),
        _ => TYPES.iter().find(|(start, _)| lower.starts_with(start)).map(|(_, relative)| *relative),
    }
}

/// Year, day of the year and seconds past midnight; and the values, NaN where missing.
fn sample(line: &str) -> Option<((i32, u32, f64), Vec<f64>)> {
    let mut words = line.split_whitespace();
    let mut date = words.next()?.split('-');
    let (year, month, day) = (date.next()?.parse().ok()?, date.next()?.parse().ok()?, date.next()?.parse().ok()?);
    let doy = day_of_year(year, month, day).ok()?;
    let mut clock = words.next()?.split(':').map(|part| part.parse::<f64>().ok());
    let seconds = 3600.0 * clock.next()?? + 60.0 * clock.next()?? + clock.next()??;
    let seconds = Some(seconds).filter(|s| (0.0..=86_400.0).contains(s))?;
    let known = |x: f64| if x.abs() < MISSING { x } else { f64::NAN };
    let values: Option<Vec<f64>> = words.skip(1).map(|word| word.parse().ok().map(known)).collect();
    Some(((year, doy, seconds), values.filter(|v| v.len() >= 3)?))
}

/// Number of days between two dates, each given by year and day of the year.
pub(super) fn days_between(from: (i32, u32), to: (i32, u32)) -> i64 {
    let whole = |a: i32, b: i32| (a..b).map(|year| i64::from(days_in_year(year))).sum::<i64>();
    whole(from.0, to.0) - whole(to.0, from.0) + i64::from(to.1) - i64::from(from.1)
}

/// The step of the samples, and their values at every step; NaN without a sample.
///
/// # Errors
/// Fails for samples that do not ascend in time or are at uneven times.
pub(super) fn even(path: &Path, samples: &[ObservatorySample]) -> Result<(f64, Vec<[f64; 4]>), ReadError> {
    /// Number of steps that every record may have: one month at intervals of 1 s.
    const FREE: f64 = 3e6;
    /// Maximum number of steps per sample in a record with more steps. Steps without a sample are gaps.
    const MOST: f64 = 256.0;
    let step_s = samples.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(f64::INFINITY, f64::min);
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Ok((1.0, vec![])) };
    if samples.len() == 1 {
        return Ok((1.0, vec![first.1]));
    }
    let steps = (last.0 - first.0) / step_s;
    if step_s.is_nan() || step_s <= 0.0 {
        return Err(ReadError::data(path, "the times of the record do not ascend"));
    }
    if steps > FREE.max(MOST * samples.len() as f64) {
        let what = format!("the record has only {} samples in {steps:.0} steps of {step_s} s", samples.len());
        return Err(ReadError::data(path, what).help("split the record at long gaps"));
    }
    let mut out = vec![[f64::NAN; 4]; steps.round() as usize + 1];
    for (tt_s, values) in samples {
        let place = (tt_s - first.0) / step_s;
        let node = place.round();
        if (place - node).abs() > EVENNESS {
            let what =
                format!("the time of the sample, {tt_s} s past midnight, is not a multiple of the step of {step_s} s");
            return Err(ReadError::data(path, what));
        }
        if let Some(slot) = out.get_mut(node as usize) {
            *slot = *values;
        }
    }
    Ok((step_s, out))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;
    use crate::samples;

    fn record(letters: [&str; 4], rows: &str) -> Result<ObservatoryRecord, ReadError> {
        let columns: String = letters.iter().map(|l| format!("   ABC{l}")).collect();
        let text = format!(
            " Format                 IAGA-2002                                    |\n IAGA CODE              ABC   |\n \
             Geodetic Longitude     90.0                                         |\n \
             Data Type              variation                                    |\n \
             # DECBAS               600    (tenths)                              |\n\
             DATE       TIME         DOY  {columns}   |\n{rows}"
        );
        parse(Path::new("x.min"), &text)
    }

    #[test]
    fn ref_boulder_by_minutes_and_seconds() {
        let minutes = read_iaga2002(&samples::path("boulder/bou20141104vmin.min")).unwrap();
        assert_eq!((minutes.station.as_str(), minutes.components.as_str()), ("BOU", "HDZF"));
        assert_eq!((minutes.date, minutes.start_tt_s, minutes.step_s), ((2014, 308), 0.0, 60.0));
        assert_eq!((minutes.lat_deg, minutes.lon_deg, minutes.ned_nt.len()), (40.137, 254.764, 1440));
        assert!(minutes.ned_nt.iter().flatten().all(|x| x.is_finite()), "the day has no gaps");
        assert_eq!((minutes.msl_m, minutes.total_nt[0], minutes.total_nt[4]), (1682.0, 52397.24, 52397.02));
        let seconds = read_iaga2002(&samples::path("boulder/BOU20200101vsec.sec")).unwrap();
        assert_eq!((seconds.step_s, seconds.ned_nt.len(), seconds.components.as_str()), (1.0, 901, "HEZF"));
        // The first line: H 20826.85, E -86.75, Z 46874.62, DECBAS 552.7 minutes: sin 0.16008219, cos 0.98710369.
        let [north, east, down] = seconds.ned_nt[0];
        assert!((north - (20826.85 * 0.987_103_69 + 86.75 * 0.160_082_19)).abs() < 2e-3, "{north}");
        assert!((east - (20826.85 * 0.160_082_19 - 86.75 * 0.987_103_69)).abs() < 2e-3, "{east}");
        assert_eq!(down, 46874.62);
    }

    #[test]
    fn unit_all_component_types_give_the_same_vector() {
        let (x, y, z) = (20_000.0_f64, 3_000.0_f64, 45_000.0_f64);
        let (h, f) = (x.hypot(y), x.hypot(y).hypot(z));
        let arcmin = |rad: f64| 60.0 * rad.to_degrees();
        let (d, i) = (arcmin(y.atan2(x)) - 60.0, arcmin(z.atan2(h)));
        let base = 1f64.to_radians();
        let along = [x * base.cos() + y * base.sin(), y * base.cos() - x * base.sin()];
        for (letters, values) in [
            (["X", "Y", "Z", "F"], [x, y, z, f]),
            (["F", "Z", "H", "D"], [f, z, h, d]),
            (["H", "E", "Z", "F"], [along[0], along[1], z, f]),
            (["D", "I", "F", "S"], [d, i, f, f]),
        ] {
            let [a, b, c, e] = values;
            let row = format!("2024-02-29 23:59:00.000 060 {a:.9} {b:.9} {c:.9} {e:.9}\n");
            let found = record(letters, &row).unwrap();
            assert_eq!((found.date, found.start_tt_s), ((2024, 60), 86_340.0));
            // Rounding to nine decimals of a minute of arc: 1e-9/3438 of 5e4 nT.
            let error = [x, y, z].iter().zip(found.ned_nt[0]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(error < 1e-6, "{letters:?}: {:?}", found.ned_nt[0]);
        }
    }

    #[test]
    fn unit_missing_values_are_nan_and_days_are_consecutive() {
        let rows = "2024-12-31 23:58:00.000 366  1.0 2.0 3.0 4.0\n2024-12-31 23:59:00.000 366  99999.00 2.0 3.0 4.0\n\
                    2025-01-01 00:01:00.000 001  5.0 6.0 7.0 88888.00\n2025-01-01 00:02:00.000 001  5.0 6.0 88888.00 \
                    1.0\n";
        let found = record(["X", "Y", "Z", "F"], rows).unwrap();
        assert_eq!((found.step_s, found.start_tt_s, found.ned_nt.len()), (60.0, 86_280.0, 5));
        let known: Vec<bool> = found.ned_nt.iter().map(|v| v.iter().all(|x| x.is_finite())).collect();
        assert_eq!(known, [true, false, false, true, false]);
        assert_eq!((found.ned_nt[3], found.tt_s(3)), ([5.0, 6.0, 7.0], 86_460.0));
    }

    #[test]
    fn gold_invalid_records() {
        let fault_text = |rows: &str| record(["X", "Y", "Z", "F"], rows).unwrap_err().to_string();
        let wrong = fault_text("2024-13-31 23:58:00.000 366  1.0 2.0 3.0 4.0\n");
        assert!(wrong.contains("the date, the time or a component is invalid in line 7"), "{wrong}");
        assert!(fault_text("").contains("the IAGA-2002 record has no samples"));
        let apart = "2024-01-01 00:00:00.000 001 1.0 2.0 3.0 4.0\n2024-01-01 00:01:00.000 001 1.0 2.0 3.0 4.0\n\
                     2024-01-01 00:02:30.000 001 1.0 2.0 3.0 4.0\n";
        assert!(
            fault_text(apart)
                .contains("the time of the sample, 150 s past midnight, is not a multiple of the step of 60 s")
        );
        let twice = "2024-01-01 00:01:00.000 001 1.0 2.0 3.0 4.0\n2024-01-01 00:01:00.000 001 1.0 2.0 3.0 4.0\n";
        assert!(fault_text(twice).contains("the times of the record do not ascend"));
        let scalar = record(["S", "F", "G", "F"], "").unwrap_err().to_string();
        assert!(scalar.contains("the components SFGF do not form a vector") && scalar.contains("XYZ, HDZ, HEZ or DIF"));
        let none = parse(Path::new("x.min"), "a,b\n1,2\n").unwrap_err().to_string();
        assert!(none.contains("not an IAGA-2002 record"), "{none}");
    }
}
