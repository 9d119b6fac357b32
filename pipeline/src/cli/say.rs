//! Text to standard output and standard error, whatever they are: a closed, full or abandoned stream panics nobody.
//!
//! Results go to standard output. A reader that has gone away (`| head -1`) ends the writing quietly; anything else that
//! stops it, such as a full disk, is kept by [`lost`], and the command ends with an exit status that says so. What cannot
//! be written to standard error is left out: there is nowhere else to say it.

use std::{
    fmt::Display,
    io::{self, Write},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

/// A line on standard error, formatted as by `eprintln!`.
macro_rules! err {
    ($($arg:tt)*) => { $crate::cli::say::err_line(format_args!($($arg)*)) };
}

/// Text on standard output, formatted as by `print!`.
macro_rules! out {
    ($($arg:tt)*) => { $crate::cli::say::out_text(format_args!($($arg)*)) };
}

pub(crate) use {err, out};

/// Nobody reads standard output any longer.
static GONE: AtomicBool = AtomicBool::new(false);
/// Why standard output could not be written.
static LOST: OnceLock<String> = OnceLock::new();

/// Writes one line to standard error.
pub fn err_line(text: impl Display) {
    // One write a line, so that lines of several threads do not mix.
    let _ = io::stderr().lock().write_all(format!("{text}\n").as_bytes());
}

/// Writes text to standard output.
pub fn out_text(text: impl Display) {
    let mut out = io::stdout().lock();
    note(out.write_all(text.to_string().as_bytes()).and_then(|()| out.flush()));
}

/// Keeps what became of something written to standard output.
pub fn note(written: io::Result<()>) {
    match written {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => GONE.store(true, Ordering::Relaxed),
        Err(e) => {
            let _ = LOST.set(e.to_string());
        }
        Ok(()) => {}
    }
}

/// Whether standard output has no reader any longer.
pub fn gone() -> bool {
    GONE.load(Ordering::Relaxed)
}

/// Why standard output could not be written, if it could not.
pub fn lost() -> Option<&'static str> {
    LOST.get().map(String::as_str)
}
