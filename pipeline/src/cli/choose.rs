//! Choice of a mapping, an output folder and identifiers that the command line does not give.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use datasets::{FlightOptions, ReadHints};
use intake::{
    flight_formats,
    mapping::{
        Mapping,
        detect::{MappingFit, firmware, fitting},
    },
};
use schemas::Fault;

use super::{ExitReason, note};

/// A file name as an identifier: letters, digits, `_`, `-` and `.`; without `..` and control characters.
pub fn plain(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let plain: String = stem.chars().map(|c| if c.is_alphanumeric() || "_-.".contains(c) { c } else { '_' }).collect();
    let plain = plain.trim_matches('.').to_owned();
    if plain.is_empty() { "log".to_owned() } else { plain }
}

/// The output folder of logs, in the current folder.
pub fn folder(inputs: &[String]) -> PathBuf {
    match inputs {
        [one] if Path::new(one).is_file() => plain(Path::new(one)).into(),
        _ => "flights".into(),
    }
}

fn options(format: Option<&str>) -> FlightOptions {
    FlightOptions { format: format.map(str::to_owned), ..FlightOptions::default() }
}

/// The built-in mappings that fit a log of several tables, the best first; empty for a log of one table.
pub fn fits(path: &Path, format: Option<&str>) -> Result<Vec<MappingFit>, Fault> {
    let options = options(format);
    let topics = datasets::topics_among(flight_formats(), path, &options).map_err(Fault::from)?;
    if topics.iter().all(|topic| topic.name.is_empty()) {
        return Ok(vec![]);
    }
    fitting(path, &options, flight_formats()).map_err(Fault::from)
}

/// The mapping of a log of several tables, by its content; `None` for a log of one table.
pub fn mapping(path: &Path, format: Option<&str>, started: bool) -> Result<Option<Arc<Mapping>>, ExitReason> {
    let options = options(format);
    // A file of one table needs no mapping: its columns are known by their names. Its rows are not counted here.
    let known = datasets::flight_format_of(flight_formats(), path, &options);
    if !known.is_ok_and(|format| flight_formats().iter().any(|f| f.name == format && f.topics.is_some())) {
        return Ok(None);
    }
    let found = fits(path, format)?;
    let Some(best) = found.first() else {
        let what = format!("{}: no built-in mapping fits this log", path.display());
        let help = format!("`magline init {}` writes a mapping for it", path.display());
        return Err(Fault::new(what).help(help).into());
    };
    let version = firmware(path, &options, flight_formats()).map_or(String::new(), |v| format!(" ({v})"));
    let others: Vec<&str> = found.iter().skip(1).map(|fit| fit.name).collect();
    let others = if others.is_empty() { "no other fits".to_owned() } else { format!("others: {}", others.join(", ")) };
    note(&format!(
        "{}{version}: the content of the log fits the mapping `{}`; {others}; choose with `--mapping NAME`",
        path.display(),
        best.name
    ));
    if best.lacks_start && !started {
        let what = format!("{}: the log does not contain its start time (no GNSS fix)", path.display());
        let help = "add `--epoch unknown` to count `tt` from the start of the log, without a date; or give the start \
                    time as `--epoch 2012-10-10T18:20:00Z`";
        return Err(Fault::new(what).help(help).into());
    }
    Ok(Some(best.mapping.clone()))
}

/// Rejects a built-in mapping that reads no table of a log, and names the mappings that do.
pub fn check(mapping: &Mapping, name: Option<&str>, path: &Path, format: Option<&str>) -> Result<(), ExitReason> {
    let builtin = name.filter(|name| mapping.label == format!("{name}.toml"));
    let Some(name) = builtin else { return Ok(()) };
    let found = fits(path, format).unwrap_or_default();
    if found.is_empty() || found.iter().any(|fit| fit.name == name) {
        return Ok(());
    }
    let names: Vec<String> = found.iter().map(|fit| format!("`--mapping {}`", fit.name)).collect();
    let what = format!("the mapping `{name}` does not fit {}", path.display());
    Err(Fault::new(what).help(format!("use {}", names.join(" or "))).into())
}

/// The mapping with the start time of `--epoch`.
pub fn started(mapping: Arc<Mapping>, epoch: Option<&str>) -> Result<Arc<Mapping>, Fault> {
    let Some(epoch) = epoch else { return Ok(mapping) };
    let text = match epoch {
        "unknown" => "{ unknown = true }".to_owned(),
        utc => format!("{{ utc = {} }}", toml::Value::String(utc.to_owned())),
    };
    mapping.with_epoch(&text).map(Arc::new)
}

/// The options, with identifiers for a file that has none: the flight is the name of the file, the line is 1.
pub fn keys(mapped: bool, path: &Path, mut options: FlightOptions) -> FlightOptions {
    if mapped || (options.flight.is_some() && options.line.is_some()) {
        return options;
    }
    let opened = datasets::open_raw_among(flight_formats(), path, &options, &ReadHints::default());
    let Ok(opened) = opened else { return options };
    let names: Vec<String> = opened.schema().fields().iter().map(|f| f.name().clone()).collect();
    let renamed = |key: &str| options.rename.values().any(|name| name == key);
    let has = |key: &str| names.iter().any(|n| n == key) || renamed(key);
    // The user must rename a column such as `Line`, which holds the identifier under another name.
    let similar = |key: &str| names.iter().any(|n| n.to_lowercase().contains(key));
    if options.flight.is_none() && !has("flight") && !similar("flight") {
        let flight = plain(path);
        note(&format!(
            "{}: the flight is named `{flight}` after the file; choose another name with `--flight`",
            path.display()
        ));
        options.flight = Some(flight);
    }
    if options.line.is_none() && !has("line") && !similar("line") {
        note(&format!(
            "{}: the whole file is one line, `1`; choose another name with `--line`, or divide the file with `--lines \
             auto`",
            path.display()
        ));
        options.line = Some("1".to_owned());
    }
    options
}
