//! Units in the names of columns, in their usual spellings: `GPS Lat (rad)`, `Mag [nT]`, `GPS Alt ft`, `MagCabin_T`,
//! `gyro_x_rad_s`.

use schemas::{convert, flight, is_unit, usual_spelling};

/// The unit that a name implies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ImpliedUnit {
    /// No unit.
    Nothing,
    /// A definite unit: in brackets, or of several letters at the end.
    Unit(String),
    /// One or two letters at the end that are a unit, or an abbreviation of something else.
    Perhaps(String),
    /// An unknown text in brackets, or an unknown end that resembles a unit.
    Unknown(String),
}

/// Words in brackets or after the unit that describe the quantity and not the unit.
const QUALIFIERS: &[&str] = &[
    "msl",
    "agl",
    "amsl",
    "asl",
    "hae",
    "wgs84",
    "wgs-84",
    "ellipsoid",
    "ellipsoidal",
    "geoid",
    "gps",
    "gnss",
    "ins",
    "utc",
    "true",
    "raw",
    "x",
    "y",
    "z",
    "north",
    "east",
    "down",
    "up",
    "filtered",
    "smoothed",
];

/// Letters at the end of a name that often have another meaning: `Flux_A` is a sensor, `vel_ns` a direction.
const AMBIGUOUS: &[&str] = &[
    "ns", "us", "ma", "mg", "mt", "mv", "ut", "min", "hr", "kn", "kt", "dps", "mm", "cm", "fpm", "mph", "pa", "pt",
    "bar", "gon",
];

/// The unit that the name of a column implies. A standard name implies no unit: the `t` of `flux_a_t` and the `a` of
/// `flux_a` are not units.
pub(super) fn implied_unit(name: &str) -> ImpliedUnit {
    if is_canonical(name) {
        return ImpliedUnit::Nothing;
    }
    let name = name.trim();
    if let Some(inside) = bracketed(name) {
        return match inside {
            _ if is_unit(&spelt(inside)) => ImpliedUnit::Unit(spelt(inside)),
            _ if is_qualifier(inside) => {
                implied_by_suffix(name.get(..name.len() - inside.len() - 2).unwrap_or("").trim_end())
            }
            _ => ImpliedUnit::Unknown(inside.to_owned()),
        };
    }
    implied_by_suffix(name)
}

/// The name and the unit in a column header such as `mag_c [nT]`, as `magline export --units` writes it. Other names
/// with brackets, such as `Mag [nT]` and `GPS Alt [ft]`, remain whole.
pub(super) fn split_head(head: &str) -> Option<(&str, &str)> {
    let (name, unit) = head.trim().strip_suffix(']')?.rsplit_once(" [")?;
    let plain = name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    // A standard name may have any unit: if the unit is unknown, the conversion fails.
    (plain && !unit.is_empty() && (is_unit(unit) || is_canonical(name))).then_some((name, unit))
}

/// Removes a known unit in brackets from the end of a name: `Anomaly (nT)` becomes `Anomaly`.
pub(super) fn without_unit(name: &str) -> &str {
    let name = name.trim();
    let Some(inside) = bracketed(name).filter(|inside| is_unit(&spelt(inside))) else { return name };
    name.get(..name.len() - inside.len() - 2).unwrap_or(name).trim_end_matches([' ', '_'])
}

/// Whether the name is a standard name with a unit.
pub(super) fn is_canonical(name: &str) -> bool {
    flight::COLUMNS.iter().any(|(known, _)| *known == name) || !flight::describe(name).unit.is_empty()
}

/// The unit of a column that is not renamed, from its name; `None` if the unit is ambiguous.
pub(super) fn kept_unit(name: &str) -> Option<String> {
    match implied_unit(name) {
        ImpliedUnit::Unit(unit) => Some(unit),
        ImpliedUnit::Perhaps(unit) => ["m", "s", "T"].contains(&unit.as_str()).then_some(unit),
        ImpliedUnit::Nothing | ImpliedUnit::Unknown(_) => None,
    }
}

