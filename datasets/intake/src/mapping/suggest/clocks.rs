//! Recognises the time column, its origin, and the epoch of a log.

use datasets::formats::name_of_head;
use numerics::regression::statistics::median;
use schemas::convert;

use super::{TopicSample, quoted, repeats::RepeatedTimes, sample::ColumnSample, text_clock::text_clock};
use crate::clock_digits;

/// Suggested clock of a table.
pub struct ClockGuess {
    /// Text of the clock in the mapping.
    pub toml: String,
    /// Reason for the guess.
    pub why: String,
    /// The column.
    pub column: String,
    /// Unit.
    unit: &'static str,
    /// Whether the clock counts from the start of the log.
    boot: bool,
    /// Rows that repeat the time of the previous row.
    pub repeats: RepeatedTimes,
    /// Times of the rows, in seconds.
    times_s: Vec<f64>,
    /// Question about the time, if its meaning is ambiguous.
    pub question: Option<String>,
}

impl ClockGuess {
    /// Whether the clock counts from the start of the log.
    pub fn is_boot(&self) -> bool {
        self.boot
    }
}

/// Minimum number of time steps in a column that is recognised as the time without a common name.
const LEAST_STEPS: usize = 50;

/// Names of time columns, the most likely first.
const NAMES: [&[&str]; 6] = [
    &["timeus", "timestamp", "timems", "tt"],
    &["time"],
    &["t"],
    &["utc", "datetime", "date"],
    &["millis", "micros", "milliseconds", "microseconds", "msec", "usec", "seconds", "secs", "sec", "uptime"],
    &["gps", "tow", "sow", "sod", "elapsed", "clock", "zeit", "timestamp"],
];

/// The clock of a table: the first column with a common name and increasing values.
pub fn clock_of(columns: &[ColumnSample]) -> Option<ClockGuess> {
    let clock = recognised(columns)?;
    Some(ClockGuess { repeats: RepeatedTimes::new(&clock.times_s, columns), ..clock })
}

fn recognised(columns: &[ColumnSample]) -> Option<ClockGuess> {
    let joined = |c: &ColumnSample| c.words().concat();
    if let Some(clock) = of_gps_week(columns).or_else(|| date_and_time(columns)) {
        return Some(clock);
    }
    for names in NAMES {
        for column in columns {
            let words = column.words();
            let is_named = names.iter().any(|n| joined(column) == *n || words.iter().any(|w| w == n));
            if let Some(clock) = is_named.then(|| one(column)).flatten() {
                return Some(clock);
            }
        }
    }
    // Dates and times as text are recognised under any name.
    columns.iter().filter(|c| !c.texts.is_empty()).find_map(one).or_else(|| only_even(columns))
}

/// The only column of numbers that increases in even steps, under any name. Two such columns are ambiguous.
fn only_even(columns: &[ColumnSample]) -> Option<ClockGuess> {
    let is_even = |c: &&ColumnSample| {
        let known: Vec<f64> = c.known().collect();
        let mut steps: Vec<f64> = known.windows(2).map(|w| w[1] - w[0]).collect();
        if steps.len() < LEAST_STEPS || known.len() < c.values.len() || steps.iter().any(|step| *step <= 0.0) {
            return false;
        }
        let usual = median(&mut steps);
        let near = steps.iter().filter(|step| (**step / usual - 1.0).abs() < 0.2).count();
        // A row counter has steps of 1, from which no rate can be inferred.
        near * 10 >= steps.len() * 9 && usual != 1.0
    };
    let mut found = columns.iter().filter(is_even);
    let (column, None) = (found.next()?, found.next()) else { return None };
    let guess = one(column)?;
    let why = format!("{}; the only column that increases in even steps", guess.why);
    Some(ClockGuess { why, ..guess })
}

fn has_repeats(times_s: &[f64]) -> bool {
    times_s.windows(2).any(|pair| pair[1] == pair[0])
}

