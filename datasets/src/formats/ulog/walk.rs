//! The messages of a ULog file in sequence. A message is valid only if another message or the end of the file follows
//! it, so that a message with lost bytes is rejected. Invalid bytes are skipped up to the next valid message.

use std::{
    collections::HashMap,
    fs::File,
    path::{Path, PathBuf},
};

use super::{
    super::{
        records::text,
        stream::{Damage, ForwardReader, counted},
    },
    definitions::{UlogFormats, UlogMessageLayout, is_name},
};
use crate::ReadError;

/// The first bytes of every file, followed by the version and the time.
pub(super) const MAGIC: &[u8] = b"ULog\x01\x12\x35";
const HEADER: usize = 16;
const SYNC: &[u8] = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12";
/// Size of the window in bytes: four messages of about the maximum length.
const AHEAD: usize = 1 << 18;
/// Maximum length of a message of an unknown type, as in pyulog.
const LONGEST_UNKNOWN: usize = 10_000;
/// Maximum length of the text of a log message; PX4 writes 127 characters.
const LONGEST_TEXT: usize = 2048;
const NO_ID: u32 = u32::MAX;
/// Maximum number of columns of all topics together: a log has thousands; a damaged one could declare any number.
const MOST_COLUMNS: usize = 1 << 20;

/// A topic: the messages of one name and instance.
pub(super) struct UlogTopic {
    pub(super) name: String,
    pub(super) instance: u8,
    pub(super) layout: UlogMessageLayout,
    /// Number of messages so far.
    pub(super) rows: u64,
    /// Number of messages that have another layout because the topic's format was redefined.
    pub(super) others: u64,
    /// Messages that are shorter or longer than their definition.
    pub(super) misfits: LengthMismatches,
}

/// Messages of a topic that do not match its definition.
#[derive(Default)]
pub(super) struct LengthMismatches {
    pub(super) messages: u64,
    /// Minimum and maximum of their lengths in bytes.
    pub(super) bytes: Option<(usize, usize)>,
}

impl LengthMismatches {
    fn add(&mut self, bytes: usize) {
        self.messages += 1;
        let (least, most) = self.bytes.unwrap_or((bytes, bytes));
        self.bytes = Some((least.min(bytes), most.max(bytes)));
    }
}

impl UlogTopic {
    /// Name of the topic in the options; the name of instance 0 has no number.
    pub(super) fn spelt(&self) -> String {
        if self.instance == 0 { self.name.clone() } else { format!("{}:{}", self.name, self.instance) }
    }

    /// A note on the messages of the topic that do not match its definition.
    pub(super) fn misfitting(&self) -> Option<String> {
        let range = |(least, most): (usize, usize)| {
            if least == most { format!("{least}") } else { format!("{least} to {most}") }
        };
        let found = range(self.misfits.bytes?);
        let defined = range((self.layout.least, self.layout.most));
        let (count, name) = (counted(self.misfits.messages, "message"), self.spelt());
        Some(format!("{count} of `{name}` skipped: each has {found} bytes, but the definition has {defined} bytes"))
    }

    /// The reason for a topic without rows; `None` if it has rows, or no messages at all.
    pub(super) fn lost(&self) -> Option<String> {
        let misfitting = self.misfitting().filter(|_| self.rows == 0);
        let others = || {
            let (count, name) = (counted(self.others, "message"), self.spelt());
            format!("{count} of `{name}` skipped: the message was redefined with other fields")
        };
        misfitting.or_else(|| (self.rows == 0 && self.others > 0).then(others))
    }
}

/// A subscription, which assigns an id of data messages to a topic.
struct Subscription {
    topic: usize,
    least: usize,
    most: usize,
    /// Whether its layout equals the layout of the topic.
    same: bool,
}

