//! `magline init`: a commented spec for the user's own log.

mod findings;
mod text;

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::Args;
use datasets::{FlightOptions, MapOptions, has_map_extension, read_grid};
use intake::{
    flight_formats,
    mapping::{
        Mapping,
        detect::{MappingFit, fitting},
        suggest::{self, KnownSystem},
    },
};
use plan::{Plan, parse_spec, sources::Flights};
use schemas::{Fault, StageEntry, render};

use self::{
    findings::LogFindings,
    text::{InitSource, InitText},
};
use super::{ExitReason, choose, print_to_stderr, say, temporary::TemporaryFile};
use crate::shell::shell_word;

/// Arguments of `magline init`.
#[derive(Args)]
pub struct InitArgs {
    /// A log, and optionally an anomaly map.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The EPSG code of the log's eastings and northings. Default: a system in which these coordinates lie on the map.
    #[arg(long)]
    epsg: Option<u16>,
    /// The output file of the spec. Default: the name of the log with `.toml`. An existing file is not overwritten.
    #[arg(short, long)]
    output: Option<PathBuf>,
}

/// Runs the command.
pub fn run(catalogue: &[StageEntry], args: &InitArgs) -> Result<(), ExitReason> {
    let (maps, logs): (Vec<&PathBuf>, Vec<&PathBuf>) = args.files.iter().partition(|path| has_map_extension(path));
    let [log] = logs.as_slice() else {
        let what = format!("`magline init` requires exactly one log, not {}", logs.len());
        return Err(Fault::new(what).help("run `magline init` for each log, with a separate `-o SPEC.toml`").into());
    };
    let name = choose::plain(log);
    let spec = args.output.clone().unwrap_or_else(|| PathBuf::from(format!("{name}.toml")));
    let folder = spec.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
    let stem = choose::plain(&spec);
    let own = folder.join(format!("{stem}_mapping.toml"));
    if let Some(there) = [&spec, &own].into_iter().find(|path| path.exists()) {
        let what = format!("{} exists and is not overwritten", there.display());
        return Err(Fault::new(what).help("give another file with `-o`, or move the existing file").into());
    }
    let grid = maps.first().map(|path| read_grid(path, &MapOptions::default()).map_err(Fault::from));
    let on_map = grid.as_ref().and_then(|grid| grid.as_ref().ok());
    let source = source(log, &own, &KnownSystem::new(log, args.epsg, on_map).map_err(Fault::from)?)?;
    let found = LogFindings::read(log, &source)?;
    let mut map = None;
    let mut questions = source.questions.clone();
    questions.extend(found.questions.iter().cloned());
    match grid.as_ref().zip(maps.first()) {
        Some((Ok(_), path)) => map = Some(relative(path, &folder)?),
        Some((Err(e), _)) => questions.push(format!("the map is not used yet: {e}")),
        None => {}
    }
    let position = map.as_ref().and_then(|_| position_question(&found, source.own.as_ref().map(|_| shown(&own))));
    if let Some(question) = position {
        map = None;
        questions.push(question);
    }
    let mut writer = InitText {
        name: identifier(&stem),
        log: relative(log, &folder)?,
        mapping: source.own.as_ref().map(|_| format!("{stem}_mapping.toml")),
        source: &source,
        found: &found,
        navigates: map.is_some() && found.tables.iter().any(|table| table.has("ins_lat")),
        map,
        lines: None,
        questions,
    };
    if writer.navigates && !found.tables.iter().any(|table| table.has("ins_aligned")) {
        let question = "when was the INS aligned? Without this time, the filter chooses the more likely of two times: \
                        the start of each line, or one hour before it. Append the time as the column `ins_aligned`, \
                        in seconds past midnight UTC of the day of take-off";
        writer.questions.push(question.to_owned());
    }
    writer.lines = writer.halves(&stem);
    let parsed = |text: String| {
        let file = spec.display().to_string();
        parse_spec(&file, folder.clone(), text, &[]).and_then(|spec| Plan::new(spec, catalogue))
    };
    // The plan reads the files of the mapping and of the lines. These files are removed if the command fails.
    let lines = writer.lines.clone().map(|(name, text)| (folder.join(name), text));
    let mut drafts = vec![];
    for (path, text) in source.own.iter().map(|text| (own.clone(), text.clone())).chain(lines.clone()) {
        write_new(&path, &text)?;
        drafts.push(TemporaryFile::new(path));
    }
    let mut text = writer.text();
    // If the log or the map does not permit a stage, the spec contains a question instead. The other stages run.
    while let Err(faults) = parsed(text.clone()) {
        let why = faults.faults.first().map_or(String::new(), Fault::to_string);
        if writer.navigates {
            writer.navigates = false;
            writer.questions.push(format!("navigation is not possible yet: {why}"));
        } else if writer.map.take().is_some() {
            writer.questions.push(format!("the map is not used yet: {why}"));
        } else {
            break;
        }
        text = writer.text();
    }
    let checked = parsed(text.clone());
    // Lines with impossible values fail in a run.
    let implausible: Vec<Fault> =
        checked.iter().flat_map(|plan| plan.flights.iter().flat_map(Flights::implausible)).collect();
    write_new(&spec, &text)?;
    drafts.into_iter().for_each(TemporaryFile::keep);
    say::out_text(writer.summary());
    say::out_text(format!("\nwritten: {}\n", spec.display()));
    if source.own.is_some() {
        say::out_text(format!("written: {} (columns, units, time)\n", shown(&own).display()));
    }
    if let Some((path, _)) = &lines {
        say::out_text(format!("written: {} (two halves of the flight as lines)\n", shown(path).display()));
    }
    checked?;
    for fault in &implausible {
        print_to_stderr(&format!("warning: {}", render(fault, "", "").trim_start_matches("error: ").trim_end()));
    }
    say::out_text(format!("next: magline run {}\n", shell_word(&spec.to_string_lossy())));
    Ok(())
}

