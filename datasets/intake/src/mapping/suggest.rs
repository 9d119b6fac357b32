//! A mapping suggested from the names, units and values of a log, with the reason for each guess. Unknown parts are
//! omitted and reported.

mod clocks;
mod columns;
mod field;
mod position;
mod repeats;
mod sample;
mod text_clock;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use datasets::{
    FlightOptions, ReadError, ReadHints,
    formats::{FlightFormat, LogTopic},
    open_raw_among, topics_among,
};
use schemas::one_line;

use clocks::{ClockGuess, clock_of, epoch_of};
use columns::{ColumnGuess, guesses};
pub use position::KnownSystem;
use position::ProjectedColumns;
use repeats::RepeatedTimes;
use sample::ColumnSample;

/// Topic with a sample of its rows.
pub(super) struct TopicSample {
    /// Name; empty for a file of one table.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Columns.
    pub columns: Vec<ColumnSample>,
    /// The clock of the topic, if recognised.
    pub clock: Option<ClockGuess>,
}

/// Suggested table of a mapping.
struct SuggestedTable<'a> {
    topic: &'a TopicSample,
    clock: &'a ClockGuess,
    found: Vec<ColumnGuess>,
    /// Eastings and northings, if the table has no latitude.
    positions: Option<ProjectedColumns>,
}

/// A suggested mapping.
pub struct MappingSuggestion {
    /// Text.
    pub text: String,
    /// Columns that the mapping does not use, with the reason if it is known.
    pub unused: Vec<String>,
    /// Questions about parts whose meaning is ambiguous.
    pub questions: Vec<String>,
}

/// Maximum number of reasons in the fault for a log without recognised columns.
const SHOWN: usize = 8;

/// A mapping of several logs: the mapping of the first log, with a comment on logs that have other columns.
///
/// # Errors
/// Returns the errors of [`suggest`]. Also fails without any log.
pub fn suggest_for(
    paths: &[PathBuf],
    options: &FlightOptions,
    formats: &[FlightFormat],
    system: &KnownSystem,
) -> Result<MappingSuggestion, ReadError> {
    let Some((first, others)) = paths.split_first() else {
        return Err(ReadError::options(Path::new("."), "there is no log"));
    };
    let found = suggest(first, options, formats, system)?;
    if others.is_empty() {
        return Ok(found);
    }
    let columns = |path: &Path| -> Result<BTreeSet<String>, ReadError> {
        let topics = topics_among(formats, path, options)?;
        let of = |topic: &LogTopic| -> Vec<String> {
            let prefix = if topic.name.is_empty() { String::new() } else { format!("{}.", topic.name) };
            topic.columns.iter().map(|c| format!("{prefix}{}", c.name)).collect()
        };
        Ok(topics.iter().filter(|topic| topic.note.is_empty()).flat_map(of).collect())
    };
    let own = columns(first)?;
    let (mut same, mut text) = (0, String::new());
    for path in others {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let line = match columns(path) {
            Ok(other) if other == own => {
                same += 1;
                continue;
            }
            Ok(other) => {
                let list = |names: Vec<&String>| match names.len() {
                    0 => "nothing".to_owned(),
                    n if n > 5 => format!("{} columns", names.len()),
                    _ => names.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(", "),
                };
                let (less, more) = (own.difference(&other).collect(), other.difference(&own).collect());
                format!("{name} lacks {}, and also has {}", list(less), list(more))
            }
            Err(e) => format!("{name} cannot be read: {e}"),
        };
        text += &wrapped(&one_line(&line));
    }
    let counted = format!("# The same columns: {same} of {} other logs.\n", others.len());
    Ok(MappingSuggestion { text: format!("{counted}{text}{}", found.text), ..found })
}