/// The column of the GPS week, from 1999 to 2037.
fn week_of(columns: &[ColumnSample]) -> Option<&ColumnSample> {
    columns.iter().find(|c| {
        let plain = c.words().concat();
        let named = c.words().iter().any(|w| w == "week") || ["gwk", "gpsweek"].contains(&plain.as_str());
        named && c.known().any(|x| (1024.0..3000.0).contains(&x))
    })
}

/// Seconds or milliseconds of a GPS week, with the column of the week. The log's own clock, if there is one, is
/// sampled more evenly, so it is preferred.
fn of_gps_week(columns: &[ColumnSample]) -> Option<ClockGuess> {
    let week = week_of(columns)?;
    let own = ["timeus", "timems", "timestamp", "t"];
    if columns.iter().any(|c| own.contains(&c.words().concat().as_str())) {
        return None;
    }
    let names = ["tow", "sow", "gpstime", "gpssec", "gpsseconds", "gpstimes", "secondsofweek", "weekseconds", "time"];
    let named = |c: &&ColumnSample| {
        let words = c.words();
        names.contains(&words.concat().as_str()) || words.iter().any(|w| w == "tow" || w == "sow")
    };
    let column = columns.iter().filter(|c| c.name != week.name).find(named)?;
    // A GNSS time that is held between fixes is not the time of the samples.
    let guess = one(column).filter(|guess| guess.boot && !has_repeats(&guess.times_s))?;
    let (_, last) = column.range()?;
    let seconds = convert(guess.unit, "s").unwrap_or(1.0);
    if last * seconds > 604_800.0 {
        return None;
    }
    let unit = guess.unit;
    Some(ClockGuess {
        toml: format!(
            "{{ from = {}, unit = \"{unit}\", clock = \"gps\", week = {} }}",
            quoted(&column.name),
            quoted(&week.name)
        ),
        why: "guess: GPS time of week; it is converted to UTC with the leap seconds of the date".to_owned(),
        boot: false,
        ..guess
    })
}

/// The date and the time of day as two columns of text.
fn date_and_time(columns: &[ColumnSample]) -> Option<ClockGuess> {
    let of = |names: [&str; 2]| {
        let named = |c: &&ColumnSample| c.words().iter().any(|w| names.contains(&w.as_str())) && !c.texts.is_empty();
        columns.iter().find(named)
    };
    let (date, time) = (of(["date", "datum"])?, of(["time", "zeit"])?);
    if date.name == time.name {
        return None;
    }
    let joined = |(date, time): (&String, &String)| format!("{date} {time}");
    let found = text_clock(date, &date.texts.iter().zip(&time.texts).map(joined).collect::<Vec<_>>())?;
    let format = found.format.map_or(String::new(), |format| format!(", format = {}", quoted(&format)));
    Some(ClockGuess {
        toml: format!("{{ from = [{}, {}], clock = \"text\"{format} }}", quoted(&date.name), quoted(&time.name)),
        why: "date and time as text, taken as UTC; if they are local times, add `zone = \"+02:00\"`".to_owned(),
        column: time.name.clone(),
        unit: "s",
        boot: false,
        repeats: RepeatedTimes::None,
        times_s: found.times_s,
        question: found.question,
    })
}

/// A column of times as text.
fn of_text(column: &ColumnSample) -> Option<ClockGuess> {
    let found = text_clock(column, &column.texts)?;
    let (name, example) = (quoted(&column.name), quoted(column.texts.first()?));
    let (format, why) = match &found.format {
        None => (
            String::new(),
            format!("ISO 8601 text, such as {example}; UTC unless the text has an offset; for local times, add `zone`"),
        ),
        Some(format) => {
            let what =
                if found.dated { "taken as UTC" } else { "time of day, taken as UTC; the date is unknown: add `date`" };
            (
                format!(", format = {}", quoted(format)),
                format!("guess: text such as {example}, {what}; for local times, add `zone`"),
            )
        }
    };
    Some(ClockGuess {
        toml: format!("{{ from = {name}, clock = \"text\"{format} }}"),
        why,
        column: column.name.clone(),
        unit: "s",
        boot: false,
        repeats: RepeatedTimes::None,
        times_s: found.times_s,
        question: found.question,
    })
}

