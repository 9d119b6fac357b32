//! INTERMAGNET's dissemination format of minute values, IMFV1.22 and 1.23: blocks of an hour, each with a header line
//! and thirty lines of two minutes. [INTERMAGNET Technical Reference Manual, IMFV1.23 GIN dissemination format]

use std::path::Path;

use numerics::earth::dates::day_of_year;

use super::{
    FlightFormat,
    declination::{self, DeclinationSample},
    iaga2002::{ObservatoryRecord, ObservatorySample, days_between, even},
    observatory,
    observatory_components::{ComponentConversion, total_nt},
    text_end,
};
use crate::ReadError;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "imf",
    about: "one-minute observatory records, INTERMAGNET IMFV1.22 and 1.23; each station is read as a flight, and each \
            day as a line",
    // The extension is the code of the station.
    extensions: &["imf"],
    recognise: |head| head.first_line().is_some_and(|line| ImfBlockHeader::from_line(&line).is_some()),
    open: |path, _, _| observatory::raw(path, &read_imf(path)?),
    topics: None,
    made_from: None,
};

/// Markers of missing or unobserved values, exactly as written in the file.
const MISSING: [f64; 4] = [999_999.0, 9_999_999.0, 888_888.0, 8_888_888.0];
const MONTHS: [&str; 12] = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"];
const LINES_A_BLOCK: usize = 30;

/// The header of a block: station, date, hour, components, place and baseline declination.
struct ImfBlockHeader {
    station: String,
    year: i32,
    doy: u32,
    /// The day of the year in the header.
    declared_doy: u32,
    hour: u32,
    letters: Vec<char>,
    lat_deg: f64,
    lon_deg: f64,
    /// Baseline of the declination, tenths of minutes of arc east.
    baseline: f64,
}

impl ImfBlockHeader {
    /// Reads a header; `None` for other lines.
    fn from_line(line: &str) -> Option<ImfBlockHeader> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [station, date, doy, hour, letters, _, _, place, baseline, ..] = words.as_slice() else { return None };
        let (month, day, year) = (date.get(..3)?, date.get(3..5)?, date.get(5..7)?);
        let month = MONTHS.iter().position(|m| m.eq_ignore_ascii_case(month))? as u32 + 1;
        let number = |text: &str| text.parse::<u32>().ok();
        let year = number(year)? as i32;
        // The format dates from 1991.
        let year = if year < 80 { 2000 + year } else { 1900 + year };
        let (colatitude, longitude) = (number(place.get(..4)?)?, number(place.get(4..8)?)?);
        let fits = date.len() == 7 && place.len() == 8 && letters.len() == 4;
        fits.then_some(ImfBlockHeader {
            station: (*station).to_owned(),
            year,
            doy: day_of_year(year, month, number(day)?).ok()?,
            declared_doy: number(doy)?,
            hour: number(hour).filter(|hour| *hour < 24)?,
            letters: letters.chars().collect(),
            lat_deg: 90.0 - f64::from(colatitude) / 10.0,
            lon_deg: f64::from(longitude) / 10.0,
            baseline: baseline.parse().ok()?,
        })
    }
}

/// Reads an IMF file: hours of one day or of consecutive days, whose components form a vector (HDZF, XYZF or DIF).
///
/// The declination is relative to the baseline in the header of its block. Values marked as missing are NaN.
///
/// # Errors
/// Fails for a file that is not in this format, a line that cannot be read, a truncated block, contradictory headers,
/// or hours that are not consecutive.
pub fn read_imf(path: &Path) -> Result<ObservatoryRecord, ReadError> {
    let bytes = text_end::read(path)?;
    parse(path, &String::from_utf8_lossy(&bytes))
}