/// An unknown text at the end of a name, with or without brackets, that looks like a unit.
pub(super) fn unknown_unit(name: &str) -> Option<String> {
    if matches!(implied_unit(name), ImpliedUnit::Unit(_) | ImpliedUnit::Perhaps(_)) {
        return None;
    }
    let end = bracketed(name).map_or_else(|| name.to_owned(), |inside| format!("in {inside}"));
    match unknown_end(&end) {
        ImpliedUnit::Unknown(unit) => Some(unit),
        ImpliedUnit::Nothing | ImpliedUnit::Unit(_) | ImpliedUnit::Perhaps(_) => None,
    }
}

/// The text in brackets at the end.
fn bracketed(name: &str) -> Option<&str> {
    [('(', ')'), ('[', ']'), ('{', '}')].into_iter().find_map(|(open, close)| {
        let body = name.strip_suffix(close)?;
        body.get(body.rfind(open)? + 1..)
    })
}

fn is_qualifier(word: &str) -> bool {
    let word = word.trim().to_ascii_lowercase();
    word.is_empty() || word.bytes().all(|b| b.is_ascii_digit()) || QUALIFIERS.contains(&word.as_str())
}

/// The longest end of the name that is a unit, without words such as `MSL` and numbers after it.
fn implied_by_suffix(name: &str) -> ImpliedUnit {
    const BETWEEN: [char; 5] = ['_', ' ', '-', ',', '.'];
    let mut name = name.trim_end_matches(BETWEEN);
    while let Some(at) = name.rfind(BETWEEN) {
        if !is_qualifier(name.get(at + 1..).unwrap_or("")) {
            break;
        }
        name = name.get(..at).unwrap_or("").trim_end_matches(BETWEEN);
    }
    let ends =
        name.char_indices().filter(|(_, c)| BETWEEN.contains(c)).filter_map(|(i, c)| name.get(i + c.len_utf8()..));
    // The whole name is excluded: a column `m` or `a` implies no unit.
    let found = ends.filter(|end| end.len() < name.len()).find(|end| is_unit(&spelt(end)));
    let Some(end) = found else { return unknown_end(name) };
    let unit = spelt(end);
    if end.len() > 1 {
        // Units in mixed case, such as `uT` and `mA`, are definite.
        let one_case = !(end.chars().any(char::is_lowercase) && end.chars().any(char::is_uppercase));
        let ambiguous = one_case && AMBIGUOUS.contains(&unit.to_ascii_lowercase().as_str());
        return if ambiguous { ImpliedUnit::Perhaps(unit) } else { ImpliedUnit::Unit(unit) };
    }
    // A single letter is a unit only in its exact case: `t`, `a`, `v`, `g`, `c` have other meanings.
    if ["T", "G", "A", "V", "m", "s", "g"].contains(&end) { ImpliedUnit::Perhaps(unit) } else { ImpliedUnit::Nothing }
}

/// Units without a conversion, and notations of angles that no factor can convert.
const OTHERS: &[&str] = &[
    "dms",
    "ddmm",
    "ddmmss",
    "dmm",
    "hms",
    "hhmmss",
    "hhmm",
    "inch",
    "inches",
    "hands",
    "rod",
    "rods",
    "chain",
    "chains",
    "link",
    "links",
    "fathom",
    "fathoms",
    "furlong",
    "furlongs",
    "league",
    "leagues",
    "semicircles",
    "turns",
    "revs",
    "rpm",
    "mils",
    "quads",
    "counts",
    "lsb",
    "adu",
    "bits",
    "ticks",
    "oersted",
    "oersteds",
    "weber",
    "percent",
    "pct",
    "ppm",
    "mach",
    "atm",
    "torr",
    "days",
    "weeks",
    "fortnight",
];

/// Prefixes of one-letter units, and prefixes of longer units.
const PREFIXES: [&[&str]; 2] =
    [&["k", "m", "u", "µ", "μ", "n", "p", "f"], &["G", "M", "k", "h", "d", "c", "m", "u", "µ", "μ", "n"]];

/// Units that take these prefixes, in their exact case.
const PREFIXED: [&[&str]; 2] =
    [&["T", "G", "V", "A"], &["gauss", "tesla", "Gal", "rad", "deg", "ft", "feet", "Pa", "bar", "Hz", "m/s", "mps"]];

/// Denominators that indicate a quotient even if the numerator is not a known unit.
const TIMES: [&str; 9] = ["s", "sec", "min", "h", "hr", "hour", "day", "week", "fortnight"];

