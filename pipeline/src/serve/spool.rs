//! Queue of chunks of an answer from the process to the client: a few in memory, more in an unnamed file. A slow client
//! thus does not block the slot of its query.

use std::{
    collections::VecDeque,
    fs::File,
    io,
    os::unix::fs::FileExt,
    path::Path,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::Notify;
use tonic::Status;

/// Number of chunks in memory.
const READY: usize = 2;
/// Maximum size of the waiting chunks in the file, in bytes; beyond it, the query waits for its client.
const MOST: u64 = 256 << 20;

/// Queued chunk, in memory or in the file.
enum SpoolPiece {
    Memory(Vec<u8>),
    File { at: u64, length: usize },
}

#[derive(Default)]
struct SpoolState {
    pieces: VecDeque<SpoolPiece>,
    file: Option<File>,
    /// Write position in the file, in bytes.
    written: u64,
    end: Option<Result<(), Status>>,
    /// Whether the client has disconnected.
    gone: bool,
}

#[derive(Default)]
struct SpoolShared {
    state: Mutex<SpoolState>,
    room: Condvar,
    news: Notify,
    left: Notify,
}

/// Write side of a spool, for the process.
#[derive(Clone, Default)]
pub struct SpoolWriter(Arc<SpoolShared>);

/// Read side of a spool, for the client; when it is dropped, the query is no longer needed.
pub struct SpoolReader(Arc<SpoolShared>);

impl SpoolShared {
    fn state(&self) -> MutexGuard<'_, SpoolState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SpoolWriter {
    /// Read side for the client.
    pub fn reader(&self) -> SpoolReader {
        SpoolReader(self.0.clone())
    }

    /// Queues a chunk; waits while the queue is full. Returns `false` if there is no reader any more.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn put(&self, piece: Vec<u8>, folder: &Path) -> io::Result<bool> {
        let mut state = self.0.state();
        while state.written >= MOST && !state.gone && state.end.is_none() {
            state = self.0.room.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.gone || state.end.is_some() {
            return Ok(false);
        }
        if state.pieces.len() < READY {
            state.pieces.push_back(SpoolPiece::Memory(piece));
        } else {
            if state.file.is_none() {
                state.file = Some(nameless(folder)?);
            }
            let (at, length) = (state.written, piece.len());
            if let Some(file) = &state.file {
                file.write_all_at(&piece, at)?;
            }
            state.written += length as u64;
            state.pieces.push_back(SpoolPiece::File { at, length });
        }
        drop(state);
        self.0.news.notify_one();
        Ok(true)
    }

    /// Ends the answer after its last chunk; any later end has no effect.
    pub fn end(&self, end: Result<(), Status>) {
        let mut state = self.0.state();
        state.end.get_or_insert(end);
        drop(state);
        self.0.room.notify_all();
        self.0.news.notify_one();
    }

    /// Ends the answer at once and discards the waiting chunks.
    pub fn cut(&self, why: Status) {
        let mut state = self.0.state();
        // A client that has received all chunks also receives the end that the process reported.
        if !state.pieces.is_empty() || state.end.is_none() {
            *state = SpoolState { end: Some(Err(why)), gone: state.gone, ..SpoolState::default() };
        }
        drop(state);
        self.0.room.notify_all();
        self.0.news.notify_one();
    }

    /// Completes when the client has disconnected.
    pub async fn left(&self) {
        loop {
            let left = self.0.left.notified();
            if self.0.state().gone {
                return;
            }
            left.await;
        }
    }
}

/// Creates an unnamed file in `folder`.
fn nameless(folder: &Path) -> io::Result<File> {
    let path = folder.join(format!("answer-{}", uuid::Uuid::new_v4().simple()));
    let file = File::options().read(true).write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

impl SpoolReader {
    /// Next chunk; `None` after the last one.
    ///
    /// # Errors
    /// Fails if the answer stopped before its end.
    pub async fn next(&self) -> Option<Result<Vec<u8>, Status>> {
        loop {
            let news = self.0.news.notified();
            if let Some(piece) = self.taken() {
                return piece;
            }
            news.await;
        }
    }

    fn taken(&self) -> Option<Option<Result<Vec<u8>, Status>>> {
        let mut state = self.0.state();
        match state.pieces.pop_front() {
            Some(SpoolPiece::Memory(piece)) => Some(Some(Ok(piece))),
            Some(SpoolPiece::File { at, length }) => {
                let mut piece = vec![0; length];
                let read = state.file.as_ref().map_or(Ok(()), |file| file.read_exact_at(&mut piece, at));
                if !state.pieces.iter().any(|p| matches!(p, SpoolPiece::File { .. })) {
                    (state.file, state.written) = (None, 0);
                    self.0.room.notify_all();
                }
                Some(Some(read.map(|()| piece).map_err(|e| Status::internal(format!("cannot read a result: {e}")))))
            }
            None => match state.end.clone()? {
                Ok(()) => Some(None),
                Err(status) => {
                    state.end = Some(Ok(()));
                    Some(Some(Err(status)))
                }
            },
        }
    }
}

impl Drop for SpoolReader {
    fn drop(&mut self) {
        let mut state = self.0.state();
        *state = SpoolState { gone: true, ..SpoolState::default() };
        drop(state);
        self.0.room.notify_all();
        self.0.left.notify_one();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_chunks_arrive_in_order_and_a_slow_client_blocks_no_query() {
        let folder = tempfile::tempdir().unwrap();
        let spool = SpoolWriter::default();
        let reader = spool.reader();
        let piece = |n: usize| vec![n as u8; 1000 + n];
        // The reader does not read, and the writer does not wait.
        (0..20).for_each(|n| assert!(spool.put(piece(n), folder.path()).unwrap()));
        spool.end(Ok(()));
        assert_eq!(folder.path().read_dir().unwrap().count(), 0, "the file has no name");
        for n in 0..20 {
            assert_eq!(reader.taken().unwrap().unwrap().unwrap(), piece(n));
        }
        assert!(reader.taken().unwrap().is_none());
    }

    #[test]
    fn unit_truncated_answer_is_an_error_and_frees_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let spool = SpoolWriter::default();
        let reader = spool.reader();
        (0..9).for_each(|n| assert!(spool.put(vec![n], folder.path()).unwrap()));
        spool.cut(Status::deadline_exceeded("late"));
        assert!(!spool.put(vec![1], folder.path()).unwrap());
        assert_eq!(reader.taken().unwrap().unwrap().unwrap_err().message(), "late");
        assert!(spool.0.state().file.is_none());
        drop(reader);
        assert!(spool.0.state().gone);
    }
}
