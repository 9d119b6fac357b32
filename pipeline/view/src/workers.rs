//! Threads that compute answers. A full queue rejects requests, so that no client waits without limit.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, PoisonError},
};

use bytes::Bytes;
use report::view::ViewFault;
use schemas::Fault;
use tokio::sync::{mpsc, oneshot};

use crate::{ViewData, answer::answer, request::ViewRequest};

/// Maximum number of waiting requests.
const WAITING: usize = 64;

/// Bytes of an answer, and their media type.
pub type AnswerBytes = (Bytes, &'static str);

/// A request, and the receiver of its answer.
struct Job {
    request: ViewRequest,
    reply: oneshot::Sender<Result<AnswerBytes, ViewFault>>,
}

/// Queue of requests.
#[derive(Clone)]
pub struct ComputeQueue(mpsc::Sender<Job>);

/// Receiver of the requests, shared by the workers.
pub struct JobReceiver(Arc<Mutex<mpsc::Receiver<Job>>>);

impl ComputeQueue {
    /// A queue, and its receiver.
    pub fn new() -> (ComputeQueue, JobReceiver) {
        let (sender, receiver) = mpsc::channel(WAITING);
        (ComputeQueue(sender), JobReceiver(Arc::new(Mutex::new(receiver))))
    }

    /// The answer of a request; `None` if the queue is full.
    pub async fn ask(&self, request: ViewRequest) -> Option<Result<AnswerBytes, ViewFault>> {
        let (reply, answer) = oneshot::channel();
        self.0.try_send(Job { request, reply }).ok()?;
        Some(answer.await.unwrap_or_else(|_| Err(Fault::machine("the server is ending").into())))
    }
}

impl JobReceiver {
    fn next(&self) -> Option<Job> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).blocking_recv()
    }
}

/// Computes answers until the queue is closed.
pub fn work(data: &ViewData, jobs: &JobReceiver) {
    while let Some(Job { request, reply }) = jobs.next() {
        // A client that has disconnected, or whose time has expired, needs no answer.
        if reply.is_closed() {
            continue;
        }
        let answered = catch_unwind(AssertUnwindSafe(|| answer(data, &request)));
        let answered =
            answered.unwrap_or_else(|_| Err(Fault::bug("an answer could not be computed because of a panic").into()));
        // The receiver may be gone.
        let _ = reply.send(answered);
    }
}
