//! Saved states of a stream: versioned bytes with a checksum.
//!
//! ```text
//! 8 bytes   "MAGSTREA"
//! 4 bytes   version, little-endian, as all numbers
//! 4 bytes   kind of the filter
//! 8 bytes   fingerprint of the filter's parameters
//! 8 bytes   length of the body
//! body      numbers of the filter, 8 bytes each
//! 8 bytes   FNV-1a checksum of all bytes before
//! ```

use thiserror::Error;

use crate::navigation::field::PredictedField;
use crate::navigation::output::NavigationReport;

const MAGIC: &[u8; 8] = b"MAGSTREA";
/// Version of the layout of the bytes.
const VERSION: u32 = 1;
const HEADER: usize = 32;
const CHECKSUM: usize = 8;

/// Reason why a saved state is rejected. The filter is unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StateError {
    /// The bytes do not begin like a saved state.
    #[error("the bytes are not a saved state of a filter stream")]
    Foreign,
    /// The layout has another version.
    #[error("the saved state has version {found}; this program reads version {VERSION}: save the state again")]
    Version {
        /// Version of the bytes.
        found: u32,
    },
    /// The bytes are truncated or changed.
    #[error("the saved state is damaged: its length or its checksum is wrong")]
    Damaged,
    /// The state belongs to another filter or other parameters.
    #[error("the saved state belongs to another filter or to other parameters; create the filter with its parameters")]
    Parameters,
    /// The state belongs to another map or core field.
    #[error(
        "the saved state belongs to another map or core field: at its last position the field was {saved_nt} nT and is \
         now {found_nt} nT"
    )]
    Field {
        /// Field at the last position when the state was saved, in nT; NaN off the map.
        saved_nt: f64,
        /// Field of this filter at the same position, in nT.
        found_nt: f64,
    },
}

/// Visitor of all numbers of a filter's state in a fixed order, which writes or reads them.
pub(crate) trait StateVisitor {
    /// Visits a number.
    fn number(&mut self, value: &mut f64);

    /// Visits a count that is at most `limit`.
    fn count(&mut self, value: &mut usize, limit: usize);

    /// Visits numbers.
    fn numbers(&mut self, values: &mut [f64]) {
        values.iter_mut().for_each(|value| self.number(value));
    }

    /// Visits a number that may be missing.
    fn optional(&mut self, value: &mut Option<f64>) {
        let (mut is_there, mut number) = (usize::from(value.is_some()), value.unwrap_or(0.0));
        self.count(&mut is_there, 1);
        self.number(&mut number);
        *value = (is_there == 1).then_some(number);
    }

    /// Visits counts of samples.
    fn counts(&mut self, values: &mut [&mut usize]) {
        values.iter_mut().for_each(|value| self.count(value, usize::MAX));
    }

    /// Visits the expansion point of a core field.
    fn point(&mut self, field: &mut PredictedField<'_>) {
        let point = field.expansion_point();
        let (mut is_there, mut place) = (usize::from(point.is_some()), point.unwrap_or_default());
        self.count(&mut is_there, 1);
        self.numbers(&mut place);
        let next = (is_there == 1).then_some(place);
        if next.map(|place| place.map(f64::to_bits)) != point.map(|place| place.map(f64::to_bits)) {
            field.expand_at(next);
        }
    }

    /// Visits the counts of a report.
    fn report(&mut self, report: &mut NavigationReport) {
        let NavigationReport { updates, missing_measurements, off_map, gated, .. } = report;
        self.counts(&mut [updates, missing_measurements, off_map, gated]);
    }
}

/// Writer of a state.
pub(super) struct StateWriter {
    bytes: Vec<u8>,
}

impl StateWriter {
    pub(super) fn new(kind: u32, fingerprint: u64) -> Self {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(fingerprint.to_le_bytes());
        bytes.extend([0; 8]);
        Self { bytes }
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        let length = (self.bytes.len() - HEADER) as u64;
        self.bytes[HEADER - 8..HEADER].copy_from_slice(&length.to_le_bytes());
        let sum = fnv1a(&self.bytes);
        self.bytes.extend(sum.to_le_bytes());
        self.bytes
    }
}

impl StateVisitor for StateWriter {
    fn number(&mut self, value: &mut f64) {
        self.bytes.extend(value.to_bits().to_le_bytes());
    }

    fn count(&mut self, value: &mut usize, _: usize) {
        self.bytes.extend((*value as u64).to_le_bytes());
    }
}

/// Reader of a state.
pub(super) struct StateReader<'a> {
    body: &'a [u8],
    /// Whether all numbers so far were present and in their range.
    is_sound: bool,
}

impl<'a> StateReader<'a> {
    /// Checks the header and the checksum.
    pub(super) fn new(bytes: &'a [u8], kind: u32, fingerprint: u64) -> Result<Self, StateError> {
        if bytes.len() < MAGIC.len() || &bytes[..MAGIC.len()] != MAGIC {
            return Err(StateError::Foreign);
        }
        let body_at = HEADER..bytes.len().saturating_sub(CHECKSUM);
        if body_at.start > body_at.end {
            return Err(StateError::Damaged);
        }
        let version = word(&bytes[8..12]) as u32;
        if version != VERSION {
            return Err(StateError::Version { found: version });
        }
        let (content, sum) = bytes.split_at(body_at.end);
        if word(sum) != fnv1a(content) || word(&bytes[24..HEADER]) != body_at.len() as u64 {
            return Err(StateError::Damaged);
        }
        if word(&bytes[12..16]) != u64::from(kind) || word(&bytes[16..24]) != fingerprint {
            return Err(StateError::Parameters);
        }
        Ok(Self { body: &bytes[body_at], is_sound: true })
    }

    /// Checks that every number was present and in its range, and that no bytes remain.
    pub(super) fn finish(self) -> Result<(), StateError> {
        if self.is_sound && self.body.is_empty() { Ok(()) } else { Err(StateError::Damaged) }
    }

    fn next(&mut self) -> Option<u64> {
        let Some((first, rest)) = self.body.split_first_chunk::<8>() else {
            self.is_sound = false;
            return None;
        };
        self.body = rest;
        Some(u64::from_le_bytes(*first))
    }
}

impl StateVisitor for StateReader<'_> {
    fn number(&mut self, value: &mut f64) {
        if let Some(bits) = self.next() {
            *value = f64::from_bits(bits);
        }
    }

    fn count(&mut self, value: &mut usize, limit: usize) {
        let Some(found) = self.next() else { return };
        match usize::try_from(found) {
            Ok(found) if found <= limit => *value = found,
            _ => self.is_sound = false,
        }
    }
}

/// Little-endian number of at most 8 bytes.
fn word(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |word, byte| (word << 8) | u64::from(*byte))
}

/// Hash of bytes. [Fowler, Noll & Vo, FNV-1a, 64 bits]
pub(super) fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}
