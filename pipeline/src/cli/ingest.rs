//! `magline ingest`: logs to flight Parquet, with a summary of their quality; and a mapping suggested from a log.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use clap::Args;
use datasets::FlightOptions;
use intake::{
    checks::{QualityFigure, QualityMeasure},
    flight_formats,
    mapping::{Mapping, MappingTable, suggest},
};
use plan::sources::{
    export::{ExportLine, ExportOutcome, LogExport},
    file, find, hive,
};
use rayon::prelude::*;
use results::text::{columns, number};
use schemas::{Fault, FaultOwner, Role, flight, plausible::PlausibilityCheck, render};
use serde_json::json;
use store::{make_folder, own_folder, sweep};

use super::{
    ExitReason, choose, counted, is_quiet, lines, note, progress::ProgressDisplay, say, temporary::TemporaryFile,
    threads,
};

/// Arguments of `magline ingest`.
#[derive(Args)]
pub struct IngestArgs {
    /// Logs: files, folders or patterns.
    #[arg(required = true)]
    inputs: Vec<String>,
    /// The output folder. A mapping with several tables writes one folder for each. Default: a folder named after the
    /// log, without its extension; `flights` for several logs.
    #[arg(long)]
    to: Option<PathBuf>,
    /// The format of the logs; by default, it is detected from content and extension.
    #[arg(long)]
    format: Option<String>,
    /// The mapping of the columns: a TOML file, or the name of a built-in mapping. Default for logs with several
    /// tables: the built-in mapping that reads most of them.
    #[arg(long)]
    mapping: Option<String>,
    /// One table of the mapping; all tables by default.
    #[arg(long, requires = "mapping")]
    table: Option<String>,
    /// The start time of the log for a mapping, if the log does not contain it: a UTC time such as
    /// 2012-10-10T18:20:00Z, or `unknown`, which counts `tt` from the start of the log and gives no date.
    #[arg(long, value_name = "UTC|unknown")]
    epoch: Option<String>,
    /// The flight identifier, if neither log nor mapping contains it. Default: the name of the file.
    #[arg(long)]
    flight: Option<String>,
    /// The line identifier, if neither log nor mapping contains it.
    #[arg(long)]
    line: Option<String>,
    #[command(flatten)]
    divided: lines::LineArgs,
    /// Write a folder `flight=...` for each flight, instead of the column.
    #[arg(long)]
    hive: bool,
    /// Replace existing files with other data.
    #[arg(long)]
    replace: bool,
    /// Accept impossible values.
    #[arg(long)]
    accept_range: bool,
    /// Write a suggested mapping for the logs instead, with the reason for each guess. If there are several logs, the
    /// first one is examined, and the others are compared with it.
    #[arg(long, conflicts_with = "lines")]
    suggest: bool,
    /// The EPSG code of the log's eastings and northings, for a suggested mapping.
    #[arg(long, requires = "suggest")]
    epsg: Option<u16>,
    /// The output file of the suggested mapping; standard output by default.
    #[arg(short, long, requires = "suggest")]
    output: Option<PathBuf>,
    /// The number of threads; all cores by default. Results do not depend on this number.
    #[arg(long, value_parser = threads::count)]
    threads: Option<usize>,
    /// Write JSON Lines to standard output: one object for each flight line of each file, with its quality figures.
    #[arg(long)]
    json: bool,
    /// Suppress progress, notes and tables; print only errors.
    #[arg(short, long)]
    quiet: bool,
}

/// A log and one of its tables.
struct IngestItem {
    input: PathBuf,
    mapped: Option<MappingTable>,
    folder: PathBuf,
    name: String,
}

impl IngestItem {
    /// The table, for messages.
    fn table(&self) -> &str {
        self.mapped.as_ref().map_or("", MappingTable::name)
    }
}