/// A mapping of a log. Eastings and northings have the coordinate system `system`.
///
/// # Errors
/// Fails for a log that cannot be read, or for a log without any recognised column.
pub fn suggest(
    path: &Path,
    options: &FlightOptions,
    formats: &[FlightFormat],
    system: &KnownSystem,
) -> Result<MappingSuggestion, ReadError> {
    let listed = topics_among(formats, path, options)?;
    let mut format = "";
    let mut topics = vec![];
    for topic in listed.into_iter().filter(|topic| topic.note.is_empty()) {
        let options = FlightOptions { topic: Some(topic.name.clone()).filter(|n| !n.is_empty()), ..options.clone() };
        let mut reader = open_raw_among(formats, path, &options, &ReadHints::default())?;
        format = reader.format();
        let columns = sample::samples(&mut reader)?;
        let clock = clock_of(&columns);
        topics.push(TopicSample { name: topic.name, rows: topic.rows, columns, clock });
    }
    let mut tables = vec![];
    let mut rest = vec![];
    let mut letters = (b'a'..=b'z').map(char::from);
    for topic in &topics {
        let found = guesses(topic, &mut letters);
        let located = found.iter().any(|guess| guess.is_used() && guess.ours == "lat");
        let positions = if located { None } else { ProjectedColumns::find(topic, system) };
        let useful = found.iter().any(ColumnGuess::is_used) || positions.is_some();
        match &topic.clock {
            Some(clock) if useful => tables.push(SuggestedTable { topic, clock, found, positions }),
            Some(_) if found.is_empty() => {
                rest.push(format!("{} ({} rows): no recognised column", shown(&topic.name), topic.rows));
            }
            Some(_) => {
                rest.push(format!("{} ({} rows): only omitted columns", shown(&topic.name), topic.rows));
                rest.extend(found.iter().map(|g| format!("  {}: {}", one_line(&g.ours), g.why)));
            }
            None if useful => rest.push(format!(
                "{} ({} rows): recognised columns, but no increasing time",
                shown(&topic.name),
                topic.rows
            )),
            None => rest.push(format!("{} ({} rows): no increasing time", shown(&topic.name), topic.rows)),
        }
    }
    if tables.is_empty() {
        let what = "cannot suggest a mapping: no table has both an increasing time and a recognised column";
        let mut help = "write a mapping as described in datasets/mappings/README.md".to_owned();
        rest.iter().take(SHOWN).for_each(|line| help += &format!("; {}", line.trim()));
        return Err(ReadError::options(path, what).help(help));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut text = format!(
        "# Suggested from {} by its names, units and first rows. Check every line with a `guess`: a log does not \
         contain\n\
         # the axes, signs and mounting of sensors.\n\n\
         about  = {}\nformat = {}\n",
        one_line(&name),
        quoted(&format!("logs like {name}")),
        quoted(format)
    );
    text += &keys(&tables);
    if tables.iter().any(|table| table.clock.is_boot()) {
        text += &epoch_of(&topics);
    }
    let single = tables.len() == 1;
    let (mut taken, mut unused): (Vec<String>, Vec<String>) = (vec![], vec![]);
    let mut questions: Vec<String> = tables.iter().filter_map(|table| table.clock.question.clone()).collect();
    questions.dedup();
    questions.extend(tables.iter().filter_map(|table| table.positions.as_ref()?.open_question()));
    for table in &tables {
        let topic = &table.topic.name;
        let name = table_name(if single && topic.is_empty() { "log" } else { topic }, &taken);
        text += &table.text(&name, &mut unused);
        taken.push(name);
    }
    if !rest.is_empty() {
        text += "\n# Omitted:\n";
        rest.iter().for_each(|line| text += &format!("# - {line}\n"));
    }
    Ok(MappingSuggestion { text, unused, questions })
}

fn shown(name: &str) -> String {
    if name.is_empty() { "the table".to_owned() } else { format!("`{}`", one_line(name)) }
}

/// The keys `flight` and `line` of the mapping, from columns of these names, if all tables have them.
fn keys(tables: &[SuggestedTable]) -> String {
    let mut text = String::new();
    for (key, usual) in [
        ("flight", "{ of_file = true }   # guess: one flight per file, named after the file"),
        ("line", "\"1\"                  # guess: one line per file"),
    ] {
        let mut names = tables.iter().map(|table| key_column(table.topic, key));
        let first = names.next().flatten();
        text += &match first.filter(|first| names.all(|name| name == Some(*first))) {
            Some(name) => format!("{key:6} = {{ from = {} }}\n", quoted(name)),
            None => format!("{key:6} = {usual}\n"),
        };
    }
    text
}

/// The column for the key `key`: a column of this name in upper or lower case, or of a common name.
fn key_column<'a>(topic: &'a TopicSample, key: &str) -> Option<&'a str> {
    const COMMON: [(&str, [&str; 9]); 2] = [
        ("line", ["lineno", "linenumber", "lineid", "linename", "profile", "profil", "leg", "transect", "linie"]),
        ("flight", ["flightno", "flightnumber", "flightid", "flightname", "flt", "fltno", "sortie", "flug", "mission"]),
    ];
    let names = || topic.columns.iter().map(|column| column.name.as_str());
    let common = COMMON.iter().find(|(own, _)| *own == key).map_or(&[][..], |(_, names)| names);
    let is_common = |column: &&ColumnSample| common.contains(&column.words().concat().as_str());
    names()
        .find(|name| name.trim().eq_ignore_ascii_case(key))
        .or_else(|| topic.columns.iter().find(is_common).map(|column| column.name.as_str()))
}

