//! ULog, the self-describing log of PX4 autopilots. Each instance of a message is a topic, such as `vehicle_attitude`,
//! or `sensor_mag:1` for the second of several instances. [docs.px4.io, ULog File Format]
//!
//! The file is read twice: once to list and count its topics, and once for the values of one topic. The log has no
//! units. Time stamps are microseconds since the start of the autopilot, and some names end in a unit.

use std::path::Path;

use self::walk::{MAGIC, UlogScanner};
use super::{
    FileHead, FlightFormat, FlightOptions, LogTopic, RawFlight, ReadHints,
    records::{RecordBuffer, RecordColumn, WideIntegerScan, batches},
    stream::counted,
    topics::chosen,
};
use crate::ReadError;

mod definitions;
mod walk;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "ulog",
    about: "log of a PX4 autopilot, ULog; `topic` is a message; `sensor_mag:1` is the second instance of `sensor_mag`",
    extensions: &["ulg"],
    recognise: |head: &FileHead| head.starts_with(MAGIC),
    open,
    topics: Some(topics),
    made_from: None,
};

fn topics(path: &Path, _: &FlightOptions) -> Result<Vec<LogTopic>, ReadError> {
    let mut walk = UlogScanner::open(path)?;
    walk.finish(&mut |_, _| ())?;
    let topic = |t: &walk::UlogTopic| {
        let columns = t.layout.columns.iter().map(RecordColumn::topic_column).collect();
        LogTopic { name: t.spelt(), rows: t.rows, columns, note: t.lost().unwrap_or_default() }
    };
    Ok(walk.state.topics.iter().filter(|t| t.rows > 0 || t.lost().is_some()).map(topic).collect())
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    // The suffix `:0` is optional.
    let asked = options.topic.as_deref().map(|t| t.strip_suffix(":0").unwrap_or(t));
    let mut scan = UlogScanner::open(path)?;
    // Topics appear when they are subscribed. Without a name, the log must have one topic.
    let mut widths: Vec<Option<WideIntegerScan>> = vec![];
    loop {
        let wanted = |t: &walk::UlogTopic| asked.is_none_or(|name| t.spelt() == name);
        let new = scan.state.topics.iter().skip(widths.len());
        widths.extend(new.map(|t| wanted(t).then(|| WideIntegerScan::new(&t.layout.columns))));
        let more = scan.step(&mut |topic, record| {
            if let Some(Some(widths)) = widths.get_mut(topic) {
                widths.look(record);
            }
        })?;
        if !more {
            break;
        }
    }
    let held: Vec<usize> = (0..scan.state.topics.len()).filter(|i| scan.state.topics[*i].rows > 0).collect();
    let lost = |t: &&walk::UlogTopic| asked.is_none_or(|name| t.spelt() == name) && t.rows == 0;
    if (asked.is_some() || held.is_empty())
        && let Some(what) = scan.state.topics.iter().filter(lost).find_map(walk::UlogTopic::lost)
    {
        return Err(ReadError::data(path, what));
    }
    let names: Vec<(String, u64)> = held.iter().map(|i| &scan.state.topics[*i]).map(|t| (t.spelt(), t.rows)).collect();
    let number = held[chosen(path, asked, &names)?];
    let notes = notes(path, &scan, number);
    let layout = scan.state.topics[number].layout.clone();
    let widths = widths.swap_remove(number).unwrap_or_default();
    let records = RecordBuffer::new(layout.columns, widths, layout.least);
    let schema = records.schema().clone();
    let mut walk = UlogScanner::open(path)?;
    let parts = batches(path, records, move |records| {
        walk.step(&mut |topic, record| {
            if topic == number {
                records.push(record);
            }
        })
    });
    Ok(RawFlight { fillers: true, unstated: true, notes, ..RawFlight::new(schema, parts) })
}

/// Notes on the whole file.
fn notes(path: &Path, walk: &UlogScanner, number: usize) -> Vec<String> {
    let state = &walk.state;
    let mut notes = vec![];
    if state.version > 1 {
        notes.push(format!("version {} of the format is unknown; the file is read as version 1", state.version));
    }
    if state.dropouts > 0 {
        notes.push(format!(
            "{}, {} ms in total, because the logger was too slow",
            counted(state.dropouts, "dropout"),
            state.dropouts_ms
        ));
    }
    notes.extend(state.damage.note());
    if state.cut > 0 {
        notes.push(format!("the log ends in the middle of a message: {} skipped", counted(state.cut, "byte")));
    }
    if state.unknown > 0 {
        notes.push(format!("{} with unknown types or ids skipped", counted(state.unknown, "message")));
    }
    if state.unreadable > 0 {
        notes.push(format!(
            "{} skipped, with all messages that use them",
            counted(state.unreadable, "invalid definition")
        ));
    }
    notes.extend(misfits(&state.topics));
    if let Some(end) = state.appended.first().filter(|end| **end > walk.position()) {
        notes.push(format!("the data appended at byte {end} are missing: the file ends at byte {}", walk.position()));
    }
    if let Some(topic) = state.topics.get(number) {
        if state.contradicted().contains(&topic.name) {
            notes.push(format!("`{}` has two different definitions", topic.name));
        }
        if topic.others > 0 {
            notes.push(format!(
                "{} of `{}` skipped: the message was redefined with other fields",
                counted(topic.others, "message"),
                topic.spelt()
            ));
        }
    }
    let file = path.display();
    notes.into_iter().map(|note| format!("{file}: {note}")).collect()
}

/// Notes on the topics with messages that do not match their definition.
fn misfits(topics: &[walk::UlogTopic]) -> Vec<String> {
    /// Topics that are listed.
    const SHOWN: usize = 5;
    let mut notes: Vec<String> = topics.iter().filter_map(walk::UlogTopic::misfitting).collect();
    if let Some(more) = notes.len().checked_sub(SHOWN).filter(|more| *more > 0) {
        notes.truncate(SHOWN);
        notes.push(format!(
            "messages of {} do not match their definitions and were skipped",
            counted(more as u64, "further topic")
        ));
    }
    notes
}

#[cfg(test)]
mod tests;
