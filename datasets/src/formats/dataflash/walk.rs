//! The messages of a DataFlash log in sequence. A message has no checksum. It is valid only if the marks of another
//! message or the end of the file follow it, so that a message with lost bytes is rejected. Invalid bytes are skipped
//! up to the next valid message.

use std::{
    collections::HashMap,
    fs::File,
    path::{Path, PathBuf},
};

use super::{
    super::{
        records::{RecordFieldType, text},
        stream::{Damage, ForwardReader, counted},
    },
    definitions::{DataflashUnits, FMT, FMT_LENGTH, HEADER, MessageDefinition},
};
use crate::ReadError;

/// The first bytes of every message, followed by its type.
pub(super) const MARKS: &[u8] = &[0xa3, 0x95];
/// Size of the window in bytes: a message and the marks of the next.
const AHEAD: usize = 1 << 10;

/// A topic: the messages of one name and, if any, of one instance.
pub(super) struct DataflashTopic {
    pub(super) instance: Option<String>,
    /// The index of the definition in `layouts`.
    pub(super) layout: usize,
    /// Number of messages so far.
    pub(super) rows: u64,
}

/// First definition of a message name in the file, and the topics of that name.
pub(super) struct DataflashLayout {
    pub(super) definition: MessageDefinition,
    /// Number of messages of this name that have a later, different definition.
    pub(super) others: u64,
    /// The topic without an instance.
    plain: Option<usize>,
    /// Topics by the byte of the instance.
    by_byte: Vec<Option<usize>>,
    /// Topics by the name of the instance.
    by_name: HashMap<Vec<u8>, usize>,
}

impl DataflashLayout {
    fn new(definition: MessageDefinition) -> DataflashLayout {
        DataflashLayout { definition, others: 0, plain: None, by_byte: vec![None; 256], by_name: HashMap::new() }
    }

    #[inline]
    fn topic(&self, instance: &[u8]) -> Option<usize> {
        match instance {
            [] => self.plain,
            [byte] => self.by_byte.get(usize::from(*byte)).copied().flatten(),
            name => self.by_name.get(name).copied(),
        }
    }

    fn set_topic(&mut self, instance: &[u8], number: usize) {
        match instance {
            [] => self.plain = Some(number),
            [byte] => {
                if let Some(of) = self.by_byte.get_mut(usize::from(*byte)) {
                    *of = Some(number);
                }
            }
            name => {
                self.by_name.insert(name.to_vec(), number);
            }
        }
    }
}

/// A message type.
#[derive(Clone, Copy, Default)]
struct DataflashMessageType {
    /// Length with the header; 0 for an undefined type.
    length: u8,
    /// Definition; `None` if it is invalid.
    layout: Option<usize>,
    /// Whether the definition of the type equals the first definition of the message name.
    same: bool,
    /// Offset and length of the instance.
    instance: Option<(usize, RecordFieldType)>,
}

/// State of the scan of a DataFlash log: definitions, topics and skipped messages.
pub(super) struct DataflashScanState {
    /// The units in the whole file.
    units: DataflashUnits,
    types: Vec<DataflashMessageType>,
    /// The bodies of the FMT messages that define the types; a repeated definition has no effect.
    defined: Vec<Vec<u8>>,
    pub(super) layouts: Vec<DataflashLayout>,
    names: HashMap<String, usize>,
    pub(super) topics: Vec<DataflashTopic>,
    pub(super) damage: Damage,
    /// Number of bytes of a message that the end of the file truncates.
    pub(super) cut: u64,
    /// Number of messages of types without a definition.
    pub(super) unknown: u64,
    /// Number of invalid definitions.
    pub(super) unreadable: u64,
    /// Number of messages of types with an invalid definition.
    pub(super) undefined: u64,
    /// The names of the types with an invalid definition, if known, and the numbers of their messages.
    unnamed: HashMap<u8, (String, u64)>,
}

/// Classification of the bytes at a position.
#[derive(Clone, Copy, PartialEq)]
enum DataflashMatch {
    /// A message of this length.
    Message(usize),
    /// The start of a message that the end of the file truncates.
    Cut,
    /// The marks of a message with an undefined type.
    Unknown,
    Nothing,
}

/// Scanner of a DataFlash log: the file, the position in the file, and the state of the scan.
pub(super) struct DataflashScanner {
    path: PathBuf,
    forward: ForwardReader<File>,
    pub(super) state: DataflashScanState,
}

