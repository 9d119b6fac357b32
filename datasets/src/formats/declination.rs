//! Comparison of the direction of an observatory's horizontal components with the IGRF, which detects wrong units and
//! baselines.

use std::path::Path;

use numerics::{
    angle::wrap_deg,
    earth::{core_field::CoreField, dates::decimal_year},
};

use super::{iaga2002::ObservatoryRecord, observatory_components::ComponentConversion};
use crate::ReadError;

/// A converted sample, and the angles used in its conversion.
pub(super) struct DeclinationSample {
    /// North, east and down, in nT.
    pub(super) ned_nt: [f64; 3],
    /// The baseline: a declination that was added to the sample's declination or, for the components H and E, the
    /// direction of H.
    pub(super) baseline_rad: f64,
    /// The declination of the sample without its baseline, if it has the component D.
    pub(super) own_rad: Option<f64>,
    /// A baseline in the header that was not added.
    pub(super) unused_rad: Option<f64>,
    /// The components.
    pub(super) kind: ComponentConversion,
    /// Year and day of the year.
    pub(super) date: (i32, u32),
}

/// Horizontal intensity below which the declination is too uncertain for a comparison, in nT.
const LEAST_HORIZONTAL_NT: f64 = 2000.0;
/// A wrong unit or baseline is assumed if the component normal to the IGRF's meridian exceeds this limit, in nT. The
/// crustal anomaly is smaller at most stations.
const ACROSS_NT: f64 = 250.0;
/// A note is added if the component normal to the IGRF's meridian exceeds this limit, in nT, even if no cause is found.
const REMARKABLE_NT: f64 = 1000.0;
/// A cause is accepted only if removing it leaves at most this fraction of the component normal to the IGRF's meridian.
const EXPLAINED: f64 = 0.25;
/// Difference of inclinations that a local anomaly cannot cause, in degrees.
const DIP_DEG: f64 = 10.0;

/// The text after `DECBAS` in a comment of a header.
pub(super) fn baseline_of(comment: &str) -> Option<&str> {
    const LABEL: &str = "DECBAS";
    let starts = comment.get(..LABEL.len()).is_some_and(|start| start.eq_ignore_ascii_case(LABEL));
    starts.then(|| comment.get(LABEL.len()..).unwrap_or("").trim_start_matches([':', '=', ' ', '\t']))
}

/// Compares a sample of a record with the IGRF at its position and date, if both are known. If the components of a
/// record are relative to an unknown baseline, north and east become unknown, with a note.
///
/// # Errors
/// Fails if a declination or an inclination agrees with the IGRF only in another unit or with another baseline.
pub(super) fn check(
    path: &Path,
    record: &mut ObservatoryRecord,
    sighting: &DeclinationSample,
) -> Result<(), ReadError> {
    let Some(igrf) = igrf(record, sighting.date) else { return Ok(()) };
    let magnitude = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (found, expected) = (magnitude(&sighting.ned_nt), magnitude(&igrf));
    if found < 0.5 * expected {
        let what = "the components are relative to base values that the file lacks";
        let mut note = format!("{what}: their magnitude is {found:.0} nT, but the IGRF gives {expected:.0} nT");
        if matches!(sighting.kind, ComponentConversion::Hdz(_) | ComponentConversion::Dif(_)) {
            disoriented(record);
            note += "; `field_n` and `field_e` are unknown: add the base value of each component to its column";
        }
        record.notes.push(note);
        return Ok(());
    }
    let horizontal_nt = igrf[0].hypot(igrf[1]);
    if horizontal_nt < LEAST_HORIZONTAL_NT {
        return Ok(());
    }
    check_dip(path, sighting, &igrf)?;
    let igrf_rad = igrf[1].atan2(igrf[0]);
    let across_nt = |rad: f64| {
        let off = (wrap_deg((rad - igrf_rad).to_degrees())).to_radians().abs();
        horizontal_nt * off.min(std::f64::consts::FRAC_PI_2).sin()
    };
    let found_rad = sighting.ned_nt[1].atan2(sighting.ned_nt[0]);
    let across = across_nt(found_rad);
    if across < ACROSS_NT {
        return Ok(());
    }
    let [found_deg, igrf_deg] = [found_rad, igrf_rad].map(f64::to_degrees);
    if let Some((what, remedy)) =
        explanation(sighting, found_rad, |rad| across_nt(rad) < ACROSS_NT.min(EXPLAINED * across))
    {
        let what = format!("{what}: the declination would be {found_deg:.2} deg, but the IGRF gives {igrf_deg:.2} deg");
        return Err(ReadError::data(path, what).help(remedy));
    }
    if across < REMARKABLE_NT {
        return Ok(());
    }
    let compared = format!("the declination would be {found_deg:.2} deg, but the IGRF gives {igrf_deg:.2} deg");
    if sighting.baseline_rad == 0.0 && !matches!(sighting.kind, ComponentConversion::Xyz(_)) {
        disoriented(record);
        let remedy = "set the baseline of the declination in the header (`DECBAS`, tenths of minutes of arc)";
        record.notes.push(format!("{compared}: `field_n` and `field_e` are unknown; {remedy}"));
    } else {
        record.notes.push(format!("{compared}: check the orientation of `field_n` and `field_e`"));
    }
    Ok(())
}

