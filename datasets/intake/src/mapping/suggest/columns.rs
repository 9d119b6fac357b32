//! Recognises columns by their names, units and values.

use std::f64::consts::{FRAC_PI_2, PI};

use datasets::formats::{name_of_head, unit_of_name};
use schemas::{convert, flight, is_unit, plausible::limits, usual_spelling};

use super::{TopicSample, field, quoted, sample::ColumnSample};

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
    /// Whether the suggestion is for a vector.
    pub is_vector: bool,
}

impl ColumnGuess {
    /// Whether the column is part of the mapping.
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

/// Words for latitude, longitude and height, also in German, French and Spanish.
const LATITUDE: [&str; 4] = ["lat", "latitude", "breite", "latitud"];
const LONGITUDE: [&str; 7] = ["lon", "lng", "long", "longitude", "länge", "laenge", "longitud"];
const HEIGHT: [&str; 7] = ["alt", "altitude", "height", "höhe", "hoehe", "hauteur", "altura"];

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

/// A scalar magnetometer under an unused number: a second sensor is `mag_2_uc`, its compensated reading `mag_2_c`.
fn numbered(mut guess: ColumnGuess, taken: &[ColumnGuess]) -> ColumnGuess {
    let is_taken = |name: &str| taken.iter().any(|g| g.is_used() && g.ours == name);
    let suffix = if flight::is_scalar_reading(&guess.ours) {
        "uc"
    } else if flight::is_compensated(&guess.ours) {
        "c"
    } else {
        return guess;
    };
    if guess.is_used() && is_taken(&guess.ours) {
        let free = (1..).map(|n| format!("mag_{n}_{suffix}")).find(|name| !is_taken(name));
        guess.ours = free.unwrap_or(guess.ours);
    }
    guess
}

/// Three columns whose names differ only in x, y, z or 0, 1, 2, with the words that these names have in common.
fn triples(topic: &TopicSample) -> Vec<([&ColumnSample; 3], Vec<String>)> {
    let mut out: Vec<([&ColumnSample; 3], Vec<String>)> = vec![];
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
    let letters = topic.columns.iter().filter_map(|x| by_letter(topic, x));
    for (axes, words) in letters.collect::<Vec<_>>() {
        if !out.iter().any(|(others, _)| others.iter().any(|other| axes.iter().any(|c| c.name == other.name))) {
            out.push((axes, words));
        }
    }
    out
}

/// Three columns whose names differ only in a letter x, y, z within a word, such as `Bx`, `By`, `Bz`.
fn by_letter<'a>(topic: &'a TopicSample, x: &'a ColumnSample) -> Option<([&'a ColumnSample; 3], Vec<String>)> {
    let name: Vec<char> = x.name.to_lowercase().chars().collect();
    let places = name.iter().enumerate().filter(|(_, letter)| **letter == 'x').map(|(at, _)| at).rev();
    let with = |at: usize, letter: char| {
        let other: String = name.iter().enumerate().map(|(i, own)| if i == at { letter } else { *own }).collect();
        topic.columns.iter().find(|c| c.name.to_lowercase() == other && !c.values.is_empty())
    };
    let [y, z] = places.clone().find_map(|at| Some([with(at, 'y')?, with(at, 'z')?]))?;
    let words = x.words().into_iter().map(|word| match word.strip_suffix('x').or_else(|| word.strip_prefix('x')) {
        Some(rest) => rest.to_owned(),
        None => word,
    });
    Some(([x, y, z], words.filter(|word| !word.is_empty()).collect()))
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

pub(super) fn has(words: &[String], any: &[&str]) -> bool {
    words.iter().any(|w| any.contains(&w.as_str()))
}

/// Unit given by the file or the name of a column, if it converts to `wanted`.
pub(super) fn declared_unit(column: &ColumnSample, wanted: &str) -> Option<String> {
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

fn vector(
    topic: &TopicSample,
    axes: &[&ColumnSample; 3],
    words: &[String],
    letters: &mut impl Iterator<Item = char>,
) -> Option<ColumnGuess> {
    let names: Vec<String> = axes.iter().map(|c| quoted(&c.name)).collect();
    let theirs: Vec<String> = axes.iter().map(|c| c.name.clone()).collect();
    let from = format!("from = [{}]", names.join(", "));
    let size = field::magnitude(axes)?;
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
    let named = field::is_named(words);
    let like = if named { None } else { field::field_like(topic, axes, words, size) };
    if named || like.is_some() {
        let fits = |unit: &&(&str, f64)| field::EARTH.contains(&(size * unit.1));
        let declared = declared_unit(first, "nT");
        let wrong =
            declared.as_ref().filter(|unit| !convert(unit, "nT").is_some_and(|nt| field::EARTH.contains(&(size * nt))));
        let (unit, why) = match (declared.clone(), like) {
            _ if wrong.is_some() => {
                let nt = field::FIELD.iter().find(fits).map_or(String::new(), |(unit, factor)| {
                    format!("; in {unit}, the magnitude would be {:.0} nT", size * factor)
                });
                let unit = declared.unwrap_or_default();
                return left(format!(
                    "a median magnitude of {size:.4} {unit} (the unit in the file) does not match the earth's \
                     field{nt}; set its `unit`"
                ));
            }
            (Some(unit), _) => (unit, "the file gives the unit".to_owned()),
            (None, Some((unit, why))) => (unit, why),
            (None, None) => match field::FIELD.iter().find(fits) {
                Some((unit, factor)) => (
                    (*unit).to_owned(),
                    format!("in this unit, the median magnitude of {size:.4} is {:.0} nT", size * factor),
                ),
                None if declared_unit(first, "V").is_some() || field::VOLTS.contains(&size) => {
                    return match field::volts(topic, first, size) {
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
                        "a median magnitude of {size:.4} does not match the earth's field in any unit; set its `unit`"
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
            None => left(format!("a median magnitude of {size:.3} does not match gravity in any unit; set its `unit`")),
        };
    }
    if has(words, &["gyr", "gyro", "gyroscope"]) {
        return match declared_unit(first, "deg/s") {
            Some(unit) => made("gyro".to_owned(), &unit, &about("angular rate"), "the file gives the unit".to_owned()),
            None => left(
                "an angular rate in rad/s or deg/s; the values do not determine the unit; set its `unit`".to_owned(),
            ),
        };
    }
    None
}

/// The attitude angle that a column holds; `None` for other columns.
fn attitude(column: &ColumnSample) -> Option<&'static str> {
    const NAMES: [(&str, &[&str]); 3] = [("roll", &["roll", "bank"]), ("pitch", &["pitch"]), ("yaw", &["yaw"])];
    let words = column.words();
    let joined = words.concat();
    let is = |names: &[&str]| {
        names.contains(&joined.as_str())
            || (words.len() > 1 && has(&words, names) && declared_unit(column, "deg").is_some())
    };
    NAMES.iter().find(|(_, names)| is(names)).map(|(angle, _)| *angle)
}

/// Largest absolute value of the attitude angles in a table that have no declared unit.
fn largest_angle(topic: &TopicSample) -> f64 {
    let of = topic.columns.iter().filter(|c| attitude(c).is_some() && declared_unit(c, "deg").is_none());
    of.map(ColumnSample::largest).fold(0.0, f64::max)
}

pub(super) fn scalar(column: &ColumnSample, topic: &TopicSample) -> Option<ColumnGuess> {
    let words = column.words();
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
    // The column already has a name of the flight table, and a unit that converts to the unit of this name.
    let listed = flight::COLUMNS.iter().any(|(name, _)| *name == own);
    if (listed || flight::is_scalar_reading(own) || flight::vector_part(own).is_some())
        && let Some(unit) = declared_unit(column, known.unit).filter(|unit| can_be(column, own, unit))
    {
        return made(own, &unit, "a column name of the flight table; the file gives the unit");
    }
    let (low, high) = column.range()?;
    let largest = column.largest();
    if has(&words, &LATITUDE) || has(&words, &LONGITUDE) {
        let is_lat = has(&words, &LATITUDE);
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
            Some(unit) => made(ours, &unit, "the file gives the unit"),
            None if largest <= ends.0 => made(
                ours,
                "rad",
                &format!("values up to {largest:.4} are radians, unless the flight is near 0 degrees"),
            ),
            None if largest <= ends.1 => made(ours, "deg", &format!("values up to {largest:.2} are degrees")),
            None if column.whole && largest <= ends.2 => {
                made(ours, "degE7", &format!("whole numbers up to {largest:.0} are in units of 1e-7 degrees"))
            }
            None => left("its values are not an angle in a common unit"),
        };
    }
    let angle = attitude(column);
    if let Some(angle) = angle {
        let ours = format!("ins_{angle}");
        return match declared_unit(column, "deg") {
            Some(unit) => made(&ours, &unit, "the file gives the unit; an estimate of the autopilot, not truth"),
            // The three angles of a log have one unit.
            None if largest_angle(topic) > 6.4 => made(
                &ours,
                "deg",
                &format!(
                    "angles up to {:.1} are degrees; an estimate of the autopilot, not truth",
                    largest_angle(topic)
                ),
            ),
            None => left(&format!("an angle of at most {largest:.2}, in degrees or radians; set its `unit`")),
        };
    }
    if has(&words, &["heading", "hdg"]) {
        return left("a heading; name it `ins_yaw` if it is relative to true north, and set its `unit`");
    }
    if has(&words, &["baro"]) && has(&words, &["alt", "altitude", "height"]) {
        return match declared_unit(column, "m") {
            Some(unit) => made("baro", &unit, "the file gives the unit"),
            None => left("a barometric height in m or ft; set its `unit`"),
        };
    }
    if has(&words, &HEIGHT) && !has(&words, &["rel", "max", "min", "des", "sp", "var"]) {
        let unit = declared_unit(column, "m");
        if is_ins {
            return match unit {
                Some(unit) => made("ins_alt", &unit, "the file gives the unit; a height of the INS, not truth"),
                None => left("a height of the INS in m or ft; set its `unit`"),
            };
        }
        return match (has(&words, &["ellipsoid", "hae", "wgs"]), has(&words, &["msl", "amsl"]), unit) {
            (true, _, Some(unit)) => made("alt", &unit, "the file gives the unit"),
            (_, true, Some(unit)) => made("msl", &unit, "the file gives the unit"),
            _ => left("a height; name it `alt` if above the ellipsoid, `msl` if above sea level, and set its `unit`"),
        };
    }
    if let Some(reading) = field::reading(column) {
        let (ours, unit, why) = match reading {
            Ok(reading) => reading,
            Err(why) => return left(&why),
        };
        return made(if known.unit == "nT" { own } else { &ours }, &unit, &why);
    }
    if has(&words, &["curr", "current"]) && !has(&words, &["tot", "total", "average", "filtered"]) {
        let ours = format!("cur_{}", own_word(&words));
        return match declared_unit(column, "A") {
            Some(unit) => made(&ours, &unit, "the file gives the unit"),
            None => {
                left("a current in A, mA or 0.01 A; the values do not determine the unit; set its `unit` (and `scale`)")
            }
        };
    }
    if has(&words, &["volt", "voltage"]) && !has(&words, &["filtered", "cell"]) {
        let ours = format!("vol_{}", own_word(&words));
        return match declared_unit(column, "V") {
            Some(unit) => made(&ours, &unit, "the file gives the unit"),
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
            return made(&ours, &unit, "the file gives the unit");
        }
    }
    if listed && !known.unit.is_empty() {
        return left(&format!("the flight table has a column of this name, in {}; set the values' `unit`", known.unit));
    }
    None
}

/// The word in a name that identifies the current or voltage; `battery` if there is no such word.
fn own_word(words: &[String]) -> String {
    const COMMON: [&str; 10] = ["curr", "current", "volt", "voltage", "a", "v", "filtered", "sensor", "uc", "raw"];
    words.iter().find(|w| !COMMON.contains(&w.as_str())).cloned().unwrap_or_else(|| "battery".to_owned())
}