/// Question about missing position columns: without the position of the INS or the true position, no map value can be
/// computed. `None` if the log has one of these positions. `mapping` is the file of a suggested mapping.
fn position_question(found: &LogFindings, mapping: Option<&Path>) -> Option<String> {
    let missing = |names: [&'static str; 3]| -> Vec<&'static str> {
        let has = |name: &&str| found.tables.iter().any(|table| table.has(name));
        names.into_iter().filter(|name| !has(name)).collect()
    };
    let (own, ins) = (missing(["lat", "lon", "alt"]), missing(["ins_lat", "ins_lon", "ins_alt"]));
    if own.is_empty() || ins.is_empty() {
        return None;
    }
    let fewest = if ins.len() < own.len() { ins } else { own };
    let names = fewest.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let remedy = match (mapping, fewest.first()) {
        (Some(file), Some(name)) => {
            format!("Name the column of the log in {}, as in `{name} = {{ from = \"COLUMN\" }}`", file.display())
        }
        _ => "Append the columns to the log".to_owned(),
    };
    Some(format!("which columns give the position and the height? The map and the navigation need {names}. {remedy}"))
}

/// The source of a log, with no mapping, a built-in mapping or a suggested mapping. `own` is the file of a suggested
/// mapping, and `system` is the coordinate system of eastings and northings.
fn source(log: &Path, own: &Path, system: &KnownSystem) -> Result<InitSource, ExitReason> {
    let options = FlightOptions::default();
    let label = own.display().to_string();
    let parsed = |text: &str| Mapping::of_text(label.clone(), text.to_owned()).map(Arc::new);
    if let Some(best) = choose::fits(log, None)?.into_iter().next() {
        return builtin(best, parsed);
    }
    // Files with the names of the flight table need no mapping.
    let keyed = FlightOptions { flight: Some("1".to_owned()), line: Some("1".to_owned()), ..options.clone() };
    let opened = intake::open_log(log, &keyed, None, &datasets::ReadHints::default());
    let canonical =
        |names: &[&str]| names.contains(&"tt") && names.iter().any(|n| schemas::flight::is_scalar_reading(n));
    if let Ok(opened) = &opened {
        let names: Vec<&str> = opened.schema.fields().iter().map(|f| f.name().as_str()).collect();
        if canonical(&names) {
            return Ok(InitSource { builtin: None, mapping: None, own: None, unused: vec![], questions: vec![] });
        }
    }
    if let Some(best) = fitting(log, &options, flight_formats()).map_err(Fault::from)?.into_iter().next() {
        return builtin(best, parsed);
    }
    let suggestion = suggest::suggest(log, &options, flight_formats(), system).map_err(Fault::from)?;
    let mapping = Some(parsed(&suggestion.text)?);
    Ok(InitSource {
        builtin: None,
        mapping,
        own: Some(suggestion.text),
        unused: suggestion.unused,
        questions: suggestion.questions,
    })
}

/// The source of a log with the built-in mapping `best`.
fn builtin(best: MappingFit, parsed: impl Fn(&str) -> Result<Arc<Mapping>, Fault>) -> Result<InitSource, ExitReason> {
    let mut source = InitSource {
        builtin: Some(best.name),
        mapping: Some(best.mapping.clone()),
        own: None,
        unused: vec![],
        questions: vec![],
    };
    if best.lacks_start {
        let changed = best.mapping.with_epoch("{ unknown = true }")?;
        let head = format!(
            "# The built-in mapping {}, without its start time: the log has no GNSS fix. `tt` counts from the start of \
             the log.\n# If you know the start: epoch = {{ utc = \"2012-10-10T18:20:00Z\" }}\n",
            best.name
        );
        let text = head + changed.text();
        source.mapping = Some(parsed(&text)?);
        source.own = Some(text);
    }
    Ok(source)
}

/// Writes a file that must not exist.
fn write_new(path: &Path, text: &str) -> Result<(), ExitReason> {
    let failed = |e: std::io::Error| ExitReason::Failed(format!("error: cannot write {}: {e}", path.display()));
    let mut file = fs::File::create_new(path).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)
}

/// The path of a file in a spec: relative to the folder of the spec if the file is below it, otherwise absolute.
fn relative(path: &Path, folder: &Path) -> Result<String, ExitReason> {
    let whole =
        |p: &Path| p.canonicalize().map_err(|e| ExitReason::Wrong(format!("error: cannot read {}: {e}", p.display())));
    let (path, folder) = (whole(path)?, whole(folder)?);
    let short = path.strip_prefix(&folder).unwrap_or(&path);
    short
        .to_str()
        .map(str::to_owned)
        .ok_or_else(|| Fault::new(format!("the path {} is not UTF-8", path.display())).help("rename the file").into())
}

/// A path without a leading `./`.
fn shown(path: &Path) -> &Path {
    path.strip_prefix(".").unwrap_or(path)
}

/// A name of a pipeline: lower-case letters, digits and `_`, beginning with a letter.
fn identifier(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' };
    let name: String = name.chars().map(plain).take(40).collect();
    let name = name.trim_matches('_').to_owned();
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) { name } else { format!("log_{name}") }
}
