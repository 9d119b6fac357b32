//! Mappings of foreign logs: TOML files that declare the meaning of a log's columns, with units, axes and clocks.
//!
//! A mapping has one or several tables, each of which reads one topic of a log. A table is checked against the columns
//! of a file before any row is read (`bind`). It then converts the rows batch by batch (`rows`). The format is
//! described in `datasets/mappings/README.md`.

mod bind;
mod clock;
mod columns;
mod declare;
pub mod detect;
mod document;
mod epoch;
mod make;
mod other_ready;
mod position;
mod row_value;
mod rows;
pub mod suggest;
#[cfg(test)]
mod tests;
mod time;
mod vector;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, PoisonError},
};

use datasets::{FlightOptions, ReadError, ReadHints, formats::FlightFormat, open_raw_among};
use schemas::{Fault, Params, keys::HashKey};

pub use datasets::mappings::READY;
pub use declare::{
    LogEpochKeys, MappingColumnKeys, MappingTableKeys, ProjectedPositionKeys, QuaternionKeys, RowIdentifierKeys,
    TimeStampKeys, VectorSensorKeys,
};
use document::{MappingDocument, TableDecl};
use rows::RepeatedRows;

use super::log_reader::LogReader;

/// Version of the conversion, increased when the same mapping gives other values for the same file.
const VERSION: &str = "mapping 2";

/// A mapping.
#[derive(Clone, Debug)]
pub struct Mapping {
    /// Path of the file, or the name of a built-in mapping followed by `.toml`.
    pub label: String,
    text: String,
    document: MappingDocument,
}

/// One table of a mapping.
#[derive(Clone, Debug)]
pub struct MappingTable {
    mapping: Arc<Mapping>,
    table: usize,
}

impl Mapping {
    /// Reads a mapping: the built-in mapping `name`, or the file that `locate` finds by that name.
    ///
    /// # Errors
    /// Returns the errors of `locate`. Also fails for a missing mapping, or with all faults of the mapping's form.
    pub fn load(name: &str, locate: impl FnOnce(&str) -> Result<PathBuf, Fault>) -> Result<Mapping, Fault> {
        if let Some(ready) = READY.iter().find(|r| r.name == name) {
            return Mapping::of_text(format!("{name}.toml"), ready.text.to_owned());
        }
        let path = locate(name)?;
        let looks_like_file = name.ends_with(".toml") || name.contains(['/', '\\']) || path.is_file();
        if !looks_like_file {
            let names: Vec<&str> = READY.iter().map(|r| r.name).collect();
            let fault = Fault::new(format!("there is no mapping `{name}`"));
            return Err(fault.nearest(name, &names));
        }
        let text = std::fs::read_to_string(&path).map_err(|e| {
            let fault = Fault::new(format!("cannot read the mapping {}: {e}", path.display()));
            fault.help(format!("ready ones: {}", READY.iter().map(|r| r.name).collect::<Vec<_>>().join(", ")))
        })?;
        Mapping::of_text(path.display().to_string(), text)
    }

    /// Parses the mapping `text`; messages call it `label`.
    ///
    /// # Errors
    /// Fails with all faults of the mapping's form.
    pub fn of_text(label: String, text: String) -> Result<Mapping, Fault> {
        match document::read(&text) {
            Ok(document) => Ok(Mapping { label, text, document }),
            Err(faults) => Err(ReadError::spec(Path::new(&label), &text, &faults).into()),
        }
    }

    /// Text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The mapping with another start time for all tables, such as `{ unknown = true }`.
    ///
    /// # Errors
    /// Fails for an epoch that is not valid.
    pub fn with_epoch(&self, epoch: &str) -> Result<Mapping, Fault> {
        let (mut kept, mut inside, mut placed) = (String::new(), false, false);
        for line in self.text.lines() {
            inside = line.trim_start().starts_with("[epoch]") || (inside && !line.starts_with('['));
            // Comments in the section belong to the next table.
            if (inside && !line.starts_with('#') && !line.is_empty()) || line.starts_with("epoch ") {
                continue;
            }
            if line.starts_with('[') && !placed {
                kept += &format!("epoch = {epoch}\n\n");
                placed = true;
            }
            kept += line;
            kept.push('\n');
        }
        Mapping::of_text(self.label.clone(), kept)
    }

    /// Purpose of the mapping.
    pub fn about(&self) -> &str {
        &self.document.about
    }

    /// The names of the mapping's tables.
    pub fn tables(&self) -> Vec<&str> {
        self.document.tables.iter().map(|t| t.name.as_str()).collect()
    }