/// Runs the command.
pub fn run(args: &IngestArgs) -> Result<(), ExitReason> {
    if args.suggest {
        return suggested(args);
    }
    super::QUIET.store(args.quiet || args.json, Ordering::Relaxed);
    super::interrupt::leave();
    let only_lines = args.to.is_none() && (args.divided.picture.is_some() || args.divided.write_lines.is_some());
    let to = args.to.clone().unwrap_or_else(|| choose::folder(&args.inputs));
    let works = works(args, &to)?;
    if args.to.is_none() && !only_lines {
        note(&format!("output folder: {}; choose another with `--to`", to.display()));
    }
    let options = FlightOptions {
        format: args.format.clone(),
        flight: args.flight.clone(),
        line: args.line.clone(),
        accept: if args.accept_range { vec![PlausibilityCheck::Range] } else { vec![] },
        ..FlightOptions::default()
    };
    let options = lines::options(&args.divided, options);
    let logs: Vec<lines::LogInput> =
        works.iter().map(|w| lines::LogInput { input: &w.input, mapped: w.mapped.as_ref() }).collect();
    let divided = lines::lines(
        &args.divided,
        &logs,
        &options,
        Some(to.as_path()).filter(|_| !only_lines),
        args.replace,
        args.json,
    )?;
    if only_lines {
        return Ok(());
    }
    let hidden = to.join(".ingest");
    let failed = |e: std::io::Error| ExitReason::Failed(format!("error: cannot write to {}: {e}", to.display()));
    let (unfinished, lock) = working_folder(&hidden).map_err(failed)?;
    let unfinished = TemporaryFile::new(unfinished);
    let progress = ProgressDisplay::new(args.quiet || args.json);
    progress.stage("ingesting logs");
    progress.detail("tables", "");
    let done = AtomicUsize::new(0);
    let one = |(number, work): (usize, &IngestItem)| {
        let export = LogExport {
            input: &work.input,
            options: choose::keys(work.mapped.is_some(), &work.input, hive(&work.input, &options)),
            mapped: work.mapped.clone(),
            lines: divided.table(),
            folder: work.folder.clone(),
            name: work.name.clone(),
            hive: args.hive,
            replace: args.replace,
            unfinished: unfinished.path(),
            number,
        };
        let exported = export.run();
        progress.set(done.fetch_add(1, Ordering::Relaxed) + 1, works.len());
        exported
    };
    let pool = threads::pool(args.threads)?;
    let results: Vec<Result<ExportOutcome, Fault>> = pool.install(|| works.par_iter().enumerate().map(one).collect());
    drop(progress);
    drop(lock);
    drop(unfinished);
    // This fails, and the folder is kept, if another process uses it.
    let _ = fs::remove_dir(&hidden);
    print_outcome(args, &works, &results, &divided)
}

/// Makes a folder for unfinished files, and locks it for this process.
fn working_folder(hidden: &Path) -> std::io::Result<(PathBuf, fs::File)> {
    const TRIALS: usize = 100;
    let mut last = std::io::Error::other("no unused folder name");
    for _ in 0..TRIALS {
        make_folder(&std::path::absolute(hidden)?)?;
        sweep(hidden);
        match own_folder(hidden) {
            // Another process that has just ended removed the empty folder; it is made again.
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => last = e,
            done => return done,
        }
    }
    Err(last)
}

/// Files and tables in the order of the inputs. Duplicate output names are rejected before any file is read.
fn works(args: &IngestArgs, to: &Path) -> Result<Vec<IngestItem>, ExitReason> {
    let given = args
        .mapping
        .as_ref()
        .map(|name| Mapping::load(name, |name| file(name, Path::new("."))).map(Arc::new))
        .transpose()?;
    let mut works: Vec<IngestItem> = vec![];
    for input in &args.inputs {
        let found = find(input, Path::new(""), args.format.is_some())?;
        for path in found {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let chosen = match &given {
                Some(mapping) => {
                    choose::check(mapping, args.mapping.as_deref(), &path, args.format.as_deref())?;
                    Some(mapping.clone())
                }
                None => choose::mapping(&path, args.format.as_deref(), args.epoch.is_some())?,
            };
            let chosen = chosen.map(|mapping| choose::started(mapping, args.epoch.as_deref())).transpose()?;
            let Some(mapping) = &chosen else {
                works.push(IngestItem { input: path, mapped: None, folder: to.to_owned(), name });
                continue;
            };
            let several = args.table.is_none() && mapping.tables().len() > 1;
            for table in tables_in(args, mapping, &path)? {
                let folder = if several { to.join(table.name()) } else { to.to_owned() };
                works.push(IngestItem { input: path.clone(), mapped: Some(table), folder, name: name.clone() });
            }
        }
    }
    let mut taken: BTreeMap<PathBuf, &Path> = BTreeMap::new();
    for work in &works {
        if let Some(other) = taken.insert(work.folder.join(&work.name), &work.input) {
            let what =
                format!("{} and {} would both be written to {}", other.display(), work.input.display(), work.name);
            return Err(Fault::new(what).help("ingest the files into different folders with `--to`").into());
        }
    }
    if works.is_empty() {
        let fault = Fault::new("these files contain no table of the mapping");
        return Err(fault.help("check the keys `file` and `topic` of the mapping").into());
    }
    Ok(works)
}

