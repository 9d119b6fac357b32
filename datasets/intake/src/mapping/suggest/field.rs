//! Recognises magnetometers: by their names, by a unit of the field, or because their values are the earth's field.

use std::ops::Range;

use numerics::regression::statistics::{median, quantile};
use schemas::{convert, flight, one_line};

use super::{
    TopicSample,
    columns::{declared_unit, has, scalar},
    sample::ColumnSample,
};

/// Units of the earth's field, with their values in nT.
pub(super) const FIELD: [(&str, f64); 5] = [("nT", 1.0), ("mgauss", 1e2), ("uT", 1e3), ("gauss", 1e5), ("T", 1e9)];

/// Median magnitude of three components, in their unit.
pub(super) fn magnitude(axes: &[&ColumnSample; 3]) -> Option<f64> {
    let mut all = magnitudes(axes);
    (!all.is_empty()).then(|| median(&mut all))
}

fn magnitudes([x, y, z]: &[&ColumnSample; 3]) -> Vec<f64> {
    let rows = x.values.iter().zip(&y.values).zip(&z.values);
    rows.map(|((x, y), z)| (x * x + y * y + z * z).sqrt()).filter(|size| size.is_finite()).collect()
}

/// Magnitudes of the earth's field at a vector magnetometer with uncorrected offsets, in nT.
pub(super) const EARTH: Range<f64> = 15_000.0..100_000.0;
/// Readings of a scalar magnetometer, in nT.
const TOTAL: Range<f64> = 15_000.0..80_000.0;
/// Largest spread of the earth's field along a flight, from the 5th to the 95th percentile, relative to its median.
const STEADY: f64 = 0.15;
/// Words in the names of vectors that are not the magnetic field.
const OTHER_VECTORS: [&str; 20] = [
    "v",
    "vel",
    "velocity",
    "speed",
    "wind",
    "p",
    "pos",
    "position",
    "ecef",
    "utm",
    "acc",
    "accel",
    "accelerometer",
    "acceleration",
    "gyr",
    "gyro",
    "gyroscope",
    "rate",
    "angular",
    "w",
];
/// Words that, with numbers, name nothing but the reading of a scalar magnetometer.
const READING: [&str; 8] = ["mag", "magnetometer", "scalar", "tmi", "totalfield", "total", "field", "uc"];
/// Words in the names of columns whose values are close to a total field without being the reading of a magnetometer.
const DERIVED: [&str; 18] = [
    "x",
    "y",
    "z",
    "lag",
    "res",
    "residual",
    "anomaly",
    "signal",
    "quality",
    "status",
    "valid",
    "lock",
    "igrf",
    "model",
    "predicted",
    "std",
    "sigma",
    "err",
];
/// Words in the names of total fields at a base station.
const BASE: [&str; 5] = ["base", "basestation", "basemag", "observatory", "reference"];

/// Whether the words of three components name a magnetometer.
pub(super) fn is_named(words: &[String]) -> bool {
    let of_field = |w: &String| {
        ["compass", "field", "fgm", "vmag", "bfield"].contains(&w.as_str())
            || w.starts_with("mag")
            || w.starts_with("flux")
    };
    words.iter().any(of_field)
}

/// Unit of three components that behave like the earth's field, and the reason: their magnitude is steady, and in the
/// range of the earth's field or near the reading of a scalar magnetometer.
pub(super) fn field_like(
    topic: &TopicSample,
    axes: &[&ColumnSample; 3],
    words: &[String],
    size: f64,
) -> Option<(String, String)> {
    let declared = declared_unit(axes[0], "nT");
    let foreign = !axes[0].unit.is_empty() && declared.is_none();
    if foreign || has(words, &OTHER_VECTORS) || !is_steady(magnitudes(axes)) {
        return None;
    }
    if let Some(unit) = declared {
        return Some((unit, "the file gives the unit".to_owned()));
    }
    let readings = readings(topic);
    let near = FIELD.iter().find_map(|(unit, factor)| {
        let own = size * factor;
        let (name, nt) = readings.iter().find(|(_, nt)| (own / nt - 1.0).abs() < STEADY)?;
        let what = format!("the magnitude is steady at {own:.0} nT; the median of `{}` is {nt:.0} nT", one_line(name));
        Some(((*unit).to_owned(), what))
    });
    let alone = || {
        let what = format!("the magnitude is steady at {size:.0}, as expected for the earth's field in nT");
        TOTAL.contains(&size).then(|| ("nT".to_owned(), what))
    };
    near.or_else(alone)
}

