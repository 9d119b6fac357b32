//! Time at which the clock of a log was 0, from the mapping or from a topic with two clocks (the log's clock and UTC),
//! such as GNSS fixes.

use std::path::{Path, PathBuf};

use datasets::{FlightOptions, ReadError, ReadHints, formats::FlightFormat, open_raw_among};
use numerics::regression::statistics::median;
use schemas::Fault;

use super::{
    Mapping,
    bind::MappingBinding,
    clock::{UtcInstant, date_text, read_instant},
    columns::MappingColumns,
    declare::{LogEpochKeys, MappingColumnKeys, MappingTableKeys},
    document::{KeyDecl, SpannedValue, TableDecl},
    time::{BootColumn, RowTimes},
};

/// Instant at which the clock of a log was 0, and a note on its source.
pub struct LogEpoch {
    /// The instant; `None` if unknown.
    pub instant: Option<UtcInstant>,
    /// Note for the user.
    pub note: String,
}

/// Maximum range of the difference between two clocks over all rows, in seconds. A larger range means that a clock was
/// adjusted.
const SET_S: f64 = 5.0;

/// Path of the file next to `log` that holds both clocks, if the epoch names a file.
pub fn other_file(epoch: &LogEpochKeys, log: &Path) -> Option<PathBuf> {
    epoch.file.as_ref().map(|name| log.with_file_name(name))
}

/// Instant at which the clock of `log` was 0.
///
/// # Errors
/// Fails if the mapping has no epoch, or if the topic has no valid time.
pub fn find(
    mapping: &Mapping,
    decl: &TableDecl,
    (log, options): (&Path, &FlightOptions),
    formats: &[FlightFormat],
) -> Result<LogEpoch, ReadError> {
    let Some(epoch) = &decl.epoch else {
        let fault = Fault::new("the time counts from the start of the log, but the start time is unknown");
        let help = "set `epoch`: a `utc` time, a `topic` with both clocks, or `unknown = true`";
        return Err(mapping.wrong(vec![fault.help(help).at(decl.time.at.clone())]));
    };
    let declared = &epoch.value;
    let name = log.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let found = [declared.unknown, declared.utc.is_some(), !declared.stamp.from.is_empty()];
    if found.iter().filter(|x| **x).count() != 1 {
        let fault = Fault::new("`epoch` requires one of `utc`, `from` and `unknown`");
        return Err(mapping.wrong(vec![fault.at(epoch.at.clone())]));
    }
    if declared.unknown {
        let note = format!(
            "{name}: `tt` is the time since the start of the log; the time of day and the date of the start are \
             unknown"
        );
        return Ok(LogEpoch { instant: None, note });
    }
    if let Some(utc) = &declared.utc {
        let Some(instant) = read_instant(utc) else {
            let fault = Fault::new(format!("`utc` cannot be `{utc}`"));
            let help = "write it as `2012-10-10` or `2012-10-10T18:20:00Z`";
            return Err(mapping.wrong(vec![fault.help(help).at(epoch.at("utc"))]));
        };
        return Ok(LogEpoch { instant: Some(instant), note: String::new() });
    }
    let Some(boot) = &declared.boot else {
        let fault = Fault::new("`epoch` requires `boot`, the column of the log's own clock");
        return Err(mapping.wrong(vec![fault.at(epoch.at.clone())]));
    };
    let path = other_file(declared, log).unwrap_or_else(|| log.to_owned());
    let topic = declared.topic.clone().or_else(|| decl.head.value.topic.clone().filter(|_| declared.file.is_none()));
    let options = FlightOptions { topic: topic.clone(), ..options.clone() };
    let reader = open_raw_among(formats, &path, &options, &ReadHints::default());
    let mut reader = reader.map_err(|e| e.help(format!("the epoch of `{}` is read from this file", decl.name)))?;
    let schema = reader.schema().clone();
    let place = super::place(&path, topic.as_deref());
    let mut columns = MappingColumns::new(&schema, place.clone());
    let table = as_table(decl, epoch);
    let bound = MappingBinding::new(&table, &mut columns, super::bind::GivenKeys::default(), None);
    let unit = declared.boot_unit.as_deref();
    let boot = BootColumn::new(boot, unit, epoch.at("boot"), &mut columns);
    if let Some(bound) = bound.as_ref().filter(|b| columns.faults.is_empty() && !b.time.is_dated()) {
        let what = if bound.time.is_boot() { "`boot`" } else { "a clock without a date" };
        let fault = Fault::new(format!("{what} does not give the start time of the log"));
        columns.push(fault.help("use `unix`, `gps`, or `text` with a date").at(epoch.at("clock")));
    }
    let (Some(mut bound), Some(boot), true) = (bound, boot, columns.faults.is_empty()) else {
        return Err(mapping.wrong(columns.faults));
    };
    let mut starts: Vec<UtcInstant> = vec![];
    let mut last = None;
    while let Some(part) = reader.next_part() {
        let batch = part?.batch;
        let own = boot.read(&batch).map_err(|f| mapping.in_data(&path, f))?;
        let kept = bound.kept(&batch).map_err(|f| mapping.in_data(&path, f))?;
        let (times, _) = bound.time.read(&batch).map_err(|f| mapping.in_data(&path, f))?;
        let RowTimes::Dated(times) = times else { continue };
        for (row, (time, own)) in times.iter().zip(&own).enumerate() {
            let is_kept = kept.as_ref().is_none_or(|k| k.get(row).copied().unwrap_or(false));
            let (Some(time), true, true) = (time, own.is_finite(), is_kept) else { continue };
            // If a time is repeated until the next fix, only its first row is valid.
            if last.replace(*time) != Some(*time) {
                starts.push(time.plus(-(own + declared.boot_offset_s)));
            }
        }
    }
    let Some(day) = starts.first().map(|s| s.day) else {
        let fault = Fault::data(format!("no row of {place} gives the start time of the log"));
        let help = "set `epoch = { utc = \"2012-10-10T18:20:00Z\" }`, or `{ unknown = true }`, in your own mapping";
        return Err(mapping.wrong(vec![fault.help(help).at(epoch.at.clone())]));
    };
    let mut seconds: Vec<f64> = starts.iter().map(|s| s.seconds_since(day)).collect();
    let (low, high) = seconds.iter().fold((f64::MAX, f64::MIN), |(l, h), s| (l.min(*s), h.max(*s)));
    let instant = UtcInstant::new(day, median(&mut seconds));
    let set = if high - low > SET_S { "; one of the clocks was adjusted during the recording" } else { "" };
    let note = format!(
        "{name}: its clock read 0 on {} at {} UTC (the median of {} rows in {place}, which differ by up to {:.3} \
         s){set}",
        date_text(instant.day),
        time_text(instant.s),
        starts.len(),
        high - low,
    );
    Ok(LogEpoch { instant: Some(instant), note })
}