/// Checks whether a name without a known unit ends in a string that looks like a unit: a quotient, a known unit with a
/// prefix or further letters, or a unit without a conversion.
fn unknown_end(name: &str) -> ImpliedUnit {
    if let Some(quotient) = unknown_quotient(name) {
        return ImpliedUnit::Unknown(quotient.to_owned());
    }
    let Some(at) = name.rfind(['_', ' ']) else { return ImpliedUnit::Nothing };
    let word = name.get(at + 1..).unwrap_or_default();
    if let Some((unit, more)) = unit_and_more(word) {
        return if is_qualifier(more) { ImpliedUnit::Unit(spelt(unit)) } else { ImpliedUnit::Unknown(word.to_owned()) };
    }
    let with = |(prefixes, units): (&[&str], &[&str])| {
        prefixes.iter().filter_map(|p| word.strip_prefix(p)).any(|rest| units.contains(&rest))
    };
    let prefixed = PREFIXES.into_iter().zip(PREFIXED).any(with);
    let listed = OTHERS.contains(&word.to_ascii_lowercase().as_str());
    if listed || prefixed { ImpliedUnit::Unknown(word.to_owned()) } else { ImpliedUnit::Nothing }
}

/// The quotient of units at the end of a name.
fn unknown_quotient(name: &str) -> Option<&str> {
    let sign = ["_per_", " per ", "/"].into_iter().filter_map(|sign| Some((name.rfind(sign)?, sign))).max()?;
    let (over, under) = (name.get(..sign.0)?, name.get(sign.0 + sign.1.len()..)?);
    let from = over.rfind(['_', ' ']).map_or(0, |at| at + 1);
    let known = over.len() - from > 1 && is_unit(over.get(from..)?);
    (from > 0 && (known || TIMES.contains(&under))).then(|| name.get(from..)).flatten()
}

/// A unit of two letters or more, and the capitalised word that follows it without a blank: `ftMSL`, `ftClarke`.
fn unit_and_more(word: &str) -> Option<(&str, &str)> {
    let capitals = word.char_indices().skip(2).filter(|(_, c)| c.is_uppercase());
    capitals.map(|(at, _)| word.split_at(at)).find(|(unit, _)| {
        let definite = !AMBIGUOUS.contains(&unit.to_lowercase().as_str());
        unit.ends_with(char::is_lowercase) && is_unit(unit) && definite
    })
}

/// The converter's spelling of a unit: `m_s2` becomes `m/s2`, and `rad_s` and `m_per_s` become quotients.
fn spelt(unit: &str) -> String {
    let unit = unit.trim();
    let usual = |unit: &str| usual_spelling(unit).unwrap_or(unit).to_owned();
    if is_unit(unit) {
        return usual(unit);
    }
    let slashed = unit.replace("_per_", "/").replace(" per ", "/").replace(['_', ' '], "/");
    let slashed = slashed.strip_suffix("/2").map_or(slashed.clone(), |body| format!("{body}2"));
    if is_unit(&slashed) { usual(&slashed) } else { unit.to_owned() }
}

/// Reason why the unit of a column does not follow from its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum UnitNameError {
    /// The name implies a unit of another dimension, or an unknown unit.
    Other(String),
    /// The last letter of the name may be a unit, which would change the values.
    Ambiguous(String),
}

/// The unit of the values of the column `name`, which is renamed to `ours` with the unit `wanted`; `None` if the name
/// implies no unit.
///
/// # Errors
/// Fails for a name with a unit that does not convert, or for an ambiguous name.
pub(super) fn unit_of_renamed(name: &str, ours: &str, wanted: &str) -> Result<Option<String>, UnitNameError> {
    let factor = |unit: &str| convert(unit, wanted);
    match implied_unit(name) {
        ImpliedUnit::Nothing => Ok(None),
        _ if wanted.is_empty() => Ok(None),
        ImpliedUnit::Unknown(word) => Err(UnitNameError::Other(word)),
        ImpliedUnit::Unit(unit) if factor(&unit).is_none() => Err(UnitNameError::Other(unit)),
        ImpliedUnit::Unit(unit) => Ok(Some(unit)),
        ImpliedUnit::Perhaps(unit) => match factor(&unit) {
            None if unit == "m" => Err(UnitNameError::Other(unit)),
            None => Ok(None),
            // `g` is standard gravity; for a field it is probably part of the name.
            Some(_) if unit == "g" && wanted != "m/s2" => Ok(None),
            Some(factor) if factor != 1.0 && is_doubtful(name, ours, &unit) => Err(UnitNameError::Ambiguous(unit)),
            Some(_) => Ok(Some(unit)),
        },
    }
}