    /// Table `name`; by default the only table.
    ///
    /// # Errors
    /// Fails for an unknown table, or for several tables without `name`.
    pub fn table(self: &Arc<Self>, name: Option<&str>) -> Result<MappingTable, Fault> {
        let tables = self.tables();
        let table = match (name, tables.as_slice()) {
            (None, [_]) => 0,
            (None, _) => {
                let what = format!("the mapping {} has {} tables; select one with `table`", self.label, tables.len());
                return Err(Fault::new(what).help(format!("its tables: {}", tables.join(", "))));
            }
            (Some(name), _) => tables.iter().position(|t| *t == name).ok_or_else(|| {
                Fault::new(format!("the mapping {} has no table `{name}`", self.label)).nearest(name, &tables)
            })?,
        };
        Ok(MappingTable { mapping: self.clone(), table })
    }

    /// Faults of the mapping, each with a position in the mapping.
    fn wrong(&self, faults: Vec<Fault>) -> ReadError {
        ReadError::spec(Path::new(&self.label), &self.text, &faults)
    }

    /// A fault of the mapping that only the data of a file reveal.
    fn in_data(&self, path: &Path, fault: Fault) -> ReadError {
        if fault.at.is_none() {
            return ReadError::data(path, fault.to_string());
        }
        let shown = schemas::render(&fault, &self.label, &self.text);
        ReadError::data(path, shown.strip_prefix("error: ").unwrap_or(&shown))
    }
}

/// Whether a fault already shows its position in a mapping. A position in a spec is then not required.
pub fn is_shown(fault: &Fault) -> bool {
    fault.what.contains("\n --> ") || fault.what.contains("\n  --> ") || fault.what.contains("\n   --> ")
}

/// A file and its topic, for messages.
fn place(path: &Path, topic: Option<&str>) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    topic.map_or(name.clone(), |topic| format!("`{topic}` of {name}"))
}

impl MappingTable {
    fn decl(&self) -> Option<&TableDecl> {
        self.mapping.document.tables.get(self.table)
    }

    /// The name of the table.
    pub fn name(&self) -> &str {
        self.decl().map_or("", |d| &d.name)
    }

    /// Mapping.
    pub fn mapping(&self) -> &Arc<Mapping> {
        &self.mapping
    }

    /// The topic that the table reads.
    pub fn topic(&self) -> Option<&str> {
        self.decl()?.head.value.topic.as_deref()
    }

    /// The format of the table's files, if given.
    pub fn format(&self) -> Option<String> {
        self.decl()?.head.value.format.clone()
    }

    /// Whether the table reads files of this name.
    pub fn is_in(&self, path: &Path) -> bool {
        let Some(pattern) = self.decl().and_then(|d| d.head.value.file.as_deref()) else { return true };
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        glob::Pattern::new(pattern).is_ok_and(|p| p.matches(&name))
    }

    /// Hash of the mapping's text and the table's name, part of the keys of results that depend on them.
    pub fn key(&self) -> HashKey {
        HashKey::from_parts([VERSION, &self.mapping.text, self.name()])
    }

    /// Path of another file next to `log` on which the values of the table depend.
    pub fn companion(&self, log: &Path) -> Option<PathBuf> {
        epoch::other_file(&self.decl()?.epoch.as_ref()?.value, log)
    }

    /// The options for reading the rows of a file under the file's own column names.
    fn raw_options(&self, options: &FlightOptions) -> FlightOptions {
        let head = self.decl().map(|d| d.head.value.clone()).unwrap_or_default();
        FlightOptions {
            topic: head.topic,
            format: options.format.clone().or(head.format),
            missing: options.missing.clone(),
            ..FlightOptions::default()
        }
    }

    /// Opens a file through the table.
    ///
    /// # Errors
    /// Fails if the file cannot be read. Also fails for all mismatches of mapping and file.
    pub fn open(
        &self,
        path: &Path,
        options: &FlightOptions,
        reading: &ReadHints,
        formats: &[FlightFormat],
    ) -> Result<LogReader, ReadError> {
        let decl = self.decl().ok_or_else(|| ReadError::options(path, "the mapping has no such table"))?;
        let raw = self.raw_options(options);
        let mut log = self.open_once(path, (options, &raw), reading, formats)?;
        let repeated_rows = repeated_rows(decl).map_err(|fault| self.mapping.wrong(vec![fault]))?;
        if repeated_rows != RepeatedRows::Keep {
            // The number of repeated rows is reported before any row is returned, so all rows are read here once to
            // count them.
            let (_, rows) = self.rows(path, (options, &raw), reading, formats)?;
            let count = rows.repeated();
            for part in rows {
                if part.is_err() {
                    break;
                }
            }
            let repeated = *count.lock().unwrap_or_else(PoisonError::into_inner);
            if repeated > 0 {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                log.notes.push(match repeated_rows {
                    RepeatedRows::AtRate(rate_hz) => format!(
                        "{name}: `{}` has {repeated} rows with the time of the previous row; they follow it at \
                         {rate_hz} Hz",
                        decl.name
                    ),
                    RepeatedRows::Drop | RepeatedRows::Keep => {
                        format!("{name}: `{}` drops {repeated} rows with the time of the previous row", decl.name)
                    }
                });
            }
        }
        Ok(log)
    }

