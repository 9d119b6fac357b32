//! Output of text to standard output and standard error, to a terminal, a file or a pipe, without a panic if the stream
//! is closed or full.
//!
//! Results go to standard output. If the reader has closed the stream (`| head -1`), writing ends quietly. Any other
//! failure, such as a full disk, is recorded by [`lost`] and sets the exit status. Text that cannot be written to
//! standard error is dropped.

use std::{
    fmt::Display,
    io::{self, Write},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use schemas::visible;

/// A line on standard error, formatted as by `eprintln!`.
macro_rules! err {
    ($($arg:tt)*) => { $crate::cli::say::err_line(format_args!($($arg)*)) };
}

/// Text on standard output, formatted as by `print!`.
macro_rules! out {
    ($($arg:tt)*) => { $crate::cli::say::out_text(format_args!($($arg)*)) };
}

pub(crate) use {err, out};

/// Whether standard output is closed.
static GONE: AtomicBool = AtomicBool::new(false);
/// The error from writing to standard output.
static LOST: OnceLock<String> = OnceLock::new();

/// Writes one line to standard error, with its control characters made [`visible`].
pub fn err_line(text: impl Display) {
    // One write per line, so that lines of several threads do not mix.
    let _ = io::stderr().lock().write_all(visible(&format!("{text}\n")).as_bytes());
}

/// Writes text to standard output, with its control characters made [`visible`].
pub fn out_text(text: impl Display) {
    let mut out = io::stdout().lock();
    note(out.write_all(visible(&text.to_string()).as_bytes()).and_then(|()| out.flush()));
}

/// Records the outcome of a write to standard output.
pub fn note(written: io::Result<()>) {
    match written {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => GONE.store(true, Ordering::Relaxed),
        Err(e) => {
            let _ = LOST.set(e.to_string());
        }
        Ok(()) => {}
    }
}

/// Whether standard output is closed.
pub fn gone() -> bool {
    GONE.load(Ordering::Relaxed)
}

/// The error from writing to standard output, if any.
pub fn lost() -> Option<&'static str> {
    LOST.get().map(String::as_str)
}
