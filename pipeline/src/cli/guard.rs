//! The process of a query of `sql`, whose memory is watched by the process that starts it and limited by the kernel.
//!
//! DataFusion accounts for the memory of sorts, joins and aggregates. Results of functions and windows are not
//! accounted for, and an allocation that fails ends the process. So a query runs in a child process, and its end is
//! reported in words.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{Child, ExitStatus},
    sync::atomic::{AtomicI32, Ordering},
    thread::{available_parallelism, sleep},
    time::Duration,
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use schemas::Fault;

use super::ExitReason;
use crate::{confine, views::sql::memory};

/// The variable that names the folder for temporary files, and marks the child.
const CHILD: &str = "MAGLINE_QUERY_FOLDER";
/// Memory of the program itself, and of what DataFusion does not account for, bytes.
const OWN: usize = 256 << 20;
/// Memory that is reserved and mostly not used: a deep stack, and arenas of the allocator.
const RESERVED: usize = 4 << 30;
/// The same of each thread: its stack and its arenas.
const THREAD: usize = 128 << 20;
/// The interval at which the memory of the child is looked at: at first, and at most.
const LOOK: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(8)];

/// The number of the child, for the handler of interrupts; 0 without one.
static CHILD_PID: AtomicI32 = AtomicI32::new(0);

/// The folder for temporary files, where this process is the child.
pub fn folder() -> Option<PathBuf> {
    env::var_os(CHILD).map(PathBuf::from)
}

/// The bytes that a query with the limit `memory` may take in all.
fn most(memory: usize) -> usize {
    memory.saturating_add(OWN.max(memory / 2))
}

/// Limits this process, the child: it ends with its parent, an allocation far beyond its limit fails before the parent
/// sees it, and panics are reported by the error of the query alone.
pub fn limit(memory: usize) {
    std::panic::set_hook(Box::new(|_| {}));
    confine::end_with_parent();
    let threads = available_parallelism().map_or(8, usize::from);
    let reserved = RESERVED.saturating_add(THREAD.saturating_mul(threads));
    // Where the kernel has no such limit, the parent watches all the same.
    let _ = confine::limit_memory(most(memory).saturating_add(reserved));
}

/// Runs this command again as a child process, in which `folder` is for temporary files, and waits for its end.
/// `unfinished` is the file that the child of a number leaves behind when it is killed.
///
/// # Errors
/// The end of the child, where it is not that of success. Its own message is out already.
pub fn run(memory: usize, folder: &Path, unfinished: impl Fn(u32) -> Option<PathBuf>) -> Result<(), ExitReason> {
    let failed = |e: &io::Error| Fault::machine(format!("cannot start the process of the query: {e}"));
    let program = env::current_exe().map_err(|e| failed(&e))?;
    let started = confine::command(&program).args(env::args_os().skip(1)).env(CHILD, folder).spawn();
    let mut child = started.map_err(|e| failed(&e))?;
    let number = i32::try_from(child.id()).unwrap_or(0);
    CHILD_PID.store(number, Ordering::SeqCst);
    // Where no handler can be set, an interrupt ends both at once.
    let _ = ctrlc::set_handler(|| {
        let number = CHILD_PID.load(Ordering::SeqCst);
        if number > 0 {
            let _ = kill(Pid::from_raw(number), Signal::SIGINT);
        }
    });
    let ended = watch(&mut child, most(memory)).map_err(|e| failed(&e))?;
    CHILD_PID.store(0, Ordering::SeqCst);
    match ended.code() {
        Some(0) => return Ok(()),
        Some(code) if code != PANICKED => return Err(ExitReason::Told(u8::try_from(code).unwrap_or(1))),
        _ => {}
    }
    if let Some(file) = unfinished(child.id()) {
        let _ = fs::remove_file(file);
    }
    if ended.code().is_none() && !confine::ran_out(ended) {
        return Err(Fault::machine(format!("the process of the query was killed: {ended}")).into());
    }
    Err(memory::fault(memory).into())
}

/// The exit status of a panic.
const PANICKED: i32 = 101;

/// Waits for the end of the child, which is killed when it takes more than `most` bytes.
fn watch(child: &mut Child, most: usize) -> io::Result<ExitStatus> {
    let [mut wait, longest] = LOOK;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if confine::used(child.id()).is_some_and(|bytes| bytes > most) {
            child.kill()?;
        }
        sleep(wait);
        wait = (wait * 2).min(longest);
    }
}