/// Tables of a mapping that occur in a file.
fn tables_in(args: &IngestArgs, mapping: &Arc<Mapping>, path: &Path) -> Result<Vec<MappingTable>, ExitReason> {
    let names: Vec<String> = match &args.table {
        Some(name) => vec![name.clone()],
        None => mapping.tables().into_iter().map(str::to_owned).collect(),
    };
    let mut tables = vec![];
    for name in names {
        let mapped = mapping.table(Some(&name))?;
        if args.table.is_some() || mapped.is_in(path) {
            tables.push(mapped);
        }
    }
    if args.table.is_some() || tables.iter().all(|t| t.topic().is_none()) {
        return Ok(tables);
    }
    let options = FlightOptions {
        format: args.format.clone().or(tables.iter().find_map(MappingTable::format)),
        ..FlightOptions::default()
    };
    let topics = datasets::topics_among(flight_formats(), path, &options).map_err(Fault::from)?;
    // A topic name without a number means the first instance of the topic.
    let plain = |name: &str| name.strip_suffix(":0").unwrap_or(name).to_owned();
    let of = |topic: &str| topics.iter().find(|known| plain(&known.name) == plain(topic));
    let there = |t: &MappingTable| t.topic().is_none_or(|topic| of(topic).is_some_and(|known| known.note.is_empty()));
    let (there, missing): (Vec<MappingTable>, Vec<MappingTable>) = tables.into_iter().partition(there);
    for table in &missing {
        let topic = table.topic().unwrap_or_default();
        let why = match of(topic) {
            Some(known) => format!("{}: {}", path.display(), known.note),
            None => format!("{} has no topic `{topic}`", path.display()),
        };
        note(&format!("{why}: the table `{}` is skipped", table.name()));
    }
    if there.is_empty() {
        let names: Vec<&str> = topics.iter().filter(|t| t.note.is_empty()).map(|t| t.name.as_str()).collect();
        let fault = Fault::new(format!("{} contains no topic of the mapping {}", path.display(), mapping.label));
        let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(fault.help(format!("topics of the file: {names}")).into());
    }
    Ok(there)
}