    fn open_once(
        &self,
        path: &Path,
        options: (&FlightOptions, &FlightOptions),
        reading: &ReadHints,
        formats: &[FlightFormat],
    ) -> Result<LogReader, ReadError> {
        let (log, rows) = self.rows(path, options, reading, formats)?;
        Ok(LogReader { parts: Box::new(rows), ..log })
    }

    /// The reader of a file's rows, and the properties of the rows that are known in advance.
    fn rows(
        &self,
        path: &Path,
        (options, raw): (&FlightOptions, &FlightOptions),
        reading: &ReadHints,
        formats: &[FlightFormat],
    ) -> Result<(LogReader, rows::MappingReader), ReadError> {
        let decl = self.decl().ok_or_else(|| ReadError::options(path, "the mapping has no such table"))?;
        let reader = open_raw_among(formats, path, raw, reading)?;
        let mut notes = reader.notes().to_vec();
        let is_boot = decl.time.value.clock == Some(declare::ClockZero::Boot);
        let mut instant = None;
        if is_boot {
            let found = epoch::find(&self.mapping, decl, (path, raw), formats)?;
            notes.extend(Some(found.note).filter(|n| !n.is_empty()));
            instant = found.instant;
        }
        let schema = reader.schema().clone();
        let mut columns = columns::MappingColumns::new(&schema, place(path, raw.topic.as_deref()));
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let given = bind::GivenKeys { flight: options.flight.as_deref(), line: options.line.as_deref(), stem: &stem };
        let bound = bind::MappingBinding::new(decl, &mut columns, given, instant);
        let bound = match bound {
            Some(bound) if columns.faults.is_empty() => bound,
            _ => return Err(self.mapping.wrong(columns.faults)),
        };
        notes.extend(bound.notes.iter().cloned());
        let log = LogReader {
            format: reader.format(),
            schema: bound.schema.clone(),
            notes,
            found: reader.found().map(str::to_owned),
            made_from: reader.made_from(),
            parts: Box::new(std::iter::empty()),
        };
        let repeated = repeated_rows(decl).map_err(|fault| self.mapping.wrong(vec![fault]))?;
        Ok((log, rows::MappingReader::new(reader, bound, self.mapping.clone(), path.to_owned(), repeated)))
    }
}

/// Treatment of rows that repeat the time of the previous row, for a table of a mapping.
///
/// # Errors
/// Fails for a table that both drops and moves such rows.
fn repeated_rows(decl: &TableDecl) -> Result<RepeatedRows, Fault> {
    let keys = &decl.head.value;
    match (keys.drop_repeated, keys.repeated_rate_hz) {
        (true, Some(_)) => {
            let what = "`drop_repeated` drops the rows to which `repeated_rate_hz` gives a time";
            Err(Fault::new(what).help("remove one of the two keys").at(decl.head.at("repeated_rate_hz")))
        }
        (true, None) => Ok(RepeatedRows::Drop),
        (false, Some(rate_hz)) => Ok(RepeatedRows::AtRate(rate_hz)),
        (false, None) => Ok(RepeatedRows::Keep),
    }
}

/// The tables of the reference that list every key of a mapping.
pub fn reference() -> String {
    let lists = schemas::ChoiceRegistry::default();
    let groups = [
        ("[tables.NAME]", [MappingTableKeys::docs(&lists), declare::AttitudeKeys::docs(&lists)].concat()),
        ("time", TimeStampKeys::docs(&lists)),
        ("epoch (and the keys of `time`)", LogEpochKeys::docs(&lists).into_iter().take(8).collect()),
        ("flight, line", RowIdentifierKeys::docs(&lists)),
        ("columns", MappingColumnKeys::docs(&lists)),
        ("vectors", VectorSensorKeys::docs(&lists)),
        ("quaternions", QuaternionKeys::docs(&lists)),
        ("projected", ProjectedPositionKeys::docs(&lists)),
    ];
    let mut text = String::new();
    for (title, docs) in groups {
        text += &format!("\n`{title}`\n\n| key | type | unit | default | values | |\n|---|---|---|---|---|---|\n");
        text.extend(docs.iter().map(|d| d.row("")));
    }
    text.trim_start().to_owned()
}
