//! The effect of Ctrl-C on a run.

use std::{
    io::Write,
    process::exit,
    sync::{Mutex, PoisonError, atomic::Ordering},
    thread,
    time::Duration,
};

use nix::unistd::getppid;
use run::{INTERRUPTED, STARTED};
use store::attempts;

use super::temporary;

/// The message on an interrupted run.
pub const MESSAGE: &str = "interrupted; finished results are stored; run the same command again to resume";

/// The exit status of an interrupted run.
pub const STATUS: u8 = 130;

/// Sets up an interrupt to end the process at once and to remove the process's unfinished files.
pub fn leave() {
    // If no handler can be set, the next process removes them.
    let _ = ctrlc::set_handler(|| {
        temporary::remove_all();
        let _ = writeln!(std::io::stderr(), "interrupted; finished files are kept");
        exit(i32::from(STATUS));
    });
}

/// Makes an interrupt end a run after the units in progress. While sources are read or simulated, which may take long
/// for a single file, an interrupt ends the process at once. The store is always consistent, and keeps the files that
/// were read.
pub fn listen() {
    // If no handler can be set, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(|| stop(STATUS, MESSAGE));
}

/// Ends a run after the units in progress, or at once with `status` while sources are read.
pub fn stop(status: u8, message: &str) {
    INTERRUPTED.store(true, Ordering::SeqCst);
    if !STARTED.load(Ordering::SeqCst) {
        // The lock is held until the process ends, so that another thread that wants to stop the process waits.
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        last.take().into_iter().for_each(|last| last(status));
        let _ = writeln!(std::io::stderr(), "{message}");
        exit(i32::from(status));
    }
}

/// Action before an interrupt ends the process at once; its argument is the exit status.
type ExitAction = Box<dyn FnOnce(u8) + Send>;

static LAST: Mutex<Option<ExitAction>> = Mutex::new(None);

/// Sets the action before an interrupt ends the process at once.
pub fn at_exit(last: impl FnOnce(u8) + Send + 'static) {
    *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(last));
}

/// Ends this process when `parent` is no longer its parent. The units in progress are not counted as lost.
pub fn with_parent(parent: u32) {
    const LOOKS_EVERY: Duration = Duration::from_millis(500);
    // If no thread can be started, the process ends after its task.
    let _ = thread::Builder::new().name("parent".to_owned()).spawn(move || {
        while u32::try_from(getppid().as_raw()).is_ok_and(|now| now == parent) {
            thread::sleep(LOOKS_EVERY);
        }
        attempts::withdraw();
        exit(i32::from(STATUS));
    });
}

/// Makes an interrupt end a worker after the units in progress, as [`listen`] does for a run. The units in progress are
/// not counted as lost.
pub fn withdraw() {
    // If no handler can be set, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(|| {
        INTERRUPTED.store(true, Ordering::SeqCst);
        attempts::withdraw();
        if !STARTED.load(Ordering::SeqCst) {
            let _ = writeln!(std::io::stderr(), "{MESSAGE}");
            exit(i32::from(STATUS));
        }
    });
}