/// Prints the outcome.
fn print_outcome(
    args: &IngestArgs,
    works: &[IngestItem],
    results: &[Result<ExportOutcome, Fault>],
    divided: &lines::LogLines,
) -> Result<(), ExitReason> {
    let mut faults: Vec<&Fault> = vec![];
    let mut noted: BTreeSet<&str> = BTreeSet::new();
    let (mut written, mut lost) = (0, 0);
    for (work, result) in works.iter().zip(results) {
        match result {
            Err(fault) => faults.push(fault),
            Ok(exported) => {
                // Several tables of one log have the same clock.
                exported.notes.iter().filter(|n| noted.insert(n)).for_each(|n| note(n));
                written += exported.lines.iter().filter(|l| l.faults.is_empty()).count();
                for line in &exported.lines {
                    lost += usize::from(!line.faults.is_empty());
                    faults.extend(&line.faults);
                }
                if args.json {
                    exported.lines.iter().for_each(|l| say::out!("{}\n", as_json(work, exported, l)));
                } else if !is_quiet() {
                    say::out_text(summary(work, exported));
                }
            }
        }
    }
    if !args.json && !is_quiet() {
        say::out_text(quality(works, results));
    }
    let all = results.iter().flatten().flat_map(|e| &e.lines);
    let empty = divided.check(all.map(|l| (l.flight.as_str(), l.line.as_str())));
    faults.extend(&empty);
    if faults.is_empty() {
        return Ok(());
    }
    const SHOWN: usize = 20;
    let shown = |f: &&Fault| {
        let help = f.help.as_ref().map(|h| h.replace("`accept = [\"range\"]`", "`--accept-range`"));
        render(&Fault { help, ..(*f).clone() }, "", "")
    };
    let mut text: Vec<String> = faults.iter().take(SHOWN).map(shown).collect();
    if faults.len() > SHOWN {
        text.push(format!("and {} more", faults.len() - SHOWN));
    }
    if written > 0 && lost > 0 {
        text.push(format!("{} written, {} rejected", counted(written, "line"), counted(lost, "line")));
    }
    // If nothing was written, and all faults are faults of the spec or the data, the input is wrong.
    let ours = faults.iter().all(|f| f.owner == FaultOwner::Spec || f.owner == FaultOwner::Data);
    let text = text.join("\n");
    Err(if written == 0 && ours { ExitReason::Wrong(text) } else { ExitReason::Failed(text) })
}

