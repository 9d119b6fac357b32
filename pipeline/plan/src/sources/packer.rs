//! Writes lines into the store, with several short lines per pack.

use std::sync::{Mutex, PoisonError};

use arrow_array::RecordBatch;
use schemas::{Fault, keys::HashKey};
use store::Store;

/// Size of a pack in memory, in bytes.
const PACK_BYTES: usize = 4 << 20;

/// Lines that are not written yet.
#[derive(Default)]
struct PackQueue {
    lines: Vec<(HashKey, RecordBatch)>,
    bytes: usize,
}

/// Writer of the lines of a file into packs, shared by several threads.
pub(super) struct LinePacker<'a> {
    store: &'a Store,
    waiting: Mutex<PackQueue>,
}

impl<'a> LinePacker<'a> {
    /// Creates a packer for `store`.
    pub fn new(store: &'a Store) -> LinePacker<'a> {
        LinePacker { store, waiting: Mutex::default() }
    }

    /// Adds a line, and writes a pack when it is full.
    ///
    /// # Errors
    /// Fails if the store cannot be written.
    pub fn put(&self, key: HashKey, batch: RecordBatch) -> Result<(), Fault> {
        let full = {
            let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
            if self.store.has(key) || waiting.lines.iter().any(|(known, _)| *known == key) {
                return Ok(());
            }
            let other = waiting.lines.first().is_some_and(|(_, first)| first.schema() != batch.schema());
            let before = if other { std::mem::take(&mut *waiting).lines } else { vec![] };
            waiting.bytes += batch.get_array_memory_size();
            waiting.lines.push((key, batch));
            let now = if waiting.bytes >= PACK_BYTES { std::mem::take(&mut *waiting).lines } else { vec![] };
            [before, now]
        };
        full.iter().try_for_each(|lines| self.store.put_all(lines))
    }

    /// Writes the remaining lines.
    ///
    /// # Errors
    /// Fails if the store cannot be written.
    pub fn finish(self) -> Result<(), Fault> {
        self.store.put_all(&self.waiting.into_inner().unwrap_or_else(PoisonError::into_inner).lines)
    }
}