/// Cause of a wrong declination and its remedy. `fits` tests the declination with an assumed cause removed.
fn explanation(
    sighting: &DeclinationSample,
    found_rad: f64,
    fits: impl Fn(f64) -> bool,
) -> Option<(&'static str, &'static str)> {
    const DECBAS: &str = "correct `DECBAS` in the header; its unit is tenths of minutes of arc";
    let DeclinationSample { baseline_rad: base, own_rad, unused_rad, .. } = *sighting;
    let without = found_rad - base;
    let of_own = own_rad.and_then(|own| {
        if fits(60.0 * own + base) {
            return Some(("D is in degrees", "convert D to minutes of arc: multiply by 60"));
        }
        let unused = unused_rad.filter(|unused| fits(own + unused));
        unused.map(|_| ("D is relative to `DECBAS`", "set `Data Type` to `variation` in the header"))
    });
    if of_own.is_some() || base == 0.0 {
        return of_own;
    }
    if fits(without + 10.0 * base) {
        return Some(("`DECBAS` is in minutes of arc", DECBAS));
    }
    if fits(without + 600.0 * base) {
        return Some(("`DECBAS` is in degrees", DECBAS));
    }
    let twice = own_rad.filter(|own| fits(*own));
    twice.map(|_| {
        ("D is the full declination, so the baseline is added twice", "set the baseline of D to 0 in the header")
    })
}

/// Rejects an inclination in degrees.
fn check_dip(path: &Path, sighting: &DeclinationSample, igrf: &[f64; 3]) -> Result<(), ReadError> {
    if !matches!(sighting.kind, ComponentConversion::Dif(_)) {
        return Ok(());
    }
    let dip_deg = |v: &[f64; 3]| v[2].atan2(v[0].hypot(v[1])).to_degrees();
    let (found, expected) = (dip_deg(&sighting.ned_nt), dip_deg(igrf));
    if (found - expected).abs() > DIP_DEG && (60.0 * found - expected).abs() < DIP_DEG {
        let what =
            format!("I is in degrees: the inclination would be {found:.2} deg, but the IGRF gives {expected:.2} deg");
        return Err(ReadError::data(path, what).help("convert D and I to minutes of arc: multiply by 60"));
    }
    Ok(())
}

/// Makes north and east unknown.
fn disoriented(record: &mut ObservatoryRecord) {
    for [north, east, _] in &mut record.ned_nt {
        (*north, *east) = (f64::NAN, f64::NAN);
    }
}