fn clock(tt: f64) -> String {
    if !tt.is_finite() {
        return "-".to_owned();
    }
    let s = tt.rem_euclid(86_400.0).floor() as u64;
    format!("{:02}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
}

fn value_of(line: &ExportLine, column: &str, check: QualityFigure) -> Option<f64> {
    line.measures.iter().find(|m| m.column == column && m.check == check).map(|m| m.value)
}

/// Lists the lines of one table of a log.
fn summary(work: &IngestItem, exported: &ExportOutcome) -> String {
    let mut text = format!("\n{}", work.input.display());
    if !work.table().is_empty() {
        text += &format!(", {}", work.table());
    }
    text += &format!(" ({})\n", exported.format);
    let named =
        |(name, unit): &(String, String)| if unit.is_empty() { name.clone() } else { format!("{name} [{unit}]") };
    let columns_of: Vec<String> = exported.columns.iter().skip(3).map(named).collect();
    text += &format!("  columns: {}\n", columns_of.join(", "));
    let words = |w: &[&str]| w.iter().map(|x| (*x).to_owned()).collect::<Vec<String>>();
    let mut rows = vec![words(&["  flight", "line", "date", "from", "to", "rows", "Hz"])];
    /// Maximum number of lines listed per file.
    const SHOWN: usize = 40;
    for line in exported.lines.iter().take(SHOWN) {
        let date = line.date.map_or("-".to_owned(), |(year, day)| format!("{year}, day {day}"));
        rows.push(vec![
            format!("  {}", line.flight),
            line.line.clone(),
            date,
            clock(line.tt.0),
            clock(line.tt.1),
            line.rows.to_string(),
            number(value_of(line, "tt", QualityFigure::Rate)),
        ]);
    }
    text += &columns(&rows, 3);
    if exported.lines.len() > SHOWN {
        text += &format!("  and {} more\n", counted(exported.lines.len() - SHOWN, "line"));
    }
    let how = if exported.unchanged { "unchanged: " } else { "" };
    for file in &exported.files {
        text += &format!("  {how}{}\n", file.display());
    }
    text
}

/// Whether a figure is shown on the terminal. Irregularities and the properties of magnetometers are shown.
fn is_reported(measure: &QualityMeasure) -> bool {
    match measure.check {
        QualityFigure::Rate | QualityFigure::Jitter | QualityFigure::Midnight => false,
        // Estimated positions have a step at each fix, which is not an irregularity.
        QualityFigure::Spikes => {
            !measure.column.starts_with("ins_") && flight::describe(&measure.column).role != Role::Truth
        }
        QualityFigure::Noise | QualityFigure::Quantisation => {
            flight::is_scalar_reading(&measure.column) || flight::vector_part(&measure.column).is_some()
        }
        QualityFigure::Gaps
        | QualityFigure::LongestGap
        | QualityFigure::RepeatedTime
        | QualityFigure::BackwardTime
        | QualityFigure::Dropouts
        | QualityFigure::Stuck
        | QualityFigure::Saturation
        | QualityFigure::Preferred
        | QualityFigure::DeadZone
        | QualityFigure::PolarDeadZone
        | QualityFigure::EquatorialDeadZone
        | QualityFigure::Lag
        | QualityFigure::Found(_) => true,
    }
}

/// Table of the shown figures of all lines.
fn quality(works: &[IngestItem], results: &[Result<ExportOutcome, Fault>]) -> String {
    /// Maximum number of table rows on the terminal.
    const SHOWN: usize = 60;
    let words = |w: &[&str]| w.iter().map(|x| (*x).to_owned()).collect::<Vec<String>>();
    let mut rows = vec![words(&["  table", "flight", "line", "column", "check", "value", "unit", "count", "first at"])];
    for (work, result) in works.iter().zip(results) {
        let Ok(exported) = result else { continue };
        let table = if work.table().is_empty() { &work.name } else { work.table() };
        for line in &exported.lines {
            for m in line.measures.iter().filter(|m| is_reported(m)) {
                rows.push(vec![
                    format!("  {table}"),
                    line.flight.clone(),
                    line.line.clone(),
                    m.column.clone(),
                    m.check.as_str().to_owned(),
                    number(Some(m.value).filter(|x| x.is_finite())),
                    m.unit.clone(),
                    m.count.to_string(),
                    clock(m.first_tt),
                ]);
            }
        }
    }
    let found = rows.len() - 1;
    if found == 0 {
        return String::new();
    }
    rows.truncate(SHOWN + 1);
    let more =
        if found > SHOWN { format!("  and {} more, in the files of _quality\n", found - SHOWN) } else { String::new() };
    format!("\nquality\n{}{more}", columns(&rows, 5))
}

fn as_json(work: &IngestItem, exported: &ExportOutcome, line: &ExportLine) -> serde_json::Value {
    let finite = |x: f64| x.is_finite().then_some(x);
    let measure = |m: &QualityMeasure| {
        json!({
            "column": m.column, "check": m.check.as_str(), "value": finite(m.value), "unit": m.unit, "count": m.count,
            "first_tt": finite(m.first_tt),
        })
    };
    json!({
        "event": "line",
        "input": work.input.display().to_string(),
        "table": work.table(),
        "format": exported.format,
        "files": exported.files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>(),
        "unchanged": exported.unchanged,
        "flight": line.flight,
        "line": line.line,
        "rows": line.rows,
        "first_tt": finite(line.tt.0),
        "last_tt": finite(line.tt.1),
        "year": line.date.map(|d| d.0),
        "doy": line.date.map(|d| d.1),
        "faults": line.faults.iter().map(Fault::to_string).collect::<Vec<_>>(),
        "notes": exported.notes,
        "quality": line.measures.iter().map(measure).collect::<Vec<_>>(),
    })
}

/// Writes a suggested mapping for logs.
fn suggested(args: &IngestArgs) -> Result<(), ExitReason> {
    let mut logs = vec![];
    for input in &args.inputs {
        logs.extend(find(input, Path::new(""), args.format.is_some() || Path::new(input).is_file())?);
    }
    let options = FlightOptions { format: args.format.clone(), ..FlightOptions::default() };
    let system = suggest::KnownSystem::new(Path::new(""), args.epsg, None).map_err(Fault::from)?;
    let text = suggest::suggest_for(&logs, &options, flight_formats(), &system).map_err(Fault::from)?.text;
    let Some(to) = &args.output else {
        say::out_text(text);
        return Ok(());
    };
    let failed = |e: std::io::Error| ExitReason::Failed(format!("error: cannot write {}: {e}", to.display()));
    // An existing mapping is never overwritten.
    let mut file = fs::File::create_new(to).map_err(failed)?;
    std::io::Write::write_all(&mut file, text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)
}