/// State of the scan of a ULog file: formats, topics, subscriptions and skipped messages.
pub(super) struct UlogScanState {
    formats: UlogFormats,
    pub(super) topics: Vec<UlogTopic>,
    /// The position of each topic in `topics`.
    numbers: HashMap<(String, u8), usize>,
    /// Number of columns of all topics.
    columns: usize,
    subscriptions: Vec<Subscription>,
    /// The subscription of each id.
    ids: Vec<u32>,
    pub(super) version: u8,
    /// Positions of appended data, in descending order; the message before each position may be truncated.
    pub(super) appended: Vec<u64>,
    pub(super) dropouts: u64,
    pub(super) dropouts_ms: u64,
    pub(super) damage: Damage,
    /// Number of bytes of messages that are truncated at the end of the file or where data were appended.
    pub(super) cut: u64,
    /// Number of messages with ids or types without a definition.
    pub(super) unknown: u64,
    /// Number of formats and subscriptions that could not be read.
    pub(super) unreadable: u64,
}

/// Classification of the bytes at a position.
#[derive(Clone, Copy, PartialEq)]
enum UlogMatch {
    /// A message of a known type and this length.
    Sure(usize),
    /// A possible message of this length, of an unknown type or id.
    Unsure(usize),
    /// A possible data message of this length, which does not match the definition of its id.
    Misfit(usize),
    /// The start of a message that the end of the file truncates.
    Cut,
    Nothing,
}

/// Scanner of a ULog file: the file, the position in it and the state.
pub(super) struct UlogScanner {
    path: PathBuf,
    forward: ForwardReader<File>,
    pub(super) state: UlogScanState,
}

impl UlogScanner {
    /// Opens a file.
    ///
    /// # Errors
    /// Fails for a file that is not a ULog file.
    pub(super) fn open(path: &Path) -> Result<UlogScanner, ReadError> {
        let mut forward = ForwardReader::open(path)?;
        let header = forward.ahead(HEADER).map_err(|e| ReadError::io(path, &e))?;
        let version = match (header.starts_with(MAGIC), header.get(MAGIC.len()), header.len() >= HEADER) {
            (true, Some(version), true) => *version,
            (true, ..) => return Err(ReadError::data(path, "the file ends within the ULog header")),
            _ => return Err(ReadError::data(path, "the file is not a ULog file: it must start with `ULog`")),
        };
        forward.skip(HEADER);
        let state = UlogScanState {
            formats: UlogFormats::default(),
            topics: vec![],
            numbers: HashMap::new(),
            columns: 0,
            subscriptions: vec![],
            ids: vec![NO_ID; 1 << 16],
            version,
            appended: vec![],
            dropouts: 0,
            dropouts_ms: 0,
            damage: Damage::default(),
            cut: 0,
            unknown: 0,
            unreadable: 0,
        };
        Ok(UlogScanner { path: path.to_path_buf(), forward, state })
    }

    /// Reads the next message and, if it is a data message, passes its topic and record to `visit`. Returns whether
    /// there was a message.
    ///
    /// # Errors
    /// Fails for a file that cannot be read or has unsupported features.
    #[inline]
    pub(super) fn step(&mut self, visit: &mut impl FnMut(usize, &[u8])) -> Result<bool, ReadError> {
        let UlogScanner { path, forward, state } = self;
        let position = forward.position();
        // Positions of appended data before the current position are invalid.
        while state.appended.last().is_some_and(|end| *end < position) {
            state.appended.pop();
        }
        let mut bytes = forward.ahead(AHEAD + 1).map_err(|e| ReadError::io(path, &e))?;
        if let Some(end) = state.appended.last().and_then(|end| end.checked_sub(position)) {
            bytes = usize::try_from(end).ok().and_then(|end| bytes.get(..end)).unwrap_or(bytes);
            if bytes.is_empty() && end == 0 {
                state.appended.pop();
                return Ok(true);
            }
        }
        let taken = match state.found(bytes) {
            _ if bytes.is_empty() => return Ok(false),
            UlogMatch::Sure(length) if state.stands(bytes, length) => {
                state.take(path, position, bytes.get(..length).unwrap_or_default(), visit)?;
                length
            }
            UlogMatch::Unsure(length) if state.leads(bytes.get(length..).unwrap_or_default(), None, 4) => {
                state.unknown += 1;
                length
            }
            UlogMatch::Misfit(length) if state.leads(bytes.get(length..).unwrap_or_default(), None, 4) => {
                state.misfit(bytes.get(..length).unwrap_or_default());
                length
            }
            UlogMatch::Cut => {
                state.cut += bytes.len() as u64;
                bytes.len()
            }
            _ => {
                let skipped = state.next_sure(bytes);
                state.damage.add(position, skipped as u64);
                skipped
            }
        };
        forward.skip(taken);
        Ok(true)
    }