impl DataflashScanner {
    /// Opens a file and first reads its units and instances, which can be anywhere in it.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    pub(super) fn open(path: &Path) -> Result<DataflashScanner, ReadError> {
        let mut first = DataflashScanner::with(path, DataflashUnits::default())?;
        let mut units = DataflashUnits::default();
        first.finish(&mut |_, _, definition, body| units.add(definition, body))?;
        DataflashScanner::with(path, units)
    }

    fn with(path: &Path, units: DataflashUnits) -> Result<DataflashScanner, ReadError> {
        let forward = ForwardReader::open(path)?;
        let mut state = DataflashScanState {
            units,
            types: vec![DataflashMessageType::default(); 256],
            defined: vec![vec![]; 256],
            layouts: vec![],
            names: HashMap::new(),
            topics: vec![],
            damage: Damage::default(),
            cut: 0,
            unknown: 0,
            unreadable: 0,
            undefined: 0,
            unnamed: HashMap::new(),
        };
        state.define(FMT, Some(MessageDefinition::of_fmt()), FMT_LENGTH);
        Ok(DataflashScanner { path: path.to_path_buf(), forward, state })
    }

    /// A scanner of the same file with the same units, at the start of the file.
    ///
    /// # Errors
    /// Fails for a file that cannot be opened.
    pub(super) fn again(self) -> Result<DataflashScanner, ReadError> {
        DataflashScanner::with(&self.path, self.state.units)
    }

    /// Reads the next message and passes it to `visit` (topic, whether it is new, definition and body). Returns whether
    /// there was a message.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    #[inline]
    pub(super) fn step(
        &mut self,
        visit: &mut impl FnMut(usize, bool, &MessageDefinition, &[u8]),
    ) -> Result<bool, ReadError> {
        let DataflashScanner { path, forward, state } = self;
        let position = forward.position();
        let bytes = forward.ahead(AHEAD).map_err(|e| ReadError::io(path, &e))?;
        let taken = match state.found(bytes) {
            _ if bytes.is_empty() => return Ok(false),
            DataflashMatch::Message(length) if leads(bytes.get(length..).unwrap_or_default()) => {
                state.take(bytes.get(..length).unwrap_or_default(), visit);
                length
            }
            DataflashMatch::Cut => {
                state.cut += bytes.len() as u64;
                bytes.len()
            }
            found => {
                state.unknown += u64::from(found == DataflashMatch::Unknown);
                let skipped = state.next_message(bytes);
                state.damage.add(position, skipped as u64);
                skipped
            }
        };
        forward.skip(taken);
        Ok(true)
    }

    /// Reads to the end of the file.
    ///
    /// # Errors
    /// Fails in the cases of [`DataflashScanner::step`].
    pub(super) fn finish(
        &mut self,
        visit: &mut impl FnMut(usize, bool, &MessageDefinition, &[u8]),
    ) -> Result<(), ReadError> {
        while self.step(visit)? {}
        Ok(())
    }
}

/// Whether the bytes begin with the marks of a message, or the file ends.
#[inline]
fn leads(bytes: &[u8]) -> bool {
    bytes.iter().zip(MARKS).all(|(a, b)| a == b)
}

impl DataflashScanState {
    /// Classification of the first bytes. `bytes` has at least [`AHEAD`] bytes or extends to the end of the file.
    #[inline]
    fn found(&self, bytes: &[u8]) -> DataflashMatch {
        let Some((header, _)) = bytes.split_first_chunk::<HEADER>() else {
            return if leads(bytes) { DataflashMatch::Cut } else { DataflashMatch::Nothing };
        };
        if !header.starts_with(MARKS) {
            return DataflashMatch::Nothing;
        }
        match self.types.get(usize::from(header[2])).map_or(0, |t| usize::from(t.length)) {
            0 => DataflashMatch::Unknown,
            length if length <= bytes.len() => DataflashMatch::Message(length),
            _ => DataflashMatch::Cut,
        }
    }

    /// The offset of the next valid message. If there is no valid message, the number of bytes examined.
    fn next_message(&self, bytes: &[u8]) -> usize {
        let judged = if bytes.len() >= AHEAD { bytes.len() - AHEAD / 2 } else { bytes.len() };
        let stands = |at: &usize| {
            let bytes = bytes.get(*at..).unwrap_or_default();
            let led = |length: usize| leads(bytes.get(length..).unwrap_or_default());
            matches!(self.found(bytes), DataflashMatch::Message(length) if led(length))
        };
        (1..judged).find(stands).unwrap_or(judged.max(1))
    }