fn time_text(s: f64) -> String {
    let ms = (s * 1e3).round() as u64;
    let (h, m) = (ms / 3_600_000, ms / 60_000 % 60);
    format!("{h:02}:{m:02}:{:06.3}", (ms % 60_000) as f64 / 1e3)
}

/// The rows of an epoch as a table: their times, their condition, and one unused column.
fn as_table(decl: &TableDecl, epoch: &SpannedValue<LogEpochKeys>) -> TableDecl {
    let head = MappingTableKeys { rows: epoch.value.rows.clone(), ..MappingTableKeys::default() };
    let nothing =
        MappingColumnKeys { value: Some(super::declare::ConstantValue::Number(0.0)), ..MappingColumnKeys::default() };
    let placed = SpannedValue { value: nothing, args: schemas::SpecEntries::default(), at: epoch.at.clone() };
    TableDecl {
        name: decl.name.clone(),
        head: SpannedValue { value: head, args: epoch.args.clone(), at: epoch.at.clone() },
        flight: Some(KeyDecl::Constant(String::new())),
        line: Some(KeyDecl::Constant(String::new())),
        time: SpannedValue { value: epoch.value.stamp.clone(), args: epoch.args.clone(), at: epoch.at.clone() },
        epoch: None,
        columns: vec![("nothing".to_owned(), placed)],
        vectors: vec![],
        quaternions: vec![],
        projected: None,
    }
}
