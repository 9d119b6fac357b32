//! Lines of `magline ingest`: they are detected in each flight or read from a table, and can be written as a table and
//! drawn.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use datasets::{FlightOptions, ReadHints};
use intake::{
    FlightDivision, LineTable,
    find_lines::{self, ChannelCollector, LineDetection},
    mapping::MappingTable,
    open_log,
};
use plan::sources::{AUTO, WHOLE, division, hive};
use report::html::write;
use results::text::columns;
use schemas::Fault;
use serde_json::json;
use store::make_folder;

use super::{ExitReason, note, say};

/// Options for the division of logs into lines.
#[derive(Args)]
pub struct LineArgs {
    /// A table of lines (`flight`, `line`, `t_start`, `t_end` in seconds past midnight UTC) that replaces the lines in
    /// the logs; or `auto` to find survey and tie lines, calibration boxes, cloverleafs, figures of eight and circles.
    #[arg(long, value_name = "FILE|auto")]
    pub lines: Option<String>,
    /// Draw the lines for checking, one .svg or .png file per flight.
    #[arg(long, requires = "lines", value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// The output table of the lines found by `--lines auto`. After editing, this table can be used by `lines` of a
    /// spec or by `--lines`. Default: `_lines/LOG.csv` in the folder of `--to`, or `_lines/lines.csv` for several logs.
    #[arg(long, requires = "lines", value_name = "FILE")]
    pub write_lines: Option<PathBuf>,
}

/// A log or one of its tables, with the mapping of its columns.
pub struct LogInput<'a> {
    /// The file.
    pub input: &'a Path,
    /// Mapping of its columns.
    pub mapped: Option<&'a MappingTable>,
}

/// The lines that logs are divided into.
#[derive(Default)]
pub struct LogLines {
    table: Option<LineTable>,
}

/// Width of a PNG.
const WIDTH_PX: usize = 1600;

impl LogLines {
    /// Table of the lines; `None` if the logs' own lines are used.
    pub fn table(&self) -> Option<&LineTable> {
        self.table.as_ref()
    }

    /// Fault of a table of lines that has lines without a sample; `None` if every line has samples.
    pub fn check<'a>(&self, written: impl Iterator<Item = (&'a str, &'a str)>) -> Option<Fault> {
        self.table.as_ref().and_then(|table| table.check(written).err())
    }
}

/// Options for reading the logs. Logs that are divided here need no line identifier.
pub fn options(args: &LineArgs, options: FlightOptions) -> FlightOptions {
    let line = options.line.clone().or_else(|| args.lines.is_some().then(|| WHOLE.to_owned()));
    FlightOptions { line, ..options }
}

/// Finds the lines of the logs, and writes and draws them if requested. `to` is the folder of the tables, if any.
pub fn lines(
    args: &LineArgs,
    logs: &[LogInput],
    options: &FlightOptions,
    to: Option<&Path>,
    replace: bool,
    json: bool,
) -> Result<LogLines, ExitReason> {
    let Some(name) = &args.lines else { return Ok(LogLines::default()) };
    if let Some(picture) = &args.picture {
        PictureFormat::from_path(picture)?;
    }
    let given = match division(name, Path::new(""))? {
        FlightDivision::Table(table) => Some(table),
        FlightDivision::Found => None,
    };
    if given.is_some() && args.write_lines.is_some() {
        let fault = Fault::new("`--write-lines` writes only lines that magline finds");
        return Err(fault.help(format!("use `--lines {AUTO}`, or remove `--write-lines`")).into());
    }
    if given.is_some() && args.picture.is_none() {
        return Ok(LogLines { table: given });
    }
    let mut collector = ChannelCollector::default();
    for log in logs {
        let reading = ReadHints { found: None, threads: 1 };
        let opened = open_log(log.input, &hive(log.input, options), log.mapped, &reading).map_err(Fault::from)?;
        collector.read(opened, log.mapped.map_or("", MappingTable::name))?;
    }
    let mut flights = collector.found();
    if let Some(table) = given {
        flights.iter_mut().for_each(|(flight, found)| found.divide(&table.lines_of(flight)));
        flights.retain(|(_, found)| !found.lines.is_empty());
        let pictures = drawn(args, &flights)?;
        pictures.iter().for_each(|path| note(&format!("{} shows the lines", path.display())));
        return Ok(LogLines { table: Some(table) });
    }
    let missing: Vec<Fault> = flights.iter().filter_map(|(flight, found)| found.missing(flight)).collect();
    flights.retain(|(_, found)| !found.lines.is_empty());
    if flights.is_empty() {
        let none = || Fault::data("the files contain no samples");
        return Err(missing.into_iter().next().unwrap_or_else(none).into());
    }
    missing.iter().for_each(|fault| note(&format!("{}; its samples are dropped", fault.what)));
    let written = written(args, logs, &flights, to, replace)?;
    let pictures = drawn(args, &flights)?;
    if json {
        as_json(&flights);
    } else if !super::is_quiet() {
        say::out_text(summary(&flights, written.iter().chain(&pictures)));
    }
    let spans = flights.iter().map(|(flight, found)| (flight.clone(), found.spans()));
    Ok(LogLines { table: Some(LineTable::new("the lines that were found", spans)) })
}