fn one(column: &ColumnSample) -> Option<ClockGuess> {
    if !column.texts.is_empty() {
        return of_text(column);
    }
    let known: Vec<f64> = column.known().collect();
    let (first, last) = (known.first().copied()?, known.last().copied()?);
    if clock_digits::minute_after(&known).is_some() {
        return Some(ClockGuess {
            toml: format!("{{ from = {}, clock = \"text\", format = \"%H%M%S%.f\" }}", quoted(&column.name)),
            why: "guess: clock times written as digits, hhmmss; the date is unknown".to_owned(),
            column: column.name.clone(),
            unit: "s",
            boot: false,
            repeats: RepeatedTimes::None,
            times_s: known,
            question: None,
        });
    }
    let falls = known.windows(2).any(|w| w[1] < w[0]);
    let missing = known.len() < column.values.len();
    if known.len() < 2 || falls || missing || last <= first {
        return None;
    }
    let step = (last - first) / (known.len() - 1) as f64;
    let (unit, why_unit) = unit_of(column, first, step)?;
    let seconds = convert(unit, "s").unwrap_or(1.0);
    // From 2001 to 2096.
    let unix = (1e9..4e9).contains(&(first * seconds));
    let of_day = name_of_head(&column.name) == "tt"
        || (column.words().iter().any(|w| w == "day" || w == "utc") && last * seconds < 172_800.0);
    let (clock, why) = match (unix, of_day) {
        (true, _) => ("unix", "read as seconds since 1970, the values are dates in this century"),
        (_, true) => ("day", "the column name indicates seconds past midnight; the date is unknown"),
        (false, false) => ("boot", "the column probably counts from the start of the log"),
    };
    let (name, hz) = (quoted(&column.name), 1.0 / (step * seconds));
    Some(ClockGuess {
        toml: format!("{{ from = {name}, unit = \"{unit}\", clock = \"{clock}\" }}"),
        why: format!("guess: {why}; unit {unit} ({why_unit}); about {hz:.3} Hz"),
        column: column.name.clone(),
        unit,
        boot: clock == "boot",
        repeats: RepeatedTimes::None,
        times_s: column.values.iter().map(|x| x * seconds).collect(),
        question: None,
    })
}

/// Unit of a time, from the file, its name, its size, or a plausible rate.
fn unit_of(column: &ColumnSample, first: f64, step: f64) -> Option<(&'static str, &'static str)> {
    let units = ["s", "ms", "us", "ns"];
    if let Some(unit) = units.iter().find(|u| convert(&column.unit, "s") == convert(u, "s") && !column.unit.is_empty())
    {
        return Some((unit, "unit in the file"));
    }
    let words = column.words();
    let joined = words.concat();
    let ends = |u: &str| words.len() > 1 && (words.last().is_some_and(|w| w == u) || joined == format!("time{u}"));
    if let Some(unit) =
        ["us", "ms", "ns", "s"].iter().find(|u| ends(u) || (words.last().is_some_and(|w| w == *u) && words.len() > 1))
    {
        return Some((unit, "suffix of the name"));
    }
    let whole_words = [
        ("ms", ["millis", "milliseconds", "msec"]),
        ("us", ["micros", "microseconds", "usec"]),
        ("s", ["seconds", "secs", "sec"]),
    ];
    if let Some((unit, _)) = whole_words.iter().find(|(_, names)| words.iter().any(|w| names.contains(&w.as_str()))) {
        return Some((*unit, "word in the name"));
    }
    for (unit, factor) in [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)] {
        if (1e9 * factor..4e9 * factor).contains(&first) {
            return Some((unit, "only this unit gives a date in this century"));
        }
    }
    // The sampling rates of logs are from 0.05 to 2000 Hz.
    let whole = column.whole && step >= 1.5;
    match (whole, step) {
        (false, 0.0005..20.0) => Some(("s", "this unit gives a common sampling rate")),
        (true, 1.5..5_000.0) => Some(("ms", "whole numbers, and this unit gives a common sampling rate")),
        (true, 5_000.0..5e6) => Some(("us", "whole numbers, and this unit gives a common sampling rate")),
        _ => None,
    }
}

