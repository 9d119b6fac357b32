//! DataFlash, the self-describing binary log of ArduPilot. The messages of one name are a topic, such as `MAG`. If the
//! definition marks an instance (unit `#`), each instance is a topic, such as `MAG:0`. [ardupilot.org, Logs;
//! AP_Logger/LogStructure.h]
//!
//! Numbers with a scaling format are scaled as in pymavlink (`c`, `C`, `e`, `E` hundredths, `L` 1e-7 degrees). All
//! others keep their logged values. Their unit comes from the FMTU, UNIT and MULT messages and includes the multiplier.
//! Logs before 2018 lack such messages and have units only for time, latitude and longitude.
//!
//! The file is read three times: for its units, to list and count its topics, and for the values of one topic.

use std::path::Path;

use self::walk::{DataflashScanner, MARKS};
use super::{
    FileHead, FlightFormat, FlightOptions, LogTopic, RawFlight, ReadHints,
    records::{RecordBuffer, RecordColumn, WideIntegerScan, batches},
    stream::counted,
    topics::{chosen, listed},
};
use crate::ReadError;

mod definitions;
mod walk;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "dataflash",
    about: "DataFlash binary log of an ArduPilot autopilot; `topic` is a message, or an instance such as `MAG:1`",
    extensions: &["bin"],
    recognise: |head: &FileHead| head.starts_with(MARKS),
    open,
    topics: Some(topics),
    made_from: None,
};

fn topics(path: &Path, _: &FlightOptions) -> Result<Vec<LogTopic>, ReadError> {
    let mut walk = DataflashScanner::open(path)?;
    walk.finish(&mut |_, _, _, _| ())?;
    some_message(path, &walk)?;
    let topic = |t: &walk::DataflashTopic| {
        let columns = walk.state.layouts.get(t.layout).map(|l| l.definition.columns.iter());
        let columns = columns.into_iter().flatten().map(RecordColumn::topic_column).collect();
        LogTopic { name: walk.state.spelt(t), rows: t.rows, columns, note: String::new() }
    };
    let topics = walk.state.topics.iter().map(topic);
    let lost = |(name, note)| LogTopic { name, rows: 0, columns: vec![], note };
    Ok(topics.chain(walk.state.lost().into_iter().map(lost)).collect())
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let mut scan = DataflashScanner::open(path)?;
    let asked = options.topic.as_deref();
    let mut widths: Vec<Option<WideIntegerScan>> = vec![];
    scan.finish(&mut |topic, new, definition, body| {
        if new {
            let wanted = asked.is_none_or(|t| t.split(':').next() == Some(definition.name.as_str()));
            widths.push(wanted.then(|| WideIntegerScan::new(&definition.columns)));
        }
        if let Some(Some(widths)) = widths.get_mut(topic) {
            widths.look(body);
        }
    })?;
    some_message(path, &scan)?;
    let state = &scan.state;
    if let Some((_, what)) = state.lost().into_iter().find(|(name, _)| asked == Some(name.as_str())) {
        return Err(ReadError::data(path, what));
    }
    let names: Vec<(String, u64)> = state.topics.iter().map(|t| (state.spelt(t), t.rows)).collect();
    let number = chosen(path, instance(path, asked, &names)?, &names)?;
    let notes = notes(path, &scan, number);
    let definition = scan.state.layouts[scan.state.topics[number].layout].definition.clone();
    let widths = widths.swap_remove(number).unwrap_or_default();
    let stride = usize::from(definition.length) - definitions::HEADER;
    let records = RecordBuffer::new(definition.columns, widths, stride);
    let schema = records.schema().clone();
    let mut walk = scan.again()?;
    let parts = batches(path, records, move |records| {
        walk.step(&mut |topic, _, _, body| {
            if topic == number {
                records.push(body);
            }
        })
    });
    Ok(RawFlight { fillers: true, unstated: true, notes, ..RawFlight::new(schema, parts) })
}

fn some_message(path: &Path, walk: &DataflashScanner) -> Result<(), ReadError> {
    if walk.state.topics.is_empty() {
        return Err(ReadError::data(path, "the file is not a DataFlash log: it holds no valid message"));
    }
    Ok(())
}

/// The requested topic. A name without an instance selects the only instance.
fn instance<'a>(path: &Path, asked: Option<&'a str>, names: &'a [(String, u64)]) -> Result<Option<&'a str>, ReadError> {
    let Some(name) = asked.filter(|name| !names.iter().any(|(known, _)| known == name)) else { return Ok(asked) };
    let of = |(known, _): &&(String, u64)| known.split_once(':').is_some_and(|(message, _)| message == name);
    let instances: Vec<(String, u64)> = names.iter().filter(of).cloned().collect();
    match instances.as_slice() {
        [] => Ok(asked),
        [_] => Ok(names.iter().find(of).map(|(known, _)| known.as_str())),
        _ => {
            let what = format!("`{name}` has {} instances; set `topic` to one of them", instances.len());
            Err(ReadError::options(path, what)
                .help(format!("the instances and their numbers of rows: {}", listed(&instances))))
        }
    }
}

/// Notes on the whole file.
fn notes(path: &Path, walk: &DataflashScanner, number: usize) -> Vec<String> {
    let state = &walk.state;
    let mut notes = vec![];
    notes.extend(state.damage.note());
    if state.cut > 0 {
        notes.push(format!("the log ends in the middle of a message: {} skipped", counted(state.cut, "byte")));
    }
    if state.unknown > 0 {
        notes.push(format!("{} skipped, because the types are not defined", counted(state.unknown, "message")));
    }
    if state.unreadable > 0 {
        notes.push(format!(
            "{}; {} skipped",
            counted(state.unreadable, "invalid definition"),
            counted(state.undefined, "message")
        ));
    }
    if let Some(layout) = state.topics.get(number).and_then(|t| state.layouts.get(t.layout)).filter(|l| l.others > 0) {
        let (others, name) = (counted(layout.others, "message"), &layout.definition.name);
        notes.push(format!("{others} of `{name}` skipped: the message was redefined with other fields"));
    }
    let file = path.display();
    notes.into_iter().map(|note| format!("{file}: {note}")).collect()
}

#[cfg(test)]
mod tests;
