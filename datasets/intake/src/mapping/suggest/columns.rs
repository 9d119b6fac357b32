//! Recognises columns by their names, units and values.

use std::f64::consts::{FRAC_PI_2, PI};

use datasets::formats::{name_of_head, unit_of_name};
use schemas::{convert, flight, is_unit, one_line, plausible::limits, usual_spelling};

use super::{TopicSample, quoted, sample::ColumnSample};

/// Suggested mapping of a column, or of a vector with three components.
pub struct ColumnGuess {
    /// The name in the flight table; for a skipped column, its name in the file.
    pub ours: String,
    /// The names in the file.
    pub theirs: Vec<String>,
    /// Text of the column in the mapping; empty for a skipped column.
    pub toml: String,
    /// Reason for the guess.
    pub why: String,
    /// Whether it is a vector.
    pub is_vector: bool,
}

impl ColumnGuess {
    /// Whether it is part of the mapping.
    pub fn is_used(&self) -> bool {
        !self.toml.is_empty()
    }

    fn left_out(name: &str, why: &str) -> ColumnGuess {
        let theirs = vec![name.to_owned()];
        ColumnGuess {
            ours: name.to_owned(),
            theirs,
            toml: String::new(),
            why: format!("omitted: {why}"),
            is_vector: false,
        }
    }
}

/// The recognised and nearly recognised columns of a table. `letters` are the unused names of vector magnetometers.
pub fn guesses(topic: &TopicSample, letters: &mut impl Iterator<Item = char>) -> Vec<ColumnGuess> {
    let mut out: Vec<ColumnGuess> = vec![];
    for (axes, words) in triples(topic) {
        if let Some(guess) = vector(topic, &axes, &words, letters) {
            let name = guess.ours.clone();
            let n = out.iter().filter(|g| g.ours == name || g.ours.starts_with(&format!("{name}_"))).count();
            out.push(if n > 0 && guess.is_used() {
                ColumnGuess { ours: format!("{name}_{}", n + 1), ..guess }
            } else {
                guess
            });
        }
    }
    let clock = topic.clock.as_ref().map(|c| c.column.as_str());
    for column in &topic.columns {
        let taken = Some(column.name.as_str()) == clock || out.iter().any(|g| g.theirs.contains(&column.name));
        if taken || flight::KEYS.contains(&column.name.as_str()) || column.range().is_none() {
            continue;
        }
        let Some(guess) = scalar(column, topic) else { continue };
        let guess = numbered(guess, &out);
        if guess.is_used() && out.iter().any(|g| g.ours == guess.ours) {
            let why = format!("another column is already `{}`", guess.ours);
            out.push(ColumnGuess::left_out(&column.name, &why));
        } else {
            out.push(guess);
        }
    }
    out
}

/// A scalar magnetometer under an unused number: a second sensor is `mag_2_uc`.
fn numbered(mut guess: ColumnGuess, taken: &[ColumnGuess]) -> ColumnGuess {
    let is_taken = |name: &str| taken.iter().any(|g| g.is_used() && g.ours == name);
    if guess.is_used() && flight::is_scalar_reading(&guess.ours) && is_taken(&guess.ours) {
        let free = (1..).map(|n| format!("mag_{n}_uc")).find(|name| !is_taken(name));
        guess.ours = free.unwrap_or(guess.ours);
    }
    guess
}

/// Three columns whose names differ only in x, y, z or 0, 1, 2, with their common words.
fn triples(topic: &TopicSample) -> Vec<([&ColumnSample; 3], Vec<String>)> {
    let mut out = vec![];
    for x in &topic.columns {
        let words = x.words();
        for letters in [["x", "y", "z"], ["0", "1", "2"]] {
            let Some(at) = words.iter().rposition(|w| w == letters[0]) else { continue };
            let with = |letter: &str| {
                let mut other = words.clone();
                other.get_mut(at).into_iter().for_each(|w| letter.clone_into(w));
                topic.columns.iter().find(|c| c.words() == other && !c.values.is_empty())
            };
            if let (Some(y), Some(z)) = (with(letters[1]), with(letters[2])) {
                let mut shared = words.clone();
                shared.remove(at);
                // A list of four entries is a quaternion.
                if letters[0] != "0" || with("3").is_none() {
                    out.push(([x, y, z], shared));
                }
            }
        }
    }
    out
}