fn is_steady(mut values: Vec<f64>) -> bool {
    values.sort_by(f64::total_cmp);
    let [low, middle, high] = [0.05, 0.5, 0.95].map(|part| quantile(&values, part));
    high - low < STEADY * middle.abs()
}

/// Scalar magnetometers of a topic, with their median readings in nT.
fn readings(topic: &TopicSample) -> Vec<(String, f64)> {
    let of = |column: &ColumnSample| {
        let guess = scalar(column, topic).filter(|guess| guess.is_used() && flight::is_scalar_reading(&guess.ours))?;
        let unit = declared_unit(column, "nT").unwrap_or_else(|| "nT".to_owned());
        Some((guess.theirs.first()?.clone(), column.median()? * convert(&unit, "nT")?))
    };
    topic.columns.iter().filter_map(of).collect()
}

/// Name, unit and reason of a column that is the total field at a scalar magnetometer; the reason why it is omitted; or
/// `None` for a column that is not a total field.
pub(super) fn reading(column: &ColumnSample) -> Option<Result<(String, String, String), String>> {
    let words = column.words();
    let named = has(&words, &["mag", "magnetometer", "tmi", "totalfield", "gamma", "gammas"])
        || (has(&words, &["total"]) && has(&words, &["field", "intensity"]));
    let declared = declared_unit(column, "nT");
    // A whole number may be a count, unless its unit is given.
    if has(&words, &DERIVED) || (declared.is_none() && (!named || column.whole)) {
        return None;
    }
    let median = column.median()?;
    let fits = |unit: &&String| convert(unit, "nT").is_some_and(|nt| TOTAL.contains(&(median * nt)));
    let fitting = declared.as_ref().filter(fits).cloned();
    let Some(unit) = fitting.or_else(|| (named && TOTAL.contains(&median)).then(|| "nT".to_owned())) else {
        let is_reading = words.iter().all(|w| READING.contains(&w.as_str()) || w.bytes().all(|b| b.is_ascii_digit()));
        return if is_reading { in_other_unit(median, declared).map(Err) } else { None };
    };
    if !named && !is_steady(column.known().collect()) {
        return None;
    }
    if has(&words, &BASE) {
        let why = format!(
            "the name and the median of {median:.1} {unit} indicate the total field at a base station; subtract the \
             mean in `sql`, and name the result `diurnal`"
        );
        return Some(Err(why));
    }
    let number = words.iter().find(|w| w.len() < 4 && w.bytes().all(|b| b.is_ascii_digit()));
    let number = number.map_or("1", String::as_str);
    if has(&words, &["comp", "compensated", "cmp"]) && !has(&words, &["un", "not"]) {
        let why =
            format!("a median of {median:.1} {unit} matches the earth's field; the name implies a compensated reading");
        return Some(Ok((format!("mag_{number}_c"), unit, why)));
    }
    let why = format!("a median of {median:.1} {unit} matches the earth's field");
    Some(Ok((format!("mag_{number}_uc"), unit, why)))
}