/// Epoch of a log: a topic that holds the log's own clock together with a GPS week or Unix time.
pub fn epoch_of(topics: &[TopicSample]) -> String {
    for topic in topics {
        if let Some(text) = of_topic(topic) {
            return text;
        }
    }
    "\n# The log does not contain its start time. If you know it, set `epoch = { utc = \"2012-10-10T18:20:00Z\" }`.\n\
     epoch = { unknown = true }\n"
        .to_owned()
}

fn of_topic(topic: &TopicSample) -> Option<String> {
    let clock = topic.clock.as_ref();
    let week = week_of(&topic.columns);
    let rises =
        |c: &&ColumnSample| c.known().fold((f64::MIN, true), |(last, fine), x| (x.max(last), fine && x >= last)).1;
    let millis = |c: &&ColumnSample| {
        c.range().is_some_and(|(_, high)| (1_000_000.0..604_800_000.0).contains(&high)) && c.whole && rises(c)
    };
    let mut lines = vec![
        "\n[epoch]   # guess: start time of the log, derived from the UTC time recorded together with the log's \
         clock"
            .to_owned(),
    ];
    if !topic.name.is_empty() {
        lines.push(format!("topic     = {}", quoted(&topic.name)));
    }
    let mut rows = vec![];
    if let Some(fix) = topic
        .columns
        .iter()
        .find(|c| ["status", "fix_type", "fix", "fixtype"].contains(&c.name.to_lowercase().as_str()))
        && fix.known().any(|x| x >= 3.0)
    {
        rows.push(format!("\"{}\" >= 3", fix.name));
    }
    let boot = if let Some(week) = week {
        let names = ["gms", "timems", "tow", "gpstimeofweekms", "itow"];
        let of_week = topic
            .columns
            .iter()
            .filter(|c| c.name != week.name)
            .find(|c| names.contains(&c.words().concat().as_str()) && millis(c))?;
        let boot = boot_column(topic, &of_week.name)?;
        rows.push(format!("\"{}\" > 0", week.name));
        lines.push(format!("from      = {}", quoted(&of_week.name)));
        lines.push("unit      = \"ms\"   # milliseconds of the week, up to 604,800,000".to_owned());
        lines.push(format!("clock     = \"gps\"\nweek      = {}", quoted(&week.name)));
        boot
    } else {
        let unix = topic.columns.iter().find(|c| {
            let named = c.words().iter().any(|w| ["utc", "unix", "epoch"].contains(&w.as_str()));
            named && c.known().any(|x| (1e15..4e15).contains(&x))
        })?;
        rows.push(format!("\"{}\" > 0", unix.name));
        lines.push(format!(
            "from      = {}\nunit      = \"us\"   # this unit gives a date in this century",
            quoted(&unix.name)
        ));
        lines.push("clock     = \"unix\"".to_owned());
        let clock = clock.filter(|c| c.boot)?;
        (clock.column.clone(), clock.unit)
    };
    lines.push(format!("boot      = {}\nboot_unit = \"{}\"", quoted(&boot.0), boot.1));
    lines.push(format!("rows      = {}", quoted(&rows.join(" and "))));
    Some(lines.join("\n") + "\n")
}

/// The column of the log's own clock, with its unit, in a topic that also has the time of the week.
fn boot_column(topic: &TopicSample, of_week: &str) -> Option<(String, &'static str)> {
    if let Some(clock) = topic.clock.as_ref().filter(|c| c.boot && c.column != of_week) {
        return Some((clock.column.clone(), clock.unit));
    }
    let own = topic
        .columns
        .iter()
        .filter(|c| c.name != of_week && ["t", "timeus", "time", "timestamp"].contains(&c.words().concat().as_str()));
    own.filter_map(one).find(|c| c.boot).map(|c| (c.column.clone(), c.unit))
}