/// Quaternions: four columns `q[0]` to `q[3]`, or `q0` to `q3`, of length 1.
pub fn quaternions(topic: &TopicSample) -> Vec<[&str; 4]> {
    let of = |k: &str| {
        let found = topic.columns.iter().find(|c| c.words() == ["q".to_owned(), k.to_owned()]);
        found.or_else(|| topic.columns.iter().find(|c| c.words() == [format!("q{k}")]))
    };
    let (Some(a), Some(b), Some(c), Some(d)) = (of("0"), of("1"), of("2"), of("3")) else { return vec![] };
    let rows = a.values.iter().zip(&b.values).zip(&c.values).zip(&d.values);
    let unit = rows.clone().all(|(((a, b), c), d)| (a * a + b * b + c * c + d * d - 1.0).abs() < 0.01);
    if unit && rows.len() > 0 { vec![[&a.name, &b.name, &c.name, &d.name]] } else { vec![] }
}

fn has(words: &[String], any: &[&str]) -> bool {
    words.iter().any(|w| any.contains(&w.as_str()))
}

/// Units of the earth's field, with their values in nT.
const FIELD: [(&str, f64); 5] = [("nT", 1.0), ("mgauss", 1e2), ("uT", 1e3), ("gauss", 1e5), ("T", 1e9)];

fn magnitude(axes: &[&ColumnSample; 3]) -> Option<f64> {
    let [x, y, z] = axes;
    let rows = x.values.iter().zip(&y.values).zip(&z.values);
    let values = rows.map(|((x, y), z)| (x * x + y * y + z * z).sqrt()).collect();
    ColumnSample { name: String::new(), unit: String::new(), text: None, values, whole: false }.median()
}

/// Unit given by the file or the name of a column, if it converts to `wanted`.
fn declared_unit(column: &ColumnSample, wanted: &str) -> Option<String> {
    if is_unit(&column.unit) && convert(&column.unit, wanted).is_some() {
        return Some(column.unit.clone());
    }
    if let Some(unit) = unit_of_name(&column.name).filter(|unit| convert(unit, wanted).is_some()) {
        return Some(unit);
    }
    let words = column.words();
    // `rad_s` and `m_s2` are two words; a letter of an axis may follow them.
    let ends = |n: usize| {
        words
            .iter()
            .rev()
            .filter(|w| !["x", "y", "z", "0", "1", "2"].contains(&w.as_str()))
            .take(n)
            .cloned()
            .collect::<Vec<_>>()
    };
    let two = ends(2);
    let pairs = [("s", "rad", "rad/s"), ("s", "m", "m/s"), ("s2", "m", "m/s2"), ("s", "deg", "deg/s")];
    if let [last, before] = two.as_slice()
        && let Some((.., unit)) = pairs.iter().find(|(l, b, _)| l == last && b == before)
        && convert(unit, wanted).is_some()
    {
        return Some((*unit).to_owned());
    }
    // The name of the unit m/s2 is split at its digit.
    if column.name.contains("m_s2") && convert("m/s2", wanted).is_some() {
        return Some("m/s2".to_owned());
    }
    let last = two.first()?;
    let usual = ["nt", "ut", "mgauss", "gauss", "ga", "deg", "rad", "m", "ft", "mps", "a", "v", "mm", "cm"];
    let unit = if last == "ga" { "gauss" } else { usual_spelling(last).unwrap_or(last) };
    (words.len() > 1 && usual.contains(&last.as_str()) && convert(unit, wanted).is_some()).then(|| unit.to_owned())
}

/// Whether the values of a column are within the limits of `ours` in a unit.
fn can_be(column: &ColumnSample, ours: &str, unit: &str) -> bool {
    let factor = convert(unit, flight::describe(ours).unit).unwrap_or(1.0);
    let Some((limits, (low, high))) = limits(ours).zip(column.range()) else { return true };
    limits.holds(low * factor) && limits.holds(high * factor)
}

/// Magnitudes of an analogue fluxgate in the earth's field, in V.
const VOLTS: (f64, f64) = (0.15, 12.0);
/// Usual sensitivities of analogue fluxgates: 10 V at 70, 100, 250, 500 and 1000 uT, in nT per V.
const SENSITIVITIES: [f64; 5] = [7_000.0, 10_000.0, 25_000.0, 50_000.0, 100_000.0];