    /// The position in the file.
    pub(super) fn position(&self) -> u64 {
        self.forward.position()
    }

    /// Reads to the end of the file.
    ///
    /// # Errors
    /// Fails in the cases of [`UlogScanner::step`].
    pub(super) fn finish(&mut self, visit: &mut impl FnMut(usize, &[u8])) -> Result<(), ReadError> {
        while self.step(visit)? {}
        Ok(())
    }
}

fn size_of(bytes: &[u8]) -> Option<(usize, u8)> {
    let [low, high, kind, ..] = bytes else { return None };
    Some((usize::from(u16::from_le_bytes([*low, *high])), *kind))
}

/// The 16 bits at an offset.
#[inline]
fn word(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|b| u16::from_le_bytes(*b))
}

impl UlogScanState {
    #[inline]
    fn subscription(&self, id: u16) -> Option<&Subscription> {
        self.subscriptions.get(*self.ids.get(usize::from(id))? as usize)
    }

    /// Classification of the first bytes. `bytes` must contain at least one whole message, or extend to the end of the
    /// file or section.
    #[inline]
    fn found(&self, bytes: &[u8]) -> UlogMatch {
        let Some((size, kind)) = size_of(bytes) else {
            return if bytes.is_empty() { UlogMatch::Nothing } else { UlogMatch::Cut };
        };
        let body = bytes.get(3..3 + size);
        if kind == b'D' {
            let fits = match word(bytes, 3).map(|id| self.subscription(id)) {
                Some(Some(s)) if size < 2 || (s.least..=s.most).contains(&(size - 2)) => size >= 2,
                // At the end of the file, a truncated message cannot be distinguished from damage.
                Some(Some(_)) => return body.map_or(UlogMatch::Nothing, |_| UlogMatch::Misfit(3 + size)),
                Some(None) if size >= 2 => {
                    return if body.is_some() { UlogMatch::Unsure(3 + size) } else { UlogMatch::Nothing };
                }
                Some(None) => false,
                None => size >= 2,
            };
            return match (fits, body) {
                (false, _) => UlogMatch::Nothing,
                (true, Some(_)) => UlogMatch::Sure(3 + size),
                (true, None) => UlogMatch::Cut,
            };
        }
        let Some(body) = body else {
            let known = b"FIMPQARLCSOB".contains(&kind) && plausible(kind, size, None);
            return if known { UlogMatch::Cut } else { UlogMatch::Nothing };
        };
        match kind {
            _ if b"FIMPQARLCSOB".contains(&kind) => {
                if plausible(kind, size, Some(body)) {
                    UlogMatch::Sure(3 + size)
                } else {
                    UlogMatch::Nothing
                }
            }
            kind if kind.is_ascii_alphabetic() && (1..=LONGEST_UNKNOWN).contains(&size) => UlogMatch::Unsure(3 + size),
            _ => UlogMatch::Nothing,
        }
    }

    /// Whether another message or the end of the file follows a message of a known type.
    #[inline]
    fn stands(&self, bytes: &[u8], length: usize) -> bool {
        let (head, rest) = (bytes.get(..length).unwrap_or_default(), bytes.get(length..).unwrap_or_default());
        // A subscription defines the id of the data after it.
        let new = head.get(2).filter(|kind| **kind == b'A').and_then(|_| word(head, 4));
        self.leads(rest, new, 4)
    }