pub(super) fn parse(path: &Path, text: &str) -> Result<ObservatoryRecord, ReadError> {
    let mut samples: Vec<ObservatorySample> = vec![];
    let mut first: Option<ImfBlockHeader> = None;
    let mut sighting = None;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    while let Some((row, line)) = lines.next() {
        let wrong = |row: usize, what: &str| ReadError::data(path, format!("{what} in line {}", row + 1));
        let block = ImfBlockHeader::from_line(line).ok_or_else(|| wrong(row, "the header of an hour is invalid"))?;
        if block.doy != block.declared_doy {
            return Err(wrong(
                row,
                &format!("the date is day {} of the year, but the header gives {},", block.doy, block.declared_doy),
            ));
        }
        let kind = ComponentConversion::from_letters(&block.letters)
            .ok_or_else(|| wrong(row, "the components do not form a vector"))?;
        let start = first.as_ref().unwrap_or(&block);
        if start.station != block.station || start.letters != block.letters {
            return Err(wrong(row, "the station or the components change within the file"));
        }
        let days = days_between((start.year, start.doy), (block.year, block.doy)) as f64;
        let hour_s = 86_400.0 * days + 3600.0 * f64::from(block.hour);
        let baseline_rad = (block.baseline / 600.0).to_radians();
        for pair in 0..LINES_A_BLOCK {
            let Some((row, line)) = lines.next() else {
                return Err(wrong(row, &format!("the file ends after {pair} of the {LINES_A_BLOCK} lines of an hour")));
            };
            let values =
                values(line).ok_or_else(|| wrong(row, "a line must hold two minutes with four values each"))?;
            for (minute, digits) in values.chunks_exact(4).enumerate() {
                let scaled: Vec<f64> = digits.iter().zip(&block.letters).map(|(x, l)| in_unit(*x, *l)).collect();
                let ned_nt @ [north, east, down] = kind.ned_nt(&scaled, baseline_rad);
                let total = total_nt(&block.letters, &scaled, &ned_nt);
                if sighting.is_none() && ned_nt.iter().all(|x| x.is_finite()) {
                    let own_rad = kind.own_declination_rad(&scaled);
                    let date = (block.year, block.doy);
                    sighting = Some(DeclinationSample { ned_nt, baseline_rad, own_rad, unused_rad: None, kind, date });
                }
                samples.push((hour_s + 60.0 * (2 * pair + minute) as f64, [north, east, down, total]));
            }
        }
        first.get_or_insert(block);
    }
    let block = first.ok_or_else(|| ReadError::data(path, "the IMF record has no samples"))?;
    let (step_s, values) = even(path, &samples)?;
    let (ned_nt, total_nt) = values.into_iter().map(|[n, e, d, total]| ([n, e, d], total)).unzip();
    let mut record = ObservatoryRecord {
        station: block.station,
        lat_deg: block.lat_deg,
        lon_deg: block.lon_deg,
        msl_m: f64::NAN,
        components: block.letters.iter().collect(),
        date: (block.year, block.doy),
        start_tt_s: samples.first().map_or(0.0, |s| s.0),
        step_s,
        ned_nt,
        total_nt,
        notes: vec![],
    };
    if let Some(sighting) = sighting {
        declination::check(path, &mut record, &sighting)?;
    }
    Ok(record)
}

/// The eight values of two minutes.
fn values(line: &str) -> Option<Vec<f64>> {
    let values: Option<Vec<f64>> = line.split_whitespace().map(|word| word.parse().ok()).collect();
    values.filter(|v| v.len() == 8 && v.iter().all(|x| x.is_finite()))
}