/// The reason to omit a reading that is a total field only in another unit than in `declared`, which is nT by default.
fn in_other_unit(median: f64, declared: Option<String>) -> Option<String> {
    let (unit, factor) = FIELD.iter().find(|(_, factor)| TOTAL.contains(&(median * factor)))?;
    let own = declared.map_or_else(|| "nT".to_owned(), |unit| format!("{unit} (the unit in the file)"));
    Some(format!(
        "a median of {median:.4} {own} does not match the earth's field; in {unit}, the median would be {:.0} nT; set \
         its `unit`",
        median * factor
    ))
}

/// Magnitudes of an analogue fluxgate in the earth's field, in V.
pub(super) const VOLTS: Range<f64> = 0.15..12.0;
/// Usual sensitivities of analogue fluxgates: 10 V at 70, 100, 250, 500 and 1000 uT, in nT per V.
const SENSITIVITIES: [f64; 5] = [7_000.0, 10_000.0, 25_000.0, 50_000.0, 100_000.0];

/// Sensitivity in nT per V of a fluxgate with the median magnitude `size`, from the reading of a scalar magnetometer,
/// and the reason; or the reason why it is unknown.
pub(super) fn volts(topic: &TopicSample, first: &ColumnSample, size: f64) -> Result<(f64, String), String> {
    let unit = declared_unit(first, "V").unwrap_or_else(|| "V".to_owned());
    let volt = convert(&unit, "V").unwrap_or(1.0);
    let whose = if declared_unit(first, "V").is_some() { "according to the names" } else { "according to their size" };
    let fits = |nt: &&f64| EARTH.contains(&(*nt * size * volt));
    let readings = readings(topic);
    let Some((name, total_nt)) = readings.first() else {
        let usual: Vec<String> = SENSITIVITIES.iter().filter(fits).map(f64::to_string).collect();
        return Err(format!(
            "volts {whose}, with a median magnitude of {size:.4} {unit}; set `scale` in nT per {unit} and \
             `unit = \"nT\"`; usual values: {}",
            usual.join(", ")
        ));
    };
    let measured = total_nt / (size * volt);
    let usual = SENSITIVITIES.into_iter().find(|nt| (measured / nt - 1.0).abs() < 0.15);
    let scale = usual.unwrap_or_else(|| (measured / 10.0).round() * 10.0) * volt;
    let kind = if usual.is_some() { "a usual sensitivity" } else { "the ratio of the medians" };
    Ok((
        scale,
        format!(
            "volts {whose}; at {scale} nT per {unit} ({kind}), the median magnitude of {size:.4} {unit} is {:.0} nT; \
             the median of `{}` is {total_nt:.0} nT",
            scale * size,
            one_line(name)
        ),
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{
        super::columns::{ColumnGuess, guesses},
        *,
    };

    const ROWS: usize = 400;

    fn column(name: &str, value: impl Fn(f64) -> f64) -> ColumnSample {
        let values = (0..ROWS).map(|row| value(row as f64 * 0.05)).collect();
        ColumnSample { name: name.to_owned(), values, ..ColumnSample::default() }
    }

    /// Three components of a rotating vector of length `size`.
    fn turning(names: [&str; 3], size: f64) -> Vec<ColumnSample> {
        let [x, y, z] = names;
        vec![
            column(x, move |t| 0.6 * size * t.cos()),
            column(y, move |t| 0.6 * size * t.sin()),
            column(z, move |_| 0.8 * size),
        ]
    }

    fn guessed(columns: Vec<ColumnSample>) -> Vec<ColumnGuess> {
        let topic = TopicSample { name: String::new(), rows: ROWS as u64, columns, clock: None };
        guesses(&topic, &mut ('a'..='z'))
    }

    fn used(columns: Vec<ColumnSample>) -> Vec<(String, String)> {
        guessed(columns).into_iter().filter(ColumnGuess::is_used).map(|guess| (guess.ours, guess.toml)).collect()
    }

    fn total(name: &str) -> ColumnSample {
        column(name, |t| 52_000.5 + 30.0 * (0.2 * t).sin())
    }

    #[test]
    fn unit_a_vector_magnetometer_is_recognised_under_any_name() {
        for (names, size, unit) in [
            (["fx", "fy", "fz"], 52_000.0, "nT"),
            (["Bx", "By", "Bz"], 52.0, "uT"),
            (["VMAG_X", "VMAG_Y", "VMAG_Z"], 0.52, "gauss"),
            (["mx", "my", "mz"], 520.0, "mgauss"),
            (["xRaw", "yRaw", "zRaw"], 52_000.0, "nT"),
        ] {
            let found = used([vec![total("mag")], turning(names, size)].concat());
            let (name, toml) = &found[0];
            assert_eq!(name, "flux_a", "{names:?}: {found:?}");
            assert!(toml.contains(&format!("unit = \"{unit}\"")) && toml.contains(names[1]), "{toml}");
            assert_eq!(found[1].0, "mag_1_uc");
        }
        // Without a scalar magnetometer, only values in nT are recognised by their size.
        assert_eq!(used(turning(["a_x", "a_y", "a_z"], 52_000.0))[0].0, "flux_a");
        assert!(used(turning(["a_x", "a_y", "a_z"], 52.0)).is_empty());
    }

    #[test]
    fn unit_other_vectors_are_not_the_field() {
        for (names, size) in [
            (["vx", "vy", "vz"], 52.0),
            (["vel_x", "vel_y", "vel_z"], 52.0),
            (["ax", "ay", "az"], 1.0),
            (["ecef_x", "ecef_y", "ecef_z"], 6.4e6),
            (["gyro_x", "gyro_y", "gyro_z"], 0.5),
        ] {
            let found = used([vec![total("mag")], turning(names, size)].concat());
            assert_eq!(found.len(), 1, "{names:?}: {found:?}");
        }
        // A magnitude that varies by more than the field does along a flight.
        let wild = ["x", "y", "z"].map(|name| column(name, |t| 30_000.0 * (1.0 + (3.0 * t).sin())));
        assert_eq!(used([vec![total("mag")], wild.to_vec()].concat()).len(), 1);
    }

    #[test]
    fn unit_a_unit_that_contradicts_the_values_is_a_reason_to_omit_a_vector() {
        let found = guessed(turning(["mag_x_uT", "mag_y_uT", "mag_z_uT"], 52_000.0));
        assert!(
            !found[0].is_used() && found[0].why.contains("in nT, the magnitude would be 52000 nT"),
            "{}",
            found[0].why
        );
        assert_eq!(used(turning(["mag_x_uT", "mag_y_uT", "mag_z_uT"], 52.0))[0].0, "flux_a");
    }

    #[test]
    fn unit_total_fields_are_recognised_by_their_unit() {
        let names = |columns: Vec<ColumnSample>| used(columns).into_iter().map(|(name, _)| name).collect::<Vec<_>>();
        assert_eq!(names(vec![total("cs_vl_nT"), total("sensor2 [nT]")]), ["mag_1_uc", "mag_2_uc"]);
        assert_eq!(
            names(vec![total("mag"), total("mag_comp"), total("mag2_comp")]),
            ["mag_1_uc", "mag_1_c", "mag_2_c"]
        );
        let micro = guessed(vec![column("mag_1", |t| 47.0 + 0.03 * (0.2 * t).sin())]);
        assert!(!micro[0].is_used() && micro[0].why.contains("in uT, the median would be 47"), "{}", micro[0].why);
        assert!(guessed(vec![column("mag_temp", |t| 25.0 + 0.1 * t)]).is_empty());
        // A residual, a model value, a pressure in Pa, and a reading in V.
        let others = [total("mag_res_nT"), total("igrf_model_nT"), total("pressure"), total("reading_V")];
        assert!(names(others.to_vec()).is_empty());
        let base = guessed(vec![total("base_mag_nT")]);
        assert!(!base[0].is_used() && base[0].why.contains("base station"), "{}", base[0].why);
    }
}