impl SuggestedTable<'_> {
    /// Text of the table in the mapping. Columns that the table does not use are added to `unused`.
    fn text(&self, name: &str, unused: &mut Vec<String>) -> String {
        let Self { topic, clock, found, positions } = self;
        let mut text = format!("\n[tables.{name}]   # {} rows\n", topic.rows);
        if !topic.name.is_empty() {
            text += &format!("topic = {}\n", quoted(&topic.name));
        }
        text += &format!("time  = {}   # {}\n", clock.toml, clock.why);
        if let Some(question) = &clock.question {
            text += &wrapped(&format!("? {question}"));
        }
        match clock.repeats {
            RepeatedTimes::None => {}
            RepeatedTimes::Some => text += "drop_repeated = true   # some rows repeat the time of the previous row\n",
            RepeatedTimes::AtRate(rate_hz) => {
                text += &format!(
                    "repeated_rate_hz = {rate_hz:?}   # guess: the times have a coarse resolution, so rows repeat \
                     them; this is the rate of the rows\n"
                );
            }
        }
        text.extend(positions.iter().map(ProjectedColumns::text));
        for (section, vectors) in [("columns", false), ("vectors", true)] {
            let of: Vec<&ColumnGuess> = found.iter().filter(|g| g.is_used() && g.is_vector == vectors).collect();
            if of.is_empty() {
                continue;
            }
            text += &format!("[tables.{name}.{section}]\n");
            for guess in of {
                text += &format!("{} = {}   # {}\n", key(&guess.ours), guess.toml, guess.why);
            }
        }
        let left: Vec<&ColumnGuess> = found.iter().filter(|g| !g.is_used()).collect();
        for guess in left {
            let line = format!("{}: {}", one_line(&guess.ours), guess.why);
            text += &format!("# {line}\n");
            unused.push(line);
        }
        let quaternions: Vec<[&str; 4]> = columns::quaternions(topic);
        for q in &quaternions {
            let from = q.iter().map(|n| quoted(n)).collect::<Vec<_>>().join(", ");
            let list = format!("# quaternions = [{{ from = [{from}], order = \"wxyz\", frames = \"frd_to_ned\" }}]");
            text += &format!("{list}   # a quaternion; check its order and frames\n");
        }
        let named = |c: &&ColumnSample| {
            let quoted_name = quoted(&c.name);
            clock.toml.contains(&quoted_name)
                || schemas::flight::KEYS.iter().any(|key| key_column(topic, key) == Some(c.name.as_str()))
                || found.iter().any(|g| g.toml.contains(&quoted_name) || g.theirs.contains(&c.name))
                || positions.iter().any(|positions| positions.reads(&c.name))
        };
        let (unreadable, others): (Vec<&ColumnSample>, Vec<&ColumnSample>) =
            topic.columns.iter().filter(|c| !named(c)).partition(|c| c.is_unreadable());
        for (reason, columns) in [("no value is a number", unreadable), ("not recognised", others)] {
            let names: Vec<String> = columns.iter().map(|c| one_line(&c.name).into_owned()).collect();
            if !names.is_empty() {
                let line = format!("{reason}: {}", names.join(", "));
                text += &wrapped(&line);
                unused.push(line);
            }
        }
        text
    }
}

/// Comment, broken into lines of a readable length.
fn wrapped(words: &str) -> String {
    const WIDE: usize = 118;
    let (mut text, mut line) = (String::new(), "#".to_owned());
    for word in words.split(' ') {
        if line.chars().count() + word.chars().count() >= WIDE {
            text += &line;
            text.push('\n');
            line = "#  ".to_owned();
        }
        line.push(' ');
        line += word;
    }
    text + &line + "\n"
}

/// A string as a TOML string.
pub fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A name as a TOML key.
fn key(name: &str) -> String {
    let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if plain { name.to_owned() } else { quoted(name) }
}

/// An unused name for a table.
fn table_name(topic: &str, taken: &[String]) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c.to_ascii_lowercase() } else { '_' };
    let mut name: String = topic.chars().map(plain).collect::<String>().trim_matches('_').to_owned();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name = format!("t_{name}");
    }
    let mut out = name.clone();
    let mut n = 2;
    while taken.contains(&out) {
        out = format!("{name}_{n}");
        n += 1;
    }
    out
}