/// Converts tenths of nT to nT, and hundredths of minutes of arc to minutes; NaN for a missing value.
fn in_unit(digits: f64, letter: char) -> f64 {
    if MISSING.contains(&digits) {
        return f64::NAN;
    }
    if matches!(letter, 'D' | 'I') { digits / 100.0 } else { digits / 10.0 }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::fmt::Write;

    use super::*;
    use crate::{formats::read_iaga2002, samples};

    /// Some hours of one day at the Boulder observatory in this format, and the record from which they were converted.
    fn boulder(hours: std::ops::Range<usize>) -> (String, ObservatoryRecord) {
        let path = samples::path("boulder/bou20141104vmin.min");
        let text = std::fs::read_to_string(&path).unwrap();
        let rows: Vec<Vec<f64>> = text
            .lines()
            .filter(|line| line.starts_with("2014"))
            .map(|line| line.split_whitespace().skip(3).map(|word| word.parse().unwrap()).collect())
            .collect();
        let mut out = String::new();
        for hour in hours {
            writeln!(out, "BOU NOV0414 308 {hour:02} HDZF R GOL 04992548 005527 RRRRRRRRRRRRRRRR").unwrap();
            for pair in rows[60 * hour..60 * (hour + 1)].chunks(2) {
                let digits = pair.iter().flat_map(|v| [10.0 * v[0], 100.0 * v[1], 10.0 * v[2], 10.0 * v[3]]);
                let words: Vec<String> = digits.map(|x| format!("{:7.0}", x.round())).collect();
                writeln!(out, "{}", words.join(" ")).unwrap();
            }
        }
        (out, read_iaga2002(&path).unwrap())
    }

    #[test]
    fn ref_boulder_is_the_same_record_in_both_formats() {
        let (text, iaga) = boulder(0..24);
        let imf = parse(Path::new("NOV0414.BOU"), &text).unwrap();
        assert_eq!((imf.date, imf.start_tt_s, imf.step_s, imf.ned_nt.len()), (iaga.date, 0.0, 60.0, 1440));
        assert_eq!((imf.station.as_str(), imf.components.as_str()), ("BOU", "HDZF"));
        assert!((imf.lat_deg - 40.1).abs() < 1e-9 && imf.lon_deg == 254.8);
        for (a, b) in imf.ned_nt.iter().flatten().zip(iaga.ned_nt.iter().flatten()) {
            // Rounding to tenths of nT instead of hundredths.
            assert!((a - b).abs() < 0.08, "{a} {b}");
        }
        assert!(imf.total_nt.iter().zip(&iaga.total_nt).all(|(a, b)| (a - b).abs() < 0.051));
        assert!(ImfBlockHeader::from_line(text.lines().next().unwrap()).is_some());
    }

    #[test]
    fn unit_missing_values_and_hours_are_nan() {
        let (text, _) = boulder(3..4);
        let line = text.lines().nth(1).unwrap();
        let damaged = text.replacen(line, "9999999 9999999 9999999 999999 208960 -965 474676 888888", 1);
        let later = boulder(5..6).0;
        let found = parse(Path::new("x"), &(damaged + &later)).unwrap();
        assert_eq!((found.start_tt_s, found.ned_nt.len()), (10_800.0, 180));
        assert!(found.ned_nt[0].iter().all(|x| x.is_nan()) && found.total_nt[0].is_nan() && found.total_nt[1].is_nan());
        assert!((found.ned_nt[1][2] - 47_467.6).abs() < 1e-9);
        assert!(found.ned_nt[60..120].iter().flatten().all(|x| x.is_nan()), "the hour between");
    }

    #[test]
    fn unit_damage_is_reported_with_its_line() {
        let (text, _) = boulder(3..4);
        let fault_text = |text: &str| parse(Path::new("x"), text).unwrap_err().to_string();
        assert!(
            fault_text(&text.replace(" 308 ", " 309 "))
                .contains("day 308 of the year, but the header gives 309, in line 1")
        );
        assert!(fault_text(&text.replace("HDZF", "ABCD")).contains("do not form a vector"));
        let cut: String = text.lines().take(20).map(|line| format!("{line}\n")).collect();
        assert!(fault_text(&cut).contains("ends after 19 of the 30 lines"));
        let word = text.lines().nth(1).unwrap().split_whitespace().next().unwrap();
        assert!(fault_text(&text.replacen(word, "x", 1)).contains("four values each in line 2"));
        assert!(fault_text("hello\n").contains("header of an hour") && fault_text("").contains("no samples"));
        assert!(fault_text(&(text.clone() + &text)).contains("do not ascend"));
    }
}
