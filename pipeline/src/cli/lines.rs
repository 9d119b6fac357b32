//! The lines of `magline ingest`: found in each flight, or those of a table; written as a table, and drawn.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use datasets::{FlightOptions, Reading};
use schemas::Fault;
use serde_json::json;

use super::{Stop, note, say};
use crate::{
    sources::{
        AUTO, Division, LineTable, WHOLE, division,
        find_lines::{self, Collector, Found},
        hive,
        mapping::Mapped,
        open_log,
    },
    store::make_folder,
    views::{
        report::write,
        text::{columns, number},
    },
};

/// Which lines the logs are divided into.
#[derive(Args)]
pub struct LineArgs {
    /// A table of lines (`flight`, `line`, `t_start`, `t_end` in s past midnight UTC) in place of the logs' own; or `auto`, which finds
    /// them: survey and tie lines, calibration boxes, cloverleafs, figures of eight and circles.
    #[arg(long, value_name = "FILE|auto")]
    pub lines: Option<String>,
    /// A picture to check the lines by: .svg or .png, one of each flight.
    #[arg(long, requires = "lines", value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// The table that lines found by `--lines auto` are written to, to be edited and used by `lines` of a spec or `--lines`;
    /// `_lines/LOG.csv` in the folder of `--to` by default.
    #[arg(long, requires = "lines", value_name = "FILE")]
    pub write_lines: Option<PathBuf>,
}

/// A log, a table of it or all of it, and how it is read.
pub struct Log<'a> {
    /// The file.
    pub input: &'a Path,
    /// What its columns mean.
    pub mapped: Option<&'a Mapped>,
}

/// The lines of each log.
#[derive(Default)]
pub struct Lines {
    /// By log, where they are not the log's own.
    tables: BTreeMap<PathBuf, LineTable>,
    given: Option<LineTable>,
}

/// Width of a PNG.
const WIDTH_PX: usize = 1600;

impl Lines {
    /// The lines of a log.
    pub fn of(&self, input: &Path) -> Option<&LineTable> {
        self.given.as_ref().or_else(|| self.tables.get(input))
    }

    /// What is wrong with a table that was given: lines without a sample.
    pub fn check<'a>(&self, written: impl Iterator<Item = (&'a str, &'a str)>) -> Option<Fault> {
        self.given.as_ref().and_then(|table| table.check(written).err())
    }
}

/// How logs are read: a log that is divided needs no lines of its own.
pub fn options(args: &LineArgs, options: FlightOptions) -> FlightOptions {
    let line = options.line.clone().or_else(|| args.lines.is_some().then(|| WHOLE.to_owned()));
    FlightOptions { line, ..options }
}

/// The lines of the logs, written and drawn where that is asked for. `to` is the folder of the tables, where there is one.
pub fn lines(
    args: &LineArgs,
    logs: &[Log],
    options: &FlightOptions,
    to: Option<&Path>,
    replace: bool,
    json: bool,
) -> Result<Lines, Stop> {
    let Some(name) = &args.lines else { return Ok(Lines::default()) };
    if let Some(picture) = &args.picture {
        Form::of(picture)?;
    }
    let given = match division(name, Path::new(""))? {
        Division::Table(table) => Some(table),
        Division::Found => None,
    };
    if given.is_some() && args.write_lines.is_some() {
        let fault = Fault::new("`--write-lines` writes the lines that are found");
        return Err(fault.help(format!("say `--lines {AUTO}`, or leave it out")).into());
    }
    if given.is_some() && args.picture.is_none() {
        return Ok(Lines { given, ..Lines::default() });
    }
    let mut all: Vec<(&Path, Vec<(String, Found)>)> = vec![];
    for log in logs {
        if all.iter().any(|(input, _)| *input == log.input) {
            continue;
        }
        let mut flights = found(log.input, logs, options)?;
        if let Some(table) = &given {
            flights.iter_mut().for_each(|(flight, found)| found.divide(&table.lines_of(flight)));
        }
        all.push((log.input, flights));
    }
    if let Some(table) = given {
        drawn(args, &all)?;
        return Ok(Lines { given: Some(table), ..Lines::default() });
    }
    let mut tables = BTreeMap::new();
    for (input, flights) in &mut all {
        let missing: Vec<Fault> = flights.iter().filter_map(|(flight, found)| found.missing(flight)).collect();
        flights.retain(|(_, found)| !found.lines.is_empty());
        if flights.is_empty() {
            let none = || Fault::data("the file holds no samples");
            let fault = missing.into_iter().next().unwrap_or_else(none);
            return Err(fault.in_file(&input.display().to_string()).into());
        }
        missing
            .iter()
            .for_each(|fault| note(&format!("{}: {}; its samples are left out", input.display(), fault.what)));
        let spans = flights.iter().map(|(flight, found)| (flight.clone(), found.spans()));
        tables.insert(input.to_path_buf(), LineTable::of(&input.display().to_string(), spans));
    }
    let written = written(args, &all, to, replace)?;
    let pictures = drawn(args, &all)?;
    if json {
        all.iter().for_each(|(input, flights)| as_json(input, flights));
    } else if !super::is_quiet() {
        say::out_text(summary(&all, written.iter().chain(&pictures)));
    }
    Ok(Lines { tables, given: None })
}

/// The flights of a log, out of all its tables, with the lines that are found in each.
fn found(input: &Path, logs: &[Log], options: &FlightOptions) -> Result<Vec<(String, Found)>, Stop> {
    let mut collector = Collector::default();
    for log in logs.iter().filter(|log| log.input == input) {
        let reading = Reading { found: None, threads: 1 };
        let opened = open_log(input, &hive(input, options), log.mapped, &reading).map_err(Fault::from)?;
        collector.read(opened)?;
    }
    Ok(collector.found())
}