/// North, east and down of the IGRF at a station, in nT; `None` if position or date is unknown or outside the model.
fn igrf(record: &ObservatoryRecord, (year, doy): (i32, u32)) -> Option<[f64; 3]> {
    if !(record.lat_deg.abs() <= 90.0 && record.lon_deg.abs() <= 360.0) {
        return None;
    }
    let field = CoreField::at(decimal_year(year, doy, 0.0).ok()?).ok()?;
    let alt_m = if record.msl_m.is_finite() { record.msl_m } else { 0.0 };
    Some(field.field_ned_nt(record.lat_deg, wrap_deg(record.lon_deg), alt_m))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]

    use super::{super::iaga2002, super::imf, *};

    /// A record of a station where the IGRF of 2019 has north 21010 nT, east 1606 nT (4.37 deg). [ppigrf 2.0]
    fn read(header: &str, components: &str, row: &str) -> Result<ObservatoryRecord, ReadError> {
        let columns: String = components.chars().map(|c| format!("   ABC{c}")).collect();
        let text = format!(
            " Format  IAGA-2002 |\n IAGA CODE  ABC |\n Geodetic Latitude 47.928 |\n Geodetic Longitude 15.866 |\n \
             Elevation 1087 |\n{header}DATE TIME DOY {columns} |\n2019-05-03 10:00:00.000 123 {row}\n"
        );
        iaga2002::parse(Path::new("a.min"), &text)
    }

    const VARIATION: &str = " Data Type variation |\n";
    const DEFINITIVE: &str = " Data Type Definitive |\n";

    /// Checks that north and east are within 1 nT of the values, and that there is no note.
    fn is(record: ObservatoryRecord, north: f64, east: f64) {
        let [n, e, d] = record.ned_nt[0];
        assert!((n - north).abs() < 1.0 && (e - east).abs() < 1.0 && d.is_finite(), "{:?}", record.ned_nt[0]);
        assert!(record.notes.is_empty(), "{:?}", record.notes);
    }

    /// Checks that north and east are unknown, down and total are as given, and a note has these words.
    fn unknown(record: ObservatoryRecord, words: &[&str]) {
        let [n, e, d] = record.ned_nt[0];
        assert!(n.is_nan() && e.is_nan() && d == 44_000.0 && record.total_nt[0] == 48_400.0, "{record:?}");
        let [note] = record.notes.as_slice() else { panic!("{:?}", record.notes) };
        assert!(words.iter().all(|word| note.contains(word)), "{note}");
    }

    #[test]
    fn unit_variations_without_a_baseline_give_no_north_and_east() {
        let hez = "20050.00 30.00 44000.00 48400.00";
        let words = ["H and E are relative", "`field_n` and `field_e` are unknown", "# DECBAS <tenths"];
        unknown(read(VARIATION, "HEZF", hez).unwrap(), &words);
        // Without a baseline, the direction of H is unknown in definitive data, too. A missing-value marker is not a
        // baseline.
        unknown(read(DEFINITIVE, "HEZF", hez).unwrap(), &words);
        unknown(read(&format!("{VARIATION} # DECBAS 99999 |\n"), "HEZF", hez).unwrap(), &words);
        let hdz = "20050.00 5.14 44000.00 48400.00";
        unknown(read(VARIATION, "HDZF", hdz).unwrap(), &["D is relative", "`# DECBAS 0` if D is the full"]);
        unknown(read("", "HDZF", hdz).unwrap(), &["D is relative", "unknown"]);
        unknown(read(" # DECBAS 2622 |\n", "HDZF", hdz).unwrap(), &["D may be relative", "Data Type"]);
        // A baseline of 0 contradicts the IGRF.
        let zero = format!("{VARIATION} # DECBAS 0 |\n");
        unknown(read(&zero, "HEZF", hez).unwrap(), &["would be 0.09 deg, but the IGRF gives 4.37", "unknown"]);
    }

    #[test]
    fn law_a_baseline_turns_variations_to_north_and_east() {
        // 4.37 deg: the sine is 0.076198, the cosine 0.997093.
        let base = format!("{VARIATION} #DECBAS: 2622 (tenths of minutes) |\n");
        is(read(&base, "HEZF", "20050.00 30.00 44000.00 48400.00").unwrap(), 19_989.4, 1_557.7);
        // The angle of 30 nT across 20050 nT is 5.144 minutes of arc.
        is(read(&base, "HDZF", "20050.02 5.144 44000.00 48400.00").unwrap(), 19_989.4, 1_557.7);
        is(read(DEFINITIVE, "HDZF", "20050.02 267.344 44000.00 48400.00").unwrap(), 19_989.4, 1_557.7);
        is(
            read(&format!("{VARIATION} # DECBAS 0 |\n"), "HDZF", "20050.02 267.344 44000 48400").unwrap(),
            19_989.4,
            1_557.7,
        );
        // The inclination of 44000 over 20050.02 is 65.5019 deg.
        is(read(DEFINITIVE, "DIFS", "267.344 3930.12 48352.4 48400.0").unwrap(), 19_989.4, 1_557.7);
    }

    #[test]
    fn unit_a_wrong_unit_or_baseline_is_reported() {
        let fault_text =
            |header: &str, components: &str, row: &str| read(header, components, row).unwrap_err().to_string();
        let degrees = fault_text(DEFINITIVE, "HDZF", "20050.02 4.456 44000 48400");
        assert!(
            degrees.contains("D is in degrees: the declination would be 0.07 deg")
                && degrees.contains("multiply by 60")
        );
        let degrees = fault_text(DEFINITIVE, "DIFS", "4.456 65.502 48352.4 48400.0");
        assert!(degrees.contains("I is in degrees: the inclination would be 1.09 deg"), "{degrees}");
        let base = |tenths: &str| format!("{VARIATION} # DECBAS {tenths} |\n");
        let hez = "20050.00 30.00 44000.00 48400.00";
        assert!(fault_text(&base("4.37"), "HEZF", hez).contains("`DECBAS` is in degrees"));
        assert!(fault_text(&base("262.2"), "HEZF", hez).contains("`DECBAS` is in minutes of arc"));
        let whole = "20050.02 267.344 44000 48400";
        assert!(fault_text(&base("2622"), "HDZF", whole).contains("the baseline is added twice"));
        let relative = format!("{DEFINITIVE} # DECBAS 2622 |\n");
        assert!(fault_text(&relative, "HDZF", "20050.02 5.144 44000 48400").contains("D is relative to `DECBAS`"));
        let reported = fault_text(" Reported HDZF |\n Data Type definitive |\n", "XYZF", "19989 1558 44000 48400");
        assert!(reported.contains("`Reported` is HDZF, but the columns are ABCX, ABCY, ABCZ, ABCF"), "{reported}");
        let station = fault_text(" IAGA CODE DEF |\n Data Type definitive |\n", "XYZF", "19989 1558 44000 48400");
        assert!(station.contains("the stations ABC and DEF"), "{station}");
        let short = fault_text(DEFINITIVE, "XYZF", "19989 1558 44000");
        assert!(short.contains("there are 3 values instead of 4 in line 8"), "{short}");
    }

    #[test]
    fn unit_components_relative_to_an_unknown_value_are_noted() {
        let xyz = read(VARIATION, "XYZF", "12.00 -3.00 5.00 48400.00").unwrap();
        assert!(xyz.notes[0].contains("their magnitude is 13 nT, but the IGRF gives 48") && xyz.ned_nt[0][0] == 12.0);
        let hdz = read(&format!("{VARIATION} # DECBAS 2622 |\n"), "HDZF", "12.00 5.00 5.00 48400.00").unwrap();
        assert!(hdz.notes[0].contains("`field_n` and `field_e` are unknown") && hdz.ned_nt[0][0].is_nan());
        // Components along sensor axes, although they have the names of geographic components.
        let xyz = read(VARIATION, "XYZF", "20050.00 30.00 44000.00 48400.00").unwrap();
        assert!(xyz.notes[0].contains("check the orientation") && xyz.ned_nt[0][1] == 30.0, "{:?}", xyz.notes);
    }

    #[test]
    fn unit_two_samples_years_apart_are_not_a_record_of_seconds() {
        let rows = "19989 1558 44000 48400\n2019-05-03 10:00:01.000 123 19989 1558 44000 48400\n\
                    2020-05-03 10:00:00.000 124 19989 1558 44000 48400";
        let message = read(DEFINITIVE, "XYZF", rows).unwrap_err().to_string();
        assert!(message.contains("3 samples in 31622400 steps of 1 s"), "{message}");
    }

    #[test]
    fn ref_the_total_is_that_of_the_scalar_magnetometer() {
        // INTERMAGNET: S is measured, and F is computed from the vector. G is F minus S, or minus S where the vector is
        // missing.
        let total = |components: &str, row: &str| read(DEFINITIVE, components, row).unwrap().total_nt[0];
        assert_eq!(total("DIFS", "267.344 3930.12 48352.4 48400.0"), 48_400.0);
        assert!((total("XYZG", "19989.40 1557.70 44000.00 -47.10") - 48_400.0).abs() < 0.1);
        assert_eq!(total("XYZG", "99999.00 99999.00 99999.00 -48400.00"), 48_400.0);
        assert!(total("XYZG", "19989.40 1557.70 44000.00 88888.00").is_nan());
        assert!(total("XYZF", "19989.40 1557.70 44000.00 99999.00").is_nan());
    }

    #[test]
    fn unit_an_imf_header_without_a_baseline_gives_no_direction() {
        let day = |baseline: &str, d: &str| {
            let pair = format!("200500 {d} 440000 484000  200500 {d} 440000 484000\n");
            let text =
                format!("ABC MAY0319 123 10 HDZF R VIE 04210159 {baseline} RRRRRRRRRRRRRRRR\n{}", pair.repeat(30));
            imf::parse(Path::new("a.abc"), &text)
        };
        // Colatitude 42.1 and longitude 15.9 deg.
        is(day("002622", "514").unwrap(), 19_989.4, 1_557.7);
        is(day("000000", "26734").unwrap(), 19_989.4, 1_557.7);
        unknown(day("000000", "514").unwrap(), &["but the IGRF gives 4.3", "`DECBAS`"]);
        let twice = day("002622", "26734").unwrap_err().to_string();
        assert!(twice.contains("the baseline is added twice"), "{twice}");
    }
}