    /// Whether the bytes begin with a message, possibly after some messages of unknown types.
    #[inline]
    fn leads(&self, bytes: &[u8], new: Option<u16>, depth: usize) -> bool {
        if new.is_some() && bytes.get(2) == Some(&b'D') && word(bytes, 3) == new {
            return true;
        }
        match self.found(bytes) {
            UlogMatch::Sure(_) | UlogMatch::Cut => true,
            UlogMatch::Unsure(length) => {
                depth > 0 && self.leads(bytes.get(length..).unwrap_or_default(), new, depth - 1)
            }
            // A data message with a wrong length still has a known id, so several in succession are not accidental.
            UlogMatch::Misfit(length) => {
                depth == 0 || self.leads(bytes.get(length..).unwrap_or_default(), new, depth - 1)
            }
            UlogMatch::Nothing => bytes.is_empty(),
        }
    }

    /// Whether the bytes are the given number of consecutive messages of known types, or fewer up to the end.
    fn chain(&self, bytes: &[u8], messages: usize) -> bool {
        match self.found(bytes) {
            _ if messages == 0 => true,
            UlogMatch::Sure(length) => self.chain(bytes.get(length..).unwrap_or_default(), messages - 1),
            // A truncated message is accepted only after a complete one.
            UlogMatch::Cut => messages < 3,
            UlogMatch::Nothing => bytes.is_empty(),
            UlogMatch::Unsure(_) | UlogMatch::Misfit(_) => false,
        }
    }

    /// The offset of the next valid message. If there is none, the number of bytes examined.
    fn next_sure(&self, bytes: &[u8]) -> usize {
        // Beyond this offset a message and its successor may exceed the window.
        let judged = if bytes.len() > AHEAD { bytes.len() - AHEAD } else { bytes.len() };
        let stands = |at: &usize| self.chain(bytes.get(*at..).unwrap_or_default(), 3);
        (1..judged).find(stands).unwrap_or(judged.max(1))
    }

    fn take(
        &mut self,
        path: &Path,
        position: u64,
        message: &[u8],
        visit: &mut impl FnMut(usize, &[u8]),
    ) -> Result<(), ReadError> {
        let body = message.get(3..).unwrap_or_default();
        match message.get(2) {
            Some(b'D') => self.data(body, visit),
            Some(b'F') if self.formats.add(body).is_none() => self.unreadable += 1,
            Some(b'A') => self.subscribe(body),
            Some(b'R') => {
                if let Some(id) = word(body, 0).and_then(|id| self.ids.get_mut(usize::from(id))) {
                    *id = NO_ID;
                }
            }
            Some(b'O') => {
                self.dropouts += 1;
                self.dropouts_ms += word(body, 0).map_or(0, u64::from);
            }
            Some(b'B') if position == HEADER as u64 => self.flags(path, body)?,
            _ => {}
        }
        Ok(())
    }

    #[inline]
    fn data(&mut self, body: &[u8], visit: &mut impl FnMut(usize, &[u8])) {
        let Some(subscription) = word(body, 0).and_then(|id| self.subscription(id)) else { return };
        let (at, same) = (subscription.topic, subscription.same);
        let Some(topic) = self.topics.get_mut(at) else { return };
        if same {
            topic.rows += 1;
            visit(at, body.get(2..).unwrap_or_default());
        } else {
            topic.others += 1;
        }
    }

    /// Counts a data message that does not match its definition.
    fn misfit(&mut self, message: &[u8]) {
        let Some(at) = word(message, 3).and_then(|id| self.subscription(id)).map(|s| s.topic) else { return };
        if let Some(topic) = self.topics.get_mut(at) {
            topic.misfits.add(message.len().saturating_sub(5));
        }
    }

