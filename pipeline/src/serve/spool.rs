//! Pieces of an answer between the process that computes them and the client that takes them: a few in memory, more in
//! a file without a name. So a client that reads slowly does not keep the place of the query that it asked.

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

/// Pieces that are kept in memory.
const READY: usize = 2;
/// The most bytes of an answer that wait in its file; beyond, the query waits for its client.
const MOST: u64 = 256 << 20;

/// A queued piece, in memory or in the file.
enum SpoolPiece {
    Memory(Vec<u8>),
    File { at: u64, length: usize },
}

#[derive(Default)]
struct SpoolState {
    pieces: VecDeque<SpoolPiece>,
    file: Option<File>,
    /// The end of the file.
    written: u64,
    end: Option<Result<(), Status>>,
    /// The client has gone away.
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

/// Read side of a spool, for the client; dropping it makes the query obsolete.
pub struct SpoolReader(Arc<SpoolShared>);

impl SpoolShared {
    fn state(&self) -> MutexGuard<'_, SpoolState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SpoolWriter {
    /// The side of the client.
    pub fn reader(&self) -> SpoolReader {
        SpoolReader(self.0.clone())
    }

    /// Takes a piece, and waits while too much waits for the client. False when nobody wants more.
    ///
    /// # Errors
    /// Fails when the file cannot be written.
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

    /// Ends the answer after its last piece; only the first end counts.
    pub fn end(&self, end: Result<(), Status>) {
        let mut state = self.0.state();
        state.end.get_or_insert(end);
        drop(state);
        self.0.room.notify_all();
        self.0.news.notify_one();
    }

    /// Ends the answer at once, without the pieces that wait.
    pub fn cut(&self, why: Status) {
        let mut state = self.0.state();
        // A client that has everything but its end has it.
        if !state.pieces.is_empty() || state.end.is_none() {
            *state = SpoolState { end: Some(Err(why)), gone: state.gone, ..SpoolState::default() };
        }
        drop(state);
        self.0.room.notify_all();
        self.0.news.notify_one();
    }

    /// Comes to its end when the client has gone away.
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

/// A file in `folder` that only this process knows.
fn nameless(folder: &Path) -> io::Result<File> {
    let path = folder.join(format!("answer-{}", uuid::Uuid::new_v4().simple()));
    let file = File::options().read(true).write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

impl SpoolReader {
    /// The next piece; none after the last one.
    ///
    /// # Errors
    /// Fails when the answer stopped before its end.
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
    fn unit_pieces_come_in_their_order_and_a_slow_client_keeps_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let spool = SpoolWriter::default();
        let reader = spool.reader();
        let piece = |n: usize| vec![n as u8; 1000 + n];
        // Nobody reads, and nothing waits.
        (0..20).for_each(|n| assert!(spool.put(piece(n), folder.path()).unwrap()));
        spool.end(Ok(()));
        assert_eq!(folder.path().read_dir().unwrap().count(), 0, "the file has no name");
        for n in 0..20 {
            assert_eq!(reader.taken().unwrap().unwrap().unwrap(), piece(n));
        }
        assert!(reader.taken().unwrap().is_none());
    }

    #[test]
    fn unit_an_answer_that_is_cut_is_an_error_and_its_file_is_given_back() {
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
