//! The built-in mappings that fit a log, by its topics, columns and units. File names and dates are not used.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use arrow_array::cast::AsArray;
use arrow_cast::cast;
use arrow_schema::{DataType, SchemaRef};
use datasets::{
    FlightOptions, LogTopic, ReadError, ReadHints, flight_format_of, formats::FlightFormat, open_raw_among,
    topics_among,
};

use super::{Mapping, READY, bind, columns::MappingColumns, declare::ClockZero, document::TableDecl, epoch, place};

/// Minimum number of columns that identify a log without topics.
const RECOGNISABLE: usize = 3;

/// A built-in mapping with at least one table that reads a log.
#[derive(Clone, Debug)]
pub struct MappingFit {
    /// The mapping.
    pub mapping: Arc<Mapping>,
    /// Name in the key `mapping`.
    pub name: &'static str,
    /// The names of the mapping's tables that read the log.
    pub tables: Vec<String>,
    /// The names of the mapping's other tables.
    pub missing: Vec<String>,
    /// Whether the mapping requires a start time that the log does not contain, for example because the log has no GNSS
    /// fix.
    pub lacks_start: bool,
}

/// The built-in mappings that fit a log, the one with most tables first; empty if none fits.
///
/// # Errors
/// Fails for a log that cannot be read.
pub fn fitting(path: &Path, options: &FlightOptions, formats: &[FlightFormat]) -> Result<Vec<MappingFit>, ReadError> {
    let format = flight_format_of(formats, path, options)?;
    let topics = topics_among(formats, path, options)?;
    let mut log = LogTopics { path, options, formats, topics, known: BTreeMap::new() };
    let mut found = vec![];
    for ready in READY {
        let mapping = Mapping::of_text(format!("{}.toml", ready.name), ready.text.to_owned());
        let Ok(mapping) = mapping.map(Arc::new) else { continue };
        let (mut tables, mut missing, mut lacks_start) = (vec![], vec![], false);
        for (number, decl) in mapping.document.tables.iter().enumerate() {
            let table = super::MappingTable { mapping: mapping.clone(), table: number };
            let of_format = decl.head.value.format.as_deref().is_none_or(|f| f == format);
            if !(of_format && table.is_in(path) && log.fits(decl)) {
                missing.push(decl.name.clone());
                continue;
            }
            // The tables share one start time.
            if tables.is_empty() && decl.time.value.clock == Some(ClockZero::Boot) {
                let raw = table.raw_options(options);
                lacks_start = epoch::find(&mapping, decl, (path, &raw), formats).is_err();
            }
            tables.push(decl.name.clone());
        }
        if !tables.is_empty() {
            found.push(MappingFit { mapping, name: ready.name, tables, missing, lacks_start });
        }
    }
    found.sort_by_key(|fit| std::cmp::Reverse(fit.tables.len()));
    Ok(found)
}

/// The autopilot and its version, as an ArduPilot log gives them in its messages; `None` for other logs.
pub fn firmware(path: &Path, options: &FlightOptions, formats: &[FlightFormat]) -> Option<String> {
    let options = FlightOptions { topic: Some("MSG".to_owned()), ..options.clone() };
    let mut reader = open_raw_among(formats, path, &options, &ReadHints::default()).ok()?;
    let batch = reader.next_part()?.ok()?.batch;
    let texts = batch.columns().iter().filter_map(|c| cast(c, &DataType::Utf8).ok());
    let words = ["copter", "plane", "rover", "ardu", "apm:"];
    let mut all = texts.flat_map(|c| c.as_string::<i32>().iter().flatten().map(str::to_owned).collect::<Vec<_>>());
    all.find(|text| words.iter().any(|word| text.to_lowercase().contains(word)))
}

/// The topics of a log. The columns of each topic are read once.
struct LogTopics<'a> {
    path: &'a Path,
    options: &'a FlightOptions,
    formats: &'a [FlightFormat],
    topics: Vec<LogTopic>,
    known: BTreeMap<Option<String>, Option<SchemaRef>>,
}

impl LogTopics<'_> {
    /// Whether all columns of a table are in the log, with units that convert.
    fn fits(&mut self, decl: &TableDecl) -> bool {
        let topic = decl.head.value.topic.clone();
        let own = decl.epoch.as_ref().and_then(|epoch| epoch.value.topic.clone());
        if own.is_some_and(|own| self.schema(Some(own)).is_none()) {
            return false;
        }
        let Some(schema) = self.schema(topic.clone()) else { return false };
        let mut columns = MappingColumns::new(&schema, place(self.path, topic.as_deref()));
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let given = bind::GivenKeys { flight: Some("1"), line: Some("1"), stem: &stem };
        let bound = bind::MappingBinding::new(decl, &mut columns, given, None);
        // Without a topic, a table with few columns could fit any log with a common name such as `time`.
        let named = topic.is_some() || decl.columns.len() + 3 * decl.vectors.len() >= RECOGNISABLE;
        bound.is_some() && columns.faults.is_empty() && named
    }

    /// The columns of a topic with rows; `None` if the log has no such topic.
    fn schema(&mut self, topic: Option<String>) -> Option<SchemaRef> {
        if let Some(known) = self.known.get(&topic) {
            return known.clone();
        }
        let single = self.topics.iter().all(|t| t.name.is_empty());
        let has_rows = |name: &str| self.topics.iter().any(|t| t.note.is_empty() && same(&t.name, name));
        let there = topic.as_deref().map_or(single, has_rows);
        let options = FlightOptions { topic: topic.clone(), ..self.options.clone() };
        let read = || open_raw_among(self.formats, self.path, &options, &ReadHints::default()).ok();
        let schema = there.then(read).flatten().map(|reader| reader.schema().clone());
        self.known.insert(topic, schema.clone());
        schema
    }
}

/// Whether two names mean the same topic. A topic without a number is the first instance.
fn same(a: &str, b: &str) -> bool {
    let plain = |name: &str| name.strip_suffix(":0").unwrap_or(name).to_owned();
    plain(a) == plain(b)
}
