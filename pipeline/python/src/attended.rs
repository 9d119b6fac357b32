//! Work on another thread, while the calling thread handles Python's signals.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use pyo3::prelude::*;
use schemas::Fault;

use crate::faults::exception;

/// Interval between checks for signals.
const INTERVAL: Duration = Duration::from_millis(50);
/// Stack of the thread, in bytes: the usual stack of a main thread.
const STACK: usize = 8 << 20;

/// Runs `work` on another thread without the GIL and returns its result. On the first interrupt, `interrupt` is called
/// and the result is awaited; the second interrupt abandons the thread.
///
/// # Errors
/// Fails with `KeyboardInterrupt`, with another exception of a signal handler, and with `BugError` after a panic.
pub fn attended<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
    interrupt: impl Fn(),
) -> PyResult<T> {
    attended_with(py, work, interrupt, || Ok(()))
}

/// Same as [`attended`], but calls `look` on the calling thread at each check for signals. An exception of `look`
/// counts as an interrupt.
///
/// # Errors
/// Fails in the cases of [`attended`], and with the exception of `look`.
pub fn attended_with<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
    interrupt: impl Fn(),
    mut look: impl FnMut() -> PyResult<()>,
) -> PyResult<T> {
    let result: Arc<Mutex<Option<thread::Result<T>>>> = Arc::default();
    let (slot, waiting) = (result.clone(), thread::current());
    let run = move || {
        let done = catch_unwind(AssertUnwindSafe(work));
        *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(done);
        waiting.unpark();
    };
    let started = thread::Builder::new().name("magline".to_owned()).stack_size(STACK).spawn(run);
    started.map_err(|e| exception(py, &Fault::machine(format!("cannot start a thread: {e}"))))?;
    let mut interrupted: Option<PyErr> = None;
    loop {
        let done = result.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (done, interrupted.take()) {
            (Some(_), Some(e)) => return Err(e),
            (Some(Ok(value)), None) => return Ok(value),
            (Some(Err(panic)), None) => return Err(exception(py, &Fault::bug(message(&*panic)))),
            (None, before) => interrupted = before,
        }
        py.detach(|| thread::park_timeout(INTERVAL));
        match (py.check_signals(), interrupted.is_some()) {
            (Err(e), true) => return Err(e),
            (Err(e), false) => interrupted = Some(e),
            (Ok(()), true) => {}
            (Ok(()), false) => interrupted = look().err(),
        }
        if interrupted.is_some() {
            interrupt();
        }
    }
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("the computation ended without a message")
        .to_owned()
}