/// Writes the tables of the lines that were found.
fn written(
    args: &LineArgs,
    all: &[(&Path, Vec<(String, Found)>)],
    to: Option<&Path>,
    replace: bool,
) -> Result<Vec<PathBuf>, Stop> {
    let mut files: Vec<(PathBuf, String)> = vec![];
    if let Some(path) = &args.write_lines {
        let flights: Vec<(String, Found)> = all.iter().flat_map(|(_, flights)| flights.iter().cloned()).collect();
        files.push((path.clone(), find_lines::csv(&flights)));
    } else if let Some(to) = to {
        for (input, flights) in all {
            let stem = input.file_stem().unwrap_or_default().to_string_lossy();
            files.push((to.join("_lines").join(format!("{stem}.csv")), find_lines::csv(flights)));
        }
    }
    for (path, text) in &files {
        // It may have been edited.
        let other = fs::read(path).is_ok_and(|known| known != text.as_bytes());
        if other && !replace {
            let fault = Fault::new(format!("{} holds other lines already", path.display()));
            let help = format!(
                "use them by `--lines {}`, name another file with `--write-lines`, or say `--replace`",
                path.display()
            );
            return Err(fault.help(help).into());
        }
    }
    for (path, text) in &files {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |e| Stop::Failed(format!("error: cannot write {}: {e}", path.display()));
        make_folder(&std::path::absolute(folder).map_err(failed)?).map_err(failed)?;
        write(path, text.as_bytes())?;
    }
    Ok(files.into_iter().map(|(path, _)| path).collect())
}

/// The form of a picture.
enum Form {
    Svg,
    Png,
}

impl Form {
    fn of(path: &Path) -> Result<Form, Fault> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let known = [("svg", Form::Svg), ("png", Form::Png)];
        let found = known.into_iter().find(|(name, _)| ending.as_deref() == Some(*name));
        found.map(|(_, form)| form).ok_or_else(|| {
            Fault::new(format!("`{}` is no kind of picture", path.display())).help("end its name in .svg or .png")
        })
    }
}

/// Draws a picture of each flight; of several, each has the flight in its name.
fn drawn(args: &LineArgs, all: &[(&Path, Vec<(String, Found)>)]) -> Result<Vec<PathBuf>, Stop> {
    let Some(path) = &args.picture else { return Ok(vec![]) };
    let form = Form::of(path)?;
    let several = all.iter().map(|(_, flights)| flights.len()).sum::<usize>() > 1;
    let mut taken: BTreeSet<PathBuf> = BTreeSet::new();
    for (flight, found) in all.iter().flat_map(|(_, flights)| flights) {
        let mut to = if several { beside(path, &plain(flight)) } else { path.clone() };
        let mut number = 1;
        while !taken.insert(to.clone()) {
            number += 1;
            to = beside(path, &format!("{}-{number}", plain(flight)));
        }
        let title = format!("Flight {flight}: {}", super::counted(found.lines.len(), "line"));
        let bytes = match form {
            Form::Svg => find_lines::svg(&title, found)?.into_bytes(),
            Form::Png => find_lines::png(&title, found, WIDTH_PX)?,
        };
        write(&to, &bytes)?;
    }
    Ok(taken.into_iter().collect())
}

/// A flight as a part of the name of a file.
fn plain(flight: &str) -> String {
    flight.chars().map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' }).collect()
}

/// `lines.svg` as `lines-1003.svg`.
fn beside(path: &Path, flight: &str) -> PathBuf {
    let (stem, ending) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    path.with_file_name(format!("{}-{flight}.{}", stem.to_string_lossy(), ending.to_string_lossy()))
}

fn summary<'a>(all: &[(&Path, Vec<(String, Found)>)], files: impl Iterator<Item = &'a PathBuf>) -> String {
    /// Lines of one log that are listed.
    const SHOWN: usize = 60;
    let mut text = String::new();
    for (input, flights) in all {
        text += &format!("\n{}, lines found\n", input.display());
        let mut rows = vec![
            ["  flight", "line", "kind", "t_start", "t_end", "course", "length m", "height m"]
                .map(str::to_owned)
                .to_vec(),
        ];
        let lines = || flights.iter().flat_map(|(flight, found)| found.lines.iter().map(move |l| (flight, found, l)));
        for (flight, found, line) in lines().take(SHOWN) {
            let (from, to) = found.times_s(line);
            let whole = |x: Option<f64>| number(x.map(f64::round));
            rows.push(vec![
                format!("  {flight}"),
                line.name.clone(),
                line.kind.word().to_owned(),
                format!("{from:.1}"),
                format!("{to:.1}"),
                line.heading_deg.map_or("-".to_owned(), |x| format!("{x:.0}")),
                whole(found.length_m(line)),
                whole(found.height_m(line)),
            ]);
        }
        text += &columns(&rows, 3);
        let more = lines().count().saturating_sub(SHOWN);
        if more > 0 {
            text += &format!("  and {more} more\n");
        }
    }
    files.for_each(|file| text += &format!("  {}\n", file.display()));
    text
}

fn as_json(input: &Path, flights: &[(String, Found)]) {
    for (flight, found) in flights {
        for line in &found.lines {
            let (from, to) = found.times_s(line);
            let event = json!({
                "event": "found_line",
                "input": input.display().to_string(),
                "flight": flight,
                "line": line.name,
                "kind": line.kind.word(),
                "t_start": from,
                "t_end": to,
                "heading_deg": line.heading_deg.filter(|x| x.is_finite()),
                "length_m": found.length_m(line),
                "alt_m": found.height_m(line),
            });
            say::out!("{event}\n");
        }
    }
}