    #[inline]
    fn take(&mut self, message: &[u8], visit: &mut impl FnMut(usize, bool, &MessageDefinition, &[u8])) {
        let Some((header, body)) = message.split_first_chunk::<HEADER>() else { return };
        if header[2] == FMT {
            self.take_definition(body);
        }
        let Some(DataflashMessageType { layout: Some(at), same, instance, .. }) =
            self.types.get(usize::from(header[2])).copied()
        else {
            self.undefined += 1;
            if let Some((_, messages)) = self.unnamed.get_mut(&header[2]) {
                *messages += 1;
            }
            return;
        };
        let Some(layout) = self.layouts.get_mut(at) else { return };
        if !same {
            layout.others += 1;
            return;
        }
        let key = instance.and_then(|(at, kind)| body.get(at..at + kind.bytes())).unwrap_or_default();
        let (number, new) = match layout.topic(key) {
            Some(number) => (number, false),
            None => {
                let instance = instance.map(|(_, kind)| spelt(kind, key));
                self.topics.push(DataflashTopic { instance, layout: at, rows: 0 });
                layout.set_topic(key, self.topics.len() - 1);
                (self.topics.len() - 1, true)
            }
        };
        if let Some(topic) = self.topics.get_mut(number) {
            topic.rows += 1;
        }
        visit(number, new, &layout.definition, body);
    }

    fn take_definition(&mut self, body: &[u8]) {
        let Some((of, length)) = body.first().copied().zip(body.get(1).copied()) else { return };
        match self.defined.get_mut(usize::from(of)) {
            Some(known) if known != body => *known = body.to_vec(),
            _ => return,
        }
        let definition = MessageDefinition::parse(body).map(|(_, definition)| definition);
        // The length of the message is used even if the definition is invalid.
        if definition.is_none() {
            self.unreadable += 1;
            let name = text(body.get(2..6).unwrap_or_default());
            self.unnamed.entry(of).or_insert((name, 0));
        }
        self.define(of, definition, length);
    }

    /// Defines a type.
    fn define(&mut self, of: u8, definition: Option<MessageDefinition>, length: u8) {
        // FMT messages have a fixed definition, and a message is at least as long as its header.
        if (of == FMT && length != FMT_LENGTH) || usize::from(length) < HEADER {
            self.unreadable += u64::from(definition.is_some());
            return;
        }
        let mut known = DataflashMessageType { length, ..DataflashMessageType::default() };
        if let Some(mut definition) = definition {
            self.units.apply(of, &mut definition);
            known.instance = self.units.instance(of).and_then(|i| definition.field(i)).and_then(|c| {
                let plain = c.divisor == 1.0
                    && matches!(c.kind, RecordFieldType::U8 | RecordFieldType::I8 | RecordFieldType::Text(_));
                plain.then_some((c.offset, c.kind))
            });
            let at = *self.names.entry(definition.name.clone()).or_insert(self.layouts.len());
            if at == self.layouts.len() {
                self.layouts.push(DataflashLayout::new(definition.clone()));
            }
            known.same = self.layouts.get(at).is_some_and(|l| l.definition.is_like(&definition));
            known.layout = Some(at);
        }
        if let Some(of) = self.types.get_mut(usize::from(of)) {
            *of = known;
        }
    }

    /// The message names of which no message is readable, each with the reason.
    pub(super) fn lost(&self) -> Vec<(String, String)> {
        let named = |(name, _): &&(String, u64)| !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic());
        let unread = self.unnamed.values().filter(named).filter(|(name, n)| *n > 0 && !self.names.contains_key(name));
        let mut lost: Vec<(String, String)> = unread
            .map(|(name, n)| {
                let what = format!("{} of `{name}` skipped: its definition is inconsistent", counted(*n, "message"));
                (name.clone(), what)
            })
            .collect();
        lost.sort();
        lost
    }

    /// The name of a topic.
    pub(super) fn spelt(&self, topic: &DataflashTopic) -> String {
        let name = self.layouts.get(topic.layout).map_or("", |l| l.definition.name.as_str());
        topic.instance.as_ref().map_or_else(|| name.to_owned(), |instance| format!("{name}:{instance}"))
    }
}

/// An instance as text.
fn spelt(kind: RecordFieldType, bytes: &[u8]) -> String {
    match (kind, bytes) {
        (RecordFieldType::I8, [b]) => b.cast_signed().to_string(),
        (RecordFieldType::U8, [b]) => b.to_string(),
        _ => text(bytes),
    }
}
