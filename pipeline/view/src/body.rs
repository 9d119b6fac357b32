//! Bodies of answers: bytes in memory, or the parts of a file.

use std::{
    convert::Infallible,
    fs::File,
    io::Read,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    task::{Context, Poll},
};

use bytes::Bytes;
use hyper::body::{Body, Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, mpsc};

/// Size of the parts of a file, in bytes.
const PART: usize = 128 << 10;
/// Maximum size of all answers in memory that clients have not read yet, in bytes.
const MOST_OPEN: usize = 384 << 20;

/// Bytes of an answer, which are counted until they are sent.
struct OpenBytes {
    all: Arc<AtomicUsize>,
    bytes: Bytes,
}

impl AsRef<[u8]> for OpenBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for OpenBytes {
    fn drop(&mut self) {
        self.all.fetch_sub(self.bytes.len(), Ordering::Relaxed);
    }
}

/// Counts the bytes of an answer until they are sent; `None` if too many bytes are unsent.
pub fn counted(all: &Arc<AtomicUsize>, bytes: Bytes) -> Option<Bytes> {
    let before = all.fetch_add(bytes.len(), Ordering::Relaxed);
    let counted = OpenBytes { all: all.clone(), bytes };
    (before == 0 || before + counted.bytes.len() <= MOST_OPEN).then(|| Bytes::from_owner(counted))
}

/// Body of an answer.
pub enum AnswerBody {
    /// Bytes in memory.
    Whole(Option<Bytes>),
    /// Parts of a file, and the number of unsent bytes.
    Parts(mpsc::Receiver<Bytes>, u64),
}

impl AnswerBody {
    /// The next `size` bytes of a file, read in parts. The permit is released when the file has been read.
    pub fn of_file(mut file: File, size: u64, permit: OwnedSemaphorePermit) -> AnswerBody {
        let (sender, receiver) = mpsc::channel(2);
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let mut left = size;
            while left > 0 {
                let mut part = vec![0; usize::try_from(left).unwrap_or(PART).min(PART)];
                // Reading ends if the file is too short or the client has disconnected.
                if file.read_exact(&mut part).is_err() {
                    break;
                }
                left -= part.len() as u64;
                if sender.blocking_send(part.into()).is_err() {
                    break;
                }
            }
        });
        AnswerBody::Parts(receiver, size)
    }
}

impl Body for AnswerBody {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(self: Pin<&mut Self>, cx: &mut Context) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        match self.get_mut() {
            AnswerBody::Whole(bytes) => {
                let bytes = bytes.take().filter(|bytes| !bytes.is_empty());
                Poll::Ready(bytes.map(|bytes| Ok(Frame::data(bytes))))
            }
            AnswerBody::Parts(receiver, left) => receiver.poll_recv(cx).map(|part| {
                let part = part?;
                *left = left.saturating_sub(part.len() as u64);
                Some(Ok(Frame::data(part)))
            }),
        }
    }

    fn is_end_stream(&self) -> bool {
        match self {
            AnswerBody::Whole(bytes) => bytes.as_ref().is_none_or(Bytes::is_empty),
            AnswerBody::Parts(_, left) => *left == 0,
        }
    }

    fn size_hint(&self) -> SizeHint {
        match self {
            AnswerBody::Whole(bytes) => SizeHint::with_exact(bytes.as_ref().map_or(0, |b| b.len() as u64)),
            AnswerBody::Parts(_, left) => SizeHint::with_exact(*left),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_unsent_bytes_are_counted_and_limited() {
        let all = Arc::new(AtomicUsize::new(0));
        let first = counted(&all, Bytes::from(vec![0; 1000]));
        assert_eq!((first.as_ref().map(Bytes::len), all.load(Ordering::Relaxed)), (Some(1000), 1000));
        all.fetch_add(MOST_OPEN, Ordering::Relaxed);
        assert!(counted(&all, Bytes::from_static(b"x")).is_none());
        all.fetch_sub(MOST_OPEN, Ordering::Relaxed);
        drop(first);
        assert_eq!(all.load(Ordering::Relaxed), 0);
    }
}