    fn subscribe(&mut self, body: &[u8]) {
        let (Some(instance), Some(id)) = (body.first(), word(body, 1)) else { return };
        let name = text(body.get(3..).unwrap_or_default());
        let Some(layout) = self.formats.layout(&name, MOST_COLUMNS - self.columns) else {
            self.unreadable += 1;
            return;
        };
        let UlogMessageLayout { least, most, .. } = layout;
        let key = (name, *instance);
        let (at, same) = match self.numbers.get(&key).and_then(|at| Some((*at, self.topics.get(*at)?))) {
            Some((at, topic)) => (at, topic.layout == layout),
            None => {
                let (name, instance) = key.clone();
                self.columns += layout.columns.len();
                self.topics.push(UlogTopic {
                    name,
                    instance,
                    layout,
                    rows: 0,
                    others: 0,
                    misfits: LengthMismatches::default(),
                });
                self.numbers.insert(key, self.topics.len() - 1);
                (self.topics.len() - 1, true)
            }
        };
        // A repeated subscription of an id replaces the earlier one for subsequent messages.
        let number = self.subscriptions.len();
        self.subscriptions.push(Subscription { topic: at, least, most, same });
        if let (Some(of), Ok(number)) = (self.ids.get_mut(usize::from(id)), u32::try_from(number)) {
            *of = number;
        }
    }

    /// Reads the flags of required features and the positions of appended data.
    fn flags(&mut self, path: &Path, body: &[u8]) -> Result<(), ReadError> {
        /// Flag of a file to which data were appended.
        const APPENDED: u8 = 1;
        let incompatible = body.get(8..16).unwrap_or_default();
        let unknown = incompatible.iter().enumerate().any(|(i, b)| b & !(if i == 0 { APPENDED } else { 0 }) != 0);
        if unknown {
            let what = "the file requires unsupported features: an unknown flag for incompatible features is set";
            return Err(ReadError::data(path, what)
                .help(format!("its flags for incompatible features are {incompatible:02x?}")));
        }
        if incompatible.first().is_some_and(|b| b & APPENDED != 0) {
            let offsets = body.get(16..40).unwrap_or_default().chunks_exact(8);
            let offsets = offsets.filter_map(|b| b.first_chunk().map(|b| u64::from_le_bytes(*b)));
            self.appended = offsets.filter(|offset| *offset > HEADER as u64).collect();
            self.appended.sort_unstable_by(|a, b| b.cmp(a));
            self.appended.dedup();
        }
        Ok(())
    }

    /// Names of formats with two different definitions.
    pub(super) fn contradicted(&self) -> &[String] {
        &self.formats.contradicted
    }
}

/// Whether the length, and the body if it is complete, are possible for a message of the type `kind`, which is not
/// data.
fn plausible(kind: u8, size: usize, body: Option<&[u8]>) -> bool {
    let check = |test: &dyn Fn(&[u8]) -> bool| body.is_none_or(test);
    // Log levels are the syslog levels 0 to 7, stored as characters or numbers.
    let level = |b: &[u8]| b.first().is_some_and(|l| (b'0'..=b'7').contains(l) || *l <= 7);
    match kind {
        b'S' => size == SYNC.len() && check(&|b| b == SYNC),
        b'O' | b'R' => size == 2,
        b'L' => (9..=LONGEST_TEXT).contains(&size) && check(&level),
        b'C' => (11..=LONGEST_TEXT).contains(&size) && check(&level),
        b'A' => size >= 4 && check(&|b| is_name(&text(b.get(3..).unwrap_or_default()))),
        b'F' => size >= 4 && check(&|b| UlogFormats::default().add(b).is_some()),
        b'I' | b'P' => size >= 2 && check(&is_key),
        b'M' | b'Q' => size >= 3 && check(&|b| is_key(b.get(1..).unwrap_or_default())),
        b'B' => size >= 40,
        _ => false,
    }
}

/// Whether a body begins with a key: its length, then `type name`.
fn is_key(body: &[u8]) -> bool {
    let Some((length, rest)) = body.split_first() else { return false };
    let Some(key) = rest.get(..usize::from(*length)).and_then(|k| std::str::from_utf8(k).ok()) else { return false };
    key.split_once(' ')
        .is_some_and(|(of, name)| of.bytes().all(|b| b.is_ascii_alphanumeric() || b"_[]".contains(&b)) && is_name(name))
}
