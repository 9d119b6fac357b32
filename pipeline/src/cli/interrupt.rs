//! The effect of Ctrl-C on a run.

use std::{
    io::Write,
    process::exit,
    sync::{Mutex, PoisonError, atomic::Ordering},
    thread,
    time::Duration,
};

use nix::unistd::getppid;

use super::temporary;
use crate::{
    run::{INTERRUPTED, STARTED},
    store::attempts,
};

/// The message on an interrupted run.
pub const SAID: &str = "interrupted; finished results are stored, run the same command again to resume";

/// The exit status of an interrupted run.
pub const STATUS: u8 = 130;

/// From now on an interrupt ends the process at once, without its unfinished files.
pub fn leave() {
    // Where no handler can be set, the next process removes them.
    let _ = ctrlc::set_handler(|| {
        temporary::remove_all();
        let _ = writeln!(std::io::stderr(), "interrupted; finished files are kept");
        exit(i32::from(STATUS));
    });
}

/// From now on an interrupt ends a run after the units that are being computed. While sources are read or simulated,
/// which may take long for a single file, it ends the process at once: the store is consistent at any moment, and the
/// files that were read are kept in it.
pub fn listen() {
    // Where no handler can be set, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(|| stop(STATUS, SAID));
}

/// Ends a run after the units that are being computed, or at once with `status` while sources are read.
pub fn stop(status: u8, said: &str) {
    INTERRUPTED.store(true, Ordering::SeqCst);
    if !STARTED.load(Ordering::SeqCst) {
        // Held to the end: another thread that stops the process waits for what is done here.
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        last.take().into_iter().for_each(|last| last(status));
        let _ = writeln!(std::io::stderr(), "{said}");
        exit(i32::from(status));
    }
}

/// Action before an interrupt ends the process at once; its argument is the exit status.
type ExitAction = Box<dyn FnOnce(u8) + Send>;

static LAST: Mutex<Option<ExitAction>> = Mutex::new(None);

/// Sets what is done before an interrupt ends the process at once.
pub fn at_exit(last: impl FnOnce(u8) + Send + 'static) {
    *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(last));
}

/// From now on this process ends when `parent` no longer is its parent: whoever gave it its tasks is gone, which is not
/// the fault of a unit.
pub fn with_parent(parent: u32) {
    const LOOKS_EVERY: Duration = Duration::from_millis(500);
    // Without a spare thread it ends after its task.
    let _ = thread::Builder::new().name("parent".to_owned()).spawn(move || {
        while u32::try_from(getppid().as_raw()).is_ok_and(|now| now == parent) {
            thread::sleep(LOOKS_EVERY);
        }
        attempts::withdraw();
        exit(i32::from(STATUS));
    });
}

/// From now on an interrupt ends a worker as [`listen`] ends a run, and the units at work are not counted as lost: what
/// stops the worker is not their fault.
pub fn withdraw() {
    // Where no handler can be set, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(|| {
        INTERRUPTED.store(true, Ordering::SeqCst);
        attempts::withdraw();
        if !STARTED.load(Ordering::SeqCst) {
            let _ = writeln!(std::io::stderr(), "{SAID}");
            exit(i32::from(STATUS));
        }
    });
}