/// Sensitivity in nT per V of a fluxgate with the median magnitude `size`, from the reading of a scalar magnetometer,
/// and the reason; or the reason why it is unknown.
fn volts(topic: &TopicSample, first: &ColumnSample, size: f64) -> Result<(f64, String), String> {
    let unit = declared_unit(first, "V").unwrap_or_else(|| "V".to_owned());
    let volt = convert(&unit, "V").unwrap_or(1.0);
    let whose = if declared_unit(first, "V").is_some() { "by the names" } else { "by their size" };
    let field = topic.columns.iter().filter_map(|column| {
        let guess = scalar(column, topic).filter(|guess| guess.is_used() && flight::is_scalar_reading(&guess.ours))?;
        let unit = declared_unit(column, "nT").unwrap_or_else(|| "nT".to_owned());
        Some((guess.theirs.first()?.clone(), column.median()? * convert(&unit, "nT")?))
    });
    let field: Vec<(String, f64)> = field.collect();
    let fits = |nt: &&f64| (15_000.0..100_000.0).contains(&(*nt * size * volt));
    let Some((name, total_nt)) = field.first() else {
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
            "volts {whose}; {scale} nT per {unit} is {kind}: the median magnitude of {size:.4} {unit} is then {:.0} \
             nT, and `{}` has {total_nt:.0} nT",
            scale * size,
            one_line(name)
        ),
    ))
}

fn vector(
    topic: &TopicSample,
    axes: &[&ColumnSample; 3],
    words: &[String],
    letters: &mut impl Iterator<Item = char>,
) -> Option<ColumnGuess> {
    let names: Vec<String> = axes.iter().map(|c| quoted(&c.name)).collect();
    let theirs: Vec<String> = axes.iter().map(|c| c.name.clone()).collect();
    let from = format!("from = [{}]", names.join(", "));
    let size = magnitude(axes)?;
    let left = |why: String| {
        let shown = theirs.join(", ");
        Some(ColumnGuess {
            ours: shown,
            theirs: theirs.clone(),
            toml: String::new(),
            why: format!("omitted: {why}"),
            is_vector: true,
        })
    };
    let made = |ours: String, unit: &str, rest: &str, why: String| {
        let toml = format!("{{ {from}, unit = \"{unit}\"{rest} }}");
        Some(ColumnGuess { ours, theirs: theirs.clone(), toml, why: format!("guess: {why}"), is_vector: true })
    };
    let first = axes[0];
    if has(words, &["ofs", "offset", "offsets", "mofs", "bias", "var", "innov", "variance", "mo"]) {
        return None;
    }
    if has(words, &["mag", "magnetometer", "compass", "flux", "fluxgate", "field"]) {
        let fits = |unit: &&(&str, f64)| (15_000.0..100_000.0).contains(&(size * unit.1));
        let (unit, why) = match declared_unit(first, "nT") {
            Some(unit) => (unit, "its unit is in the file".to_owned()),
            None => match FIELD.iter().find(fits) {
                Some((unit, factor)) => (
                    (*unit).to_owned(),
                    format!("in this unit, the median magnitude of {size:.4} is {:.0} nT", size * factor),
                ),
                None if declared_unit(first, "V").is_some() || (VOLTS.0..VOLTS.1).contains(&size) => {
                    return match volts(topic, first, size) {
                        Ok((scale, why)) => {
                            let rest = format!(", scale = {scale:?}, axes = \"+x +y +z\"");
                            let ours = format!("flux_{}", letters.next()?);
                            made(ours, "nT", &rest, format!("{why}; check `scale`, `axes` and `rotation_deg`"))
                        }
                        Err(why) => left(why),
                    };
                }
                None => {
                    return left(format!(
                        "a median magnitude of {size:.4} is not the earth's field in any unit; set its `unit`"
                    ));
                }
            },
        };
        let letter = letters.next()?;
        let offsets = topic
            .columns
            .iter()
            .any(|c| c.words().iter().any(|w| ["ofs", "offset", "bias"].contains(&w.as_str())) && c.largest() > 0.0);
        let doubt = if offsets {
            "; check `axes` and `rotation_deg`, and whether the values include the logged offsets, which `sql` can \
             subtract"
        } else {
            "; check `axes` and `rotation_deg`"
        };
        return made(format!("flux_{letter}"), &unit, ", axes = \"+x +y +z\"", format!("{why}{doubt}"));
    }
    let about = |text: &str| format!(", role = \"sensor\", description = \"{text}, axes of the sensor\"");
    if has(words, &["acc", "accel", "accelerometer", "acceleration"]) {
        let unit = declared_unit(first, "m/s2").or_else(|| {
            let near = |g: f64| (size / g - 1.0).abs() < 0.15;
            [("m/s2", 9.81), ("g0", 1.0)].into_iter().find(|(_, g)| near(*g)).map(|(u, _)| u.to_owned())
        });
        return match unit {
            Some(unit) => made(
                "accel".to_owned(),
                &unit,
                &about("specific force"),
                format!("a median magnitude of {size:.3} {unit}"),
            ),
            None => left(format!("a median magnitude of {size:.3} is not gravity in any unit; set its `unit`")),
        };
    }
    if has(words, &["gyr", "gyro", "gyroscope"]) {
        return match declared_unit(first, "deg/s") {
            Some(unit) => made("gyro".to_owned(), &unit, &about("angular rate"), "its unit is in the file".to_owned()),
            None => left(
                "an angular rate in rad/s or deg/s; the values do not determine the unit; set its `unit`".to_owned(),
            ),
        };
    }
    None
}