/// Writes the table of the detected lines.
fn written(
    args: &LineArgs,
    logs: &[LogInput],
    flights: &[(String, LineDetection)],
    to: Option<&Path>,
    replace: bool,
) -> Result<Option<PathBuf>, ExitReason> {
    let of_one = logs.first().filter(|first| logs.iter().all(|log| log.input == first.input));
    let stem = of_one.and_then(|log| log.input.file_stem()).map_or("lines".into(), |stem| stem.to_string_lossy());
    let default_path = || to.map(|to| to.join("_lines").join(format!("{stem}.csv")));
    let Some(path) = args.write_lines.clone().or_else(default_path) else { return Ok(None) };
    let text = find_lines::csv(flights);
    // An existing table is kept, because the user may have edited it.
    let other = fs::read(&path).is_ok_and(|known| known != text.as_bytes());
    if other && !replace {
        let help = format!(
            "use the lines in this file with `--lines {}`, give another file with `--write-lines`, or replace this \
             file with `--replace`",
            path.display()
        );
        return Err(Fault::new(format!("{} already contains other lines", path.display())).help(help).into());
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let failed = |e| ExitReason::Failed(format!("error: cannot write {}: {e}", path.display()));
    make_folder(&std::path::absolute(folder).map_err(failed)?).map_err(failed)?;
    write(&path, text.as_bytes())?;
    Ok(Some(path))
}

/// File format of a picture.
enum PictureFormat {
    Svg,
    Png,
}

impl PictureFormat {
    fn from_path(path: &Path) -> Result<PictureFormat, Fault> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let known = [("svg", PictureFormat::Svg), ("png", PictureFormat::Png)];
        let found = known.into_iter().find(|(name, _)| ending.as_deref() == Some(*name));
        found.map(|(_, form)| form).ok_or_else(|| {
            Fault::new(format!("`{}` is not a supported image format", path.display()))
                .help("use the extension .svg or .png")
        })
    }
}

/// Draws a picture of each flight. With several flights, each file name contains its flight.
fn drawn(args: &LineArgs, flights: &[(String, LineDetection)]) -> Result<Vec<PathBuf>, ExitReason> {
    let Some(path) = &args.picture else { return Ok(vec![]) };
    let form = PictureFormat::from_path(path)?;
    let mut taken: BTreeSet<PathBuf> = BTreeSet::new();
    for (flight, found) in flights {
        let mut to = if flights.len() > 1 { with_flight(path, &plain(flight)) } else { path.clone() };
        let mut number = 1;
        while !taken.insert(to.clone()) {
            number += 1;
            to = with_flight(path, &format!("{}-{number}", plain(flight)));
        }
        let title = format!("Flight {flight}: {}", super::counted(found.lines.len(), "line"));
        let bytes = match form {
            PictureFormat::Svg => find_lines::svg(&title, found)?.into_bytes(),
            PictureFormat::Png => find_lines::png(&title, found, WIDTH_PX)?,
        };
        write(&to, &bytes)?;
    }
    Ok(taken.into_iter().collect())
}

/// Flight identifier as part of a file name.
fn plain(flight: &str) -> String {
    flight.chars().map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' }).collect()
}

/// Inserts the flight into a path: `lines.svg` becomes `lines-1003.svg`.
fn with_flight(path: &Path, flight: &str) -> PathBuf {
    let (stem, ending) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    path.with_file_name(format!("{}-{flight}.{}", stem.to_string_lossy(), ending.to_string_lossy()))
}

fn summary<'a>(flights: &[(String, LineDetection)], files: impl Iterator<Item = &'a PathBuf>) -> String {
    /// Maximum number of listed lines.
    const SHOWN: usize = 60;
    let heads = ["  flight", "line", "kind", "t_start", "t_end", "course", "length m", "height m"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    let lines = || flights.iter().flat_map(|(flight, found)| found.lines.iter().map(move |l| (flight, found, l)));
    for (flight, found, line) in lines().take(SHOWN) {
        let (from, to) = found.times_s(line);
        let whole = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.0}"));
        rows.push(vec![
            format!("  {flight}"),
            line.name.clone(),
            line.kind.word().to_owned(),
            format!("{from:.1}"),
            format!("{to:.1}"),
            whole(line.heading_deg.map(|x| x.round() % 360.0)),
            whole(found.length_m(line)),
            whole(found.height_m(line)),
        ]);
    }
    let mut text = format!("\nlines found\n{}", columns(&rows, 3));
    let more = lines().count().saturating_sub(SHOWN);
    if more > 0 {
        text += &format!("  and {more} more\n");
    }
    files.for_each(|file| text += &format!("  {}\n", file.display()));
    text
}

fn as_json(flights: &[(String, LineDetection)]) {
    for (flight, found) in flights {
        for line in &found.lines {
            let (from, to) = found.times_s(line);
            let event = json!({
                "event": "found_line",
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