/// Whether a unit of one letter is ambiguous. The `T` of `FLUXB_T`, a name in capitals, may mean tesla or total; so may
/// the `T` of any column that is renamed to a vector's magnitude.
fn is_doubtful(name: &str, ours: &str, unit: &str) -> bool {
    unit.len() == 1 && (!name.bytes().any(|b| b.is_ascii_lowercase()) || (unit == "T" && ours.ends_with("_t")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::panic)]

    use super::*;

    fn unit(word: &str) -> ImpliedUnit {
        ImpliedUnit::Unit(word.to_owned())
    }

    #[test]
    fn ref_usual_spellings_of_units_in_names() {
        for (name, expected) in [
            ("GPS Lat (rad)", "rad"),
            ("GPS Alt ft", "ft"),
            ("GPS Alt ft MSL", "ft"),
            ("alt_ft_1", "ft"),
            ("Alt ft (WGS84)", "ft"),
            ("Altitude[m]", "m"),
            ("Mag [nT]", "nT"),
            ("mag_uT", "uT"),
            ("mag µT", "µT"),
            ("mag_x_mgauss", "mgauss"),
            ("ins_lat_rad", "rad"),
            ("roll_deg", "deg"),
            ("gyro_x_rad_s", "rad/s"),
            ("accel_m_s2", "m/s2"),
            ("speed m/s", "m/s"),
            ("vn_m_s", "m/s"),
            ("vn_mps", "m/s"),
            ("flux_a_x_nt", "nT"),
            ("lat_degE7", "degE7"),
        ] {
            let ImpliedUnit::Unit(found) = implied_unit(name) else { panic!("{name}: {:?}", implied_unit(name)) };
            assert_eq!(convert(&found, expected), Some(1.0), "{name}: {found}");
        }
        assert_eq!(implied_unit("MagCabin_T"), ImpliedUnit::Perhaps("T".into()));
        assert_eq!(implied_unit("Mag (counts)"), ImpliedUnit::Unknown("counts".into()));
        assert_eq!(implied_unit("Mag [T]"), unit("T"));
    }

    #[test]
    fn unit_a_head_of_an_export_is_a_name_and_a_unit() {
        for (head, parts) in [
            ("tt [s]", Some(("tt", "s"))),
            ("my_2 [uT]", Some(("my_2", "uT"))),
            ("alt [fathoms]", Some(("alt", "fathoms"))),
            ("lat[deg]", None),
            ("Mag [nT]", None),
            ("my_2 [counts]", None),
            ("flight", None),
            ("x []", None),
        ] {
            assert_eq!(split_head(head), parts, "{head}");
        }
    }

    #[test]
    fn unit_standard_names_are_never_read_as_units() {
        let families = ["mag_2_uc", "mag_1_c", "flux_a_x", "flux_a_t", "cur_x", "cur_ac_hi", "vol_bat_1", "vol_back_n"];
        let all = flight::COLUMNS.iter().map(|(name, _)| *name).chain(families);
        for name in all {
            assert_eq!((implied_unit(name), kept_unit(name)), (ImpliedUnit::Nothing, None), "{name}");
        }
        for name in
            ["flux_a", "flux_a_t", "m", "counter", "mag_c", "Mag A", "vel_ns", "event", "Flux_V", "mag_t", "time_ut"]
        {
            assert_eq!(kept_unit(name), None, "{name}");
        }
        for (name, unit) in [("tie_m", "m"), ("time_s", "s"), ("MagCabin_T", "T"), ("GPS Alt ft", "ft")] {
            assert_eq!(kept_unit(name).as_deref(), Some(unit), "{name}");
        }
    }

    #[test]
    fn unit_unknown_texts_that_look_like_units_are_found() {
        for (name, unit) in [("ALT_kft", Some("kft")), ("Mag (counts)", Some("counts")), ("TMI (IGRF removed)", None)] {
            assert_eq!(unknown_unit(name).as_deref(), unit, "{name}");
        }
        for name in ["ALT_ft", "MAG_LEV", "alt", "mag_1_uc", "X", "Mag [nT]"] {
            assert_eq!(unknown_unit(name), None, "{name}");
        }
    }

    #[test]
    fn unit_a_renamed_column_is_converted_or_rejected() {
        let of = |name, ours, wanted| unit_of_renamed(name, ours, wanted);
        assert_eq!(of("MagCabin_T", "mag_4_uc", "nT"), Ok(Some("T".into())));
        assert_eq!(of("acc_x_g", "ins_fn", "m/s2"), Ok(Some("g".into())));
        assert_eq!(of("mag_g", "mag_4_uc", "nT"), Ok(None));
        assert_eq!(of("Flux A", "flux_a_x", "nT"), Ok(None));
        assert_eq!(of("flux_a", "flux_a_x", "nT"), Ok(None));
        assert_eq!(of("vel_ns", "vn", "m/s"), Ok(None));
        assert_eq!(of("time_ut", "tt", "s"), Ok(None));
        assert_eq!(of("mag_ut", "mag_4_uc", "nT"), Ok(Some("uT".into())));
        assert_eq!(of("temp_degC", "mag_4_uc", "nT"), Err(UnitNameError::Other("degC".into())));
        assert_eq!(of("Alt (fathoms)", "alt", "m"), Err(UnitNameError::Other("fathoms".into())));
        assert_eq!(of("lat_m", "lat", "deg"), Err(UnitNameError::Other("m".into())));
        for (name, ours, wanted, unit) in [
            ("Alt_ftUS", "alt", "m", "ftUS"),
            ("Alt (US-ft)", "alt", "m", "ftUS"),
            ("alt_us_ft", "alt", "m", "ftUS"),
            ("Alt_ft_US", "alt", "m", "ftUS"),
            ("alt_sft", "alt", "m", "ftUS"),
            ("Alt US survey foot", "alt", "m", "ftUS"),
            ("ve_fps", "ve", "m/s", "ft/s"),
            ("Vn kts", "vn", "m/s", "kn"),
            ("ve_km_h", "ve", "m/s", "km/h"),
            ("ve km/hr", "ve", "m/s", "km/h"),
            ("Alt_ftMSL", "alt", "m", "ft"),
        ] {
            assert_eq!(of(name, ours, wanted), Ok(Some(unit.into())), "{name}");
        }
        for (name, ours, wanted, unit) in [
            ("Alt_fathoms", "alt", "m", "fathoms"),
            ("alt_kft", "alt", "m", "kft"),
            ("alt_ftClarke", "alt", "m", "ftClarke"),
            ("lat_dms", "lat", "deg", "dms"),
            ("vd_ft/day", "vd", "m/s", "ft/day"),
            ("vd_furlongs_per_fortnight", "vd", "m/s", "furlongs_per_fortnight"),
            ("mag_kgauss", "mag_4_uc", "nT", "kgauss"),
            ("mag_counts", "mag_4_uc", "nT", "counts"),
        ] {
            assert_eq!(of(name, ours, wanted), Err(UnitNameError::Other(unit.into())), "{name}");
        }
        for (name, ours, wanted) in [
            ("TotalField_comp", "mag_1_c", "nT"),
            ("vn_bar", "vn", "m/s"),
            ("GPS_Altitude", "alt", "m"),
            ("mag lev", "mag_1_c", "nT"),
            ("Alt_HAE", "alt", "m"),
            ("UTC_time", "tt", "s"),
            ("B_Total", "mag_4_uc", "nT"),
            ("velocity N/S", "vn", "m/s"),
        ] {
            assert_eq!(of(name, ours, wanted), Ok(None), "{name}");
        }
        assert_eq!(of("FLUXB_T", "flux_b_t", "nT"), Err(UnitNameError::Ambiguous("T".into())));
        assert_eq!(of("MAG_T", "mag_4_uc", "nT"), Err(UnitNameError::Ambiguous("T".into())));
        assert_eq!(of("TIME_S", "tt", "s"), Ok(None));
        assert_eq!(of("Event (left)", "event", ""), Ok(None));
    }
}