fn scalar(column: &ColumnSample, topic: &TopicSample) -> Option<ColumnGuess> {
    let words = column.words();
    let joined = words.concat();
    let own = name_of_head(&column.name);
    let known = flight::describe(own);
    let topic_words: Vec<String> =
        topic.name.to_lowercase().split(|c: char| !c.is_alphanumeric()).map(str::to_owned).collect();
    let is_ins = has(&words, &["ins", "nav", "ekf", "est"]) || has(&topic_words, &["ins", "ekf"]);
    let from = quoted(&column.name);
    let made = |ours: &str, unit: &str, why: &str| {
        let toml = format!("{{ from = {from}, unit = \"{unit}\" }}");
        let theirs = vec![column.name.clone()];
        Some(ColumnGuess { ours: ours.to_owned(), theirs, toml, why: format!("guess: {why}"), is_vector: false })
    };
    let left = |why: &str| Some(ColumnGuess::left_out(&column.name, why));
    if ["year", "doy"].contains(&column.name.as_str()) {
        let theirs = vec![column.name.clone()];
        let dated = topic.clock.as_ref().is_some_and(|c| !c.toml.contains("\"day\""));
        if dated {
            return left("the date follows from the time");
        }
        let toml = format!("{{ from = {from} }}");
        return Some(ColumnGuess {
            ours: column.name.clone(),
            theirs,
            toml,
            why: "a column name of the flight table".to_owned(),
            is_vector: false,
        });
    }
    // The column already has a name of the flight table, and a unit of its dimension.
    let listed = flight::COLUMNS.iter().any(|(name, _)| *name == own);
    if (listed || flight::is_scalar_reading(own) || flight::vector_part(own).is_some())
        && let Some(unit) = declared_unit(column, known.unit).filter(|unit| can_be(column, own, unit))
    {
        return made(own, &unit, "a column name of the flight table; its unit is in the file");
    }
    let (low, high) = column.range()?;
    let largest = column.largest();
    if has(&words, &["lat", "latitude"]) || has(&words, &["lon", "lng", "long", "longitude"]) {
        let is_lat = has(&words, &["lat", "latitude"]);
        let ours = match (is_ins, is_lat) {
            (true, true) => "ins_lat",
            (true, false) => "ins_lon",
            (false, true) => "lat",
            (false, false) => "lon",
        };
        let ends = if is_lat { (FRAC_PI_2, 90.0, 9e8) } else { (PI, 360.0, 3.6e9) };
        if low == high && low == 0.0 {
            return left("all values are 0");
        }
        return match declared_unit(column, "deg").filter(|unit| can_be(column, ours, unit)) {
            Some(unit) => made(ours, &unit, "its unit is in the file"),
            None if largest <= ends.0 => made(
                ours,
                "rad",
                &format!("values up to {largest:.4} are radians, unless the flight is near 0 degrees"),
            ),
            None if largest <= ends.1 => made(ours, "deg", &format!("values up to {largest:.2} are degrees")),
            None if column.whole && largest <= ends.2 => {
                made(ours, "degE7", &format!("whole numbers up to {largest:.0} are 1e-7 degrees"))
            }
            None => left("its values are not an angle in a common unit"),
        };
    }
    let angle = ["roll", "pitch", "yaw"]
        .into_iter()
        .find(|a| joined == *a || (words.len() > 1 && has(&words, &[a]) && declared_unit(column, "deg").is_some()));
    if let Some(angle) = angle {
        let ours = format!("ins_{angle}");
        return match declared_unit(column, "deg") {
            Some(unit) => made(&ours, &unit, "its unit is in the file; an estimate of the autopilot, not truth"),
            None if largest > 6.4 => made(
                &ours,
                "deg",
                &format!("values up to {largest:.1} are degrees; an estimate of the autopilot, not truth"),
            ),
            None => left(&format!("an angle of at most {largest:.2}, in degrees or radians; set its `unit`")),
        };
    }
    if has(&words, &["baro"]) && has(&words, &["alt", "altitude", "height"]) {
        return match declared_unit(column, "m") {
            Some(unit) => made("baro", &unit, "its unit is in the file"),
            None => left("a barometric height in m or ft; set its `unit`"),
        };
    }
    if has(&words, &["alt", "altitude", "height"]) && !has(&words, &["rel", "max", "min", "des", "sp", "var"]) {
        let unit = declared_unit(column, "m");
        if is_ins {
            return match unit {
                Some(unit) => made("ins_alt", &unit, "its unit is in the file; a height of the INS, not truth"),
                None => left("a height of the INS in m or ft; set its `unit`"),
            };
        }
        return match (has(&words, &["ellipsoid", "hae", "wgs"]), has(&words, &["msl", "amsl"]), unit) {
            (true, _, Some(unit)) => made("alt", &unit, "its unit is in the file"),
            (_, true, Some(unit)) => made("msl", &unit, "its unit is in the file"),
            _ => left("a height: name it `alt` if above the ellipsoid, `msl` if above sea level; set its `unit`"),
        };
    }
    let is_field = has(&words, &["mag", "magnetometer", "tmi", "totalfield"])
        || (has(&words, &["total"]) && has(&words, &["field"]));
    let is_part =
        has(&words, &["x", "y", "z", "lag", "res", "anomaly", "signal", "quality", "status", "valid", "lock"]);
    // A whole number may be a count, unless its unit is given.
    if is_field && !is_part && (!column.whole || declared_unit(column, "nT").is_some()) {
        let median = column.median()?;
        let unit = declared_unit(column, "nT")
            .filter(|u| convert(u, "nT").is_some_and(|f| (15_000.0..80_000.0).contains(&(median * f))));
        let unit = unit.or_else(|| (15_000.0..80_000.0).contains(&median).then(|| "nT".to_owned()));
        if let Some(unit) = unit {
            let number = words.iter().find(|w| w.len() < 4 && w.bytes().all(|b| b.is_ascii_digit()));
            let ours = format!("mag_{}_uc", number.map_or("1", String::as_str));
            let ours = if known.unit == "nT" { own } else { &ours };
            return made(ours, &unit, &format!("a median of {median:.1} {unit} is the earth's field"));
        }
    }
    if has(&words, &["curr", "current"]) && !has(&words, &["tot", "total", "average", "filtered"]) {
        let ours = format!("cur_{}", own_word(&words));
        return match declared_unit(column, "A") {
            Some(unit) => made(&ours, &unit, "its unit is in the file"),
            None => {
                left("a current in A, mA or 0.01 A; the values do not determine the unit; set its `unit` (and `scale`)")
            }
        };
    }
    if has(&words, &["volt", "voltage"]) && !has(&words, &["filtered", "cell"]) {
        let ours = format!("vol_{}", own_word(&words));
        return match declared_unit(column, "V") {
            Some(unit) => made(&ours, &unit, "its unit is in the file"),
            None => {
                left("a voltage in V, mV or 0.01 V; the values do not determine the unit; set its `unit` (and `scale`)")
            }
        };
    }
    let wind = has(&words, &["wind", "sp", "des", "var", "innov"]);
    if has(&words, &["vel", "velocity", "vn", "ve", "vd"]) && !wind {
        let axis = [("n", ["north", "n", "vn"]), ("e", ["east", "e", "ve"]), ("d", ["down", "d", "vd"])];
        let axis = axis.iter().find(|(_, names)| has(&words, names)).map(|(axis, _)| *axis);
        if let (Some(axis), Some(unit)) = (axis, declared_unit(column, "m/s")) {
            let ours = if is_ins { format!("ins_v{axis}") } else { format!("v{axis}") };
            return made(&ours, &unit, "its unit is in the file");
        }
    }
    if listed && !known.unit.is_empty() {
        return left(&format!("a column name of the flight table, where its unit is {}; set its `unit`", known.unit));
    }
    None
}

/// The word of a name that distinguishes a current or voltage.
fn own_word(words: &[String]) -> String {
    const COMMON: [&str; 10] = ["curr", "current", "volt", "voltage", "a", "v", "filtered", "sensor", "uc", "raw"];
    words.iter().find(|w| !COMMON.contains(&w.as_str())).cloned().unwrap_or_else(|| "battery".to_owned())
}
